//! What is set: properties, focus lock, presets.

use std::collections::BTreeMap;
use std::sync::Arc;

use egui::accesskit::Role;
use egui::{Key, Modifiers};
use egui_kittest::Harness;
use egui_kittest::kittest::Queryable;
use sofiscope::viewer::bench::{Activity, BenchCommand, BenchStatus, FocusAsk, FocusStatus, LiveSettings};
use sofiscope::viewer::view::View;
use sofiscope::viewer::{Preset, Presets, Window, WindowSettings};

use crate::fake::{Fake, card, click, of, open, pictures, press, says, showing};

fn devices(status: BenchStatus) -> (Fake, Harness<'static, Window>) {
    let (fake, mut harness) = showing(status);
    click(&mut harness, "Instrument");
    harness.set_size(egui::vec2(1280.0, 1400.0));
    harness.run_steps(4);
    click(&mut harness, "camera R  (simulated)");
    harness.run_steps(20);
    (fake, harness)
}

fn property(property: &str, value: &str) -> BenchCommand {
    let (device, property, value) = ("camera R".to_owned(), property.to_owned(), value.to_owned());
    BenchCommand::SetProperty { device, property, value }
}

#[test]
fn properties_are_chosen_or_typed_while_nothing_is_under_way() {
    let (fake, mut harness) = devices(open(Activity::Idle));
    harness.get_by_role_and_label(Role::ComboBox, "cooler").click();
    harness.run_steps(4);
    click(&mut harness, "off");
    let field = harness.get_by_role_and_label(Role::TextInput, "gain");
    field.focus();
    harness.run_steps(2);
    harness.get_by_role_and_label(Role::TextInput, "gain").type_text("2");
    harness.run_steps(2);
    click(&mut harness, "Set gain");
    assert_eq!(fake.asked.borrow().commands, [property("cooler", "off"), property("gain", "12")]);
}

#[test]
fn properties_are_left_alone_while_cameras_are_at_work() {
    for activity in [Activity::Live, Activity::Run, Activity::Paused] {
        let (fake, mut harness) = devices(open(activity));
        assert!(says(&harness, "Changed only while the cameras rest: finish what is under way (F)."));
        assert!(says(&harness, "sensor width: 64 px  (1 to 64)"), "they can be looked at");
        harness.get_by_role_and_label(Role::ComboBox, "cooler").click();
        harness.run_steps(4);
        assert!(harness.query_by_label("off").is_none());
        assert!(fake.asked.borrow().commands.is_empty());
    }
}

#[test]
fn what_the_camera_has_taken_is_shown() {
    let (fake, mut harness) = devices(open(Activity::Idle));
    let mut changed = card();
    changed.devices[0].properties[2].value = "12".to_owned();
    fake.status.borrow_mut().instrument = Some(Arc::new(changed));
    harness.run_steps(3);
    let field = harness.get_by_role_and_label(Role::TextInput, "gain");
    assert_eq!(field.value().as_deref(), Some("12"));
}

fn focus(state: &str) -> Option<FocusStatus> {
    Some(FocusStatus { state: state.to_owned(), is_calibrated: true, ..FocusStatus::default() })
}

#[test]
fn the_focus_lock_is_locked_released_calibrated_and_moved_by_hand() {
    let status = BenchStatus { focus: focus("off"), ..open(Activity::Idle) };
    let (fake, mut harness) = showing(status);
    click(&mut harness, "Instrument");
    assert!(says(&harness, "No focus error yet"));
    for button in ["Lock", "Calibrate", "focus up", "focus down", "Release"] {
        click(&mut harness, button);
    }
    fake.status.borrow_mut().focus = focus("locked");
    harness.run_steps(2);
    for button in ["Release", "focus up", "Lock"] {
        click(&mut harness, button);
    }
    let expected = [
        FocusAsk::Lock,
        FocusAsk::Calibrate,
        FocusAsk::MoveBy(100.0),
        FocusAsk::MoveBy(-100.0),
        FocusAsk::Release,
    ];
    assert_eq!(fake.asked.borrow().commands, expected.map(BenchCommand::Focus));
}

