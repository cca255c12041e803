//! One simulated camera: its state, its ring of buffers, what goes wrong with it.
//!
//! In: calls of the library, the trigger line, the time now. Out: answers. Never: reads a clock.
//! Fails: [`Code`], as the library would.
//!
//! States: stable (open), ready (buffers taken), busy (capturing).

use std::collections::BTreeSet;
use std::time::Duration;

use crate::capture::Capture;
use crate::codes::{Code, id, status};
use crate::line::Line;
use crate::settings::{Region, Settings};
use crate::spec::{Access, Spec, find};

/// What goes wrong; nothing by default.
#[derive(Debug, Clone, Default)]
pub(crate) struct Faults {
    /// Frame stamps that never arrive.
    pub(crate) lose: BTreeSet<u32>,
    /// Pulses, counted from the start of a capture, that are not heard.
    pub(crate) miss: BTreeSet<u64>,
    /// Frames after which the plug is pulled.
    pub(crate) unplug_after: Option<u32>,
    pub(crate) unplugged: bool,
    /// Settings that are refused as busy.
    pub(crate) busy: u32,
}

/// A buffer of the ring.
#[derive(Debug, Clone, Default)]
pub(crate) struct Slot {
    pub(crate) exposure: u64,
    pub(crate) stamp: u32,
    pub(crate) done_at: Duration,
    /// Stamp of the frame whose pixels it has.
    pub(crate) drawn: Option<u32>,
    pub(crate) pixels: Vec<u16>,
}

/// A simulated camera.
#[derive(Debug, Default)]
pub(crate) struct Camera {
    pub(crate) settings: Settings,
    pub(crate) faults: Faults,
    pub(crate) slots: Vec<Slot>,
    pub(crate) region: Option<Region>,
    /// Frames written to the ring since the start.
    pub(crate) written: u32,
    stamp: u32,
    capture: Option<Capture>,
    /// Reports that wait to be told.
    pub(crate) lost: u32,
    pub(crate) too_frequent: u64,
}

impl Camera {
    pub(crate) fn status(&self) -> i32 {
        match (&self.capture, self.slots.is_empty()) {
            (Some(_), _) => status::BUSY,
            (None, false) => status::READY,
            (None, true) => status::STABLE,
        }
    }

    pub(crate) fn check(&self) -> Result<(), Code> {
        if self.faults.unplugged { Err(Code::FAILREADCAMERA) } else { Ok(()) }
    }

    /// Whether a property can be set now.
    pub(crate) fn may_set(&mut self, id: i32) -> Result<&'static Spec, Code> {
        let spec = find(id).ok_or(Code::INVALIDPROPERTYID)?;
        if spec.access == Access::Never {
            return Err(Code::NOTWRITABLE);
        }
        if self.faults.busy > 0 {
            self.faults.busy -= 1;
            return Err(Code::BUSY);
        }
        let shapes = matches!(id, id::BINNING | id::LEFT | id::WIDTH | id::TOP | id::HEIGHT | id::SUBARRAY);
        let blocked = match self.status() {
            status::BUSY => spec.access != Access::Always,
            status::READY => shapes,
            _ => false,
        };
        if blocked { Err(Code::BUSY) } else { Ok(spec) }
    }

    pub(crate) fn allocate(&mut self, frames: usize) -> Result<(), Code> {
        match self.status() {
            status::BUSY => Err(Code::BUSY),
            _ if frames == 0 => Err(Code::INVALIDPARAM),
            _ => {
                let region = self.settings.region();
                let num_pixels = region.width as usize * region.height as usize;
                let slot = || Slot { pixels: vec![0; num_pixels], ..Slot::default() };
                self.slots = std::iter::repeat_with(slot).take(frames).collect();
                self.region = Some(region);
                self.written = 0;
                Ok(())
            }
        }
    }

    pub(crate) fn release(&mut self) -> Result<(), Code> {
        if self.capture.is_some() {
            return Err(Code::BUSY);
        }
        self.slots = Vec::new();
        Ok(())
    }

    pub(crate) fn start(&mut self, line: &Line, now: Duration) -> Result<(), Code> {
        match self.status() {
            status::READY => {
                self.capture = Some(Capture::new(self.settings.input(), self.settings.timing(), line, now));
                (self.written, self.stamp, self.lost, self.too_frequent) = (0, 0, 0, 0);
                Ok(())
            }
            status::BUSY => Err(Code::BUSY),
            _ => Err(Code::NOTREADY),
        }
    }

    pub(crate) fn stop(&mut self) {
        self.capture = None;
    }

    /// Lets frames arrive that are finished by `now`; begins of frames go to `output`.
    pub(crate) fn advance(&mut self, line: &Line, now: Duration, output: impl FnMut(Duration)) {
        let Some(capture) = &mut self.capture else { return };
        let faults = &mut self.faults;
        capture.advance(line, now, |pulse| faults.miss.contains(&pulse), output);
        self.too_frequent += std::mem::take(&mut capture.too_frequent);
        if capture.has_started() {
            self.settings.back_to_internal();
        }
        while let Some(shot) = capture.finished(now).filter(|_| !faults.unplugged) {
            let stamp = self.stamp;
            self.stamp = stamp.wrapping_add(1);
            if faults.lose.contains(&stamp) {
                self.lost += 1;
                continue;
            }
            let place = self.written as usize % self.slots.len();
            let slot = &mut self.slots[place];
            (slot.exposure, slot.stamp, slot.done_at, slot.drawn) =
                (shot.exposure, stamp, shot.done_at, None);
            self.written = self.written.wrapping_add(1);
            faults.unplugged |= faults.unplug_after.is_some_and(|frames| self.written >= frames);
        }
    }

    /// Buffer of the newest frame.
    pub(crate) fn newest_slot(&self) -> i32 {
        match (self.written.checked_sub(1), self.slots.len()) {
            (Some(newest), slots @ 1..) => (newest as usize % slots) as i32,
            _ => -1,
        }
    }

    pub(crate) fn is_capturing(&self) -> bool {
        self.capture.is_some()
    }

    /// When something happens next.
    pub(crate) fn next_at(&self, line: &Line) -> Option<Duration> {
        self.capture.as_ref()?.next_at(line)
    }
}
