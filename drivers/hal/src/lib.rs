//! Contracts between the instrument and its devices: the words both sides use.

use serde::{Deserialize, Serialize};

/// The two physical detection channels behind the emission dichroic (paper, Fig. 1a).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Channel {
    /// Camera R: the short-wavelength side of the dichroic.
    Reflected,
    /// Camera T: the long-wavelength side of the dichroic.
    Transmitted,
}

impl Channel {
    /// Both channels in the order in which files and results list them.
    pub const BOTH: [Self; 2] = [Self::Reflected, Self::Transmitted];
}

/// Exposures since the cameras were armed; never wraps; the pairing key.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct ExposureIndex(pub u64);
