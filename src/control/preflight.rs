//! Whether a run can work, before anything is lit.
//!
//! In: [`Facts`], plain numbers that the caller has gathered. Out: a list of [`Check`]s, all of them.
//! Never: asks a device or a disk, stops at the first failure. Fails: not at all; a failed check is a value.

use std::fmt;
use std::time::Duration;

use serde::Serialize;
use sofiscope_hal::{Channel, Region, TriggerMode};

/// Room for what is written beside the pixels.
const DISK_RESERVE: f64 = 1.05;
/// A disk below this share above the need is near its limit.
const RATE_RESERVE: f64 = 1.25;
/// Share of the largest count above which too little room is left for a bright moment.
const BRIGHT: f64 = 0.8;
/// Condition number above which unmixing is noisy, and above which it is refused.
const CONDITION_LIMITS: (f64, f64) = (100.0, 1e6);

/// How a check went.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Outcome {
    /// Nothing to say.
    Pass,
    /// The run can begin, and the person should know.
    Warn,
    /// The run must not begin.
    Fail,
}

/// One check: what, where, and what to do next.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Check {
    /// How it went.
    pub outcome: Outcome,
    /// What was checked.
    pub what: &'static str,
    /// Where, as the person knows it.
    pub place: String,
    /// What was found, with numbers.
    pub found: String,
    /// What to do next; empty for a pass.
    pub remedy: String,
}

impl fmt::Display for Check {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let outcome = match self.outcome {
            Outcome::Pass => "pass",
            Outcome::Warn => "warn",
            Outcome::Fail => "fail",
        };
        write!(formatter, "{outcome}  {} ({}): {}", self.what, self.place, self.found)?;
        if self.remedy.is_empty() { Ok(()) } else { write!(formatter, "; {}", self.remedy) }
    }
}

/// What is known of one camera.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraFacts {
    /// Its side of the dichroic.
    pub channel: Channel,
    /// True for a simulated camera.
    pub simulated: bool,
    /// Region that will be read.
    pub region: Region,
    /// Columns and rows of the sensor.
    pub sensor: (u32, u32),
    /// Time of one exposure.
    pub exposure: Duration,
    /// Time from exposure to exposure.
    pub period: Duration,
    /// Shortest period that the camera can do.
    pub shortest_period: Duration,
    /// What starts exposures.
    pub trigger: TriggerMode,
    /// Largest count of a pixel.
    pub saturation_counts: u16,
    /// Brightest count seen just now, where a frame was taken.
    pub brightest_counts: Option<u16>,
}

/// Where frames are recorded.
#[derive(Debug, Clone, PartialEq)]
pub struct DiskFacts {
    /// The directory.
    pub place: String,
    /// Bytes that are free.
    pub free_bytes: u64,
    /// Bytes per second that the disk can take, where it was measured.
    pub bytes_per_second: Option<f64>,
}

/// What is known of the memory.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MemoryFacts {
    /// Bytes that are available.
    pub available_bytes: u64,
    /// Frames that the pool of each camera holds.
    pub pool_frames: u64,
    /// Bytes for the analysis.
    pub analysis_bytes: u64,
}

/// What is known of the analysis.
#[derive(Debug, Clone, PartialEq)]
pub struct AnalysisFacts {
    /// Cumulant order.
    pub order: usize,
    /// Number of species; 0 for no unmixing.
    pub species: usize,
    /// Condition number of the unmixing, where it could be computed.
    pub condition: Option<f64>,
    /// Why species, dichroic or order cannot be used, where they cannot.
    pub error: Option<String>,
    /// Exposures per subsequence.
    pub subsequence_exposures: u64,
}

/// Everything that the checks look at.
#[derive(Debug, Clone, PartialEq)]
pub struct Facts {
    /// One or two cameras.
    pub cameras: Vec<CameraFacts>,
    /// Exposures of all series; `None` when the end is not certain.
    pub exposures: Option<u64>,
    /// Where frames are recorded; `None` for no recording.
    pub disk: Option<DiskFacts>,
    /// Memory.
    pub memory: MemoryFacts,
    /// Analysis; `None` without one.
    pub analysis: Option<AnalysisFacts>,
    /// Laser energy of one series and the limit, millijoules, where both are known.
    pub dose_mj: Option<(f64, f64)>,
}

