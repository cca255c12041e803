//! Blocks of exposures into the engine: the next block is read while this one is summed.

use super::AllCores;
use crate::sofi::cumulant::{Count, CumulantEngine, CumulantSettings, Exposure, PushError, RunSummary};
use ndarray::Array2;

/// Exposures per block: few enough for memory, many enough that sums are seldom moved.
pub const BLOCK: usize = 32;

/// Why feeding ended early.
#[derive(Debug, thiserror::Error)]
pub enum FeedError<E> {
    /// The source failed.
    #[error(transparent)]
    Source(E),
    /// The engine refused a block.
    #[error(transparent)]
    Push(#[from] PushError),
}

/// What came out of a feed beside the engine's state.
#[derive(Debug, Clone, Default)]
pub struct Feed {
    /// Exposures fed.
    pub exposures: u64,
    /// Subsequences that closed.
    pub closed: Vec<RunSummary>,
    /// Exposure index and mean counts per channel, for at most a few hundred exposures evenly spread.
    pub trace: Vec<(u64, Vec<f64>)>,
}

/// Feeds an engine from a source until it ends.
///
/// `read(first, block)` fills one buffer per channel with up to [`BLOCK`] frames, one after another,
/// and says how many; fewer than [`BLOCK`] ends the feed. `progress` is told how many were fed.
///
/// # Errors
/// [`FeedError`]: what the source or the engine says.
pub fn feed<T: Count + Default, E: Send>(
    engine: &mut CumulantEngine<T>,
    pixels: usize,
    trace_every: u64,
    mut read: impl FnMut(u64, &mut [Vec<T>]) -> Result<usize, E> + Send,
    mut progress: impl FnMut(u64) + Send,
) -> Result<Feed, FeedError<E>> {
    let channels = engine.settings().channels;
    let masks = raw_masks(engine.settings());
    let buffer = || vec![vec![T::default(); BLOCK * pixels]; channels];
    let (mut now, mut next) = (buffer(), buffer());
    let mut result = Feed::default();
    let mut frames = read(0, &mut now).map_err(FeedError::Source)?;
    while frames > 0 {
        let first = result.exposures;
        let following = first + frames as u64;
        let (pushed, read_next) = rayon::join(
            || push(engine, first, frames, pixels, &now),
            || if frames == BLOCK { read(following, &mut next) } else { Ok(0) },
        );
        result.closed.extend(pushed?);
        trace(&mut result.trace, first, frames, pixels, trace_every, &now, &masks);
        result.exposures = following;
        progress(frames as u64);
        frames = read_next.map_err(FeedError::Source)?;
        std::mem::swap(&mut now, &mut next);
    }
    Ok(result)
}

fn push<T: Count>(
    engine: &mut CumulantEngine<T>,
    first: u64,
    frames: usize,
    pixels: usize,
    buffers: &[Vec<T>],
) -> Result<Vec<RunSummary>, PushError> {
    let frame = |buffer: &'_ Vec<T>, frame: usize| -> std::ops::Range<usize> {
        debug_assert!(buffer.len() >= (frame + 1) * pixels);
        frame * pixels..(frame + 1) * pixels
    };
    let planes: Vec<Vec<&[T]>> = (0..frames)
        .map(|index| buffers.iter().map(|buffer| &buffer[frame(buffer, index)]).collect())
        .collect();
    let exposures: Vec<Exposure<'_, T>> = planes
        .iter()
        .enumerate()
        .map(|(offset, planes)| Exposure { index: first + offset as u64, planes })
        .collect();
    engine.push(&AllCores, &exposures)
}

fn trace<T: Count>(
    trace: &mut Vec<(u64, Vec<f64>)>,
    first: u64,
    frames: usize,
    pixels: usize,
    every: u64,
    buffers: &[Vec<T>],
    masks: &[Option<Array2<bool>>],
) {
    for offset in 0..frames {
        let index = first + offset as u64;
        if index.is_multiple_of(every.max(1)) {
            let mean = |(buffer, mask): (&Vec<T>, &Option<Array2<bool>>)| {
                mean_counts(&buffer[offset * pixels..(offset + 1) * pixels], mask.as_ref())
            };
            trace.push((index, buffers.iter().zip(masks).map(mean).collect()));
        }
    }
}

/// The pixels of each camera, as it gives them, that are left out.
pub(super) fn raw_masks(settings: &CumulantSettings) -> Vec<Option<Array2<bool>>> {
    (0..settings.channels).map(|channel| settings.camera(channel)?.mask()).collect()
}

/// Mean of the pixels of a frame that are not left out, counts.
pub(super) fn mean_counts<T: Count>(frame: &[T], mask: Option<&Array2<bool>>) -> f64 {
    let Some(mask) = mask else { return sum(frame) / frame.len() as f64 };
    let good = frame.iter().zip(mask).filter(|(_, masked)| !**masked);
    let (sum, number) =
        good.fold((0.0, 0u64), |(sum, number), (count, _)| (sum + f64::from(count.counts()), number + 1));
    sum / number.max(1) as f64
}

/// Sum of all pixels, exact for counts of 16 bits.
fn sum<T: Count>(frame: &[T]) -> f64 {
    // A lane holds the sum of 256 such counts exactly.
    const LANES: usize = 16;
    pulp::Arch::new().dispatch(
        #[inline(always)]
        || {
            let mut total = 0.0;
            for pixels in frame.chunks(256 * LANES) {
                let (registers, rest) = pixels.as_chunks::<LANES>();
                let mut lanes = [0.0_f32; LANES];
                for register in registers {
                    for (lane, pixel) in lanes.iter_mut().zip(register) {
                        *lane += pixel.counts();
                    }
                }
                let rest = rest.iter().map(|pixel| pixel.counts());
                total += lanes.into_iter().chain(rest).map(f64::from).sum::<f64>();
            }
            total
        },
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn means_of_counts_are_exact() {
        for pixels in [1, 15, 16, 4095, 4096, 4097, 100_003] {
            let frame: Vec<u16> =
                (0..pixels as u32).map(|i| u16::MAX - (i.wrapping_mul(40_503) >> 22) as u16).collect();
            let wanted = frame.iter().map(|&count| u64::from(count)).sum::<u64>() as f64 / pixels as f64;
            assert_eq!(mean_counts(&frame, None), wanted);
            let mask = Array2::from_shape_fn((1, pixels), |(_, x)| x % 3 == 1);
            let good =
                frame.iter().enumerate().filter(|(x, _)| x % 3 != 1).map(|(_, &count)| f64::from(count));
            let wanted = good.clone().sum::<f64>() / good.count().max(1) as f64;
            assert_eq!(mean_counts(&frame, Some(&mask)), wanted);
        }
    }
}
