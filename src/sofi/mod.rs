//! Pure mathematics of the paper, one file per step.
