//! BigTIFF under way: one page per frame, whole groups of pages appended.
//!
//! ```text
//! 0      header, name of the program      4 KiB; holds the offset of the first directory
//! group  directories, 10 to a block       chained; the last one ends the chain
//!        pixels of each frame             begin on whole pages
//! group  ...
//! end    OME-XML                          written when the recording ends or is recovered
//! ```
//!
//! In: groups of frames with their facts. Out: a file whose chain of directories ends behind the last published group.
//! Never: links to a group before it is completely written. Fails: [`RecordingError`]; the chain is then as before.

use super::RecordingError;
use super::direct::{Aligned, DirectFile, PAGE};
use super::facts::{FACTS_BYTES, FactsBytes};
use super::gate::Gate;
use super::metadata::{CameraDescription, stride};
use super::writer::{Bounce, write_frames};
use std::path::Path;

/// Directories in a block of 4 KiB; none lies across two blocks.
const IFDS_PER_BLOCK: usize = 10;
/// Bytes from one directory to the next.
const IFD_BYTES: usize = 400;
/// Where the facts of a frame lie behind its directory.
const FACTS_AT: usize = IFD_BYTES - FACTS_BYTES;
/// Where the header says where the first directory is.
const FIRST_IFD_AT: usize = 8;
/// The description of a recording that has not ended.
const UNFINISHED: &[u8] = b"sofiscope recording, not finished\0";
const UNFINISHED_AT: usize = 64;
/// Private tag with the facts of a frame.
pub(super) const FACTS_TAG: u16 = 65_100;
/// Resolutions are this over a denominator; exact to 1/400 nm.
const RESOLUTION_PIXELS: u32 = 4_000_000_000;

/// A file under way.
#[derive(Debug)]
pub(super) struct TiffFile {
    file: DirectFile,
    camera: CameraDescription,
    bounce: Bounce,
    pages: u64,
    end: u64,
    limit: u64,
    pointer: Pointer,
    /// Frames that are written and not linked yet.
    staged: u64,
}

/// The block with the end of the chain, and the place of that end in it.
#[derive(Debug)]
struct Pointer {
    block: Aligned,
    offset: u64,
    at: usize,
}

impl TiffFile {
    pub(super) fn create(
        path: &Path,
        camera: &CameraDescription,
        planned: Option<u64>,
        gate: Gate,
    ) -> Result<Self, RecordingError> {
        let mut block = Aligned::zeroed(PAGE);
        let bytes = block.bytes_mut();
        bytes[..8].copy_from_slice(&[b'I', b'I', 43, 0, 8, 0, 0, 0]);
        bytes[UNFINISHED_AT..UNFINISHED_AT + UNFINISHED.len()].copy_from_slice(UNFINISHED);
        let mut file = DirectFile::create(path, gate)?;
        file.write(&[block.bytes()], 0)?;
        // A group of one frame has a block of directories for itself.
        let page_bytes = stride(camera).saturating_add(PAGE as u64);
        Ok(Self {
            file,
            camera: camera.clone(),
            bounce: Bounce::for_frames(camera.frame_bytes()),
            pages: 0,
            end: PAGE as u64,
            limit: planned.map_or(u64::MAX, |planned| planned.saturating_mul(page_bytes)),
            pointer: Pointer { block, offset: 0, at: FIRST_IFD_AT },
            staged: 0,
        })
    }

    /// Writes the pixels of a group, with room for its directories before them; readers do not see it yet.
    pub(super) fn stage(&mut self, group: &[&[u8]]) -> Result<(), RecordingError> {
        self.staged = group.len() as u64;
        self.file.reserve(self.staged_end(), self.limit);
        let pixels_at = self.pixels_at();
        write_frames(&mut self.file, group, pixels_at, &mut self.bounce)
    }

    /// Writes the directories of the staged group and links them.
    pub(super) fn publish(&mut self, facts: &[FactsBytes]) -> Result<(), RecordingError> {
        if self.staged == 0 {
            return Ok(());
        }
        let (directories, pointer) = self.directories(facts);
        let end = self.staged_end();
        self.file.write(&[directories.bytes()], self.end)?;
        self.pointer.link(self.end);
        if let Err(error) = self.pointer.write(&mut self.file) {
            // It may have reached the file or not: the old end of the chain is tried again, the group stays.
            self.pointer.link(0);
            let _ = self.pointer.write(&mut self.file);
            self.end = end;
            self.staged = 0;
            return Err(error);
        }
        self.pages += self.staged;
        self.end = end;
        self.staged = 0;
        self.pointer = pointer;
        Ok(())
    }

    /// Where the pixels of the staged group begin.
    fn pixels_at(&self) -> u64 {
        self.end + self.staged.div_ceil(IFDS_PER_BLOCK as u64) * PAGE as u64
    }

    /// Where the staged group ends.
    fn staged_end(&self) -> u64 {
        self.pixels_at() + self.staged * stride(&self.camera)
    }

    /// Gives back all room behind the published groups.
    pub(super) fn cut(&mut self) -> Result<(), RecordingError> {
        self.file.cut(self.end)
    }

