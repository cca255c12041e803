//! Settings to features and back; the older names of features are known to Aravis.
//!
//! GenICam counts exposures in microseconds and gives rates instead of periods; the contract has times.

use std::time::Duration;

use aravis::glib;
use aravis::prelude::{CameraExt, DeviceExt};
use sofiscope_hal::{CameraCapabilities, CameraSettings, Region, TriggerMode};

/// Longest time that a feature is believed to mean.
const LONGEST_S: f64 = 1e6;

/// A time from a feature in microseconds, rounded to nanoseconds.
pub(crate) fn from_microseconds(microseconds: f64) -> Duration {
    let nanoseconds = (microseconds * 1e3).round().clamp(0.0, LONGEST_S * 1e9);
    Duration::from_nanos(nanoseconds as u64)
}

fn to_microseconds(time: Duration) -> f64 {
    time.as_nanos() as f64 / 1e3
}

/// The period of a rate, rounded to nanoseconds.
pub(crate) fn period_of(rate_hz: f64) -> Duration {
    from_microseconds(1e6 / rate_hz)
}

/// What is wrong with settings, with the limit; nothing is asked of the camera.
pub(crate) fn check(able: &CameraCapabilities, want: &CameraSettings) -> Result<(), String> {
    let CameraCapabilities { sensor_width, sensor_height, region_step: step, .. } = *able;
    let Region { left, top, width, height } = want.region;
    for (what, first, length, most) in
        [("columns", left, width, sensor_width), ("rows", top, height, sensor_height)]
    {
        let fits = first.checked_add(length).is_some_and(|end| end <= most);
        if length == 0 || !fits {
            return Err(format!(
                "a region of {length} {what} from {first} is not on the sensor, which has {most}"
            ));
        }
        if !first.is_multiple_of(step) || !length.is_multiple_of(step) {
            return Err(format!("{length} {what} from {first} are no multiples of {step}"));
        }
    }
    if !able.exposure.contains(&want.exposure) {
        let (least, most) = (able.exposure.start(), able.exposure.end());
        return Err(format!("an exposure of {:?} is outside {least:?} to {most:?}", want.exposure));
    }
    Ok(())
}

/// Sets everything in an order that cameras take, and reads back what they made of it.
pub(crate) fn apply(
    camera: &aravis::Camera,
    device: &aravis::Device,
    trigger_source: &str,
    want: &CameraSettings,
) -> Result<CameraSettings, glib::Error> {
    camera.clear_triggers()?;
    set_region(device, want.region)?;
    camera.set_exposure_time(to_microseconds(want.exposure))?;
    // The rate before the trigger: setting a rate switches triggers off.
    let shortest = set_rate(camera, device, want.period)?;
    let exposure = from_microseconds(camera.exposure_time()?);
    let period = match want.trigger {
        TriggerMode::FreeRunning => camera.frame_rate().map_or(want.period, period_of),
        TriggerMode::External => {
            camera.set_trigger(trigger_source)?;
            want.period.max(shortest)
        }
    };
    let region = region(device)?;
    Ok(CameraSettings { region, exposure, period: period.max(exposure), trigger: want.trigger })
}

/// Offsets to zero first, as a large region fits nowhere else.
fn set_region(device: &aravis::Device, region: Region) -> Result<(), glib::Error> {
    let has_offsets = device.is_feature_available("OffsetX").unwrap_or(false);
    let Region { left, top, width, height } = region;
    let offsets = |left: u32, top: u32| {
        if !has_offsets {
            return Ok(());
        }
        device.set_integer_feature_value("OffsetX", left.into())?;
        device.set_integer_feature_value("OffsetY", top.into())
    };
    offsets(0, 0)?;
    device.set_integer_feature_value("Width", width.into())?;
    device.set_integer_feature_value("Height", height.into())?;
    offsets(left, top)
}

fn region(device: &aravis::Device) -> Result<Region, glib::Error> {
    let length = |name| Ok::<_, glib::Error>(u32::try_from(device.integer_feature_value(name)?).unwrap_or(0));
    let offset =
        |name| device.integer_feature_value(name).ok().and_then(|value| value.try_into().ok()).unwrap_or(0);
    Ok(Region {
        left: offset("OffsetX"),
        top: offset("OffsetY"),
        width: length("Width")?,
        height: length("Height")?,
    })
}

/// Sets the rate as near as the camera can; returns its shortest period.
fn set_rate(
    camera: &aravis::Camera,
    device: &aravis::Device,
    period: Duration,
) -> Result<Duration, glib::Error> {
    if !camera.is_frame_rate_available()? {
        return Ok(Duration::ZERO);
    }
    if device.is_feature_available("AcquisitionFrameRateEnable").unwrap_or(false) {
        device.set_boolean_feature_value("AcquisitionFrameRateEnable", true)?;
    }
    let (slowest_hz, fastest_hz) = camera.frame_rate_bounds()?;
    let rate_hz = (1.0 / period.as_secs_f64()).min(fastest_hz).max(slowest_hz);
    camera.set_frame_rate(rate_hz)?;
    Ok(period_of(fastest_hz))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_survive_the_way_there_and_back() {
        for nanoseconds in [1, 999, 10_000_000, 16_666_667, 3_600_000_000_123] {
            let time = Duration::from_nanos(nanoseconds);
            assert_eq!(from_microseconds(to_microseconds(time)), time);
        }
        for milliseconds in [1, 3, 7, 10, 20, 33, 1000] {
            let period = Duration::from_millis(milliseconds);
            assert_eq!(period_of(1.0 / period.as_secs_f64()), period);
        }
        assert_eq!(from_microseconds(f64::NAN), Duration::ZERO);
        assert_eq!(period_of(0.0), Duration::from_secs(1_000_000));
    }
}
