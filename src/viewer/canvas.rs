//! One pane with an image: drawn, zoomed, measured.
//!
//! In: the newest pictures, a view. Out: the pane, and what the person did in it. Never: makes pictures itself, waits.
//! Fails: not at all; a pane without an image says what it waits for.

use super::bench::Pictures;
use super::plane::{Layer, layers, mean_layers};
use super::renderer::{Renderer, Request};
use super::view::{View, Zoom};
use crate::display::{Limits, nice_length_at_most};
use egui::{Align2, Color32, FontId, Pos2, Rect, Response, Sense, Stroke, StrokeKind, Ui, Vec2};

/// What a person did in a pane.
#[derive(Debug, Clone, Default)]
pub struct Done {
    /// A new zoom; none within for the whole image.
    pub zoom: Option<Option<Zoom>>,
    /// The divider was dragged there.
    pub split: Option<f64>,
    /// A line from one place to another, micrometers.
    pub line_um: Option<[[f64; 2]; 2]>,
    /// A rectangle: left, top, width, height in micrometers.
    pub rectangle_um: Option<[f64; 4]>,
    /// Bring this place to the middle by moving the stage: micrometers from the middle of the image.
    pub center_um: Option<[f64; 2]>,
    /// What stands under the pointer, for people.
    pub reading: Option<String>,
}

/// A rectangle that is drawn over the image.
#[derive(Debug, Clone)]
pub struct Mark {
    /// Left, top, width, height in micrometers.
    pub area_um: [f64; 4],
    /// Of its line.
    pub color: Color32,
    /// Written beside it.
    pub name: String,
}

/// A pane.
pub struct Canvas {
    name: &'static str,
    renderer: Renderer,
    texture: Option<egui::TextureHandle>,
    /// Part of the sample that the texture shows.
    part_um: [f64; 4],
    limits: Vec<Limits>,
    asked: Option<Asked>,
    /// What is to be seen, also while the renderer is busy.
    wanted: Option<Request>,
    key: u64,
    drag: Option<Drag>,
    marks: Vec<Mark>,
    pace: std::time::Duration,
}

/// What was asked of the renderer last.
#[derive(Debug)]
struct Asked {
    request: Request,
    view: View,
}

/// A drag with a key held, from a place in micrometers.
#[derive(Debug, Clone, Copy)]
enum Drag {
    Line([f64; 2]),
    Rectangle([f64; 2]),
    Divider,
}

/// From micrometers in the sample to points of the screen.
#[derive(Debug, Clone, Copy)]
struct Place {
    zoom: Zoom,
    middle: Pos2,
}

impl Place {
    fn to_screen(self, [x, y]: [f64; 2]) -> Pos2 {
        let [cx, cy] = self.zoom.center_um;
        let by = |um: f64| (um * self.zoom.scale) as f32;
        self.middle + Vec2::new(by(x - cx), by(y - cy))
    }

    fn to_sample(self, place: Pos2) -> [f64; 2] {
        let [cx, cy] = self.zoom.center_um;
        let offset = place - self.middle;
        [cx + f64::from(offset.x) / self.zoom.scale, cy + f64::from(offset.y) / self.zoom.scale]
    }
}

impl Canvas {
    /// An empty pane.
    #[must_use]
    pub fn new(name: &'static str) -> Self {
        Self {
            name,
            renderer: Renderer::start(),
            texture: None,
            part_um: [0.0; 4],
            limits: Vec::new(),
            asked: None,
            wanted: None,
            key: 0,
            drag: None,
            marks: Vec::new(),
            pace: std::time::Duration::ZERO,
        }
    }

    /// A picture that is there is drawn after this time.
    pub fn set_pace(&mut self, pace: std::time::Duration) {
        self.pace = pace / 2;
    }

    /// Rectangles to be drawn over the image.
    pub fn set_marks(&mut self, marks: Vec<Mark>) {
        self.marks = marks;
    }

    /// Limits that the contrast came to, layer by layer.
    #[must_use]
    pub fn limits(&self) -> &[Limits] {
        &self.limits
    }

    /// The newest picture's size, for tests and measurements.
    #[must_use]
    pub fn has_picture(&self) -> bool {
        self.texture.is_some()
    }

