//! What the camera of the focus lock sees: the reflected beam as a spot that moves when the focus changes.
//!
//! In: the [`OpticalTable`], an exposure and its time. Out: counts with shot noise, the same for the same seed,
//! exposure and table. Never: reads a clock, allocates once it has seen the region. Fails: never; a table with
//! numbers that are none gives a dark frame.
//!
//! As the source of frames of a simulated camera:
//!
//! ```
//! # use sofiscope_virtual::{OpticalTable, monotonic, spot::{FocusSpot, SpotScene}};
//! # use sofiscope_hal::Region;
//! let mut spot = FocusSpot::new(OpticalTable::private()?, SpotScene::default());
//! let mut source = move |region: Region, exposure: u64, counts: &mut [u16]| {
//!     spot.render(region, exposure, monotonic(), counts);
//! };
//! let region = Region { left: 200, top: 100, width: 200, height: 64 };
//! source(region, 0, &mut vec![0; region.num_pixels()]);
//! # Ok::<(), std::io::Error>(())
//! ```

#[cfg(test)]
mod tests;

use std::time::Duration;

use sofiscope_hal::Region;

use crate::OpticalTable;
use crate::table::Quantity;

/// Means from here on are drawn as normal; below, as Poisson.
const NORMAL_FROM: f64 = 12.0;
/// Spots are drawn to this many widths from their center.
const REACH: f64 = 6.0;

/// How many spots the beam makes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum SpotPattern {
    /// One, which moves with the focus.
    One,
    /// Two at this distance in focus, in pixels; the distance changes with the focus.
    Two(f64),
}

/// Beam, optics and camera of a virtual focus lock.
#[derive(Debug, Clone, PartialEq)]
pub struct SpotScene {
    /// How many spots.
    pub pattern: SpotPattern,
    /// Column of the spot in focus, of the middle between two, in pixels of the sensor.
    pub zero_px: f64,
    /// Row of the spots, in pixels of the sensor.
    pub row_px: f64,
    /// Change of position or distance with the focus error, pixels per nanometer.
    pub slope_px_per_nm: f64,
    /// Width of a spot (σ of a Gaussian), pixels.
    pub sigma_px: f64,
    /// Light of the brightest pixel, counts; one photon is one count.
    pub peak_counts: f64,
    /// Light where no spot is, counts.
    pub background_counts: f64,
    /// Focus errors beyond this move the spot no further, and its light falls off, nanometers.
    pub capture_nm: f64,
    /// Largest count of a pixel.
    pub saturation_counts: u16,
    /// Of the shot noise.
    pub seed: u64,
}

impl Default for SpotScene {
    /// The example of 65 px/µm (60° in glass, 100 ×, pixels of 5.3 µm) on a 12-bit camera.
    fn default() -> Self {
        Self {
            pattern: SpotPattern::One,
            zero_px: 300.0,
            row_px: 132.0,
            slope_px_per_nm: 0.065,
            sigma_px: 4.0,
            peak_counts: 1000.0,
            background_counts: 20.0,
            capture_nm: 1200.0,
            saturation_counts: 4095,
            seed: 1,
        }
    }
}

/// Renders what the camera of the focus lock sees.
#[derive(Debug, Clone)]
pub struct FocusSpot {
    table: OpticalTable,
    scene: SpotScene,
    /// Light of one row through the middle of the spots, by column.
    profile: Vec<f64>,
}

impl FocusSpot {
    /// The spot of a beam on a table.
    #[must_use]
    pub fn new(table: OpticalTable, scene: SpotScene) -> Self {
        Self { table, scene, profile: Vec::new() }
    }

    /// Where the spots are at `at`, in columns of the sensor, and the share of their light that arrives.
    #[must_use]
    pub fn truth(&self, at: Duration) -> (SpotPlaces, f64) {
        let SpotScene { zero_px, slope_px_per_nm, capture_nm, .. } = self.scene;
        let error_nm = self.table.focus_error_nm(at);
        let shift_px = slope_px_per_nm * error_nm.clamp(-capture_nm.abs(), capture_nm.abs());
        let places = match self.scene.pattern {
            SpotPattern::One => SpotPlaces::One(zero_px + shift_px),
            SpotPattern::Two(distance_px) => {
                let half_px = 0.5 * (distance_px + shift_px);
                SpotPlaces::Two(zero_px - half_px, zero_px + half_px)
            }
        };
        (places, self.light_share(error_nm))
    }

