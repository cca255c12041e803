//! From the files of camera maps to what the cumulants know of pixels, for files, recordings and live frames alike.
//!
//! In: settings and a source. Out: [`UsedMaps`] per camera, of the part of the sensor that is read.
//! Never: uses the maps of another camera or another part. Fails: [`AppError`] that names the file.

use super::AppError;
use super::analysis::Source;
use super::text_file::read_text;
use crate::config::{AnalysisSettings, CameraCalibration};
use crate::files::{FileError, ImageStack, ResultHeader, SampleType, write_result};
use crate::sofi::camera::{CameraMaps, pulled_together};
use ndarray::Array2;
use sofiscope_hal::Region;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Longest file beside maps that is read.
const MOST_BYTES: u64 = 1 << 20;

/// Names of the pages that every file of maps has.
const PAGES: [&str; 4] = [
    "offset (counts)",
    "gain (counts per electron)",
    "read-noise variance (counts squared)",
    "faults (1 hot, 2 dead, 4 saturated)",
];

/// Names of the pages of a calibration that was not yet used.
const ERROR_PAGES: [&str; 3] = [
    "standard error of the offset (counts)",
    "standard error of the gain (counts per electron)",
    "standard error of the read-noise variance (counts squared)",
];

/// What stands in an entry of `camera_maps` for a camera without maps.
const NONE: &str = "none";

/// Where maps are to be found.
#[derive(Debug, Clone)]
pub(super) struct MapsPlace {
    /// Text of the file beside them.
    pub(super) text: String,
    /// The folder of both files.
    pub(super) folder: PathBuf,
    /// What to call it in messages.
    pub(super) name: String,
}

/// Maps that are used.
#[derive(Debug, Clone)]
pub(super) struct UsedMaps {
    /// What they are of: the part of the sensor that is read.
    pub(super) calibration: CameraCalibration,
    pub(super) maps: Arc<CameraMaps>,
}

impl MapsPlace {
    /// The maps that a file describes.
    pub(super) fn of(path: &Path) -> Result<Self, AppError> {
        Ok(Self {
            text: read_text(path, MOST_BYTES)?,
            folder: path.parent().unwrap_or(Path::new("")).to_owned(),
            name: path.display().to_string(),
        })
    }

    fn refused(&self, reason: impl std::fmt::Display) -> AppError {
        AppError::Usage(format!("{}: {reason}", self.name))
    }

    /// The maps of the part of the sensor with frames of this size.
    pub(super) fn load(
        &self,
        [height, width]: [usize; 2],
        region: Option<Region>,
    ) -> Result<UsedMaps, AppError> {
        let mut calibration =
            CameraCalibration::from_toml(&self.text).map_err(|faults| self.refused(faults))?;
        let maps = read_maps(&self.folder.join(&calibration.maps_file), calibration.region)?;
        let made_for = calibration.region;
        let is_whole = (made_for.height as usize, made_for.width as usize) == (height, width);
        let begin = match region {
            Some(region) => [(region.top, made_for.top), (region.left, made_for.left)]
                .map(|(read, mapped)| read.checked_sub(mapped)),
            None if is_whole => [Some(0); 2],
            None => [None; 2],
        };
        let part = match begin {
            [Some(top), Some(left)] => maps.part([top as usize, left as usize], [height, width]),
            _ => None,
        };
        let maps = part.ok_or_else(|| {
            self.refused(format!(
                "the maps are of {} x {} pixels from column {} and row {} on, and the frames of {width} x {height}{}; \
                 use a region of the calibration or calibrate again",
                made_for.width,
                made_for.height,
                made_for.left,
                made_for.top,
                region.map_or(String::new(), |region| format!(" from column {} and row {} on", region.left, region.top))
            ))
        })?;
        if let [Some(top), Some(left)] = begin {
            calibration.region = Region {
                left: made_for.left + left,
                top: made_for.top + top,
                width: width as u32,
                height: height as u32,
            };
        }
        Ok(UsedMaps { calibration, maps: Arc::new(maps) })
    }
}

/// The maps that the settings name, or that the source knows; empty where there are none.
pub(super) fn used_maps(
    settings: &AnalysisSettings,
    source: &Source,
) -> Result<Vec<Option<UsedMaps>>, AppError> {
    let cameras = source.inputs.len();
    let places = if settings.camera_maps.is_empty() {
        source.calibrations.camera_maps.clone()
    } else {
        let place = |path: &PathBuf| (path != Path::new(NONE)).then(|| MapsPlace::of(path)).transpose();
        settings.camera_maps.iter().map(place).collect::<Result<Vec<_>, AppError>>()?
    };
    if places.iter().all(Option::is_none) {
        return Ok(Vec::new());
    }
    if places.len() != cameras {
        return Err(AppError::Usage(format!(
            "camera_maps names {} files for {cameras} cameras; give one for each, or \"{NONE}\" in its place",
            places.len()
        )));
    }
    let used = places.iter().enumerate().map(|(camera, place)| {
        let Some(place) = place else { return Ok(None) };
        let size = [source.height, source.width];
        let used = place.load(size, source.calibrations.regions.get(camera).copied().flatten())?;
        let serials = (&used.calibration.serial, source.serials.get(camera).and_then(Option::as_ref));
        if let (Some(made_for), Some(found)) = serials
            && made_for != found
        {
            return Err(place.refused(format!(
                "the maps are of the camera with serial {made_for}, and {found} is used; \
                 exchange the files or calibrate this camera"
            )));
        }
        Ok(Some(used))
    });
    used.collect()
}

