//! From frames of the live view and marked regions to a share.
//!
//! In: sums of frames, regions, the live view that they are of. Out: [`FoundShare`] and what its file says of it.
//! Never: counts saturated pixels. Fails: [`AppError`] with what to do.

use super::UnderLive;
use super::file::Entry;
use crate::app::AppError;
use crate::app::window::session::Known;
use crate::config::Catalogue;
use crate::reconstruction::CameraLook;
use crate::sofi::registration::Resampler;
use crate::sofi::response::{
    Marked, PixelArea, ResponseError, ResponseSettings, StainedSums, transmitted_share_in,
};
use crate::viewer::bench::{DyeInUse, FoundShare, MarkedRegions};
use ndarray::Array2;

/// Share of saturated pixels above which regions are refused.
const MOST_SATURATED: f64 = 0.01;
/// An uncertainty above which more frames are recommended.
const LARGE_UNCERTAINTY: f64 = 0.02;

/// Sums of frames, and the pixels of R and T that were saturated in one of them.
pub(super) struct Gathered {
    size: [usize; 2],
    sums: StainedSums,
    saturated: [Array2<bool>; 2],
    frames: usize,
}

impl Gathered {
    pub(super) fn new(size: [usize; 2]) -> Self {
        let none = || Array2::from_elem((size[0], size[1]), false);
        Self { size, sums: StainedSums::new(size), saturated: [none(), none()], frames: 0 }
    }

    /// One more; false, and not taken, where it has another size.
    pub(super) fn push(&mut self, look: &CameraLook) -> bool {
        let fits = [look.height, look.width] == self.size;
        if fits {
            let [r, t] = &look.cameras;
            self.sums.push([&r.counts, &t.counts]);
            for (mask, camera) in self.saturated.iter_mut().zip([r, t]).filter(|(_, one)| one.saturated > 0) {
                let counts = mask.iter_mut().zip(camera.counts.iter());
                counts.for_each(|(mask, &count)| *mask |= count >= camera.saturation_counts);
            }
            self.frames += 1;
        }
        fits
    }
}

pub(super) fn estimate(
    gathered: &Gathered,
    dye: &str,
    marked: &MarkedRegions,
    live: &UnderLive,
    known: &Known,
) -> Result<(FoundShare, Entry), AppError> {
    let dye = Catalogue::built_in().fluorophore(dye).map_err(AppError::usage)?.name().to_owned();
    let prepared = &live.prepared;
    if [prepared.source.height, prepared.source.width] != gathered.size {
        return Err(AppError::usage("the live view began anew while frames were taken; measure again"));
    }
    let areas = marked.dye.iter().map(|&area| placed(area, live)).collect::<Result<Vec<_>, _>>()?;
    let background = marked.background.map(|area| placed(area, live)).transpose()?;
    let registration = prepared.engine.registration.as_ref();
    let resampler = registration
        .map(|registration| Resampler::new(&registration.transform, registration.interpolation))
        .transpose()
        .map_err(AppError::data)?;
    let maps = [0, 1].map(|camera| prepared.camera_maps.get(camera).and_then(Option::as_ref));
    let saturated = saturated_share(gathered, resampler.as_ref(), &areas)?;
    let masks: [Array2<bool>; 2] = std::array::from_fn(|camera| {
        let of_maps = maps[camera].and_then(|used| used.maps.mask());
        let saturated = &gathered.saturated[camera];
        of_maps.map_or_else(|| saturated.clone(), |of_maps| &of_maps | saturated)
    });
    let settings = ResponseSettings {
        blank: None,
        offsets: maps.map(|used| Some(used?.maps.offset())),
        masks: [Some(&masks[0]), Some(&masks[1])],
        resampler: resampler.as_ref(),
    };
    let means = gathered.sums.means().map_err(AppError::data)?;
    let marked_areas = Marked { dye: &areas, background };
    let share = transmitted_share_in(&means, &settings, &marked_areas).map_err(told)?;
    let uncertainty = share.uncertainty();
    let mut warnings = Vec::new();
    if registration.is_none() {
        warnings.push(
            "No registration is in use: the cameras are taken as aligned. Unless they are, register them first (Cameras), \
             start the live view again and measure again."
                .to_owned(),
        );
    }
    if saturated > 0.0 {
        warnings.push(format!(
            "{:.1} % of the pixels in the regions were saturated and are left out; less light is better",
            100.0 * saturated
        ));
    }
    if uncertainty > LARGE_UNCERTAINTY {
        warnings.push("The uncertainty is large: take more frames or mark more of the dye.".to_owned());
    }
    let told = FoundShare {
        in_use: in_use(&dye, live, known),
        dye: dye.clone(),
        transmission: share.transmission,
        uncertainty,
        frames: gathered.frames,
        warnings,
    };
    let entry = Entry {
        dye,
        // Chance may put a share close to an end beyond it.
        transmission: share.transmission.clamp(0.0, 1.0),
        uncertainty: uncertainty.min(1.0),
        marked: marked.clone(),
        exposures: format!(
            "{} of {} ms each, from the live view",
            gathered.frames,
            live.settings.exposure.as_secs_f64() * 1e3
        ),
        registration: prepared.registration.as_deref().map_or_else(
            || "none; the cameras were taken as aligned".to_owned(),
            crate::app::window::registering::in_words,
        ),
        date: jiff::Timestamp::now().to_string(),
    };
    Ok((told, entry))
}

