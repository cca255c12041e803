//! `analyze`: from two stacks of frames, or one, to the unmixed super-resolved image.

use super::AppError;
use super::analysis::{Calibrations, Prepared, Source};
use super::analysis_arguments::AnalysisArguments;
use super::replay::{ReplayRequest, play};
use super::results::{ensure_space, write_results};
use super::text_file::read_text;
use crate::config::{AnalysisFaults, AnalysisSettings, RawAnalysis};
use crate::files::{ImageStack, OutputDirectory, SampleType};
use crate::reconstruction::BLOCK;
use crate::replay::{ReplayOptions, ReplaySpeed};
use crate::sofi::cumulant::Count;
use ndarray::Array2;
use std::path::{Path, PathBuf};

/// Share of saturated pixel values above which the report warns.
const SATURATED_SHARE: f64 = 1e-4;

/// Longest settings file that is read.
const MOST_SETTINGS_BYTES: u64 = 64 << 10;

/// Arguments of `analyze`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  sofiscope analyze reflection.ome.tif transmission.ome.tif \\
      --species \"Alexa Fluor 488,Atto 565,Alexa Fluor 647\" --dichroic \"zt 594 RDC\" --out result
  sofiscope analyze one-camera.tif --psf-sigma 1.15 --out result
  sofiscope analyze r.tif t.tif --settings analysis.toml --order 3 --out result3")]
pub(super) struct AnalyzeArguments {
    /// Stack of camera R (reflection), or a stack with both cameras as channels, or the only camera, or a recording
    reflection: PathBuf,
    /// Stack of camera T (transmission, the long-wavelength side)
    transmission: Option<PathBuf>,
    /// Settings file (TOML); arguments win over it
    #[arg(long)]
    settings: Option<PathBuf>,
    #[command(flatten)]
    analysis: AnalysisArguments,
    /// Pixel sets: all-closest, one-per-position or sofipackage
    #[arg(long)]
    combinations: Option<String>,
    /// Standard deviation of the camera's point-spread function, camera pixels
    #[arg(long)]
    psf_sigma: Option<f64>,
    /// Size of a camera pixel in the sample, nanometers
    #[arg(long)]
    pixel_nm: Option<f64>,
    /// Iterations of Lucy-Richardson
    #[arg(long)]
    iterations: Option<usize>,
    /// Keep species from going negative
    #[arg(long)]
    non_negative: bool,
    /// Leave the linearized image as sharp as the deconvolution made it
    #[arg(long)]
    no_reconvolution: bool,
    /// Directory for the results; must not exist
    #[arg(long, default_value = "sofiscope-result")]
    out: PathBuf,
    /// Print one object on stdout
    #[arg(long)]
    json: bool,
}

/// Runs `analyze`.
///
/// # Errors
/// [`AppError`]: what is wrong with the arguments, the files or the disk; then there is no result directory.
pub(super) fn run(arguments: &AnalyzeArguments) -> Result<(), AppError> {
    if arguments.transmission.is_none() && arguments.reflection.join("recording.json").is_file() {
        return analyze_recording(arguments);
    }
    let settings = AnalysisSettings::try_from(raw_settings(arguments)?).map_err(AppError::usage)?;
    let mut stacks = open_stacks(&arguments.reflection, arguments.transmission.as_deref())?;
    let mut prepared = Prepared::new(settings, source(&stacks)?)?;
    prepared.warnings.extend(same_file(arguments));
    let out = OutputDirectory::create(&arguments.out)?;
    ensure_space(&prepared, &out)?;
    let float = stacks.iter().any(|stack| stack.info().sample == SampleType::Float32);
    let limit = prepared.settings.saturation_counts;
    let analysis = if float {
        let limit = limit.unwrap_or(f32::INFINITY);
        let mut saturation = Saturation::new(&stacks, &prepared, |_| limit);
        let analysis = prepared.run::<f32>(|_, blocks| read_block(&mut stacks, blocks, &mut saturation))?;
        saturation.warn(analysis)?
    } else {
        let mut saturation =
            Saturation::new(&stacks, &prepared, |sample| limit.unwrap_or(largest_count(sample)));
        let analysis = prepared.run::<u16>(|_, blocks| read_block(&mut stacks, blocks, &mut saturation))?;
        saturation.warn(analysis)?
    };
    let command = std::env::args().collect::<Vec<_>>().join(" ");
    let summary = write_results(&analysis, &out, &command, None)?;
    let results = out.commit()?;
    summary.print(&results, arguments.json)
}

