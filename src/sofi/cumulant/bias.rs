//! The noise that values between pixels share, and what it adds to the cumulants of camera T.
//!
//! A value between pixels of T is made from raw pixels, so neighbors share the noise of these, and their joint cumulant
//! is not zero even where nothing blinks: `bias(p, q, ...) = sum over raw pixels a of w_p(a) w_q(a) ... kappa_n(a)`,
//! with the cumulant of order n of the noise of pixel a. For shot noise in a gain of `g` counts per electron that is
//! `g^(n - 2)` times its variance, which is linear in the mean image of T, summed beside the products.
//!
//! In: sums of raw pixels, the resampler, the noise of T. Out: the bias of a term, by rows.
//! Never: looks at other than pure T, as the noise of R is not shared. Where emitters blink, orders 3 and 4 keep products of
//! lower cumulants with shared noise.

use super::kernel::dispatch;
use super::layout::Layout;
use super::plan::{Element, Term};
use super::registered::RawSums;
use crate::sofi::camera::CameraMaps;
use crate::sofi::registration::{NoiseLine, PADDED_TAPS, Resampler, TAPS};
use pulp::{Simd, WithSimd};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Highest order whose bias is known.
pub(super) const HIGHEST_ORDER: usize = 4;

/// Columns that a row is worked out for beyond the sensor on either side.
const MARGIN: i64 = 2 * TAPS as i64;

/// Rows of R around the one that is worked on whose places are kept.
const NEAR: i64 = 8;

/// Raw rows whose noise is kept.
const MOST_NOISE_ROWS: usize = 160;

/// The noise of T's pixels.
#[derive(Debug, Clone)]
pub(super) enum PixelNoise {
    /// The same law for all of them.
    Line(NoiseLine),
    /// Each its own.
    Maps(Arc<CameraMaps>),
}

impl PixelNoise {
    /// The cumulant of an order of the noise of a pixel of the sensor with this mean.
    #[inline(always)]
    fn cumulant(&self, order: usize, place: (usize, usize), mean: f64) -> f64 {
        match (self, order) {
            (Self::Line(line), _) => line.slope.powi(order as i32 - 2) * line.variance(mean),
            (Self::Maps(maps), 2) => maps.noise_variance(place, mean),
            (Self::Maps(maps), _) => {
                let gain = f64::from(maps.gain()[place]);
                gain.powi(order as i32 - 1) * (mean - f64::from(maps.offset()[place])).max(0.0)
            }
        }
    }
}

/// First pixel and phase of the weights, column by column from `-MARGIN` on.
type Places = Vec<(i32, u32)>;

/// Memory for the bias of one row of R.
#[derive(Debug, Default)]
pub(super) struct BiasRows {
    /// The bias of the last term that was asked for.
    pub(super) row: Vec<f64>,
    across: BTreeMap<i64, Places>,
    down: BTreeMap<i64, Places>,
    /// Cumulants of the noise in a row of flipped T, by order.
    noise: BTreeMap<(usize, i64), Vec<f32>>,
    /// What the lines of some rows of R share, at every column of flipped T.
    shared: BTreeMap<Vec<i64>, Vec<f32>>,
    /// What sets of pixels of this row share, on its way.
    parts: Vec<Vec<f64>>,
}

/// What does not change from row to row.
#[derive(Clone, Copy)]
struct Camera<'a> {
    raw: &'a RawSums,
    noise: &'a PixelNoise,
    layout: &'a Layout,
    samples: u64,
}

impl Camera<'_> {
    fn resampler(&self) -> &Resampler {
        &self.raw.registered.resampler
    }
}

impl BiasRows {
    /// Begins another row of R.
    pub(super) fn restart(&mut self, y: i64) {
        self.shared.clear();
        let is_near = |row: &i64| (row - y).abs() <= NEAR;
        self.across.retain(|row, _| is_near(row));
        self.down.retain(|row, _| is_near(row));
        if self.noise.len() > MOST_NOISE_ROWS {
            self.noise.clear();
        }
    }

