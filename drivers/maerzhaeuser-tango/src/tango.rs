//! The stage.

mod connect;
mod motion;

use std::sync::Arc;
use std::time::{Duration, Instant};

use sofiscope_hal::{
    DeviceError, DeviceIdentity, ErrorKind, Micrometers, MillimetersPerSecond, Motion, Properties, Property,
    PropertyValue, Stage, StageEnvelope, StagePoint, StopMotion,
};
use sofiscope_serial_line::{Line, LineSettings};

use crate::brake::{Brake, Stopper};
use crate::dialog::Dialog;
use crate::properties::AxisSettings;
use crate::watch::Activity;
use crate::{properties, reply};

/// How a TANGO talks: 57600 baud with two stop bits.
pub const LINE_SETTINGS: LineSettings = LineSettings { baud: 57_600, two_stop_bits: true };

/// Dim 9: millimeters with four decimals, and millimeters per second.
const DIM: u32 = 9;

/// Time since some beginning, that never goes back.
pub type Clock = Box<dyn Fn() -> Duration + Send>;

/// What the configuration says of this stage.
#[derive(Debug, Clone, PartialEq)]
pub struct TangoSettings {
    /// The serial number that it must tell (`?readsn`).
    pub serial: String,
    /// Where it may go, from the lower end switches.
    pub envelope: StageEnvelope,
    /// No axis is ever faster; one that is when connected is slowed down.
    pub fastest: MillimetersPerSecond,
    /// How far from its target a move may end.
    pub tolerance: Micrometers,
}

/// A stage behind a TANGO controller.
pub struct Tango {
    dialog: Dialog,
    brake: Arc<Brake>,
    settings: TangoSettings,
    clock: Clock,
    identity: DeviceIdentity,
    envelope: StageEnvelope,
    num_axes: usize,
    axes: [AxisSettings; 2],
    activity: Activity,
    /// Whether a motion was given up since the last homing, whatever the controller thinks of its place.
    needs_homing: bool,
    /// STOPs at the beginning of the newest motion.
    stops_before: u64,
}

impl Tango {
    /// Identifies the controller and makes it ready; the stage does not move.
    ///
    /// # Errors
    /// [`Identity`](ErrorKind::Identity) for another device or serial number, to which nothing was said but
    /// questions; [`Fault`](ErrorKind::Fault) when the configured envelope is outside of the measured travel.
    pub fn open(line: Line, settings: TangoSettings) -> Result<Self, DeviceError> {
        let begun = Instant::now();
        Self::with_clock(line, settings, Box::new(move || begun.elapsed()))
    }

    /// The same with a clock of one's own, for simulated time.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn with_clock(line: Line, settings: TangoSettings, clock: Clock) -> Result<Self, DeviceError> {
        let dialog = Dialog::new(line);
        let brake = Brake::new(dialog.device(), dialog.sender()?);
        let identity = DeviceIdentity {
            vendor: "Märzhäuser".to_owned(),
            model: "TANGO".to_owned(),
            serial: String::new(),
            firmware: String::new(),
            simulated: false,
        };
        let envelope = settings.envelope.clone();
        let mut tango = Self {
            dialog,
            brake,
            settings,
            clock,
            identity,
            envelope,
            num_axes: 2,
            axes: [AxisSettings::default(); 2],
            activity: Activity::Still,
            needs_homing: false,
            stops_before: 0,
        };
        tango.connect()?;
        Ok(tango)
    }

    /// Goes on with a new line to the same controller. When contact was lost during a motion, STOP is sent and the
    /// stage must be homed again, whatever the controller thinks of its place. Stoppers go on working.
    ///
    /// # Errors
    /// As [`Self::open`]; nothing moves until a later try succeeds.
    pub fn reconnect(&mut self, line: Line) -> Result<(), DeviceError> {
        let dialog = Dialog::new(line);
        self.brake.replace(dialog.sender()?);
        self.dialog = dialog;
        self.connect()
    }

    /// Position in the coordinates of the controller, units checked.
    fn read_position(&mut self) -> Result<StagePoint, DeviceError> {
        self.check_units()?;
        let num_axes = self.num_axes;
        let place =
            self.dialog.ask("?pos", "a position", |answer| point(&reply::numbers(answer, num_axes)?))?;
        Ok(place)
    }

    /// The menu, another program or a reset may have changed the units; a wrong one would move a thousand times too
    /// far. So they are looked at before every place that is read or sent.
    fn check_units(&mut self) -> Result<(), DeviceError> {
        let dims = self.dialog.ask("?dim", "the units", reply::wholes)?;
        if dims[..2] == [DIM; 2] { Ok(()) } else { self.dialog.tell(&format!("!dim {DIM} {DIM}")) }
    }

    /// Whatever fails during a motion ends it and leaves the place unknown.
    fn guarded<T>(&mut self, result: Result<T, DeviceError>) -> Result<T, DeviceError> {
        if let Err(error) = &result
            && self.activity.is_motion()
            && matches!(error.kind(), ErrorKind::Lost | ErrorKind::Timeout | ErrorKind::Protocol)
        {
            self.give_up();
        }
        result
    }

    /// STOP, and the place is no longer known.
    fn give_up(&mut self) {
        (self.activity, self.needs_homing) = (Activity::Unknown, true);
        // The caller already has the error; where the line is gone there is nothing else to try.
        let _sent = self.brake.stop();
    }

    fn error(&self, kind: ErrorKind, message: impl Into<String>) -> DeviceError {
        DeviceError::new(kind, self.dialog.device(), message)
    }

    fn now(&self) -> Duration {
        (self.clock)()
    }
}

impl Properties for Tango {
    fn properties(&mut self) -> Result<Vec<Property>, DeviceError> {
        let listed = properties::listed(&mut self.dialog, &self.axes, self.settings.fastest.value());
        self.guarded(listed)
    }

    fn set_property(&mut self, name: &str, value: &PropertyValue) -> Result<(), DeviceError> {
        self.activity.allows_settings(self.dialog.device())?;
        let fastest = self.settings.fastest.value();
        if name.starts_with("vel") {
            // Velocities depend on the units.
            self.check_units()?;
        }
        properties::set(&mut self.dialog, &mut self.axes, fastest, (name, value))
    }
}

impl Stage for Tango {
    fn identity(&self) -> &DeviceIdentity {
        &self.identity
    }

    fn envelope(&self) -> &StageEnvelope {
        &self.envelope
    }

    fn position(&mut self) -> Result<StagePoint, DeviceError> {
        let place = self.read_position();
        self.guarded(place)
    }

    fn move_to(&mut self, target: StagePoint) -> Result<(), DeviceError> {
        let begun = self.begin_move(target);
        self.guarded(begun)
    }

    fn motion(&mut self) -> Result<Motion, DeviceError> {
        let motion = self.look();
        self.guarded(motion)
    }

    fn stopper(&self) -> Box<dyn StopMotion> {
        Box::new(Stopper(Arc::clone(&self.brake)))
    }

    fn begin_homing(&mut self) -> Result<(), DeviceError> {
        let begun = self.home();
        self.guarded(begun)
    }
}

/// Millimeters of the controller as a place.
fn point(millimeters: &[f64]) -> Option<StagePoint> {
    let length = |axis: usize| Micrometers::new(1e3 * *millimeters.get(axis)?).ok();
    Some(StagePoint { x: length(0)?, y: length(1)? })
}
