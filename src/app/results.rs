//! The result directory: images, pictures, report; see the README's table of files.

use super::AppError;
use super::analysis::{Analysis, Prepared};
use crate::display::{
    Colormap, Contrast, DisplayError, Layer, PngNotes, Rgb, RgbImage, composite, default_colors, render,
};
use crate::files::{FileError, OutputDirectory, ResultHeader, ensure_free, write_result};
use crate::report::{self, AnalysisReport, ColorScale, Crosstalk, LegendEntry, Picture, Resolution, Step};
use ndarray::Array2;
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Longer side of `composite.png`, pixels.
pub(super) const COMPOSITE_SIDE: usize = 960;

/// Percentile of the brightest value shown in composites, whose dark end is zero.
const BRIGHTEST_PERCENT: f64 = 99.9;

/// Scores against a simulated truth, for the report.
#[derive(Debug, Clone, Default)]
pub(super) struct Scores {
    pub(super) crosstalk: Option<Crosstalk>,
    pub(super) resolution: Option<Resolution>,
}

/// What scripts and people are told about one analysis.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Summary {
    pub(super) frames_received: u64,
    pub(super) frames_used: u64,
    pub(super) pairs: u64,
    pub(super) subsequences: u64,
    pub(super) species: Vec<String>,
    pub(super) condition_number: Option<f64>,
    pub(super) noise_gain: Vec<f64>,
    pub(super) seconds: f64,
    pub(super) warnings: Vec<String>,
    /// Directory of the results; set when it is there.
    pub(super) results: Option<PathBuf>,
    pub(super) files: Vec<String>,
}

impl Summary {
    /// Prints the summary: one JSON object on stdout, or lines for a person.
    pub(super) fn print(mut self, results: &Path, json: bool) -> Result<(), AppError> {
        self.results = Some(results.to_owned());
        for warning in &self.warnings {
            eprintln!("warning: {warning}");
        }
        if json {
            println!("{}", serde_json::to_string_pretty(&self).map_err(AppError::data)?);
            return Ok(());
        }
        println!(
            "{} of {} exposures in {} subsequences analyzed in {:.1} s",
            self.frames_used, self.frames_received, self.subsequences, self.seconds
        );
        for file in &self.files {
            println!("  {}", results.join(file).display());
        }
        Ok(())
    }
}

/// Writes every result file of an analysis into a directory that is not yet visible.
pub(super) fn write_results(
    analysis: &Analysis,
    out: &OutputDirectory,
    command: &str,
    scores: Option<Scores>,
) -> Result<Summary, AppError> {
    let mut writer = Writer { analysis, out, files: Vec::new() };
    let n = analysis.prepared.grid.order();
    let channels = channel_names(analysis);
    writer.images("mean", &channels, 1, &analysis.drawing.means)?;
    writer.images("variance", &channels, 1, &analysis.drawing.variances)?;
    writer.images("cumulants", &spectral_names(analysis), n, &analysis.drawing.cumulants)?;
    if let Some(stages) = &analysis.stages {
        let species = species_names(analysis);
        writer.images("unmixed", &species, n, &stages.unmixed)?;
        writer.images("flattened", &species, n, &stages.flattened)?;
        writer.images("linearized", &species, n, &stages.linearized)?;
    }
    writer.composite()?;
    let files = writer.files;
    let report = super::summary::report(analysis, command, &files, scores.unwrap_or_default());
    report::write_json(&report, &out.file("report.json")).map_err(AppError::data)?;
    report::write_html(&report, &pictures(analysis)?, &out.file("report.html")).map_err(AppError::data)?;
    Ok(summary(analysis, &report, files))
}

/// Refuses, before the first frame is read, when the results would not fit on the disk.
///
/// # Errors
/// [`AppError`] with the space needed and free.
pub(super) fn ensure_space(prepared: &Prepared, out: &OutputDirectory) -> Result<(), AppError> {
    Ok(ensure_free(out.target(), needed_bytes(prepared))?)
}

/// Bytes of all images, with room for pictures and report.
fn needed_bytes(prepared: &Prepared) -> u64 {
    let n = prepared.grid.order() as u64;
    let cameras = prepared.source.inputs.len() as u64;
    let spectral_channels = if cameras > 1 { n + 1 } else { 1 };
    let coarse = 2 * cameras;
    let fine = spectral_channels + 3 * prepared.species.len() as u64;
    let pixels = (prepared.source.height * prepared.source.width) as u64;
    (coarse + fine * n * n) * pixels * size_of::<f32>() as u64 + (32 << 20)
}

