//! An instrument whose devices are open, real, virtual or simulated, as its file says.
//!
//! In: an instrument file. Out: devices for the sequencer, and what everybody else must know of them.
//! Never: takes a simulated device for one that is missing. Fails: [`AppError`] with the device that could not be opened.

use super::AppError;
use super::analysis::{self, Prepared};
use super::camera_maps::MapsPlace;
use super::hardware::{self, Guarded, StageHandle};
use super::session::stop_with_interrupts;
use super::simulated::{self, Rig, RigFacts};
use super::text_file::read_text;
use crate::acquisition::{LeaveOut, Patience, Surroundings};
use crate::config::{CameraKind, Instrument, Simulation, StageLink};
use crate::control::focus_lock::FocusRemote;
use crate::control::plan::{Plan, RecordingFormat};
use crate::control::preflight::{AnalysisFacts, CameraFacts, DiskFacts, Facts, MemoryFacts};
use crate::control::sequencer::Devices;
use crate::files::free_bytes;
use crate::sofi::spectra::{Species, SpectralResponse};
use sofiscope_hal::{CameraIdentity, Channel, Region, Stage, TriggerMode};
use sofiscope_sim::instrument::Pace;
use sofiscope_sim::{Film, InstrumentSettings, Scenario, Scene, SimulatedInstrument, Source, World};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

/// Longest plan, instrument or scene file that is read.
pub(super) const MOST_BYTES: u64 = 1 << 20;

/// Exposures that an analysis without a certain end is prepared for.
pub(super) const NO_CERTAIN_END: u64 = 1 << 40;

/// Bytes of running sums per camera pixel at order 2, from the tests of the engine; higher orders need more.
const STATE_BYTES_PER_PIXEL: u64 = 70;

/// How long a simulated sample lasts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Sample {
    /// For so many exposures, or as long as its scene says.
    Once(Option<u64>),
    /// Without end: it is there anew whenever its scene is over.
    Again,
}

/// Whether hardware is involved.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Label {
    /// It is.
    Real,
    /// Programs that speak as the devices do.
    Virtual,
    /// Simulated cameras in this program.
    Simulated,
}

impl Label {
    /// The word for it wherever the instrument is named.
    pub(super) fn word(self) -> Option<&'static str> {
        match self {
            Self::Real => None,
            Self::Virtual => Some("VIRTUAL"),
            Self::Simulated => Some("SIMULATED"),
        }
    }

    /// What people must know before anything begins.
    pub(super) fn notice(self) -> Option<&'static str> {
        (self == Self::Virtual).then_some(
            "all devices are VIRTUAL: no hardware is involved, and what the cameras show is simulated",
        )
    }
}

/// An instrument whose devices are open.
pub(super) struct OpenInstrument {
    pub(super) devices: Devices,
    pub(super) about: About,
}

/// Everything about an open instrument but its devices.
#[derive(Clone)]
pub(super) struct About {
    pub(super) facts: RigFacts,
    pub(super) patience: Patience,
    pub(super) label: Label,
    /// Who answered, for people.
    pub(super) identities: Vec<String>,
    /// What people must know.
    pub(super) warnings: Vec<String>,
    /// The stage, for whoever moves it beside the sequencer.
    pub(super) stage: Option<StageHandle>,
    /// What lasers and gates say of themselves, if there are any.
    pub(super) lights: Option<Guarded>,
    /// The focus lock, for whoever asks and looks beside the sequencer.
    pub(super) focus: Option<FocusRemote>,
    /// Rows and columns of the simulated sample.
    scene: Option<(String, [usize; 2])>,
    species: Option<Vec<Species>>,
    /// Text of the registration of camera T onto camera R that the instrument file names.
    registration: Option<String>,
    /// Maps of the pixels of both cameras that it names.
    camera_maps: Vec<Option<MapsPlace>>,
    /// Text of the measured shares of the dyes' light that it names.
    response: Option<String>,
    pixel_pitch_nm: f64,
    regions: [Option<Region>; 2],
}