impl CameraFacts {
    fn frame_bytes(&self) -> u64 {
        self.region.num_pixels() as u64 * 2
    }
}

impl Facts {
    /// Bytes of pixels of the whole plan; `None` when the end is not certain.
    #[must_use]
    pub fn planned_bytes(&self) -> Option<u64> {
        let frame: u64 = self.cameras.iter().map(CameraFacts::frame_bytes).sum();
        self.exposures.map(|exposures| exposures.saturating_mul(frame))
    }

    /// Bytes of pixels per second of all cameras.
    #[must_use]
    pub fn bytes_per_second(&self) -> f64 {
        let rate = |camera: &CameraFacts| camera.frame_bytes() as f64 / camera.period.as_secs_f64().max(1e-9);
        self.cameras.iter().map(rate).sum()
    }
}

/// Looks at everything; the run may begin when [`may_begin`] says so.
#[must_use]
pub fn preflight(facts: &Facts) -> Vec<Check> {
    let mut checks: Vec<Check> = facts.cameras.iter().flat_map(camera_checks).collect();
    checks.extend(pair_checks(&facts.cameras));
    checks.push(disk_space(facts));
    checks.extend(disk_rate(facts));
    checks.push(memory(facts));
    checks.extend(facts.analysis.iter().flat_map(|analysis| analysis_checks(analysis, facts.exposures)));
    checks.extend(facts.dose_mj.map(dose));
    checks
}

/// Whether no check failed.
#[must_use]
pub fn may_begin(checks: &[Check]) -> bool {
    checks.iter().all(|check| check.outcome != Outcome::Fail)
}

fn check(outcome: Outcome, what: &'static str, place: &str, found: String, remedy: &str) -> Check {
    let remedy = if outcome == Outcome::Pass { "" } else { remedy };
    Check { outcome, what, place: place.to_owned(), found, remedy: remedy.to_owned() }
}

fn camera_checks(camera: &CameraFacts) -> Vec<Check> {
    let place = camera.channel.to_string();
    let mut checks = vec![exposure(camera, &place), period(camera, &place), region(camera, &place)];
    checks.extend(camera.brightest_counts.map(|counts| saturation(camera, counts, &place)));
    if camera.simulated {
        let found = "this camera is simulated; what it shows is computed".to_owned();
        checks.push(check(Outcome::Warn, "device", &place, found, "name a camera in the instrument file"));
    }
    checks
}

fn exposure(camera: &CameraFacts, place: &str) -> Check {
    let (exposure, period) = (camera.exposure, camera.period);
    let outcome = match camera.trigger {
        _ if exposure > period => Outcome::Fail,
        // A pulse that comes while the last exposure is not over is lost on many cameras.
        TriggerMode::External if exposure == period && !camera.simulated => Outcome::Warn,
        _ => Outcome::Pass,
    };
    let found = format!("exposure {exposure:?}, period {period:?}");
    check(
        outcome,
        "exposure within the period",
        place,
        found,
        "make the exposure shorter or the period longer",
    )
}

fn period(camera: &CameraFacts, place: &str) -> Check {
    let outcome = if camera.period < camera.shortest_period { Outcome::Fail } else { Outcome::Pass };
    let found = format!("period {:?}, the camera can do {:?}", camera.period, camera.shortest_period);
    check(outcome, "period", place, found, "make the period longer or the region smaller")
}

fn region(camera: &CameraFacts, place: &str) -> Check {
    let region = camera.region;
    let fits = |first: u32, size: u32, all: u32| u64::from(first) + u64::from(size) <= u64::from(all);
    let fits = fits(region.left, region.width, camera.sensor.0)
        && fits(region.top, region.height, camera.sensor.1)
        && region.num_pixels() > 0;
    let outcome = if fits { Outcome::Pass } else { Outcome::Fail };
    let found = format!(
        "{} x {} pixels at ({}, {}) of a sensor of {} x {}",
        region.width, region.height, region.left, region.top, camera.sensor.0, camera.sensor.1
    );
    check(outcome, "region on the sensor", place, found, "choose a region inside the sensor")
}

