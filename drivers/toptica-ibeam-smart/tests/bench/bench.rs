//! A virtual iBEAM on a bench, with its driver.

use std::path::Path;
use std::time::Duration;

use sofiscope_hal::conformance::LaserRig;
use sofiscope_hal::{DeviceError, Laser, Milliwatts};
use sofiscope_serial_line::{Line, ModelPort, Wire};
use sofiscope_toptica_ibeam_smart::{IbeamSettings, IbeamSmart, Modulation, line_settings};
use sofiscope_virtual::EmissionLog;
use sofiscope_virtual::laser::{IbeamSmart as Model, Place};
use sofiscope_virtual::table::{OpticalTable, Quantity};

pub(crate) const SERIAL: &str = "iBEAM-SMART-488-S-HP-TEST";
pub(crate) const CAP_MW: f64 = 60.0;

pub(crate) fn mw(power: f64) -> Milliwatts {
    Milliwatts::new(power).unwrap()
}

pub(crate) struct Bench {
    pub(crate) table: OpticalTable,
    pub(crate) port: ModelPort<Wire<Model>>,
}

impl Bench {
    pub(crate) fn new() -> Self {
        Self::judged_by(EmissionLog::none())
    }

    pub(crate) fn logged(path: &Path) -> Self {
        Self::judged_by(EmissionLog::append(path, "laser-488").unwrap())
    }

    fn judged_by(log: EmissionLog) -> Self {
        let table = OpticalTable::private().unwrap();
        let place = Place { table: table.clone(), line: 0, wavelength_nm: 488, log, began: Duration::ZERO };
        let model = Model::new(place, SERIAL, 200.0);
        Self { table, port: ModelPort::new(Wire::new(model, line_settings())) }
    }

    pub(crate) fn open(&self, modulation: Modulation) -> Result<IbeamSmart, DeviceError> {
        self.open_as(SERIAL, modulation)
    }

    pub(crate) fn open_as(&self, serial: &str, modulation: Modulation) -> Result<IbeamSmart, DeviceError> {
        let line = Line::new(Box::new(self.port.again()), "laser 488");
        let serial = serial.to_owned();
        IbeamSmart::open(line, IbeamSettings { wavelength_nm: 488, serial, cap: mw(CAP_MW), modulation })
    }

    /// A laser that emits 40 mW, without modulation.
    pub(crate) fn bright(&mut self) -> IbeamSmart {
        let mut laser = self.open(Modulation::None).unwrap();
        laser.set_power(mw(40.0)).unwrap();
        laser.switch_on().unwrap();
        assert_eq!(self.light(), 40.0);
        laser
    }

    pub(crate) fn model<T>(&self, change: impl FnOnce(&mut Model, Duration) -> T) -> T {
        self.port.with(|wire, now| change(wire.model(), now))
    }

    pub(crate) fn now(&self) -> Duration {
        self.port.with(|_, now| now)
    }

    /// What leaves the head now, milliwatts.
    pub(crate) fn light(&mut self) -> f64 {
        self.port.pass(Duration::from_millis(5));
        self.table.get(Quantity::Power(0))
    }
}

pub(crate) struct Rig {
    pub(crate) bench: Bench,
    pub(crate) laser: IbeamSmart,
}

impl LaserRig for Rig {
    fn laser(&mut self) -> &mut dyn Laser {
        &mut self.laser
    }

    fn power(&self) -> Milliwatts {
        mw(25.0)
    }

    fn emitted(&mut self) -> Milliwatts {
        self.bench.port.pass(Duration::from_millis(200));
        mw(self.bench.light())
    }

    fn num_sent(&mut self) -> u64 {
        self.bench.model(|model, _| model.num_received())
    }

    fn open_interlock(&mut self) {
        self.bench.table.set(Quantity::InterlockOpen, 1.0);
    }

    fn close_interlock(&mut self) {
        self.bench.table.set(Quantity::InterlockOpen, 0.0);
    }
}
