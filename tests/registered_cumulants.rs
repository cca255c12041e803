//! Cumulants of cameras that do not come aligned: exact where pixels only change places, without the shared noise else.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on should stop here")]

use ndarray::Array2;
use rand::SeedableRng;
use rand_distr::{Distribution, Poisson};
use rand_xoshiro::Xoshiro256PlusPlus;
use sofiscope::reconstruction::AllCores;
use sofiscope::sofi::cumulant::{CumulantEngine, CumulantSettings, Drawing, Exposure, Incomplete, Serial};
use sofiscope::sofi::registration::{
    Affine, Interpolation, Mirror, NoiseLine, ReflectedFromTransmitted, RegistrationSettings,
};

const GAIN: f64 = 2.0;
const OFFSET: f64 = 100.0;

fn settings(transform: ReflectedFromTransmitted, order: usize, subsequence: u64) -> CumulantSettings {
    CumulantSettings {
        registration: Some(RegistrationSettings {
            transform,
            interpolation: Interpolation::UnbiasedSinc,
            noise: NoiseLine::of_camera(GAIN, OFFSET, 0.0),
        }),
        ..CumulantSettings::new(order, 2, subsequence)
    }
}

/// Frames of `photons` per pixel and exposure, one after another.
fn noise(seed: u64, frames: usize, pixels: usize, photons: f64) -> Vec<Vec<u16>> {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
    let poisson = Poisson::new(photons).unwrap();
    let mut count = || (OFFSET + GAIN * poisson.sample(&mut random)) as u16;
    (0..frames).map(|_| (0..pixels).map(|_| count()).collect()).collect()
}

fn draw(settings: CumulantSettings, side: usize, r: &[Vec<u16>], t: &[Vec<u16>], block: usize) -> Drawing {
    let mut engine = CumulantEngine::new(settings, side, side).unwrap();
    let planes: Vec<[&[u16]; 2]> = r.iter().zip(t).map(|(r, t)| [&r[..], &t[..]]).collect();
    let exposures: Vec<_> = planes
        .iter()
        .enumerate()
        .map(|(index, planes)| Exposure { index: index as u64, planes: &planes[..] })
        .collect();
    for block in exposures.chunks(block) {
        if block.len() % 2 == 0 {
            engine.push(&AllCores, block).unwrap();
        } else {
            engine.push(&Serial, block).unwrap();
        }
    }
    engine.draw(&AllCores, Incomplete::AtLeastHalf).unwrap()
}

#[test]
fn mirrors_and_whole_pixels_change_no_bit() {
    let (side, frames) = (40, 12);
    let r = noise(1, frames, side * side, 60.0);
    let t = noise(2, frames, side * side, 60.0);
    for (_, mirror) in Mirror::NAMES {
        let shift = [3.0, -5.0];
        let affine = Affine { shift, ..Affine::IDENTITY };
        let map = ReflectedFromTransmitted { mirror, affine, size: [side, side] };
        let moved = |frame: &Vec<u16>| -> Vec<u16> {
            let at = |pixel: usize| {
                let [y, x] = map.undo([(pixel / side) as f64, (pixel % side) as f64]).unwrap();
                let inside = |v: f64| (0.0..side as f64).contains(&v);
                if inside(y) && inside(x) { frame[y as usize * side + x as usize] } else { 7 }
            };
            (0..side * side).map(at).collect()
        };
        let aligned: Vec<_> = t.iter().map(moved).collect();
        for order in [2, 3, 4] {
            let wanted = draw(CumulantSettings::new(order, 2, 6), side, &r, &aligned, 5);
            let got = draw(settings(map, order, 6), side, &r, &t, 4);
            for (u, (wanted, got)) in wanted.cumulants.iter().zip(&got.cumulants).enumerate() {
                let valid = got.iter().zip(wanted).filter(|(got, _)| got.is_finite());
                let mut number = 0;
                for (got, wanted) in valid {
                    assert_eq!(got.to_bits(), wanted.to_bits(), "{mirror:?}, order {order}, {u} from T");
                    number += 1;
                }
                assert!(number > order * order * side * side / 2, "{number} valid pixels");
            }
            assert!(got.cumulants[order][[1, order * 8]].is_nan(), "rows above the partner are missing");
        }
    }
}

/// A map as between real cameras: rotation in degrees, scale, shift.
fn real(side: usize, mirror: Mirror, degrees: f64, scale: f64, shift: [f64; 2]) -> ReflectedFromTransmitted {
    let (sin, cos) = degrees.to_radians().sin_cos();
    let matrix = [[scale * cos, scale * sin], [-scale * sin, scale * cos]];
    ReflectedFromTransmitted { mirror, affine: Affine { matrix, shift }, size: [side, side] }
}

