//! What the window sees of the instrument, and what it can ask for.
//!
//! In: nothing. Out: [`BenchStatus`] and [`Pictures`] as data, [`BenchCommand`]s, the trait [`Bench`] between both.
//! Never: waits, talks to a device. Fails: a command that cannot be taken says so.

use crate::reconstruction::{CameraLook, Quality, SofiLook};
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

/// The instrument behind the window. No call waits.
pub trait Bench {
    /// How things stand now; the same `Arc` as long as nothing has changed.
    fn status(&self) -> Arc<BenchStatus>;

    /// The newest pictures; the same `Arc`s as long as there are no newer ones.
    fn pictures(&self) -> Pictures;

    /// Asks for something. What becomes of it is told by the status and its events.
    ///
    /// # Errors
    /// [`Refused`] when too much is asked for already.
    fn ask(&self, command: BenchCommand) -> Result<(), Refused>;

    /// STOP: lasers off, motion stopped, run aborted; never queued behind other commands.
    fn stop(&self);

    /// Settings of the analysis or plan that a text describes: faults for people, or an estimate.
    ///
    /// # Errors
    /// All faults of the plan, one per line.
    fn judge_plan(&self, text: &str) -> Result<PlanEstimate, String>;
}

/// Too much is asked for already, or the instrument is gone.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("the instrument is busy with earlier commands; try again")]
pub struct Refused;

/// The newest pictures.
#[derive(Debug, Clone, Default)]
pub struct Pictures {
    /// Both cameras.
    pub cameras: Option<Arc<CameraLook>>,
    /// The running result.
    pub sofi: Option<Arc<SofiLook>>,
}

/// What can be asked for.
#[derive(Debug, Clone, PartialEq)]
pub enum BenchCommand {
    /// Open the simulated microscope.
    OpenSimulated,
    /// Open the instrument of a file.
    OpenInstrument(PathBuf),
    /// Close the instrument.
    CloseInstrument,
    /// Show the cameras and the running analysis, recording nothing; again with other settings while it goes on.
    Live(LiveSettings),
    /// Carry out a plan; recording and results go to a new directory.
    Run {
        /// YAML or JSON.
        plan: String,
        /// Must not exist yet.
        out: PathBuf,
    },
    /// Play a recording.
    Replay {
        /// The recording's directory.
        recording: PathBuf,
        /// Times the original speed; infinite for as fast as possible.
        speed: f64,
        /// First exposure to play.
        from: u64,
    },
    /// Hold the run, and go on after it.
    Pause,
    /// Go on after a pause.
    Resume,
    /// End what is under way in good order.
    Finish,
    /// Move the stage to a place, micrometers.
    MoveStage {
        /// Along the rows of the camera.
        x_um: f64,
        /// Along the columns.
        y_um: f64,
    },
    /// Write the images of the last run or live view as they are now into a new directory.
    SaveResults(PathBuf),
    /// Change a property of a device, see [`DeviceCard::properties`].
    SetProperty {
        /// Name of the device.
        device: String,
        /// Name of the property.
        property: String,
        /// As typed.
        value: String,
    },
}

/// How the live view is taken.
#[derive(Debug, Clone, PartialEq)]
pub struct LiveSettings {
    /// Time of one exposure and from exposure to exposure.
    pub exposure: Duration,
    /// Left, top, width, height in camera pixels; none for the whole sensor.
    pub region: Option<[u32; 4]>,
    /// Order of the cumulants.
    pub order: usize,
    /// Exposures per subsequence.
    pub subsequence: u64,
    /// Dyes by their names; empty for those of the instrument.
    pub species: Vec<String>,
    /// Laser lines that the person has armed, milliwatts by nanometers.
    pub laser_power_mw: BTreeMap<u32, f64>,
    /// Whether the focus lock shall hold.
    pub hold_focus: bool,
}

impl Default for LiveSettings {
    fn default() -> Self {
        Self {
            exposure: Duration::from_millis(20),
            region: None,
            order: 2,
            subsequence: 200,
            species: Vec::new(),
            laser_power_mw: BTreeMap::new(),
            hold_focus: false,
        }
    }
}

/// How things stand.
#[derive(Debug, Clone, PartialEq, Default)]
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
    /// What happened, oldest first; the newest 1000.
    pub events: Arc<Vec<Event>>,
    /// Recordings and results of this session and of earlier ones, newest first.
    pub recent: Arc<Vec<PathBuf>>,
    /// Where the last run left its files.
    pub last_saved: Option<PathBuf>,
}

/// What is under way.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
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
#[derive(Debug, Clone, PartialEq)]
pub struct InstrumentCard {
    /// Its name.
    pub name: String,
    /// "SIMULATED" or "VIRTUAL" where no hardware is involved.
    pub label: Option<&'static str>,
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
#[derive(Debug, Clone, PartialEq, Default)]
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
#[derive(Debug, Clone, PartialEq, Default)]
pub struct PropertyRow {
    /// Its name.
    pub name: String,
    /// Its value.
    pub value: String,
    /// Its unit; empty without one.
    pub unit: String,
    /// What it can be.
    pub range: String,
    /// Whether it can be changed.
    pub is_writable: bool,
}

/// Numbers of a run.
#[derive(Debug, Clone, PartialEq, Default)]
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
    /// Frames lost by reason.
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
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StageStatus {
    /// Micrometers.
    pub x_um: f64,
    /// Micrometers.
    pub y_um: f64,
    /// Whether it moves.
    pub is_moving: bool,
}

/// A laser line.
#[derive(Debug, Clone, PartialEq)]
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
#[derive(Debug, Clone, PartialEq, Default)]
pub struct FocusStatus {
    /// "off", "searching", "locked", "lost".
    pub state: String,
    /// Newest errors, nanometers, oldest first, with seconds before now.
    pub trace: Vec<(f64, f64)>,
    /// 0 to 1.
    pub quality: Option<f64>,
}

/// How grave an event is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Gravity {
    /// Good to know.
    Note,
    /// Something is not as it should be, and the result is complete.
    Warning,
    /// Something failed or was lost.
    Error,
}

/// Something that happened.
#[derive(Debug, Clone, PartialEq)]
pub struct Event {
    /// Local time of the day.
    pub time: String,
    /// How grave it is.
    pub gravity: Gravity,
    /// What happened and what to do.
    pub text: String,
}

/// What a plan will do.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct PlanEstimate {
    /// One line per check: passed, warned or failed, and why.
    pub checks: Vec<(Gravity, String)>,
    /// Whether it may begin.
    pub may_begin: bool,
    /// How long it takes, if that is certain.
    pub duration: Option<Duration>,
    /// Bytes that it records.
    pub bytes: Option<u64>,
    /// Series and exposures of each.
    pub series: usize,
    /// Exposures of each series.
    pub exposures: Option<u64>,
}
