//! What became of one exposure, as it leaves the pairing.

use super::{Analysis, Frame, Loss, PairState};
use sofiscope_hal::{Channel, ExposureIndex};

/// One camera's side of an exposure.
#[derive(Debug, Clone)]
pub enum Side {
    /// The frame is here.
    Frame(Frame),
    /// The frame is lost, and why; with its facts if it had come so far as to have any.
    Lost(Loss, Option<super::FrameFacts>),
}

impl Side {
    /// The frame, if there is one.
    #[must_use]
    pub fn frame(&self) -> Option<&Frame> {
        match self {
            Self::Frame(frame) => Some(frame),
            Self::Lost(..) => None,
        }
    }
}

/// Both sides of one exposure; every exposure since arming comes once, in order.
#[derive(Debug, Clone)]
pub struct ExposureRecord {
    /// The exposure.
    pub exposure: ExposureIndex,
    /// The sides in the order R, T.
    pub sides: [Side; 2],
    /// Whether the two frames make a pair.
    pub pair: PairState,
    /// Whether the pair went to the live analysis.
    pub analysis: Analysis,
}

impl ExposureRecord {
    /// The side of one camera.
    #[must_use]
    pub fn side(&self, channel: Channel) -> &Side {
        &self.sides[channel.index()]
    }
}
