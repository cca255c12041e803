//! The panel below the images: curves, histogram, profile, events.

use super::color_of;
use super::histogram::histogram;
use crate::display::{Contrast, Limits};
use crate::reconstruction::Quality;
use crate::viewer::bench::{BenchStatus, Pictures};
use crate::viewer::plane::Layer;
use crate::viewer::settings::Below;
use egui::{Color32, RichText, ScrollArea, Ui};
use egui_plot::{AxisHints, Corner, Legend, Line, Plot, Points};

/// Blue, orange, green, vermilion: told apart by all eyes.
pub(super) const COLORS: [Color32; 4] = [
    Color32::from_rgb(86, 180, 233),
    Color32::from_rgb(230, 159, 0),
    Color32::from_rgb(0, 158, 115),
    Color32::from_rgb(213, 94, 0),
];

/// Signal-to-noise and resolution that "still needed" speaks of.
const WANTED_SNR: f64 = 5.0;

/// What the panel shows.
pub(in crate::viewer) struct Shown<'a> {
    pub(in crate::viewer) status: &'a BenchStatus,
    pub(in crate::viewer) pictures: &'a Pictures,
    /// Those of the cameras' contrast.
    pub(in crate::viewer) limits: &'a [Limits],
    /// The profile, layer by layer.
    pub(in crate::viewer) line: &'a [(String, Vec<[f64; 2]>)],
}

/// Draws the panel; gives another contrast of the cameras when a handle of the histogram is dragged.
pub(in crate::viewer) fn below(
    ui: &mut Ui,
    what: Below,
    shown: &Shown<'_>,
    contrast: Contrast,
) -> Option<Contrast> {
    match what {
        Below::Curves => curves(ui, shown.status, shown.pictures),
        Below::Histogram => return histogram(ui, shown.pictures, shown.limits, contrast),
        Below::Profile => profile_plot(ui, shown.line),
        Below::Events => events(ui, shown.status),
    }
    None
}

fn curves(ui: &mut Ui, status: &BenchStatus, pictures: &Pictures) {
    let quality = &status.quality;
    let Some(last) = quality.last() else {
        ui.label("Signal-to-noise, resolution and bleaching appear here after two subsequences.");
        return;
    };
    let needed = last.exposures_for_snr(WANTED_SNR);
    let needed = needed.map_or("cannot be said yet".to_owned(), |exposures| match exposures {
        0 => "reached".to_owned(),
        more => format!("{more} more exposures needed"),
    });
    ui.label(format!("Signal-to-noise {WANTED_SNR} in every dye: {needed}"));
    let names = names_of_results(pictures);
    let named = |index: usize| names.get(index).cloned().unwrap_or_else(|| format!("image {}", index + 1));
    let height = (ui.available_height() - 4.0).max(60.0);
    ui.columns(3, |columns| {
        let curve = |value: &dyn Fn(&Quality) -> Option<f64>| -> Vec<[f64; 2]> {
            quality.iter().filter_map(|quality| Some([quality.exposures as f64, value(quality)?])).collect()
        };
        plot(&mut columns[0], ("SNR", Corner::LeftTop), height, |index| {
            last.snr_species.get(index)?;
            Some((named(index), curve(&|quality| quality.snr_species.get(index).copied().flatten())))
        });
        plot(&mut columns[1], ("resolution, nm", Corner::LeftBottom), height, |index| {
            last.resolution.get(index)?;
            Some((named(index), curve(&|quality| quality.resolution.get(index)?.nm)))
        });
        plot(&mut columns[2], ("light left", Corner::LeftBottom), height, |index| {
            let name = ["camera R", "camera T"].get(index)?;
            let left = |quality: &Quality| Some(quality.bleaching.get(index)?.as_ref()?.left);
            Some(((*name).to_owned(), curve(&left)))
        });
    });
}

/// Names of the dyes, or of the spectral channels where no dyes are named.
fn names_of_results(pictures: &Pictures) -> Vec<String> {
    let Some(sofi) = &pictures.sofi else { return Vec::new() };
    let stage = sofi.last_stage();
    stage.into_iter().flat_map(|stage| sofi.stage(stage)).map(|image| image.name.clone()).collect()
}