fn saturation(camera: &CameraFacts, counts: u16, place: &str) -> Check {
    let largest = camera.saturation_counts;
    let outcome = match f64::from(counts) / f64::from(largest.max(1)) {
        share if share >= 1.0 => Outcome::Fail,
        share if share > BRIGHT => Outcome::Warn,
        _ => Outcome::Pass,
    };
    let found = format!("the brightest pixel has {counts} of {largest} counts");
    check(
        outcome,
        "saturation",
        place,
        found,
        "lower the laser power or the exposure; clipped pixels falsify cumulants",
    )
}

fn pair_checks(cameras: &[CameraFacts]) -> Vec<Check> {
    let [r, t] = cameras else {
        return Vec::new();
    };
    let outcome = |is_good: bool| if is_good { Outcome::Pass } else { Outcome::Fail };
    let size = |camera: &CameraFacts| (camera.region.width, camera.region.height);
    let ((rw, rh), (tw, th)) = (size(r), size(t));
    let regions = check(
        outcome((rw, rh) == (tw, th)),
        "regions of equal size",
        "both cameras",
        format!("{rw} x {rh} and {tw} x {th} pixels"),
        "give both cameras regions of equal size",
    );
    let pace = check(
        outcome(r.exposure == t.exposure && r.period == t.period),
        "equal exposures",
        "both cameras",
        format!("{:?} every {:?} and {:?} every {:?}", r.exposure, r.period, t.exposure, t.period),
        "give both cameras the same exposure and period",
    );
    let triggered = [r, t].iter().all(|camera| camera.trigger == TriggerMode::External);
    let together = check(
        outcome(triggered),
        "common trigger",
        "both cameras",
        if triggered { "both wait for the same pulses" } else { "a camera runs by itself" }.to_owned(),
        "trigger both cameras from one source; otherwise frames of equal number are not the same exposure",
    );
    vec![regions, pace, together]
}

fn disk_space(facts: &Facts) -> Check {
    let what = "space on disk";
    let Some(disk) = &facts.disk else {
        let found = "nothing is recorded".to_owned();
        return check(Outcome::Warn, what, "recording", found, "choose a recording to keep the frames");
    };
    let free = disk.free_bytes as f64;
    let Some(planned) = facts.planned_bytes() else {
        let seconds = free / facts.bytes_per_second().max(1.0) / DISK_RESERVE;
        let found = format!("the end is not certain; {} are free, enough for {seconds:.0} s", bytes(free));
        return check(Outcome::Warn, what, &disk.place, found, "add stop.frames or stop.seconds");
    };
    let needed = planned as f64 * DISK_RESERVE;
    let outcome = if needed > free { Outcome::Fail } else { Outcome::Pass };
    let found = format!("{} needed, {} free", bytes(needed), bytes(free));
    check(
        outcome,
        what,
        &disk.place,
        found,
        "free some space, record elsewhere, or take fewer or smaller frames",
    )
}

fn disk_rate(facts: &Facts) -> Option<Check> {
    let disk = facts.disk.as_ref()?;
    let can = disk.bytes_per_second?;
    let needed = facts.bytes_per_second();
    let outcome = match () {
        () if needed > can => Outcome::Fail,
        () if needed * RATE_RESERVE > can => Outcome::Warn,
        () => Outcome::Pass,
    };
    let found = format!("{}/s needed, the disk takes {}/s", bytes(needed), bytes(can));
    Some(check(
        outcome,
        "speed of the disk",
        &disk.place,
        found,
        "record to a faster disk, or take smaller or fewer frames",
    ))
}

fn memory(facts: &Facts) -> Check {
    let frames: u64 = facts.cameras.iter().map(CameraFacts::frame_bytes).sum();
    let needed = frames.saturating_mul(facts.memory.pool_frames).saturating_add(facts.memory.analysis_bytes);
    let available = facts.memory.available_bytes;
    let outcome = match () {
        () if needed > available => Outcome::Fail,
        () if needed as f64 > 0.8 * available as f64 => Outcome::Warn,
        () => Outcome::Pass,
    };
    let found = format!("{} needed, {} available", bytes(needed as f64), bytes(available as f64));
    check(
        outcome,
        "memory",
        "frames and analysis",
        found,
        "close other programs, or choose a smaller region or order",
    )
}

