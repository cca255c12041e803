//! The property values of one camera and the timing that follows from them.
//!
//! In: values as a program sets them. Out: values read back, times of the rolling shutter.
//! Never: keeps a value outside its limits. Fails: [`Code`].

use std::collections::BTreeMap;

use crate::capture::{Input, Timing};
use crate::codes::{Code, id};
use crate::spec::{
    EDGE_BLANK_LINES, Kind, LINE_FAST_S, LINE_SLOW_S, SIDE, SYNCHRONOUS_BLANK_LINES, Spec, USB_BYTES_PER_S,
    find,
};

/// Part of the sensor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Region {
    pub(crate) left: u32,
    pub(crate) top: u32,
    pub(crate) width: u32,
    pub(crate) height: u32,
}

/// Values that were set; the others have their default.
#[derive(Debug, Clone, Default)]
pub(crate) struct Settings(BTreeMap<i32, f64>);

impl Settings {
    fn kept(&self, id: i32) -> f64 {
        self.0.get(&id).copied().unwrap_or_else(|| match id {
            id::READOUT_SPEED => 2.0,
            _ => find(id).map_or(0.0, |spec| spec.default),
        })
    }

    /// The value of a property.
    pub(crate) fn get(&self, id: i32) -> Result<f64, Code> {
        find(id).ok_or(Code::INVALIDPROPERTYID)?;
        let region = self.region();
        Ok(match id {
            id::READOUT_TIME => self.readout_s(),
            id::CYCLIC_PERIOD | id::MIN_INTERVAL => self.least_interval_s(),
            id::FRAME_INTERVAL => self.interval_s(),
            id::FRAME_RATE => 1.0 / self.interval_s(),
            id::IMAGE_WIDTH => f64::from(region.width),
            id::IMAGE_HEIGHT => f64::from(region.height),
            id::ROW_BYTES => 2.0 * f64::from(region.width),
            id::FRAME_BYTES => 2.0 * f64::from(region.width) * f64::from(region.height),
            _ => self.kept(id),
        })
    }

    /// Sets a value that somebody may set now.
    pub(crate) fn set(&mut self, spec: &Spec, id: i32, value: f64) -> Result<(), Code> {
        if !(spec.least..=spec.greatest).contains(&value) {
            // A rounding of the last digit of a limit is none.
            if (value - spec.least).abs() > 1e-9 && (value - spec.greatest).abs() > 1e-9 {
                return Err(Code::OUTOFRANGE);
            }
        }
        let value = match spec.kind {
            Kind::Mode(choices) if choices.iter().any(|(choice, _)| f64::from(*choice) == value) => value,
            Kind::Mode(_) => return Err(Code::INVALIDVALUE),
            Kind::Long if value % spec.step != 0.0 => return Err(Code::INVALIDVALUE),
            Kind::Long => value,
            Kind::Real if id == id::EXPOSURE => (value / self.line_s()).round() * self.line_s(),
            Kind::Real => value,
        };
        let before = self.0.insert(id, value);
        if self.fits() {
            return Ok(());
        }
        match before {
            Some(before) => self.0.insert(id, before),
            None => self.0.remove(&id),
        };
        Err(Code::INVALIDVALUE)
    }

    /// The camera itself sets its trigger source back after a start trigger.
    pub(crate) fn back_to_internal(&mut self) {
        self.0.insert(id::TRIGGER_SOURCE, 1.0);
    }

    fn fits(&self) -> bool {
        let side = f64::from(SIDE);
        self.kept(id::LEFT) + self.kept(id::WIDTH) <= side
            && self.kept(id::TOP) + self.kept(id::HEIGHT) <= side
    }

    pub(crate) fn region(&self) -> Region {
        if self.kept(id::SUBARRAY) == 1.0 {
            return Region { left: 0, top: 0, width: SIDE, height: SIDE };
        }
        let pixels = |id| self.kept(id) as u32;
        Region {
            left: pixels(id::LEFT),
            top: pixels(id::TOP),
            width: pixels(id::WIDTH),
            height: pixels(id::HEIGHT),
        }
    }

