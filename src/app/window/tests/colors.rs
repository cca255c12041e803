//! Shares of the dyes' light from regions of the live view, for what comes next.

use super::{QUICK, SHORT_RUN, is, simulated, text_of, until};
use crate::app::window::bench::LocalBench;
use crate::config::Catalogue;
use crate::viewer::bench::{
    Activity, Bench, BenchCommand, BenchStatus, ColorsAsk, ColorsStep, FoundShare, Gravity, LiveSettings,
    MarkedRegions,
};
use clap::Parser;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

/// A command line of `analyze`.
#[derive(clap::Parser)]
struct Line {
    #[command(flatten)]
    analyze: crate::app::analyze::AnalyzeArguments,
}

/// A pace at which every computer goes on showing frames.
fn steady() -> LiveSettings {
    LiveSettings { exposure: Duration::from_millis(20), ..QUICK }
}

/// The dyes of the simulated sample, their shares, and where only one of them is: left, top, width, height.
const TRUTH: [(&str, f64, [u32; 4]); 3] = [
    ("Alexa Fluor 488", 0.02, [30, 43, 12, 12]),
    ("Atto 565", 0.35, [19, 31, 16, 13]),
    ("Alexa Fluor 647", 0.98, [38, 31, 16, 13]),
];

fn ask(bench: &LocalBench, asked: ColorsAsk) {
    bench.ask(BenchCommand::Colors(asked)).unwrap();
}

fn begin(bench: &LocalBench, dye: &str, areas: &[[u32; 4]], frames: usize) {
    let marked = MarkedRegions { dye: areas.to_vec(), background: None };
    ask(bench, ColorsAsk::Begin { dye: dye.to_owned(), marked, frames });
}

fn live(bench: &LocalBench, settings: LiveSettings) {
    if bench.status().activity != Activity::Idle {
        bench.ask(BenchCommand::Finish).unwrap();
        until(bench, "rest", is(&Activity::Idle));
    }
    bench.ask(BenchCommand::Live(settings)).unwrap();
    until(bench, "frames", |status| {
        bench.pictures().cameras.filter(|_| status.activity == Activity::Live).map(|_| ())
    });
}

fn found(bench: &LocalBench) -> Arc<FoundShare> {
    until(bench, "a share", |status| match &status.colors.step {
        ColorsStep::Found(found) => Some(Arc::clone(found)),
        ColorsStep::Failed(why) => panic!("{why}"),
        _ => None,
    })
}

fn failure(bench: &LocalBench) -> String {
    until(bench, "a failure", |status| match &status.colors.step {
        ColorsStep::Failed(why) => Some(why.clone()),
        ColorsStep::Found(found) => panic!("{found:?}"),
        _ => None,
    })
}

fn in_use(status: &BenchStatus, dye: &str) -> f64 {
    status.colors.in_use.iter().find(|in_use| in_use.dye == dye).unwrap().transmission
}

/// What a run of the bench went by.
fn note(bench: &LocalBench, out: &Path) -> serde_json::Value {
    if bench.status().activity != Activity::Idle {
        bench.ask(BenchCommand::Finish).unwrap();
        until(bench, "rest", is(&Activity::Idle));
    }
    let plan = SHORT_RUN.replace("loops: 600", "loops: 100").replace("2.0", "10.0");
    bench.ask(BenchCommand::Run { plan, out: out.to_owned() }).unwrap();
    until(bench, "a run", |status| {
        let is_new = status.last_saved.as_ref().is_some_and(|saved| saved.file_name() == out.file_name());
        (is_new && status.activity == Activity::Idle).then_some(())
    });
    serde_json::from_str(&std::fs::read_to_string(out.join("analysis.json")).unwrap()).unwrap()
}

