//! The house rules that no compiler checks: which room may know which, and what is in no room at all.
//!
//! Each rule is run over the whole source, and over a snippet that breaks it, so that it can be seen to fail.

#[cfg(test)]
#[path = "architecture/reading.rs"]
mod reading;
#[cfg(test)]
#[path = "architecture/rules.rs"]
mod rules;

/// What one room of `src/` may know beside the standard library and itself.
struct Room {
    name: &'static str,
    /// Other rooms.
    rooms: &'static [&'static str],
    /// Packages of this workspace.
    packages: &'static [&'static str],
    /// Packages from elsewhere, outside tests; `None` for any.
    crates: Option<&'static [&'static str]>,
}

/// The arrows that are allowed. A new arrow is a decision: it is made here, with its reason in the same change.
const ROOMS: [Room; 14] = [
    // The mathematics knows nothing of the program: no file, no device, no log.
    Room {
        name: "sofi",
        rooms: &[],
        packages: &[],
        crates: Some(&["libm", "nalgebra", "ndarray", "pulp", "rayon", "rustfft", "thiserror"]),
    },
    Room { name: "files", rooms: &[], packages: &[], crates: None },
    Room {
        name: "display",
        rooms: &[],
        packages: &[],
        crates: Some(&["bytemuck", "ndarray", "png", "serde", "thiserror"]),
    },
    Room { name: "report", rooms: &["display"], packages: &[], crates: None },
    // Instrument files name channels and regions in the words of the devices.
    Room { name: "config", rooms: &["sofi"], packages: &["sofiscope_form", "sofiscope_hal"], crates: None },
    Room {
        name: "reconstruction",
        rooms: &["acquisition", "pipeline", "sofi"],
        packages: &["sofiscope_hal"],
        crates: None,
    },
    // Plumbing knows no physics and no device.
    Room {
        name: "pipeline",
        rooms: &[],
        packages: &[],
        crates: Some(&["rtrb", "thiserror", "triple_buffer"]),
    },
    Room {
        name: "acquisition",
        rooms: &["pipeline"],
        packages: &["sofiscope_hal"],
        crates: Some(&["bytemuck", "memmap2", "serde", "serde_json", "thiserror", "tracing"]),
    },
    Room {
        name: "recording",
        rooms: &["acquisition", "files", "pipeline"],
        packages: &["sofiscope_hal"],
        crates: None,
    },
    // Recorded frames behind the contract of cameras.
    Room {
        name: "replay",
        rooms: &["acquisition", "files", "recording"],
        packages: &["sofiscope_hal"],
        crates: None,
    },
    // A process of its own, which knows devices and nothing of the instrument.
    Room {
        name: "guard",
        rooms: &[],
        packages: &["sofiscope_hal"],
        crates: Some(&["crossbeam_channel", "serde", "serde_json", "thiserror", "tracing"]),
    },
    // Plans and the order of steps; devices only through their contracts.
    Room { name: "control", rooms: &["config"], packages: &["sofiscope_hal"], crates: None },
    // The window draws data and sends commands; it knows no device and no thread of the instrument.
    Room {
        name: "viewer",
        rooms: &["control", "display", "pipeline", "reconstruction"],
        packages: &[],
        crates: None,
    },
    // The composition root knows every room and is known by none; `main.rs` alone calls it.
    Room {
        name: "app",
        rooms: &[
            "acquisition",
            "config",
            "control",
            "display",
            "files",
            "guard",
            "pipeline",
            "reconstruction",
            "recording",
            "replay",
            "report",
            "sofi",
            "viewer",
        ],
        packages: &[
            "sofiscope_dcam",
            "sofiscope_focus_sensor",
            "sofiscope_gated_laser",
            "sofiscope_gatekeeper",
            "sofiscope_genicam",
            "sofiscope_hal",
            "sofiscope_laserquantum_smd12",
            "sofiscope_madlib",
            "sofiscope_madlib_stand_in",
            "sofiscope_maerzhaeuser_tango",
            "sofiscope_micromanager_arduino",
            "sofiscope_micromanager_teensy_pulse",
            "sofiscope_serial_line",
            "sofiscope_sim",
            "sofiscope_toptica_ibeam_smart",
            "sofiscope_virtual",
        ],
        crates: None,
    },
];

