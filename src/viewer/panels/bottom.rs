//! The line at the very bottom: how far the run is, what the disk has left, what is under the pointer, the last event.

use super::{color_of, in_bytes, in_words};
use crate::viewer::bench::{Activity, BenchStatus, Gravity, Pictures};
use egui::{ProgressBar, RichText, Ui};

/// Draws the line.
pub(in crate::viewer) fn bottom(
    ui: &mut Ui,
    status: &BenchStatus,
    pictures: &Pictures,
    reading: Option<&str>,
) {
    let run = &status.run;
    if !matches!(status.activity, Activity::Closed | Activity::Opening) {
        ui.horizontal_wrapped(|ui| {
            if let Some(planned) = run.planned.filter(|planned| *planned > 0) {
                let share = run.exposures as f32 / planned as f32;
                let series = if run.series.1 > 1 {
                    format!("series {}/{}, ", run.series.0, run.series.1)
                } else {
                    String::new()
                };
                let text = format!("{series}{} of {planned} exposures", run.exposures);
                ui.add(ProgressBar::new(share).desired_width(260.0).text(text));
            } else {
                ui.label(format!("{} exposures", run.exposures));
            }
            let is_over = status.activity == Activity::Idle;
            if is_over && !run.ended.is_empty() {
                ui.label(RichText::new(&run.ended).strong());
            } else if !run.phase.is_empty() && !is_over {
                ui.label(&run.phase);
            }
            ui.label(in_words(run.elapsed));
            if let Some(remaining) = run.remaining.filter(|_| status.activity == Activity::Run) {
                ui.label(format!("{} left", in_words(remaining)));
            }
            if let (Some(free), Some(left), false) = (run.disk_free, run.disk_left, is_over) {
                ui.label(format!("disk: {} free, {} at this rate", in_bytes(free), in_words(left)));
            }
            ui.label(format!("{} pairs, {} analyzed", run.pairs, run.pairs_analyzed));
            if is_over {
                return;
            }
            let fill = run.fill.map(|fill| format!("{:.0} %", fill * 100.0));
            ui.label(format!("queues {} | {}", fill[0], fill[1]))
                .on_hover_text("How full the queues to recording and analysis are");
            if !run.latency.is_zero() {
                ui.label(format!("picture {:.0} ms behind", run.latency.as_secs_f64() * 1e3));
            }
            if let Some(sofi) = &pictures.sofi {
                ui.label(&sofi.label).on_hover_text("What the image of the result is made of");
            }
        });
    }
    ui.horizontal(|ui| {
        if let Some(reading) = reading {
            ui.label(RichText::new(reading).monospace().size(12.0));
        } else if let Some(event) = status.events.last() {
            let text = RichText::new(format!("{}  {}", event.time, event.text));
            ui.label(if event.gravity == Gravity::Note { text } else { text.color(color_of(event.gravity)) });
        } else {
            ui.label(" ");
        }
    });
}
