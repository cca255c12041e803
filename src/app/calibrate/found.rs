//! A registration from frames of both cameras, and the files that it is kept in; the same for command and window.
//!
//! In: frames of both cameras. Out: [`Found`], its file and its picture of residuals.
//! Never: overwrites a file. Fails: [`AppError`] with what to change.

use super::correlated::correlated;
use super::frames::Frames;
use super::statistics::{flat, statistics};
use super::vacant;
use crate::app::AppError;
use crate::app::residual_map::residual_map;
use crate::config::Registration;
use crate::display::{PngNotes, RgbImage};
use crate::sofi::psf_width::from_beads;
use crate::sofi::registration::{NoiseLine, find_beads, match_beads};
use ndarray::Array2;
use std::path::{Path, PathBuf};

/// Residuals above this are worth a warning, nanometers.
pub(in crate::app) const LARGE_RESIDUAL_NM: f64 = 20.0;

/// Diameter of beads where nobody says it, nanometers.
pub(in crate::app) const BEAD_NM: f64 = 200.0;

/// How a registration is found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(in crate::app) enum Method {
    Beads,
    Correlation,
}

/// A registration, and the mean image of camera R that its residuals are drawn on.
#[derive(Debug, Clone)]
pub(in crate::app) struct Found {
    pub(in crate::app) registration: Registration,
    mean: Array2<f32>,
}

/// Whose frames they are, and of what.
#[derive(Debug, Clone)]
pub(in crate::app) struct Cameras {
    /// Size of a camera pixel in the sample, nanometers.
    pub(in crate::app) pixel_pitch_nm: f64,
    /// Serial numbers of R and T, where known.
    pub(in crate::app) serials: [Option<String>; 2],
    /// Diameter of the beads, nanometers; taken off the width of the point-spread function.
    pub(in crate::app) bead_nm: f64,
}

/// Finds the registration of camera T onto camera R; `frames` are of R and of T, of the same exposures.
pub(in crate::app) fn find<F: Frames>(
    frames: &mut [F],
    method: Method,
    cameras: Cameras,
) -> Result<Found, AppError> {
    let [statistics_r, statistics_t] = statistics(frames)?;
    let mut all_beads = None;
    let found = match method {
        Method::Beads => {
            let beads = [&statistics_r, &statistics_t].map(|s| find_beads(&s.mean.view()));
            let beads = all_beads.insert(beads);
            let size = <[usize; 2]>::from(statistics_r.mean.dim());
            match_beads(&beads[0], &beads[1], size).map_err(AppError::data)?
        }
        Method::Correlation => correlated(frames)?,
    };
    let noise = match method {
        // Beads do not blink, so what their pixels do in time is noise.
        Method::Beads => NoiseLine::fit(flat(&statistics_t.mean), flat(&statistics_t.variance)),
        Method::Correlation => statistics_t.noise_between_pixels(),
    };
    let registration = Registration {
        method: if method == Method::Beads { "beads" } else { "correlation" }.to_owned(),
        date: jiff::Timestamp::now().to_string(),
        serials: cameras.serials,
        transform: found.transform,
        pixel_pitch_nm: cameras.pixel_pitch_nm,
        residual_px: found.residual_px,
        noise,
        psf_sigma_px: all_beads.and_then(|beads| {
            let diameter_px = cameras.bead_nm / cameras.pixel_pitch_nm;
            let [r, t] = beads.map(|beads| from_beads(&beads, diameter_px).map(|width| width.sigma_px));
            // A pixel of T is so many pixels of R.
            Some([r?, t? * found.transform.scale()])
        }),
        points: Registration::points_of(&found.pairs, &found.transform),
        points_left_out: found.outliers,
    };
    Registration::from_toml(&registration.to_toml()).map_err(AppError::data)?;
    Ok(Found { registration, mean: statistics_r.mean })
}

impl Found {
    /// The picture of residuals.
    pub(in crate::app) fn residual_map(&self) -> Result<RgbImage, AppError> {
        residual_map(&self.mean, &self.registration).map_err(AppError::data)
    }

    /// Writes the file and, beside it, the picture of residuals, whose path is given back.
    pub(in crate::app) fn write(&self, path: &Path) -> Result<PathBuf, AppError> {
        let (file, picture) = (path.to_owned(), path.with_extension("png"));
        vacant([&file, &picture])?;
        let notes = PngNotes {
            title: Some("Residuals of the registration of camera T onto camera R".to_owned()),
            pixel_pitch_nm: Some(self.registration.pixel_pitch_nm),
        };
        self.residual_map()?.write_png(&picture, &notes).map_err(AppError::data)?;
        std::fs::write(path, self.registration.to_toml())
            .map_err(|error| AppError::Usage(format!("{}: {error}", path.display())))?;
        Ok(picture)
    }
}
