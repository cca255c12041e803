//! From the plan as typed to one that can be believed.

use std::time::Duration;

use sofiscope_hal::{Nanometers, Region};

use super::raw::{self, RawPlan, RawRegion};
use super::{
    CameraWish, FocusWish, OnRecordDrop, Plan, PlanFaults, Readback, RecordingFormat, StagePosition,
    TRIGGERS, VERSION,
};
use crate::config::{AnalysisSettings, Catalogue, Findings, Judge, Node};
use crate::control::stop_rule::StopRule;

const OURS: &str = "metadata.sofiscope";

pub(super) fn read(text: &str) -> Result<Plan, PlanFaults> {
    let node = Node::from_yaml(text).map_err(|faults| PlanFaults { faults })?;
    let findings = Findings::default();
    let raw = raw::read(&node, &findings);
    let mut faults = findings.into_list();
    let plan = Plan::try_from(raw);
    if let Err(error) = &plan {
        // A key that could not be read is not missing as well.
        let unread: Vec<String> = faults.iter().map(|fault| fault.key.clone()).collect();
        faults.extend(error.faults.iter().filter(|fault| !unread.contains(&fault.key)).cloned());
        faults.sort_by_key(|fault| fault.line.unwrap_or(usize::MAX));
    }
    match plan {
        Ok(plan) if faults.is_empty() => Ok(plan),
        _ => Err(PlanFaults { faults }),
    }
}

impl TryFrom<RawPlan> for Plan {
    type Error = PlanFaults;

    fn try_from(raw: RawPlan) -> Result<Self, PlanFaults> {
        let findings = Findings::default();
        let judge = Judge { findings: &findings, places: &raw.places, assign: ": " };
        let plan = Check { judge, raw: &raw }.plan();
        let faults = findings.into_list();
        if faults.is_empty() { Ok(plan) } else { Err(PlanFaults { faults }) }
    }
}

struct Check<'a> {
    judge: Judge<'a>,
    raw: &'a RawPlan,
}

