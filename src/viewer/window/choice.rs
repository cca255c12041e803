//! The row above the images: what is shown, in which colors, with which contrast.
//!
//! In: the newest pictures. Out: another view. Never: offers what is not there. Fails: not at all.

use super::Window;
use crate::display::{Colormap, Contrast, Limits};
use crate::reconstruction::{SofiLook, SofiStage};
use crate::viewer::bench::{Gravity, Pictures};
use crate::viewer::panels::{self, Own, Wishes};
use crate::viewer::view::{Subject, View};
use egui::{Button, Checkbox, ComboBox, DragValue, RichText, Ui};

impl Window {
    /// The row above the images: what is shown, in which colors, with which contrast.
    pub(super) fn choose(&self, ui: &mut Ui, pictures: &Pictures, view: &mut View, wishes: &mut Wishes) {
        ui.horizontal_wrapped(|ui| {
            // In one row of a window of 1280 points.
            ui.spacing_mut().item_spacing.x = 5.0;
            let sofi = pictures.sofi.as_deref();
            let label = ui.label("Image");
            let images = ComboBox::from_id_salt("image").selected_text(name_of(view.subject, sofi));
            let images = images.show_ui(ui, |ui| {
                for subject in subjects(sofi) {
                    ui.selectable_value(&mut view.subject, subject, name_of(subject, sofi));
                }
            });
            images
                .response
                .labelled_by(label.id)
                .on_hover_text("Cameras, or any step of the analysis (R, T, O, 1 to 5)");
            let label = ui.label("Colors");
            let colors = ComboBox::from_id_salt("colors").selected_text(view.colormap.name());
            let colors = colors.show_ui(ui, |ui| {
                for map in Colormap::ALL {
                    ui.selectable_value(&mut view.colormap, map, map.name());
                }
            });
            colors.response.labelled_by(label.id).on_hover_text("Colors of single images");
            contrast(ui, view, self.result.limits());
            let mut is_split = view.split.is_some();
            if ui
                .checkbox(&mut is_split, "Beside the mean")
                .on_hover_text("Mean image left of the divider (M)")
                .changed()
            {
                view.split = is_split.then_some(0.5);
            }
            ui.checkbox(&mut view.marks_saturation, "Mark saturation")
                .on_hover_text("Saturated pixels in red, judged on raw counts");
            if view.subject == Subject::Overlay {
                registration(ui, pictures, view);
            }
            if ui.button("Whole image").on_hover_text("Double click in the image").clicked() {
                view.zoom = None;
            }
            let hover = "The image as it is seen, with its contrast and a scale bar, as PNG (E)";
            let has_image = self.result.shown().is_some();
            if ui.add_enabled(has_image, Button::new("Save picture")).on_hover_text(hover).clicked() {
                wishes.own.push(Own::SavePicture);
            }
            if let Some(trouble) = pictures.sofi.as_ref().and_then(|sofi| sofi.trouble.as_ref()) {
                ui.label(RichText::new(trouble).color(panels::color_of(Gravity::Warning)));
            }
        });
    }
}

/// Camera T on camera R, or both as they are.
fn registration(ui: &mut Ui, pictures: &Pictures, view: &mut View) {
    let look = pictures.cameras.as_ref();
    let is_known = look.is_some_and(|look| look.transmitted_from_reflected.is_some());
    let mut is_applied = is_known && view.applies_registration;
    let checkbox = ui.add_enabled(is_known, Checkbox::new(&mut is_applied, "Registered"));
    let checkbox = checkbox
        .on_hover_text(
            "Camera T brought onto camera R by the registration in use; off shows both as they are",
        )
        .on_disabled_hover_text("No registration is in use: both cameras are shown as they are");
    if checkbox.changed() {
        view.applies_registration = is_applied;
    }
}

/// Everything that can be shown, in the order of the light path.
fn subjects(sofi: Option<&SofiLook>) -> Vec<Subject> {
    let mut all = vec![Subject::Camera(0), Subject::Camera(1), Subject::Overlay];
    for stage in SofiStage::ALL {
        let images = sofi.map_or(0, |sofi| sofi.stage(stage).count());
        if images > 0 {
            all.push(Subject::Composite(stage));
            all.extend((0..images).map(|index| Subject::One(stage, index)));
        }
    }
    all
}

fn name_of(subject: Subject, sofi: Option<&SofiLook>) -> String {
    match subject {
        Subject::Camera(0) => "camera R".to_owned(),
        Subject::Camera(_) => "camera T".to_owned(),
        Subject::Overlay => "both cameras".to_owned(),
        Subject::Composite(stage) => format!("{}, all", stage.name()),
        Subject::One(stage, index) => {
            let image = sofi.and_then(|sofi| sofi.stage(stage).nth(index));
            let name = image.map_or_else(|| (index + 1).to_string(), |image| image.name.clone());
            format!("{}, {name}", stage.name())
        }
    }
}

fn contrast(ui: &mut Ui, view: &mut View, limits: &[Limits]) {
    let index = view.contrast_index();
    let now = limits.first().copied().unwrap_or(Limits { low: 0.0, high: 1.0 });
    let mut is_manual = matches!(view.contrasts[index], Contrast::Manual(_));
    if ui
        .checkbox(&mut is_manual, "Manual contrast")
        .on_hover_text("Black and white by value; percentiles again with A")
        .changed()
    {
        view.contrasts[index] =
            if is_manual { Contrast::Manual(now) } else { View::default().contrasts[index] };
    }
    let named = |ui: &mut Ui, name: &str, value: DragValue<'_>, hover: &str| {
        let label = ui.label(name);
        ui.add(value).labelled_by(label.id).on_hover_text(hover);
    };
    let by_value = "Drag, or click to type; in counts for cameras";
    let by_share = "Drag, or click to type; percent of the pixels that are darker";
    match &mut view.contrasts[index] {
        Contrast::Manual(limits) => {
            let speed = ((limits.high - limits.low).abs() / 200.0).max(1e-6);
            named(ui, "black", DragValue::new(&mut limits.low).speed(speed), by_value);
            named(ui, "white", DragValue::new(&mut limits.high).speed(speed), by_value);
        }
        Contrast::Percentile { low, high } => {
            named(ui, "black", DragValue::new(low).range(0.0..=50.0).speed(0.1).suffix(" %"), by_share);
            named(ui, "white", DragValue::new(high).range(50.0..=100.0).speed(0.02).suffix(" %"), by_share);
        }
        Contrast::FromZero { high } => {
            named(ui, "white", DragValue::new(high).range(50.0..=100.0).speed(0.02).suffix(" %"), by_share);
        }
    }
}
