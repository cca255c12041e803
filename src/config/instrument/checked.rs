//! From the instrument file as typed to one that can be believed.

use sofiscope_hal::{Channel, Region};

use super::hardware::HardwareCheck;
use super::raw::{self, RawCamera, RawInstrument, RawSimulation};
use super::{
    CameraEntry, CameraKind, Instrument, InstrumentFaults, Limits, Simulation, TriggerKind, VERSION,
};
use crate::config::dyes::Catalogue;
use crate::config::judge::Judge;
use crate::config::section::Findings;
use crate::config::tree::Node;

pub(super) fn read(text: &str) -> Result<Instrument, InstrumentFaults> {
    let node = Node::from_toml(text).map_err(|faults| InstrumentFaults { faults })?;
    let findings = Findings::default();
    let document: toml::Table = toml::from_str(text).unwrap_or_default();
    let faults = document.get("faults").and_then(toml::Value::as_table).cloned();
    let raw = raw::read(&node, faults, &findings);
    let check = Check { judge: Judge { findings: &findings, places: &raw.places, assign: " = " } };
    let instrument = check.instrument(&raw);
    let mut faults = findings.into_list();
    // A key that could not be read is not missing as well.
    let mut seen = Vec::new();
    faults.retain(|fault| {
        let is_new = fault.key.is_empty() || !seen.contains(&fault.key);
        seen.push(fault.key.clone());
        is_new
    });
    if faults.is_empty() { Ok(instrument) } else { Err(InstrumentFaults { faults }) }
}

struct Check<'a> {
    judge: Judge<'a>,
}

