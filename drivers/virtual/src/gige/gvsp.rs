//! The stream protocol (GVSP): one frame as leader, payload packets and trailer; all numbers big-endian.

use super::setup::{PixelFormat, Region};

/// Bytes of a packet that are no payload: IP, UDP and GVSP headers.
const HEADERS: usize = 20 + 8 + 8;
/// Bytes of the GVSP header.
const HEADER: usize = 8;
/// Payload type of an image.
const IMAGE: u16 = 1;

/// A frame ready to be sent, and sent again.
#[derive(Debug)]
pub(super) struct Packets {
    pub(super) block_id: u16,
    pub(super) time_ns: u64,
    pub(super) region: Region,
    pub(super) format: PixelFormat,
    pub(super) payload: Vec<u8>,
    pub(super) packet_size: usize,
}

impl Packets {
    fn bytes_per_packet(&self) -> usize {
        self.packet_size.saturating_sub(HEADERS).max(1)
    }

    /// Leader, payload packets and trailer.
    pub(super) fn num_packets(&self) -> u32 {
        let payload_packets = self.payload.len().div_ceil(self.bytes_per_packet());
        u32::try_from(payload_packets + 2).unwrap_or(u32::MAX)
    }

    /// Writes packet `number` into `packet`.
    pub(super) fn write(&self, number: u32, packet: &mut Vec<u8>) {
        packet.clear();
        let last = self.num_packets() - 1;
        let content: u32 = match number {
            0 => 1,
            number if number == last => 2,
            _ => 3,
        };
        packet.extend(0_u16.to_be_bytes());
        packet.extend(self.block_id.to_be_bytes());
        packet.extend((content << 24 | number).to_be_bytes());
        debug_assert_eq!(packet.len(), HEADER);
        match content {
            1 => self.write_leader(packet),
            2 => {
                packet.extend(u32::from(IMAGE).to_be_bytes());
                packet.extend(self.region.height.to_be_bytes());
            }
            _ => {
                let first = (number as usize - 1) * self.bytes_per_packet();
                let end = (first + self.bytes_per_packet()).min(self.payload.len());
                packet.extend(&self.payload[first..end]);
            }
        }
    }

    fn write_leader(&self, packet: &mut Vec<u8>) {
        packet.extend(0_u16.to_be_bytes());
        packet.extend(IMAGE.to_be_bytes());
        packet.extend(self.time_ns.to_be_bytes());
        packet.extend((self.format as u32).to_be_bytes());
        let Region { left, top, width, height } = self.region;
        packet.extend([width, height, left, top].map(u32::to_be_bytes).concat());
        packet.extend(0_u32.to_be_bytes());
    }
}

/// Counts as the camera sends them; Mono16 and Mono12 are little-endian (PFNC 2.4), larger counts are clipped.
pub(super) fn pack(format: PixelFormat, counts: &[u16], payload: &mut Vec<u8>) {
    payload.clear();
    let most = format.saturation();
    let pairs = |write: fn(u16, u16) -> [u8; 3]| {
        counts.chunks(2).flat_map(move |pair| {
            let second = pair.get(1).copied().unwrap_or(0);
            write(pair[0].min(0xFFF), second.min(0xFFF))
        })
    };
    match format {
        PixelFormat::Mono8 => payload.extend(counts.iter().map(|&count| count.min(most) as u8)),
        PixelFormat::Mono12 | PixelFormat::Mono16 => {
            payload.extend(counts.iter().flat_map(|&count| count.min(most).to_le_bytes()));
        }
        PixelFormat::Mono12Packed => payload.extend(pairs(|first, second| {
            [(first >> 4) as u8, ((second & 0xF) << 4 | first & 0xF) as u8, (second >> 4) as u8]
        })),
        PixelFormat::Mono12p => payload.extend(pairs(|first, second| {
            [first as u8, ((second & 0xF) << 4 | first >> 8) as u8, (second >> 4) as u8]
        })),
    }
    payload.truncate(format.num_bytes(counts.len()));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn twelve_bits_are_packed_as_the_standards_say() {
        let mut payload = Vec::new();
        pack(PixelFormat::Mono12p, &[0xABC, 0xDEF], &mut payload);
        assert_eq!(payload, [0xBC, 0xFA, 0xDE]);
        pack(PixelFormat::Mono12Packed, &[0xABC, 0xDEF, 0x123], &mut payload);
        assert_eq!(payload, [0xAB, 0xFC, 0xDE, 0x12, 0x03]);
    }

    #[test]
    fn a_frame_is_leader_payload_and_trailer() {
        let region = Region { left: 0, top: 0, width: 100, height: 3 };
        let format = PixelFormat::Mono8;
        let payload = vec![7; 300];
        let frame = Packets { block_id: 9, time_ns: 1, region, format, payload, packet_size: 136 };
        let mut packet = Vec::new();
        let sizes: Vec<usize> = (0..frame.num_packets())
            .map(|number| {
                frame.write(number, &mut packet);
                packet.len()
            })
            .collect();
        assert_eq!(sizes, [8 + 36, 108, 108, 108, 16]);
    }
}
