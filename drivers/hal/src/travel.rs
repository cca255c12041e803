//! Whether the sample may travel sideways while the objective is near it.
//!
//! In: where the focus is, how far the stage shall go. Out: [`Route`]. Never: moves anything.
//!
//! A long move with an oil objective at the sample ends at the rim of the holder. Near the sample only short moves
//! are allowed, and every other one needs the objective retracted first. The rule refuses and tells the safe route;
//! it does not take it, because retracting loses the focus and that is for the person or the plan to decide.

use crate::{DeviceError, ErrorKind, Micrometers, Nanometers, StagePoint, Toward};
use serde::{Deserialize, Serialize};

/// The rule of one objective on one stand.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct SafeTravel {
    /// Which way brings the objective closer to the sample.
    pub toward: Toward,
    /// Here and farther from the sample, any move is safe.
    pub safe_z: Nanometers,
    /// Longest move that is allowed closer to the sample than that.
    pub short: Micrometers,
}

/// How to get to a place.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Route {
    /// The move is safe as it is.
    Go,
    /// Not before the focus is at `to`.
    RetractFirst {
        /// Where the focus must be first.
        to: Nanometers,
    },
}

impl SafeTravel {
    /// The route to `target`, for a stage at `here` and a focus at `z`; what is not known is `None`, and then
    /// taken for the worst.
    #[must_use]
    pub fn route(&self, z: Option<Nanometers>, here: Option<StagePoint>, target: StagePoint) -> Route {
        let is_retracted = z.is_some_and(|z| !self.is_near(z));
        let is_short = here.is_some_and(|here| distance_um(here, target) <= self.short.value());
        if is_retracted || is_short { Route::Go } else { Route::RetractFirst { to: self.safe_z } }
    }

    /// The same as an answer to whoever asked for the move.
    ///
    /// # Errors
    /// [`Busy`](ErrorKind::Busy) with the safe route, when the focus must be retracted first.
    pub fn check(
        &self,
        z: Option<Nanometers>,
        here: Option<StagePoint>,
        target: StagePoint,
    ) -> Result<(), DeviceError> {
        let Route::RetractFirst { to } = self.route(z, here, target) else { return Ok(()) };
        let found = z.map_or_else(|| "not known where".to_owned(), |z| format!("at {z}"));
        let message = format!(
            "a move to ({}, {}) is longer than {} and the focus, {found}, may be near the sample; \
             retract the focus to {to}, then move, then approach again",
            target.x, target.y, self.short,
        );
        Err(DeviceError::new(ErrorKind::Busy, "stage", message))
    }

    /// Whether the objective is nearer to the sample than is safe for long moves.
    #[must_use]
    pub fn is_near(&self, z: Nanometers) -> bool {
        match self.toward {
            Toward::Up => z > self.safe_z,
            Toward::Down => z < self.safe_z,
        }
    }
}

/// Length of the way; infinite when it is too long for a number.
fn distance_um(from: StagePoint, to: StagePoint) -> f64 {
    (from.x.value() - to.x.value()).hypot(from.y.value() - to.y.value())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn nanometers() -> impl Strategy<Value = Nanometers> {
        (-1e6..1e6).prop_map(|value| Nanometers::new(value).unwrap())
    }

    fn point() -> impl Strategy<Value = StagePoint> {
        let number = || prop_oneof![-1e3..1e3, -2e5..2e5, Just(f64::MAX), Just(-f64::MAX)];
        let length = |value| Micrometers::new(value).unwrap();
        (number(), number()).prop_map(move |(x, y)| StagePoint { x: length(x), y: length(y) })
    }

    fn rule() -> impl Strategy<Value = SafeTravel> {
        let toward = prop_oneof![Just(Toward::Up), Just(Toward::Down)];
        (toward, nanometers(), 0.0..500.0).prop_map(|(toward, safe_z, short)| {
            let short = Micrometers::new(short).unwrap();
            SafeTravel { toward, safe_z, short }
        })
    }

    /// How much nearer than safe, positive when nearer: the slow and obvious way to say it.
    fn nearness(rule: &SafeTravel, z: Nanometers) -> f64 {
        let sign = if rule.toward == Toward::Up { 1.0 } else { -1.0 };
        sign * (z.value() - rule.safe_z.value())
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(20_000))]

        #[test]
        fn no_long_move_is_let_go_near_the_sample(
            rule in rule(), z in nanometers(), here in point(), target in point(),
        ) {
            let dx = here.x.value() - target.x.value();
            let dy = here.y.value() - target.y.value();
            let is_long = dx.abs() > rule.short.value() || dy.abs() > rule.short.value();
            if nearness(&rule, z) > 0.0 && is_long {
                prop_assert_eq!(
                    rule.route(Some(z), Some(here), target),
                    Route::RetractFirst { to: rule.safe_z }
                );
                prop_assert!(rule.check(Some(z), Some(here), target).is_err());
            }
        }

        #[test]
        fn the_safe_route_leads_on_and_away_from_the_sample(
            rule in rule(), z in nanometers(), here in point(), target in point(),
        ) {
            if let Route::RetractFirst { to } = rule.route(Some(z), Some(here), target) {
                prop_assert!(nearness(&rule, to) < nearness(&rule, z));
                prop_assert_eq!(rule.route(Some(to), Some(here), target), Route::Go);
            }
        }

        #[test]
        fn what_is_not_known_is_taken_for_the_worst(
            rule in rule(), z in nanometers(), here in point(), target in point(),
        ) {
            prop_assert_ne!(rule.route(None, None, target), Route::Go);
            let known = rule.route(Some(z), Some(here), target);
            if rule.route(None, Some(here), target) == Route::Go || rule.route(Some(z), None, target) == Route::Go {
                prop_assert_eq!(known, Route::Go);
            }
        }

        #[test]
        fn short_moves_and_retracted_objectives_are_not_hindered(
            rule in rule(), z in nanometers(), here in point(), target in point(),
        ) {
            prop_assert_eq!(rule.route(None, Some(here), here), Route::Go);
            if nearness(&rule, z) <= 0.0 {
                prop_assert_eq!(rule.route(Some(z), Some(here), target), Route::Go);
            }
        }
    }

    #[test]
    fn a_refusal_tells_the_safe_route() {
        let length = |value| Micrometers::new(value).unwrap();
        let height = |value| Nanometers::new(value).unwrap();
        let rule = SafeTravel { toward: Toward::Up, safe_z: height(1000.0), short: length(200.0) };
        let [here, there] = [0.0, 5000.0].map(|x| StagePoint { x: length(x), y: length(0.0) });
        let error = rule.check(Some(height(150_000.0)), Some(here), there).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Busy);
        assert_eq!(
            error.to_string(),
            "stage: a move to (5000 µm, 0 µm) is longer than 200 µm and the focus, at 150000 nm, may be near the \
             sample; retract the focus to 1000 nm, then move, then approach again"
        );
    }
}
