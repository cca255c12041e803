//! What a person may look at.

use sofiscope_hal::{DeviceError, Laser, Properties, Property, PropertyValue};

use crate::driver::Smd12;
use crate::link::{Haste, Shape};
use crate::reply;

/// Questions whose answers are shown as they are.
const READINGS: [(&str, &str); 4] =
    [("CONTROL", "CONTROL?"), ("CURRENT", "CURRENT?"), ("LASTEMP", "LASTEMP?"), ("PSUTEMP", "PSUTEMP?")];

impl Properties for Smd12 {
    fn properties(&mut self) -> Result<Vec<Property>, DeviceError> {
        let text = |name: &str, value: String| Property::reading(name, PropertyValue::Text(value), "");
        let mut properties = vec![
            text("VERSION", self.identity().firmware.clone()),
            Property::reading("power cap", PropertyValue::Number(self.power_cap().value()), "mW"),
        ];
        for (name, command) in READINGS {
            let value = self.link.ask(command, Shape::Text, Haste::Usual, reply::something)?;
            properties.push(text(name, value));
        }
        for timer in self.link.timers()? {
            let (name, value) = timer.split_once('=').unwrap_or(("TIMERS", &timer));
            properties.push(text(name.trim(), value.trim().to_owned()));
        }
        Ok(properties)
    }
}
