//! What is done with images: registration, handles of the histogram, undo of gestures, pictures as seen.

use std::sync::Arc;

use egui::{Event, Key, Modifiers, MouseWheelSource, MouseWheelUnit, TouchPhase, Vec2};
use egui_kittest::Harness;
use egui_kittest::kittest::Queryable;
use sofiscope::display::{Contrast, Limits};
use sofiscope::reconstruction::{PixelMap, Quality, SofiStage};
use sofiscope::viewer::Window;
use sofiscope::viewer::bench::{Activity, BenchStatus, Pictures};
use sofiscope::viewer::plane::layers;
use sofiscope::viewer::view::Subject;

use crate::fake::{Fake, click, harness, open, pictures, press, says, showing, with};

const MIRRORED: PixelMap = PixelMap { matrix: [[1.0, 0.0], [0.0, -1.0]], shift: [0.0, 63.0] };

fn registered() -> Pictures {
    let mut shown = pictures();
    let look = shown.cameras.as_deref().cloned();
    shown.cameras = look.map(|look| Arc::new(look.registered(Some(MIRRORED))));
    shown
}

#[test]
fn the_overlay_is_registered_or_shows_both_cameras_as_they_are() {
    let fake = Fake::default();
    (*fake.status.borrow_mut(), *fake.pictures.borrow_mut()) = (open(Activity::Live), registered());
    let mut harness = harness(&fake);
    assert!(harness.query_by_label("Registered").is_none(), "only where both are shown");
    press(&mut harness, Modifiers::NONE, Key::O);
    let warps = |harness: &Harness<'static, Window>| -> Vec<_> {
        layers(&registered(), &harness.state().view()).iter().map(|layer| layer.warp).collect()
    };
    assert_eq!(warps(&harness), [None, Some(MIRRORED)]);
    click(&mut harness, "Registered");
    assert_eq!(warps(&harness), [None, None]);
    press(&mut harness, Modifiers::COMMAND, Key::Z);
    assert_eq!(warps(&harness), [None, Some(MIRRORED)]);
    press(&mut harness, Modifiers::NONE, Key::T);
    assert_eq!(warps(&harness), [None], "a camera alone is shown as it is");
}

#[test]
fn without_a_registration_there_is_nothing_to_apply() {
    let (_, mut harness) = showing(open(Activity::Live));
    press(&mut harness, Modifiers::NONE, Key::O);
    let before = harness.state().view();
    click(&mut harness, "Registered");
    assert_eq!(harness.state().view(), before);
}

/// Drags by points of the screen, in steps.
fn drag(harness: &mut Harness<'static, Window>, from: egui::Pos2, by: Vec2) {
    harness.drag_at(from);
    harness.run_steps(2);
    for step in 1..=4_u8 {
        harness.hover_at(from + by * (f32::from(step) / 4.0));
        harness.run_steps(2);
    }
    harness.drop_at(from + by);
    harness.run_steps(2);
}

fn limits(harness: &Harness<'static, Window>) -> Limits {
    match harness.state().view().contrasts[0] {
        Contrast::Manual(limits) => limits,
        other => panic!("{other:?}"),
    }
}

/// Waits for the pictures of the cameras, whose limits have the handles; nobody else would ask for another look.
fn until_seen(harness: &mut Harness<'static, Window>) {
    while !harness.state().has_pictures().1 {
        harness.run_steps(1);
    }
    harness.run_steps(3);
}

#[test]
fn handles_of_the_histogram_set_black_and_white_and_one_undo_takes_a_drag_back() {
    let (_, mut harness) = showing(open(Activity::Live));
    let first = harness.state().view();
    until_seen(&mut harness);
    click(&mut harness, "Histogram");
    harness.run_steps(4);
    let white = harness.get_by_label("white of camera T").rect().center();
    drag(&mut harness, white, Vec2::new(-120.0, 0.0));
    let by_hand = limits(&harness);
    assert!(by_hand.high < 150.0 && by_hand.high > by_hand.low, "{by_hand:?}");
    let black = harness.get_by_label("black").rect().center();
    drag(&mut harness, black, Vec2::new(-40.0, 0.0));
    assert!(limits(&harness).low < by_hand.low && limits(&harness).high == by_hand.high);
    press(&mut harness, Modifiers::COMMAND, Key::Z);
    assert_eq!(limits(&harness), by_hand, "the second drag as a whole");
    press(&mut harness, Modifiers::COMMAND, Key::Z);
    assert_eq!(harness.state().view(), first, "the first drag as a whole");
    press(&mut harness, Modifiers::COMMAND, Key::Y);
    assert_eq!(limits(&harness), by_hand);
}

