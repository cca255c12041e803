//! The camera as whoever speaks the protocol by hand finds it.

use std::net::UdpSocket;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;

use super::*;

/// A camera in a thread, and somebody who talks to it.
struct Bench {
    record: GigeRecord,
    over: Arc<AtomicBool>,
    camera: Option<JoinHandle<io::Result<()>>>,
    control: UdpSocket,
    stream: UdpSocket,
    requests: u16,
}

impl Bench {
    fn open(settings: GigeSettings) -> Self {
        let address = settings.address;
        let source = |exposure: &Exposure, counts: &mut [u16]| counts.fill(exposure.index as u16);
        let camera = GigeCamera::open(settings, source).unwrap();
        let (record, over) = (camera.record(), Arc::new(AtomicBool::new(false)));
        let flag = over.clone();
        let camera = Some(std::thread::spawn(move || camera.serve(&flag)));
        let socket = || {
            let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
            socket.set_read_timeout(Some(Duration::from_secs(5))).unwrap();
            socket
        };
        let (control, stream) = (socket(), socket());
        control.connect((address, gvcp::PORT)).unwrap();
        Self { record, over, camera, control, stream, requests: 0 }
    }

    /// Status and payload of the answer.
    fn ask(&mut self, command: u16, payload: &[u8]) -> (u16, Vec<u8>) {
        self.requests += 1;
        let words = [command, payload.len() as u16, self.requests].map(u16::to_be_bytes).concat();
        self.control.send(&[&[0x42, 1], words.as_slice(), payload].concat()).unwrap();
        let mut answer = [0; 1024];
        let length = self.control.recv(&mut answer).unwrap();
        assert_eq!(answer[6..8], self.requests.to_be_bytes());
        (u16::from_be_bytes([answer[0], answer[1]]), answer[8..length].to_vec())
    }

    fn write(&mut self, address: u32, value: u32) -> u16 {
        self.ask(0x82, &[address, value].map(u32::to_be_bytes).concat()).0
    }

    fn start(&mut self) {
        let port = self.stream.local_addr().unwrap().port();
        for (address, value) in [
            (0xA00, 2),
            (0xD00, port.into()),
            (0xD18, 0x7F00_0001),
            (0xD04, 1036),
            (0x8000, 32),
            (0x8004, 32),
        ] {
            assert_eq!(self.write(address, value), 0, "{address:x}");
        }
        assert_eq!(self.write(0x8018, 1), 0);
    }

    /// Block id, content and packet number of the next packet.
    fn packet(&mut self) -> (u16, u8, u32) {
        let mut packet = [0; 2048];
        let length = self.stream.recv(&mut packet).unwrap();
        assert!(length >= 8);
        let number = u32::from_be_bytes([0, packet[5], packet[6], packet[7]]);
        (u16::from_be_bytes([packet[2], packet[3]]), packet[4], number)
    }
}

impl Drop for Bench {
    fn drop(&mut self) {
        self.over.store(true, Ordering::Relaxed);
        let served = self.camera.take().map(JoinHandle::join);
        assert!(std::thread::panicking() || matches!(served, Some(Ok(Ok(())))));
    }
}

fn settings(last: u8) -> GigeSettings {
    GigeSettings::new(Ipv4Addr::new(127, 77, 0, last), "SIM-7")
}

#[test]
fn discovery_says_that_it_is_simulated() {
    let mut bench = Bench::open(settings(1));
    let (status, payload) = bench.ask(2, &[]);
    assert_eq!((status, payload.len()), (0, 0xF8));
    let text = String::from_utf8_lossy(&payload);
    assert!(text.contains("simulated") && text.contains("SIM-7"), "{text}");
}

#[test]
fn frames_are_counted_past_the_wrap() {
    let mut bench = Bench::open(GigeSettings { first_block_id: 65_534, ..settings(2) });
    bench.start();
    // 2048 bytes of payload in packets of 1000.
    let expected = [65_534, 65_535, 1, 2]
        .into_iter()
        .flat_map(|id| [(id, 1, 0), (id, 3, 1), (id, 3, 2), (id, 3, 3), (id, 2, 4)]);
    for expected in expected {
        assert_eq!(bench.packet(), expected);
    }
}

