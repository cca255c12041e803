//! The course of one run as a pure state machine.
//!
//! In: [`Input`]s, one after another. Out: [`Action`]s for whoever has the devices in hand, in the order to do them.
//! Never: waits, asks what time it is, leaves a phase without a way out.
//! Fails: not at all; an input that means nothing in a phase changes nothing.
//!
//! ```text
//! Idle ─► Preparing ─► Armed ─► Acquiring ◄─► Paused
//!             └──────────┴──────────┴───────────┴─► Draining ─► Closing ─► Idle
//! ```
//!
//! Every run that leaves `Idle` passes `Draining` and `Closing`: the way into `Draining` stops the trigger before the
//! cameras and turns the lasers off, the way into `Closing` writes the one stop record.

use std::fmt;

use serde::Serialize;

use super::stop_rule::StopReason;

/// Why a run ended; a later reason takes the place of an earlier one only if it is graver.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum FinishReason {
    /// All exposures of the plan are there.
    Completed,
    /// An end that the plan names was reached.
    StopRule(StopReason),
    /// A person ended it; everything up to there is kept.
    Stopped,
    /// A person ended it at once; what was on its way is lost and marked.
    Aborted,
    /// A device or the recording failed.
    Failed(String),
    /// A safety trip made everything dark; a person has to arm again.
    Tripped(String),
}

impl FinishReason {
    fn gravity(&self) -> u8 {
        match self {
            Self::Completed => 0,
            Self::StopRule(_) => 1,
            Self::Stopped => 2,
            Self::Aborted => 3,
            Self::Failed(_) => 4,
            Self::Tripped(_) => 5,
        }
    }

    /// The graver of two reasons, the first where they are alike.
    fn or(self, other: Self) -> Self {
        if other.gravity() > self.gravity() { other } else { self }
    }

    /// Whether the run did what the plan asked.
    #[must_use]
    pub fn is_success(&self) -> bool {
        matches!(self, Self::Completed | Self::StopRule(_))
    }
}

impl fmt::Display for FinishReason {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Completed => formatter.write_str("completed"),
            Self::StopRule(reason) => write!(formatter, "ended by its stop rule: {reason}"),
            Self::Stopped => formatter.write_str("stopped"),
            Self::Aborted => formatter.write_str("aborted"),
            Self::Failed(message) => write!(formatter, "failed: {message}"),
            Self::Tripped(message) => write!(formatter, "safety trip: {message}"),
        }
    }
}

/// Where a run is.
#[derive(Debug, Clone, PartialEq, Default)]
pub enum RunPhase {
    /// Nothing runs.
    #[default]
    Idle,
    /// Devices are being set up.
    Preparing,
    /// Cameras wait for the first exposure.
    Armed,
    /// Exposures are taken.
    Acquiring,
    /// Cameras are armed, but trigger and lasers are off.
    Paused,
    /// Devices are off; frames on their way are let through.
    Draining(FinishReason),
    /// The recording is being closed.
    Closing(FinishReason),
}

impl RunPhase {
    /// The name on screen and in logs.
    #[must_use]
    pub fn name(&self) -> &'static str {
        match self {
            Self::Idle => "idle",
            Self::Preparing => "preparing",
            Self::Armed => "armed",
            Self::Acquiring => "acquiring",
            Self::Paused => "paused",
            Self::Draining(_) | Self::Closing(_) => "finishing",
        }
    }
}

/// What happens to a run.
#[derive(Debug, Clone, PartialEq)]
pub enum Input {
    /// Set up the devices.
    Prepare,
    /// The devices are set up and the cameras armed.
    Prepared,
    /// Take exposures.
    Start,
    /// Hold on for a while.
    Pause,
    /// Go on after a pause.
    Resume,
    /// End in good order.
    Stop,
    /// End at once.
    Abort,
    /// Ctrl-C: the first is a stop, the second an abort.
    Interrupt,
    /// All exposures of the plan are there.
    AllExposures,
    /// An end that the plan names is reached.
    RuleReached(StopReason),
    /// A device failed.
    DeviceFailed(String),
    /// Light was taken away for safety.
    SafetyTrip(String),
    /// The recording or another part of the data path failed.
    RecordingFailed(String),
    /// Everything on its way is through.
    Drained,
    /// The recording is closed and its stop record written, or both were tried.
    Closed,
}

