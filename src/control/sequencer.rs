//! The only hand: carries out the steps of a plan with real devices.
//!
//! In: [`AcquisitionEvent`]s, [`Command`]s from a bounded queue, devices, a [`DataPath`], a [`Clock`].
//! Out: a [`StopRecord`] for every series; [`Status`] on the way.
//! Never: sleeps (it waits for commands), starts the trigger before all cameras are armed, leaves a laser on,
//! takes what a camera does for what it was asked.
//! Fails: not at all; whatever fails ends the series, and the record says why.
//!
//! What is to be done and in which order is decided by [`RunState`]; here it is done.

mod devices;
mod readback;
#[cfg(test)]
mod tests;

use std::collections::VecDeque;
use std::time::Duration;

use crossbeam_channel::{Receiver, RecvTimeoutError, TryRecvError};
use sofiscope_hal::HostTime;

use super::contracts::{Clock, DataPath, DataPathError, Drain, PathProgress, StopRecord};
use super::plan::{AcquisitionEvent, FocusWish, OnRecordDrop, Plan};
use super::run_state::{Action, FinishReason, Input, RunPhase, RunState};
use super::stop_rule::{Progress, Verdict};

pub use devices::{CameraStation, Devices};
pub use readback::Mismatch;

/// What a person wants.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Command {
    /// Take exposures.
    Start,
    /// Hold on for a while; not possible where cameras run by themselves.
    Pause,
    /// Go on after a pause.
    Resume,
    /// End in good order.
    Stop,
    /// End at once.
    Abort,
    /// Ctrl-C: the first is a stop, the second an abort.
    Interrupt,
}

impl From<Command> for Input {
    fn from(command: Command) -> Self {
        match command {
            Command::Start => Self::Start,
            Command::Pause => Self::Pause,
            Command::Resume => Self::Resume,
            Command::Stop => Self::Stop,
            Command::Abort => Self::Abort,
            Command::Interrupt => Self::Interrupt,
        }
    }
}

/// When exposures begin.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Begin {
    /// As soon as everything is prepared.
    #[default]
    AtOnce,
    /// With [`Command::Start`].
    OnCommand,
}

/// How long the sequencer is patient.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Patience {
    /// Time between two looks at the data path, while no command comes.
    pub look: Duration,
    /// Without any exposure for this long, and for ten periods, the cameras have stalled.
    pub stall: Duration,
    /// Draining is given up after this time.
    pub drain: Duration,
    /// A series goes on after a pause when no exposure came for this long, and for four periods: those that were on
    /// their way when it was held are counted then, and are not made once more.
    pub settle: Duration,
}

impl Default for Patience {
    fn default() -> Self {
        Self {
            look: Duration::from_millis(20),
            stall: Duration::from_secs(2),
            drain: Duration::from_secs(10),
            settle: Duration::from_millis(300),
        }
    }
}

/// What the sequencer is made of.
pub struct Sequencer<'a> {
    /// The devices.
    pub devices: Devices,
    /// Where the frames go.
    pub path: &'a mut dyn DataPath,
    /// What persons want; the queue is bounded. When its other end is gone, the run is stopped.
    pub commands: Receiver<Command>,
    /// The clock.
    pub clock: &'a dyn Clock,
    /// Hears of every look at the data path and of every change of phase.
    pub observer: &'a mut dyn FnMut(&Status<'_>),
    /// When exposures begin.
    pub begin: Begin,
    /// How long it is patient.
    pub patience: Patience,
}

/// Where a series is.
#[derive(Debug)]
pub struct Status<'s> {
    /// Which series of the plan, from 0.
    pub series: usize,
    /// The phase of the run.
    pub phase: &'s RunPhase,
    /// How far it has come.
    pub progress: &'s Progress,
    /// Frames that the recording lost.
    pub record_drops: u64,
}

/// One series under way.
struct Series {
    event: AcquisitionEvent,
    state: RunState,
    progress: Progress,
    record_drops: u64,
    failures: Vec<String>,
    record: Option<StopRecord>,
    /// When the trigger was started last.
    since: Option<HostTime>,
    /// Acquired before that.
    before: Duration,
    /// When the last exposure was settled.
    moved: HostTime,
    /// Whether the loss of the focus lock has been told.
    is_unfocused: bool,
    /// Whether it shall go on as soon as all exposures of before the pause have come.
    wants_to_go_on: bool,
}

