//! What may shine, and when it must not any more.
//!
//! In: what was asked, proved and seen, each with its time. Out: [`Action`]s for the devices.
//! Never: reads a clock, talks to a device. Fails: [`Refusal`]; the state is then what it was.
//!
//! Two rules hold in every state, and the property tests say so: light is only allowed while armed, and every
//! way out of [`Phase::Lit`] begins with closing the gates.

use std::time::Duration;

use serde::{Deserialize, Serialize};

/// Without a proof of progress for this long, everything goes dark.
///
/// With a look at the clock every 10 ms and a command of a few bytes to the controller, gates are closed within the
/// 300 ms that are promised; the watchdog of the controller (250 ms) is the second line.
pub const PROOF_TIMEOUT: Duration = Duration::from_millis(180);
/// Between arming and the first light the emission indicator is on for this long.
pub const INDICATOR: Duration = Duration::from_secs(2);
/// Arming that is not used expires.
pub const IDLE_EXPIRY: Duration = Duration::from_secs(30 * 60);
/// A measured power that is off by more than this share of the wanted one is a fault.
pub const POWER_TOLERANCE: f64 = 0.1;

/// Why everything went dark by itself.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", tag = "kind", content = "detail")]
pub enum Trip {
    /// The instrument process is gone.
    InstrumentGone,
    /// It is there, but did not prove progress in time.
    NoProof,
    /// The interlock is open, or the key is off.
    Interlock(String),
    /// A laser or the controller is gone; what it does is unknown.
    DeviceLost(String),
    /// A device reports a fault, or does something else than it was asked.
    DeviceFault(String),
    /// The controller closed its gates by itself.
    Controller(String),
}

impl std::fmt::Display for Trip {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::InstrumentGone => formatter.write_str("the instrument process is gone"),
            Self::NoProof => write!(
                formatter,
                "the instrument process gave no sign of progress for {} ms",
                PROOF_TIMEOUT.as_millis()
            ),
            Self::Interlock(what) => write!(formatter, "the interlock is open ({what})"),
            Self::DeviceLost(what) => {
                write!(formatter, "{what}; its light is unknown and must be taken as on: use the key")
            }
            Self::DeviceFault(what) => formatter.write_str(what),
            Self::Controller(what) => write!(formatter, "the trigger controller closed its gates: {what}"),
        }
    }
}

/// What may shine.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Phase {
    /// Nothing; a person has not armed.
    Dark,
    /// Nothing yet; a person has armed.
    Armed {
        /// When, for indicator and expiry.
        since: Duration,
    },
    /// What was asked for.
    Lit {
        /// The newest proof that somebody holds it on.
        proved: Duration,
    },
    /// Nothing, until a person arms again.
    Tripped(Trip),
}

/// Something asked, proved or seen.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Input {
    /// A person arms.
    Arm,
    /// A person or a run disarms.
    Disarm,
    /// Light is wanted.
    Light,
    /// No light is wanted.
    Darken,
    /// The instrument has made progress.
    Proof,
    /// Time has passed.
    Look,
    /// Something is wrong.
    Wrong(Trip),
}

/// What the devices are to do, in this order.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Action {
    /// Let the controller open gates when asked.
    ArmGates,
    /// Close all gates and let none open.
    CloseGates,
    /// Make all lasers dark.
    DarkenLasers,
    /// Let the lasers emit, then open their gates.
    Shine,
}

/// Why nothing was done.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Refusal {
    /// Light without arming.
    #[error("the lasers are not armed; a person at the instrument has to arm them")]
    NotArmed,
    /// The emission indicator has not been on for long enough.
    #[error("the emission indicator must be on for another {} ms", .0.as_millis())]
    Indicator(Duration),
    /// A trip is latched.
    #[error("a safety trip is latched; a person at the instrument has to arm again")]
    Tripped,
}

/// The state machine of the guard.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Safety {
    phase: Phase,
}

impl Default for Safety {
    fn default() -> Self {
        Self { phase: Phase::Dark }
    }
}

const DARK: &[Action] = &[Action::CloseGates, Action::DarkenLasers];

impl Safety {
    /// What may shine.
    #[must_use]
    pub fn phase(&self) -> &Phase {
        &self.phase
    }