/// What is to be done.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Action {
    /// Move the stage, configure the cameras and compare what they read back.
    SetUpDevices,
    /// Arm all cameras and hand their streams to the data path.
    ArmCameras,
    /// Turn the lasers of the plan on.
    LasersOn,
    /// Start the trigger.
    StartTrigger,
    /// Stop the trigger.
    StopTrigger,
    /// Turn all lasers off.
    LasersOff,
    /// Stop all cameras.
    StopCameras,
    /// Let everything on its way through.
    DrainPipeline,
    /// Give up what is on its way, and mark it.
    AbandonPipeline,
    /// Close the recording.
    CloseRecording,
    /// Write how the run ended.
    WriteStopRecord,
}

const PREPARE: [Action; 2] = [Action::SetUpDevices, Action::ArmCameras];
const GO: [Action; 2] = [Action::LasersOn, Action::StartTrigger];
const HOLD: [Action; 2] = [Action::StopTrigger, Action::LasersOff];
/// Lasers do not wait for cameras, which may hang.
const DRAIN: [Action; 4] =
    [Action::StopTrigger, Action::LasersOff, Action::StopCameras, Action::DrainPipeline];
const GIVE_UP: [Action; 4] =
    [Action::LasersOff, Action::StopTrigger, Action::StopCameras, Action::AbandonPipeline];
const CLOSE: [Action; 2] = [Action::CloseRecording, Action::WriteStopRecord];

/// One run after another, each from `Idle` to `Idle`.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct RunState {
    phase: RunPhase,
    interrupts: u32,
}

impl RunState {
    /// Where the run is.
    #[must_use]
    pub fn phase(&self) -> &RunPhase {
        &self.phase
    }

    /// Takes one input and says what is to be done.
    #[must_use = "the actions are to be done"]
    pub fn step(&mut self, input: Input) -> Vec<Action> {
        let input = self.counted(input);
        let (phase, actions) = next(std::mem::take(&mut self.phase), input);
        self.phase = phase;
        if self.phase == RunPhase::Idle {
            self.interrupts = 0;
        }
        actions
    }

    fn counted(&mut self, input: Input) -> Input {
        if input != Input::Interrupt {
            return input;
        }
        self.interrupts = self.interrupts.saturating_add(1);
        if self.interrupts == 1 { Input::Stop } else { Input::Abort }
    }
}

fn next(phase: RunPhase, input: Input) -> (RunPhase, Vec<Action>) {
    use RunPhase::{Acquiring, Armed, Closing, Draining, Idle, Paused, Preparing};
    match (phase, input) {
        (Idle, Input::Prepare) => (Preparing, PREPARE.to_vec()),
        (Idle, _) => (Idle, Vec::new()),
        (Preparing, Input::Prepared) => (Armed, Vec::new()),
        (Armed, Input::Start) => (Acquiring, GO.to_vec()),
        (Acquiring, Input::Pause) => (Paused, HOLD.to_vec()),
        (Paused, Input::Resume) => (Acquiring, GO.to_vec()),
        (Draining(reason), Input::Drained) => (Closing(reason), CLOSE.to_vec()),
        (Draining(reason), Input::Abort) => {
            let actions = [Action::AbandonPipeline].into_iter().chain(CLOSE).collect();
            (Closing(reason.or(FinishReason::Aborted)), actions)
        }
        (Closing(_), Input::Closed) => (Idle, Vec::new()),
        (Draining(reason), input) => (Draining(graver(reason, input)), Vec::new()),
        (Closing(reason), input) => (Closing(graver(reason, input)), Vec::new()),
        (running, input) => end(running, input),
    }
}

