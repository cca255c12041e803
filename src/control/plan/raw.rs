//! The plan as typed, in the shape of useq-schema's `MDASequence`: every key may be absent, none is checked.
//!
//! In: a tree of keys. Out: [`RawPlan`]. Never: judges a value.
//! Fails: values of a wrong kind, unknown keys and fields of useq that are not supported are noted, each by name.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use crate::config::{Content, Findings, Node, Places, RawAnalysis, Section};

/// The top keys that are values of their own.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct RawTop {
    /// Identifier that other programs gave the plan.
    pub uid: Option<String>,
    /// Order of the axes, outermost first, such as `ptc`.
    pub axis_order: Option<RawAxes>,
    /// Axes along which the light stays on.
    pub keep_shutter_open_across: Option<RawAxes>,
}

/// Axes as one word or as a list.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged, expecting = "expected axes such as \"ptc\" or [p, t, c]")]
pub enum RawAxes {
    /// As one word.
    Word(String),
    /// As a list of letters.
    Letters(Vec<String>),
}

impl RawAxes {
    /// The axes as one word.
    #[must_use]
    pub fn word(&self) -> String {
        match self {
            Self::Word(word) => word.clone(),
            Self::Letters(letters) => letters.concat(),
        }
    }
}

/// Time between exposures.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged, expecting = "expected seconds as a number, or a table such as {milliseconds: 20}")]
pub enum RawInterval {
    /// Seconds.
    Seconds(f64),
    /// Parts that add up.
    Parts(RawParts),
}

/// Parts of an interval.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RawParts {
    /// Minutes.
    pub minutes: f64,
    /// Seconds.
    pub seconds: f64,
    /// Milliseconds.
    pub milliseconds: f64,
    /// Microseconds.
    pub microseconds: f64,
}

impl RawInterval {
    /// In seconds.
    #[must_use]
    pub fn seconds(&self) -> f64 {
        match self {
            Self::Seconds(seconds) => *seconds,
            Self::Parts(parts) => {
                parts.minutes * 60.0 + parts.seconds + parts.milliseconds * 1e-3 + parts.microseconds * 1e-6
            }
        }
    }
}

/// `time_plan`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct RawTime {
    /// Time from exposure to exposure; 0 for the period of the cameras.
    pub interval: Option<RawInterval>,
    /// Exposures.
    pub loops: Option<u64>,
}

/// One of `stage_positions`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct RawPosition {
    /// Name in results.
    pub name: Option<String>,
    /// Micrometers.
    pub x: Option<f64>,
    /// Micrometers.
    pub y: Option<f64>,
    /// Micrometers.
    pub z: Option<f64>,
}

/// One of `channels`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct RawChannel {
    /// Name of the preset.
    pub config: Option<String>,
    /// Group of the preset.
    pub group: Option<String>,
    /// Milliseconds.
    pub exposure: Option<f64>,
}

/// A region of a sensor, pixels.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct RawRegion {
    /// First column.
    pub left: Option<u32>,
    /// First row.
    pub top: Option<u32>,
    /// Columns.
    pub width: Option<u32>,
    /// Rows.
    pub height: Option<u32>,
}

/// Values of `metadata.sofiscope.cameras` that hold for both cameras.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct RawCameras {
    /// Time of one exposure, milliseconds.
    pub exposure_ms: Option<f64>,
    /// Time from exposure to exposure, milliseconds.
    pub period_ms: Option<f64>,
    /// `external` or `free-running`.
    pub trigger: Option<String>,
    /// Whether a run begins although a camera does something else than it was asked.
    pub accept_readback: Option<bool>,
}

/// Where regions can stand in `metadata.sofiscope.cameras`.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct RawRegions {
    /// For both cameras.
    pub region: Option<RawRegion>,
    /// For camera R, in place of the common one.
    pub reflected: Option<RawRegion>,
    /// For camera T, in place of the common one.
    pub transmitted: Option<RawRegion>,
}

/// `metadata.sofiscope.stop`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct RawStop {
    /// Exposures.
    pub frames: Option<u64>,
    /// Seconds of acquisition.
    pub seconds: Option<f64>,
    /// Signal-to-noise that every species must reach.
    pub snr: Option<f64>,
    /// Resolution that must be reached, nanometers.
    pub resolution_nm: Option<f64>,
}

/// Values of `metadata.sofiscope` itself.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct RawRun {
    /// Version of these additions.
    pub version: Option<u64>,
    /// Power of each laser line, milliwatts by nanometers.
    pub laser_power_mw: Option<BTreeMap<String, f64>>,
    /// Laser energy after which bleaching is no longer worth it, millijoules of all lines together.
    pub dose_limit_mj: Option<f64>,
    /// `stop` or `continue`.
    pub on_record_drop: Option<String>,
    /// `ome-tiff`, `ome-zarr` or `none`.
    pub recording: Option<String>,
    /// `none` or `hold`.
    pub focus_lock: Option<String>,
    /// Focus error above which pairs are recorded and not analyzed, nanometers.
    pub focus_gate_nm: Option<f64>,
}