impl OpenInstrument {
    /// Opens every device; `text` is the file of the instrument, which the laser guard reads for itself.
    ///
    /// # Errors
    /// [`AppError`] with the device that could not be opened; everything opened before is dark and still.
    pub(super) fn open(
        instrument: &Instrument,
        text: &str,
        path: &Path,
        sample: Sample,
    ) -> Result<Self, AppError> {
        let is_simulated = instrument.cameras().iter().any(|camera| camera.kind == CameraKind::Simulated);
        // A calibration that cannot be read is told before any device is touched.
        let beside = |file: &str| path.parent().unwrap_or(Path::new("")).join(file);
        let text_of = |file: Option<&str>| file.map(|file| read_text(&beside(file), MOST_BYTES)).transpose();
        let registration = text_of(instrument.registration_file())?;
        let response = text_of(instrument.response_file())?;
        let maps_of = |channel| {
            let file = instrument.camera(channel).and_then(|camera| camera.maps_file.as_deref());
            file.map(|file| MapsPlace::of(&beside(file))).transpose()
        };
        let camera_maps = vec![maps_of(Channel::Reflected)?, maps_of(Channel::Transmitted)?];
        let mut open =
            if is_simulated { simulated(instrument, path, sample)? } else { real(instrument, text)? };
        open.about.registration = registration;
        open.about.response = response;
        open.about.camera_maps = camera_maps;
        Ok(open)
    }
}

impl About {
    /// Names of the dyes that a simulated sample has.
    pub(super) fn species_names(&self) -> Vec<String> {
        self.species.iter().flatten().map(|species| species.name.clone()).collect()
    }

    /// What the cameras give for a plan, as the analysis sees it.
    pub(super) fn source(&self, plan: &Plan) -> analysis::Source {
        let (region, period) = (plan.region(Channel::Reflected), plan.cameras().period);
        let mut source = self.source_of(region, period, plan.exposures_per_series());
        source.calibrations.regions[1] = plan.region(Channel::Transmitted).or(self.regions[1]);
        source
    }

    /// The same for a region, a period and a number of exposures.
    pub(super) fn source_of(
        &self,
        region: Option<Region>,
        period: Duration,
        exposures: Option<u64>,
    ) -> analysis::Source {
        let wanted = region;
        let region = region.or(self.regions[0]);
        let whole = match &self.scene {
            Some((_, [height, width])) => (*width, *height),
            None => (self.facts.sensors[0].0 as usize, self.facts.sensors[0].1 as usize),
        };
        let (width, height) = region.map_or(whole, |region| (region.width as usize, region.height as usize));
        let input = |role: &str, index: usize| {
            let about = match &self.scene {
                Some((scene, _)) => format!("simulated: {scene}"),
                None => {
                    let CameraIdentity { vendor, model, serial, .. } = &self.facts.identities[index];
                    format!("{vendor} {model}, S/N {serial}")
                }
            };
            (role.to_owned(), about, "uint16".to_owned())
        };
        analysis::Source {
            inputs: vec![input("camera R", 0), input("camera T", 1)],
            height,
            width,
            frames: exposures.unwrap_or(NO_CERTAIN_END),
            pixel_pitch_nm: Some(self.pixel_pitch_nm),
            exposure_ms: Some(period.as_secs_f64() * 1e3),
            simulated: self.label != Label::Real,
            species: self.species.clone(),
            serials: self.facts.identities.each_ref().map(|identity| Some(identity.serial.clone())),
            registration: self.registration.clone(),
            calibrations: analysis::Calibrations {
                camera_maps: self.camera_maps.clone(),
                regions: self.regions.map(|of_file| wanted.or(of_file)),
                response: self.response.clone(),
            },
        }
    }

