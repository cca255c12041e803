//! How the dyes divide between the cameras, from regions that the person marks.

use std::sync::Arc;

use egui::accesskit::Role;
use egui::{Modifiers, Pos2, Vec2};
use egui_kittest::Harness;
use egui_kittest::kittest::{NodeT, Queryable};
use sofiscope::viewer::Window;
use sofiscope::viewer::bench::{
    Activity, BenchCommand, BenchStatus, ColorsAsk, ColorsStatus, ColorsStep, DyeInUse, FoundShare,
    MarkedRegions,
};

use crate::fake::{Fake, click, open, says, showing};
use crate::images::{drag, points_per_um};

const KEYS: Modifiers = Modifiers { alt: false, ctrl: true, shift: false, mac_cmd: false, command: true };

fn in_use() -> DyeInUse {
    DyeInUse { dye: "dye A".to_owned(), transmission: 0.35, from: "the catalogue, zt 594 RDC".to_owned() }
}

fn dyes(activity: Activity, step: ColorsStep) -> (Fake, Harness<'static, Window>) {
    let colors = ColorsStatus { step, in_use: Arc::new(vec![in_use()]), is_of_session: false };
    let (fake, mut harness) = showing(BenchStatus { colors, ..open(activity) });
    click(&mut harness, "Align");
    click(&mut harness, "Dyes");
    harness.set_size(egui::vec2(1280.0, 1400.0));
    harness.run_steps(4);
    (fake, harness)
}

fn choose(harness: &mut Harness<'static, Window>) {
    click(harness, "Dye to measure");
    click(harness, "dye A");
}

/// Marks a rectangle of pixels in the pane of a camera.
fn mark(harness: &mut Harness<'static, Window>, pane: &str, from: [f32; 2], size: [f32; 2]) {
    let rect = harness.get_by_label(pane).rect();
    let px = points_per_um(rect) as f32 * 0.1;
    let start: Pos2 = rect.center() + Vec2::new(from[0] - 32.0, from[1] - 24.0) * px;
    drag(harness, start, Vec2::from(size) * px, KEYS);
    harness.run_steps(2);
}

fn asked(fake: &Fake) -> Vec<ColorsAsk> {
    let commands = fake.asked.borrow().commands.clone();
    let asked = commands.into_iter().map(|command| match command {
        BenchCommand::Colors(asked) => asked,
        other => panic!("{other:?}"),
    });
    asked.collect()
}

fn is_near(is: [u32; 4], should: [u32; 4]) -> bool {
    is.iter().zip(should).all(|(is, should)| is.abs_diff(should) <= 1)
}

#[test]
fn a_dye_is_chosen_its_regions_marked_and_its_share_measured() {
    let (fake, mut harness) = dyes(Activity::Live, ColorsStep::Idle);
    assert!(says(&harness, "No registration is in use: the cameras are taken as aligned"));
    choose(&mut harness);
    assert!(says(&harness, "In use: T = 0.3500, from the catalogue, zt 594 RDC"));
    mark(&mut harness, "camera R image", [10.0, 12.0], [16.0, 12.0]);
    mark(&mut harness, "camera R image", [40.0, 30.0], [10.0, 9.0]);
    assert!(says(&harness, "2 regions of the dye; background: the surroundings"));
    // Camera T has other pixels, and a slip is no region.
    mark(&mut harness, "camera T image", [10.0, 12.0], [16.0, 12.0]);
    assert!(says(&harness, "2 regions of the dye"));
    mark(&mut harness, "camera R image", [10.0, 12.0], [16.0, 4.0]);
    assert!(says(&harness, "2 regions of the dye") && says(&harness, "at least 8 x 8 px"));
    click(&mut harness, "Mark background");
    mark(&mut harness, "camera R image", [30.0, 4.0], [20.0, 10.0]);
    assert!(says(&harness, "background: one region"));
    click(&mut harness, "Measure");
    let asked = asked(&fake);
    let [ColorsAsk::Begin { dye, marked: MarkedRegions { dye: areas, background }, frames: 100 }] =
        &asked[..]
    else {
        panic!("{asked:?}")
    };
    assert_eq!(dye, "dye A");
    assert!(is_near(areas[0], [10, 12, 16, 12]) && is_near(areas[1], [40, 30, 10, 9]), "{areas:?}");
    assert!(is_near(background.unwrap(), [30, 4, 20, 10]), "{background:?}");
    click(&mut harness, "Clear regions");
    assert!(says(&harness, "0 regions of the dye; background: the surroundings"));
    // None of it was taken for the region of the cameras.
    click(&mut harness, "Live view");
    assert!(says(&harness, "Region: whole sensor, 64 x 48 px"));
}

