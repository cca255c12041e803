//! How the instrument stands, as data.
//!
//! In: nothing. Out: [`BenchStatus`] and its parts. Never: waits, holds pixels. Fails: not at all.

use super::colors::ColorsStatus;
use super::registration::RegistrationStatus;
use crate::reconstruction::Quality;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

/// How things stand.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct BenchStatus {
    /// The open instrument.
    pub instrument: Option<Arc<InstrumentCard>>,
    /// What is under way.
    pub activity: Activity,
    /// Numbers of the run, live view or replay under way, or of the last one.
    pub run: RunNumbers,
    /// Quality after each subsequence of the same.
    pub quality: Arc<Vec<Quality>>,
    /// Where the stage is.
    pub stage: Option<StageStatus>,
    /// Laser lines, from the shortest.
    pub lasers: Vec<LaserStatus>,
    /// The focus lock.
    pub focus: Option<FocusStatus>,
    /// The registration of the cameras.
    pub registration: RegistrationStatus,
    /// How the dyes divide between the cameras.
    pub colors: ColorsStatus,
    /// The replay under way.
    pub replay: Option<ReplayStatus>,
    /// What happened, oldest first; the newest 1000.
    pub events: Arc<Vec<Event>>,
    /// Recordings and results of this session and of earlier ones, newest first.
    pub recent: Arc<Vec<PathBuf>>,
    /// Where the last run left its files.
    pub last_saved: Option<PathBuf>,
}

/// What is under way.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub enum Activity {
    /// No instrument is open.
    #[default]
    Closed,
    /// The instrument is being opened.
    Opening,
    /// Ready.
    Idle,
    /// The live view.
    Live,
    /// A plan.
    Run,
    /// A plan, held.
    Paused,
    /// A replay.
    Replay,
    /// Frames on their way are worked on, results written.
    Ending,
}

/// What does not change while an instrument is open.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct InstrumentCard {
    /// Its name.
    pub name: String,
    /// "SIMULATED" or "VIRTUAL" where no hardware is involved.
    pub label: Option<String>,
    /// Columns and rows of both sensors.
    pub sensor: (u32, u32),
    /// Shortest time between exposures.
    pub shortest_period: Duration,
    /// Longest exposure.
    pub longest_exposure: Duration,
    /// Side of a camera pixel in the sample, nanometers.
    pub pixel_pitch_nm: f64,
    /// The dichroic.
    pub dichroic: Option<String>,
    /// Dyes that the instrument's sample has, or that are asked for by default.
    pub species: Vec<String>,
    /// Dyes that can be asked for.
    pub known_species: Vec<String>,
    /// Whether there is a focus lock.
    pub has_focus: bool,
    /// Where the stage may go, micrometers: x and y from, to.
    pub stage_um: Option<[(f64, f64); 2]>,
    /// Devices, with their properties as read when they were opened.
    pub devices: Vec<DeviceCard>,
    /// Warnings for people: gates without a watchdog, and the like.
    pub warnings: Vec<String>,
    /// Plans that come with the program: name and text.
    pub plans: Vec<(String, String)>,
}

/// A device.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct DeviceCard {
    /// What it is for: "camera R".
    pub role: String,
    /// Maker, model, serial number.
    pub identity: String,
    /// Whether it is simulated.
    pub is_simulated: bool,
    /// Its properties.
    pub properties: Vec<PropertyRow>,
}

/// A property as the property browser shows it.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct PropertyRow {
    /// Its name.
    pub name: String,
    /// Its value.
    pub value: String,
    /// Its unit; empty without one.
    pub unit: String,
    /// What it can be, for people.
    pub range: String,
    /// What it can be, where there are only so many values; empty otherwise.
    pub choices: Vec<String>,
    /// Whether it can be changed.
    pub is_writable: bool,
}

/// Numbers of a run.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct RunNumbers {
    /// Where it is, for people.
    pub phase: String,
    /// Which series, from 1, and of how many.
    pub series: (usize, usize),
    /// Exposures settled.
    pub exposures: u64,
    /// Exposures of the series; none without a certain end.
    pub planned: Option<u64>,
    /// Frames received of both cameras.
    pub received: [u64; 2],
    /// Frames lost by reason, in words.
    pub lost: Vec<(String, u64)>,
    /// Pairs.
    pub pairs: u64,
    /// Pairs analyzed.
    pub pairs_analyzed: u64,
    /// Pairs that the analysis was not given.
    pub left_out: u64,
    /// Frames that the recording did not get.
    pub unrecorded: u64,
    /// Frames per second of R and T.
    pub frame_rate: [f64; 2],
    /// Fill of the queues to recording and analysis, 0 to 1.
    pub fill: [f64; 2],
    /// From the last frame of a picture to the picture.
    pub latency: Duration,
    /// Since the first exposure.
    pub elapsed: Duration,
    /// Until the end, if that is known.
    pub remaining: Option<Duration>,
    /// Bytes that the disk still has, where frames are recorded.
    pub disk_free: Option<u64>,
    /// How long that lasts at this rate.
    pub disk_left: Option<Duration>,
    /// Where the recording is.
    pub recording: Option<PathBuf>,
    /// Why it ended; empty while it goes on.
    pub ended: String,
}

/// Where the stage is.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct StageStatus {
    /// Micrometers.
    pub x_um: f64,
    /// Micrometers.
    pub y_um: f64,
    /// Whether it moves.
    pub is_moving: bool,
}

/// A laser line.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LaserStatus {
    /// Nanometers.
    pub wavelength_nm: u32,
    /// Highest power that the instrument allows, milliwatts.
    pub cap_mw: f64,
    /// Who it is.
    pub identity: String,
    /// Power that it was last told, milliwatts; 0 when off.
    pub power_mw: f64,
    /// Whether it emits, as read back; none where it cannot be read.
    pub is_emitting: Option<bool>,
    /// Whether the interlock is closed.
    pub interlock_closed: Option<bool>,
}

/// The focus lock.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct FocusStatus {
    /// "off", "searching", "probing", "locked", "lost".
    pub state: String,
    /// Newest errors, nanometers, oldest first, with seconds before now.
    pub trace: Vec<(f64, f64)>,
    /// Share of good readings lately, 0 to 1; none while nothing holds.
    pub quality: Option<f64>,
    /// Why it does not hold, or what a device said last, for people.
    pub reason: Option<String>,
    /// Place of the drive, micrometers.
    pub z_um: Option<f64>,
    /// Whether it knows how signal and focus error go together.
    pub is_calibrated: bool,
}

/// A replay under way.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ReplayStatus {
    /// What is played.
    pub recording: PathBuf,
    /// Exposures of the whole recording.
    pub exposures: u64,
    /// The exposure that it has come to.
    pub position: u64,
    /// Time from exposure to exposure in the recording.
    pub period: Duration,
    /// Times the original speed; infinite for as fast as possible.
    pub speed: f64,
    /// Whether it is held.
    pub is_paused: bool,
}

/// How grave an event is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Gravity {
    /// Good to know.
    Note,
    /// Something is not as it should be, and the result is complete.
    Warning,
    /// Something failed or was lost.
    Error,
}

/// Something that happened.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Event {
    /// Local time of the day.
    pub time: String,
    /// How grave it is.
    pub gravity: Gravity,
    /// What happened and what to do.
    pub text: String,
}
