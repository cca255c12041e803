//! GenICam cameras (GigE Vision, USB3 Vision) through Aravis 0.8.
//!
//! | file | what |
//! |---|---|
//! | `settings` | which camera, and what the contract has no words for |
//! | `camera`, `opening` | [`GenicamCamera`]: found by serial number or address, known by serial number |
//! | `configuring` | settings to features and back, each feature optional |
//! | `properties` | the node map for the property browser |
//! | `stream` | [`GenicamStream`]: frames into the caller's memory |
//! | `naming` | ids and times of frames whose leader is lost |
//! | `unpacking` | counts out of the bytes of a frame |
//! | `watchdog`, `probe` | whether a silent camera is still there |
//! | `advice` | what the person can do for a faster network |
//! | `raw` | the only `unsafe` code |
//!
//! In: [`CameraSettings`](sofiscope_hal::CameraSettings). Out: frames, numbered since arming.
//! Never: knows a camera by the order in which it was found; touches the control channel on the thread that grabs
//! frames, beyond a question on a socket of its own. Fails: as the contracts of `sofiscope_hal` say.
//!
//! Without the feature `aravis` this package is empty, so that the program builds where libaravis is not installed.
#![cfg(feature = "aravis")]

mod advice;
mod camera;
mod configuring;
mod naming;
mod opening;
mod probe;
mod properties;
mod raw;
mod settings;
mod stream;
mod unpacking;
mod watchdog;

pub use camera::{GenicamCamera, StreamStatistics};
pub use settings::{Find, GenicamSettings};
pub use stream::GenicamStream;
