//! `bench`: pairs per second per order beside the machine's own memory bandwidth, measured in the same run.

use super::AppError;
use crate::reconstruction::AllCores;
use crate::sofi::cumulant::{CumulantEngine, CumulantSettings, Exposure};
use crate::sofi::grid::Combinations;
use crate::sofi::registration::{
    Affine, Interpolation, Mirror, NoiseLine, ReflectedFromTransmitted, RegistrationSettings,
};
use rayon::prelude::*;
use serde::Serialize;
use std::time::{Duration, Instant};

/// Exposures that the engine is given at once, as the live pipeline does.
const BLOCK: usize = 32;

/// Bytes of the memory whose reading is timed.
const LARGE_MEMORY: usize = 512 << 20;

/// One measured case.
#[derive(Debug, Clone, Serialize)]
pub struct Measurement {
    /// What was measured.
    pub case: String,
    /// Cumulant order.
    pub order: usize,
    /// Width of one camera image, pixels.
    pub width: usize,
    /// Height of one camera image, pixels.
    pub height: usize,
    /// Median over rounds, both cores.
    pub pairs_per_second: f64,
    /// Bytes of camera data taken in per second.
    pub input_bytes_per_second: f64,
    /// Median read bandwidth measured between the rounds.
    pub read_bandwidth_bytes_per_second: f64,
}

/// A case to measure.
#[derive(Debug, Clone, Copy)]
pub struct Case {
    name: &'static str,
    order: usize,
    side: usize,
    combinations: Combinations,
    /// Whether camera T is brought onto camera R as a real one must be.
    registered: bool,
}

/// The cases of the command, the paper's camera size first.
pub const CASES: [Case; 5] = [
    Case {
        name: "two cameras, all spectral channels",
        order: 2,
        side: 2048,
        combinations: Combinations::AllClosest,
        registered: false,
    },
    Case {
        name: "two cameras, all spectral channels, T mirrored, turned and stretched",
        order: 2,
        side: 2048,
        combinations: Combinations::AllClosest,
        registered: true,
    },
    Case {
        name: "two cameras, all spectral channels",
        order: 3,
        side: 512,
        combinations: Combinations::AllClosest,
        registered: false,
    },
    Case {
        name: "two cameras, all spectral channels",
        order: 4,
        side: 512,
        combinations: Combinations::AllClosest,
        registered: false,
    },
    Case {
        name: "two cameras, one set per position",
        order: 4,
        side: 512,
        combinations: Combinations::OnePerPosition,
        registered: false,
    },
];

/// Measures one case: rounds of engine work and of plain reading in turn.
#[must_use]
pub fn measure(case: Case, rounds: usize) -> Measurement {
    let pixels = case.side * case.side;
    let memory: Vec<Vec<u16>> = (0..2 * BLOCK).map(|frame| frame_of_noise(pixels, frame as u64)).collect();
    let planes: Vec<[&[u16]; 2]> =
        (0..BLOCK).map(|pair| [&memory[2 * pair][..], &memory[2 * pair + 1][..]]).collect();
    let settings = CumulantSettings {
        combinations: case.combinations,
        registration: case.registered.then(|| registration(case.side)),
        ..CumulantSettings::new(case.order, 2, 200)
    };
    let mut engine =
        CumulantEngine::<u16>::new(settings, case.side, case.side).expect("the built-in cases are valid");
    let mut next = 0;
    let mut push_block = || {
        let exposures: Vec<_> = planes
            .iter()
            .enumerate()
            .map(|(i, planes)| Exposure { index: next + i as u64, planes })
            .collect();
        engine.push(&AllCores, &exposures).expect("exposures rise");
        next += BLOCK as u64;
    };
    push_block();
    let per_round = blocks_per_round(&mut push_block);
    let (mut speeds, mut bandwidths) = (Vec::new(), Vec::new());
    let large = vec![1u16; LARGE_MEMORY / size_of::<u16>()];
    for _ in 0..rounds {
        bandwidths.push(read_bandwidth(&large));
        let start = Instant::now();
        (0..per_round).for_each(|_| push_block());
        speeds.push((per_round * BLOCK) as f64 / start.elapsed().as_secs_f64());
    }
    let pairs_per_second = median(&mut speeds);
    Measurement {
        case: case.name.to_owned(),
        order: case.order,
        width: case.side,
        height: case.side,
        pairs_per_second,
        input_bytes_per_second: pairs_per_second * (pixels * 2 * size_of::<u16>()) as f64,
        read_bandwidth_bytes_per_second: median(&mut bandwidths),
    }
}

