//! Places the emitters of a scene.
//!
//! In: a scene and a seed. Out: emitters with position, brightness and kinetics, species by species.
//! Never: depends on the number of frames. Fails: never; a validated scene has room for its emitters.

use rand_xoshiro::Xoshiro256PlusPlus;

use crate::blinking::{Kinetics, Switching};
use crate::geometry::{Line, between as distance};
use crate::random::{Stream, between, uniform};
use crate::scene::{PatchGrid, Scene, Shape, cells};

/// One fluorophore or bead.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Emitter {
    pub(crate) species: usize,
    /// Number within its species; names its random stream.
    pub(crate) number: u64,
    /// Position `[y, x]` in pixels of camera R.
    pub(crate) position_px: [f64; 2],
    /// Photons per exposure in the on-state.
    pub(crate) photons: f64,
    pub(crate) kinetics: Kinetics,
}

/// One filled place of the patch grid.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Patch {
    pub(crate) species: usize,
    pub(crate) center_px: [f64; 2],
    pub(crate) photons: f64,
    pub(crate) on_ratio: f64,
}

/// All emitters of a scene in order of species, and the patches among them.
pub(crate) fn place(scene: &Scene, seed: u64) -> (Vec<Emitter>, Vec<Patch>) {
    let patches = scene.patch_grid().map_or_else(Vec::new, |grid| fill_grid(scene, grid, seed));
    let mut emitters = Vec::new();
    for (index, species) in scene.species().iter().enumerate() {
        let kinetics = species.kinetics(scene.exposure_ms());
        let mut number = 0;
        let mut push = |position_px, photons, kinetics| {
            emitters.push(Emitter { species: index, number, position_px, photons, kinetics });
            number += 1;
        };
        for (shape_index, shape) in species.shapes.iter().enumerate() {
            let stream = Stream::Placement { species: index as u64, shape: shape_index as u64 };
            let count = shape.num_emitters(scene.optics().pixel_pitch_nm);
            for position_px in on_shape(shape, count, &mut stream.generator(seed)) {
                push(position_px, species.i_on_photons, kinetics);
            }
        }
        for (patch, positions) in patches.iter().filter(|(patch, _)| patch.species == index) {
            let kinetics = Kinetics { switching: in_patch(kinetics, patch), ..kinetics };
            for &position_px in positions {
                push(position_px, patch.photons, kinetics);
            }
        }
    }
    (emitters, patches.into_iter().map(|(patch, _)| patch).collect())
}

/// The on-ratio of a patch comes about through its off-time.
fn in_patch(kinetics: Kinetics, patch: &Patch) -> Option<Switching> {
    kinetics.switching.map(|Switching { on, .. }| Switching { on, off: on * (1.0 / patch.on_ratio - 1.0) })
}

fn fill_grid(scene: &Scene, grid: &PatchGrid, seed: u64) -> Vec<(Patch, Vec<[f64; 2]>)> {
    let mut rng = Stream::Patches.generator(seed);
    let radius_px = grid.radius_nm / scene.optics().pixel_pitch_nm;
    let [rows, columns] = grid.size();
    let mut patches = Vec::new();
    for row in 0..rows {
        for column in 0..columns {
            let species = (uniform(&mut rng) * scene.species().len() as f64) as usize;
            let center_px = [
                grid.from_px[0] + row as f64 * grid.spacing_px,
                grid.from_px[1] + column as f64 * grid.spacing_px,
            ];
            let own = &scene.species()[species];
            let photons = grid.i_on_photons.map_or(own.i_on_photons, |ends| ramp(ends, row, rows));
            let on_ratio =
                grid.on_ratio.map_or(own.photophysics.on_ratio(), |ends| ramp(ends, column, columns));
            let positions =
                (0..grid.emitters_per_patch).map(|_| in_disc(center_px, radius_px, &mut rng)).collect();
            patches.push((Patch { species, center_px, photons, on_ratio }, positions));
        }
    }
    patches
}

/// Linear from the first to the last of `count` places.
fn ramp(ends: [f64; 2], place: u64, count: u64) -> f64 {
    let share = if count > 1 { place as f64 / (count - 1) as f64 } else { 0.0 };
    ends[0] + share * (ends[1] - ends[0])
}

fn on_shape(shape: &Shape, count: u64, rng: &mut Xoshiro256PlusPlus) -> Vec<[f64; 2]> {
    if let Shape::Random { from_px, to_px, minimum_distance_px, .. } = shape {
        return apart(*from_px, *to_px, *minimum_distance_px, count, rng);
    }
    if let Shape::Drawing { from_px, cell_px, rows, .. } = shape {
        return in_drawing(*from_px, *cell_px, rows, count, rng);
    }
    let axis = shape.axis();
    let length = axis.as_ref().map_or(0.0, Line::length);
    (0..count)
        .map(|_| match (shape, &axis) {
            (
                Shape::Filament { width_px, .. }
                | Shape::Curve { width_px, .. }
                | Shape::Ring { width_px, .. },
                Some(axis),
            ) => {
                let along = uniform(rng) * length;
                axis.place(along, (uniform(rng) - 0.5) * width_px)
            }
            (Shape::Disc { center_px, radius_px, .. }, _) => in_disc(*center_px, *radius_px, rng),
            (Shape::Blob { center_px, sigma_px, .. }, _) => in_cloud(*center_px, *sigma_px, rng),
            _ => [f64::NAN; 2],
        })
        .collect()
}

fn in_disc(center_px: [f64; 2], radius_px: f64, rng: &mut Xoshiro256PlusPlus) -> [f64; 2] {
    around(center_px, radius_px * uniform(rng).sqrt(), rng)
}

