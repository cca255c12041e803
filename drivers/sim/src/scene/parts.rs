//! The parts of a scene: optics, species, cameras, the view of camera T.
//!
//! In: tables of a scene file. Out: values within their limits.
//! Never: has a default for what the sample is; cameras default to a typical sCMOS.

use serde::{Deserialize, Serialize};

use super::pixels::PixelSpread;
use super::shape::{Shape, read_shapes};
use crate::blinking::{Kinetics, Switching};
use crate::optics::psf_sigma_px;
use sofiscope_form::Form;

/// What the objective and the camera pixels do to light.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Optics {
    /// Pixel pitch in the sample, nanometers.
    pub pixel_pitch_nm: f64,
    /// Numerical aperture of the objective.
    pub numerical_aperture: f64,
}

impl Optics {
    pub(super) fn read(form: &Form<'_>) -> Self {
        Self {
            pixel_pitch_nm: form.number("pixel_pitch_nm", 10.0..=10_000.0),
            numerical_aperture: form.number("numerical_aperture", 0.1..=1.7),
        }
    }
}

/// How an emitter shines over time.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", tag = "kind")]
pub enum Photophysics {
    /// Always on, as a bead.
    Steady,
    /// Two-state Markov blinking with exponential times.
    Blinking {
        /// Mean time in the on-state, milliseconds.
        tau_on_ms: f64,
        /// Mean time in the off-state, milliseconds.
        tau_off_ms: f64,
    },
}

impl Photophysics {
    /// Share of the time in the on-state, 0 to 1.
    #[must_use]
    pub fn on_ratio(self) -> f64 {
        match self {
            Self::Steady => 1.0,
            Self::Blinking { tau_on_ms, tau_off_ms } => tau_on_ms / (tau_on_ms + tau_off_ms),
        }
    }
}

/// One kind of fluorophore and where it sits.
#[derive(Debug, Clone, PartialEq)]
pub struct Species {
    /// Name, unique in the scene.
    pub name: String,
    /// Share of its light that reaches camera T (`T_i` of the paper, Table S1).
    pub transmission: f64,
    /// Share of its light that reaches camera R (`R_i`; `1 - T_i` unless measured).
    pub reflection: f64,
    /// Wavelength of the emission that sets the width of the PSF, nanometers.
    pub emission_nm: f64,
    /// Photons that reach both cameras together in one exposure spent in the on-state (`I_on`).
    pub i_on_photons: f64,
    /// Blinking.
    pub photophysics: Photophysics,
    /// Mean time until bleaching, seconds; `None` for never.
    pub tau_bleach_s: Option<f64>,
    /// Diameter of a bead, nanometers; 0 for a molecule. Widens the PSF by the variance of a ball, `d^2 / 20`.
    pub diameter_nm: f64,
    /// Where its emitters sit.
    pub shapes: Vec<Shape>,
}

impl Species {
    /// Standard deviation of its image on camera R, pixels.
    #[must_use]
    pub fn sigma_px(&self, optics: &Optics) -> f64 {
        let psf = psf_sigma_px(self.emission_nm, optics.numerical_aperture, optics.pixel_pitch_nm);
        let diameter_px = self.diameter_nm / optics.pixel_pitch_nm;
        (psf * psf + diameter_px * diameter_px / 20.0).sqrt()
    }

    /// Its times in exposures.
    pub(crate) fn kinetics(&self, exposure_ms: f64) -> Kinetics {
        let switching = match self.photophysics {
            Photophysics::Steady => None,
            Photophysics::Blinking { tau_on_ms, tau_off_ms } => {
                Some(Switching { on: tau_on_ms / exposure_ms, off: tau_off_ms / exposure_ms })
            }
        };
        Kinetics { switching, bleaching: self.tau_bleach_s.map(|tau_s| tau_s * 1e3 / exposure_ms) }
    }

    pub(super) fn read(form: &Form<'_>, exposure_ms: f64, field: [[f64; 2]; 2]) -> Self {
        let transmission = form.number("transmission", 0.0..=1.0);
        Self {
            name: form.text("name"),
            transmission,
            reflection: read_reflection(form, transmission),
            emission_nm: form.number("emission_nm", 300.0..=1200.0),
            i_on_photons: form.number("i_on_photons", 0.0..=1e6),
            photophysics: read_photophysics(form, exposure_ms),
            tau_bleach_s: form.number_if_any("tau_bleach_s", 1e-3..=1e9),
            diameter_nm: form.number_or("diameter_nm", 0.0, 0.0..=10_000.0),
            shapes: read_shapes(form, field),
        }
    }
}