    /// Puts the bias of pure T at a term's sub-position into `row`; says whether there is one.
    ///
    /// The estimators of `samples` samples miss a part of the cumulants: `1 - 1/N` of order 2 is left of them,
    /// `(1 - 1/N)(1 - 2/N)` of order 3, `(N - 1)(N^2 - 6N + 6)/N^3` of order 4, which also has
    /// `-2 (N - 1)/N^2` times every product of the cumulants of two pairs.
    pub(super) fn fill(&mut self, raw: &RawSums, layout: &Layout, samples: u64, term: &Term, y: i64) -> bool {
        let Some(noise) = &raw.registered.noise else { return false };
        let camera = Camera { raw, noise, layout, samples };
        let (n, sets) = (samples as f64, term.sets.len() as f64);
        let mut row = std::mem::take(&mut self.row);
        row.clear();
        row.resize(layout.stride, 0.0);
        for set in &term.sets {
            let all = &set.elements[..];
            let (left, of_pairs) = match all.len() {
                2 => (1.0 - 1.0 / n, 0.0),
                3 => ((1.0 - 1.0 / n) * (1.0 - 2.0 / n), 0.0),
                4 => ((n - 1.0) * (n * n - 6.0 * n + 6.0) / n.powi(3), -2.0 * (n - 1.0) / (n * n)),
                _ => return false,
            };
            if self.part(camera, all, y, 0) {
                add(&mut row, left / sets, &self.parts[..1]);
            }
            if let (&[a, b, c, d], true) = (all, of_pairs != 0.0) {
                for [first, second] in [[[a, b], [c, d]], [[a, c], [b, d]], [[a, d], [b, c]]] {
                    if self.part(camera, &first, y, 0) && self.part(camera, &second, y, 1) {
                        add(&mut row, of_pairs / sets, &self.parts[..2]);
                    }
                }
            }
        }
        self.row = row;
        true
    }

    /// Puts what some pixels share into a part; false where it is nothing.
    fn part(&mut self, camera: Camera<'_>, elements: &[Element], y: i64, part: usize) -> bool {
        if elements.iter().any(|element| element.lag != elements[0].lag) {
            return false;
        }
        let rows: Vec<i64> = elements.iter().map(|element| y + i64::from(element.dy)).collect();
        self.share(camera, &rows);
        for &row in &rows {
            self.across.entry(row).or_insert_with(|| {
                let columns = -MARGIN..camera.layout.width as i64 + MARGIN;
                columns.map(|x| place(camera.resampler().across_place(row, x))).collect()
            });
        }
        let width = camera.layout.width;
        let places: Vec<&[(i32, u32)]> = rows
            .iter()
            .zip(elements)
            .map(|(row, element)| &self.across[row][(MARGIN + i64::from(element.dx)) as usize..][..width])
            .collect();
        let shared = &self.shared[&rows];
        self.parts.resize_with(self.parts.len().max(part + 1), Vec::new);
        let values = &mut self.parts[part];
        values.clear();
        values.resize(camera.layout.stride, 0.0);
        let weights = |phase: usize| camera.resampler().across_weights(phase);
        dispatch(AlongRow { places: &places, weights, shared, values: &mut values[..width] });
        true
    }

    /// Works out what the lines of some rows of R share at every column of flipped T.
    fn share(&mut self, camera: Camera<'_>, rows: &[i64]) {
        if self.shared.contains_key(rows) {
            return;
        }
        let columns = -MARGIN..camera.layout.width as i64 + MARGIN;
        for &row in rows {
            self.down.entry(row).or_insert_with(|| {
                columns.clone().map(|j| place(camera.resampler().down_place(row, j))).collect()
            });
        }
        let places: Vec<&[(i32, u32)]> = rows.iter().map(|row| &self.down[row][..]).collect();
        let mut shared = vec![0.0; places[0].len()];
        let mut start = 0;
        for run in places[0].chunk_by(|a, b| a.0 == b.0) {
            let first = i64::from(run[0].0);
            for row in first..first + TAPS as i64 {
                let noise = || noise_row(camera, rows.len(), row, columns.clone());
                self.noise.entry((rows.len(), row)).or_insert_with(noise);
            }
            let noise: [&[f32]; TAPS] =
                std::array::from_fn(|tap| &self.noise[&(rows.len(), first + tap as i64)][start..]);
            let weights = |phase: usize| camera.resampler().down_weights(phase);
            let values = &mut shared[start..start + run.len()];
            dispatch(DownLines { places: &places, start, weights, noise, values });
            start += run.len();
        }
        self.shared.insert(rows.to_vec(), shared);
    }
}