fn in_cloud(center_px: [f64; 2], sigma_px: f64, rng: &mut Xoshiro256PlusPlus) -> [f64; 2] {
    let radius_px = sigma_px * (-2.0 * libm::log(1.0 - uniform(rng))).sqrt();
    around(center_px, radius_px, rng)
}

fn around(center_px: [f64; 2], radius_px: f64, rng: &mut Xoshiro256PlusPlus) -> [f64; 2] {
    let angle = std::f64::consts::TAU * uniform(rng);
    [center_px[0] + radius_px * libm::sin(angle), center_px[1] + radius_px * libm::cos(angle)]
}

/// Positions in the cells of a drawing, each as often as its weight says.
fn in_drawing(
    from_px: [f64; 2],
    cell_px: f64,
    rows: &[String],
    count: u64,
    rng: &mut Xoshiro256PlusPlus,
) -> Vec<[f64; 2]> {
    let mut total = 0.0;
    let ends: Vec<(f64, [f64; 2])> = cells(rows)
        .map(|(row, column, ninths)| {
            total += ninths;
            (total, [row as f64, column as f64])
        })
        .collect();
    (0..count)
        .map(|_| {
            let chosen = uniform(rng) * total;
            let index = ends.partition_point(|(end, _)| *end <= chosen);
            let cell = ends[index.min(ends.len() - 1)].1;
            [0, 1].map(|axis| from_px[axis] + cell_px * (cell[axis] + uniform(rng)))
        })
        .collect()
}

/// Positions in a rectangle, no two of them closer than a distance.
fn apart(
    from_px: [f64; 2],
    to_px: [f64; 2],
    minimum_distance_px: f64,
    count: u64,
    rng: &mut Xoshiro256PlusPlus,
) -> Vec<[f64; 2]> {
    // Scenes leave so much room that a place is found within a few tries.
    const TRIES: usize = 10_000;
    let mut positions: Vec<[f64; 2]> = Vec::new();
    for _ in 0..count {
        for _ in 0..TRIES {
            let position = [between(rng, from_px[0], to_px[0]), between(rng, from_px[1], to_px[1])];
            let free = minimum_distance_px == 0.0
                || positions.iter().all(|&other| distance(position, other) >= minimum_distance_px);
            if free {
                positions.push(position);
                break;
            }
        }
    }
    positions
}

#[cfg(test)]
mod tests {
    use super::*;

    fn positions(shape: &Shape) -> Vec<[f64; 2]> {
        on_shape(shape, 4000, &mut Stream::Patches.generator(17))
    }

    /// Mean and variance agree with a uniform law between two limits within 4 standard errors.
    fn assert_uniform(values: &[f64], from: f64, to: f64) {
        let (n, width) = (values.len() as f64, to - from);
        assert!(values.iter().all(|value| (from - 1e-9..=to + 1e-9).contains(value)));
        let mean = values.iter().sum::<f64>() / n;
        let variance = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / n;
        assert!((mean - (from + to) / 2.0).abs() < 4.0 * width / (12.0 * n).sqrt(), "{mean}");
        // The fourth central moment of a uniform law is width^4 / 80.
        let error = width.powi(2) * ((1.0 / 80.0 - 1.0 / 144.0) / n).sqrt();
        assert!((variance - width.powi(2) / 12.0).abs() < 4.0 * error, "{variance}");
    }

    #[test]
    fn bands_are_filled_evenly_along_and_across() {
        let shape = Shape::Filament {
            from_px: [10.0, 5.0],
            to_px: [10.0, 53.0],
            width_px: 0.4,
            density_per_um2: 1.0,
        };
        let positions = positions(&shape);
        assert_uniform(&positions.iter().map(|p| p[0]).collect::<Vec<_>>(), 9.8, 10.2);
        assert_uniform(&positions.iter().map(|p| p[1]).collect::<Vec<_>>(), 5.0, 53.0);
        let ring = Shape::Ring {
            center_px: [30.0, 30.0],
            radius_px: [20.0, 20.0],
            width_px: 2.0,
            density_per_um2: 1.0,
        };
        let radii: Vec<f64> = self::positions(&ring).iter().map(|&p| distance(p, [30.0, 30.0])).collect();
        // The ellipse has 256 straight sides, so radii fall short by up to 0.0015 px.
        assert_uniform(&radii, 18.9985, 21.001);
    }

    #[test]
    fn discs_are_filled_evenly_and_clouds_are_round_gaussians() {
        let center_px = [20.0, 40.0];
        let disc = Shape::Disc { center_px, radius_px: 7.0, density_per_um2: 1.0 };
        let squares: Vec<f64> = positions(&disc).iter().map(|&p| distance(p, center_px).powi(2)).collect();
        assert_uniform(&squares, 0.0, 49.0);
        let blob = Shape::Blob { center_px, sigma_px: 3.0, emitters: 1 };
        let cloud = positions(&blob);
        for axis in [0, 1] {
            let offsets = cloud.iter().map(|p| p[axis] - center_px[axis]);
            let n = cloud.len() as f64;
            let (sum, squares) = offsets.fold((0.0, 0.0), |(sum, squares), d| (sum + d, squares + d * d));
            assert!((sum / n).abs() < 4.0 * 3.0 / n.sqrt());
            assert!((squares / n - 9.0).abs() < 4.0 * 9.0 * (2.0 / n).sqrt());
        }
    }

    #[test]
    fn beads_keep_their_distance() {
        let beads = apart([0.0, 0.0], [100.0, 60.0], 6.0, 80, &mut Stream::Patches.generator(3));
        assert_eq!(beads.len(), 80);
        for (number, &bead) in beads.iter().enumerate() {
            assert!(beads[..number].iter().all(|&other| distance(bead, other) >= 6.0));
            assert!((0.0..100.0).contains(&bead[0]) && (0.0..60.0).contains(&bead[1]));
        }
    }
}
