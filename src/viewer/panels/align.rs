//! What brings both cameras together: where they see the same, and how the dyes divide between them.

use super::{Forms, Wishes, colors, registration};
use crate::viewer::bench::BenchStatus;
use egui::Ui;

/// Draws the procedure that is chosen.
pub(in crate::viewer) fn align(ui: &mut Ui, status: &BenchStatus, forms: &mut Forms, wishes: &mut Wishes) {
    ui.horizontal(|ui| {
        let is_shown = &mut forms.colors.is_shown;
        ui.selectable_value(is_shown, false, "Cameras")
            .on_hover_text("Where camera R sees what camera T sees");
        ui.selectable_value(is_shown, true, "Dyes").on_hover_text("How each dye divides between the cameras");
    });
    if forms.colors.is_shown {
        colors::colors(ui, status, &mut forms.colors, wishes);
    } else {
        registration::registration(ui, status, &mut forms.registration, wishes);
    }
}
