//! Curves of a few numbers, for planning where no measured spectrum is at hand.
//!
//! In: peak and half widths of an emission, place and width of an edge, passbands, in nanometers.
//! Out: [`Spectrum`] sampled every half nanometer. Never: stands for a measured curve unsaid.
//! Fails: [`SpectraError::Shape`].

use super::{SpectraError, Spectrum};

/// Distance of the points of a curve, nanometers.
const STEP_NM: f64 = 0.5;
/// An emission ends where it is below this share of its peak.
const END: f64 = 1e-5;
/// Filters are given between these wavelengths, nanometers.
const FILTER_NM: (f64, f64) = (300.0, 1200.0);
/// A logistic edge rises from a tenth to nine tenths over this many of its own lengths, `2 ln 9`.
const TENTH_TO_NINE_TENTHS: f64 = 4.394_449_154_672_439;

/// A log-normal emission (Siano and Metzler 1969), peak 1:
/// `S = exp(-ln 2 (ln a / ln rho)^2)`, `a = 1 + (lambda - peak) (rho^2 - 1) / (rho w)`, `rho = long / short`,
/// `w = long + short`; a Gaussian where both half widths are the same.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EmissionShape {
    /// Wavelength of the maximum, nanometers.
    pub peak_nm: f64,
    /// From the maximum to half of it on the short side, nanometers.
    pub short_half_width_nm: f64,
    /// From the maximum to half of it on the long side, nanometers.
    pub long_half_width_nm: f64,
}

impl EmissionShape {
    /// Value at a wavelength, `0..=1`.
    #[must_use]
    pub fn at(&self, wavelength_nm: f64) -> f64 {
        let (short, long) = (self.short_half_width_nm, self.long_half_width_nm);
        let offset = wavelength_nm - self.peak_nm;
        let rho = long / short;
        if (rho - 1.0).abs() < 1e-6 {
            return libm::exp(-std::f64::consts::LN_2 * (offset / short).powi(2));
        }
        let a = 1.0 + offset * (rho * rho - 1.0) / (rho * (short + long));
        if a <= 0.0 {
            return 0.0;
        }
        libm::exp(-std::f64::consts::LN_2 * (libm::log(a) / libm::log(rho)).powi(2))
    }

    /// The curve.
    ///
    /// # Errors
    /// [`SpectraError::Shape`] unless all three numbers are positive and both half widths at least 1 nm.
    pub fn spectrum(&self) -> Result<Spectrum, SpectraError> {
        let widths = [self.short_half_width_nm, self.long_half_width_nm];
        let is_good = self.peak_nm.is_finite() && widths.iter().all(|width| (1.0..=200.0).contains(width));
        if !is_good || self.peak_nm <= 0.0 {
            return Err(SpectraError::Shape("an emission needs a peak and half widths from 1 to 200 nm"));
        }
        let walk = |step: f64| {
            let places = (1..20_000).map(move |k| self.peak_nm + f64::from(k) * step);
            places.take_while(|&place| place > 0.0 && self.at(place) > END)
        };
        let mut wavelengths: Vec<f64> = walk(-STEP_NM).collect();
        wavelengths.reverse();
        wavelengths.push(self.peak_nm);
        wavelengths.extend(walk(STEP_NM));
        let values = wavelengths.iter().map(|&place| self.at(place)).collect();
        Spectrum::new(wavelengths, values)
    }
}

/// The edge of a dichroic that transmits the long side: a logistic step from `floor` to `ceiling`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EdgeShape {
    /// Wavelength of the middle of the step, nanometers.
    pub edge_nm: f64,
    /// From a tenth to nine tenths of the step, nanometers.
    pub width_nm: f64,
    /// Transmission of the short side, `0..=1`.
    pub floor: f64,
    /// Transmission of the long side, `0..=1`.
    pub ceiling: f64,
}

impl EdgeShape {
    /// The transmission curve.
    ///
    /// # Errors
    /// [`SpectraError::Shape`] for an edge or a width that is not positive, [`SpectraError::OutOfRange`] for shares.
    pub fn spectrum(&self) -> Result<Spectrum, SpectraError> {
        if !(self.edge_nm > 0.0 && self.width_nm > 0.0) {
            return Err(SpectraError::Shape("an edge needs a wavelength and a width above 0 nm"));
        }
        for value in [self.floor, self.ceiling] {
            if !(0.0..=1.0).contains(&value) {
                return Err(SpectraError::OutOfRange { coefficient: "transmission", value });
            }
        }
        let step = |nm: f64| self.floor + (self.ceiling - self.floor) * rise(nm, self.edge_nm, self.width_nm);
        sampled(step)
    }
}

/// A filter that transmits some bands: each a pair of logistic edges, everything else blocked.
#[derive(Debug, Clone, PartialEq)]
pub struct FilterShape {
    /// First and last wavelength of each band at half transmission, nanometers.
    pub bands_nm: Vec<[f64; 2]>,
    /// Of each edge from a tenth to nine tenths, nanometers.
    pub width_nm: f64,
    /// Transmission inside the bands, `0..=1`.
    pub ceiling: f64,
}

