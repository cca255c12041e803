//! The recording room against its promises: what goes in comes out, and what was committed survives.

#[cfg(test)]
#[path = "recording/common.rs"]
mod common;
#[cfg(test)]
#[path = "recording/damage.rs"]
mod damage;
#[cfg(test)]
#[path = "recording/full_disk.rs"]
mod full_disk;
#[cfg(test)]
#[path = "recording/kill.rs"]
mod kill;
#[cfg(test)]
#[path = "recording/round_trip.rs"]
mod round_trip;
#[cfg(test)]
#[path = "recording/speed.rs"]
mod speed;
#[cfg(test)]
#[path = "recording/stock_readers.rs"]
mod stock_readers;
