//! Named settings that outlive the session: how the live view is taken, powers, contrast, colors.
//!
//! In: settings under a name. Out: [`Presets`], to be stored. Never: arms a laser line: a preset knows powers, and a
//! person arms the line again. Fails: not at all; what is out of range on this instrument is refused where it is used.

use super::bench::LiveSettings;
use super::view::View;
use crate::display::{Colormap, Contrast};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Settings under a name.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Preset {
    /// Its name.
    pub name: String,
    /// How the live view is taken; without light.
    pub live: LiveSettings,
    /// Powers of the laser lines, milliwatts by nanometers.
    pub powers_mw: BTreeMap<u32, f64>,
    /// Contrast of cameras, of results, and of composites.
    pub contrasts: [Contrast; 3],
    /// Colors of single images.
    pub colormap: Colormap,
}

impl Preset {
    /// Settings of the moment under a name.
    #[must_use]
    pub fn of(name: String, live: &LiveSettings, powers_mw: BTreeMap<u32, f64>, view: &View) -> Self {
        let live = LiveSettings { laser_power_mw: BTreeMap::new(), ..live.clone() };
        Self { name, live, powers_mw, contrasts: view.contrasts, colormap: view.colormap }
    }

    /// A view with contrast and colors of the preset.
    #[must_use]
    pub fn view(&self, view: View) -> View {
        View { contrasts: self.contrasts, colormap: self.colormap, ..view }
    }
}

/// All presets, in the order in which they were kept.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Presets(Vec<Preset>);

impl Presets {
    /// Every preset.
    pub fn iter(&self) -> impl Iterator<Item = &Preset> {
        self.0.iter()
    }

    /// The preset of a name.
    #[must_use]
    pub fn named(&self, name: &str) -> Option<&Preset> {
        self.0.iter().find(|preset| preset.name == name)
    }

    /// Keeps a preset; one of the same name is replaced.
    pub fn keep(&mut self, preset: Preset) {
        match self.0.iter_mut().find(|other| other.name == preset.name) {
            Some(other) => *other = preset,
            None => self.0.push(preset),
        }
    }

    /// Forgets the preset of a name.
    pub fn remove(&mut self, name: &str) {
        self.0.retain(|preset| preset.name != name);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_preset_carries_no_light_and_is_replaced_by_its_name() {
        let bright =
            LiveSettings { order: 3, laser_power_mw: [(488, 5.0)].into(), ..LiveSettings::default() };
        let view = View::default();
        let mut presets = Presets::default();
        presets.keep(Preset::of("cells".to_owned(), &bright, [(488, 5.0)].into(), &view));
        assert_eq!(presets.named("cells").unwrap().live.laser_power_mw, BTreeMap::new());
        presets.keep(Preset::of("cells".to_owned(), &LiveSettings::default(), BTreeMap::new(), &view));
        assert_eq!(presets.iter().map(|preset| preset.live.order).collect::<Vec<_>>(), [2]);
        presets.remove("cells");
        assert_eq!(presets, Presets::default());
    }
}
