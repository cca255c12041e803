//! The window itself: panes, panels, keys.
//!
//! In: a [`Bench`]. Out: what is drawn. Never: waits, owns state that matters. Fails: not at all.

mod choice;
mod gesture;
mod keys;
mod obey;

use gesture::Gestures;
pub use keys::SHORTCUTS;

use super::bench::{Activity, Bench, BenchStatus, Gravity, Pictures};
use super::canvas::{Canvas, Done, Mark};
use super::panels::{self, Forms, Wishes};
use super::plane::layers;
use super::presets::Presets;
use super::settings::{Below, Side, WindowSettings};
use super::view::{History, Subject, View};
use crate::display::Limits;
use egui::{CentralPanel, Panel, RichText, ScrollArea, Ui};
use std::time::{Duration, Instant};

/// Shortest time between two looks while something goes on, and the time while nothing does.
const LOOKS: [Duration; 2] = [Duration::from_millis(33), Duration::from_millis(250)];
/// Drawing takes at most a third of a core: the window waits so many times as long as a look has taken.
const REST: f64 = 2.0;

/// Size of the smallest writing, points.
const SMALL: f32 = 11.0;

/// The window.
pub struct Window {
    bench: Box<dyn Bench>,
    settings: WindowSettings,
    history: History,
    result: Canvas,
    cameras: [Canvas; 2],
    forms: Forms,
    presets: Presets,
    gestures: Gestures,
    line_um: Option<[[f64; 2]; 2]>,
    /// Left and top of the region that the live view was asked for last, pixels of the sensor.
    live_corner: [u32; 2],
    escaped: Option<f64>,
    shows_shortcuts: bool,
    /// What was refused, and when.
    refused: Option<(String, Instant)>,
    /// How long the last look took on the window's own thread.
    took: Duration,
    /// Time between two looks, as the computer can draw.
    pace: Duration,
}

impl Window {
    /// A window on an instrument.
    #[must_use]
    pub fn new(bench: Box<dyn Bench>, settings: WindowSettings) -> Self {
        Self {
            bench,
            settings,
            history: History::default(),
            result: Canvas::new("result"),
            cameras: [Canvas::new("camera R image"), Canvas::new("camera T image")],
            forms: Forms::default(),
            presets: Presets::default(),
            gestures: Gestures::default(),
            line_um: None,
            live_corner: [0; 2],
            escaped: None,
            shows_shortcuts: false,
            refused: None,
            took: Duration::ZERO,
            pace: LOOKS[0],
        }
    }

    /// The same with presets of earlier times.
    #[must_use]
    pub fn with_presets(mut self, presets: Presets) -> Self {
        self.presets = presets;
        self
    }

    /// Presets, to be stored for the next time.
    #[must_use]
    pub fn presets(&self) -> &Presets {
        &self.presets
    }

    /// What is to be stored for the next time.
    #[must_use]
    pub fn settings(&self) -> &WindowSettings {
        &self.settings
    }

    /// How it is looked at.
    #[must_use]
    pub fn view(&self) -> View {
        self.history.view()
    }

    /// How long the window's thread took for the last look.
    #[must_use]
    pub fn took(&self) -> Duration {
        self.took
    }

    /// Whether result and cameras have pictures.
    #[must_use]
    pub fn has_pictures(&self) -> (bool, bool) {
        (self.result.has_picture(), self.cameras.iter().all(Canvas::has_picture))
    }

    /// The whole of the last look took this long, with the drawing by OpenGL.
    pub fn drawn_in(&mut self, took: Duration) {
        self.pace = took.mul_f64(1.0 + REST).clamp(LOOKS[0], LOOKS[1]);
    }