/// What the packages of `drivers/` may know of this workspace: contracts, never the program.
const DRIVERS: [(&str, &[&str]); 19] = [
    // Drivers of vendor libraries are tested against a library of ours, which they open as they open the vendor's.
    ("dcam", &["sofiscope_dcam_stand_in", "sofiscope_hal", "sofiscope_virtual"]),
    ("dcam-stand-in", &["sofiscope_hal", "sofiscope_sim", "sofiscope_virtual"]),
    ("focus-sensor", &["sofiscope_hal", "sofiscope_virtual"]),
    ("form", &[]),
    ("gated-laser", &["sofiscope_hal", "sofiscope_virtual"]),
    ("gatekeeper", &["sofiscope_hal", "sofiscope_serial_line", "sofiscope_virtual"]),
    ("gatekeeper-core", &[]),
    ("genicam", &["sofiscope_hal", "sofiscope_virtual"]),
    ("hal", &[]),
    ("laserquantum-smd12", &["sofiscope_hal", "sofiscope_serial_line", "sofiscope_virtual"]),
    ("madlib", &["sofiscope_hal", "sofiscope_madlib_stand_in", "sofiscope_virtual"]),
    ("madlib-stand-in", &["sofiscope_virtual"]),
    ("maerzhaeuser-tango", &["sofiscope_hal", "sofiscope_serial_line", "sofiscope_virtual"]),
    ("micromanager-arduino", &["sofiscope_hal", "sofiscope_serial_line", "sofiscope_virtual"]),
    ("micromanager-teensy-pulse", &["sofiscope_hal", "sofiscope_serial_line", "sofiscope_virtual"]),
    ("serial-line", &["sofiscope_hal"]),
    ("sim", &["sofiscope_form", "sofiscope_hal"]),
    ("toptica-ibeam-smart", &["sofiscope_hal", "sofiscope_serial_line", "sofiscope_virtual"]),
    ("virtual", &["sofiscope_gatekeeper_core", "sofiscope_hal", "sofiscope_serial_line"]),
];

/// Files that may hold `unsafe` code, each with its reason.
const UNSAFE: [(&str, &str); 10] = [
    (
        "src/sofi/prefetch.rs",
        "the prefetch instruction has no safe form; it can neither fault nor change a value",
    ),
    (
        "drivers/gatekeeper-core/src/firmware.rs",
        "the firmware of the trigger controller is C; the virtual board runs the same code as the real one",
    ),
    (
        "drivers/virtual/src/table/cells.rs",
        "memory that several processes share has no safe form; all access is atomic",
    ),
    ("drivers/dcam/src/ffi/mod.rs", "calls of DCAM-API, a library of the maker opened at run time"),
    ("drivers/dcam-stand-in/src/exports.rs", "C functions that take pointers, as DCAM-API has them"),
    ("drivers/dcam-stand-in/src/remote.rs", "calls the library of the same package as its users do"),
    ("drivers/madlib/src/ffi.rs", "calls of Madlib, a library of the maker opened at run time"),
    ("drivers/madlib-stand-in/src/exports.rs", "C functions that take pointers, as Madlib has them"),
    ("drivers/madlib-stand-in/src/remote.rs", "calls the library of the same package as its users do"),
    (
        "drivers/genicam/src/raw.rs",
        "bytes of buffers, serial numbers and sockets have no safe form in the binding of Aravis",
    ),
];

#[cfg(test)]
mod tests {
    use crate::reading::{Source, all_sources};
    use crate::rules;
    use crate::{DRIVERS, ROOMS};

    type Rule = fn(&[Source]) -> Vec<String>;

