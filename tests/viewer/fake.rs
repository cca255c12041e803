//! The bench that writes down what it is asked, an open instrument and pictures to show, hands for the window.

use std::cell::RefCell;
use std::rc::Rc;
use std::sync::Arc;
use std::time::Duration;

use egui::{Key, Modifiers};
use egui_kittest::Harness;
use egui_kittest::kittest::Queryable;
use ndarray::Array2;
use sofiscope::reconstruction::{CameraLook, OneCamera, SofiLook, SofiStage, StageImage};
use sofiscope::viewer::bench::{
    Activity, Bench, BenchCommand, BenchStatus, DeviceCard, FocusStatus, Gravity, InstrumentCard,
    LaserStatus, Pictures, PlanEstimate, PropertyRow, Refused, StageStatus,
};
use sofiscope::viewer::{AsSeen, Window, WindowSettings};

/// What a bench was asked for.
#[derive(Debug, Default)]
pub(crate) struct Asked {
    pub(crate) commands: Vec<BenchCommand>,
    pub(crate) stops: usize,
    pub(crate) judged: Vec<String>,
    pub(crate) kept: Vec<AsSeen>,
}

/// A bench that shows what a test gives it.
#[derive(Clone, Default)]
pub(crate) struct Fake {
    pub(crate) status: Rc<RefCell<BenchStatus>>,
    pub(crate) pictures: Rc<RefCell<Pictures>>,
    pub(crate) asked: Rc<RefCell<Asked>>,
    pub(crate) refuses: bool,
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

    fn keep_picture(&self, picture: AsSeen) -> Result<(), Refused> {
        self.asked.borrow_mut().kept.push(picture);
        if self.refuses { Err(Refused) } else { Ok(()) }
    }

    fn judge_plan(&self, text: &str) -> Result<PlanEstimate, String> {
        self.asked.borrow_mut().judged.push(text.to_owned());
        if text.contains("bad") {
            return Err("line 1: `bad` is unknown; remove it".to_owned());
        }
        let mut checks = vec![(Gravity::Note, "memory: room enough".to_owned())];
        if text.contains("doubtful") {
            checks.push((Gravity::Warning, "the disk is nearly full".to_owned()));
        }
        Ok(PlanEstimate {
            checks,
            may_begin: true,
            duration: Some(Duration::from_secs(80)),
            bytes: Some(1_000_000),
            series: 1,
            exposures: Some(4000),
        })
    }
}

pub(crate) fn card() -> InstrumentCard {
    InstrumentCard {
        name: "Test microscope".to_owned(),
        label: Some("SIMULATED".to_owned()),
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
            properties: vec![
                PropertyRow {
                    name: "sensor width".to_owned(),
                    value: "64".to_owned(),
                    unit: "px".to_owned(),
                    range: "1 to 64".to_owned(),
                    ..PropertyRow::default()
                },
                PropertyRow {
                    name: "cooler".to_owned(),
                    value: "on".to_owned(),
                    range: "off, on".to_owned(),
                    choices: vec!["off".to_owned(), "on".to_owned()],
                    is_writable: true,
                    ..PropertyRow::default()
                },
                PropertyRow {
                    name: "gain".to_owned(),
                    value: "1".to_owned(),
                    unit: "dB".to_owned(),
                    range: "0 to 24".to_owned(),
                    is_writable: true,
                    ..PropertyRow::default()
                },
            ],
        }],
        warnings: vec!["the controller has no watchdog".to_owned()],
        plans: vec![("quick look".to_owned(), "time_plan: {interval: 0, loops: 10}".to_owned())],
    }
}

pub(crate) fn open(activity: Activity) -> BenchStatus {
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
            quality: Some(0.98),
            z_um: Some(123.456),
            is_calibrated: true,
            ..FocusStatus::default()
        }),
        ..BenchStatus::default()
    }
}

pub(crate) fn pictures() -> Pictures {
    let counts: Vec<u16> = (0..64 * 48).map(|place| 100 + (place % 64) as u16).collect();
    let camera = || OneCamera::of(&counts, 60_000);
    let cameras = CameraLook {
        exposure: 7,
        width: 64,
        height: 48,
        cameras: [camera(), camera()],
        pixel_pitch_nm: 100.0,
        transmitted_from_reflected: None,
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

pub(crate) fn harness(fake: &Fake) -> Harness<'static, Window> {
    of(Window::new(Box::new(fake.clone()), WindowSettings::default()))
}

pub(crate) fn of(window: Window) -> Harness<'static, Window> {
    let mut harness = Harness::builder()
        .with_size(egui::Vec2::new(1280.0, 800.0))
        .with_step_dt(0.05)
        .build_ui_state(|ui, window: &mut Window| window.ui(ui), window);
    harness.run_steps(4);
    harness
}

pub(crate) fn with(status: BenchStatus) -> (Fake, Harness<'static, Window>) {
    let fake = Fake::default();
    *fake.status.borrow_mut() = status;
    let harness = harness(&fake);
    (fake, harness)
}

pub(crate) fn showing(status: BenchStatus) -> (Fake, Harness<'static, Window>) {
    let fake = Fake::default();
    (*fake.status.borrow_mut(), *fake.pictures.borrow_mut()) = (status, pictures());
    let harness = harness(&fake);
    (fake, harness)
}

pub(crate) fn click(harness: &mut Harness<'static, Window>, label: &str) {
    harness.get_by_label(label).click();
    harness.run_steps(4);
}

pub(crate) fn says(harness: &Harness<'static, Window>, part: &str) -> bool {
    harness.query_all_by_label_contains(part).next().is_some()
}

pub(crate) fn press(harness: &mut Harness<'static, Window>, modifiers: Modifiers, key: Key) {
    harness.key_press_modifiers(modifiers, key);
    harness.run_steps(2);
}
