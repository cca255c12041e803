//! An analysis as the report's data.

use super::analysis::{Analysis, Prepared};
use super::camera_maps::UsedMaps;
use super::results::{Scores, species_names, spectral_names, title};
use crate::display::default_colors;
use crate::report::{
    AnalysisReport, BleachingCurve, CurveUnit, FORMAT_VERSION, FlatteningNotes, FrameAccount, FrameCount,
    InputFile, OutputFile, PsfUsed, Resolution, ResolutionCurve, ResolutionValue, Settings, Species,
    Subsequence, SubsequenceFate, Timing, Unmixing,
};
use crate::sofi::flattening::FlatteningReport;
use crate::sofi::grid::Combinations;
use crate::sofi::psf_width::{MeasuredWidth, without_pixels};
use crate::sofi::unmixing::UnmixingMethod;

/// Fills the report of an analysis.
pub(super) fn report(analysis: &Analysis, command: &str, files: &[String], scores: Scores) -> AnalysisReport {
    let mut warnings = analysis.warnings.clone();
    warnings.extend(flattening_warnings(analysis));
    AnalysisReport {
        format_version: FORMAT_VERSION,
        title: title(analysis),
        command: command.to_owned(),
        created: jiff::Timestamp::now().to_string(),
        simulated: analysis.prepared.source.simulated,
        warnings,
        inputs: inputs(analysis),
        settings: settings(analysis),
        frames: frames(analysis),
        subsequences: subsequences(analysis),
        species: species(analysis),
        unmixing: unmixing(analysis),
        bleaching: bleaching(analysis),
        crosstalk: scores.crosstalk,
        resolution: resolution(analysis, scores.resolution),
        timing: Some(timing(analysis)),
        outputs: files
            .iter()
            .map(|file| OutputFile { path: file.clone(), content: content_of(file) })
            .collect(),
        ..AnalysisReport::default()
    }
}

fn content_of(file: &str) -> String {
    let content = match file {
        "mean.ome.tif" => "mean image of each camera, counts",
        "variance.ome.tif" => "temporal variance of each camera, counts squared",
        "cumulants.ome.tif" => "cumulants of every spectral channel on the fine grid",
        "unmixed.ome.tif" => "one image per species after unmixing",
        "flattened.ome.tif" => "the same with equal weights on all sub-grids",
        "linearized.ome.tif" => "deconvolved, n-th root, reconvolved",
        "composite.png" => "the linearized species in one picture",
        _ => "",
    };
    content.to_owned()
}

fn inputs(analysis: &Analysis) -> Vec<InputFile> {
    let source = &analysis.prepared.source;
    let input = |(role, path, sample): &(String, String, String)| InputFile {
        role: role.clone(),
        path: path.clone(),
        frames: source.frames,
        height: source.height as u64,
        width: source.width as u64,
        sample_type: sample.clone(),
    };
    source.inputs.iter().map(input).collect()
}

/// How camera T was brought onto camera R.
fn registration(prepared: &Prepared) -> String {
    let Some(used) = &prepared.engine.registration else {
        let aligned = "none: the cameras are taken as aligned";
        return if prepared.engine.channels == 1 { "none: one camera" } else { aligned }.to_owned();
    };
    let [y, x] = used.transform.central_shift();
    format!(
        "mirror {}, shift ({x:.2}, {y:.2}) px, rotation {:.3} degrees, scale {:.4}; {}",
        used.transform.mirror.name(),
        used.transform.rotation_deg(),
        used.transform.scale(),
        used.interpolation.name()
    )
}

fn settings(analysis: &Analysis) -> Settings {
    let prepared = &analysis.prepared;
    let chosen = &prepared.settings;
    let combinations = Combinations::NAMES.iter().find(|(_, rule)| *rule == prepared.grid.combinations());
    let widths = analysis.widths.iter().zip(&prepared.species);
    Settings {
        order: prepared.grid.order() as u32,
        subsequence_length: prepared.engine.subsequence,
        combinations: combinations.map(|(name, _)| (*name).to_owned()).unwrap_or_default(),
        lags: prepared.engine.lags.iter().map(|&lag| lag as u32).collect(),
        dichroic: chosen.dichroic.clone(),
        registration: Some(registration(prepared)),
        unmixing: match chosen.unmixing {
            UnmixingMethod::NonNegative => "non-negative".to_owned(),
            _ => "pseudo-inverse".to_owned(),
        },
        flattening: if chosen.distance_factor { "distance factor" } else { "equal means" }.to_owned(),
        linearization_iterations: Some(chosen.iterations as u32),
        psf: analysis
            .widths
            .first()
            .map(|width| PsfUsed { sigma_px: width.sigma_px, source: width.source.clone() }),
        camera_pixel_pitch_nm: Some(prepared.pixel_pitch_nm),
        exposure_ms: prepared.source.exposure_ms,
        other: calibrations(prepared)
            .into_iter()
            .chain(widths.map(|(width, species)| {
                (
                    format!("PSF sigma of {}", species.name),
                    format!("{:.3} px ({})", width.sigma_px, width.source),
                )
            }))
            .chain(measured_widths(analysis))
            .collect(),
    }
}

