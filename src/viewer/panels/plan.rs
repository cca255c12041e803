//! Plans: chosen or typed, judged, begun.

use super::{Own, Wishes, color_of, heading, in_bytes, in_words, suggested};
use crate::viewer::bench::{Activity, BenchCommand, BenchStatus, Gravity, InstrumentCard, PlanEstimate};
use egui::{Button, CollapsingHeader, RichText, ScrollArea, TextEdit, Ui, Vec2};
use std::path::PathBuf;

/// What is typed for a plan.
#[derive(Debug, Clone, Default)]
pub(in crate::viewer) struct PlanForm {
    pub(in crate::viewer) text: String,
    out: String,
    /// The directory that was suggested last: another one takes its place as long as nobody types.
    suggestion: String,
    /// What the window knew to be saved when that was suggested.
    saved: Option<PathBuf>,
    /// What the judgment said of which text.
    pub(in crate::viewer) judged: Option<(String, Result<PlanEstimate, String>)>,
}

impl PlanForm {
    fn suggest(&mut self, status: &BenchStatus) {
        self.suggestion = suggested("sofiscope-run");
        self.out.clone_from(&self.suggestion);
        self.saved.clone_from(&status.last_saved);
    }

    /// What the judgment of the present text says; none of a text that was changed since.
    fn judgment(&self) -> Option<&Result<PlanEstimate, String>> {
        self.judged.as_ref().filter(|(text, _)| *text == self.text).map(|(_, judgment)| judgment)
    }

    /// Whether the plan can begin at all; none before it was judged.
    pub(in crate::viewer) fn may_begin(&self) -> Option<bool> {
        self.judgment().map(|judgment| judgment.as_ref().is_ok_and(|estimate| estimate.may_begin))
    }

    /// The command to begin, into a directory that is still free where nobody typed another one.
    pub(in crate::viewer) fn begin(&mut self, status: &BenchStatus) -> BenchCommand {
        if self.out == self.suggestion {
            self.suggest(status);
        }
        BenchCommand::Run { plan: self.text.clone(), out: self.out.trim().into() }
    }

    /// Whether the plan may begin without another word of the person: it was judged, and nothing is to be warned of.
    pub(in crate::viewer) fn is_clear(&self) -> bool {
        self.judgment().is_some_and(|judgment| {
            judgment.as_ref().is_ok_and(|estimate| {
                estimate.may_begin && estimate.checks.iter().all(|(gravity, _)| *gravity == Gravity::Note)
            })
        })
    }
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
    if form.out.is_empty() || (form.saved != status.last_saved && form.out == form.suggestion) {
        form.suggest(status);
    }
    heading(ui, "Plan");
    ui.horizontal_wrapped(|ui| {
        for (name, text) in &card.plans {
            let hover = format!("Begin with the plan '{name}'; what is typed below is replaced");
            if ui.selectable_label(form.text == *text, name).on_hover_text(hover).clicked() {
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
    let may_begin = form.may_begin();
    ui.horizontal(|ui| {
        if ui.button("Check plan").on_hover_text("Pre-flight: disk, memory, limits, dyes").clicked() {
            wishes.own.push(Own::JudgePlan);
        }
        let is_free = matches!(status.activity, Activity::Idle | Activity::Live | Activity::Replay);
        let (text, hover) = match may_begin {
            Some(true) if !form.is_clear() => {
                ("Run all the same", "Acquire and analyze in spite of the warnings below (Ctrl+Enter)")
            }
            Some(true) => ("Run", "Acquire and analyze, and record if the plan says so"),
            Some(false) => ("Run", "The plan cannot begin; see below what to change"),
            None => ("Run", "Check the plan, and begin unless there is something to warn of (Ctrl+Enter)"),
        };
        let run = Button::new(RichText::new(text).size(17.0)).min_size(Vec2::new(110.0, 32.0));
        let run = ui.add_enabled(is_free && may_begin != Some(false), run);
        if run.on_hover_text(hover).on_disabled_hover_text(hover).clicked() {
            match may_begin {
                Some(_) => wishes.ask(form.begin(status)),
                None => wishes.own.push(Own::CheckAndRun),
            }
        }
    });
    if let Some(judgment) = form.judgment() {
        judgment_of(ui, judgment);
    }
}

fn judgment_of(ui: &mut Ui, judgment: &Result<PlanEstimate, String>) {
    match judgment {
        Err(faults) => {
            for fault in faults.lines() {
                ui.label(RichText::new(fault).color(color_of(Gravity::Error)));
            }
        }
        Ok(estimate) => {
            let exposures =
                estimate.exposures.map_or("no certain number of".to_owned(), |number| number.to_string());
            let time = estimate.duration.map_or(String::new(), |time| format!(", {}", in_words(time)));
            let bytes = estimate.bytes.map_or(String::new(), |bytes| format!(", {}", in_bytes(bytes)));
            ui.label(format!("{} series of {exposures} exposures{time}{bytes}", estimate.series));
            let (passed, others): (Vec<_>, Vec<_>) =
                estimate.checks.iter().partition(|(gravity, _)| *gravity == Gravity::Note);
            let tell = |ui: &mut Ui, (gravity, check): &(Gravity, String)| {
                ui.label(RichText::new(check).color(color_of(*gravity)).small());
            };
            others.into_iter().for_each(|check| tell(ui, check));
            let title = format!("{} checks passed", passed.len());
            CollapsingHeader::new(title).id_salt("passed").show(ui, |ui| {
                passed.into_iter().for_each(|check| tell(ui, check));
            });
        }
    }
}

/// Draws what can be done with the run under way, above whatever else the side shows.
pub(in crate::viewer) fn run(ui: &mut Ui, status: &BenchStatus, wishes: &mut Wishes) {
    let is_running = matches!(status.activity, Activity::Run | Activity::Paused | Activity::Ending);
    if !is_running {
        return;
    }
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
    ui.separator();
}
