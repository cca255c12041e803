//! From the file of a registration to the settings of the cumulants, for files, recordings and live frames alike.
//!
//! In: settings and a source. Out: [`Registered`], or none where the cameras come aligned.
//! Never: uses a registration of other cameras or another size. Fails: [`AppError`] that names the file.

use super::AppError;
use super::analysis::Source;
use super::camera_maps::UsedMaps;
use super::text_file::read_text;
use crate::config::{AnalysisSettings, Registration};
use crate::sofi::registration::{NoiseLine, RegistrationSettings};

/// Longest file that is read.
pub(super) const MOST_BYTES: u64 = 1 << 20;

/// A registration that is used.
#[derive(Debug, Clone)]
pub(super) struct Registered {
    /// Text of its file, kept beside the frames.
    pub(super) text: String,
    pub(super) settings: RegistrationSettings,
    /// Width of the point-spread function of R and T on beads, pixels of R.
    pub(super) psf_sigma_px: Option<[f64; 2]>,
    pub(super) warnings: Vec<String>,
}

/// The registration that the settings name, or that the source knows; maps of T know its noise where that does not.
pub(super) fn registered(
    settings: &AnalysisSettings,
    source: &Source,
    camera_maps: &[Option<UsedMaps>],
) -> Result<Option<Registered>, AppError> {
    let (text, place) = match (&settings.registration_file, &source.registration) {
        (Some(path), _) => (read_text(path, MOST_BYTES)?, path.display().to_string()),
        (None, Some(text)) => {
            (text.clone(), "the registration of the instrument or the recording".to_owned())
        }
        (None, None) => return Ok(None),
    };
    let refused = |reason: &dyn std::fmt::Display| AppError::Usage(format!("{place}: {reason}"));
    let mut registration = Registration::from_toml(&text).map_err(|faults| refused(&faults))?;
    if let Some(Some(used)) = camera_maps.get(1) {
        let [gain, offset, read_variance] = used.maps.typical();
        let line = NoiseLine { slope: gain, at_zero: read_variance - gain * offset };
        registration.noise.get_or_insert(line);
    }
    if source.inputs.len() != 2 {
        return Err(refused(&"a registration needs two cameras; leave it out for one"));
    }
    let (made_for, frames) = (registration.transform.size, [source.height, source.width]);
    if made_for != frames {
        return Err(refused(&format!(
            "the registration is for regions of {} x {} pixels and the frames have {} x {}; \
             use the regions of the calibration or calibrate again",
            made_for[1], made_for[0], frames[1], frames[0]
        )));
    }
    for ((camera, made_for), found) in ["R", "T"].iter().zip(&registration.serials).zip(&source.serials) {
        if let (Some(made_for), Some(found)) = (made_for, found)
            && made_for != found
        {
            return Err(refused(&format!(
                "the registration is for camera {camera} with serial {made_for}, and {found} is used; \
                 calibrate these cameras"
            )));
        }
    }
    let interpolation = settings.interpolation;
    let mut warnings = Vec::new();
    if interpolation.is_unbiased() && settings.order > 2 {
        let about = if settings.order > 4 {
            "neighbors in T share shot noise, which is taken off up to order 4 only"
        } else {
            "the shot noise that neighbors in T share is taken off where nothing blinks; where it does, about one part in \
             the photons per pixel is left"
        };
        warnings.push(format!(
            "Order {} with a registration between pixels: {about}; compare with order 2, or with cameras aligned to \
             whole pixels.",
            settings.order
        ));
    }
    let psf_sigma_px = registration.psf_sigma_px;
    let settings = registration.settings(interpolation).map_err(|reason| refused(&reason))?;
    Ok(Some(Registered { text, settings, psf_sigma_px, warnings }))
}