impl Check<'_> {
    fn choice<T: Copy + Default>(&self, key: &str, name: Option<&str>, known: &[(&str, T)]) -> T {
        name.and_then(|name| self.judge.choice(key, name, known)).unwrap_or_default()
    }

    fn plan(&self) -> Plan {
        let raw = self.raw;
        self.axes();
        self.judge.version(&format!("{OURS}.version"), &raw.run.version.unwrap_or(VERSION), &VERSION);
        let loops = self.loops();
        let stop = self.stop();
        if raw.time.is_none() && !stop.has_end() {
            self.judge.fault(
                "time_plan",
                "the plan has no end",
                format!("add `time_plan: {{interval: 0, loops: 4000}}`, or an end in `{OURS}.stop`"),
            );
        }
        self.analysis();
        let focus = self.focus();
        let key = |name: &str| format!("{OURS}.{name}");
        Plan {
            uid: raw.top.uid.clone(),
            channel: self.channel(),
            positions: self.positions(),
            loops,
            cameras: self.cameras(),
            analysis: raw.analysis.clone(),
            laser_power_mw: self.judge.laser_power(&key("laser_power_mw"), raw.run.laser_power_mw.as_ref()),
            stop,
            on_record_drop: self.choice(
                &key("on_record_drop"),
                raw.run.on_record_drop.as_deref(),
                &OnRecordDrop::NAMES,
            ),
            recording: self.choice(&key("recording"), raw.run.recording.as_deref(), &RecordingFormat::NAMES),
            focus,
            focus_gate: self.focus_gate(focus),
            metadata: raw.metadata.clone(),
        }
    }

    fn focus(&self) -> FocusWish {
        self.choice(&format!("{OURS}.focus_lock"), self.raw.run.focus_lock.as_deref(), &FocusWish::NAMES)
    }

    /// Without a lock no pair would pass.
    fn focus_gate(&self, focus: FocusWish) -> Option<Nanometers> {
        let key = format!("{OURS}.focus_gate_nm");
        let gate_nm = self.raw.run.focus_gate_nm?;
        if focus != FocusWish::Hold {
            let message = "needs the focus lock, and the plan leaves it off";
            self.judge.fault(&key, message, "add `focus_lock: hold`, or remove it");
        }
        Nanometers::new(self.judge.within(&key, gate_nm, 0.1, 10_000.0)).ok()
    }

    /// Positions are outside of time: a series is never torn apart by a move.
    fn axes(&self) {
        if let Some(order) = self.raw.top.axis_order.as_ref().map(raw::RawAxes::word) {
            let unknown = order.chars().find(|axis| !"tpgcz".contains(*axis));
            let is_twice = order.char_indices().any(|(at, axis)| order[..at].contains(axis));
            if let Some(axis) = unknown {
                self.judge.fault("axis_order", format!("has an axis {axis}"), "use t, p, g, c and z");
            } else if is_twice {
                self.judge.fault("axis_order", "has an axis twice", "write every axis once, such as ptc");
            } else if self.raw.positions.len() > 1
                && order.find('t').unwrap_or(usize::MAX) < order.find('p').unwrap_or(usize::MAX)
            {
                let reason = "has time outside of positions, which is not supported yet: \
                              the stage would move between the exposures of a series";
                self.judge.fault("axis_order", reason, "write p before t, such as ptc");
            }
        }
        if let Some(open) = self.raw.top.keep_shutter_open_across.as_ref().map(raw::RawAxes::word)
            && open != "t"
        {
            let reason = if open.contains('t') {
                "is not supported yet with other axes than t: the sample would be lit while nothing is recorded"
            } else {
                "is not supported yet without t: exposures of a series follow each other without a gap"
            };
            self.judge.fault("keep_shutter_open_across", reason, "write [t]");
        }
    }

    fn loops(&self) -> Option<u64> {
        let time = self.raw.time.as_ref()?;
        match time.loops {
            None => self.judge.fault("time_plan.loops", "is missing", "add `loops`, the number of exposures"),
            Some(loops) => {
                self.judge.within("time_plan.loops", loops as f64, 1.0, 1e10);
            }
        }
        time.loops
    }

    fn stop(&self) -> StopRule {
        let (stop, key) = (&self.raw.stop, |name: &str| format!("{OURS}.stop.{name}"));
        let within = |name, value: Option<f64>, from, to| {
            value.map(|value| self.judge.within(&key(name), value, from, to))
        };
        if let Some(frames) = stop.frames {
            self.judge.within(&key("frames"), frames as f64, 1.0, 1e10);
        }
        let seconds = within("seconds", stop.seconds, 0.001, 1e7);
        let dose = self.raw.run.dose_limit_mj;
        StopRule {
            frames: stop.frames,
            time: seconds.and_then(|seconds| Duration::try_from_secs_f64(seconds).ok()),
            snr: within("snr", stop.snr, 0.01, 1e6),
            resolution_nm: within("resolution_nm", stop.resolution_nm, 1.0, 1e5),
            dose_mj: dose.map(|dose| self.judge.within(&format!("{OURS}.dose_limit_mj"), dose, 1e-6, 1e12)),
        }
    }

    fn positions(&self) -> Vec<StagePosition> {
        let positions = self.raw.positions.iter().enumerate().map(|(index, position)| {
            let key = format!("stage_positions[{index}]");
            let place = [position.x, position.y, position.z];
            if place.iter().all(Option::is_none) {
                self.judge.fault(&key, "names no place", "give x and y in micrometers");
            } else if position.x.is_some() != position.y.is_some() {
                self.judge.fault(&key, "has only one of x and y", "give both in micrometers, or none");
            }
            for (axis, value) in ["x", "y", "z"].into_iter().zip(place) {
                value.map(|value| self.judge.within(&format!("{key}.{axis}"), value, -1e6, 1e6));
            }
            StagePosition { name: position.name.clone(), x_um: place[0], y_um: place[1], z_um: place[2] }
        });
        positions.collect()
    }

    fn channel(&self) -> Option<raw::RawChannel> {
        if self.raw.channels.len() > 1 {
            self.judge.fault(
                "channels[1]",
                "is not supported yet: all dyes are seen in every exposure, so there is one channel",
                "keep one channel, and name the dyes in `metadata.sofiscope.analysis.species`",
            );
        }
        self.raw.channels.first().cloned()
    }

    fn exposure(&self) -> Duration {
        let key = format!("{OURS}.cameras.exposure_ms");
        let of_channel = self.raw.channels.first().and_then(|channel| channel.exposure);
        match (self.raw.cameras.exposure_ms, of_channel) {
            (None, None) => {
                self.judge.fault(&key, "is missing", "add `exposure_ms: 20.0`");
                Duration::ZERO
            }
            (Some(given), Some(other)) if given != other => {
                self.judge.fault(
                    "channels[0].exposure",
                    format!("is {other} ms, and `{key}` is {given} ms"),
                    "keep one of them",
                );
                Duration::ZERO
            }
            (Some(given), _) => self.judge.milliseconds(&key, given),
            (None, Some(given)) => self.judge.milliseconds("channels[0].exposure", given),
        }
    }

    fn period(&self, exposure: Duration) -> Duration {
        let key = format!("{OURS}.cameras.period_ms");
        let interval = self.raw.time.as_ref().and_then(|time| time.interval.as_ref());
        let interval_ms = interval.map(raw::RawInterval::seconds).filter(|&seconds| seconds != 0.0);
        let interval =
            interval_ms.map(|seconds| self.judge.milliseconds("time_plan.interval", seconds * 1000.0));
        let given = self.raw.cameras.period_ms.map(|period| self.judge.milliseconds(&key, period));
        let period = match (given, interval) {
            (Some(given), Some(interval)) if given != interval => {
                self.judge.fault(
                    "time_plan.interval",
                    format!("is {interval:?}, and `{key}` is {given:?}"),
                    "write `interval: 0`, or leave period_ms out",
                );
                return given;
            }
            (Some(period), _) | (None, Some(period)) => period,
            (None, None) => {
                self.judge.fault(&key, "is missing", "add `period_ms`, the time from exposure to exposure");
                return exposure;
            }
        };
        if period < exposure {
            let key = if given.is_some() { key.as_str() } else { "time_plan.interval" };
            self.judge.fault(
                key,
                format!("is {period:?}, shorter than the exposure of {exposure:?}"),
                "make it longer, or the exposure shorter",
            );
        }
        period
    }

    fn cameras(&self) -> CameraWish {
        let cameras = &self.raw.cameras;
        let exposure = self.exposure();
        let key = |name: &str| format!("{OURS}.cameras.{name}");
        let regions = &self.raw.regions;
        if self.raw.setup_region.is_some() && regions.region.is_some() {
            self.judge.fault("setup.roi", "is given beside the region of the cameras", "keep one of them");
        }
        let setup = self.region("setup.roi", self.raw.setup_region.as_ref());
        let common = self.region(&key("region"), regions.region.as_ref()).or(setup);
        let reflected = self.region(&key("reflected.region"), regions.reflected.as_ref()).or(common);
        let transmitted = self.region(&key("transmitted.region"), regions.transmitted.as_ref()).or(common);
        if let (Some(r), Some(t)) = (reflected, transmitted)
            && (r.width, r.height) != (t.width, t.height)
        {
            self.judge.fault(
                &key("transmitted.region"),
                format!(
                    "has {} x {} pixels, and that of camera R {} x {}",
                    t.width, t.height, r.width, r.height
                ),
                "give both cameras regions of equal size",
            );
        }
        let trigger = cameras.trigger.as_deref();
        CameraWish {
            exposure,
            period: self.period(exposure),
            regions: [reflected, transmitted],
            trigger: trigger.and_then(|name| self.judge.choice(&key("trigger"), name, &TRIGGERS)),
            readback: match cameras.accept_readback {
                Some(true) => Readback::Accept,
                _ => Readback::Refuse,
            },
        }
    }

    fn region(&self, key: &str, region: Option<&RawRegion>) -> Option<Region> {
        let region = region?;
        let size = |name: &str, value| self.judge.pixels(&format!("{key}.{name}"), value);
        Some(Region {
            left: region.left.unwrap_or(0),
            top: region.top.unwrap_or(0),
            width: size("width", region.width),
            height: size("height", region.height),
        })
    }

    fn analysis(&self) {
        let (analysis, section) = (&self.raw.analysis, format!("{OURS}.analysis"));
        if let Err(error) = AnalysisSettings::try_from(analysis.clone()) {
            for sentence in error.faults {
                let (message, remedy) = sentence.split_once("; ").unwrap_or((&sentence, "change it"));
                self.judge.fault(&section, message, remedy);
            }
        }
        let catalogue = Catalogue::built_in();
        let species = analysis.species.as_deref().unwrap_or_default();
        // A file of measured shares, which may hold dichroics of its own, is read when the run begins.
        let dichroic = analysis.dichroic.as_deref().filter(|_| analysis.response_file.is_none());
        let names = match dichroic {
            Some(dichroic) if !species.is_empty() => catalogue.species(species, dichroic).map(|_| ()),
            Some(dichroic) => catalogue.dichroic(dichroic).map(|_| ()),
            None => species.iter().try_for_each(|name| catalogue.fluorophore(name).map(|_| ())),
        };
        if let Err(error) = names {
            let key = if species.is_empty() { "dichroic" } else { "species" };
            let remedy = "name dyes and dichroics of config/fluorophores.toml and config/dichroics.toml";
            self.judge.fault(&format!("{section}.{key}"), error.to_string(), remedy);
        }
        let order = analysis.order.unwrap_or(2);
        if species.len() > order + 1 {
            self.judge.fault(
                &format!("{section}.species"),
                format!("are {}, and order {order} tells {} apart", species.len(), order + 1),
                "raise the order, or name fewer dyes",
            );
        }
        if let (Some(frames), Some(length)) =
            (self.raw.time.as_ref().and_then(|time| time.loops), analysis.subsequence_exposures)
            && length > frames
        {
            self.judge.fault(
                &format!("{section}.subsequence_exposures"),
                format!("is {length}, more than the {frames} exposures of the series"),
                "make it shorter, in practice 100 to 500",
            );
        }
    }
}