fn scroll(harness: &mut Harness<'static, Window>) {
    for _ in 0..3 {
        harness.event(Event::MouseWheel {
            unit: MouseWheelUnit::Point,
            delta: Vec2::new(0.0, 20.0),
            phase: TouchPhase::Move,
            source: MouseWheelSource::Wheel,
            modifiers: Modifiers::NONE,
        });
        harness.run_steps(2);
    }
    harness.run_steps(10);
}

#[test]
fn a_turn_of_the_wheel_and_a_drag_of_the_image_are_steps_of_their_own() {
    let (_, mut harness) = showing(open(Activity::Live));
    let middle = harness.get_by_label("result").rect().center();
    harness.hover_at(middle);
    harness.run_steps(2);
    scroll(&mut harness);
    let zoomed = harness.state().view();
    assert!(zoomed.zoom.is_some());
    drag(&mut harness, middle, Vec2::new(60.0, 30.0));
    assert_ne!(harness.state().view().zoom, zoomed.zoom);
    press(&mut harness, Modifiers::COMMAND, Key::Z);
    assert_eq!(harness.state().view(), zoomed);
    press(&mut harness, Modifiers::COMMAND, Key::Z);
    assert_eq!(harness.state().view().zoom, None);
}

#[test]
fn the_divider_is_dragged_and_undone_as_a_whole() {
    let (_, mut harness) = showing(open(Activity::Live));
    press(&mut harness, Modifiers::NONE, Key::M);
    let middle = harness.get_by_label("result").rect().center();
    drag(&mut harness, middle, Vec2::new(-100.0, 0.0));
    let split = harness.state().view().split.unwrap();
    assert!(split < 0.45, "{split}");
    press(&mut harness, Modifiers::COMMAND, Key::Z);
    assert_eq!(harness.state().view().split, Some(0.5));
}

#[test]
fn the_pane_is_kept_as_it_is_seen() {
    let (fake, mut harness) = showing(open(Activity::Live));
    press(&mut harness, Modifiers::NONE, Key::Num3);
    harness.run_steps(4);
    click(&mut harness, "Save picture");
    press(&mut harness, Modifiers::NONE, Key::T);
    press(&mut harness, Modifiers::NONE, Key::E);
    let kept = fake.asked.borrow().kept.clone();
    let names: Vec<Vec<_>> =
        kept.iter().map(|one| one.request.layers.iter().map(|layer| layer.name.clone()).collect()).collect();
    assert_eq!(names, [vec!["dye A unmixed", "dye B unmixed"], vec!["camera T"]]);
    assert_eq!(kept[0].label, "200 exposures, linearized");
    assert_eq!(kept[1].label, "exposure 7");
    assert!(kept.iter().all(|one| one.path.ends_with("sofiscope-picture.png")));
    assert_eq!(kept[0].request.contrast, harness.state().view().contrasts[2]);
}

#[test]
fn without_an_image_there_is_no_picture_and_the_window_says_so() {
    let (fake, mut harness) = with(open(Activity::Idle));
    click(&mut harness, "Save picture");
    press(&mut harness, Modifiers::NONE, Key::E);
    assert!(fake.asked.borrow().kept.is_empty());
    assert!(says(&harness, "there is no image yet; start the live view first"));
}

#[test]
fn plots_without_points_say_that_there_is_nothing_yet() {
    let quality = Quality { snr_species: vec![None, None], ..Quality::default() };
    let status = BenchStatus { quality: Arc::new(vec![quality]), ..open(Activity::Live) };
    let (_, mut harness) = showing(status);
    for part in ["SNR: nothing yet", "resolution, nm: nothing yet", "light left: nothing yet"] {
        assert!(says(&harness, part), "{part}");
    }
    let subject = harness.state().view().subject;
    assert_eq!(subject, Subject::Composite(SofiStage::Linearized));
    click(&mut harness, "Profile");
    assert!(says(&harness, "Drag with Shift in an image"));
}
