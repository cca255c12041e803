//! The instrument file as typed: every key may be absent, none is checked.
//!
//! In: a tree of keys. Out: [`RawInstrument`]. Never: judges a value. Fails: faults of kind and unknown keys are noted.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::super::section::{Findings, Section};
use super::super::tree::{Node, Places};
use super::hardware::{RawHardware, RawLaser};

/// The top keys.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub(crate) struct RawTop {
    pub(crate) version: Option<u64>,
    pub(crate) name: Option<String>,
    pub(crate) pixel_pitch_nm: Option<f64>,
    pub(crate) numerical_aperture: Option<f64>,
    pub(crate) dichroic: Option<String>,
    pub(crate) registration_file: Option<String>,
    pub(crate) response_file: Option<String>,
}

/// `[camera.reflected]` and `[camera.transmitted]`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub(crate) struct RawCamera {
    pub(crate) kind: Option<String>,
    pub(crate) serial: Option<String>,
    pub(crate) address: Option<String>,
    pub(crate) library: Option<String>,
    pub(crate) exposure_ms: Option<f64>,
    pub(crate) period_ms: Option<f64>,
    pub(crate) left_px: Option<u32>,
    pub(crate) top_px: Option<u32>,
    pub(crate) width_px: Option<u32>,
    pub(crate) height_px: Option<u32>,
    pub(crate) maps_file: Option<String>,
}

/// `[trigger]`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub(crate) struct RawTrigger {
    pub(crate) kind: Option<String>,
    pub(crate) port: Option<String>,
}

/// `[limits]`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub(crate) struct RawLimits {
    pub(crate) shortest_period_ms: Option<f64>,
    pub(crate) longest_exposure_ms: Option<f64>,
    pub(crate) laser_power_mw: Option<BTreeMap<String, f64>>,
}

/// `[simulation]`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub(crate) struct RawSimulation {
    pub(crate) scene: Option<String>,
    pub(crate) seed: Option<u64>,
    pub(crate) speed: Option<f64>,
    pub(crate) film_frames: Option<u64>,
    pub(crate) fault_scenario: Option<String>,
}

/// The whole file.
#[derive(Debug, Clone, Default)]
pub(crate) struct RawInstrument {
    pub(crate) top: RawTop,
    pub(crate) reflected: Option<RawCamera>,
    pub(crate) transmitted: Option<RawCamera>,
    pub(crate) trigger: Option<RawTrigger>,
    pub(crate) limits: RawLimits,
    pub(crate) hardware: RawHardware,
    pub(crate) simulation: Option<RawSimulation>,
    pub(crate) faults: Option<toml::Table>,
    pub(crate) places: Places,
}

/// Reads the tree; the table `[faults]` belongs to the simulator and is taken as it is.
pub(crate) fn read(node: &Node, faults: Option<toml::Table>, findings: &Findings) -> RawInstrument {
    let root = Section::root(node, findings);
    let top = root.fields();
    let (mut reflected, mut transmitted) = (None, None);
    if let Some(cameras) = root.table("camera") {
        reflected = record(&cameras, "reflected");
        transmitted = record(&cameras, "transmitted");
        cameras.finish();
    }
    let trigger = record(&root, "trigger");
    let limits = record(&root, "limits").unwrap_or_default();
    let hardware = RawHardware {
        gates: record(&root, "gates"),
        lasers: root.items("laser").into_iter().map(|(name, node)| laser(&root, name, node)).collect(),
        stage: record(&root, "stage"),
        focus: record(&root, "focus"),
        virtual_devices: record(&root, "virtual"),
    };
    let simulation = record(&root, "simulation");
    root.node("faults");
    root.finish();
    RawInstrument {
        top,
        reflected,
        transmitted,
        trigger,
        limits,
        hardware,
        simulation,
        faults,
        places: Places::of(node),
    }
}

fn laser(root: &Section<'_>, name: String, node: &Node) -> (String, RawLaser) {
    let table = root.item(name.clone(), node);
    let laser = table.fields();
    table.finish();
    (name, laser)
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
