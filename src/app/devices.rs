//! `devices`: what is connected, who it is, and virtual devices to try everything without hardware.

use super::AppError;
use super::hardware;
use super::text_file::read_text;
use super::virtual_devices::VirtualInstrument;
use crate::config::Instrument;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Longest instrument file that is read.
const MOST_BYTES: u64 = 1 << 20;

/// Arguments of `devices`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  sofiscope devices list
  sofiscope devices virtual up config/virtual.toml     (in one terminal)
  sofiscope devices check config/virtual.toml          (in another)
  sofiscope run plan.yaml --instrument config/virtual.toml")]
pub(super) struct DevicesArguments {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, clap::Subcommand)]
enum What {
    /// List serial ports with what the system knows of them
    List {
        /// Print one object on stdout
        #[arg(long)]
        json: bool,
    },
    /// Open every device of an instrument file, ask each who it is, and let go of it again
    Check {
        /// Instrument file
        instrument: PathBuf,
        /// Print one object on stdout
        #[arg(long)]
        json: bool,
    },
    /// Show what lasers and gates do, once a second, until Ctrl-C; nothing is switched on
    Monitor {
        /// Instrument file
        instrument: PathBuf,
        /// Only so many times
        #[arg(long)]
        times: Option<u64>,
    },
    /// Let the stage find its end switches; it crosses its WHOLE travel, so retract the objective before
    Home {
        /// Instrument file
        instrument: PathBuf,
    },
    /// Virtual devices: programs that speak as the real ones do
    Virtual {
        #[command(subcommand)]
        what: Virtual,
    },
}

#[derive(Debug, clap::Subcommand)]
enum Virtual {
    /// Start all devices of a file with a `[virtual]` table, until Ctrl-C
    Up {
        /// Instrument file
        instrument: PathBuf,
    },
}

/// Runs `devices`.
///
/// # Errors
/// [`AppError`] with the device that does not answer.
pub(super) fn run(arguments: &DevicesArguments) -> Result<(), AppError> {
    match &arguments.what {
        What::List { json } => list(*json),
        What::Check { instrument, json } => check(instrument, *json),
        What::Monitor { instrument, times } => monitor(instrument, *times),
        What::Home { instrument } => home(instrument),
        What::Virtual { what: Virtual::Up { instrument } } => up(instrument),
    }
}

/// One serial port.
#[derive(Debug, Serialize)]
struct PortFound {
    path: String,
    /// A name that stays the same when ports are plugged in another order.
    by_id: Option<String>,
    about: String,
}

fn list(json: bool) -> Result<(), AppError> {
    let found = ports()?;
    if json {
        println!("{}", serde_json::to_string(&found).map_err(AppError::data)?);
        return Ok(());
    }
    if found.is_empty() {
        println!("no serial ports were found; virtual devices are started by `sofiscope devices virtual up`");
    }
    for port in found {
        println!("{}  {}  {}", port.path, port.by_id.as_deref().unwrap_or("-"), port.about);
    }
    Ok(())
}

/// Serial ports, by what the system says of them.
fn ports() -> Result<Vec<PortFound>, AppError> {
    let links = std::fs::read_dir("/dev/serial/by-id").into_iter().flatten().flatten();
    let links: Vec<(PathBuf, PathBuf)> =
        links.filter_map(|entry| Some((entry.path().canonicalize().ok()?, entry.path()))).collect();
    let entries = std::fs::read_dir("/dev").map_err(|error| AppError::Device(format!("/dev: {error}")))?;
    let mut found: Vec<PortFound> = entries
        .flatten()
        .filter(|entry| {
            let name = entry.file_name();
            let name = name.to_string_lossy();
            ["ttyUSB", "ttyACM"].iter().any(|kind| name.starts_with(kind))
        })
        .map(|entry| {
            let path = entry.path();
            let by_id = links.iter().find(|(device, _)| *device == path);
            let about = if by_id.is_some() { "USB" } else { "without an identity of its own" };
            PortFound {
                path: path.display().to_string(),
                by_id: by_id.map(|(_, link)| link.display().to_string()),
                about: about.to_owned(),
            }
        })
        .collect();
    found.sort_by(|a, b| a.path.cmp(&b.path));
    Ok(found)
}

/// What a check found.
#[derive(Debug, Serialize)]
struct Checked {
    devices: Vec<String>,
    is_virtual: bool,
    seconds: f64,
}

fn read(path: &Path) -> Result<(Instrument, String), AppError> {
    let text = read_text(path, MOST_BYTES)?;
    let instrument = Instrument::from_toml(&text)
        .map_err(|faults| AppError::Usage(format!("{}: {faults}", path.display())))?;
    Ok((instrument, text))
}

fn home(path: &Path) -> Result<(), AppError> {
    let (instrument, _) = read(path)?;
    hardware::home(&instrument)?;
    println!("the stage is homed: its place is known");
    Ok(())
}

fn monitor(path: &Path, times: Option<u64>) -> Result<(), AppError> {
    let (instrument, text) = read(path)?;
    let interrupts = interrupts()?;
    let watched = hardware::watch_lights(&instrument, &text)?;
    for _ in 0..times.unwrap_or(u64::MAX) {
        println!("{}", watched()?);
        if interrupts.recv_timeout(Duration::from_secs(1)).is_ok() {
            break;
        }
    }
    Ok(())
}

/// Where Ctrl-C arrives.
fn interrupts() -> Result<crossbeam_channel::Receiver<()>, AppError> {
    let (sender, interrupts) = crossbeam_channel::bounded(1);
    ctrlc::set_handler(move || {
        // A second one finds the first still waiting.
        let _ = sender.try_send(());
    })
    .map_err(|error| AppError::Device(format!("Ctrl-C cannot be heard: {error}")))?;
    Ok(interrupts)
}

fn check(path: &Path, json: bool) -> Result<(), AppError> {
    let (instrument, text) = read(path)?;
    let begun = std::time::Instant::now();
    let opened = hardware::open(&instrument, &text)?;
    let checked = Checked {
        devices: opened.identities.clone(),
        is_virtual: opened.is_virtual,
        seconds: begun.elapsed().as_secs_f64(),
    };
    if json {
        println!("{}", serde_json::to_string(&checked).map_err(AppError::data)?);
        return Ok(());
    }
    for device in &checked.devices {
        println!("{device}");
    }
    let kind = if checked.is_virtual { "; all of them VIRTUAL, no hardware is involved" } else { "" };
    println!("{} devices answered within {:.1} s{kind}", checked.devices.len(), checked.seconds);
    Ok(())
}

fn up(path: &Path) -> Result<(), AppError> {
    let interrupts = interrupts()?;
    let mut devices = VirtualInstrument::up(path)?;
    for (name, process) in devices.devices() {
        println!("{name} (virtual), process {process}");
    }
    println!("up; end with Ctrl-C");
    loop {
        if interrupts.recv_timeout(Duration::from_millis(200)).is_ok() {
            return Ok(());
        }
        if let Some(name) = devices.ended() {
            return Err(AppError::Device(format!(
                "virtual {name} has ended by itself; all others were ended"
            )));
        }
    }
}
