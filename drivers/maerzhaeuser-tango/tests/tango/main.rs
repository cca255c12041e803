//! The driver against a script, against the virtual controller, and against everything that can go wrong.

mod bench;
mod bytes;
mod conformance;
mod envelope;
mod faults;
mod garbage;
mod lost;
mod races;
mod stop;
