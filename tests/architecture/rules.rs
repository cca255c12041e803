//! The rules, each from sources to findings of the form `file:line: what is wrong`.

use crate::reading::{PathUse, Source, outside_packages};
use crate::{DRIVERS, ROOMS, Room, UNSAFE};

/// Rooms of `src/` know only what the table allows.
pub(crate) fn arrows(sources: &[Source]) -> Vec<String> {
    let (outside, tests) = (outside_packages(), test_files(sources));
    sources
        .iter()
        .filter(|source| source.path.starts_with("src/"))
        .flat_map(|source| arrows_of(source, &outside, tests.contains(&source.path)))
        .collect()
}

fn arrows_of(source: &Source, outside: &[String], is_test: bool) -> Vec<String> {
    let modules = source.modules();
    let (name, room) = match modules.first() {
        None => (if source.path == "src/main.rs" { "main" } else { "lib" }, None),
        Some(name) => match ROOMS.iter().find(|room| room.name == name) {
            None => return vec![format!("{}: the room {name} is not in the table of arrows", source.path)],
            room => (name.as_str(), room),
        },
    };
    let mut findings = Vec::new();
    for path in source.paths() {
        let (to, is_allowed) = match target(&path, &modules, outside) {
            Target::Room(to) => (to.clone(), may_enter(name, room, &to)),
            Target::Package(to) => (to.clone(), may_know(room, &to)),
            Target::Outside(to) => (to.clone(), is_test || path.is_test || may_use(room, &to)),
            Target::Here => continue,
        };
        if !is_allowed {
            let place = format!("{}:{}", source.path, path.line);
            findings.push(format!("{place}: the arrow {name} -> {to} is not allowed"));
        }
    }
    findings
}

enum Target {
    Room(String),
    Package(String),
    Outside(String),
    Here,
}

fn may_enter(from: &str, room: Option<&Room>, to: &str) -> bool {
    match room {
        Some(room) => from == to || room.rooms.contains(&to),
        None => to == "app",
    }
}

fn may_know(room: Option<&Room>, package: &str) -> bool {
    room.is_some_and(|room| room.packages.contains(&package))
}

fn may_use(room: Option<&Room>, to: &str) -> bool {
    room.and_then(|room| room.crates).is_none_or(|crates| crates.contains(&to))
}

/// Where a path leads, seen from a module of the program.
fn target(path: &PathUse, modules: &[String], outside: &[String]) -> Target {
    let segments = &path.segments;
    let here: Vec<&String> = modules.iter().chain(&path.inline_modules).collect();
    let is_room = |name: &String| ROOMS.iter().any(|room| room.name == name);
    let climbs = segments.iter().take_while(|segment| *segment == "super").count();
    let inside = match segments[0].as_str() {
        "crate" | "sofiscope" => segments.get(1),
        "super" if climbs >= here.len() => segments.get(climbs),
        "super" => return Target::Room(here[0].clone()),
        package if package.starts_with("sofiscope_") => return Target::Package(package.to_owned()),
        package if outside.iter().any(|name| name == package) => return Target::Outside(package.to_owned()),
        _ => return Target::Here,
    };
    match inside {
        Some(name) if is_room(name) => Target::Room(name.clone()),
        _ => Target::Here,
    }
}

/// Drivers know contracts only.
pub(crate) fn driver_arrows(sources: &[Source]) -> Vec<String> {
    let mut findings = Vec::new();
    for source in sources {
        let Some((driver, _)) = source.path.strip_prefix("drivers/").and_then(|path| path.split_once('/'))
        else {
            continue;
        };
        let Some(allowed) = allowed_packages(driver) else {
            findings.push(format!("{}: the driver {driver} is not in the table of arrows", source.path));
            continue;
        };
        for path in source.paths() {
            let to = &path.segments[0];
            let is_ours = to == "sofiscope" || to.starts_with("sofiscope_");
            if is_ours && !allowed.contains(&to.as_str()) {
                let place = format!("{}:{}", source.path, path.line);
                findings.push(format!("{place}: the arrow {driver} -> {to} is not allowed"));
            }
        }
    }
    findings
}

