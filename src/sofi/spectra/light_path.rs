//! Everything between a dye and the counts of both cameras, as curves over wavelength.
//!
//! In: the emission of a dye, a dichroic, filters and quantum efficiencies. Out: [`Detected`].
//! Never: counts a filter twice, takes a missing filter for a dark one. Fails: [`SpectraError`].
//!
//! With `S` the emission, `D` the dichroic, `F` what both cameras share and `F_T`, `F_R` what stands before one
//! (its quantum efficiency included):
//! `t = integral S F D F_T`, `r = integral S F (1 - D) F_R`, `T = t / (t + r)`, `R = 1 - T`
//! (section "Optimization" of the supporting information, with `T` on the long side, and all filters in the path).
//! A single-stained sample gives the same `T` from the sums of both cameras.

use super::{SpectraError, SpectralResponse, Spectrum};

/// What a dichroic does to light of each wavelength.
#[derive(Debug, Clone, PartialEq)]
pub struct DichroicCurve {
    transmission: Spectrum,
    reflection: Spectrum,
}

impl DichroicCurve {
    /// A dichroic that loses nothing: it reflects what it does not transmit (shares, `0..=1`).
    ///
    /// # Errors
    /// [`SpectraError::OutOfRange`] for a share above 1.
    pub fn lossless(transmission: Spectrum) -> Result<Self, SpectraError> {
        let reflection = transmission.complement()?;
        Ok(Self { transmission, reflection })
    }

    /// A dichroic whose reflection was measured too (shares, `0..=1`).
    ///
    /// # Errors
    /// [`SpectraError::OutOfRange`] for a share above 1.
    pub fn measured(transmission: Spectrum, reflection: Spectrum) -> Result<Self, SpectraError> {
        transmission.complement()?;
        reflection.complement()?;
        Ok(Self { transmission, reflection })
    }

    /// Share that passes to camera T.
    #[must_use]
    pub fn transmission(&self) -> &Spectrum {
        &self.transmission
    }

    /// Share that goes to camera R.
    #[must_use]
    pub fn reflection(&self) -> &Spectrum {
        &self.reflection
    }
}

/// Filters and quantum efficiencies, shares in `0..=1`; empty lists are free ways.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct LightPath {
    /// Passed by all light: objective, multi-band filters, cameras of one kind.
    pub common: Vec<Spectrum>,
    /// Before camera R only: its emission filter, its quantum efficiency.
    pub reflected: Vec<Spectrum>,
    /// Before camera T only.
    pub transmitted: Vec<Spectrum>,
}

/// What both cameras see of a dye.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Detected {
    /// Shares of the light that is seen.
    pub response: SpectralResponse,
    /// Share of the emission that either camera sees, `0..=1`.
    pub efficiency: f64,
}

impl LightPath {
    /// Whether nothing stands in it.
    #[must_use]
    pub fn is_free(&self) -> bool {
        [&self.common, &self.reflected, &self.transmitted].iter().all(|filters| filters.is_empty())
    }

    /// What the cameras see of an emission (any unit) behind a dichroic.
    ///
    /// # Errors
    /// [`SpectraError::NoLight`] if neither sees anything.
    pub fn detected(&self, emission: &Spectrum, dichroic: &DichroicCurve) -> Result<Detected, SpectraError> {
        let seen = |side: &Spectrum, own: &[Spectrum]| {
            let factors: Vec<&Spectrum> =
                [emission, side].into_iter().chain(&self.common).chain(own).collect();
            Spectrum::integral_of_product(&factors)
        };
        let transmitted = seen(&dichroic.transmission, &self.transmitted);
        let reflected = seen(&dichroic.reflection, &self.reflected);
        let emitted = emission.integral_above(f64::NEG_INFINITY);
        Ok(Detected {
            response: SpectralResponse::from_sums(transmitted, reflected)?,
            efficiency: (transmitted + reflected) / emitted,
        })
    }

