//! `simulate`: the frames of both cameras looking at a scene, and the ground truth beside them.
//!
//! In: a scene file or the name of a built-in scene, a seed. Out: a directory of two stacks, truth and scene.
//! Never: leaves part of a directory, writes without saying that the data are simulated.
//! Fails: [`AppError`] for unknown scenes, faulty scene files, taken paths and full disks.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use serde::Serialize;
use sofiscope_hal::Channel;
use sofiscope_sim::{Scene, World};
use toml::de::DeTable;

use super::simulated_pixels::write_pixels;
use super::text_file::read_text;
use super::{AppError, Progress};
use crate::config::nearest;
use crate::files::{FileError, OutputDirectory, StackHeader, StackWriter, ensure_free};

/// File of camera R in the output.
pub const REFLECTION_FILE: &str = "reflection.ome.tif";
/// File of camera T in the output.
pub const TRANSMISSION_FILE: &str = "transmission.ome.tif";
/// File of the ground truth in the output.
pub const TRUTH_FILE: &str = "truth.json";
/// File of the scene as it was simulated, in the output.
pub const SCENE_FILE: &str = "scene.toml";

/// Files of the pixels of cameras R and T in the output, where they are not all alike.
pub const PIXEL_FILES: [&str; 2] = ["pixels-reflection.ome.tif", "pixels-transmission.ome.tif"];

/// A scene file is refused unread above this size.
pub(super) const MAX_SCENE_BYTES: u64 = 1 << 20;
/// Memory for the frames of one block of both cameras.
const BLOCK_BYTES: usize = 32 << 20;
/// Frames rendered at a time at most, so that progress moves.
const MAX_BLOCK_FRAMES: usize = 128;
/// Room for truth, scene and directories beside the stacks.
const SMALL_FILES_BYTES: u64 = 4 << 20;

/// Arguments of `simulate`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  sofiscope simulate figure-s4 --out /tmp/s4
  sofiscope simulate config/scenes/cell.toml --out /tmp/cell --seed 7 --frames 500
  sofiscope simulate beads --out /tmp/beads --json
  sofiscope simulate flat --background 0 --out /tmp/dark
  sofiscope simulate flat --background 2000 --seed 2 --out /tmp/flat-2000

DIR receives reflection.ome.tif, transmission.ome.tif, truth.json (read by `score`) and scene.toml; where the
pixels of the cameras are not all alike, also what each of them is in truth.
Equal scene, seed and frames give equal bytes.")]
pub struct SimulateArguments {
    /// Scene file, or a built-in scene: figure-2, figure-s4, figure-s6, figure-s7, figure-s8, figure-s10, beads, cell, flat
    scene: String,
    /// Directory to write; must not exist yet, or be empty
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Seed of all chance; the scene proposes one
    #[arg(long, value_parser = clap::value_parser!(u64).range(0..=i64::MAX as u64))]
    seed: Option<u64>,
    /// Frames of each camera; the scene proposes a number
    #[arg(long)]
    frames: Option<u64>,
    /// Background photons per pixel and exposure, of both cameras together; the scene proposes a number
    #[arg(long, value_name = "PHOTONS")]
    background: Option<f64>,
    /// Print one object on stdout
    #[arg(long)]
    json: bool,
}

/// What was written.
#[derive(Debug, Clone, Serialize)]
pub struct Simulated {
    /// Name of the scene.
    pub scene: String,
    /// Always true: these are not measured data.
    pub simulated: bool,
    /// The directory.
    pub out: PathBuf,
    /// Stack of camera R.
    pub reflection: PathBuf,
    /// Stack of camera T.
    pub transmission: PathBuf,
    /// Ground truth.
    pub truth: PathBuf,
    /// The scene as simulated.
    pub scene_file: PathBuf,
    /// Frames of each camera.
    pub frames: u64,
    /// Rows of each camera.
    pub height_px: usize,
    /// Columns of each camera.
    pub width_px: usize,
    /// The seed used.
    pub seed: u64,
    /// Names of the species.
    pub species: Vec<String>,
    /// Time taken.
    pub seconds: f64,
}

/// A scene and the text it was read from.
#[derive(Debug, Clone)]
pub struct SceneText {
    /// The scene.
    pub scene: Scene,
    /// Its text, with the seed and frames of the scene.
    pub text: String,
}

