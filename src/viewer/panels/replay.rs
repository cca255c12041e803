//! Replay: which recording, how fast, from where.

use super::transport::SPEEDS;
use super::{Wishes, heading};
use crate::viewer::bench::{Activity, BenchCommand, BenchStatus};
use egui::{Button, DragValue, ScrollArea, TextEdit, Ui};

/// What is typed for a replay.
#[derive(Debug, Clone)]
pub(in crate::viewer) struct ReplayForm {
    path: String,
    speed: f64,
    from: u64,
}

impl Default for ReplayForm {
    fn default() -> Self {
        Self { path: String::new(), speed: 1.0, from: 0 }
    }
}

/// Draws the panel.
pub(in crate::viewer) fn replay(
    ui: &mut Ui,
    status: &BenchStatus,
    form: &mut ReplayForm,
    wishes: &mut Wishes,
) {
    heading(ui, "Replay");
    ui.horizontal(|ui| {
        let label = ui.label("Recording");
        ui.add(TextEdit::singleline(&mut form.path).desired_width(210.0))
            .labelled_by(label.id)
            .on_hover_text("A recording's directory; it plays through the very pipeline of the cameras");
    });
    ui.horizontal(|ui| {
        ui.label("Speed");
        for (speed, name) in SPEEDS {
            let hover = if speed.is_finite() {
                format!("{speed} times the speed of the recording")
            } else {
                "As fast as the computer can".to_owned()
            };
            ui.selectable_value(&mut form.speed, speed, name).on_hover_text(hover);
        }
    });
    ui.horizontal(|ui| {
        let label = ui.label("From exposure");
        ui.add(DragValue::new(&mut form.from).speed(10.0))
            .labelled_by(label.id)
            .on_hover_text("First exposure to play, from 0");
    });
    let command =
        || BenchCommand::Replay { recording: form.path.trim().into(), speed: form.speed, from: form.from };
    let is_free =
        !matches!(status.activity, Activity::Run | Activity::Paused | Activity::Ending | Activity::Opening);
    ui.horizontal(|ui| {
        let is_playing = status.activity == Activity::Replay;
        let text = if is_playing { "Play again" } else { "Play" };
        let play = ui.add_enabled(is_free && !form.path.trim().is_empty(), Button::new(text));
        let play = play.on_hover_text("Play it through the pipeline of the cameras");
        if play.on_disabled_hover_text("Choose a recording first; a run has to end before").clicked() {
            wishes.ask(command());
        }
        let end = ui.add_enabled(is_playing, Button::new("End replay")).on_hover_text("End it (F)");
        if end.on_disabled_hover_text("Nothing is played").clicked() {
            wishes.ask(BenchCommand::Finish);
        }
    });
    heading(ui, "Recent");
    if status.recent.is_empty() {
        ui.label("Recordings and saved images appear here.");
    }
    let mut chosen = None;
    ScrollArea::vertical().id_salt("recent").max_height(300.0).show(ui, |ui| {
        for path in status.recent.iter() {
            let text = path.display().to_string();
            if ui.selectable_label(form.path == text, &text).clicked() {
                chosen = Some(text);
            }
        }
    });
    if let Some(path) = chosen {
        form.path = path;
    }
}
