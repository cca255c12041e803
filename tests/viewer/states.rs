//! Every state of the instrument and what the window shows and asks in it.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use egui::{Key, Modifiers};
use egui_kittest::Harness;
use egui_kittest::kittest::Queryable;
use sofiscope::display::Contrast;
use sofiscope::reconstruction::{CameraLook, OneCamera, SofiStage};
use sofiscope::viewer::bench::{Activity, BenchCommand, BenchStatus, Event, Gravity, RunNumbers};
use sofiscope::viewer::view::Subject;
use sofiscope::viewer::{SHORTCUTS, Window, WindowSettings};

use crate::fake::{Fake, card, click, harness, open, pictures, press, says, showing, with};

#[test]
fn the_first_screen_offers_the_simulated_microscope_in_one_click() {
    let recent = vec![PathBuf::from("/tmp/cell-1")];
    let status = BenchStatus { recent: Arc::new(recent), ..BenchStatus::default() };
    let (fake, mut harness) = with(status);
    click(&mut harness, "Start the simulated microscope");
    let commands = fake.asked.borrow().commands.clone();
    assert_eq!(commands[0], BenchCommand::OpenSimulated);
    assert!(matches!(&commands[1], BenchCommand::Live(_)), "{commands:?}");
    click(&mut harness, "Open instrument");
    assert!(matches!(fake.asked.borrow().commands[2], BenchCommand::OpenInstrument(_)));
    click(&mut harness, "/tmp/cell-1");
    assert!(matches!(&fake.asked.borrow().commands[3], BenchCommand::Replay { speed, .. } if *speed == 1.0));
}

#[test]
fn while_it_opens_nothing_else_can_be_opened() {
    let (fake, mut harness) = with(BenchStatus { activity: Activity::Opening, ..BenchStatus::default() });
    assert!(says(&harness, "opening every device"));
    click(&mut harness, "Start the simulated microscope");
    assert!(fake.asked.borrow().commands.is_empty());
}

#[test]
fn an_open_instrument_is_labeled_and_waits_for_live() {
    let (fake, mut harness) = with(open(Activity::Idle));
    assert!(says(&harness, "SIMULATED") && says(&harness, "ready") && says(&harness, "0 frames lost"));
    press(&mut harness, Modifiers::NONE, Key::L);
    let commands = fake.asked.borrow().commands.clone();
    assert!(matches!(&commands[..], [BenchCommand::Live(settings)] if settings.order == 2), "{commands:?}");
    click(&mut harness, "3");
    click(&mut harness, "Live");
    let commands = fake.asked.borrow().commands.clone();
    assert!(matches!(&commands[1..], [BenchCommand::Live(settings)] if settings.order == 3), "{commands:?}");
}

#[test]
fn settings_of_the_live_view_go_with_it() {
    let (fake, mut harness) = showing(open(Activity::Live));
    assert!(says(&harness, "LIVE, not recorded"));
    click(&mut harness, "3");
    click(&mut harness, "Hold focus");
    click(&mut harness, "Apply and restart");
    let commands = fake.asked.borrow().commands.clone();
    let [BenchCommand::Live(settings)] = &commands[..] else { panic!("{commands:?}") };
    assert!(settings.order == 3 && settings.hold_focus && settings.laser_power_mw.is_empty());
    click(&mut harness, "Finish");
    click(&mut harness, "Save images");
    let commands = fake.asked.borrow().commands.clone();
    assert!(matches!(&commands[1..], [BenchCommand::Finish, BenchCommand::SaveResults(_)]), "{commands:?}");
}

#[test]
fn stop_is_always_there_and_has_two_keys() {
    for status in [BenchStatus::default(), open(Activity::Idle), open(Activity::Run), open(Activity::Ending)]
    {
        let (fake, mut harness) = with(status);
        click(&mut harness, "STOP");
        assert_eq!(fake.asked.borrow().stops, 1);
        press(&mut harness, Modifiers::COMMAND, Key::Period);
        assert_eq!(fake.asked.borrow().stops, 2);
        press(&mut harness, Modifiers::NONE, Key::Escape);
        assert_eq!(fake.asked.borrow().stops, 2, "one Escape is none");
        press(&mut harness, Modifiers::NONE, Key::Escape);
        assert_eq!(fake.asked.borrow().stops, 3);
        assert!(fake.asked.borrow().commands.is_empty());
    }
}

