//! One deterministic blinking sample and the two cameras looking at it.
