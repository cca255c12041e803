//! The replay room against its promises: what was recorded comes again, when it came, and nothing else.

#[cfg(test)]
#[path = "replay/builder.rs"]
mod builder;
#[cfg(test)]
#[path = "replay/cameras.rs"]
mod cameras;
#[cfg(test)]
#[path = "replay/common.rs"]
mod common;
#[cfg(test)]
#[path = "replay/formats.rs"]
mod formats;
#[cfg(test)]
#[path = "replay/hostile.rs"]
mod hostile;
#[cfg(test)]
#[path = "replay/pipeline.rs"]
mod pipeline;
#[cfg(test)]
#[path = "replay/recordings.rs"]
mod recordings;
#[cfg(test)]
#[path = "replay/stacks.rs"]
mod stacks;
#[cfg(test)]
#[path = "replay/timing.rs"]
mod timing;
