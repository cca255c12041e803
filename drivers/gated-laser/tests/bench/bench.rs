//! A virtual laser without a data link, on a bench with a controller.

use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;

use sofiscope_gated_laser::{
    Calibration, CalibrationPoint, Drive, GatedLaser, GatedLaserSettings, Output, OutputState, Permitting,
    Polarity, Wiring,
};
use sofiscope_hal::conformance::LaserRig;
use sofiscope_hal::{DeviceError, DeviceIdentity, GateController, Laser, Milliwatts, Volts};
use sofiscope_virtual::EmissionLog;
use sofiscope_virtual::laser::diode::Input;
use sofiscope_virtual::laser::{Diode, Place};
use sofiscope_virtual::table::{OpticalTable, Quantity};

use crate::controller::Controller;

/// Gate and line of the laser.
pub(crate) const LINE: u8 = 2;
/// Its analog output.
pub(crate) const OUTPUT: u8 = 1;
/// Below the 200 mW of the laser.
pub(crate) const CAP_MW: f64 = 120.0;

pub(crate) fn mw(power: f64) -> Milliwatts {
    Milliwatts::new(power).unwrap()
}

pub(crate) fn volts(level: f64) -> Volts {
    Volts::new(level).unwrap()
}

/// The controller of a test; a program has a mailbox to its thread instead.
#[derive(Clone)]
pub(crate) struct Shared {
    controller: Arc<Mutex<Permitting<Controller>>>,
    pub(crate) wiring: Wiring,
}

impl Shared {
    pub(crate) fn lock(&self) -> MutexGuard<'_, Permitting<Controller>> {
        self.controller.lock().unwrap()
    }
}

impl Output for Shared {
    fn grant(&mut self, level: Volts) -> Result<(), DeviceError> {
        self.lock().grant(self.wiring, level)
    }

    fn set_level(&mut self, level: Volts) -> Result<(), DeviceError> {
        self.lock().set_level_of(self.wiring, level)
    }

    fn withhold(&mut self) -> Result<(), DeviceError> {
        self.lock().withhold(self.wiring)
    }

    fn state(&mut self) -> Result<OutputState, DeviceError> {
        self.lock().output_state(self.wiring)
    }
}

/// What is wired.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Wired {
    Ttl,
    Analog,
    Both,
}

pub(crate) struct Bench {
    pub(crate) table: OpticalTable,
    pub(crate) shared: Shared,
    pub(crate) wired: Wired,
    diode: Diode,
    now: Duration,
}

impl Bench {
    /// An armed controller with the laser's outputs claimed.
    pub(crate) fn new(wired: Wired, log: EmissionLog) -> Self {
        let table = OpticalTable::private().unwrap();
        let place = Place {
            table: table.clone(),
            line: usize::from(LINE),
            wavelength_nm: 405,
            log,
            began: Duration::ZERO,
        };
        let input = match wired {
            Wired::Ttl => Input::Gate,
            Wired::Analog | Wired::Both => Input::Level { output: usize::from(OUTPUT), threshold_v: 0.5 },
        };
        // By its supply, the laser with a digital input alone emits 100 mW.
        let diode = Diode::new(place, input, if wired == Wired::Ttl { 100.0 } else { 200.0 });
        let wiring = Wiring {
            line: (wired != Wired::Analog).then_some(LINE),
            output: (wired != Wired::Ttl).then_some(OUTPUT),
        };
        let mut controller = Permitting::new(Controller::new(table.clone()));
        controller.claim(wiring).unwrap();
        controller.arm().unwrap();
        let shared = Shared { controller: Arc::new(Mutex::new(controller)), wiring };
        Self { table, shared, wired, diode, now: Duration::ZERO }
    }

    pub(crate) fn laser(&self) -> GatedLaser<Shared> {
        GatedLaser::new(self.shared.clone(), settings(self.wired, Polarity::HighIsLight, CAP_MW)).unwrap()
    }

    /// What leaves the head now, milliwatts.
    pub(crate) fn light(&mut self) -> f64 {
        self.shared.lock().controller().look();
        self.now = self.diode.step(self.now);
        self.table.get(Quantity::Power(usize::from(LINE)))
    }
}

pub(crate) fn settings(wired: Wired, polarity: Polarity, cap_mw: f64) -> GatedLaserSettings {
    // Measured with the power meter: the laser is a line from 0.5 V.
    let point = |level: f64| CalibrationPoint { level: volts(level), power: mw(200.0 * (level - 0.5) / 4.5) };
    let calibration = Calibration::new([0.5, 1.0, 2.0, 5.0].map(point).to_vec(), volts(0.5)).unwrap();
    let identity = DeviceIdentity {
        vendor: "Roithner".into(),
        model: "MLL-III-405-200mW (virtual)".into(),
        serial: String::new(),
        firmware: String::new(),
        simulated: true,
    };
    let drive = match wired {
        Wired::Ttl => Drive::Ttl { power: mw(100.0), polarity },
        Wired::Analog => Drive::Analog { calibration },
        Wired::Both => Drive::Both { calibration, polarity },
    };
    GatedLaserSettings { name: "laser 405".into(), identity, wavelength_nm: 405, cap: mw(cap_mw), drive }
}

pub(crate) struct Rig {
    pub(crate) bench: Bench,
    pub(crate) laser: GatedLaser<Shared>,
}

impl LaserRig for Rig {
    fn laser(&mut self) -> &mut dyn Laser {
        &mut self.laser
    }

    fn power(&self) -> Milliwatts {
        mw(50.0)
    }

    fn emitted(&mut self) -> Milliwatts {
        mw(self.bench.light())
    }

    fn num_sent(&mut self) -> u64 {
        self.bench.shared.lock().controller().num_calls
    }

    fn open_interlock(&mut self) {
        self.bench.table.set(Quantity::InterlockOpen, 1.0);
    }

    fn close_interlock(&mut self) {
        self.bench.table.set(Quantity::InterlockOpen, 0.0);
        // The supply wants its inputs low before it emits again, and a person arms the controller.
        self.bench.light();
        self.bench.shared.lock().arm().unwrap();
    }
}