fn summary(analysis: &Analysis, report: &AnalysisReport, mut files: Vec<String>) -> Summary {
    files.extend(["report.json".to_owned(), "report.html".to_owned()]);
    let matrix = analysis.prepared.matrix.as_ref();
    let exposures = analysis.feed.exposures;
    Summary {
        frames_received: exposures,
        frames_used: analysis.drawing.samples,
        pairs: if analysis.prepared.source.inputs.len() > 1 { exposures } else { 0 },
        subsequences: analysis.drawing.runs,
        species: species_names(analysis),
        condition_number: matrix.map(crate::sofi::unmixing::UnmixingMatrix::condition),
        noise_gain: matrix.map(crate::sofi::unmixing::UnmixingMatrix::noise_gain).unwrap_or_default(),
        seconds: analysis.steps.iter().map(|(_, seconds)| seconds).sum(),
        warnings: report.warnings.clone(),
        results: None,
        files,
    }
}

struct Writer<'a> {
    analysis: &'a Analysis,
    out: &'a OutputDirectory,
    files: Vec<String>,
}

impl Writer<'_> {
    /// Writes `name.ome.tif` with one page per image on the `fold`-fold grid.
    fn images(
        &mut self,
        name: &str,
        channels: &[String],
        fold: usize,
        images: &[Array2<f32>],
    ) -> Result<(), AppError> {
        let prepared = &self.analysis.prepared;
        let settings = vec![
            ("order".to_owned(), prepared.grid.order().to_string()),
            ("subsequence_exposures".to_owned(), prepared.engine.subsequence.to_string()),
            ("simulated".to_owned(), prepared.source.simulated.to_string()),
        ];
        let header = ResultHeader {
            name: name.to_owned(),
            channels: channels.to_vec(),
            height: prepared.source.height * fold,
            width: prepared.source.width * fold,
            pixel_size_nm: Some(prepared.pixel_pitch_nm / fold as f64),
            settings,
            ..ResultHeader::default()
        };
        let planes: Vec<&[f32]> = images
            .iter()
            .map(|image| image.as_slice().expect("result images are row-major and whole"))
            .collect();
        let file = format!("{name}.ome.tif");
        write_result(&self.out.file(&file), &header, &planes).map_err(|error| self.visible(error))?;
        self.files.push(file);
        Ok(())
    }

    /// The error with the path that the output would have had, as the partial one is gone when it is read.
    fn visible(&self, error: FileError) -> FileError {
        match error {
            FileError::DiskFull { space, .. } => {
                FileError::DiskFull { path: self.out.target().to_path_buf(), space }
            }
            other => other,
        }
    }

    fn composite(&mut self) -> Result<(), AppError> {
        let (image, pitch_nm) = composite_of(self.analysis)?;
        let (mut picture, factor) = image.fitted(COMPOSITE_SIDE).map_err(AppError::data)?;
        picture.draw_scale_bar(pitch_nm / factor);
        let notes = PngNotes { title: Some(title(self.analysis)), pixel_pitch_nm: Some(pitch_nm / factor) };
        picture.write_png(&self.out.file("composite.png"), &notes).map_err(AppError::data)?;
        self.files.push("composite.png".to_owned());
        Ok(())
    }
}

/// Title of pictures and report; says when the data are simulated.
pub(super) fn title(analysis: &Analysis) -> String {
    let species = species_names(analysis).join(", ");
    let what = if species.is_empty() { "spectral cross-cumulants".to_owned() } else { species };
    let order = analysis.prepared.grid.order();
    let simulated = if analysis.prepared.source.simulated { " (simulated data)" } else { "" };
    format!("SOFI of order {order}: {what}{simulated}")
}

pub(super) fn species_names(analysis: &Analysis) -> Vec<String> {
    analysis.prepared.species.iter().map(|species| species.name.clone()).collect()
}

fn channel_names(analysis: &Analysis) -> Vec<String> {
    channels_of(&analysis.prepared).0
}

/// Names of cameras and of spectral channels.
pub(super) fn channels_of(prepared: &Prepared) -> (Vec<String>, Vec<String>) {
    let n = prepared.grid.order();
    if prepared.source.inputs.len() == 1 {
        return (vec!["camera".to_owned()], vec![format!("order {n}")]);
    }
    let cameras = ["R", "T"].map(str::to_owned).to_vec();
    (cameras, (0..=n).map(|u| "T".repeat(u) + &"R".repeat(n - u)).collect())
}

/// `RR`, `TR`, `TT` and so on, in the order `u = 0..=n`; powers of one camera otherwise.
pub(super) fn spectral_names(analysis: &Analysis) -> Vec<String> {
    channels_of(&analysis.prepared).1
}