    pub(super) fn pages(&self) -> u64 {
        self.pages
    }

    pub(super) fn bytes(&self) -> u64 {
        self.end
    }

    pub(super) fn reserve(&self) -> u64 {
        self.file.reserve_beyond(self.end)
    }

    pub(super) fn path(&self) -> &Path {
        self.file.path()
    }

    /// The directories of a group as whole blocks, and where the chain ends in them.
    fn directories(&self, group: &[FactsBytes]) -> (Aligned, Pointer) {
        let num_blocks = group.len().div_ceil(IFDS_PER_BLOCK);
        let mut blocks = Aligned::zeroed(num_blocks * PAGE);
        let pixels_at = self.pixels_at();
        let place = |index: usize| index / IFDS_PER_BLOCK * PAGE + index % IFDS_PER_BLOCK * IFD_BYTES;
        let mut end_at = 0;
        for (index, facts) in group.iter().enumerate() {
            let is_last = index + 1 == group.len();
            let ifd = Ifd {
                camera: &self.camera,
                offset: self.end + place(index) as u64,
                pixels: pixels_at + index as u64 * stride(&self.camera),
                next: if is_last { 0 } else { self.end + place(index + 1) as u64 },
                facts,
                has_description: self.pages == 0 && index == 0,
            };
            let bytes = &mut blocks.bytes_mut()[place(index)..place(index) + IFD_BYTES];
            end_at = place(index) + ifd.write(bytes);
        }
        let last_block = end_at / PAGE * PAGE;
        let mut block = Aligned::zeroed(PAGE);
        block.bytes_mut().copy_from_slice(&blocks.bytes()[last_block..last_block + PAGE]);
        (blocks, Pointer { block, offset: self.end + last_block as u64, at: end_at % PAGE })
    }
}

impl Pointer {
    fn link(&mut self, ifd: u64) {
        self.block.bytes_mut()[self.at..self.at + 8].copy_from_slice(&ifd.to_le_bytes());
    }

    fn write(&self, file: &mut DirectFile) -> Result<(), RecordingError> {
        file.write(&[self.block.bytes()], self.offset)
    }
}

/// One directory.
struct Ifd<'a> {
    camera: &'a CameraDescription,
    offset: u64,
    pixels: u64,
    next: u64,
    facts: &'a FactsBytes,
    has_description: bool,
}

const SHORT: u16 = 3;
const LONG: u16 = 4;
const RATIONAL: u16 = 5;
const UNDEFINED: u16 = 7;
const LONG8: u16 = 16;
const ASCII: u16 = 2;

impl Ifd<'_> {
    /// Writes directory and facts; returns where the offset of the next one stands.
    fn write(&self, bytes: &mut [u8]) -> usize {
        let fields = self.fields();
        bytes[..8].copy_from_slice(&(fields.len() as u64).to_le_bytes());
        for (index, (tag, kind, count, value)) in fields.iter().enumerate() {
            let field = &mut bytes[8 + index * 20..][..20];
            field[..2].copy_from_slice(&tag.to_le_bytes());
            field[2..4].copy_from_slice(&kind.to_le_bytes());
            field[4..12].copy_from_slice(&count.to_le_bytes());
            field[12..].copy_from_slice(&value.to_le_bytes());
        }
        let next_at = 8 + fields.len() * 20;
        bytes[next_at..next_at + 8].copy_from_slice(&self.next.to_le_bytes());
        bytes[FACTS_AT..].copy_from_slice(self.facts);
        next_at
    }

    /// Tag, type, count and value; small values lie in the low bytes, as little-endian files have them.
    fn fields(&self) -> Vec<(u16, u16, u64, u64)> {
        let (height, width) = (self.camera.height() as u64, self.camera.width() as u64);
        let mut fields = vec![
            (256, LONG, 1, width),
            (257, LONG, 1, height),
            (258, SHORT, 1, 16),
            (259, SHORT, 1, 1),
            (262, SHORT, 1, 1),
            (273, LONG8, 1, self.pixels),
            (277, SHORT, 1, 1),
            (278, LONG, 1, height),
            (279, LONG8, 1, self.camera.frame_bytes() as u64),
            (339, SHORT, 1, 1),
            (FACTS_TAG, UNDEFINED, FACTS_BYTES as u64, self.offset + FACTS_AT as u64),
        ];
        if self.has_description {
            fields.insert(5, (270, ASCII, UNFINISHED.len() as u64, UNFINISHED_AT as u64));
        }
        if let Some(size_nm) = self.camera.pixel_size_nm {
            // Pixels per centimeter; 1 cm is 1e7 nm.
            let denominator = f64::from(RESOLUTION_PIXELS) * size_nm / 1e7;
            let denominator = denominator.round().clamp(1.0, f64::from(u32::MAX)) as u64;
            let ratio = u64::from(RESOLUTION_PIXELS) | denominator << 32;
            let at = fields.len() - 2;
            let resolution = [(282, RATIONAL, 1, ratio), (283, RATIONAL, 1, ratio), (296, SHORT, 1, 3)];
            fields.splice(at..at, resolution);
        }
        fields
    }
}