/// A recording goes through the pipeline of live frames, as fast as it can be read.
fn analyze_recording(arguments: &AnalyzeArguments) -> Result<(), AppError> {
    let request = ReplayRequest {
        paths: std::slice::from_ref(&arguments.reflection),
        options: ReplayOptions { speed: ReplaySpeed::Max, ..ReplayOptions::default() },
        settings: raw_settings(arguments)?,
        as_live: false,
    };
    let (_, results, summary) = play(request, &arguments.out)?;
    summary.print(&results, arguments.json)
}

fn raw_settings(arguments: &AnalyzeArguments) -> Result<RawAnalysis, AppError> {
    let given = RawAnalysis {
        combinations: arguments.combinations.clone(),
        unmixing: arguments.non_negative.then(|| "non-negative".to_owned()),
        iterations: arguments.iterations,
        reconvolution: arguments.no_reconvolution.then_some(false),
        psf_sigma_px: arguments.psf_sigma,
        pixel_pitch_nm: arguments.pixel_nm,
        ..arguments.analysis.raw()
    };
    let file = match &arguments.settings {
        Some(path) => read_settings(path)?,
        None => RawAnalysis::default(),
    };
    Ok(given.or(file))
}

fn read_settings(path: &Path) -> Result<RawAnalysis, AppError> {
    let text = read_text(path, MOST_SETTINGS_BYTES)?;
    let refused = |faults: AnalysisFaults| AppError::Usage(format!("{}, {faults}", path.display()));
    let raw = RawAnalysis::from_toml(&text).map_err(refused)?;
    AnalysisSettings::try_from(raw.clone()).map_err(refused)?;
    Ok(raw)
}

/// One stack per channel; a stack that holds both cameras is opened once for each.
pub(super) fn open_stacks(
    reflection_path: &Path,
    transmission: Option<&Path>,
) -> Result<Vec<ImageStack>, AppError> {
    let reflection = ImageStack::open(reflection_path)?;
    let Some(transmission) = transmission else {
        let channels = reflection.info().channels;
        if channels == 1 {
            return Ok(vec![reflection]);
        }
        if channels > 2 {
            return Err(AppError::Data(format!(
                "{} has {channels} channels; give a stack of one or two cameras",
                reflection_path.display()
            )));
        }
        let select = |channel| -> Result<ImageStack, AppError> {
            let mut stack = ImageStack::open(reflection_path)?;
            stack.select_channel(channel)?;
            Ok(stack)
        };
        return (0..channels).map(select).collect();
    };
    let stacks = vec![reflection, ImageStack::open(transmission)?];
    for stack in &stacks {
        if stack.info().channels > 1 {
            return Err(AppError::Data(format!(
                "{} holds {} channels; give one stack per camera, or this file alone",
                stack.path().display(),
                stack.info().channels
            )));
        }
    }
    Ok(stacks)
}

/// A slip of the hand that no number would show.
fn same_file(arguments: &AnalyzeArguments) -> Option<String> {
    let transmission = arguments.transmission.as_ref()?.canonicalize().ok()?;
    let is_same = arguments.reflection.canonicalize().ok()? == transmission;
    is_same.then(|| {
        format!(
            "{} was given for both cameras, which tells no dyes apart; give the stack of camera T as the second.",
            arguments.reflection.display()
        )
    })
}

fn source(stacks: &[ImageStack]) -> Result<Source, AppError> {
    let first = stacks[0].info();
    for other in &stacks[1..] {
        let (a, b) = (stacks[0].path().display(), other.path().display());
        let info = other.info();
        if (info.height, info.width) != (first.height, first.width) {
            return Err(AppError::Data(format!(
                "the cameras differ in size: {a} has {} x {} pixels, {b} has {} x {}; crop both to the same region",
                first.width, first.height, info.width, info.height
            )));
        }
        if info.frames != first.frames {
            return Err(AppError::Data(format!(
                "the cameras differ in frames: {a} has {}, {b} has {}; frames cannot be paired by counting, \
                 export both cameras again or cut them to the exposures they share",
                first.frames, info.frames
            )));
        }
    }
    let roles = if stacks.len() == 1 { vec!["camera"] } else { vec!["camera R", "camera T"] };
    let input = |(stack, role): (&ImageStack, &str)| {
        (role.to_owned(), stack.path().display().to_string(), stack.info().sample.name().to_owned())
    };
    Ok(Source {
        inputs: stacks.iter().zip(roles).map(input).collect(),
        height: first.height,
        width: first.width,
        frames: first.frames as u64,
        pixel_pitch_nm: first.pixel_size_nm.map(|[x, _]| x),
        exposure_ms: first.frame_interval.map(|interval| interval.as_secs_f64() * 1e3),
        simulated: stacks.iter().all(|stack| stack.info().is_simulated()),
        species: None,
        serials: [None, None],
        registration: None,
        calibrations: Calibrations::default(),
    })
}

