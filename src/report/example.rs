//! A made-up analysis of three crossing filaments, for tests of the report: nothing here is measured.

use ndarray::Array2;

use super::figure::{ColorScale, LegendEntry, Picture, Step};
use super::model::{
    AnalysisReport, BleachingCurve, Crosstalk, CrosstalkReference, CurveUnit, FORMAT_VERSION,
    FlatteningNotes, FrameAccount, FrameCount, InputFile, OutputFile, PsfUsed, Resolution, ResolutionCurve,
    ResolutionValue, Settings, Species, Subsequence, SubsequenceFate, Timing, Unmixing,
};
use crate::display::{Colormap, Contrast, Layer, RgbImage, composite, default_colors, render};

const SIDE: usize = 64;
const PITCH_NM: f64 = 108.0;
const NAMES: [&str; 3] = ["Alexa Fluor 488", "Atto 565", "Alexa Fluor 647"];
const T: [f64; 3] = [0.02, 0.35, 0.98];
/// Ends `(y, x)` of each filament, in camera pixels.
const FILAMENTS: [[(f64, f64); 2]; 3] =
    [[(31.5, 7.5), (31.5, 55.5)], [(52.0, 15.5), (10.0, 40.0)], [(52.0, 48.0), (10.0, 23.5)]];

/// Distance of a point to a filament, in camera pixels.
fn distance(species: usize, y: f64, x: f64) -> f64 {
    let [(y0, x0), (y1, x1)] = FILAMENTS[species];
    let (dy, dx) = (y1 - y0, x1 - x0);
    let along = (((y - y0) * dy + (x - x0) * dx) / (dy * dy + dx * dx)).clamp(0.0, 1.0);
    (y - y0 - along * dy).hypot(x - x0 - along * dx)
}

/// Noise between -1 and 1 that depends on the position only.
fn noise(seed: usize, y: usize, x: usize) -> f64 {
    let mut state = (seed * 73_856_093) ^ (y * 19_349_663) ^ (x * 83_492_791) ^ 0x9E37;
    let mut step = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f64 / (1_u64 << 24) as f64
    };
    (step() + step() + step()) / 1.5 - 1.0
}

/// An image on a grid `order` times finer, from the values at camera positions; the last row and column are NaN.
fn image(order: usize, value: impl Fn(usize, usize, f64, f64) -> f64) -> Array2<f32> {
    let side = SIDE * order;
    Array2::from_shape_fn((side, side), |(y, x)| {
        let outside = order > 1 && (y + 3 > side || x + 3 > side || y < 1 || x < 1);
        let found = value(y, x, y as f64 / order as f64, x as f64 / order as f64);
        if outside { f32::NAN } else { found as f32 }
    })
}

fn line(species: usize, sigma: f64, y: f64, x: f64) -> f64 {
    (-distance(species, y, x).powi(2) / (2.0 * sigma * sigma)).exp()
}

fn mean_of(transmitted: bool) -> Array2<f32> {
    image(1, |y, x, cy, cx| {
        let sum: f64 =
            (0..3).map(|i| if transmitted { T[i] } else { 1.0 - T[i] } * line(i, 1.35, cy, cx)).sum();
        100.0 + 420.0 * sum + 6.0 * noise(usize::from(transmitted), y, x)
    })
}

/// Weight of a sub-grid before flattening.
fn weight(y: usize, x: usize) -> f64 {
    [1.0, 0.86, 0.86, 0.78][(y % 2) * 2 + x % 2]
}

fn cumulant(u: i32) -> Array2<f32> {
    image(2, |y, x, cy, cx| {
        let mixed = |i: usize| T[i].powi(u) * (1.0 - T[i]).powi(2 - u) * line(i, 0.95, cy, cx);
        9000.0 * weight(y, x) * ((0..3).map(mixed).sum::<f64>() + 0.012 * noise(9, y, x))
    })
}

fn unmixed(species: usize, flat: bool) -> Array2<f32> {
    image(2, |y, x, cy, cx| {
        let bled: f64 = (0..3).filter(|&j| j != species).map(|j| 0.012 * line(j, 0.95, cy, cx)).sum();
        let gain = if flat { 1.0 } else { weight(y, x) };
        9000.0 * gain * (line(species, 0.95, cy, cx) + bled + 0.04 * noise(20 + species, y, x))
    })
}

fn linearized(species: usize) -> Array2<f32> {
    image(2, |y, x, cy, cx| {
        95.0 * (line(species, 0.62, cy, cx) * (1.0 + 0.25 * noise(40 + species, y / 2, x / 2))).max(0.0)
    })
}

