//! Cameras that see the same beads mirrored, apart, turned and stretched, registered from the live view.

use super::{QUICK, is, text_of, until};
use crate::app::window::bench::LocalBench;
use crate::config::{Instrument, Registration};
use crate::reconstruction::{CameraLook, PixelMap};
use crate::viewer::bench::{
    Activity, Bench, BenchCommand, FoundRegistration, Gravity, RegisterBy, RegistrationAsk, RegistrationStep,
};
use sofiscope_sim::{Mirror, View};
use std::path::Path;
use std::sync::Arc;

/// The cameras of the scene of beads.
const TRUTH: View =
    View { mirror: Mirror::Horizontal, shift_px: [12.4, -9.7], rotation_deg: 0.6, scale: 1.004 };
const SIDE: usize = 256;

/// The simulated microscope that looks at another scene.
fn looking_at(folder: &Path, scene: &str) -> LocalBench {
    let file = folder.join("instrument.toml");
    let text = Instrument::simulated_toml().replace("scene = \"figure-s4\"", &format!("scene = \"{scene}\""));
    std::fs::write(&file, text).unwrap();
    let bench = LocalBench::start().unwrap();
    bench.ask(BenchCommand::OpenInstrument(file)).unwrap();
    until(&bench, "an open instrument", is(&Activity::Idle));
    bench
}

fn ask(bench: &LocalBench, asked: RegistrationAsk) {
    bench.ask(BenchCommand::Registration(asked)).unwrap();
}

/// A new live view, with frames of its own.
fn live(bench: &LocalBench) -> Arc<CameraLook> {
    if bench.status().activity != Activity::Idle {
        bench.ask(BenchCommand::Finish).unwrap();
        until(bench, "rest", is(&Activity::Idle));
    }
    let before = bench.pictures().cameras;
    bench.ask(BenchCommand::Live(QUICK)).unwrap();
    until(bench, "frames", |status| {
        let is_new = |look: &Arc<CameraLook>| before.as_ref().is_none_or(|before| !Arc::ptr_eq(before, look));
        bench.pictures().cameras.filter(is_new).filter(|_| status.activity == Activity::Live)
    })
}

fn found(bench: &LocalBench) -> Arc<FoundRegistration> {
    until(bench, "a registration", |status| match &status.registration.step {
        RegistrationStep::Found(found) => Some(Arc::clone(found)),
        RegistrationStep::Failed(why) => panic!("{why}"),
        _ => None,
    })
}

/// The farthest that a map of the window is from the truth, pixels, over the field that both cameras see.
fn farthest(map: &PixelMap) -> f64 {
    let places = [20.0, 128.0, 235.0];
    let off = |point: [f64; 2]| {
        let (is, should) = (map.apply(point), TRUTH.apply(point, SIDE, SIDE));
        (is[0] - should[0]).hypot(is[1] - should[1])
    };
    places.into_iter().flat_map(|y| places.map(|x| off([y, x]))).fold(0.0, f64::max)
}