#[test]
fn stop_is_in_the_same_place_in_every_state() {
    let place = |status| {
        let (_, harness) = with(status);
        harness.get_by_label("STOP").rect()
    };
    let first = place(BenchStatus::default());
    for activity in [Activity::Idle, Activity::Live, Activity::Run, Activity::Replay, Activity::Ending] {
        assert_eq!(place(open(activity.clone())), first, "{activity:?}");
    }
}

#[test]
fn losses_are_told_by_reason_and_a_run_by_its_numbers() {
    let run = RunNumbers {
        phase: "acquiring".to_owned(),
        series: (1, 2),
        exposures: 1000,
        planned: Some(4000),
        lost: vec![("lost by the camera".to_owned(), 3)],
        left_out: 5,
        pairs: 997,
        frame_rate: [50.0, 49.9],
        fill: [0.25, 0.5],
        latency: Duration::from_millis(120),
        elapsed: Duration::from_secs(20),
        remaining: Some(Duration::from_secs(60)),
        disk_free: Some(80_000_000_000),
        disk_left: Some(Duration::from_secs(400)),
        ..RunNumbers::default()
    };
    let (_, harness) = showing(BenchStatus { run, ..open(Activity::Run) });
    for part in [
        "3 frames LOST: 3 lost by the camera",
        "5 pairs not analyzed",
        "RUN, not recorded",
        "1 min 00 s left",
        "80 GB free, 6 min 40 s at this rate",
        "queues 25 % | 50 %",
        "picture 120 ms behind",
        "50.0 | 49.9 frames/s",
    ] {
        assert!(says(&harness, part), "{part}");
    }
}

#[test]
fn a_plan_is_judged_before_it_runs() {
    let (fake, mut harness) = showing(open(Activity::Idle));
    click(&mut harness, "Plan");
    click(&mut harness, "Check plan");
    assert!(fake.asked.borrow().commands.is_empty() && fake.asked.borrow().judged.len() == 1);
    assert!(says(&harness, "1 series of 4000 exposures, 1 min 20 s, 1 MB"));
    click(&mut harness, "Run");
    let commands = fake.asked.borrow().commands.clone();
    assert!(
        matches!(&commands[..], [BenchCommand::Run { plan, .. }] if plan.contains("loops: 10")),
        "{commands:?}"
    );
}

#[test]
fn run_checks_by_itself_and_asks_again_where_there_is_something_to_warn_of() {
    let (fake, mut harness) = showing(open(Activity::Idle));
    click(&mut harness, "Plan");
    click(&mut harness, "Run");
    assert_eq!(fake.asked.borrow().judged.len(), 1, "checked");
    assert!(matches!(&fake.asked.borrow().commands[..], [BenchCommand::Run { .. }]), "and begun at once");
    for (plan, label) in [("time_plan: {loops: 5}  # doubtful", Some("Run all the same")), ("bad", None)] {
        let (fake, mut harness) = showing(open(Activity::Idle));
        let mut changed = card();
        changed.plans = vec![("other".to_owned(), plan.to_owned())];
        fake.status.borrow_mut().instrument = Some(Arc::new(changed));
        click(&mut harness, "Plan");
        click(&mut harness, "Run");
        assert!(fake.asked.borrow().commands.is_empty(), "{plan}: not without another word");
        match label {
            Some(label) => {
                assert!(says(&harness, "the disk is nearly full"));
                click(&mut harness, label);
                assert!(matches!(&fake.asked.borrow().commands[..], [BenchCommand::Run { .. }]));
            }
            None => {
                assert!(says(&harness, "line 1: `bad` is unknown; remove it"));
                press(&mut harness, Modifiers::COMMAND, Key::Enter);
                click(&mut harness, "Run");
                assert!(fake.asked.borrow().commands.is_empty());
            }
        }
    }
}

#[test]
fn the_plan_is_run_by_a_key_and_by_the_same_key_in_spite_of_warnings() {
    let (fake, mut harness) = showing(open(Activity::Idle));
    press(&mut harness, Modifiers::COMMAND, Key::Enter);
    assert!(matches!(&fake.asked.borrow().commands[..], [BenchCommand::Run { .. }]), "nothing to warn of");
    let (fake, mut harness) = showing(open(Activity::Idle));
    let mut changed = card();
    changed.plans = vec![("other".to_owned(), "time_plan: {loops: 5}  # doubtful".to_owned())];
    fake.status.borrow_mut().instrument = Some(Arc::new(changed));
    press(&mut harness, Modifiers::COMMAND, Key::Enter);
    assert!(fake.asked.borrow().commands.is_empty() && says(&harness, "the disk is nearly full"));
    press(&mut harness, Modifiers::COMMAND, Key::Enter);
    assert!(matches!(&fake.asked.borrow().commands[..], [BenchCommand::Run { .. }]));
}

