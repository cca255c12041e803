//! Where in the recorded time a replay is, for both cameras together.
//!
//! In: the time now, pauses, speeds, arming and stopping. Out: when a frame is due.
//! Never: waits. Fails: never.

use sofiscope_hal::{Bell, Channel, Clock, HostTime};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// How fast a replay goes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ReplaySpeed {
    /// As fast as frames can be read and are taken.
    Max,
    /// So many times as fast as they were recorded, with the intervals of the recording.
    Times(f64),
}

/// The slowest and the fastest multiple; beyond it, times round to nothing.
const SPEEDS: std::ops::RangeInclusive<f64> = 1e-3..=1e6;

/// A speed that can be played.
fn tamed(speed: ReplaySpeed) -> ReplaySpeed {
    match speed {
        ReplaySpeed::Max => ReplaySpeed::Max,
        ReplaySpeed::Times(times) if times.is_nan() => ReplaySpeed::Times(1.0),
        ReplaySpeed::Times(times) => ReplaySpeed::Times(times.clamp(*SPEEDS.start(), *SPEEDS.end())),
    }
}

/// When something may go out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Due {
    /// Now.
    Now,
    /// At this time, unless something changes.
    At(HostTime),
    /// Not before something changes.
    Held,
    /// Never: the camera was stopped before.
    Never,
}

/// The recorded time that both cameras share.
#[derive(Debug)]
pub(super) struct Timeline {
    pub(super) clock: Arc<dyn Clock>,
    pub(super) bell: Bell,
    state: Mutex<State>,
}

#[derive(Debug, Clone, Copy)]
struct State {
    speed: ReplaySpeed,
    is_paused: bool,
    /// Time and position from which it goes on; `None` until the first frame is asked for.
    anchor: Option<(HostTime, f64)>,
    cameras: [Armed; 2],
    /// How often each camera was armed.
    runs: [u64; 2],
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Armed {
    No,
    Yes,
    /// Stopped at this position.
    Until(f64),
}

impl State {
    /// Nanoseconds of the recording that have passed.
    fn position(&self, now: HostTime) -> f64 {
        match (self.anchor, self.speed) {
            (None, _) => 0.0,
            (Some((_, at)), _) if self.is_paused => at,
            (Some((since, at)), ReplaySpeed::Times(times)) => {
                at + now.0.saturating_sub(since.0) as f64 * times
            }
            (Some((_, at)), ReplaySpeed::Max) => at,
        }
    }
}

impl Timeline {
    pub(super) fn new(clock: Arc<dyn Clock>, speed: ReplaySpeed) -> Self {
        let state = State {
            speed: tamed(speed),
            is_paused: false,
            anchor: None,
            cameras: [Armed::No; 2],
            runs: [0; 2],
        };
        Self { clock, bell: Bell::default(), state: Mutex::new(state) }
    }

    pub(super) fn pause(&self) {
        self.change(|state| state.is_paused = true);
    }

    pub(super) fn resume(&self) {
        self.change(|state| state.is_paused = false);
    }

    pub(super) fn is_paused(&self) -> bool {
        self.lock().is_paused
    }

    pub(super) fn set_speed(&self, speed: ReplaySpeed) {
        self.change(|state| state.speed = tamed(speed));
    }

    pub(super) fn speed(&self) -> ReplaySpeed {
        self.lock().speed
    }

    /// Whether no camera is armed.
    pub(super) fn is_idle(&self) -> bool {
        self.lock().cameras.iter().all(|camera| *camera != Armed::Yes)
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Changes something and goes on from here.
    fn change(&self, change: impl FnOnce(&mut State)) {
        let now = self.clock.now();
        {
            let mut state = self.lock();
            if state.anchor.is_some() {
                state.anchor = Some((now, state.position(now)));
            }
            change(&mut state);
        }
        self.bell.ring();
    }

    /// A camera is armed; time begins anew if the other is not. Gives the number of the run.
    pub(super) fn arm(&self, channel: Channel) -> u64 {
        let mut state = self.lock();
        if state.cameras[channel.other().index()] != Armed::Yes {
            state.anchor = None;
        }
        state.cameras[channel.index()] = Armed::Yes;
        state.runs[channel.index()] += 1;
        state.runs[channel.index()]
    }

    /// A camera is stopped: frames due until now are finished.
    pub(super) fn stop(&self, channel: Channel) {
        let now = self.clock.now();
        {
            let mut state = self.lock();
            state.cameras[channel.index()] = match (state.cameras[channel.index()], state.speed) {
                (Armed::Yes, ReplaySpeed::Times(_)) => Armed::Until(state.position(now)),
                (Armed::Yes, ReplaySpeed::Max) => Armed::Until(0.0),
                (already, _) => already,
            };
        }
        self.bell.ring();
    }

    /// When a frame at this position of the recording may go out, in nanoseconds from its begin.
    pub(super) fn due(&self, (channel, run): (Channel, u64), position_ns: u64, now: HostTime) -> Due {
        let mut state = self.lock();
        if state.runs[channel.index()] != run {
            return Due::Never;
        }
        let anchor = *state.anchor.get_or_insert((now, 0.0));
        let position = position_ns as f64;
        match state.cameras[channel.index()] {
            Armed::Until(end) if position < end => return Due::Now,
            Armed::Until(_) | Armed::No => return Due::Never,
            Armed::Yes => {}
        }
        match state.speed {
            _ if state.is_paused => Due::Held,
            ReplaySpeed::Max => {
                // What was played has passed, so that another speed goes on from here.
                state.anchor = Some((now, position.max(anchor.1)));
                Due::Now
            }
            ReplaySpeed::Times(times) => {
                let wait_ns = ((position - anchor.1) / times).ceil().max(0.0);
                let at = HostTime(anchor.0.0.saturating_add(wait_ns as u64));
                if at <= now { Due::Now } else { Due::At(at) }
            }
        }
    }
}
