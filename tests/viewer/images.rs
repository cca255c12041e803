//! A hand in the images: profile, region, stage, read-out; what is chosen above them and drawn below them.

use std::sync::Arc;

use egui::accesskit::Role;
use egui::{Event, Key, Modifiers, PointerButton, Pos2, Rect, Theme, Vec2};
use egui_kittest::Harness;
use egui_kittest::kittest::Queryable;
use sofiscope::display::Colormap;
use sofiscope::reconstruction::{BleachingState, Quality, Resolution, SofiStage};
use sofiscope::viewer::bench::{Activity, BenchCommand, BenchStatus};
use sofiscope::viewer::view::Subject;
use sofiscope::viewer::{Below, Window};

use crate::fake::{click, open, press, says, showing};

/// Sides of both the cameras' and the result's images in the sample, micrometers.
const EXTENT_UM: [f64; 2] = [6.4, 4.8];

fn button(harness: &mut Harness<'static, Window>, at: Pos2, which: PointerButton, keys: Modifiers) {
    for pressed in [true, false] {
        one(harness, at, which, pressed, keys);
    }
}

fn one(
    harness: &mut Harness<'static, Window>,
    pos: Pos2,
    button: PointerButton,
    pressed: bool,
    modifiers: Modifiers,
) {
    harness.event(Event::ModifiersChanged(modifiers));
    harness.event(Event::PointerMoved(pos));
    harness.event(Event::PointerButton { pos, button, pressed, modifiers });
    harness.run_steps(2);
}

pub(crate) fn drag(harness: &mut Harness<'static, Window>, from: Pos2, by: Vec2, keys: Modifiers) {
    one(harness, from, PointerButton::Primary, true, keys);
    for step in 1..=4_u8 {
        harness.event(Event::PointerMoved(from + by * (f32::from(step) / 4.0)));
        harness.run_steps(2);
    }
    one(harness, from + by, PointerButton::Primary, false, keys);
    harness.event(Event::ModifiersChanged(Modifiers::NONE));
    harness.run_steps(2);
}

/// Points of the screen per micrometer, of an image that fits its pane.
pub(crate) fn points_per_um(pane: Rect) -> f64 {
    (f64::from(pane.width()) / EXTENT_UM[0]).min(f64::from(pane.height()) / EXTENT_UM[1])
}

#[test]
fn a_drag_with_shift_brings_the_profile() {
    let (_, mut harness) = showing(open(Activity::Live));
    let pane = harness.get_by_label("result").rect();
    let view = harness.state().view();
    drag(&mut harness, pane.center(), Vec2::new(60.0, 10.0), Modifiers::SHIFT);
    assert_eq!(harness.state().settings().below, Below::Profile);
    assert!(!says(&harness, "Drag with Shift in an image"), "there is a line");
    assert_eq!(harness.state().view(), view, "the image stays where it is");
}

#[test]
fn a_drag_with_ctrl_in_a_camera_is_the_region_of_the_next_live_view() {
    let (fake, mut harness) = showing(open(Activity::Live));
    assert!(says(&harness, "Region: whole sensor, 64 x 48 px"));
    let pane = harness.get_by_label("camera R image").rect();
    let (by, keys) = (Vec2::new(80.0, 50.0), Modifiers::CTRL | Modifiers::COMMAND);
    drag(&mut harness, pane.center(), by, keys);
    press(&mut harness, Modifiers::NONE, Key::L);
    let commands = fake.asked.borrow().commands.clone();
    let [BenchCommand::Live(settings)] = &commands[..] else { panic!("{commands:?}") };
    let region = settings.region.unwrap().map(f64::from);
    let px = |points: f32| f64::from(points) / points_per_um(pane) / 0.1;
    for (is, should) in region.into_iter().zip([32.0, 24.0, px(by.x), px(by.y)]) {
        assert!((is - should).abs() <= 1.0, "{region:?}: {is} should be {should}");
    }
    click(&mut harness, "Whole sensor");
    assert!(says(&harness, "Region: whole sensor, 64 x 48 px"));
}

#[test]
fn a_right_click_brings_the_place_to_the_middle() {
    let (fake, mut harness) = showing(open(Activity::Live));
    let pane = harness.get_by_label("camera R image").rect();
    let off = Vec2::new(40.0, -30.0);
    button(&mut harness, pane.center() + off, PointerButton::Secondary, Modifiers::NONE);
    let commands = fake.asked.borrow().commands.clone();
    let [BenchCommand::MoveStage { x_um, y_um }] = commands[..] else { panic!("{commands:?}") };
    let um = |points: f32| f64::from(points) / points_per_um(pane);
    assert!((x_um - 500.0 - um(off.x)).abs() < 1e-3 && (y_um - 400.0 - um(off.y)).abs() < 1e-3);
}

