//! The live view: exposure, order, dyes, region, presets.

use super::lasers::will_shine;
use super::{Forms, Own, Wishes, color_of, heading};
use crate::viewer::bench::{Activity, BenchCommand, BenchStatus, Gravity, InstrumentCard, LiveSettings};
use crate::viewer::presets::{Preset, Presets};
use egui::{Button, ComboBox, DragValue, RichText, TextEdit, Ui, Vec2};
use std::time::Duration;

/// What is typed for the live view.
#[derive(Debug, Clone, Default)]
pub(in crate::viewer) struct LiveForm {
    pub(in crate::viewer) settings: LiveSettings,
    /// Name of the next preset.
    name: String,
}

impl LiveForm {
    /// The settings with lasers that are armed.
    fn command(&self) -> BenchCommand {
        BenchCommand::Live(self.settings.clone())
    }
}

/// Draws the panel.
pub(in crate::viewer) fn live(
    ui: &mut Ui,
    status: &BenchStatus,
    card: &InstrumentCard,
    forms: &mut Forms,
    presets: &Presets,
    wishes: &mut Wishes,
) {
    let powers_mw = forms.lasers.powers();
    let form = &mut forms.live;
    let is_live = status.activity == Activity::Live;
    let is_free = matches!(status.activity, Activity::Idle | Activity::Live | Activity::Replay);
    ui.horizontal(|ui| {
        let text = if is_live { "Apply and restart" } else { "Live" };
        let button = Button::new(RichText::new(text).size(17.0)).min_size(Vec2::new(150.0, 36.0));
        if ui
            .add_enabled(is_free, button)
            .on_hover_text("Show the cameras and the running image; nothing is recorded (L)")
            .clicked()
        {
            wishes.ask(form.command());
        }
        let finish = Button::new(RichText::new("Finish").size(17.0)).min_size(Vec2::new(110.0, 36.0));
        let is_looking = matches!(status.activity, Activity::Live | Activity::Replay);
        let finish = ui.add_enabled(is_looking, finish).on_hover_text("End in good order (F)");
        if finish.on_disabled_hover_text("Nothing is shown that could end").clicked() {
            wishes.ask(BenchCommand::Finish);
        }
    });
    if let Some(light) = will_shine(&form.settings) {
        ui.label(RichText::new(light).color(color_of(Gravity::Warning)));
    }
    ui.add_space(4.0);
    let can_save = matches!(status.activity, Activity::Live | Activity::Idle | Activity::Replay);
    let size = Vec2::new(ui.available_width().min(268.0), 28.0);
    let hover =
        "Write every image of the running or last view as OME-TIFF, with a picture, into a new directory (S)";
    let save = ui.add_enabled_ui(can_save, |ui| ui.add_sized(size, Button::new("Save images"))).inner;
    if save.on_hover_text(hover).clicked() {
        wishes.own.push(Own::Save);
    }
    if let Some(saved) = &status.last_saved {
        ui.label(RichText::new(format!("last saved: {}", saved.display())).small());
    }
    heading(ui, "Cameras");
    let settings = &mut form.settings;
    let mut exposure_ms = settings.exposure.as_secs_f64() * 1e3;
    let (shortest, longest) =
        (card.shortest_period.as_secs_f64() * 1e3, card.longest_exposure.as_secs_f64() * 1e3);
    let range = shortest.min(longest)..=longest;
    number(
        ui,
        "Exposure",
        DragValue::new(&mut exposure_ms).range(range).speed(0.1).suffix(" ms"),
        "Time of one exposure, which is also the time from exposure to exposure",
    );
    settings.exposure = Duration::from_secs_f64(exposure_ms.max(1e-3) / 1e3);
    ui.horizontal(|ui| {
        match settings.region {
            None => ui.label(format!("Region: whole sensor, {} x {} px", card.sensor.0, card.sensor.1)),
            Some([left, top, width, height]) => {
                ui.label(format!("Region: {width} x {height} px from ({left}, {top})"))
            }
        }
        .on_hover_text("Drag with Ctrl in a camera image to choose a region");
        if settings.region.is_some() && ui.button("Whole sensor").clicked() {
            settings.region = None;
        }
    });
    if card.has_focus {
        ui.checkbox(&mut settings.hold_focus, "Hold focus")
            .on_hover_text("The focus lock must hold before the first exposure");
    }
    heading(ui, "Analysis");
    ui.horizontal(|ui| {
        ui.label("Order");
        for order in 2..=4 {
            ui.selectable_value(&mut settings.order, order, order.to_string())
                .on_hover_text("Order of the cumulants: finer with every order, and noisier");
        }
    });
    number(
        ui,
        "Subsequence",
        DragValue::new(&mut settings.subsequence).range(10..=5000).suffix(" exposures"),
        "So short that bleaching does not matter; 200 in the paper",
    );
    dyes(ui, card, settings);
    let is_of = |preset: &Preset| {
        let live =
            LiveSettings { laser_power_mw: preset.live.laser_power_mw.clone(), ..form.settings.clone() };
        live == preset.live && preset.powers_mw == powers_mw
    };
    let current = presets.iter().find(|preset| is_of(preset)).map(|preset| preset.name.clone());
    presets_of(ui, presets, current.as_deref(), &mut form.name, wishes);
}

