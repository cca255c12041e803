//! Opens whatever two cameras have left behind.
//!
//! In: one path with both cameras, or one path per camera, R before T. Out: a [`Replay`].
//! Never: believes the ending of a name where the content tells, except for `.toml` and `.raw`.
//! Fails: [`ReplayError`] naming the file, and what to do with the frames of one camera.

use super::camera::Reel;
use super::source::{Numbering, Opened, SourceFile};
use super::stack::PERIOD_UNKNOWN;
use super::timeline::Timeline;
use super::{
    Replay, ReplayCamera, ReplayControl, ReplayError, ReplayInfo, ReplayOptions, dcimg, raw, recorded, stack,
    zarr,
};
use crate::files::FileError;
use sofiscope_hal::{CameraIdentity, CameraSettings, Channel, Region, TriggerMode};
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// First frame stamps that differ by more than this are not from one start.
const MOST_LOST_AT_BEGIN: u64 = 1000;

/// Measured periods of one run differ by less than one part in this many.
const MOST_PERIOD_DIFFERENCE: u32 = 100;

/// Opens a recording, one file with both channels, or one file per camera with R before T.
///
/// # Errors
/// [`ReplayError`] for files that are missing, damaged or of another kind, for frames of one camera only, and
/// for files that do not belong together.
pub fn open(paths: &[PathBuf], options: ReplayOptions) -> Result<Replay, ReplayError> {
    check_options(&options)?;
    let parts = match paths {
        [path] if is_recording(path) => recording(path)?,
        [path] => {
            let [reflected, transmitted] = both(path, open_file(path, options.period)?)?;
            files(reflected, transmitted, &options)?
        }
        [first, second] => {
            for path in [first, second] {
                if is_recording(path) {
                    let reason = format!("{} is a whole recording; name it alone", path.display());
                    return Err(ReplayError::Refused { reason });
                }
            }
            let [reflected, transmitted] = pair([first, second], options.period)?;
            files(reflected, transmitted, &options)?
        }
        _ => {
            let reason =
                format!("{} paths were given; name a recording, or the file of R and that of T", paths.len());
            return Err(ReplayError::Refused { reason });
        }
    };
    assemble(parts, options)
}

/// Opens one file per camera; where only one says its period, it holds for both.
fn pair(paths: [&PathBuf; 2], period: Option<Duration>) -> Result<[Opened; 2], ReplayError> {
    let open = |path: &PathBuf, period| one(path, open_file(path, period)?);
    let [reflected, transmitted] = [open(paths[0], period)?, open(paths[1], period)?];
    Ok(match (reflected.period, transmitted.period) {
        (None, Some(known)) => [open(paths[0], Some(known))?, transmitted],
        (Some(known), None) => [reflected, open(paths[1], Some(known))?],
        _ => [reflected, transmitted],
    })
}

fn check_options(options: &ReplayOptions) -> Result<(), ReplayError> {
    let refuse = |reason: &str| Err(ReplayError::Refused { reason: reason.to_owned() });
    if options.period.is_some_and(|period| period.is_zero() || period > Duration::from_secs(3600)) {
        return refuse("the period is not between 0 and an hour");
    }
    if options.pixel_size_nm.is_some_and(|size| !size.is_finite() || size <= 0.0) {
        return refuse("the pixel size is no positive number");
    }
    Ok(())
}

fn is_recording(path: &Path) -> bool {
    path.join(recorded::METADATA).is_file()
}

/// One source per channel of a file or directory, by its content.
fn open_file(path: &Path, period: Option<Duration>) -> Result<Vec<Opened>, ReplayError> {
    let found = fs::metadata(path).map_err(|source| ReplayError::io(path, "open", source))?;
    if found.is_dir() {
        if path.join(zarr::METADATA).is_file() {
            return zarr::open(path, period);
        }
        let (detail, remedy) = if path.join(".zarray").exists() || path.join(".zgroup").exists() {
            ("it is Zarr of version 2", "Convert it to Zarr of version 3 or to TIFF")
        } else {
            ("neither recording.json nor zarr.json is in it", "Name a recording of sofiscope, or image files")
        };
        return Err(ReplayError::unsupported(path, "directory", detail, remedy));
    }
    if !found.is_file() {
        let path = path.to_path_buf();
        return Err(FileError::NotAFile { path, found: "a device or pipe" }.into());
    }
    // Only headers and bare pixels have no sign of what they are.
    if path.extension().is_some_and(|ending| ending == "toml" || ending == "raw") {
        return Ok(vec![raw::open(path, period)?]);
    }
    let file = SourceFile::open(path)?;
    let mut beginning = [0; dcimg::MAGIC.len()];
    let length = file.length.min(beginning.len() as u64) as usize;
    file.read(&mut beginning[..length], 0, "header")?;
    if beginning == *dcimg::MAGIC {
        return Ok(vec![dcimg::open(path, period)?]);
    }
    stack::open(path, period)
}