#[test]
fn the_value_under_the_pointer_is_read_out() {
    let (_, mut harness) = showing(open(Activity::Live));
    let pane = harness.get_by_label("result").rect();
    harness.hover_at(pane.center() + Vec2::splat(3.0));
    harness.run_steps(3);
    let um = |side: usize| 0.5 * EXTENT_UM[side] + 3.0 / points_per_um(pane);
    let [column, row] = [0, 1].map(|side| (um(side) / 0.05).floor());
    for dye in ["dye A", "dye B"] {
        let part = format!("{dye} linearized [{column}, {row}] = {}", column * row);
        assert!(says(&harness, &part), "{part}");
    }
}

#[test]
fn every_step_and_image_can_be_chosen_in_every_color() {
    let (_, mut harness) = showing(open(Activity::Live));
    harness.set_size(Vec2::new(1280.0, 1400.0));
    harness.run_steps(3);
    for (name, subject) in [
        ("mean, all", Subject::Composite(SofiStage::Mean)),
        ("cumulants, dye A", Subject::One(SofiStage::Cumulant, 0)),
        ("unmixed, dye B", Subject::One(SofiStage::Unmixed, 1)),
        ("flattened, all", Subject::Composite(SofiStage::Flattened)),
        ("linearized, dye B", Subject::One(SofiStage::Linearized, 1)),
        ("camera T", Subject::Camera(1)),
        ("both cameras", Subject::Overlay),
    ] {
        harness.get_by_role_and_label(Role::ComboBox, "Image").click();
        harness.run_steps(4);
        harness.get_by_role_and_label(Role::Button, name).scroll_to_me();
        harness.run_steps(8);
        harness.get_by_role_and_label(Role::Button, name).click();
        harness.run_steps(4);
        assert_eq!(harness.state().view().subject, subject, "{name}");
    }
    for map in Colormap::ALL {
        harness.get_by_role_and_label(Role::ComboBox, "Colors").click();
        harness.run_steps(4);
        harness.get_by_role_and_label(Role::Button, map.name()).click();
        harness.run_steps(4);
        assert_eq!(harness.state().view().colormap, map);
    }
}

#[test]
fn theme_and_size_of_writing_are_chosen_and_kept() {
    let (_, mut harness) = showing(open(Activity::Idle));
    assert_eq!(harness.ctx.theme(), Theme::Dark);
    click(&mut harness, "View");
    click(&mut harness, "Dark theme");
    assert_eq!(harness.ctx.theme(), Theme::Light);
    if !says(&harness, "Size of writing") {
        click(&mut harness, "View");
    }
    click(&mut harness, "A+");
    assert!((harness.ctx.zoom_factor() - 1.1).abs() < 1e-3, "{}", harness.ctx.zoom_factor());
    let settings = harness.state().settings();
    assert!(!settings.is_dark && (settings.scale - 1.1).abs() < 1e-3);
}

#[test]
fn curves_say_how_many_exposures_are_still_needed() {
    let quality = |subsequences: u64, snr: f64| Quality {
        subsequences,
        exposures: 200 * subsequences,
        subsequence_exposures: 200,
        snr_species: vec![Some(snr), Some(2.0 * snr)],
        resolution: vec![Resolution { nm: Some(150.0), ..Resolution::default() }; 2],
        ..Quality::default()
    };
    let left = BleachingState {
        half_time_exposures: 1e9,
        half_time_s: None,
        half_time_range_exposures: [1e8, 1e10],
        left: 0.9,
    };
    let mut newest = quality(10, 2.5);
    newest.bleaching = vec![Some(left), Some(left)];
    let history = vec![quality(5, 1.8), newest.clone()];
    let (fake, mut harness) = showing(BenchStatus { quality: Arc::new(history), ..open(Activity::Live) });
    assert!(!says(&harness, "nothing yet"), "three plots with curves");
    let needed = newest.exposures_for_snr(5.0).unwrap();
    // Twice the signal-to-noise takes four times the exposures, 2000 of which are there.
    assert!((5800..=6200).contains(&needed), "{needed}");
    assert!(says(&harness, &format!("{needed} more exposures needed")));
    fake.status.borrow_mut().quality = Arc::new(vec![quality(40, 5.5)]);
    harness.run_steps(3);
    assert!(says(&harness, "Signal-to-noise 5 in every dye: reached"));
}