    /// What the pane shows, to be drawn again; none as long as it shows nothing.
    #[must_use]
    pub fn shown(&self) -> Option<&Request> {
        self.wanted.as_ref()
    }

    /// Draws the pane into all the room that there is; `waiting` is shown as long as there is no image.
    pub fn ui(&mut self, ui: &mut Ui, pictures: &Pictures, view: &View, waiting: &str) -> Done {
        let (rect, response) =
            ui.allocate_exact_size(ui.available_size().max(Vec2::splat(40.0)), Sense::click_and_drag());
        let name = self.name;
        response.widget_info(|| egui::WidgetInfo::labeled(egui::Role::Image, true, name));
        let painter = ui.painter_at(rect);
        painter.rect_filled(rect, 2.0, Color32::from_gray(10));
        let layers = layers(pictures, view);
        let mut done = Done::default();
        let Some(first) = layers.first() else {
            self.texture = None;
            (self.asked, self.wanted) = (None, None);
            let room = rect.shrink(8.0);
            let font = FontId::proportional(15.0);
            let text = painter.layout(waiting.to_owned(), font, Color32::from_gray(150), room.width());
            painter.galley(room.center() - 0.5 * text.size(), text, Color32::from_gray(150));
            return done;
        };
        let extent = first.extent_um();
        let fitted = fit(extent, rect);
        let zoom = view.zoom.map(|zoom| Zoom { scale: zoom.scale * fitted.scale, ..zoom });
        let place = Place { zoom: zoom.unwrap_or(fitted), middle: rect.center() };
        self.interact(ui, &response, rect, place, view, &mut done);
        let relative = |zoom: Zoom| Zoom { scale: zoom.scale / fitted.scale, ..zoom };
        done.zoom = done.zoom.map(|zoom| zoom.map(relative));
        self.refresh(ui, rect, place, &layers, pictures, view);
        if let Some(texture) = &self.texture {
            let [left, top, width, height] = self.part_um;
            let area = Rect::from_two_pos(
                place.to_screen([left, top]),
                place.to_screen([left + width, top + height]),
            );
            let uv = Rect::from_min_max(Pos2::ZERO, Pos2::new(1.0, 1.0));
            painter.image(texture.id(), area, uv, Color32::WHITE);
        }
        scale_bar(&painter, rect, place.zoom.scale);
        self.overlays(&painter, rect, place, view, &response);
        if let Some(pointer) = response.hover_pos() {
            done.reading = Some(reading(&layers, place.to_sample(pointer)));
        }
        legend(&painter, rect, &layers);
        done
    }

    fn interact(
        &mut self,
        ui: &Ui,
        response: &Response,
        rect: Rect,
        place: Place,
        view: &View,
        done: &mut Done,
    ) {
        let (scroll, pinch, modifiers) =
            ui.input(|input| (input.smooth_scroll_delta().y, input.zoom_delta(), input.modifiers));
        if let Some(pointer) = response.hover_pos() {
            let factor = f64::from(pinch) * f64::from(scroll * 0.004).exp();
            if (factor - 1.0).abs() > 1e-6 {
                let offset = pointer - place.middle;
                let zoom = place.zoom.about([f64::from(offset.x), f64::from(offset.y)], factor);
                done.zoom = Some(Some(zoom));
            }
        }
        if response.drag_started()
            && let Some(pointer) = ui.input(|input| input.pointer.press_origin())
        {
            let at = place.to_sample(pointer);
            let on_divider = view.split.is_some_and(|share| (pointer.x - divider(rect, share)).abs() < 7.0);
            self.drag = match (modifiers.shift, modifiers.command, on_divider) {
                (true, ..) => Some(Drag::Line(at)),
                (_, true, _) => Some(Drag::Rectangle(at)),
                (_, _, true) => Some(Drag::Divider),
                _ => None,
            };
        }
        if response.dragged() {
            let pointer = response.interact_pointer_pos().map(|pointer| place.to_sample(pointer));
            match (self.drag, pointer) {
                (None, _) => {
                    let by = response.drag_delta();
                    let zoom = place.zoom.moved([f64::from(by.x), f64::from(by.y)]);
                    done.zoom = Some(Some(zoom));
                }
                (Some(Drag::Line(from)), Some(to)) => done.line_um = Some([from, to]),
                (Some(Drag::Rectangle(from)), Some(to)) => {
                    done.rectangle_um = Some([
                        from[0].min(to[0]),
                        from[1].min(to[1]),
                        (to[0] - from[0]).abs(),
                        (to[1] - from[1]).abs(),
                    ]);
                }
                (Some(Drag::Divider), _) => {
                    if let Some(pointer) = response.interact_pointer_pos() {
                        let share = (pointer.x - rect.left()) / rect.width();
                        done.split = Some(f64::from(share.clamp(0.02, 0.98)));
                    }
                }
                _ => {}
            }
        }
        if response.drag_stopped() {
            self.drag = None;
        }
        if response.double_clicked() {
            done.zoom = Some(None);
        }
        if response.secondary_clicked()
            && let Some(pointer) = response.interact_pointer_pos()
        {
            let [x, y] = place.to_sample(pointer);
            done.center_um = Some([x, y]);
        }
    }