#[test]
fn beads_of_the_live_view_register_what_comes_next() {
    let folder = tempfile::tempdir().unwrap();
    let bench = looking_at(folder.path(), "beads");
    ask(&bench, RegistrationAsk::Begin { by: RegisterBy::Beads, frames: 30 });
    until(&bench, "a refusal", |status| {
        text_of(status, Gravity::Warning).iter().any(|text| text.contains("start it (L)")).then_some(())
    });
    assert_eq!(live(&bench).transmitted_from_reflected, None);
    ask(&bench, RegistrationAsk::Begin { by: RegisterBy::Beads, frames: 30 });
    until(&bench, "frames that are counted", |status| match status.registration.step {
        RegistrationStep::Gathering { taken, wanted: 30 } if taken > 0 => Some(()),
        _ => None,
    });
    let told = found(&bench);
    assert_eq!(bench.status().activity, Activity::Live, "the live view goes on");
    assert_eq!((told.by, told.mirror.as_str()), (RegisterBy::Beads, "horizontal"));
    assert!(told.points > 60 && told.residual_nm < 5.0, "{told:?}");
    assert!((told.rotation_deg.abs() - 0.6).abs() < 0.01, "{}", told.rotation_deg);
    assert!(told.residual_map.width() >= SIDE, "drawn");
    assert_eq!(bench.status().registration.in_use, None, "nothing has changed yet");

    let taken = folder.path().join("taken.toml");
    std::fs::write(&taken, "mine").unwrap();
    ask(&bench, RegistrationAsk::Use(taken.clone()));
    until(&bench, "a refusal", |status| {
        text_of(status, Gravity::Error).iter().any(|text| text.contains("exists; give")).then_some(())
    });
    assert_eq!(std::fs::read_to_string(&taken).unwrap(), "mine");
    let file = folder.path().join("registration.toml");
    ask(&bench, RegistrationAsk::Use(file.clone()));
    let in_use = until(&bench, "what is used", |status| status.registration.in_use.clone());
    assert!(in_use.starts_with("beads, "), "{in_use}");
    assert_eq!(bench.status().registration.step, RegistrationStep::Idle);
    let text = std::fs::read_to_string(&file).unwrap();
    let written = Registration::from_toml(&text).unwrap();
    let card = bench.status().instrument.clone().unwrap();
    for (serial, device) in written.serials.iter().zip(&card.devices) {
        let serial = serial.as_ref().unwrap();
        assert!(device.identity.contains(serial), "{serial} and {}", device.identity);
    }
    assert!(written.date.parse::<jiff::Timestamp>().is_ok(), "{}", written.date);
    assert!(file.with_extension("png").is_file());

    // The next live view goes by it, to a twentieth of a pixel.
    let map = live(&bench).transmitted_from_reflected.unwrap();
    assert!(farthest(&map) < 0.05, "{} px", farthest(&map));
    bench.ask(BenchCommand::Finish).unwrap();
    until(&bench, "the end", is(&Activity::Idle));
    // So does the next run, which keeps it beside its frames.
    let (plan, out) = (super::SHORT_RUN.replace("loops: 600", "loops: 60"), folder.path().join("run"));
    let plan = plan.replace("subsequence_exposures: 50", "subsequence_exposures: 30");
    bench.ask(BenchCommand::Run { plan, out: out.clone() }).unwrap();
    until(&bench, "a run", |status| status.last_saved.clone().filter(|_| status.activity == Activity::Idle));
    let note: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(out.join("analysis.json")).unwrap()).unwrap();
    assert_eq!(note["registration"], text);
    // Given up, cameras are taken as they come.
    ask(&bench, RegistrationAsk::Forget);
    until(&bench, "nothing in use", |status| status.registration.in_use.is_none().then_some(()));
    assert_eq!(live(&bench).transmitted_from_reflected, None);
}

#[test]
fn a_registration_that_is_discarded_leaves_everything_as_it_was() {
    let folder = tempfile::tempdir().unwrap();
    let bench = looking_at(folder.path(), "beads");
    live(&bench);
    // While frames are taken, and after it was found.
    ask(&bench, RegistrationAsk::Begin { by: RegisterBy::Beads, frames: 2000 });
    until(&bench, "frames that are counted", |status| match status.registration.step {
        RegistrationStep::Gathering { .. } => Some(()),
        _ => None,
    });
    ask(&bench, RegistrationAsk::Discard);
    assert_eq!(bench.status().registration.step, RegistrationStep::Idle);
    ask(&bench, RegistrationAsk::Begin { by: RegisterBy::Beads, frames: 20 });
    found(&bench);
    ask(&bench, RegistrationAsk::Discard);
    assert_eq!(bench.status().registration.step, RegistrationStep::Idle);
    let file = folder.path().join("registration.toml");
    ask(&bench, RegistrationAsk::Use(file.clone()));
    until(&bench, "a refusal", |status| {
        text_of(status, Gravity::Error)
            .iter()
            .any(|text| text.contains("no registration was found"))
            .then_some(())
    });
    assert!(!file.exists() && bench.status().registration.in_use.is_none());
    assert_eq!(bench.status().activity, Activity::Live);
}

#[test]
fn a_blinking_sample_is_registered_as_well_and_an_end_of_the_live_view_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let bench = looking_at(folder.path(), "figure-s4");
    live(&bench);
    ask(&bench, RegistrationAsk::Begin { by: RegisterBy::Blinking, frames: 2000 });
    until(&bench, "frames that are counted", |status| match status.registration.step {
        RegistrationStep::Gathering { .. } => Some(()),
        _ => None,
    });
    bench.ask(BenchCommand::Finish).unwrap();
    let why = until(&bench, "a failure", |status| match &status.registration.step {
        RegistrationStep::Failed(why) => Some(why.clone()),
        _ => None,
    });
    assert!(why.contains("start it again (L)"), "{why}");
    until(&bench, "the end", is(&Activity::Idle));
    live(&bench);
    // These cameras are aligned, in a field of 72 pixels.
    ask(&bench, RegistrationAsk::Begin { by: RegisterBy::Blinking, frames: 160 });
    let told = found(&bench);
    assert_eq!((told.by, told.mirror.as_str()), (RegisterBy::Blinking, "none"));
    assert!(told.shift_px.iter().all(|shift| shift.abs() < 0.5), "{told:?}");
}
