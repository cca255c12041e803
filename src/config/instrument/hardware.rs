//! Devices on ports and in libraries: what an instrument file says of them, checked.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use sofiscope_hal::{Micrometers, Milliwatts, Nanometers, StageEnvelope, Toward, Volts};

use super::Limits;
use crate::config::judge::Judge;

/// Frames of a virtual sample where the file names no number.
const VIRTUAL_FRAMES: u64 = 20_000;

/// A device at a serial port.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PortEntry {
    /// Path of the port; `/dev/serial/by-id/…` stays the same when ports are plugged in another order.
    pub path: PathBuf,
    /// The serial number that the device must have, where it tells one.
    pub serial: Option<String>,
}

/// What makes the pulses or opens the gates.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum GatesKind {
    /// Our own firmware, with a watchdog.
    Gatekeeper,
    /// The Arduino protocol of Micro-Manager, without one.
    MicromanagerArduino,
}

impl GatesKind {
    /// Every kind with the name it has in instrument files.
    pub const NAMES: [(&'static str, Self); 2] =
        [("gatekeeper", Self::Gatekeeper), ("micromanager-arduino", Self::MicromanagerArduino)];
}

/// The controller that opens the gates of the lasers.
#[derive(Debug, Clone, PartialEq)]
pub struct GatesEntry {
    /// Which one.
    pub kind: GatesKind,
    /// Where it is.
    pub port: PortEntry,
}

/// How a laser is reached.
#[derive(Debug, Clone, PartialEq)]
pub enum LaserLink {
    /// Toptica iBEAM smart.
    TopticaIbeamSmart(PortEntry),
    /// Laser Quantum gem on an SMD12 supply.
    LaserquantumSmd12(PortEntry),
    /// No data link: gate and analog level of the controller.
    Gated {
        /// Analog output; `None` for a laser that is only switched.
        level: Option<u8>,
        /// Level and the power that belongs to it, rising.
        calibration: Vec<(Volts, Milliwatts)>,
    },
}

/// A laser of the instrument.
#[derive(Debug, Clone, PartialEq)]
pub struct LaserEntry {
    /// Wavelength, nanometers.
    pub wavelength_nm: u32,
    /// How it is reached.
    pub link: LaserLink,
    /// Its gate at the controller, from 0.
    pub gate: u8,
    /// The most that may be asked of it.
    pub cap: Milliwatts,
}

/// How a stage is reached.
#[derive(Debug, Clone, PartialEq)]
pub enum StageLink {
    /// A Märzhäuser TANGO controller.
    Tango(PortEntry),
    /// The simulated stage, which carries the sample of the simulated cameras.
    Simulated,
}

/// The stage of the instrument.
#[derive(Debug, Clone, PartialEq)]
pub struct StageEntry {
    /// How it is reached.
    pub link: StageLink,
    /// Where the stage may go.
    pub envelope: StageEnvelope,
}

/// The piezo and the sensor of the focus lock.
#[derive(Debug, Clone, PartialEq)]
pub struct FocusEntry {
    /// Path of the maker's library; `None` for where the system has it.
    pub library: Option<PathBuf>,
    /// Serial number of the piezo.
    pub serial: Option<String>,
    /// Where the piezo may go.
    pub range: (Nanometers, Nanometers),
    /// Which way brings objective and sample together.
    pub toward: Toward,
    /// Network address of the camera that sees the reflected spot.
    pub sensor_address: String,
    /// Its serial number.
    pub sensor_serial: String,
}

/// What virtual devices in other processes show, instead of a microscope.
#[derive(Debug, Clone, PartialEq)]
pub struct VirtualEntry {
    /// Directory of the terminals, logs and the table that they share.
    pub directory: PathBuf,
    /// Name of a built-in scene, or path of a scene file.
    pub scene: String,
    /// Seed in place of the scene's own.
    pub seed: Option<u64>,
    /// Frames of the sample before it begins again.
    pub frames: u64,
    /// Drift of the sample along the optical axis, nanometers per second.
    pub drift_nm_per_s: f64,
}

/// Everything beside the cameras.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Hardware {
    /// What opens the gates.
    pub gates: Option<GatesEntry>,
    /// The clock of the cameras, where it is another device than the gates.
    pub clock: Option<PortEntry>,
    /// The lasers, in the order of the file.
    pub lasers: Vec<LaserEntry>,
    /// The stage.
    pub stage: Option<StageEntry>,
    /// The focus lock.
    pub focus: Option<FocusEntry>,
    /// There exactly if the devices are virtual ones.
    pub virtual_devices: Option<VirtualEntry>,
}

/// `[gates]`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub(crate) struct RawGates {
    pub(crate) kind: Option<String>,
    pub(crate) port: Option<String>,
    pub(crate) serial: Option<String>,
}

