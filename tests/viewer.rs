//! The window on a bench that does nothing but write down what it is asked: every panel and state, every key.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::rc::Rc;
use std::sync::Arc;
use std::time::Duration;

use egui::{Key, Modifiers};
use egui_kittest::Harness;
use egui_kittest::kittest::Queryable;
use ndarray::Array2;
use sofiscope::display::Contrast;
use sofiscope::reconstruction::{CameraLook, OneCamera, SofiLook, SofiStage, StageImage};
use sofiscope::viewer::bench::{
    Activity, Bench, BenchCommand, BenchStatus, DeviceCard, Event, FocusStatus, Gravity, InstrumentCard,
    LaserStatus, Pictures, PlanEstimate, PropertyRow, Refused, RunNumbers, StageStatus,
};
use sofiscope::viewer::view::Subject;
use sofiscope::viewer::{SHORTCUTS, Window, WindowSettings};

/// What a bench was asked for.
#[derive(Debug, Default)]
struct Asked {
    commands: Vec<BenchCommand>,
    stops: usize,
    judged: Vec<String>,
}

/// A bench that shows what a test gives it.
#[derive(Clone, Default)]
struct Fake {
    status: Rc<RefCell<BenchStatus>>,
    pictures: Rc<RefCell<Pictures>>,
    asked: Rc<RefCell<Asked>>,
    refuses: bool,
}

impl Bench for Fake {
    fn status(&self) -> Arc<BenchStatus> {
        Arc::new(self.status.borrow().clone())
    }

    fn pictures(&self) -> Pictures {
        self.pictures.borrow().clone()
    }

    fn ask(&self, command: BenchCommand) -> Result<(), Refused> {
        self.asked.borrow_mut().commands.push(command);
        if self.refuses { Err(Refused) } else { Ok(()) }
    }

    fn stop(&self) {
        self.asked.borrow_mut().stops += 1;
    }

    fn judge_plan(&self, text: &str) -> Result<PlanEstimate, String> {
        self.asked.borrow_mut().judged.push(text.to_owned());
        if text.contains("bad") {
            return Err("line 1: `bad` is unknown; remove it".to_owned());
        }
        Ok(PlanEstimate {
            checks: vec![(Gravity::Note, "disk: room enough".to_owned())],
            may_begin: true,
            duration: Some(Duration::from_secs(80)),
            bytes: Some(1_000_000),
            series: 1,
            exposures: Some(4000),
        })
    }
}

fn card() -> InstrumentCard {
    InstrumentCard {
        name: "Test microscope".to_owned(),
        label: Some("SIMULATED"),
        sensor: (64, 48),
        shortest_period: Duration::from_millis(1),
        longest_exposure: Duration::from_secs(1),
        pixel_pitch_nm: 100.0,
        dichroic: Some("zt 594 RDC".to_owned()),
        species: vec!["dye A".to_owned(), "dye B".to_owned()],
        known_species: vec!["dye A".to_owned(), "dye C".to_owned()],
        has_focus: true,
        stage_um: Some([(0.0, 1000.0), (0.0, 800.0)]),
        devices: vec![DeviceCard {
            role: "camera R".to_owned(),
            identity: "maker model, S/N 1".to_owned(),
            is_simulated: true,
            properties: vec![PropertyRow {
                name: "sensor width".to_owned(),
                value: "64".to_owned(),
                unit: "px".to_owned(),
                range: "1 to 64".to_owned(),
                is_writable: false,
            }],
        }],
        warnings: vec!["the controller has no watchdog".to_owned()],
        plans: vec![("quick look".to_owned(), "time_plan: {interval: 0, loops: 10}".to_owned())],
    }
}

fn open(activity: Activity) -> BenchStatus {
    BenchStatus {
        instrument: Some(Arc::new(card())),
        activity,
        stage: Some(StageStatus { x_um: 500.0, y_um: 400.0, is_moving: false }),
        lasers: vec![
            LaserStatus {
                wavelength_nm: 488,
                cap_mw: 50.0,
                identity: "blue laser".to_owned(),
                power_mw: 5.0,
                is_emitting: Some(true),
                interlock_closed: Some(true),
            },
            LaserStatus {
                wavelength_nm: 561,
                cap_mw: 40.0,
                identity: "green laser".to_owned(),
                power_mw: 0.0,
                is_emitting: Some(false),
                interlock_closed: Some(false),
            },
        ],
        focus: Some(FocusStatus {
            state: "locked".to_owned(),
            trace: vec![(-0.2, 3.0), (-0.1, -1.0), (0.0, 2.0)],
            quality: None,
        }),
        ..BenchStatus::default()
    }
}

fn pictures() -> Pictures {
    let counts: Vec<u16> = (0..64 * 48).map(|place| 100 + (place % 64) as u16).collect();
    let camera = || OneCamera::of(&counts, 60_000);
    let cameras = CameraLook {
        exposure: 7,
        width: 64,
        height: 48,
        cameras: [camera(), camera()],
        pixel_pitch_nm: 100.0,
    };
    let mut images = Vec::new();
    for stage in SofiStage::ALL {
        for name in ["dye A", "dye B"] {
            let image = Arc::new(Array2::from_shape_fn((96, 128), |(y, x)| (y * x) as f32));
            images.push(StageImage { stage, name: name.to_owned(), image, pixel_pitch_nm: 50.0 });
        }
    }
    let label = "200 exposures, linearized".to_owned();
    let sofi = SofiLook { samples: 200, open_samples: 0, label, images, trouble: None };
    Pictures { cameras: Some(Arc::new(cameras)), sofi: Some(Arc::new(sofi)) }
}

fn harness(fake: &Fake) -> Harness<'static, Window> {
    let window = Window::new(Box::new(fake.clone()), WindowSettings::default());
    let mut harness = Harness::builder()
        .with_size(egui::Vec2::new(1280.0, 800.0))
        .with_step_dt(0.05)
        .build_ui_state(|ui, window: &mut Window| window.ui(ui), window);
    harness.run_steps(4);
    harness
}

fn with(status: BenchStatus) -> (Fake, Harness<'static, Window>) {
    let fake = Fake::default();
    *fake.status.borrow_mut() = status;
    let harness = harness(&fake);
    (fake, harness)
}

fn showing(status: BenchStatus) -> (Fake, Harness<'static, Window>) {
    let fake = Fake::default();
    (*fake.status.borrow_mut(), *fake.pictures.borrow_mut()) = (status, pictures());
    let harness = harness(&fake);
    (fake, harness)
}

fn click(harness: &mut Harness<'static, Window>, label: &str) {
    harness.get_by_label(label).click();
    harness.run_steps(4);
}

fn says(harness: &Harness<'static, Window>, part: &str) -> bool {
    harness.query_all_by_label_contains(part).next().is_some()
}

fn press(harness: &mut Harness<'static, Window>, modifiers: Modifiers, key: Key) {
    harness.key_press_modifiers(modifiers, key);
    harness.run_steps(2);
}

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
    let _ = harness;
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
        "RUN, recording",
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
    click(&mut harness, "Run");
    assert!(fake.asked.borrow().commands.is_empty(), "not before it was checked");
    click(&mut harness, "Check plan");
    assert!(says(&harness, "1 series of 4000 exposures, 1 min 20 s, 1 MB"));
    click(&mut harness, "Run");
    let commands = fake.asked.borrow().commands.clone();
    assert!(
        matches!(&commands[..], [BenchCommand::Run { plan, .. }] if plan.contains("loops: 10")),
        "{commands:?}"
    );
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
    for part in ["locked, 2.0 nm", "2.2 nm rms", "the controller has no watchdog"] {
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
