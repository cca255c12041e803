//! Shares of the dyes' light: from single-stained samples, and contradicted by data.

use crate::bench::{Bench, shipped, single_stained, text, told};
use sofiscope::sofi::response::{
    Marked, MeasuredShare, PixelArea, ResponseSettings, StainedSums, transmitted_share, transmitted_share_in,
};
use sofiscope_hal::{Channel, ExposureIndex};
use sofiscope_sim::{Scene, World};

const S4: &str = "Alexa Fluor 488,Atto 565,Alexa Fluor 647";

/// What a sample of one dye with this share gives.
fn measured(share: f64, seed: u64) -> MeasuredShare {
    let text = single_stained(&shipped("figure-s4"), 1)
        .replace("transmission = 0.35", &format!("transmission = {share:?}"));
    let scene = Scene::from_toml(&text).unwrap().with_frames(60).unwrap();
    let world = World::new(&scene, seed);
    let mut sums = StainedSums::new([72, 72]);
    let mut counts = [vec![0; 72 * 72], vec![0; 72 * 72]];
    for exposure in 0..60 {
        for channel in Channel::BOTH {
            world.frame(channel, ExposureIndex(exposure), &mut counts[channel.index()]).unwrap();
        }
        sums.push([&counts[0], &counts[1]]);
    }
    transmitted_share(&sums.means().unwrap(), &ResponseSettings::default()).unwrap()
}

#[test]
fn shares_lie_within_their_uncertainty_in_19_of_20_trials() {
    let (mut within, mut half, mut squares) = (0, 0, 0.0);
    for trial in 0..100 {
        let share = [0.02, 0.16, 0.26, 0.35, 0.47, 0.98][trial % 6];
        let found = measured(share, 1000 + trial as u64);
        let off = (found.transmission - share) / found.error;
        within += u32::from((found.transmission - share).abs() <= found.uncertainty());
        half += u32::from((found.transmission - share).abs() <= 0.5 * found.uncertainty());
        squares += off * off;
    }
    println!(
        "{within} of 100 within, {half} within half, mean square in standard errors {}",
        squares / 100.0
    );
    assert!(within >= 95, "{within} of 100");
    // Nor is the uncertainty stated larger than it is: half of it holds some two thirds.
    assert!(half <= 85, "{half} of 100 within half of it");
}

/// The mixed sample and, dye by dye, where only one of them is; last, where none is.
const ALONE: [PixelArea; 4] = [
    PixelArea { top: 43, left: 30, height: 12, width: 12 },
    PixelArea { top: 31, left: 19, height: 13, width: 16 },
    PixelArea { top: 31, left: 38, height: 13, width: 16 },
    PixelArea { top: 2, left: 4, height: 12, width: 60 },
];

#[test]
fn regions_of_a_mixed_sample_give_each_share_within_its_uncertainty() {
    let scene = shipped("figure-s4");
    let scene = scene.replace("photons_per_exposure = 5.0", "photons_per_exposure = 50.0");
    let scene = Scene::from_toml(&scene).unwrap().with_frames(100).unwrap();
    let truth = [0.02, 0.35, 0.98];
    for background in [None, Some(ALONE[3])] {
        let (mut within, mut half, mut largest) = ([0; 3], 0, [0.0_f64; 3]);
        let mut off = [0.0; 3];
        for trial in 0..100 {
            let world = World::new(&scene, 3000 + trial);
            let mut sums = StainedSums::new([72, 72]);
            let mut counts = [vec![0; 72 * 72], vec![0; 72 * 72]];
            for exposure in 0..100 {
                for channel in Channel::BOTH {
                    world.frame(channel, ExposureIndex(exposure), &mut counts[channel.index()]).unwrap();
                }
                sums.push([&counts[0], &counts[1]]);
            }
            let means = sums.means().unwrap();
            for dye in 0..3 {
                let marked = Marked { dye: &ALONE[dye..=dye], background };
                let found = transmitted_share_in(&means, &ResponseSettings::default(), &marked).unwrap();
                let distance = (found.transmission - truth[dye]).abs();
                within[dye] += u32::from(distance <= found.uncertainty());
                half += u32::from(distance <= 0.5 * found.uncertainty());
                largest[dye] = largest[dye].max(found.uncertainty());
                off[dye] += (found.transmission - truth[dye]) / 100.0;
            }
        }
        println!(
            "background {background:?}: {within:?} of 100 within, {half} of 300 within half, off {off:?}"
        );
        println!("largest uncertainty {largest:?}");
        assert!(within.iter().all(|&within| within >= 90), "{within:?} of 100");
        // Nor is the uncertainty stated larger than it is.
        assert!(half <= 270, "{half} of 300 within half of it");
        assert!(largest.iter().all(|&largest| largest < 0.05), "{largest:?}");
    }
}

#[test]
fn coefficients_that_the_data_contradict_are_named() {
    let bench = Bench::new();
    let scene = shipped("figure-s4");
    bench.simulate("sample", &scene, &["--frames", "1000"]);
    let folders = [0, 1, 2].map(|dye| {
        let single = single_stained(&scene, dye);
        bench.simulate(&format!("stained-{dye}"), &single, &["--frames", "200", "--seed", "5"])
    });
    let stained: Vec<String> =
        S4.split(',').zip(&folders).map(|(name, folder)| format!("{name}={}", text(folder))).collect();
    let out = bench.path("response.toml");
    let mut arguments = vec!["calibrate", "response", "--name", "our dichroic", "--out", text(&out)];
    stained.iter().for_each(|stained| arguments.extend(["--stained", stained.as_str()]));
    let told = told(&arguments);
    for (coefficient, truth) in told["coefficients"].as_array().unwrap().iter().zip([0.02, 0.35, 0.98]) {
        let number = |key: &str| coefficient[key].as_f64().unwrap();
        let (found, uncertainty) = (number("transmission"), number("transmission_uncertainty"));
        assert!((found - truth).abs() < 1.5 * uncertainty && uncertainty < 0.005, "{coefficient}");
    }
    let right = bench.analyze("sample", "right", &["--species", S4, "--response", text(&out)]);
    assert!(!right.contains("may be wrong"), "{right}");
    let report = std::fs::read_to_string(bench.path("right/report.json")).unwrap();
    assert!(report.contains("measured shares"), "{report}");
    let measured = std::fs::read_to_string(&out).unwrap();
    let dye = told["coefficients"][1]["transmission"].as_f64().unwrap();
    let wrong = measured.replace(&format!("transmission = {dye:.6}"), "transmission = 0.45");
    assert_ne!(wrong, measured);
    let wrong = bench.write("wrong.toml", &wrong);
    let said = bench.analyze("sample", "wrong", &["--species", S4, "--response", text(&wrong)]);
    assert!(said.contains("Where Atto 565 prevails") && said.contains("T = 0.45 may be wrong"), "{said}");
}