    /// Draws everything once.
    pub fn ui(&mut self, ui: &mut Ui) {
        let begun = Instant::now();
        let (status, pictures) = (self.bench.status(), self.bench.pictures());
        self.appear(ui);
        ui.input(|input| self.gestures.look(input));
        let mut wishes = Wishes::default();
        self.keys(ui, &status, &mut wishes);
        Panel::top("top").show(ui, |ui| {
            let can = self.history.can();
            let (undo, redo) = panels::top(ui, &status, &mut self.settings, can, &mut wishes);
            if undo {
                self.undo();
            }
            if redo {
                self.redo();
            }
            self.tell_trouble(ui, &status);
        });
        let mut done = Done::default();
        let reading_of = self.result_reading();
        Panel::bottom("bottom").show(ui, |ui| panels::bottom(ui, &status, &pictures, reading_of.as_deref()));
        let is_showing =
            status.instrument.is_some() || pictures.cameras.is_some() || status.activity == Activity::Replay;
        if is_showing {
            self.side(ui, &status, &mut wishes);
            self.below(ui, &status, &pictures);
            if let Some(replay) = &status.replay {
                let form = &mut self.forms.transport;
                Panel::bottom("transport")
                    .resizable(false)
                    .show(ui, |ui| panels::transport(ui, &status, replay, form, &mut wishes));
            }
            CentralPanel::default().show(ui, |ui| done = self.images(ui, &status, &pictures, &mut wishes));
        } else {
            CentralPanel::default()
                .show(ui, |ui| panels::start(ui, &status, &mut self.settings, &mut wishes));
        }
        self.take_up(ui, done, &status, &pictures);
        self.obey(ui, wishes, &status, &pictures);
        self.list_shortcuts(ui);
        let goes_on = !matches!(status.activity, Activity::Closed | Activity::Idle);
        ui.ctx().request_repaint_after(if goes_on { self.pace } else { LOOKS[1] });
        self.took = begun.elapsed();
    }

    fn result_reading(&self) -> Option<String> {
        self.refused
            .as_ref()
            .filter(|(_, at)| at.elapsed() < Duration::from_secs(5))
            .map(|(text, _)| text.clone())
    }

    fn appear(&self, ui: &Ui) {
        let theme = if self.settings.is_dark { egui::Theme::Dark } else { egui::Theme::Light };
        if ui.ctx().theme() != theme {
            ui.ctx().set_theme(theme);
        }
        let readable = egui::FontId::proportional(SMALL);
        if ui.style().text_styles.get(&egui::TextStyle::Small) != Some(&readable) {
            ui.ctx().all_styles_mut(|style| {
                style.text_styles.insert(egui::TextStyle::Small, readable.clone());
            });
        }
        if (ui.ctx().zoom_factor() - self.settings.scale).abs() > 1e-3 {
            ui.ctx().set_zoom_factor(self.settings.scale);
        }
    }

    /// The newest failure, as long as it is new, in words that say what to do.
    fn tell_trouble(&self, ui: &mut Ui, status: &BenchStatus) {
        let newest = status.events.iter().rev().take(3).find(|event| event.gravity == Gravity::Error);
        if let Some(event) = newest {
            let text = RichText::new(format!("{}  {}", event.time, event.text));
            ui.label(text.color(panels::color_of(Gravity::Error)));
        }
    }

    fn side(&mut self, ui: &mut Ui, status: &BenchStatus, wishes: &mut Wishes) {
        Panel::right("side").default_size(310.0).min_size(280.0).show(ui, |ui| {
            ui.add_space(4.0);
            ui.horizontal_wrapped(|ui| {
                // All of them in one row of the narrowest side.
                (ui.spacing_mut().item_spacing.x, ui.spacing_mut().button_padding.x) = (1.0, 5.0);
                for (side, name, hover) in Side::ALL {
                    ui.selectable_value(&mut self.settings.side, side, RichText::new(name).size(14.0))
                        .on_hover_text(hover);
                }
            });
            ui.separator();
            panels::run(ui, status, wishes);
            ScrollArea::vertical().id_salt("side").auto_shrink([false, false]).show(ui, |ui| {
                let Some(card) = status.instrument.as_deref() else {
                    return panels::replay(ui, status, &mut self.forms.replay, wishes);
                };
                let forms = &mut self.forms;
                match self.settings.side {
                    Side::Live => panels::live(ui, status, card, forms, &self.presets, wishes),
                    Side::Plan => panels::plan(ui, status, card, &mut forms.plan, wishes),
                    Side::Devices => panels::instrument(ui, status, card, forms, wishes),
                    Side::Align => panels::align(ui, status, forms, wishes),
                    Side::Replay => panels::replay(ui, status, &mut forms.replay, wishes),
                }
            });
        });
    }

    fn below(&mut self, ui: &mut Ui, status: &BenchStatus, pictures: &Pictures) {
        let view = self.history.view();
        let lines = match (self.line_um, self.settings.below) {
            (Some(line), Below::Profile) => panels::profile(&layers(pictures, &view), line),
            _ => Vec::new(),
        };
        let mut contrast = None;
        Panel::bottom("below").resizable(true).default_size(220.0).min_size(120.0).show(ui, |ui| {
            ui.horizontal(|ui| {
                for (below, name, hover) in Below::ALL {
                    ui.selectable_value(&mut self.settings.below, below, name).on_hover_text(hover);
                }
            });
            let limits: Vec<Limits> =
                self.cameras.iter().flat_map(|camera| camera.limits().first().copied()).collect();
            let shown = panels::Shown { status, pictures, limits: &limits, line: &lines };
            contrast = panels::below(ui, self.settings.below, &shown, view.contrasts[0]);
            ui.take_available_height();
        });
        if let Some(contrast) = contrast {
            let mut view = self.history.view();
            view.contrasts[0] = contrast;
            self.change(ui, view);
        }
    }

