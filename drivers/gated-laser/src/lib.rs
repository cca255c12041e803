//! Lasers without a data link, through gate and level of a trigger controller.
