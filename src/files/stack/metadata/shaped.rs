//! The description `{"shape": [..], "truncated": true}` of Python's writer: one directory, then all pixels.
//!
//! In: the text. Out: the number of planes, if it is such a description.
//! Never: guesses. Fails: not at all.

/// Planes that a truncated file promises; `None` for every other text.
pub(super) fn planes(text: &str) -> Option<u64> {
    let description: serde_json::Value = serde_json::from_str(text).ok()?;
    if !description.get("truncated")?.as_bool()? {
        return None;
    }
    let shape = description.get("shape")?.as_array()?;
    let outer = shape.get(..shape.len().checked_sub(2)?)?;
    outer.iter().try_fold(1_u64, |total, size| total.checked_mul(size.as_u64()?))
}

#[cfg(test)]
mod tests {
    use super::planes;

    #[test]
    fn only_truncated_files_promise_more_planes() {
        assert_eq!(planes(r#"{"shape": [2, 5, 3, 4], "truncated": true}"#), Some(10));
        assert_eq!(planes(r#"{"shape": [5, 3, 4]}"#), None);
        assert_eq!(planes(r#"{"shape": [1e99, 5, 3, 4], "truncated": true}"#), None);
        assert_eq!(planes("Recorded on Monday"), None);
    }
}
