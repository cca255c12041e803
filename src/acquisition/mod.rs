//! From cameras to frame pairs: memory on loan, losses as values, pairs by exposure.
//!
//! ```text
//! camera R ─ grabber ─┐
//!                     ├─► pairing ─► ExposureRecord in order of exposure ─► recording, analysis
//! camera T ─ grabber ─┘       └────► Ledger: what became of every exposure
//! ```
//!
//! In: frames in the order in which cameras deliver them.
//! Out: every exposure of each camera once, in order: a frame, or the reason why there is none.
//! Never: waits for a consumer, looks at pixels, pairs by arrival, allocates memory for pixels after arming.
//! Fails: frames are lost with a [`Loss`]; only a camera that is gone ends the run.

mod accounts;
mod alignment;
mod dispatch;
mod grabber;
mod ledger;
mod loss;
mod pairing;
mod pool;
mod record;
mod shedding;
mod start;
mod surroundings;

pub use accounts::{Accounts, CameraAccount, LossRange, Tally};
pub use dispatch::{Dispatch, DispatchReport, FramePair, LeaveOut, Progress, Tap};
pub use grabber::{Grabber, GrabberEnd, GrabberStatus, HostClock, Patience};
pub use ledger::{Analysis, LedgerColumns, LedgerError, LedgerRow, PairState, RowState};
pub use loss::Loss;
pub use pairing::{Grabbed, Pairing, PairingEvent, PairingSettings, Resolved, Surplus};
pub use pool::{Frame, FrameFacts, FrameMemory, FramePool, PAGE_BYTES};
pub use record::{ExposureRecord, Side};
pub use shedding::{Pressure, PressureGauge, Shedding};
pub(crate) use surroundings::FOCUS_STEPS_PER_NM;
pub use surroundings::{Conditions, FocusGauge, Light, Surroundings};
