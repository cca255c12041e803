//! Frames rendered once and shown over and over, for runs longer or faster than the world can be rendered.
//!
//! In: a world, or a size and a seed. Out: the frames of both cameras, exposure `k` showing frame `k` modulo
//! the length. Never: changes after it was made. Fails: [`WorldError`] for more frames than the scene has.

use rand::Rng;
use sofiscope_hal::{Channel, ExposureIndex};

use crate::random::Stream;
use crate::{World, WorldError};

/// A loop of frames of both cameras.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Film {
    height: usize,
    width: usize,
    counts: [Vec<u16>; 2],
}

impl Film {
    /// The first frames of a world, rendered on the current rayon threads.
    ///
    /// # Errors
    /// [`WorldError::BeyondEnd`] when the scene has fewer frames.
    ///
    /// # Panics
    /// When `frames` is 0.
    pub fn render(world: &World, frames: usize) -> Result<Self, WorldError> {
        assert!(frames > 0, "a film has at least one frame");
        let (height, width) = (world.scene().height_px(), world.scene().width_px());
        let last = frames as u64 - 1;
        if last >= world.scene().frames() {
            return Err(WorldError::BeyondEnd { exposure: last, frames: world.scene().frames() });
        }
        let mut reflected = vec![0; frames * height * width];
        let mut transmitted = reflected.clone();
        world.render_block(0..frames as u64, &mut reflected, &mut transmitted)?;
        Ok(Self { height, width, counts: [reflected, transmitted] })
    }

    /// Frames of uniform noise from 0 to 4095 counts, different in every frame and camera.
    ///
    /// # Panics
    /// When a side or the number of frames is 0.
    #[must_use]
    pub fn noise(height: usize, width: usize, frames: usize, seed: u64) -> Self {
        assert!(height > 0 && width > 0 && frames > 0, "a film has pixels and frames");
        let counts = Channel::BOTH.map(|channel| {
            let mut counts = vec![0; frames * height * width];
            for (frame, counts) in counts.chunks_exact_mut(height * width).enumerate() {
                let stream = Stream::Film { channel: channel.index() as u64, frame: frame as u64 };
                let mut rng = stream.generator(seed);
                counts.fill_with(|| (rng.next_u64() >> 52) as u16);
            }
            counts
        });
        Self { height, width, counts }
    }

    /// Rows of a frame.
    #[must_use]
    pub fn height(&self) -> usize {
        self.height
    }

    /// Columns of a frame.
    #[must_use]
    pub fn width(&self) -> usize {
        self.width
    }

    /// Frames until the film begins again.
    #[must_use]
    pub fn frames(&self) -> usize {
        self.counts[0].len() / (self.height * self.width)
    }

    /// The counts that a camera sees in one exposure, row by row.
    #[must_use]
    pub fn frame(&self, channel: Channel, exposure: ExposureIndex) -> &[u16] {
        let num_pixels = self.height * self.width;
        let frame = (exposure.0 % self.frames() as u64) as usize;
        &self.counts[channel.index()][frame * num_pixels..(frame + 1) * num_pixels]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_differs_between_frames_and_cameras_and_begins_again() {
        let film = Film::noise(8, 10, 3, 7);
        let at = |channel, exposure| film.frame(channel, ExposureIndex(exposure));
        assert_ne!(at(Channel::Reflected, 0), at(Channel::Reflected, 1));
        assert_ne!(at(Channel::Reflected, 0), at(Channel::Transmitted, 0));
        assert_eq!(at(Channel::Reflected, 1), at(Channel::Reflected, 3_000_001));
        assert_eq!(film, Film::noise(8, 10, 3, 7));
        assert!(at(Channel::Transmitted, 2).iter().all(|&count| count < 4096));
    }
}
