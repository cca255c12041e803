//! What each pixel of a simulated camera is in truth, as a file of camera maps.
//!
//! In: the pixels of the simulator. Out: a file with the pages of `calibrate camera`. Never: guesses.
//! Fails: [`AppError`] of the disk.

use super::AppError;
use super::camera_maps::write_maps;
use crate::sofi::camera::PixelFault;
use ndarray::Array2;
use sofiscope_sim::{Scene, Sensor};
use std::path::Path;

/// The truth of a camera's pixels, with the pages that `calibrate camera` writes.
pub(super) fn write_pixels(path: &Path, scene: &Scene, sensor: &Sensor) -> Result<(), AppError> {
    let size = (scene.height_px(), scene.width_px());
    let map = |value: &dyn Fn(usize) -> f32| Array2::from_shape_fn(size, |(y, x)| value(y * size.1 + x));
    let faults = map(&|pixel| {
        let bit = |is: bool, fault: PixelFault| if is { f32::from(fault.bit()) } else { 0.0 };
        bit(sensor.is_hot[pixel], PixelFault::Hot) + bit(sensor.is_dead[pixel], PixelFault::Dead)
    });
    let maps = [
        map(&|pixel| sensor.dark_mean_counts(pixel) as f32),
        map(&|pixel| sensor.gain_counts_per_electron[pixel] as f32),
        map(&|pixel| sensor.dark_variance_counts2(pixel) as f32),
    ];
    let [offset, gain, variance] = &maps;
    let faults = faults.mapv(|bits| bits as u8);
    Ok(write_maps(path, "pixels (simulated)", [offset, gain, variance], &faults, None)?)
}