/// The composite of the last stage there is, and its pixel size in nanometers.
fn composite_of(analysis: &Analysis) -> Result<(RgbImage, f64), AppError> {
    let pitch = analysis.prepared.pixel_pitch_nm;
    let fine = pitch / analysis.prepared.grid.order() as f64;
    let (images, pitch) = match &analysis.stages {
        Some(stages) => (&stages.linearized, fine),
        None => (&analysis.drawing.cumulants, fine),
    };
    Ok((overlay(images).map_err(AppError::data)?, pitch))
}

/// The composite of some images, each in its color.
pub(super) fn overlay(images: &[Array2<f32>]) -> Result<RgbImage, DisplayError> {
    let layers: Vec<Layer<'_>> = images
        .iter()
        .zip(default_colors(images.len()))
        .map(|(image, color)| {
            let limits = Contrast::FromZero { high: BRIGHTEST_PERCENT }.limits(image);
            Layer { image: image.view(), color, limits }
        })
        .collect();
    composite(&layers)
}

/// The pictures of the report, step by step in the order of the light path.
fn pictures(analysis: &Analysis) -> Result<Vec<Picture>, AppError> {
    let n = analysis.prepared.grid.order();
    let pitch = analysis.prepared.pixel_pitch_nm;
    let fine = pitch / n as f64;
    let species = species_names(analysis);
    let colors = default_colors(species.len());
    let mut pictures = Vec::new();
    let cameras = channel_names(analysis);
    pictures.push(Picture {
        step: Step::Cameras,
        title: "Mean".to_owned(),
        caption: "What the cameras see.".to_owned(),
        image: camera_overlay(analysis)?,
        pixel_pitch_nm: Some(pitch),
        legend: legend(&cameras, &default_colors(cameras.len())),
        scale: None,
    });
    let kappa_unit = format!("counts{}", superscript(n));
    for (image, name) in analysis.drawing.cumulants.iter().zip(spectral_names(analysis)) {
        pictures.push(panel(Step::Cumulants, name, image, Colormap::Morgenstemning, &kappa_unit, fine)?);
    }
    if let Some(stages) = &analysis.stages {
        for (step, images, unit) in [
            (Step::Unmixed, &stages.unmixed, kappa_unit.as_str()),
            (Step::Flattened, &stages.flattened, kappa_unit.as_str()),
            (Step::Linearized, &stages.linearized, "counts"),
        ] {
            for (index, (image, name)) in images.iter().zip(&species).enumerate() {
                let map =
                    if species.len() == 1 { Colormap::Morgenstemning } else { Colormap::of_species(index) };
                pictures.push(panel(step, name.clone(), image, map, unit, fine)?);
            }
        }
    }
    let (image, pitch) = composite_of(analysis)?;
    let names = if species.is_empty() { spectral_names(analysis) } else { species };
    let colors = if colors.is_empty() { default_colors(names.len()) } else { colors };
    pictures.push(Picture {
        step: Step::Composite,
        title: "Composite".to_owned(),
        caption: String::new(),
        image,
        pixel_pitch_nm: Some(pitch),
        legend: legend(&names, &colors),
        scale: None,
    });
    Ok(pictures)
}

/// Mean images of the cameras above their darkest percentile, as the offset is no light.
fn camera_overlay(analysis: &Analysis) -> Result<RgbImage, AppError> {
    let means = &analysis.drawing.means;
    let layers: Vec<Layer<'_>> = means
        .iter()
        .zip(default_colors(means.len()))
        .map(|(image, color)| Layer { image: image.view(), color, limits: Contrast::default().limits(image) })
        .collect();
    composite(&layers).map_err(AppError::data)
}

fn legend(names: &[String], colors: &[Rgb]) -> Vec<LegendEntry> {
    names.iter().zip(colors).map(|(label, &color)| LegendEntry { label: label.clone(), color }).collect()
}

fn panel(
    step: Step,
    title: String,
    image: &Array2<f32>,
    map: Colormap,
    unit: &str,
    pitch_nm: f64,
) -> Result<Picture, AppError> {
    let limits = Contrast::FromZero { high: BRIGHTEST_PERCENT }.limits(image);
    Ok(Picture {
        step,
        title,
        caption: String::new(),
        image: render(image, map, limits).map_err(AppError::data)?,
        pixel_pitch_nm: Some(pitch_nm),
        legend: Vec::new(),
        scale: Some(ColorScale { map, limits, unit: unit.to_owned() }),
    })
}

/// The power of a unit as it is printed.
fn superscript(n: usize) -> char {
    ['⁰', '¹', '²', '³', '⁴', '⁵', '⁶'].get(n).copied().unwrap_or('ⁿ')
}
