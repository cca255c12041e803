//! The driver against virtual lasers, on a small simulated controller.

#[cfg(test)]
mod bench;
#[cfg(test)]
mod controller;
#[cfg(test)]
mod faults;
#[cfg(test)]
mod sequences;
