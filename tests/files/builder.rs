//! TIFF files of every kind, byte by byte, for the reader to read.

use std::io::Write;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Sample {
    U8,
    U16,
    F32,
}

impl Sample {
    pub(crate) fn bytes(self) -> usize {
        match self {
            Sample::U8 => 1,
            Sample::U16 => 2,
            Sample::F32 => 4,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Chunks {
    Strips(usize),
    Tiles(usize, usize),
}

/// A file to be built; `pages` hold the bits of each sample.
#[derive(Clone, Debug)]
pub(crate) struct Tiff {
    pub is_big: bool,
    pub is_big_endian: bool,
    pub height: usize,
    pub width: usize,
    pub sample: Sample,
    /// TIFF code of the compression.
    pub compression: u16,
    pub predictor: u16,
    pub chunks: Chunks,
    pub description: String,
    /// Tag, type and values, for every page; they replace what would be written otherwise.
    pub overrides: Vec<(u16, u16, Vec<u64>)>,
    pub without: Vec<u16>,
    pub pages: Vec<Vec<u32>>,
}

impl Tiff {
    /// Small, uncompressed, little-endian, with `num_pages` pages of distinct pixels.
    pub(crate) fn new(sample: Sample, num_pages: usize, height: usize, width: usize) -> Tiff {
        let pages = (0..num_pages).map(|page| pixels(sample, page, height * width)).collect();
        Tiff {
            is_big: false,
            is_big_endian: false,
            height,
            width,
            sample,
            compression: 1,
            predictor: 1,
            chunks: Chunks::Strips(height),
            description: String::new(),
            overrides: Vec::new(),
            without: Vec::new(),
            pages,
        }
    }

    pub(crate) fn set(mut self, tag: u16, kind: u16, value: u64) -> Tiff {
        self.overrides.push((tag, kind, vec![value]));
        self
    }

    pub(crate) fn build(&self) -> Vec<u8> {
        let mut file = if self.is_big_endian { b"MM".to_vec() } else { b"II".to_vec() };
        let mut pointer_at;
        if self.is_big {
            for number in [43, 8, 0] {
                self.put(&mut file, number, 2);
            }
            pointer_at = file.len();
            self.put(&mut file, 0, 8);
        } else {
            self.put(&mut file, 42, 2);
            pointer_at = file.len();
            self.put(&mut file, 0, 4);
        }
        for page in &self.pages {
            let fields = self.fields(&mut file, page);
            let position = file.len() as u64;
            self.patch(&mut file, pointer_at, position);
            pointer_at = self.put_directory(&mut file, &fields);
        }
        file
    }

    fn slot(&self) -> usize {
        if self.is_big { 8 } else { 4 }
    }

    pub(crate) fn put(&self, file: &mut Vec<u8>, value: u64, size: usize) {
        let mut bytes = value.to_le_bytes()[..size].to_vec();
        if self.is_big_endian {
            bytes.reverse();
        }
        file.extend(bytes);
    }

    fn patch(&self, file: &mut [u8], at: usize, value: u64) {
        let mut bytes = Vec::new();
        self.put(&mut bytes, value, self.slot());
        file[at..at + bytes.len()].copy_from_slice(&bytes);
    }

    fn fields(&self, file: &mut Vec<u8>, page: &[u32]) -> Vec<(u16, u16, Vec<u64>)> {
        let mut offsets = Vec::new();
        let mut counts = Vec::new();
        for chunk in self.chunk_rows(page) {
            let packed = self.compress(&chunk);
            offsets.push(file.len() as u64);
            counts.push(packed.len() as u64);
            file.extend(packed);
        }
        let offset_kind = if self.is_big { 16 } else { 4 };
        let format = if self.sample == Sample::F32 { 3 } else { 1 };
        let mut fields: Vec<(u16, u16, Vec<u64>)> = vec![
            (256, 4, vec![self.width as u64]),
            (257, 4, vec![self.height as u64]),
            (258, 3, vec![8 * self.sample.bytes() as u64]),
            (259, 3, vec![u64::from(self.compression)]),
            (262, 3, vec![1]),
            (277, 3, vec![1]),
            (317, 3, vec![u64::from(self.predictor)]),
            (339, 3, vec![format]),
        ];
        if !self.description.is_empty() {
            let text = self.description.bytes().chain([0]).map(u64::from).collect();
            fields.push((270, 2, text));
        }
        match self.chunks {
            Chunks::Strips(rows) => {
                fields.push((273, offset_kind, offsets));
                fields.push((278, 4, vec![rows as u64]));
                fields.push((279, offset_kind, counts));
            }
            Chunks::Tiles(rows, columns) => {
                fields.push((322, 4, vec![columns as u64]));
                fields.push((323, 4, vec![rows as u64]));
                fields.push((324, offset_kind, offsets));
                fields.push((325, offset_kind, counts));
            }
        }
        fields.retain(|(tag, ..)| {
            !self.without.contains(tag) && self.overrides.iter().all(|(other, ..)| other != tag)
        });
        fields.extend(self.overrides.clone());
        fields.sort();
        fields
    }

    /// Writes the directory; returns where its pointer to the next one is.
    fn put_directory(&self, file: &mut Vec<u8>, fields: &[(u16, u16, Vec<u64>)]) -> usize {
        let slot = self.slot();
        let (count_size, field_size) = if self.is_big { (8, 20) } else { (2, 12) };
        let mut values_at = file.len() + count_size + fields.len() * field_size + slot;
        self.put(file, fields.len() as u64, count_size);
        let mut spilled = Vec::new();
        for (tag, kind, values) in fields {
            let size = match kind {
                3 => 2,
                4 | 13 => 4,
                5 | 16 => 8,
                _ => 1,
            };
            let mut bytes = Vec::new();
            for value in values {
                if *kind == 5 {
                    self.put(&mut bytes, value >> 32, 4);
                    self.put(&mut bytes, value & 0xffff_ffff, 4);
                } else {
                    self.put(&mut bytes, *value, size);
                }
            }
            self.put(file, u64::from(*tag), 2);
            self.put(file, u64::from(*kind), 2);
            self.put(file, values.len() as u64, slot);
            if bytes.len() > slot {
                self.put(file, values_at as u64, slot);
                values_at += bytes.len();
                spilled.extend(bytes);
            } else {
                bytes.resize(slot, 0);
                file.extend(bytes);
            }
        }
        let pointer_at = file.len();
        self.put(file, 0, slot);
        file.extend(spilled);
        pointer_at
    }

    /// The bytes of each strip or tile in file order, predictor applied; tiles are padded with 7.
    fn chunk_rows(&self, page: &[u32]) -> Vec<Vec<u8>> {
        let (rows, columns, is_tiled) = match self.chunks {
            Chunks::Strips(rows) => (rows, self.width, false),
            Chunks::Tiles(rows, columns) => (rows, columns, true),
        };
        let mut chunks = Vec::new();
        for top in (0..self.height).step_by(rows) {
            for left in (0..self.width).step_by(columns) {
                let mut bytes = Vec::new();
                let bottom = if is_tiled { top + rows } else { self.height.min(top + rows) };
                for y in top..bottom {
                    let row: Vec<u32> = (left..left + columns)
                        .map(|x| match y < self.height && x < self.width {
                            true => page[y * self.width + x],
                            false => 7,
                        })
                        .collect();
                    bytes.extend(self.row_bytes(&row));
                }
                chunks.push(bytes);
            }
        }
        chunks
    }

    fn row_bytes(&self, row: &[u32]) -> Vec<u8> {
        let size = self.sample.bytes();
        let mut bytes = Vec::new();
        match self.predictor {
            2 => {
                let mut before = 0;
                for value in row {
                    self.put(&mut bytes, u64::from(value.wrapping_sub(before)), size);
                    before = *value;
                }
            }
            3 => {
                let shuffled: Vec<u8> = (0..4)
                    .flat_map(|plane| row.iter().map(move |value| value.to_be_bytes()[plane]))
                    .collect();
                let mut before = 0_u8;
                for byte in shuffled {
                    bytes.push(byte.wrapping_sub(before));
                    before = byte;
                }
            }
            _ => row.iter().for_each(|value| self.put(&mut bytes, u64::from(*value), size)),
        }
        bytes
    }

    fn compress(&self, plain: &[u8]) -> Vec<u8> {
        match self.compression {
            5 => {
                weezl::encode::Encoder::with_tiff_size_switch(weezl::BitOrder::Msb, 8).encode(plain).unwrap()
            }
            8 | 32946 => {
                let mut packer = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::fast());
                packer.write_all(plain).unwrap();
                packer.finish().unwrap()
            }
            50000 => zstd::encode_all(plain, 1).unwrap(),
            _ => plain.to_vec(),
        }
    }
}

/// Bits of reproducible pixels, smooth enough to be compressed and with large steps now and then.
fn pixels(sample: Sample, page: usize, len: usize) -> Vec<u32> {
    (0..len)
        .map(|index| {
            let value = (index * 37 + index / 5 * 1009 + page * 4001) as u32;
            match sample {
                Sample::U8 => value & 0xff,
                Sample::U16 => value & 0xffff,
                Sample::F32 => (value as f32 * 0.37 - 300.0).to_bits(),
            }
        })
        .collect()
}
