//! Where the pixels come from.
//!
//! In: channel, region and exposure. Out: counts of the region, row by row, in the caller's memory.
//! Never: allocates after it was made, but for the first frame of a sample that has moved. Fails: never; exposures beyond the end are not asked for.

use std::sync::Arc;

use sofiscope_hal::{Channel, ExposureIndex, Region};

use super::Film;
use super::stage::SamplePlace;
use crate::World;

/// What the cameras look at.
#[derive(Debug, Clone)]
pub enum Source {
    /// A sample, rendered frame by frame; ends after the frames of its scene.
    World(Arc<World>),
    /// The same without end: after the frames of its scene the sample is there anew, with all its dyes.
    Again(Arc<World>),
    /// Frames in memory, shown over and over without end.
    Film(Arc<Film>),
}

impl From<World> for Source {
    fn from(world: World) -> Self {
        Self::World(Arc::new(world))
    }
}

impl From<Film> for Source {
    fn from(film: Film) -> Self {
        Self::Film(Arc::new(film))
    }
}

impl Source {
    /// Rows and columns of the sensor.
    pub(super) fn size(&self) -> [usize; 2] {
        match self {
            Self::World(world) | Self::Again(world) => [world.scene().height_px(), world.scene().width_px()],
            Self::Film(film) => [film.height(), film.width()],
        }
    }

    /// Exposures until there is nothing more to see.
    pub(super) fn end(&self) -> u64 {
        match self {
            Self::World(world) => world.scene().frames(),
            Self::Again(_) | Self::Film(_) => u64::MAX,
        }
    }

    /// The most counts a pixel of one camera can give.
    pub(super) fn saturation_counts(&self, channel: Channel) -> u16 {
        match self {
            Self::World(world) | Self::Again(world) => {
                world.scene().cameras()[channel.index()].saturation_counts
            }
            Self::Film(_) => u16::MAX,
        }
    }
}

/// One camera's view of the source, with all memory that it takes.
#[derive(Debug)]
pub(super) struct Viewfinder {
    source: Source,
    channel: Channel,
    region: Region,
    place: SamplePlace,
    photons: Vec<f32>,
    /// The whole sensor, where only a part of it is wanted.
    sensor: Vec<u16>,
}

impl Viewfinder {
    pub(super) fn new(source: Source, channel: Channel, region: Region, place: SamplePlace) -> Self {
        let [height, width] = source.size();
        let rendered = !matches!(source, Source::Film(_));
        let cut = region.num_pixels() != height * width;
        let photons = vec![0.0; if rendered { height * width } else { 0 }];
        let sensor = vec![0; if rendered && cut { height * width } else { 0 }];
        Self { source, channel, region, place, photons, sensor }
    }

    /// Pixels of one frame.
    pub(super) fn num_pixels(&self) -> usize {
        self.region.num_pixels()
    }

    /// Writes what the camera sees in one exposure.
    pub(super) fn expose(&mut self, exposure: ExposureIndex, counts: &mut [u16]) {
        let [height, width] = self.source.size();
        match &self.source {
            Source::Film(film) => cut(film.frame(self.channel, exposure), width, self.region, counts),
            Source::World(world) | Source::Again(world) => {
                let frames = world.scene().frames();
                let exposure = match &self.source {
                    Source::Again(_) => ExposureIndex(exposure.0 % frames.max(1)),
                    _ => exposure,
                };
                let (columns, rows) = self.place.shift_px(world.scene().optics().pixel_pitch_nm);
                let is_moved = (columns, rows) != (0, 0);
                if is_moved && self.sensor.is_empty() {
                    self.sensor = vec![0; height * width];
                }
                let whole = self.sensor.is_empty();
                let sensor = if whole { &mut *counts } else { &mut self.sensor[..] };
                world
                    .frame_through(self.channel, exposure, &mut self.photons, sensor)
                    .expect("memory has the size of the sensor and no one asks beyond the end");
                if is_moved {
                    let turn = |by: i64, length: usize| by.rem_euclid(length.max(1) as i64) as usize;
                    self.sensor.rotate_left(turn(rows, height) * width);
                    let columns = turn(columns, width);
                    self.sensor.chunks_exact_mut(width).for_each(|row| row.rotate_left(columns));
                }
                if !whole {
                    cut(&self.sensor, width, self.region, counts);
                }
            }
        }
    }
}

/// Copies a region of a sensor that is `width` columns wide.
fn cut(sensor: &[u16], width: usize, region: Region, counts: &mut [u16]) {
    if counts.len() == sensor.len() {
        counts.copy_from_slice(sensor);
        return;
    }
    let (left, columns) = (region.left as usize, region.width as usize);
    let rows = sensor.chunks_exact(width).skip(region.top as usize);
    for (row, counts) in rows.zip(counts.chunks_exact_mut(columns)) {
        counts.copy_from_slice(&row[left..left + columns]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_region_is_cut_out_of_the_sensor() {
        let film = Film::noise(9, 12, 2, 3);
        let region = Region { left: 4, top: 2, width: 3, height: 5 };
        let mut view =
            Viewfinder::new(Source::from(film.clone()), Channel::Transmitted, region, SamplePlace::default());
        let mut counts = vec![0; view.num_pixels()];
        view.expose(ExposureIndex(3), &mut counts);
        let sensor = film.frame(Channel::Transmitted, ExposureIndex(1));
        for y in 0..5 {
            for x in 0..3 {
                assert_eq!(counts[y * 3 + x], sensor[(y + 2) * 12 + x + 4]);
            }
        }
    }
}
