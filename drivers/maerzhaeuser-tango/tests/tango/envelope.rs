//! Whatever is asked for, nothing outside of the envelope goes onto the wire.

use proptest::prelude::*;
use sofiscope_hal::{Micrometers, Stage, StagePoint};
use sofiscope_maerzhaeuser_tango::TangoSettings;

use crate::bench::{Bench, length, opened, settings};

/// Requests of one case; with the cases, 10^5 requests.
const REQUESTS: usize = 500;
const CASES: u32 = 200;

/// Any number at all, often near the edges.
fn number() -> impl Strategy<Value = f64> {
    let edges = [5000.07, 99_999.96, 0.0, 60_000.0, 120_000.0, -2000.0];
    let near = (prop::sample::select(edges.to_vec()), -0.2..0.2_f64).prop_map(|(edge, off)| edge + off);
    let odd = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, f64::MAX, f64::MIN_POSITIVE, -0.0, 1e300];
    prop_oneof![any::<f64>(), near, -1e4..1.3e5_f64, 5000.0..60_000.0_f64, prop::sample::select(odd.to_vec())]
}

/// Limits that are not on the grid of the controller.
fn odd() -> TangoSettings {
    let mut settings = settings();
    settings.envelope.x = length(5000.07)..=length(99_999.96);
    settings
}

/// The target of a command, in micrometers; `None` for commands that do not move.
fn target_of(command: &str) -> Option<[f64; 2]> {
    let words: Vec<&str> = command.split(' ').collect();
    let ["!moa" | "go", x, y] = words[..] else {
        assert!(
            !command.contains("mo") && !command.contains("go") && !command.contains("speed"),
            "{command}"
        );
        return None;
    };
    // The fourth decimal of a millimeter is a tenth of a micrometer; exact, as in a slow and obvious driver.
    let micrometers = |word: &str| {
        let tenths: i64 = word.replace('.', "").parse().unwrap_or_else(|_| panic!("no number: {command}"));
        assert!(word.split('.').nth(1).is_some_and(|decimals| decimals.len() == 4), "{command}");
        tenths as f64 / 10.0
    };
    Some([micrometers(x), micrometers(y)])
}

proptest! {
    #![proptest_config(ProptestConfig { cases: CASES, max_shrink_iters: 2000, ..ProptestConfig::default() })]

    #[test]
    fn no_request_brings_a_command_outside_onto_the_wire(
        requests in prop::collection::vec((number(), number()), REQUESTS),
    ) {
        let mut bench = Bench::homed();
        let configured = odd();
        bench.stage = opened(&bench.port, configured.clone()).unwrap();
        bench.received();
        let envelope = bench.stage.envelope().clone();
        prop_assert_eq!(envelope.y.start().value(), 0.0);
        for (x, y) in requests {
            let (x, y) = match (Micrometers::new(x), Micrometers::new(y)) {
                (Ok(x), Ok(y)) => (x, y),
                (x, y) => {
                    prop_assert!(x.is_err() || y.is_err());
                    continue;
                }
            };
            let target = StagePoint { x, y };
            let taken = bench.stage.move_to(target);
            let received = bench.received();
            prop_assert_eq!(taken.is_ok(), envelope.contains(target), "{:?}: {:?}", target, taken);
            if taken.is_err() {
                prop_assert_eq!(received, Vec::<String>::new(), "a refused request costs no byte: {:?}", target);
                continue;
            }
            let targets: Vec<[f64; 2]> = received.iter().filter_map(|command| target_of(command)).collect();
            prop_assert_eq!(targets.len(), 1);
            for [x, y] in targets {
                let sent = StagePoint { x: Micrometers::new(x).unwrap(), y: Micrometers::new(y).unwrap() };
                prop_assert!(envelope.contains(sent) && configured.envelope.contains(sent), "{:?}", received);
            }
        }
    }
}
