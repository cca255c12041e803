//! Source text as words and paths: as much of Rust's grammar as the rules need.
//!
//! In: text. Out: its words without comments and literals, the paths in it, and what belongs to tests.

use std::fs;
use std::path::{Path, PathBuf};

/// One file of the program.
pub(crate) struct Source {
    /// From the root of the repository, with forward slashes.
    pub(crate) path: String,
    pub(crate) text: String,
    pub(crate) words: Vec<Word>,
}

/// An identifier or a mark outside comments and literals.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Word {
    pub(crate) text: String,
    pub(crate) line: usize,
    pub(crate) is_test: bool,
}

/// A path such as `crate::sofi::grid`, with the inline modules around it.
pub(crate) struct PathUse {
    pub(crate) segments: Vec<String>,
    pub(crate) inline_modules: Vec<String>,
    pub(crate) line: usize,
    pub(crate) is_test: bool,
}

impl Source {
    pub(crate) fn new(path: &str, text: &str) -> Self {
        let mut words = words(text);
        mark_tests(&mut words);
        Self { path: path.to_owned(), text: text.to_owned(), words }
    }

    /// Names of the modules from the root of the package: `src/sofi/psf.rs` is `sofi`, `psf`.
    pub(crate) fn modules(&self) -> Vec<String> {
        let inside = self.path.split_once("src/").map_or("", |(_, inside)| inside);
        let mut modules: Vec<String> = inside.trim_end_matches(".rs").split('/').map(str::to_owned).collect();
        if matches!(modules.last().map(String::as_str), Some("mod" | "lib" | "main")) {
            modules.pop();
        }
        modules
    }

    /// All paths with at least two segments, and those in `use` declarations, lists in braces taken apart.
    pub(crate) fn paths(&self) -> Vec<PathUse> {
        let mut found = Vec::new();
        let mut blocks: Vec<Option<String>> = Vec::new();
        let mut at = 0;
        while at < self.words.len() {
            let word = &self.words[at];
            match word.text.as_str() {
                "{" => blocks.push(module_before(&self.words[..at])),
                "}" => drop(blocks.pop()),
                _ => {}
            }
            let mut next = at + 1;
            if is_name(&word.text) {
                let mut paths = Vec::new();
                next = path_tree(&self.words, at, &[], &mut paths);
                let in_use = at > 0 && self.words[at - 1].text == "use";
                paths.retain(|path| path.len() > 1 || in_use);
                found.extend(paths.into_iter().map(|segments| PathUse {
                    segments,
                    inline_modules: blocks.iter().flatten().cloned().collect(),
                    line: word.line,
                    is_test: word.is_test,
                }));
            }
            at = next;
        }
        found
    }

    /// Files that a `#[cfg(test)] mod name;` of this file names.
    pub(crate) fn test_files(&self) -> Vec<String> {
        let folder = format!("{}/src/{}", self.package(), self.modules().join("/"));
        let folder = folder.trim_start_matches('/').trim_end_matches('/').to_owned();
        let declared =
            self.words.windows(3).filter(|w| w[0].text == "mod" && w[2].text == ";" && w[0].is_test);
        declared
            .flat_map(|w| [format!("{folder}/{}.rs", w[1].text), format!("{folder}/{}/mod.rs", w[1].text)])
            .collect()
    }

    fn package(&self) -> &str {
        self.path.split_once("/src/").map_or("", |(package, _)| package)
    }
}

/// The name of the inline module whose brace comes next, if it is one.
fn module_before(words: &[Word]) -> Option<String> {
    match words {
        [.., keyword, name] if keyword.text == "mod" => Some(name.text.clone()),
        _ => None,
    }
}

fn is_name(text: &str) -> bool {
    text.starts_with(|first: char| first.is_alphabetic() || first == '_')
}

/// Reads the path that begins at `at`, and the lists in its braces; returns the place behind it.
fn path_tree(words: &[Word], mut at: usize, before: &[String], paths: &mut Vec<Vec<String>>) -> usize {
    let text = |at: usize| words.get(at).map_or("", |word| word.text.as_str());
    let mut path = before.to_vec();
    path.push(text(at).to_owned());
    at += 1;
    while text(at) == "::" && (is_name(text(at + 1)) || text(at + 1) == "*") {
        path.push(text(at + 1).to_owned());
        at += 2;
    }
    if text(at) != "::" || text(at + 1) != "{" {
        paths.push(path);
        return if text(at) == "as" { at + 2 } else { at };
    }
    at += 2;
    while at < words.len() && text(at) != "}" {
        at = match text(at) {
            "," => at + 1,
            _ => path_tree(words, at, &path, paths),
        };
    }
    at + 1
}

/// Marks what follows `#[cfg(test)]` or `#[test]`, to the end of the item.
fn mark_tests(words: &mut [Word]) {
    let mut at = 0;
    while at < words.len() {
        let begins = |pattern: &[&str]| {
            words.len() >= at + pattern.len()
                && pattern.iter().zip(&words[at..]).all(|(pattern, word)| *pattern == word.text)
        };
        if !begins(&["#", "[", "cfg", "(", "test", ")", "]"]) && !begins(&["#", "[", "test", "]"]) {
            at += 1;
            continue;
        }
        let end = end_of_item(words, at);
        words[at..end].iter_mut().for_each(|word| word.is_test = true);
        at = end;
    }
}

/// One past the last word of the item whose attributes begin at `at`.
fn end_of_item(words: &[Word], at: usize) -> usize {
    let mut depth = 0_usize;
    for (place, word) in words.iter().enumerate().skip(at) {
        match word.text.as_str() {
            "{" | "(" | "[" => depth += 1,
            "}" if depth == 1 => return place + 1,
            "}" | ")" | "]" => depth = depth.saturating_sub(1),
            ";" if depth == 0 => return place + 1,
            _ => {}
        }
    }
    words.len()
}

