//! The three filaments through the plainest second-order analysis: their fluctuations tell the dyes apart.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use sofiscope_sim::score::{crosstalk_percent, resolution_nm, signal_to_noise};
use sofiscope_sim::{Plane, Scene, Truth, World};

const SUBSEQUENCE: usize = 500;

/// Zero-lag cross-cumulants RR, TR, TT of pixels two apart around each pixel (paper, Eq. 2).
fn cumulants(world: &World) -> [Vec<f64>; 3] {
    let (pixels, width) = (world.scene().num_pixels(), world.scene().width_px());
    let mut sums = [0; 3].map(|_| vec![0.0; pixels]);
    let mut frames = [0; 2].map(|_| vec![0_u16; SUBSEQUENCE * pixels]);
    for first in (0..world.scene().frames()).step_by(SUBSEQUENCE) {
        let [reflected, transmitted] = &mut frames;
        let end = first + SUBSEQUENCE as u64;
        world.render_block(first..end, reflected, transmitted).unwrap();
        let centered = [centered(reflected, pixels), centered(transmitted, pixels)];
        for (sum, [a, b]) in sums.iter_mut().zip([[0, 0], [1, 0], [1, 1]]) {
            add_products(sum, &centered[a], &centered[b], width);
            add_products(sum, &centered[b], &centered[a], width);
        }
    }
    sums
}

fn centered(frames: &[u16], pixels: usize) -> Vec<f32> {
    let mut mean = vec![0.0; pixels];
    for frame in frames.chunks_exact(pixels) {
        mean.iter_mut().zip(frame).for_each(|(mean, &count)| *mean += f32::from(count));
    }
    let scale = pixels as f32 / frames.len() as f32;
    let all = frames.iter().enumerate();
    all.map(|(place, &count)| f32::from(count) - mean[place % pixels] * scale).collect()
}

fn add_products(sum: &mut [f64], first: &[f32], second: &[f32], width: usize) {
    let pixels = sum.len();
    for (a, b) in first.chunks_exact(pixels).zip(second.chunks_exact(pixels)) {
        for pixel in width..pixels - width {
            let beside = a[pixel - 1] * b[pixel + 1] + a[pixel - width] * b[pixel + width];
            sum[pixel] += f64::from(beside);
        }
    }
}

/// Solves `kappa_u = sum_i T_i^u R_i^(2-u) s_i` for each pixel by Cramer's rule.
fn unmixed(truth: &Truth, kappa: &[Vec<f64>; 3]) -> Vec<Vec<f32>> {
    let columns: Vec<[f64; 3]> = truth
        .species
        .iter()
        .map(|s| [s.reflection.powi(2), s.reflection * s.transmission, s.transmission.powi(2)])
        .collect();
    let det = |c: [[f64; 3]; 3]| {
        c[0][0] * (c[1][1] * c[2][2] - c[1][2] * c[2][1]) - c[0][1] * (c[1][0] * c[2][2] - c[1][2] * c[2][0])
            + c[0][2] * (c[1][0] * c[2][1] - c[1][1] * c[2][0])
    };
    let matrix = [columns[0], columns[1], columns[2]];
    let solve = |species: usize, pixel: usize| {
        let mut with = matrix;
        with[species] = [kappa[0][pixel], kappa[1][pixel], kappa[2][pixel]];
        (det(with) / det(matrix)) as f32
    };
    (0..3).map(|i| (0..kappa[0].len()).map(|pixel| solve(i, pixel)).collect()).collect()
}

fn worst_crosstalk(name: &str) -> f64 {
    let scene = Scene::from_toml(Scene::built_in(name).unwrap()).unwrap();
    let world = World::new(&scene, 1);
    let truth = world.truth();
    let images = unmixed(&truth, &cumulants(&world));
    let planes: Vec<Plane<'_>> = images
        .iter()
        .map(|pixels| Plane { pixels, height: scene.height_px(), width: scene.width_px(), fold: 1 })
        .collect();
    let widths = resolution_nm(&truth, &planes).unwrap();
    for (width_nm, species) in widths.iter().zip(&truth.species) {
        // Squares of Gaussians are narrower by the root of two; the filament and the pixels add a little.
        let square_nm = 2.355 * species.sigma_px * 108.0 / 2.0_f64.sqrt();
        assert!((0.95..1.15).contains(&(width_nm / square_nm)), "{name}: {width_nm} {square_nm}");
    }
    assert!(signal_to_noise(&truth, &planes).unwrap().iter().all(|&ratio| ratio > 5.0));
    let table = crosstalk_percent(&truth, &planes).unwrap();
    let mut worst = 0.0_f64;
    for (species, row) in table.iter().enumerate() {
        assert_eq!(row[species], 100.0);
        let others = row.iter().enumerate().filter(|&(image, _)| image != species);
        worst = others.fold(worst, |worst, (_, percent)| worst.max(percent.abs()));
    }
    worst
}

#[test]
fn dyes_far_apart_unmix_within_a_percent() {
    let worst = worst_crosstalk("figure-s4");
    assert!(worst < 1.0, "{worst}");
}

#[test]
fn dyes_ten_nanometers_apart_unmix_within_a_few_percent() {
    let worst = worst_crosstalk("figure-s10");
    assert!(worst < 5.0, "{worst}");
}
