//! The TeensyPulseGenerator of Micro-Manager, a clock for cameras.
