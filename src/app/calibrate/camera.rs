//! `calibrate camera`: offset, gain, read noise and faults of every pixel, from darks and a photon-transfer series.
//!
//! In: a recording without light and some of even light. Out: a file of maps, and one that says where they come from.
//! Never: overwrites a file, holds more than sums per pixel. Fails: [`AppError`] with what to change.

use super::source::{CameraFrames, camera_frames};
use super::{instrument, vacant};
use crate::app::AppError;
use crate::app::camera_maps::write_maps;
use crate::app::progress::Progress;
use crate::config::{CameraCalibration, Instrument};
use crate::sofi::camera::{PhotonTransfer, PixelFault, PixelMoments, PixelStatistics, photon_transfer};
use ndarray::Array2;
use sofiscope_hal::{Channel, Region};
use std::path::{Path, PathBuf};

/// Share of pixels left out above which something else is wrong.
const MANY_FAULTS: f64 = 0.01;

/// Arguments of `calibrate camera`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  sofiscope calibrate camera --dark dark-r.tif --flat flat-1.tif --flat flat-2.tif --flat flat-3.tif --out camera-r.toml
  sofiscope calibrate camera --dark run-dark --flat run-dim --flat run-bright --camera transmitted --out camera-t.toml
  sofiscope analyze r.tif t.tif --camera-maps camera-r.toml,camera-t.toml --out result

Darks and flats need the same exposure time and region. Flats: even light of 3 or more levels up to half of the range,
some hundred frames each; the error of the gain of a pixel is about the square root of 2 over all frames.")]
pub(super) struct CameraArguments {
    /// Recording without light: a stack, a recording, or a directory of `simulate`
    #[arg(long)]
    dark: PathBuf,
    /// Recording of even light; give several of different levels
    #[arg(long, required = true)]
    flat: Vec<PathBuf>,
    /// Which camera, where the recordings are of two
    #[arg(long, value_enum, default_value_t = Side::Reflected)]
    camera: Side,
    /// Counts at which the camera saturates [default: the most that the file can hold]
    #[arg(long)]
    saturation_counts: Option<u16>,
    /// The file to write; the maps get the same name with .ome.tif
    #[arg(long, default_value = "camera.toml")]
    out: PathBuf,
    /// Instrument file, for the serial number and the region of the camera
    #[arg(long)]
    instrument: Option<PathBuf>,
    /// Print one object on stdout
    #[arg(long)]
    json: bool,
}

/// A side of the dichroic.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Side {
    Reflected,
    Transmitted,
}

impl Side {
    fn channel(self) -> Channel {
        match self {
            Self::Reflected => Channel::Reflected,
            Self::Transmitted => Channel::Transmitted,
        }
    }
}

/// Runs `calibrate camera`.
///
/// # Errors
/// [`AppError`]: what is wrong with the arguments, the frames or the disk; then nothing is written.
pub(super) fn run(arguments: &CameraArguments) -> Result<(), AppError> {
    let maps_path = arguments.out.with_extension("ome.tif");
    vacant([&arguments.out, &maps_path])?;
    let maps_file = maps_path
        .file_name()
        .map(|name| name.to_string_lossy().into_owned())
        .ok_or_else(|| AppError::usage("--out names no file; give a name that ends in .toml"))?;
    let instrument = arguments.instrument.as_deref().map(instrument).transpose()?;
    let channel = arguments.camera.channel();
    let mut dark_frames = camera_frames(&arguments.dark, channel)?;
    let saturation = arguments.saturation_counts.unwrap_or_else(|| dark_frames.largest_count());
    let dark = moments(&mut dark_frames, saturation, None)?;
    let mut flats = Vec::new();
    for path in &arguments.flat {
        let mut frames = camera_frames(path, channel)?;
        ensure_alike(&dark_frames, &frames)?;
        flats.push(moments(&mut frames, saturation, Some(&dark.mean))?);
    }
    let found = photon_transfer(&dark, &flats).map_err(AppError::data)?;
    let calibration =
        calibration(arguments, instrument.as_ref(), &dark_frames, &found, (maps_file, saturation));
    CameraCalibration::from_toml(&calibration.to_toml()).map_err(AppError::data)?;
    let name = format!("maps of camera {}", channel.letter());
    write_maps(
        &maps_path,
        &name,
        [&found.offset, &found.gain, &found.read_variance],
        &found.faults,
        Some([&found.offset_error, &found.gain_error, &found.read_variance_error]),
    )?;
    std::fs::write(&arguments.out, calibration.to_toml())
        .map_err(|error| AppError::Usage(format!("{}: {error}", arguments.out.display())))?;
    tell(&calibration, &found, (&arguments.out, &maps_path), arguments.json)
}

/// Reads a recording once.
fn moments(
    frames: &mut CameraFrames,
    saturation: u16,
    offset: Option<&Array2<f32>>,
) -> Result<PixelMoments, AppError> {
    let size = frames.size();
    let mut statistics = PixelStatistics::new(size, saturation);
    let mut counts = vec![0; size[0] * size[1]];
    let label = if offset.is_some() { "flat" } else { "dark" };
    let mut progress = Progress::begin(label, frames.stack.info().frames as u64);
    while frames.stack.read_counts(&mut counts)? {
        statistics.push(&counts);
        progress.advance(1);
    }
    progress.finish();
    Ok(statistics.finish(offset))
}

