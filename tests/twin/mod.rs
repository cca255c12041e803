//! A slow and obvious cumulant engine: two passes over all frames in `f64`, joint cumulants from set partitions.

use ndarray::Array2;
use sofiscope::sofi::cumulant::CumulantSettings;
use sofiscope::sofi::grid::{Offset, VirtualPixelGrid};

/// One recorded exposure: its index and one image per channel, row-major.
pub(crate) type Recorded = (u64, Vec<Vec<f64>>);

/// A set of pixels with one lag each.
struct Tuple {
    pixels: Vec<Offset>,
    lags: Vec<u64>,
}

/// Fine-grid images per spectral channel, NaN where a tuple leaves the sensor; subsequences as the engine has them.
pub(crate) fn cumulants(
    settings: &CumulantSettings,
    height: usize,
    width: usize,
    frames: &[Recorded],
) -> Vec<Array2<f64>> {
    let grid = VirtualPixelGrid::new(settings.order, settings.combinations).unwrap();
    let n = settings.order;
    let spectral = spectral_channels(settings.channels, n);
    let mut sums = vec![Array2::zeros((n * height, n * width)); spectral.len()];
    let mut weight = 0.0;
    for run in frames.chunk_by(|a, b| a.0 / settings.subsequence == b.0 / settings.subsequence) {
        let span = settings.lags.iter().max().copied().unwrap_or(0)
            - settings.lags.iter().min().copied().unwrap_or(0);
        let samples = samples(run, &settings.lags, n);
        if (samples.len() as u64 + span) * 2 < settings.subsequence || samples.len() < 2 {
            continue;
        }
        weight += samples.len() as f64;
        for sub_grid in grid.sub_grids() {
            for (u, shares) in spectral.iter().enumerate() {
                for y in 0..height {
                    for x in 0..width {
                        let mut values = Vec::new();
                        for set in &sub_grid.sets {
                            let tuple = Tuple { pixels: set.clone(), lags: settings.lags.clone() };
                            for share in shares {
                                values.push(joint(run, &samples, &tuple, share, (y, x), (height, width)));
                            }
                        }
                        let mean = values.iter().sum::<f64>() / values.len() as f64;
                        let place = [n * y + sub_grid.p, n * x + sub_grid.q];
                        sums[u][place] += mean * samples.len() as f64;
                    }
                }
            }
        }
    }
    sums.into_iter().map(|sum| sum / weight).collect()
}

/// For each multiset of channels, all ways to give them to the pixels; with two channels u of T counts up.
fn spectral_channels(channels: usize, n: usize) -> Vec<Vec<Vec<usize>>> {
    let mut all: Vec<(Vec<usize>, Vec<Vec<usize>>)> = Vec::new();
    for number in 0..channels.pow(n as u32) {
        let share: Vec<usize> = (0..n).map(|pixel| number / channels.pow(pixel as u32) % channels).collect();
        let mut sorted = share.clone();
        sorted.sort_unstable();
        match all.iter_mut().find(|(key, _)| *key == sorted) {
            Some((_, shares)) => shares.push(share),
            None => all.push((sorted, vec![share])),
        }
    }
    all.sort();
    all.into_iter().map(|(_, shares)| shares).collect()
}

/// Index, within the run, of the exposure that each pixel of the tuple takes, for every sample.
fn samples(run: &[Recorded], lags: &[u64], n: usize) -> Vec<Vec<usize>> {
    let lags = if lags.is_empty() { vec![0; n] } else { lags.to_vec() };
    let (first, last) = (lags.iter().min().copied().unwrap_or(0), lags.iter().max().copied().unwrap_or(0));
    let find = |index: u64| run.iter().position(|(exposure, _)| *exposure == index);
    run.iter()
        .filter(|(start, _)| (0..=last - first).all(|lag| find(start + lag).is_some()))
        .map(|(start, _)| lags.iter().map(|lag| find(start + lag - first).unwrap()).collect())
        .collect()
}

fn joint(
    run: &[Recorded],
    samples: &[Vec<usize>],
    tuple: &Tuple,
    share: &[usize],
    (y, x): (usize, usize),
    (height, width): (usize, usize),
) -> f64 {
    let _ = &tuple.lags;
    let mut series: Vec<Vec<f64>> = Vec::new();
    for (pixel, offset) in tuple.pixels.iter().enumerate() {
        let (py, px) = (y as i64 + i64::from(offset.dy), x as i64 + i64::from(offset.dx));
        if py < 0 || px < 0 || py >= height as i64 || px >= width as i64 {
            return f64::NAN;
        }
        let place = py as usize * width + px as usize;
        series.push(samples.iter().map(|frames| run[frames[pixel]].1[share[pixel]][place]).collect());
    }
    joint_cumulant(&mut series)
}

/// The joint cumulant of equally long series by the partition formula, after centering (population moments).
pub(crate) fn joint_cumulant(series: &mut [Vec<f64>]) -> f64 {
    for values in series.iter_mut() {
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        values.iter_mut().for_each(|value| *value -= mean);
    }
    let mut total = 0.0;
    for partition in partitions(series.len()) {
        if partition.iter().any(|block| block.len() == 1) {
            continue; // a centered variable alone has mean zero
        }
        let blocks = partition.len();
        let sign = if blocks % 2 == 1 { 1.0 } else { -1.0 };
        let factorial: f64 = (1..blocks).map(|k| k as f64).product();
        let product: f64 = partition.iter().map(|block| mean_product(series, block)).product();
        total += sign * factorial * product;
    }
    total
}

fn mean_product(series: &[Vec<f64>], block: &[usize]) -> f64 {
    let frames = series[0].len();
    let product = |frame: usize| block.iter().map(|&variable| series[variable][frame]).product::<f64>();
    (0..frames).map(product).sum::<f64>() / frames as f64
}

/// All partitions of `0..n` into blocks.
fn partitions(n: usize) -> Vec<Vec<Vec<usize>>> {
    if n == 0 {
        return vec![vec![]];
    }
    let mut all = Vec::new();
    for smaller in partitions(n - 1) {
        for block in 0..=smaller.len() {
            let mut partition = smaller.clone();
            if block == smaller.len() {
                partition.push(vec![n - 1]);
            } else {
                partition[block].push(n - 1);
            }
            all.push(partition);
        }
    }
    all
}
