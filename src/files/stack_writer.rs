//! Stacks of camera counts written as OME-TIFF, one page per frame.
//!
//! In: frames of uint16 counts, their number known beforehand. Out: one file, BigTIFF when it would pass 3.9 GB.
//! Never: keeps a frame, writes over an existing file. Fails: [`FileError`] when the disk does or a frame does not fit.

use std::path::{Path, PathBuf};
use std::time::Duration;

use super::FileError;
use super::ome_xml::{OmeImage, document};
use super::tiff_writer::{PageFormat, TiffWriter, file_bytes};

/// What is known about a stack before its first frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StackHeader {
    /// Frames that will be written.
    pub frames: usize,
    /// Rows of a frame, in pixels.
    pub height: usize,
    /// Columns of a frame, in pixels.
    pub width: usize,
    /// Name of the image.
    pub name: String,
    /// Name of the channel, such as `Reflected`.
    pub channel: String,
    /// Free text for a reader.
    pub description: String,
    /// Pixel size in the sample, in nanometers.
    pub pixel_size_nm: Option<f64>,
    /// Time from frame to frame.
    pub frame_interval: Option<Duration>,
    /// How the frames came to be, as keys and values.
    pub settings: Vec<(String, String)>,
}

impl StackHeader {
    /// Upper bound of the size of the file, in bytes; for [`ensure_free`](super::ensure_free).
    ///
    /// # Errors
    /// [`FileError::NotWritable`] when a size is zero or beyond what TIFF can say.
    pub fn file_bytes(&self, path: &Path) -> Result<u64, FileError> {
        let format = self.format(path)?;
        Ok(file_bytes(&format, self.frames as u64, self.document().len() as u64))
    }

    fn format(&self, path: &Path) -> Result<PageFormat, FileError> {
        page_format(path, [self.frames, self.height, self.width], 16, self.pixel_size_nm)
    }

    fn document(&self) -> String {
        document(&OmeImage {
            name: &self.name,
            description: &self.description,
            sample: "uint16",
            height: self.height,
            width: self.width,
            channels: std::slice::from_ref(&self.channel),
            frames: self.frames,
            pixel_size_nm: self.pixel_size_nm,
            frame_interval_s: self.frame_interval.map(|interval| interval.as_secs_f64()),
            delta_t_s: &[],
            settings: &self.settings,
        })
    }
}

/// A stack under way.
#[derive(Debug)]
pub struct StackWriter {
    writer: TiffWriter,
    path: PathBuf,
    frames: usize,
    frame_len: usize,
}

impl StackWriter {
    /// Creates the file `path`, which must not exist.
    ///
    /// # Errors
    /// [`FileError::OutputExists`], [`FileError::NotWritable`] for sizes of zero, and whatever the disk says.
    pub fn create(path: &Path, header: &StackHeader) -> Result<StackWriter, FileError> {
        let format = header.format(path)?;
        let writer = TiffWriter::create(path, format, header.frames as u64, header.document())?;
        Ok(StackWriter {
            writer,
            path: path.to_path_buf(),
            frames: header.frames,
            frame_len: header.height * header.width,
        })
    }

    /// Appends one frame, row by row (`height * width` counts).
    ///
    /// # Errors
    /// [`FileError::NotWritable`] for a frame of another size or one too many, [`FileError::DiskFull`].
    pub fn push(&mut self, counts: &[u16]) -> Result<(), FileError> {
        if counts.len() != self.frame_len {
            let reason = format!("a frame has {} pixels, not {}", self.frame_len, counts.len());
            return Err(not_writable(&self.path, reason));
        }
        if self.writer.pages_written() >= self.frames as u64 {
            let reason = format!("all its {} frames are written already", self.frames);
            return Err(not_writable(&self.path, reason));
        }
        self.writer.push(bytemuck::cast_slice(counts))
    }

    /// Hands the whole stack to the operating system.
    ///
    /// # Errors
    /// [`FileError::NotWritable`] when frames are missing, [`FileError::DiskFull`].
    pub fn finish(self) -> Result<(), FileError> {
        let written = self.writer.pages_written();
        if written != self.frames as u64 {
            let reason = format!("{written} of {} frames came", self.frames);
            return Err(not_writable(&self.path, reason));
        }
        self.writer.finish()
    }
}

/// The format of uncompressed pages; `[pages, height, width]` must be more than zero and fit.
pub(super) fn page_format(
    path: &Path,
    [pages, height, width]: [usize; 3],
    bits: u16,
    pixel_size_nm: Option<f64>,
) -> Result<PageFormat, FileError> {
    let sizes = (u32::try_from(height), u32::try_from(width));
    let (Ok(rows), Ok(columns), false) = (sizes.0, sizes.1, [pages, height, width].contains(&0)) else {
        let reason = format!("{pages} pages of {height} x {width} pixels are no image");
        return Err(not_writable(path, reason));
    };
    Ok(PageFormat {
        height: rows,
        width: columns,
        bits,
        sample_format: if bits == 32 { 3 } else { 1 },
        compression: 1,
        pixel_size_nm,
    })
}

pub(super) fn not_writable(path: &Path, reason: String) -> FileError {
    FileError::NotWritable { path: path.to_path_buf(), reason }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs::OpenOptions;

    #[test]
    fn a_full_disk_is_said_plainly() {
        let path = Path::new("/dev/full");
        let Ok(file) = OpenOptions::new().write(true).open(path) else {
            return;
        };
        let header = StackHeader { frames: 2, height: 1024, width: 1024, ..StackHeader::default() };
        let format = header.format(path).unwrap();
        let mut writer = TiffWriter::over(file, path, format, 2, header.document()).unwrap();
        let error = writer.push(&vec![0; 2 << 20]).unwrap_err();
        assert!(matches!(error, FileError::DiskFull { .. }), "{error}");
        assert!(error.to_string().contains("not enough space"), "{error}");
    }

    #[test]
    fn more_than_four_gigabytes_become_bigtiff() {
        let folder = tempfile::tempdir().unwrap();
        for (frames, version) in [(10, 42), (10_000, 43)] {
            let path = folder.path().join(format!("{frames}.tif"));
            let header = StackHeader { frames, height: 512, width: 512, ..StackHeader::default() };
            let mut writer = StackWriter::create(&path, &header).unwrap();
            writer.push(&vec![0; 512 * 512]).unwrap();
            let said = writer.finish().unwrap_err().to_string();
            assert!(said.contains("1 of"), "{said}");
            assert_eq!(std::fs::read(&path).unwrap()[2], version);
        }
    }
}