fn ensure_alike(dark: &CameraFrames, flat: &CameraFrames) -> Result<(), AppError> {
    let (a, b) = (dark.stack.path().display(), flat.stack.path().display());
    let ([height, width], [rows, columns]) = (dark.size(), flat.size());
    if dark.size() != flat.size() || dark.region != flat.region {
        return Err(AppError::Data(format!(
            "{a} ({width} x {height} pixels) and {b} ({columns} x {rows}) are not of the same part of the sensor; \
             record them with the same region"
        )));
    }
    if dark.serial != flat.serial {
        return Err(AppError::Data(format!("{a} and {b} are of different cameras; calibrate one at a time")));
    }
    let intervals = (dark.stack.info().frame_interval, flat.stack.info().frame_interval);
    if let (Some(dark), Some(flat)) = intervals
        && dark.abs_diff(flat) > dark / 100
    {
        eprintln!(
            "warning: {a} and {b} have different times per frame ({dark:?}, {flat:?}); \
             dark current makes the offset depend on the exposure"
        );
    }
    Ok(())
}

fn calibration(
    arguments: &CameraArguments,
    instrument: Option<&Instrument>,
    dark: &CameraFrames,
    found: &PhotonTransfer,
    (maps_file, saturation_counts): (String, u16),
) -> CameraCalibration {
    let camera = instrument.and_then(|instrument| instrument.camera(arguments.camera.channel()));
    let [height, width] = dark.size().map(|side| side as u32);
    let of_instrument =
        camera.and_then(|camera| camera.region).filter(|r| (r.width, r.height) == (width, height));
    let typical = |map: &Array2<f32>| {
        let mut values: Vec<f32> = map.iter().copied().filter(|value| value.is_finite()).collect();
        values.sort_by(f32::total_cmp);
        values.get(values.len() / 2).map_or(0.0, |&value| f64::from(value))
    };
    let gain = typical(&found.gain);
    let pixels =
        |fault: PixelFault| found.faults.iter().filter(|faults| **faults & fault.bit() != 0).count() as u64;
    let path = |path: &Path| path.canonicalize().unwrap_or_else(|_| path.to_owned()).display().to_string();
    CameraCalibration {
        serial: dark.serial.clone().or_else(|| camera.and_then(|camera| camera.serial.clone())),
        date: jiff::Timestamp::now().to_string(),
        maps_file,
        region: dark.region.or(of_instrument).unwrap_or(Region { left: 0, top: 0, width, height }),
        saturation_counts,
        gain_counts_per_electron: gain,
        offset_counts: typical(&found.offset),
        read_noise_electrons: typical(&found.read_variance).max(0.0).sqrt() / gain,
        faulty_pixels: PixelFault::ALL.map(pixels),
        dark: path(&arguments.dark),
        flats: arguments.flat.iter().map(|flat| path(flat)).collect(),
    }
}

/// What scripts are told.
#[derive(Debug, serde::Serialize)]
struct Told<'a> {
    calibration: &'a Path,
    maps: &'a Path,
    gain_counts_per_electron: f64,
    offset_counts: f64,
    read_noise_electrons: f64,
    hot_pixels: u64,
    dead_pixels: u64,
    saturated_pixels: u64,
    masked_pixels: usize,
}

fn tell(
    calibration: &CameraCalibration,
    found: &PhotonTransfer,
    (file, maps): (&Path, &Path),
    json: bool,
) -> Result<(), AppError> {
    let [hot_pixels, dead_pixels, saturated_pixels] = calibration.faulty_pixels;
    let masked_pixels = found.faults.iter().filter(|faults| **faults != 0).count();
    let &CameraCalibration { gain_counts_per_electron, offset_counts, read_noise_electrons, .. } =
        calibration;
    if masked_pixels as f64 > MANY_FAULTS * found.faults.len() as f64 {
        eprintln!(
            "warning: {masked_pixels} of {} pixels are left out; check that the dark was dark and the light even",
            found.faults.len()
        );
    }
    if json {
        let told = Told {
            calibration: file,
            maps,
            gain_counts_per_electron,
            offset_counts,
            read_noise_electrons,
            hot_pixels,
            dead_pixels,
            saturated_pixels,
            masked_pixels,
        };
        println!("{}", serde_json::to_string(&told).map_err(AppError::data)?);
        return Ok(());
    }
    println!(
        "gain {gain_counts_per_electron:.3} counts per electron, offset {offset_counts:.1} counts, \
         read noise {read_noise_electrons:.2} electrons (middle pixel)"
    );
    println!(
        "{masked_pixels} pixels are left out: {hot_pixels} hot, {dead_pixels} dead, {saturated_pixels} saturated"
    );
    println!("wrote {} and {}", file.display(), maps.display());
    Ok(())
}