impl Series {
    fn new(event: AcquisitionEvent, now: HostTime) -> Self {
        Self {
            event,
            state: RunState::default(),
            progress: Progress::default(),
            record_drops: 0,
            failures: Vec::new(),
            record: None,
            since: None,
            before: Duration::ZERO,
            moved: now,
            is_unfocused: false,
            wants_to_go_on: false,
        }
    }

    fn is_idle(&self) -> bool {
        *self.state.phase() == RunPhase::Idle
    }

    fn count_time(&mut self, now: HostTime) {
        let running = self.since.map_or(Duration::ZERO, |since| now.since(since));
        self.progress.acquired = self.before + running;
        let power: f64 = self.event.laser_power_mw.values().sum();
        self.progress.dose_mj = power * self.progress.acquired.as_secs_f64();
    }

    fn take(&mut self, path: &PathProgress, now: HostTime) {
        if path.exposures > self.progress.frames {
            self.moved = now;
        }
        self.progress.frames = self.progress.frames.max(path.exposures);
        self.progress.snr.clone_from(&path.snr);
        self.progress.resolution_nm = path.resolution_nm;
        self.record_drops = path.record_drops;
    }

    fn pulses_left(&self) -> Option<u64> {
        self.event.exposures.map(|wanted| wanted.saturating_sub(self.progress.frames).max(1))
    }
}

