//! What the virtual cameras see: the simulated sample, where the stage has brought it, in the light that the gates
//! let through, as sharp as the focus.

use sofiscope_hal::{Channel, ExposureIndex};
use sofiscope_sim::World;
use sofiscope_virtual::gige::Exposure;
use sofiscope_virtual::table::{LINES, OpticalTable, Quantity};
use std::sync::Arc;
use std::time::Duration;

/// Counts of a pixel in the dark.
const DARK_COUNTS: u16 = 100;
/// The gates open with the pulse that begins an exposure; this long is waited for light.
const LIGHT_COMES_WITHIN: Duration = Duration::from_millis(4);
/// Focus error that blurs by one more pixel.
const BLUR_NM_PER_PIXEL: f64 = 400.0;
/// The place of the stage at which the sample is in the middle of the image.
const HOME_UM: [f64; 2] = [0.0, 0.0];

/// One camera's view of the sample.
pub(super) struct View {
    pub(super) world: Arc<World>,
    pub(super) channel: Channel,
    pub(super) table: OpticalTable,
    pub(super) pixel_pitch_nm: f64,
    pub(super) whole: Vec<u16>,
    pub(super) blurred: Vec<u16>,
}

impl View {
    pub(super) fn new(world: Arc<World>, channel: Channel, table: OpticalTable, pixel_pitch_nm: f64) -> Self {
        let num_pixels = world.scene().num_pixels();
        Self {
            world,
            channel,
            table,
            pixel_pitch_nm,
            whole: vec![0; num_pixels],
            blurred: vec![0; num_pixels],
        }
    }

    /// Fills the counts of one exposure.
    pub(super) fn expose(&mut self, exposure: &Exposure, counts: &mut [u16]) {
        counts.fill(DARK_COUNTS);
        if !self.light_comes() {
            return;
        }
        let scene = self.world.scene();
        let index = ExposureIndex(exposure.index % scene.frames().max(1));
        if self.world.frame(self.channel, index, &mut self.whole).is_err() {
            return;
        }
        let (width, height) = (scene.width_px(), scene.height_px());
        let error = self.table.focus_error_nm(sofiscope_virtual::monotonic()).abs();
        for _ in 0..((error / BLUR_NM_PER_PIXEL) as usize).min(8) {
            blur(&self.whole, &mut self.blurred, width);
            std::mem::swap(&mut self.whole, &mut self.blurred);
        }
        let shift = |quantity, home: f64| -> i64 {
            ((self.table.get(quantity) - home) * 1000.0 / self.pixel_pitch_nm).round() as i64
        };
        let (dx, dy) = (shift(Quantity::StageX, HOME_UM[0]), shift(Quantity::StageY, HOME_UM[1]));
        for row in 0..exposure.height as usize {
            let y = (exposure.top as usize + row) as i64 + dy;
            let Some(y) = usize::try_from(y).ok().filter(|y| *y < height) else { continue };
            for column in 0..exposure.width as usize {
                let x = (exposure.left as usize + column) as i64 + dx;
                if let Some(x) = usize::try_from(x).ok().filter(|x| *x < width) {
                    counts[row * exposure.width as usize + column] = self.whole[y * width + x];
                }
            }
        }
    }

    /// Whether any line reaches the sample, now or in a moment.
    fn light_comes(&self) -> bool {
        let begun = sofiscope_virtual::monotonic();
        loop {
            if (0..LINES).any(|line| self.table.light_mw(line) > 0.0) {
                return true;
            }
            if sofiscope_virtual::monotonic() >= begun + LIGHT_COMES_WITHIN {
                return false;
            }
            // Nothing will ever come: this is a pause between two looks.
            let _ = crossbeam_channel::after(Duration::from_micros(300)).recv();
        }
    }
}

/// Mean of each pixel with its neighbors above, below, left and right; edges stay as they are.
fn blur(from: &[u16], to: &mut [u16], width: usize) {
    to.copy_from_slice(from);
    let rows = from.len() / width.max(1);
    for row in 1..rows.saturating_sub(1) {
        let begin = row * width;
        for (column, mean) in to[begin..begin + width].iter_mut().enumerate().take(width - 1).skip(1) {
            let at = begin + column;
            let sum: u32 =
                [at, at - 1, at + 1, at - width, at + width].iter().map(|&at| u32::from(from[at])).sum();
            *mean = u16::try_from(sum / 5).unwrap_or(u16::MAX);
        }
    }
}
