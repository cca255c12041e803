//! Pictures and reports of one analysis.