#[test]
fn the_share_of_each_filament_is_found_and_what_is_used_goes_for_all_that_comes() {
    let folder = tempfile::tempdir().unwrap();
    let bench = simulated();
    begin(&bench, TRUTH[0].0, &[TRUTH[0].2], 40);
    until(&bench, "a refusal", |status| {
        text_of(status, Gravity::Warning).iter().any(|text| text.contains("start it (L)")).then_some(())
    });
    live(&bench, steady());
    let mut kept = Vec::new();
    for (dye, truth, area) in TRUTH {
        assert_eq!(in_use(&bench.status(), dye), truth, "of the sample");
        begin(&bench, dye, &[area], 60);
        let share = found(&bench);
        println!("{dye}: {:.4} +/- {:.4}, truth {truth}", share.transmission, share.uncertainty);
        assert_eq!((share.dye.as_str(), share.frames), (dye, 60));
        // One measurement in twenty may be farther off than its uncertainty says.
        assert!((share.transmission - truth).abs() <= 1.5 * share.uncertainty, "{share:?}");
        assert!(share.uncertainty < 0.05, "{share:?}");
        assert_eq!(share.in_use.as_ref().unwrap().transmission, truth);
        assert!(share.warnings.iter().any(|text| text.contains("No registration is in use")), "{share:?}");
        assert!(!bench.status().colors.is_of_session || !kept.is_empty(), "nothing has changed yet");

        let taken = folder.path().join(format!("taken {dye}"));
        std::fs::write(&taken, "mine").unwrap();
        ask(&bench, ColorsAsk::Use(taken.clone()));
        let refused = format!("taken {dye} exists; give");
        until(&bench, "a refusal", |status| {
            text_of(status, Gravity::Error).iter().any(|text| text.contains(&refused)).then_some(())
        });
        assert_eq!(std::fs::read_to_string(&taken).unwrap(), "mine");
        let file = folder.path().join(format!("{dye}.toml"));
        ask(&bench, ColorsAsk::Use(file.clone()));
        until(&bench, "its use", |status| {
            (status.colors.step == ColorsStep::Idle && status.colors.is_of_session).then_some(())
        });
        let written = share.transmission.clamp(0.0, 1.0);
        assert!((in_use(&bench.status(), dye) - written).abs() < 1e-6);
        kept.push((dye, written, file));
    }
    // The last file has all three, and what the catalogue knows of other dyes.
    let text = std::fs::read_to_string(&kept[2].2).unwrap();
    let catalogue = Catalogue::with_dichroics(&text).unwrap();
    for (dye, written, _) in &kept {
        let response = catalogue.response(dye, "zt 594 RDC").unwrap().unwrap();
        assert!((response.transmission() - written).abs() < 1e-6, "{text}");
    }
    assert_eq!(
        catalogue.response("Alexa Fluor 568", "zt 594 RDC").unwrap().unwrap().transmission(),
        0.47,
        "carried over"
    );
    let table: toml::Table = text.parse().unwrap();
    let dichroic = table["dichroic"][0].as_table().unwrap();
    assert_eq!(dichroic["reflected_serial"].as_str(), Some("SIM-R"));
    assert_eq!(dichroic["instrument"].as_str(), Some("Simulated microscope"));
    assert!(dichroic["date"].as_str().unwrap().parse::<jiff::Timestamp>().is_ok());
    let measured = dichroic["coefficients"].as_array().unwrap().last().unwrap();
    assert_eq!(measured["regions"].as_str(), Some("16 x 13 px from column 38 and row 31 on"));
    assert_eq!(measured["exposures"].as_str(), Some("60 of 20 ms each, from the live view"));
    assert!(measured["registration"].as_str().unwrap().starts_with("none"));
    // A run goes by it, and keeps it beside its frames.
    let kept_note = note(&bench, &folder.path().join("run"));
    assert_eq!(kept_note["response"], text);
    for (species, (dye, written, _)) in kept_note["species"].as_array().unwrap().iter().zip(&kept) {
        assert_eq!(species["name"], *dye);
        assert!((species["transmission"].as_f64().unwrap() - written).abs() < 1e-6, "{species}");
    }
    // `analyze` takes the file as one of `calibrate response`.
    let (run, out) = (folder.path().join("run"), folder.path().join("again"));
    let line = Line::parse_from([
        "analyze".as_ref(),
        run.as_os_str(),
        "--species".as_ref(),
        "Alexa Fluor 488,Atto 565,Alexa Fluor 647".as_ref(),
        "--response".as_ref(),
        kept[2].2.as_os_str(),
        "--out".as_ref(),
        out.as_os_str(),
    ]);
    crate::app::analyze::run(&line.analyze).unwrap();
    let report = std::fs::read_to_string(out.join("report.json")).unwrap();
    assert!(report.contains("measured shares"), "{report}");
    // So does the next live view, which says so of what it is compared with.
    live(&bench, steady());
    begin(&bench, TRUTH[1].0, &[TRUTH[1].2], 20);
    let again = found(&bench);
    let compared = again.in_use.as_ref().unwrap();
    assert!(
        (compared.transmission - kept[1].1).abs() < 1e-6 && compared.from.contains("measured"),
        "{compared:?}"
    );
    // Given up, the coefficients of the instrument are back.
    ask(&bench, ColorsAsk::Discard);
    ask(&bench, ColorsAsk::Forget);
    let status = bench.status();
    assert!(
        !status.colors.is_of_session && TRUTH.iter().all(|(dye, truth, _)| in_use(&status, dye) == *truth)
    );
    let without = note(&bench, &folder.path().join("without"));
    assert_eq!(without["species"][1]["transmission"], 0.35);
    assert!(without.get("response").is_none());
}