/// Identifiers and marks outside comments and literals; `::` is one mark.
fn words(text: &str) -> Vec<Word> {
    let letters: Vec<char> = text.chars().collect();
    let (mut words, mut at, mut line) = (Vec::new(), 0, 1);
    while at < letters.len() {
        let end = end_of_word(&letters, at);
        let word: String = letters[at..end].iter().collect();
        let is_word = is_name(&word) && !word.ends_with(['"', '#']);
        let is_mark =
            matches!(word.as_str(), "::" | "{" | "}" | "(" | ")" | "[" | "]" | ";" | "," | "." | "#" | "*");
        if is_word || is_mark {
            words.push(Word { text: word.clone(), line, is_test: false });
        }
        line += word.matches('\n').count();
        at = end;
    }
    words
}

/// One past the comment, literal, identifier or mark that begins at `at`.
fn end_of_word(letters: &[char], at: usize) -> usize {
    let next = letters.get(at + 1).copied().unwrap_or(' ');
    match letters[at] {
        '/' if next == '/' => letters[at..].iter().position(|&c| c == '\n').map_or(letters.len(), |n| at + n),
        '/' if next == '*' => end_of_comment(letters, at),
        '"' => end_of_string(letters, at),
        '\'' if next == '\\' || letters.get(at + 2) == Some(&'\'') => {
            let quote = letters.iter().skip(at + 3).position(|&c| c == '\'');
            if next == '\\' { quote.map_or(letters.len(), |n| at + 4 + n) } else { at + 3 }
        }
        ':' if next == ':' => at + 2,
        first if first.is_alphanumeric() || first == '_' => {
            let rest = letters[at..].iter().position(|c| !c.is_alphanumeric() && *c != '_');
            let end = rest.map_or(letters.len(), |n| at + n);
            let prefix: String = letters[at..end].iter().collect();
            match prefix.as_str() {
                "r" | "br" | "cr" => end_of_raw_string(letters, end).unwrap_or(end),
                "b" | "c" if letters.get(end) == Some(&'"') => end_of_string(letters, end),
                _ => end,
            }
        }
        _ => at + 1,
    }
}

fn end_of_comment(letters: &[char], at: usize) -> usize {
    let (mut depth, mut place) = (1, at + 2);
    while place < letters.len() && depth > 0 {
        match letters[place..] {
            ['/', '*', ..] => (depth, place) = (depth + 1, place + 2),
            ['*', '/', ..] => (depth, place) = (depth - 1, place + 2),
            _ => place += 1,
        }
    }
    place
}

fn end_of_string(letters: &[char], quote: usize) -> usize {
    let mut place = quote + 1;
    while place < letters.len() && letters[place] != '"' {
        place += if letters[place] == '\\' { 2 } else { 1 };
    }
    letters.len().min(place + 1)
}

/// One past the raw string whose number signs begin at `at`; nothing if there is none.
fn end_of_raw_string(letters: &[char], at: usize) -> Option<usize> {
    let signs = letters[at..].iter().take_while(|&&c| c == '#').count();
    if letters.get(at + signs) != Some(&'"') {
        return None;
    }
    let closes = |place: &usize| {
        letters[*place] == '"'
            && letters[place + 1..].iter().take(signs).filter(|&&c| c == '#').count() == signs
    };
    let end = (at + signs + 1..letters.len()).find(closes);
    Some(end.map_or(letters.len(), |quote| quote + 1 + signs))
}

/// Every Rust file of the program and of the drivers, tests of packages left out.
pub(crate) fn all_sources() -> Vec<Source> {
    let root = root();
    let mut files = rust_files(&root.join("src"));
    files.extend(drivers().iter().flat_map(|driver| rust_files(&driver.join("src"))));
    files
        .iter()
        .map(|file| {
            let relative = file.strip_prefix(&root).expect("the file is below the root");
            Source::new(&relative.to_string_lossy().replace('\\', "/"), &read(file))
        })
        .collect()
}

/// Name and manifest of every driver.
pub(crate) fn driver_manifests() -> Vec<(String, String)> {
    let name = |driver: &Path| driver.file_name().map(|name| name.to_string_lossy().into_owned());
    drivers().iter().map(|d| (name(d).unwrap_or_default(), read(&d.join("Cargo.toml")))).collect()
}

/// The packages that the workspace depends on, spelled as in source.
pub(crate) fn outside_packages() -> Vec<String> {
    let manifest: toml::Table = read(&root().join("Cargo.toml")).parse().expect("Cargo.toml is valid TOML");
    let table = manifest["workspace"]["dependencies"].as_table().expect("the one dependency table");
    table.keys().map(|name| name.replace('-', "_")).filter(|name| !name.starts_with("sofiscope")).collect()
}

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

fn drivers() -> Vec<PathBuf> {
    let is_package = |path: &PathBuf| path.join("Cargo.toml").is_file();
    entries(&root().join("drivers")).into_iter().filter(is_package).collect()
}

fn rust_files(folder: &Path) -> Vec<PathBuf> {
    let below = |path: PathBuf| if path.is_dir() { rust_files(&path) } else { vec![path] };
    let is_rust = |path: &PathBuf| path.extension().is_some_and(|extension| extension == "rs");
    entries(folder).into_iter().flat_map(below).filter(is_rust).collect()
}

fn entries(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).unwrap_or_else(|error| panic!("{}: {error}", folder.display()));
    let mut paths: Vec<PathBuf> = entries.map(|entry| entry.expect("a readable folder").path()).collect();
    paths.sort();
    paths
}

fn read(file: &Path) -> String {
    fs::read_to_string(file).unwrap_or_else(|error| panic!("{}: {error}", file.display()))
}
