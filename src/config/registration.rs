//! The file of a registration: where camera R sees what camera T sees, and how well that is known.
//!
//! In: text in TOML. Out: [`Registration`], and its text again.
//! Never: guesses a mirror, takes a file for another size. Fails: [`RegistrationFaults`], all faults at once.

use crate::sofi::registration::{
    Affine, Interpolation, Mirror, NoiseLine, PointPair, ReflectedFromTransmitted, RegistrationSettings,
    Resampler,
};
use sofiscope_form::{Fault, Faults, Form, read};
use std::fmt::Write;

/// Version of the file.
const VERSION: u64 = 1;

/// Sides of camera regions, pixels.
const SIDES: std::ops::RangeInclusive<u64> = 4..=100_000;

/// A calibration of two cameras.
#[derive(Debug, Clone, PartialEq)]
pub struct Registration {
    /// How it was found: `beads` or `correlation`.
    pub method: String,
    /// When, in the form of ISO 8601.
    pub date: String,
    /// Serial numbers of R and T, where known.
    pub serials: [Option<String>; 2],
    /// The transform, between regions of its size.
    pub transform: ReflectedFromTransmitted,
    /// Size of a camera pixel in the sample, nanometers.
    pub pixel_pitch_nm: f64,
    /// Root mean square of the distances between partners, pixels of R.
    pub residual_px: f64,
    /// Noise of camera T.
    pub noise: Option<NoiseLine>,
    /// Width of the point-spread function of R and T on beads, standard deviation in pixels of R, where it was measured.
    pub psf_sigma_px: Option<[f64; 2]>,
    /// The points that were used, in T as its camera gives it and in R, `[y, x]`.
    pub points: Vec<[[f64; 2]; 2]>,
    /// Points that were found in both cameras and do not fit.
    pub points_left_out: usize,
}

/// Everything that is wrong with the file.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{}", faults.iter().map(ToString::to_string).collect::<Vec<_>>().join("; "))]
pub struct RegistrationFaults {
    /// All faults in the order of lines.
    pub faults: Vec<Fault>,
}

impl Registration {
    /// Reads a file.
    ///
    /// # Errors
    /// [`RegistrationFaults`] with every fault.
    pub fn from_toml(text: &str) -> Result<Self, RegistrationFaults> {
        let faults = Faults::new(text);
        let found = read(&faults, whole);
        match (found, faults.into_list()) {
            (Some(registration), faults) if faults.is_empty() => Ok(registration),
            (_, faults) => Err(RegistrationFaults { faults }),
        }
    }

    /// The text of the file.
    #[must_use]
    pub fn to_toml(&self) -> String {
        let Affine { matrix: [row_y, row_x], shift } = self.transform.affine;
        let mut text = format!(
            "# Registration of camera T onto camera R, made by `sofiscope calibrate registration`.\n\
             # In R: [y, x] = matrix * mirrored [y, x] of T + shift; the mirror is about the middle of T's region.\n\
             registration_version = {VERSION}\n\
             method = {:?}\n\
             date = {:?}\n",
            self.method, self.date
        );
        for (key, serial) in ["reflected_serial", "transmitted_serial"].iter().zip(&self.serials) {
            if let Some(serial) = serial {
                let _ = writeln!(text, "{key} = {}", toml::Value::from(serial.as_str()));
            }
        }
        let _ = write!(
            text,
            "height_px = {}\nwidth_px = {}\npixel_pitch_nm = {:?}\n\
             mirror = \"{}\"\nmatrix_y = {row_y:?}\nmatrix_x = {row_x:?}\nshift_px = {shift:?}\n\
             residual_px = {:?}\nresidual_nm = {:?}\npoints_left_out = {}\n",
            self.transform.size[0],
            self.transform.size[1],
            self.pixel_pitch_nm,
            self.transform.mirror.name(),
            self.residual_px,
            self.residual_px * self.pixel_pitch_nm,
            self.points_left_out,
        );
        if let Some(widths) = self.psf_sigma_px {
            let _ = writeln!(text, "psf_sigma_px = {widths:?}");
        }
        for (key, camera) in [("reflected_points_px", 1), ("transmitted_points_px", 0)] {
            if self.points.is_empty() {
                continue;
            }
            let _ = writeln!(text, "{key} = [");
            for point in &self.points {
                let [y, x] = point[camera];
                let _ = writeln!(text, "  [{y:.4}, {x:.4}],");
            }
            text.push_str("]\n");
        }
        if let Some(NoiseLine { slope, at_zero }) = self.noise {
            let _ = write!(
                text,
                "\n# Variance of a pixel of T: slope_counts * mean + at_zero_counts2, as found from its frames; the slope\n\
                 # is the gain in counts per electron.\n\
                 [transmitted_noise]\nslope_counts = {slope:?}\nat_zero_counts2 = {at_zero:?}\n"
            );
        }
        text
    }

    /// What the cumulants need of it.
    ///
    /// # Errors
    /// A sentence, where the noise of T is needed and not known.
    pub fn settings(&self, interpolation: Interpolation) -> Result<RegistrationSettings, String> {
        let noise = match (self.noise, interpolation.is_unbiased()) {
            (Some(noise), _) => noise,
            (None, false) => NoiseLine { slope: 0.0, at_zero: 0.0 },
            (None, true) => {
                return Err("the registration does not know the noise of camera T; add the table \
                     [transmitted_noise] with slope_counts and at_zero_counts2"
                    .to_owned());
            }
        };
        Ok(RegistrationSettings { transform: self.transform, interpolation, noise })
    }

