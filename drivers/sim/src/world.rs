//! One sample and both cameras, at any exposure in any order.
//!
//! In: a scene and a seed, then exposure indices.
//! Out: expected photons, counts, the ground truth.
//! Never: reads a clock or keeps state between calls; a frame depends on scene, seed and exposure only.
//! Fails: [`WorldError`] for exposures after the end of the scene and for memory of the wrong size.

use std::cell::RefCell;
use std::ops::Range;

use rayon::prelude::*;
use sofiscope_hal::{Channel, ExposureIndex};

use crate::blinking::{OnIntervals, on_fractions};
use crate::camera::{Digitizer, Generators};
use crate::emitters::{Emitter, Patch, place};
use crate::optics::{Spot, SpotPatterns};
use crate::random::Stream;
use crate::scene::{Photophysics, Scene};
use crate::sensor::Sensor;
use crate::truth::Truth;

/// Why the world gives no frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum WorldError {
    /// The sample is simulated up to the frames of its scene; take a scene with more frames, or start over.
    #[error("exposure {exposure} is beyond the {frames} frames of the scene")]
    BeyondEnd {
        /// The exposure asked for.
        exposure: u64,
        /// Frames of the scene.
        frames: u64,
    },
    /// The memory for the frames does not have their size.
    #[error("memory for {found} pixels was given where {expected} are needed")]
    WrongLength {
        /// Pixels needed.
        expected: usize,
        /// Pixels given.
        found: usize,
    },
}

/// A simulated sample under two cameras (paper, Materials and methods: Simulations).
#[derive(Debug)]
pub struct World {
    scene: Scene,
    seed: u64,
    emitters: Vec<Emitter>,
    patches: Vec<Patch>,
    activity: Activity,
    optical_paths: [OpticalPath; 2],
}

/// What one camera sees.
#[derive(Debug)]
struct OpticalPath {
    /// Background and everything that never blinks.
    steady: Vec<f32>,
    spots: SpotPatterns,
    digitizer: Digitizer,
}

/// Who shines how long in which exposure, sorted by exposure.
#[derive(Debug)]
struct Activity {
    /// `starts[k]..starts[k + 1]` are the entries of exposure `k`.
    starts: Vec<usize>,
    /// Emitter and on-fraction.
    entries: Vec<(u32, f32)>,
}

impl World {
    /// Places all emitters and draws when each of them shines; uses the current rayon threads.
    #[must_use]
    pub fn new(scene: &Scene, seed: u64) -> Self {
        let (emitters, patches) = place(scene, seed);
        let activity = Activity::new(&emitters, scene.frames(), seed);
        let optical_paths = Channel::BOTH.map(|channel| OpticalPath::new(scene, channel, &emitters));
        Self { scene: scene.clone(), seed, emitters, patches, activity, optical_paths }
    }

    /// The scene of this world.
    #[must_use]
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// The seed of this world.
    #[must_use]
    pub fn seed(&self) -> u64 {
        self.seed
    }

    /// The ground truth, to be stored beside the frames.
    #[must_use]
    pub fn truth(&self) -> Truth {
        Truth::new(self)
    }

    /// The pixels of a camera; none where all of them are alike.
    #[must_use]
    pub fn sensor(&self, channel: Channel) -> Option<&Sensor> {
        self.optical_paths[channel.index()].digitizer.sensor()
    }

    /// Expected photons per pixel that reach a camera in one exposure, before its quantum efficiency.
    ///
    /// # Errors
    /// [`WorldError::BeyondEnd`], and [`WorldError::WrongLength`] unless `photons` has one entry per pixel.
    pub fn photons_at(
        &self,
        channel: Channel,
        exposure: ExposureIndex,
        photons: &mut [f32],
    ) -> Result<(), WorldError> {
        self.check(exposure.0, 1, photons.len())?;
        self.light(channel, exposure, photons);
        Ok(())
    }

