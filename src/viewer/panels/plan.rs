//! Plans: chosen or typed, judged, begun.

use super::{Own, Wishes, color_of, heading, in_bytes, in_words, suggested};
use crate::viewer::bench::{Activity, BenchCommand, BenchStatus, InstrumentCard, PlanEstimate};
use egui::{Button, RichText, ScrollArea, TextEdit, Ui, Vec2};

/// What is typed for a plan.
#[derive(Debug, Clone, Default)]
pub(in crate::viewer) struct PlanForm {
    pub(in crate::viewer) text: String,
    out: String,
    /// What the judgment said of which text.
    pub(in crate::viewer) judged: Option<(String, Result<PlanEstimate, String>)>,
}

/// Draws the panel.
pub(in crate::viewer) fn plan(
    ui: &mut Ui,
    status: &BenchStatus,
    card: &InstrumentCard,
    form: &mut PlanForm,
    wishes: &mut Wishes,
) {
    if form.text.is_empty()
        && let Some((_, text)) = card.plans.first()
    {
        form.text.clone_from(text);
    }
    if form.out.is_empty() {
        form.out = suggested("sofiscope-run");
    }
    heading(ui, "Plan");
    ui.horizontal_wrapped(|ui| {
        for (name, text) in &card.plans {
            if ui.selectable_label(form.text == *text, name).clicked() {
                form.text.clone_from(text);
            }
        }
    });
    ScrollArea::vertical().id_salt("plan-text").max_height(260.0).show(ui, |ui| {
        ui.add(
            TextEdit::multiline(&mut form.text).code_editor().desired_rows(14).desired_width(f32::INFINITY),
        )
        .on_hover_text("YAML or JSON in the shape of useq-schema");
    });
    ui.horizontal(|ui| {
        let label = ui.label("Into");
        ui.add(TextEdit::singleline(&mut form.out).desired_width(200.0))
            .labelled_by(label.id)
            .on_hover_text("A directory that must not exist yet");
    });
    let is_judged = form.judged.as_ref().is_some_and(|(text, _)| *text == form.text);
    let may_begin = is_judged && matches!(&form.judged, Some((_, Ok(estimate))) if estimate.may_begin);
    ui.horizontal(|ui| {
        if ui.button("Check plan").on_hover_text("Pre-flight: disk, memory, limits, dyes").clicked() {
            wishes.own.push(Own::JudgePlan);
        }
        let is_free = matches!(status.activity, Activity::Idle | Activity::Live | Activity::Replay);
        let run = Button::new(RichText::new("Run").size(17.0)).min_size(Vec2::new(110.0, 32.0));
        let hover = if may_begin { "Acquire, record and analyze" } else { "Check the plan first" };
        if ui
            .add_enabled(is_free && may_begin, run)
            .on_hover_text(hover)
            .on_disabled_hover_text(hover)
            .clicked()
        {
            wishes.ask(BenchCommand::Run { plan: form.text.clone(), out: form.out.trim().into() });
            form.out.clear();
        }
    });
    if let (true, Some((_, judgment))) = (is_judged, &form.judged) {
        judgment_of(ui, judgment);
    }
    run(ui, status, wishes);
}

fn judgment_of(ui: &mut Ui, judgment: &Result<PlanEstimate, String>) {
    match judgment {
        Err(faults) => {
            for fault in faults.lines() {
                ui.label(RichText::new(fault).color(color_of(crate::viewer::bench::Gravity::Error)));
            }
        }
        Ok(estimate) => {
            let exposures =
                estimate.exposures.map_or("no certain number of".to_owned(), |number| number.to_string());
            let time = estimate.duration.map_or(String::new(), |time| format!(", {}", in_words(time)));
            let bytes = estimate.bytes.map_or(String::new(), |bytes| format!(", {}", in_bytes(bytes)));
            ui.label(format!("{} series of {exposures} exposures{time}{bytes}", estimate.series));
            for (gravity, check) in &estimate.checks {
                ui.label(RichText::new(check).color(color_of(*gravity)).small());
            }
        }
    }
}

fn run(ui: &mut Ui, status: &BenchStatus, wishes: &mut Wishes) {
    let is_running = matches!(status.activity, Activity::Run | Activity::Paused | Activity::Ending);
    if !is_running {
        return;
    }
    heading(ui, "Run");
    ui.horizontal(|ui| {
        let is_paused = status.activity == Activity::Paused;
        if ui.add_enabled(status.activity == Activity::Run, Button::new("Pause")).clicked() {
            wishes.ask(BenchCommand::Pause);
        }
        if ui.add_enabled(is_paused, Button::new("Resume")).clicked() {
            wishes.ask(BenchCommand::Resume);
        }
        let hover = "End in good order: everything so far is kept and analyzed";
        if ui
            .add_enabled(status.activity != Activity::Ending, Button::new("Finish run"))
            .on_hover_text(hover)
            .clicked()
        {
            wishes.ask(BenchCommand::Finish);
        }
    });
}