    /// What the pre-flight needs to know; `disk_rate` in bytes per second where it was measured.
    ///
    /// # Errors
    /// [`AppError`] where the place of the recording cannot be looked at.
    pub(super) fn facts(
        &self,
        plan: &Plan,
        source: &analysis::Source,
        prepared: &Prepared,
        out: &Path,
        disk_rate: Option<f64>,
    ) -> Result<Facts, AppError> {
        let period = plan.cameras().period;
        let (height, width) = (source.height as u32, source.width as u32);
        let camera = |channel: Channel| CameraFacts {
            channel,
            simulated: self.facts.identities[channel.index()].simulated,
            region: plan.region(channel).unwrap_or(Region { left: 0, top: 0, width, height }),
            sensor: self.facts.sensors[channel.index()],
            exposure: plan.cameras().exposure,
            period,
            shortest_period: self.facts.shortest_periods[channel.index()],
            trigger: plan.cameras().trigger.unwrap_or(TriggerMode::External),
            saturation_counts: self.facts.saturation_counts[channel.index()],
            brightest_counts: None,
        };
        let disk = match plan.recording() {
            RecordingFormat::None => None,
            _ => Some(DiskFacts {
                place: out.display().to_string(),
                free_bytes: free_bytes(out)?,
                bytes_per_second: disk_rate,
            }),
        };
        let pixels = u64::from(height) * u64::from(width);
        let path = super::data_path::DataPathSettings {
            pixels: pixels as usize,
            period,
            patience: self.patience,
            leave_out: LeaveOut::default(),
            surroundings: Surroundings::default(),
            pool_frames: None,
        };
        Ok(Facts {
            cameras: Channel::BOTH.map(camera).to_vec(),
            exposures: plan.exposures_per_series(),
            disk,
            memory: MemoryFacts {
                available_bytes: available_memory(),
                pool_frames: path.frames() as u64,
                analysis_bytes: pixels * STATE_BYTES_PER_PIXEL * (prepared.grid.order() as u64).pow(2) / 4,
            },
            analysis: Some(AnalysisFacts {
                order: prepared.grid.order(),
                species: prepared.species.len(),
                condition: prepared.matrix.as_ref().map(crate::sofi::unmixing::UnmixingMatrix::condition),
                error: None,
                subsequence_exposures: prepared.engine.subsequence,
            }),
            dose_mj: plan.dose_per_series_mj().zip(plan.stop_rule().dose_mj),
        })
    }
}

fn real(instrument: &Instrument, text: &str) -> Result<OpenInstrument, AppError> {
    let hardware::Opened { rig, is_virtual, identities, stage, lights, focus, warnings } =
        hardware::open(instrument, text)?;
    let about = About {
        facts: rig.facts,
        patience: Patience::Live,
        label: if is_virtual { Label::Virtual } else { Label::Real },
        identities,
        warnings,
        stage,
        lights,
        focus,
        scene: None,
        species: None,
        registration: None,
        camera_maps: Vec::new(),
        response: None,
        pixel_pitch_nm: instrument.pixel_pitch_nm(),
        regions: Channel::BOTH.map(|channel| instrument.camera(channel).and_then(|camera| camera.region)),
    };
    Ok(OpenInstrument { devices: rig.devices, about })
}

fn simulated(instrument: &Instrument, path: &Path, lasts: Sample) -> Result<OpenInstrument, AppError> {
    let kinds = Channel::BOTH.map(|channel| instrument.camera(channel).map(|camera| camera.kind));
    let [Some(CameraKind::Simulated), Some(CameraKind::Simulated)] = kinds else {
        return Err(AppError::Device(format!(
            "{}: simulated cameras come in pairs; make both of kind \"simulated\", or neither",
            path.display()
        )));
    };
    let simulation = instrument.simulation().ok_or_else(|| {
        AppError::Usage(format!("{}: simulated cameras need a [simulation] table", path.display()))
    })?;
    let (source, scene, world) = sample(simulation, lasts)?;
    let pace =
        if simulation.speed > 0.0 { Pace::RealTime { speed: simulation.speed } } else { Pace::Unpaced };
    let seed = simulation.seed.unwrap_or_else(|| scene.seed());
    let settings = InstrumentSettings { pace, seed, ..faults(simulation, path)? };
    let microscope = SimulatedInstrument::new(source, settings);
    let stage = stage(instrument, &microscope)?;
    let Rig { devices, facts } = simulated::rig_of(&microscope, instrument.trigger(), stage.as_ref());
    for channel in Channel::BOTH {
        let wanted = instrument.camera(channel).and_then(|camera| camera.serial.clone());
        let found = &facts.identities[channel.index()].serial;
        if let Some(wanted) = wanted.filter(|wanted| wanted != found) {
            return Err(AppError::Device(format!(
                "{channel}: serial {wanted} is expected and {found} was found; exchange the cables or correct {}",
                path.display()
            )));
        }
    }
    let identities = facts
        .identities
        .iter()
        .map(|camera| format!("{} {}, S/N {} (simulated)", camera.vendor, camera.model, camera.serial));
    let about = About {
        identities: identities.chain(stage.iter().map(|stage| stage.identity().to_string())).collect(),
        facts,
        patience: simulated::patience_of(pace),
        label: Label::Simulated,
        warnings: Vec::new(),
        stage,
        lights: None,
        focus: None,
        species: Some(species_of(&world)?),
        registration: None,
        camera_maps: Vec::new(),
        response: None,
        scene: Some((scene.name().to_owned(), [scene.height_px(), scene.width_px()])),
        pixel_pitch_nm: instrument.pixel_pitch_nm(),
        regions: Channel::BOTH.map(|channel| instrument.camera(channel).and_then(|camera| camera.region)),
    };
    Ok(OpenInstrument { devices, about })
}

