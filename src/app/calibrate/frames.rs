//! Frames that a calibration reads more than once, from a stack or from memory.
//!
//! In: a stack, or frames that were kept. Out: [`Frames`]. Never: copies frames that are in memory already.
//! Fails: [`AppError`] of the files.

use crate::app::AppError;
use crate::files::ImageStack;
use std::sync::Arc;

/// Frames of one camera, read one after another and again from the beginning.
pub(in crate::app) trait Frames {
    /// Height and width, pixels.
    fn size(&self) -> [usize; 2];

    /// The next frame that is read is the first one.
    fn rewind(&mut self) -> Result<(), AppError>;

    /// Reads the next frame; false when there is none.
    fn read_counts(&mut self, counts: &mut [u16]) -> Result<bool, AppError>;
}

impl Frames for ImageStack {
    fn size(&self) -> [usize; 2] {
        [self.info().height, self.info().width]
    }

    fn rewind(&mut self) -> Result<(), AppError> {
        Ok(self.seek(0)?)
    }

    fn read_counts(&mut self, counts: &mut [u16]) -> Result<bool, AppError> {
        Ok(ImageStack::read_counts(self, counts)?)
    }
}

/// Frames in memory.
#[derive(Debug, Clone)]
pub(in crate::app) struct KeptFrames {
    size: [usize; 2],
    frames: Vec<Arc<Vec<u16>>>,
    next: usize,
}

impl KeptFrames {
    /// None yet, of `size` `[height, width]`.
    pub(in crate::app) fn new(size: [usize; 2]) -> Self {
        Self { size, frames: Vec::new(), next: 0 }
    }

    /// One more; false, and not kept, where it has another size.
    pub(in crate::app) fn push(&mut self, frame: Arc<Vec<u16>>) -> bool {
        let fits = frame.len() == self.size[0] * self.size[1];
        if fits {
            self.frames.push(frame);
        }
        fits
    }
}

impl Frames for KeptFrames {
    fn size(&self) -> [usize; 2] {
        self.size
    }

    fn rewind(&mut self) -> Result<(), AppError> {
        self.next = 0;
        Ok(())
    }

    fn read_counts(&mut self, counts: &mut [u16]) -> Result<bool, AppError> {
        let Some(frame) = self.frames.get(self.next) else { return Ok(false) };
        counts.copy_from_slice(frame);
        self.next += 1;
        Ok(true)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kept_frames_come_in_order_and_again() {
        let mut kept = KeptFrames::new([1, 2]);
        assert!(kept.push(Arc::new(vec![1, 2])) && kept.push(Arc::new(vec![3, 4])));
        assert!(!kept.push(Arc::new(vec![5])), "another size");
        let mut counts = [0; 2];
        for _ in 0..2 {
            kept.rewind().unwrap();
            assert!(kept.read_counts(&mut counts).unwrap());
            assert_eq!(counts, [1, 2]);
            assert!(kept.read_counts(&mut counts).unwrap());
            assert_eq!(counts, [3, 4]);
            assert!(!kept.read_counts(&mut counts).unwrap());
        }
    }
}
