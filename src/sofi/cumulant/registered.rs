//! Camera T on the pixels of camera R.
//!
//! In: raw frames of T, the resampler, the noise of T. Out: rows of T on the pixels of R; sums of raw pixels, from
//! which the shared noise is found.
//! Never: changes anything where cameras come aligned, depends on how samples were blocked.

use super::bias::{self, PixelNoise};
use super::kernel::{Count, Planes, dispatch};
use super::layout::Layout;
use crate::sofi::camera::CameraMaps;
use crate::sofi::registration::{RegistrationSettings, Resampler, TransformError};
use ndarray::Array2;
use pulp::{Simd, WithSimd};
use std::sync::Arc;

/// The channel that is brought onto the others.
pub(super) const TRANSMITTED: usize = 1;

/// What an engine knows of the registration.
#[derive(Debug, Clone)]
pub(super) struct Registered {
    pub(super) resampler: Arc<Resampler>,
    /// The noise whose shared part is taken off; none where it stays.
    pub(super) noise: Option<PixelNoise>,
}

impl Registered {
    pub(super) fn new(
        settings: &RegistrationSettings,
        order: usize,
        camera: Option<&Arc<CameraMaps>>,
    ) -> Result<Self, TransformError> {
        let resampler = Arc::new(Resampler::new(&settings.transform, settings.interpolation)?);
        let is_taken_off = settings.interpolation.is_unbiased() && order <= bias::HIGHEST_ORDER;
        let noise = is_taken_off.then(|| match camera {
            Some(maps) => PixelNoise::Maps(Arc::clone(maps)),
            None => PixelNoise::Line(settings.noise),
        });
        Ok(Self { resampler, noise })
    }

    /// Pixels of R without a partner, or with a masked one.
    pub(super) fn missing(&self, masked: Option<&Array2<bool>>) -> Option<Array2<bool>> {
        self.resampler.missing(masked)
    }

    /// The band of T's rows that a band of R's rows has just been made from, about; another one for every band.
    pub(super) fn raw_band(&self, layout: &Layout, band: usize) -> usize {
        let middle = [layout.height / 2, layout.width / 2];
        let (row, _) = self.resampler.nearest(middle[0], middle[1]);
        let (here, there, bands) = (layout.band_of(middle[0]), layout.band_of(row), layout.bands());
        let flipped = self.resampler.nearest(middle[0] + 1, middle[1]).0 < row;
        if flipped {
            (there + here + 2 * bands - band) % bands
        } else {
            (there + band + bands - here) % bands
        }
    }

    /// Empty sums for one subsequence.
    pub(super) fn raw_sums(&self, layout: &Layout) -> RawSums {
        let bands = if self.noise.is_some() { layout.zeroed(1) } else { vec![Vec::new(); layout.bands()] };
        RawSums { registered: self.clone(), bands }
    }
}

/// Sums of raw pixels of T over the samples of a subsequence, by bands of its own rows.
#[derive(Debug, Clone)]
pub(super) struct RawSums {
    pub(super) registered: Registered,
    pub(super) bands: Vec<Vec<f64>>,
}

impl RawSums {
    pub(super) fn clear(&mut self) {
        self.bands.iter_mut().for_each(|sums| sums.fill(0.0));
    }

    pub(super) fn bytes(&self) -> usize {
        self.bands.iter().map(|sums| sums.len() * size_of::<f64>()).sum()
    }

    pub(super) fn merge(&mut self, later: &Self) {
        for (ours, theirs) in self.bands.iter_mut().flatten().zip(later.bands.iter().flatten()) {
            *ours += theirs;
        }
    }
}

/// Columns whose sums stay in registers while the samples pass.
const SUMMED_COLUMNS: usize = 32;

/// Adds the raw pixels of T in the rows of one band, in the order of time.
pub(super) fn add_raw<T: Count>(samples: &[Planes<'_, T>], layout: &Layout, band: usize, sums: &mut [f64]) {
    if !sums.is_empty() {
        dispatch(RawWork { samples, layout, band, sums });
    }
}

struct RawWork<'a, 'b, T> {
    samples: &'a [Planes<'b, T>],
    layout: &'a Layout,
    band: usize,
    sums: &'a mut [f64],
}

impl<T: Count> WithSimd for RawWork<'_, '_, T> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { samples, layout, band, sums } = self;
        for (y, sums) in layout.rows(band).zip(sums.chunks_exact_mut(layout.stride)) {
            let mut start = y * layout.width;
            let (many, rest) = sums[..layout.width].as_chunks_mut::<SUMMED_COLUMNS>();
            for sums in many {
                let mut now = *sums;
                for sample in samples {
                    let Some(pixels) = sample[TRANSMITTED][start..].first_chunk::<SUMMED_COLUMNS>() else {
                        continue;
                    };
                    for (sum, pixel) in now.iter_mut().zip(pixels) {
                        *sum += f64::from(pixel.counts());
                    }
                }
                *sums = now;
                start += SUMMED_COLUMNS;
            }
            for sample in samples {
                for (sum, pixel) in rest.iter_mut().zip(&sample[TRANSMITTED][start..]) {
                    *sum += f64::from(pixel.counts());
                }
            }
        }
    }
}
