//! A plan as text again.

use serde_json::{Map, Value, json};
use sofiscope_hal::{Nanometers, Region};

use super::{FocusWish, OnRecordDrop, Plan, Readback, RecordingFormat, TRIGGERS, VERSION};

impl Plan {
    /// The plan in YAML; reading it gives the same plan.
    #[must_use]
    pub fn to_yaml(&self) -> String {
        serde_saphyr::to_string(&self.to_json()).expect("a tree of texts and finite numbers can be written")
    }

    /// The plan in JSON; reading it gives the same plan.
    #[must_use]
    pub fn to_json(&self) -> Value {
        let mut metadata = self.metadata.clone();
        metadata.insert("sofiscope".to_owned(), self.sofiscope());
        let positions = self.positions.iter().map(|position| {
            json!({ "name": position.name, "x": position.x_um, "y": position.y_um, "z": position.z_um })
        });
        without_empty(json!({
            "uid": self.uid,
            "axis_order": "ptc",
            "keep_shutter_open_across": ["t"],
            "time_plan": self.loops.map(|loops| json!({ "interval": 0, "loops": loops })),
            "stage_positions": positions.collect::<Vec<_>>(),
            "channels": self.channel.iter().map(|channel| json!(channel)).collect::<Vec<_>>(),
            "metadata": metadata,
        }))
    }

    fn sofiscope(&self) -> Value {
        let cameras = &self.cameras;
        let region = |index: usize| cameras.regions[index].map(region);
        let trigger = TRIGGERS.iter().find(|(_, mode)| Some(*mode) == cameras.trigger);
        json!({
            "version": VERSION,
            "cameras": {
                "exposure_ms": cameras.exposure.as_nanos() as f64 / 1e6,
                "period_ms": cameras.period.as_nanos() as f64 / 1e6,
                "trigger": trigger.map(|(name, _)| name),
                "accept_readback": cameras.readback == Readback::Accept,
                "reflected": { "region": region(0) },
                "transmitted": { "region": region(1) },
            },
            "analysis": self.analysis,
            "laser_power_mw": self.laser_power_mw.iter().map(|(line, power)| (line.to_string(), json!(power)))
                .collect::<Map<_, _>>(),
            "dose_limit_mj": self.stop.dose_mj,
            "stop": {
                "frames": self.stop.frames,
                "seconds": self.stop.time.map(|time| time.as_secs_f64()),
                "snr": self.stop.snr,
                "resolution_nm": self.stop.resolution_nm,
            },
            "on_record_drop": OnRecordDrop::NAMES[self.on_record_drop as usize].0,
            "focus_lock": FocusWish::NAMES[self.focus as usize].0,
            "focus_gate_nm": self.focus_gate.map(Nanometers::value),
            "recording": RecordingFormat::NAMES[self.recording as usize].0,
        })
    }
}

fn region(region: Region) -> Value {
    json!({ "left": region.left, "top": region.top, "width": region.width, "height": region.height })
}

/// The same without keys that have nothing to say.
fn without_empty(value: Value) -> Value {
    let is_empty = |value: &Value| match value {
        Value::Null => true,
        Value::Object(entries) => entries.is_empty(),
        Value::Array(items) => items.is_empty(),
        _ => false,
    };
    match value {
        Value::Object(entries) => {
            let entries = entries.into_iter().map(|(key, value)| (key, without_empty(value)));
            Value::Object(entries.filter(|(_, value)| !is_empty(value)).collect())
        }
        Value::Array(items) => items.into_iter().map(without_empty).collect(),
        other => other,
    }
}