#[test]
fn what_is_missing_before_a_measurement_is_said() {
    for (activity, chosen, why) in [
        (Activity::Idle, true, "Start the live view first"),
        (Activity::Run, true, "Not during a run"),
        (Activity::Live, false, "Choose a dye first"),
        (Activity::Live, true, "Mark a region with this dye first"),
    ] {
        let (fake, mut harness) = dyes(activity, ColorsStep::Idle);
        if chosen {
            choose(&mut harness);
        }
        let button = harness.get_by_role_and_label(Role::Button, "Measure");
        assert!(button.accesskit_node().is_disabled());
        button.hover();
        harness.run_steps(40);
        assert!(says(&harness, why), "{why}");
        click(&mut harness, "Measure");
        assert!(asked(&fake).is_empty());
    }
}

#[test]
fn frames_are_counted_and_can_be_given_up_and_a_failure_says_what_to_do() {
    let (fake, mut harness) = dyes(Activity::Live, ColorsStep::Gathering { taken: 37, wanted: 100 });
    assert!(harness.get_by_role(Role::ProgressIndicator).rect().width() > 50.0);
    click(&mut harness, "Cancel");
    assert_eq!(asked(&fake), [ColorsAsk::Discard]);
    let why = "the regions are too dark; mark them where this dye is bright";
    let (fake, mut harness) = dyes(Activity::Live, ColorsStep::Failed(why.to_owned()));
    assert!(says(&harness, why));
    click(&mut harness, "Discard");
    assert_eq!(asked(&fake), [ColorsAsk::Discard]);
}

#[test]
fn a_share_stands_beside_the_one_in_use_and_is_used_or_discarded() {
    let share = |transmission: f64, in_use: Option<DyeInUse>| {
        ColorsStep::Found(Arc::new(FoundShare {
            dye: "dye A".to_owned(),
            transmission,
            uncertainty: 0.01,
            in_use,
            frames: 100,
            warnings: vec!["the uncertainty is large".to_owned()],
        }))
    };
    for (transmission, in_use, words) in [
        (0.3561, Some(in_use()), "Agrees with T = 0.3500 in use, from the catalogue"),
        (
            0.4,
            Some(in_use()),
            "Does not agree with T = 0.3500 in use, from the catalogue, zt 594 RDC: they differ by 0.0500",
        ),
        (0.4, None, "Nothing is in use for this dye yet"),
    ] {
        let (fake, mut harness) = dyes(Activity::Live, share(transmission, in_use));
        assert!(says(&harness, &format!("dye A: T = {transmission:.4} +/- 0.0100")));
        assert!(says(&harness, words), "{words}");
        assert!(says(&harness, "the uncertainty is large"));
        click(&mut harness, "Discard");
        let file = harness.get_by_role_and_label(Role::TextInput, "File").value().unwrap();
        assert!(file.starts_with("response") && file.ends_with(".toml"), "{file}");
        click(&mut harness, "Use");
        assert_eq!(asked(&fake), [ColorsAsk::Discard, ColorsAsk::Use(file.into())]);
    }
}

#[test]
fn measured_shares_can_be_given_up() {
    let (fake, mut harness) = dyes(Activity::Live, ColorsStep::Idle);
    assert!(harness.query_by_label("Stop using measured shares").is_none());
    fake.status.borrow_mut().colors.is_of_session = true;
    harness.run_steps(3);
    click(&mut harness, "Stop using measured shares");
    assert_eq!(asked(&fake), [ColorsAsk::Forget]);
}
