//! Says which share of a dye's light each physical channel receives (`T_i`, `R_i`; main text, Table S1).
//!
//! In: numbers measured on a single-stained sample, or emission and filter spectra in nanometers.
//! Out: [`SpectralResponse`] and [`Species`], proved to lie in `0..=1`.
//! Never: reads files, guesses a missing spectrum, or puts `T` on the short side of a dichroic
//! (the supporting information writes the integral from 0 to the edge; Table S1 has the long side).
//! Fails: [`SpectraError`].

use thiserror::Error;

/// Why a spectral response or spectrum is refused.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum SpectraError {
    /// A coefficient is not a number in `0..=1`.
    #[error("{coefficient} = {value} is not a share of light between 0 and 1")]
    OutOfRange {
        /// Which coefficient: "transmission" or "reflection".
        coefficient: &'static str,
        /// The value given.
        value: f64,
    },
    /// Wavelengths and values differ in number, or there are fewer than two.
    #[error(
        "a spectrum needs at least two points and one value per wavelength: \
         {wavelengths} wavelengths, {values} values"
    )]
    Length {
        /// Number of wavelengths.
        wavelengths: usize,
        /// Number of values.
        values: usize,
    },
    /// Wavelengths do not increase, or something is negative or not finite.
    #[error("spectrum point {index}: wavelengths must increase, values be finite and not negative")]
    Point {
        /// Index of the first bad point, from 0.
        index: usize,
    },
    /// No light arrives in either channel, so there is no share to speak of.
    #[error("no light: the emission does not pass the filters, or both sums are zero or negative")]
    NoLight,
}

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
        let total = integral_of_product(&factors);
        if total <= 0.0 {
            return Err(SpectraError::NoLight);
        }
        factors.push(dichroic);
        Self::from_transmission(integral_of_product(&factors) / total)
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

/// A curve over wavelength, linear between its points.
///
/// As an emission it ends where its points end; as a filter it keeps its last value beyond them.
#[derive(Debug, Clone, PartialEq)]
pub struct Spectrum {
    wavelengths_nm: Vec<f64>,
    values: Vec<f64>,
}

impl Spectrum {
    /// A spectrum on any increasing grid of wavelengths (nanometers), values not negative.
    ///
    /// # Errors
    /// [`SpectraError::Length`] or [`SpectraError::Point`].
    pub fn new(wavelengths_nm: Vec<f64>, values: Vec<f64>) -> Result<Self, SpectraError> {
        if wavelengths_nm.len() < 2 || wavelengths_nm.len() != values.len() {
            return Err(SpectraError::Length { wavelengths: wavelengths_nm.len(), values: values.len() });
        }
        let is_good = |i: usize| {
            wavelengths_nm[i].is_finite()
                && (i == 0 || wavelengths_nm[i] > wavelengths_nm[i - 1])
                && values[i].is_finite()
                && values[i] >= 0.0
        };
        match (0..values.len()).find(|&i| !is_good(i)) {
            Some(index) => Err(SpectraError::Point { index }),
            None => Ok(Self { wavelengths_nm, values }),
        }
    }

    /// Value at a wavelength (nanometers), linear between points, the end value beyond the ends.
    #[must_use]
    pub fn at(&self, wavelength_nm: f64) -> f64 {
        let after = self.wavelengths_nm.partition_point(|&w| w < wavelength_nm);
        if after == 0 {
            return self.values[0];
        }
        if after == self.values.len() {
            return self.values[after - 1];
        }
        let (x0, x1) = (self.wavelengths_nm[after - 1], self.wavelengths_nm[after]);
        let (y0, y1) = (self.values[after - 1], self.values[after]);
        y0 + (y1 - y0) * (wavelength_nm - x0) / (x1 - x0)
    }

    /// First and last wavelength, nanometers.
    #[must_use]
    pub fn range_nm(&self) -> (f64, f64) {
        let last = self.wavelengths_nm.len() - 1;
        (self.wavelengths_nm[0], self.wavelengths_nm[last])
    }

    /// Integral over the wavelengths above `from_nm` (value times nanometers).
    #[must_use]
    pub fn integral_above(&self, from_nm: f64) -> f64 {
        let points = || self.wavelengths_nm.iter().zip(&self.values);
        points()
            .zip(points().skip(1))
            .map(|((&x0, _), (&x1, &y1))| {
                let start = from_nm.clamp(x0, x1);
                0.5 * (self.at(start) + y1) * (x1 - start)
            })
            .sum()
    }
}

fn share(coefficient: &'static str, value: f64) -> Result<f64, SpectraError> {
    if (0.0..=1.0).contains(&value) {
        Ok(value)
    } else {
        Err(SpectraError::OutOfRange { coefficient, value })
    }
}

/// Integral of the product of up to three spectra over the range of the first.
///
/// Simpson's rule between neighbors of the united grid is exact for cubics, so for three lines.
fn integral_of_product(factors: &[&Spectrum]) -> f64 {
    let (first, last) = factors[0].range_nm();
    let mut grid: Vec<f64> = factors
        .iter()
        .flat_map(|spectrum| spectrum.wavelengths_nm.iter().copied())
        .filter(|wavelength| (first..=last).contains(wavelength))
        .collect();
    grid.sort_by(f64::total_cmp);
    let product = |nm: f64| factors.iter().map(|s| s.at(nm)).product::<f64>();
    grid.windows(2)
        .map(|pair| {
            let middle = 0.5 * (pair[0] + pair[1]);
            let sum = product(pair[0]) + 4.0 * product(middle) + product(pair[1]);
            sum * (pair[1] - pair[0]) / 6.0
        })
        .sum()
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
    fn bad_spectra_are_refused() {
        assert!(Spectrum::new(vec![500.0], vec![1.0]).is_err());
        assert!(Spectrum::new(vec![500.0, 500.0], vec![1.0, 1.0]).is_err());
        assert!(Spectrum::new(vec![500.0, 501.0], vec![1.0, -1.0]).is_err());
        let dark = Spectrum::new(vec![500.0, 501.0], vec![0.0, 0.0]).unwrap();
        assert!(SpectralResponse::behind_ideal_edge(&dark, 500.5).is_err());
    }
}