#[test]
fn what_is_discarded_leaves_everything_as_it_was() {
    let folder = tempfile::tempdir().unwrap();
    let bench = simulated();
    live(&bench, steady());
    begin(&bench, TRUTH[1].0, &[TRUTH[1].2], 5000);
    until(&bench, "frames that are counted", |status| match status.colors.step {
        ColorsStep::Gathering { taken, wanted: 5000 } if taken > 0 => Some(()),
        _ => None,
    });
    ask(&bench, ColorsAsk::Discard);
    assert_eq!(bench.status().colors.step, ColorsStep::Idle);
    begin(&bench, TRUTH[1].0, &[TRUTH[1].2], 20);
    found(&bench);
    ask(&bench, ColorsAsk::Discard);
    let file = folder.path().join("response.toml");
    ask(&bench, ColorsAsk::Use(file.clone()));
    until(&bench, "a refusal", |status| {
        text_of(status, Gravity::Error).iter().any(|text| text.contains("no share was found")).then_some(())
    });
    assert!(!file.exists() && !bench.status().colors.is_of_session);
    assert_eq!(bench.status().activity, Activity::Live);
}

#[test]
fn regions_that_cannot_be_used_say_what_to_do() {
    let bench = simulated();
    live(&bench, steady());
    for (area, why) in [
        ([28, 41, 16, 6], "too small"),
        ([60, 41, 16, 16], "clear the regions and mark them again"),
        ([4, 2, 60, 10], "too dark"),
    ] {
        begin(&bench, TRUTH[0].0, &[area], 10);
        let said = failure(&bench);
        assert!(said.contains(why), "{said}");
        ask(&bench, ColorsAsk::Discard);
    }
    let marked = MarkedRegions { dye: vec![[28, 41, 16, 16]], background: Some([30, 45, 10, 10]) };
    ask(&bench, ColorsAsk::Begin { dye: TRUTH[0].0.to_owned(), marked, frames: 10 });
    assert!(failure(&bench).contains("none of the dyes is"));
    // Regions stay where they are on the sensor when less of it is read.
    live(&bench, LiveSettings { region: Some([8, 24, 48, 40]), ..steady() });
    begin(&bench, TRUTH[1].0, &[TRUTH[1].2], 60);
    let share = found(&bench);
    assert!((share.transmission - 0.35).abs() <= 1.5 * share.uncertainty, "{share:?}");
    begin(&bench, TRUTH[1].0, &[TRUTH[1].2], 5000);
    until(&bench, "frames that are counted", |status| match status.colors.step {
        ColorsStep::Gathering { .. } => Some(()),
        _ => None,
    });
    bench.ask(BenchCommand::Finish).unwrap();
    assert!(failure(&bench).contains("start it again (L)"));
}
