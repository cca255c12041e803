//! Whether an instrument can do what a plan asks.
//!
//! In: a plan and an instrument, both believed. Out: everything that does not fit, with its key in the plan.
//! Never: clips a wish to a limit. Fails: not at all.

use sofiscope_hal::TriggerMode;

use super::Plan;
use crate::config::{Catalogue, Fault, Instrument, TriggerKind};

impl Plan {
    /// Everything in this plan that the instrument cannot or must not do; empty when it fits.
    #[must_use]
    pub fn misfits(&self, instrument: &Instrument) -> Vec<Fault> {
        let mut faults = Vec::new();
        let mut note = |key: String, message: String, remedy: &str| {
            let key = format!("metadata.sofiscope.{key}");
            faults.push(Fault { line: None, key, message, remedy: remedy.to_owned() });
        };
        let (cameras, limits) = (self.cameras(), instrument.limits());
        if let Some(longest) = limits.longest_exposure.filter(|&longest| cameras.exposure > longest) {
            let message = format!("is {:?}, and the instrument allows {longest:?}", cameras.exposure);
            note("cameras.exposure_ms".to_owned(), message, "make it shorter");
        }
        if let Some(shortest) = limits.shortest_period.filter(|&shortest| cameras.period < shortest) {
            let message = format!("is {:?}, and the instrument allows {shortest:?}", cameras.period);
            note("cameras.period_ms".to_owned(), message, "make it longer");
        }
        if cameras.trigger == Some(TriggerMode::External) && instrument.trigger() == TriggerKind::FreeRunning
        {
            let message = "is external, and the instrument has no trigger".to_owned();
            note("cameras.trigger".to_owned(), message, "write free-running, or connect a trigger");
        }
        for (line, &power) in self.laser_power_mw() {
            let key = format!("laser_power_mw.{line}");
            match limits.laser_power_mw.get(line) {
                None => note(key, "is a line that the instrument does not have".to_owned(), "remove it"),
                Some(&most) if power > most => {
                    note(key, format!("is {power} mW, and the instrument allows {most} mW"), "lower it");
                }
                Some(_) => {}
            }
        }
        if let (Some(wanted), Some(mounted)) = (self.analysis().dichroic.as_deref(), instrument.dichroic())
            && self.analysis().response_file.is_none()
            && !is_same_dichroic(wanted, mounted)
        {
            let message = format!("is {wanted}, and {mounted} is mounted");
            note("analysis.dichroic".to_owned(), message, "name the dichroic that is mounted");
        }
        faults
    }
}

/// A dichroic has several names.
fn is_same_dichroic(a: &str, b: &str) -> bool {
    let catalogue = Catalogue::built_in();
    match (catalogue.dichroic(a), catalogue.dichroic(b)) {
        (Ok(a), Ok(b)) => a.name() == b.name(),
        _ => a == b,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_an_instrument_cannot_do_is_refused_and_not_clipped() {
        let text = include_str!("../../../config/plans/paper-three-color.yaml");
        let instrument = Instrument::from_toml(Instrument::simulated_toml()).unwrap();
        let misfits = |text: &str| Plan::from_text(text).unwrap().misfits(&instrument);
        assert_eq!(misfits(text), []);
        assert_eq!(misfits(&text.replace("zt 594 RDC", "ZT-594")), []);
        let wrong = text
            .replace("exposure_ms: 20.0", "exposure_ms: 2000")
            .replace("period_ms: 20.0", "period_ms: 2000")
            .replace("zt 594 RDC", "HC BS 640")
            .replace("recording:", "laser_power_mw: {488: 60, 405: 1, 561: 50}\n    recording:");
        let found: Vec<String> = misfits(&wrong).iter().map(|fault| fault.key.clone()).collect();
        let expected =
            ["cameras.exposure_ms", "laser_power_mw.405", "laser_power_mw.488", "analysis.dichroic"];
        assert_eq!(found, expected.map(|key| format!("metadata.sofiscope.{key}")));
        let short = text
            .replace("exposure_ms: 20.0", "exposure_ms: 0.01")
            .replace("period_ms: 20.0", "period_ms: 0.05");
        assert!(misfits(&short)[0].key.ends_with("period_ms"));
        let own = Instrument::simulated_toml()
            .replace("[trigger]\nkind = \"simulated\"", "[trigger]\nkind = \"free-running\"");
        let own = Instrument::from_toml(&own).unwrap();
        let external = text.replace("exposure_ms:", "trigger: external\n      exposure_ms:");
        assert_eq!(Plan::from_text(&external).unwrap().misfits(&own).len(), 1);
    }
}
