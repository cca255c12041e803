//! The bar at the top: which instrument, what it does, what was lost, and STOP in its place.

use super::{Own, Wishes, color_of};
use crate::viewer::bench::{Activity, BenchCommand, BenchStatus, Gravity};
use crate::viewer::settings::WindowSettings;
use egui::{Align, Button, Color32, Layout, RichText, Ui, Vec2};

/// Draws the bar.
pub(in crate::viewer) fn top(
    ui: &mut Ui,
    status: &BenchStatus,
    settings: &mut WindowSettings,
    undo: (bool, bool),
    wishes: &mut Wishes,
) -> (bool, bool) {
    let mut undone = (false, false);
    ui.horizontal(|ui| {
        ui.set_height(34.0);
        match &status.instrument {
            Some(card) => {
                ui.label(RichText::new(&card.name).strong().size(16.0));
                if let Some(label) = &card.label {
                    let text = RichText::new(format!(" {label} ")).strong().color(Color32::BLACK);
                    ui.label(text.background_color(color_of(Gravity::Warning)))
                        .on_hover_text("No hardware is involved: what the cameras show is simulated.");
                }
            }
            None => {
                ui.label(RichText::new("sofiscope").strong().size(16.0));
            }
        }
        ui.separator();
        let is_held = status.replay.as_ref().is_some_and(|replay| replay.is_paused);
        let is_recorded = status.run.recording.is_some();
        let now = match &status.activity {
            Activity::Replay if is_held => "replay held",
            Activity::Run if !is_recorded => "RUN, not recorded",
            other => activity(other),
        };
        ui.label(RichText::new(now).size(15.0));
        let run = &status.run;
        if status.activity != Activity::Closed {
            ui.separator();
            if status.activity != Activity::Idle {
                let [r, t] = run.frame_rate;
                ui.label(format!("{r:.1} | {t:.1} frames/s"))
                    .on_hover_text("Frames per second of camera R and camera T");
                ui.separator();
            }
            losses(ui, status);
        }
        ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
            let red = Color32::from_rgb(200, 30, 30);
            let stop = Button::new(RichText::new("STOP").strong().size(19.0).color(Color32::WHITE)).fill(red);
            let hover = "Lasers off, motion stopped, run aborted (Ctrl+. or Esc twice)";
            if ui.add_sized(Vec2::new(96.0, 32.0), stop).on_hover_text(hover).clicked() {
                wishes.stop = true;
            }
            let menu = ui.menu_button("View", |ui| {
                ui.checkbox(&mut settings.shows_cameras, "Cameras beside the result")
                    .on_hover_text("Both cameras left of the result (C)");
                ui.checkbox(&mut settings.is_dark, "Dark theme").on_hover_text("Dark or light");
                ui.horizontal(|ui| {
                    ui.label("Size of writing");
                    if ui.button("A-").on_hover_text("Smaller (Ctrl+-)").clicked() {
                        settings.scale = (settings.scale - 0.1).max(0.6);
                    }
                    if ui.button("A+").on_hover_text("Larger (Ctrl++)").clicked() {
                        settings.scale = (settings.scale + 0.1).min(2.5);
                    }
                });
                let hover = "Panels, sizes and writing as they were at first; presets stay";
                if ui.button("Reset layout").on_hover_text(hover).clicked() {
                    wishes.own.push(Own::ResetLayout);
                }
                let hover = "Everything frequent has a key";
                if ui.button("Keyboard shortcuts (F1)").on_hover_text(hover).clicked() {
                    wishes.own.push(Own::Shortcuts);
                }
                let hover = "Lasers off, every device is released; the first screen comes back";
                if status.instrument.is_some() && ui.button("Close instrument").on_hover_text(hover).clicked()
                {
                    wishes.ask(BenchCommand::CloseInstrument);
                }
            });
            menu.response.on_hover_text("Layout, theme, size of writing, keys");
            undone.1 = ui
                .add_enabled(undo.1, Button::new("Redo"))
                .on_hover_text("View and contrast (Ctrl+Y)")
                .on_disabled_hover_text("No change of view or contrast was taken back (Ctrl+Y)")
                .clicked();
            undone.0 = ui
                .add_enabled(undo.0, Button::new("Undo"))
                .on_hover_text("View and contrast (Ctrl+Z)")
                .on_disabled_hover_text("View and contrast are as they were at first (Ctrl+Z)")
                .clicked();
        });
    });
    undone
}

fn activity(activity: &Activity) -> &'static str {
    match activity {
        Activity::Closed => "no instrument",
        Activity::Opening => "opening the instrument ...",
        Activity::Idle => "ready",
        Activity::Live => "LIVE, not recorded",
        Activity::Run => "RUN, recording",
        Activity::Paused => "run paused",
        Activity::Replay => "replay of a recording",
        Activity::Ending => "finishing ...",
    }
}

/// Always there, so that nobody has to look for it when it matters.
fn losses(ui: &mut Ui, status: &BenchStatus) {
    let lost: u64 = status.run.lost.iter().map(|(_, frames)| frames).sum::<u64>() + status.run.unrecorded;
    if lost == 0 {
        ui.label("0 frames lost");
    } else {
        let mut reasons: Vec<String> =
            status.run.lost.iter().map(|(reason, frames)| format!("{frames} {reason}")).collect();
        if status.run.unrecorded > 0 {
            reasons.push(format!("{} not recorded", status.run.unrecorded));
        }
        let text = format!("{lost} frames LOST: {}", reasons.join(", "));
        ui.label(RichText::new(text).strong().color(color_of(Gravity::Error)));
    }
    if status.run.left_out > 0 {
        ui.separator();
        let text = format!("{} pairs not analyzed", status.run.left_out);
        ui.label(RichText::new(text).color(color_of(Gravity::Warning))).on_hover_text(
            "The computer is short of time: frames are kept, and the analysis leaves these out.",
        );
    }
}
