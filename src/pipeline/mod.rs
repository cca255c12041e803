//! Plumbing between threads: bounded queues with names, the latest value, named threads. Knows no physics.
