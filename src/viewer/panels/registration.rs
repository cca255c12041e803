//! The registration of the cameras, step by step.

use super::{Wishes, color_of, heading, suggested_file};
use crate::display::RgbImage;
use crate::viewer::bench::{
    Activity, BenchCommand, BenchStatus, FoundRegistration, Gravity, RegisterBy, RegistrationAsk,
    RegistrationStep,
};
use egui::{
    Button, ColorImage, DragValue, Image, ProgressBar, RichText, TextEdit, TextureHandle, TextureOptions, Ui,
    Vec2,
};
use std::sync::Arc;

/// What is chosen and typed, and the picture that is shown.
#[derive(Clone)]
pub(in crate::viewer) struct RegistrationForm {
    by: RegisterBy,
    frames: usize,
    file: Option<String>,
    picture: Option<(Arc<RgbImage>, TextureHandle)>,
}

impl Default for RegistrationForm {
    fn default() -> Self {
        Self { by: RegisterBy::Beads, frames: 100, file: None, picture: None }
    }
}

impl std::fmt::Debug for RegistrationForm {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { by, frames, file, picture: _ } = self;
        formatter
            .debug_struct("RegistrationForm")
            .field("by", by)
            .field("frames", frames)
            .field("file", file)
            .finish()
    }
}

/// Draws the procedure.
pub(super) fn registration(
    ui: &mut Ui,
    status: &BenchStatus,
    form: &mut RegistrationForm,
    wishes: &mut Wishes,
) {
    heading(ui, "Registration of the cameras");
    let registration = &status.registration;
    let in_use = registration.in_use.as_deref().unwrap_or("none; the cameras are taken as aligned");
    ui.label(format!("In use: {in_use}")).on_hover_text("What the next live view and run go by");
    if registration.is_of_session {
        let forget = ui.button("Stop using it").on_hover_text(
            "The next live view and run go by the file of the instrument again; the file that was written stays",
        );
        if forget.clicked() {
            wishes.ask(BenchCommand::Registration(RegistrationAsk::Forget));
        }
    }
    ui.add_space(6.0);
    let is_live = status.activity == Activity::Live;
    ui.label(RichText::new("1. Sample").strong());
    ui.label("Put beads on the stage, or a blinking sample, that both cameras see over the whole field.");
    ui.label(if is_live { "The live view runs." } else { "Start the live view (L)." });
    ui.add_space(6.0);
    ui.label(RichText::new("2. Frames").strong());
    ui.horizontal(|ui| {
        ui.radio_value(&mut form.by, RegisterBy::Beads, "Beads")
            .on_hover_text("Small beads that shine in both cameras; the most accurate");
        ui.radio_value(&mut form.by, RegisterBy::Blinking, "Blinking sample")
            .on_hover_text("What blinks together in both cameras; needs some hundred frames");
    });
    ui.horizontal(|ui| {
        let label = ui.label("Frames");
        ui.add(DragValue::new(&mut form.frames).range(10..=2000)).labelled_by(label.id).on_hover_text(
            "Frames of both cameras that are taken from the live view; their mean shows the beads",
        );
        let is_at_work =
            matches!(registration.step, RegistrationStep::Gathering { .. } | RegistrationStep::Working);
        let why = match status.activity {
            Activity::Run | Activity::Paused | Activity::Ending => {
                "Not during a run: finish it first, then start the live view (L)"
            }
            Activity::Live => "Already under way",
            _ => "Start the live view first (L)",
        };
        let register = ui
            .add_enabled(is_live && !is_at_work, Button::new("Register"))
            .on_hover_text("Take frames and find where camera R sees what camera T sees; nothing changes yet")
            .on_disabled_hover_text(why);
        if register.clicked() {
            let (by, frames) = (form.by, form.frames);
            wishes.ask(BenchCommand::Registration(RegistrationAsk::Begin { by, frames }));
        }
    });
    ui.add_space(6.0);
    step(ui, &registration.step, form, wishes);
}

fn step(ui: &mut Ui, step: &RegistrationStep, form: &mut RegistrationForm, wishes: &mut Wishes) {
    let discard = BenchCommand::Registration(RegistrationAsk::Discard);
    match step {
        RegistrationStep::Idle => {}
        RegistrationStep::Gathering { taken, wanted } => {
            let share = *taken as f32 / (*wanted).max(1) as f32;
            ui.add(ProgressBar::new(share).text(format!("{taken} of {wanted} frames")));
            if ui.button("Cancel").clicked() {
                wishes.ask(discard);
            }
        }
        RegistrationStep::Working => {
            ui.label("Working it out ...");
        }
        RegistrationStep::Failed(why) => {
            ui.label(RichText::new(why).color(color_of(Gravity::Error)));
            if ui.button("Discard").on_hover_text("Everything stays as it was").clicked() {
                wishes.ask(discard);
            }
        }
        RegistrationStep::Found(found) => {
            ui.label(RichText::new("3. Result").strong());
            result(ui, found);
            residual_map(ui, &found.residual_map, form);
            let file = form.file.get_or_insert_with(|| suggested_file("registration", "toml"));
            ui.horizontal(|ui| {
                let label = ui.label("File");
                ui.add(TextEdit::singleline(file).desired_width(220.0)).labelled_by(label.id);
            });
            let path = file.trim().to_owned();
            ui.horizontal(|ui| {
                let hover = "The next live view and run go by it; it is written into the file, and this picture beside it";
                let keep = ui.add_enabled(!path.is_empty(), Button::new("Use")).on_hover_text(hover);
                if keep.on_disabled_hover_text("Name a file first").clicked() {
                    wishes.ask(BenchCommand::Registration(RegistrationAsk::Use(path.into())));
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

fn result(ui: &mut Ui, found: &FoundRegistration) {
    let mirror = match found.mirror.as_str() {
        "none" => "not mirrored".to_owned(),
        "both" => "mirrored both ways".to_owned(),
        way => format!("mirrored, {way}"),
    };
    let [y, x] = found.shift_px;
    ui.label(format!("Camera T is {mirror}, shifted by x {x:.2}, y {y:.2} px in the middle,"));
    ui.label(format!("turned by {:.3}° and scaled by {:.5}.", found.rotation_deg, found.scale));
    let what = match found.by {
        RegisterBy::Beads => "beads",
        RegisterBy::Blinking => "patches",
    };
    ui.label(format!("Residual {:.1} nm rms over {} {what}", found.residual_nm, found.points))
        .on_hover_text("Root mean square of the distances between partners, in the sample");
    if found.points_left_out > 0 {
        ui.label(format!("{} {what} left out, as they do not fit", found.points_left_out));
    }
    for warning in &found.warnings {
        ui.label(RichText::new(warning).color(color_of(Gravity::Warning)));
    }
}

/// Uploaded once for every result.
fn residual_map(ui: &mut Ui, map: &Arc<RgbImage>, form: &mut RegistrationForm) {
    let is_same = form.picture.as_ref().is_some_and(|(shown, _)| Arc::ptr_eq(shown, map));
    if !is_same {
        let image = ColorImage::from_rgb([map.width(), map.height()], map.bytes());
        let texture = ui.ctx().load_texture("residual map", image, TextureOptions::LINEAR);
        form.picture = Some((Arc::clone(map), texture));
    }
    let Some((_, texture)) = &form.picture else { return };
    let side = ui.available_width().min(420.0);
    ui.add(Image::new(texture).max_size(Vec2::splat(side)).alt_text("Residual map")).on_hover_text(
        "Mean of camera R. Every point has a stroke along its residual, 1 pixel for 1 nm: green is small, red 20 nm and more",
    );
}
