//! Properties of the cameras: read when the instrument is opened, changed while nothing is under way.
//!
//! In: a name and what was typed. Out: the property set, and all of them read back. Never: touches a camera at work.
//! Fails: [`AppError`] with what the camera said, or with what can be typed.

use super::Session;
use super::card::row;
use crate::app::AppError;
use crate::control::sequencer::Devices;
use crate::viewer::bench::{Gravity, InstrumentCard};
use sofiscope_hal::{Channel, Property, PropertyRange, PropertyValue};
use std::sync::Arc;

/// Adds the properties of both cameras to the card; gives a warning for each camera that does not tell them.
pub(super) fn read_all(devices: &mut Devices, card: &mut InstrumentCard) -> Vec<String> {
    let mut warnings = Vec::new();
    for channel in Channel::BOTH {
        match devices.camera_properties(channel) {
            Ok(properties) => put(card, channel, &properties),
            Err(error) => warnings.push(format!("{channel} does not tell its properties: {error}")),
        }
    }
    warnings
}

/// Exchanges what a card says of the properties of a camera, behind what is always known of it.
fn put(card: &mut InstrumentCard, channel: Channel, properties: &[Property]) {
    let role = channel.to_string();
    if let Some(device) = card.devices.iter_mut().find(|device| device.role == role) {
        device.properties.retain(|row| super::card::KNOWN_OF_CAMERAS.contains(&row.name.as_str()));
        device.properties.extend(properties.iter().map(row));
    }
}

impl Session {
    pub(super) fn set_property(&mut self, device: &str, name: &str, typed: &str) -> Result<(), AppError> {
        let channel = Channel::BOTH.into_iter().find(|channel| channel.to_string() == device);
        let Some(channel) = channel else {
            return Err(AppError::Usage(format!(
                "{device}: {name} cannot be changed here; write it in the instrument file and open it again"
            )));
        };
        let devices = self.devices.as_mut().ok_or_else(super::nothing_open)?;
        let properties = devices.camera_properties(channel).map_err(AppError::from)?;
        let property = properties.iter().find(|property| property.name == name);
        let property =
            property.ok_or_else(|| AppError::Usage(format!("{device} has no property '{name}'")))?;
        if !property.writable {
            return Err(AppError::Usage(format!("{device}: '{name}' can only be looked at")));
        }
        let value = value_of(property, typed)
            .map_err(|why| AppError::Usage(format!("{device}: '{name}' {why}; '{typed}' was typed")))?;
        devices.set_camera_property(channel, name, &value).map_err(AppError::from)?;
        let properties = devices.camera_properties(channel).map_err(AppError::from)?;
        let now = properties.iter().find(|property| property.name == name).map(row);
        if let Some(card) = self.shared.card.load_full() {
            let mut card = InstrumentCard::clone(&card);
            put(&mut card, channel, &properties);
            self.shared.card.store(Some(Arc::new(card)));
        }
        let now = now.map_or(String::new(), |row| format!("{} {}", row.value, row.unit));
        self.shared.tell(Gravity::Note, format!("{device}: {name} is {}", now.trim()));
        Ok(())
    }
}

/// What was typed as a value of the property's own kind, within its range.
fn value_of(property: &Property, typed: &str) -> Result<PropertyValue, String> {
    let typed = typed.trim();
    let value = match &property.value {
        PropertyValue::Flag(_) => match typed.to_lowercase().as_str() {
            "true" | "on" | "yes" | "1" => PropertyValue::Flag(true),
            "false" | "off" | "no" | "0" => PropertyValue::Flag(false),
            _ => return Err("takes true or false".to_owned()),
        },
        PropertyValue::Whole(_) => {
            PropertyValue::Whole(typed.parse().map_err(|_| "takes a whole number".to_owned())?)
        }
        PropertyValue::Number(_) => {
            let number = typed.replace(',', ".").parse::<f64>().ok().filter(|number| number.is_finite());
            PropertyValue::Number(number.ok_or("takes a number")?)
        }
        PropertyValue::Text(_) => PropertyValue::Text(typed.to_owned()),
    };
    let number = match &value {
        PropertyValue::Whole(whole) => Some(*whole as f64),
        PropertyValue::Number(number) => Some(*number),
        PropertyValue::Flag(_) | PropertyValue::Text(_) => None,
    };
    match (&property.range, number, &value) {
        (PropertyRange::Between { least, greatest }, Some(number), _)
            if !(*least..=*greatest).contains(&number) =>
        {
            Err(format!("takes {least} to {greatest} {}", property.unit).trim().to_owned())
        }
        (PropertyRange::Choice(choices), _, PropertyValue::Text(text)) if !choices.contains(text) => {
            Err(format!("takes one of {}", choices.join(", ")))
        }
        _ => Ok(value),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_typed_becomes_a_value_of_the_same_kind_or_a_sentence() {
        let number = Property::reading("gain", PropertyValue::Number(1.0), "dB")
            .writable(PropertyRange::Between { least: 0.0, greatest: 24.0 });
        assert_eq!(value_of(&number, " 12,5 "), Ok(PropertyValue::Number(12.5)));
        assert_eq!(value_of(&number, "25"), Err("takes 0 to 24 dB".to_owned()));
        assert_eq!(value_of(&number, "nan"), Err("takes a number".to_owned()));
        let whole = Property::reading("offset", PropertyValue::Whole(1), "").writable(PropertyRange::Any);
        assert_eq!(value_of(&whole, "-7"), Ok(PropertyValue::Whole(-7)));
        assert!(value_of(&whole, "1.5").is_err());
        let flag = Property::reading("inverter", PropertyValue::Flag(false), "").writable(PropertyRange::Any);
        assert_eq!(value_of(&flag, "On"), Ok(PropertyValue::Flag(true)));
        assert!(value_of(&flag, "maybe").is_err());
        let choice = Property::reading("mode", PropertyValue::Text("slow".into()), "")
            .writable(PropertyRange::Choice(vec!["slow".into(), "fast".into()]));
        assert_eq!(value_of(&choice, "fast"), Ok(PropertyValue::Text("fast".into())));
        assert_eq!(value_of(&choice, "faster"), Err("takes one of slow, fast".to_owned()));
    }
}