/// Cameras as they stand in real setups: mirrored, 40 pixels apart, turned by 1 degree, stretched by 1 %.
fn registration(side: usize) -> RegistrationSettings {
    let (sin, cos) = (1.01 * 0.0175, 1.01);
    RegistrationSettings {
        transform: ReflectedFromTransmitted {
            mirror: Mirror::Horizontal,
            affine: Affine { matrix: [[cos, sin], [-sin, cos]], shift: [22.4, 4.45] },
            size: [side, side],
        },
        interpolation: Interpolation::UnbiasedSinc,
        noise: NoiseLine::of_camera(2.174, 100.0, 3.0),
    }
}

/// As many blocks as take about a second, and at least one whole subsequence.
fn blocks_per_round(push_block: &mut impl FnMut()) -> usize {
    let start = Instant::now();
    push_block();
    let block = start.elapsed().max(Duration::from_micros(10));
    (Duration::from_secs(1).as_secs_f64() / block.as_secs_f64()).ceil().clamp(7.0, 400.0) as usize
}

/// Bytes per second at which all cores together read memory that no cache can hold.
fn read_bandwidth(memory: &[u16]) -> f64 {
    let bytes = size_of_val(memory);
    let repeats = (1 << 30) / bytes + 1;
    let start = Instant::now();
    for _ in 0..repeats {
        let sum: u64 = memory.par_chunks(1 << 20).map(sum_of).sum();
        std::hint::black_box(sum);
    }
    (bytes * repeats) as f64 / start.elapsed().as_secs_f64()
}

fn sum_of(frame: &[u16]) -> u64 {
    pulp::Arch::new().dispatch(
        #[inline(always)]
        || {
            frame
                .chunks(4096)
                .map(|chunk| {
                    let sum = chunk.iter().fold(0u32, |sum, &value| sum + u32::from(value));
                    u64::from(sum)
                })
                .sum()
        },
    )
}

fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Counts around 200 from a small generator; what they are does not change the speed.
fn frame_of_noise(pixels: usize, seed: u64) -> Vec<u16> {
    let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
    let mut next = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        150 + (state >> 57) as u16
    };
    (0..pixels).map(|_| next()).collect()
}

/// Arguments of `bench`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  sofiscope bench
  sofiscope bench --order 2 --json > speed.json
  sofiscope bench --live 2048 --rate 50")]
pub struct BenchArguments {
    /// Measure only the cases of this order
    #[arg(long)]
    order: Option<usize>,
    /// Rounds per case; the median is reported
    #[arg(long, default_value_t = 5)]
    rounds: usize,
    #[command(flatten)]
    live: super::bench_live::LiveArguments,
    /// Print a list of objects on stdout
    #[arg(long)]
    json: bool,
}

/// Runs `bench`.
///
/// # Errors
/// A usage error when no case has the order asked for.
pub fn run(arguments: &BenchArguments) -> Result<(), AppError> {
    if arguments.live.is_wanted() {
        return super::bench_live::run(&arguments.live, arguments.order.unwrap_or(2), arguments.json);
    }
    let cases: Vec<Case> =
        CASES.into_iter().filter(|case| arguments.order.is_none_or(|order| case.order == order)).collect();
    if cases.is_empty() {
        return Err(AppError::usage("bench has cases of order 2, 3 and 4; choose one of these with --order"));
    }
    let mut measurements = Vec::new();
    for case in cases {
        eprintln!("measuring {}, order {}, {} x {}", case.name, case.order, case.side, case.side);
        let measurement = measure(case, arguments.rounds.max(1));
        if !arguments.json {
            println!("{}", line(&measurement));
        }
        measurements.push(measurement);
    }
    if arguments.json {
        println!("{}", serde_json::to_string_pretty(&measurements).map_err(AppError::data)?);
    }
    Ok(())
}

fn line(m: &Measurement) -> String {
    format!(
        "{}, order {}, 2 x {} x {}: {:.1} pairs/s, {:.2} GB/s of input, {:.2} of the {:.1} GB/s that memory reads",
        m.case,
        m.order,
        m.width,
        m.height,
        m.pairs_per_second,
        m.input_bytes_per_second / 1e9,
        m.input_bytes_per_second / m.read_bandwidth_bytes_per_second,
        m.read_bandwidth_bytes_per_second / 1e9
    )
}
