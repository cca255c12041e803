//! A library like Madlib with a simulated Nano-Drive behind it, for programs and tests without a piezo.
//!
//! In: calls as of Madlib; `SOFISCOPE_MADLIB_TABLE` (optical table that sees the piezo), `SOFISCOPE_MADLIB_CONTROL`
//! (commands at the start, separated by `;`). Out: positions and answers; [`Remote`] for tests.
//! Never: pretends to be real: Madlib has no texts, so the library has a function `sofiscope_madlib_bench` by which
//! a driver knows it. Fails: as the library would.
//!
//! | module | what |
//! |---|---|
//! | `exports` | the C functions; the only `unsafe` code beside `remote` |
//! | `bench` | handle, converters, faults |
//! | `plant` | the motion, pure |
//! | `remote` | words for tests |

mod bench;
mod exports;
mod plant;
mod remote;

pub use remote::{Remote, library};
