//! All properties of a camera for the property browser, as the library lists them.
//!
//! In: an open camera. Out: [`Property`] with name, value, limits or choices. Never: lets the browser change what a
//! run sets by itself. Fails: as [`Properties`] says.

use sofiscope_hal::{DeviceError, ErrorKind, Properties, Property, PropertyRange, PropertyValue};

use crate::camera::DcamCamera;
use crate::ffi::Attribute;
use crate::ffi::ids::{Id, flag};

/// More properties than any camera has: a library that never ends its list is stopped here.
const MOST_PROPERTIES: usize = 4096;
/// A mode with more values is shown as a number.
const MOST_CHOICES: i64 = 256;

impl DcamCamera {
    fn ids(&self) -> Result<Vec<Id>, DeviceError> {
        let (library, camera) = (self.device.functions(), self.device.handle());
        let mut ids: Vec<Id> = Vec::new();
        let mut last = Id(0);
        while ids.len() < MOST_PROPERTIES {
            let next = library.next_property(camera, last);
            match next.map_err(|failure| self.device.error("does not list its properties", failure))? {
                Some(id) => ids.push(id),
                None => break,
            }
            last = ids.last().copied().unwrap_or(last);
        }
        Ok(ids)
    }

    /// The property as the browser shows it; none if it can be neither read nor named.
    fn property(&self, id: Id) -> Option<(Property, Attribute)> {
        let (library, camera) = (self.device.functions(), self.device.handle());
        let attribute = library.attribute(camera, id).ok()?;
        let name = library.property_name(camera, id).ok()?;
        if attribute.flags & flag::READABLE == 0 {
            return None;
        }
        let value = library.value(camera, id).ok()?;
        let (shown, range) = self.shown(id, attribute, value);
        let property = Property::reading(name, shown, unit(attribute.unit));
        let allowed = if self.is_armed() { flag::ACCESS_BUSY } else { flag::WRITABLE };
        let free = attribute.flags & flag::WRITABLE != 0 && attribute.flags & allowed != 0;
        let writable = free && !Id::MANAGED.contains(&id);
        Some((if writable { property.writable(range) } else { Property { range, ..property } }, attribute))
    }

    fn shown(&self, id: Id, attribute: Attribute, value: f64) -> (PropertyValue, PropertyRange) {
        let Attribute { flags, least, greatest, .. } = attribute;
        let between = if flags & flag::HAS_RANGE == 0 {
            PropertyRange::Any
        } else {
            PropertyRange::Between { least, greatest }
        };
        match flags & flag::TYPE {
            flag::TYPE_MODE => {
                let choices: Vec<String> =
                    self.choices(id, attribute).into_iter().map(|(_, text)| text).collect();
                let text = self.device.functions().value_text(self.device.handle(), id, value);
                let text = text.unwrap_or_else(|_| value.to_string());
                (PropertyValue::Text(text), PropertyRange::Choice(choices))
            }
            flag::TYPE_LONG => (PropertyValue::Whole(value.round() as i64), between),
            _ => (PropertyValue::Number(value), between),
        }
    }

    /// The values of a mode, found by asking for the text of every number in its range.
    fn choices(&self, id: Id, attribute: Attribute) -> Vec<(f64, String)> {
        let (library, camera) = (self.device.functions(), self.device.handle());
        let (least, greatest) = (attribute.least.round() as i64, attribute.greatest.round() as i64);
        (least..=greatest.min(least.saturating_add(MOST_CHOICES)))
            .map(|value| value as f64)
            .filter_map(|value| library.value_text(camera, id, value).ok().map(|text| (value, text)))
            .collect()
    }

    fn number(
        &self,
        id: Id,
        property: &Property,
        attribute: Attribute,
        value: &PropertyValue,
    ) -> Result<f64, DeviceError> {
        let number = match value {
            PropertyValue::Whole(whole) => Some(*whole as f64),
            PropertyValue::Number(number) => Some(*number).filter(|number| number.is_finite()),
            PropertyValue::Flag(_) => None,
            PropertyValue::Text(text) => {
                let choices = self.choices(id, attribute);
                choices.into_iter().find(|(_, choice)| choice == text).map(|(value, _)| value)
            }
        };
        let in_range = |number: &f64| match &property.range {
            PropertyRange::Between { least, greatest } => (least..=greatest).contains(&number),
            PropertyRange::Choice(_) => matches!(value, PropertyValue::Text(_)),
            PropertyRange::Any => true,
        };
        number.filter(in_range).ok_or_else(|| {
            let message = format!("'{}' does not take {value:?}, only {:?}", property.name, property.range);
            self.error(ErrorKind::OutOfRange, message)
        })
    }
}

impl Properties for DcamCamera {
    fn properties(&mut self) -> Result<Vec<Property>, DeviceError> {
        Ok(self.ids()?.into_iter().filter_map(|id| self.property(id)).map(|(property, _)| property).collect())
    }

    fn set_property(&mut self, name: &str, value: &PropertyValue) -> Result<(), DeviceError> {
        let found = self.ids()?.into_iter().find_map(|id| {
            let (property, attribute) = self.property(id)?;
            (property.name == name).then_some((id, property, attribute))
        });
        let Some((id, property, attribute)) = found else {
            return Err(self.error(ErrorKind::OutOfRange, format!("has no property '{name}'")));
        };
        if Id::MANAGED.contains(&id) {
            let message = format!("'{name}' belongs to the settings of a run; change it there");
            return Err(self.error(ErrorKind::OutOfRange, message));
        }
        if !property.writable {
            let writable_when_stopped = attribute.flags & flag::WRITABLE != 0;
            return Err(if writable_when_stopped {
                self.error(ErrorKind::Busy, format!("'{name}' cannot be changed while armed; stop it first"))
            } else {
                self.error(ErrorKind::OutOfRange, format!("'{name}' can only be looked at"))
            });
        }
        let number = self.number(id, &property, attribute, value)?;
        self.device.set(id, number)
    }
}

/// Units of DCAM-API.
fn unit(number: i32) -> &'static str {
    match number {
        1 => "s",
        2 => "°C",
        3 => "K",
        4 => "m/s",
        5 => "1/s",
        6 => "°",
        7 => "µm",
        _ => "",
    }
}