/// The manifests of drivers, as pairs of folder and text, name no other package of ours.
pub(crate) fn driver_manifests(manifests: &[(String, String)]) -> Vec<String> {
    let mut findings = Vec::new();
    for (driver, text) in manifests {
        let manifest: toml::Table = text.parse().expect("a manifest is valid TOML");
        for table in ["dependencies", "dev-dependencies", "build-dependencies"] {
            let names =
                manifest.get(table).and_then(toml::Value::as_table).into_iter().flat_map(toml::Table::keys);
            for name in names.map(|name| name.replace('-', "_")).filter(|name| name.starts_with("sofiscope"))
            {
                if allowed_packages(driver).is_none_or(|allowed| !allowed.contains(&name.as_str())) {
                    findings.push(format!("drivers/{driver}/Cargo.toml: {driver} -> {name} is not allowed"));
                }
            }
        }
    }
    findings
}

fn allowed_packages(driver: &str) -> Option<&'static [&'static str]> {
    DRIVERS.iter().find(|(name, _)| *name == driver).map(|(_, allowed)| *allowed)
}

/// Every file begins with a description; that of a room says what goes in and out, or lists what is there.
pub(crate) fn descriptions(sources: &[Source]) -> Vec<String> {
    let tests = test_files(sources);
    let mut findings = Vec::new();
    for source in sources.iter().filter(|source| !tests.contains(&source.path)) {
        let header: Vec<&str> = source.text.lines().take_while(|line| line.starts_with("//!")).collect();
        if header.is_empty() {
            findings.push(format!("{}:1: begins without `//!` and what it is", source.path));
            continue;
        }
        let says = |what: &str| header.iter().any(|line| line.contains(what));
        let lists = header.iter().any(|line| line.starts_with("//! |"));
        let is_room = source.path.starts_with("src/") && source.path.ends_with("/mod.rs");
        if is_room && !lists && !(says("In:") && says("Out:")) {
            let path = &source.path;
            findings.push(format!("{path}:1: says neither `In:` and `Out:` nor, in a table, what is there"));
        }
    }
    findings
}

/// `unsafe` is only in the files that are listed for it.
pub(crate) fn unsafe_code(sources: &[Source]) -> Vec<String> {
    let listed = |path: &str| UNSAFE.iter().any(|(file, _)| *file == path);
    let mut findings = Vec::new();
    for source in sources.iter().filter(|source| !listed(&source.path)) {
        let words = source.words.iter().filter(|word| word.text == "unsafe");
        findings.extend(words.map(|word| format!("{}:{}: unsafe code", source.path, word.line)));
    }
    findings
}

/// Nothing is unwrapped outside tests.
pub(crate) fn unwraps(sources: &[Source]) -> Vec<String> {
    let tests = test_files(sources);
    let mut findings = Vec::new();
    for source in sources.iter().filter(|source| !tests.contains(&source.path)) {
        for words in source.words.windows(4).filter(|words| !words[1].is_test) {
            let is_call = [".", "unwrap", "(", ")"].iter().zip(words).all(|(text, word)| word.text == *text);
            if is_call {
                findings.push(format!("{}:{}: unwrap outside a test", source.path, words[1].line));
            }
        }
    }
    findings
}

/// Every queue is bounded.
pub(crate) fn unbounded_queues(sources: &[Source]) -> Vec<String> {
    let mut findings = Vec::new();
    for source in sources {
        for path in source.paths() {
            let ends_with =
                |end: &[&str]| path.segments.iter().rev().zip(end.iter().rev()).all(|(a, b)| a == b);
            let is_unbounded = path.segments.iter().any(|name| name.starts_with("unbounded"))
                || (path.segments.len() > 1 && ends_with(&["mpsc", "channel"]));
            if is_unbounded {
                findings.push(format!("{}:{}: a queue that is not bounded", source.path, path.line));
            }
        }
    }
    findings
}

fn test_files(sources: &[Source]) -> Vec<String> {
    let declared: Vec<String> = sources.iter().flat_map(Source::test_files).collect();
    let is_below = |source: &&Source| {
        let folder = |file: &String| file.trim_end_matches(".rs").to_owned() + "/";
        declared.iter().any(|file| source.path.starts_with(&folder(file)))
    };
    let below: Vec<String> = sources.iter().filter(is_below).map(|source| source.path.clone()).collect();
    [declared, below].concat()
}