impl SceneText {
    /// Finds a scene by the path of its file or by its built-in name.
    ///
    /// # Errors
    /// A usage error for unknown names (with the nearest), unreadable files and faulty scenes (with all faults).
    pub fn find(scene: &str) -> Result<Self, AppError> {
        let path = Path::new(scene);
        let text = match Scene::built_in(scene) {
            Some(text) => text.to_owned(),
            None if path.exists() => read_text(path, MAX_SCENE_BYTES)?,
            None => return Err(unknown_scene(scene)),
        };
        let parsed = Scene::from_toml(&text).map_err(|error| AppError::usage(format!("{scene}: {error}")))?;
        Ok(Self { scene: parsed, text })
    }

    /// The same scene with another number of frames or another seed, where given; its text says so.
    ///
    /// # Errors
    /// A usage error when the scene does not allow that many frames.
    pub fn with(mut self, frames: Option<u64>, seed: Option<u64>) -> Result<Self, AppError> {
        if let Some(frames) = frames {
            self.scene.with_frames(frames).map_err(|error| AppError::usage(format!("--frames: {error}")))?;
        }
        for (key, value) in [("frames", frames), ("seed", seed)] {
            if let Some(value) = value {
                replace_top_value(&mut self.text, key, value);
            }
        }
        self.scene = Scene::from_toml(&self.text).map_err(AppError::usage)?;
        Ok(self)
    }

    /// The same scene with another background, where given; its text says so.
    ///
    /// # Errors
    /// A usage error for a number that is no background.
    pub fn with_background(mut self, photons: Option<f64>) -> Result<Self, AppError> {
        if let Some(photons) = photons {
            replace_top_value(&mut self.text, "background_photons_per_exposure", photons);
            self.scene = Scene::from_toml(&self.text)
                .map_err(|error| AppError::usage(format!("--background: {error}")))?;
        }
        Ok(self)
    }
}

/// Replaces a number of the top table in its place, so that comments and order of the text stay.
fn replace_top_value(text: &mut String, key: &str, value: impl std::fmt::Debug) {
    let (document, _) = DeTable::parse_recoverable(text);
    let found = document.get_ref().iter().find(|(name, _)| name.get_ref() == key);
    if let Some(span) = found.map(|(_, value)| value.span()) {
        drop(document);
        text.replace_range(span, &format!("{value:?}"));
    }
}

fn unknown_scene(scene: &str) -> AppError {
    let stem = Path::new(scene).file_stem().map_or(scene.into(), |stem| stem.to_string_lossy());
    let near = nearest(&stem, Scene::built_in_names());
    let suggestion = match near.first() {
        Some(name) => format!("Did you mean {name}? "),
        None => String::new(),
    };
    let known: Vec<&str> = Scene::built_in_names().collect();
    AppError::usage(format!(
        "{scene} is neither a file nor a built-in scene. {suggestion}Built in are: {}",
        known.join(", ")
    ))
}

/// Simulates a scene into the directory `out`.
///
/// # Errors
/// [`AppError`] when `out` is taken, too little space is left or the disk fails; nothing remains then.
pub fn simulate(scene: &SceneText, out: &Path) -> Result<Simulated, AppError> {
    let begun = Instant::now();
    let output = OutputDirectory::create(out)?;
    let SceneText { scene, text } = scene;
    let seed = scene.seed();
    let [reflected, transmitted] = Channel::BOTH.map(|channel| header(scene, seed, channel));
    let paths = [output.file(REFLECTION_FILE), output.file(TRANSMISSION_FILE)];
    let needed = reflected.file_bytes(&paths[0])? + transmitted.file_bytes(&paths[1])?;
    ensure_free(out, needed + SMALL_FILES_BYTES)?;
    let world = World::new(scene, seed);
    let writers =
        [StackWriter::create(&paths[0], &reflected)?, StackWriter::create(&paths[1], &transmitted)?];
    write_frames(&world, writers)?;
    write_text(&output.file(TRUTH_FILE), &world.truth().to_json().map_err(AppError::data)?)?;
    write_text(&output.file(SCENE_FILE), text)?;
    for (channel, file) in Channel::BOTH.into_iter().zip(PIXEL_FILES) {
        if let Some(sensor) = world.sensor(channel) {
            write_pixels(&output.file(file), scene, sensor)?;
        }
    }
    let out = output.commit()?;
    Ok(Simulated {
        scene: scene.name().to_owned(),
        simulated: true,
        reflection: out.join(REFLECTION_FILE),
        transmission: out.join(TRANSMISSION_FILE),
        truth: out.join(TRUTH_FILE),
        scene_file: out.join(SCENE_FILE),
        out,
        frames: scene.frames(),
        height_px: scene.height_px(),
        width_px: scene.width_px(),
        seed,
        species: scene.species().iter().map(|species| species.name.clone()).collect(),
        seconds: begun.elapsed().as_secs_f64(),
    })
}

