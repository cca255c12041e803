//! Why a spectrum or a share of light is refused.
//!
//! In: a cause. Out: [`SpectraError`]. Never: a bare number without its meaning. Fails: not at all.

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
    /// Numbers that make no curve.
    #[error("{0}")]
    Shape(&'static str),
}