fn analysis_checks(analysis: &AnalysisFacts, exposures: Option<u64>) -> Vec<Check> {
    let mut checks = vec![separable(analysis)];
    if let Some(exposures) = exposures {
        let runs = exposures / analysis.subsequence_exposures.max(1);
        let outcome = if runs >= 2 { Outcome::Pass } else { Outcome::Warn };
        let found = format!("{runs} whole subsequences of {} exposures", analysis.subsequence_exposures);
        let remedy = "make subsequences shorter; noise is estimated from the spread between them";
        checks.push(check(outcome, "subsequences", "analysis", found, remedy));
    }
    checks
}

fn separable(analysis: &AnalysisFacts) -> Check {
    let (what, place) = ("species can be told apart", "analysis");
    if let Some(error) = &analysis.error {
        return check(
            Outcome::Fail,
            what,
            place,
            error.clone(),
            "choose other dyes, another dichroic or order",
        );
    }
    if !(2..=6).contains(&analysis.order) {
        let found = format!("order {} is not available", analysis.order);
        return check(Outcome::Fail, what, place, found, "choose an order from 2 to 6");
    }
    if analysis.species == 0 {
        let found = "no species are named; spectral channels stay as they are".to_owned();
        return check(Outcome::Warn, what, place, found, "name species and dichroic");
    }
    if analysis.species > analysis.order + 1 {
        let found = format!(
            "{} species, order {} tells {} apart",
            analysis.species,
            analysis.order,
            analysis.order + 1
        );
        return check(Outcome::Fail, what, place, found, "raise the order, or name fewer dyes");
    }
    let condition = analysis.condition.unwrap_or(f64::INFINITY);
    let outcome = match condition {
        good if good <= CONDITION_LIMITS.0 => Outcome::Pass,
        noisy if noisy <= CONDITION_LIMITS.1 => Outcome::Warn,
        _ => Outcome::Fail,
    };
    let found =
        format!("{} species at order {}, condition number {condition:.3}", analysis.species, analysis.order);
    check(outcome, what, place, found, "choose dyes that are further apart, or another dichroic")
}

fn dose((planned, limit): (f64, f64)) -> Check {
    let outcome = if planned > limit { Outcome::Warn } else { Outcome::Pass };
    let found = format!("{planned:.1} mJ planned, the limit is {limit:.1} mJ");
    check(outcome, "dose", "sample", found, "the series will end early; lower the power or take fewer frames")
}