    /// Fills the counts of one exposure, row by row, for a region of the sensor.
    pub fn render(&mut self, region: Region, exposure: u64, at: Duration, counts: &mut [u16]) {
        let (places, share) = self.truth(at);
        self.fill_profile(region, places, share);
        let mut noise = Noise::of(self.scene.seed, exposure);
        let background = self.scene.background_counts.max(0.0);
        let brightest = f64::from(self.scene.saturation_counts);
        for (row, line) in (region.top..).zip(counts.chunks_mut(region.width.max(1) as usize)) {
            let height = gaussian(f64::from(row) - self.scene.row_px, self.scene.sigma_px);
            for (count, light) in line.iter_mut().zip(&self.profile) {
                *count = noise.photons(background + height * light).min(brightest) as u16;
            }
        }
    }

    fn light_share(&self, error_nm: f64) -> f64 {
        let blocked = self.table.get(Quantity::FocusBeamBlocked);
        if blocked != 0.0 || !error_nm.is_finite() {
            return 0.0;
        }
        let capture_nm = self.scene.capture_nm.abs();
        gaussian((error_nm.abs() - capture_nm).max(0.0), 0.5 * capture_nm)
    }

    fn fill_profile(&mut self, region: Region, places: SpotPlaces, share: f64) {
        let SpotScene { sigma_px, peak_counts, .. } = self.scene;
        let peak = if share > 0.0 { peak_counts * share } else { 0.0 };
        self.profile.clear();
        self.profile.extend((0..region.width).map(|column| {
            let x = f64::from(region.left) + f64::from(column);
            match places {
                _ if peak <= 0.0 => 0.0,
                SpotPlaces::One(place) => peak * gaussian(x - place, sigma_px),
                SpotPlaces::Two(left, right) => {
                    peak * (gaussian(x - left, sigma_px) + gaussian(x - right, sigma_px))
                }
            }
        }));
    }
}

/// Columns of the spots.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum SpotPlaces {
    /// Of the only spot.
    One(f64),
    /// Of the left and the right one.
    Two(f64, f64),
}

/// exp(−x²/2σ²), nothing beyond the reach of a spot or of no width.
fn gaussian(x: f64, sigma: f64) -> f64 {
    if x == 0.0 {
        return 1.0;
    }
    let widths = x / sigma;
    if widths.abs() <= REACH { (-0.5 * widths * widths).exp() } else { 0.0 }
}

/// Shot noise of one exposure (SplitMix64: Steele, Lea, Flood, OOPSLA 2014; normal by Marsaglia's polar method).
struct Noise {
    state: u64,
    spare: Option<f64>,
}

impl Noise {
    fn of(seed: u64, exposure: u64) -> Self {
        let mut noise = Self { state: seed, spare: None };
        noise.state = noise.bits() ^ exposure.wrapping_mul(0xD6E8_FEB8_6659_FD93);
        noise
    }

    fn bits(&mut self) -> u64 {
        self.state = self.state.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut mixed = self.state;
        mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        mixed ^ (mixed >> 31)
    }

    /// From 0 to below 1.
    fn unit(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn normal(&mut self) -> f64 {
        if let Some(spare) = self.spare.take() {
            return spare;
        }
        loop {
            let (u, v) = (2.0 * self.unit() - 1.0, 2.0 * self.unit() - 1.0);
            let square = u * u + v * v;
            if square > 0.0 && square < 1.0 {
                let factor = (-2.0 * square.ln() / square).sqrt();
                self.spare = Some(v * factor);
                return u * factor;
            }
        }
    }

    /// Photons where `mean` are expected.
    fn photons(&mut self, mean: f64) -> f64 {
        if mean >= NORMAL_FROM {
            return (mean + mean.sqrt() * self.normal()).round().max(0.0);
        }
        let (end, mut product, mut photons) = ((-mean).exp(), self.unit(), 0.0);
        while product > end {
            product *= self.unit();
            photons += 1.0;
        }
        photons
    }
}
