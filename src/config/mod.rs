//! Settings as typed become settings that can be believed.
//!
//! In: text in TOML or YAML. Out: [`Catalogue`], the dyes and dichroics that the program knows by name;
//! [`Instrument`], what is connected where; [`Registration`], how its cameras see each other;
//! [`CameraCalibration`], where the maps of their pixels come from; [`AnalysisSettings`]; spectra,
//! measured or parametric.
//! Never: stops at the first fault of a file, guesses a name, reads a file itself.
//! Fails: [`Fault`]s with line, key and remedy; [`DyeError`] for names, with the nearest known ones.

mod analysis;
mod camera_calibration;
mod dyes;
mod instrument;
mod judge;
mod names;
mod registration;
mod section;
mod spectra;
mod tree;

pub use analysis::{AnalysisFaults, AnalysisSettings, PsfSource, RawAnalysis};
pub use camera_calibration::{CameraCalibration, CameraCalibrationFaults};
pub use dyes::{Catalogue, CatalogueError, Dichroic, DyeError, Fluorophore};
pub use instrument::{
    CameraEntry, CameraKind, FocusEntry, GatesEntry, GatesKind, Hardware, Instrument, InstrumentFaults,
    LaserEntry, LaserLink, Limits, PortEntry, Simulation, StageEntry, StageLink, TriggerKind, VirtualEntry,
};
pub(crate) use judge::Judge;
pub use registration::{Registration, RegistrationFaults};
pub(crate) use section::{Findings, Section};
pub use sofiscope_form::{Fault, nearest, plain};
pub use spectra::{
    CsvSpectrum, ParametricDichroic, ParametricSpectra, SpectrumFaults, ValueUnit, read_spectrum,
};
pub(crate) use tree::{Content, Node, Places};
