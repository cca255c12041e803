//! Virtual devices in processes of their own, what they have noted, and cores that are busy.

use sofiscope_virtual::log::{Note, read};
use sofiscope_virtual::table::{OpticalTable, Quantity};
use sofiscope_virtual::{EmissionLog, monotonic};
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::sync_channel;
use std::time::Duration;

/// How often each cause is tried; 20 for a thorough run.
const TRIALS: &str = "SOFISCOPE_TEST_SAFETY_TRIALS";
pub(crate) const THOROUGH: u32 = 20;
pub(crate) const PROGRAM: &str = env!("CARGO_BIN_EXE_sofiscope");
pub(crate) const GATES: &str = "gates";
pub(crate) const LASER: &str = "laser-488";
/// Gate 1, the one in front of the laser.
pub(crate) const LASER_GATE: u8 = 0b10;

/// How often each cause is tried.
pub(crate) fn num_trials() -> u32 {
    std::env::var(TRIALS).ok().and_then(|trials| trials.parse().ok()).unwrap_or(2)
}

/// Waits without sleeping: nothing is ever sent.
pub(crate) fn wait(time: Duration) {
    let (_sender, receiver) = sync_channel::<()>(0);
    let _ = receiver.recv_timeout(time);
}

pub(crate) fn milliseconds(time: Duration) -> f64 {
    time.as_secs_f64() * 1e3
}

/// Keeps every core busy until it is dropped.
pub(crate) struct BusyCores(Arc<AtomicBool>);

impl BusyCores {
    pub(crate) fn new() -> Self {
        let over = Arc::new(AtomicBool::new(false));
        for _ in 0..std::thread::available_parallelism().map_or(2, usize::from) {
            let over = Arc::clone(&over);
            std::thread::spawn(move || {
                while !over.load(Ordering::Relaxed) {
                    std::hint::spin_loop();
                }
            });
        }
        Self(over)
    }
}

impl Drop for BusyCores {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// A trigger controller and a laser, each a process behind a pseudo-terminal, on one optical table.
pub(crate) struct Bench {
    devices: Vec<(&'static str, Child)>,
    pub(crate) table: OpticalTable,
    folder: tempfile::TempDir,
}

impl Bench {
    /// Devices of an instrument whose cameras expose for `exposure`.
    pub(crate) fn new(exposure: Duration) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let table = OpticalTable::set_up(&folder.path().join("table")).unwrap();
        let mut bench = Self { devices: Vec::new(), table, folder };
        std::fs::write(bench.instrument(), bench.text(exposure)).unwrap();
        bench.start(GATES);
        bench.start(LASER);
        bench
    }

    pub(crate) fn instrument(&self) -> PathBuf {
        self.path("instrument.toml")
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn text(&self, exposure: Duration) -> String {
        let (directory, ms) = (self.folder.path().display(), exposure.as_millis());
        let camera = format!("kind = \"genicam\"\nexposure_ms = {ms}.0\nperiod_ms = {ms}.0\n");
        format!(
            "version = 1\nname = \"Light alone\"\npixel_pitch_nm = 108.0\nnumerical_aperture = 1.27\n\
             dichroic = \"zt 594 RDC\"\n[camera.reflected]\nserial = \"R\"\n{camera}\
             [camera.transmitted]\nserial = \"T\"\n{camera}[trigger]\nkind = \"gates\"\n\
             [gates]\nkind = \"gatekeeper\"\nport = \"{directory}/controller\"\n\
             [[laser]]\nwavelength_nm = 488\nkind = \"toptica-ibeam-smart\"\nport = \"{directory}/laser\"\n\
             serial = \"iBEAM-SMART-488-VIRTUAL\"\ngate = 1\n\
             [limits]\nshortest_period_ms = 1.0\nlongest_exposure_ms = 60000.0\n\
             laser_power_mw = {{ 488 = 50.0 }}\n[virtual]\ndirectory = \"{directory}\"\n\
             scene = \"figure-s4\"\nseed = 1\ndrift_nm_per_s = 0.0\n"
        )
    }

    /// Starts a device and waits until it can be opened.
    pub(crate) fn start(&mut self, device: &'static str) {
        let mut child = Command::new(PROGRAM)
            .args(["virtual-device", "--device", device, "--instrument"])
            .arg(self.instrument())
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let said = BufReader::new(child.stdout.take().unwrap()).lines().next();
        assert_eq!(said.unwrap().unwrap(), "ready", "{device}");
        self.devices.push((device, child));
    }

    /// Kills a device; its end of the line is gone.
    pub(crate) fn kill(&mut self, device: &str) {
        let at = self.devices.iter().position(|(name, _)| *name == device).unwrap();
        let (_, mut child) = self.devices.remove(at);
        child.kill().unwrap();
        child.wait().unwrap();
        // Its terminal's number may be given to another one, and the name would then lead there.
        std::fs::remove_file(self.path(if device == GATES { "controller" } else { "laser" })).unwrap();
    }

    /// Presses the reset button of the controller.
    pub(crate) fn reset_controller(&self) {
        self.table.set(Quantity::ControllerResets, self.table.get(Quantity::ControllerResets) + 1.0);
    }

    /// What the gates have done.
    pub(crate) fn gates(&self) -> Vec<Note> {
        notes(&self.path("gates.log"))
    }

    /// What the laser has done.
    pub(crate) fn laser(&self) -> Vec<Note> {
        notes(&self.path("laser-488.log"))
    }

    /// Waits until a gate is open and light comes through.
    pub(crate) fn await_light(&self, within: Duration) -> Result<(), String> {
        let until = monotonic() + within;
        while monotonic() < until {
            if self.table.light_mw(1) > 0.0 && is_on(&self.gates()) && is_on(&self.laser()) {
                return Ok(());
            }
            wait(Duration::from_millis(2));
        }
        Err(format!("no light: gates {:?}, laser {:?}", self.gates(), self.laser()))
    }
}

impl Drop for Bench {
    fn drop(&mut self) {
        for (_, child) in &mut self.devices {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

/// A log that is not there yet is empty.
fn notes(path: &Path) -> Vec<Note> {
    if path.exists() { read(path).unwrap() } else { Vec::new() }
}

/// Whether the newest note is light.
pub(crate) fn is_on(notes: &[Note]) -> bool {
    notes.last().is_some_and(|note| note.value != 0.0)
}

/// When it went dark for the last time; `None` while it is on or has never been.
pub(crate) fn dark_since(notes: &[Note]) -> Option<Duration> {
    let last_on = notes.iter().rposition(|note| note.value != 0.0)?;
    notes.get(last_on + 1).map(|note| note.at)
}

#[test]
fn the_judge_sees_light_that_stays_or_comes_back() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("gates.log");
    let mut log = EmissionLog::append(&path, GATES).unwrap();
    let verdict = || {
        let notes = notes(&path);
        (is_on(&notes), dark_since(&notes))
    };
    assert_eq!(verdict(), (false, None), "never on");
    let ms = Duration::from_millis;
    let expected = [
        (1, 2.0, (true, None)),
        (5, 0.0, (false, Some(ms(5)))),
        (900, 2.0, (true, None)),
        (905, 0.0, (false, Some(ms(905)))),
    ];
    for (at, value, expected) in expected {
        log.note(ms(at), "gates", value);
        assert_eq!(verdict(), expected);
    }
}
