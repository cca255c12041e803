//! `calibrate registration`: where camera R sees what camera T sees, from beads or from the blinking sample itself.
//!
//! In: frames of both cameras. Out: a registration file and a picture of its residuals.
//! Never: overwrites a file, writes a registration that does not fit. Fails: [`AppError`] with what to change.

use super::found::{BEAD_NM, Cameras, LARGE_RESIDUAL_NM, Method, find};
use super::{instrument, open, vacant};
use crate::app::AppError;
use crate::config::{Instrument, Registration};
use crate::files::ImageStack;
use crate::sofi::psf_width::without_pixels;
use sofiscope_hal::Channel;
use std::path::{Path, PathBuf};

/// Pixel pitch where nothing says it, nanometers.
const ASSUMED_PITCH_NM: f64 = 108.0;

/// Arguments of `calibrate registration`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  sofiscope calibrate registration beads-r.ome.tif beads-t.ome.tif --method beads --out registration.toml
  sofiscope calibrate registration r.ome.tif t.ome.tif --method correlation --out registration.toml
  sofiscope analyze r.ome.tif t.ome.tif --registration registration.toml --out result")]
pub(super) struct RegistrationArguments {
    /// Stack of camera R, or one with both cameras as channels, or a recording
    reflection: PathBuf,
    /// Stack of camera T
    transmission: Option<PathBuf>,
    /// beads: small beads seen by both cameras; correlation: what blinks together in any sample
    #[arg(long, value_enum, default_value_t = Method::Beads)]
    method: Method,
    /// The file to write; the picture of residuals gets the same name with .png
    #[arg(long, default_value = "registration.toml")]
    out: PathBuf,
    /// Instrument file, for the serial numbers of the cameras and the pixel pitch
    #[arg(long)]
    instrument: Option<PathBuf>,
    /// Size of a camera pixel in the sample, nanometers
    #[arg(long)]
    pixel_nm: Option<f64>,
    /// Diameter of the beads, nanometers; taken off the width of the point-spread function, 0 for points
    #[arg(long, default_value_t = BEAD_NM)]
    bead_nm: f64,
    /// Print one object on stdout
    #[arg(long)]
    json: bool,
}

/// Runs `calibrate registration`.
///
/// # Errors
/// [`AppError`]: what is wrong with the arguments, the frames or the disk; then nothing is written.
pub(super) fn run(arguments: &RegistrationArguments) -> Result<(), AppError> {
    if !(0.0..=10_000.0).contains(&arguments.bead_nm) {
        return Err(AppError::Usage(format!(
            "beads of {} nm make no sense; give --bead-nm from 0 to 10000, in nanometers",
            arguments.bead_nm
        )));
    }
    vacant([&arguments.out, &arguments.out.with_extension("png")])?;
    let instrument = arguments.instrument.as_deref().map(instrument).transpose()?;
    let mut stacks = both(arguments)?;
    let pitch = instrument.as_ref().map(Instrument::pixel_pitch_nm);
    let file_pitch = stacks[0].info().pixel_size_nm.map(|[x, _]| x);
    let pixel_pitch_nm = arguments.pixel_nm.or(pitch).or(file_pitch).unwrap_or(ASSUMED_PITCH_NM);
    let serials = Channel::BOTH.map(|channel| {
        instrument.as_ref().and_then(|i| i.camera(channel)).and_then(|camera| camera.serial.clone())
    });
    let found =
        find(&mut stacks, arguments.method, Cameras { pixel_pitch_nm, serials, bead_nm: arguments.bead_nm })?;
    let picture_path = found.write(&arguments.out)?;
    tell(&found.registration, &arguments.out, &picture_path, arguments.json)
}

/// The stacks of both cameras, frame by frame.
fn both(arguments: &RegistrationArguments) -> Result<Vec<ImageStack>, AppError> {
    let stacks = open(&arguments.reflection, arguments.transmission.as_deref())?;
    let [r, t] = &stacks[..] else {
        return Err(AppError::usage("a registration needs two cameras; give the stack of camera T as well"));
    };
    let (a, b) = (r.info(), t.info());
    if (a.height, a.width) != (b.height, b.width) {
        return Err(AppError::Data(format!(
            "the cameras differ in size: {} x {} and {} x {} pixels; crop both to the same size",
            a.width, a.height, b.width, b.height
        )));
    }
    if a.frames.min(b.frames) < 2 || a.frames != b.frames {
        return Err(AppError::Data(format!(
            "camera R has {} frames and camera T {}; give the same number of both, at least 2",
            a.frames, b.frames
        )));
    }
    Ok(stacks)
}

/// What scripts are told.
#[derive(Debug, serde::Serialize)]
struct Told<'a> {
    registration: &'a Path,
    residual_map: &'a Path,
    method: &'a str,
    mirror: &'a str,
    rotation_deg: f64,
    scale: f64,
    central_shift_px: [f64; 2],
    residual_px: f64,
    residual_nm: f64,
    points: usize,
    points_left_out: usize,
    noise_is_known: bool,
    /// Width of the point-spread function of R and T with that of the pixels, standard deviation in pixels of R.
    psf_sigma_px: Option<[f64; 2]>,
}

fn tell(registration: &Registration, file: &Path, map: &Path, json: bool) -> Result<(), AppError> {
    let Registration { transform, method, residual_px, pixel_pitch_nm, points, points_left_out, .. } =
        registration;
    let residual_nm = residual_px * pixel_pitch_nm;
    let (rotation_deg, scale, shift) =
        (transform.rotation_deg(), transform.scale(), transform.central_shift());
    if residual_nm > LARGE_RESIDUAL_NM {
        eprintln!("the residual of {residual_nm:.1} nm is large; look at {}", map.display());
    }
    if registration.noise.is_none() {
        eprintln!(
            "the noise of camera T could not be found from these frames; add [transmitted_noise] to {}",
            file.display()
        );
    }
    if json {
        let told = Told {
            registration: file,
            residual_map: map,
            method,
            mirror: transform.mirror.name(),
            rotation_deg,
            scale,
            central_shift_px: shift,
            residual_px: *residual_px,
            residual_nm,
            points: points.len(),
            points_left_out: *points_left_out,
            noise_is_known: registration.noise.is_some(),
            psf_sigma_px: registration.psf_sigma_px,
        };
        println!("{}", serde_json::to_string(&told).map_err(AppError::data)?);
        return Ok(());
    }
    println!(
        "mirror {}, rotation {rotation_deg:.3} degrees, scale {scale:.5}, shift of the middle ({:.2}, {:.2}) px",
        transform.mirror.name(),
        shift[0],
        shift[1]
    );
    println!("residual {residual_nm:.1} nm over {} points, {points_left_out} left out", points.len());
    if let Some([Some(r), Some(t)]) = registration.psf_sigma_px.map(|widths| widths.map(without_pixels)) {
        println!(
            "width of the point-spread function on beads: {:.1} nm (R), {:.1} nm (T), standard deviation",
            r * pixel_pitch_nm,
            t * pixel_pitch_nm
        );
    }
    println!("wrote {} and {}", file.display(), map.display());
    Ok(())
}
