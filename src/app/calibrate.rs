//! `calibrate registration`: where camera R sees what camera T sees, from beads or from the blinking sample itself.
//!
//! In: frames of both cameras. Out: a registration file and a picture of its residuals.
//! Never: overwrites a file, writes a registration that does not fit. Fails: [`AppError`] with what to change.

use super::AppError;
use super::analyze::open_stacks;
use super::residual_map::residual_map;
use super::text_file::read_text;
use crate::config::{Instrument, Registration};
use crate::display::PngNotes;
use crate::files::ImageStack;
use crate::sofi::registration::{
    BeadMatch, CoarseCorrelation, NoiseLine, PatchCorrelation, ReflectedFromTransmitted, find_beads,
    match_beads, root_mean_square, shifted, without_outliers,
};
use ndarray::Array2;
use sofiscope_hal::Channel;
use std::path::{Path, PathBuf};

/// Frames that are correlated as a block, less their mean.
const BLOCK: usize = 16;
/// Blocks that the coarse correlation looks at.
const COARSE_BLOCKS: usize = 12;
/// Longest side of frames that are correlated as a whole; larger ones are averaged in squares first.
const COARSE_SIDE: usize = 256;
/// Rounds of finer correlation, each around the map of the one before.
const ROUNDS: usize = 3;
/// Residuals above this are worth a warning, nanometers.
const LARGE_RESIDUAL_NM: f64 = 20.0;
/// Pixel pitch where nothing says it, nanometers.
const ASSUMED_PITCH_NM: f64 = 108.0;
/// Longest instrument file that is read.
const MOST_BYTES: u64 = 4 << 20;

/// Arguments of `calibrate`.
#[derive(Debug, clap::Args)]
#[command(arg_required_else_help = true)]
pub(super) struct CalibrateArguments {
    #[command(subcommand)]
    what: Calibration,
}

#[derive(Debug, clap::Subcommand)]
enum Calibration {
    /// Where camera R sees what camera T sees
    Registration(RegistrationArguments),
}

/// Arguments of `calibrate registration`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  sofiscope calibrate registration beads-r.ome.tif beads-t.ome.tif --method beads --out registration.toml
  sofiscope calibrate registration r.ome.tif t.ome.tif --method correlation --out registration.toml
  sofiscope analyze r.ome.tif t.ome.tif --registration registration.toml --out result")]
struct RegistrationArguments {
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
    /// Print one object on stdout
    #[arg(long)]
    json: bool,
}

/// How a registration is found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Method {
    Beads,
    Correlation,
}

/// Runs `calibrate`.
///
/// # Errors
/// [`AppError`]: what is wrong with the arguments, the frames or the disk; then nothing is written.
pub(super) fn run(arguments: &CalibrateArguments) -> Result<(), AppError> {
    match &arguments.what {
        Calibration::Registration(arguments) => registration(arguments),
    }
}

fn registration(arguments: &RegistrationArguments) -> Result<(), AppError> {
    let picture_path = arguments.out.with_extension("png");
    for path in [&arguments.out, &picture_path] {
        if path.exists() {
            return Err(AppError::Usage(format!("{} exists; give --out another name", path.display())));
        }
    }
    let instrument = arguments.instrument.as_deref().map(instrument).transpose()?;
    let mut stacks = open(arguments)?;
    let [statistics_r, statistics_t] = statistics(&mut stacks)?;
    let found = match arguments.method {
        Method::Beads => {
            let beads = [&statistics_r, &statistics_t].map(|s| find_beads(&s.mean.view()));
            let size = <[usize; 2]>::from(statistics_r.mean.dim());
            match_beads(&beads[0], &beads[1], size).map_err(AppError::data)?
        }
        Method::Correlation => correlated(&mut stacks)?,
    };
    let noise = match arguments.method {
        // Beads do not blink, so what their pixels do in time is noise.
        Method::Beads => NoiseLine::fit(flat(&statistics_t.mean), flat(&statistics_t.variance)),
        Method::Correlation => statistics_t.noise_between_pixels(),
    };
    let pitch = instrument.as_ref().map(Instrument::pixel_pitch_nm);
    let file_pitch = stacks[0].info().pixel_size_nm.map(|[x, _]| x);
    let pixel_pitch_nm = arguments.pixel_nm.or(pitch).or(file_pitch).unwrap_or(ASSUMED_PITCH_NM);
    let serials = Channel::BOTH.map(|channel| {
        instrument.as_ref().and_then(|i| i.camera(channel)).and_then(|camera| camera.serial.clone())
    });
    let registration = Registration {
        method: if arguments.method == Method::Beads { "beads" } else { "correlation" }.to_owned(),
        date: jiff::Timestamp::now().to_string(),
        serials,
        transform: found.transform,
        pixel_pitch_nm,
        residual_px: found.residual_px,
        noise,
        points: Registration::points_of(&found.pairs, &found.transform),
        points_left_out: found.outliers,
    };
    Registration::from_toml(&registration.to_toml()).map_err(AppError::data)?;
    let map = residual_map(&statistics_r.mean, &registration).map_err(AppError::data)?;
    let notes = PngNotes {
        title: Some("Residuals of the registration of camera T onto camera R".to_owned()),
        pixel_pitch_nm: Some(pixel_pitch_nm),
    };
    map.write_png(&picture_path, &notes).map_err(AppError::data)?;
    std::fs::write(&arguments.out, registration.to_toml())
        .map_err(|error| AppError::Usage(format!("{}: {error}", arguments.out.display())))?;
    tell(&registration, &arguments.out, &picture_path, arguments.json)
}