    /// What camera R and camera T would see of an emission of each wavelength if all of it came their way,
    /// with a point at least every `step_nm` nanometers.
    ///
    /// # Errors
    /// [`SpectraError::Point`] if a product is not finite.
    pub fn weights(&self, emission: &Spectrum, step_nm: f64) -> Result<[Spectrum; 2], SpectraError> {
        let weight = |own: &[Spectrum]| {
            let factors: Vec<&Spectrum> = [emission].into_iter().chain(&self.common).chain(own).collect();
            Spectrum::product(&factors, step_nm)
        };
        Ok([weight(&self.reflected)?, weight(&self.transmitted)?])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn flat(value: f64) -> Spectrum {
        Spectrum::new(vec![400.0, 800.0], vec![value; 2]).unwrap()
    }

    fn block() -> Spectrum {
        Spectrum::new(vec![500.0, 600.0], vec![1.0, 1.0]).unwrap()
    }

    /// Transmits from 550 nm on.
    fn edge() -> DichroicCurve {
        let curve = Spectrum::new(vec![549.999, 550.001], vec![0.0, 1.0]).unwrap();
        DichroicCurve::lossless(curve).unwrap()
    }

    #[test]
    fn a_free_way_shares_the_light_and_loses_none() {
        let detected = LightPath::default().detected(&block(), &edge()).unwrap();
        assert!((detected.response.transmission() - 0.5).abs() < 1e-9);
        assert!((detected.efficiency - 1.0).abs() < 1e-9);
        assert!(LightPath::default().is_free());
    }

    #[test]
    fn common_filters_change_the_efficiency_and_filters_of_one_camera_the_shares() {
        let common = LightPath { common: vec![flat(0.8), flat(0.5)], ..LightPath::default() };
        let detected = common.detected(&block(), &edge()).unwrap();
        assert!((detected.response.transmission() - 0.5).abs() < 1e-9);
        assert!((detected.efficiency - 0.4).abs() < 1e-9);
        let own =
            LightPath { reflected: vec![flat(0.25)], transmitted: vec![flat(0.75)], ..LightPath::default() };
        let detected = own.detected(&block(), &edge()).unwrap();
        assert!((detected.response.transmission() - 0.75).abs() < 1e-9);
        assert!((detected.response.reflection() - 0.25).abs() < 1e-9);
        assert!((detected.efficiency - 0.5).abs() < 1e-9);
    }

    #[test]
    fn a_lossy_dichroic_is_taken_as_measured() {
        let dichroic = DichroicCurve::measured(flat(0.3), flat(0.6)).unwrap();
        let detected = LightPath::default().detected(&block(), &dichroic).unwrap();
        assert!((detected.response.transmission() - 1.0 / 3.0).abs() < 1e-12);
        assert!((detected.efficiency - 0.9).abs() < 1e-12);
        assert!(DichroicCurve::lossless(flat(1.2)).is_err());
        assert!(DichroicCurve::measured(flat(0.2), flat(1.2)).is_err());
    }

    #[test]
    fn blocked_light_is_no_share() {
        let dark = LightPath { common: vec![flat(0.0)], ..LightPath::default() };
        assert_eq!(dark.detected(&block(), &edge()), Err(SpectraError::NoLight));
    }

    #[test]
    fn weights_agree_with_what_is_detected_behind_an_edge() {
        let ramp = Spectrum::new(vec![400.0, 800.0], vec![0.2, 0.9]).unwrap();
        let path = LightPath { common: vec![ramp.clone()], transmitted: vec![ramp], ..LightPath::default() };
        let [r, t] = path.weights(&block(), 0.25).unwrap();
        let (t, r) = (t.integral_above(550.0), r.integral_above(0.0) - r.integral_above(550.0));
        let detected = path.detected(&block(), &edge()).unwrap();
        assert!((detected.response.transmission() - t / (t + r)).abs() < 1e-5);
    }
}
