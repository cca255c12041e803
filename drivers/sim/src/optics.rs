//! The point-spread function on the pixels of a camera.
//!
//! In: emitter positions on a camera, widths and photons. Out: photons per pixel.
//! Never: samples the Gaussian at pixel centers; it is integrated over each pixel.
//! The PSF is the paper's: rotationally symmetric Gaussian (Materials and methods: Simulations).

/// The profile reaches this many standard deviations; less than 1e-6 of the light lies outside.
const REACH_SIGMAS: f64 = 5.0;

/// Standard deviation of the PSF in camera pixels, `0.21 * lambda / NA / pitch`.
///
/// All arguments must be positive; wavelength and pitch in nanometers.
#[must_use]
pub fn psf_sigma_px(emission_nm: f64, numerical_aperture: f64, pixel_pitch_nm: f64) -> f64 {
    0.21 * emission_nm / numerical_aperture / pixel_pitch_nm
}

/// Where one emitter appears on one camera.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Spot {
    pub(crate) position_px: [f64; 2],
    pub(crate) sigma_px: f64,
    /// Photons of a whole exposure in the on-state.
    pub(crate) photons: f64,
}

/// The light patterns of all emitters on one camera, as products of a column and a row profile.
#[derive(Debug, Default)]
pub(crate) struct SpotPatterns {
    patterns: Vec<Pattern>,
    weights: Vec<f32>,
}

#[derive(Debug, Clone, Copy)]
struct Pattern {
    first_y: u32,
    first_x: u32,
    num_y: u32,
    num_x: u32,
    first_weight: usize,
}

impl SpotPatterns {
    /// Appends the pattern of one emitter, cut at the edges of the camera.
    pub(crate) fn push(&mut self, spot: &Spot, height: usize, width: usize) {
        let first_weight = self.weights.len();
        let (y, x) = (spot.position_px[0], spot.position_px[1]);
        let (first_y, num_y) = covered(y, spot.sigma_px, height);
        let (first_x, num_x) = covered(x, spot.sigma_px, width);
        let dark = spot.photons <= 0.0 || num_y == 0 || num_x == 0;
        let (num_y, num_x) = if dark { (0, 0) } else { (num_y, num_x) };
        self.weights
            .extend(profile(y, spot.sigma_px, first_y, num_y).map(|share| (share * spot.photons) as f32));
        self.weights.extend(profile(x, spot.sigma_px, first_x, num_x).map(|share| share as f32));
        self.patterns.push(Pattern { first_y, first_x, num_y, num_x, first_weight });
    }

    /// Adds `on_fraction` of the light of one emitter to a plane of this width.
    pub(crate) fn add(&self, emitter: usize, on_fraction: f32, plane: &mut [f32], width: usize) {
        let pattern = self.patterns[emitter];
        let (num_y, num_x) = (pattern.num_y as usize, pattern.num_x as usize);
        let weights = &self.weights[pattern.first_weight..][..num_y + num_x];
        let (column, row) = weights.split_at(num_y);
        let mut start = pattern.first_y as usize * width + pattern.first_x as usize;
        for &in_column in column {
            let light = in_column * on_fraction;
            for (pixel, &in_row) in plane[start..][..num_x].iter_mut().zip(row) {
                *pixel += light * in_row;
            }
            start += width;
        }
    }
}

/// First pixel and number of pixels of an axis of `length` within reach of a spot.
fn covered(center: f64, sigma_px: f64, length: usize) -> (u32, u32) {
    let reach = REACH_SIGMAS * sigma_px;
    let last_pixel = length as f64 - 1.0;
    let first = (center - reach).round().max(0.0);
    let last = (center + reach).round().min(last_pixel);
    if first > last { (0, 0) } else { (first as u32, (last - first) as u32 + 1) }
}

/// Share of a Gaussian in each of `count` pixels from `first`; pixel `k` spans `k - 1/2` to `k + 1/2`.
fn profile(center: f64, sigma_px: f64, first: u32, count: u32) -> impl Iterator<Item = f64> {
    let below = move |edge: f64| 0.5 * libm::erf((edge - center) / (sigma_px * std::f64::consts::SQRT_2));
    (first..first + count).map(move |pixel| {
        let pixel = f64::from(pixel);
        below(pixel + 0.5) - below(pixel - 0.5)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(spot: Spot, side: usize) -> Vec<f32> {
        let mut patterns = SpotPatterns::default();
        patterns.push(&spot, side, side);
        let mut plane = vec![0.0; side * side];
        patterns.add(0, 1.0, &mut plane, side);
        plane
    }

    #[test]
    fn widths_are_those_of_the_three_dyes() {
        for (emission_nm, sigma_px) in [(520.0, 0.79615), (592.0, 0.90639), (668.0, 1.02275)] {
            assert!((psf_sigma_px(emission_nm, 1.27, 108.0) - sigma_px).abs() < 1e-5);
        }
    }

    #[test]
    fn light_is_kept_and_lands_where_it_should() {
        let spot = Spot { position_px: [15.3, 12.8], sigma_px: 1.02, photons: 400.0 };
        let plane = image(spot, 32);
        let (mut sum, mut y_sum, mut x_sum, mut spread) = (0.0, 0.0, 0.0, 0.0);
        for (index, &photons) in plane.iter().enumerate() {
            let (y, x) = ((index / 32) as f64, (index % 32) as f64);
            sum += f64::from(photons);
            y_sum += f64::from(photons) * y;
            x_sum += f64::from(photons) * x;
            spread += f64::from(photons) * (x - 12.8).powi(2);
        }
        assert!((sum / 400.0 - 1.0).abs() < 2e-6, "{sum}");
        assert!((y_sum / sum - 15.3).abs() < 1e-4);
        assert!((x_sum / sum - 12.8).abs() < 1e-4);
        // Integration over a pixel adds its own variance, 1/12.
        assert!((spread / sum - (1.02 * 1.02 + 1.0 / 12.0)).abs() < 1e-3);
    }

    #[test]
    fn spots_outside_leave_no_light_and_spots_at_the_edge_are_cut() {
        let far = Spot { position_px: [-40.0, 5.0], sigma_px: 1.0, photons: 100.0 };
        assert!(image(far, 16).iter().all(|&photons| photons == 0.0));
        let edge = Spot { position_px: [-0.5, 8.0], sigma_px: 1.0, photons: 100.0 };
        let sum: f32 = image(edge, 16).iter().sum();
        assert!((sum - 50.0).abs() < 1e-3, "{sum}");
    }
}
