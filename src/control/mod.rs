//! Plans as data, and the one hand that carries them out.
