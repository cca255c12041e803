//! The report of one analysis: `report.json` for scripts, `report.html` for people.
//!
//! In: an [`AnalysisReport`] filled in by the application, and [`Picture`]s.
//! Out: JSON, and one HTML page that needs nothing but itself.
//! Never: computes results, reads clocks, refers to anything outside the page.
//! Fails: [`ReportError`] for pictures that cannot be made and files that cannot be written or read.

mod error;
#[cfg(test)]
mod example;
mod facts;
mod figure;
mod json;
mod model;
mod model_quality;
mod null;
mod page;
mod plot;
mod sections;
mod stacked;
mod tables;
mod text;
mod ticks;
mod verdict;

pub use error::ReportError;
pub use figure::{ColorScale, LegendEntry, Picture, Step};
pub use json::{read_json, to_json, write_json};
pub use model::{
    AnalysisReport, BleachingCurve, Crosstalk, CrosstalkReference, CurveUnit, FORMAT_VERSION,
    FlatteningNotes, FrameAccount, FrameCount, InputFile, Matrix, OutputFile, PsfUsed, Resolution,
    ResolutionCurve, ResolutionValue, Settings, Software, Species, Subsequence, SubsequenceFate, Timing,
    Unmixing,
};
pub use page::{html, write_html};
pub use plot::{Axis, AxisRange, LinePlot, Series};
pub use stacked::stacked;
pub use verdict::verdict;