/// One of `[[laser]]`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub(crate) struct RawLaser {
    pub(crate) wavelength_nm: Option<u32>,
    pub(crate) kind: Option<String>,
    pub(crate) port: Option<String>,
    pub(crate) serial: Option<String>,
    pub(crate) gate: Option<u8>,
    pub(crate) level: Option<u8>,
    pub(crate) calibration_v_mw: Option<Vec<[f64; 2]>>,
}

/// `[stage]`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub(crate) struct RawStage {
    pub(crate) kind: Option<String>,
    pub(crate) port: Option<String>,
    pub(crate) serial: Option<String>,
    pub(crate) x_um: Option<[f64; 2]>,
    pub(crate) y_um: Option<[f64; 2]>,
}

/// `[focus]`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub(crate) struct RawFocus {
    pub(crate) drive: Option<String>,
    pub(crate) library: Option<String>,
    pub(crate) serial: Option<String>,
    pub(crate) z_um: Option<[f64; 2]>,
    pub(crate) toward_sample: Option<String>,
    pub(crate) sensor: Option<String>,
    pub(crate) sensor_address: Option<String>,
    pub(crate) sensor_serial: Option<String>,
}

/// `[virtual]`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub(crate) struct RawVirtual {
    pub(crate) directory: Option<String>,
    pub(crate) scene: Option<String>,
    pub(crate) seed: Option<u64>,
    pub(crate) frames: Option<u64>,
    pub(crate) drift_nm_per_s: Option<f64>,
}

/// All of it as typed.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct RawHardware {
    pub(crate) gates: Option<RawGates>,
    /// Each with the name of its table.
    pub(crate) lasers: Vec<(String, RawLaser)>,
    pub(crate) stage: Option<RawStage>,
    pub(crate) focus: Option<RawFocus>,
    pub(crate) virtual_devices: Option<RawVirtual>,
}

/// Judges what was typed; limits cap the lasers.
pub(super) struct HardwareCheck<'a> {
    pub(super) judge: Judge<'a>,
    pub(super) limits: &'a Limits,
}

