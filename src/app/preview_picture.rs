//! The picture of the preview: the composite of the running cumulants, as far down the light path as time allows.
//!
//! At full size the whole chain runs, to linearized species. With squares of pixels averaged there is nothing to
//! deconvolve; species are unmixed and flattened, the sub-grids averaged and the n-th root taken.

use super::AppError;
use super::analysis::Prepared;
use super::results::overlay;
use crate::display::RgbImage;
use crate::reconstruction::Snapshot;
use crate::sofi::cumulant::{Binning, Drawing};
use crate::sofi::flattening::{Flattening, PsfWidth, flatten};
use ndarray::Array2;

/// What the operator sees while frames come in.
#[derive(Debug, Clone)]
pub(super) struct PreviewPicture {
    /// The composite, or why there is none.
    pub(super) image: Result<RgbImage, String>,
    /// Size of its pixels in the sample, nanometers.
    pub(super) pixel_pitch_nm: f64,
    /// What it is: samples, squares, last step of the chain.
    pub(super) label: String,
}

/// Makes the picture of a snapshot.
pub(super) fn compose(prepared: &Prepared, snapshot: &Snapshot) -> PreviewPicture {
    let order = prepared.grid.order();
    let side = snapshot.binning.side();
    let samples = snapshot.drawing.samples;
    let open = snapshot.drawing.incomplete_samples;
    let is_whole = snapshot.binning == Binning::One;
    let step = if is_whole { "linearized" } else { "flattened, not deconvolved" };
    let label =
        format!("{samples} exposures ({open} of them in an open subsequence), {step}, binning {side}");
    let image =
        if is_whole { whole(prepared, &snapshot.drawing) } else { binned(prepared, &snapshot.drawing) };
    let fold = if is_whole { order } else { 1 };
    PreviewPicture {
        image: image.map_err(|error| error.to_string()),
        pixel_pitch_nm: prepared.pixel_pitch_nm * side as f64 / fold as f64,
        label,
    }
}

fn whole(prepared: &Prepared, drawing: &Drawing) -> Result<RgbImage, AppError> {
    let (stages, _) = prepared.stages(drawing)?;
    let images = stages.map_or_else(|| drawing.cumulants.clone(), |stages| stages.linearized);
    overlay(&images).map_err(AppError::data)
}

fn binned(prepared: &Prepared, drawing: &Drawing) -> Result<RgbImage, AppError> {
    let order = prepared.grid.order();
    let distances = prepared.grid.squared_distances();
    let images = match &prepared.matrix {
        None => drawing.cumulants.clone(),
        Some(matrix) => {
            let kappa: Vec<_> = drawing.cumulants.iter().map(|image| image.view()).collect();
            let unmixed = matrix.unmix_with(&prepared.settings.unmixing, &kappa).map_err(AppError::data)?;
            let widths = prepared.widths(drawing, matrix);
            let flat = |(image, width): (&Array2<f32>, &super::analysis::Width)| {
                let kind = Flattening::EqualMeans(PsfWidth::Known(width.sigma_px));
                flatten(image, &distances, kind).map(|(flat, _)| flat).map_err(AppError::data)
            };
            unmixed.iter().zip(&widths).map(flat).collect::<Result<Vec<_>, _>>()?
        }
    };
    let merged: Vec<Array2<f32>> = images.iter().map(|image| merged_root(image, order)).collect();
    overlay(&merged).map_err(AppError::data)
}

/// The n-th root of the mean over the sub-positions of each pixel; negative means are dark.
fn merged_root(image: &Array2<f32>, order: usize) -> Array2<f32> {
    let size = (image.nrows() / order, image.ncols() / order);
    Array2::from_shape_fn(size, |(y, x)| {
        let inside = (0..order * order).map(|k| image[[y * order + k / order, x * order + k % order]]);
        let (sum, count) = inside
            .filter(|value| !value.is_nan())
            .fold((0.0_f32, 0_u32), |(sum, count), value| (sum + value, count + 1));
        if count == 0 { f32::NAN } else { (sum / count as f32).max(0.0).powf(1.0 / order as f32) }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sub_positions_without_a_value_do_not_count() {
        let mut image = Array2::from_elem((4, 4), 9.0_f32);
        image[[0, 0]] = f32::NAN;
        image.slice_mut(ndarray::s![2.., 2..]).fill(-1.0);
        image.slice_mut(ndarray::s![2.., ..2]).fill(f32::NAN);
        let merged = merged_root(&image, 2);
        assert!((merged[[0, 0]] - 3.0).abs() < 1e-6 && merged[[1, 1]] == 0.0 && merged[[1, 0]].is_nan());
    }
}
