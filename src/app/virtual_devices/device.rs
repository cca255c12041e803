//! One virtual device, until the program that started it is gone.

use sofiscope_hal::{Channel, Region};
use sofiscope_serial_line::{LineModel, LineSettings, Wire};
use sofiscope_sim::{Scene, World};
use sofiscope_virtual::gige::{Exposure, GigeCamera, GigeSettings};
use sofiscope_virtual::laser::diode::Input;
use sofiscope_virtual::laser::smd12::CurrentControl;
use sofiscope_virtual::laser::{Diode, IbeamSmart, Place, Smd12};
use sofiscope_virtual::pty::Terminal;
use sofiscope_virtual::spot::{FocusSpot, SpotScene};
use sofiscope_virtual::stage::TangoModel;
use sofiscope_virtual::table::OpticalTable;
use sofiscope_virtual::trigger::{
    ArduinoDefects, ArduinoKind, Bench, BoardSetup, VirtualArduino, VirtualGatekeeper,
};
use sofiscope_virtual::{EmissionLog, monotonic};
use std::io::Read;
use std::net::Ipv4Addr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use super::sample::View;
use super::{log_path, read, table_path};
use crate::app::AppError;
use crate::app::priority;
use crate::app::text_file::read_text;
use crate::config::{GatesKind, Instrument, LaserEntry, LaserLink, StageLink, VirtualEntry};

/// Most power of the virtual laser heads, milliwatts.
const HEAD_MW: f64 = 200.0;
/// Serial number of the virtual gatekeeper.
const GATEKEEPER_SERIAL: u32 = 1;

/// Arguments of the hidden command `virtual-device`.
#[derive(Debug, clap::Args)]
pub(in crate::app) struct DeviceArguments {
    /// Instrument file
    #[arg(long)]
    instrument: PathBuf,
    /// Which device of it
    #[arg(long)]
    device: String,
}

/// Is one device until standard input ends; says `ready` when it can be opened.
///
/// # Errors
/// [`AppError`] with the port or address that could not be had.
pub(in crate::app) fn run(arguments: &DeviceArguments) -> Result<(), AppError> {
    // Ctrl-C at the terminal reaches every process of the group; a device goes when its instrument goes.
    ctrlc::set_handler(|| {})
        .map_err(|error| AppError::Device(format!("signals cannot be heard: {error}")))?;
    let (instrument, entry) = read(&arguments.instrument)?;
    let over = Arc::new(AtomicBool::new(false));
    let raised = Arc::clone(&over);
    std::thread::Builder::new()
        .name("starter".to_owned())
        .spawn(move || {
            // Whatever way the starter goes, its end of the pipe is closed then.
            let mut nothing = [0; 16];
            while matches!(std::io::stdin().read(&mut nothing), Ok(1..)) {}
            raised.store(true, Ordering::Relaxed);
        })
        .map_err(|error| AppError::Device(error.to_string()))?;
    let device = Device { instrument: &instrument, entry: &entry, name: &arguments.device, over: &over };
    device.live()
}

struct Device<'a> {
    instrument: &'a Instrument,
    entry: &'a VirtualEntry,
    name: &'a str,
    over: &'a AtomicBool,
}

