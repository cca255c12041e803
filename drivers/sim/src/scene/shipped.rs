//! The scene files that come with the program, so that it works away from its repository.
//!
//! In: a name. Out: the text of the file. Fails: `None` for an unknown name.

use super::Scene;

macro_rules! shipped {
    ($($name:literal),* $(,)?) => {
        &[$(($name, include_str!(concat!("../../../../config/scenes/", $name, ".toml")))),*]
    };
}

const SHIPPED: &[(&str, &str)] = shipped![
    "figure-2",
    "figure-s4",
    "figure-s6",
    "figure-s7",
    "figure-s8",
    "figure-s10",
    "beads",
    "cell",
    "flat",
];

impl Scene {
    /// The text of a scene that comes with the program, such as `figure-s4`.
    #[must_use]
    pub fn built_in(name: &str) -> Option<&'static str> {
        SHIPPED.iter().find(|(shipped, _)| *shipped == name).map(|(_, text)| *text)
    }

    /// The names of all scenes that come with the program.
    pub fn built_in_names() -> impl Iterator<Item = &'static str> {
        SHIPPED.iter().map(|(name, _)| *name)
    }
}
