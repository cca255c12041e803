//! A virtual SMD12 on a bench, with its driver.

use std::path::Path;
use std::time::Duration;

use sofiscope_hal::conformance::LaserRig;
use sofiscope_hal::{DeviceError, Laser, Milliwatts};
use sofiscope_laserquantum_smd12::{Smd12, Smd12Settings, line_settings};
use sofiscope_serial_line::{Line, ModelPort, Wire};
use sofiscope_virtual::EmissionLog;
use sofiscope_virtual::laser::smd12::CurrentControl;
use sofiscope_virtual::laser::{Place, Smd12 as Model};
use sofiscope_virtual::table::{OpticalTable, Quantity};

pub(crate) const VERSION: &str = "SMD12 virtual 1.0";
pub(crate) const CAP_MW: f64 = 200.0;

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
        Self::judged_by(EmissionLog::append(path, "laser-561").unwrap())
    }

    fn judged_by(log: EmissionLog) -> Self {
        let table = OpticalTable::private().unwrap();
        let place = Place { table: table.clone(), line: 1, wavelength_nm: 561, log, began: Duration::ZERO };
        let model = Model::new(place, 500.0, CurrentControl::Missing);
        Self { table, port: ModelPort::new(Wire::new(model, line_settings())) }
    }

    pub(crate) fn open(&self) -> Result<Smd12, DeviceError> {
        self.open_as(VERSION)
    }

    pub(crate) fn open_as(&self, version: &str) -> Result<Smd12, DeviceError> {
        let line = Line::new(Box::new(self.port.again()), "laser 561");
        let settings = Smd12Settings { wavelength_nm: 561, version: version.to_owned(), cap: mw(CAP_MW) };
        let port = self.port.again();
        Smd12::open(line, settings, Box::new(move || port.with(|_, now| now)))
    }

    /// A laser that emits 100 mW steadily.
    pub(crate) fn bright(&mut self) -> Smd12 {
        let mut laser = self.open().unwrap();
        laser.set_power(mw(100.0)).unwrap();
        laser.switch_on().unwrap();
        self.port.pass(Duration::from_secs(30));
        laser.state().unwrap();
        assert!((self.light() - 100.0).abs() < 0.1);
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
        self.table.get(Quantity::Power(1))
    }
}

pub(crate) struct Rig {
    pub(crate) bench: Bench,
    pub(crate) laser: Smd12,
}

impl LaserRig for Rig {
    fn laser(&mut self) -> &mut dyn Laser {
        &mut self.laser
    }

    fn power(&self) -> Milliwatts {
        mw(80.0)
    }

    fn emitted(&mut self) -> Milliwatts {
        self.bench.port.pass(Duration::from_secs(30));
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
