//! The instrument: lasers, stage, focus lock, properties.

use super::focus::focus;
use super::lasers::lasers;
use super::properties::devices;
use super::{Forms, Wishes, heading};
use crate::viewer::bench::{Activity, BenchCommand, BenchStatus, InstrumentCard};
use egui::{Button, DragValue, RichText, Ui};

/// What is typed for the stage, and places that were kept.
#[derive(Debug, Clone)]
pub(in crate::viewer) struct StageForm {
    target_um: Option<[f64; 2]>,
    step_um: f64,
    places: Vec<[f64; 2]>,
}

impl Default for StageForm {
    fn default() -> Self {
        Self { target_um: None, step_um: 10.0, places: Vec::new() }
    }
}

/// Draws the panel.
pub(in crate::viewer) fn instrument(
    ui: &mut Ui,
    status: &BenchStatus,
    card: &InstrumentCard,
    forms: &mut Forms,
    wishes: &mut Wishes,
) {
    lasers(ui, status, &mut forms.lasers, &mut forms.live.settings);
    heading(ui, "Stage");
    match (status.stage, card.stage_um) {
        (Some(stage), Some(limits)) => {
            let moving = if stage.is_moving { "   moving" } else { "" };
            ui.label(format!("x {:.2} µm   y {:.2} µm{moving}", stage.x_um, stage.y_um));
            stage_controls(ui, [stage.x_um, stage.y_um], limits, &mut forms.stage, wishes);
        }
        (None, Some(_)) => {
            ui.label("The stage does not tell its place; look at the events.");
        }
        (_, None) => {
            ui.label("This instrument has none.");
        }
    }
    focus(ui, status, &mut forms.focus, wishes);
    devices(ui, status, card, &mut forms.properties, wishes);
    let hover = "Lasers off, every device is released; the first screen comes back";
    if status.activity == Activity::Idle && ui.button("Close the instrument").on_hover_text(hover).clicked() {
        wishes.ask(BenchCommand::CloseInstrument);
    }
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
        if ui.button("Move").on_hover_text("Go to x and y; Ctrl+. stops it").clicked() {
            go(*target);
        }
    });
    ui.horizontal(|ui| {
        let label = ui.label("Step");
        ui.add(DragValue::new(&mut form.step_um).range(0.1..=5000.0).speed(0.5).suffix(" µm"))
            .labelled_by(label.id)
            .on_hover_text("How far each step goes, 0.1 to 5000 µm");
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
    let hover = "Adds the present place to the list below, to come back to it";
    if ui.button("Keep this place").on_hover_text(hover).clicked() {
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