fn plot(
    ui: &mut Ui,
    (name, corner): (&str, Corner),
    height: f32,
    curve: impl Fn(usize) -> Option<(String, Vec<[f64; 2]>)>,
) {
    let lines: Vec<_> = (0..4).map_while(curve).collect();
    if lines.iter().all(|(_, points)| points.is_empty()) {
        ui.vertical_centered(|ui| {
            ui.add_space(0.4 * height);
            ui.label(format!("{name}: nothing yet"));
        });
        return;
    }
    Plot::new(name)
        .height(height)
        .custom_x_axes(vec![
            AxisHints::new_x().label("exposures").label_spacing(egui::Rangef::new(20.0, 60.0)),
        ])
        .y_axis_label(name)
        .include_y(0.0)
        .include_x(0.0)
        .legend(Legend::default().position(corner).background_alpha(0.3))
        .allow_scroll(false)
        .show(ui, |plot| {
            for ((name, points), color) in lines.into_iter().zip(COLORS) {
                plot.points(Points::new(name.clone(), points.clone()).color(color).radius(2.5));
                plot.line(Line::new(name, points).color(color).width(1.5));
            }
        });
}

fn profile_plot(ui: &mut Ui, lines: &[(String, Vec<[f64; 2]>)]) {
    if lines.is_empty() {
        ui.label("Drag with Shift in an image: the values along the line appear here.");
        return;
    }
    let height = (ui.available_height() - 6.0).max(60.0);
    Plot::new("profile")
        .height(height)
        .x_axis_label("µm along the line")
        .legend(Legend::default())
        .allow_scroll(false)
        .show(ui, |plot| {
            for ((name, points), color) in lines.iter().zip(COLORS) {
                plot.line(Line::new(name.clone(), points.clone()).color(color).width(2.0));
            }
        });
}

/// Values along a line, layer by layer, at steps of half a pixel.
#[must_use]
pub(in crate::viewer) fn profile(
    layers: &[Layer],
    [from, to]: [[f64; 2]; 2],
) -> Vec<(String, Vec<[f64; 2]>)> {
    let way = [to[0] - from[0], to[1] - from[1]];
    let length = way[0].hypot(way[1]);
    layers
        .iter()
        .map(|layer| {
            let steps = (length * 1e3 / layer.pixel_pitch_nm * 2.0).ceil().clamp(1.0, 4096.0) as usize;
            let points = (0..=steps).filter_map(|step| {
                let share = step as f64 / steps as f64;
                let at = [from[0] + share * way[0], from[1] + share * way[1]];
                let (_, _, value) = layer.at(at)?;
                (!value.is_nan()).then(|| [share * length, f64::from(value)])
            });
            (layer.name.clone(), points.collect())
        })
        .collect()
}

fn events(ui: &mut Ui, status: &BenchStatus) {
    ScrollArea::vertical().stick_to_bottom(true).auto_shrink([false, false]).show(ui, |ui| {
        if status.events.is_empty() {
            ui.label("Nothing has happened yet.");
        }
        for event in status.events.iter() {
            ui.label(RichText::new(format!("{}  {}", event.time, event.text)).color(color_of(event.gravity)));
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::display::Colormap;
    use crate::viewer::plane::{Paint, Pixels};
    use ndarray::Array2;
    use std::sync::Arc;

    #[test]
    fn a_profile_reads_the_pixels_on_its_way() {
        let image = Array2::from_shape_fn((10, 10), |(y, x)| (10 * y + x) as f32);
        let layer = Layer {
            name: "image".to_owned(),
            pixels: Pixels::Values(Arc::new(image)),
            pixel_pitch_nm: 100.0,
            paint: Paint::Map(Colormap::Gray),
            warp: None,
        };
        let lines = profile(&[layer], [[0.05, 0.35], [0.75, 0.35]]);
        let (name, points) = &lines[0];
        assert_eq!((name.as_str(), points.len()), ("image", 15));
        assert_eq!(points[0], [0.0, 30.0]);
        assert!((points[14][0] - 0.7).abs() < 1e-12 && points[14][1] == 37.0, "{points:?}");
    }
}