/// The stage of a simulated microscope; it was homed before anybody came.
fn stage(instrument: &Instrument, microscope: &SimulatedInstrument) -> Result<Option<StageHandle>, AppError> {
    let Some(entry) = &instrument.hardware().stage else { return Ok(None) };
    if entry.link != StageLink::Simulated {
        return Err(AppError::usage(
            "simulated cameras see the simulated stage only; write kind = \"simulated\" in [stage]",
        ));
    }
    let mut stage = microscope.stage(entry.envelope.clone());
    stage.begin_homing()?;
    let handle = StageHandle::spawn(Box::new(stage))?;
    stop_with_interrupts(handle.stopper());
    Ok(Some(handle))
}

/// The simulated sample: a world, or a film of its beginning that is played again and again.
fn sample(simulation: &Simulation, lasts: Sample) -> Result<(Source, Scene, Arc<World>), AppError> {
    let text = match Scene::built_in(&simulation.scene) {
        Some(text) => text.to_owned(),
        None => read_text(Path::new(&simulation.scene), MOST_BYTES)?,
    };
    let scene = Scene::from_toml(&text).map_err(|e| AppError::Usage(format!("{}: {e}", simulation.scene)))?;
    let seed = simulation.seed.unwrap_or_else(|| scene.seed());
    let frames = match lasts {
        Sample::Once(frames) => simulation.film_frames.or(frames),
        Sample::Again => simulation.film_frames,
    };
    let scene = match frames {
        Some(frames) => scene.with_frames(frames).map_err(AppError::usage)?,
        None => scene,
    };
    let world = Arc::new(World::new(&scene, seed));
    let source = match simulation.film_frames {
        Some(frames) => {
            Source::Film(Arc::new(Film::render(&world, frames as usize).map_err(AppError::usage)?))
        }
        None if lasts == Sample::Again => Source::Again(Arc::clone(&world)),
        None => Source::World(Arc::clone(&world)),
    };
    Ok((source, scene, world))
}

/// The faults that the simulated devices shall show.
fn faults(simulation: &Simulation, path: &Path) -> Result<InstrumentSettings, AppError> {
    let (text, place) = match (&simulation.fault_scenario, &simulation.faults) {
        (Some(file), _) => {
            let beside = path.parent().unwrap_or(Path::new("")).join(file);
            (read_text(&beside, MOST_BYTES)?, beside)
        }
        (None, Some(table)) => {
            let mut whole = toml::Table::new();
            whole.insert("faults".to_owned(), toml::Value::Table(table.clone()));
            (whole.to_string(), path.to_path_buf())
        }
        (None, None) => return Ok(InstrumentSettings::default()),
    };
    let scenario = Scenario::from_toml(&text);
    scenario
        .map(Scenario::into_settings)
        .map_err(|error| AppError::Usage(format!("{}: {error}", place.display())))
}

/// The species of a simulated sample, as their response was simulated.
pub(super) fn species_of(world: &World) -> Result<Vec<Species>, AppError> {
    let species = |truth: &sofiscope_sim::SpeciesTruth| {
        let response = SpectralResponse::measured(truth.transmission, truth.reflection);
        let response = response.map_err(AppError::usage)?;
        Ok(Species { name: truth.name.clone(), response, emission_nm: Some(truth.emission_nm) })
    };
    world.truth().species.iter().map(species).collect()
}

/// Memory that can be had without swapping, bytes; without an answer from the system, as much as one asks for.
fn available_memory() -> u64 {
    let text = std::fs::read_to_string("/proc/meminfo").unwrap_or_default();
    let line = text.lines().find_map(|line| line.strip_prefix("MemAvailable:"));
    let kibibytes = line.and_then(|line| line.trim().trim_end_matches(" kB").parse::<u64>().ok());
    kibibytes.map_or(u64::MAX, |kibibytes| kibibytes << 10)
}