fn one(path: &Path, opened: Vec<Opened>) -> Result<Opened, ReplayError> {
    let channels = opened.len();
    match <[Opened; 1]>::try_from(opened) {
        Ok([opened]) => Ok(opened),
        Err(_) => {
            let reason = format!("{} has {channels} channels; name it alone", path.display());
            Err(ReplayError::Refused { reason })
        }
    }
}

fn both(path: &Path, opened: Vec<Opened>) -> Result<[Opened; 2], ReplayError> {
    <[Opened; 2]>::try_from(opened).map_err(|_| ReplayError::OneCamera { path: path.to_path_buf() })
}

/// All that makes a replay but the options.
struct Parts {
    opened: [Opened; 2],
    origins: [u64; 2],
    identities: [CameraIdentity; 2],
    settings: [CameraSettings; 2],
    info: ReplayInfo,
}

fn recording(directory: &Path) -> Result<Parts, ReplayError> {
    let recorded = recorded::open(directory)?;
    let cameras = recorded.cameras;
    let [reflected, transmitted] = [&cameras[0], &cameras[1]];
    let size = |camera: &crate::recording::CameraDescription| (camera.height(), camera.width());
    let path = directory.join(recorded::METADATA);
    if size(reflected) != size(transmitted) {
        let detail = format!("R is {:?}, T is {:?}", size(reflected), size(transmitted));
        let remedy = "Cameras of different size are not paired; analyze each by itself";
        return Err(ReplayError::unsupported(&path, "cameras.settings.region", detail, remedy));
    }
    for (camera, channel) in cameras.iter().zip(Channel::BOTH) {
        let CameraSettings { region, period, .. } = camera.settings;
        let ends = region.left.checked_add(region.width).zip(region.top.checked_add(region.height));
        if period.is_zero() || period > Duration::from_secs(3600) || ends.is_none() {
            let detail = format!("a period of {period:?} in {region:?}");
            let field = format!("cameras.{}.settings", channel.letter());
            return Err(ReplayError::damaged(&path, field, detail));
        }
    }
    let settings = Channel::BOTH.map(|channel| CameraSettings {
        trigger: TriggerMode::FreeRunning,
        ..cameras[channel.index()].settings
    });
    let identities = Channel::BOTH.map(|channel| {
        let identity = cameras[channel.index()].identity.clone();
        CameraIdentity { model: format!("replay of {}", identity.model), ..identity }
    });
    let info = ReplayInfo {
        height: settings[0].region.height,
        width: settings[0].region.width,
        exposures: recorded.exposures,
        period: settings[0].period,
        is_period_assumed: false,
        pixel_size_nm: reflected.pixel_size_nm.or(transmitted.pixel_size_nm),
        simulated: recorded.simulated,
        left_out: recorded.left_out,
        provenance: recorded.provenance,
        description: format!("replay of {}, {}", directory.display(), recorded.origin),
    };
    let opened = recorded.sources.map(|source| Opened {
        path: directory.to_path_buf(),
        source: Box::new(source),
        height: info.height,
        width: info.width,
        exposures: info.exposures,
        numbering: Numbering::Exposures,
        period: Some(info.period),
        pixel_size_nm: info.pixel_size_nm,
        saturation_counts: u16::MAX,
        simulated: recorded.simulated,
        kind: "recording",
    });
    Ok(Parts { opened, origins: [0; 2], identities, settings, info })
}

fn files(reflected: Opened, transmitted: Opened, options: &ReplayOptions) -> Result<Parts, ReplayError> {
    let opened = [reflected, transmitted];
    let [reflected, transmitted] = &opened;
    check_belonging(reflected, transmitted)?;
    let origins = origins(reflected, transmitted)?;
    check_counted(&opened, origins)?;
    let period = options.period.or(reflected.period).or(transmitted.period);
    let exposures = opened.iter().zip(origins).map(|(opened, origin)| opened.exposures - origin).max();
    let kinds = if reflected.kind == transmitted.kind {
        reflected.kind.to_owned()
    } else {
        format!("{} and {}", reflected.kind, transmitted.kind)
    };
    let info = ReplayInfo {
        height: reflected.height,
        width: reflected.width,
        exposures: exposures.unwrap_or(0),
        period: period.unwrap_or(PERIOD_UNKNOWN),
        is_period_assumed: period.is_none(),
        pixel_size_nm: reflected.pixel_size_nm.or(transmitted.pixel_size_nm),
        simulated: opened.iter().any(|opened| opened.simulated),
        left_out: BTreeMap::new(),
        provenance: Vec::new(),
        description: if reflected.path == transmitted.path {
            format!("replay of {} ({kinds})", reflected.path.display())
        } else {
            format!("replay of {} and {} ({kinds})", reflected.path.display(), transmitted.path.display())
        },
    };
    let region = Region { left: 0, top: 0, width: info.width, height: info.height };
    let settings = CameraSettings {
        region,
        exposure: info.period,
        period: info.period,
        trigger: TriggerMode::FreeRunning,
    };
    let identities = Channel::BOTH.map(|channel| {
        let name = opened[channel.index()].path.file_name().unwrap_or_default().to_string_lossy();
        CameraIdentity {
            vendor: "sofiscope".to_owned(),
            model: format!("replay of {name}"),
            serial: format!("REPLAY-{}", channel.letter()),
            firmware: env!("CARGO_PKG_VERSION").to_owned(),
            simulated: opened[channel.index()].simulated,
        }
    });
    Ok(Parts { opened, origins, identities, settings: [settings; 2], info })
}