    /// Residuals of the points that were used: place in R and error, `[y, x]` in pixels.
    #[must_use]
    pub fn residuals(&self) -> Vec<([f64; 2], [f64; 2])> {
        let residual = |[transmitted, reflected]: &[[f64; 2]; 2]| {
            let mapped = self.transform.apply(*transmitted);
            (*reflected, std::array::from_fn(|axis| mapped[axis] - reflected[axis]))
        };
        self.points.iter().map(residual).collect()
    }

    /// Points from pairs of flipped T and R.
    #[must_use]
    pub fn points_of(pairs: &[PointPair], transform: &ReflectedFromTransmitted) -> Vec<[[f64; 2]; 2]> {
        pairs.iter().map(|pair| [transform.mirror.apply(pair.from, transform.size), pair.to]).collect()
    }
}

fn whole(form: &Form<'_>) -> Registration {
    let version = form.whole("registration_version", 0..=u64::MAX);
    if form.has("registration_version") && version != VERSION {
        form.fault(
            "registration_version",
            format!("is {version}, and this version of the program reads {VERSION}"),
            "calibrate again with this version",
        );
    }
    form.number_or("residual_nm", 0.0, 0.0..=1e9);
    let serial = |key| form.has(key).then(|| form.text(key));
    let registration = Registration {
        method: form.text("method"),
        date: form.text("date"),
        serials: [serial("reflected_serial"), serial("transmitted_serial")],
        transform: ReflectedFromTransmitted {
            mirror: form.word("mirror", &Mirror::NAMES),
            affine: Affine {
                matrix: [form.pair("matrix_y", -2.0..=2.0), form.pair("matrix_x", -2.0..=2.0)],
                shift: form.pair("shift_px", -1e6..=1e6),
            },
            size: [form.whole("height_px", SIDES) as usize, form.whole("width_px", SIDES) as usize],
        },
        pixel_pitch_nm: form.number("pixel_pitch_nm", 1.0..=100_000.0),
        residual_px: form.number("residual_px", 0.0..=1e6),
        noise: form.table("transmitted_noise").map(|noise| {
            let line = NoiseLine {
                slope: noise.number("slope_counts", 1e-6..=1e6),
                at_zero: noise.number("at_zero_counts2", -1e12..=1e12),
            };
            noise.finish();
            line
        }),
        psf_sigma_px: form.pair_if_any("psf_sigma_px", 0.1..=100.0),
        points: points(form),
        points_left_out: form.whole("points_left_out", 0..=u64::MAX) as usize,
    };
    let keys = ["matrix_y", "matrix_x", "shift_px", "height_px", "width_px"];
    if keys.iter().all(|key| form.has(key))
        && let Err(error) = Resampler::new(&registration.transform, Interpolation::default())
    {
        form.fault("matrix_y", format!("cannot be used: {error}"), "calibrate again");
    }
    registration
}

fn points(form: &Form<'_>) -> Vec<[[f64; 2]; 2]> {
    let list = |key| if form.has(key) { form.points(key, -1e6..=1e6) } else { Vec::new() };
    let (transmitted, reflected) = (list("transmitted_points_px"), list("reflected_points_px"));
    if transmitted.len() != reflected.len() {
        form.fault(
            "transmitted_points_px",
            format!("has {} points and reflected_points_px {}", transmitted.len(), reflected.len()),
            "give every point in both cameras",
        );
    }
    transmitted.into_iter().zip(reflected).map(|(t, r)| [t, r]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn example() -> Registration {
        Registration {
            method: "beads".to_owned(),
            date: "2026-01-02".to_owned(),
            serials: [Some("A \"1\"".to_owned()), None],
            transform: ReflectedFromTransmitted {
                mirror: Mirror::Horizontal,
                affine: Affine { matrix: [[1.002, 0.01], [-0.01, 1.002]], shift: [40.4, -12.55] },
                size: [256, 512],
            },
            pixel_pitch_nm: 108.0,
            residual_px: 0.05,
            noise: Some(NoiseLine { slope: 2.174, at_zero: -208.0 }),
            psf_sigma_px: Some([0.98, 1.1]),
            points: vec![[[1.5, 2.25], [3.0, 4.0]], [[10.0, 20.0], [30.0, 40.0]]],
            points_left_out: 3,
        }
    }

    #[test]
    fn what_is_written_is_read() {
        for registration in
            [example(), Registration { noise: None, psf_sigma_px: None, points: Vec::new(), ..example() }]
        {
            assert_eq!(Registration::from_toml(&registration.to_toml()).unwrap(), registration);
        }
    }

    #[test]
    fn all_faults_are_named() {
        let text = example().to_toml();
        let text = text.replace("mirror = \"horizontal\"", "mirror = \"left\"").replace("date", "dates");
        let faults = Registration::from_toml(&text).unwrap_err().to_string();
        assert!(faults.contains("mirror") && faults.contains("date"), "{faults}");
        let turned = example().to_toml().replace("0.01", "0.2");
        assert!(Registration::from_toml(&turned).unwrap_err().to_string().contains("turn the camera"));
    }

    #[test]
    fn noise_is_needed_only_where_it_is_taken_off() {
        let unknown = Registration { noise: None, ..example() };
        assert!(unknown.settings(Interpolation::UnbiasedSinc).is_err());
        assert!(unknown.settings(Interpolation::BilinearFrames).is_ok());
    }
}
