//! The registration by what blinks together, coarse to fine.
//!
//! In: frames of both cameras. Out: where camera R sees what camera T sees. Never: keeps more than a block of frames.
//! Fails: [`AppError`] where nothing blinks together.

use super::frames::Frames;
use crate::app::AppError;
use crate::sofi::registration::{
    BeadMatch, CoarseCorrelation, PatchCorrelation, ReflectedFromTransmitted, root_mean_square, shifted,
    without_outliers,
};

/// Frames that are correlated as a block, less their mean.
const BLOCK: usize = 16;
/// Blocks that the coarse correlation looks at.
const COARSE_BLOCKS: usize = 12;
/// Longest side of frames that are correlated as a whole; larger ones are averaged in squares first.
const COARSE_SIDE: usize = 256;
/// Rounds of finer correlation, each around the map of the one before.
const ROUNDS: usize = 3;
/// Blocks of frames of both cameras, as long as there are any.
fn blocks<F: Frames>(
    stacks: &mut [F],
    mut work: impl FnMut(&[&[u16]], &[&[u16]]) -> bool,
) -> Result<(), AppError> {
    let pixels = stacks[0].size().iter().product();
    let mut memory = vec![vec![vec![0u16; pixels]; BLOCK]; 2];
    stacks.iter_mut().try_for_each(Frames::rewind)?;
    loop {
        let mut read = 0;
        for frame in 0..BLOCK {
            let mut both = true;
            for (stack, frames) in stacks.iter_mut().zip(&mut memory) {
                both &= stack.read_counts(&mut frames[frame])?;
            }
            if !both {
                break;
            }
            read += 1;
        }
        if read < 2 {
            return Ok(());
        }
        let [r, t] =
            [0, 1].map(|camera: usize| memory[camera][..read].iter().map(Vec::as_slice).collect::<Vec<_>>());
        if !work(&r, &t) {
            return Ok(());
        }
    }
}

/// The registration by what blinks together.
pub(super) fn correlated<F: Frames>(stacks: &mut [F]) -> Result<BeadMatch, AppError> {
    let nothing = || {
        AppError::data(
            "nothing fluctuates together in both cameras; record a blinking sample that both cameras see, \
             with more frames or more light, or use --method beads",
        )
    };
    let size = stacks[0].size();
    let square = size[0].max(size[1]).div_ceil(COARSE_SIDE);
    let small = size.map(|side| side / square);
    let mut coarse = CoarseCorrelation::new(small);
    let mut seen = 0;
    blocks(stacks, |r, t| {
        let [r, t] = [r, t].map(|frames| fluctuations(frames, size, square));
        r.iter().zip(&t).for_each(|(r, t)| coarse.push(r, t));
        seen += 1;
        seen < COARSE_BLOCKS
    })?;
    let (mirror, shift) = coarse.best().ok_or_else(nothing)?;
    // Squares of flipped T do not begin where T does, if its side is no multiple.
    let flips = mirror.flips();
    let shift = std::array::from_fn(|axis| {
        let left_over = (size[axis] - small[axis] * square) as f64;
        shift[axis] * square as f64 + if flips[axis] { left_over } else { 0.0 }
    });
    let mut transform = shifted(mirror, shift, size);
    let mut last = None;
    for _ in 0..ROUNDS {
        let mut patches = PatchCorrelation::new(transform);
        blocks(stacks, |r, t| {
            patches.push(r, t);
            true
        })?;
        let pairs = patches.pairs();
        let (affine, inliers) = without_outliers(&pairs).ok_or_else(nothing)?;
        transform = ReflectedFromTransmitted { affine, ..transform };
        last = Some((pairs.len() - inliers.len(), inliers));
    }
    let (outliers, pairs) = last.ok_or_else(nothing)?;
    Ok(BeadMatch { transform, outliers, residual_px: root_mean_square(&transform.affine, &pairs), pairs })
}

/// Frames with squares of pixels averaged, less their mean.
fn fluctuations(frames: &[&[u16]], [height, width]: [usize; 2], square: usize) -> Vec<Vec<f32>> {
    let (rows, columns) = (height / square, width / square);
    let mut all: Vec<Vec<f32>> = frames
        .iter()
        .map(|frame| {
            let mut averaged = vec![0.0; rows * columns];
            for y in 0..rows * square {
                for x in 0..columns * square {
                    averaged[y / square * columns + x / square] += f32::from(frame[y * width + x]);
                }
            }
            averaged
        })
        .collect();
    for pixel in 0..rows * columns {
        let mean = all.iter().map(|frame| frame[pixel]).sum::<f32>() / all.len() as f32;
        all.iter_mut().for_each(|frame| frame[pixel] -= mean);
    }
    all
}