impl HardwareCheck<'_> {
    pub(super) fn hardware(&self, raw: &RawHardware) -> Hardware {
        let gates = raw.gates.as_ref().and_then(|gates| self.gates(gates));
        let lasers: Vec<LaserEntry> =
            raw.lasers.iter().filter_map(|(key, laser)| self.laser(key, laser)).collect();
        if !lasers.is_empty() && raw.gates.is_none() {
            self.judge.fault(
                "laser",
                "there are lasers and no gates",
                "add `[gates]`: light is only let through by a controller that closes when nobody is there",
            );
        }
        for (index, laser) in lasers.iter().enumerate() {
            let others = &lasers[..index];
            let key = format!("laser[{index}]");
            if others.iter().any(|other| other.wavelength_nm == laser.wavelength_nm) {
                self.judge.fault(
                    &format!("{key}.wavelength_nm"),
                    "is the wavelength of another laser too",
                    "give each line once",
                );
            }
            if others.iter().any(|other| other.gate == laser.gate) {
                self.judge.fault(
                    &format!("{key}.gate"),
                    "is the gate of another laser too",
                    "give each laser its own gate",
                );
            }
        }
        Hardware {
            gates,
            clock: None,
            lasers,
            stage: raw.stage.as_ref().and_then(|stage| self.stage(stage)),
            focus: raw.focus.as_ref().and_then(|focus| self.focus(focus)),
            virtual_devices: raw.virtual_devices.as_ref().and_then(|table| self.virtual_devices(table)),
        }
    }

    fn gates(&self, raw: &RawGates) -> Option<GatesEntry> {
        let kind = self.judge.required("gates.kind", raw.kind.as_deref(), "\"gatekeeper\"");
        let kind = kind.and_then(|kind| self.judge.choice("gates.kind", kind, &GatesKind::NAMES));
        let port = self.port("gates", raw.port.as_deref(), raw.serial.as_ref());
        Some(GatesEntry { kind: kind?, port: port? })
    }

    /// The port of a device.
    pub(super) fn port(&self, table: &str, path: Option<&str>, serial: Option<&String>) -> Option<PortEntry> {
        let key = format!("{table}.port");
        let path = self.judge.required(&key, path, "\"/dev/serial/by-id/...\"")?;
        Some(PortEntry { path: PathBuf::from(path), serial: serial.cloned() })
    }

    fn laser(&self, key: &str, raw: &RawLaser) -> Option<LaserEntry> {
        let name = |field: &str| format!("{key}.{field}");
        let kinds = [("toptica-ibeam-smart", 0), ("laserquantum-smd12", 1), ("gated", 2)];
        let wavelength = self.judge.required(&name("wavelength_nm"), raw.wavelength_nm, "488");
        let kind = self.judge.required(&name("kind"), raw.kind.as_deref(), "\"gated\"");
        let kind = kind.and_then(|kind| self.judge.choice(&name("kind"), kind, &kinds));
        let gate = self.judge.required(&name("gate"), raw.gate, "0");
        let cap = wavelength.and_then(|wavelength| self.cap(&name("wavelength_nm"), wavelength));
        let link = match kind? {
            2 => self.gated(key, raw),
            kind => self.port(key, raw.port.as_deref(), raw.serial.as_ref()).map(|port| match kind {
                0 => LaserLink::TopticaIbeamSmart(port),
                _ => LaserLink::LaserquantumSmd12(port),
            }),
        };
        if gate.is_some_and(|gate| gate > 7) {
            self.judge.fault(&name("gate"), "is beyond the eight gates of a controller", "give 0 to 7");
        }
        Some(LaserEntry { wavelength_nm: wavelength?, link: link?, gate: gate?, cap: cap? })
    }

    fn cap(&self, key: &str, wavelength: u32) -> Option<Milliwatts> {
        let cap = self.limits.laser_power_mw.get(&wavelength).copied();
        if cap.is_none() {
            self.judge.fault(
                key,
                format!("{wavelength} nm has no cap"),
                format!("add `{wavelength} = ...` to `limits.laser_power_mw`"),
            );
        }
        cap.and_then(|cap| Milliwatts::new(cap).ok())
    }

    fn gated(&self, key: &str, raw: &RawLaser) -> Option<LaserLink> {
        let name = format!("{key}.calibration_v_mw");
        let example = "[[0.0, 0.0], [5.0, 200.0]]";
        let points = self.judge.required(&name, raw.calibration_v_mw.as_ref(), example)?;
        let calibration: Vec<(Volts, Milliwatts)> = points
            .iter()
            .filter_map(|[volts, power]| Some((Volts::new(*volts).ok()?, Milliwatts::new(*power).ok()?)))
            .collect();
        let rises = calibration.windows(2).all(|pair| pair[0].0 < pair[1].0 && pair[0].1 < pair[1].1);
        if calibration.len() < points.len().max(2) || !rises {
            self.judge.fault(
                &name,
                "is no rising curve of at least two points",
                format!("give pairs of volts and milliwatts, for example {example}"),
            );
        }
        Some(LaserLink::Gated { level: raw.level, calibration })
    }

    fn stage(&self, raw: &RawStage) -> Option<StageEntry> {
        let kind = self.judge.required("stage.kind", raw.kind.as_deref(), "\"maerzhaeuser-tango\"");
        let kinds = [("maerzhaeuser-tango", false), ("simulated", true)];
        let link = match kind.and_then(|kind| self.judge.choice("stage.kind", kind, &kinds)) {
            Some(true) => Some(StageLink::Simulated),
            _ => self.port("stage", raw.port.as_deref(), raw.serial.as_ref()).map(StageLink::Tango),
        };
        let x = self.interval("stage.x_um", raw.x_um, 120_000.0);
        let y = self.interval("stage.y_um", raw.y_um, 80_000.0);
        let envelope = |(least, greatest): (f64, f64)| {
            Some(Micrometers::new(least).ok()?..=Micrometers::new(greatest).ok()?)
        };
        Some(StageEntry { link: link?, envelope: StageEnvelope { x: envelope(x?)?, y: envelope(y?)? } })
    }

    /// Travel limits have no default: they keep the objective whole.
    fn interval(&self, key: &str, value: Option<[f64; 2]>, greatest: f64) -> Option<(f64, f64)> {
        let [from, to] = self.judge.required(key, value, "[0.0, 1000.0]")?;
        if !(from < to && from >= 0.0 && to <= greatest) {
            self.judge.fault(
                key,
                format!("is [{from}, {to}]"),
                format!("give two numbers, the smaller first, from 0 to {greatest}"),
            );
        }
        Some((from, to))
    }

    fn focus(&self, raw: &RawFocus) -> Option<FocusEntry> {
        let drive = self.judge.required("focus.drive", raw.drive.as_deref(), "\"madlib\"");
        drive.and_then(|drive| self.judge.choice("focus.drive", drive, &[("madlib", ())]));
        let sensor = self.judge.required("focus.sensor", raw.sensor.as_deref(), "\"spot-camera\"");
        sensor.and_then(|sensor| self.judge.choice("focus.sensor", sensor, &[("spot-camera", ())]));
        let toward = self.judge.required("focus.toward_sample", raw.toward_sample.as_deref(), "\"up\"");
        let ways = [("up", Toward::Up), ("down", Toward::Down)];
        let toward = toward.and_then(|toward| self.judge.choice("focus.toward_sample", toward, &ways));
        let range = self.interval("focus.z_um", raw.z_um, 1000.0);
        let address =
            self.judge.required("focus.sensor_address", raw.sensor_address.clone(), "\"192.168.0.3\"");
        let serial = self.judge.required("focus.sensor_serial", raw.sensor_serial.clone(), "\"...\"");
        let nm = |um: f64| Nanometers::new(um * 1000.0).ok();
        let range = range.and_then(|(from, to)| Some((nm(from)?, nm(to)?)));
        Some(FocusEntry {
            library: raw.library.as_ref().map(PathBuf::from),
            serial: raw.serial.clone(),
            range: range?,
            toward: toward?,
            sensor_address: address?,
            sensor_serial: serial?,
        })
    }

    fn virtual_devices(&self, raw: &RawVirtual) -> Option<VirtualEntry> {
        let directory =
            self.judge.required("virtual.directory", raw.directory.as_ref(), "\"/tmp/sofiscope\"");
        let scene = self.judge.required("virtual.scene", raw.scene.clone(), "\"figure-s4\"");
        let drift = raw.drift_nm_per_s.unwrap_or(0.0);
        Some(VirtualEntry {
            directory: PathBuf::from(directory?),
            scene: scene?,
            seed: raw.seed,
            frames: raw.frames.unwrap_or(VIRTUAL_FRAMES),
            drift_nm_per_s: self.judge.within("virtual.drift_nm_per_s", drift, -1000.0, 1000.0),
        })
    }
}
