//! What a person looks at while frames come: the newest frames of both cameras, and the images of every step.
//!
//! In: frame pairs and drawings. Out: [`CameraLook`], [`SofiLook`], each whole in itself.
//! Never: keeps memory of the frame pool, judges saturation on anything but raw counts. Fails: not at all.

use crate::acquisition::FramePair;
use crate::sofi::registration::ReflectedFromTransmitted;
use ndarray::Array2;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Most bins of a histogram.
pub const HISTOGRAM_BINS: usize = 1024;

/// Both cameras at one exposure.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraLook {
    /// Exposure since the cameras were armed.
    pub exposure: u64,
    /// Columns of a frame.
    pub width: usize,
    /// Rows of a frame.
    pub height: usize,
    /// R and T.
    pub cameras: [OneCamera; 2],
    /// Side of a camera pixel in the sample, nanometers.
    pub pixel_pitch_nm: f64,
    /// Where camera T sees what camera R sees; none for cameras that come aligned.
    pub transmitted_from_reflected: Option<PixelMap>,
}

/// From pixels of one camera to those of the other: `q = matrix * p + shift`, all `[y, x]`, whole numbers in the
/// middle of pixels.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize, Serialize)]
pub struct PixelMap {
    /// Rows for y and x, columns for y and x.
    pub matrix: [[f64; 2]; 2],
    /// Pixels.
    pub shift: [f64; 2],
}

impl PixelMap {
    /// The way of a registration from R to T; none for a map that cannot be undone.
    #[must_use]
    pub fn undoing(registration: &ReflectedFromTransmitted) -> Option<Self> {
        let way = registration.affine.inverse()?;
        let mut map = Self { matrix: way.matrix, shift: way.shift };
        for (axis, is_flipped) in registration.mirror.flips().into_iter().enumerate() {
            if is_flipped {
                map.matrix[axis] = map.matrix[axis].map(|entry| -entry);
                map.shift[axis] = registration.size[axis] as f64 - 1.0 - map.shift[axis];
            }
        }
        Some(map)
    }

    /// Where the other camera sees a point.
    #[must_use]
    pub fn apply(&self, point: [f64; 2]) -> [f64; 2] {
        std::array::from_fn(|axis| {
            let [to_y, to_x] = self.matrix[axis];
            to_y * point[0] + to_x * point[1] + self.shift[axis]
        })
    }
}

/// One camera at one exposure.
#[derive(Debug, Clone, PartialEq)]
pub struct OneCamera {
    /// Raw counts, row by row.
    pub counts: Arc<Vec<u16>>,
    /// How many pixels have counts in each of at most [`HISTOGRAM_BINS`] equal ranges from 0 on.
    pub histogram: Arc<Vec<u32>>,
    /// Counts in each of these ranges: the smallest power of two with which the brightest pixel is in one of them.
    pub bin_counts: u32,
    /// Pixels at or above the saturation of the camera.
    pub saturated: u64,
    /// Lowest, mean and highest counts.
    pub range: (u16, f64, u16),
    /// Counts from which on a pixel is saturated.
    pub saturation_counts: u16,
}

impl OneCamera {
    /// Takes the numbers of a frame; `counts` are copied, so that the frame is free again.
    #[must_use]
    pub fn of(counts: &[u16], saturation_counts: u16) -> Self {
        let brightest = usize::from(counts.iter().copied().max().unwrap_or(0));
        let bin_counts = (brightest / HISTOGRAM_BINS + 1).next_power_of_two();
        let mut histogram = vec![0_u32; brightest / bin_counts + 1];
        let (mut lowest, mut highest, mut sum, mut saturated) = (u16::MAX, 0, 0_u64, 0_u64);
        for &count in counts {
            histogram[usize::from(count) / bin_counts] += 1;
            lowest = lowest.min(count);
            highest = highest.max(count);
            sum += u64::from(count);
            saturated += u64::from(count >= saturation_counts);
        }
        let mean = if counts.is_empty() { 0.0 } else { sum as f64 / counts.len() as f64 };
        Self {
            counts: Arc::new(counts.to_vec()),
            histogram: Arc::new(histogram),
            bin_counts: bin_counts as u32,
            saturated,
            range: (lowest.min(highest), mean, highest),
            saturation_counts,
        }
    }
}

