//! The laser guard as a process: started by the instrument, and what the instrument's sequencer sees of it.

use sofiscope_hal::{DeviceError, ErrorKind, TriggerSource};
use std::collections::BTreeMap;
use std::os::fd::AsFd;
use std::os::unix::net::UnixStream;
use std::process::{Child, Command};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use super::super::AppError;
use super::lights::Lights;
use crate::control::contracts::Illumination;
use crate::guard::client::{GuardClient, start_process};
use crate::guard::message::LightsState;
use crate::guard::process;

/// Arguments of the hidden command `laser-guard`.
#[derive(Debug, clap::Args)]
pub(in crate::app) struct GuardArguments {}

/// Guards the light until the instrument process, at the other end of standard input, is gone.
///
/// # Errors
/// [`AppError::Usage`] when standard input is no socket.
pub(in crate::app) fn run(_arguments: &GuardArguments) -> Result<(), AppError> {
    super::super::priority::go_ahead("the laser guard");
    // Ctrl-C at the terminal reaches every process of the group; the guard goes when the instrument goes.
    ctrlc::set_handler(|| {})
        .map_err(|error| AppError::Device(format!("signals cannot be heard: {error}")))?;
    let no_socket = |error: std::io::Error| {
        AppError::Usage(format!("the laser guard is started by the instrument, never by hand ({error})"))
    };
    let socket = UnixStream::from(std::io::stdin().as_fd().try_clone_to_owned().map_err(no_socket)?);
    socket.peer_addr().map_err(no_socket)?;
    process::serve(socket, &mut Lights::default())
        .map_err(|error| AppError::Safety(format!("the laser guard lost the instrument: {error}")))
}

/// The guard in the hand of the sequencer: light and the clock of the cameras.
#[derive(Clone)]
pub(in crate::app) struct Guarded(Arc<Mutex<Held>>);

struct Held {
    client: GuardClient,
    child: Child,
    is_armed: bool,
    /// The instrument file, for a second guard if the first one dies.
    instrument: String,
}

impl Held {
    /// When the guard itself has died, gates with a watchdog have closed by now; another guard makes the rest dark.
    fn darken_after_death(&mut self) {
        if !matches!(self.child.try_wait(), Ok(Some(_))) {
            return;
        }
        match started(&self.instrument) {
            Ok((client, child, _)) => {
                (self.client, self.child) = (client, child);
                tracing::error!("the laser guard had died; another one has made all lasers dark");
            }
            Err(error) => {
                tracing::error!(
                    "the laser guard has died, and lasers could not be made dark again: {error}; use their KEYS"
                );
            }
        }
    }
}

/// A guard with all lasers dark: that is how each of them is opened.
fn started(instrument: &str) -> Result<(GuardClient, Child, LightsState), AppError> {
    let failed = |error: std::io::Error| {
        AppError::Device(format!("the laser guard could not be started: {error}; no laser was touched"))
    };
    let program = std::env::current_exe().map_err(failed)?;
    let mut command = Command::new(program);
    command.arg("laser-guard");
    let (child, socket) = start_process(command).map_err(failed)?;
    let (client, state) =
        GuardClient::set_up(socket, instrument).map_err(|error| AppError::Device(error.to_string()))?;
    Ok((client, child, state))
}

impl Drop for Held {
    fn drop(&mut self) {
        let dark = self.client.disarm();
        if let Err(error) = dark {
            tracing::error!("{error}");
        }
    }
}

impl Guarded {
    /// Starts the guard's process and lets it open gates and lasers.
    ///
    /// # Errors
    /// What could not be started or opened; everything is dark then.
    pub(super) fn start(instrument: &str) -> Result<(Self, LightsState), AppError> {
        let (client, child, state) = started(instrument)?;
        let held = Held { client, child, is_armed: false, instrument: instrument.to_owned() };
        Ok((Self(Arc::new(Mutex::new(held))), state))
    }

    /// The process of the guard, for those who watch it.
    pub(super) fn process_id(&self) -> u32 {
        self.held().child.id()
    }

    /// Asks what the devices say.
    ///
    /// # Errors
    /// What the guard says.
    pub(in crate::app) fn state(&self) -> Result<LightsState, DeviceError> {
        self.held().client.state()
    }

    fn held(&self) -> MutexGuard<'_, Held> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Illumination for Guarded {
    /// Whoever starts a run whose plan names lasers has armed them: it is a deliberate act at the instrument.
    fn on(&mut self, power_mw: &BTreeMap<u32, f64>) -> Result<(), DeviceError> {
        let mut held = self.held();
        if !held.is_armed {
            held.client.arm()?;
            held.is_armed = true;
            eprintln!("LASERS will emit in 2 s: {}", lines(power_mw));
        }
        held.client.light(power_mw)
    }

    fn hold(&mut self) -> Result<(), DeviceError> {
        let mut held = self.held();
        if !held.is_armed {
            return Ok(());
        }
        held.client.prove();
        match held.client.trip() {
            None => Ok(()),
            Some(trip) => {
                held.is_armed = false;
                held.darken_after_death();
                Err(DeviceError::new(ErrorKind::Fault, "lasers off", trip.to_string()))
            }
        }
    }

    fn off(&mut self) -> Result<(), DeviceError> {
        self.held().client.darken()
    }
}

impl TriggerSource for Guarded {
    fn start(&mut self, period: Duration, pulses: Option<u64>) -> Result<(), DeviceError> {
        self.held().client.start_train(period, pulses)
    }

    fn stop(&mut self) -> Result<(), DeviceError> {
        self.held().client.stop_train()
    }
}

fn lines(power_mw: &BTreeMap<u32, f64>) -> String {
    let lines: Vec<String> =
        power_mw.iter().map(|(wavelength, power)| format!("{power} mW at {wavelength} nm")).collect();
    lines.join(", ")
}