#[test]
fn what_is_not_allowed_is_refused() {
    let mut bench = Bench::open(settings(3));
    bench.start();
    assert_eq!(bench.write(0x8000, 64), gvcp::Status::WriteProtect as u16, "while exposing");
    assert_eq!(bench.write(0x8018, 0), 0);
    assert_eq!(bench.write(0x8000, 66), gvcp::Status::InvalidParameter as u16, "no multiple of four");
    assert_eq!(bench.write(0x8000, 260), gvcp::Status::InvalidParameter as u16, "wider than the sensor");
    assert_eq!(bench.write(0x8050, 260), gvcp::Status::WriteProtect as u16, "the sensor itself");
    let stranger = UdpSocket::bind("127.0.0.1:0").unwrap();
    stranger.connect(bench.control.peer_addr().unwrap()).unwrap();
    let own = std::mem::replace(&mut bench.control, stranger);
    bench.control.set_read_timeout(Some(Duration::from_secs(5))).unwrap();
    assert_eq!(bench.write(0x8000, 64), gvcp::Status::AccessDenied as u16, "another has control");
    bench.control = own;
    assert_eq!(bench.write(0x8000, 64), 0);
}

#[test]
fn lost_frames_are_on_record_and_not_on_the_line() {
    let faults = GigeFaults { lost_frames: vec![1], ..GigeFaults::default() };
    let mut bench = Bench::open(GigeSettings { first_block_id: 7, faults, ..settings(4) });
    bench.start();
    let ids: Vec<u16> = (0..15).map(|_| bench.packet().0).collect();
    assert_eq!(ids, [[7; 5], [9; 5], [10; 5]].concat());
    let expected = Damage { run: 1, exposure: 1, block_id: 8, fate: Fate::Lost };
    assert_eq!(bench.record.damages(), [expected]);
}

#[test]
fn pulses_on_the_table_make_frames_one_each() {
    let table = OpticalTable::private().unwrap();
    let mut bench = Bench::open(GigeSettings { table: Some(table.clone()), ..settings(5) });
    bench.write(0x8034, 1);
    bench.start();
    bench.stream.set_read_timeout(Some(Duration::from_millis(50))).unwrap();
    assert!(bench.stream.recv(&mut [0; 64]).is_err(), "no pulse, no frame");
    bench.stream.set_read_timeout(Some(Duration::from_secs(5))).unwrap();
    for pulse in 1..=3 {
        table.set(crate::table::Quantity::LastPulse, crate::monotonic().as_secs_f64());
        table.set(crate::table::Quantity::Pulses, f64::from(pulse));
        let packets: Vec<(u16, u8, u32)> = (0..5).map(|_| bench.packet()).collect();
        assert!(packets.iter().all(|packet| packet.0 == 65_399 + pulse as u16), "{packets:?}");
    }
}

#[test]
fn packets_are_sent_again_when_asked_for() {
    let faults = GigeFaults { stall_at: Some(1), ..GigeFaults::default() };
    let mut bench = Bench::open(GigeSettings { first_block_id: 9, faults, ..settings(6) });
    bench.start();
    let frame: Vec<(u16, u8, u32)> = (0..5).map(|_| bench.packet()).collect();
    assert_eq!(frame[4], (9, 2, 4));
    bench.control.send(&[0x42, 0, 0, 0x40, 0, 12, 0, 9, 0, 0, 0, 9, 0, 0, 0, 2, 0, 0, 0, 3]).unwrap();
    assert_eq!([bench.packet(), bench.packet()], [(9, 3, 2), (9, 3, 3)]);
    bench.control.send(&[0x42, 0, 0, 0x40, 0, 12, 0, 9, 0, 0, 0, 8, 0, 0, 0, 2, 0, 0, 0, 3]).unwrap();
    assert_eq!(bench.ask(2, &[]).0, 0, "a frame that never was is asked for in vain, and the camera lives");
    assert_eq!(bench.record.resent_packets(), 2);
}
