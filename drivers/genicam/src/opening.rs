//! Finds a camera, makes sure that it is the one that was meant, and brings it into a known state.
//!
//! In: [`GenicamSettings`]. Out: an open camera with identity, capabilities and layout of its pixels.
//! Never: keeps a camera with another serial number. Fails: `Lost` when none answers, `Identity` when it is another
//! one, `Busy` when another program has control of it.

use std::net::Ipv4Addr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use aravis::glib::object::Cast;
use aravis::prelude::{CameraExt, DeviceExt};
use aravis::{GvDevice, GvStreamOption, glib};
use sofiscope_hal::{CameraCapabilities, CameraIdentity, DeviceError, ErrorKind};

use crate::settings::{Find, GenicamSettings};
use crate::unpacking::Layout;
use crate::{advice, raw};

/// An open camera; what belongs to one connection.
pub(crate) struct Connection {
    pub(crate) camera: aravis::Camera,
    pub(crate) device: aravis::Device,
    pub(crate) identity: CameraIdentity,
    pub(crate) capabilities: CameraCapabilities,
    pub(crate) layout: Layout,
    /// Its address, where it stands on a network.
    pub(crate) address: Option<Ipv4Addr>,
    /// Raised when the camera is gone, or no longer ours.
    pub(crate) is_lost: Arc<AtomicBool>,
    pub(crate) advice: Vec<String>,
}

/// Shortest step of exposures of cameras that name none.
const EXPOSURE_STEP: Duration = Duration::from_micros(1);

/// The kind of what Aravis says.
pub(crate) fn error(device: &str, doing: &str, error: &glib::Error) -> DeviceError {
    use aravis::DeviceError as Code;
    let kind = match error.kind::<Code>() {
        Some(
            Code::NotConnected | Code::NotFound | Code::Timeout | Code::TransferError | Code::NotController,
        ) => ErrorKind::Lost,
        Some(Code::ProtocolErrorBusy) => ErrorKind::Busy,
        Some(Code::ProtocolErrorInvalidParameter | Code::InvalidParameter) => ErrorKind::OutOfRange,
        Some(Code::ProtocolError | Code::GenicamNotFound) => ErrorKind::Protocol,
        _ => ErrorKind::Fault,
    };
    let next = if kind == ErrorKind::Lost { "; check cable, power and address of the camera" } else { "" };
    DeviceError::new(kind, device, format!("{doing} failed: {error}{next}"))
}

impl Connection {
    pub(crate) fn open(settings: &GenicamSettings) -> Result<Self, DeviceError> {
        let name = &settings.name;
        let (id, address) = find(settings)?;
        let camera = aravis::Camera::new(Some(&id))
            .map_err(|cause| error(name, &format!("opening the camera at {id}"), &cause))?;
        let device = camera.device().ok_or_else(|| {
            DeviceError::new(ErrorKind::Protocol, name, format!("the camera at {id} has no control channel"))
        })?;
        let identity = identity(&camera, &device);
        if identity.serial != settings.serial {
            let message = format!(
                "serial number {} was expected, but the camera at {id} has {} ({} {}); check which cable goes to \
                 which camera, and the instrument file",
                settings.serial, identity.serial, identity.vendor, identity.model
            );
            return Err(DeviceError::new(ErrorKind::Identity, name, message));
        }
        let name = format!("{name} ({}, S/N {})", identity.model, identity.serial);
        if device.downcast_ref::<GvDevice>().is_some_and(|device| !device.is_controller()) {
            let message = "another program has control of it; close that program";
            return Err(DeviceError::new(ErrorKind::Busy, name, message));
        }
        let told = |doing: &'static str| {
            let name = name.clone();
            move |cause: glib::Error| error(&name, doing, &cause)
        };
        if camera.is_gv_device() {
            // The packet socket hears nothing on the loopback interface, and needs a capability elsewhere.
            camera.gv_set_stream_options(GvStreamOption::PACKET_SOCKET_DISABLED);
            set_packets(&camera, settings).map_err(told("choosing the packet size"))?;
        }
        let layout = layout(&camera, &device, settings, &name)?;
        bring_into_known_state(&camera, &device).map_err(told("bringing the camera into a known state"))?;
        let capabilities = capabilities(&camera, layout).map_err(told("asking for the limits"))?;
        let advice = advice_for(&camera, &device, settings);
        let is_lost = Arc::new(AtomicBool::new(false));
        let flag = is_lost.clone();
        device.connect_control_lost(move |_| flag.store(true, Ordering::Relaxed));
        Ok(Self { camera, device, identity, capabilities, layout, address, is_lost, advice })
    }
}