    fn assert_kept(rule: Rule) {
        let findings = rule(&all_sources());
        assert!(findings.is_empty(), "\n{}\n", findings.join("\n"));
    }

    fn assert_caught(rule: Rule, path: &str, text: &str, expected: &str) {
        let findings = rule(&[Source::new(path, text)]);
        assert!(findings.iter().any(|finding| finding.contains(expected)), "{text}\n{findings:?}");
    }

    fn assert_passes(rule: Rule, path: &str, text: &str) {
        assert_eq!(rule(&[Source::new(path, text)]), [""; 0], "{text}");
    }

    #[test]
    fn the_sources_are_found() {
        let sources = all_sources();
        let rooms = |name: &str| sources.iter().any(|source| source.path == format!("src/{name}/mod.rs"));
        assert!(ROOMS.iter().all(|room| rooms(room.name)), "a room of the table has no folder");
        for (driver, _) in DRIVERS {
            let path = format!("drivers/{driver}/src/lib.rs");
            assert!(sources.iter().any(|source| source.path == path), "{path}");
        }
        assert!(sources.len() > 60);
    }

    #[test]
    fn rooms_know_only_the_rooms_they_may() {
        assert_kept(rules::arrows);
    }

    #[test]
    fn forbidden_arrows_are_caught_in_every_spelling() {
        let caught = |path, text, expected| assert_caught(rules::arrows, path, text, expected);
        caught("src/sofi/psf.rs", "use crate::files::FileError;", "sofi -> files");
        caught("src/sofi/psf.rs", "use crate::{display::Rgb, sofi::grid};", "sofi -> display");
        caught("src/sofi/cumulant/plan.rs", "use super::super::super::report::html;", "sofi -> report");
        caught("src/display/mod.rs", "fn f() { let e = crate::report::html(); }", "display -> report");
        caught("src/display/mod.rs", "mod tests { use super::super::files::Place; }", "display -> files");
        caught("src/report/page.rs", "use crate::app::{run as start, AppError};", "report -> app");
        caught("src/sofi/psf.rs", "use tracing::warn;", "sofi -> tracing");
        caught("src/files/stack.rs", "use sofiscope_sim::World;", "files -> sofiscope_sim");
        caught("src/cellar/mod.rs", "", "cellar");
        caught("src/main.rs", "use sofiscope::sofi::grid;", "main -> sofi");
        caught("src/sofi/psf.rs", "/* \" */ use crate::files; // \"", "sofi -> files");
        caught(
            "src/sofi/psf.rs",
            "const Q: char = '\"'; use crate::files; const R: char = '\"';",
            "sofi -> files",
        );
    }

    #[test]
    fn allowed_arrows_pass() {
        let passes = |path, text| assert_passes(rules::arrows, path, text);
        passes(
            "src/report/page.rs",
            "use crate::display::{Rgb, hex}; use super::text; use serde::Serialize;",
        );
        passes("src/sofi/psf.rs", "// use crate::files;\nconst TEXT: &str = r#\"use \"crate::files;\"#;");
        passes("src/sofi/psf.rs", "#[cfg(test)] mod tests { use super::*; use proptest::prelude::*; }");
        passes("src/report/figure.rs", "mod tests { use super::super::example; }");
        passes("src/main.rs", "use sofiscope::app::{Arguments, run};");
        passes("src/app/mod.rs", "use crate::sofi::grid; use sofiscope_sim::World; use anyhow::Result;");
    }

    #[test]
    fn drivers_know_only_their_contracts() {
        assert_kept(rules::driver_arrows);
        let manifests = rules::driver_manifests(&crate::reading::driver_manifests());
        assert!(manifests.is_empty(), "{manifests:?}");
    }