fn read_reflection(form: &Form<'_>, transmission: f64) -> f64 {
    let reflection = form.number_or("reflection", 1.0 - transmission, 0.0..=1.0);
    if reflection + transmission > 1.0 + 1e-9 {
        form.fault(
            "reflection",
            "and `transmission` together exceed 1",
            "give shares of the light, or leave `reflection` out for 1 - transmission",
        );
    }
    reflection
}

fn read_photophysics(form: &Form<'_>, exposure_ms: f64) -> Photophysics {
    // Far shorter times would be white noise within an exposure, at the price of endless switching.
    let times_ms = 1e-3 * exposure_ms..=1e9;
    if !form.flag("steady") {
        return Photophysics::Blinking {
            tau_on_ms: form.number("tau_on_ms", times_ms.clone()),
            tau_off_ms: form.number("tau_off_ms", times_ms),
        };
    }
    for key in ["tau_on_ms", "tau_off_ms"] {
        if form.has(key) {
            form.fault(key, "contradicts `steady = true`", "remove one of the two");
        }
    }
    Photophysics::Steady
}

/// A grid of small patches, each filled by one species chosen at random (paper, Fig. 2).
///
/// Brightness changes linearly from the top row to the bottom row, the on-ratio linearly from the left
/// column to the right one, through the off-time. Where a range is absent, the species' own values hold.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PatchGrid {
    /// Center of the first patch, `[y, x]` in pixels.
    pub from_px: [f64; 2],
    /// No patch center lies beyond this corner, `[y, x]` in pixels.
    pub to_px: [f64; 2],
    /// Distance between the centers of neighbors, pixels.
    pub spacing_px: f64,
    /// Radius of a patch, nanometers.
    pub radius_nm: f64,
    /// Emitters in each patch.
    pub emitters_per_patch: u64,
    /// Photons per exposure in the on-state in the top row and in the bottom row.
    pub i_on_photons: Option<[f64; 2]>,
    /// On-ratio in the left column and in the right column.
    pub on_ratio: Option<[f64; 2]>,
}

impl PatchGrid {
    /// Rows and columns of patches.
    #[must_use]
    pub fn size(&self) -> [u64; 2] {
        [0, 1].map(|axis| {
            ((self.to_px[axis] - self.from_px[axis]) / self.spacing_px + 1e-9).floor().max(0.0) as u64 + 1
        })
    }

    pub(super) fn read(form: &Form<'_>) -> Self {
        let grid = Self {
            from_px: form.pair("from_px", super::shape::COORDINATE_PX),
            to_px: form.pair("to_px", super::shape::COORDINATE_PX),
            spacing_px: form.number("spacing_px", 0.1..=1000.0),
            radius_nm: form.number("radius_nm", 0.0..=10_000.0),
            emitters_per_patch: form.whole("emitters_per_patch", 1..=1000),
            i_on_photons: form.pair_if_any("i_on_photons", 0.0..=1e6),
            on_ratio: form.pair_if_any("on_ratio", 1e-4..=0.99),
        };
        if grid.to_px[0] < grid.from_px[0] || grid.to_px[1] < grid.from_px[1] {
            form.fault("to_px", "is not beyond `from_px`", "give the corner of greater y and x");
        }
        grid
    }
}

/// How one camera turns photons into counts.
///
/// Electrons are Poisson with mean `quantum_efficiency * photons + dark_electrons_per_exposure`; counts are
/// `offset_counts + gain_counts_per_electron * (electrons + read noise)`, rounded, from 0 to `saturation_counts`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct CameraModel {
    /// Electrons per photon, 0 to 1. The default 1 makes all photon numbers of a scene *detected* photons.
    pub quantum_efficiency: f64,
    /// Counts per electron.
    pub gain_counts_per_electron: f64,
    /// Counts without any electron.
    pub offset_counts: f64,
    /// Standard deviation of the Gaussian read noise, electrons.
    pub read_noise_electrons: f64,
    /// Mean dark electrons per pixel and exposure.
    pub dark_electrons_per_exposure: f64,
    /// The most counts a pixel can give.
    pub saturation_counts: u16,
    /// How its pixels differ.
    #[serde(default)]
    pub pixels: PixelSpread,
}

impl Default for CameraModel {
    /// Typical values of an sCMOS camera of the kind used in the paper (0.46 electrons per count).
    fn default() -> Self {
        Self {
            quantum_efficiency: 1.0,
            gain_counts_per_electron: 1.0 / 0.46,
            offset_counts: 100.0,
            read_noise_electrons: 1.4,
            dark_electrons_per_exposure: 0.0,
            saturation_counts: u16::MAX,
            pixels: PixelSpread::default(),
        }
    }
}

