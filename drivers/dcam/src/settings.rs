//! What a camera is made to do, in the order in which it takes it, and what it says it does.
//!
//! In: [`DcamOptions`] of the configuration, [`CameraSettings`] of a run. Out: settings read back.
//! Never: trusts a value that was not read back. Fails: [`DeviceError`], before anything is sent where the limits
//! are known.
//!
//! The order is that of storm-control, pyLabLib, PYME and python-microscope: sensor mode, readout speed, binning,
//! region off, position and size, region on, correction of pixels off, exposure, trigger.

use std::time::Duration;

use sofiscope_hal::{CameraCapabilities, CameraSettings, DeviceError, ErrorKind, Region, TriggerMode};

use crate::api::Device;
use crate::ffi::ids::{Id, mode};

/// Position and size of a region are multiples of this (ORCA-Flash4.0 manual, sub-array).
pub(crate) const REGION_STEP: u32 = 4;

/// What a pulse does to a camera with an external trigger.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum PulseInput {
    /// Each pulse ends one exposure and begins the next; the exposure is the time between them.
    ///
    /// The first pulse ends nothing, so `N + 1` pulses give `N` frames: frame stamp 0 is the exposure that began
    /// with the first pulse, on every camera, and what the last pulse began is never delivered.
    #[default]
    SynchronousReadout,
    /// Each pulse begins one exposure of the time that was set.
    Edge,
    /// The first pulse begins exposures that follow each other by themselves.
    Start,
}

impl PulseInput {
    /// Pulses that a trigger has to give for `frames` frames.
    #[must_use]
    pub fn pulses_for(self, frames: u64) -> u64 {
        match self {
            Self::SynchronousReadout => frames.saturating_add(1),
            Self::Edge => frames,
            Self::Start => frames.min(1),
        }
    }
}

/// The edge of a pulse that counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Polarity {
    /// From low to high.
    #[default]
    Positive,
    /// From high to low.
    Negative,
}

/// How fast the sensor is read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ReadoutSpeed {
    /// The standard: 9.74 µs per pair of rows.
    #[default]
    Fast,
    /// With less noise: about 32 µs per pair of rows, where the camera has it.
    Slow,
}

/// What the configuration says of a camera beside its serial number.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct DcamOptions {
    /// What a pulse does.
    pub pulse_input: PulseInput,
    /// The edge that counts.
    pub polarity: Polarity,
    /// How fast the sensor is read.
    pub readout_speed: ReadoutSpeed,
    /// Buffers of the library's ring; two seconds of frames where none is given.
    pub buffers: Option<u32>,
}

const FEWEST_BUFFERS: u32 = 8;
const MOST_BUFFERS: u32 = 2000;
const MOST_BUFFER_BYTES: u64 = 2 << 30;

impl DcamOptions {
    /// Buffers for two seconds of frames, at most 2000 and 2 GiB (the caps of storm-control).
    pub(crate) fn buffers_for(self, settings: &CameraSettings) -> u32 {
        let frame_bytes = 2 * settings.region.num_pixels() as u64;
        let fit = MOST_BUFFER_BYTES / frame_bytes.max(1);
        let in_two_seconds = 2_000_000_000 / settings.period.as_nanos().max(1);
        let wanted =
            u32::try_from(in_two_seconds).unwrap_or(MOST_BUFFERS).clamp(FEWEST_BUFFERS, MOST_BUFFERS);
        self.buffers.unwrap_or_else(|| wanted.min(u32::try_from(fit).unwrap_or(MOST_BUFFERS))).max(2)
    }
}

/// Refuses what the camera cannot do, before anything is sent to it.
pub(crate) fn check(
    device: &Device,
    able: &CameraCapabilities,
    options: DcamOptions,
    want: &CameraSettings,
) -> Result<(), DeviceError> {
    let refuse = |message| Err(DeviceError::new(ErrorKind::OutOfRange, device.name(), message));
    let Region { left, top, width, height } = want.region;
    let fits = |start: u32, length: u32, limit: u32| {
        length > 0
            && start.is_multiple_of(REGION_STEP)
            && length.is_multiple_of(REGION_STEP)
            && start.checked_add(length).is_some_and(|end| end <= limit)
    };
    if !fits(left, width, able.sensor_width) || !fits(top, height, able.sensor_height) {
        return refuse(format!(
            "a region of {width} x {height} pixels from column {left}, row {top} is not within the {} x {} pixels \
             of the sensor in steps of {REGION_STEP}",
            able.sensor_width, able.sensor_height
        ));
    }
    let (shortest, longest) = able.exposure.clone().into_inner();
    if !able.exposure.contains(&want.exposure) {
        return refuse(format!("an exposure of {:?} is outside {shortest:?} to {longest:?}", want.exposure));
    }
    let synchronous = options.pulse_input == PulseInput::SynchronousReadout;
    if want.trigger == TriggerMode::External && synchronous && want.period > longest {
        return refuse(format!(
            "exposures last as long as the period of the trigger, and {:?} is above {longest:?}",
            want.period
        ));
    }
    Ok(())
}