impl Check<'_> {
    fn instrument(&self, raw: &RawInstrument) -> Instrument {
        if let Some(version) = self.judge.required("version", raw.top.version, "1") {
            self.judge.version("version", &version, &VERSION);
        }
        let name = self.judge.required("name", raw.top.name.clone(), "\"...\"").unwrap_or_default();
        let pitch = self.judge.required("pixel_pitch_nm", raw.top.pixel_pitch_nm, "108.0").unwrap_or(108.0);
        let aperture = raw.top.numerical_aperture;
        // A file of measured shares may hold dichroics of its own.
        if let Some(dichroic) = &raw.top.dichroic
            && raw.top.response_file.is_none()
            && let Err(error) = Catalogue::built_in().dichroic(dichroic)
        {
            self.judge.fault(
                "dichroic",
                error.to_string(),
                "give the name of a dichroic of config/dichroics.toml",
            );
        }
        let cameras = self.cameras(raw);
        let trigger = self.trigger(raw);
        let limits = self.limits(raw);
        let check = HardwareCheck { judge: self.judge, limits: &limits };
        let mut hardware = check.hardware(&raw.hardware);
        if trigger == TriggerKind::TeensyPulse {
            let port = raw.trigger.as_ref().and_then(|trigger| trigger.port.as_deref());
            hardware.clock = check.port("trigger", port, None);
        }
        if trigger == TriggerKind::Gates && raw.hardware.gates.is_none() {
            self.judge.fault("trigger.kind", "is gates, and there are none", "add `[gates]`");
        }
        let simulation = self.simulation(raw, &cameras, trigger);
        Instrument {
            name,
            cameras,
            trigger,
            pixel_pitch_nm: self.judge.within("pixel_pitch_nm", pitch, 1.0, 100_000.0),
            numerical_aperture: aperture
                .map(|value| self.judge.within("numerical_aperture", value, 0.01, 2.0)),
            dichroic: raw.top.dichroic.clone(),
            registration_file: raw.top.registration_file.clone(),
            response_file: raw.top.response_file.clone(),
            limits,
            hardware,
            simulation,
        }
    }

    fn cameras(&self, raw: &RawInstrument) -> Vec<CameraEntry> {
        let sides = [
            (Channel::Reflected, "camera.reflected", &raw.reflected),
            (Channel::Transmitted, "camera.transmitted", &raw.transmitted),
        ];
        let cameras: Vec<CameraEntry> = sides
            .into_iter()
            .filter_map(|(channel, key, camera)| Some(self.camera(channel, key, camera.as_ref()?)))
            .collect();
        match cameras.as_slice() {
            [] => self.judge.fault("camera", "no camera is there", "add `[camera.reflected]`"),
            [r, t] if r.serial.is_some() && r.serial == t.serial => self.judge.fault(
                "camera.transmitted.serial",
                "is the serial of both cameras",
                "give each camera its own serial number",
            ),
            _ => {}
        }
        cameras
    }

    fn camera(&self, channel: Channel, key: &str, raw: &RawCamera) -> CameraEntry {
        let name = |field: &str| format!("{key}.{field}");
        let kind = self
            .judge
            .required(&name("kind"), raw.kind.as_deref(), "\"simulated\"")
            .and_then(|kind| self.judge.choice(&name("kind"), kind, &CameraKind::NAMES))
            .unwrap_or(CameraKind::Simulated);
        if kind != CameraKind::Simulated {
            self.judge.required(&name("serial"), raw.serial.as_ref(), "\"...\", as printed on the camera");
        }
        let exposure = self.judge.required(&name("exposure_ms"), raw.exposure_ms, "20.0").unwrap_or(20.0);
        let exposure = self.judge.milliseconds(&name("exposure_ms"), exposure);
        let period = raw.period_ms.map(|period| self.judge.milliseconds(&name("period_ms"), period));
        let period = period.unwrap_or(exposure);
        if period < exposure {
            self.judge.fault(
                &name("period_ms"),
                "is shorter than the exposure",
                format!("give at least {} ms", exposure.as_secs_f64() * 1000.0),
            );
        }
        let region = self.region(key, raw);
        let maps_file = raw.maps_file.clone();
        CameraEntry {
            channel,
            kind,
            serial: raw.serial.clone(),
            address: raw.address.clone(),
            library: raw.library.clone(),
            exposure,
            period,
            region,
            maps_file,
        }
    }

    fn region(&self, key: &str, raw: &RawCamera) -> Option<Region> {
        if raw.width_px.is_none() && raw.height_px.is_none() && raw.left_px.is_none() && raw.top_px.is_none()
        {
            return None;
        }
        let size = |field: &str, value| self.judge.pixels(&format!("{key}.{field}"), value);
        Some(Region {
            left: raw.left_px.unwrap_or(0),
            top: raw.top_px.unwrap_or(0),
            width: size("width_px", raw.width_px),
            height: size("height_px", raw.height_px),
        })
    }

    fn trigger(&self, raw: &RawInstrument) -> TriggerKind {
        let kind = raw.trigger.as_ref().and_then(|trigger| trigger.kind.as_deref());
        self.judge
            .required("trigger.kind", kind, "\"simulated\"")
            .and_then(|kind| self.judge.choice("trigger.kind", kind, &TriggerKind::NAMES))
            .unwrap_or(TriggerKind::FreeRunning)
    }

    fn limits(&self, raw: &RawInstrument) -> Limits {
        let limits = &raw.limits;
        let time = |key: &str, value: Option<f64>| value.map(|value| self.judge.milliseconds(key, value));
        let laser_power_mw = self.judge.laser_power("limits.laser_power_mw", limits.laser_power_mw.as_ref());
        Limits {
            shortest_period: time("limits.shortest_period_ms", limits.shortest_period_ms),
            longest_exposure: time("limits.longest_exposure_ms", limits.longest_exposure_ms),
            laser_power_mw,
        }
    }

    fn simulation(
        &self,
        raw: &RawInstrument,
        cameras: &[CameraEntry],
        trigger: TriggerKind,
    ) -> Option<Simulation> {
        let is_simulated = cameras.iter().any(|camera| camera.kind == CameraKind::Simulated);
        if cameras.iter().any(|camera| camera.kind != CameraKind::Simulated)
            && trigger == TriggerKind::Simulated
        {
            self.judge.fault(
                "trigger.kind",
                "is simulated, but a camera is not",
                "name the trigger that is connected",
            );
        }
        match &raw.simulation {
            None if is_simulated => {
                self.judge.fault(
                    "simulation",
                    "is missing",
                    "add `[simulation]` with `scene = \"figure-s4\"`",
                );
                None
            }
            Some(_) if !is_simulated && !cameras.is_empty() => {
                self.judge.fault("simulation", "is there, but no camera is simulated", "remove it");
                None
            }
            None => {
                if raw.faults.is_some() {
                    self.judge.fault("faults", "is there, but no camera is simulated", "remove it");
                }
                None
            }
            Some(simulation) => Some(self.simulated(simulation, raw.faults.clone())),
        }
    }

    fn simulated(&self, raw: &RawSimulation, faults: Option<toml::Table>) -> Simulation {
        let scene = self.judge.required("simulation.scene", raw.scene.clone(), "\"figure-s4\"");
        if let Some(film) = raw.film_frames {
            self.judge.within("simulation.film_frames", film as f64, 2.0, 1e7);
        }
        if raw.fault_scenario.is_some() && faults.is_some() {
            self.judge.fault(
                "simulation.fault_scenario",
                "names a file, and `[faults]` is here too",
                "keep one of them",
            );
        }
        Simulation {
            scene: scene.unwrap_or_default(),
            seed: raw.seed,
            speed: self.judge.within("simulation.speed", raw.speed.unwrap_or(1.0), 0.0, 1000.0),
            film_frames: raw.film_frames,
            fault_scenario: raw.fault_scenario.clone(),
            faults,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn faults(text: &str) -> Vec<String> {
        let error = Instrument::from_toml(text).unwrap_err();
        error.faults.iter().map(ToString::to_string).collect()
    }

    #[test]
    fn the_shipped_instrument_is_simulated_and_says_so() {
        let instrument = Instrument::from_toml(Instrument::simulated_toml()).unwrap();
        assert_eq!(instrument.cameras().len(), 2);
        assert!(instrument.cameras().iter().all(|camera| camera.kind == CameraKind::Simulated));
        assert_eq!(instrument.simulation().unwrap().scene, "figure-s4");
        assert_eq!(instrument.camera(Channel::Transmitted).unwrap().channel, Channel::Transmitted);
    }

    #[test]
    fn all_faults_come_at_once_with_their_lines() {
        let text = "version = 2\npixel_pitch_nm = -1\nnam = \"x\"\n[camera.reflected]\nkind = \"simulatd\"\nexposure = 20\n\
                    [trigger]\nkind = 3\n[limits]\nlaser_power_mw = { green = 5.0 }\n[simulation]\nscene = \"a\"\nspeed = nan\n";
        let found = faults(text);
        let lines: Vec<&str> = found.iter().map(|fault| fault.split(':').next().unwrap()).collect();
        for line in ["line 1", "line 2", "line 3", "line 5", "line 6", "line 8", "line 10", "line 13"] {
            assert!(lines.contains(&line), "{line}: {found:#?}");
        }
        assert!(found.iter().any(|fault| fault.contains("write `name`")), "{found:#?}");
        assert!(found.iter().any(|fault| fault.contains("write `simulated`")), "{found:#?}");
        assert!(found.iter().any(|fault| fault.contains("write `exposure_ms`")), "{found:#?}");
    }

    #[test]
    fn simulated_devices_are_only_where_the_file_says_so() {
        let real = "version = 1\nname = \"rig\"\npixel_pitch_nm = 108\n[trigger]\nkind = \"free-running\"\n\
                    [camera.reflected]\nkind = \"genicam\"\nserial = \"7\"\nexposure_ms = 20\n";
        assert!(Instrument::from_toml(real).unwrap().simulation().is_none());
        let mixed = format!("{real}[simulation]\nscene = \"beads\"\n");
        assert!(faults(&mixed)[0].contains("no camera is simulated"));
        let triggered = real.replace("free-running", "simulated");
        assert!(faults(&triggered)[0].contains("name the trigger"));
        let nameless = real.replace("serial = \"7\"\n", "");
        assert!(faults(&nameless)[0].contains("`camera.reflected.serial` is missing"));
        let simulated = real.replace("genicam", "simulated");
        assert!(faults(&simulated)[0].contains("`simulation` is missing"));
    }

    #[test]
    fn the_shipped_virtual_instrument_has_every_device_of_the_paper() {
        let instrument = Instrument::from_toml(Instrument::virtual_toml()).unwrap();
        let hardware = instrument.hardware();
        let lines: Vec<u32> = hardware.lasers.iter().map(|laser| laser.wavelength_nm).collect();
        assert_eq!(lines, [405, 488, 561, 635]);
        assert!(hardware.gates.is_some() && hardware.stage.is_some() && hardware.focus.is_some());
        assert!(hardware.virtual_devices.is_some());
        assert!(instrument.cameras().iter().all(|camera| camera.kind != CameraKind::Simulated));
    }

    #[test]
    fn what_could_hurt_has_no_default() {
        let text = Instrument::virtual_toml();
        for (from, to, expected) in [
            ("x_um = [0.0, 120000.0]\n", "", "`stage.x_um` is missing"),
            ("488 = 50.0, ", "", "488 nm has no cap"),
            ("gate = 1", "gate = 0", "gate of another laser"),
            ("wavelength_nm = 561", "wavelength_nm = 488", "wavelength of another laser"),
            ("[[0.0, 0.0], [5.0, 100.0]]", "[[0.0, 0.0], [5.0, -1.0]]", "no rising curve"),
            ("z_um = [0.0, 300.0]", "z_um = [300.0, 0.0]", "the smaller first"),
        ] {
            assert!(text.contains(from), "{from}");
            let found = faults(&text.replacen(from, to, 1));
            assert!(found.iter().any(|fault| fault.contains(expected)), "{expected}: {found:#?}");
        }
    }

    #[test]
    fn keys_of_the_faults_are_the_simulators() {
        let text = format!("{}\n[faults]\nanything = [1, 2]\n", Instrument::simulated_toml());
        let instrument = Instrument::from_toml(&text).unwrap();
        let faults = instrument.simulation().unwrap().faults.clone().unwrap();
        assert_eq!(faults["anything"].as_array().unwrap().len(), 2);
    }

    #[test]
    fn two_cameras_have_two_serials() {
        let text = Instrument::simulated_toml().replace("SIM-T", "SIM-R");
        assert!(faults(&text)[0].contains("both cameras"));
    }

    #[test]
    fn nothing_that_can_be_typed_panics() {
        for text in
            ["", "version", "camera = 3", "camera.reflected = []", "[[camera]]", "faults = 1\nversion = 1"]
        {
            assert!(!faults(text).is_empty());
        }
    }
}