fn header(scene: &Scene, seed: u64, channel: Channel) -> StackHeader {
    let (name, camera) = match channel {
        Channel::Reflected => ("Reflected", "R (reflected, short wavelengths)"),
        Channel::Transmitted => ("Transmitted", "T (transmitted, long wavelengths)"),
    };
    let frame_interval = Duration::from_secs_f64(scene.exposure_ms() / 1e3);
    let setting = |key: &str, value: String| (key.to_owned(), value);
    StackHeader {
        frames: scene.frames() as usize,
        height: scene.height_px(),
        width: scene.width_px(),
        name: format!("{} {name} (simulated)", scene.name()),
        channel: format!("{name} (simulated)"),
        description: format!(
            "SIMULATED, not measured: camera {camera} looking at the scene {}, seed {seed}. {}",
            scene.name(),
            scene.about().trim()
        ),
        pixel_size_nm: Some(scene.optics().pixel_pitch_nm),
        frame_interval: Some(frame_interval),
        settings: vec![
            setting("simulated", "true".to_owned()),
            setting("scene", scene.name().to_owned()),
            setting("seed", seed.to_string()),
            setting("exposure_ms", scene.exposure_ms().to_string()),
            setting("numerical_aperture", scene.optics().numerical_aperture.to_string()),
        ],
    }
}

/// Renders on all cores and writes, block after block; while one block is written the next one is rendered.
fn write_frames(world: &World, mut writers: [StackWriter; 2]) -> Result<(), AppError> {
    let (frames, pixels) = (world.scene().frames(), world.scene().num_pixels());
    let block = (BLOCK_BYTES / (pixels * 4 * size_of::<u16>())).clamp(1, MAX_BLOCK_FRAMES) as u64;
    let mut progress = Progress::begin("simulating", frames);
    let mut ready = Block::default();
    let mut next = Block::default();
    for first in (0..frames).step_by(block as usize) {
        let exposures = first..(first + block).min(frames);
        let (written, rendered) =
            rayon::join(|| ready.write(&mut writers), || next.render(world, exposures.clone(), pixels));
        written?;
        rendered?;
        std::mem::swap(&mut ready, &mut next);
        progress.advance(exposures.end - exposures.start);
    }
    ready.write(&mut writers)?;
    for writer in writers {
        writer.finish()?;
    }
    progress.finish();
    Ok(())
}

/// Frames of both cameras, one after the other.
#[derive(Debug, Default)]
struct Block {
    counts: [Vec<u16>; 2],
    pixels: usize,
}

impl Block {
    fn render(
        &mut self,
        world: &World,
        exposures: std::ops::Range<u64>,
        pixels: usize,
    ) -> Result<(), AppError> {
        let length = (exposures.end - exposures.start) as usize * pixels;
        self.pixels = pixels;
        let [reflected, transmitted] = &mut self.counts;
        reflected.resize(length, 0);
        transmitted.resize(length, 0);
        world.render_block(exposures, reflected, transmitted).map_err(AppError::data)
    }

    fn write(&self, writers: &mut [StackWriter; 2]) -> Result<(), FileError> {
        for (writer, counts) in writers.iter_mut().zip(&self.counts) {
            for frame in counts.chunks_exact(self.pixels.max(1)) {
                writer.push(frame)?;
            }
        }
        Ok(())
    }
}

fn write_text(path: &Path, text: &str) -> Result<(), FileError> {
    std::fs::write(path, text).map_err(|source| FileError::from_io(path, "write", source))
}

/// Runs `simulate`.
///
/// # Errors
/// As [`SceneText::find`], [`SceneText::with`] and [`simulate`].
pub fn run(arguments: &SimulateArguments) -> Result<(), AppError> {
    let scene = SceneText::find(&arguments.scene)?.with(arguments.frames, arguments.seed)?;
    let scene = scene.with_background(arguments.background)?;
    let simulated = simulate(&scene, &arguments.out)?;
    if arguments.json {
        println!("{}", serde_json::to_string_pretty(&simulated).map_err(AppError::data)?);
        return Ok(());
    }
    println!(
        "{}: {} simulated frames of 2 x {} x {} pixels, seed {}, in {:.1} s",
        simulated.scene,
        simulated.frames,
        simulated.height_px,
        simulated.width_px,
        simulated.seed,
        simulated.seconds
    );
    println!("species: {}", simulated.species.join(", "));
    for path in [&simulated.reflection, &simulated.transmission, &simulated.truth, &simulated.scene_file] {
        println!("{}", path.display());
    }
    Ok(())
}