impl CameraModel {
    pub(super) fn read(form: &Form<'_>, default: Self) -> Self {
        let number = |key, otherwise, limits| form.number_or(key, otherwise, limits);
        let saturation_counts = if form.has("saturation_counts") {
            form.whole("saturation_counts", 1..=u64::from(u16::MAX)) as u16
        } else {
            default.saturation_counts
        };
        Self {
            quantum_efficiency: number("quantum_efficiency", default.quantum_efficiency, 0.0..=1.0),
            gain_counts_per_electron: number(
                "gain_counts_per_electron",
                default.gain_counts_per_electron,
                1e-3..=1000.0,
            ),
            offset_counts: number("offset_counts", default.offset_counts, 0.0..=60_000.0),
            read_noise_electrons: number("read_noise_electrons", default.read_noise_electrons, 0.0..=1000.0),
            dark_electrons_per_exposure: number(
                "dark_electrons_per_exposure",
                default.dark_electrons_per_exposure,
                0.0..=1e5,
            ),
            saturation_counts,
            pixels: match form.table("pixels") {
                None => default.pixels,
                Some(own) => {
                    let pixels = PixelSpread::read(&own, default.pixels);
                    own.finish();
                    pixels
                }
            },
        }
    }
}

/// How camera T is flipped against camera R.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Mirror {
    /// Not at all.
    None,
    /// Left becomes right: `x -> width - 1 - x`.
    Horizontal,
    /// Top becomes bottom: `y -> height - 1 - y`.
    Vertical,
}

/// Where camera T sees a point of camera R.
///
/// First rotation and scale about the image center `c = ((height - 1) / 2, (width - 1) / 2)`, then the shift,
/// then the mirror: `p_T = mirror(c + scale * rotation * (p_R - c) + shift)`.
/// A positive angle turns the x axis towards the y axis, clockwise on a screen.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct View {
    /// The flip.
    pub mirror: Mirror,
    /// Shift `[y, x]` in pixels.
    pub shift_px: [f64; 2],
    /// Rotation in degrees.
    pub rotation_deg: f64,
    /// Magnification of camera T over camera R; widens the PSF as well.
    pub scale: f64,
}

impl Default for View {
    /// Both cameras see the same.
    fn default() -> Self {
        Self { mirror: Mirror::None, shift_px: [0.0; 2], rotation_deg: 0.0, scale: 1.0 }
    }
}

impl View {
    pub(super) fn read(form: &Form<'_>) -> Self {
        let mirrors =
            [("none", Mirror::None), ("horizontal", Mirror::Horizontal), ("vertical", Mirror::Vertical)];
        Self {
            mirror: form.word("mirror", &mirrors),
            shift_px: form.pair_if_any("shift_px", -10_000.0..=10_000.0).unwrap_or([0.0; 2]),
            rotation_deg: form.number_or("rotation_deg", 0.0, -180.0..=180.0),
            scale: form.number_or("scale", 1.0, 0.1..=10.0),
        }
    }

    /// The affine map as rows `[a_y, a_x, b]` for y and x: `y_T = a_y * y_R + a_x * x_R + b`.
    #[must_use]
    pub fn transmitted_from_reflected(&self, height_px: usize, width_px: usize) -> [[f64; 3]; 2] {
        let center = [(height_px as f64 - 1.0) / 2.0, (width_px as f64 - 1.0) / 2.0];
        let angle = self.rotation_deg.to_radians();
        let (sin, cos) = (self.scale * libm::sin(angle), self.scale * libm::cos(angle));
        let offset = |axis: usize, a_y: f64, a_x: f64| {
            center[axis] + self.shift_px[axis] - a_y * center[0] - a_x * center[1]
        };
        let mut rows = [[cos, sin, offset(0, cos, sin)], [-sin, cos, offset(1, -sin, cos)]];
        let flipped = match self.mirror {
            Mirror::None => return rows,
            Mirror::Vertical => 0,
            Mirror::Horizontal => 1,
        };
        rows[flipped] = rows[flipped].map(|entry| -entry);
        rows[flipped][2] += 2.0 * center[flipped];
        rows
    }

    /// Where camera T sees the point `[y, x]` of camera R, in pixels.
    #[must_use]
    pub fn apply(&self, point: [f64; 2], height_px: usize, width_px: usize) -> [f64; 2] {
        let rows = self.transmitted_from_reflected(height_px, width_px);
        rows.map(|[a_y, a_x, b]| a_y * point[0] + a_x * point[1] + b)
    }
}
