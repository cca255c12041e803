//! Numbers in memory that several processes map.

use std::fs::OpenOptions;
use std::io;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use memmap2::{MmapOptions, MmapRaw};

/// A row of numbers; every access is one atomic load or store, so that no half-written number is ever seen.
#[derive(Debug, Clone)]
pub(super) struct Cells {
    memory: Arc<MmapRaw>,
    num_cells: usize,
}

impl Cells {
    pub(super) fn create(path: &Path, num_cells: usize) -> io::Result<Self> {
        let file = OpenOptions::new().read(true).write(true).create_new(true).open(path)?;
        file.set_len(bytes_of(num_cells) as u64)?;
        Ok(Self { memory: Arc::new(MmapOptions::new().len(bytes_of(num_cells)).map_raw(&file)?), num_cells })
    }

    pub(super) fn open(path: &Path, num_cells: usize) -> io::Result<Self> {
        let file = OpenOptions::new().read(true).write(true).open(path)?;
        if file.metadata()?.len() != bytes_of(num_cells) as u64 {
            return Err(io::Error::other(format!("{} is no optical table of this version", path.display())));
        }
        Ok(Self { memory: Arc::new(MmapOptions::new().len(bytes_of(num_cells)).map_raw(&file)?), num_cells })
    }

    pub(super) fn private(num_cells: usize) -> io::Result<Self> {
        let memory = MmapOptions::new().len(bytes_of(num_cells)).map_anon()?;
        Ok(Self { memory: Arc::new(memory.into()), num_cells })
    }

    pub(super) fn get(&self, cell: usize) -> f64 {
        f64::from_bits(self.cell(cell).load(Ordering::Acquire))
    }

    pub(super) fn set(&self, cell: usize, value: f64) {
        self.cell(cell).store(value.to_bits(), Ordering::Release);
    }

    #[expect(unsafe_code, reason = "memory shared between processes has no safe form")]
    fn cell(&self, cell: usize) -> &AtomicU64 {
        assert!(cell < self.num_cells, "cell {cell} of {}", self.num_cells);
        // SAFETY: the mapping begins at a page and has `num_cells` cells of 8 bytes, so the address is valid and
        // aligned for as long as `self.memory` lives; every process reaches the cells through atomics only.
        unsafe { AtomicU64::from_ptr(self.memory.as_mut_ptr().cast::<u64>().add(cell)) }
    }
}

fn bytes_of(num_cells: usize) -> usize {
    num_cells * size_of::<AtomicU64>()
}
