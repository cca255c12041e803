//! The transport: a replay is held, goes on, goes elsewhere, goes faster.

use std::path::PathBuf;
use std::time::Duration;

use egui::accesskit::Role;
use egui::{Key, Modifiers};
use egui_kittest::kittest::Queryable;
use sofiscope::viewer::bench::{Activity, BenchCommand, BenchStatus, ReplayStatus};

use crate::fake::{click, open, press, says, showing};

fn playing(is_paused: bool) -> BenchStatus {
    let replay = ReplayStatus {
        recording: PathBuf::from("/tmp/cell-1"),
        exposures: 1000,
        position: 250,
        period: Duration::from_millis(20),
        speed: 1.0,
        is_paused,
    };
    BenchStatus { replay: Some(replay), ..open(Activity::Replay) }
}

#[test]
fn a_replay_is_held_and_goes_on_by_button_and_key() {
    let (fake, mut harness) = showing(playing(false));
    assert!(says(&harness, "replay of a recording") && says(&harness, "5.0 s of 20.0 s"));
    click(&mut harness, "Pause replay");
    press(&mut harness, Modifiers::NONE, Key::P);
    *fake.status.borrow_mut() = playing(true);
    harness.run_steps(2);
    assert!(says(&harness, "replay held"));
    click(&mut harness, "Resume replay");
    press(&mut harness, Modifiers::NONE, Key::P);
    let [pause, resume] = [BenchCommand::Pause, BenchCommand::Resume];
    assert_eq!(fake.asked.borrow().commands, [pause.clone(), pause, resume.clone(), resume]);
}

#[test]
fn another_speed_takes_effect_at_once() {
    let (fake, mut harness) = showing(playing(false));
    click(&mut harness, "5x");
    click(&mut harness, "max");
    click(&mut harness, "End");
    let speeds =
        [BenchCommand::ReplaySpeed(5.0), BenchCommand::ReplaySpeed(f64::INFINITY), BenchCommand::Finish];
    assert_eq!(fake.asked.borrow().commands, speeds);
}

#[test]
fn a_drag_along_the_recording_asks_once_at_its_end() {
    let (fake, mut harness) = showing(playing(false));
    let slider = harness.get_by_role_and_label(Role::Slider, "At exposure").rect();
    let at = |share: f32| egui::pos2(slider.left() + share * slider.width(), slider.center().y);
    harness.drag_at(at(0.2));
    harness.run_steps(2);
    for share in [0.3, 0.4, 0.5] {
        harness.hover_at(at(share));
        harness.run_steps(2);
    }
    assert!(fake.asked.borrow().commands.is_empty(), "not while it is dragged");
    harness.drop_at(at(0.5));
    harness.run_steps(3);
    let commands = fake.asked.borrow().commands.clone();
    let [BenchCommand::Seek(exposure)] = &commands[..] else { panic!("{commands:?}") };
    assert!((400..600).contains(exposure), "{exposure}");
}

#[test]
fn there_is_no_transport_without_a_replay() {
    let (_, harness) = showing(open(Activity::Live));
    assert!(harness.query_by_label("Pause replay").is_none());
}
