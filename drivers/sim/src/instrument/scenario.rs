//! A scenario file: how the simulated instrument behaves and what goes wrong with it.
//!
//! In: TOML text with units in its key names. Out: a [`Scenario`] with every value inside its limits.
//! Never: accepts an unknown key, reads a file.
//! Fails: [`ScenarioError`] with all faults at once, each with line, key and remedy.
//!
//! Keys of `[camera]` and `[faults]` hold for both cameras; those of `[camera.reflected]`,
//! `[camera.transmitted]`, `[faults.reflected]` and `[faults.transmitted]` for one of them, where they replace the common ones.

use std::time::Duration;

use sofiscope_form::{Fault, Faults, Form, counted};

use super::settings::{
    Bursts, CameraBehavior, CameraFaults, ClockStep, Counter, DeviceClock, InstrumentSettings, Pace,
};

/// A scenario longer than this is refused unread.
const MAX_TEXT_BYTES: usize = 1 << 20;
const EXPOSURE: std::ops::RangeInclusive<u64> = 0..=1_000_000_000_000;
const ONE_IN: std::ops::RangeInclusive<u64> = 1..=1_000_000_000;

/// All faults of a scenario file; never empty.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("the scenario has {}", counted(.faults))]
pub struct ScenarioError {
    /// The faults in order of lines.
    pub faults: Vec<Fault>,
}

/// Settings read from the text of a scenario.
#[derive(Debug, Clone)]
pub struct Scenario {
    settings: InstrumentSettings,
}

impl Scenario {
    /// Reads a scenario; an empty text is an instrument without faults.
    ///
    /// # Errors
    /// All faults of the text at once.
    pub fn from_toml(text: &str) -> Result<Self, ScenarioError> {
        let faults = Faults::new(text);
        if text.len() > MAX_TEXT_BYTES {
            let message = format!("is {} bytes long", text.len());
            faults.note(None, "", message, "give a file of at most 1 MiB");
            return Err(ScenarioError { faults: faults.into_list() });
        }
        let settings = sofiscope_form::read(&faults, read_settings);
        let list = faults.into_list();
        let settings = settings.filter(|_| list.is_empty()).ok_or(ScenarioError { faults: list })?;
        Ok(Self { settings })
    }

    /// The settings.
    #[must_use]
    pub fn settings(&self) -> &InstrumentSettings {
        &self.settings
    }

    /// The settings, to be changed or used up.
    #[must_use]
    pub fn into_settings(self) -> InstrumentSettings {
        self.settings
    }
}

fn read_settings(form: &Form<'_>) -> InstrumentSettings {
    let default = InstrumentSettings::default();
    let mut cameras = default.cameras;
    if let Some(camera) = form.table("camera") {
        read_both(&camera, &mut cameras, read_behavior);
        camera.finish();
    }
    if let Some(faults) = form.table("faults") {
        let mut both = cameras.each_ref().map(|camera| camera.faults.clone());
        read_both(&faults, &mut both, read_faults);
        for (camera, faults) in cameras.iter_mut().zip(both) {
            camera.faults = faults;
        }
        faults.finish();
    }
    InstrumentSettings {
        pace: read_pace(form),
        seed: form.whole_if_any("seed", 0..=i64::MAX as u64).unwrap_or(default.seed),
        exposures: form.whole_if_any("exposures", 1..=*EXPOSURE.end()),
        cameras,
        clock: default.clock,
    }
}

fn read_pace(form: &Form<'_>) -> Pace {
    let speed = form.number_if_any("speed", 1e-3..=1e3);
    let paces = [("unpaced", Pace::Unpaced), ("real-time", Pace::RealTime { speed: speed.unwrap_or(1.0) })];
    let pace = form.word("pace", &paces);
    if pace == Pace::Unpaced && speed.is_some() {
        form.fault("speed", "has no meaning without real time", "remove it, or add `pace = \"real-time\"`");
    }
    pace
}

/// Reads the common keys into both values, then those of each camera into its own.
fn read_both<T>(form: &Form<'_>, both: &mut [T; 2], read: fn(&Form<'_>, &mut T)) {
    for value in &mut *both {
        read(form, value);
    }
    for (value, key) in both.iter_mut().zip(["reflected", "transmitted"]) {
        if let Some(own) = form.table(key) {
            read(&own, value);
            own.finish();
        }
    }
}

