//! `calibrate response`: the shares of each dye's light that reach both cameras, from single-stained samples.
//!
//! In: a recording of both cameras for each dye. Out: a file as `config/dichroics.toml`, with where it comes from.
//! Never: overwrites a file. Fails: [`AppError`] with the dye and what to change.

use super::source::{CameraFrames, camera_frames};
use super::vacant;
use crate::app::AppError;
use crate::app::camera_maps::{MapsPlace, UsedMaps};
use crate::app::text_file::read_text;
use crate::config::{Catalogue, Registration};
use crate::sofi::registration::{Interpolation, Resampler};
use crate::sofi::response::{HalfMeans, MeasuredShare, ResponseSettings, StainedSums, transmitted_share};
use ndarray::Array2;
use sofiscope_hal::Channel;
use std::fmt::Write;
use std::path::{Path, PathBuf};

/// Longest registration file that is read.
const MOST_BYTES: u64 = 1 << 20;

/// Arguments of `calibrate response`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  sofiscope calibrate response --stained \"Alexa Fluor 488=run-488\" --stained \"Atto 565=run-565\" \\
      --registration registration.toml --name \"zt 594 RDC, 2026\" --out response.toml
  sofiscope calibrate response --stained \"Atto 565=r.tif,t.tif\" --blank unstained --out response.toml
  sofiscope analyze r.tif t.tif --species \"Alexa Fluor 488,Atto 565\" --response response.toml --out result

A sample holds one dye only. Without a blank it needs structure that is brighter than its surroundings; an evenly
stained sample needs one. The stated uncertainty holds the truth in 95 of 100 measurements.")]
pub(super) struct ResponseArguments {
    /// A dye and its recording: NAME=RECORDING or NAME=STACK-R,STACK-T; give one for each dye
    #[arg(long, required = true, value_name = "NAME=FILES")]
    stained: Vec<String>,
    /// Recording of an unstained sample with the same settings: RECORDING or STACK-R,STACK-T
    #[arg(long, value_name = "FILES")]
    blank: Option<String>,
    /// Name of the dichroic in the file
    #[arg(long, default_value = "measured")]
    name: String,
    /// Registration of camera T onto camera R, as `calibrate registration` writes it
    #[arg(long, value_name = "FILE")]
    registration: Option<PathBuf>,
    /// Maps of each camera's pixels, R before T, as `calibrate camera` writes them
    #[arg(long, value_delimiter = ',', num_args = 1, value_name = "FILES")]
    camera_maps: Option<Vec<PathBuf>>,
    /// The file to write
    #[arg(long, default_value = "response.toml")]
    out: PathBuf,
    /// Print one object on stdout
    #[arg(long)]
    json: bool,
}

/// One dye as measured.
#[derive(Debug, serde::Serialize)]
struct Measured {
    fluorophore: String,
    transmission: f64,
    /// Of 95 %.
    transmission_uncertainty: f64,
    recording: String,
}

/// The recordings, and what applies to all of them.
struct Bench {
    size: [usize; 2],
    serials: [Option<String>; 2],
    maps: [Option<UsedMaps>; 2],
    masks: [Option<Array2<bool>>; 2],
    resampler: Option<Resampler>,
    blank: Option<HalfMeans>,
}