impl Sequencer<'_> {
    /// Carries out a plan, series after series, until one ends otherwise than planned.
    pub fn run(&mut self, plan: &Plan) -> Vec<StopRecord> {
        let mut records = Vec::new();
        for event in plan.events() {
            let record = self.run_event(event);
            let is_success = record.reason.is_success();
            records.push(record);
            if !is_success {
                break;
            }
        }
        records
    }

    /// Carries out one series from setting up to its stop record.
    pub fn run_event(&mut self, event: AcquisitionEvent) -> StopRecord {
        let mut series = Series::new(event, self.clock.now());
        self.setup_event(&mut series);
        self.exec_event(&mut series);
        self.teardown_event(&mut series);
        series.record.expect("a series that was prepared is idle again only after its stop record")
    }

    /// Sets up the devices and arms the cameras; afterwards the series is armed or about to end.
    fn setup_event(&mut self, series: &mut Series) {
        self.feed(series, Input::Prepare);
        if *series.state.phase() == RunPhase::Preparing {
            self.feed(series, Input::Prepared);
        }
    }

    /// Takes exposures until an end is reached.
    fn exec_event(&mut self, series: &mut Series) {
        if self.begin == Begin::AtOnce {
            self.feed(series, Input::Start);
        }
        while matches!(series.state.phase(), RunPhase::Armed | RunPhase::Acquiring | RunPhase::Paused) {
            if let Some(command) = self.await_command(series) {
                self.obey(series, command);
            }
            for input in self.look(series) {
                self.feed(series, input);
            }
            self.go_on_when_settled(series);
            if *series.state.phase() == RunPhase::Acquiring
                && let Err(taken) = self.devices.hold()
            {
                self.fail(series, taken);
            }
            self.look_at_focus(series);
            self.tell(series);
        }
    }

    /// Frames without focus are kept: the stop record says that there are some.
    fn look_at_focus(&mut self, series: &mut Series) {
        if series.event.duties.focus == FocusWish::Off {
            return;
        }
        match self.devices.look_at_focus() {
            Ok(()) => series.is_unfocused = false,
            Err(error) if !series.is_unfocused => {
                series.is_unfocused = true;
                tracing::warn!("{error}");
                series.failures.push(format!("after {} exposures: {error}", series.progress.frames));
            }
            Err(_) => {}
        }
    }

    /// Lets frames through, closes the recording and writes the stop record; runs after every failure too.
    fn teardown_event(&mut self, series: &mut Series) {
        let begun = self.clock.now();
        while !series.is_idle() {
            match series.state.phase() {
                RunPhase::Draining(_) => self.drain(series, begun),
                RunPhase::Closing(_) => self.feed(series, Input::Closed),
                // Unreachable by the rules of the run state; the way out is the same from everywhere.
                _ => self.feed(series, Input::Stop),
            }
            self.tell(series);
        }
    }

    fn drain(&mut self, series: &mut Series, begun: HostTime) {
        match self.path.drain() {
            Ok(Drain::Done) => {
                let last = self.path.progress();
                series.take(&last, self.clock.now());
                self.feed(series, Input::Drained);
            }
            Err(error) => {
                self.fail(series, error);
                self.feed(series, Input::Drained);
            }
            Ok(Drain::UnderWay) if self.clock.now().since(begun) > self.patience.drain => {
                let message = format!(
                    "frames were still on their way {:.1} s after the end; they are given up",
                    self.patience.drain.as_secs_f64()
                );
                self.fail(series, DataPathError::Recording(message));
                self.feed(series, Input::Abort);
            }
            Ok(Drain::UnderWay) => {
                if let Ok(command) = self.commands.recv_timeout(self.patience.look) {
                    self.obey(series, command);
                }
            }
        }
    }

    /// Waits for a command; without anyone who could give one the series is stopped.
    fn await_command(&self, series: &Series) -> Option<Command> {
        match self.commands.recv_timeout(self.patience.look) {
            Ok(command) => Some(command),
            Err(RecvTimeoutError::Timeout) => None,
            Err(RecvTimeoutError::Disconnected) => {
                tracing::warn!(series = series.event.series, "no one can give commands any more: stopping");
                Some(Command::Stop)
            }
        }
    }

    fn obey(&mut self, series: &mut Series, command: Command) {
        if command == Command::Pause && !self.devices.can_pause() {
            tracing::warn!("a pause is not possible where cameras run by themselves; stop the run instead");
            return;
        }
        series.wants_to_go_on = command == Command::Resume && *series.state.phase() == RunPhase::Paused;
        if !series.wants_to_go_on {
            self.feed(series, command.into());
        }
    }

    fn go_on_when_settled(&mut self, series: &mut Series) {
        let period = self.devices.period().unwrap_or(series.event.cameras.period);
        let quiet = self.clock.now().since(series.moved);
        if series.wants_to_go_on && quiet >= self.patience.settle.max(4 * period) {
            series.wants_to_go_on = false;
            self.feed(series, Input::Resume);
        }
    }

    /// What the data path and the clock have to say.
    fn look(&mut self, series: &mut Series) -> Vec<Input> {
        let (path, now) = (self.path.progress(), self.clock.now());
        series.take(&path, now);
        series.count_time(now);
        let mut inputs = Vec::new();
        if let Some(failure) = path.failure {
            series.failures.push(failure.to_string());
            inputs.push(failed(failure));
        }
        if path.record_drops > 0 && series.event.duties.on_record_drop == OnRecordDrop::Stop {
            let lost = path.record_drops;
            let message = format!("the recording lost {lost} frames; everything before them is kept");
            series.failures.push(message.clone());
            inputs.push(Input::RecordingFailed(message));
        }
        if *series.state.phase() == RunPhase::Acquiring {
            inputs.extend(self.ends(series, now));
        }
        inputs
    }

    fn ends(&self, series: &mut Series, now: HostTime) -> Option<Input> {
        if series.event.exposures.is_some_and(|wanted| series.progress.frames >= wanted) {
            return Some(Input::AllExposures);
        }
        if let Verdict::Stop(reason) = series.event.stop.judge(&series.progress) {
            return Some(Input::RuleReached(reason));
        }
        let period = self.devices.period().unwrap_or(series.event.cameras.period);
        let quiet = now.since(series.moved);
        if quiet <= self.patience.stall.max(period * 10) {
            return None;
        }
        // All pulses were given: what is missing was lost at the end, and the ledger says so.
        let wanted = series.event.exposures.map(|wanted| period.as_secs_f64() * wanted as f64);
        if series.progress.frames > 0
            && wanted.is_some_and(|wanted| series.progress.acquired.as_secs_f64() > wanted)
        {
            return Some(Input::AllExposures);
        }
        let message = format!(
            "no exposure came for {:.1} s after {} of them; check cables, power and the trigger of the cameras",
            quiet.as_secs_f64(),
            series.progress.frames
        );
        series.failures.push(message.clone());
        Some(Input::DeviceFailed(message))
    }

    /// Gives one input to the run and does what follows from it.
    fn feed(&mut self, series: &mut Series, input: Input) {
        let mut actions: VecDeque<Action> = series.state.step(input).into();
        while let Some(action) = actions.pop_front() {
            let outcome = self.act(series, action);
            let input = match outcome {
                Ok(()) => self.waiting_command(series),
                Err(error) => {
                    series.failures.push(error.to_string());
                    Some(failed(error))
                }
            };
            // New actions end the series, so what was left of the old ones is void.
            let next = input.map(|input| series.state.step(input)).unwrap_or_default();
            if !next.is_empty() {
                actions = next.into();
            }
        }
    }

    /// A stop does not wait until everything is set up.
    fn waiting_command(&self, series: &Series) -> Option<Input> {
        if *series.state.phase() != RunPhase::Preparing {
            return None;
        }
        match self.commands.try_recv() {
            Ok(command) => Some(command.into()),
            Err(TryRecvError::Empty) => None,
            Err(TryRecvError::Disconnected) => Some(Input::Stop),
        }
    }

    fn act(&mut self, series: &mut Series, action: Action) -> Result<(), DataPathError> {
        tracing::debug!(series = series.event.series, ?action);
        match action {
            Action::SetUpDevices => self.devices.set_up(&series.event),
            Action::ArmCameras => {
                let armed = self.devices.arm()?;
                self.path.arm(&series.event, armed)
            }
            Action::LasersOn => self.devices.lasers_on(&series.event.laser_power_mw),
            Action::StartTrigger => {
                let pulses = series.pulses_left();
                series.moved = self.clock.now();
                series.since = Some(series.moved);
                self.devices.start_trigger(pulses)
            }
            Action::StopTrigger => self.devices.stop_trigger(),
            Action::LasersOff => {
                series.count_time(self.clock.now());
                series.before = series.progress.acquired;
                series.since = None;
                self.devices.lasers_off()
            }
            Action::StopCameras => self.devices.stop_cameras(),
            Action::DrainPipeline => Ok(()),
            Action::AbandonPipeline => {
                self.path.abandon();
                Ok(())
            }
            Action::CloseRecording => self.path.close(),
            Action::WriteStopRecord => self.write_record(series),
        }
    }

    fn write_record(&mut self, series: &mut Series) -> Result<(), DataPathError> {
        let reason = match series.state.phase() {
            RunPhase::Draining(reason) | RunPhase::Closing(reason) => reason.clone(),
            _ => FinishReason::Stopped,
        };
        let mut record = StopRecord {
            series: series.event.series,
            reason,
            exposures: series.progress.frames,
            record_drops: series.record_drops,
            acquired_s: series.progress.acquired.as_secs_f64(),
            dose_mj: series.progress.dose_mj,
            failures: series.failures.clone(),
        };
        let written = self.path.write_stop_record(&record);
        if let Err(error) = &written {
            record.reason = FinishReason::Failed(error.to_string());
            record.failures.push(error.to_string());
        }
        series.record = Some(record);
        written
    }

    fn fail(&mut self, series: &mut Series, error: DataPathError) {
        series.failures.push(error.to_string());
        self.feed(series, failed(error));
    }

    fn tell(&mut self, series: &Series) {
        (self.observer)(&Status {
            series: series.event.series,
            phase: series.state.phase(),
            progress: &series.progress,
            record_drops: series.record_drops,
        });
    }
}

fn failed(error: DataPathError) -> Input {
    match error {
        DataPathError::Device(message) => Input::DeviceFailed(message),
        DataPathError::Recording(message) => Input::RecordingFailed(message),
        DataPathError::Safety(message) => Input::SafetyTrip(message),
    }
}