fn check_belonging(reflected: &Opened, transmitted: &Opened) -> Result<(), ReplayError> {
    let names = format!("{} and {}", reflected.path.display(), transmitted.path.display());
    let refuse = |reason: String| Err(ReplayError::Refused { reason });
    let size = |opened: &Opened| format!("{} x {}", opened.height, opened.width);
    if size(reflected) != size(transmitted) {
        let (r, t) = (size(reflected), size(transmitted));
        return refuse(format!("{names} differ in size, {r} and {t} pixels; name two files of one run"));
    }
    let frames = [reflected.source.frames(), transmitted.source.frames()];
    if let (Some(r), Some(t)) = (reflected.period, transmitted.period)
        && r.abs_diff(t) > r.max(t) / MOST_PERIOD_DIFFERENCE
    {
        return refuse(format!("{names} differ in period, {r:?} and {t:?}; name two files of one run"));
    }
    let counted = [reflected, transmitted].iter().any(|opened| opened.numbering == Numbering::Counted);
    if counted && frames[0] != frames[1] {
        return refuse(format!(
            "{names} differ in frames, {} and {}; frames cannot be paired by counting where some are lost",
            frames[0], frames[1]
        ));
    }
    Ok(())
}

/// Refuses counted frames beside numbered ones with gaps: nothing tells where they belong.
fn check_counted(opened: &[Opened; 2], origins: [u64; 2]) -> Result<(), ReplayError> {
    let is_counted = |opened: &Opened| opened.numbering == Numbering::Counted;
    for ((one, origin), other) in opened.iter().zip(origins).zip(opened.iter().rev()) {
        let lost = one.exposures - origin - one.source.frames();
        if is_counted(other) && lost > 0 {
            let reason = format!(
                "{} lost {lost} frames, and those of {} have no numbers to find their partners by",
                one.path.display(),
                other.path.display()
            );
            return Err(ReplayError::Refused { reason });
        }
    }
    Ok(())
}

/// The number that each source gives to the first exposure of both.
fn origins(reflected: &Opened, transmitted: &Opened) -> Result<[u64; 2], ReplayError> {
    match (reflected.numbering, transmitted.numbering) {
        (Numbering::Stamped(r), Numbering::Stamped(t)) if r.abs_diff(t) <= MOST_LOST_AT_BEGIN => {
            Ok([r.min(t); 2])
        }
        (Numbering::Stamped(r), Numbering::Stamped(t)) => {
            let reason = format!(
                "the first frame of {} has the number {r}, that of {} has {t}; both cameras must start together",
                reflected.path.display(),
                transmitted.path.display()
            );
            Err(ReplayError::Refused { reason })
        }
        (r, t) => {
            let first = |numbering| if let Numbering::Stamped(first) = numbering { first } else { 0 };
            Ok([first(r), first(t)])
        }
    }
}

fn assemble(parts: Parts, options: ReplayOptions) -> Result<Replay, ReplayError> {
    let Parts { opened, origins, identities, settings, mut info } = parts;
    info.pixel_size_nm = options.pixel_size_nm.or(info.pixel_size_nm);
    let timeline = Arc::new(Timeline::new(options.clock, options.speed));
    let saturation = [opened[0].saturation_counts, opened[1].saturation_counts];
    let mut channels = Channel::BOTH.into_iter();
    let reels = opened.map(|opened| {
        let channel = channels.next().unwrap_or(Channel::Transmitted);
        Arc::new(Reel {
            channel,
            source: Mutex::new(opened.source),
            origin: origins[channel.index()],
            timeline: Arc::clone(&timeline),
            repeat: options.repeat,
            cut: Mutex::default(),
        })
    });
    let control = ReplayControl { reels: reels.clone(), exposures: info.exposures, period: info.period };
    if info.exposures > 0 || options.start > 0 {
        control.seek(options.start)?;
    }
    let [r, t] = reels;
    let [identity_r, identity_t] = identities;
    let cameras = [
        ReplayCamera::new(r, identity_r, settings[0], saturation[0]),
        ReplayCamera::new(t, identity_t, settings[1], saturation[1]),
    ];
    Ok(Replay { cameras, info, control })
}
