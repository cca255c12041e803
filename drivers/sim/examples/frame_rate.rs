//! Measures how fast a scene plays: `cargo run --release -p sofiscope-sim --example frame_rate [SCENE]`.

use std::time::Instant;

use sofiscope_sim::{Scene, World};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let name = std::env::args().nth(1).unwrap_or_else(|| "figure-s4".into());
    let text = Scene::built_in(&name).ok_or("no such scene")?;
    let scene = Scene::from_toml(text)?;
    let start = Instant::now();
    let world = World::new(&scene, scene.seed());
    let placed = start.elapsed();

    let block = 100.min(scene.frames());
    let mut reflected = vec![0; block as usize * scene.num_pixels()];
    let mut transmitted = reflected.clone();
    let start = Instant::now();
    for first in (0..=scene.frames() - block).step_by(block as usize) {
        world.render_block(first..first + block, &mut reflected, &mut transmitted)?;
    }
    let rendered = start.elapsed();
    let pixels = 2 * scene.num_pixels() as u64 * (scene.frames() / block * block);
    println!(
        "{name}: world {:.2} s, {} frames of 2 x {} x {} in {:.2} s, {:.1} ns per pixel",
        placed.as_secs_f64(),
        scene.frames(),
        scene.height_px(),
        scene.width_px(),
        rendered.as_secs_f64(),
        rendered.as_secs_f64() * 1e9 / pixels as f64,
    );
    Ok(())
}
