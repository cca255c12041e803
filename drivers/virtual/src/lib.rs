//! The microscope without the microscope: a virtual instrument for every device that speaks over a line.
//!
//! | module | what |
//! |---|---|
//! | [`gige`] | a GigE Vision camera on an address of this computer |
//! | [`table`] | [`OpticalTable`]: what all virtual devices share, in memory that processes map |
//! | [`stage`] | [`TangoModel`](stage::TangoModel), a TANGO controller with its stage |
//! | [`laser`] | lasers: iBEAM smart, SMD12, and one without a data link |
//! | [`log`] | [`EmissionLog`]: what came out of lasers and gates, by the device's own clock |
//! | [`pty`] | a model behind a pseudo-terminal, in real time |
//! | [`trigger`] | trigger controllers: gatekeeper, Arduino and TeensyPulseGenerator of Micro-Manager |
//! | [`spot`] | [`FocusSpot`](spot::FocusSpot): what the camera of the focus lock sees |
//!
//! In: bytes over pseudo-terminals, and what the other devices do to the optical table. Out: bytes, and what this
//! device does to the table. Never: pretends to be real: every identity says that it is simulated where its
//! protocol has room for it, and the instrument file names it as virtual. Fails: when the system has no
//! pseudo-terminals, or the table's file cannot be mapped.
//!
//! Models are pure ([`LineModel`](sofiscope_serial_line::LineModel)): a test talks to them without a terminal.

pub mod gige;
pub mod laser;
pub mod log;
pub mod pty;
pub mod spot;
pub mod stage;
pub mod table;
pub mod trigger;

pub use log::EmissionLog;
pub use table::OpticalTable;

/// Time since this computer was switched on, on the clock that all processes share.
#[must_use]
pub fn monotonic() -> std::time::Duration {
    let now = rustix::time::clock_gettime(rustix::time::ClockId::Monotonic);
    std::time::Duration::new(now.tv_sec.unsigned_abs(), u32::try_from(now.tv_nsec).unwrap_or(0))
}