/// A region of the sensor in the frames of the live view.
fn placed([left, top, width, height]: [u32; 4], live: &UnderLive) -> Result<PixelArea, AppError> {
    let [first_column, first_row, ..] = live.settings.region.unwrap_or_default();
    let source = &live.prepared.source;
    let corner = left.checked_sub(first_column).zip(top.checked_sub(first_row));
    let area = corner.map(|(left, top)| PixelArea {
        top: top as usize,
        left: left as usize,
        height: height as usize,
        width: width as usize,
    });
    let fits =
        |area: &PixelArea| area.top + area.height <= source.height && area.left + area.width <= source.width;
    area.filter(fits).ok_or_else(|| {
        AppError::usage(
            "a region lies outside of what the live view shows; clear the regions and mark them again",
        )
    })
}

/// The share of pixels of the regions that a camera had saturated.
fn saturated_share(
    gathered: &Gathered,
    resampler: Option<&Resampler>,
    areas: &[PixelArea],
) -> Result<f64, AppError> {
    let on_r = match resampler {
        None => Some(gathered.saturated[1].clone()),
        // Pixels that T does not see are in it with and without saturated ones.
        Some(resampler) => resampler.missing(Some(&gathered.saturated[1])).map(|all| {
            let unseen = resampler.missing(None);
            unseen.map_or(all.clone(), |unseen| &all & &!&unseen)
        }),
    };
    let mut most: f64 = 0.0;
    for (name, mask) in [("R", Some(&gathered.saturated[0])), ("T", on_r.as_ref())] {
        let Some(mask) = mask else { continue };
        let (mut count, mut pixels) = (0, 0);
        for area in areas {
            for y in area.top..area.top + area.height {
                for x in area.left..area.left + area.width {
                    pixels += 1;
                    count += usize::from(mask[[y, x]]);
                }
            }
        }
        let share = f64::from(count as u32) / (pixels as f64).max(1.0);
        if share > MOST_SATURATED {
            return Err(AppError::Usage(format!(
                "{:.0} % of the pixels in the regions are saturated in camera {name}; lower the laser power or the \
                 exposure, start the live view again and measure again",
                100.0 * share
            )));
        }
        most = most.max(share);
    }
    Ok(most)
}

/// What the live view goes by.
fn in_use(dye: &str, live: &UnderLive, known: &Known) -> Option<DyeInUse> {
    let told = known.dyes().iter().find(|in_use| in_use.dye == dye).cloned();
    let shown = live.prepared.species.iter().find(|species| species.name == dye);
    let Some(shown) = shown else { return told };
    let transmission = shown.response.transmission();
    let is_same = |told: &DyeInUse| (told.transmission - transmission).abs() < 1e-9;
    Some(told.filter(is_same).unwrap_or_else(|| DyeInUse {
        dye: dye.to_owned(),
        transmission,
        from: "the settings of this live view".to_owned(),
    }))
}

fn told(error: ResponseError) -> AppError {
    AppError::Data(match error {
        ResponseError::NoLight => "the regions are too dark, or nothing in them is clearly brighter than its \
             surroundings: mark them where this dye is bright, take more frames or more light, or mark a background \
             for evenly stained regions"
            .to_owned(),
        other => other.to_string(),
    })
}