fn read_behavior(form: &Form<'_>, camera: &mut CameraBehavior) {
    let offset_s = camera.clock.offset.as_secs_f64();
    camera.clock = DeviceClock {
        // Later than the farthest jump backwards.
        offset: Duration::from_secs_f64(form.number_or("clock_offset_s", offset_s, 2e5..=1e9)),
        drift_ppm: form.number_or("clock_drift_ppm", camera.clock.drift_ppm, -1e4..=1e4),
        jitter_ns: form.whole_if_any("clock_jitter_ns", 0..=1_000_000_000).unwrap_or(camera.clock.jitter_ns),
    };
    if form.has("counter") {
        let counters = [("16-bit", Counter::Careless16Bit), ("64-bit", Counter::FromZero)];
        camera.counter = form.word("counter", &counters);
    }
    if let Some(buffers) = form.whole_if_any("buffers", 1..=100_000) {
        camera.buffers = buffers as usize;
    }
}

fn read_faults(form: &Form<'_>, faults: &mut CameraFaults) {
    let whole = |key, value: &mut Option<u64>, limits| *value = form.whole_if_any(key, limits).or(*value);
    whole("drop_one_in", &mut faults.drop_one_in, ONE_IN);
    whole("duplicate_one_in", &mut faults.duplicate_one_in, ONE_IN);
    whole("incomplete_one_in", &mut faults.incomplete_one_in, ONE_IN);
    whole("reorder_within", &mut faults.reorder_within, 2..=64);
    whole("late_one_in", &mut faults.late_one_in, ONE_IN);
    whole("stall_at", &mut faults.stall_at, EXPOSURE);
    whole("die_at", &mut faults.die_at, EXPOSURE);
    whole("id_restart_at", &mut faults.id_restart_at, 1..=30_000);
    for (key, exposures) in [
        ("wrong_size_at", &mut faults.wrong_size_at),
        ("missed_trigger_at", &mut faults.missed_trigger_at),
        ("extra_trigger_at", &mut faults.extra_trigger_at),
    ] {
        if let Some(found) = form.wholes_if_any(key, EXPOSURE) {
            *exposures = found;
        }
    }
    faults.start_fails |= form.flag("start_fails");
    read_lateness(form, faults);
    read_bursts(form, faults);
    read_clock_step(form, faults);
}

fn read_lateness(form: &Form<'_>, faults: &mut CameraFaults) {
    let late_by_frames = form.whole_if_any("late_by_frames", 1..=64);
    faults.late_by_frames = late_by_frames.unwrap_or(faults.late_by_frames);
    check_pair(
        form,
        "late_one_in",
        faults.late_one_in.is_some(),
        "late_by_frames",
        faults.late_by_frames > 0,
    );
}

fn read_bursts(form: &Form<'_>, faults: &mut CameraFaults) {
    let probability = form.number_if_any("burst_probability", 0.0..=1.0);
    let lengths = form.pair_if_any("burst_lengths", 1.0..=500.0);
    let before = faults.bursts;
    let probability = probability.or(before.map(|bursts| bursts.probability));
    let lengths =
        lengths.map(|pair| pair.map(|length| length as u64)).or(before.map(|bursts| bursts.lengths));
    check_pair(form, "burst_probability", probability.is_some(), "burst_lengths", lengths.is_some());
    if lengths.is_some_and(|[fewest, most]| most < fewest) {
        form.fault("burst_lengths", "ends before it begins", "give the fewest and the most exposures");
    }
    faults.bursts = probability.zip(lengths).map(|(probability, lengths)| Bursts { probability, lengths });
}

fn read_clock_step(form: &Form<'_>, faults: &mut CameraFaults) {
    let before = faults.clock_step;
    let at = form.whole_if_any("clock_step_at", EXPOSURE).or(before.map(|step| step.at));
    let seconds = form.number_if_any("clock_step_s", -1e5..=1e5).or(before.map(|step| step.seconds));
    check_pair(form, "clock_step_at", at.is_some(), "clock_step_s", seconds.is_some());
    faults.clock_step = at.zip(seconds).map(|(at, seconds)| ClockStep { at, seconds });
}

