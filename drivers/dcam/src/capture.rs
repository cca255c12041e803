//! One run of a camera: its buffers, its wait and what it lost, shared by the threads that control and grab.
//!
//! In: an open camera. Out: frames copied, losses counted. Never: releases buffers while one is copied.
//! Fails: [`DeviceError`].
//!
//! Order of the end: abort the wait, stop, release the buffers, close the wait, close the camera, end the library.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use sofiscope_hal::DeviceError;

use crate::api::Device;
use crate::ffi::{Failure, Hdcamwait};

/// Frames that a run lost, and why; each also is a gap in the exposures of the frames that came.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Losses {
    /// Overwritten in the ring before they were read.
    pub overwritten: u64,
    /// Overwritten while they were read; delivered as incomplete.
    pub torn: u64,
    /// Frames missing in the frame stamps for another reason.
    pub missing: u64,
    /// Reports of the library that it lost a frame.
    pub reported: u64,
    /// Reports of the library that a trigger came too early and was dropped.
    pub too_frequent: u64,
}

/// The same, counted on one thread and read on another.
#[derive(Debug, Default)]
pub(crate) struct LossCounts {
    pub(crate) overwritten: AtomicU64,
    pub(crate) torn: AtomicU64,
    pub(crate) missing: AtomicU64,
    pub(crate) reported: AtomicU64,
    pub(crate) too_frequent: AtomicU64,
}

impl LossCounts {
    pub(crate) fn read(&self) -> Losses {
        let get = |count: &AtomicU64| count.load(Ordering::Relaxed);
        Losses {
            overwritten: get(&self.overwritten),
            torn: get(&self.torn),
            missing: get(&self.missing),
            reported: get(&self.reported),
            too_frequent: get(&self.too_frequent),
        }
    }
}

/// Whether the ring of buffers is still there.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Buffers {
    Held,
    Released,
}

/// A run.
#[derive(Debug)]
pub(crate) struct Capture {
    pub(crate) device: Arc<Device>,
    wait: Hdcamwait,
    stopping: AtomicBool,
    buffers: Mutex<Buffers>,
    pub(crate) losses: Arc<LossCounts>,
}

impl Capture {
    /// Takes buffers and lets the camera capture.
    pub(crate) fn begin(
        device: Arc<Device>,
        buffers: u32,
        losses: Arc<LossCounts>,
    ) -> Result<Self, DeviceError> {
        let (library, camera) = (device.functions(), device.handle());
        let wait =
            library.open_wait(camera).map_err(|failure| device.error("cannot be waited for", failure))?;
        if let Err(failure) = library.allocate(camera, buffers) {
            let error = device.error(&format!("has no memory for {buffers} frames"), failure);
            note(&device, "close the wait", library.close_wait(wait));
            return Err(error);
        }
        let capture =
            Self { device, wait, stopping: false.into(), buffers: Mutex::new(Buffers::Held), losses };
        // From here on dropping it gives everything back.
        capture.library_start().map_err(|failure| capture.device.error("cannot start exposures", failure))?;
        Ok(capture)
    }

    fn library_start(&self) -> Result<(), Failure> {
        self.device.functions().start(self.device.handle())
    }

    /// Ends exposures and wakes whoever waits for a frame; what is finished can still be read.
    pub(crate) fn stop(&self) -> Result<(), DeviceError> {
        if self.stopping.swap(true, Ordering::SeqCst) {
            return Ok(());
        }
        let (library, camera) = (self.device.functions(), self.device.handle());
        let stopped = library.stop(camera);
        // After the stop, so that whoever wakes finds everything that was finished.
        note(&self.device, "wake its reader", library.abort(self.wait));
        match stopped {
            Err(Failure::NOTBUSY) | Ok(()) => Ok(()),
            Err(failure) => Err(self.device.error("cannot be stopped", failure)),
        }
    }

    pub(crate) fn is_stopping(&self) -> bool {
        self.stopping.load(Ordering::SeqCst)
    }

    /// The buffers, which stay as they are while this is held.
    pub(crate) fn buffers(&self) -> MutexGuard<'_, Buffers> {
        self.buffers.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Gives the buffers back; frames that were not read are gone.
    pub(crate) fn release(&self) {
        let mut buffers = self.buffers();
        if *buffers == Buffers::Held {
            *buffers = Buffers::Released;
            note(
                &self.device,
                "give its buffers back",
                self.device.functions().release(self.device.handle()),
            );
        }
    }

    /// Waits for events of `mask`; gives those that happened.
    pub(crate) fn wait(&self, mask: i32, timeout_ms: i32) -> Result<i32, Failure> {
        self.device.functions().wait(self.wait, mask, timeout_ms)
    }
}

impl Drop for Capture {
    fn drop(&mut self) {
        if let Err(error) = self.stop() {
            tracing::warn!("{error}");
        }
        self.release();
        note(&self.device, "close the wait", self.device.functions().close_wait(self.wait));
    }
}

/// Logs what could not be undone at an end; nobody can do more about it.
fn note(device: &Device, what: &str, result: Result<(), Failure>) {
    if let Err(failure) = result {
        tracing::warn!("{}: cannot {what}: {failure}", device.name());
    }
}