/// A pixel type that stacks can be read into.
trait Readable: Count + Default + PartialOrd {
    fn read(stack: &mut ImageStack, frame: &mut [Self]) -> Result<bool, AppError>;
}

impl Readable for u16 {
    fn read(stack: &mut ImageStack, frame: &mut [Self]) -> Result<bool, AppError> {
        Ok(stack.read_counts(frame)?)
    }
}

impl Readable for f32 {
    fn read(stack: &mut ImageStack, frame: &mut [Self]) -> Result<bool, AppError> {
        if stack.info().sample == SampleType::Float32 {
            let read = stack.read_values(frame)?;
            if read {
                stack.check_finite(frame)?;
            }
            return Ok(read);
        }
        let mut counts = vec![0u16; frame.len()];
        let read = stack.read_counts(&mut counts)?;
        frame.iter_mut().zip(counts).for_each(|(value, count)| *value = Self::from(count));
        Ok(read)
    }
}

fn read_block<T: Readable>(
    stacks: &mut [ImageStack],
    blocks: &mut [Vec<T>],
    saturation: &mut Saturation,
) -> Result<usize, AppError> {
    let mut read = 0;
    for ((stack, block), camera) in stacks.iter_mut().zip(blocks).zip(&mut saturation.cameras) {
        let pixels = block.len() / BLOCK;
        read = 0;
        for frame in block.chunks_exact_mut(pixels) {
            if !T::read(stack, frame)? {
                break;
            }
            read += 1;
        }
        if read > 0 {
            camera.look_at(&block[..pixels]);
        }
    }
    Ok(read)
}

/// How many pixel values are at the camera's limit, judged on raw counts of one frame per block.
struct Saturation {
    cameras: Vec<SaturatedCamera>,
}

struct SaturatedCamera {
    limit: f32,
    saturated: u64,
    seen: u64,
    /// Pixels that are left out anyway.
    mask: Option<Array2<bool>>,
}

impl Saturation {
    fn new(stacks: &[ImageStack], prepared: &Prepared, limit: impl Fn(SampleType) -> f32) -> Self {
        let camera = |(channel, stack): (usize, &ImageStack)| SaturatedCamera {
            limit: limit(stack.info().sample),
            saturated: 0,
            seen: 0,
            mask: prepared.engine.camera(channel).and_then(|maps| maps.mask()),
        };
        Self { cameras: stacks.iter().enumerate().map(camera).collect() }
    }

    fn warn(&self, mut analysis: super::analysis::Analysis) -> Result<super::analysis::Analysis, AppError> {
        for (camera, (role, path, _)) in self.cameras.iter().zip(&analysis.prepared.source.inputs) {
            let share = camera.saturated as f64 / camera.seen.max(1) as f64;
            if share > SATURATED_SHARE {
                analysis.warnings.push(format!(
                    "{role} {path}: {:.2} % of the pixel values are saturated (at {} counts); cumulants there are wrong.",
                    100.0 * share,
                    camera.limit
                ));
            }
        }
        Ok(analysis)
    }
}

impl SaturatedCamera {
    fn look_at<T: Count>(&mut self, frame: &[T]) {
        self.seen += frame.len() as u64;
        let mut saturated = frame.iter().enumerate().filter(|(_, count)| count.counts() >= self.limit);
        self.saturated += match self.mask.as_ref().and_then(|mask| mask.as_slice()) {
            Some(mask) => saturated.filter(|(pixel, _)| !mask[*pixel]).count() as u64,
            None => saturated.by_ref().count() as u64,
        };
    }
}

fn largest_count(sample: SampleType) -> f32 {
    match sample {
        SampleType::Uint8 => f32::from(u8::MAX),
        _ => f32::from(u16::MAX),
    }
}
