//! A hint to the processor to bring a line of memory closer before it is needed.
#![expect(
    unsafe_code,
    reason = "the prefetch instruction has no safe form; it can neither fault nor change a value"
)]

/// Bytes that one hint brings.
pub(super) const LINE_BYTES: usize = 64;

/// Asks for the cache lines of a slice, into the second-level cache.
///
/// Rows of frames are powers of two apart and would push each other out of the first level.
#[inline(always)]
pub(super) fn prefetch<T>(values: &[T]) {
    let step = (LINE_BYTES / size_of::<T>()).max(1);
    for value in values.iter().step_by(step) {
        #[cfg(target_arch = "x86_64")]
        {
            use core::arch::x86_64::{_MM_HINT_T1, _mm_prefetch};
            // SAFETY: prefetching any address is allowed and has no visible effect; SSE is part of x86-64.
            unsafe { _mm_prefetch::<_MM_HINT_T1>(std::ptr::from_ref(value).cast()) };
        }
        #[cfg(not(target_arch = "x86_64"))]
        let _ = value;
    }
}