    fn line_s(&self) -> f64 {
        if self.kept(id::READOUT_SPEED) == 1.0 { LINE_SLOW_S } else { LINE_FAST_S }
    }

    /// Both halves of the sensor are read outward from its center at once.
    fn readout_s(&self) -> f64 {
        let Region { top, height, .. } = self.region();
        let center = SIDE / 2;
        let pairs = center.abs_diff(top).max(center.abs_diff(top + height));
        f64::from(pairs) * self.line_s()
    }

    fn transfer_s(&self) -> f64 {
        let Region { width, height, .. } = self.region();
        2.0 * f64::from(width) * f64::from(height) / USB_BYTES_PER_S
    }

    fn interval_s(&self) -> f64 {
        self.kept(id::EXPOSURE).max(self.readout_s()).max(self.transfer_s())
    }

    fn least_interval_s(&self) -> f64 {
        let lines = |lines: f64| lines * self.line_s();
        match self.input() {
            Input::Synchronous => (self.readout_s() + lines(SYNCHRONOUS_BLANK_LINES)).max(self.transfer_s()),
            Input::Edge => {
                let least = self.kept(id::EXPOSURE) + self.readout_s() + lines(EDGE_BLANK_LINES);
                least.max(self.transfer_s())
            }
            Input::Internal | Input::Start => self.interval_s(),
        }
    }

    pub(crate) fn input(&self) -> Input {
        if self.kept(id::TRIGGER_SOURCE) != 2.0 {
            Input::Internal
        } else if self.kept(id::TRIGGER_MODE) == 6.0 {
            Input::Start
        } else if self.kept(id::TRIGGER_ACTIVE) == 3.0 {
            Input::Synchronous
        } else {
            Input::Edge
        }
    }

    pub(crate) fn timing(&self) -> Timing {
        Timing {
            exposure_s: self.kept(id::EXPOSURE),
            readout_s: self.readout_s(),
            line_s: self.line_s(),
            interval_s: self.interval_s(),
            least_interval_s: self.least_interval_s(),
        }
    }

    /// Whether the first output gives a pulse at the beginning of each frame.
    pub(crate) fn gives_frame_pulses(&self) -> bool {
        self.kept(id::OUTPUT_KIND) == 3.0 && self.kept(id::OUTPUT_SOURCE) == 3.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn set(settings: &mut Settings, id: i32, value: f64) -> Result<(), Code> {
        settings.set(find(id).unwrap(), id, value)
    }

    #[test]
    fn exposures_are_whole_lines() {
        let mut settings = Settings::default();
        set(&mut settings, id::EXPOSURE, 0.010).unwrap();
        let lines = settings.get(id::EXPOSURE).unwrap() / LINE_FAST_S;
        assert!((lines - 1026.0).abs() < 1e-6, "{lines}");
        assert_eq!(set(&mut settings, id::EXPOSURE, 11.0), Err(Code::OUTOFRANGE));
    }

    #[test]
    fn readout_follows_the_rows_around_the_center() {
        let mut settings = Settings::default();
        assert!((settings.get(id::READOUT_TIME).unwrap() - 9.978e-3).abs() < 1e-6);
        for (id, value) in [(id::HEIGHT, 512.0), (id::TOP, 768.0), (id::SUBARRAY, 2.0)] {
            set(&mut settings, id, value).unwrap();
        }
        let per_second = 1.0 / settings.get(id::READOUT_TIME).unwrap();
        assert!((per_second - 400.9).abs() < 0.5, "{per_second}");
        assert_eq!(set(&mut settings, id::TOP, 1600.0), Err(Code::INVALIDVALUE), "beyond the sensor");
        assert_eq!(set(&mut settings, id::TOP, 770.0), Err(Code::INVALIDVALUE), "no multiple of 4");
        assert_eq!(settings.region().top, 768);
    }
}