fn single(step: Step, title: &str, map: Colormap, unit: &str, image: &Array2<f32>) -> Picture {
    let limits = Contrast::default().limits(image);
    let pixel_pitch_nm = Some(PITCH_NM * SIDE as f64 / image.nrows() as f64);
    Picture {
        step,
        title: title.to_owned(),
        caption: String::new(),
        image: render(image, map, limits).unwrap(),
        pixel_pitch_nm,
        legend: Vec::new(),
        scale: Some(ColorScale { map, limits, unit: unit.to_owned() }),
    }
}

fn together(step: Step, title: &str, caption: &str, names: &[&str], images: &[Array2<f32>]) -> Picture {
    let colors = default_colors(images.len());
    let contrast =
        if step == Step::Cameras { Contrast::default() } else { Contrast::FromZero { high: 99.9 } };
    let layers: Vec<_> = images
        .iter()
        .zip(&colors)
        .map(|(image, &color)| Layer { image: image.view(), color, limits: contrast.limits(image) })
        .collect();
    let legend =
        names.iter().zip(colors.clone()).map(|(&name, color)| LegendEntry { label: name.to_owned(), color });
    Picture {
        step,
        title: title.to_owned(),
        caption: caption.to_owned(),
        image: composite(&layers).unwrap(),
        pixel_pitch_nm: Some(PITCH_NM * SIDE as f64 / images[0].nrows() as f64),
        legend: legend.collect(),
        scale: None,
    }
}

/// All pictures of the example.
pub(super) fn pictures() -> Vec<Picture> {
    let (r, t) = (mean_of(false), mean_of(true));
    let done: Vec<_> = (0..3).map(linearized).collect();
    let mut all = vec![
        together(Step::Composite, "All species", "Linearized second-order images.", &NAMES, &done),
        single(Step::Cameras, "R, reflection", Colormap::Gray, "counts", &r),
        single(Step::Cameras, "T, transmission", Colormap::Gray, "counts", &t),
        together(Step::Cameras, "Overlay", "White where both agree.", &["R", "T"], &[r, t]),
    ];
    for (u, name) in (0..3).zip(["κ₂ RR", "κ₂ TR (virtual)", "κ₂ TT"]) {
        all.push(single(Step::Cumulants, name, Colormap::Morgenstemning, "counts²", &cumulant(u)));
    }
    for (i, name) in NAMES.into_iter().enumerate() {
        let map = Colormap::of_species(i);
        all.push(single(Step::Unmixed, name, map, "counts²", &unmixed(i, false)));
        all.push(single(Step::Flattened, name, map, "counts²", &unmixed(i, true)));
        all.push(single(Step::Linearized, name, map, "counts", &done[i]));
    }
    all.push(together(Step::Flattened, "Together", "", &NAMES, &[0, 1, 2].map(|i| unmixed(i, true))));
    all
}

/// The report of the example: every part is filled in.
pub(super) fn report() -> AnalysisReport {
    AnalysisReport {
        format_version: FORMAT_VERSION,
        title: "Three crossing filaments (scene of Figure S4)".to_owned(),
        command: "sofiscope analyze reflection.ome.tif transmission.ome.tif --dichroic \"zt 594 RDC\""
            .to_owned(),
        created: "2026-01-31T14:05:09+01:00".to_owned(),
        simulated: true,
        warnings: vec![
            "3 frames of camera T were lost; their exposures are left out of both channels.".to_owned(),
            "Alexa Fluor 647 bleached by more than half during the run.".to_owned(),
        ],
        inputs: ["R", "T"].map(input).to_vec(),
        settings: settings(),
        frames: FrameAccount {
            received: 3997,
            used: 3984,
            lost: vec![FrameCount { reason: "camera buffer overrun".to_owned(), frames: 3 }],
            excluded: vec![FrameCount { reason: "last subsequence too short".to_owned(), frames: 13 }],
        },
        subsequences: (0..21).map(subsequence).collect(),
        species: (0..3).map(species).collect(),
        unmixing: Some(unmixing()),
        bleaching: Some(bleaching()),
        crosstalk: Some(crosstalk()),
        resolution: Some(resolution()),
        timing: Some(Timing {
            seconds: 3.25,
            pairs_per_second: 1225.0,
            steps: vec![("cumulants".to_owned(), 2.5), ("linearization".to_owned(), 0.5)],
        }),
        outputs: vec![OutputFile {
            path: "out/linearized.ome.tif".to_owned(),
            content: "linearized species".to_owned(),
        }],
        ..AnalysisReport::default()
    }
}

fn input(role: &str) -> InputFile {
    InputFile {
        role: role.to_owned(),
        path: format!("data/{role}.ome.tif"),
        frames: 4000,
        height: SIDE as u64,
        width: SIDE as u64,
        sample_type: "uint16".to_owned(),
    }
}

