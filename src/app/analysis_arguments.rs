//! The arguments by which `analyze` and `replay` are told how to analyze.
//!
//! In: the command line. Out: [`RawAnalysis`] with what was given. Never: judges a value. Fails: not at all.

use crate::config::RawAnalysis;

/// Arguments that win over settings from elsewhere.
#[derive(Debug, Clone, clap::Args)]
pub(super) struct AnalysisArguments {
    /// Dyes, separated by commas, in the order of the result images [default: those of the settings or the recording]
    #[arg(long, value_delimiter = ',')]
    species: Option<Vec<String>>,
    /// Dichroic between the cameras
    #[arg(long)]
    dichroic: Option<String>,
    /// Cumulant order, 2 to 6
    #[arg(long)]
    order: Option<usize>,
    /// Exposures per subsequence [default: 200, or all if there are fewer]
    #[arg(long)]
    subsequence: Option<u64>,
    /// Registration of camera T onto camera R, as `calibrate registration` writes it
    #[arg(long, value_name = "FILE")]
    registration: Option<String>,
    /// How T is brought onto R: unbiased-sinc or bilinear-frames [default: unbiased-sinc]
    #[arg(long, value_name = "NAME")]
    registration_method: Option<String>,
    /// Maps of each camera's pixels, R before T, as `calibrate camera` writes them; none for a camera without
    #[arg(long, value_delimiter = ',', value_name = "FILES")]
    camera_maps: Option<Vec<String>>,
    /// Measured shares of the dyes' light, as `calibrate response` writes them
    #[arg(long, value_name = "FILE")]
    response: Option<String>,
    /// Width of the point-spread function where none is given: optics (aperture and emission) or measured (in the
    /// data, else on beads) [default: optics]
    #[arg(long, value_name = "NAME")]
    psf: Option<String>,
}

impl AnalysisArguments {
    /// What was given, and nothing else.
    pub(super) fn raw(&self) -> RawAnalysis {
        RawAnalysis {
            order: self.order,
            subsequence_exposures: self.subsequence,
            species: self.species.clone(),
            dichroic: self.dichroic.clone(),
            registration_file: self.registration.clone(),
            registration: self.registration_method.clone(),
            camera_maps: self.camera_maps.clone(),
            response_file: self.response.clone(),
            psf: self.psf.clone(),
            ..RawAnalysis::default()
        }
    }
}