#[test]
fn a_run_says_whether_it_is_recorded() {
    let (fake, mut harness) = showing(open(Activity::Run));
    assert!(says(&harness, "RUN, not recorded"));
    fake.status.borrow_mut().run.recording = Some(PathBuf::from("/tmp/cell-1"));
    harness.run_steps(2);
    assert!(says(&harness, "RUN, recording"));
}

#[test]
fn a_run_is_paused_resumed_and_finished() {
    let (fake, mut harness) = showing(open(Activity::Run));
    click(&mut harness, "Plan");
    click(&mut harness, "Pause");
    fake.status.borrow_mut().activity = Activity::Paused;
    harness.run_steps(2);
    click(&mut harness, "Resume");
    click(&mut harness, "Finish run");
    let expected = [BenchCommand::Pause, BenchCommand::Resume, BenchCommand::Finish];
    assert_eq!(fake.asked.borrow().commands, expected);
}

#[test]
fn lasers_show_emission_and_interlock_and_go_with_live_only_when_armed() {
    let (fake, mut harness) = showing(open(Activity::Idle));
    click(&mut harness, "Instrument");
    for part in ["EMITTING", "dark", "interlock closed", "interlock OPEN"] {
        assert!(says(&harness, part), "{part}");
    }
    click(&mut harness, "488 nm");
    press(&mut harness, Modifiers::NONE, Key::L);
    let commands = fake.asked.borrow().commands.clone();
    let [BenchCommand::Live(settings)] = &commands[..] else { panic!("{commands:?}") };
    assert_eq!(settings.laser_power_mw, BTreeMap::new(), "an armed line without power emits nothing");
}

#[test]
fn the_stage_goes_by_steps_and_to_places_that_were_kept() {
    let (fake, mut harness) = showing(open(Activity::Idle));
    click(&mut harness, "Instrument");
    assert!(says(&harness, "x 500.00 µm   y 400.00 µm"));
    click(&mut harness, "right");
    click(&mut harness, "up");
    click(&mut harness, "Keep this place");
    click(&mut harness, "go");
    let expected = [(510.0, 400.0), (500.0, 390.0), (500.0, 400.0)];
    let expected: Vec<_> =
        expected.into_iter().map(|(x_um, y_um)| BenchCommand::MoveStage { x_um, y_um }).collect();
    assert_eq!(fake.asked.borrow().commands, expected);
}

#[test]
fn focus_devices_and_warnings_are_shown() {
    let (_, mut harness) = showing(open(Activity::Live));
    click(&mut harness, "Instrument");
    for part in ["locked, 2.0 nm, 98 % good   z 123.456 µm", "2.2 nm rms", "the controller has no watchdog"]
    {
        assert!(says(&harness, part), "{part}");
    }
    click(&mut harness, "camera R  (simulated)");
    harness.run_steps(20);
    assert!(says(&harness, "maker model, S/N 1") && says(&harness, "sensor width: 64 px  (1 to 64)"));
}

#[test]
fn keys_choose_what_is_shown_and_undo_brings_it_back() {
    let (_, mut harness) = showing(open(Activity::Live));
    let subject = |harness: &Harness<'static, Window>| harness.state().view().subject;
    let first = subject(&harness);
    press(&mut harness, Modifiers::NONE, Key::Num1);
    assert_eq!(subject(&harness), Subject::Composite(SofiStage::Mean));
    press(&mut harness, Modifiers::NONE, Key::T);
    assert_eq!(subject(&harness), Subject::Camera(1));
    press(&mut harness, Modifiers::NONE, Key::O);
    assert_eq!(subject(&harness), Subject::Overlay);
    press(&mut harness, Modifiers::COMMAND, Key::Z);
    press(&mut harness, Modifiers::COMMAND, Key::Z);
    assert_eq!(subject(&harness), Subject::Composite(SofiStage::Mean));
    press(&mut harness, Modifiers::COMMAND, Key::Y);
    assert_eq!(subject(&harness), Subject::Camera(1));
    click(&mut harness, "Undo");
    click(&mut harness, "Undo");
    assert_eq!(subject(&harness), first);
    press(&mut harness, Modifiers::NONE, Key::M);
    assert_eq!(harness.state().view().split, Some(0.5));
}

