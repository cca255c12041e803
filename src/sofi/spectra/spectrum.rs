//! A curve over wavelength and its integrals.
//!
//! In: wavelengths in nanometers on any increasing grid, values that are not negative. Out: [`Spectrum`].
//! Never: looks beyond the range of an emission. Fails: [`SpectraError`].

use super::SpectraError;

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

    /// The wavelengths of its points, nanometers.
    #[must_use]
    pub fn wavelengths_nm(&self) -> &[f64] {
        &self.wavelengths_nm
    }

    /// The values at its points.
    #[must_use]
    pub fn values(&self) -> &[f64] {
        &self.values
    }

    /// Largest value.
    #[must_use]
    pub fn peak(&self) -> f64 {
        self.values.iter().copied().fold(0.0, f64::max)
    }

    /// What a curve of shares leaves over: `1 - value` at every point.
    ///
    /// # Errors
    /// [`SpectraError::OutOfRange`] if a value is above 1.
    pub fn complement(&self) -> Result<Self, SpectraError> {
        if self.peak() > 1.0 {
            return Err(SpectraError::OutOfRange { coefficient: "transmission", value: self.peak() });
        }
        let values = self.values.iter().map(|value| 1.0 - value).collect();
        Ok(Self { wavelengths_nm: self.wavelengths_nm.clone(), values })
    }

    /// Integral of the product of spectra over the range of the first (value times nanometers); 0 for none.
    ///
    /// Four points after Gauss between neighbors of the united grid are exact for up to seven factors.
    #[must_use]
    pub fn integral_of_product(factors: &[&Self]) -> f64 {
        let Some(grid) = united_grid(factors) else { return 0.0 };
        let product = |nm: f64| factors.iter().map(|factor| factor.at(nm)).product::<f64>();
        let between = |pair: &[f64]| {
            let (middle, half) = (0.5 * (pair[0] + pair[1]), 0.5 * (pair[1] - pair[0]));
            let sum: f64 = GAUSS
                .iter()
                .map(|(place, weight)| {
                    weight * (product(middle - half * place) + product(middle + half * place))
                })
                .sum();
            sum * half
        };
        grid.windows(2).map(between).sum()
    }

    /// The product of spectra over the range of the first, with a point at least every `step_nm` nanometers.
    ///
    /// # Errors
    /// [`SpectraError::Length`] without any factor, [`SpectraError::Point`] if a product is not finite.
    pub fn product(factors: &[&Self], step_nm: f64) -> Result<Self, SpectraError> {
        let grid = united_grid(factors).unwrap_or_default();
        let mut wavelengths_nm: Vec<f64> = Vec::with_capacity(grid.len());
        for pair in grid.windows(2) {
            let parts = ((pair[1] - pair[0]) / step_nm).ceil().clamp(1.0, 1e4) as u32;
            let step = (pair[1] - pair[0]) / f64::from(parts);
            wavelengths_nm.extend((0..parts).map(|part| pair[0] + f64::from(part) * step));
        }
        wavelengths_nm.extend(grid.last());
        let value = |nm: &f64| factors.iter().map(|factor| factor.at(*nm)).product();
        let values = wavelengths_nm.iter().map(value).collect();
        Self::new(wavelengths_nm, values)
    }
}

/// Places and weights of Gauss and Legendre for four points on `-1..=1`, each for both signs.
const GAUSS: [(f64, f64); 2] =
    [(0.339_981_043_584_856_3, 0.652_145_154_862_546_1), (0.861_136_311_594_052_6, 0.347_854_845_137_453_85)];

/// All wavelengths of all spectra within the range of the first, increasing; nothing without a spectrum.
fn united_grid(factors: &[&Spectrum]) -> Option<Vec<f64>> {
    let (first, last) = factors.first()?.range_nm();
    let all = factors.iter().flat_map(|factor| factor.wavelengths_nm.iter().copied());
    let mut grid: Vec<f64> = all.filter(|wavelength| (first..=last).contains(wavelength)).collect();
    grid.sort_by(f64::total_cmp);
    grid.dedup();
    Some(grid)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bad_spectra_are_refused() {
        assert!(Spectrum::new(vec![500.0], vec![1.0]).is_err());
        assert!(Spectrum::new(vec![500.0, 500.0], vec![1.0, 1.0]).is_err());
        assert!(Spectrum::new(vec![500.0, 501.0], vec![1.0, -1.0]).is_err());
    }

    #[test]
    fn products_are_integrated_exactly_and_sampled_finely() {
        let line = |a: f64, b: f64| Spectrum::new(vec![0.0, 2.0], vec![a, b]).unwrap();
        // The integral of x^5 from 0 to 2, five factors x.
        let ramp = line(0.0, 2.0);
        assert!((Spectrum::integral_of_product(&[&ramp; 5]) - 64.0 / 6.0).abs() < 1e-12);
        assert_eq!(Spectrum::integral_of_product(&[]), 0.0);
        let square = Spectrum::product(&[&ramp, &ramp], 0.01).unwrap();
        assert!(square.wavelengths_nm().len() >= 201);
        assert!((square.integral_above(0.0) - 8.0 / 3.0).abs() < 1e-3);
        assert!(Spectrum::product(&[], 1.0).is_err());
    }

    #[test]
    fn what_is_not_transmitted_is_left_over() {
        let curve = Spectrum::new(vec![500.0, 600.0], vec![0.25, 1.0]).unwrap();
        assert_eq!(curve.complement().unwrap().values(), [0.75, 0.0]);
        assert!(Spectrum::new(vec![500.0, 600.0], vec![0.0, 1.01]).unwrap().complement().is_err());
    }
}