impl FilterShape {
    /// The transmission curve.
    ///
    /// # Errors
    /// [`SpectraError::Shape`] for a band that ends before it begins or a width that is not positive,
    /// [`SpectraError::OutOfRange`] for the ceiling.
    pub fn spectrum(&self) -> Result<Spectrum, SpectraError> {
        let is_band = |band: &[f64; 2]| band[0] > 0.0 && band[1] > band[0];
        if self.bands_nm.is_empty() || !self.bands_nm.iter().all(is_band) || self.width_nm.is_nan() {
            return Err(SpectraError::Shape("a filter needs bands that end above where they begin"));
        }
        if self.width_nm <= 0.0 {
            return Err(SpectraError::Shape("a filter needs edges wider than 0 nm"));
        }
        if !(0.0..=1.0).contains(&self.ceiling) {
            return Err(SpectraError::OutOfRange { coefficient: "transmission", value: self.ceiling });
        }
        let passes = |nm: f64| {
            let band = |[low, high]: &[f64; 2]| {
                rise(nm, *low, self.width_nm) * (1.0 - rise(nm, *high, self.width_nm))
            };
            self.ceiling * self.bands_nm.iter().map(band).sum::<f64>().min(1.0)
        };
        sampled(passes)
    }
}

/// From 0 to 1 at an edge.
fn rise(nm: f64, edge_nm: f64, width_nm: f64) -> f64 {
    1.0 / (1.0 + libm::exp(-TENTH_TO_NINE_TENTHS * (nm - edge_nm) / width_nm))
}

fn sampled(value_at: impl Fn(f64) -> f64) -> Result<Spectrum, SpectraError> {
    let count = ((FILTER_NM.1 - FILTER_NM.0) / STEP_NM) as u32;
    let wavelengths: Vec<f64> = (0..=count).map(|k| FILTER_NM.0 + f64::from(k) * STEP_NM).collect();
    let values = wavelengths.iter().map(|&nm| value_at(nm)).collect();
    Spectrum::new(wavelengths, values)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_emission_has_its_peak_and_its_half_widths() {
        for (short, long) in [(15.0, 27.0), (20.0, 20.0), (30.0, 12.0)] {
            let shape =
                EmissionShape { peak_nm: 590.0, short_half_width_nm: short, long_half_width_nm: long };
            let curve = shape.spectrum().unwrap();
            assert!((curve.at(590.0) - 1.0).abs() < 1e-12);
            assert!((curve.at(590.0 - short) - 0.5).abs() < 1e-3, "{}", curve.at(590.0 - short));
            assert!((curve.at(590.0 + long) - 0.5).abs() < 1e-3, "{}", curve.at(590.0 + long));
            let (first, last) = curve.range_nm();
            assert!(curve.at(first) < 1e-4 && curve.at(last) < 1e-4);
        }
    }

    #[test]
    fn an_edge_rises_from_floor_to_ceiling_within_its_width() {
        let shape = EdgeShape { edge_nm: 600.0, width_nm: 8.0, floor: 0.1, ceiling: 0.9 };
        let curve = shape.spectrum().unwrap();
        for (nm, expected) in [(596.0, 0.18), (600.0, 0.5), (604.0, 0.82), (400.0, 0.1), (900.0, 0.9)] {
            assert!((curve.at(nm) - expected).abs() < 1e-3, "{nm}: {}", curve.at(nm));
        }
    }

    #[test]
    fn a_filter_passes_its_bands_only() {
        let shape =
            FilterShape { bands_nm: vec![[500.0, 545.0], [572.0, 616.0]], width_nm: 4.0, ceiling: 0.95 };
        let curve = shape.spectrum().unwrap();
        for (nm, expected) in [(450.0, 0.0), (520.0, 0.95), (545.0, 0.475), (560.0, 0.0), (590.0, 0.95)] {
            assert!((curve.at(nm) - expected).abs() < 2e-3, "{nm}: {}", curve.at(nm));
        }
    }

    #[test]
    fn shapes_that_are_none_are_refused() {
        let emission = EmissionShape { peak_nm: 590.0, short_half_width_nm: 15.0, long_half_width_nm: 25.0 };
        assert!(EmissionShape { peak_nm: f64::NAN, ..emission }.spectrum().is_err());
        assert!(EmissionShape { short_half_width_nm: 0.0, ..emission }.spectrum().is_err());
        let edge = EdgeShape { edge_nm: 600.0, width_nm: 8.0, floor: 0.0, ceiling: 1.0 };
        assert!(EdgeShape { width_nm: 0.0, ..edge }.spectrum().is_err());
        assert!(EdgeShape { ceiling: 1.1, ..edge }.spectrum().is_err());
        let filter = FilterShape { bands_nm: vec![[500.0, 550.0]], width_nm: 4.0, ceiling: 1.0 };
        assert!(FilterShape { bands_nm: vec![[550.0, 500.0]], ..filter.clone() }.spectrum().is_err());
        assert!(FilterShape { bands_nm: Vec::new(), ..filter.clone() }.spectrum().is_err());
        assert!(FilterShape { ceiling: f64::NAN, ..filter }.spectrum().is_err());
    }
}
