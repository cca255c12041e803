//! Camera T on the pixels of camera R, and the noise that neighbors share by that.
//!
//! A value between pixels of T is made from raw pixels, so neighbors share the shot noise of these, and their product
//! has a mean even where nothing blinks: `bias(p, q) = sum over raw pixels a of w_p(a) w_q(a) var(a)`. It is linear in
//! the mean image of T, which is summed beside the products, and is taken off when sums become cumulants.
//!
//! In: raw frames of T, the resampler, the noise of T. Out: sums of raw pixels; the bias of a pair of pixels, by rows.
//! Never: changes anything where cameras come aligned, depends on how samples were blocked.

use super::kernel::{Count, Planes};
use super::layout::Layout;
use super::plan::{Element, Term};
use crate::sofi::camera::CameraMaps;
use crate::sofi::registration::{
    NoiseLine, REGISTER, RegistrationSettings, Resampler, RowTaps, TAPS, TransformError,
};
use ndarray::Array2;
use pulp::Simd;
use std::sync::Arc;

/// The channel that is brought onto the others.
pub(super) const TRANSMITTED: usize = 1;

/// What an engine knows of the registration.
#[derive(Debug, Clone)]
pub(super) struct Registered {
    pub(super) resampler: Arc<Resampler>,
    /// The noise whose shared part is taken off; none where it stays.
    noise: Option<PixelNoise>,
}

/// The noise of T's pixels.
#[derive(Debug, Clone)]
enum PixelNoise {
    /// The same law for all of them.
    Line(NoiseLine),
    /// Each its own.
    Maps(Arc<CameraMaps>),
}

impl PixelNoise {
    #[inline(always)]
    fn variance(&self, place: (usize, usize), mean: f64) -> f64 {
        match self {
            Self::Line(line) => line.variance(mean),
            Self::Maps(maps) => maps.noise_variance(place, mean),
        }
    }
}