/// What is known of the cameras' pixels and of measured shares.
fn calibrations(prepared: &Prepared) -> Vec<(String, String)> {
    let maps = prepared.camera_maps.iter().zip(["R", "T"]);
    let line = |(used, camera): (&Option<UsedMaps>, &str)| {
        Some((format!("maps of camera {camera}"), used.as_ref()?.line()))
    };
    let response = prepared
        .response
        .as_ref()
        .map(|_| ("shares of the dyes' light".to_owned(), "from a file of measured shares".to_owned()));
    maps.filter_map(line).chain(response).collect()
}

/// What the sub-grids say of each species and beads of each camera, whether it was used or not.
fn measured_widths(analysis: &Analysis) -> Vec<(String, String)> {
    let prepared = &analysis.prepared;
    let in_nm = |px: f64| px * prepared.pixel_pitch_nm;
    let species = prepared.species.iter().zip(&analysis.measured).map(|(species, seen)| {
        let width = seen.and_then(MeasuredWidth::without_pixels);
        let value = width.map_or("not clear enough in these frames".to_owned(), |width| {
            let (px, error) = (width.sigma_px, width.standard_error_px);
            format!("{px:.3} px, standard error {error:.3} px ({:.0} nm, standard error {:.1} nm; from sub-grid ratios)",
                in_nm(px), in_nm(error))
        });
        (format!("measured PSF sigma of {}", species.name), value)
    });
    let beads = prepared.bead_widths.into_iter().flat_map(|widths| ["R", "T"].into_iter().zip(widths));
    let beads = beads.map(|(camera, seen)| {
        let value = without_pixels(seen).map_or("narrower than a pixel".to_owned(), |px| {
            format!("{px:.3} px ({:.0} nm; from beads of the registration)", in_nm(px))
        });
        (format!("measured PSF sigma of camera {camera}"), value)
    });
    species.chain(beads).collect()
}

fn frames(analysis: &Analysis) -> FrameAccount {
    let (received, used) = (analysis.feed.exposures, analysis.drawing.samples);
    let excluded = received.saturating_sub(used);
    let reason = "in a subsequence with less than half of its exposures".to_owned();
    FrameAccount {
        received,
        used,
        lost: Vec::new(),
        excluded: if excluded > 0 { vec![FrameCount { reason, frames: excluded }] } else { Vec::new() },
    }
}

fn subsequences(analysis: &Analysis) -> Vec<Subsequence> {
    let length = analysis.prepared.engine.subsequence;
    let fate = |used: bool, samples: u64| {
        if used {
            SubsequenceFate::Used { weight: samples as f64 / length as f64 }
        } else {
            SubsequenceFate::Skipped { reason: "fewer than half of its exposures".to_owned() }
        }
    };
    let closed = analysis.feed.closed.iter().map(|run| Subsequence {
        first_exposure: run.run * length,
        frames: run.samples,
        fate: fate(run.used, run.samples),
    });
    let rest = analysis.feed.exposures % length;
    let last = (rest > 0).then(|| Subsequence {
        first_exposure: analysis.feed.exposures - rest,
        frames: rest,
        fate: fate(analysis.drawing.incomplete_samples > 0, rest),
    });
    closed.chain(last).collect()
}