fn instrument(path: &Path) -> Result<Instrument, AppError> {
    let text = read_text(path, MOST_BYTES)?;
    Instrument::from_toml(&text).map_err(|faults| AppError::Usage(format!("{}: {faults}", path.display())))
}

fn open(arguments: &RegistrationArguments) -> Result<Vec<ImageStack>, AppError> {
    let mut paths = (arguments.reflection.clone(), arguments.transmission.clone());
    if paths.1.is_none() && paths.0.join("recording.json").is_file() {
        paths = (paths.0.join("reflection.ome.tif"), Some(paths.0.join("transmission.ome.tif")));
    }
    let stacks = open_stacks(&paths.0, paths.1.as_deref())?;
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

/// What the frames of one camera are like.
struct Statistics {
    mean: Array2<f32>,
    /// Over time, counts squared.
    variance: Array2<f32>,
    /// Mean square of what differs between neighboring pixels faster than light can, counts squared.
    grain: Array2<f32>,
}

/// Differences that smooth light hardly passes.
const GRAIN: [f64; 4] = [1.0, -3.0, 3.0, -1.0];

impl Statistics {
    /// The noise of pixels that blink, from what differs between neighbors in single frames.
    fn noise_between_pixels(&self) -> Option<NoiseLine> {
        let (height, width) = self.grain.dim();
        // Every pixel's noise counts by its squared weight.
        let squares = GRAIN.map(|weight| weight * weight);
        let total: f64 = squares.iter().sum::<f64>().powi(2);
        let mean = Array2::from_shape_fn((height, width), |(y, x)| {
            let mut sum = 0.0;
            for (j, a) in squares.iter().enumerate() {
                for (i, b) in squares.iter().enumerate() {
                    sum += a * b * f64::from(self.mean[[y + j, x + i]]);
                }
            }
            (sum / total) as f32
        });
        let variance = self.grain.mapv(|square| (f64::from(square) / total) as f32);
        NoiseLine::fit(flat(&mean), flat(&variance))
    }
}

fn flat(image: &Array2<f32>) -> &[f32] {
    image.as_slice().unwrap_or_default()
}

/// Reads all frames once.
fn statistics(stacks: &mut [ImageStack]) -> Result<[Statistics; 2], AppError> {
    let (height, width) = (stacks[0].info().height, stacks[0].info().width);
    let of = |stack: &mut ImageStack| -> Result<Statistics, AppError> {
        let mut counts = vec![0u16; height * width];
        let (mut sums, mut squares) = (vec![0.0; counts.len()], vec![0.0; counts.len()]);
        let grain_size = (height.saturating_sub(3), width.saturating_sub(3));
        let mut grain = Array2::<f64>::zeros(grain_size);
        let mut frames = 0.0;
        stack.seek(0)?;
        while stack.read_counts(&mut counts)? {
            frames += 1.0;
            for ((sum, square), &count) in sums.iter_mut().zip(&mut squares).zip(&counts) {
                let count = f64::from(count);
                *sum += count;
                *square += count * count;
            }
            add_grain(&counts, width, &mut grain);
        }
        let image = |value: &dyn Fn(usize) -> f64| {
            Array2::from_shape_fn((height, width), |(y, x)| value(y * width + x) as f32)
        };
        Ok(Statistics {
            mean: image(&|pixel| sums[pixel] / frames),
            variance: image(&|pixel| (squares[pixel] - sums[pixel] * sums[pixel] / frames) / (frames - 1.0)),
            grain: grain.mapv(|sum| (sum / frames) as f32),
        })
    };
    let [r, t] = stacks else { return Err(AppError::usage("a registration needs two cameras")) };
    Ok([of(r)?, of(t)?])
}

fn add_grain(counts: &[u16], width: usize, grain: &mut Array2<f64>) {
    let across: Vec<f32> = counts
        .windows(4)
        .map(|p| p.iter().zip(GRAIN).map(|(&count, weight)| f32::from(count) * weight as f32).sum())
        .collect();
    for ((y, x), sum) in grain.indexed_iter_mut() {
        let value: f32 =
            GRAIN.iter().enumerate().map(|(j, weight)| across[(y + j) * width + x] * *weight as f32).sum();
        *sum += f64::from(value * value);
    }
}

/// Blocks of frames of both cameras, as long as there are any.
fn blocks(
    stacks: &mut [ImageStack],
    mut work: impl FnMut(&[&[u16]], &[&[u16]]) -> bool,
) -> Result<(), AppError> {
    let pixels = stacks[0].info().height * stacks[0].info().width;
    let mut memory = vec![vec![vec![0u16; pixels]; BLOCK]; 2];
    stacks.iter_mut().try_for_each(|stack| stack.seek(0))?;
    loop {
        let mut read = 0;
        for frame in 0..BLOCK {
            let mut both = true;
            for (stack, frames) in stacks.iter_mut().zip(&mut memory) {
                both &= stack.read_counts(&mut frames[frame])?;
            }
            if !both {
                break;
            }
            read += 1;
        }
        if read < 2 {
            return Ok(());
        }
        let [r, t] =
            [0, 1].map(|camera: usize| memory[camera][..read].iter().map(Vec::as_slice).collect::<Vec<_>>());
        if !work(&r, &t) {
            return Ok(());
        }
    }
}

/// The registration by what blinks together.
fn correlated(stacks: &mut [ImageStack]) -> Result<BeadMatch, AppError> {
    let nothing = || {
        AppError::data(
            "nothing fluctuates together in both cameras; record a blinking sample that both cameras see, \
             with more frames or more light, or use --method beads",
        )
    };
    let size = [stacks[0].info().height, stacks[0].info().width];
    let square = size[0].max(size[1]).div_ceil(COARSE_SIDE);
    let small = size.map(|side| side / square);
    let mut coarse = CoarseCorrelation::new(small);
    let mut seen = 0;
    blocks(stacks, |r, t| {
        let [r, t] = [r, t].map(|frames| fluctuations(frames, size, square));
        r.iter().zip(&t).for_each(|(r, t)| coarse.push(r, t));
        seen += 1;
        seen < COARSE_BLOCKS
    })?;
    let (mirror, shift) = coarse.best().ok_or_else(nothing)?;
    // Squares of flipped T do not begin where T does, if its side is no multiple.
    let flips = mirror.flips();
    let shift = std::array::from_fn(|axis| {
        let left_over = (size[axis] - small[axis] * square) as f64;
        shift[axis] * square as f64 + if flips[axis] { left_over } else { 0.0 }
    });
    let mut transform = shifted(mirror, shift, size);
    let mut last = None;
    for _ in 0..ROUNDS {
        let mut patches = PatchCorrelation::new(transform);
        blocks(stacks, |r, t| {
            patches.push(r, t);
            true
        })?;
        let pairs = patches.pairs();
        let (affine, inliers) = without_outliers(&pairs).ok_or_else(nothing)?;
        transform = ReflectedFromTransmitted { affine, ..transform };
        last = Some((pairs.len() - inliers.len(), inliers));
    }
    let (outliers, pairs) = last.ok_or_else(nothing)?;
    Ok(BeadMatch { transform, outliers, residual_px: root_mean_square(&transform.affine, &pairs), pairs })
}

/// Frames with squares of pixels averaged, less their mean.
fn fluctuations(frames: &[&[u16]], [height, width]: [usize; 2], square: usize) -> Vec<Vec<f32>> {
    let (rows, columns) = (height / square, width / square);
    let mut all: Vec<Vec<f32>> = frames
        .iter()
        .map(|frame| {
            let mut averaged = vec![0.0; rows * columns];
            for y in 0..rows * square {
                for x in 0..columns * square {
                    averaged[y / square * columns + x / square] += f32::from(frame[y * width + x]);
                }
            }
            averaged
        })
        .collect();
    for pixel in 0..rows * columns {
        let mean = all.iter().map(|frame| frame[pixel]).sum::<f32>() / all.len() as f32;
        all.iter_mut().for_each(|frame| frame[pixel] -= mean);
    }
    all
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
    println!("wrote {} and {}", file.display(), map.display());
    Ok(())
}
