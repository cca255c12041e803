//! How far an image is from the expected one.

/// Largest difference over the root mean square of the expected image; infinite when NaN stands in other places.
pub(crate) fn relative_error<'a>(
    got: impl IntoIterator<Item = &'a f32>,
    expected: impl IntoIterator<Item = &'a f64>,
) -> f64 {
    let (mut worst, mut squares, mut count) = (0.0f64, 0.0, 0.0);
    for (&got, &expected) in got.into_iter().zip(expected) {
        if got.is_nan() != expected.is_nan() {
            return f64::INFINITY;
        }
        if !expected.is_nan() {
            worst = worst.max((f64::from(got) - expected).abs());
            squares += expected * expected;
            count += 1.0;
        }
    }
    worst / (squares / count).sqrt()
}
