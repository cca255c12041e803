//! Files written past the page cache, or through it where little is to be written: whole pages at offsets that are
//! whole pages.
//!
//! In: slices of page-aligned memory, or any bytes through a small aligned copy. Out: bytes at their place.
//! Never: keeps data back; a write has reached the file when it returns. Fails: as the system says, path and verb added.
//! Little comes into the page cache, which a killed program does not take with it and where no disk is waited for;
//! much would cost a copy of everything there. Where the file system refuses direct writing, all goes through it.

use super::RecordingError;
use super::gate::{Change, Gate, Operation};
use rustix::fs::{FallocateFlags, OFlags, fallocate, fcntl_getfl, fcntl_setfl};
use rustix::io::{Errno, pwritev};
use std::fs::{File, OpenOptions};
use std::io::{self, IoSlice};
use std::path::{Path, PathBuf};

/// Offsets, lengths and addresses are multiples of this.
pub(super) const PAGE: usize = crate::acquisition::PAGE_BYTES;
/// Less than this goes through the page cache.
const SMALL_BYTES: usize = 512 << 10;
/// Slices handed to the system at once, below its limit of 1024.
const MAX_SLICES: usize = 512;
/// Room is reserved ahead in steps of at most this.
const RESERVE_STEP: u64 = 256 << 20;

/// Bytes that begin on a page.
#[derive(Debug)]
pub(super) struct Aligned {
    memory: Vec<u8>,
    first: usize,
    len: usize,
}

impl Aligned {
    pub(super) fn zeroed(len: usize) -> Self {
        let memory = vec![0; len + PAGE];
        let first = memory.as_ptr().align_offset(PAGE).min(PAGE);
        Self { memory, first, len }
    }

    pub(super) fn bytes(&self) -> &[u8] {
        &self.memory[self.first..self.first + self.len]
    }

    pub(super) fn bytes_mut(&mut self) -> &mut [u8] {
        &mut self.memory[self.first..self.first + self.len]
    }
}

/// A file under way.
#[derive(Debug)]
pub(super) struct DirectFile {
    file: File,
    /// The same file through the page cache.
    cached: File,
    path: PathBuf,
    gate: Gate,
    is_direct: bool,
    can_reserve: bool,
    reserved: u64,
}

impl DirectFile {
    /// Creates the file, which must not exist.
    pub(super) fn create(path: &Path, gate: Gate) -> Result<Self, RecordingError> {
        let file = gate
            .pass(Operation::Write, path)
            .and_then(|()| OpenOptions::new().read(true).write(true).create_new(true).open(path))
            .map_err(|source| RecordingError::storage(path, "create", source))?;
        let cached = OpenOptions::new()
            .write(true)
            .open(path)
            .map_err(|source| RecordingError::storage(path, "open", source))?;
        gate.note(Change::Created, path);
        let is_direct = set_direct(&file, true).is_ok();
        let path = path.to_path_buf();
        Ok(Self { file, cached, path, gate, is_direct, can_reserve: true, reserved: 0 })
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Bytes reserved beyond `end`.
    pub(super) fn reserve_beyond(&self, end: u64) -> u64 {
        self.reserved.saturating_sub(end)
    }

    /// Reserves room up to `end` and further ahead, without changing the length; at most `limit` if that is more.
    /// A disk that cannot reserve still writes.
    pub(super) fn reserve(&mut self, end: u64, limit: u64) {
        if end <= self.reserved || !self.can_reserve {
            return;
        }
        let free = crate::files::free_bytes(&self.path).unwrap_or(0);
        let step = RESERVE_STEP.min(free / 16) / PAGE as u64 * PAGE as u64;
        let ahead = end.saturating_add(step).min(limit.max(end));
        let len = ahead - self.reserved;
        match fallocate(&self.file, FallocateFlags::KEEP_SIZE, self.reserved, len) {
            Ok(()) => self.reserved = ahead,
            Err(Errno::NOSPC) => {}
            Err(_) => self.can_reserve = false,
        }
    }

    /// Writes `slices` one after another from `offset` on; lengths and addresses are whole pages.
    pub(super) fn write(&mut self, slices: &[&[u8]], offset: u64) -> Result<(), RecordingError> {
        self.gate
            .pass(Operation::Write, &self.path)
            .and_then(|()| self.write_all(slices, offset))
            .map_err(|source| RecordingError::storage(&self.path, "write", source))?;
        let mut at = offset;
        for slice in slices {
            self.gate.note(Change::Bytes(at, slice), &self.path);
            at += slice.len() as u64;
        }
        Ok(())
    }

    fn write_all(&mut self, slices: &[&[u8]], offset: u64) -> io::Result<()> {
        let total: usize = slices.iter().map(|slice| slice.len()).sum();
        let is_direct = self.is_direct && total >= SMALL_BYTES;
        let mut done = 0;
        while done < total {
            let file = if is_direct { &self.file } else { &self.cached };
            let written = match pwritev(file, &slices_from(slices, done), offset + done as u64) {
                Ok(0) => return Err(io::ErrorKind::WriteZero.into()),
                Ok(written) => written,
                Err(Errno::INTR) => continue,
                Err(Errno::INVAL) if is_direct && self.is_direct => {
                    self.leave_direct()?;
                    continue;
                }
                Err(errno) => return Err(errno.into()),
            };
            done += written;
            // Half a page is written once more with its other half.
            if is_direct && self.is_direct && done < total && !done.is_multiple_of(PAGE) {
                done = done / PAGE * PAGE;
                if written < PAGE {
                    self.leave_direct()?;
                }
            }
        }
        Ok(())
    }

    fn leave_direct(&mut self) -> io::Result<()> {
        self.is_direct = false;
        set_direct(&self.file, false)
    }

    /// Cuts the file at `end` and gives back what is reserved behind.
    pub(super) fn cut(&mut self, end: u64) -> Result<(), RecordingError> {
        self.reserved = end;
        self.gate
            .pass(Operation::Write, &self.path)
            .and_then(|()| self.file.set_len(end))
            .map_err(|source| RecordingError::storage(&self.path, "truncate", source))?;
        self.gate.note(Change::Length(end), &self.path);
        Ok(())
    }
}

fn set_direct(file: &File, on: bool) -> io::Result<()> {
    let mut flags = fcntl_getfl(file)?;
    flags.set(OFlags::DIRECT, on);
    Ok(fcntl_setfl(file, flags)?)
}

/// What is left of `slices` after their first `done` bytes, as many as go at once.
fn slices_from<'a>(slices: &[&'a [u8]], mut done: usize) -> Vec<IoSlice<'a>> {
    let mut left = Vec::with_capacity(slices.len().min(MAX_SLICES));
    for slice in slices {
        if done >= slice.len() {
            done -= slice.len();
            continue;
        }
        left.push(IoSlice::new(&slice[done..]));
        done = 0;
        if left.len() == MAX_SLICES {
            break;
        }
    }
    left
}

/// Makes the entries of a directory durable.
pub(super) fn sync_directory(path: &Path, gate: &Gate) -> Result<(), RecordingError> {
    gate.pass(Operation::Sync, path)
        .and_then(|()| File::open(path)?.sync_all())
        .map_err(|source| RecordingError::storage(path, "sync", source))?;
    gate.note(Change::Synced, path);
    Ok(())
}