/// Drops what belongs to a camera. With one that is gone, Aravis waits some seconds for an answer when it gives control
/// back; nobody shall wait with it.
pub(crate) fn let_go<T: Send + 'static>(is_lost: bool, belongings: T) {
    if is_lost {
        // Where no thread can be had, the belongings are dropped here, with the failed attempt.
        let _dropped =
            std::thread::Builder::new().name("genicam-let-go".into()).spawn(move || drop(belongings));
    }
}

/// What Aravis opens the camera by, and its address.
fn find(settings: &GenicamSettings) -> Result<(String, Option<Ipv4Addr>), DeviceError> {
    if let Find::At(address) = settings.find {
        return Ok((address.to_string(), Some(address)));
    }
    let found = raw::cameras();
    if let Some(camera) = found.iter().find(|camera| camera.serial == settings.serial) {
        let address: Option<Ipv4Addr> = camera.address.parse().ok();
        // By address rather than by name: a name may be answered through another network card.
        return Ok((address.map_or_else(|| camera.id.clone(), |address| address.to_string()), address));
    }
    let serial = &settings.serial;
    let (kind, message) = if found.is_empty() {
        let message =
            format!("no camera answers, and serial number {serial} was expected; check cable and power");
        (ErrorKind::Lost, message)
    } else {
        let others: Vec<String> =
            found.iter().map(|camera| format!("{} ({})", camera.serial, camera.model)).collect();
        let others = others.join(", ");
        (ErrorKind::Identity, format!("serial number {serial} was expected, but only these answer: {others}"))
    };
    Err(DeviceError::new(kind, &settings.name, message))
}

/// The first of these features that the camera has.
fn text(device: &aravis::Device, names: &[&str]) -> String {
    let value = names.iter().find_map(|name| device.string_feature_value(name).ok());
    value.map(|value| value.trim().to_owned()).unwrap_or_default()
}

fn identity(camera: &aravis::Camera, device: &aravis::Device) -> CameraIdentity {
    let vendor = camera.vendor_name().map(|text| text.to_string()).unwrap_or_default();
    let model = camera.model_name().map(|text| text.to_string()).unwrap_or_default();
    let serial = camera.device_serial_number().map(|text| text.trim().to_owned()).unwrap_or_default();
    let firmware = text(device, &["DeviceFirmwareVersion", "DeviceVersion"]);
    // The fake camera of Aravis says so by its name alone.
    let simulated = model.to_lowercase().contains("simulated") || (vendor == "Aravis" && model == "Fake");
    CameraIdentity { vendor, model, serial, firmware, simulated }
}

fn set_packets(camera: &aravis::Camera, settings: &GenicamSettings) -> Result<(), glib::Error> {
    match settings.packet_size {
        Some(size) => camera.gv_set_packet_size(i32::try_from(size).unwrap_or(i32::MAX))?,
        None => camera.gv_auto_packet_size()?,
    }
    let delay_ns = i64::try_from(settings.packet_delay.as_nanos()).unwrap_or(i64::MAX);
    if delay_ns > 0 {
        camera.gv_set_packet_delay(delay_ns)?;
    }
    Ok(())
}

fn layout(
    camera: &aravis::Camera,
    device: &aravis::Device,
    settings: &GenicamSettings,
    name: &str,
) -> Result<Layout, DeviceError> {
    let offered = device
        .dup_available_enumeration_feature_values("PixelFormat")
        .map_err(|cause| error(name, "asking for the formats of pixels", &cause))?;
    let fits = |layout: &Layout| {
        offered.contains(&i64::from(*layout as u32))
            && settings.pixel_format.as_deref().is_none_or(|wanted| wanted == layout.name())
    };
    let Some(layout) = Layout::ALL.into_iter().find(fits) else {
        let wanted = settings.pixel_format.as_deref().unwrap_or("any monochrome format");
        let known = Layout::ALL.map(Layout::name).join(", ");
        let message = format!("it does not offer {wanted}; known formats: {known}");
        return Err(DeviceError::new(ErrorKind::OutOfRange, name, message));
    };
    camera
        .set_pixel_format(aravis::PixelFormat::from_raw(layout as u32))
        .map_err(|cause| error(name, "choosing the format of pixels", &cause))?;
    Ok(layout)
}

