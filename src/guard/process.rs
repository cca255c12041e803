//! The guard's own loop.
//!
//! In: a socket and a [`Builder`] of devices. Out: light that somebody holds, and darkness else.
//! Never: waits for a device. Fails: with what could not be opened; whatever was opened is dark then.

use std::collections::{BTreeMap, BTreeSet};
use std::io;
use std::os::unix::net::UnixStream;
use std::thread::JoinHandle;
use std::time::Duration;

use crossbeam_channel::{Receiver, Sender, bounded};
use sofiscope_hal::{DeviceError, ErrorKind, GatePattern, Milliwatts};

use super::lights::{Controller, Event, GateJob, Gates, Hold, LaserJob, LaserStation, Line};
use super::message::{
    Answer, FromGuard, LightsState, LineState, Messages, Numbered, Received, RefusedKind, Request,
};
use super::safety::{Action, Input, Phase, Refusal, Safety, Trip};

/// Longest time without a look at the clock.
const LOOK: Duration = Duration::from_millis(10);
/// Events that may wait for the loop.
const EVENTS: usize = 64;

/// Makes the devices that an instrument file names.
pub trait Builder {
    /// Opens the trigger controller.
    ///
    /// # Errors
    /// [`DeviceError`] with what was looked for and what was found.
    fn controller(&mut self, instrument: &str) -> Result<Box<dyn Controller>, DeviceError>;

    /// Opens the lasers; some of them get their power through the controller.
    ///
    /// # Errors
    /// [`DeviceError`] with what was looked for and what was found.
    fn lasers(&mut self, gates: &Gates) -> Result<Vec<LaserStation>, DeviceError>;
}

/// Guards the light until the other end of the socket is gone.
///
/// # Errors
/// When the socket fails; everything is dark then.
pub fn serve(socket: UnixStream, builder: &mut dyn Builder) -> io::Result<()> {
    let mut messages = Messages::new(socket);
    let Some((number, instrument)) = setup(&mut messages)? else { return Ok(()) };
    let mut guard = match Guard::build(&instrument, builder) {
        Ok(guard) => guard,
        Err(error) => return messages.send(&answer(number, refused(&error))),
    };
    messages.send(&answer(number, Answer::State(Box::new(guard.state()))))?;
    let outcome = guard.watch(&mut messages);
    guard.end();
    match outcome {
        // Who is gone cannot be told any more; everything is dark.
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(()),
        outcome => outcome,
    }
}

fn setup(messages: &mut Messages) -> io::Result<Option<(u64, String)>> {
    loop {
        match messages.receive(Duration::from_secs(1))? {
            Received::Message(Numbered { number, request: Request::Setup(text) }) => {
                return Ok(Some((number, text)));
            }
            Received::Message(_) => return Err(io::Error::other("the first request must name the devices")),
            Received::Nothing => {}
            Received::Gone => return Ok(None),
        }
    }
}

/// Light that is being made: lasers first, gates when all of them are there.
struct Lighting {
    number: u64,
    waiting: BTreeSet<u64>,
    open: GatePattern,
}

struct Guard {
    safety: Safety,
    hold: Hold,
    gates: Gates,
    lines: Vec<Line>,
    threads: Vec<JoinHandle<()>>,
    events: Receiver<Event>,
    lighting: Option<Lighting>,
    /// Requests that wait for a job, by ticket.
    waiting: BTreeMap<u64, u64>,
    ticket: u64,
    proof: u64,
    told: Option<Trip>,
}

impl Guard {
    fn build(instrument: &str, builder: &mut dyn Builder) -> Result<Self, DeviceError> {
        let (sender, events) = bounded(EVENTS);
        let hold = Hold::default();
        let controller = builder.controller(instrument)?;
        let no_thread =
            |error: io::Error| DeviceError::new(ErrorKind::Busy, "laser guard", error.to_string());
        let (gates, thread) = Gates::spawn(controller, hold.clone(), sender.clone()).map_err(no_thread)?;
        let mut threads = vec![thread];
        let lines = Self::lines(builder, &gates, &sender, &mut threads)?;
        gates.close();
        lines.iter().for_each(Line::darken);
        Ok(Self {
            safety: Safety::default(),
            hold,
            gates,
            lines,
            threads,
            events,
            lighting: None,
            waiting: BTreeMap::new(),
            ticket: 0,
            proof: 0,
            told: None,
        })
    }

