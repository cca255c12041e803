//! The picture of the preview: the composite of the running cumulants, as far down the light path as time allows.
//!
//! At full size the whole chain runs, to linearized species. With squares of pixels averaged there is nothing to
//! deconvolve; species are unmixed and flattened, the sub-grids averaged and the n-th root taken.

use super::AppError;
use super::analysis::Prepared;
use super::results::{channels_of, overlay};
use crate::display::RgbImage;
use crate::reconstruction::{Snapshot, SofiLook, SofiStage, StageImage};
use crate::sofi::cumulant::Binning;
use crate::sofi::flattening::{Flattening, PsfWidth, flatten};
use ndarray::Array2;
use std::sync::Arc;

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
    picture(prepared, snapshot, &steps(prepared, snapshot))
}

/// Makes the picture of a snapshot, and the images of every step for whoever looks closer.
pub(super) fn compose_and_look(prepared: &Prepared, snapshot: &Snapshot) -> (PreviewPicture, SofiLook) {
    let steps = steps(prepared, snapshot);
    let picture = picture(prepared, snapshot, &steps);
    let side = snapshot.binning.side() as f64;
    let camera_nm = prepared.pixel_pitch_nm * side;
    let fine_nm = camera_nm / prepared.grid.order() as f64;
    let last_nm = picture.pixel_pitch_nm;
    let (cameras, spectral) = channels_of(prepared);
    let species: Vec<String> = prepared.species.iter().map(|species| species.name.clone()).collect();
    let drawing = &snapshot.drawing;
    let mut images = Vec::new();
    let mut add = |stage, names: &[String], planes: &[Array2<f32>], pixel_pitch_nm| {
        for (name, image) in names.iter().zip(planes) {
            let (name, image) = (name.clone(), Arc::new(image.clone()));
            images.push(StageImage { stage, name, image, pixel_pitch_nm });
        }
    };
    // Pixels of the mean, whatever squares it was averaged over.
    let mean_nm = drawing.means.first().map_or(camera_nm, |mean| {
        prepared.pixel_pitch_nm * prepared.source.width as f64 / mean.ncols().max(1) as f64
    });
    add(SofiStage::Mean, &cameras, &drawing.means, mean_nm);
    add(SofiStage::Cumulant, &spectral, &drawing.cumulants, fine_nm);
    let mut trouble = None;
    match &steps {
        Ok(Some(steps)) => {
            add(SofiStage::Unmixed, &species, &steps.unmixed, fine_nm);
            add(SofiStage::Flattened, &species, &steps.flattened, fine_nm);
            add(SofiStage::Linearized, &species, &steps.last, last_nm);
        }
        Ok(None) => trouble = Some("no dyes were named, so nothing is unmixed".to_owned()),
        Err(error) => trouble = Some(error.to_string()),
    }
    let look = SofiLook {
        samples: drawing.samples,
        open_samples: drawing.incomplete_samples,
        label: picture.label.clone(),
        images,
        trouble,
    };
    (picture, look)
}

/// Images of the species, step by step.
struct Steps {
    unmixed: Vec<Array2<f32>>,
    flattened: Vec<Array2<f32>>,
    /// Linear in brightness: deconvolved at full size, else the root of the averaged sub-grids.
    last: Vec<Array2<f32>>,
}

fn picture(
    prepared: &Prepared,
    snapshot: &Snapshot,
    steps: &Result<Option<Steps>, AppError>,
) -> PreviewPicture {
    let order = prepared.grid.order();
    let side = snapshot.binning.side();
    let samples = snapshot.drawing.samples;
    let open = snapshot.drawing.incomplete_samples;
    let is_whole = snapshot.binning == Binning::One;
    let step = if is_whole { "linearized" } else { "flattened, not deconvolved" };
    let label =
        format!("{samples} exposures ({open} of them in an open subsequence), {step}, binning {side}");
    let image = match steps {
        Ok(Some(steps)) => overlay(&steps.last).map_err(|error| error.to_string()),
        Ok(None) if is_whole => overlay(&snapshot.drawing.cumulants).map_err(|error| error.to_string()),
        Ok(None) => overlay(&merged(&snapshot.drawing.cumulants, order)).map_err(|error| error.to_string()),
        Err(error) => Err(error.to_string()),
    };
    let fold = if is_whole { order } else { 1 };
    PreviewPicture { image, pixel_pitch_nm: prepared.pixel_pitch_nm * side as f64 / fold as f64, label }
}

/// The steps that the time allows; none without species.
fn steps(prepared: &Prepared, snapshot: &Snapshot) -> Result<Option<Steps>, AppError> {
    let drawing = &snapshot.drawing;
    if snapshot.binning == Binning::One {
        let (stages, _) = prepared.stages(drawing)?;
        return Ok(stages.map(|stages| Steps {
            unmixed: stages.unmixed,
            flattened: stages.flattened,
            last: stages.linearized,
        }));
    }
    let Some(matrix) = &prepared.matrix else { return Ok(None) };
    let distances = prepared.grid.squared_distances();
    let kappa: Vec<_> = drawing.cumulants.iter().map(|image| image.view()).collect();
    let unmixed = matrix.unmix_with(&prepared.settings.unmixing, &kappa).map_err(AppError::data)?;
    let widths = prepared.widths(drawing, matrix, &unmixed);
    let flat = |(image, width): (&Array2<f32>, &super::widths::Width)| {
        let kind = Flattening::EqualMeans(PsfWidth::Known(width.seen_px));
        flatten(image, &distances, kind).map(|(flat, _)| flat).map_err(AppError::data)
    };
    let flattened = unmixed.iter().zip(&widths).map(flat).collect::<Result<Vec<_>, _>>()?;
    let last = merged(&flattened, prepared.grid.order());
    Ok(Some(Steps { unmixed, flattened, last }))
}

fn merged(images: &[Array2<f32>], order: usize) -> Vec<Array2<f32>> {
    images.iter().map(|image| merged_root(image, order)).collect()
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
