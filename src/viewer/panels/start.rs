//! The first screen: one click to the simulated microscope.

use super::Wishes;
use crate::viewer::bench::{Activity, BenchCommand, BenchStatus, LiveSettings};
use crate::viewer::settings::WindowSettings;
use egui::{Button, RichText, TextEdit, Ui, Vec2};

/// What comes after the click, for whoever is here for the first time.
const WHAT_TO_DO: [(&str, &str); 3] = [
    (
        "Look",
        "Both cameras, and the unmixed image of the dyes that sharpens while frames come; F1 lists the keys.",
    ),
    ("Keep", "S saves every image as data, E the picture as it is seen."),
    ("Acquire", "Ctrl+Enter checks the plan and runs it; STOP is at the top right, Ctrl+. or Esc twice."),
];

/// Draws the first screen.
pub(in crate::viewer) fn start(
    ui: &mut Ui,
    status: &BenchStatus,
    settings: &mut WindowSettings,
    wishes: &mut Wishes,
) {
    ui.vertical_centered(|ui| {
        ui.add_space(ui.available_height() * 0.12);
        ui.label(RichText::new("sofiscope").size(34.0).strong());
        ui.label("multicolor super-resolution (SOFI), live, with two cameras");
        ui.add_space(28.0);
        let is_free = status.activity == Activity::Closed;
        let button = Button::new(RichText::new("Start the simulated microscope").size(19.0));
        let hover = "Two simulated cameras look at three dyes; no hardware is involved";
        if ui.add_enabled(is_free, button.min_size(Vec2::new(380.0, 52.0))).on_hover_text(hover).clicked() {
            wishes.ask(BenchCommand::OpenSimulated);
            // Nothing shines and nothing moves there: the sample is shown at once.
            wishes.ask(BenchCommand::Live(LiveSettings::default()));
        }
        ui.add_space(24.0);
        ui.label("or open an instrument file");
        ui.horizontal(|ui| {
            ui.add_space((ui.available_width() - 470.0).max(0.0) * 0.5);
            let label = ui.label("File");
            ui.add(TextEdit::singleline(&mut settings.instrument).desired_width(330.0)).labelled_by(label.id);
            let hover = "Opens every device of the instrument; nothing shines and nothing moves";
            if ui.add_enabled(is_free, Button::new("Open instrument")).on_hover_text(hover).clicked() {
                wishes.ask(BenchCommand::OpenInstrument(settings.instrument.trim().into()));
            }
        });
        if status.activity == Activity::Opening {
            ui.add_space(12.0);
            ui.spinner();
            ui.label("opening every device of the instrument ...");
        }
        ui.add_space(28.0);
        for (what, how) in WHAT_TO_DO {
            ui.label(RichText::new(what).strong());
            ui.label(how);
            ui.add_space(6.0);
        }
        if !status.recent.is_empty() {
            ui.add_space(24.0);
            ui.label("or replay a recording");
            for path in status.recent.iter().take(6) {
                let play = ui
                    .link(path.display().to_string())
                    .on_hover_text("Play it as if the microscope were there");
                if play.clicked() {
                    wishes.ask(BenchCommand::Replay { recording: path.clone(), speed: 1.0, from: 0 });
                }
            }
        }
    });
}
