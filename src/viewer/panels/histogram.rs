//! The histogram of raw counts, with handles for black and white.

use super::below::COLORS;
use super::color_of;
use crate::display::{Contrast, Limits};
use crate::viewer::bench::{Gravity, Pictures};
use egui::{CursorIcon, Rect, RichText, Role, Sense, Ui, WidgetInfo};
use egui_plot::{Legend, Line, Plot, PlotPoint, PlotTransform, VLine};

/// Cameras by name.
const NAMES: [&str; 2] = ["camera R", "camera T"];
/// Half of the width that a handle can be taken at, points.
const REACH: f32 = 6.0;

/// Draws histogram and handles; gives the contrast that a dragged handle makes.
pub(super) fn histogram(
    ui: &mut Ui,
    pictures: &Pictures,
    limits: &[Limits],
    contrast: Contrast,
) -> Option<Contrast> {
    let Some(look) = &pictures.cameras else {
        ui.label("The histogram of raw counts appears here with the first frames.");
        return None;
    };
    for (camera, name) in look.cameras.iter().zip(NAMES) {
        let (low, mean, high) = camera.range;
        let text =
            format!("{name}: {low} to {high} counts, mean {mean:.1}, {} saturated pixels", camera.saturated);
        let text = RichText::new(text);
        ui.label(if camera.saturated > 0 { text.color(color_of(Gravity::Error)) } else { text });
    }
    let height = (ui.available_height() - 6.0).max(60.0);
    let highest = look.cameras.iter().map(|camera| f64::from(camera.range.2)).fold(1.0, f64::max);
    let lines = look.cameras.each_ref().map(|camera| -> Vec<[f64; 2]> {
        let step = f64::from(camera.bin_counts);
        let bins = camera.histogram.iter().enumerate();
        bins.map(|(bin, &pixels)| [(bin as f64 + 0.5) * step, f64::from(pixels).max(0.5).log10()]).collect()
    });
    let handles = handles(limits, contrast);
    let plot = Plot::new("histogram")
        .height(height)
        .x_axis_label("raw counts")
        .y_axis_label("log10 of pixels")
        .legend(Legend::default())
        .include_x(0.0)
        .include_x(highest * 1.05)
        .allow_scroll(false)
        .allow_drag(false)
        .show(ui, |plot| {
            for ((points, name), color) in lines.into_iter().zip(NAMES).zip(COLORS) {
                plot.line(Line::new(name, points).color(color).width(1.5));
            }
            for handle in &handles {
                let line = VLine::new("", handle.at()).color(COLORS[handle.color]);
                plot.vline(line.width(if handle.is_white { 2.5 } else { 1.5 }));
            }
        });
    handles.iter().find_map(|handle| handle.drag(ui, &plot.transform, highest * 1.5))
}

/// A line that can be dragged.
struct Handle {
    name: String,
    color: usize,
    is_white: bool,
    limits: Limits,
}

/// Black and white of both cameras, or of both together where they were set by hand.
fn handles(limits: &[Limits], contrast: Contrast) -> Vec<Handle> {
    let pair = |name: &str, color: usize, limits: Limits| {
        [("black", false), ("white", true)].map(|(what, is_white)| Handle {
            name: format!("{what}{name}"),
            color,
            is_white,
            limits,
        })
    };
    match contrast {
        Contrast::Manual(limits) => pair("", 2, limits).into(),
        _ => limits
            .iter()
            .zip(NAMES)
            .enumerate()
            .flat_map(|(camera, (&limits, name))| pair(&format!(" of {name}"), camera, limits))
            .collect(),
    }
}

impl Handle {
    fn at(&self) -> f64 {
        if self.is_white { self.limits.high } else { self.limits.low }
    }

    /// The contrast that it makes where it is dragged to, at most at `most` counts.
    fn drag(&self, ui: &Ui, transform: &PlotTransform, most: f64) -> Option<Contrast> {
        let x = transform.position_from_point(&PlotPoint::new(self.at(), 0.0)).x;
        let frame = transform.frame();
        let area = Rect::from_x_y_ranges(x - REACH..=x + REACH, frame.y_range()).intersect(*frame);
        let id = |camera: usize| ui.scope_id().with(("contrast", self.is_white, camera));
        // A drag that began at one camera goes on when the limits are those of both.
        let dragged = (0..NAMES.len()).find(|&camera| ui.ctx().is_being_dragged(id(camera)));
        let id = match self.color {
            camera if camera < NAMES.len() => id(camera),
            _ => id(dragged.unwrap_or(0)),
        };
        let response = ui.interact(area, id, Sense::drag());
        response.widget_info(|| WidgetInfo::labeled(Role::Slider, true, &self.name));
        let response = response.on_hover_and_drag_cursor(CursorIcon::ResizeHorizontal);
        let pointer = response.interact_pointer_pos().filter(|_| response.dragged())?;
        Some(Contrast::Manual(self.moved(transform.value_from_position(pointer).x.min(most))))
    }

    /// The limits with this end elsewhere; black stays below white.
    fn moved(&self, to: f64) -> Limits {
        let Limits { low, high } = self.limits;
        if self.is_white {
            Limits { low, high: to.max(low + 1.0) }
        } else {
            Limits { low: to.clamp(0.0, (high - 1.0).max(0.0)), high }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn black_stays_below_white() {
        let limits = Limits { low: 100.0, high: 200.0 };
        let handle = |is_white| Handle { name: String::new(), color: 0, is_white, limits };
        assert_eq!(handle(true).moved(150.0), Limits { low: 100.0, high: 150.0 });
        assert_eq!(handle(true).moved(50.0), Limits { low: 100.0, high: 101.0 });
        assert_eq!(handle(false).moved(-5.0), Limits { low: 0.0, high: 200.0 });
        assert_eq!(handle(false).moved(500.0), Limits { low: 199.0, high: 200.0 });
    }

    #[test]
    fn each_camera_has_handles_until_both_are_set_by_hand() {
        let limits = [Limits { low: 1.0, high: 2.0 }, Limits { low: 3.0, high: 4.0 }];
        let names = |contrast| handles(&limits, contrast).into_iter().map(|one| one.name).collect::<Vec<_>>();
        assert_eq!(
            names(Contrast::default()),
            ["black of camera R", "white of camera R", "black of camera T", "white of camera T"]
        );
        assert_eq!(names(Contrast::Manual(limits[0])), ["black", "white"]);
    }
}
