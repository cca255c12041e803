//! The panels around the images, one file each.
//!
//! In: the status, what the person has typed. Out: commands into [`Wishes`]. Never: keeps a number of the instrument.
//! Fails: not at all.

mod align;
mod below;
mod bottom;
mod colors;
mod focus;
mod histogram;
mod instrument;
mod lasers;
mod live;
mod plan;
mod properties;
mod registration;
mod replay;
mod start;
mod top;
mod transport;

pub(super) use align::align;
pub(super) use below::{Shown, below, profile};
pub(super) use bottom::bottom;
pub(super) use instrument::instrument;
pub(super) use live::live;
pub(super) use plan::{plan, run};
pub(super) use replay::replay;
pub(super) use start::start;
pub(super) use top::top;
pub(super) use transport::transport;

use super::bench::{BenchCommand, Gravity};
use egui::{Color32, RichText, Ui};
use std::time::Duration;

/// What is typed and not yet sent, panel by panel.
#[derive(Debug, Clone, Default)]
pub(super) struct Forms {
    pub(super) live: live::LiveForm,
    pub(super) plan: plan::PlanForm,
    pub(super) replay: replay::ReplayForm,
    pub(super) transport: transport::TransportForm,
    pub(super) stage: instrument::StageForm,
    pub(super) lasers: lasers::LaserForm,
    pub(super) focus: focus::FocusForm,
    pub(super) properties: properties::PropertyForm,
    pub(super) registration: registration::RegistrationForm,
    pub(super) colors: colors::ColorsForm,
}

/// What the window itself is asked for.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Own {
    /// Judge the text of the plan.
    JudgePlan,
    /// Judge it, and begin unless there is something to warn of.
    CheckAndRun,
    /// Save images under a suggested name.
    Save,
    /// Save the pane of the result as it is seen.
    SavePicture,
    /// Keep settings of the moment under a name.
    KeepPreset(String),
    /// Take the settings of a preset.
    UsePreset(String),
    /// Forget a preset.
    RemovePreset(String),
    /// The layout as it was at first.
    ResetLayout,
    /// Show the list of keys.
    Shortcuts,
}

/// What the person asks for in this look at the window.
#[derive(Debug, Default)]
pub(super) struct Wishes {
    pub(super) commands: Vec<BenchCommand>,
    pub(super) own: Vec<Own>,
    pub(super) stop: bool,
}

impl Wishes {
    pub(super) fn ask(&mut self, command: BenchCommand) {
        self.commands.push(command);
    }
}

/// A heading of a part of a panel.
fn heading(ui: &mut Ui, text: &str) {
    ui.add_space(8.0);
    ui.label(RichText::new(text).strong().size(14.5));
    ui.separator();
}

/// Blue, orange and vermilion are told apart by all eyes.
pub(super) fn color_of(gravity: Gravity) -> Color32 {
    match gravity {
        Gravity::Note => Color32::from_rgb(120, 170, 220),
        Gravity::Warning => Color32::from_rgb(230, 159, 0),
        Gravity::Error => Color32::from_rgb(235, 105, 60),
    }
}

/// A duration for people.
fn in_words(time: Duration) -> String {
    let seconds = time.as_secs();
    match seconds {
        0..60 => format!("{:.1} s", time.as_secs_f64()),
        60..3600 => format!("{} min {:02} s", seconds / 60, seconds % 60),
        _ => format!("{} h {:02} min", seconds / 3600, seconds / 60 % 60),
    }
}

/// Bytes for people.
fn in_bytes(bytes: u64) -> String {
    let mut value = bytes as f64;
    for unit in ["B", "kB", "MB", "GB"] {
        if value < 1000.0 {
            return format!("{value:.3} {unit}").replace(".000", "");
        }
        value /= 1000.0;
    }
    format!("{value:.2} TB")
}

/// The first free directory of a name in the present one.
pub(super) fn suggested(name: &str) -> String {
    free(name, "")
}

/// The first free file of a name in the present directory.
pub(super) fn suggested_file(name: &str, extension: &str) -> String {
    free(name, &format!(".{extension}"))
}

fn free(name: &str, end: &str) -> String {
    let numbered =
        |number: u32| if number == 1 { format!("{name}{end}") } else { format!("{name}-{number}{end}") };
    (1..10_000).map(numbered).find(|path| !std::path::Path::new(path).exists()).unwrap_or_else(|| numbered(1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_and_bytes_are_short() {
        assert_eq!(in_words(Duration::from_millis(1500)), "1.5 s");
        assert_eq!(in_words(Duration::from_secs(125)), "2 min 05 s");
        assert_eq!(in_words(Duration::from_secs(7260)), "2 h 01 min");
        assert_eq!(in_bytes(999), "999 B");
        assert_eq!(in_bytes(1_500_000), "1.500 MB");
        assert_eq!(in_bytes(2_500_000_000_000), "2.50 TB");
    }
}