/// Reads the pages of a file of maps.
fn read_maps(path: &Path, region: Region) -> Result<CameraMaps, AppError> {
    let mut stack = ImageStack::open(path)?;
    let info = stack.info().clone();
    let size = (region.height as usize, region.width as usize);
    let refused = |reason: String| AppError::Data(format!("{}: {reason}", path.display()));
    if info.sample != SampleType::Float32 || info.channels < PAGES.len() || info.frames != 1 {
        return Err(refused("is no file of camera maps; make one with `calibrate camera`".to_owned()));
    }
    if (info.height, info.width) != size {
        let (height, width) = size;
        return Err(refused(format!(
            "has {} x {} pixels and the file beside it says {width} x {height}; calibrate again",
            info.width, info.height
        )));
    }
    let mut page = |channel: usize| -> Result<Array2<f32>, AppError> {
        let mut values = vec![0.0; size.0 * size.1];
        stack.select_channel(channel)?;
        stack.seek(0)?;
        stack.read_values(&mut values)?;
        Array2::from_shape_vec(size, values).map_err(AppError::data)
    };
    let [offset, gain, read_variance, faults] = [page(0)?, page(1)?, page(2)?, page(3)?];
    let gain = if info.channels == PAGES.len() + ERROR_PAGES.len() {
        pulled_together(&gain, &page(PAGES.len() + 1)?)
    } else {
        gain
    };
    let faults = faults.mapv(|fault| if fault.is_finite() { fault.clamp(0.0, 255.0) as u8 } else { 255 });
    Ok(CameraMaps::new(offset, gain, read_variance, faults))
}

/// Writes a file of maps: those of a calibration with their standard errors, those in use without.
pub(super) fn write_maps(
    path: &Path,
    name: &str,
    maps: [&Array2<f32>; 3],
    faults: &Array2<u8>,
    errors: Option<[&Array2<f32>; 3]>,
) -> Result<(), FileError> {
    let (height, width) = faults.dim();
    let faults = faults.mapv(f32::from);
    let pages: Vec<&Array2<f32>> =
        maps.into_iter().chain([&faults]).chain(errors.iter().flatten().copied()).collect();
    let planes: Vec<Vec<f32>> = pages.iter().map(|page| page.iter().copied().collect()).collect();
    let names = PAGES.iter().chain(&ERROR_PAGES).take(planes.len()).map(|name| (*name).to_owned()).collect();
    let header = ResultHeader {
        name: name.to_owned(),
        channels: names,
        height,
        width,
        description: "What every pixel of a camera does to light.".to_owned(),
        ..ResultHeader::default()
    };
    write_result(path, &header, &planes.iter().map(Vec::as_slice).collect::<Vec<_>>())
}

/// Name of the file of maps in a recording; `camera` counts from R.
fn kept_name(camera: usize) -> String {
    format!("camera-maps-{}.ome.tif", if camera == 0 { "r" } else { "t" })
}

/// Copies the maps in a recording to another one of the same frames.
pub(super) fn copy_kept(from: &Path, to: &Path) -> Result<(), FileError> {
    for name in [0, 1].map(kept_name) {
        let (from, to) = (from.join(&name), to.join(&name));
        if from.is_file() {
            std::fs::copy(&from, &to).map_err(|source| FileError::from_io(&to, "write", source))?;
        }
    }
    Ok(())
}

impl UsedMaps {
    /// The text that is kept beside the frames of a recording.
    pub(super) fn kept_text(&self, camera: usize) -> String {
        CameraCalibration { maps_file: kept_name(camera), ..self.calibration.clone() }.to_toml()
    }

    /// Writes the maps in use into the directory of a recording.
    pub(super) fn keep(&self, camera: usize, directory: &Path) -> Result<(), FileError> {
        let maps = [self.maps.offset(), self.maps.gain(), self.maps.read_variance()];
        write_maps(&directory.join(kept_name(camera)), "camera maps", maps, self.maps.faults(), None)
    }

    /// What the report says of them.
    pub(super) fn line(&self) -> String {
        let CameraCalibration { serial, date, .. } = &self.calibration;
        let of = serial.as_ref().map_or(String::new(), |serial| format!("serial {serial}, "));
        format!("{of}{date}, {} pixels left out", self.maps.masked_pixels())
    }
}
