//! Everything that a device lets a person look at or change, as data for a property browser.
//!
//! In: nothing. Out: [`Property`], [`Properties`]. Never: replaces the contract of a device; what a run needs has
//! a method of its own, checked and with units in types.

use crate::DeviceError;
use serde::{Deserialize, Serialize};

/// The value of a property.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PropertyValue {
    /// Yes or no.
    Flag(bool),
    /// A whole number.
    Whole(i64),
    /// A number.
    Number(f64),
    /// A text, or one of the choices.
    Text(String),
}

/// Which values a property takes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PropertyRange {
    /// Whatever its kind of value allows.
    Any,
    /// Numbers from `least` to `greatest`.
    Between {
        /// Smallest allowed number.
        least: f64,
        /// Largest allowed number.
        greatest: f64,
    },
    /// One of these.
    Choice(Vec<String>),
}

/// One line of the property browser.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Property {
    /// The name as the maker's manual has it.
    pub name: String,
    /// Present value.
    pub value: PropertyValue,
    /// Unit, empty for plain numbers and texts.
    pub unit: String,
    /// Allowed values.
    pub range: PropertyRange,
    /// Whether a person may change it now.
    pub writable: bool,
}

impl Property {
    /// A property that is only looked at.
    pub fn reading(name: impl Into<String>, value: PropertyValue, unit: impl Into<String>) -> Self {
        Self { name: name.into(), value, unit: unit.into(), range: PropertyRange::Any, writable: false }
    }

    /// The same property, to be changed within `range`.
    #[must_use]
    pub fn writable(self, range: PropertyRange) -> Self {
        Self { range, writable: true, ..self }
    }
}

/// A device whose properties can be browsed.
pub trait Properties {
    /// All properties with their present values, in the order of the manual.
    ///
    /// # Errors
    /// Whatever the device says.
    fn properties(&mut self) -> Result<Vec<Property>, DeviceError>;

    /// Changes one property.
    ///
    /// # Errors
    /// [`OutOfRange`](crate::ErrorKind::OutOfRange) for unknown names, properties that are only looked at and
    /// values outside the range; nothing has then changed.
    fn set_property(&mut self, name: &str, value: &PropertyValue) -> Result<(), DeviceError> {
        let _ = value;
        Err(DeviceError::new(crate::ErrorKind::OutOfRange, "property", format!("'{name}' cannot be changed")))
    }
}
