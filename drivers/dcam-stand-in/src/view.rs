//! What a camera of 2048 x 2048 pixels sees: the scene in the middle of the sensor, darkness around it.
//!
//! In: the text of a scene, channel, exposure, region. Out: counts. Never: looks at a clock; both cameras see one
//! world. Fails: when the scene is none.

use sofiscope_hal::{Channel, ExposureIndex};
use sofiscope_sim::{Scene, World};

use crate::settings::Region;
use crate::spec::SIDE;

/// Offset of the camera where no light comes, counts (ORCA-Flash4.0 V2).
const OFFSET: u16 = 100;

/// One world and memory to look at it.
#[derive(Debug)]
pub(crate) struct View {
    world: World,
    scratch: Vec<u16>,
}

impl View {
    /// A scene by the text of its file.
    pub(crate) fn of(text: &str) -> Result<Self, String> {
        let scene = Scene::from_toml(text).map_err(|error| error.to_string())?;
        let scratch = vec![0; scene.num_pixels()];
        Ok(Self { world: World::new(&scene, scene.seed()), scratch })
    }

    /// A scene by the name of one that comes with the program, or by the path of its file.
    pub(crate) fn named(name: &str) -> Result<Self, String> {
        if let Some(text) = Scene::built_in(name) {
            return Self::of(text);
        }
        let text = std::fs::read_to_string(name).map_err(|error| format!("{name}: {error}"))?;
        Self::of(&text)
    }

    /// Writes one frame; the scene begins anew after its end.
    pub(crate) fn expose(&mut self, channel: Channel, exposure: u64, region: Region, counts: &mut [u16]) {
        let (width, height) = (self.world.scene().width_px(), self.world.scene().height_px());
        let frame = ExposureIndex(exposure % self.world.scene().frames());
        let seen = self.world.frame(channel, frame, &mut self.scratch).is_ok();
        let (left, top) =
            ((SIDE as usize).saturating_sub(width) / 2, (SIDE as usize).saturating_sub(height) / 2);
        let columns = region.width as usize;
        for (row, counts) in counts.chunks_exact_mut(columns).enumerate() {
            let y = region.top as usize + row;
            for (column, count) in counts.iter_mut().enumerate() {
                let x = region.left as usize + column;
                let inside = seen && (left..left + width).contains(&x) && (top..top + height).contains(&y);
                *count = if inside {
                    self.scratch[(y - top) * width + x - left]
                } else {
                    OFFSET - 3 + noise(channel, exposure, x, y)
                };
            }
        }
    }
}

/// Noise from 0 to 7 counts that depends on place and exposure only.
fn noise(channel: Channel, exposure: u64, x: usize, y: usize) -> u16 {
    let place = (y as u64) << 32 | (x as u64) << 8 | channel.index() as u64;
    let mixed = (place ^ exposure.wrapping_mul(0x9E37_79B9_7F4A_7C15)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    (mixed >> 61) as u16
}
