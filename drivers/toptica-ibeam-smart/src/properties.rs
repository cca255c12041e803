//! What a person may look at.

use sofiscope_hal::{DeviceError, Laser, Properties, Property, PropertyValue};

use crate::driver::IbeamSmart;
use crate::link::{Haste, Shape};
use crate::reply;

/// Questions whose answers are shown as they are.
const READINGS: [(&str, &str); 6] = [
    ("laser diode current", "sh cur"),
    ("laser diode temperature", "sh temp"),
    ("base plate temperature", "sh temp sys"),
    ("clip status", "sta clip"),
    ("FINE", "sta fine"),
    ("uptime", "sta uptime"),
];

impl Properties for IbeamSmart {
    fn properties(&mut self) -> Result<Vec<Property>, DeviceError> {
        let identity = self.identity();
        let mut properties = vec![
            Property::reading("model", PropertyValue::Text(identity.model.clone()), ""),
            Property::reading("serial", PropertyValue::Text(identity.serial.clone()), ""),
            Property::reading("version", PropertyValue::Text(identity.firmware.clone()), ""),
            Property::reading("power cap", PropertyValue::Number(self.power_cap().value()), "mW"),
        ];
        for (name, command) in READINGS {
            let text = |texts: &[String]| reply::only(texts).map(str::to_owned);
            let value = self.link.ask(command, Shape::Text, Haste::Usual, text)?;
            properties.push(Property::reading(name, PropertyValue::Text(value), ""));
        }
        Ok(properties)
    }
}
