//! Frames take no memory once the first ones have come.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::time::Duration;

use sofiscope_hal::{Camera, CameraSettings, FrameStream, Region, TriggerMode};
use sofiscope_sim::instrument::SimulatedCamera;
use sofiscope_sim::{Film, Scenario, Scene, SimulatedInstrument, Source, World};

const UNKIND: &str = "
[faults]
drop_one_in = 31
burst_probability = 0.001
burst_lengths = [1, 50]
duplicate_one_in = 20
reorder_within = 16
late_one_in = 40
late_by_frames = 20
incomplete_one_in = 37
missed_trigger_at = [100, 200]
";

fn read(camera: &mut SimulatedCamera, region: Region, frames: usize) -> u64 {
    let period = Duration::from_millis(10);
    let settings = CameraSettings { region, exposure: period, period, trigger: TriggerMode::FreeRunning };
    camera.configure(&settings).unwrap();
    let mut stream: Box<dyn FrameStream> = camera.arm().unwrap();
    let mut counts = vec![0; region.num_pixels()];
    let measured = allocation_counter::measure(|| {
        for _ in 0..frames {
            stream.next_frame(&mut counts, Duration::from_secs(10)).unwrap();
        }
    });
    measured.count_total
}

#[test]
fn frames_take_no_memory_after_arming() {
    let seen = allocation_counter::measure(|| drop(std::hint::black_box(vec![0_u8; 10])));
    assert_eq!(seen.count_total, 1, "the counter counts");
    let scene = Scene::from_toml(Scene::built_in("figure-s4").unwrap()).unwrap().with_frames(200).unwrap();
    let world = World::new(&scene, 1);
    let (height, width) = (scene.height_px() as u32, scene.width_px() as u32);
    let film = Film::render(&world, 5).unwrap();
    let whole = Region { left: 0, top: 0, width, height };
    let part = Region { left: 4, top: 8, width: width / 2, height: height / 2 };
    for (source, frames) in [(Source::from(world), 100), (Source::from(film), 20_000)] {
        let settings = Scenario::from_toml(UNKIND).unwrap().into_settings();
        let instrument = SimulatedInstrument::new(source, settings);
        let mut cameras = instrument.cameras();
        for region in [whole, part] {
            for camera in &mut cameras {
                assert_eq!(read(camera, region, frames), 0, "{region:?}");
                camera.stop().unwrap();
            }
        }
    }
}