/// Runs `calibrate response`.
///
/// # Errors
/// [`AppError`]: what is wrong with the arguments, the frames or the disk; then nothing is written.
pub(super) fn run(arguments: &ResponseArguments) -> Result<(), AppError> {
    vacant([&arguments.out])?;
    let catalogue = Catalogue::built_in();
    let stained: Vec<(String, &str)> = arguments
        .stained
        .iter()
        .map(|given| {
            let (name, files) = given.split_once('=').ok_or_else(|| {
                AppError::Usage(format!("--stained {given:?}: give NAME=RECORDING or NAME=STACK-R,STACK-T"))
            })?;
            let dye = catalogue.fluorophore(name.trim()).map_err(AppError::usage)?;
            Ok((dye.name().to_owned(), files))
        })
        .collect::<Result<_, AppError>>()?;
    if let Some(again) =
        (1..stained.len()).find(|&i| stained[..i].iter().any(|(name, _)| *name == stained[i].0))
    {
        return Err(AppError::Usage(format!("{} was given twice; give each dye once", stained[again].0)));
    }
    let bench = Bench::of(arguments, stained[0].1)?;
    let measured = stained
        .iter()
        .map(|(name, files)| {
            let of_dye = |error: AppError| AppError::Data(format!("{name}: {error}"));
            let share = bench.measure(files).map_err(of_dye)?;
            Ok(Measured {
                fluorophore: name.clone(),
                // Chance may put a share close to an end beyond it.
                transmission: share.transmission.clamp(0.0, 1.0),
                transmission_uncertainty: share.uncertainty(),
                recording: (*files).to_owned(),
            })
        })
        .collect::<Result<Vec<_>, AppError>>()?;
    let text = file_text(arguments, &bench, &measured);
    Catalogue::with_dichroics(&text).map_err(AppError::data)?;
    std::fs::write(&arguments.out, text)
        .map_err(|error| AppError::Usage(format!("{}: {error}", arguments.out.display())))?;
    tell(arguments, &measured)
}

/// Both cameras of a recording.
fn both(files: &str) -> Result<[CameraFrames; 2], AppError> {
    let frames = match files.split_once(',') {
        Some((r, t)) => [r, t].map(|path| camera_frames(Path::new(path.trim()), Channel::Reflected)),
        None => Channel::BOTH.map(|channel| camera_frames(Path::new(files), channel)),
    };
    let [r, t] = frames;
    let (r, t) = (r?, t?);
    if !files.contains(',') && Path::new(files).is_file() && r.stack.info().channels < 2 {
        return Err(AppError::usage("two cameras are needed; give STACK-R,STACK-T"));
    }
    let (a, b) = (r.stack.info(), t.stack.info());
    if r.size() != t.size() || a.frames != b.frames {
        return Err(AppError::Data(format!(
            "the cameras differ: R has {} frames of {} x {} pixels and T {} of {} x {}; record both alike",
            a.frames, a.width, a.height, b.frames, b.width, b.height
        )));
    }
    Ok([r, t])
}

/// Mean images of a recording, read once.
fn means(frames: &mut [CameraFrames; 2]) -> Result<HalfMeans, AppError> {
    let size = frames[0].size();
    let mut sums = StainedSums::new(size);
    let mut counts = [vec![0; size[0] * size[1]], vec![0; size[0] * size[1]]];
    loop {
        for (frames, counts) in frames.iter_mut().zip(&mut counts) {
            if !frames.stack.read_counts(counts)? {
                return sums.means().map_err(AppError::data);
            }
        }
        sums.push([&counts[0], &counts[1]]);
    }
}

impl Bench {
    fn of(arguments: &ResponseArguments, first: &str) -> Result<Self, AppError> {
        let frames = both(first)?;
        let size = frames[0].size();
        let regions = frames.each_ref().map(|frames| frames.region);
        let mut maps = [None, None];
        if let Some(paths) = &arguments.camera_maps {
            let [r, t] = &paths[..] else {
                return Err(AppError::usage("--camera-maps needs two files, of R and of T"));
            };
            maps = [
                Some(MapsPlace::of(r)?.load(size, regions[0])?),
                Some(MapsPlace::of(t)?.load(size, regions[1])?),
            ];
        }
        let resampler = arguments.registration.as_deref().map(|path| resampler(path, size)).transpose()?;
        let blank = arguments.blank.as_deref().map(|files| means(&mut both(files)?)).transpose()?;
        Ok(Self {
            size,
            serials: frames.map(|frames| frames.serial),
            masks: maps.each_ref().map(|used| used.as_ref()?.maps.mask()),
            maps,
            resampler,
            blank,
        })
    }