fn sub_grid_mean(image: &Array2<f32>, p: usize, q: usize) -> f64 {
    let of_grid =
        image.indexed_iter().filter(|((y, x), value)| y % 2 == p && x % 2 == q && value.is_finite());
    let (sum, number) = of_grid.fold((0.0, 0.0), |(sum, n), (_, value)| (sum + f64::from(*value), n + 1.0));
    sum / number
}

#[test]
fn background_without_emitters_has_no_cumulants() {
    let (side, frames, photons) = (160, 600, 50.0);
    let r = noise(3, frames, side * side, photons);
    let t = noise(4, frames, side * side, photons);
    let variance = GAIN * GAIN * photons;
    for map in [
        real(side, Mirror::None, 0.0, 1.0, [0.4, 0.55]),
        real(side, Mirror::Horizontal, 0.3, 1.002, [4.4, -2.55]),
    ] {
        let drawing = draw(settings(map, 2, 100), side, &r, &t, 32);
        for (u, image) in drawing.cumulants.iter().enumerate() {
            for (p, q) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
                let share = sub_grid_mean(image, p, q) / variance;
                println!("{u} from T, sub-grid {p} {q}: {:.3} %", 100.0 * share);
                assert!(share.abs() < 0.002, "{u} from T, sub-grid {p} {q}: {share}");
            }
        }
    }
}

#[test]
fn background_without_emitters_has_no_cumulants_of_orders_3_and_4() {
    let (side, frames, photons) = (96, 800, 50.0);
    let r = noise(17, frames, side * side, photons);
    let t = noise(18, frames, side * side, photons);
    let map = real(side, Mirror::None, 0.3, 1.002, [0.4, 0.55]);
    for order in [3, 4] {
        let drawing = draw(settings(map, order, 200), side, &r, &t, 32);
        let scale = (GAIN * GAIN * photons).powf(order as f64 / 2.0);
        let mut squares = Vec::new();
        for (u, image) in drawing.cumulants.iter().enumerate() {
            for (p, q) in (0..order).flat_map(|p| (0..order).map(move |q| (p, q))) {
                let (mean, error) = block_mean(image, order, (p, q));
                let (share, standard) = (mean / scale, mean / error);
                println!(
                    "order {order}, {u} from T, sub-grid {p} {q}: {share:.5} of the noise, {standard:.2} errors"
                );
                assert!(standard.abs() < 4.0, "order {order}, {u} from T, {p} {q}: {mean} +- {error}");
                squares.push(standard * standard);
            }
        }
        let all = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
        assert!(
            (0.7..1.3).contains(&all),
            "order {order}: {all} errors, root mean square of {}",
            squares.len()
        );
    }
}

/// Mean of a sub-grid and its standard error, from means of blocks of 8 x 8 camera pixels, as neighbors are correlated.
fn block_mean(image: &Array2<f32>, order: usize, (p, q): (usize, usize)) -> (f64, f64) {
    let mut blocks = std::collections::BTreeMap::<(usize, usize), Vec<f64>>::new();
    for ((y, x), value) in image.indexed_iter() {
        if y % order == p && x % order == q && value.is_finite() {
            blocks.entry((y / (8 * order), x / (8 * order))).or_default().push(f64::from(*value));
        }
    }
    let full = blocks.values().filter(|block| block.len() == 64);
    let means: Vec<f64> = full.map(|block| block.iter().sum::<f64>() / 64.0).collect();
    let number = means.len() as f64;
    let mean = means.iter().sum::<f64>() / number;
    let variance = means.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / (number - 1.0);
    (mean, (variance / number).sqrt())
}

#[test]
fn blocks_and_threads_change_no_bit() {
    let (side, frames) = (48, 40);
    let r = noise(5, frames, side * side, 30.0);
    let t = noise(6, frames, side * side, 30.0);
    let map = real(side, Mirror::Vertical, 1.0, 0.99, [2.3, 1.7]);
    let one = draw(settings(map, 2, 20), side, &r, &t, 1);
    for block in [2, 7, 32, 40] {
        let other = draw(settings(map, 2, 20), side, &r, &t, block);
        for (one, other) in one.cumulants.iter().zip(&other.cumulants) {
            assert!(one.iter().zip(other).all(|(one, other)| one.to_bits() == other.to_bits()), "{block}");
        }
    }
}
