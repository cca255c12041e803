//! The highest rate of two simulated cameras without a lost frame on this computer: a measurement, not a test.
//!
//! `cargo test -p sofiscope-genicam --features aravis --release --test throughput -- --ignored --nocapture`
#![cfg(feature = "aravis")]

mod bench;

use std::time::{Duration, Instant};

use bench::{Fake, SERIAL, address, driver, settings};
use sofiscope_genicam::{GenicamCamera, GenicamSettings};
use sofiscope_hal::{Camera, FrameStatus};
use sofiscope_virtual::gige::{Exposure, GigeSettings};

/// The pace of a line of 600 MB/s.
const PACKET_DELAY: Duration = Duration::from_micros(15);
const RUN: Duration = Duration::from_secs(2);

/// Frames per second of the slower camera, and frames that both have lost.
fn run(cameras: &mut [GenicamCamera; 2], side: u32, rate: u32) -> (f64, u64) {
    let period = Duration::from_secs(1) / rate;
    let settings = sofiscope_hal::CameraSettings { period, exposure: period / 4, ..settings(side, side, 10) };
    let streams = cameras.each_mut().map(|camera| {
        camera.configure(&settings).expect("the camera answers");
        camera.arm().expect("the camera answers")
    });
    let grabbers = streams.map(|mut stream| {
        std::thread::spawn(move || {
            let mut counts = vec![0; settings.region.num_pixels()];
            let begun = Instant::now();
            let (mut complete, mut last) = (0, 0);
            while begun.elapsed() < RUN {
                let Ok(info) = stream.next_frame(&mut counts, Duration::from_millis(200)) else { continue };
                if info.status != FrameStatus::Complete {
                    println!("exposure {} is incomplete", info.exposure.0);
                }
                complete += u64::from(info.status == FrameStatus::Complete);
                last = info.exposure.0 + 1;
            }
            (complete as f64 / begun.elapsed().as_secs_f64(), last - complete)
        })
    });
    let results = grabbers.map(|grabber| grabber.join().expect("the camera answers"));
    cameras.iter_mut().for_each(|camera| camera.stop().expect("the camera answers"));
    (results[0].0.min(results[1].0), results[0].1 + results[1].1)
}

#[test]
#[ignore = "a measurement that takes minutes and wants the computer for itself"]
fn highest_rate_of_two_cameras_without_loss() {
    let _fakes = [1, 2].map(|number| {
        let settings = GigeSettings::new(address(40, number), SERIAL);
        let settings =
            GigeSettings { sensor: (2048, 2048), row_readout: Duration::from_nanos(100), ..settings };
        Fake::start_with(settings, |exposure: &Exposure, counts: &mut [u16]| {
            counts.fill(exposure.index as u16);
        })
    });
    let mut cameras = [1, 2].map(|number| {
        let settings = GenicamSettings {
            packet_size: Some(9000),
            packet_delay: PACKET_DELAY,
            ..driver(address(40, number))
        };
        GenicamCamera::open(settings).unwrap()
    });
    for (side, rates) in [
        (256, &[400, 800, 1000, 1500][..]),
        (512, &[200, 300, 400, 500, 600]),
        (1024, &[50, 75, 100, 125, 150]),
        (2048, &[10, 20, 25, 30, 40, 50]),
    ] {
        let mut best: Option<f64> = None;
        for &rate in rates {
            let (reached, lost) = run(&mut cameras, side, rate);
            println!("2 x {side} x {side} at {rate} Hz: {reached:.1} Hz, {lost} lost");
            if lost == 0 {
                best = Some(best.unwrap_or(0.0).max(reached));
            }
        }
        println!("2 x {side} x {side}: without loss up to {best:.1?} Hz");
    }
}
