//! Everything frequent has a key.
//!
//! In: keys. Out: wishes, other views. Never: takes a key from a field that is typed in, but for STOP.
//! Fails: not at all.

use super::Window;
use crate::reconstruction::SofiStage;
use crate::viewer::bench::{Activity, BenchCommand, BenchStatus};
use crate::viewer::panels::{Own, Wishes};
use crate::viewer::settings::Side;
use crate::viewer::view::{Subject, View};
use egui::{Key, Modifiers, RichText, Ui};

/// Longest time between two Escapes that are a STOP.
const TWICE: f64 = 1.0;
/// Keys and what they do, as the list shows them.
pub const SHORTCUTS: [(&str, &str); 19] = [
    ("Ctrl+.  or Esc Esc", "STOP: lasers off, motion stopped, run aborted"),
    ("L", "Live"),
    ("Ctrl+Enter", "Check the plan and run it"),
    ("F", "Finish in good order"),
    ("P", "Hold a run or replay, and go on"),
    ("S", "Save images as data"),
    ("E", "Save the image as it is seen"),
    ("1 ... 5", "Show mean, cumulants, unmixed, flattened, linearized"),
    ("R, T, O", "Show camera R, camera T, both on each other"),
    ("C", "Cameras beside the result on and off"),
    ("M", "Compare with the mean image"),
    ("A", "Contrast by percentiles again"),
    ("Scroll, drag", "Zoom at the pointer, move the image"),
    ("Double click", "Whole image"),
    ("Shift+drag", "Line profile"),
    ("Ctrl+drag in a camera", "Region of the cameras"),
    ("Right click", "Bring this place to the middle with the stage"),
    ("Ctrl+Z, Ctrl+Y", "Undo and redo view and contrast"),
    ("Ctrl+Q", "Leave; a run is asked about"),
];

impl Window {
    pub(super) fn keys(&mut self, ui: &Ui, status: &BenchStatus, wishes: &mut Wishes) {
        let context = ui.ctx().clone();
        let (now, escape, dot) = context.input_mut(|input| {
            let dot = input.consume_key(Modifiers::COMMAND, Key::Period);
            (input.time, input.key_pressed(Key::Escape), dot)
        });
        if escape {
            wishes.stop |= self.escaped.is_some_and(|before| now - before < TWICE);
            self.escaped = if wishes.stop { None } else { Some(now) };
        }
        wishes.stop |= dot;
        if context.egui_wants_keyboard_input() {
            return;
        }
        let pressed =
            |modifiers: Modifiers, key: Key| context.input_mut(|input| input.consume_key(modifiers, key));
        let plain = |key: Key| pressed(Modifiers::NONE, key);
        if pressed(Modifiers::COMMAND, Key::Enter) && status.instrument.is_some() {
            // The plan is shown with what there is to say of it.
            self.settings.side = Side::Plan;
            wishes.own.push(Own::CheckAndRun);
        }
        if pressed(Modifiers::COMMAND, Key::Z) {
            self.undo();
        }
        if pressed(Modifiers::COMMAND, Key::Y) {
            self.redo();
        }
        if plain(Key::F1) || plain(Key::Questionmark) {
            self.shows_shortcuts = !self.shows_shortcuts;
        }
        if plain(Key::L) && status.instrument.is_some() {
            wishes.ask(BenchCommand::Live(self.forms.live.settings.clone()));
        }
        if plain(Key::F) {
            wishes.ask(BenchCommand::Finish);
        }
        if plain(Key::P) {
            wishes.commands.extend(hold_or_go_on(status));
        }
        if plain(Key::E) {
            wishes.own.push(Own::SavePicture);
        }
        if plain(Key::S) {
            wishes.own.push(Own::Save);
        }
        if plain(Key::C) {
            self.settings.shows_cameras = !self.settings.shows_cameras;
        }
        let view = self.history.view();
        let mut next = view;
        for (key, stage) in
            [Key::Num1, Key::Num2, Key::Num3, Key::Num4, Key::Num5].into_iter().zip(SofiStage::ALL)
        {
            if plain(key) {
                next.subject = Subject::Composite(stage);
            }
        }
        for (key, subject) in
            [(Key::R, Subject::Camera(0)), (Key::T, Subject::Camera(1)), (Key::O, Subject::Overlay)]
        {
            if plain(key) {
                next.subject = subject;
            }
        }
        if plain(Key::M) {
            next.split = if view.split.is_some() { None } else { Some(0.5) };
        }
        if plain(Key::A) {
            next.contrasts[view.contrast_index()] = View::default().contrasts[view.contrast_index()];
        }
        if next != view {
            self.gestures.end();
            self.history.set(next, false);
        }
    }

    pub(super) fn list_shortcuts(&mut self, ui: &Ui) {
        let mut is_open = self.shows_shortcuts;
        egui::Window::new("Keyboard shortcuts").open(&mut is_open).resizable(false).show(ui.ctx(), |ui| {
            egui::Grid::new("shortcuts").striped(true).show(ui, |ui| {
                for (keys, what) in SHORTCUTS {
                    ui.label(RichText::new(keys).monospace());
                    ui.label(what);
                    ui.end_row();
                }
            });
        });
        self.shows_shortcuts = is_open;
    }
}

fn hold_or_go_on(status: &BenchStatus) -> Option<BenchCommand> {
    let is_held = status.replay.as_ref().is_some_and(|replay| replay.is_paused);
    match status.activity {
        Activity::Run => Some(BenchCommand::Pause),
        Activity::Replay if !is_held => Some(BenchCommand::Pause),
        Activity::Paused | Activity::Replay => Some(BenchCommand::Resume),
        _ => None,
    }
}
