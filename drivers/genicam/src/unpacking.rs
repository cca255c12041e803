//! Counts out of the bytes of a frame, in one pass into the caller's memory.
//!
//! In: bytes in one of the monochrome formats of PFNC 2.4 and GigE Vision 1.2. Out: counts.
//! Never: allocates. Fails: when there are fewer bytes than the pixels need.

/// How pixels lie in the bytes of a frame; the numbers are those of the standards.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub(crate) enum Layout {
    Mono8 = 0x0108_0001,
    Mono10 = 0x0110_0003,
    Mono12 = 0x0110_0005,
    Mono14 = 0x0110_0025,
    Mono16 = 0x0110_0007,
    /// Two pixels in three bytes, the low bits of both in the middle one (GigE Vision).
    Mono12Packed = 0x010C_0006,
    /// Two pixels in three bytes, bits in their order (PFNC).
    Mono12p = 0x010C_0047,
}

impl Layout {
    /// All layouts, the ones with most bits first, unpacked before packed.
    pub(crate) const ALL: [Self; 7] = [
        Self::Mono16,
        Self::Mono14,
        Self::Mono12,
        Self::Mono12p,
        Self::Mono12Packed,
        Self::Mono10,
        Self::Mono8,
    ];

    /// The name in the Standard Features Naming Convention.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Mono8 => "Mono8",
            Self::Mono10 => "Mono10",
            Self::Mono12 => "Mono12",
            Self::Mono14 => "Mono14",
            Self::Mono16 => "Mono16",
            Self::Mono12Packed => "Mono12Packed",
            Self::Mono12p => "Mono12p",
        }
    }

    pub(crate) fn saturation(self) -> u16 {
        match self {
            Self::Mono8 => 0xFF,
            Self::Mono10 => 0x3FF,
            Self::Mono12 | Self::Mono12Packed | Self::Mono12p => 0xFFF,
            Self::Mono14 => 0x3FFF,
            Self::Mono16 => u16::MAX,
        }
    }

    /// Bytes of so many pixels; bits 16 to 23 of the number are the bits of one.
    pub(crate) fn num_bytes(self, num_pixels: usize) -> usize {
        let bits = (self as u32 >> 16) as usize & 0xFF;
        (num_pixels * bits).div_ceil(8)
    }

    /// Writes the counts; false when there are too few bytes, and then nothing is written.
    pub(crate) fn unpack(self, bytes: &[u8], counts: &mut [u16]) -> bool {
        let Some(bytes) = bytes.get(..self.num_bytes(counts.len())) else { return false };
        match self {
            Self::Mono8 => {
                for (count, &byte) in counts.iter_mut().zip(bytes) {
                    *count = byte.into();
                }
            }
            Self::Mono10 | Self::Mono12 | Self::Mono14 | Self::Mono16 => {
                for (count, &pair) in counts.iter_mut().zip(bytes.as_chunks().0) {
                    *count = u16::from_le_bytes(pair);
                }
            }
            Self::Mono12Packed => {
                unpack_pairs(bytes, counts, |high, low, other| {
                    (high << 4 | low & 0xF, other << 4 | low >> 4)
                });
            }
            Self::Mono12p => unpack_pairs(bytes, counts, |first, middle, last| {
                (first | (middle & 0xF) << 8, last << 4 | middle >> 4)
            }),
        }
        true
    }
}

/// Three bytes make two counts; a last odd count has two bytes of its own.
fn unpack_pairs(bytes: &[u8], counts: &mut [u16], unpack: impl Fn(u16, u16, u16) -> (u16, u16)) {
    let (pairs, odd) = counts.as_chunks_mut::<2>();
    let (triples, rest) = bytes.as_chunks::<3>();
    for (pair, triple) in pairs.iter_mut().zip(triples) {
        let [first, middle, last] = triple.map(u16::from);
        (pair[0], pair[1]) = unpack(first, middle, last);
    }
    if let ([count], [first, middle, ..]) = (odd, rest) {
        *count = unpack((*first).into(), (*middle).into(), 0).0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn twelve_bits_come_out_of_three_bytes() {
        let mut counts = [0; 3];
        assert!(Layout::Mono12Packed.unpack(&[0xAB, 0xFC, 0xDE, 0x12, 0x03], &mut counts));
        assert_eq!(counts, [0xABC, 0xDEF, 0x123]);
        assert!(Layout::Mono12p.unpack(&[0xBC, 0xFA, 0xDE, 0x23, 0x01], &mut counts));
        assert_eq!(counts, [0xABC, 0xDEF, 0x123]);
    }

    #[test]
    fn whole_bytes_are_little_endian() {
        let mut counts = [0; 2];
        assert!(Layout::Mono16.unpack(&[0x34, 0x12, 0xFF, 0xFF, 9], &mut counts));
        assert_eq!(counts, [0x1234, 0xFFFF]);
        assert!(Layout::Mono8.unpack(&[7, 255], &mut counts));
        assert_eq!(counts, [7, 255]);
    }

    #[test]
    fn too_few_bytes_write_nothing() {
        for layout in Layout::ALL {
            let mut counts = [0xBEEF; 5];
            let bytes = vec![0; layout.num_bytes(5) - 1];
            assert!(!layout.unpack(&bytes, &mut counts), "{layout:?}");
            assert_eq!(counts, [0xBEEF; 5]);
        }
    }

    #[test]
    fn every_pixel_is_written_and_none_is_above_saturation() {
        for layout in Layout::ALL {
            for num_pixels in [1, 2, 7, 64] {
                let mut counts = vec![0xBEEF; num_pixels];
                let clear = if layout.num_bytes(8) == 16 { layout.saturation() } else { u16::MAX };
                let bytes: Vec<u8> = clear.to_le_bytes().repeat(num_pixels);
                assert!(layout.unpack(&bytes, &mut counts), "{layout:?}");
                assert_eq!(counts, vec![layout.saturation(); num_pixels], "{layout:?}");
            }
        }
    }
}