    fn images(
        &mut self,
        ui: &mut Ui,
        status: &BenchStatus,
        pictures: &Pictures,
        wishes: &mut Wishes,
    ) -> Done {
        let mut view = self.history.view();
        self.choose(ui, pictures, &mut view, wishes);
        let waiting = waiting(status);
        let mut done = Done::default();
        let marks = self.marks(pictures);
        let marks_regions = self.marks_regions();
        let share = if self.settings.shows_cameras { 0.30 } else { 0.0 };
        let area = ui.available_rect_before_wrap();
        if share > 0.0 {
            let width = (area.width() * share).min(area.height() * 0.5).max(0.0);
            Panel::left("cameras").exact_size(width).resizable(false).show(ui, |ui| {
                let height = ((ui.available_height() - 8.0) * 0.5).max(0.0);
                for (index, canvas) in self.cameras.iter_mut().enumerate() {
                    canvas.set_pace(self.pace);
                    canvas.set_marks(if index == 0 { marks.clone() } else { Vec::new() });
                    let own = View { subject: Subject::Camera(index), split: None, ..view };
                    ui.allocate_ui(egui::Vec2::new(ui.available_width(), height), |ui| {
                        let mut one = canvas.ui(ui, pictures, &own, waiting);
                        // Regions are on the pixels of camera R.
                        one.rectangle_um = one.rectangle_um.filter(|_| index == 0 || !marks_regions);
                        merge(&mut done, one);
                    });
                }
            });
        }
        CentralPanel::no_frame().show(ui, |ui| {
            self.result.set_pace(self.pace);
            let is_of_t = view.subject == Subject::Camera(1);
            self.result.set_marks(if is_of_t { Vec::new() } else { marks });
            let mut one = self.result.ui(ui, pictures, &view, waiting);
            one.rectangle_um = one.rectangle_um.filter(|_| !is_of_t || !marks_regions);
            merge(&mut done, one);
        });
        self.change(ui, view);
        done
    }

    /// Whether rectangles mark where dyes are.
    fn marks_regions(&self) -> bool {
        self.settings.side == Side::Align && self.forms.colors.is_shown
    }

    /// What is marked, where the panes show it.
    fn marks(&self, pictures: &Pictures) -> Vec<Mark> {
        let pitch_um = pictures.cameras.as_ref().map(|look| look.pixel_pitch_nm / 1e3);
        let Some(pitch_um) = pitch_um.filter(|_| self.marks_regions()) else { return Vec::new() };
        let [left, top] = self.live_corner.map(f64::from);
        let marks = self.forms.colors.marks().into_iter().map(|(area, color, name)| {
            let [x, y, width, height] = area.map(f64::from);
            Mark { area_um: [x - left, y - top, width, height].map(|px| px * pitch_um), color, name }
        });
        marks.collect()
    }

    /// Another view; what changes within one gesture is undone together.
    fn change(&mut self, ui: &Ui, view: View) {
        if view != self.history.view() {
            let goes_on = ui.input(|input| self.gestures.goes_on(input));
            self.history.set(view, goes_on);
        }
    }

    fn undo(&mut self) {
        self.gestures.end();
        self.history.undo();
    }

    fn redo(&mut self) {
        self.gestures.end();
        self.history.redo();
    }
}

fn merge(done: &mut Done, one: Done) {
    done.zoom = done.zoom.or(one.zoom);
    done.split = done.split.or(one.split);
    done.line_um = done.line_um.or(one.line_um);
    done.rectangle_um = done.rectangle_um.or(one.rectangle_um);
    done.center_um = done.center_um.or(one.center_um);
    done.reading = done.reading.take().or(one.reading);
}

fn waiting(status: &BenchStatus) -> &'static str {
    match status.activity {
        Activity::Live | Activity::Run | Activity::Replay | Activity::Paused => {
            "waiting for the first frames ..."
        }
        Activity::Ending => "finishing ...",
        _ => "press Live (L) to see the sample",
    }
}
