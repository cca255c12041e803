//! The property browser: everything that a device tells of itself, and what of it may be changed now.

use super::{Wishes, color_of, heading};
use crate::viewer::bench::{
    Activity, BenchCommand, BenchStatus, DeviceCard, Gravity, InstrumentCard, PropertyRow,
};
use egui::{Button, CollapsingHeader, ComboBox, RichText, Role, TextEdit, Ui, WidgetInfo};
use std::collections::BTreeMap;

/// Devices with more properties than this get a field to search them.
const MANY: usize = 12;

/// What is typed, by device and property.
#[derive(Debug, Clone, Default)]
pub(in crate::viewer) struct PropertyForm {
    typed: BTreeMap<(String, String), String>,
    sought: String,
}

/// Draws all devices.
pub(super) fn devices(
    ui: &mut Ui,
    status: &BenchStatus,
    card: &InstrumentCard,
    form: &mut PropertyForm,
    wishes: &mut Wishes,
) {
    heading(ui, "Devices");
    for warning in &card.warnings {
        ui.label(RichText::new(warning).color(color_of(Gravity::Warning)));
    }
    if card.devices.iter().any(|device| device.properties.len() > MANY) {
        ui.horizontal(|ui| {
            let label = ui.label("Find a property");
            ui.add(TextEdit::singleline(&mut form.sought).desired_width(150.0)).labelled_by(label.id);
        });
    }
    let is_idle = status.activity == Activity::Idle;
    for device in &card.devices {
        let mark = if device.is_simulated { "  (simulated)" } else { "" };
        CollapsingHeader::new(format!("{}{mark}", device.role)).id_salt(&device.identity).show(ui, |ui| {
            ui.label(&device.identity);
            let can_change = device.properties.iter().any(|row| row.is_writable);
            if can_change && !is_idle {
                let text = "Changed only while the cameras rest: finish what is under way (F).";
                ui.label(RichText::new(text).small());
            }
            let sought = form.sought.trim().to_lowercase();
            for row in device.properties.iter().filter(|row| row.name.to_lowercase().contains(&sought)) {
                property(ui, device, row, is_idle, form, wishes);
            }
        });
    }
}

fn property(
    ui: &mut Ui,
    device: &DeviceCard,
    row: &PropertyRow,
    is_idle: bool,
    form: &mut PropertyForm,
    wishes: &mut Wishes,
) {
    let PropertyRow { name, value, unit, range, .. } = row;
    if !row.is_writable {
        let range = if range.is_empty() { String::new() } else { format!("  ({range})") };
        ui.label(format!("{name}: {value} {unit}{range}")).on_hover_text("Read only");
        return;
    }
    let mut set = |value: String| {
        let (device, property) = (device.role.clone(), name.clone());
        wishes.ask(BenchCommand::SetProperty { device, property, value });
    };
    ui.horizontal(|ui| {
        let label = ui.label(name);
        if !row.choices.is_empty() {
            ui.add_enabled_ui(is_idle, |ui| {
                let shown =
                    ComboBox::from_id_salt((&device.role, name)).selected_text(value).show_ui(ui, |ui| {
                        for choice in &row.choices {
                            if ui.selectable_label(choice == value, choice).clicked() && choice != value {
                                set(choice.clone());
                            }
                        }
                    });
                shown.response.labelled_by(label.id);
            });
            return;
        }
        let key = (device.role.clone(), name.clone());
        let typed = form.typed.entry(key.clone()).or_insert_with(|| value.clone());
        let field = TextEdit::singleline(typed).desired_width(80.0);
        let field = ui.add_enabled(is_idle, field).labelled_by(label.id).on_hover_text(range);
        let (enter, is_new) = (ui.input(|input| input.key_pressed(egui::Key::Enter)), typed != value);
        ui.label(unit);
        let button = ui.add_enabled(is_idle && is_new, Button::new("Set").small());
        // Long names would make the panel wider, and one "Set" would be like the other to those who cannot see.
        button.widget_info(|| WidgetInfo::labeled(Role::Button, is_idle && is_new, format!("Set {name}")));
        if button.clicked() || (field.lost_focus() && enter && is_new) {
            set(typed.trim().to_owned());
        }
        // What nobody types in follows the device.
        if !field.has_focus() && !is_new {
            form.typed.remove(&key);
        }
    });
}
