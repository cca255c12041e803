//! The laser guard: a process of its own that holds lasers and gates, and lets go of them when nobody proves to be
//! there.
//!
//! ```text
//! instrument process                              guard process
//!   sequencer ─► Illumination ─► GuardClient ══ socket ══ serve ─► Safety (pure)
//!                 proof of progress                        ├─► guard-gates   heartbeat ─► controller
//!                                                          └─► guard-laser-… ─► laser
//! ```
//!
//! In: requests and proofs of progress over a socket. Out: light, held only as long as proofs come.
//! Never: opens a gate unless armed by a person, gives a heartbeat to the controller that no proof stands behind,
//! forgets a trip before it is armed again, makes light because a port was opened.
//! Fails: towards darkness. End of file, silence, a device that is lost or says something unexpected, an open
//! interlock: gates are closed first, then the lasers; what cannot be confirmed is reported as on.
//!
//! | module | what |
//! |---|---|
//! | [`safety`] | the state machine that decides, pure |
//! | [`message`] | what goes over the socket |
//! | [`lights`] | lasers and controller in the guard's hand, one thread per port |
//! | [`process`] | the guard's own loop |
//! | [`client`] | the other end of the socket |

pub mod client;
pub mod lights;
pub mod message;
pub mod process;
pub mod safety;
