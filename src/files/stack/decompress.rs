//! Strips and tiles as streams of plain bytes: LZW, Deflate, zstd or as they are.
//!
//! In: a section of the file. Out: its decompressed bytes through [`Read`].
//! Never: holds more than a window of them. Fails: `io::Error` from damaged data.

use std::io::{self, BufRead, BufReader, Read};

use super::page::Compression;
use super::source::Section;

/// Bytes fetched from the file at a time.
const FETCH_BYTES: u64 = 64 << 10;
/// Largest zstd window accepted, as a power of two; writers of images stay far below.
const ZSTD_WINDOW_LOG_MAX: u32 = 27;

/// A reader of the plain bytes of `section`, which has `bytes` bytes in the file.
pub(super) fn plain_bytes<'file>(
    section: Section<'file>,
    bytes: u64,
    compression: Compression,
) -> io::Result<Box<dyn Read + 'file>> {
    let capacity = bytes.clamp(1, FETCH_BYTES) as usize;
    let packed = BufReader::with_capacity(capacity, section);
    Ok(match compression {
        Compression::None => Box::new(packed),
        Compression::Lzw => Box::new(LzwReader::new(packed)),
        Compression::Deflate => Box::new(flate2::bufread::ZlibDecoder::new(packed)),
        Compression::Zstd => {
            let mut reader = zstd::Decoder::with_buffer(packed)?;
            reader.window_log_max(ZSTD_WINDOW_LOG_MAX)?;
            Box::new(reader)
        }
    })
}

/// LZW as TIFF has it: most significant bit first, code length switched one code early.
struct LzwReader<R> {
    packed: R,
    decoder: weezl::decode::Decoder,
}

impl<R: BufRead> LzwReader<R> {
    fn new(packed: R) -> LzwReader<R> {
        LzwReader { packed, decoder: weezl::decode::Decoder::with_tiff_size_switch(weezl::BitOrder::Msb, 8) }
    }
}

impl<R: BufRead> Read for LzwReader<R> {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        if bytes.is_empty() {
            return Ok(0);
        }
        loop {
            let available = self.packed.fill_buf()?;
            let is_end = available.is_empty();
            let step = self.decoder.decode_bytes(available, bytes);
            self.packed.consume(step.consumed_in);
            let status = step.status.map_err(|error| io::Error::new(io::ErrorKind::InvalidData, error))?;
            if step.consumed_out > 0 {
                return Ok(step.consumed_out);
            }
            match status {
                weezl::LzwStatus::Done => return Ok(0),
                _ if is_end => return Ok(0),
                weezl::LzwStatus::NoProgress if step.consumed_in == 0 => return Ok(0),
                _ => {}
            }
        }
    }
}
