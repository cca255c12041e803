//! Laser lines: armed by a person, with their powers, beside what they say of themselves.

use super::{color_of, heading};
use crate::viewer::bench::{BenchStatus, Gravity, LaserStatus, LiveSettings};
use egui::{Color32, DragValue, RichText, Ui};
use std::collections::BTreeMap;

/// A line as a person has set it.
#[derive(Debug, Clone, Copy, Default)]
struct Line {
    is_armed: bool,
    power_mw: f64,
}

/// Lines by nanometers.
#[derive(Debug, Clone, Default)]
pub(in crate::viewer) struct LaserForm(BTreeMap<u32, Line>);

impl LaserForm {
    /// Powers of all lines, armed or not.
    pub(in crate::viewer) fn powers(&self) -> BTreeMap<u32, f64> {
        self.0.iter().filter(|(_, line)| line.power_mw > 0.0).map(|(nm, line)| (*nm, line.power_mw)).collect()
    }

    /// Other powers; no line is armed any more.
    pub(in crate::viewer) fn disarm_with(&mut self, powers_mw: &BTreeMap<u32, f64>) {
        self.0 = powers_mw.iter().map(|(&nm, &power_mw)| (nm, Line { is_armed: false, power_mw })).collect();
    }

    fn armed(&self) -> BTreeMap<u32, f64> {
        let lit = self.0.iter().filter(|(_, line)| line.is_armed && line.power_mw > 0.0);
        lit.map(|(nm, line)| (*nm, line.power_mw)).collect()
    }
}

/// Draws the lines.
pub(super) fn lasers(ui: &mut Ui, status: &BenchStatus, form: &mut LaserForm, settings: &mut LiveSettings) {
    heading(ui, "Lasers");
    if status.lasers.is_empty() {
        ui.label("This instrument has none in its hand.");
    }
    for laser in &status.lasers {
        line(ui, laser, form);
    }
    settings.laser_power_mw = form.armed();
    if !status.lasers.is_empty() {
        ui.label(RichText::new("Armed lines emit with the next Live, as long as it goes on.").small());
    }
}

/// What will shine with the next Live; nothing where nothing will.
pub(super) fn will_shine(settings: &LiveSettings) -> Option<String> {
    let lines: Vec<String> =
        settings.laser_power_mw.iter().map(|(nm, power)| format!("{nm} nm at {power:.1} mW")).collect();
    (!lines.is_empty()).then(|| format!("Live turns on {}", lines.join(", ")))
}

fn line(ui: &mut Ui, laser: &LaserStatus, form: &mut LaserForm) {
    let Line { is_armed, power_mw } = form.0.entry(laser.wavelength_nm).or_default();
    ui.horizontal(|ui| {
        let (text, color) = match laser.is_emitting {
            Some(true) => ("EMITTING", Color32::from_rgb(255, 80, 60)),
            Some(false) => ("dark", Color32::from_rgb(120, 170, 220)),
            None if laser.power_mw > 0.0 => ("told on", Color32::from_rgb(230, 159, 0)),
            None => ("told off", Color32::from_gray(150)),
        };
        let name = format!("{} nm", laser.wavelength_nm);
        ui.checkbox(is_armed, RichText::new(&name).strong()).on_hover_text("Arm this line for the next Live");
        let value = DragValue::new(power_mw).range(0.0..=laser.cap_mw).speed(0.1).suffix(" mW");
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
