//! Reads `null` as NaN, as which numbers that are not finite are written.

use serde::{Deserialize, Deserializer};

/// One number.
pub(super) fn number<'de, D: Deserializer<'de>>(input: D) -> Result<f64, D::Error> {
    Option::deserialize(input).map(or_nan)
}

/// A list of numbers.
pub(super) fn list<'de, D: Deserializer<'de>>(input: D) -> Result<Vec<f64>, D::Error> {
    Vec::<Option<f64>>::deserialize(input).map(values)
}

/// A list of numbers that may be missing as a whole.
pub(super) fn optional_list<'de, D: Deserializer<'de>>(input: D) -> Result<Option<Vec<f64>>, D::Error> {
    Option::<Vec<Option<f64>>>::deserialize(input).map(|list| list.map(values))
}

/// A matrix.
pub(super) fn rows<'de, D: Deserializer<'de>>(input: D) -> Result<Vec<Vec<f64>>, D::Error> {
    Vec::<Vec<Option<f64>>>::deserialize(input).map(|rows| rows.into_iter().map(values).collect())
}

fn values(list: Vec<Option<f64>>) -> Vec<f64> {
    list.into_iter().map(or_nan).collect()
}

fn or_nan(number: Option<f64>) -> f64 {
    number.unwrap_or(f64::NAN)
}
