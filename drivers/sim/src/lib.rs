//! One deterministic blinking sample and the two cameras looking at it.
//!
//! ```text
//! scene file ─► Scene ─► emitters ─► blinking ─► optics ─► camera ─► counts
//!                  ├────────────────► Truth ─► score ◄── analyzed images
//!                  └─► World ─► instrument ─► SimulatedCamera R, T and what goes wrong with them
//! ```
//!
//! In: a scene (text in TOML) and a seed.
//! Out: frames of both cameras for any exposure in any order, the ground truth, and scores of images against it;
//! two cameras and a trigger that can be controlled as real ones.
//! Never: depends on the number of threads or, but for what a slow reader loses in real time, on a clock.
//! Fails: [`SceneError`] with all faults of a scene file at once; [`WorldError`]; [`TruthError`]; [`ScoreError`].
//!
//! The model is the one of the paper, Materials and methods: Simulations.
//!
//! ```
//! use sofiscope_hal::{Channel, ExposureIndex};
//! use sofiscope_sim::{Scene, World};
//!
//! let scene = Scene::from_toml(Scene::built_in("figure-s4").unwrap())?.with_frames(10)?;
//! let world = World::new(&scene, scene.seed());
//! let mut counts = vec![0_u16; scene.num_pixels()];
//! world.frame(Channel::Reflected, ExposureIndex(3), &mut counts)?;
//! assert!(counts.iter().any(|&count| count > 100));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod blinking;
mod camera;
mod emitters;
mod geometry;
pub mod instrument;
mod optics;
mod poisson;
mod random;
pub mod scene;
pub mod score;
mod sensor;
mod truth;
mod world;

pub use instrument::{
    Film, InstrumentSettings, Oracle, Scenario, SimulatedInstrument, SimulatedStage, Source,
};
pub use optics::psf_sigma_px;
pub use scene::{
    CameraModel, Fault, Mirror, Optics, PatchGrid, Photophysics, PixelSpread, Scene, SceneError, Shape,
    Species, View,
};
pub use score::{Plane, ScoreError};
pub use sensor::Sensor;
pub use truth::{PatchTruth, SpeciesTruth, Truth, TruthError};
pub use world::{World, WorldError};
