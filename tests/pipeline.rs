//! Accounting: every exposure of every camera is somewhere, and no pair is wrong.
//!
//! The simulated cameras say exactly what they did; the books of the pipeline must say the same, whatever is too slow.
//! `SOFISCOPE_TEST_EXPOSURES` sets the number of exposures of each run (100 000 by default).

#[cfg(test)]
#[path = "pipeline/rig.rs"]
mod rig;

#[cfg(test)]
mod tests {
    use crate::rig::{Outcome, Rates, exposures, run};
    use sofiscope::acquisition::Loss;
    use sofiscope_hal::Channel;
    use sofiscope_sim::instrument::{Bursts, CameraFaults};
    use sofiscope_sim::{InstrumentSettings, Scenario};

    const SEEDS: [u64; 3] = [1, 2, 3];

    fn unkind(seed: u64) -> InstrumentSettings {
        let mut settings = InstrumentSettings { seed, ..InstrumentSettings::default() };
        for camera in &mut settings.cameras {
            camera.faults = CameraFaults {
                drop_one_in: Some(100),
                bursts: Some(Bursts { probability: 2e-5, lengths: [1, 500] }),
                duplicate_one_in: Some(1000),
                reorder_within: Some(8),
                incomplete_one_in: Some(5000),
                ..CameraFaults::default()
            };
        }
        settings
    }

    /// What must hold in every run, whoever is too slow.
    fn assert_accounted(outcome: &Outcome, name: &str) {
        let accounts = &outcome.accounts;
        assert_eq!(accounts.balance(), Ok(()), "{name}");
        assert_eq!(outcome.wrong_frames, 0, "{name}: frames with the pixels of another exposure");
        assert_eq!(outcome.records, accounts.exposures, "{name}: every exposure reaches the recording once");
        assert!(outcome.records_in_order, "{name}");
        for channel in Channel::BOTH {
            let lost: Vec<u64> = accounts
                .losses
                .iter()
                .filter(|range| range.channel == channel)
                .flat_map(|range| range.first..=range.last)
                .collect();
            let mut truly = outcome.oracle.lost(channel);
            truly.retain(|&exposure| exposure < accounts.exposures);
            assert_eq!(lost.len(), truly.len(), "{name}, {channel}");
            assert!(lost == truly, "{name}, {channel}: the books name other exposures than the camera lost");
            let account = &accounts.cameras[channel.index()];
            assert_eq!(account.received, outcome.oracle.intact(channel), "{name}, {channel}");
            assert_eq!(
                account.duplicates + account.late,
                outcome.oracle.duplicates(channel),
                "{name}, {channel}"
            );
            let unrecorded: u64 = account.unrecorded.values().sum();
            assert_eq!(account.received, outcome.recorded[channel.index()] + unrecorded, "{name}, {channel}");
        }
        let left_out: u64 = accounts.analysis_left_out.values().sum();
        assert_eq!(accounts.pairs, outcome.analyzed + left_out, "{name}: pairs = analyzed + left out");
        assert_eq!(accounts.pairs_analyzed, outcome.analyzed, "{name}");
    }

    #[test]
    fn nothing_is_lost_that_the_cameras_deliver() {
        for seed in SEEDS {
            let outcome = run(unkind(seed), Rates::default());
            assert_accounted(&outcome, "all fast enough");
            let lost_reasons: Vec<Loss> = outcome.accounts.lost_by_reason().into_keys().collect();
            assert_eq!(lost_reasons, [Loss::UpstreamGap, Loss::Incomplete]);
            assert_eq!(
                outcome.recorded.iter().sum::<u64>(),
                outcome.accounts.cameras.iter().map(|camera| camera.received).sum::<u64>()
            );
            assert!(outcome.accounts.analysis_left_out.keys().all(|&reason| reason == Loss::ShedByPolicy));
            assert!(outcome.accounts.exposures >= exposures() - 500);
        }
    }

    #[test]
    fn a_slow_analysis_costs_the_preview_first_and_the_recording_never() {
        for seed in SEEDS {
            let outcome = run(unkind(seed), Rates { analysis: Some(1.5), ..Rates::default() });
            assert_accounted(&outcome, "analysis too slow");
            assert!(outcome.accounts.analysis_left_out.values().sum::<u64>() > 0);
            assert!(outcome.accounts.cameras.iter().all(|camera| camera.unrecorded.is_empty()));
            assert_eq!(outcome.analysis_lost_beside_preview, 0, "the preview must go first");
        }
    }

    #[test]
    fn a_slow_recording_costs_preview_and_analysis_before_a_frame() {
        for seed in SEEDS {
            let outcome = run(unkind(seed), Rates { recording: Some(1.5), ..Rates::default() });
            assert_accounted(&outcome, "recording too slow");
            assert!(outcome.accounts.cameras[0].unrecorded.contains_key(&Loss::QueueFull));
            assert!(outcome.accounts.analysis_left_out.contains_key(&Loss::ShedByPolicy));
            assert_eq!(outcome.recording_lost_beside_analysis, 0, "the analysis must go first");
        }
    }

