//! Live multicolor super-resolution imaging (SOFI) with two cameras: the rooms in the order light travels.
//!
//! ```text
//! cameras ─► pairing ─► registration ─► cumulants ─► unmixing ─► flattening ─► linearization ─► picture
//! drivers    acquisition                sofi         sofi        sofi          sofi             display
//!                                       └────────────── reconstruction ──────────────┘         report
//! ```
//!
//! | room | what happens there |
//! |---|---|
//! | [`pipeline`] | queues, the latest value, threads; no physics |
//! | [`acquisition`] | cameras to frame pairs, and the books of both |
//! | [`recording`] | every exposure to disk or listed as lost, and back |
//! | [`control`] | plans, and the one hand that carries them out |
//! | [`files`] | image stacks in, result images out |
//! | [`replay`] | recorded frames through cameras that are none, into the same pipeline |
//! | [`sofi`] | the mathematics, one file per step of the paper |
//! | [`reconstruction`] | exposures to images: runs `sofi` on all cores |
//! | [`display`] | colormaps, contrast, composites, scale bars |
//! | [`report`] | one analysis as JSON and as a page to show |
//! | [`config`] | dyes, dichroics and settings, checked |
//! | [`viewer`] | the window: draws snapshots, sends commands |
//! | [`app`] | the commands; the only room that knows every other |

pub mod acquisition;
pub mod app;
pub mod config;
pub mod control;
pub mod display;
pub mod files;
pub mod guard;
pub mod pipeline;
pub mod reconstruction;
pub mod recording;
pub mod replay;
pub mod report;
pub mod sofi;
pub mod viewer;
