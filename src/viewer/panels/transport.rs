//! The transport of a replay, below the images: hold, go on, another place, another speed.
//!
//! In: how the replay stands. Out: commands. Never: keeps a place but while it is dragged. Fails: not at all.

use super::{Wishes, in_words};
use crate::viewer::bench::{Activity, BenchCommand, BenchStatus, ReplayStatus};
use egui::{Button, Slider, Ui};

/// Speeds that are offered.
pub(super) const SPEEDS: [(f64, &str); 5] =
    [(0.5, "0.5x"), (1.0, "1x"), (2.0, "2x"), (5.0, "5x"), (f64::INFINITY, "max")];

/// A place that is being dragged to.
#[derive(Debug, Clone, Copy, Default)]
pub(in crate::viewer) struct TransportForm {
    wanted: Option<u64>,
}

/// Draws the transport.
pub(in crate::viewer) fn transport(
    ui: &mut Ui,
    status: &BenchStatus,
    replay: &ReplayStatus,
    form: &mut TransportForm,
    wishes: &mut Wishes,
) {
    let is_playing = status.activity == Activity::Replay;
    ui.horizontal(|ui| {
        let (text, hover, command) = if replay.is_paused {
            ("Resume replay", "Go on (P)", BenchCommand::Resume)
        } else {
            ("Pause replay", "Hold the replay; the images stay (P)", BenchCommand::Pause)
        };
        let button = Button::new(text).min_size(egui::Vec2::new(110.0, 24.0));
        if ui.add_enabled(is_playing, button).on_hover_text(hover).clicked() {
            wishes.ask(command);
        }
        let end =
            ui.add_enabled(is_playing, Button::new("End")).on_hover_text("End the replay in good order (F)");
        if end.clicked() {
            wishes.ask(BenchCommand::Finish);
        }
        for (speed, name) in SPEEDS {
            let hover = "Times the speed of the recording; the images are the same at every speed";
            if ui.selectable_label(replay.speed == speed, name).on_hover_text(hover).clicked() {
                wishes.ask(BenchCommand::ReplaySpeed(speed));
            }
        }
        place(ui, replay, form, wishes);
    });
}

fn place(ui: &mut Ui, replay: &ReplayStatus, form: &mut TransportForm, wishes: &mut Wishes) {
    let last = replay.exposures.saturating_sub(1);
    let mut at = form.wanted.unwrap_or_else(|| replay.position.min(last));
    let time = |exposure: u64| in_words(replay.period.mul_f64(exposure as f64));
    let text = format!("{} of {}", time(at), time(replay.exposures));
    ui.spacing_mut().slider_width = (ui.available_width() - 290.0).clamp(80.0, 1200.0);
    let label = ui.label("At exposure");
    let slider = ui
        .add(Slider::new(&mut at, 0..=last).update_while_editing(false))
        .labelled_by(label.id)
        .on_hover_text("Drag to another exposure; the running image begins anew there");
    ui.label(text).on_hover_text("Time of the recording");
    if slider.dragged() {
        form.wanted = Some(at);
    } else if slider.drag_stopped() || slider.changed() {
        form.wanted = None;
        wishes.ask(BenchCommand::Seek(at));
    }
}
