//! The laser chain against its promise: whatever happens, the gates are closed within 300 ms and stay closed.
//!
//! Every process is a real one: virtual devices behind pseudo-terminals, the laser guard, and an instrument that
//! holds the light by proving its progress. The judges are the virtual devices, which note every change of a gate
//! and of emitted power by their own clock, while threads of this test keep all cores busy.

#[cfg(test)]
#[path = "laser_safety/bench.rs"]
mod bench;
#[cfg(test)]
#[path = "laser_safety/causes.rs"]
mod causes;
#[cfg(test)]
#[path = "laser_safety/connects.rs"]
mod connects;
#[cfg(test)]
#[path = "laser_safety/holding.rs"]
mod holding;
#[cfg(test)]
#[path = "laser_safety/instrument.rs"]
mod instrument;
#[cfg(test)]
#[path = "laser_safety/on_time.rs"]
mod on_time;
#[cfg(test)]
#[path = "laser_safety/trials.rs"]
mod trials;
