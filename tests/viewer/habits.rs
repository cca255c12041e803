//! Habits of the window: every control says what it is for, nothing is modal, panes move together, what has not
//! changed is not drawn anew, fine screens get fine pictures.

use std::cell::Cell;
use std::rc::Rc;
use std::time::Instant;

use egui::accesskit::Role;
use egui::epaint::{ClippedShape, Shape};
use egui::{Event, Key, Modifiers, MouseWheelSource, MouseWheelUnit, Order, Rect, TouchPhase, Vec2};
use egui_kittest::kittest::{NodeT, Queryable};
use egui_kittest::{Harness, TestRenderer};
use sofiscope::viewer::Window;
use sofiscope::viewer::bench::Activity;

use crate::fake::{click, open, press, showing};

/// Longer than a pointer has to rest for a tooltip, in steps.
const RESTS: usize = 16;

fn has_tooltip(harness: &Harness<'static, Window>) -> bool {
    harness
        .ctx
        .memory(|memory| memory.areas().visible_layer_ids().iter().any(|layer| layer.order == Order::Tooltip))
}

/// What can be operated, with its name: buttons, numbers, texts, ticks.
fn controls(harness: &Harness<'static, Window>) -> Vec<(String, Rect)> {
    let kinds = [Role::Button, Role::SpinButton, Role::CheckBox, Role::TextInput, Role::ComboBox];
    let window = harness.ctx.content_rect();
    harness
        .query_all(egui_kittest::kittest::By::new().predicate(move |node| kinds.contains(&node.role())))
        .map(|node| (node.accesskit_node().label().unwrap_or_default(), node.rect()))
        .filter(|(_, rect)| window.contains(rect.center()) && rect.width() > 1.0)
        .collect()
}

#[test]
fn every_control_says_what_it_is_for() {
    let mut silent = Vec::new();
    let mut seen = std::collections::BTreeSet::new();
    for tab in ["Live view", "Plan", "Instrument", "Align", "Replay"] {
        let (_, mut harness) = showing(open(Activity::Idle));
        click(&mut harness, tab);
        harness.run_steps(4);
        for (name, rect) in controls(&harness) {
            // The same control in the same place is tried once.
            if !seen.insert((name.clone(), rect.min.x as i32, rect.min.y as i32)) {
                continue;
            }
            harness.hover_at(rect.center());
            harness.run_steps(RESTS);
            if !has_tooltip(&harness) {
                silent.push(format!("{tab}: {name:?} at {rect:?}"));
            }
            harness.hover_at(egui::Pos2::new(640.0, 795.0));
            harness.run_steps(4);
        }
    }
    assert!(silent.is_empty(), "without a word: {silent:#?}");
}

#[test]
fn no_state_has_a_modal_dialog() {
    use Activity::{Closed, Ending, Idle, Live, Opening, Paused, Replay, Run};
    for activity in [Closed, Opening, Idle, Live, Run, Paused, Replay, Ending] {
        let (_, mut harness) = showing(open(activity.clone()));
        press(&mut harness, Modifiers::NONE, Key::F1);
        assert!(harness.ctx.memory(egui::Memory::top_modal_layer).is_none(), "{activity:?}");
    }
}

/// The part of the sample that a pane shows, and how many pixels it has for that.
fn kept(harness: &mut Harness<'static, Window>, fake: &crate::fake::Fake) -> ([f64; 4], [usize; 2]) {
    press(harness, Modifiers::NONE, Key::E);
    let asked = fake.asked.borrow();
    let request = &asked.kept.last().expect("the picture is kept").request;
    (request.part_um, request.size)
}

