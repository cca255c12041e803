//! Everything that an instrument file names, opened in the order in which it is safe: lasers dark first.

use sofiscope_hal::{Camera, Channel, Micrometers, MillimetersPerSecond, Region, Stage, TriggerSource};
use sofiscope_maerzhaeuser_tango::{LINE_SETTINGS, Tango, TangoSettings};
use sofiscope_micromanager_teensy_pulse::TeensyPulse;
use sofiscope_serial_line::Line;
use std::time::Duration;

use super::super::AppError;
use super::super::session::stop_with_interrupts;
use super::super::simulated::{Rig, RigFacts};
use super::cameras;
use super::drive::AwaitedStage;
use super::guarded::Guarded;
use super::stage_thread::StageHandle;
use crate::acquisition::FocusGauge;
use crate::config::{Instrument, StageEntry, StageLink, TriggerKind};
use crate::control::contracts::{FocusHold, Illumination, NoLasers, StageDrive};
use crate::control::focus_lock::FocusRemote;
use crate::control::sequencer::{CameraStation, Devices};

/// The stage is never faster than this, millimeters per second.
const FASTEST_STAGE: f64 = 20.0;
/// How far from its target a move may end, micrometers.
const STAGE_TOLERANCE: f64 = 1.0;
/// Width of the pulses of a clock of its own.
const PULSE_WIDTH: Duration = Duration::from_millis(1);

/// An instrument whose devices are open.
pub(in crate::app) struct Opened {
    /// For the sequencer.
    pub(in crate::app) rig: Rig,
    /// Whether the devices are virtual ones: no hardware is involved.
    pub(in crate::app) is_virtual: bool,
    /// Everything that answered, for people.
    pub(in crate::app) identities: Vec<String>,
    /// The stage, for whoever moves it beside the sequencer.
    pub(in crate::app) stage: Option<StageHandle>,
    /// What lasers and gates say of themselves, if there are any.
    pub(in crate::app) lights: Option<Guarded>,
    /// The focus lock, for whoever asks and looks beside the sequencer.
    pub(in crate::app) focus: Option<FocusRemote>,
    /// What people must know.
    pub(in crate::app) warnings: Vec<String>,
}

/// Opens the instrument; `text` is its file, which the laser guard reads for itself.
///
/// # Errors
/// [`AppError::Device`] with the device that could not be opened; everything opened before is dark and still.
pub(in crate::app) fn open(instrument: &Instrument, text: &str) -> Result<Opened, AppError> {
    let hardware = instrument.hardware();
    let guard = match &hardware.gates {
        Some(_) => Some(Guarded::start(text)?),
        None => None,
    };
    let mut warnings = Vec::new();
    if let Some((guard, state)) = &guard {
        tracing::info!(process = guard.process_id(), controller = %state.controller, "laser guard");
        if !state.has_watchdog {
            warnings.push(format!(
                "the trigger controller ({}) has no watchdog: only the laser guard closes its gates, and nothing \
                 does when the guard itself is killed",
                state.controller
            ));
        }
    }
    let mut identities = Vec::new();
    let guard = guard.map(|(guard, state)| {
        identities.push(state.controller.to_string());
        let lines = state
            .lines
            .iter()
            .map(|line| format!("{} nm: {}, gate {}", line.wavelength_nm, line.identity, line.gate));
        identities.extend(lines);
        guard
    });
    let trigger: Option<Box<dyn TriggerSource>> = match (instrument.trigger(), &hardware.clock, &guard) {
        (TriggerKind::Gates, _, Some(guard)) => Some(Box::new(guard.clone())),
        (TriggerKind::TeensyPulse, Some(port), _) => {
            let line = Line::open(&port.path, TeensyPulse::line_settings(), "camera clock")?;
            Some(Box::new(TeensyPulse::connect(line, PULSE_WIDTH)?))
        }
        _ => None,
    };
    let stage = match &hardware.stage {
        None => None,
        Some(entry) => {
            let stage = stage(entry)?;
            identities.push(stage.identity().to_string());
            let handle = StageHandle::spawn(Box::new(stage))?;
            stop_with_interrupts(handle.stopper());
            Some(handle)
        }
    };
    let [Some(r), Some(t)] = Channel::BOTH.map(|channel| instrument.camera(channel)) else {
        return Err(AppError::Usage("a run needs both cameras; name both in the instrument file".to_owned()));
    };
    let cameras = [cameras::open(r)?, cameras::open(t)?];
    for (entry, camera) in [r, t].into_iter().zip(&cameras) {
        let identity = camera.identity();
        identities.push(format!(
            "{}: {} {}, S/N {}",
            entry.channel, identity.vendor, identity.model, identity.serial
        ));
    }
    let lights = guard.clone();
    let lasers: Box<dyn Illumination> = match guard {
        Some(guard) => Box::new(guard),
        None => Box::new(NoLasers),
    };
    let (focus, focus_gauge, remote) = match &hardware.focus {
        None => (None, FocusGauge::default(), None),
        Some(entry) => {
            let focus = super::focus::open(entry, hardware.virtual_devices.as_ref())?;
            identities.push("focus lock: Nano-Drive and spot camera".to_owned());
            let error = focus.error();
            let gauge = FocusGauge::new(move || error.now_nm());
            let remote = focus.remote();
            (Some(Box::new(focus) as Box<dyn FocusHold>), gauge, Some(remote))
        }
    };
    let drive = stage.clone().map(|stage| Box::new(stage) as Box<dyn StageDrive>);
    let mut rig = rig(instrument, cameras, trigger, lasers, drive);
    rig.devices = rig.devices.with_focus(focus);
    rig.facts.focus = focus_gauge;
    let is_virtual = hardware.virtual_devices.is_some();
    Ok(Opened { rig, is_virtual, identities, stage, lights, focus: remote, warnings })
}

