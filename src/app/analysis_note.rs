//! How a run was analyzed, kept beside its frames as `analysis.json`, so that it can be done again.

use super::AppError;
use super::analysis::Prepared;
use super::camera_maps::UsedMaps;
use crate::config::RawAnalysis;
use crate::sofi::spectra::{Species, SpectralResponse};
use serde::{Deserialize, Serialize};

/// Name of the file in a recording.
pub(super) const FILE: &str = "analysis.json";

/// Settings and species of an analysis.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct AnalysisNote {
    /// The settings as they were typed, with the length of subsequences that followed from them.
    pub(super) settings: RawAnalysis,
    /// Species that the source knew, where none were named.
    species: Vec<SpeciesNote>,
    /// The text of the registration that was used.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) registration: Option<String>,
    /// The texts beside the maps of each camera; the maps are in the directory of the recording.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub(super) camera_maps: Vec<Option<String>>,
    /// The text of the measured shares of the dyes' light that were used.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) response: Option<String>,
}

#[derive(Debug, Clone, Serialize, Deserialize)]
struct SpeciesNote {
    name: String,
    transmission: f64,
    reflection: f64,
    emission_nm: Option<f64>,
}

impl AnalysisNote {
    /// What is to be kept of an analysis.
    pub(super) fn of(raw: &RawAnalysis, prepared: &Prepared) -> Self {
        let mut settings = raw.clone();
        settings.subsequence_exposures = Some(prepared.engine.subsequence);
        settings.pixel_pitch_nm = Some(prepared.pixel_pitch_nm);
        // Its text is kept instead, as the file may change.
        settings.registration_file = None;
        settings.response_file = None;
        settings.camera_maps = None;
        let kept = |(camera, used): (usize, &Option<UsedMaps>)| Some(used.as_ref()?.kept_text(camera));
        let note = |species: &Species| SpeciesNote {
            name: species.name.clone(),
            transmission: species.response.transmission(),
            reflection: species.response.reflection(),
            emission_nm: species.emission_nm,
        };
        Self {
            settings,
            species: prepared.source.species.iter().flatten().map(note).collect(),
            registration: prepared.registration.clone(),
            camera_maps: prepared.camera_maps.iter().enumerate().map(kept).collect(),
            response: prepared.response.clone(),
        }
    }

    /// The file's name and text.
    pub(super) fn file(&self) -> Result<(String, String), AppError> {
        Ok((FILE.to_owned(), serde_json::to_string_pretty(self).map_err(AppError::data)?))
    }

    /// Reads the text of the file.
    pub(super) fn read(text: &str) -> Result<Self, AppError> {
        serde_json::from_str(text).map_err(|error| AppError::Data(format!("{FILE}: {error}")))
    }

    /// The species that the source knew.
    pub(super) fn species(&self) -> Result<Option<Vec<Species>>, AppError> {
        let species = |note: &SpeciesNote| {
            let response = SpectralResponse::measured(note.transmission, note.reflection);
            let response = response.map_err(|error| AppError::Data(format!("{FILE}: {error}")))?;
            Ok(Species { name: note.name.clone(), response, emission_nm: note.emission_nm })
        };
        let all = self.species.iter().map(species).collect::<Result<Vec<_>, AppError>>()?;
        Ok((!all.is_empty()).then_some(all))
    }
}
