//! Whether the cameras still lie where their registration says, told from the blinking sample.
//!
//! In: pixels of the central part of both cameras. Out: [`CameraDrift`], each from frames of its own.
//! Never: looks at more than the first exposures of a subsequence, takes a patch that is not clear of the noise.
//! Fails: never; `None` where too little blinks in both cameras.

use crate::sofi::registration::{Affine, Mirror, PatchCorrelation, PointPair, ReflectedFromTransmitted};
use serde::{Deserialize, Serialize};

/// Exposures of each subsequence that are looked at.
const EXPOSURES: usize = 32;

/// Patches along a side.
const PATCHES: usize = 5;

/// Exposures that are looked at together: so many that their mean is one, so few that nobody waits for them.
const BLOCK: usize = 8;

/// Fewest patches that tell a drift.
const LEAST_PATCHES: usize = 8;

/// Drifts up to here do no harm that the images would show, camera pixels.
pub const MOST_DRIFT_PX: f64 = 0.1;

/// How far the cameras lie from where their registration says.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize, Serialize)]
pub struct CameraDrift {
    /// What T shows lies so far from the same in R, rows and columns, pixels of R.
    pub shift_px: [f64; 2],
    /// One standard error of each.
    pub standard_error_px: [f64; 2],
    /// Patches of the central part that it is the median of.
    pub patches: usize,
}

impl CameraDrift {
    /// Length of the shift, pixels of R.
    #[must_use]
    pub fn distance_px(&self) -> f64 {
        self.shift_px[0].hypot(self.shift_px[1])
    }

    /// Whether the registration should be made anew: farther than [`MOST_DRIFT_PX`], and not by chance.
    #[must_use]
    pub fn is_too_far(&self) -> bool {
        let error = self.standard_error_px[0].hypot(self.standard_error_px[1]);
        self.distance_px() > MOST_DRIFT_PX && self.distance_px() > 4.0 * error
    }

    /// The median of what the patches say; none for too few.
    fn of(pairs: &[PointPair], registration: &Affine) -> Option<Self> {
        if pairs.len() < LEAST_PATCHES {
            return None;
        }
        let [rows, columns] = [0, 1].map(|axis| {
            let off = pairs.iter().map(|pair| registration.apply(pair.from)[axis] - pair.to[axis]);
            let mut off: Vec<f64> = off.collect();
            let middle = median(&mut off);
            let mut scatter: Vec<f64> = off.iter().map(|off| (off - middle).abs()).collect();
            // In a small field patches overlap by half on each side; half of them are taken as independent.
            let independent = pairs.len() as f64 / 2.0;
            (middle, 1.2533 * 1.4826 * median(&mut scatter) / independent.sqrt())
        });
        Some(Self {
            shift_px: [rows.0, columns.0],
            standard_error_px: [rows.1, columns.1],
            patches: pairs.len(),
        })
    }
}

/// Follows the place of T against R.
#[derive(Debug)]
pub(super) struct DriftWatch {
    map: ReflectedFromTransmitted,
    patches: PatchCorrelation,
    /// Exposures on their way, camera by camera.
    waiting: [Vec<u16>; 2],
    /// Exposures of this subsequence that were taken.
    taken: usize,
    newest: Option<CameraDrift>,
}

impl DriftWatch {
    /// For parts of a registration, or of this size where cameras come aligned.
    pub(super) fn new(registration: Option<ReflectedFromTransmitted>, size: [usize; 2]) -> Self {
        let aligned = ReflectedFromTransmitted { mirror: Mirror::None, affine: Affine::IDENTITY, size };
        let map = registration.unwrap_or(aligned);
        let patches = PatchCorrelation::with_patches(map, PATCHES);
        Self { map, patches, waiting: [Vec::new(), Vec::new()], taken: 0, newest: None }
    }

    /// Looks at the parts of an exposure, unless enough of its subsequence were seen.
    pub(super) fn push(&mut self, [reflected, transmitted]: [&[u16]; 2]) {
        if self.taken == EXPOSURES {
            return;
        }
        self.taken += 1;
        self.waiting[0].extend_from_slice(reflected);
        self.waiting[1].extend_from_slice(transmitted);
        if self.taken.is_multiple_of(BLOCK) {
            let pixels = self.map.size[0] * self.map.size[1];
            let [r, t] =
                self.waiting.each_ref().map(|waiting| waiting.chunks_exact(pixels).collect::<Vec<_>>());
            self.patches.push(&r, &t);
            self.waiting.iter_mut().for_each(Vec::clear);
        }
    }

    /// Ends a subsequence. Once enough patches are clear they tell a drift, and the next one begins anew.
    pub(super) fn close(&mut self) {
        self.taken = 0;
        self.waiting.iter_mut().for_each(Vec::clear);
        if let Some(drift) = CameraDrift::of(&self.patches.pairs(), &self.map.affine) {
            if drift.is_too_far() && !self.newest.is_some_and(|before| before.is_too_far()) {
                let [rows, columns] = drift.shift_px;
                tracing::warn!(
                    rows_px = rows,
                    columns_px = columns,
                    "the cameras do not lie where their registration says; calibrate them anew"
                );
            }
            self.newest = Some(drift);
            self.patches = PatchCorrelation::with_patches(self.map, PATCHES);
        }
    }

    /// The newest drift that was told.
    pub(super) fn newest(&self) -> Option<CameraDrift> {
        self.newest
    }
}

fn median(values: &mut [f64]) -> f64 {
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pairs(off: impl Fn(usize) -> f64) -> Vec<PointPair> {
        let pair = |k: usize| {
            let from = [10.0 * k as f64, 7.0];
            PointPair { from, to: [from[0] + 2.0 - off(k), 7.0], weight: 1.0 }
        };
        (0..20).map(pair).collect()
    }

    #[test]
    fn a_drift_is_told_from_scatter() {
        let registration = Affine { shift: [2.0, 0.0], ..Affine::IDENTITY };
        let scatter = |k: usize| 0.2 * ((k * 7 % 20) as f64 / 19.0 - 0.5);
        let of = |off: f64| CameraDrift::of(&pairs(|k| off + scatter(k)), &registration).unwrap();
        let (still, moved) = (of(0.0), of(0.4));
        assert!(!still.is_too_far(), "{still:?}");
        assert!(moved.is_too_far() && (moved.shift_px[0] - 0.4).abs() < 0.03, "{moved:?}");
        assert!((moved.standard_error_px[0] - 0.03).abs() < 0.02, "{moved:?}");
        assert_eq!(CameraDrift::of(&pairs(scatter)[..LEAST_PATCHES - 1], &registration), None);
    }

    #[test]
    fn large_scatter_is_no_drift() {
        let scatter = |k: usize| 0.15 + 4.0 * ((k * 7 % 20) as f64 / 19.0 - 0.5);
        let drift =
            CameraDrift::of(&pairs(scatter), &Affine { shift: [2.0, 0.0], ..Affine::IDENTITY }).unwrap();
        assert!(!drift.is_too_far(), "{drift:?}");
    }
}
