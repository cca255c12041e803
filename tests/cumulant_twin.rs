//! The running engine against a slow two-pass twin, and the algebra that its state must obey.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on should stop here")]

mod compare;
mod twin;

use proptest::prelude::*;
use rand::{Rng, RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use sofiscope::sofi::cumulant::{CumulantEngine, CumulantSettings, Drawing, Exposure, Incomplete, Serial};
use sofiscope::sofi::grid::Combinations;
use twin::Recorded;

#[derive(Debug, Clone)]
struct Case {
    settings: CumulantSettings,
    height: usize,
    width: usize,
    frames: usize,
    offset: u32,
    lost_one_in: u32,
    seed: u64,
}

impl Case {
    /// Blinking, correlated pixels on an offset; some exposures lost.
    fn record(&self) -> Vec<Recorded> {
        let mut random = Xoshiro256PlusPlus::seed_from_u64(self.seed);
        let pixels = self.height * self.width;
        let brightness: Vec<f64> = (0..pixels).map(|_| random.random_range(0.0..60.0)).collect();
        let mut recorded = Vec::new();
        for index in 0..self.frames as u64 {
            let on = random.random_range(0..3) == 0;
            let planes = (0..self.settings.channels).map(|channel| {
                let share = 1.0 / (1.0 + channel as f64);
                let light = |pixel: usize| if on { share * brightness[pixel] } else { 0.0 };
                (0..pixels)
                    .map(|p| (light(p) + f64::from(self.offset) + noise(&mut random)).round())
                    .collect()
            });
            let planes: Vec<Vec<f64>> = planes.collect();
            if self.lost_one_in == 0 || random.random_range(0..self.lost_one_in) != 0 {
                recorded.push((self.settings.first_exposure + index, planes));
            }
        }
        recorded
    }
}

fn noise(random: &mut impl Rng) -> f64 {
    (0..4).map(|_| random.random_range(0.0..8.0)).sum()
}

fn counts(recorded: &[Recorded]) -> Vec<(u64, Vec<Vec<u16>>)> {
    let as_counts = |plane: &Vec<f64>| plane.iter().map(|&value| value as u16).collect();
    recorded.iter().map(|(index, planes)| (*index, planes.iter().map(as_counts).collect())).collect()
}

fn push_all(engine: &mut CumulantEngine<u16>, frames: &[(u64, Vec<Vec<u16>>)], block: usize) {
    for block in frames.chunks(block) {
        let planes: Vec<Vec<&[u16]>> =
            block.iter().map(|(_, planes)| planes.iter().map(Vec::as_slice).collect()).collect();
        let exposures: Vec<Exposure<'_, u16>> = block
            .iter()
            .zip(&planes)
            .map(|((index, _), planes)| Exposure { index: *index, planes })
            .collect();
        engine.push(&Serial, &exposures).unwrap();
    }
}

fn drawn(case: &Case, frames: &[(u64, Vec<Vec<u16>>)], block: usize) -> Option<Drawing> {
    let mut engine = CumulantEngine::new(case.settings.clone(), case.height, case.width).unwrap();
    push_all(&mut engine, frames, block);
    engine.draw(&Serial, Incomplete::AtLeastHalf)
}

fn tolerance(order: usize) -> f64 {
    if order == 2 { 1e-5 } else { 1e-4 }
}

fn cases() -> impl Strategy<Value = Case> {
    let sizes = (4usize..9, 4usize..21);
    let stream = (10usize..90, 8u64..60, prop_oneof![Just(0u32), Just(7)], 0u32..20_000);
    (2usize..=6, 1usize..=3, sizes, stream, any::<u64>(), any::<bool>()).prop_map(
        |(order, channels, (height, width), (frames, subsequence, lost_one_in, offset), seed, thin)| {
            // Many channels at high order are slow in the twin, not in the engine.
            let channels = if order > 4 { channels.min(2) } else { channels };
            let (height, width) = if order > 3 { (height.min(6), width.min(7)) } else { (height, width) };
            let frames = if order > 3 { 10 + frames / 3 } else { frames };
            let mut settings = CumulantSettings::new(order, channels, subsequence);
            if thin {
                settings.combinations = Combinations::OnePerPosition;
            }
            Case { settings, height, width, frames, offset, lost_one_in, seed }
        },
    )
}

fn assert_agrees_with_twin(case: &Case, block: usize) {
    let recorded = case.record();
    let expected = twin::cumulants(&case.settings, case.height, case.width, &recorded);
    let Some(drawing) = drawn(case, &counts(&recorded), block) else {
        assert!(
            expected[0].iter().all(|value| value.is_nan()),
            "the twin found a usable subsequence: {case:?}"
        );
        return;
    };
    for (u, (got, expected)) in drawing.cumulants.iter().zip(&expected).enumerate() {
        let error = compare::relative_error(got, expected);
        assert!(error <= tolerance(case.settings.order), "channel {u}: {error:e} in {case:?}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 16, failure_persistence: None, rng_seed: proptest::test_runner::RngSeed::Fixed(2026), ..ProptestConfig::default() })]

    #[test]
    fn engine_agrees_with_the_two_pass_twin(case in cases(), block in 1usize..40) {
        assert_agrees_with_twin(&case, block);
    }

    #[test]
    fn lags_agree_with_the_twin_and_never_bridge_a_gap(
        case in cases(), block in 1usize..40, lags in proptest::collection::vec(0u64..3, 6)
    ) {
        let mut case = case;
        case.settings.lags = lags[..case.settings.order].to_vec();
        assert_agrees_with_twin(&case, block);
    }

    #[test]
    fn blocks_do_not_change_a_bit(case in cases(), block in 1usize..40) {
        let frames = counts(&case.record());
        let one_by_one = drawn(&case, &frames, 1);
        let in_blocks = drawn(&case, &frames, block);
        prop_assert_eq!(one_by_one.is_some(), in_blocks.is_some());
        if let (Some(a), Some(b)) = (one_by_one, in_blocks) {
            let bits = |drawing: &Drawing| -> Vec<u32> {
                let images = drawing.cumulants.iter().chain(&drawing.means).chain(&drawing.variances);
                images.flatten().map(|value| value.to_bits()).collect()
            };
            prop_assert_eq!(bits(&a), bits(&b));
        }
    }

    #[test]
    fn merged_states_equal_one_sequence(
        case in cases(), cut in 0.0f64..1.0, gap in 0u64..20, lagged in any::<bool>()
    ) {
        let mut case = case;
        if lagged {
            case.settings.lags = (0..case.settings.order as u64).map(|pixel| pixel % 3).collect();
        }
        let frames = counts(&case.record());
        let cut = (cut * case.frames as f64) as u64;
        let early: Vec<_> = frames.iter().filter(|(index, _)| *index < cut).cloned().collect();
        let late: Vec<_> = frames.iter().filter(|(index, _)| *index >= cut + gap).cloned().collect();
        let both: Vec<_> = early.iter().chain(&late).cloned().collect();
        let mut first = CumulantEngine::new(case.settings.clone(), case.height, case.width).unwrap();
        push_all(&mut first, &early, 11);
        let settings = CumulantSettings { first_exposure: cut + gap, ..case.settings.clone() };
        let mut second = CumulantEngine::new(settings, case.height, case.width).unwrap();
        push_all(&mut second, &late, 7);
        first.merge(&Serial, &second).unwrap();
        let merged = first.draw(&Serial, Incomplete::AtLeastHalf);
        let sequence = drawn(&case, &both, 5);
        prop_assert_eq!(merged.is_some(), sequence.is_some(), "{:?}", case);
        if let (Some(merged), Some(sequence)) = (merged, sequence) {
            prop_assert_eq!((merged.runs, merged.samples), (sequence.runs, sequence.samples));
            for (a, b) in merged.cumulants.iter().zip(&sequence.cumulants) {
                let error = compare::relative_error(a, &b.mapv(f64::from));
                prop_assert!(error <= tolerance(case.settings.order), "{error:e} in {case:?}");
            }
        }
    }
}

#[test]
fn long_subsequences_keep_their_precision() {
    let settings = CumulantSettings::new(2, 2, 3000);
    let case = Case { settings, height: 4, width: 5, frames: 3000, offset: 20_000, lost_one_in: 0, seed: 5 };
    assert_agrees_with_twin(&case, 64);
}

#[test]
fn masked_pixels_become_nan_and_change_nothing_else() {
    let settings = CumulantSettings::new(3, 2, 20);
    let case = Case { settings, height: 9, width: 10, frames: 20, offset: 100, lost_one_in: 0, seed: 8 };
    let frames = counts(&case.record());
    let mut engine = CumulantEngine::new(case.settings.clone(), 9, 10).unwrap();
    let mut mask = ndarray::Array2::from_elem((9, 10), false);
    mask[[4, 5]] = true;
    engine.set_masks(vec![None, Some(mask)]);
    push_all(&mut engine, &frames, 8);
    let masked = engine.draw(&Serial, Incomplete::AtLeastHalf).unwrap();
    let whole = drawn(&case, &frames, 8).unwrap();
    let needs_no_t = compare::relative_error(&masked.cumulants[0], &whole.cumulants[0].mapv(f64::from));
    assert_eq!(needs_no_t, 0.0, "RRR takes no pixel from T");
    let mut newly_nan = 0;
    for (masked, whole) in masked.cumulants[1].iter().zip(&whole.cumulants[1]) {
        assert!(masked.is_nan() || masked == whole);
        newly_nan += usize::from(masked.is_nan() && !whole.is_nan());
    }
    assert!(newly_nan > 9, "only {newly_nan} virtual pixels need the masked one");
    assert!(masked.means[1][[4, 5]].is_nan() && !masked.means[0][[4, 5]].is_nan());
}

#[test]
fn state_does_not_grow_with_exposures_and_stays_in_its_budget() {
    let mut engine = CumulantEngine::<u16>::new(CumulantSettings::new(2, 2, 200), 64, 64).unwrap();
    let planes: [&[u16]; 2] = [&[100; 4096], &[90; 4096]];
    let mut bytes = Vec::new();
    for index in 0..900 {
        engine.push(&Serial, &[Exposure { index, planes: &planes }]).unwrap();
        bytes.push(engine.state_bytes());
    }
    assert_eq!(bytes[0], bytes[899]);
    assert!(bytes[899] as f64 / (2.0 * 4096.0) <= 150.0, "{} bytes", bytes[899]);
}

#[test]
fn short_subsequences_of_high_order_keep_their_precision() {
    let mut settings = CumulantSettings::new(4, 3, 16);
    (settings.combinations, settings.lags) = (Combinations::OnePerPosition, vec![2, 0, 2, 2]);
    let seed = 9_861_212_823_445_054_859;
    assert_agrees_with_twin(
        &Case { settings, height: 5, width: 7, frames: 23, offset: 0, lost_one_in: 0, seed },
        5,
    );
}
