//! Checks of identity, settings and states.

use std::time::Duration;

use super::{CameraRig, Run, halt, must, refused};
use crate::{CameraCapabilities, CameraSettings, ErrorKind, Region, TriggerMode};

pub(super) fn identity_is_told(rig: &mut impl CameraRig) {
    let identity = rig.camera().identity().clone();
    for (name, text) in
        [("vendor", &identity.vendor), ("model", &identity.model), ("serial number", &identity.serial)]
    {
        assert!(!text.trim().is_empty(), "the identity has a {name}: {identity:?}");
    }
    assert_eq!(*rig.camera().identity(), identity, "the identity stays the same");
    let able = rig.camera().capabilities();
    assert!(able.sensor_width > 0 && able.sensor_height > 0, "the sensor has pixels: {able:?}");
    assert!(able.region_step > 0, "regions have a step of at least a pixel: {able:?}");
    assert!(!able.exposure.is_empty(), "there is an exposure time: {able:?}");
    assert!(able.saturation_counts > 0, "pixels can have counts: {able:?}");
}

pub(super) fn arming_needs_settings(rig: &mut impl CameraRig) {
    refused(rig.camera().arm(), ErrorKind::Busy, "arming a camera that was never configured");
    must(rig.camera().stop(), "stopping a camera that was never armed");
}

pub(super) fn settings_are_read_back(rig: &mut impl CameraRig) {
    let want = rig.settings();
    let external = want.trigger == TriggerMode::External;
    assert_eq!(external, rig.trigger().is_some(), "a rig has a trigger if its settings want one");
    let exact = must(rig.camera().configure(&want), "configuring");
    assert_eq!(exact, want, "settings that the camera can do come back as they are");
    let able = rig.camera().capabilities().clone();
    let odd = CameraSettings {
        region: smaller(want.region, 1),
        exposure: (want.exposure + able.exposure_step / 3).min(*able.exposure.end()),
        period: Duration::ZERO,
        ..want
    };
    match rig.camera().configure(&odd) {
        Ok(done) => assert_within(&able, &done),
        Err(error) => {
            assert_eq!(error.kind(), ErrorKind::OutOfRange, "odd settings are rounded or refused: {error}");
        }
    }
    must(rig.camera().configure(&want), "configuring again");
}

/// A region with `pixels` fewer rows and columns, as far as there are any.
pub(super) fn smaller(region: Region, pixels: u32) -> Region {
    let less = |length: u32| length.saturating_sub(pixels).max(1);
    Region { width: less(region.width), height: less(region.height), ..region }
}

/// Asserts that what a camera says it does is what it can do.
pub(super) fn assert_within(able: &CameraCapabilities, done: &CameraSettings) {
    let Region { left, top, width, height } = done.region;
    for (what, value) in [("left", left), ("top", top), ("width", width), ("height", height)] {
        let whole = value % able.region_step == 0;
        assert!(whole, "{what} of the region read back is a multiple of {}: {done:?}", able.region_step);
    }
    assert!(width > 0 && height > 0, "the region read back has pixels: {done:?}");
    assert!(left + width <= able.sensor_width, "the region read back is on the sensor: {done:?}");
    assert!(top + height <= able.sensor_height, "the region read back is on the sensor: {done:?}");
    assert!(able.exposure.contains(&done.exposure), "the exposure read back is within limits: {done:?}");
    assert!(done.period > Duration::ZERO, "the period read back is not zero: {done:?}");
}

pub(super) fn settings_out_of_range_change_nothing(rig: &mut impl CameraRig) {
    let want = rig.settings();
    let able = rig.camera().capabilities().clone();
    let settings = must(rig.camera().configure(&want), "configuring");
    let region = |region| CameraSettings { region, ..want };
    // Another exposure beside the faulty value shows whether a part of the settings was taken over.
    let step = able.region_step;
    let wide = Region { width: able.sensor_width + step, ..smaller(want.region, step) };
    let outside = Region { left: able.sensor_width, ..smaller(want.region, step) };
    let far = Region { top: u32::MAX - u32::MAX % step, ..smaller(want.region, step) };
    let empty = Region { height: 0, ..smaller(want.region, step) };
    let mut faulty = vec![
        ("a region wider than the sensor", region(wide)),
        ("a region beside the sensor", region(outside)),
        ("a region far below the sensor", region(far)),
        ("a region without rows", region(empty)),
    ];
    let longer = able.exposure.end().saturating_mul(2);
    let other = region(smaller(want.region, step));
    faulty.push(("an exposure above the longest", CameraSettings { exposure: longer, ..other }));
    if *able.exposure.start() > Duration::ZERO {
        let none = CameraSettings { exposure: Duration::ZERO, ..other };
        faulty.push(("an exposure below the shortest", none));
    }
    for (what, settings) in faulty {
        refused(rig.camera().configure(&settings), ErrorKind::OutOfRange, what);
    }
    let mut run = Run::arm(rig, settings);
    Run::expose(rig, settings);
    let times: Vec<_> = run.several();
    super::frames::assert_even(&times, settings.period);
    run.end(rig);
}

pub(super) fn armed_cameras_are_busy(rig: &mut impl CameraRig) {
    let want = rig.settings();
    let mut run = Run::begin(rig);
    refused(rig.camera().configure(&want), ErrorKind::Busy, "configuring an armed camera");
    refused(rig.camera().arm(), ErrorKind::Busy, "arming an armed camera");
    run.several();
    refused(rig.camera().arm(), ErrorKind::Busy, "arming a camera that exposes");
    run.end(rig);
    halt(rig);
    must(rig.camera().configure(&want), "configuring a camera that was stopped");
}