impl Device<'_> {
    fn live(&self) -> Result<(), AppError> {
        let hardware = self.instrument.hardware();
        let table =
            OpticalTable::join(&table_path(&self.entry.directory)).map_err(|error| self.failed(&error))?;
        match self.name {
            "gates" => self.gates(table),
            "stage" => {
                let link = hardware.stage.as_ref().map(|stage| &stage.link);
                let Some(StageLink::Tango(port)) = link else { return Err(self.unknown()) };
                let serial = port.serial.clone().unwrap_or_default();
                let settings = LineSettings::with_two_stop_bits(57_600);
                self.behind_terminal(&port.path, settings, |_| TangoModel::new(serial, table))
            }
            "camera-reflected" => self.camera(Channel::Reflected, table),
            "camera-transmitted" => self.camera(Channel::Transmitted, table),
            "focus-camera" => self.focus_camera(table),
            name => {
                let laser =
                    hardware.lasers.iter().find(|laser| format!("laser-{}", laser.wavelength_nm) == name);
                self.laser(laser.ok_or_else(|| self.unknown())?, &table)
            }
        }
    }

    fn gates(&self, table: OpticalTable) -> Result<(), AppError> {
        let gates = self.instrument.hardware().gates.as_ref().ok_or_else(|| self.unknown())?;
        let log = self.log()?;
        let path = &gates.port.path;
        match gates.kind {
            GatesKind::Gatekeeper => self.behind_terminal(path, LineSettings::new(115_200), |base| {
                VirtualGatekeeper::new(BoardSetup::teensy(GATEKEEPER_SERIAL), Bench { table, log, base })
            }),
            GatesKind::MicromanagerArduino => self.behind_terminal(path, LineSettings::new(57_600), |base| {
                let bench = Bench { table, log, base };
                VirtualArduino::new(ArduinoKind::Teensy4, ArduinoDefects::default(), bench)
            }),
        }
    }

    fn laser(&self, laser: &LaserEntry, table: &OpticalTable) -> Result<(), AppError> {
        let place = |began| -> Result<Place, AppError> {
            Ok(Place {
                table: table.clone(),
                line: usize::from(laser.gate),
                wavelength_nm: laser.wavelength_nm,
                log: self.log()?,
                began,
            })
        };
        match &laser.link {
            LaserLink::TopticaIbeamSmart(port) => {
                let serial = port.serial.clone().unwrap_or_default();
                let place = place(monotonic())?;
                self.behind_terminal(&port.path, LineSettings::new(115_200), |began| {
                    IbeamSmart::new(Place { began, ..place }, serial, HEAD_MW)
                })
            }
            LaserLink::LaserquantumSmd12(port) => {
                let place = place(monotonic())?;
                self.behind_terminal(&port.path, LineSettings::new(9600), |began| {
                    Smd12::new(Place { began, ..place }, HEAD_MW, CurrentControl::Missing)
                })
            }
            LaserLink::Gated { level, calibration } => {
                let full = calibration.last().map_or(0.0, |(_, power)| power.value());
                let input = level.map_or(Input::Gate, |output| Input::Level {
                    output: usize::from(output),
                    threshold_v: 0.0,
                });
                let began = monotonic();
                let mut diode = Diode::new(place(began)?, input, full);
                self.ready();
                while !self.over.load(Ordering::Relaxed) {
                    let next = diode.step(monotonic().saturating_sub(began));
                    let wait = (began + next).saturating_sub(monotonic());
                    // Nothing will ever come: this is how the time until its next look passes.
                    let _ = crossbeam_channel::after(wait).recv();
                }
                Ok(())
            }
        }
    }

    fn camera(&self, channel: Channel, table: OpticalTable) -> Result<(), AppError> {
        let camera = self.instrument.camera(channel).ok_or_else(|| self.unknown())?;
        let text = match Scene::built_in(&self.entry.scene) {
            Some(text) => text.to_owned(),
            None => read_text(Path::new(&self.entry.scene), super::MOST_BYTES)?,
        };
        let scene = Scene::from_toml(&text)
            .and_then(|scene| scene.with_frames(self.entry.frames))
            .map_err(|error| AppError::Usage(format!("{}: {error}", self.entry.scene)))?;
        let seed = self.entry.seed.unwrap_or_else(|| scene.seed());
        let size = |pixels: usize| u32::try_from(pixels).unwrap_or(u32::MAX);
        let sensor = (size(scene.width_px()), size(scene.height_px()));
        let settings = GigeSettings {
            sensor,
            table: Some(table.clone()),
            ..GigeSettings::new(
                self.address(camera.address.as_deref())?,
                camera.serial.clone().unwrap_or_default(),
            )
        };
        let world = Arc::new(World::new(&scene, seed));
        let mut view = View::new(world, channel, table, self.instrument.pixel_pitch_nm());
        let camera =
            GigeCamera::open(settings, move |exposure: &_, counts: &mut [u16]| view.expose(exposure, counts));
        self.serve(camera)
    }

    fn focus_camera(&self, table: OpticalTable) -> Result<(), AppError> {
        let focus = self.instrument.hardware().focus.as_ref().ok_or_else(|| self.unknown())?;
        let settings = GigeSettings {
            sensor: (200, 64),
            table: Some(table.clone()),
            ..GigeSettings::new(self.address(Some(&focus.sensor_address))?, focus.sensor_serial.clone())
        };
        let scene = SpotScene { zero_px: 100.0, row_px: 32.0, ..SpotScene::default() };
        let mut spot = FocusSpot::new(table, scene);
        let camera = GigeCamera::open(settings, move |exposure: &Exposure, counts: &mut [u16]| {
            let Exposure { left, top, width, height, .. } = *exposure;
            spot.render(Region { left, top, width, height }, exposure.index, monotonic(), counts);
        });
        self.serve(camera)
    }

    fn serve(&self, camera: std::io::Result<GigeCamera>) -> Result<(), AppError> {
        let camera = camera.map_err(|error| self.failed(&error))?;
        self.ready();
        camera.serve(self.over).map_err(|error| self.failed(&error))
    }

    fn behind_terminal<M: LineModel>(
        &self,
        path: &Path,
        settings: LineSettings,
        model: impl FnOnce(Duration) -> M,
    ) -> Result<(), AppError> {
        // Hardware does not wait for the programs of a computer.
        priority::go_ahead(self.name);
        let terminal = Terminal::open(path).map_err(|error| self.failed(&error))?;
        let base = monotonic();
        let mut model = Wire::new(model(base), settings);
        self.ready();
        terminal.serve_since(base, &mut model, self.over).map_err(|error| self.failed(&error))
    }

    fn address(&self, address: Option<&str>) -> Result<Ipv4Addr, AppError> {
        let parsed = address.and_then(|address| address.parse().ok());
        parsed.ok_or_else(|| {
            AppError::Usage(format!("{}: a virtual camera needs an `address` such as 127.0.0.1", self.name))
        })
    }

    fn log(&self) -> Result<EmissionLog, AppError> {
        EmissionLog::append(&log_path(&self.entry.directory, self.name), self.name)
            .map_err(|error| self.failed(&error))
    }

    fn ready(&self) {
        println!("ready");
    }

    fn unknown(&self) -> AppError {
        AppError::Usage(format!("the instrument file has no device {}", self.name))
    }

    fn failed(&self, error: &dyn std::fmt::Display) -> AppError {
        AppError::Device(format!("virtual {}: {error}", self.name))
    }
}
