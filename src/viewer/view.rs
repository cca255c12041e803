//! What is shown and how: image, zoom, contrast, colors; with undo.
//!
//! In: what a person changes. Out: a [`View`] for every pane. Never: keeps an image. Fails: not at all.

use crate::display::{Colormap, Contrast};
use crate::reconstruction::SofiStage;

/// Steps that can be undone.
const MOST_STEPS: usize = 100;

/// Which image.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Subject {
    /// Camera R (0) or T (1).
    Camera(usize),
    /// Both cameras on each other: R green, T magenta.
    Overlay,
    /// One image of a step.
    One(SofiStage, usize),
    /// All images of a step in their colors.
    Composite(SofiStage),
}

/// Where the image lies on the screen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Zoom {
    /// The place in the middle of the pane, micrometers from the corner of the image.
    pub center_um: [f64; 2],
    /// Points of the screen for a micrometer.
    pub scale: f64,
}

impl Zoom {
    /// Zooms so that what is under the pointer stays there; `offset` is the pointer's from the middle, points.
    #[must_use]
    pub fn about(self, offset: [f64; 2], factor: f64) -> Self {
        let scale = (self.scale * factor).clamp(0.05, 1e5);
        let shift = |axis: usize| offset[axis] * (1.0 / self.scale - 1.0 / scale);
        Self { center_um: [self.center_um[0] + shift(0), self.center_um[1] + shift(1)], scale }
    }

    /// Moves the image by points of the screen.
    #[must_use]
    pub fn moved(self, by: [f64; 2]) -> Self {
        let [x, y] = self.center_um;
        Self { center_um: [x - by[0] / self.scale, y - by[1] / self.scale], ..self }
    }
}

/// One way to look.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct View {
    /// What is shown.
    pub subject: Subject,
    /// Where; none for the whole image. All subjects and panes share it: its scale is relative to that of the whole
    /// image, as panes differ in size.
    pub zoom: Option<Zoom>,
    /// Contrast of cameras, of results, and of composites.
    pub contrasts: [Contrast; 3],
    /// Colors of single images.
    pub colormap: Colormap,
    /// Part of the pane that shows the mean image instead; none for no split.
    pub split: Option<f64>,
    /// Whether camera T is brought onto camera R where both are shown on each other.
    pub applies_registration: bool,
    /// Whether saturated pixels are marked, judged on raw counts.
    pub marks_saturation: bool,
}

impl Default for View {
    fn default() -> Self {
        Self {
            subject: Subject::Composite(SofiStage::Linearized),
            zoom: None,
            contrasts: [
                Contrast::Percentile { low: 0.5, high: 99.8 },
                Contrast::Percentile { low: 1.0, high: 99.8 },
                Contrast::FromZero { high: 99.7 },
            ],
            colormap: Colormap::Viridis,
            split: None,
            applies_registration: true,
            marks_saturation: true,
        }
    }
}

impl View {
    /// Which of the contrasts belongs to the subject.
    #[must_use]
    pub fn contrast_index(&self) -> usize {
        match self.subject {
            Subject::Camera(_) | Subject::Overlay => 0,
            Subject::One(..) => 1,
            Subject::Composite(_) => 2,
        }
    }

    /// Whether the subject is a result, which can be compared with the mean image.
    #[must_use]
    pub fn shows_result(&self) -> bool {
        matches!(self.subject, Subject::One(..) | Subject::Composite(_))
    }

    /// The contrast of the subject.
    #[must_use]
    pub fn contrast(&self) -> Contrast {
        self.contrasts[self.contrast_index()]
    }
}

/// The view, what it was before, and what was undone.
#[derive(Debug, Default)]
pub struct History {
    now: View,
    before: Vec<View>,
    undone: Vec<View>,
}

impl History {
    /// How it is now.
    #[must_use]
    pub fn view(&self) -> View {
        self.now
    }

    /// Changes it; `is_going_on` for steps of one drag or scroll, which are undone together.
    pub fn set(&mut self, view: View, is_going_on: bool) {
        if view == self.now {
            return;
        }
        if !is_going_on {
            self.before.push(self.now);
            let surplus = self.before.len().saturating_sub(MOST_STEPS);
            self.before.drain(..surplus);
        }
        self.undone.clear();
        self.now = view;
    }

    /// Takes the last change back.
    pub fn undo(&mut self) {
        if let Some(view) = self.before.pop() {
            self.undone.push(std::mem::replace(&mut self.now, view));
        }
    }

    /// Makes the last undone change again.
    pub fn redo(&mut self) {
        if let Some(view) = self.undone.pop() {
            self.before.push(std::mem::replace(&mut self.now, view));
        }
    }

    /// Whether there is something to undo, and to make again.
    #[must_use]
    pub fn can(&self) -> (bool, bool) {
        (!self.before.is_empty(), !self.undone.is_empty())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_under_the_pointer_stays_there() {
        let zoom = Zoom { center_um: [3.0, 4.0], scale: 50.0 };
        let offset = [120.0, -33.0];
        let place = |zoom: Zoom| [0, 1].map(|axis| zoom.center_um[axis] + offset[axis] / zoom.scale);
        let closer = zoom.about(offset, 1.7);
        for axis in 0..2 {
            assert!((place(zoom)[axis] - place(closer)[axis]).abs() < 1e-12);
        }
        let back = closer.about(offset, 1.0 / 1.7);
        assert!((back.center_um[0] - 3.0).abs() < 1e-9 && (back.scale - 50.0).abs() < 1e-9);
        assert_eq!(zoom.moved([50.0, 0.0]).center_um, [2.0, 4.0]);
    }

    #[test]
    fn changes_are_undone_one_by_one_and_drags_as_a_whole() {
        let mut history = History::default();
        let first = history.view();
        let with = |split: f64| View { split: Some(split), ..first };
        history.set(with(0.1), false);
        history.set(with(0.2), true);
        history.set(with(0.3), true);
        history.set(View { colormap: Colormap::Gray, ..with(0.3) }, false);
        history.undo();
        assert_eq!(history.view(), with(0.3));
        history.undo();
        assert_eq!(history.view(), first);
        assert_eq!(history.can(), (false, true));
        history.redo();
        assert_eq!(history.view(), with(0.3));
        history.set(with(0.5), false);
        history.redo();
        assert_eq!(history.view(), with(0.5), "a new change ends what was undone");
    }
}
