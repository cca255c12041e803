//! What the person did and wished for, carried out.
//!
//! In: what was done in the panes, wishes of the panels. Out: another view, commands. Never: waits. Fails: not at all;
//! what is refused is said.

use super::Window;
use crate::viewer::as_seen::AsSeen;
use crate::viewer::bench::{Activity, BenchCommand, BenchStatus, Pictures};
use crate::viewer::canvas::Done;
use crate::viewer::panels::{self, Own, Wishes};
use crate::viewer::presets::Preset;
use crate::viewer::settings::{Below, WindowSettings};
use egui::Ui;
use std::time::Instant;

impl Window {
    /// What the person did in the panes.
    pub(super) fn take_up(&mut self, ui: &Ui, done: Done, status: &BenchStatus, pictures: &Pictures) {
        let mut view = self.history.view();
        view.zoom = done.zoom.unwrap_or(view.zoom);
        view.split = done.split.or(view.split);
        self.change(ui, view);
        if let Some(line) = done.line_um {
            self.line_um = Some(line);
            self.settings.below = Below::Profile;
        }
        let pitch_um = pictures.cameras.as_ref().map(|look| look.pixel_pitch_nm / 1e3);
        if let (Some(rectangle), Some(pitch_um)) = (done.rectangle_um, pitch_um) {
            let [left, top, width, height] = rectangle.map(|um| (um / pitch_um).max(0.0).round() as u32);
            let corner = self.live_corner;
            if self.marks_regions() {
                self.forms.colors.draw(Some([corner[0] + left, corner[1] + top, width, height]));
            } else if width > 3 && height > 3 && status.activity != Activity::Run {
                self.forms.live.settings.region = Some([corner[0] + left, corner[1] + top, width, height]);
            }
        }
        if done.rectangle_um.is_none() {
            self.forms.colors.draw(None);
        }
        if let (Some(center), Some(stage), Some(look), Some(pitch_um)) =
            (done.center_um, status.stage, &pictures.cameras, pitch_um)
        {
            let middle = [look.width, look.height].map(|pixels| 0.5 * pixels as f64 * pitch_um);
            let command = BenchCommand::MoveStage {
                x_um: stage.x_um + center[0] - middle[0],
                y_um: stage.y_um + center[1] - middle[1],
            };
            self.ask(command);
        }
        if let Some(reading) = done.reading {
            self.refused = Some((reading, Instant::now()));
        } else if self.refused.as_ref().is_some_and(|(text, _)| text.starts_with("x ")) {
            self.refused = None;
        }
    }

    pub(super) fn obey(&mut self, ui: &Ui, wishes: Wishes, status: &BenchStatus, pictures: &Pictures) {
        if wishes.stop {
            self.bench.stop();
        }
        for command in wishes.commands {
            self.ask(command);
        }
        for own in wishes.own {
            self.obey_own(ui, own, status, pictures);
        }
    }

    fn obey_own(&mut self, ui: &Ui, own: Own, status: &BenchStatus, pictures: &Pictures) {
        match own {
            Own::JudgePlan => self.judge_plan(),
            Own::CheckAndRun => {
                // What is to be warned of has been read when it is wanted once more.
                let is_wanted_again = self.forms.plan.may_begin();
                if is_wanted_again.is_none() {
                    self.judge_plan();
                }
                if is_wanted_again.unwrap_or(self.forms.plan.is_clear()) {
                    let command = self.forms.plan.begin(status);
                    self.ask(command);
                }
            }
            Own::Save if status.instrument.is_some() => {
                self.ask(BenchCommand::SaveResults(panels::suggested("sofiscope-images").into()));
            }
            Own::Save => {}
            Own::SavePicture => self.keep_picture(pictures),
            Own::KeepPreset(name) => {
                let (live, view) = (&self.forms.live.settings, self.history.view());
                self.presets.keep(Preset::of(name, live, self.forms.lasers.powers(), &view));
            }
            Own::UsePreset(name) => self.use_preset(ui, &name),
            Own::RemovePreset(name) => self.presets.remove(&name),
            Own::ResetLayout => {
                let is_dark = self.settings.is_dark;
                self.settings = WindowSettings { is_dark, ..WindowSettings::default() };
            }
            Own::Shortcuts => self.shows_shortcuts = true,
        }
    }

    fn ask(&mut self, command: BenchCommand) {
        let corner = match &command {
            BenchCommand::Live(settings) => {
                settings.region.map(|[left, top, ..]| [left, top]).or(Some([0; 2]))
            }
            _ => None,
        };
        match self.bench.ask(command) {
            Ok(()) => self.live_corner = corner.unwrap_or(self.live_corner),
            Err(refused) => self.refused = Some((refused.to_string(), Instant::now())),
        }
    }

    fn judge_plan(&mut self) {
        let judgment = self.bench.judge_plan(&self.forms.plan.text);
        self.forms.plan.judged = Some((self.forms.plan.text.clone(), judgment));
    }

    /// The result's pane as it is seen, into a file.
    fn keep_picture(&mut self, pictures: &Pictures) {
        let Some(request) = self.result.shown().cloned() else {
            self.refused =
                Some(("there is no image yet; start the live view first".to_owned(), Instant::now()));
            return;
        };
        let label = match (&pictures.sofi, &pictures.cameras) {
            (Some(sofi), _) if self.history.view().shows_result() => sofi.label.clone(),
            (_, Some(look)) => format!("exposure {}", look.exposure),
            (_, None) => String::new(),
        };
        let path = panels::suggested_file("sofiscope-picture", "png").into();
        if let Err(refused) = self.bench.keep_picture(AsSeen { request, label, path }) {
            self.refused = Some((refused.to_string(), Instant::now()));
        }
    }

    /// Settings of a preset; no laser line is armed by it.
    fn use_preset(&mut self, ui: &Ui, name: &str) {
        let Some(preset) = self.presets.named(name).cloned() else { return };
        self.forms.lasers.disarm_with(&preset.powers_mw);
        let view = preset.view(self.history.view());
        self.forms.live.settings = preset.live;
        self.change(ui, view);
    }
}