#[test]
fn contrast_by_hand_is_undone_and_reset() {
    let (_, mut harness) = showing(open(Activity::Live));
    let contrast = |harness: &Harness<'static, Window>| harness.state().view().contrast();
    let first = contrast(&harness);
    click(&mut harness, "Manual contrast");
    assert!(matches!(contrast(&harness), Contrast::Manual(_)));
    press(&mut harness, Modifiers::COMMAND, Key::Z);
    assert_eq!(contrast(&harness), first);
    click(&mut harness, "Manual contrast");
    press(&mut harness, Modifiers::NONE, Key::A);
    assert_eq!(contrast(&harness), first);
}

#[test]
fn saturation_is_told_from_raw_counts() {
    let fake = Fake::default();
    *fake.status.borrow_mut() = open(Activity::Live);
    let mut shown = pictures();
    if let Some(look) = &shown.cameras {
        let mut look = CameraLook::clone(look);
        look.cameras[0] = OneCamera::of(&vec![65_535; 64 * 48], 60_000);
        shown.cameras = Some(Arc::new(look));
    }
    *fake.pictures.borrow_mut() = shown;
    let mut harness = harness(&fake);
    click(&mut harness, "Histogram");
    assert!(says(&harness, "camera R: 65535 to 65535 counts, mean 65535.0, 3072 saturated pixels"));
    assert!(says(&harness, "camera T: 100 to 163 counts, mean 131.5, 0 saturated pixels"));
}

#[test]
fn errors_stand_at_the_top_and_in_the_log() {
    let event = |gravity, text: &str| Event { time: "12:00:00".to_owned(), gravity, text: text.to_owned() };
    let events = vec![
        event(Gravity::Note, "the instrument is open"),
        event(Gravity::Error, "safety trip: the interlock is open; close it and arm again"),
    ];
    let (_, mut harness) = showing(BenchStatus { events: Arc::new(events), ..open(Activity::Idle) });
    assert!(says(&harness, "safety trip: the interlock is open"));
    click(&mut harness, "Events");
    assert!(says(&harness, "12:00:00  the instrument is open"));
}

#[test]
fn what_is_refused_is_said() {
    let fake = Fake { refuses: true, ..Fake::default() };
    *fake.status.borrow_mut() = open(Activity::Idle);
    let mut harness = harness(&fake);
    press(&mut harness, Modifiers::NONE, Key::L);
    assert!(says(&harness, "busy with earlier commands"));
}

#[test]
fn replay_has_speed_and_beginning() {
    let recent = vec![PathBuf::from("/tmp/cell-1")];
    let (fake, mut harness) = showing(BenchStatus { recent: Arc::new(recent), ..open(Activity::Idle) });
    click(&mut harness, "Replay");
    click(&mut harness, "/tmp/cell-1");
    click(&mut harness, "max");
    click(&mut harness, "Play");
    let commands = fake.asked.borrow().commands.clone();
    let [BenchCommand::Replay { recording, speed, from: 0 }] = &commands[..] else { panic!("{commands:?}") };
    assert!(recording.ends_with("cell-1") && speed.is_infinite());
}

#[test]
fn shortcuts_are_listed() {
    let (_, mut harness) = with(open(Activity::Idle));
    press(&mut harness, Modifiers::NONE, Key::F1);
    harness.run_steps(10);
    for (_, what) in SHORTCUTS {
        assert!(says(&harness, what), "{what}");
    }
}

#[test]
fn the_layout_is_reset_and_kept() {
    let (_, mut harness) = showing(open(Activity::Idle));
    press(&mut harness, Modifiers::NONE, Key::C);
    assert!(!harness.state().settings().shows_cameras);
    let kept = serde_json::to_string(harness.state().settings()).unwrap();
    let again: WindowSettings = serde_json::from_str(&kept).unwrap();
    assert_eq!(again, *harness.state().settings());
    click(&mut harness, "View");
    click(&mut harness, "Reset layout");
    assert_eq!(*harness.state().settings(), WindowSettings::default());
}

#[test]
fn every_state_is_drawn_at_small_and_large_sizes() {
    use Activity::{Closed, Ending, Idle, Live, Opening, Paused, Replay, Run};
    for size in [[900.0, 600.0], [1280.0, 800.0], [2560.0, 1440.0]] {
        for activity in [Closed, Opening, Idle, Live, Run, Paused, Replay, Ending] {
            let (_, mut harness) = showing(open(activity));
            harness.set_size(size.into());
            harness.run_steps(3);
            let window = egui::Rect::from_min_size(egui::Pos2::ZERO, size.into());
            assert!(window.contains_rect(harness.get_by_label("STOP").rect()), "STOP is inside of {size:?}");
        }
    }
}