/// Notes which of two keys that need each other is missing.
fn check_pair(form: &Form<'_>, one: &str, has_one: bool, other: &str, has_other: bool) {
    if has_one && !has_other {
        form.fault(one, format!("is given without `{other}`"), format!("add `{other} = ...`"));
    }
    if has_other && !has_one {
        form.fault(other, format!("is given without `{one}`"), format!("add `{one} = ...`"));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn faults(text: &str) -> Vec<(Option<usize>, String)> {
        let error = Scenario::from_toml(text).expect_err("this scenario is faulty");
        error.faults.into_iter().map(|fault| (fault.line, fault.key)).collect()
    }

    #[test]
    fn an_empty_scenario_is_an_instrument_without_faults() {
        let settings = Scenario::from_toml("").unwrap().into_settings();
        assert_eq!(settings.cameras, InstrumentSettings::default().cameras);
        assert_eq!((settings.pace, settings.exposures), (Pace::Unpaced, None));
    }

    #[test]
    fn every_key_is_read() {
        let text = r#"
            seed = 7
            exposures = 1000
            pace = "real-time"
            speed = 2.5
            [camera]
            counter = "64-bit"
            buffers = 32
            clock_offset_s = 300000
            clock_drift_ppm = 100.0
            clock_jitter_ns = 50
            [faults]
            drop_one_in = 97
            burst_probability = 0.001
            burst_lengths = [1, 500]
            duplicate_one_in = 98
            reorder_within = 8
            late_one_in = 99
            late_by_frames = 20
            incomplete_one_in = 100
            wrong_size_at = 5
            missed_trigger_at = [20, 10]
            extra_trigger_at = 30
            stall_at = 900
            die_at = 950
            id_restart_at = 1500
            clock_step_at = 600
            clock_step_s = -37.0
            start_fails = true
        "#;
        let settings = Scenario::from_toml(text).unwrap_or_else(|error| panic!("{error}")).into_settings();
        assert_eq!((settings.seed, settings.exposures), (7, Some(1000)));
        assert_eq!(settings.pace, Pace::RealTime { speed: 2.5 });
        let expected = CameraBehavior {
            counter: Counter::FromZero,
            clock: DeviceClock { offset: Duration::from_secs(300_000), drift_ppm: 100.0, jitter_ns: 50 },
            buffers: 32,
            faults: CameraFaults {
                drop_one_in: Some(97),
                bursts: Some(Bursts { probability: 0.001, lengths: [1, 500] }),
                duplicate_one_in: Some(98),
                reorder_within: Some(8),
                late_one_in: Some(99),
                late_by_frames: 20,
                incomplete_one_in: Some(100),
                wrong_size_at: vec![5],
                missed_trigger_at: vec![10, 20],
                extra_trigger_at: vec![30],
                stall_at: Some(900),
                die_at: Some(950),
                id_restart_at: Some(1500),
                clock_step: Some(ClockStep { at: 600, seconds: -37.0 }),
                start_fails: true,
            },
        };
        assert_eq!(settings.cameras, [expected.clone(), expected]);
    }

    #[test]
    fn a_camera_has_its_own_faults_beside_the_common_ones() {
        let text = "[faults]\ndrop_one_in = 97\n[faults.transmitted]\ndrop_one_in = 5\nstall_at = 3";
        let [reflected, transmitted] = Scenario::from_toml(text).unwrap().into_settings().cameras;
        assert_eq!((reflected.faults.drop_one_in, reflected.faults.stall_at), (Some(97), None));
        assert_eq!((transmitted.faults.drop_one_in, transmitted.faults.stall_at), (Some(5), Some(3)));
    }

    #[test]
    fn all_faults_of_a_scenario_are_told_at_once_with_their_lines() {
        let text = "speed = 2.0\n[faults]\ndrop_one_inn = 3\nreorder_within = 1000\nlate_one_in = 3\n\
                    missed_trigger_at = [1, -2]\n[faults.reflected]\nburst_lengths = [5, 2]\n\
                    [camera]\ncounter = 3";
        let expected = [
            (1, "speed"),
            (3, "faults.drop_one_inn"),
            (4, "faults.reorder_within"),
            (5, "faults.late_one_in"),
            (6, "faults.missed_trigger_at"),
            (8, "faults.reflected.burst_lengths"),
            (10, "camera.counter"),
        ];
        let found = faults(text);
        for (line, key) in expected {
            assert!(found.contains(&(Some(line), key.into())), "{line} {key}: {found:?}");
        }
        let message = Scenario::from_toml(text).unwrap_err().to_string();
        assert!(message.contains("write `drop_one_in` if that was meant"), "{message}");
    }

    #[test]
    fn broken_syntax_is_told_with_its_line() {
        assert_eq!(faults("seed = 1\n[faults")[0].0, Some(2));
    }
}
