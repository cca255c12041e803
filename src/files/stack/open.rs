//! Opening a stack: header, page list, description, and whether they agree.
//!
//! In: a path. Out: an [`ImageStack`] ready to read.
//! Never: reads pixels. Fails: [`FileError`] with what does not fit.

use std::path::Path;

use super::directory::{Directories, Directory};
use super::metadata::{self, Dialect, Metadata};
use super::page::{Geometry, Page};
use super::source::Source;
use super::{ImageStack, Pages, StackInfo, pixels};
use crate::files::{FileError, Place};

const DESCRIPTION: &str = "ImageDescription";

pub(super) fn open(path: &Path) -> Result<ImageStack, FileError> {
    let mut source = Source::open(path)?;
    let (first, is_big) = Directories::read_header(&mut source)?;
    let (pages, geometry, metadata) = walk(&source, first, is_big)?;
    let (pages, num_planes) = match contiguous(&source, &pages, geometry, &metadata)? {
        Some((contiguous, num_planes)) => (contiguous, num_planes),
        None => {
            let num_pages = pages.len() as u64;
            (Pages::Listed(pages), num_pages)
        }
    };
    ensure_complete(&source, &metadata, num_planes)?;
    let channels = channels(&source, &metadata, num_planes)?;
    let frames = num_planes / channels;
    Ok(ImageStack {
        source,
        pages,
        geometry,
        run: metadata.run.clamp(1, frames.max(1)) as usize,
        info: info(geometry, frames as usize, channels as usize, metadata),
        channel: 0,
        next_frame: 0,
        last_page: 0,
    })
}

/// Reads all directories once; the pages are proved to be alike.
fn walk(source: &Source, first: u64, is_big: bool) -> Result<(Vec<Page>, Geometry, Metadata), FileError> {
    let mut directories = Directories::new(source, first, is_big);
    let mut pages = Vec::new();
    let mut common: Option<(Geometry, Metadata)> = None;
    while let Some(directory) = directories.advance()? {
        let Some((page, geometry)) = Page::parse(source, &directory)? else {
            continue;
        };
        match &common {
            None => common = Some((geometry, metadata::read(source, &directory)?)),
            Some((first, _)) => ensure_alike(source, &directory, *first, geometry)?,
        }
        pages.push(page);
    }
    match (common, pages.last()) {
        (Some((geometry, metadata)), Some(last)) => {
            last.chunks(source, geometry)?;
            Ok((pages, geometry, metadata))
        }
        _ => Err(source.damaged(Place::Header, "page list", "the file has no page")),
    }
}

fn ensure_alike(
    source: &Source,
    directory: &Directory,
    first: Geometry,
    this: Geometry,
) -> Result<(), FileError> {
    if this == first {
        return Ok(());
    }
    let detail = format!("the page is {this}, the first is {first}");
    let remedy = "Save the pages of one size and type to a file of their own";
    Err(source.unsupported(directory.place, "ImageWidth and ImageLength", detail, remedy))
}

/// ImageJ stacks may have one directory and all pixels after it: its way to write more than 4 GB; Python's writer can too.
fn contiguous(
    source: &Source,
    pages: &[Page],
    geometry: Geometry,
    metadata: &Metadata,
) -> Result<Option<(Pages, u64)>, FileError> {
    let promised = metadata.planes.unwrap_or(1);
    let [first] = pages else {
        return Ok(None);
    };
    if metadata.dialect == Dialect::Ome || promised <= 1 {
        return Ok(None);
    }
    let chunks = first.chunks(source, geometry)?;
    let Some(offset) = pixels::contiguous_start(first, &chunks) else {
        return Ok(None);
    };
    let frame = geometry.frame_bytes() as u64;
    let held = (source.length - offset) / frame;
    let pages = Pages::Contiguous { first: *first, offset };
    Ok(Some((pages, promised.min(held))))
}

/// Refuses files with fewer planes than promised; only OME files may be a part of a set or of a run that was stopped.
fn ensure_complete(source: &Source, metadata: &Metadata, held: u64) -> Result<(), FileError> {
    let promised = metadata.planes.unwrap_or(held);
    if held >= promised {
        return Ok(());
    }
    if metadata.dialect != Dialect::Ome {
        let detail = format!("it promises {promised} images, the file holds {held}");
        return Err(source.damaged(Place::Page(1), DESCRIPTION, detail));
    }
    tracing::warn!(path = %source.path.display(), promised, held, "the OME-XML promises more planes than the file holds");
    Ok(())
}

/// Channels of a file with `num_planes` planes; contradictions are errors, a set spread over several files is not.
fn channels(source: &Source, metadata: &Metadata, num_planes: u64) -> Result<u64, FileError> {
    let channels = metadata.channels;
    let promised = metadata.planes.unwrap_or(num_planes);
    let is_complete = promised == num_planes;
    let is_one_channel_of_a_set = num_planes.checked_mul(channels) == Some(promised);
    let is_cut_between_frames = metadata.run == 1 && num_planes.is_multiple_of(channels);
    if channels == 1 || is_one_channel_of_a_set && !is_complete {
        return Ok(1);
    }
    if num_planes.is_multiple_of(channels) && (is_complete || is_cut_between_frames) {
        return Ok(channels);
    }
    let detail =
        format!("it promises {promised} planes in {channels} channels, the file holds {num_planes} pages");
    Err(source.damaged(Place::Page(1), DESCRIPTION, detail))
}

fn info(geometry: Geometry, frames: usize, channels: usize, metadata: Metadata) -> StackInfo {
    let mut channel_names = metadata.channel_names;
    channel_names.resize(channels, String::new());
    StackInfo {
        frames,
        channels,
        height: geometry.height,
        width: geometry.width,
        sample: geometry.sample,
        dialect: metadata.dialect,
        channel_names,
        pixel_size_nm: metadata.pixel_size_nm,
        frame_interval: metadata.frame_interval,
    }
}
