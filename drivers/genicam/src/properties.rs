//! The node map for the property browser: every feature of the table that the camera has.

use aravis::glib::object::{Cast, ObjectExt};
use aravis::prelude::{DeviceExt, GcFloatExt, GcIntegerExt};
use aravis::{Device, GcAccessMode, GcBoolean, GcEnumeration, GcFloat, GcInteger, GcString, glib};
use sofiscope_hal::{Property, PropertyRange, PropertyValue};

/// Whether a person may change a feature that the camera lets be changed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Owner {
    /// The contract of cameras sets it.
    Run,
    Person,
}

/// Features of the Standard Features Naming Convention 2.7, with older names, in its order.
const FEATURES: [(&str, Owner); 66] = [
    ("DeviceVendorName", Owner::Run),
    ("DeviceModelName", Owner::Run),
    ("DeviceSerialNumber", Owner::Run),
    ("DeviceID", Owner::Run),
    ("DeviceFirmwareVersion", Owner::Run),
    ("DeviceVersion", Owner::Run),
    ("DeviceTemperatureSelector", Owner::Person),
    ("DeviceTemperature", Owner::Run),
    ("DeviceLinkThroughputLimit", Owner::Person),
    ("SensorWidth", Owner::Run),
    ("SensorHeight", Owner::Run),
    ("WidthMax", Owner::Run),
    ("HeightMax", Owner::Run),
    ("Width", Owner::Run),
    ("Height", Owner::Run),
    ("OffsetX", Owner::Run),
    ("OffsetY", Owner::Run),
    ("BinningHorizontal", Owner::Run),
    ("BinningVertical", Owner::Run),
    ("PixelFormat", Owner::Run),
    ("PixelDynamicRangeMax", Owner::Run),
    ("SensorReadoutMode", Owner::Person),
    ("SensorShutterMode", Owner::Person),
    ("AcquisitionMode", Owner::Run),
    ("AcquisitionFrameRateEnable", Owner::Run),
    ("AcquisitionFrameRate", Owner::Run),
    ("AcquisitionFrameRateAbs", Owner::Run),
    ("ExposureMode", Owner::Run),
    ("ExposureAuto", Owner::Run),
    ("ExposureTime", Owner::Run),
    ("ExposureTimeAbs", Owner::Run),
    ("TriggerSelector", Owner::Run),
    ("TriggerMode", Owner::Run),
    ("TriggerSource", Owner::Run),
    ("TriggerActivation", Owner::Person),
    ("TriggerDelay", Owner::Person),
    ("TriggerDelayAbs", Owner::Person),
    ("TriggerOverlap", Owner::Person),
    ("LineSelector", Owner::Person),
    ("LineMode", Owner::Person),
    ("LineInverter", Owner::Person),
    ("LineSource", Owner::Person),
    ("LineStatus", Owner::Run),
    ("GainAuto", Owner::Run),
    ("Gain", Owner::Person),
    ("GainRaw", Owner::Person),
    ("BlackLevel", Owner::Person),
    ("BlackLevelRaw", Owner::Person),
    ("ChunkModeActive", Owner::Run),
    ("TimestampLatchValue", Owner::Run),
    ("GevTimestampTickFrequency", Owner::Run),
    ("PtpEnable", Owner::Person),
    ("PtpStatus", Owner::Run),
    ("PtpOffsetFromMaster", Owner::Run),
    ("GevIEEE1588", Owner::Person),
    ("GevIEEE1588Status", Owner::Run),
    ("ActionSelector", Owner::Person),
    ("ActionGroupKey", Owner::Person),
    ("ActionGroupMask", Owner::Person),
    ("PayloadSize", Owner::Run),
    ("TLParamsLocked", Owner::Run),
    ("GevSCPSPacketSize", Owner::Run),
    ("GevSCPD", Owner::Person),
    ("GevHeartbeatTimeout", Owner::Run),
    ("GevGVSPExtendedIDMode", Owner::Run),
    ("GevCurrentIPAddress", Owner::Run),
];

/// All features that the camera has and can tell now.
pub(crate) fn all(device: &Device) -> Vec<Property> {
    FEATURES.iter().filter_map(|&(name, owner)| property(device, name, owner)).collect()
}

