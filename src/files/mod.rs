//! Image stacks in, result images out.