fn presets_of(ui: &mut Ui, presets: &Presets, current: Option<&str>, name: &mut String, wishes: &mut Wishes) {
    heading(ui, "Presets");
    for preset in presets.iter() {
        ui.horizontal(|ui| {
            let hover = "Exposure, region, analysis, powers, contrast and colors; arms no laser";
            let label = ui.selectable_label(current == Some(preset.name.as_str()), &preset.name);
            if label.on_hover_text(hover).clicked() {
                wishes.own.push(Own::UsePreset(preset.name.clone()));
            }
            let remove =
                ui.small_button("remove").on_hover_text(format!("Forget the preset {}", preset.name));
            if remove.clicked() {
                wishes.own.push(Own::RemovePreset(preset.name.clone()));
            }
        });
    }
    ui.horizontal(|ui| {
        let label = ui.label("Name");
        ui.add(TextEdit::singleline(name).desired_width(130.0))
            .labelled_by(label.id)
            .on_hover_text("Name of a preset to keep");
        let button = ui.add_enabled(!name.trim().is_empty(), Button::new("Keep as preset"));
        let hover =
            "Keeps exposure, region, analysis, powers, contrast and colors for later sessions as well";
        if button.on_hover_text(hover).on_disabled_hover_text("Type a name first").clicked() {
            wishes.own.push(Own::KeepPreset(name.trim().to_owned()));
            name.clear();
        }
    });
}

fn number(ui: &mut Ui, name: &str, value: DragValue<'_>, hover: &str) {
    ui.horizontal(|ui| {
        let label = ui.label(name);
        ui.add(value).labelled_by(label.id).on_hover_text(hover);
    });
}

fn dyes(ui: &mut Ui, card: &InstrumentCard, settings: &mut LiveSettings) {
    if settings.species.is_empty() {
        let own = if card.species.is_empty() { "none".to_owned() } else { card.species.join(", ") };
        ui.label(format!("Dyes: {own}"));
    }
    let mut removed = None;
    for (index, dye) in settings.species.iter().enumerate() {
        ui.horizontal(|ui| {
            ui.label(dye);
            if ui.small_button("remove").on_hover_text(format!("Remove {dye}")).clicked() {
                removed = Some(index);
            }
        });
    }
    if let Some(index) = removed {
        settings.species.remove(index);
    }
    let most = settings.order + 1;
    if settings.species.len() < most {
        let choice = ComboBox::from_label("Add a dye").selected_text("choose").show_ui(ui, |ui| {
            for dye in &card.known_species {
                if !settings.species.contains(dye) && ui.selectable_label(false, dye).clicked() {
                    settings.species.push(dye.clone());
                }
            }
        });
        choice.response.on_hover_text(format!("Up to {most} dyes at order {}", most - 1));
    }
    if let Some(dichroic) = &card.dichroic {
        ui.label(format!("Dichroic: {dichroic}"));
    }
}