    /// One frame of one camera.
    ///
    /// # Errors
    /// [`WorldError::BeyondEnd`], and [`WorldError::WrongLength`] unless `counts` has one entry per pixel.
    pub fn frame(
        &self,
        channel: Channel,
        exposure: ExposureIndex,
        counts: &mut [u16],
    ) -> Result<(), WorldError> {
        self.check(exposure.0, 1, counts.len())?;
        self.expose(channel, exposure, counts);
        Ok(())
    }

    /// As [`Self::frame`], with the caller's memory for the photons, so that nothing is allocated.
    pub(crate) fn frame_through(
        &self,
        channel: Channel,
        exposure: ExposureIndex,
        photons: &mut [f32],
        counts: &mut [u16],
    ) -> Result<(), WorldError> {
        self.check(exposure.0, 1, counts.len())?;
        self.check(exposure.0, 1, photons.len())?;
        self.digitize(channel, exposure, photons, counts);
        Ok(())
    }

    /// The frames of both cameras for a range of exposures, one after the other, on the current rayon threads.
    ///
    /// The bytes are those of [`Self::frame`], whatever the number of threads.
    ///
    /// # Errors
    /// [`WorldError::BeyondEnd`], and [`WorldError::WrongLength`] unless both slices hold all pixels of the range.
    pub fn render_block(
        &self,
        exposures: Range<u64>,
        reflected: &mut [u16],
        transmitted: &mut [u16],
    ) -> Result<(), WorldError> {
        let Some(last) = exposures.end.checked_sub(1).filter(|&last| last >= exposures.start) else {
            self.check(0, 0, reflected.len())?;
            return self.check(0, 0, transmitted.len());
        };
        let number = exposures.end - exposures.start;
        self.check(last, number, reflected.len())?;
        self.check(last, number, transmitted.len())?;
        let num_pixels = self.scene.num_pixels();
        reflected
            .par_chunks_exact_mut(num_pixels)
            .zip(transmitted.par_chunks_exact_mut(num_pixels))
            .enumerate()
            .for_each(|(number, (reflected, transmitted))| {
                let exposure = exposures.start + number as u64;
                self.expose(Channel::Reflected, ExposureIndex(exposure), reflected);
                self.expose(Channel::Transmitted, ExposureIndex(exposure), transmitted);
            });
        Ok(())
    }

    pub(crate) fn emitters(&self) -> &[Emitter] {
        &self.emitters
    }

    pub(crate) fn patches(&self) -> &[Patch] {
        &self.patches
    }

    /// Checks the last exposure of a request and the memory for its frames.
    fn check(&self, last: u64, number: u64, found: usize) -> Result<(), WorldError> {
        let frames = self.scene.frames();
        if last >= frames {
            return Err(WorldError::BeyondEnd { exposure: last, frames });
        }
        let expected = (number as usize).saturating_mul(self.scene.num_pixels());
        if found == expected { Ok(()) } else { Err(WorldError::WrongLength { expected, found }) }
    }

    fn light(&self, channel: Channel, exposure: ExposureIndex, photons: &mut [f32]) {
        let path = &self.optical_paths[channel.index()];
        photons.copy_from_slice(&path.steady);
        for &(emitter, on_fraction) in self.activity.of(exposure) {
            path.spots.add(emitter as usize, on_fraction, photons, self.scene.width_px());
        }
    }

    fn expose(&self, channel: Channel, exposure: ExposureIndex, counts: &mut [u16]) {
        thread_local! {
            /// Photons of the frame in work; kept by each thread, so that frames need no new memory.
            static PHOTONS: RefCell<Vec<f32>> = const { RefCell::new(Vec::new()) };
        }
        PHOTONS.with_borrow_mut(|photons| {
            photons.resize(counts.len(), 0.0);
            self.digitize(channel, exposure, photons, counts);
        });
    }