    #[test]
    fn everything_too_slow_is_still_accounted() {
        for seed in SEEDS {
            let rates = Rates { analysis: Some(1.5), recording: Some(1.5), ..Rates::default() };
            assert_accounted(&run(unkind(seed), rates), "both too slow");
        }
    }

    #[test]
    fn a_missed_trigger_costs_one_pair_and_makes_none_wrong() {
        let mut settings = InstrumentSettings::default();
        settings.cameras[0].faults.missed_trigger_at = vec![1_000, 40_000];
        settings.cameras[1].faults.missed_trigger_at = vec![20_000];
        let outcome = run(settings, Rates::default());
        assert_eq!(outcome.wrong_frames, 0);
        assert_eq!(outcome.accounts.balance(), Ok(()));
        assert_eq!(outcome.accounts.pairs, exposures() - 3);
        assert_eq!(outcome.missed_triggers, 3);
    }

    #[test]
    fn extra_triggers_cost_few_pairs_and_make_none_wrong() {
        let scenario = "[faults.reflected]\nextra_trigger_at = [1000, 1003, 40000]\n\
                        [faults.transmitted]\nextra_trigger_at = 20000\nmissed_trigger_at = 30000\n";
        let outcome = run(Scenario::from_toml(scenario).unwrap().into_settings(), Rates::default());
        assert_eq!(outcome.accounts.balance(), Ok(()));
        assert_eq!(outcome.wrong_pairs, 0);
        assert!(outcome.accounts.pairs >= exposures() - 10, "{} pairs", outcome.accounts.pairs);
        assert_eq!((outcome.extra_triggers, outcome.missed_triggers), (4, 1));
        let extra: u64 = outcome.accounts.cameras.iter().map(|camera| camera.extra).sum();
        assert_eq!(extra, Channel::BOTH.map(|channel| outcome.oracle.extra(channel)).iter().sum::<u64>());
    }

    #[test]
    fn extra_triggers_among_lost_and_shuffled_frames_make_no_pair_wrong() {
        for seed in SEEDS {
            let mut settings = unkind(seed);
            let slips = |from: u64| (from..exposures()).step_by(5_000).collect();
            settings.cameras[0].faults.extra_trigger_at = slips(2_500);
            settings.cameras[1].faults.extra_trigger_at = slips(4_000);
            settings.cameras[1].faults.missed_trigger_at = slips(1_000);
            let outcome = run(settings, Rates::default());
            assert_eq!(outcome.accounts.balance(), Ok(()));
            assert_eq!(outcome.wrong_pairs, 0);
            let whole = run(unkind(seed), Rates::default()).accounts.pairs;
            assert!(outcome.accounts.pairs + 20 * 60 > whole, "{} of {whole}", outcome.accounts.pairs);
        }
    }

    #[test]
    fn a_counter_that_restarts_soon_after_arming_loses_nothing() {
        for (at, counter) in [(1, "16-bit"), (5, "64-bit"), (63, "16-bit"), (64, "64-bit")] {
            let scenario =
                format!("[camera]\ncounter = \"{counter}\"\n[faults.transmitted]\nid_restart_at = {at}\n");
            let outcome = run(Scenario::from_toml(&scenario).unwrap().into_settings(), Rates::default());
            assert_accounted(&outcome, "counter restart");
            assert_eq!(outcome.accounts.pairs, exposures());
        }
    }

    #[test]
    fn a_slow_preview_costs_neither_analysis_nor_recording_a_frame() {
        for seed in SEEDS {
            let outcome = run(unkind(seed), Rates { preview: Some(1.5), ..Rates::default() });
            assert_accounted(&outcome, "preview too slow");
            assert!(outcome.previews_skipped > 0, "a preview that keeps up is not too slow");
            assert_eq!(outcome.previews_shown + outcome.previews_skipped, outcome.analyzed);
            assert!(outcome.accounts.cameras.iter().all(|camera| camera.unrecorded.is_empty()));
        }
    }

    #[test]
    fn all_three_too_slow_are_still_accounted_and_shed_in_order() {
        for seed in SEEDS {
            let outcome =
                run(unkind(seed), Rates { preview: Some(1.5), analysis: Some(1.5), recording: Some(1.5) });
            assert_accounted(&outcome, "all three too slow");
            assert_eq!(outcome.previews_shown + outcome.previews_skipped, outcome.analyzed);
            assert_eq!(outcome.analysis_lost_beside_preview, 0, "the preview must go first");
            assert_eq!(
                outcome.recording_lost_beside_analysis, 0,
                "the analysis must go before the recording"
            );
        }
    }
}