fn settings() -> Settings {
    Settings {
        order: 2,
        subsequence_length: 200,
        combinations: "all sets of least pair distance (6)".to_owned(),
        lags: vec![0, 0],
        dichroic: Some("zt 594 RDC".to_owned()),
        registration: Some("image correlation, residual 0.04 px".to_owned()),
        unmixing: "least squares".to_owned(),
        flattening: "equal means".to_owned(),
        linearization_iterations: Some(20),
        psf: Some(PsfUsed { sigma_px: 0.92, source: "NA 1.27, 600 nm".to_owned() }),
        camera_pixel_pitch_nm: Some(PITCH_NM),
        exposure_ms: Some(20.0),
        other: vec![("Camera offset".to_owned(), "100 counts".to_owned())],
    }
}

fn subsequence(index: u64) -> Subsequence {
    let fate = match index {
        20 => SubsequenceFate::Skipped { reason: "shorter than half a subsequence".to_owned() },
        _ => SubsequenceFate::Used { weight: 0.05 },
    };
    Subsequence { first_exposure: index * 200, frames: if index == 20 { 13 } else { 200 }, fate }
}

fn species(index: usize) -> Species {
    let fallbacks =
        if index == 0 { vec!["sub-grid (1, 1): mean below 3 standard errors".to_owned()] } else { vec![] };
    Species {
        name: NAMES[index].to_owned(),
        transmission: T[index],
        reflection: 1.0 - T[index],
        emission_nm: Some([519.0, 590.0, 668.0][index]),
        color: default_colors(3).get(index).copied(),
        noise_gain: Some([1.25, 4.5, 1.125][index]),
        signal_to_noise: Some([21.5, 9.25, 18.75][index]),
        flattening: Some(FlatteningNotes { sub_grid_factors: vec![1.0, 1.16, 1.16, 1.28], fallbacks }),
    }
}

fn unmixing() -> Unmixing {
    let row = |u: i32| T.iter().map(|t| t.powi(u) * (1.0 - t).powi(2 - u)).collect();
    Unmixing {
        spectral_channels: ["RR", "TR", "TT"].map(str::to_owned).to_vec(),
        matrix: (0..3).map(row).collect(),
        singular_values: vec![1.0625, 0.96875, 0.1875],
        condition_number: 5.625,
    }
}

fn bleaching() -> BleachingCurve {
    let exposures: Vec<f64> = (0..200).map(|block| f64::from(block) * 20.0 + 10.0).collect();
    let decay = |start: f64, time: f64, seed: usize| -> Vec<f64> {
        let value = |(i, e): (usize, &f64)| start * (0.3 + 0.7 * (-e / time).exp()) + 0.4 * noise(seed, i, 0);
        exposures.iter().enumerate().map(value).map(|v| (v * 256.0).round() / 256.0).collect()
    };
    let (reflected, transmitted) = (decay(62.0, 3500.0, 1), decay(48.0, 2000.0, 2));
    BleachingCurve { exposures, reflected, transmitted: Some(transmitted), unit: CurveUnit::Counts }
}

fn crosstalk() -> Crosstalk {
    let matrix = |rows: [[f64; 3]; 3]| rows.map(|row| row.to_vec()).to_vec();
    Crosstalk {
        species: NAMES.map(str::to_owned).to_vec(),
        flattened: matrix([[100.0, 0.05, -0.02], [0.1, 100.0, 0.04], [0.01, -0.08, 100.0]]),
        linearized: matrix([[100.0, 2.6, 0.4], [0.9, 100.0, 1.1], [0.3, 1.9, 100.0]]),
        reference: Some(CrosstalkReference {
            source: "paper, Table 2 (linearized)".to_owned(),
            linearized: matrix([[100.0, 5.0, 1.0], [2.0, 100.0, 2.0], [2.0, 4.0, 100.0]]),
        }),
    }
}

fn resolution() -> Resolution {
    let frequency: Vec<f64> = (0..60).map(|index| f64::from(index) * 0.125).collect();
    let curve = |name: &str, cutoff: f64| ResolutionCurve {
        image: name.to_owned(),
        frequency_per_um: frequency.clone(),
        correlation: frequency.iter().map(|f| 1.0 / (1.0 + (f / cutoff).powi(6))).collect(),
    };
    let values = NAMES.iter().zip([176.0, 189.0, 203.0]).map(|(name, nanometers)| ResolutionValue {
        image: (*name).to_owned(),
        method: "Fourier ring correlation, 1/7".to_owned(),
        nanometers,
    });
    let curves = NAMES.iter().zip([4.2, 3.9, 3.6]).map(|(name, cutoff)| curve(name, cutoff));
    Resolution { values: values.collect(), curves: curves.collect() }
}

/// The picture of one image, for size tests.
pub(super) fn large_picture() -> Picture {
    let image = RgbImage::from_fn(1500, 2100, |y, x| [(y % 256) as u8, (x % 256) as u8, 0]).unwrap();
    Picture { image, ..pictures().swap_remove(0) }
}