    /// Until when the controller may be told that somebody is there; `None` while nothing may shine.
    #[must_use]
    pub fn held_until(&self) -> Option<Duration> {
        match self.phase {
            Phase::Lit { proved } => Some(proved + PROOF_TIMEOUT),
            Phase::Dark | Phase::Armed { .. } | Phase::Tripped(_) => None,
        }
    }

    /// One step at `now`, which never goes back.
    ///
    /// # Errors
    /// [`Refusal`]; nothing has then changed.
    pub fn step(&mut self, input: Input, now: Duration) -> Result<&'static [Action], Refusal> {
        match (&self.phase, input) {
            (_, Input::Wrong(trip)) => {
                // The first reason stays: what follows from it is no news.
                if !matches!(self.phase, Phase::Tripped(_)) {
                    self.phase = Phase::Tripped(trip);
                }
                Ok(DARK)
            }
            (Phase::Dark | Phase::Tripped(_), Input::Arm) => {
                self.phase = Phase::Armed { since: now };
                Ok(&[Action::CloseGates, Action::DarkenLasers, Action::ArmGates])
            }
            (Phase::Armed { .. } | Phase::Lit { .. }, Input::Arm) => Ok(&[]),
            (Phase::Tripped(_), Input::Disarm | Input::Darken) => Ok(DARK),
            (_, Input::Disarm) => {
                self.phase = Phase::Dark;
                Ok(DARK)
            }
            (Phase::Dark, Input::Light) => Err(Refusal::NotArmed),
            (Phase::Tripped(_), Input::Light) => Err(Refusal::Tripped),
            (Phase::Armed { since }, Input::Light) => {
                let shown = now.saturating_sub(*since);
                if shown < INDICATOR {
                    return Err(Refusal::Indicator(INDICATOR - shown));
                }
                self.phase = Phase::Lit { proved: now };
                Ok(&[Action::ArmGates, Action::Shine])
            }
            (Phase::Lit { .. }, Input::Light) => Ok(&[Action::CloseGates, Action::ArmGates, Action::Shine]),
            (Phase::Lit { .. }, Input::Darken) => {
                // The indicator has been seen: what was armed stays armed for a while.
                self.phase = Phase::Armed { since: now.saturating_sub(INDICATOR) };
                Ok(DARK)
            }
            (Phase::Dark | Phase::Armed { .. }, Input::Darken) => Ok(DARK),
            (Phase::Lit { proved }, Input::Proof | Input::Look) if now > *proved + PROOF_TIMEOUT => {
                self.phase = Phase::Tripped(Trip::NoProof);
                Ok(DARK)
            }
            (Phase::Lit { .. }, Input::Proof) => {
                self.phase = Phase::Lit { proved: now };
                Ok(&[])
            }
            (Phase::Armed { since }, Input::Look) if now > *since + IDLE_EXPIRY => {
                self.phase = Phase::Dark;
                Ok(DARK)
            }
            (_, Input::Proof | Input::Look) => Ok(&[]),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const fn ms(number: u64) -> Duration {
        Duration::from_millis(number)
    }

    #[test]
    fn light_needs_a_person_the_indicator_and_somebody_who_holds_it() {
        let mut safety = Safety::default();
        assert_eq!(safety.step(Input::Light, ms(0)), Err(Refusal::NotArmed));
        assert!(safety.step(Input::Arm, ms(0)).is_ok());
        assert_eq!(safety.step(Input::Light, ms(500)), Err(Refusal::Indicator(ms(1500))));
        assert_eq!(safety.step(Input::Light, ms(2000)), Ok(&[Action::ArmGates, Action::Shine][..]));
        assert_eq!(safety.step(Input::Proof, ms(2150)), Ok(&[][..]));
        assert_eq!(safety.step(Input::Look, ms(2330)), Ok(&[][..]), "held until 2330 ms");
        assert_eq!(safety.step(Input::Look, ms(2331)), Ok(DARK));
        assert_eq!(safety.phase(), &Phase::Tripped(Trip::NoProof));
        assert_eq!(safety.step(Input::Proof, ms(2332)), Ok(&[][..]), "a late proof changes nothing");
        assert_eq!(safety.step(Input::Light, ms(2333)), Err(Refusal::Tripped));
    }

    #[test]
    fn a_proof_that_comes_too_late_is_none() {
        let mut safety = Safety::default();
        for (input, at) in [(Input::Arm, 0), (Input::Light, 2000)] {
            assert!(safety.step(input, ms(at)).is_ok());
        }
        assert_eq!(safety.step(Input::Proof, ms(2500)), Ok(DARK), "the guard itself was away meanwhile");
    }

    #[test]
    fn the_first_reason_of_a_trip_stays() {
        let mut safety = Safety::default();
        let interlock = Trip::Interlock("488 nm".to_owned());
        assert_eq!(safety.step(Input::Wrong(interlock.clone()), ms(0)), Ok(DARK));
        assert_eq!(safety.step(Input::Wrong(Trip::InstrumentGone), ms(1)), Ok(DARK));
        assert_eq!(safety.step(Input::Disarm, ms(2)), Ok(DARK));
        assert_eq!(safety.phase(), &Phase::Tripped(interlock));
    }

    #[test]
    fn unused_arming_expires() {
        let mut safety = Safety::default();
        assert!(safety.step(Input::Arm, ms(0)).is_ok());
        assert_eq!(safety.step(Input::Look, IDLE_EXPIRY + ms(1)), Ok(DARK));
        assert_eq!(safety.phase(), &Phase::Dark);
    }

    /// A slow obvious twin of the devices: what the actions make of gates and lasers.
    #[derive(Debug, Default)]
    struct Sample {
        gates_armed: bool,
        gates_open: bool,
        emitting: bool,
    }

    impl Sample {
        fn obey(&mut self, action: Action) {
            match action {
                Action::ArmGates => self.gates_armed = true,
                Action::CloseGates => (self.gates_armed, self.gates_open) = (false, false),
                Action::DarkenLasers => self.emitting = false,
                Action::Shine => (self.gates_open, self.emitting) = (self.gates_armed, true),
            }
        }
    }

    fn input() -> impl Strategy<Value = Input> {
        prop_oneof![
            2 => Just(Input::Arm),
            1 => Just(Input::Disarm),
            4 => Just(Input::Light),
            1 => Just(Input::Darken),
            8 => Just(Input::Proof),
            8 => Just(Input::Look),
            1 => prop_oneof![
                Just(Trip::InstrumentGone),
                Just(Trip::Interlock("key".to_owned())),
                Just(Trip::DeviceLost("488 nm".to_owned())),
                Just(Trip::Controller("watchdog".to_owned())),
            ].prop_map(Input::Wrong),
        ]
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 2000, ..ProptestConfig::default() })]

        /// 2000 sequences of 60 steps each; light is only there while armed, proved and nothing is wrong.
        #[test]
        fn no_sequence_leads_to_light_that_nobody_holds(
            steps in proptest::collection::vec((input(), 0_u64..1500), 60)
        ) {
            let (mut safety, mut sample, mut now) = (Safety::default(), Sample::default(), ms(0));
            let (mut armed_at, mut proved_at, mut wrong) = (None, None, false);
            for (input, wait) in steps {
                now += ms(wait);
                let before = safety.clone();
                match safety.step(input.clone(), now) {
                    Ok(actions) => actions.iter().for_each(|action| sample.obey(*action)),
                    Err(_) => prop_assert_eq!(&safety, &before, "a refusal changes nothing"),
                }
                match input {
                    Input::Arm if wrong || armed_at.is_none() => (armed_at, wrong) = (Some(now), false),
                    Input::Disarm => armed_at = None,
                    Input::Wrong(_) => (wrong, armed_at) = (true, None),
                    Input::Light | Input::Proof if sample.gates_open => proved_at = Some(now),
                    _ => {}
                }
                if let Phase::Tripped(_) = safety.phase() {
                    (wrong, armed_at) = (true, None);
                }
                if *safety.phase() == Phase::Dark {
                    armed_at = None;
                }
                if sample.gates_open || sample.emitting {
                    let armed = armed_at.ok_or_else(|| TestCaseError::fail("light without arming"))?;
                    prop_assert!(!wrong);
                    prop_assert!(now >= armed + INDICATOR);
                    let proved = proved_at.ok_or_else(|| TestCaseError::fail("light that nobody holds"))?;
                    if matches!(input, Input::Look | Input::Proof) {
                        prop_assert!(now <= proved + PROOF_TIMEOUT);
                    }
                    prop_assert!(safety.held_until().is_some());
                } else {
                    prop_assert_eq!(safety.held_until(), None);
                }
            }
        }
    }
}