    fn lines(
        builder: &mut dyn Builder,
        gates: &Gates,
        events: &Sender<Event>,
        threads: &mut Vec<JoinHandle<()>>,
    ) -> Result<Vec<Line>, DeviceError> {
        let mut lines = Vec::new();
        for station in builder.lasers(gates)? {
            if station.gate >= gates.capabilities().gates {
                return Err(DeviceError::new(
                    ErrorKind::OutOfRange,
                    station.laser.identity().to_string(),
                    format!(
                        "gate {} is not there; {} has {}",
                        station.gate,
                        gates.identity(),
                        gates.capabilities().gates
                    ),
                ));
            }
            let (line, thread) = Line::spawn(station, events.clone())
                .map_err(|error| DeviceError::new(ErrorKind::Busy, "laser guard", error.to_string()))?;
            lines.push(line);
            threads.push(thread);
        }
        Ok(lines)
    }

    fn watch(&mut self, messages: &mut Messages) -> io::Result<()> {
        loop {
            match messages.receive(LOOK) {
                Ok(Received::Message(asked)) => self.obey(asked, messages)?,
                Ok(Received::Nothing) => {}
                Ok(Received::Gone) => {
                    self.feed(Input::Wrong(Trip::InstrumentGone));
                    return Ok(());
                }
                Err(error) => {
                    self.feed(Input::Wrong(Trip::InstrumentGone));
                    return Err(error);
                }
            }
            self.feed(Input::Look);
            while let Ok(event) = self.events.try_recv() {
                self.hear(event, messages)?;
            }
            self.tell_trips(messages)?;
        }
    }

    fn obey(&mut self, asked: Numbered, messages: &mut Messages) -> io::Result<()> {
        let number = asked.number;
        let reply = match asked.request {
            Request::Proof(proof) => {
                // The same number twice is no progress.
                if proof != self.proof {
                    self.proof = proof;
                    self.feed(Input::Proof);
                }
                return Ok(());
            }
            Request::Setup(_) => Some(refused_as(RefusedKind::OutOfRange, "the devices are set up already")),
            Request::Arm => {
                self.told = None;
                Some(self.ask(Input::Arm))
            }
            Request::Disarm => Some(self.ask(Input::Disarm)),
            Request::Darken => Some(self.ask(Input::Darken)),
            Request::Light(powers) => self.light(number, &powers),
            Request::StartTrain { period_ns, pulses } => {
                let period = Duration::from_nanos(period_ns);
                self.post(number, GateJob::StartTrain(period, pulses))
            }
            Request::StopTrain => self.post(number, GateJob::StopTrain),
            Request::State => Some(Answer::State(Box::new(self.state()))),
        };
        reply.map_or(Ok(()), |reply| messages.send(&answer(number, reply)))
    }

    /// Checks everything before anything is done.
    fn light(&mut self, number: u64, powers: &BTreeMap<u32, f64>) -> Option<Answer> {
        let mut wanted = Vec::new();
        for (&wavelength, &power) in powers {
            let Some(line) = self.lines.iter().position(|line| line.wavelength_nm() == wavelength) else {
                let lines: Vec<String> =
                    self.lines.iter().map(|line| line.wavelength_nm().to_string()).collect();
                let message =
                    format!("there is no laser of {wavelength} nm; lines are {} nm", lines.join(", "));
                return Some(refused_as(RefusedKind::OutOfRange, message));
            };
            let cap = self.lines[line].power_cap();
            match Milliwatts::new(power) {
                Ok(power) if power >= Milliwatts::ZERO && power <= cap => {
                    if power > Milliwatts::ZERO {
                        wanted.push((line, power));
                    }
                }
                _ => {
                    let message = format!("{power} mW at {wavelength} nm is outside of 0 to {cap}");
                    return Some(refused_as(RefusedKind::OutOfRange, message));
                }
            }
        }
        if wanted.is_empty() {
            return Some(self.ask(Input::Darken));
        }
        if let Err(refusal) = self.step(Input::Light) {
            return Some(refusal);
        }
        let open =
            wanted.iter().fold(GatePattern::CLOSED, |open, (line, _)| open.with(self.lines[*line].gate()));
        let mut waiting = BTreeSet::new();
        for (index, line) in self.lines.iter().enumerate() {
            let job = wanted.iter().find(|(wanted, _)| *wanted == index);
            let job = job.map_or(LaserJob::Dark, |(_, power)| LaserJob::Emit(*power));
            self.ticket += 1;
            waiting.insert(self.ticket);
            if let Err(error) = line.post(self.ticket, job) {
                self.feed(Input::Wrong(Trip::DeviceFault(error.to_string())));
                return Some(refused(&error));
            }
        }
        self.lighting = Some(Lighting { number, waiting, open });
        None
    }

    fn post(&mut self, number: u64, job: GateJob) -> Option<Answer> {
        self.ticket += 1;
        match self.gates.post(self.ticket, job) {
            Ok(()) => {
                self.waiting.insert(self.ticket, number);
                None
            }
            Err(error) => Some(refused(&error)),
        }
    }

