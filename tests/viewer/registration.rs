//! The registration of the cameras, step by step.

use std::sync::Arc;

use egui::accesskit::Role;
use egui_kittest::Harness;
use egui_kittest::kittest::{NodeT, Queryable};
use sofiscope::display::RgbImage;
use sofiscope::viewer::Window;
use sofiscope::viewer::bench::{
    Activity, BenchCommand, BenchStatus, FoundRegistration, RegisterBy, RegistrationAsk, RegistrationStatus,
    RegistrationStep,
};

use crate::fake::{Fake, click, open, says, showing};

fn align(activity: Activity, step: RegistrationStep) -> (Fake, Harness<'static, Window>) {
    let registration = RegistrationStatus { step, ..RegistrationStatus::default() };
    let (fake, mut harness) = showing(BenchStatus { registration, ..open(activity) });
    click(&mut harness, "Align");
    harness.set_size(egui::vec2(1280.0, 1400.0));
    harness.run_steps(4);
    (fake, harness)
}

fn found() -> RegistrationStep {
    let Ok(map) = RgbImage::from_fn(40, 60, |_, _| [90, 90, 90]) else { panic!("a picture of 60 x 40") };
    RegistrationStep::Found(Arc::new(FoundRegistration {
        by: RegisterBy::Beads,
        mirror: "horizontal".to_owned(),
        shift_px: [12.4, -9.71],
        rotation_deg: 0.6,
        scale: 1.004,
        residual_nm: 1.84,
        points: 153,
        points_left_out: 2,
        warnings: vec!["the residual is large".to_owned()],
        residual_map: Arc::new(map),
    }))
}

fn asked(fake: &Fake) -> Vec<RegistrationAsk> {
    let commands = fake.asked.borrow().commands.clone();
    let asked = commands.into_iter().map(|command| match command {
        BenchCommand::Registration(asked) => asked,
        other => panic!("{other:?}"),
    });
    asked.collect()
}

#[test]
fn the_cameras_are_registered_from_the_live_view_by_the_chosen_way() {
    let (fake, mut harness) = align(Activity::Live, RegistrationStep::Idle);
    assert!(says(&harness, "In use: none; the cameras are taken as aligned"));
    assert!(says(&harness, "The live view runs."));
    click(&mut harness, "Register");
    click(&mut harness, "Blinking sample");
    click(&mut harness, "Register");
    let begin = |by| RegistrationAsk::Begin { by, frames: 100 };
    assert_eq!(asked(&fake), [begin(RegisterBy::Beads), begin(RegisterBy::Blinking)]);
}

#[test]
fn it_is_not_begun_without_a_live_view_or_during_a_run_and_says_why() {
    for (activity, why) in [
        (Activity::Idle, "Start the live view first"),
        (Activity::Run, "Not during a run"),
        (Activity::Paused, "Not during a run"),
    ] {
        let (fake, mut harness) = align(activity, RegistrationStep::Idle);
        let button = harness.get_by_role_and_label(Role::Button, "Register");
        assert!(button.accesskit_node().is_disabled());
        button.hover();
        harness.run_steps(40);
        assert!(says(&harness, why), "{why}");
        click(&mut harness, "Register");
        assert!(asked(&fake).is_empty());
    }
}

#[test]
fn frames_are_counted_and_can_be_given_up() {
    let step = RegistrationStep::Gathering { taken: 37, wanted: 100 };
    let (fake, mut harness) = align(Activity::Live, step);
    assert!(harness.get_by_role_and_label(Role::Button, "Register").accesskit_node().is_disabled());
    assert!(harness.get_by_role(Role::ProgressIndicator).rect().width() > 50.0);
    click(&mut harness, "Cancel");
    assert_eq!(asked(&fake), [RegistrationAsk::Discard]);
}

#[test]
fn what_was_found_is_said_drawn_and_used_or_discarded() {
    let (fake, mut harness) = align(Activity::Live, found());
    for words in [
        "Camera T is mirrored, horizontal, shifted by x -9.71, y 12.40 px",
        "turned by 0.600° and scaled by 1.00400",
        "Residual 1.8 nm rms over 153 beads",
        "2 beads left out",
        "the residual is large",
    ] {
        assert!(says(&harness, words), "{words}");
    }
    let picture = harness.get_by_label("Residual map").rect();
    assert!((picture.width() / picture.height() - 1.5).abs() < 0.05, "{picture:?}");
    click(&mut harness, "Discard");
    let file = harness.get_by_role_and_label(Role::TextInput, "File").value().unwrap();
    assert!(file.starts_with("registration") && file.ends_with(".toml"), "{file}");
    click(&mut harness, "Use");
    assert_eq!(asked(&fake), [RegistrationAsk::Discard, RegistrationAsk::Use(file.into())]);
}

#[test]
fn a_failure_says_what_to_do() {
    let why = "12 beads were found in camera R and 0 in camera T; bring both into focus";
    let (fake, mut harness) = align(Activity::Live, RegistrationStep::Failed(why.to_owned()));
    assert!(says(&harness, why));
    click(&mut harness, "Discard");
    assert_eq!(asked(&fake), [RegistrationAsk::Discard]);
}

#[test]
fn what_is_used_is_said_and_can_be_given_up() {
    let (fake, mut harness) = align(Activity::Live, RegistrationStep::Idle);
    assert!(harness.query_by_label("Stop using it").is_none());
    let in_use = Some("beads, 1.8 nm rms, 2026-11-28T20:00:00Z".to_owned());
    let step = RegistrationStep::Idle;
    fake.status.borrow_mut().registration = RegistrationStatus { step, in_use, is_of_session: true };
    harness.run_steps(3);
    assert!(says(&harness, "In use: beads, 1.8 nm rms"));
    click(&mut harness, "Stop using it");
    assert_eq!(asked(&fake), [RegistrationAsk::Forget]);
}
