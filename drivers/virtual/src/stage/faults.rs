//! What can go wrong with the controller and its stage.

use std::time::Duration;

/// How a move ends on half of its way.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Jam {
    /// It stands and says that it moves, until it is aborted.
    Moving,
    /// The letter for a timeout.
    Timeout,
    /// The letter for an end switch.
    Switch,
    /// It stands and says that it is ready, as after lost steps that an encoder has seen.
    Short,
}

/// Faults of the controller; those of the line are [`WireFaults`](sofiscope_serial_line::WireFaults).
#[derive(Debug, Clone, PartialEq, Default)]
pub struct StageFaults {
    /// What happens to the next move.
    pub jam: Option<Jam>,
    /// Error of the next command that sets something, beside units and autostatus.
    pub refuse: Option<u16>,
    /// A lasting state in which nothing moves: 27 emergency stop, 29 amplifiers off.
    pub condition: Option<u16>,
    /// Whether a line of autostatus stands before every answer.
    pub talks_between: bool,
    /// How late the next answer is.
    pub late: Option<Duration>,
    /// Answers that are not given; `usize::MAX` for a controller that is silent for good.
    pub silent: usize,
    /// Answers that are still given before those.
    pub spared: usize,
}
