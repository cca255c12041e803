//! The cooler of a simulated camera: something for the property browser that changes no pixel.
//!
//! In: a name and a value. Out: properties, another cooler. Never: changes a frame; the noise of a simulated camera is
//! that of its scene at every temperature. Fails: with what is wrong, in words.

use sofiscope_hal::{Property, PropertyRange, PropertyValue};

/// Temperatures that can be asked for, degrees Celsius.
const TARGETS: [f64; 2] = [-30.0, 20.0];
/// Temperature of the room.
const ROOM: f64 = 20.0;
const COOLER: &str = "cooler";
const TARGET: &str = "target temperature";
const STATES: [&str; 2] = ["off", "on"];

/// The cooler.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Cooling {
    is_on: bool,
    target: f64,
}

impl Default for Cooling {
    fn default() -> Self {
        Self { is_on: true, target: -10.0 }
    }
}

impl Cooling {
    /// What the browser shows.
    pub(super) fn properties(self) -> Vec<Property> {
        let [least, greatest] = TARGETS;
        let state = PropertyValue::Text(STATES[usize::from(self.is_on)].into());
        let now = if self.is_on { self.target } else { ROOM };
        vec![
            Property::reading(COOLER, state, "")
                .writable(PropertyRange::Choice(STATES.map(Into::into).into())),
            Property::reading(TARGET, PropertyValue::Number(self.target), "°C")
                .writable(PropertyRange::Between { least, greatest }),
            Property::reading("sensor temperature", PropertyValue::Number(now), "°C"),
        ]
    }

    /// The same with one property changed.
    pub(super) fn with(self, name: &str, value: &PropertyValue) -> Result<Self, String> {
        let [least, greatest] = TARGETS;
        match (name, value) {
            (COOLER, PropertyValue::Text(state)) if STATES.contains(&state.as_str()) => {
                Ok(Self { is_on: state == "on", ..self })
            }
            (TARGET, PropertyValue::Number(target)) if (least..=greatest).contains(target) => {
                Ok(Self { target: *target, ..self })
            }
            (COOLER, _) => Err(format!("'{COOLER}' takes off or on, not {value:?}")),
            (TARGET, _) => Err(format!("'{TARGET}' takes {least} to {greatest} °C, not {value:?}")),
            _ => Err(format!("'{name}' cannot be changed")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_set_is_shown_and_nothing_else_is_taken() {
        let shown = |cooling: Cooling, place: usize| cooling.properties()[place].value.clone();
        let warm = Cooling::default().with(COOLER, &PropertyValue::Text("off".into())).unwrap();
        assert_eq!(shown(warm, 2), PropertyValue::Number(ROOM));
        let cold = Cooling::default().with(TARGET, &PropertyValue::Number(-25.0)).unwrap();
        assert_eq!(
            (shown(cold, 1), shown(cold, 2)),
            (PropertyValue::Number(-25.0), PropertyValue::Number(-25.0))
        );
        for (name, value) in [
            (COOLER, PropertyValue::Text("warm".into())),
            (TARGET, PropertyValue::Number(-31.0)),
            (TARGET, PropertyValue::Number(f64::NAN)),
            ("sensor temperature", PropertyValue::Number(0.0)),
        ] {
            assert!(Cooling::default().with(name, &value).is_err(), "{name} {value:?}");
        }
    }
}