#[test]
fn panes_are_zoomed_and_moved_together() {
    let (fake, mut harness) = showing(open(Activity::Live));
    let whole = kept(&mut harness, &fake).0;
    let camera = harness.get_by_label("camera R image").rect().center();
    harness.hover_at(camera);
    harness.run_steps(2);
    for _ in 0..3 {
        harness.event(Event::MouseWheel {
            unit: MouseWheelUnit::Point,
            delta: Vec2::new(0.0, 40.0),
            phase: TouchPhase::Move,
            source: MouseWheelSource::Wheel,
            modifiers: Modifiers::NONE,
        });
        harness.run_steps(6);
    }
    let near = kept(&mut harness, &fake).0;
    assert!(near[2] < 0.9 * whole[2], "the wheel over a camera zooms the result: {whole:?} {near:?}");
}

fn shapes(harness: &Harness<'static, Window>) -> Vec<Shape> {
    fn flat(shape: &Shape, all: &mut Vec<Shape>) {
        match shape {
            Shape::Vec(many) => many.iter().for_each(|one| flat(one, all)),
            one => all.push(one.clone()),
        }
    }
    let mut all = Vec::new();
    harness.output().shapes.iter().for_each(|ClippedShape { shape, .. }| flat(shape, &mut all));
    all
}

#[test]
fn every_pane_has_a_scale_bar_as_long_as_it_says() {
    let (_, harness) = showing(open(Activity::Live));
    let all = shapes(&harness);
    let bars: Vec<Rect> = all
        .iter()
        .filter_map(|shape| match shape {
            Shape::Rect(bar) if bar.fill == egui::Color32::WHITE && (bar.rect.height() - 4.0).abs() < 0.1 => {
                Some(bar.rect)
            }
            _ => None,
        })
        .collect();
    let length_um = |bar: &Rect| {
        all.iter().find_map(|shape| match shape {
            Shape::Text(text) => {
                let area = text.visual_bounding_rect();
                let is_of_it = (area.center().x - bar.center().x).abs() < 1.0
                    && (0.0..8.0).contains(&(bar.top() - area.bottom()));
                let words = text.galley.text();
                let number: f32 = words.split(' ').next()?.parse().ok()?;
                is_of_it.then_some(if words.ends_with("nm") { number / 1e3 } else { number })
            }
            _ => None,
        })
    };
    for (pane, columns_um) in [("result", 6.4_f32), ("camera R image", 6.4), ("camera T image", 6.4)] {
        let rect = harness.get_by_label(pane).rect();
        let bar = bars.iter().find(|bar| rect.contains_rect(**bar));
        let bar = bar.unwrap_or_else(|| panic!("{pane} has no scale bar: {bars:?}"));
        // The whole image fits: 64 x 48 pixels of 100 nm.
        let points_per_um = (rect.width() / columns_um).min(rect.height() / 4.8);
        let length = length_um(bar).unwrap_or_else(|| panic!("the bar of {pane} has no length"));
        let wanted = length * points_per_um;
        assert!((bar.width() - wanted).abs() < 0.01 * wanted, "{pane}: {} for {wanted}", bar.width());
    }
}

#[test]
fn the_focus_trace_is_drawn() {
    let (_, mut harness) = showing(open(Activity::Live));
    click(&mut harness, "Instrument");
    harness.run_steps(4);
    let errors: Vec<f64> =
        open(Activity::Live).focus.unwrap().trace.iter().map(|(_, error)| *error).collect();
    // A line through three places whose heights are to each other as the errors are.
    let is_the_trace = |shape: &Shape| match shape {
        Shape::Path(path) if path.points.len() == 3 && !path.closed => {
            let [a, b, c] = [0, 1, 2].map(|at| f64::from(path.points[at].y));
            let wanted = (errors[2] - errors[1]) / (errors[0] - errors[1]);
            ((c - b) / (a - b) - wanted).abs() < 0.01
        }
        _ => false,
    };
    assert_eq!(shapes(&harness).iter().filter(|shape| is_the_trace(shape)).count(), 1);
    let mut status = open(Activity::Live);
    status.focus.as_mut().unwrap().trace.clear();
    let (_, mut harness) = showing(status);
    click(&mut harness, "Instrument");
    harness.run_steps(4);
    assert!(!shapes(&harness).iter().any(is_the_trace));
}

