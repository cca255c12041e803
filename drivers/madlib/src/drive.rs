//! A Nano-Drive with one piezo along z.
//!
//! In: targets in nanometers, [`NanoDriveOptions`]. Out: measured positions. Never: moves but where it is told, not
//! even at the end unless a place to park was configured; sends a target outside the range.
//! Fails: as [`FocusDrive`] says; after [`Lost`](ErrorKind::Lost) the next call opens the device anew.

use std::ops::RangeInclusive;
use std::time::{Duration, Instant};

use sofiscope_hal::{
    DeviceError, DeviceIdentity, ErrorKind, FocusDrive, Nanometers, Properties, Property, PropertyValue,
};

use crate::ffi::{Failure, Functions, Handle, ProductInformation};
use crate::library::Madlib;

const NM_PER_UM: f64 = 1000.0;
/// The z axis among those of a device.
const HAS_Z: u8 = 4;
/// Firmware that tells its last target.
const TELLS_TARGET: i16 = 0x0008;

/// What the configuration says of a drive.
#[derive(Debug, Clone, PartialEq)]
pub struct NanoDriveOptions {
    /// Serial number; none takes the only device there is.
    pub serial: Option<i16>,
    /// Where it may go, within the travel of the device.
    pub travel: RangeInclusive<Nanometers>,
    /// Where it goes when it is closed; it stays where it is without.
    pub park: Option<Nanometers>,
    /// Calls that take longer are reported.
    pub slow_call: Duration,
}

impl NanoDriveOptions {
    /// The only device there is, within `travel`; stays where it is when it is closed.
    #[must_use]
    pub fn within(travel: RangeInclusive<Nanometers>) -> Self {
        Self { serial: None, travel, park: None, slow_call: Duration::from_millis(500) }
    }
}

/// Calls that took longer than they should.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct SlowCalls {
    /// How many.
    pub number: u64,
    /// The slowest.
    pub slowest: Duration,
}

/// A piezo along z on a Nano-Drive.
#[derive(Debug)]
pub struct NanoDrive {
    library: Madlib,
    handle: Option<Handle>,
    identity: DeviceIdentity,
    serial: i16,
    product: ProductInformation,
    travel_um: f64,
    options: NanoDriveOptions,
    slow: SlowCalls,
}

impl NanoDrive {
    /// Opens the device and reads who it is and how far it goes.
    ///
    /// # Errors
    /// [`Identity`](ErrorKind::Identity) when no device has the serial number, [`Lost`](ErrorKind::Lost) when none
    /// is there or another program owns it, [`OutOfRange`](ErrorKind::OutOfRange) when the configured travel or
    /// place to park is beyond that of the device.
    pub fn open(library: &Madlib, options: NanoDriveOptions) -> Result<Self, DeviceError> {
        let functions = library.functions();
        let handle = take(functions, options.serial)?;
        let described = describe(functions, handle).and_then(|found| found.checked(&options));
        let described = described.inspect_err(|_| functions.release(handle))?;
        let Described { serial, product, travel_um } = described;
        let [version, revision] = functions.version();
        let (product_id, firmware) = (product.product_id, product.firmware_version);
        let identity = DeviceIdentity {
            vendor: "Mad City Labs".into(),
            model: format!("Nano-Drive 0x{product_id:04X}"),
            serial: serial.to_string(),
            firmware: format!("firmware {firmware}, Madlib {version}.{revision}"),
            simulated: functions.simulated,
        };
        let slow = SlowCalls::default();
        let library = library.clone();
        Ok(Self { library, handle: Some(handle), identity, serial, product, travel_um, options, slow })
    }

    /// Calls that took longer than they should.
    #[must_use]
    pub fn slow_calls(&self) -> SlowCalls {
        self.slow
    }

    /// Travel of the device, whatever the configuration allows of it.
    #[must_use]
    pub fn travel(&self) -> Nanometers {
        Nanometers::new(self.travel_um * NM_PER_UM).unwrap_or_default()
    }

