//! Velocity, acceleration, backlash and joystick, as the controller has them.

use sofiscope_hal::{DeviceError, ErrorKind, Property, PropertyRange, PropertyValue};

use crate::dialog::Dialog;
use crate::reply;
use crate::watch::Pace;

/// Axes in the order of the controller.
pub(crate) const AXES: [char; 2] = ['x', 'y'];
/// Slowest that Micro-Manager allows, mm/s.
const SLOWEST_MM_S: f64 = 0.001;
/// Accelerations that Micro-Manager offers, m/s².
const ACCELERATION_M_S2: [f64; 2] = [0.01, 2.0];
/// Backlash, micrometers.
const BACKLASH_UM: [f64; 2] = [0.0, 10.0];

/// Settings of the axes, as last read from the controller.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct AxisSettings {
    pub(crate) pace: Pace,
    backlash_um: f64,
}

/// Reads the settings of an axis; `fastest_mm_s` is set where it is faster.
pub(crate) fn read(dialog: &mut Dialog, axis: char, fastest_mm_s: f64) -> Result<AxisSettings, DeviceError> {
    let mut velocity_mm_s = read_number(dialog, &format!("?vel {axis}"))?;
    if velocity_mm_s > fastest_mm_s {
        velocity_mm_s = set_number(dialog, &format!("vel {axis}"), fastest_mm_s)?;
    }
    let acceleration_m_s2 = read_number(dialog, &format!("?accel {axis}"))?;
    let backlash_um = read_number(dialog, &format!("?backlash {axis}"))?;
    Ok(AxisSettings { pace: Pace { velocity_mm_s, acceleration_m_s2 }, backlash_um })
}

/// The browsable properties.
pub(crate) fn listed(
    dialog: &mut Dialog,
    axes: &[AxisSettings; 2],
    fastest_mm_s: f64,
) -> Result<Vec<Property>, DeviceError> {
    let joystick = dialog.ask("?joy", "a number", reply::whole)? > 0;
    let mut properties = Vec::new();
    let mut number = |name: String, value, unit: &str, [least, greatest]: [f64; 2]| {
        let property = Property::reading(name, PropertyValue::Number(value), unit);
        properties.push(property.writable(PropertyRange::Between { least, greatest }));
    };
    for (axis, settings) in AXES.into_iter().zip(axes) {
        let AxisSettings { pace, backlash_um } = *settings;
        number(format!("vel {axis}"), pace.velocity_mm_s, "mm/s", [SLOWEST_MM_S, fastest_mm_s]);
        number(format!("accel {axis}"), pace.acceleration_m_s2, "m/s²", ACCELERATION_M_S2);
        number(format!("backlash {axis}"), backlash_um, "µm", BACKLASH_UM);
    }
    let joystick = Property::reading("joy", PropertyValue::Flag(joystick), "");
    properties.push(joystick.writable(PropertyRange::Any));
    Ok(properties)
}

/// Changes a property and reads it back.
pub(crate) fn set(
    dialog: &mut Dialog,
    axes: &mut [AxisSettings; 2],
    fastest_mm_s: f64,
    (name, value): (&str, &PropertyValue),
) -> Result<(), DeviceError> {
    if let ("joy", PropertyValue::Flag(is_on)) = (name, value) {
        // 2: with counting of the position.
        return dialog.tell(if *is_on { "!joy 2" } else { "!joy 0" });
    }
    let ranges =
        [("vel", [SLOWEST_MM_S, fastest_mm_s]), ("accel", ACCELERATION_M_S2), ("backlash", BACKLASH_UM)];
    let known = ranges.into_iter().find_map(|(verb, range)| {
        let axis = AXES.iter().position(|axis| name == format!("{verb} {axis}"))?;
        Some((verb, axis, range))
    });
    let (Some((verb, axis, [least, greatest])), Some(wanted)) = (known, as_number(value)) else {
        let message = format!("'{name}' cannot be changed to {value:?}");
        return Err(DeviceError::new(ErrorKind::OutOfRange, dialog.device(), message));
    };
    if !(least..=greatest).contains(&wanted) {
        let message = format!("'{name}' = {wanted} is outside of {least} to {greatest}");
        return Err(DeviceError::new(ErrorKind::OutOfRange, dialog.device(), message));
    }
    let found = set_number(dialog, name, wanted)?;
    match verb {
        "vel" => axes[axis].pace.velocity_mm_s = found,
        "accel" => axes[axis].pace.acceleration_m_s2 = found,
        _ => axes[axis].backlash_um = found,
    }
    Ok(())
}

fn as_number(value: &PropertyValue) -> Option<f64> {
    match value {
        PropertyValue::Number(number) => Some(*number),
        PropertyValue::Whole(number) => Some(*number as f64),
        PropertyValue::Flag(_) | PropertyValue::Text(_) => None,
    }
}

/// Sets a number and gives what the controller then has.
fn set_number(dialog: &mut Dialog, name: &str, wanted: f64) -> Result<f64, DeviceError> {
    dialog.tell(&format!("!{name} {wanted:.4}"))?;
    let found = read_number(dialog, &format!("?{name}"))?;
    if (found - wanted).abs() > 0.01 * wanted.abs() + 0.05 * f64::from(u8::from(name.starts_with("backlash")))
    {
        let message = format!("'{name}' was set to {wanted} and is {found}; set it again");
        return Err(DeviceError::new(ErrorKind::Fault, dialog.device(), message));
    }
    Ok(found)
}

fn read_number(dialog: &mut Dialog, question: &str) -> Result<f64, DeviceError> {
    dialog.ask(question, "a number", |answer| reply::numbers(answer, 1)?.first().copied())
}