    fn measure(&self, files: &str) -> Result<MeasuredShare, AppError> {
        let mut frames = both(files)?;
        for (serial, found) in self.serials.iter().zip(&frames) {
            if *serial != found.serial {
                return Err(AppError::data("is recorded with other cameras than the first dye"));
            }
        }
        if frames[0].size() != self.size {
            return Err(AppError::data(
                "has another size than the first dye; record all with the same region",
            ));
        }
        let means = means(&mut frames)?;
        let settings = ResponseSettings {
            blank: self.blank.as_ref(),
            offsets: self.maps.each_ref().map(|used| Some(used.as_ref()?.maps.offset())),
            masks: self.masks.each_ref().map(Option::as_ref),
            resampler: self.resampler.as_ref(),
        };
        transmitted_share(&means, &settings).map_err(AppError::data)
    }
}

fn resampler(path: &Path, size: [usize; 2]) -> Result<Resampler, AppError> {
    let refused = |reason: &dyn std::fmt::Display| AppError::Usage(format!("{}: {reason}", path.display()));
    let registration =
        Registration::from_toml(&read_text(path, MOST_BYTES)?).map_err(|faults| refused(&faults))?;
    if registration.transform.size != size {
        return Err(refused(&"is for regions of another size; use those of the calibration"));
    }
    Resampler::new(&registration.transform, Interpolation::default()).map_err(|error| refused(&error))
}

fn file_text(arguments: &ResponseArguments, bench: &Bench, measured: &[Measured]) -> String {
    let quoted = |text: &str| toml::Value::from(text).to_string();
    let mut text = format!(
        "# Shares of the light of each dye on camera T, made by `sofiscope calibrate response`; R = 1 - T.\n\
         # They are shares of counts, as the unmixing takes them. Uncertainties are those of 95 %: two standard\n\
         # errors, or more where few places decide.\n\
         [[dichroic]]\n\
         name = {}\n\
         about = \"measured on single-stained samples\"\n\
         date = {}\n",
        quoted(&arguments.name),
        quoted(&jiff::Timestamp::now().to_string())
    );
    for (key, serial) in ["reflected_serial", "transmitted_serial"].iter().zip(&bench.serials) {
        if let Some(serial) = serial {
            let _ = writeln!(text, "{key} = {}", quoted(serial));
        }
    }
    let registration = arguments.registration.as_ref().map(|path| path.display().to_string());
    for (key, value) in [("registration", &registration), ("blank", &arguments.blank)] {
        if let Some(value) = value {
            let _ = writeln!(text, "{key} = {}", quoted(value));
        }
    }
    text.push_str("coefficients = [\n");
    for Measured { fluorophore, transmission, transmission_uncertainty, recording } in measured {
        let _ = writeln!(
            text,
            "  {{ fluorophore = {}, transmission = {transmission:.6}, \
             transmission_uncertainty = {transmission_uncertainty:.6}, recording = {} }},",
            quoted(fluorophore),
            quoted(recording)
        );
    }
    text.push_str("]\n");
    text
}

/// What scripts are told.
#[derive(Debug, serde::Serialize)]
struct Told<'a> {
    response: &'a Path,
    dichroic: &'a str,
    coefficients: &'a [Measured],
}

fn tell(arguments: &ResponseArguments, measured: &[Measured]) -> Result<(), AppError> {
    if arguments.json {
        let told = Told { response: &arguments.out, dichroic: &arguments.name, coefficients: measured };
        println!("{}", serde_json::to_string(&told).map_err(AppError::data)?);
        return Ok(());
    }
    for Measured { fluorophore, transmission, transmission_uncertainty, .. } in measured {
        println!(
            "{fluorophore}: T = {transmission:.4} +/- {transmission_uncertainty:.4}, R = {:.4}",
            1.0 - transmission
        );
    }
    println!("wrote {}", arguments.out.display());
    Ok(())
}