/// Sends checked settings in the right order and reads back what became of them.
pub(crate) fn apply(
    device: &Device,
    options: DcamOptions,
    want: &CameraSettings,
) -> Result<CameraSettings, DeviceError> {
    let speed = match options.readout_speed {
        ReadoutSpeed::Fast => mode::FAST,
        ReadoutSpeed::Slow => mode::SLOW,
    };
    device.set_if_any(Id::SENSOR_MODE, mode::AREA)?;
    device.set_if_any(Id::READOUT_SPEED, speed)?;
    device.set(Id::BINNING, 1.0)?;
    set_region(device, want.region)?;
    device.set_if_any(Id::DEFECT_CORRECT, mode::OFF)?;
    let exposure = duration(device.set_and_get(Id::EXPOSURE_TIME, want.exposure.as_secs_f64())?);
    set_trigger(device, options, want.trigger)?;
    let region = read_region(device)?;
    if region != want.region {
        let message = format!("made a region {region:?} of {:?}; choose another region", want.region);
        return Err(DeviceError::new(ErrorKind::Protocol, device.name(), message));
    }
    timing(device, options, CameraSettings { region, exposure, ..*want })
}

/// The region is off while it changes, so that no part of the change is out of range.
fn set_region(device: &Device, region: Region) -> Result<(), DeviceError> {
    device.set(Id::SUBARRAY_MODE, mode::OFF)?;
    // A position that is too far for the size of before would be refused: position 0 first, then size, then position.
    for (id, value) in [
        (Id::SUBARRAY_LEFT, 0),
        (Id::SUBARRAY_WIDTH, region.width),
        (Id::SUBARRAY_LEFT, region.left),
        (Id::SUBARRAY_TOP, 0),
        (Id::SUBARRAY_HEIGHT, region.height),
        (Id::SUBARRAY_TOP, region.top),
    ] {
        device.set(id, f64::from(value))?;
    }
    device.set(Id::SUBARRAY_MODE, mode::ON)
}

fn read_region(device: &Device) -> Result<Region, DeviceError> {
    let pixels = |id| device.value(id).map(|value| value.round() as u32);
    Ok(Region {
        left: pixels(Id::SUBARRAY_LEFT)?,
        top: pixels(Id::SUBARRAY_TOP)?,
        width: pixels(Id::SUBARRAY_WIDTH)?,
        height: pixels(Id::SUBARRAY_HEIGHT)?,
    })
}

/// Sets the trigger; before every run, as a start trigger sets its source back to internal by itself.
pub(crate) fn set_trigger(
    device: &Device,
    options: DcamOptions,
    trigger: TriggerMode,
) -> Result<(), DeviceError> {
    let start = options.pulse_input == PulseInput::Start;
    if trigger == TriggerMode::FreeRunning {
        return device.set(Id::TRIGGER_SOURCE, mode::INTERNAL);
    }
    device.set(Id::TRIGGER_SOURCE, mode::EXTERNAL)?;
    device.set_if_any(Id::TRIGGER_MODE, if start { mode::TRIGGER_START } else { mode::TRIGGER_NORMAL })?;
    let active = match options.pulse_input {
        PulseInput::SynchronousReadout => mode::SYNCHRONOUS_READOUT,
        PulseInput::Edge | PulseInput::Start => mode::EDGE,
    };
    match device.set(Id::TRIGGER_ACTIVE, active) {
        // Cameras say that it is not writable while the start trigger is chosen (storm-control).
        Err(error) if start && error.kind() == ErrorKind::OutOfRange => {}
        other => other?,
    }
    let polarity = match options.polarity {
        Polarity::Positive => mode::POSITIVE,
        Polarity::Negative => mode::NEGATIVE,
    };
    device.set(Id::TRIGGER_POLARITY, polarity)
}

/// The period that the camera can keep, and the exposure that follows from it.
fn timing(
    device: &Device,
    options: DcamOptions,
    done: CameraSettings,
) -> Result<CameraSettings, DeviceError> {
    let pulsed = done.trigger == TriggerMode::External && options.pulse_input != PulseInput::Start;
    if !pulsed {
        let interval = match device.value_if_any(Id::INTERNAL_FRAME_INTERVAL)? {
            Some(interval) => duration(interval),
            None => done.exposure.max(duration(device.value(Id::READOUT_TIME)?)),
        };
        return Ok(CameraSettings { period: interval, ..done });
    }
    let least = duration_above(device.value(Id::MIN_TRIGGER_INTERVAL)?);
    let period = done.period.max(least);
    let exposure = if options.pulse_input == PulseInput::SynchronousReadout { period } else { done.exposure };
    Ok(CameraSettings { period, exposure, ..done })
}

/// Seconds of the camera, to the nearest nanosecond.
pub(crate) fn duration(seconds: f64) -> Duration {
    Duration::from_nanos((seconds * 1e9).round() as u64)
}

/// Seconds of the camera, up to the next nanosecond; what is within a thousandth of one is that one.
fn duration_above(seconds: f64) -> Duration {
    Duration::from_nanos((seconds * 1e9 - 1e-3).ceil() as u64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn synchronous_readout_needs_one_pulse_more_than_frames() {
        assert_eq!(PulseInput::SynchronousReadout.pulses_for(500), 501);
        assert_eq!(PulseInput::Edge.pulses_for(500), 500);
        assert_eq!(PulseInput::Start.pulses_for(500), 1);
    }

    #[test]
    fn buffers_hold_two_seconds_within_two_gibibytes() {
        let of = |side, period_us, buffers| {
            let settings = CameraSettings {
                region: Region { left: 0, top: 0, width: side, height: side },
                exposure: Duration::from_millis(1),
                period: Duration::from_micros(period_us),
                trigger: TriggerMode::External,
            };
            DcamOptions { buffers, ..DcamOptions::default() }.buffers_for(&settings)
        };
        assert_eq!(of(512, 10_000, None), 200);
        assert_eq!(of(2048, 5_000, None), 256, "2 GiB of 8 MiB");
        assert_eq!(of(128, 500, None), 2000);
        assert_eq!(of(512, 3_000_000, None), 8);
        assert_eq!(of(512, 10_000, Some(4)), 4);
    }
}
