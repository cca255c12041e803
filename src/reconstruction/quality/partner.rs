//! The part of camera T that shows what the central part of camera R shows.
//!
//! In: the registration of whole frames. Out: that of both parts; whole pixels of T at the places of R.
//! Never: leaves the sensor. Fails: [`SettingsError`] for a registration that cannot be used.

use crate::sofi::cumulant::{CumulantSettings, SettingsError};
use crate::sofi::registration::Resampler;
use std::ops::Range;

/// Where the part lies.
#[derive(Debug)]
pub(super) struct Partner {
    /// First row and column in T.
    pub(super) begin: [usize; 2],
    /// For every pixel of R's part, the nearest one in T's.
    nearest: Vec<usize>,
}

impl Partner {
    /// The channel whose part lies elsewhere.
    pub(super) const CHANNEL: usize = 1;

    /// Finds the part and makes the registration one between parts; none where cameras come aligned.
    pub(super) fn of(
        cumulants: &mut CumulantSettings,
        rows: &Range<usize>,
        columns: &Range<usize>,
    ) -> Result<Option<Self>, SettingsError> {
        let Some(registration) = &mut cumulants.registration else { return Ok(None) };
        let size = [rows.len(), columns.len()];
        let in_reflected = [rows.start, columns.start];
        let middle: [f64; 2] =
            std::array::from_fn(|axis| in_reflected[axis] as f64 + (size[axis] as f64 - 1.0) / 2.0);
        let in_transmitted = registration.transform.undo(middle).unwrap_or(middle);
        let begin: [usize; 2] = std::array::from_fn(|axis| {
            let first = (in_transmitted[axis] - (size[axis] as f64 - 1.0) / 2.0).round().max(0.0) as usize;
            first.min(registration.transform.size[axis].saturating_sub(size[axis]))
        });
        registration.transform = registration.transform.cropped([in_reflected, begin], size);
        let resampler = Resampler::new(&registration.transform, registration.interpolation)?;
        let nearest = (0..size[0] * size[1])
            .map(|pixel| {
                let (row, column) = resampler.nearest(pixel / size[1], pixel % size[1]);
                row * size[1] + column
            })
            .collect();
        Ok(Some(Self { begin, nearest }))
    }

    /// Pixels of T's part at the places of R's.
    pub(super) fn moved(&self, plane: &[u16]) -> Vec<u16> {
        self.nearest.iter().map(|&pixel| plane[pixel]).collect()
    }
}
