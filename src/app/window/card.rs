//! What the window tells of an open instrument.
//!
//! In: the instrument's file and its open devices. Out: [`InstrumentCard`], laser lines.
//! Never: asks a device anything. Fails: not at all.

use crate::app::instrument::{About, Label};
use crate::config::{Catalogue, Instrument};
use crate::guard::message::LightsState;
use crate::viewer::bench::{DeviceCard, InstrumentCard, LaserStatus, PropertyRow};
use sofiscope_hal::laser::{Emission, Interlock};
use sofiscope_hal::{Channel, Property, PropertyRange, PropertyValue};
use std::collections::BTreeMap;
use std::time::Duration;

/// Plans that come with the program.
const PLANS: [(&str, &str); 3] = [
    ("quick look", include_str!("../../../config/plans/quick-look.yaml")),
    ("paper, three colors", include_str!("../../../config/plans/paper-three-color.yaml")),
    ("two places, lasers and focus lock", include_str!("../../../config/plans/three-color.yaml")),
];

/// What is known of every camera when it is opened.
pub(super) const KNOWN_OF_CAMERAS: [&str; 5] =
    ["firmware", "sensor width", "sensor height", "shortest period", "saturation"];

/// Longest exposure where the instrument sets no limit.
const LONGEST_EXPOSURE: Duration = Duration::from_secs(10);

/// The card of an instrument.
pub(super) fn card(instrument: &Instrument, open: &About) -> InstrumentCard {
    let catalogue = Catalogue::built_in();
    let limits = instrument.limits();
    let cameras = Channel::BOTH.into_iter().map(|channel| {
        let camera = &open.facts.identities[channel.index()];
        let (width, height) = open.facts.sensors[channel.index()];
        let reading = |name: &str, value: String, unit: &str| PropertyRow {
            name: name.to_owned(),
            value,
            unit: unit.to_owned(),
            ..PropertyRow::default()
        };
        let shortest = open.facts.shortest_periods[channel.index()].as_secs_f64() * 1e3;
        DeviceCard {
            role: channel.to_string(),
            identity: format!("{} {}, S/N {}", camera.vendor, camera.model, camera.serial),
            is_simulated: camera.simulated,
            properties: vec![
                reading(KNOWN_OF_CAMERAS[0], camera.firmware.clone(), ""),
                reading(KNOWN_OF_CAMERAS[1], width.to_string(), "px"),
                reading(KNOWN_OF_CAMERAS[2], height.to_string(), "px"),
                reading(KNOWN_OF_CAMERAS[3], format!("{shortest:.3}"), "ms"),
                reading(
                    KNOWN_OF_CAMERAS[4],
                    open.facts.saturation_counts[channel.index()].to_string(),
                    "counts",
                ),
            ],
        }
    });
    let stage = open.stage.iter().map(|stage| DeviceCard {
        role: "stage".to_owned(),
        identity: stage.identity().to_string(),
        is_simulated: stage.identity().simulated,
        properties: stage.properties().iter().map(row).collect(),
    });
    let others = open.identities.iter().map(|identity| DeviceCard {
        role: "answered".to_owned(),
        identity: identity.clone(),
        is_simulated: open.label != Label::Real,
        properties: Vec::new(),
    });
    let cameras: Vec<DeviceCard> = cameras.collect();
    let known = |one: &DeviceCard| cameras.iter().any(|camera| one.identity.contains(&camera.identity));
    let others: Vec<DeviceCard> = others.filter(|one| !known(one)).collect();
    let stage: Vec<DeviceCard> = stage.collect();
    let others = others.into_iter().filter(|one| stage.iter().all(|stage| stage.identity != one.identity));
    let (a, b) = (open.facts.sensors[0], open.facts.sensors[1]);
    InstrumentCard {
        name: instrument.name().to_owned(),
        label: open.label.word().map(str::to_owned),
        sensor: (a.0.min(b.0), a.1.min(b.1)),
        shortest_period: open.facts.shortest_periods[0].max(open.facts.shortest_periods[1]),
        longest_exposure: limits.longest_exposure.unwrap_or(LONGEST_EXPOSURE),
        pixel_pitch_nm: instrument.pixel_pitch_nm(),
        dichroic: instrument.dichroic().map(str::to_owned),
        species: open.species_names(),
        known_species: catalogue.fluorophores().iter().map(|dye| dye.name().to_owned()).collect(),
        has_focus: instrument.hardware().focus.is_some(),
        stage_um: open.stage.as_ref().map(|stage| {
            let envelope = stage.envelope();
            [&envelope.x, &envelope.y].map(|axis| (axis.start().value(), axis.end().value()))
        }),
        devices: cameras.iter().cloned().chain(stage.iter().cloned()).chain(others).collect(),
        warnings: open.warnings.clone(),
        plans: PLANS.map(|(name, text)| (name.to_owned(), text.to_owned())).to_vec(),
    }
}

