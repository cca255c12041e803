//! `T_i` and `R_i`: the shares of one dye's light in the two physical channels.
//!
//! In: numbers, sums of counts, or spectra. Out: [`SpectralResponse`], [`Species`].
//! Never: a share outside `0..=1`. Fails: [`SpectraError`].

use super::{SpectraError, Spectrum};

/// Shares of one dye's emission in the two physical channels behind one dichroic.
///
/// Both are in `0..=1`; `reflection = 1 - transmission` unless both were measured.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpectralResponse {
    transmission: f64,
    reflection: f64,
}

impl SpectralResponse {
    /// A lossless dichroic: `R = 1 - T`.
    ///
    /// # Errors
    /// [`SpectraError::OutOfRange`] unless `transmission` is in `0..=1`.
    pub fn from_transmission(transmission: f64) -> Result<Self, SpectraError> {
        Self::measured(transmission, 1.0 - transmission)
    }

    /// Both shares measured independently; they need not add up to 1.
    ///
    /// # Errors
    /// [`SpectraError::OutOfRange`] unless both are in `0..=1`.
    pub fn measured(transmission: f64, reflection: f64) -> Result<Self, SpectraError> {
        Ok(Self {
            transmission: share("transmission", transmission)?,
            reflection: share("reflection", reflection)?,
        })
    }

    /// From background-corrected sums of both channels of a single-stained sample (any unit):
    /// `T = sum_T / (sum_T + sum_R)`.
    ///
    /// # Errors
    /// [`SpectraError::NoLight`] if the total is not positive, [`SpectraError::OutOfRange`] if one
    /// sum is negative or not finite.
    pub fn from_sums(transmitted: f64, reflected: f64) -> Result<Self, SpectraError> {
        let total = transmitted + reflected;
        if total <= 0.0 {
            return Err(SpectraError::NoLight);
        }
        Self::from_transmission(transmitted / total)
    }

    /// `T = integral S F D_T / integral S F`, `S` the emission, `D_T` the transmission of the
    /// dichroic (`0..=1`), `F` a filter common to both channels.
    ///
    /// # Errors
    /// [`SpectraError::NoLight`] if nothing of the emission passes `common_filter`,
    /// [`SpectraError::OutOfRange`] if the dichroic transmits more than everything.
    pub fn from_spectra(
        emission: &Spectrum,
        dichroic: &Spectrum,
        common_filter: Option<&Spectrum>,
    ) -> Result<Self, SpectraError> {
        let mut factors = vec![emission];
        factors.extend(common_filter);
        let total = Spectrum::integral_of_product(&factors);
        if total <= 0.0 {
            return Err(SpectraError::NoLight);
        }
        factors.push(dichroic);
        Self::from_transmission(Spectrum::integral_of_product(&factors) / total)
    }

    /// An ideal step edge at `edge_nm` that transmits the long side: `T = integral_edge^inf S / integral S`.
    ///
    /// # Errors
    /// [`SpectraError::NoLight`] if the emission is zero everywhere.
    pub fn behind_ideal_edge(emission: &Spectrum, edge_nm: f64) -> Result<Self, SpectraError> {
        let total = emission.integral_above(f64::NEG_INFINITY);
        if total <= 0.0 {
            return Err(SpectraError::NoLight);
        }
        Self::from_transmission((emission.integral_above(edge_nm) / total).clamp(0.0, 1.0))
    }

    /// `T_i`, the share on the long-wavelength side, in `0..=1`.
    #[must_use]
    pub fn transmission(&self) -> f64 {
        self.transmission
    }

    /// `R_i`, the share on the short-wavelength side, in `0..=1`.
    #[must_use]
    pub fn reflection(&self) -> f64 {
        self.reflection
    }
}

/// One fluorophore species as the unmixing sees it.
#[derive(Debug, Clone, PartialEq)]
pub struct Species {
    /// Name shown to the user and used in errors, e.g. `"Alexa Fluor 647"`.
    pub name: String,
    /// Shares of its light in the two channels.
    pub response: SpectralResponse,
    /// Wavelength of its emission maximum, nanometers, where known.
    pub emission_nm: Option<f64>,
}

impl Species {
    /// A species of unknown emission maximum behind a lossless dichroic.
    ///
    /// # Errors
    /// [`SpectraError::OutOfRange`] unless `transmission` is in `0..=1`.
    pub fn new(name: &str, transmission: f64) -> Result<Self, SpectraError> {
        Ok(Self {
            name: name.to_owned(),
            response: SpectralResponse::from_transmission(transmission)?,
            emission_nm: None,
        })
    }
}

fn share(coefficient: &'static str, value: f64) -> Result<f64, SpectraError> {
    if (0.0..=1.0).contains(&value) {
        Ok(value)
    } else {
        Err(SpectraError::OutOfRange { coefficient, value })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn triangle() -> Spectrum {
        Spectrum::new(vec![500.0, 550.0, 600.0], vec![0.0, 1.0, 0.0]).unwrap()
    }

    #[test]
    fn reflection_completes_transmission_unless_measured() {
        let ideal = SpectralResponse::from_transmission(0.35).unwrap();
        assert!((ideal.reflection() - 0.65).abs() < 1e-15);
        let lossy = SpectralResponse::measured(0.3, 0.5).unwrap();
        assert_eq!((lossy.transmission(), lossy.reflection()), (0.3, 0.5));
        let sums = SpectralResponse::from_sums(30.0, 10.0).unwrap();
        assert!((sums.transmission() - 0.75).abs() < 1e-15);
    }

    #[test]
    fn shares_outside_zero_to_one_are_refused() {
        for bad in [-0.01, 1.01, f64::NAN, f64::INFINITY] {
            assert!(SpectralResponse::from_transmission(bad).is_err());
            assert!(SpectralResponse::measured(0.5, bad).is_err());
        }
        assert_eq!(SpectralResponse::from_sums(0.0, 0.0), Err(SpectraError::NoLight));
        assert!(SpectralResponse::from_sums(-1.0, 5.0).is_err());
    }

    #[test]
    fn the_long_side_is_transmitted() {
        let red = SpectralResponse::behind_ideal_edge(&triangle(), 500.0).unwrap();
        let blue = SpectralResponse::behind_ideal_edge(&triangle(), 600.0).unwrap();
        let half = SpectralResponse::behind_ideal_edge(&triangle(), 575.0).unwrap();
        assert_eq!((red.transmission(), blue.transmission()), (1.0, 0.0));
        assert!((half.transmission() - 0.125).abs() < 1e-12);
    }

    #[test]
    fn products_of_spectra_on_different_grids_are_integrated_exactly() {
        let ramp = Spectrum::new(vec![500.0, 600.0], vec![0.0, 1.0]).unwrap();
        let response = SpectralResponse::from_spectra(&triangle(), &ramp, None).unwrap();
        assert!((response.transmission() - 0.5).abs() < 1e-12);
        // Filtered by the same ramp: integral S x^2 / integral S x with x uniform on the triangle.
        let filtered = SpectralResponse::from_spectra(&triangle(), &ramp, Some(&ramp)).unwrap();
        assert!((filtered.transmission() - (7.0 / 24.0) / 0.5).abs() < 1e-12);
    }

    #[test]
    fn a_dark_emission_is_refused() {
        let dark = Spectrum::new(vec![500.0, 501.0], vec![0.0, 0.0]).unwrap();
        assert!(SpectralResponse::behind_ideal_edge(&dark, 500.5).is_err());
    }
}