/// Failures that come while a run ends are its reason from then on.
fn graver(reason: FinishReason, input: Input) -> FinishReason {
    match input {
        Input::DeviceFailed(message) | Input::RecordingFailed(message) => {
            reason.or(FinishReason::Failed(message))
        }
        Input::SafetyTrip(message) => reason.or(FinishReason::Tripped(message)),
        _ => reason,
    }
}

/// The ways out of every phase with devices under way.
fn end(running: RunPhase, input: Input) -> (RunPhase, Vec<Action>) {
    let reason = match input {
        Input::Stop => FinishReason::Stopped,
        Input::AllExposures => FinishReason::Completed,
        Input::RuleReached(reason) => FinishReason::StopRule(reason),
        Input::DeviceFailed(message) | Input::RecordingFailed(message) => FinishReason::Failed(message),
        Input::SafetyTrip(message) => FinishReason::Tripped(message),
        Input::Abort => {
            let actions = GIVE_UP.into_iter().chain(CLOSE).collect();
            return (RunPhase::Closing(FinishReason::Aborted), actions);
        }
        _ => return (running, Vec::new()),
    };
    (RunPhase::Draining(reason), DRAIN.to_vec())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn any_input() -> impl Strategy<Value = Input> {
        prop_oneof![
            4 => Just(Input::Prepare),
            4 => Just(Input::Prepared),
            4 => Just(Input::Start),
            2 => Just(Input::Pause),
            2 => Just(Input::Resume),
            1 => Just(Input::Stop),
            1 => Just(Input::Abort),
            1 => Just(Input::Interrupt),
            1 => Just(Input::AllExposures),
            1 => Just(Input::RuleReached(StopReason::Frames { frames: 7 })),
            1 => Just(Input::DeviceFailed("gone".to_owned())),
            1 => Just(Input::SafetyTrip("nobody there".to_owned())),
            1 => Just(Input::RecordingFailed("full".to_owned())),
            3 => Just(Input::Drained),
            3 => Just(Input::Closed),
        ]
    }

    /// What devices would be doing after the actions so far.
    #[derive(Debug, Default)]
    struct Bench {
        lit: bool,
        pulsing: bool,
        armed: bool,
        open_runs: u32,
        records: u32,
        prepared: u32,
    }

    impl Bench {
        fn act(&mut self, action: Action) {
            match action {
                Action::SetUpDevices => {
                    assert!(!self.lit && !self.pulsing && !self.armed, "a run begins with quiet devices");
                    self.prepared += 1;
                    self.open_runs += 1;
                }
                Action::ArmCameras => self.armed = true,
                Action::LasersOn => self.lit = true,
                Action::StartTrigger => {
                    assert!(self.armed, "cameras are armed before the trigger starts");
                    self.pulsing = true;
                }
                Action::StopTrigger => self.pulsing = false,
                Action::LasersOff => self.lit = false,
                Action::StopCameras => {
                    assert!(!self.pulsing, "the trigger stops before the cameras");
                    self.armed = false;
                }
                Action::DrainPipeline | Action::AbandonPipeline => assert!(!self.armed),
                Action::CloseRecording => assert!(!self.lit && !self.pulsing && !self.armed),
                Action::WriteStopRecord => {
                    self.records += 1;
                    self.open_runs -= 1;
                }
            }
        }
    }

    fn play(state: &mut RunState, bench: &mut Bench, input: Input) -> Vec<Action> {
        let actions = state.step(input);
        actions.iter().for_each(|&action| bench.act(action));
        actions
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]

        #[test]
        fn every_course_ends_dark_with_one_record(inputs in prop::collection::vec(any_input(), 0..60)) {
            let (mut state, mut bench) = (RunState::default(), Bench::default());
            for input in inputs {
                let was_finishing = state.phase().name() == "finishing";
                let is_start = matches!(input, Input::Start | Input::Resume | Input::Prepare);
                let actions = play(&mut state, &mut bench, input);
                prop_assert!(!(was_finishing && is_start && !actions.is_empty()), "no start while finishing");
                let may_be_lit = *state.phase() == RunPhase::Acquiring;
                prop_assert_eq!(bench.lit, may_be_lit);
                prop_assert_eq!(bench.pulsing, may_be_lit);
                prop_assert!(bench.open_runs <= 1);
            }
            // The way out, whatever the phase.
            for input in [Input::Stop, Input::Drained, Input::Closed] {
                play(&mut state, &mut bench, input);
            }
            prop_assert_eq!(state.phase(), &RunPhase::Idle);
            prop_assert_eq!((bench.records, bench.open_runs), (bench.prepared, 0));
            prop_assert!(!bench.lit && !bench.pulsing && !bench.armed);
        }

        #[test]
        fn a_second_stop_changes_nothing(inputs in prop::collection::vec(any_input(), 0..40)) {
            let mut state = RunState::default();
            for input in inputs {
                drop(state.step(input));
            }
            drop(state.step(Input::Stop));
            let before = state.clone();
            prop_assert_eq!(state.step(Input::Stop), Vec::new());
            prop_assert_eq!(state, before);
        }

        #[test]
        fn any_number_of_interrupts_leads_to_one_record(ctrl_c in 2..20_u32, phase in 0..4_usize) {
            let mut state = RunState::default();
            for input in [Input::Prepare, Input::Prepared, Input::Start, Input::Pause].into_iter().take(phase + 1) {
                drop(state.step(input));
            }
            let actions: Vec<Action> = (0..ctrl_c).flat_map(|_| state.step(Input::Interrupt)).collect();
            let records = actions.iter().filter(|&&action| action == Action::WriteStopRecord).count();
            prop_assert_eq!(records, 1);
            prop_assert_eq!(state.phase(), &RunPhase::Closing(FinishReason::Aborted));
            prop_assert_eq!(state.step(Input::Closed), Vec::new());
            prop_assert_eq!(state, RunState::default());
        }
    }

    #[test]
    fn a_run_goes_its_way() {
        let mut state = RunState::default();
        assert_eq!(state.step(Input::Prepare), PREPARE);
        assert_eq!(state.step(Input::Start), []);
        assert_eq!(state.step(Input::Prepared), []);
        assert_eq!(state.step(Input::Start), GO);
        assert_eq!(state.step(Input::Pause), HOLD);
        assert_eq!(state.step(Input::Resume), GO);
        assert_eq!(state.step(Input::AllExposures), DRAIN);
        assert_eq!(state.phase(), &RunPhase::Draining(FinishReason::Completed));
        assert_eq!(state.step(Input::Drained), CLOSE);
        assert_eq!(state.step(Input::Closed), []);
        assert_eq!(state.phase(), &RunPhase::Idle);
    }

    #[test]
    fn failures_while_finishing_are_the_reason() {
        let mut state = RunState::default();
        for input in [Input::Prepare, Input::Prepared, Input::Start, Input::Stop] {
            drop(state.step(input));
        }
        assert_eq!(state.step(Input::RecordingFailed("disk full".to_owned())), []);
        assert_eq!(state.step(Input::DeviceFailed("later".to_owned())), []);
        assert_eq!(state.phase(), &RunPhase::Draining(FinishReason::Failed("disk full".to_owned())));
        assert_eq!(state.step(Input::Abort)[0], Action::AbandonPipeline);
        assert_eq!(state.phase(), &RunPhase::Closing(FinishReason::Failed("disk full".to_owned())));
    }

    #[test]
    fn interrupts_are_counted_per_run() {
        let mut state = RunState::default();
        drop(state.step(Input::Prepare));
        assert_eq!(state.step(Input::Interrupt), DRAIN);
        assert_eq!(state.step(Input::Interrupt)[0], Action::AbandonPipeline);
        drop(state.step(Input::Closed));
        drop(state.step(Input::Interrupt));
        drop(state.step(Input::Prepare));
        assert_eq!(state.step(Input::Interrupt), DRAIN);
    }
}
