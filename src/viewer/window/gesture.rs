//! What a person does in one go is undone in one go: a drag from press to release, a turn of the wheel.
//!
//! In: the input of every look. Out: whether a change belongs to the one before. Never: keeps a view. Fails: not at all.

use egui::InputState;

/// Turns of the wheel that follow each other this closely are one, seconds.
const PAUSE: f64 = 0.6;

/// The last change and what it came from.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Origin {
    Press(u64),
    Wheel(f64),
}

/// Tells changes of one gesture from others.
#[derive(Debug, Default)]
pub(super) struct Gestures {
    presses: u64,
    last: Option<Origin>,
}

impl Gestures {
    /// To be called once for every look, before anything changes.
    pub(super) fn look(&mut self, input: &InputState) {
        self.presses += u64::from(input.pointer.any_pressed());
    }

    /// Called when something changes: whether that belongs to the change before.
    pub(super) fn goes_on(&mut self, input: &InputState) -> bool {
        let is_held = input.pointer.any_down() || input.pointer.any_released();
        let turns = input.smooth_scroll_delta() != egui::Vec2::ZERO || input.zoom_delta() != 1.0;
        let origin = match (is_held, turns) {
            (true, _) => Some(Origin::Press(self.presses)),
            (false, true) => Some(Origin::Wheel(input.time)),
            (false, false) => None,
        };
        let before = std::mem::replace(&mut self.last, origin);
        match (before, origin) {
            (Some(Origin::Press(before)), Some(Origin::Press(now))) => before == now,
            (Some(Origin::Wheel(before)), Some(Origin::Wheel(now))) => now - before < PAUSE,
            _ => false,
        }
    }

    /// Whatever comes next is something new.
    pub(super) fn end(&mut self) {
        self.last = None;
    }
}
