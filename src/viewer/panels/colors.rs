//! How the dyes divide between the cameras, from regions that the person marks.

use super::{Wishes, color_of, heading, suggested_file};
use crate::viewer::bench::{
    Activity, BenchCommand, BenchStatus, ColorsAsk, ColorsStep, FoundShare, Gravity, MarkedRegions,
};
use egui::{Button, Color32, ComboBox, DragValue, ProgressBar, RichText, TextEdit, Ui};

/// Side that a region must have at least, pixels.
const LEAST_SIDE: u32 = 8;

/// What a rectangle that is drawn becomes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
enum Marks {
    #[default]
    Dye,
    Background,
}

/// What is chosen, marked and typed.
#[derive(Debug, Clone)]
pub(in crate::viewer) struct ColorsForm {
    /// Whether this is shown, not the registration of the cameras.
    pub(in crate::viewer) is_shown: bool,
    dye: Option<String>,
    marks: Marks,
    marked: MarkedRegions,
    /// The rectangle that is being drawn.
    drawing: Option<[u32; 4]>,
    /// Why the last rectangle was not taken.
    refused: Option<String>,
    frames: usize,
    file: Option<String>,
}

impl Default for ColorsForm {
    fn default() -> Self {
        Self {
            is_shown: false,
            dye: None,
            marks: Marks::Dye,
            marked: MarkedRegions::default(),
            drawing: None,
            refused: None,
            frames: 100,
            file: None,
        }
    }
}

impl ColorsForm {
    /// The rectangle under the pointer, pixels of the sensor; none when it is let go, which marks it.
    pub(in crate::viewer) fn draw(&mut self, rectangle: Option<[u32; 4]>) {
        if rectangle.is_some() {
            self.drawing = rectangle;
            return;
        }
        let Some(area) = self.drawing.take() else { return };
        let [_, _, width, height] = area;
        let is_small = width.min(height) < LEAST_SIDE;
        self.refused = is_small.then(|| {
            format!(
                "{width} x {height} px are too small; a region needs at least {LEAST_SIDE} x {LEAST_SIDE} px"
            )
        });
        match self.marks {
            _ if is_small => {}
            Marks::Dye => self.marked.dye.push(area),
            Marks::Background => self.marked.background = Some(area),
        }
    }

    /// Everything marked, in pixels of the sensor, with its color and name.
    pub(in crate::viewer) fn marks(&self) -> Vec<([u32; 4], Color32, String)> {
        let dye = self.marked.dye.iter().enumerate();
        let dye = dye.map(|(index, area)| (*area, DYE, (index + 1).to_string()));
        let background =
            self.marked.background.iter().map(|area| (*area, BACKGROUND, "background".to_owned()));
        dye.chain(background).collect()
    }
}

/// Blue and orange are told apart by all eyes.
const DYE: Color32 = Color32::from_rgb(230, 159, 0);
const BACKGROUND: Color32 = Color32::from_rgb(120, 170, 220);

/// Draws the procedure.
pub(super) fn colors(ui: &mut Ui, status: &BenchStatus, form: &mut ColorsForm, wishes: &mut Wishes) {
    heading(ui, "Colors of the dyes");
    ui.label("T is the share of a dye's light that reaches camera T. The unmixing goes by it.");
    if status.colors.is_of_session {
        let forget = ui.button("Stop using measured shares").on_hover_text(
            "The next live view and run go by the instrument's own coefficients again; files that were written stay",
        );
        if forget.clicked() {
            wishes.ask(BenchCommand::Colors(ColorsAsk::Forget));
        }
    }
    if status.registration.in_use.is_none() {
        let text = "No registration is in use: the cameras are taken as aligned. Register them first unless they are.";
        ui.label(RichText::new(text).color(color_of(Gravity::Warning)));
    }
    ui.add_space(6.0);
    choose_dye(ui, status, form);
    ui.add_space(6.0);
    mark(ui, form);
    ui.add_space(6.0);
    begin(ui, status, form, wishes);
    ui.add_space(6.0);
    step(ui, &status.colors.step, form, wishes);
}

fn choose_dye(ui: &mut Ui, status: &BenchStatus, form: &mut ColorsForm) {
    ui.label(RichText::new("1. Dye").strong());
    let card = status.instrument.as_deref();
    let known = card.map(|card| card.known_species.clone()).unwrap_or_default();
    ui.horizontal(|ui| {
        let label = ui.label("Dye to measure");
        let shown = form.dye.clone().unwrap_or_else(|| "choose".to_owned());
        let list = ComboBox::from_id_salt("dye to measure").selected_text(shown).show_ui(ui, |ui| {
            for name in known {
                if ui.selectable_label(form.dye.as_ref() == Some(&name), &name).clicked() {
                    // What was marked shows another dye.
                    form.marked.dye.clear();
                    form.dye = Some(name);
                }
            }
        });
        list.response.labelled_by(label.id).on_hover_text("The dye whose share of light is measured");
    });
    let Some(dye) = &form.dye else { return };
    let in_use = status.colors.in_use.iter().find(|in_use| in_use.dye == *dye);
    ui.label(in_use.map_or_else(
        || "In use: nothing is known of this dye behind this dichroic".to_owned(),
        |in_use| format!("In use: T = {:.4}, from {}", in_use.transmission, in_use.from),
    ));
}