#[test]
fn during_a_run_the_lock_can_only_be_asked_to_hold_again() {
    let status = BenchStatus { focus: focus("lost"), ..open(Activity::Run) };
    let (fake, mut harness) = showing(status);
    click(&mut harness, "Instrument");
    for button in ["Release", "Calibrate", "focus up", "Lock"] {
        click(&mut harness, button);
    }
    assert_eq!(fake.asked.borrow().commands, [BenchCommand::Focus(FocusAsk::Lock)]);
}

#[test]
fn why_the_lock_does_not_hold_is_said() {
    let mut lost = focus("lost").unwrap();
    lost.reason = Some("the signal of the focus sensor is gone".to_owned());
    let (_, mut harness) = showing(BenchStatus { focus: Some(lost), ..open(Activity::Idle) });
    click(&mut harness, "Instrument");
    assert!(says(&harness, "the signal of the focus sensor is gone"));
}

#[test]
fn a_preset_is_kept_used_and_outlives_the_session() {
    let (fake, mut harness) = showing(open(Activity::Idle));
    let first = harness.state().view();
    click(&mut harness, "3");
    harness.get_by_role_and_label(Role::TextInput, "Name").focus();
    harness.run_steps(2);
    harness.get_by_role_and_label(Role::TextInput, "Name").type_text("cells");
    harness.run_steps(2);
    click(&mut harness, "Keep as preset");
    let stored = serde_json::to_string(harness.state().presets()).unwrap();
    let presets: Presets = serde_json::from_str(&stored).unwrap();
    assert_eq!(presets.named("cells").map(|preset| preset.live.order), Some(3));
    // Another session.
    let window = Window::new(Box::new(fake.clone()), WindowSettings::default()).with_presets(presets);
    let mut harness = of(window);
    click(&mut harness, "cells");
    press(&mut harness, Modifiers::NONE, Key::L);
    let commands = fake.asked.borrow().commands.clone();
    assert!(matches!(&commands[..], [BenchCommand::Live(settings)] if settings.order == 3), "{commands:?}");
    assert_eq!(harness.state().view(), first);
    click(&mut harness, "remove");
    assert_eq!(*harness.state().presets(), Presets::default());
}

#[test]
fn a_preset_brings_powers_and_contrast_and_arms_nothing() {
    let mut presets = Presets::default();
    let mut view = View::default();
    view.contrasts[2] = sofiscope::display::Contrast::FromZero { high: 90.0 };
    let powers: BTreeMap<u32, f64> = [(488, 5.0)].into();
    presets.keep(Preset::of("bright".to_owned(), &LiveSettings::default(), powers.clone(), &view));
    let fake = Fake::default();
    (*fake.status.borrow_mut(), *fake.pictures.borrow_mut()) = (open(Activity::Idle), pictures());
    let mut harness =
        of(Window::new(Box::new(fake.clone()), WindowSettings::default()).with_presets(presets));
    // A line that is armed is dark again with the preset.
    click(&mut harness, "Instrument");
    click(&mut harness, "488 nm");
    click(&mut harness, "Live view");
    click(&mut harness, "bright");
    assert_eq!(harness.state().view().contrasts, view.contrasts);
    press(&mut harness, Modifiers::COMMAND, Key::Z);
    assert_eq!(harness.state().view(), View::default(), "what a preset did to the view is undone");
    click(&mut harness, "Instrument");
    click(&mut harness, "Live view");
    press(&mut harness, Modifiers::NONE, Key::L);
    click(&mut harness, "Instrument");
    click(&mut harness, "488 nm");
    click(&mut harness, "Live view");
    assert!(says(&harness, "Live turns on 488 nm at 5.0 mW"));
    press(&mut harness, Modifiers::NONE, Key::L);
    let commands = fake.asked.borrow().commands.clone();
    let lit: Vec<_> = commands
        .iter()
        .map(|command| match command {
            BenchCommand::Live(settings) => settings.laser_power_mw.clone(),
            other => panic!("{other:?}"),
        })
        .collect();
    assert_eq!(lit, [BTreeMap::new(), powers]);
}