/// A property as the browser shows it.
pub(super) fn row(property: &Property) -> PropertyRow {
    let value = match &property.value {
        PropertyValue::Flag(flag) => flag.to_string(),
        PropertyValue::Whole(number) => number.to_string(),
        PropertyValue::Number(number) => format!("{number}"),
        PropertyValue::Text(text) => text.clone(),
    };
    let range = match &property.range {
        PropertyRange::Any => String::new(),
        PropertyRange::Between { least, greatest } => format!("{least} to {greatest}"),
        PropertyRange::Choice(choices) => choices.join(", "),
    };
    let choices = match (&property.range, &property.value) {
        (PropertyRange::Choice(choices), _) => choices.clone(),
        (_, PropertyValue::Flag(_)) => ["false", "true"].map(str::to_owned).to_vec(),
        _ => Vec::new(),
    };
    PropertyRow {
        name: property.name.clone(),
        value,
        unit: property.unit.clone(),
        range,
        choices,
        is_writable: property.writable,
    }
}

/// Laser lines without anybody who could be asked: what they were told is all that is known.
pub(super) fn told_lasers(instrument: &Instrument, lit: &BTreeMap<u32, f64>) -> Vec<LaserStatus> {
    let lines = instrument.limits().laser_power_mw.iter();
    lines
        .map(|(&wavelength_nm, &cap_mw)| LaserStatus {
            wavelength_nm,
            cap_mw,
            identity: "simulated laser; lights nothing, the simulated sample shines by itself".to_owned(),
            power_mw: lit.get(&wavelength_nm).copied().unwrap_or(0.0),
            is_emitting: None,
            interlock_closed: None,
        })
        .collect()
}

/// Laser lines as the guard reads them back; what cannot be asked is taken as on.
pub(super) fn read_lasers(instrument: &Instrument, state: &LightsState) -> Vec<LaserStatus> {
    let caps = &instrument.limits().laser_power_mw;
    let lines = state.lines.iter().map(|line| {
        let laser = line.laser.as_ref();
        let emission = laser.map_or(Emission::UnknownAssumeOn, |laser| laser.emission);
        LaserStatus {
            wavelength_nm: line.wavelength_nm,
            cap_mw: caps.get(&line.wavelength_nm).copied().unwrap_or(0.0),
            identity: line.identity.to_string(),
            power_mw: laser.map_or(0.0, |laser| laser.power_set.value()),
            is_emitting: match emission {
                Emission::Off => Some(false),
                Emission::On => Some(true),
                Emission::UnknownAssumeOn => None,
            },
            interlock_closed: laser.and_then(|laser| match laser.interlock {
                Interlock::Closed => Some(true),
                Interlock::Open => Some(false),
                Interlock::NotReported => None,
            }),
        }
    });
    let mut lines: Vec<_> = lines.collect();
    lines.sort_by_key(|line| line.wavelength_nm);
    lines
}