fn species(analysis: &Analysis) -> Vec<Species> {
    let gains = analysis.prepared.matrix.as_ref().map(crate::sofi::unmixing::UnmixingMatrix::noise_gain);
    let colors = default_colors(analysis.prepared.species.len());
    let notes = analysis.stages.iter().flat_map(|stages| &stages.flattening);
    let mut notes: Vec<Option<FlatteningNotes>> =
        notes.map(|report| Some(flattening_notes(report))).collect();
    notes.resize(analysis.prepared.species.len(), None);
    let signal_to_noise = |index: usize| analysis.quality.as_ref()?.snr_species.get(index).copied().flatten();
    let one = |((index, species), flattening): ((usize, &crate::sofi::spectra::Species), _)| Species {
        name: species.name.clone(),
        transmission: species.response.transmission(),
        reflection: species.response.reflection(),
        emission_nm: species.emission_nm,
        color: Some(colors[index]),
        noise_gain: gains.as_ref().map(|gains| gains[index]),
        signal_to_noise: signal_to_noise(index),
        flattening,
    };
    analysis.prepared.species.iter().enumerate().zip(notes).map(one).collect()
}

/// What was measured on the images, and the Fourier ring correlation of the live analysis.
fn resolution(analysis: &Analysis, measured: Option<Resolution>) -> Option<Resolution> {
    let quality = analysis.quality.as_ref();
    let names = species_names(analysis);
    let mut all = measured.unwrap_or_default();
    for (found, name) in quality.iter().flat_map(|quality| &quality.resolution).zip(&names) {
        let (Some(nanometers), Some(curve)) = (found.nm, &found.curve) else { continue };
        let limit = if found.is_pixel_limited { ", limited by the pixels" } else { "" };
        all.values.push(ResolutionValue {
            image: name.clone(),
            method: format!("Fourier ring correlation, 1/7, of the flattened image{limit}"),
            nanometers,
        });
        if let Some(camera_px) = found.decorrelation_camera_px {
            all.values.push(ResolutionValue {
                image: name.clone(),
                method: "decorrelation analysis of the flattened image".to_owned(),
                nanometers: camera_px * analysis.prepared.pixel_pitch_nm,
            });
        }
        let fine_um = analysis.prepared.pixel_pitch_nm / 1e3 / analysis.prepared.grid.order() as f64;
        all.curves.push(ResolutionCurve {
            image: name.clone(),
            frequency_per_um: (0..curve.smoothed.len())
                .map(|ring| ring as f64 * curve.frequency_step / fine_um)
                .collect(),
            correlation: curve.smoothed.clone(),
        });
    }
    (!all.values.is_empty()).then_some(all)
}

fn flattening_notes(report: &FlatteningReport) -> FlatteningNotes {
    let sentence = |(p, q): &(usize, usize)| {
        format!("sub-grid ({p}, {q}) has no clear mean and is weighted by the distance factor")
    };
    FlatteningNotes {
        sub_grid_factors: report.scales.iter().copied().collect(),
        fallbacks: report.fallbacks.iter().map(sentence).collect(),
    }
}

fn flattening_warnings(analysis: &Analysis) -> Vec<String> {
    let reports = analysis.stages.iter().flat_map(|stages| &stages.flattening);
    reports
        .zip(species_names(analysis))
        .filter(|(report, _)| !report.fallbacks.is_empty())
        .map(|(report, name)| {
            format!(
                "{name}: {} of {} sub-grids have no clear mean and were weighted by the distance factor; \
                 this species may be too weak here.",
                report.fallbacks.len(),
                report.scales.len()
            )
        })
        .collect()
}

fn unmixing(analysis: &Analysis) -> Option<Unmixing> {
    let matrix = analysis.prepared.matrix.as_ref()?;
    Some(Unmixing {
        spectral_channels: spectral_names(analysis),
        matrix: matrix.matrix().rows().into_iter().map(|row| row.to_vec()).collect(),
        singular_values: matrix.singular_values().to_vec(),
        condition_number: matrix.condition(),
    })
}

fn bleaching(analysis: &Analysis) -> Option<BleachingCurve> {
    let trace = &analysis.feed.trace;
    let channels = analysis.prepared.source.inputs.len();
    let mean_of = |channel: usize| trace.iter().map(|(_, means)| means[channel]).collect::<Vec<_>>();
    (!trace.is_empty()).then(|| BleachingCurve {
        exposures: trace.iter().map(|(exposure, _)| *exposure as f64).collect(),
        reflected: mean_of(0),
        transmitted: (channels > 1).then(|| mean_of(1)),
        unit: CurveUnit::Counts,
    })
}

fn timing(analysis: &Analysis) -> Timing {
    let cumulants = analysis.steps.first().map_or(0.0, |(_, seconds)| *seconds);
    Timing {
        seconds: analysis.steps.iter().map(|(_, seconds)| seconds).sum(),
        pairs_per_second: analysis.feed.exposures as f64 / cumulants.max(1e-9),
        steps: analysis.steps.clone(),
    }
}
