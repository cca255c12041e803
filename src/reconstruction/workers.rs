//! Worker threads for the mathematics: a pool of the computer's cores.

use crate::sofi::cumulant::Workers;
use rayon::prelude::*;

/// Spreads work over rayon's threads; results are the same for any number of them.
#[derive(Debug, Clone, Copy, Default)]
pub struct AllCores;

impl Workers for AllCores {
    fn for_each<T: Send, F: Fn(usize, &mut T) + Sync>(&self, items: &mut [T], work: F) {
        items.par_iter_mut().enumerate().for_each(|(index, item)| work(index, item));
    }
}