    #[test]
    fn drivers_that_know_more_are_caught() {
        let caught = |path, text, expected| assert_caught(rules::driver_arrows, path, text, expected);
        caught("drivers/sim/src/world.rs", "use sofiscope::sofi::grid;", "sim -> sofiscope");
        caught("drivers/hal/src/lib.rs", "use sofiscope_sim::World;", "hal -> sofiscope_sim");
        caught("drivers/tank/src/lib.rs", "", "tank");
        let manifest = ("sim".to_owned(), "[dependencies]\nsofiscope.path = \"../..\"\n".to_owned());
        assert_eq!(rules::driver_manifests(&[manifest]).len(), 1);
        assert_passes(rules::driver_arrows, "drivers/sim/src/world.rs", "use sofiscope_hal::Channel;");
    }

    #[test]
    fn every_room_says_what_it_does() {
        assert_kept(rules::descriptions);
    }

    #[test]
    fn rooms_without_a_description_are_caught() {
        let caught = |text, expected| assert_caught(rules::descriptions, "src/sofi/mod.rs", text, expected);
        caught("mod psf;", "begins without");
        caught("//! The mathematics.\n\nmod psf;", "In");
        caught("//! The mathematics.\n//! In: frames.\n\n//! Out: images.", "In");
        assert_caught(rules::descriptions, "src/sofi/psf.rs", "use std::fmt;", "begins without");
        let passes = |text| assert_passes(rules::descriptions, "src/sofi/mod.rs", text);
        passes("//! The mathematics.\n//!\n//! In: frames. Out: images.\n\nmod psf;");
        passes("//! The mathematics.\n//!\n//! | step | file |\n//! |---|---|\n\nmod psf;");
    }

    #[test]
    fn unsafe_code_is_only_where_it_is_listed() {
        assert_kept(rules::unsafe_code);
        let text = "fn f() { unsafe { g() } }";
        assert_caught(rules::unsafe_code, "src/sofi/psf.rs", text, "unsafe");
        assert_passes(rules::unsafe_code, "src/sofi/psf.rs", "// unsafe\nconst TEXT: &str = \"unsafe\";");
    }

    #[test]
    fn nothing_is_unwrapped_outside_tests() {
        assert_kept(rules::unwraps);
        let caught = |text| assert_caught(rules::unwraps, "src/files/open.rs", text, "unwrap");
        caught("fn f() { g()\n    .unwrap(); }");
        caught("#[cfg(test)] mod tests { fn f() { g().unwrap(); } } fn h() { g().unwrap(); }");
        caught("#[cfg(test)] mod tests; fn h() { g().unwrap(); }");
        let passes = |text| assert_passes(rules::unwraps, "src/files/open.rs", text);
        passes("/// g().unwrap()\nfn f() { g().unwrap_or(0); }");
        passes(
            "#[cfg(test)]\n#[expect(dead_code, reason = \"{\")]\npub(super) mod tests { fn f() { g().unwrap(); } }",
        );
        passes("#[test] fn f() { g().unwrap(); }");
    }

    #[test]
    fn files_of_tests_are_known_by_their_declaration() {
        let room = Source::new("src/sofi/mod.rs", "#[cfg(test)]\nmod reference;\nmod psf;");
        let file = |path| Source::new(path, "fn f() { g().unwrap(); }");
        let sources = [
            room,
            file("src/sofi/reference.rs"),
            file("src/sofi/reference/fakes.rs"),
            file("src/sofi/psf.rs"),
        ];
        let findings = rules::unwraps(&sources);
        assert_eq!(findings.len(), 1);
        assert!(findings[0].starts_with("src/sofi/psf.rs:1"));
    }

    #[test]
    fn every_queue_is_bounded() {
        assert_kept(rules::unbounded_queues);
        let caught = |text| assert_caught(rules::unbounded_queues, "src/app/live.rs", text, "bounded");
        caught("let (tx, rx) = crossbeam_channel::unbounded();");
        caught("use std::sync::mpsc; let (tx, rx) = mpsc::channel();");
        caught("use std::sync::mpsc::{Receiver, channel};");
        caught("let (tx, rx) = tokio::sync::mpsc::unbounded_channel();");
        assert_passes(rules::unbounded_queues, "src/app/live.rs", "std::sync::mpsc::sync_channel(4);");
    }
}
