//! Physical quantities between rooms: a number never travels without its unit.
//!
//! A quantity is finite or it is not made: [`new`](Nanometers::new) refuses NaN and infinities, so that no
//! driver has to ask again.

use serde::{Deserialize, Serialize};

/// A number that no device can be asked for: NaN or infinite.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[error("{value} {unit} is not a finite number")]
pub struct NotFinite {
    value: f64,
    unit: &'static str,
}

macro_rules! quantity {
    ($(#[$doc:meta])* $name:ident, $unit:literal) => {
        $(#[$doc])*
        #[derive(Debug, Clone, Copy, PartialEq, PartialOrd, Default, Serialize, Deserialize)]
        #[serde(try_from = "f64", into = "f64")]
        pub struct $name(f64);

        impl $name {
            /// Nothing of it.
            pub const ZERO: Self = Self(0.0);

            /// A quantity.
            ///
            /// # Errors
            /// [`NotFinite`] for NaN and infinities.
            pub fn new(value: f64) -> Result<Self, NotFinite> {
                if value.is_finite() { Ok(Self(value)) } else { Err(NotFinite { value, unit: $unit }) }
            }

            /// The number in the unit of the name.
            #[must_use]
            pub fn value(self) -> f64 {
                self.0
            }

            /// The distance between two of them, never negative.
            #[must_use]
            pub fn distance(self, other: Self) -> Self {
                Self((self.0 - other.0).abs())
            }
        }

        impl TryFrom<f64> for $name {
            type Error = NotFinite;

            fn try_from(value: f64) -> Result<Self, NotFinite> {
                Self::new(value)
            }
        }

        impl From<$name> for f64 {
            fn from(quantity: $name) -> Self {
                quantity.0
            }
        }

        impl std::fmt::Display for $name {
            fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                std::fmt::Display::fmt(&self.0, formatter)?;
                formatter.write_str(concat!(" ", $unit))
            }
        }
    };
}

quantity!(
    /// A length or position along the optical axis.
    Nanometers,
    "nm"
);
quantity!(
    /// A position of the stage.
    Micrometers,
    "µm"
);
quantity!(
    /// Speed of the stage.
    MillimetersPerSecond,
    "mm/s"
);
quantity!(
    /// Optical power.
    Milliwatts,
    "mW"
);
quantity!(
    /// Level of an analog output.
    Volts,
    "V"
);
quantity!(
    /// Temperature.
    Celsius,
    "°C"
);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_finite_numbers_become_quantities() {
        for value in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            assert!(Nanometers::new(value).is_err(), "{value} nm");
        }
        assert_eq!(Nanometers::new(-3.5).map(Nanometers::value), Ok(-3.5));
        assert_eq!(Milliwatts::new(f64::NAN).unwrap_err().to_string(), "NaN mW is not a finite number");
    }

    #[test]
    fn quantities_are_written_with_their_unit() {
        assert_eq!(Micrometers::new(1250.0).unwrap().to_string(), "1250 µm");
        assert_eq!(format!("{:.1}", Milliwatts::new(4.987).unwrap()), "5.0 mW");
    }
}