fn mark(ui: &mut Ui, form: &mut ColorsForm) {
    ui.label(RichText::new("2. Regions").strong());
    ui.label("Drag with Ctrl in the image of camera R around places with only this dye.");
    ui.horizontal(|ui| {
        ui.radio_value(&mut form.marks, Marks::Dye, "Mark the dye")
            .on_hover_text("Rectangles hold this dye and no other, 2 pixels away from others");
        ui.radio_value(&mut form.marks, Marks::Background, "Mark background").on_hover_text(
            "A region without any dye, if you like: evenly stained places need it. Without it, what surrounds the \
             dye within its regions counts as background",
        );
    });
    let background = if form.marked.background.is_some() { "one region" } else { "the surroundings" };
    let regions = form.marked.dye.len();
    let word = if regions == 1 { "region" } else { "regions" };
    ui.horizontal_wrapped(|ui| {
        ui.label(format!("{regions} {word} of the dye; background: {background}"));
        let has_marks = form.marked != MarkedRegions::default();
        let clear = ui.add_enabled(has_marks, Button::new("Clear regions"));
        let clear = clear.on_hover_text("Forget all regions, that of the background too");
        if clear.on_disabled_hover_text("Nothing is marked").clicked() {
            form.marked = MarkedRegions::default();
        }
    });
    if let Some(refused) = &form.refused {
        ui.label(RichText::new(refused).color(color_of(Gravity::Warning)));
    }
}

fn begin(ui: &mut Ui, status: &BenchStatus, form: &mut ColorsForm, wishes: &mut Wishes) {
    ui.label(RichText::new("3. Frames").strong());
    ui.horizontal(|ui| {
        let label = ui.label("Frames");
        ui.add(DragValue::new(&mut form.frames).range(20..=5000))
            .labelled_by(label.id)
            .on_hover_text("Frames of both cameras that are taken from the live view");
        let is_at_work = matches!(status.colors.step, ColorsStep::Gathering { .. } | ColorsStep::Working);
        let why = match (&status.activity, &form.dye) {
            (Activity::Run | Activity::Paused | Activity::Ending, _) => {
                Some("Not during a run: finish it first, then start the live view (L)")
            }
            (Activity::Live, _) if is_at_work => Some("Already under way"),
            (Activity::Live, None) => Some("Choose a dye first"),
            (Activity::Live, Some(_)) if form.marked.dye.is_empty() => {
                Some("Mark a region with this dye first: drag with Ctrl in the image of camera R")
            }
            (Activity::Live, Some(_)) => None,
            _ => Some("Start the live view first (L)"),
        };
        let measure = ui
            .add_enabled(why.is_none(), Button::new("Measure"))
            .on_hover_text(
                "Take frames and find the share of this dye's light on camera T; nothing changes yet",
            )
            .on_disabled_hover_text(why.unwrap_or_default());
        if let (true, Some(dye)) = (measure.clicked(), form.dye.clone()) {
            let (marked, frames) = (form.marked.clone(), form.frames);
            wishes.ask(BenchCommand::Colors(ColorsAsk::Begin { dye, marked, frames }));
        }
    });
}

fn step(ui: &mut Ui, step: &ColorsStep, form: &mut ColorsForm, wishes: &mut Wishes) {
    let discard = BenchCommand::Colors(ColorsAsk::Discard);
    match step {
        ColorsStep::Idle => {}
        ColorsStep::Gathering { taken, wanted } => {
            let share = *taken as f32 / (*wanted).max(1) as f32;
            ui.add(ProgressBar::new(share).text(format!("{taken} of {wanted} frames")));
            if ui.button("Cancel").clicked() {
                wishes.ask(discard);
            }
        }
        ColorsStep::Working => {
            ui.label("Working it out ...");
        }
        ColorsStep::Failed(why) => {
            ui.label(RichText::new(why).color(color_of(Gravity::Error)));
            if ui.button("Discard").on_hover_text("Everything stays as it was").clicked() {
                wishes.ask(discard);
            }
        }
        ColorsStep::Found(found) => {
            ui.label(RichText::new("4. Result").strong());
            result(ui, found);
            let file = form.file.get_or_insert_with(|| suggested_file("response", "toml"));
            ui.horizontal(|ui| {
                let label = ui.label("File");
                ui.add(TextEdit::singleline(file).desired_width(220.0)).labelled_by(label.id);
            });
            let path = file.trim().to_owned();
            ui.horizontal(|ui| {
                let hover = "The next live view and run go by it; it is written into the file with where it comes from";
                let keep = ui.add_enabled(!path.is_empty(), Button::new("Use")).on_hover_text(hover);
                if keep.on_disabled_hover_text("Name a file first").clicked() {
                    wishes.ask(BenchCommand::Colors(ColorsAsk::Use(path.into())));
                    form.file = None;
                }
                if ui.button("Discard").on_hover_text("Everything stays as it was").clicked() {
                    wishes.ask(discard);
                    form.file = None;
                }
            });
        }
    }
}

fn result(ui: &mut Ui, found: &FoundShare) {
    let FoundShare { dye, transmission, uncertainty, in_use, frames, warnings } = found;
    ui.label(RichText::new(format!("{dye}: T = {transmission:.4} +/- {uncertainty:.4}")).strong())
        .on_hover_text(format!(
            "From {frames} frames; the interval holds the truth in 95 of 100 measurements"
        ));
    let (text, gravity) = match (in_use, found.agrees()) {
        (Some(in_use), Some(true)) => (
            format!("Agrees with T = {:.4} in use, from {}.", in_use.transmission, in_use.from),
            Gravity::Note,
        ),
        (Some(in_use), _) => {
            let off = (transmission - in_use.transmission).abs();
            let text = format!(
                "Does not agree with T = {:.4} in use, from {}: they differ by {off:.4}.",
                in_use.transmission, in_use.from
            );
            (text, Gravity::Warning)
        }
        (None, _) => ("Nothing is in use for this dye yet.".to_owned(), Gravity::Note),
    };
    ui.label(RichText::new(text).color(color_of(gravity)));
    for warning in warnings {
        ui.label(RichText::new(warning).color(color_of(Gravity::Warning)));
    }
}
