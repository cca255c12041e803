//! A stage driver and the virtual controller that it drives, on one table.

use std::time::Duration;

use sofiscope_hal::{
    DeviceError, Micrometers, MillimetersPerSecond, Motion, Stage, StageEnvelope, StagePoint,
};
use sofiscope_maerzhaeuser_tango::{LINE_SETTINGS, Tango, TangoSettings};
use sofiscope_serial_line::{Line, ModelPort, Wire};
use sofiscope_virtual::OpticalTable;
use sofiscope_virtual::stage::TangoModel;

pub(crate) const SERIAL: &str = "20260001";

pub(crate) type Port = ModelPort<Wire<TangoModel>>;

pub(crate) struct Bench {
    pub(crate) stage: Tango,
    pub(crate) port: Port,
}

pub(crate) fn length(value: f64) -> Micrometers {
    Micrometers::new(value).expect("a finite number")
}

pub(crate) fn place(x: f64, y: f64) -> StagePoint {
    StagePoint { x: length(x), y: length(y) }
}

pub(crate) fn settings() -> TangoSettings {
    TangoSettings {
        serial: SERIAL.to_owned(),
        envelope: StageEnvelope {
            x: length(5000.0)..=length(100_000.0),
            y: length(-2000.0)..=length(60_000.0),
        },
        fastest: MillimetersPerSecond::new(8.0).expect("a finite number"),
        tolerance: length(1.0),
    }
}

pub(crate) fn model() -> TangoModel {
    TangoModel::new(SERIAL, OpticalTable::private().expect("memory for a table"))
}

pub(crate) fn powered_up() -> Port {
    ModelPort::new(Wire::new(model(), LINE_SETTINGS))
}

pub(crate) fn line(port: &Port) -> Line {
    Line::new(Box::new(port.again()), "stage (virtual)")
}

pub(crate) fn opened(port: &Port, settings: TangoSettings) -> Result<Tango, DeviceError> {
    let watch = port.again();
    Tango::with_clock(line(port), settings, Box::new(move || watch.with(|_, now| now)))
}

impl Bench {
    /// Never homed.
    pub(crate) fn new() -> Self {
        let port = powered_up();
        let stage = opened(&port, settings()).expect("a healthy controller");
        Self { stage, port }
    }

    pub(crate) fn homed() -> Self {
        let mut bench = Self::new();
        bench.stage.begin_homing().expect("homing begins");
        assert_eq!(bench.ended().expect("homing ends"), Motion::Still);
        bench
    }

    /// Waits for the end of a motion.
    pub(crate) fn ended(&mut self) -> Result<Motion, DeviceError> {
        for _ in 0..5000 {
            let motion = self.stage.motion()?;
            if motion != Motion::Moving {
                return Ok(motion);
            }
            self.port.pass(Duration::from_millis(100));
        }
        panic!("a motion without end");
    }

    /// Breaks something.
    pub(crate) fn with(&self, change: impl FnOnce(&mut TangoModel)) {
        self.port.with(|wire, _| change(wire.model()));
    }

    /// Commands that came since this was asked last.
    pub(crate) fn received(&self) -> Vec<String> {
        let commands = self.port.with(|wire, _| wire.model().take_received());
        commands.into_iter().map(|(_, command)| command.escape_ascii().to_string()).collect()
    }

    pub(crate) fn now(&self) -> Duration {
        self.port.with(|_, now| now)
    }
}