/// What pixels of a row of R share, from what their lines share.
struct AlongRow<'a, 'b, F> {
    places: &'a [&'b [(i32, u32)]],
    weights: F,
    shared: &'a [f32],
    values: &'a mut [f64],
}

impl<'w, F: Fn(usize) -> &'w [f32; PADDED_TAPS]> WithSimd for AlongRow<'_, '_, F> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        for (x, value) in self.values.iter_mut().enumerate() {
            let first = i64::from(self.places[0][x].0);
            let weights = product(self.places, x, &self.weights);
            let shared = usize::try_from(first + MARGIN).ok().and_then(|start| self.shared.get(start..));
            // Pixels of R whose partners are beyond the sensor are masked.
            let Some(shared) = shared.and_then(|shared| shared.first_chunk::<TAPS>()) else { continue };
            *value = f64::from(total(std::array::from_fn(|tap| weights[tap] * shared[tap])));
        }
    }
}

/// What lines share at some columns of flipped T, from the noise of the pixels.
struct DownLines<'a, 'b, F> {
    places: &'a [&'b [(i32, u32)]],
    start: usize,
    weights: F,
    noise: [&'a [f32]; TAPS],
    values: &'a mut [f32],
}

impl<'w, F: Fn(usize) -> &'w [f32; PADDED_TAPS]> WithSimd for DownLines<'_, '_, F> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        for (index, value) in self.values.iter_mut().enumerate() {
            let weights = product(self.places, self.start + index, &self.weights);
            *value = total(std::array::from_fn(|tap| weights[tap] * self.noise[tap][index]));
        }
    }
}

/// The sum, halves added to each other, as one after another they would wait for each other.
#[inline(always)]
fn total(values: [f32; TAPS]) -> f32 {
    let four: [f32; 4] = std::array::from_fn(|i| values[i] + values[i + 4]);
    (four[0] + four[2]) + (four[1] + four[3])
}

/// Adds `scale` times the product of parts to a row.
fn add(row: &mut [f64], scale: f64, parts: &[Vec<f64>]) {
    for (x, value) in row.iter_mut().enumerate() {
        *value += scale * parts.iter().map(|part| part[x]).product::<f64>();
    }
}

fn place((first, phase): (i64, usize)) -> (i32, u32) {
    (first as i32, phase as u32)
}

/// Products of the weights of all values, at the pixels of the first one.
#[inline(always)]
fn product<'a>(
    places: &[&[(i32, u32)]],
    index: usize,
    weights: impl Fn(usize) -> &'a [f32; PADDED_TAPS],
) -> [f32; TAPS] {
    let (first, phase) = places[0][index];
    let mut product: [f32; TAPS] = *weights(phase as usize)[TAPS..].first_chunk().unwrap_or(&[0.0; TAPS]);
    for other in &places[1..] {
        let (other_first, phase) = other[index];
        let start = TAPS as i32 + first - other_first;
        let start = if (0..=2 * TAPS as i32).contains(&start) { start as usize } else { 0 };
        let weights = weights(phase as usize)[start..].first_chunk().unwrap_or(&[0.0; TAPS]);
        product = std::array::from_fn(|tap| product[tap] * weights[tap]);
    }
    product
}

/// Cumulants of an order of the noise in a row of flipped T, that of the nearest pixel outside the sensor.
fn noise_row(camera: Camera<'_>, order: usize, row: i64, columns: std::ops::Range<i64>) -> Vec<f32> {
    let Camera { raw, noise, layout, samples } = camera;
    let per_sample = 1.0 / samples as f64;
    columns
        .map(|j| {
            let (row, column) = camera.resampler().sensor(row, j);
            let band = layout.band_of(row);
            let place = (row - layout.rows(band).start) * layout.stride + column;
            noise.cumulant(order, (row, column), raw.bands[band][place] * per_sample) as f32
        })
        .collect()
}
