//! Starts all virtual devices of an instrument, and ends them with this value.

use sofiscope_virtual::table::{OpticalTable, Quantity};
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use super::{names, read, table_path};
use crate::app::AppError;

/// Height of the virtual sample, nanometers: in the middle of the piezo's travel.
const SAMPLE_Z_NM: f64 = 150_000.0;

/// Virtual devices, each in a process of its own; they end when this is dropped, or this process dies.
#[derive(Debug)]
pub(in crate::app) struct VirtualInstrument {
    devices: Vec<(String, Child)>,
    directory: PathBuf,
}

impl VirtualInstrument {
    /// Starts everything that the file names and waits until each device can be opened.
    ///
    /// # Errors
    /// [`AppError`] with the device that could not be started; the others are ended.
    pub(in crate::app) fn up(path: &Path) -> Result<Self, AppError> {
        let (instrument, entry) = read(path)?;
        let failed =
            |error: std::io::Error| AppError::Device(format!("{}: {error}", entry.directory.display()));
        std::fs::create_dir_all(&entry.directory).map_err(failed)?;
        let table = table_path(&entry.directory);
        if table.exists() {
            // Whoever still uses an old table keeps it; nobody new finds it.
            std::fs::remove_file(&table).map_err(failed)?;
        }
        let shared = OpticalTable::set_up(&table).map_err(failed)?;
        shared.set(Quantity::SampleZ, SAMPLE_Z_NM);
        shared.set(Quantity::PiezoZ, SAMPLE_Z_NM);
        shared.set(Quantity::DriftSpeed, entry.drift_nm_per_s);
        let mut up = Self { devices: Vec::new(), directory: entry.directory.clone() };
        up.link_piezo()?;
        for name in names(&instrument) {
            up.start(path, &name)?;
        }
        for (name, child) in &mut up.devices {
            await_ready(name, child)?;
        }
        Ok(up)
    }

    /// Which devices there are, with their processes.
    pub(in crate::app) fn devices(&self) -> impl Iterator<Item = (&str, u32)> {
        self.devices.iter().map(|(name, child)| (name.as_str(), child.id()))
    }

    /// The first device that has ended, if one has.
    pub(in crate::app) fn ended(&mut self) -> Option<String> {
        self.devices.iter_mut().find_map(|(name, child)| {
            let is_alive = matches!(child.try_wait(), Ok(None));
            (!is_alive).then(|| name.clone())
        })
    }

    fn start(&mut self, instrument: &Path, name: &str) -> Result<(), AppError> {
        let failed = |error: std::io::Error| AppError::Device(format!("virtual {name}: {error}"));
        let program = std::env::current_exe().map_err(failed)?;
        let child = Command::new(program)
            .args(["virtual-device", "--device", name, "--instrument"])
            .arg(instrument)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .map_err(failed)?;
        self.devices.push((name.to_owned(), child));
        Ok(())
    }

    /// The virtual piezo is a library and no program; it is found beside this one.
    fn link_piezo(&self) -> Result<(), AppError> {
        let link = self.directory.join("libmadlib.so");
        let _old = std::fs::remove_file(&link);
        match sofiscope_madlib_stand_in::library() {
            Ok(found) => std::os::unix::fs::symlink(found, &link)
                .map_err(|error| AppError::Device(format!("{}: {error}", link.display()))),
            Err(reason) => {
                eprintln!("the virtual piezo is missing: {reason}");
                Ok(())
            }
        }
    }
}

fn await_ready(name: &str, child: &mut Child) -> Result<(), AppError> {
    let told = child.stdout.take().and_then(|out| BufReader::new(out).lines().next());
    match told {
        Some(Ok(line)) if line == "ready" => Ok(()),
        _ => Err(AppError::Device(format!("virtual {name} did not start; its own message is above"))),
    }
}

impl Drop for VirtualInstrument {
    fn drop(&mut self) {
        for (_, child) in &mut self.devices {
            // Its end of the pipe closes, and it goes by itself.
            drop(child.stdin.take());
        }
        for (name, child) in &mut self.devices {
            if let Err(error) = child.wait() {
                tracing::warn!("virtual {name}: {error}");
            }
        }
    }
}
