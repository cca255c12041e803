//! The border between Rust and the firmware.
//!
//! In: [`Board`], [`Inputs`]. Out: [`Outputs`]. Never: keeps a pointer that the firmware gave, or gives it one that
//! it may keep. Fails: when the two compilers disagree about sizes, at the first [`Core::power_up`].
#![expect(unsafe_code, reason = "the firmware is C, and calling C has no safe form")]

use std::fmt;
use std::mem::MaybeUninit;

use crate::{Board, Inputs, Outputs};

/// `gk_inputs` of the firmware.
#[repr(C)]
struct RawInputs {
    now_us: u32,
    byte: i16,
    interlock_closed: u8,
    exposing: u8,
}

/// Memory for `gk_core`, whose parts only the firmware knows.
#[derive(Clone)]
struct Memory(Box<[u64]>);

unsafe extern "C" {
    safe fn gk_size_of_core() -> usize;
    safe fn gk_size_of_board() -> usize;
    safe fn gk_size_of_inputs() -> usize;
    safe fn gk_size_of_outputs() -> usize;
    fn gk_power_up(core: *mut u64, board: *const Board, now_us: u32);
    fn gk_step(core: *mut u64, inputs: *const RawInputs, outputs: *mut Outputs);
    fn gk_idle_us(core: *const u64) -> u32;
}

/// A board under power.
#[derive(Clone)]
pub struct Core(Memory);

impl fmt::Debug for Core {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("Core")
    }
}

impl Core {
    /// Switches the board on, or resets it: everything low, nothing armed.
    ///
    /// # Panics
    /// When the compiler of the firmware laid out its data in another way than this one.
    #[must_use]
    pub fn power_up(board: &Board, now_us: u32) -> Self {
        assert_eq!(gk_size_of_board(), size_of::<Board>(), "both sides agree about the board");
        assert_eq!(gk_size_of_inputs(), size_of::<RawInputs>(), "both sides agree about the inputs");
        assert_eq!(gk_size_of_outputs(), size_of::<Outputs>(), "both sides agree about the outputs");
        let mut memory = vec![0_u64; gk_size_of_core().div_ceil(size_of::<u64>())].into_boxed_slice();
        // SAFETY: `memory` has at least the size of `gk_core` and the alignment of 8 bytes, which is that of its
        // largest part or more; `board` has the layout of `gk_board`, of equal size; the firmware keeps neither.
        unsafe { gk_power_up(memory.as_mut_ptr(), board, now_us) };
        Self(Memory(memory))
    }

    /// One turn of the main loop.
    #[must_use]
    pub fn step(&mut self, inputs: &Inputs) -> Outputs {
        let raw = RawInputs {
            now_us: inputs.now_us,
            byte: inputs.byte.map_or(-1, i16::from),
            interlock_closed: u8::from(inputs.interlock_closed),
            exposing: u8::from(inputs.exposing),
        };
        let mut outputs = MaybeUninit::<Outputs>::zeroed();
        // SAFETY: the memory was set up by `gk_power_up` and nothing else writes to it; inputs and outputs have the
        // layout and size of `gk_inputs` and `gk_outputs`; the firmware keeps none of them.
        unsafe { gk_step(self.0.0.as_mut_ptr(), &raw, outputs.as_mut_ptr()) };
        // SAFETY: all its parts are integers, for which zeros and whatever the firmware wrote are valid.
        unsafe { outputs.assume_init() }
    }

    /// Microseconds after the last turn until outputs can change without any input; at most a second.
    #[must_use]
    pub fn idle_us(&self) -> u32 {
        // SAFETY: the memory was set up by `gk_power_up`, and is only read.
        unsafe { gk_idle_us(self.0.0.as_ptr()) }
    }
}