/// Lets the stage find its end switches; whoever asks for it has retracted the objective.
///
/// # Errors
/// [`AppError`] when there is no stage, or it does not find them.
pub(in crate::app) fn home(instrument: &Instrument) -> Result<(), AppError> {
    let entry = instrument.hardware().stage.as_ref();
    let entry = entry.ok_or_else(|| AppError::Usage("the instrument file has no `[stage]`".to_owned()))?;
    AwaitedStage(Box::new(stage(entry)?)).home()?;
    Ok(())
}

/// Opens lasers and gates, all dark, and gives what tells in one line what they do.
///
/// # Errors
/// [`AppError`] when there are none, or one does not answer.
pub(in crate::app) fn watch_lights(
    instrument: &Instrument,
    text: &str,
) -> Result<impl Fn() -> Result<String, AppError> + use<>, AppError> {
    if instrument.hardware().gates.is_none() {
        return Err(AppError::Usage("the instrument file has no `[gates]` to watch".to_owned()));
    }
    let (guard, _) = Guarded::start(text)?;
    Ok(move || {
        let state = guard.state()?;
        let gates = state.gates.map_or("gates UNKNOWN, take them as open".to_owned(), |gates| {
            format!(
                "gates {:08b}{}",
                gates.open.0,
                gates.trip.map_or(String::new(), |trip| format!(", tripped: {trip:?}"))
            )
        });
        let lines = state.lines.iter().map(|line| match &line.laser {
            None => format!("{} nm UNKNOWN, take it as on", line.wavelength_nm),
            Some(laser) => format!(
                "{} nm {:?} {:.1}",
                line.wavelength_nm,
                laser.emission,
                laser.power_measured.unwrap_or(laser.power_set)
            ),
        });
        Ok(format!("{gates}; {}", lines.collect::<Vec<_>>().join("; ")))
    })
}

fn stage(entry: &StageEntry) -> Result<Tango, AppError> {
    let StageLink::Tango(port) = &entry.link else {
        return Err(AppError::usage(
            "a simulated stage carries the sample of simulated cameras only; remove `[stage]`",
        ));
    };
    let line = Line::open(&port.path, LINE_SETTINGS, "stage")?;
    let serial = port.serial.clone().ok_or_else(|| {
        AppError::Usage(
            "the stage has no `serial` in the instrument file; write what `devices list` shows".to_owned(),
        )
    })?;
    let settings = TangoSettings {
        serial,
        envelope: entry.envelope.clone(),
        fastest: MillimetersPerSecond::new(FASTEST_STAGE).unwrap_or_default(),
        tolerance: Micrometers::new(STAGE_TOLERANCE).unwrap_or_default(),
    };
    Ok(Tango::open(line, settings)?)
}

fn rig(
    instrument: &Instrument,
    cameras: [Box<dyn Camera>; 2],
    trigger: Option<Box<dyn TriggerSource>>,
    lasers: Box<dyn Illumination>,
    stage: Option<Box<dyn StageDrive>>,
) -> Rig {
    let identities = cameras.each_ref().map(|camera| camera.identity().clone());
    let capabilities = cameras.each_ref().map(|camera| camera.capabilities().clone());
    let stations = Channel::BOTH.into_iter().zip(cameras).map(|(channel, camera)| {
        let whole = Region {
            left: 0,
            top: 0,
            width: camera.capabilities().sensor_width,
            height: camera.capabilities().sensor_height,
        };
        let region = instrument.camera(channel).and_then(|entry| entry.region).unwrap_or(whole);
        CameraStation { channel, camera, region }
    });
    let facts = RigFacts {
        identities,
        sensors: capabilities.each_ref().map(|camera| (camera.sensor_width, camera.sensor_height)),
        shortest_periods: capabilities.each_ref().map(|camera| camera.shortest_period),
        saturation_counts: capabilities.each_ref().map(|camera| camera.saturation_counts),
        focus: FocusGauge::default(),
    };
    Rig { devices: Devices::new(stations.collect(), trigger, lasers, stage), facts }
}
