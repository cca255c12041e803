//! Mad City Labs Nano-Drive through Madlib, opened at run time.