    /// Asks for another picture when image, part, size or contrast have changed; shows the one that has come.
    fn refresh(
        &mut self,
        ui: &Ui,
        rect: Rect,
        place: Place,
        layers: &[Layer],
        pictures: &Pictures,
        view: &View,
    ) {
        if let Some(rendered) = self.renderer.take() {
            let options = egui::TextureOptions::NEAREST;
            match &mut self.texture {
                Some(texture) => texture.set(rendered.image, options),
                empty => *empty = Some(ui.ctx().load_texture(self.name, rendered.image, options)),
            }
            (self.part_um, self.limits) = (rendered.part_um, rendered.limits);
        }
        let extent = layers.first().map_or([1.0; 2], Layer::extent_um);
        let [from, to] = [rect.min, rect.max].map(|corner| place.to_sample(corner));
        let clip = |axis: usize| {
            let (begin, end) = (from[axis].max(0.0), to[axis].min(extent[axis]));
            (begin.min(extent[axis]), (end - begin).max(1e-3))
        };
        let ((left, width), (top, height)) = (clip(0), clip(1));
        let points = f64::from(ui.ctx().pixels_per_point()) * place.zoom.scale;
        let size = [width, height].map(|um| ((um * points).round() as usize).clamp(1, 4096));
        let part_um = [left, top, width, height];
        let split = view.split.filter(|_| view.shows_result()).map(|share| {
            let at = place.to_sample(Pos2::new(divider(rect, share), rect.top()))[0];
            ((at - left) / width).clamp(0.0, 1.0)
        });
        let is_known = self.asked.as_ref().is_some_and(|Asked { request, view: asked }| {
            request.part_um == part_um
                && request.size == size
                && request.split.as_ref().map(|(share, _)| *share) == split
                && asked == view
                && request.layers.len() == layers.len()
                && request.layers.iter().zip(layers).all(|(a, b)| a.pixels.is_same(&b.pixels))
        });
        if is_known {
            return;
        }
        let request = Request {
            key: self.key + 1,
            layers: layers.to_vec(),
            split: split.map(|share| (share, mean_layers(pictures))),
            contrast: view.contrast(),
            part_um,
            size,
            pace: self.pace,
        };
        self.wanted = Some(request.clone());
        if self.renderer.ask(request.clone(), ui.ctx()) {
            self.key += 1;
            self.asked = Some(Asked { request, view: *view });
        } else {
            ui.ctx().request_repaint_after(std::time::Duration::from_millis(15));
        }
    }