    fn hear(&mut self, event: Event, messages: &mut Messages) -> io::Result<()> {
        match event {
            Event::Wrong(trip) => self.feed(Input::Wrong(trip)),
            Event::Settled { ticket, outcome } => {
                if let Some(number) = self.waiting.remove(&ticket) {
                    let reply = outcome.map_or_else(|error| refused(&error), |()| Answer::Done);
                    return messages.send(&answer(number, reply));
                }
                if let Some(reply) = self.lit(ticket, outcome) {
                    return messages.send(&reply);
                }
            }
        }
        Ok(())
    }

    /// One laser more, or one that fails; the gates open when all are there.
    fn lit(&mut self, ticket: u64, outcome: Result<(), DeviceError>) -> Option<FromGuard> {
        let lighting = self.lighting.as_mut()?;
        if !lighting.waiting.remove(&ticket) {
            return None;
        }
        let number = lighting.number;
        if let Err(error) = outcome {
            self.lighting = None;
            self.feed(Input::Wrong(Trip::DeviceFault(error.to_string())));
            return Some(answer(number, refused(&error)));
        }
        if !lighting.waiting.is_empty() {
            return None;
        }
        let open = lighting.open;
        self.lighting = None;
        self.post(number, GateJob::Open(open)).map(|refusal| answer(number, refusal))
    }

    fn ask(&mut self, input: Input) -> Answer {
        self.step(input).map_or_else(|refusal| refusal, |()| Answer::Done)
    }

    fn feed(&mut self, input: Input) {
        // What is fed, and not asked, is never refused.
        let _ = self.step(input);
    }

    fn step(&mut self, input: Input) -> Result<(), Answer> {
        let outcome = self.safety.step(input, self.hold.now());
        self.hold.set(self.safety.held_until());
        match outcome {
            Ok(actions) => {
                actions.iter().for_each(|action| self.act(*action));
                Ok(())
            }
            Err(refusal) => Err(refused_as(
                match refusal {
                    Refusal::Indicator(_) => RefusedKind::Indicator,
                    Refusal::NotArmed | Refusal::Tripped => RefusedKind::Safety,
                },
                match self.safety.phase() {
                    Phase::Tripped(trip) => format!("{refusal} ({trip})"),
                    _ => refusal.to_string(),
                },
            )),
        }
    }

    fn act(&mut self, action: Action) {
        match action {
            Action::CloseGates => self.gates.close(),
            Action::DarkenLasers => {
                self.lighting = None;
                self.lines.iter().for_each(Line::darken);
            }
            Action::ArmGates => {
                self.ticket += 1;
                if let Err(error) = self.gates.post(self.ticket, GateJob::Arm) {
                    tracing::error!("the gates were not armed: {error}");
                }
            }
            // Done step by step in `light`, as each laser takes its time.
            Action::Shine => {}
        }
    }

    fn tell_trips(&mut self, messages: &mut Messages) -> io::Result<()> {
        match self.safety.phase() {
            Phase::Tripped(trip) if self.told.as_ref() != Some(trip) => {
                self.told = Some(trip.clone());
                tracing::error!("lasers off: {trip}");
                messages.send(&FromGuard::Tripped(trip.clone()))
            }
            _ => Ok(()),
        }
    }

    fn state(&self) -> LightsState {
        let lines = self.lines.iter().map(|line| LineState {
            identity: line.identity().clone(),
            wavelength_nm: line.wavelength_nm(),
            gate: line.gate(),
            laser: line.state(),
        });
        LightsState {
            phase: self.safety.phase().clone(),
            controller: self.gates.identity().clone(),
            has_watchdog: self.gates.capabilities().watchdog.is_some(),
            gates: self.gates.state(),
            lines: lines.collect(),
        }
    }

    /// Closes the ports with everything dark.
    fn end(self) {
        self.hold.set(None);
        self.gates.close();
        let Self { gates, lines, threads, events, .. } = self;
        drop((gates, lines));
        for thread in threads {
            if thread.join().is_err() {
                tracing::error!("a thread of the guard failed; check that all lasers are off");
            }
        }
        drop(events);
    }
}

fn answer(number: u64, answer: Answer) -> FromGuard {
    FromGuard::Answer { number, answer }
}

fn refused(error: &DeviceError) -> Answer {
    let kind = match error.kind() {
        ErrorKind::OutOfRange => RefusedKind::OutOfRange,
        _ => RefusedKind::Device,
    };
    refused_as(kind, error.to_string())
}

fn refused_as(kind: RefusedKind, message: impl Into<String>) -> Answer {
    Answer::Refused { kind, message: message.into() }
}

#[cfg(test)]
mod tests;