/// What is wrong with a new value.
pub(crate) fn check(device: &Device, name: &str, value: &PropertyValue) -> Result<(), String> {
    let feature = FEATURES.iter().find(|(known, _)| *known == name);
    let Some(property) = feature.and_then(|&(name, owner)| property(device, name, owner)) else {
        return Err(format!("it has no property '{name}'"));
    };
    if !property.writable {
        return Err(format!("'{name}' cannot be changed here; the settings of the run decide it"));
    }
    if std::mem::discriminant(&property.value) != std::mem::discriminant(value) {
        return Err(format!("'{name}' takes a value such as {:?}, not {value:?}", property.value));
    }
    let number = match value {
        PropertyValue::Whole(whole) => Some(*whole as f64),
        PropertyValue::Number(number) => Some(*number),
        PropertyValue::Flag(_) | PropertyValue::Text(_) => None,
    };
    match (&property.range, number, value) {
        (PropertyRange::Between { least, greatest }, Some(number), _)
            if !(*least..=*greatest).contains(&number) =>
        {
            Err(format!("'{name}' takes {least} to {greatest}, not {number}"))
        }
        (PropertyRange::Choice(choices), _, PropertyValue::Text(text)) if !choices.contains(text) => {
            Err(format!("'{name}' takes one of {}, not {text}", choices.join(", ")))
        }
        _ => Ok(()),
    }
}

/// Changes a feature; what [`check`] says has been heeded.
pub(crate) fn set(device: &Device, name: &str, value: &PropertyValue) -> Result<(), glib::Error> {
    match value {
        PropertyValue::Flag(flag) => device.set_boolean_feature_value(name, *flag),
        PropertyValue::Whole(whole) => device.set_integer_feature_value(name, *whole),
        PropertyValue::Number(number) => device.set_float_feature_value(name, *number),
        PropertyValue::Text(text) => device.set_string_feature_value(name, text),
    }
}

fn property(device: &Device, name: &str, owner: Owner) -> Option<Property> {
    if !device.is_feature_available(name).unwrap_or(false) {
        return None;
    }
    let node = device.feature(name)?;
    // An enumeration is an integer as well, so it is asked for first.
    let (value, range, unit) = if node.is::<GcEnumeration>() {
        let value = device.string_feature_value(name).ok()?.to_string();
        let choices = device.dup_available_enumeration_feature_values_as_strings(name).unwrap_or_default();
        let choices = choices.iter().map(ToString::to_string).collect();
        (PropertyValue::Text(value), PropertyRange::Choice(choices), None)
    } else if node.is::<GcBoolean>() {
        (PropertyValue::Flag(device.boolean_feature_value(name).ok()?), PropertyRange::Any, None)
    } else if let Some(float) = node.dynamic_cast_ref::<GcFloat>() {
        let value = PropertyValue::Number(device.float_feature_value(name).ok()?);
        (value, between(device.float_feature_bounds(name).ok()), float.unit())
    } else if let Some(integer) = node.dynamic_cast_ref::<GcInteger>() {
        let value = PropertyValue::Whole(device.integer_feature_value(name).ok()?);
        let bounds = device.integer_feature_bounds(name).map(|(least, most)| (least as f64, most as f64));
        (value, between(bounds.ok()), integer.unit())
    } else if node.is::<GcString>() {
        (PropertyValue::Text(device.string_feature_value(name).ok()?.to_string()), PropertyRange::Any, None)
    } else {
        return None;
    };
    let unit = unit.map(|unit| unit.to_string()).unwrap_or_default();
    let reading = Property::reading(name, value, unit);
    // Aravis 0.8.26 calls what can be read and written `Wo`.
    let takes = matches!(device.feature_access_mode(name), GcAccessMode::Rw | GcAccessMode::Wo);
    let may = owner == Owner::Person && takes;
    Some(if may { reading.writable(range) } else { Property { range, ..reading } })
}

fn between(bounds: Option<(f64, f64)>) -> PropertyRange {
    bounds.map_or(PropertyRange::Any, |(least, greatest)| PropertyRange::Between { least, greatest })
}
