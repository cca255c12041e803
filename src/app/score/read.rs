//! Reads the images of a result directory and the truth beside its simulation.

use std::path::{Path, PathBuf};

use sofiscope_sim::Truth;

use super::{Images, Score, Stage, StageImages, score_images, text};
use crate::app::AppError;
use crate::app::simulate::TRUTH_FILE;
use crate::app::text_file::read_text;
use crate::files::{ImageStack, SampleType};

/// A truth is refused unread above this size.
const MAX_TRUTH_BYTES: u64 = 256 << 20;
/// Orders above this are not analyzed, so images are at most so many times finer than the cameras.
const MAX_FOLD: usize = 6;

/// Arguments of `score`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  sofiscope simulate figure-s4 --out /tmp/s4
  sofiscope analyze /tmp/s4/reflection.ome.tif /tmp/s4/transmission.ome.tif --out /tmp/s4-result
  sofiscope score /tmp/s4-result --truth /tmp/s4
  sofiscope score /tmp/s4-result --truth /tmp/s4 --json

RESULT holds unmixed.ome.tif, flattened.ome.tif and linearized.ome.tif, or some of them.")]
pub struct ScoreArguments {
    /// Directory that `analyze` wrote
    result: PathBuf,
    /// Directory that `simulate` wrote
    #[arg(long, value_name = "DIR")]
    truth: PathBuf,
    /// Print one object on stdout
    #[arg(long)]
    json: bool,
}

/// Runs `score`.
///
/// # Errors
/// A usage error for wrong paths, a data error for images that do not belong to the truth.
pub fn run(arguments: &ScoreArguments) -> Result<(), AppError> {
    let score = score_result(&arguments.result, &arguments.truth)?;
    if arguments.json {
        println!("{}", serde_json::to_string_pretty(&score).map_err(AppError::data)?);
    } else {
        print!("{}", text(&score));
    }
    Ok(())
}

/// Scores a result directory against a simulation directory.
///
/// # Errors
/// As [`run`].
pub fn score_result(result: &Path, truth: &Path) -> Result<Score, AppError> {
    let truth = read_truth(truth)?;
    let mut read = Vec::new();
    let mut missing = Vec::new();
    for stage in Stage::ALL {
        let path = result.join(format!("{}.ome.tif", stage.name()));
        match path.exists() {
            true => read.push((stage, StageFile::read(&path, &truth)?)),
            false => missing.push(format!("{} is not there", path.display())),
        }
    }
    let Some((_, first)) = read.first() else {
        return Err(AppError::usage(format!(
            "{} has none of unmixed.ome.tif, flattened.ome.tif and linearized.ome.tif. Give the directory that \
             `analyze` wrote.",
            result.display()
        )));
    };
    if let Some((stage, _)) = read.iter().find(|(_, file)| !file.is_like(first)) {
        return Err(AppError::data(format!(
            "{}: the images of {}.ome.tif differ in size or species from the others. Analyze again into a new \
             directory.",
            result.display(),
            stage.name()
        )));
    }
    let planes: Vec<Vec<&[f32]>> =
        read.iter().map(|(_, file)| file.planes.iter().map(Vec::as_slice).collect()).collect();
    let stages: Vec<StageImages<'_>> =
        read.iter().zip(&planes).map(|(&(stage, _), planes)| StageImages { stage, planes }).collect();
    let images =
        Images { species: &first.species, height: first.height, width: first.width, stages: &stages };
    let mut score = score_images(&truth, &images)?;
    score.notes.splice(0..0, missing);
    Ok(score)
}

fn read_truth(path: &Path) -> Result<Truth, AppError> {
    let file = if path.is_dir() { path.join(TRUTH_FILE) } else { path.to_path_buf() };
    let text = read_text(&file, MAX_TRUTH_BYTES)?;
    Truth::from_json(&text).map_err(|error| AppError::data(format!("{}: {error}", file.display())))
}

/// The images of one stage as read.
struct StageFile {
    species: Vec<String>,
    height: usize,
    width: usize,
    planes: Vec<Vec<f32>>,
}

impl StageFile {
    fn read(path: &Path, truth: &Truth) -> Result<Self, AppError> {
        let mut stack = ImageStack::open(path)?;
        let info = stack.info().clone();
        if info.sample != SampleType::Float32 || info.frames != 1 {
            return Err(AppError::data(format!(
                "{}: {} frames of {} where one float32 image per species was expected. Give the directory that \
                 `analyze` wrote.",
                path.display(),
                info.frames,
                info.sample.name()
            )));
        }
        let too_large = |full: usize, side: usize| full > side.saturating_mul(MAX_FOLD);
        if too_large(info.height, truth.height_px)
            || too_large(info.width, truth.width_px)
            || info.channels > truth.species.len().saturating_mul(4)
        {
            return Err(AppError::data(format!(
                "{}: {} images of {} x {} pixels do not belong to the scene {} of {} x {} pixels. Choose the \
                 truth that belongs to these images.",
                path.display(),
                info.channels,
                info.height,
                info.width,
                truth.scene,
                truth.height_px,
                truth.width_px
            )));
        }
        let mut planes = Vec::new();
        for channel in 0..info.channels {
            let mut plane = vec![0.0; info.height * info.width];
            stack.select_channel(channel)?;
            stack.seek(0)?;
            stack.read_values(&mut plane)?;
            planes.push(plane);
        }
        Ok(Self { species: info.channel_names, height: info.height, width: info.width, planes })
    }

    fn is_like(&self, other: &Self) -> bool {
        (self.height, self.width, &self.species) == (other.height, other.width, &other.species)
    }
}