    fn overlays(&self, painter: &egui::Painter, rect: Rect, place: Place, view: &View, response: &Response) {
        if let Some(share) = view.split.filter(|_| view.shows_result()) {
            let x = divider(rect, share);
            painter.vline(x, rect.y_range(), Stroke::new(1.5, Color32::WHITE));
            let font = FontId::proportional(12.0);
            let y = rect.top() + 26.0;
            painter.text(Pos2::new(x - 6.0, y), Align2::RIGHT_CENTER, "mean", font.clone(), Color32::WHITE);
            painter.text(Pos2::new(x + 6.0, y), Align2::LEFT_CENTER, "SOFI", font, Color32::WHITE);
        }
        for Mark { area_um: [left, top, width, height], color, name } in &self.marks {
            let corner = place.to_screen([*left, *top]);
            let area = Rect::from_two_pos(corner, place.to_screen([left + width, top + height]));
            painter.rect_stroke(area, 0.0, Stroke::new(1.5, *color), StrokeKind::Middle);
            painter.text(corner, Align2::LEFT_BOTTOM, name, FontId::proportional(12.0), *color);
        }
        let Some(pointer) = response.interact_pointer_pos() else { return };
        let stroke = Stroke::new(1.5, Color32::from_rgb(255, 220, 80));
        match self.drag {
            Some(Drag::Line(from)) => {
                painter.line_segment([place.to_screen(from), pointer], stroke);
            }
            Some(Drag::Rectangle(from)) => {
                let area = Rect::from_two_pos(place.to_screen(from), pointer);
                painter.rect_stroke(area, 0.0, stroke, StrokeKind::Middle);
            }
            _ => {}
        }
    }
}

fn divider(rect: Rect, share: f64) -> f32 {
    rect.left() + rect.width() * share as f32
}

fn fit([width, height]: [f64; 2], rect: Rect) -> Zoom {
    let scale = (f64::from(rect.width()) / width).min(f64::from(rect.height()) / height);
    Zoom { center_um: [0.5 * width, 0.5 * height], scale: scale.max(1e-6) }
}

fn reading(layers: &[Layer], at: [f64; 2]) -> String {
    let values: Vec<String> = layers
        .iter()
        .filter_map(|layer| {
            let (column, row, value) = layer.at(at)?;
            let value = if value.is_nan() { "no value".to_owned() } else { in_digits(value) };
            Some(format!("{} [{column}, {row}] = {value}", layer.name))
        })
        .collect();
    format!("x {:.3} µm, y {:.3} µm   {}", at[0], at[1], values.join("   "))
}

/// Counts as they are, other values with the digits that tell something.
fn in_digits(value: f32) -> String {
    if value.fract() == 0.0 && value.abs() < 1e6 { format!("{value}") } else { format!("{value:.4}") }
}

fn scale_bar(painter: &egui::Painter, rect: Rect, points_per_um: f64) {
    let Some(length) = nice_length_at_most(f64::from(rect.width()) * 0.25 / points_per_um * 1e3) else {
        return;
    };
    let points = (length / 1e3 * points_per_um) as f32;
    let corner = rect.right_bottom() - Vec2::new(14.0, 14.0);
    let bar = Rect::from_min_max(corner - Vec2::new(points, 4.0), corner);
    painter.rect_filled(bar.expand(1.0), 0.0, Color32::from_black_alpha(140));
    painter.rect_filled(bar, 0.0, Color32::WHITE);
    let text = if length >= 1e3 { format!("{} µm", length / 1e3) } else { format!("{length} nm") };
    let above = bar.center_top() - Vec2::new(0.0, 3.0);
    painter.text(above, Align2::CENTER_BOTTOM, text, FontId::proportional(13.0), Color32::WHITE);
}

fn legend(painter: &egui::Painter, rect: Rect, layers: &[Layer]) {
    let mut at = rect.left_top() + Vec2::new(8.0, 6.0);
    for layer in layers {
        let color = match layer.paint {
            super::plane::Paint::Color([red, green, blue]) => Color32::from_rgb(red, green, blue),
            super::plane::Paint::Map(_) => Color32::WHITE,
        };
        let text = painter.layout_no_wrap(layer.name.clone(), FontId::proportional(12.5), color);
        let area = Rect::from_min_size(at, text.size()).expand(2.0);
        painter.rect_filled(area, 2.0, Color32::from_black_alpha(150));
        let step = text.size().x + 12.0;
        painter.galley(at, text, color);
        at.x += step;
        if at.x > rect.right() - 80.0 {
            at = Pos2::new(rect.left() + 8.0, at.y + 18.0);
        }
    }
}