impl CameraLook {
    /// The look at a pair; frames have `width` columns.
    #[must_use]
    pub fn of(pair: &FramePair, width: usize, pixel_pitch_nm: f64, saturation_counts: [u16; 2]) -> Self {
        let look = |channel: usize| OneCamera::of(pair.frames[channel].counts(), saturation_counts[channel]);
        let cameras = [look(0), look(1)];
        let height = cameras[0].counts.len() / width.max(1);
        let exposure = pair.exposure.0;
        Self { exposure, width, height, cameras, pixel_pitch_nm, transmitted_from_reflected: None }
    }

    /// The same with what is known of where both cameras see the same.
    #[must_use]
    pub fn registered(self, transmitted_from_reflected: Option<PixelMap>) -> Self {
        Self { transmitted_from_reflected, ..self }
    }
}

/// A step of the light path whose images can be looked at.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Deserialize, Serialize)]
pub enum SofiStage {
    /// Temporal mean of each camera, the widefield image.
    Mean,
    /// Cumulants, one per spectral channel.
    Cumulant,
    /// One image per species.
    Unmixed,
    /// The same with equal weight for all sub-grids.
    Flattened,
    /// The same with brightness linear again.
    Linearized,
}

impl SofiStage {
    /// All of them in the order of the light path.
    pub const ALL: [Self; 5] = [Self::Mean, Self::Cumulant, Self::Unmixed, Self::Flattened, Self::Linearized];

    /// As the window and the results call it.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Mean => "mean",
            Self::Cumulant => "cumulants",
            Self::Unmixed => "unmixed",
            Self::Flattened => "flattened",
            Self::Linearized => "linearized",
        }
    }
}

/// One image of one step.
#[derive(Debug, Clone, PartialEq)]
pub struct StageImage {
    /// Its step.
    pub stage: SofiStage,
    /// Camera, spectral channel or species.
    pub name: String,
    /// The image; NaN where nothing could be computed.
    pub image: Arc<Array2<f32>>,
    /// Side of one of its pixels in the sample, nanometers.
    pub pixel_pitch_nm: f64,
}

/// The running result.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SofiLook {
    /// Exposures in it.
    pub samples: u64,
    /// How many of them belong to a subsequence that is still open.
    pub open_samples: u64,
    /// What it is, for people: samples, last step of the chain, binning.
    pub label: String,
    /// Images of every step that could be computed, step by step.
    pub images: Vec<StageImage>,
    /// Why later steps are missing.
    pub trouble: Option<String>,
}

impl SofiLook {
    /// The images of a step.
    pub fn stage(&self, stage: SofiStage) -> impl Iterator<Item = &StageImage> {
        self.images.iter().filter(move |image| image.stage == stage)
    }

    /// The last step that there are images of.
    #[must_use]
    pub fn last_stage(&self) -> Option<SofiStage> {
        self.images.iter().map(|image| image.stage).max()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sofi::registration::{Affine, Mirror};

    #[test]
    fn the_way_from_r_to_t_undoes_the_registration() {
        for (_, mirror) in Mirror::NAMES {
            let affine = Affine { matrix: [[1.01, 0.02], [-0.02, 0.99]], shift: [3.5, -7.25] };
            let registration = ReflectedFromTransmitted { mirror, affine, size: [48, 64] };
            let map = PixelMap::undoing(&registration).unwrap();
            for in_transmitted in [[0.0, 0.0], [11.5, 40.25], [47.0, 63.0]] {
                let back = map.apply(registration.apply(in_transmitted));
                let off = (back[0] - in_transmitted[0]).hypot(back[1] - in_transmitted[1]);
                assert!(off < 1e-9, "{mirror:?}: {in_transmitted:?} became {back:?}");
            }
        }
    }

    #[test]
    fn histogram_and_saturation_are_of_raw_counts() {
        let camera = OneCamera::of(&[0, 63, 64, 65_535, 60_000], 60_000);
        assert_eq!((camera.histogram[0], camera.histogram[1], camera.histogram[1023]), (2, 1, 1));
        assert_eq!((camera.bin_counts, camera.histogram.len()), (64, HISTOGRAM_BINS));
        let dim = OneCamera::of(&[90, 90, 1023], 60_000);
        assert_eq!((dim.bin_counts, dim.histogram[90], dim.histogram[1023]), (1, 2, 1));
        assert_eq!(OneCamera::of(&[1024], 60_000).bin_counts, 2);
        assert_eq!(camera.saturated, 2);
        assert_eq!((camera.range.0, camera.range.2), (0, 65_535));
        assert_eq!(camera.histogram.iter().sum::<u32>(), 5);
        assert_eq!(OneCamera::of(&[], 1).range, (0, 0.0, 0));
    }
}