fn bytes(number: f64) -> String {
    let units = [(1e12, "TB"), (1e9, "GB"), (1e6, "MB"), (1e3, "kB")];
    let unit = units.into_iter().find(|(size, _)| number >= *size);
    unit.map_or_else(|| format!("{number:.0} B"), |(size, name)| format!("{:.1} {name}", number / size))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera(channel: Channel) -> CameraFacts {
        CameraFacts {
            channel,
            simulated: false,
            region: Region { left: 0, top: 0, width: 512, height: 512 },
            sensor: (2048, 2048),
            exposure: Duration::from_millis(20),
            period: Duration::from_millis(21),
            shortest_period: Duration::from_millis(10),
            trigger: TriggerMode::External,
            saturation_counts: 65_535,
            brightest_counts: Some(9000),
        }
    }

    fn good() -> Facts {
        Facts {
            cameras: Channel::BOTH.map(camera).to_vec(),
            exposures: Some(4000),
            disk: Some(DiskFacts {
                place: "/data".to_owned(),
                free_bytes: 5_000_000_000,
                bytes_per_second: Some(400e6),
            }),
            memory: MemoryFacts { available_bytes: 8 << 30, pool_frames: 256, analysis_bytes: 1 << 30 },
            analysis: Some(AnalysisFacts {
                order: 2,
                species: 3,
                condition: Some(5.0),
                error: None,
                subsequence_exposures: 200,
            }),
            dose_mj: Some((400.0, 1000.0)),
        }
    }

    /// The one check that changes when one fact is bad.
    fn assert_change(what: &str, outcome: Outcome, change: impl FnOnce(&mut Facts)) -> Check {
        let mut facts = good();
        change(&mut facts);
        let checks = preflight(&facts);
        let bad: Vec<&Check> = checks.iter().filter(|check| check.outcome != Outcome::Pass).collect();
        assert!(
            !bad.is_empty() && bad.iter().all(|check| check.what == what && !check.remedy.is_empty()),
            "{bad:?}"
        );
        assert_eq!(bad[0].outcome, outcome, "{bad:?}");
        assert_eq!(may_begin(&checks), outcome == Outcome::Warn);
        bad[0].clone()
    }

    #[test]
    fn a_good_setup_passes_everything() {
        let checks = preflight(&good());
        assert!(
            checks.iter().all(|check| check.outcome == Outcome::Pass && check.remedy.is_empty()),
            "{checks:#?}"
        );
        assert!(checks.len() >= 15);
    }

    #[test]
    fn each_bad_fact_is_found() {
        use Outcome::{Fail, Warn};
        let ms = Duration::from_millis;
        let both =
            |facts: &mut Facts, change: fn(&mut CameraFacts)| facts.cameras.iter_mut().for_each(change);
        assert_change("exposure within the period", Fail, |facts| {
            both(facts, |camera| camera.exposure += Duration::from_millis(2));
        });
        assert_change("exposure within the period", Warn, |facts| {
            both(facts, |camera| camera.exposure = camera.period);
        });
        assert_change("period", Fail, |facts| facts.cameras[1].shortest_period = ms(30));
        assert_change("region on the sensor", Fail, |facts| facts.cameras[0].region.left = 2000);
        assert_change("regions of equal size", Fail, |facts| facts.cameras[0].region.width = 500);
        assert_change("equal exposures", Fail, |facts| facts.cameras[0].exposure = ms(19));
        assert_change("common trigger", Fail, |facts| facts.cameras[0].trigger = TriggerMode::FreeRunning);
        assert_change("saturation", Fail, |facts| facts.cameras[0].brightest_counts = Some(65_535));
        assert_change("saturation", Warn, |facts| facts.cameras[0].brightest_counts = Some(60_000));
        assert_change("device", Warn, |facts| facts.cameras[1].simulated = true);
        assert_change("memory", Fail, |facts| facts.memory.available_bytes = 1 << 30);
        assert_change("memory", Warn, |facts| facts.memory.available_bytes = 1_500 << 20);
        assert_change("dose", Warn, |facts| facts.dose_mj = Some((2000.0, 1000.0)));
        assert_change("subsequences", Warn, |facts| facts.exposures = Some(300));
    }

    #[test]
    fn the_disk_must_hold_the_plan_and_its_pace() {
        use Outcome::{Fail, Warn};
        let with = |facts: &mut Facts, free, rate| {
            facts.disk =
                Some(DiskFacts { place: "/data".to_owned(), free_bytes: free, bytes_per_second: Some(rate) });
        };
        let space = assert_change("space on disk", Fail, |facts| with(facts, 4_200_000_000, 400e6));
        assert_eq!(space.found, "4.4 GB needed, 4.2 GB free");
        assert_change("speed of the disk", Fail, |facts| with(facts, 5_000_000_000, 40e6));
        assert_change("speed of the disk", Warn, |facts| with(facts, 5_000_000_000, 55e6));
        assert_change("space on disk", Warn, |facts| facts.disk = None);
        let open = assert_change("space on disk", Warn, |facts| facts.exposures = None);
        assert!(open.found.contains("enough for 95 s"), "{open}");
    }

    #[test]
    fn species_must_be_separable() {
        use Outcome::{Fail, Warn};
        let what = "species can be told apart";
        let change = |outcome, change: fn(&mut AnalysisFacts)| {
            assert_change(what, outcome, |facts| change(facts.analysis.as_mut().unwrap()));
        };
        change(Fail, |analysis| analysis.species = 4);
        change(Fail, |analysis| analysis.order = 7);
        change(Fail, |analysis| analysis.condition = Some(1e7));
        change(Fail, |analysis| analysis.condition = Some(f64::NAN));
        change(Fail, |analysis| analysis.error = Some("no dichroic is called X".to_owned()));
        change(Warn, |analysis| analysis.condition = Some(1000.0));
        change(Warn, |analysis| analysis.species = 0);
    }
}