    /// Whether the device answers; opens it anew if it was lost.
    pub fn is_attached(&mut self) -> bool {
        let functions = self.library.functions();
        self.opened().is_ok_and(|handle| functions.is_attached(handle))
    }

    fn error(&self, kind: ErrorKind, message: impl Into<String>) -> DeviceError {
        DeviceError::new(kind, self.identity.to_string(), message)
    }

    /// The device, opened anew after it was lost.
    fn opened(&mut self) -> Result<Handle, DeviceError> {
        if let Some(handle) = self.handle {
            return Ok(handle);
        }
        let functions = self.library.functions();
        let handle = take(functions, Some(self.serial))?;
        tracing::info!("{}: is there again; where it is has to be read anew", self.identity);
        self.handle = Some(handle);
        Ok(handle)
    }

    /// One call of the library, its time watched and its failure explained.
    fn call<T>(
        &mut self,
        what: &str,
        call: impl FnOnce(&Functions, Handle) -> Result<T, Failure>,
    ) -> Result<T, DeviceError> {
        let handle = self.opened()?;
        let functions = self.library.functions();
        let begun = Instant::now();
        let answer = call(functions, handle);
        let took = begun.elapsed();
        if took > self.options.slow_call {
            self.slow.number += 1;
            self.slow.slowest = self.slow.slowest.max(took);
            tracing::warn!("{}: took {took:?} where {what}; check its USB cable", self.identity);
        }
        answer.map_err(|failure| {
            let (kind, why) = explain(failure);
            if kind == ErrorKind::Lost {
                functions.release(handle);
                self.handle = None;
            }
            self.error(kind, format!("{what} failed: {why} ({})", failure.0))
        })
    }
}

impl FocusDrive for NanoDrive {
    fn identity(&self) -> &DeviceIdentity {
        &self.identity
    }

    fn range(&self) -> RangeInclusive<Nanometers> {
        self.options.travel.clone()
    }

    fn position(&mut self) -> Result<Nanometers, DeviceError> {
        let um = self.call("reading the position", Functions::position)?;
        Nanometers::new(um * NM_PER_UM).map_err(|error| self.error(ErrorKind::Protocol, error.to_string()))
    }

    fn move_to(&mut self, target: Nanometers) -> Result<(), DeviceError> {
        let range = self.range();
        if !range.contains(&target) {
            let (least, greatest) = range.into_inner();
            let message = format!("{target} is outside {least} to {greatest}; choose a target within");
            return Err(self.error(ErrorKind::OutOfRange, message));
        }
        let um = target.value() / NM_PER_UM;
        self.call("moving", |functions, handle| functions.set_position(handle, um))
    }
}

impl Properties for NanoDrive {
    fn properties(&mut self) -> Result<Vec<Property>, DeviceError> {
        let position = self.call("reading the position", Functions::position)?;
        let product = self.product;
        let whole = |value: i16| PropertyValue::Whole(i64::from(value));
        let mut properties = vec![
            Property::reading("SerialNumber", whole(self.serial), ""),
            Property::reading("Calibration", PropertyValue::Number(self.travel_um), "µm"),
            Property::reading("Position", PropertyValue::Number(position), "µm"),
            Property::reading("ADC_resolution", whole(product.adc_bits), "bit"),
            Property::reading("DAC_resolution", whole(product.dac_bits), "bit"),
            Property::reading("Product_id", whole(product.product_id), ""),
            Property::reading("FirmwareVersion", whole(product.firmware_version), ""),
            Property::reading("FirmwareProfile", whole(product.firmware_profile), ""),
            Property::reading("Slow calls", PropertyValue::Whole(self.slow.number.cast_signed()), ""),
        ];
        if product.firmware_profile & TELLS_TARGET != 0 {
            let target = self.call("reading the target", Functions::commanded)?;
            properties.push(Property::reading("CommandedPosition", PropertyValue::Number(target), "µm"));
        }
        Ok(properties)
    }
}

