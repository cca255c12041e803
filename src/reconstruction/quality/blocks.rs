//! The central part of a camera, and the means of its blocks of pixels.

use std::ops::Range;

/// Side of the blocks whose traces are correlated between the cameras, camera pixels.
pub(super) const SIDE: usize = 8;

/// The middle of a side, at most this long.
pub(super) fn central(side: usize, longest: usize) -> Range<usize> {
    let length = side.min(longest);
    let start = (side - length) / 2;
    start..start + length
}

/// Means of blocks of pixels, row by row; those at the lower and right border may be smaller.
pub(super) fn block_means(plane: &[u16], width: usize) -> Vec<f64> {
    let across = width.div_ceil(SIDE);
    let mut means = Vec::with_capacity(across * plane.len().div_ceil(width * SIDE));
    for rows in plane.chunks(width * SIDE) {
        let mut sums = vec![0_u64; across];
        for row in rows.chunks(width) {
            for (sum, part) in sums.iter_mut().zip(row.chunks(SIDE)) {
                *sum += u64::from(part.iter().map(|&count| u32::from(count)).sum::<u32>());
            }
        }
        let height = rows.len() / width;
        let pixels = |block: usize| height * SIDE.min(width - block * SIDE);
        means.extend(sums.iter().enumerate().map(|(block, &sum)| sum as f64 / pixels(block) as f64));
    }
    means
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_central_part_lies_in_the_middle() {
        assert_eq!(central(2048, 256), 896..1152);
        assert_eq!(central(72, 256), 0..72);
    }

    #[test]
    fn blocks_at_the_border_are_means_too() {
        let plane: Vec<u16> = (0..90).map(|pixel| if pixel % 9 < 8 { 10 } else { 20 }).collect();
        assert_eq!(block_means(&plane, 9), [10.0, 20.0, 10.0, 20.0]);
    }
}