    fn digitize(&self, channel: Channel, exposure: ExposureIndex, photons: &mut [f32], counts: &mut [u16]) {
        let (number, exposure_number) = (channel.index() as u64, exposure.0);
        let stream = Stream::Noise { channel: number, exposure: exposure_number };
        let mut noise = stream.generator(self.seed);
        let stream = Stream::Dark { channel: number, exposure: exposure_number };
        let mut dark = stream.generator(self.seed);
        self.light(channel, exposure, photons);
        self.optical_paths[channel.index()].digitizer.draw(
            photons,
            Generators { noise: &mut noise, dark: &mut dark },
            counts,
        );
    }
}

impl OpticalPath {
    fn new(scene: &Scene, channel: Channel, emitters: &[Emitter]) -> Self {
        let (height, width) = (scene.height_px(), scene.width_px());
        let share = match channel {
            Channel::Reflected => 1.0 - scene.background_transmission(),
            Channel::Transmitted => scene.background_transmission(),
        };
        let background = (scene.background_photons_per_exposure() * share) as f32;
        let mut steady = vec![background; height * width];
        let mut spots = SpotPatterns::default();
        for (number, emitter) in emitters.iter().enumerate() {
            spots.push(&spot(scene, channel, emitter), height, width);
            if shines_forever(emitter) {
                spots.add(number, 1.0, &mut steady, width);
            }
        }
        let model = scene.cameras()[channel.index()];
        let sensor = Sensor::new(&model, channel.index(), height * width);
        let digitizer = Digitizer::new(model, sensor, background);
        Self { steady, spots, digitizer }
    }
}

/// How an emitter appears on a camera.
fn spot(scene: &Scene, channel: Channel, emitter: &Emitter) -> Spot {
    let species = &scene.species()[emitter.species];
    let sigma_px = species.sigma_px(scene.optics());
    let position_px = emitter.position_px;
    match channel {
        Channel::Reflected => Spot { position_px, sigma_px, photons: emitter.photons * species.reflection },
        Channel::Transmitted => Spot {
            position_px: scene.view().apply(position_px, scene.height_px(), scene.width_px()),
            sigma_px: sigma_px * scene.view().scale,
            photons: emitter.photons * species.transmission,
        },
    }
}

fn shines_forever(emitter: &Emitter) -> bool {
    emitter.kinetics.switching.is_none() && emitter.kinetics.bleaching.is_none()
}

impl Activity {
    fn new(emitters: &[Emitter], frames: u64, seed: u64) -> Self {
        let per_emitter: Vec<Vec<(u32, f32)>> = emitters
            .par_iter()
            .map(|emitter| {
                if shines_forever(emitter) {
                    return Vec::new();
                }
                let species = emitter.species as u64;
                let stream = Stream::Trajectory { species, emitter: emitter.number };
                let generator = stream.generator(seed);
                on_fractions(OnIntervals::new(emitter.kinetics, frames as f64, generator))
            })
            .collect();
        Self::sorted_by_exposure(&per_emitter, frames as usize)
    }

    fn sorted_by_exposure(per_emitter: &[Vec<(u32, f32)>], frames: usize) -> Self {
        let mut starts = vec![0; frames + 1];
        for &(exposure, _) in per_emitter.iter().flatten() {
            starts[exposure as usize + 1] += 1;
        }
        for exposure in 0..frames {
            starts[exposure + 1] += starts[exposure];
        }
        let mut next = starts.clone();
        let mut entries = vec![(0, 0.0); starts[frames]];
        for (emitter, fractions) in per_emitter.iter().enumerate() {
            for &(exposure, fraction) in fractions {
                let place = &mut next[exposure as usize];
                entries[*place] = (emitter as u32, fraction);
                *place += 1;
            }
        }
        Self { starts, entries }
    }

    fn of(&self, exposure: ExposureIndex) -> &[(u32, f32)] {
        let exposure = exposure.0 as usize;
        &self.entries[self.starts[exposure]..self.starts[exposure + 1]]
    }
}

/// Whether positions of a species are worth recording: steady ones are calibration targets.
pub(crate) fn is_target(photophysics: Photophysics) -> bool {
    photophysics == Photophysics::Steady
}
