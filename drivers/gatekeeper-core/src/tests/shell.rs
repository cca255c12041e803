//! The compiler's view of the firmware: no warning as C11 and as C++11, no fault under sanitizers, and a shell that
//! drives its outputs low before anything else, on an Arduino made of text.

use std::path::{Path, PathBuf};
use std::process::Command;

fn here(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(path)
}

const CORE: &str = "../gatekeeper/firmware/gatekeeper/gatekeeper_core.c";
const FRAMES: &str = "../gatekeeper/firmware/gatekeeper/gatekeeper_frames.c";

/// Runs a program and gives what it printed; panics with what it said when it fails.
fn run(program: impl AsRef<std::ffi::OsStr>, arguments: &[&str]) -> String {
    let done = Command::new(program).args(arguments).current_dir(here("")).output().unwrap();
    let said = String::from_utf8_lossy(&done.stderr).into_owned();
    assert!(done.status.success(), "{arguments:?}: {}\n{said}", done.status);
    assert!(said.is_empty(), "{arguments:?}: {said}");
    String::from_utf8_lossy(&done.stdout).into_owned()
}

const STRICT: [&str; 6] =
    ["-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror", "-I../gatekeeper/firmware/gatekeeper"];

#[test]
fn the_firmware_compiles_without_a_warning() {
    let core = ["-std=c11", "-fsyntax-only", CORE, FRAMES];
    run("cc", &[&STRICT[..], &core].concat());
    // Small boards have C++ in which an `int` is narrow; the same text must be good for both.
    run("c++", &["-x", "c++", "-std=c++11", "-Wall", "-Wextra", "-Werror", "-fsyntax-only", CORE, FRAMES]);
}

#[test]
fn two_million_random_turns_have_no_fault_under_sanitizers() {
    let folder = tempfile::tempdir().unwrap();
    let program = folder.path().join("turns");
    let build = ["-std=c11", "-O1", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"];
    let files = ["-o", program.to_str().unwrap(), CORE, FRAMES, "src/tests/turns.c"];
    run("cc", &[&STRICT[..], &build, &files].concat());
    let printed = run(&program, &[]);
    let mut numbers = printed.split_whitespace().map(|word| word.parse::<u64>().unwrap());
    assert_eq!(numbers.next(), Some(2_000_000), "turns");
    let (open, wrong) = (numbers.next().unwrap(), numbers.next().unwrap());
    assert_eq!(wrong, 0, "turns with a gate open while the interlock was");
    assert!(open > 10_000, "only {open} turns with an open gate: the test looks at nothing");
}

#[test]
fn the_shell_drives_its_outputs_low_before_anything_else() {
    for (board, pins) in [
        ("__AVR__", [7, 8, 9, 10, 12, 14, 3, 11, 6].as_slice()),
        ("__IMXRT1062__", [9, 10, 11, 12, 14, 15, 16, 17, 3, 4, 5, 6, 13].as_slice()),
    ] {
        let folder = tempfile::tempdir().unwrap();
        let program = folder.path().join("shell");
        let build = ["-std=c++11", "-Isrc/tests/arduino", "-I../gatekeeper/firmware/gatekeeper"];
        let define = format!("-D{board}");
        let files =
            ["-o", program.to_str().unwrap(), "-x", "c++", CORE, FRAMES, "src/tests/arduino/bench.cpp"];
        run("c++", &[&build[..], &[define.as_str()], &files].concat());
        let printed = run(&program, &[]);
        let lines: Vec<&str> = printed.lines().collect();
        let first: Vec<String> =
            pins.iter().flat_map(|pin| [format!("write {pin} 0"), format!("output {pin}")]).collect();
        assert_eq!(lines[..first.len()], first, "{board}");
        let high = lines.iter().find(|line| line.starts_with("write") && line.ends_with(" 1"));
        assert_eq!(high, None, "{board}: nothing is high without a command");
        let begun = lines.iter().position(|line| *line == "serial").unwrap();
        assert!(begun > first.len(), "{board}: the port is opened after the outputs are low");
        assert!(lines.contains(&"feeds"), "{board}: the hardware watchdog is fed");
        assert!(lines.iter().any(|line| line.starts_with("sent :000181")), "{board}: hello is answered");
    }
}
