//! The instrument: lasers, stage, focus lock, properties.

use super::{Wishes, color_of, heading};
use crate::viewer::bench::{
    Activity, BenchCommand, BenchStatus, FocusStatus, Gravity, InstrumentCard, LaserStatus, LiveSettings,
};
use egui::{Button, CollapsingHeader, Color32, DragValue, RichText, Ui};
use egui_plot::{HLine, Line, Plot};
use std::collections::BTreeMap;

/// What is typed for the stage, and places that were kept.
#[derive(Debug, Clone)]
pub(in crate::viewer) struct StageForm {
    target_um: Option<[f64; 2]>,
    step_um: f64,
    places: Vec<[f64; 2]>,
    /// Lines that are armed, with their powers.
    powers_mw: BTreeMap<u32, (bool, f64)>,
}

impl Default for StageForm {
    fn default() -> Self {
        Self { target_um: None, step_um: 10.0, places: Vec::new(), powers_mw: BTreeMap::new() }
    }
}

/// Draws the panel.
pub(in crate::viewer) fn instrument(
    ui: &mut Ui,
    status: &BenchStatus,
    card: &InstrumentCard,
    form: &mut StageForm,
    settings: &mut LiveSettings,
    wishes: &mut Wishes,
) {
    heading(ui, "Lasers");
    if status.lasers.is_empty() {
        ui.label("This instrument has none in its hand.");
    }
    for laser in &status.lasers {
        line(ui, laser, form);
    }
    settings.laser_power_mw = form
        .powers_mw
        .iter()
        .filter(|(_, (is_armed, power))| *is_armed && *power > 0.0)
        .map(|(line, (_, power))| (*line, *power))
        .collect();
    if !status.lasers.is_empty() {
        ui.label(RichText::new("Armed lines emit with the next Live, as long as it goes on.").small());
    }
    if let (Some(stage), Some(limits)) = (status.stage, card.stage_um) {
        heading(ui, "Stage");
        let moving = if stage.is_moving { "   moving" } else { "" };
        ui.label(format!("x {:.2} µm   y {:.2} µm{moving}", stage.x_um, stage.y_um));
        stage_controls(ui, [stage.x_um, stage.y_um], limits, form, wishes);
    }
    if let Some(focus) = &status.focus {
        heading(ui, "Focus lock");
        focus_trace(ui, focus);
    }
    heading(ui, "Devices");
    for warning in &card.warnings {
        ui.label(RichText::new(warning).color(color_of(Gravity::Warning)));
    }
    for device in &card.devices {
        let mark = if device.is_simulated { "  (simulated)" } else { "" };
        CollapsingHeader::new(format!("{}{mark}", device.role)).id_salt(&device.identity).show(ui, |ui| {
            ui.label(&device.identity);
            for row in &device.properties {
                let range = if row.range.is_empty() { String::new() } else { format!("  ({})", row.range) };
                let lock = if row.is_writable { "" } else { "  read only" };
                ui.label(format!("{}: {} {}{range}", row.name, row.value, row.unit))
                    .on_hover_text(lock.trim());
            }
        });
    }
    if status.activity == Activity::Idle && ui.button("Close the instrument").clicked() {
        wishes.ask(BenchCommand::CloseInstrument);
    }
}

fn line(ui: &mut Ui, laser: &LaserStatus, form: &mut StageForm) {
    let (is_armed, power) = form.powers_mw.entry(laser.wavelength_nm).or_insert((false, 0.0));
    ui.horizontal(|ui| {
        let (text, color) = match laser.is_emitting {
            Some(true) => ("EMITTING", Color32::from_rgb(255, 80, 60)),
            Some(false) => ("dark", Color32::from_rgb(120, 170, 220)),
            None if laser.power_mw > 0.0 => ("told on", Color32::from_rgb(230, 159, 0)),
            None => ("told off", Color32::from_gray(150)),
        };
        let name = format!("{} nm", laser.wavelength_nm);
        ui.checkbox(is_armed, RichText::new(&name).strong()).on_hover_text("Arm this line for the next Live");
        let value = DragValue::new(power).range(0.0..=laser.cap_mw).speed(0.1).suffix(" mW");
        ui.add(value)
            .on_hover_text(format!("Power of {name}, at most {} mW on this instrument", laser.cap_mw));
        ui.label(RichText::new(text).strong().color(color)).on_hover_text(&laser.identity);
        match laser.interlock_closed {
            Some(false) => {
                ui.label(RichText::new("interlock OPEN").color(color_of(Gravity::Error)));
            }
            Some(true) => {
                ui.label(RichText::new("interlock closed").small());
            }
            None => {}
        }
    });
}

fn stage_controls(
    ui: &mut Ui,
    here: [f64; 2],
    [x_limits, y_limits]: [(f64, f64); 2],
    form: &mut StageForm,
    wishes: &mut Wishes,
) {
    let mut go = |[x_um, y_um]: [f64; 2]| wishes.ask(BenchCommand::MoveStage { x_um, y_um });
    let target = form.target_um.get_or_insert(here);
    ui.horizontal(|ui| {
        for (axis, (name, limits)) in [("x", x_limits), ("y", y_limits)].into_iter().enumerate() {
            let label = ui.label(name);
            let value = DragValue::new(&mut target[axis]).range(limits.0..=limits.1).speed(1.0).suffix(" µm");
            ui.add(value).labelled_by(label.id).on_hover_text(format!("{} to {} µm", limits.0, limits.1));
        }
        if ui.button("Move").clicked() {
            go(*target);
        }
    });
    ui.horizontal(|ui| {
        let label = ui.label("Step");
        ui.add(DragValue::new(&mut form.step_um).range(0.1..=5000.0).speed(0.5).suffix(" µm"))
            .labelled_by(label.id);
        let step = form.step_um;
        for (text, hover, by) in [
            ("left", "Move left", [-step, 0.0]),
            ("right", "Move right", [step, 0.0]),
            ("up", "Move up", [0.0, -step]),
            ("down", "Move down", [0.0, step]),
        ] {
            if ui.button(text).on_hover_text(hover).clicked() {
                go([here[0] + by[0], here[1] + by[1]]);
            }
        }
    });
    ui.label(RichText::new("Right click in an image brings that place to the middle.").small());
    if ui.button("Keep this place").clicked() {
        form.places.push(here);
    }
    let mut removed = None;
    for (index, place) in form.places.iter().enumerate() {
        ui.horizontal(|ui| {
            ui.label(format!("{}:  {:.1}, {:.1} µm", index + 1, place[0], place[1]));
            if ui.add(Button::new("go").small()).on_hover_text(format!("Go to place {}", index + 1)).clicked()
            {
                go(*place);
            }
            if ui
                .add(Button::new("remove").small())
                .on_hover_text(format!("Remove place {}", index + 1))
                .clicked()
            {
                removed = Some(index);
            }
        });
    }
    if let Some(index) = removed {
        form.places.remove(index);
    }
}

fn focus_trace(ui: &mut Ui, focus: &FocusStatus) {
    let newest = focus.trace.last().map_or(String::new(), |(_, error)| format!(", {error:.1} nm"));
    ui.label(format!("{}{newest}", focus.state));
    if focus.trace.len() > 1 {
        let squares: f64 = focus.trace.iter().map(|(_, error)| error * error).sum();
        let rms = (squares / focus.trace.len() as f64).sqrt();
        ui.label(RichText::new(format!("{rms:.1} nm rms")).small());
    }
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