/// A screen that counts the images that it is sent.
struct Counting(Rc<Cell<usize>>);

impl TestRenderer for Counting {
    fn handle_delta(&mut self, delta: &mut egui::TexturesDelta) {
        // Writing that is new to the screen brings parts of its letters, which are no images.
        let whole = delta.set.values().flatten().filter(|image| image.is_whole());
        self.0.set(self.0.get() + whole.count());
        delta.clear();
    }
}

#[test]
fn what_has_not_changed_is_not_sent_to_the_screen_again() {
    let fake = crate::fake::Fake::default();
    (*fake.status.borrow_mut(), *fake.pictures.borrow_mut()) =
        (open(Activity::Live), crate::fake::pictures());
    let (window, sent) = (window(&fake), Rc::new(Cell::new(0)));
    let mut harness = Harness::builder()
        .with_size(Vec2::new(1280.0, 800.0))
        .with_step_dt(0.05)
        .renderer(Counting(Rc::clone(&sent)))
        .build_ui_state(|ui, window: &mut Window| window.ui(ui), window);
    let before = settled(&mut harness, &sent);
    assert!(before >= 3, "three panes have pictures");
    // A new result changes its own pane only.
    let newer = crate::fake::pictures().sofi;
    fake.pictures.borrow_mut().sofi = newer;
    let begun = Instant::now();
    while sent.get() == before {
        harness.run_steps(1);
        assert!(begun.elapsed().as_secs() < 60, "the new result is not shown");
    }
    assert_eq!(settled(&mut harness, &sent), before + 1);
}

/// How many images were sent when a thousand looks have brought none.
fn settled(harness: &mut Harness<'static, Window>, sent: &Cell<usize>) -> usize {
    let (mut quiet, begun) = (0, Instant::now());
    while quiet < 1000 || harness.state().has_pictures() != (true, true) {
        let before = sent.get();
        harness.run_steps(1);
        quiet = if sent.get() == before { quiet + 1 } else { 0 };
        assert!(begun.elapsed().as_secs() < 120, "images are sent again and again: {} of them", sent.get());
    }
    sent.get()
}

fn window(fake: &crate::fake::Fake) -> Window {
    Window::new(Box::new(fake.clone()), sofiscope::viewer::WindowSettings::default())
}

#[test]
fn a_fine_screen_gets_a_picture_as_fine() {
    let [coarse, fine] = [1.0, 2.0].map(|pixels_per_point| {
        let fake = crate::fake::Fake::default();
        (*fake.status.borrow_mut(), *fake.pictures.borrow_mut()) =
            (open(Activity::Live), crate::fake::pictures());
        let window = window(&fake);
        let mut harness = Harness::builder()
            .with_size(Vec2::new(1280.0, 800.0))
            .with_pixels_per_point(pixels_per_point)
            .with_step_dt(0.05)
            .build_ui_state(|ui, window: &mut Window| window.ui(ui), window);
        harness.run_steps(6);
        kept(&mut harness, &fake)
    });
    assert_eq!(coarse.0, fine.0);
    for (fine, coarse) in fine.1.into_iter().zip(coarse.1) {
        assert!(fine.abs_diff(2 * coarse) <= 1, "{coarse} became {fine}");
    }
}

#[test]
fn writing_of_any_size_leaves_a_window_that_can_be_drawn() {
    // The largest writing on a small screen leaves room for little more than the bars.
    let (fake, mut harness) = showing(open(Activity::Live));
    for _ in 0..20 {
        press(&mut harness, Modifiers::COMMAND, Key::Plus);
    }
    harness.set_size(Vec2::new(360.0, 240.0));
    harness.run_steps(6);
    press(&mut harness, Modifiers::COMMAND, Key::Period);
    assert_eq!(fake.asked.borrow().stops, 1);
}
