//! The focus lock: what it does, how well, and what can be asked of it.

use super::{Wishes, color_of, heading};
use crate::viewer::bench::{Activity, BenchCommand, BenchStatus, FocusAsk, FocusStatus, Gravity};
use egui::{Button, DragValue, RichText, Ui};
use egui_plot::{HLine, Line, Plot};

/// Step of the drive by hand.
#[derive(Debug, Clone, Copy)]
pub(in crate::viewer) struct FocusForm {
    step_nm: f64,
}

impl Default for FocusForm {
    fn default() -> Self {
        Self { step_nm: 100.0 }
    }
}

/// Draws the focus lock.
pub(super) fn focus(ui: &mut Ui, status: &BenchStatus, form: &mut FocusForm, wishes: &mut Wishes) {
    heading(ui, "Focus lock");
    let Some(focus) = &status.focus else {
        ui.label("This instrument has none.");
        return;
    };
    let newest = focus.trace.last().map_or(String::new(), |(_, error)| format!(", {error:.1} nm"));
    let quality = focus.quality.map_or(String::new(), |quality| format!(", {:.0} % good", quality * 100.0));
    let place = focus.z_um.map_or(String::new(), |z_um| format!("   z {z_um:.3} µm"));
    ui.label(format!("{}{newest}{quality}{place}", focus.state))
        .on_hover_text("State, newest focus error, share of good readings lately, place of the drive");
    if let Some(reason) = &focus.reason {
        ui.label(RichText::new(reason).color(color_of(Gravity::Warning)));
    }
    controls(ui, status, focus, form, wishes);
    trace(ui, focus);
}

fn controls(
    ui: &mut Ui,
    status: &BenchStatus,
    focus: &FocusStatus,
    form: &mut FocusForm,
    wishes: &mut Wishes,
) {
    let is_run = matches!(status.activity, Activity::Run | Activity::Paused | Activity::Ending);
    let is_off = matches!(focus.state.as_str(), "off" | "lost" | "not locked");
    let mut button = |ui: &mut Ui, may: bool, text: &str, hover: &str, ask: FocusAsk| {
        let button = ui.add_enabled(may, Button::new(text)).on_hover_text(hover);
        let why = if is_run { "The lock belongs to the run under way" } else { hover };
        if button.on_disabled_hover_text(why).clicked() {
            wishes.ask(BenchCommand::Focus(ask));
        }
    };
    ui.horizontal(|ui| {
        let lock = if focus.is_calibrated {
            "Find the signal and hold it"
        } else {
            "Not calibrated yet: focus on the sample by hand, then calibrate"
        };
        button(ui, is_off && focus.is_calibrated, "Lock", lock, FocusAsk::Lock);
        button(ui, !is_run && !is_off, "Release", "Stand still at this place", FocusAsk::Release);
        let hover = "Sweep 2 µm to both sides and learn how signal and focus go together; takes ten seconds";
        button(ui, !is_run && is_off, "Calibrate", hover, FocusAsk::Calibrate);
    });
    ui.horizontal(|ui| {
        let label = ui.label("Step");
        ui.add(DragValue::new(&mut form.step_nm).range(1.0..=5000.0).speed(5.0).suffix(" nm"))
            .labelled_by(label.id)
            .on_hover_text("How far each step goes, 1 to 5000 nm");
        let hover = "Moves the drive, while the lock is off";
        button(ui, !is_run && is_off, "focus up", hover, FocusAsk::MoveBy(form.step_nm));
        button(ui, !is_run && is_off, "focus down", hover, FocusAsk::MoveBy(-form.step_nm));
    });
}

fn trace(ui: &mut Ui, focus: &FocusStatus) {
    if focus.trace.is_empty() {
        ui.label(RichText::new("No focus error yet: its trace begins when the lock holds.").small());
        return;
    }
    let squares: f64 = focus.trace.iter().map(|(_, error)| error * error).sum();
    let rms = (squares / focus.trace.len() as f64).sqrt();
    ui.label(RichText::new(format!("{rms:.1} nm rms")).small());
    let points: Vec<[f64; 2]> = focus.trace.iter().map(|&(time, error)| [time, error]).collect();
    Plot::new("focus")
        .height(90.0)
        .show_x(false)
        .allow_drag(false)
        .allow_zoom(false)
        .allow_scroll(false)
        .y_axis_label("nm")
        .show(ui, |plot| {
            plot.hline(HLine::new("focus", 0.0));
            plot.line(Line::new("error", points));
        });
}