/// Nothing automatic, no binning, the whole sensor. Every feature may be missing, and then nothing needs doing.
fn bring_into_known_state(camera: &aravis::Camera, device: &aravis::Device) -> Result<(), glib::Error> {
    let has = |name: &str| device.is_feature_available(name).unwrap_or(false);
    for (name, value) in [
        ("ExposureMode", "Timed"),
        ("ExposureAuto", "Off"),
        ("GainAuto", "Off"),
        ("BlackLevelAuto", "Off"),
        ("AcquisitionMode", "Continuous"),
    ] {
        if has(name) {
            device.set_string_feature_value(name, value)?;
        }
    }
    for (name, value) in [("BinningHorizontal", 1), ("BinningVertical", 1), ("OffsetX", 0), ("OffsetY", 0)] {
        if has(name) {
            device.set_integer_feature_value(name, value)?;
        }
    }
    let (width, height) = sensor(camera)?;
    device.set_integer_feature_value("Width", width.into())?;
    device.set_integer_feature_value("Height", height.into())
}

/// Columns and rows that frames can have.
fn sensor(camera: &aravis::Camera) -> Result<(i32, i32), glib::Error> {
    let (width, height) = match (camera.integer("WidthMax"), camera.integer("HeightMax")) {
        (Ok(width), Ok(height)) => {
            (i32::try_from(width).unwrap_or(i32::MAX), i32::try_from(height).unwrap_or(i32::MAX))
        }
        _ => camera.sensor_size()?,
    };
    Ok((width, height))
}

fn capabilities(camera: &aravis::Camera, layout: Layout) -> Result<CameraCapabilities, glib::Error> {
    let (width, height) = sensor(camera)?;
    let (shortest_us, longest_us) = camera.exposure_time_bounds()?;
    let step = |name: &str| camera.integer_increment(name).ok().and_then(|step| u32::try_from(step).ok());
    let steps = ["Width", "Height", "OffsetX", "OffsetY"].into_iter().filter_map(step);
    let exposure_step = ["ExposureTime", "ExposureTimeAbs"]
        .into_iter()
        .find_map(|name| camera.float_increment(name).ok())
        .map(crate::configuring::from_microseconds)
        .filter(|step| !step.is_zero() && *step < Duration::from_millis(10));
    let greatest_hz = camera.frame_rate_bounds().map(|(_, greatest)| greatest).ok();
    Ok(CameraCapabilities {
        sensor_width: width.unsigned_abs(),
        sensor_height: height.unsigned_abs(),
        region_step: steps.fold(1, least_common_multiple),
        exposure: crate::configuring::from_microseconds(shortest_us)
            ..=crate::configuring::from_microseconds(longest_us),
        exposure_step: exposure_step.unwrap_or(EXPOSURE_STEP),
        shortest_period: greatest_hz.map_or(Duration::ZERO, crate::configuring::period_of),
        saturation_counts: layout.saturation(),
    })
}

fn least_common_multiple(a: u32, b: u32) -> u32 {
    let (mut greatest, mut rest) = (a, b.max(1));
    while rest != 0 {
        (greatest, rest) = (rest, greatest % rest);
    }
    a / greatest * b.max(1)
}

/// Bit of the GVCP capability register: packets can be sent again.
const CAN_RESEND: u32 = 1 << 2;

fn advice_for(camera: &aravis::Camera, device: &aravis::Device, settings: &GenicamSettings) -> Vec<String> {
    if !camera.is_gv_device() {
        return Vec::new();
    }
    let capabilities = device.read_register(0x934).map_or(0, |(_, value)| value);
    let can_resend = !settings.resend || capabilities & CAN_RESEND != 0;
    advice::sentences(advice::receive_buffers(), camera.gv_get_packet_size().ok(), can_resend)
}

#[cfg(test)]
mod tests {
    use super::least_common_multiple;

    #[test]
    fn steps_of_all_features_fit_into_one() {
        assert_eq!([4, 2, 16, 1].into_iter().fold(1, least_common_multiple), 16);
        assert_eq!([6, 4, 0].into_iter().fold(1, least_common_multiple), 12);
    }
}