/// A plan as typed.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct RawPlan {
    /// Top keys.
    pub top: RawTop,
    /// `time_plan`.
    pub time: Option<RawTime>,
    /// `stage_positions`.
    pub positions: Vec<RawPosition>,
    /// `channels`.
    pub channels: Vec<RawChannel>,
    /// `setup.roi`.
    pub setup_region: Option<RawRegion>,
    /// `metadata.sofiscope`.
    pub run: RawRun,
    /// `metadata.sofiscope.cameras`.
    pub cameras: RawCameras,
    /// Regions in `metadata.sofiscope.cameras`.
    pub regions: RawRegions,
    /// `metadata.sofiscope.analysis`, with the keys of a settings file of `analyze`.
    pub analysis: RawAnalysis,
    /// `metadata.sofiscope.stop`.
    pub stop: RawStop,
    /// Other metadata, kept as it is.
    pub metadata: Map<String, Value>,
    /// Lines of the keys; empty for plans that were not read from a text.
    pub(crate) places: Places,
}

const NOT_SUPPORTED: [(&str, &str); 5] = [
    ("z_plan", "the focus stays where it is during a series"),
    ("grid_plan", "write the places as stage_positions"),
    ("autofocus_plan", "write `focus_lock: hold` in metadata.sofiscope instead"),
    ("tiles", "write the places as stage_positions"),
    ("replicates", "write the repetitions as stage_positions"),
];

const CHANNEL_NOT_SUPPORTED: [(&str, &str); 4] = [
    ("z_offset", "the focus stays where it is during a series"),
    ("do_stack", "there are no z stacks"),
    ("acquire_every", "every exposure lights all dyes"),
    ("camera", "both cameras take every exposure"),
];

const TIME_NOT_SUPPORTED: [(&str, &str); 4] = [
    ("duration", "write interval and loops"),
    ("phases", "write one interval and one number of loops"),
    ("prioritize_duration", "exposures follow the trigger"),
    ("intervals", "write one interval"),
];

/// Reads the tree of a plan.
pub(super) fn read(node: &Node, findings: &Findings) -> RawPlan {
    let root = Section::root(node, findings);
    let mut raw = RawPlan { top: root.fields(), places: Places::of(node), ..RawPlan::default() };
    refuse_all(&root, &NOT_SUPPORTED);
    raw.time = root.table("time_plan").map(|time| {
        let read = time.fields();
        refuse_all(&time, &TIME_NOT_SUPPORTED);
        time.finish();
        read
    });
    raw.positions = root.items("stage_positions").into_iter().map(|item| position(&root, item)).collect();
    raw.channels = root.items("channels").into_iter().map(|item| channel(&root, item)).collect();
    if let Some(setup) = root.table("setup") {
        raw.setup_region = record(&setup, "roi");
        setup.refuse("properties", "device properties are set by the instrument file");
        setup.finish();
    }
    if let Some(metadata) = root.table("metadata") {
        if let Some(section) = metadata.table("sofiscope") {
            sofiscope(&section, &mut raw);
        }
        raw.metadata = metadata.others();
    }
    root.finish();
    raw
}

fn sofiscope(section: &Section<'_>, raw: &mut RawPlan) {
    raw.run = section.fields();
    if let Some(cameras) = section.table("cameras") {
        raw.cameras = cameras.fields();
        raw.regions.region = record(&cameras, "region");
        let side = |key| {
            let side = cameras.table(key)?;
            let region = record(&side, "region");
            side.finish();
            region
        };
        raw.regions.reflected = side("reflected");
        raw.regions.transmitted = side("transmitted");
        cameras.finish();
    }
    raw.analysis = record(section, "analysis").unwrap_or_default();
    raw.stop = record(section, "stop").unwrap_or_default();
    section.finish();
}

fn refuse_all(section: &Section<'_>, keys: &[(&str, &str)]) {
    for (key, reason) in keys {
        section.refuse(key, reason);
    }
}

fn record<T: Default + Serialize + serde::de::DeserializeOwned>(
    section: &Section<'_>,
    key: &str,
) -> Option<T> {
    let table = section.table(key)?;
    let record = table.fields();
    table.finish();
    Some(record)
}

/// A position as a table, or as the list `[x, y, z]`.
fn position(root: &Section<'_>, (name, node): (String, &Node)) -> RawPosition {
    if let Content::List(items) = &node.content {
        let numbers: Vec<Option<f64>> = items.iter().map(|item| item.to_json().as_f64()).collect();
        return match numbers.as_slice() {
            [x, y] => RawPosition { x: *x, y: *y, ..RawPosition::default() },
            [x, y, z] => RawPosition { x: *x, y: *y, z: *z, name: None },
            _ => RawPosition::default(),
        };
    }
    let table = root.item(name, node);
    let position = table.fields();
    table.refuse("sequence", "every position has the same series");
    refuse_all(&table, &[("row", "positions are not on a grid"), ("col", "positions are not on a grid")]);
    table.finish();
    position
}

/// A channel as a table, or as its name alone.
fn channel(root: &Section<'_>, (name, node): (String, &Node)) -> RawChannel {
    if let Content::Single(Value::String(config)) = &node.content {
        return RawChannel { config: Some(config.clone()), ..RawChannel::default() };
    }
    let table = root.item(name, node);
    let channel = table.fields();
    refuse_all(&table, &CHANNEL_NOT_SUPPORTED);
    table.finish();
    channel
}