impl Registered {
    pub(super) fn new(
        settings: &RegistrationSettings,
        order: usize,
        camera: Option<&Arc<CameraMaps>>,
    ) -> Result<Self, TransformError> {
        let resampler = Arc::new(Resampler::new(&settings.transform, settings.interpolation)?);
        let noise = (settings.interpolation.is_unbiased() && order == 2).then(|| match camera {
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

/// Columns that are summed at a time: few enough that their sums stay in the first-level cache.
const SUMMED_COLUMNS: usize = 512;

/// Adds the raw pixels of T in the rows of one band, in the order of time.
pub(super) fn add_raw<T: Count>(samples: &[Planes<'_, T>], layout: &Layout, band: usize, sums: &mut [f64]) {
    if sums.is_empty() {
        return;
    }
    pulp::Arch::new().dispatch(
        #[inline(always)]
        || {
            for (y, sums) in layout.rows(band).zip(sums.chunks_exact_mut(layout.stride)) {
                let mut start = y * layout.width;
                for sums in sums[..layout.width].chunks_mut(SUMMED_COLUMNS) {
                    for sample in samples {
                        let pixels = &sample[TRANSMITTED][start..start + sums.len()];
                        for (sum, pixel) in sums.iter_mut().zip(pixels) {
                            *sum += f64::from(pixel.counts());
                        }
                    }
                    start += sums.len();
                }
            }
        },
    );
}

/// Memory for the bias of one row of R.
#[derive(Debug, Default)]
pub(super) struct BiasRows {
    /// The bias of the last term that was asked for.
    pub(super) row: Vec<f64>,
    /// For two rows of R: the shared variance of their lines at every column of flipped T.
    shared: Vec<((i64, i64), Vec<f64>)>,
}

/// First column of flipped T that a row is worked out for, before the sensor's first.
const MARGIN: i64 = 8;

impl BiasRows {
    /// Puts the bias of TT at a term's sub-position into `row`; says whether there is one.
    pub(super) fn fill(&mut self, raw: &RawSums, layout: &Layout, samples: u64, term: &Term, y: i64) -> bool {
        let Some(noise) = &raw.registered.noise else { return false };
        let resampler = &raw.registered.resampler;
        // The mean of the products about their own mean lacks one part in the number of samples.
        let scale = (1.0 - 1.0 / samples as f64) / term.sets.len() as f64;
        self.row.clear();
        self.row.resize(layout.stride, 0.0);
        for set in &term.sets {
            let [a, b] = &set.elements[..] else { return false };
            if a.lag != b.lag {
                continue;
            }
            let rows = (y + i64::from(a.dy), y + i64::from(b.dy));
            let shared = self.shared(raw, noise, layout, samples, rows);
            add_shared(&mut self.row, &self.shared[shared].1, resampler, (a, b), (y, layout.width), scale);
        }
        true
    }

    /// Begins another row of R.
    pub(super) fn restart(&mut self) {
        self.shared.clear();
    }

    fn shared(
        &mut self,
        raw: &RawSums,
        noise: &PixelNoise,
        layout: &Layout,
        samples: u64,
        rows: (i64, i64),
    ) -> usize {
        if let Some(known) = self.shared.iter().position(|(of, _)| *of == rows) {
            return known;
        }
        let resampler = &raw.registered.resampler;
        let per_sample = 1.0 / samples as f64;
        let columns = -MARGIN..layout.width as i64 + MARGIN;
        let variances = columns.map(|j| {
            let ((first_a, a), (first_b, b)) = (resampler.down(rows.0, j), resampler.down(rows.1, j));
            let mut sum = 0.0;
            for (tap, weight) in a.iter().enumerate() {
                let row = first_a + tap as i64;
                let Some(other) = usize::try_from(row - first_b).ok().and_then(|tap| b.get(tap)) else {
                    continue;
                };
                let weight = weight * other;
                if weight == 0.0 {
                    continue;
                }
                let (row, column) = resampler.sensor(row, j);
                let band = layout.band_of(row);
                let place = (row - layout.rows(band).start) * layout.stride + column;
                let mean = raw.bands[band][place] * per_sample;
                sum += f64::from(weight) * noise.variance((row, column), mean);
            }
            sum
        });
        self.shared.push((rows, variances.collect()));
        self.shared.len() - 1
    }
}

/// Adds the bias of one pair to a row, from what the lines of its two rows share.
fn add_shared(
    bias: &mut [f64],
    shared: &[f64],
    resampler: &Resampler,
    (a, b): (&Element, &Element),
    (y, width): (i64, usize),
    scale: f64,
) {
    for (x, bias) in bias.iter_mut().enumerate().take(width) {
        let at =
            |element: &Element| resampler.across(y + i64::from(element.dy), x as i64 + i64::from(element.dx));
        let ((first_a, a), (first_b, b)) = (at(a), at(b));
        let mut sum = 0.0;
        for tap in 0..TAPS as i64 {
            let other = first_a + tap - first_b;
            if !(0..TAPS as i64).contains(&other) {
                continue;
            }
            let column = usize::try_from(first_a + tap + MARGIN).ok();
            let Some(shared) = column.and_then(|column| shared.get(column)) else { continue };
            sum += f64::from(a[tap as usize] * b[other as usize]) * shared;
        }
        *bias += scale * sum;
    }
}

/// Memory for one row of T on its way.
#[derive(Debug, Default)]
pub(super) struct Rows {
    taps: RowTaps,
    pub(super) values: Vec<f32>,
}

impl Rows {
    /// Makes ready for a row of R from a column on.
    #[inline(always)]
    pub(super) fn prepare(&mut self, resampler: &Resampler, y: usize, column: usize, columns: usize) {
        let registers = columns.div_ceil(REGISTER);
        self.values.resize(registers * REGISTER, 0.0);
        resampler.prepare(y as i64, column, registers, &mut self.taps);
    }

    /// The values of a frame of T.
    #[inline(always)]
    pub(super) fn fill<S: Simd, T: Count>(&mut self, simd: S, resampler: &Resampler, frame: &[T]) {
        resampler.row(simd, &mut self.taps, frame, T::counts, &mut self.values);
    }
}