impl Drop for NanoDrive {
    fn drop(&mut self) {
        if self.handle.is_none() {
            return;
        }
        if let Some(park) = self.options.park
            && let Err(error) = self.move_to(park)
        {
            tracing::warn!("cannot be parked: {error}");
        }
        if let Some(handle) = self.handle.take() {
            self.library.functions().release(handle);
        }
    }
}

/// Takes hold of a device.
fn take(functions: &Functions, serial: Option<i16>) -> Result<Handle, DeviceError> {
    let (name, kind, found) = match serial {
        Some(serial) => {
            (format!("Nano-Drive S/N {serial}"), ErrorKind::Identity, functions.with_serial(serial))
        }
        None => ("Nano-Drive".into(), ErrorKind::Lost, functions.any()),
    };
    found.ok_or_else(|| {
        let message = "is not there; switch the controller on, check its USB cable and the serial number, and \
                       close other programs that use it";
        DeviceError::new(kind, name, message)
    })
}

/// What a device tells of itself.
struct Described {
    serial: i16,
    product: ProductInformation,
    travel_um: f64,
}

fn describe(functions: &Functions, handle: Handle) -> Result<Described, DeviceError> {
    let read = |what: &'static str| {
        move |failure: Failure| {
            let (kind, why) = explain(failure);
            DeviceError::new(kind, "Nano-Drive", format!("{what} failed: {why} ({})", failure.0))
        }
    };
    let serial = functions.serial(handle).map_err(read("reading the serial number"))?;
    let serial = i16::try_from(serial).map_err(|_| {
        DeviceError::new(ErrorKind::Protocol, "Nano-Drive", format!("{serial} is no serial number"))
    })?;
    Ok(Described {
        serial,
        product: functions.product(handle).map_err(read("reading the product information"))?,
        travel_um: functions.travel(handle).map_err(read("reading the calibration of z"))?,
    })
}

impl Described {
    /// Refuses a configuration that does not fit the device.
    fn checked(self, options: &NanoDriveOptions) -> Result<Self, DeviceError> {
        let name = format!("Nano-Drive S/N {}", self.serial);
        let refuse = |message| Err(DeviceError::new(ErrorKind::OutOfRange, name.clone(), message));
        if self.product.axes & HAS_Z == 0 {
            return Err(DeviceError::new(
                ErrorKind::Identity,
                name,
                "has no z axis; configure another device",
            ));
        }
        let (least, greatest) = (options.travel.start().value(), options.travel.end().value());
        let end = self.travel_um * NM_PER_UM;
        if least >= greatest || least < 0.0 || greatest > end {
            return refuse(format!(
                "a travel of {least} nm to {greatest} nm is not within the 0 nm to {end} nm of the device; correct \
                 the configuration"
            ));
        }
        match options.park {
            Some(park) if !options.travel.contains(&park) => refuse(format!(
                "the place to park, {park}, is outside {least} nm to {greatest} nm; correct the configuration"
            )),
            _ => Ok(self),
        }
    }
}

/// What an error code of Madlib.h means to the caller, and to the person.
fn explain(failure: Failure) -> (ErrorKind, &'static str) {
    match failure.0 {
        -2 => (ErrorKind::Lost, "a transfer failed; switch the controller off and on, then try again"),
        -3 => (ErrorKind::Lost, "the device is not attached; check its USB cable, then try again"),
        -4 => (ErrorKind::OutOfRange, "this unit does not support it"),
        -5 => (ErrorKind::Busy, "it is busy with a waveform; stop it or wait"),
        -6 => (ErrorKind::OutOfRange, "an argument is out of range; choose another value"),
        -7 => (ErrorKind::OutOfRange, "the axis is not there"),
        -8 => (ErrorKind::Lost, "the handle is no longer valid; try again"),
        -9 => (ErrorKind::Fault, "the USB driver does not fit the library; install both anew"),
        -10 => (ErrorKind::OutOfRange, "the sequence is not valid"),
        -11 => (ErrorKind::Busy, "TIRF-Lock holds the axis; switch it off at the controller"),
        _ => (ErrorKind::Fault, "the controller reports a general error; switch it off and on"),
    }
}
