//! Names as people type them: what is said when one is not known.
//!
//! In: the nearest known names. Out: half a sentence. Never: decides for the person. Fails: not at all.

/// " Did you mean A, B or C?", or nothing when there is nothing to suggest.
pub(super) fn suggestion(names: &[String]) -> String {
    match names {
        [] => String::new(),
        [only] => format!(" Did you mean {only}?"),
        [first @ .., last] => format!(" Did you mean {} or {last}?", first.join(", ")),
    }
}
