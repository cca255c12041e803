//! Which dyes are unmixed and by which coefficients, and whether the data agree with these.
//!
//! In: settings, a source, the catalogue of dyes. Out: [`Species`], the [`UnmixingMatrix`], warnings.
//! Never: guesses a coefficient. Fails: [`AppError`] with the known names.

use super::AppError;
use super::analysis::{Prepared, Source};
use super::text_file::read_text;
use crate::config::{AnalysisSettings, Catalogue};
use crate::sofi::cumulant::Drawing;
use crate::sofi::spectra::Species;
use crate::sofi::unmixing::{UnmixingError, UnmixingMatrix, contradictions};
use ndarray::array;

/// Longest file of measured shares that is read.
pub(super) const MOST_BYTES: u64 = 1 << 20;

/// The dyes that are known, with those of the file of measured shares that the settings or the source name, and its
/// text.
pub(super) fn dyes(
    settings: &AnalysisSettings,
    source: &Source,
) -> Result<(Catalogue, Option<String>), AppError> {
    let (text, place) = match (&settings.response_file, &source.calibrations.response) {
        (Some(path), _) => (read_text(path, MOST_BYTES)?, path.display().to_string()),
        (None, Some(text)) => {
            (text.clone(), "the measured shares of the instrument or the recording".to_owned())
        }
        (None, None) => return Ok((Catalogue::built_in(), None)),
    };
    let catalogue =
        Catalogue::with_dichroics(&text).map_err(|faults| AppError::Usage(format!("{place}: {faults}")))?;
    Ok((catalogue, Some(text)))
}

/// Says which dyes the data contradict.
pub(super) fn contradiction_warnings(
    prepared: &Prepared,
    drawing: &Drawing,
) -> Result<Vec<String>, AppError> {
    let Some(matrix) = prepared.matrix.as_ref().filter(|_| prepared.source.inputs.len() > 1) else {
        return Ok(Vec::new());
    };
    let kappa: Vec<_> = drawing.cumulants.iter().map(|image| image.view()).collect();
    let found = contradictions(matrix, &kappa).map_err(AppError::data)?;
    let sentence = |found: &crate::sofi::unmixing::Contradiction| {
        let Species { name, response, .. } = &prepared.species[found.species];
        format!(
            "Where {name} prevails, no mixture of the dyes explains {:.0} % ({:.0} to {:.0} %) of the light: T = {} may be \
             wrong, another dye may be there, or the cameras do not see the same. Check with `calibrate response`, and \
             the registration.",
            100.0 * found.share,
            100.0 * (found.share - 2.0 * found.error),
            100.0 * (found.share + 2.0 * found.error),
            response.transmission()
        )
    };
    Ok(found.iter().map(sentence).collect())
}

/// The species to unmix: those named, those that the source knows, or one unnamed one behind a single camera.
pub(super) fn species(
    settings: &AnalysisSettings,
    source: &Source,
    catalogue: &Catalogue,
    warnings: &mut Vec<String>,
) -> Result<Vec<Species>, AppError> {
    if settings.species.is_empty() {
        if let Some(species) = &source.species {
            return Ok(species.clone());
        }
        if source.inputs.len() == 1 {
            return Ok(vec![Species::new("sample", 0.0).map_err(AppError::usage)?]);
        }
        warnings.push(
            "No dyes were named, so nothing was unmixed: give --species and --dichroic for species images."
                .to_owned(),
        );
        return Ok(Vec::new());
    }
    let measured = catalogue.measured().filter(|_| settings.dichroic.is_none());
    let Some(dichroic) = settings.dichroic.as_deref().or(measured) else {
        if source.inputs.len() == 1 && settings.species.len() == 1 {
            let dye = catalogue.fluorophore(&settings.species[0]).map_err(AppError::usage)?;
            let one = Species::new(dye.name(), 0.0).map_err(AppError::usage)?;
            return Ok(vec![Species { emission_nm: dye.emission_nm(), ..one }]);
        }
        let known: Vec<_> = catalogue.dichroics().iter().map(|d| d.name().to_owned()).collect();
        return Err(AppError::Usage(format!(
            "species were named without the dichroic between the cameras; give --dichroic, one of: {}",
            known.join(", ")
        )));
    };
    catalogue.species(&settings.species, dichroic).map_err(AppError::usage)
}

/// The matrix of the unmixing; none without dyes.
pub(super) fn mixing(
    settings: &AnalysisSettings,
    source: &Source,
    species: &[Species],
) -> Result<Option<UnmixingMatrix>, AppError> {
    match (source.inputs.len(), species.len()) {
        (_, 0) => Ok(None),
        (1, 1) => {
            let name = [species[0].name.clone()];
            let all_light = array![[1.0]];
            let matrix = UnmixingMatrix::from_proportions(settings.order, &name, &all_light);
            matrix.map(Some).map_err(AppError::usage)
        }
        (1, several) => Err(AppError::Usage(format!(
            "{several} species cannot be told apart with one camera; give the transmission stack as well, \
             or name one species"
        ))),
        _ => UnmixingMatrix::new(settings.order, species)
            .map(Some)
            .map_err(|error| inseparable(&error, settings.dichroic.as_deref())),
    }
}

/// The error of the unmixing with what can be done about it.
fn inseparable(error: &UnmixingError, dichroic: Option<&str>) -> AppError {
    AppError::Usage(match error {
        UnmixingError::TooManySpecies { species, spectral_channels } => format!(
            "{species} species cannot be told apart by {spectral_channels} spectral channels; \
             choose --order {} or name at most {spectral_channels}",
            species - 1
        ),
        UnmixingError::Indistinguishable { .. } => {
            let behind = dichroic.map_or(String::new(), |name| format!(" behind {name}"));
            format!("{error}{behind}; name only one of them or use another dichroic")
        }
        other => other.to_string(),
    })
}
