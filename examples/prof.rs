//! scratch
use sofiscope::reconstruction::AllCores;
use sofiscope::sofi::cumulant::*;
fn main() {
    let side: usize = std::env::args().nth(1).map_or(2048, |s| s.parse().unwrap());
    let order: usize = std::env::args().nth(2).map_or(2, |s| s.parse().unwrap());
    let blocks: usize = std::env::args().nth(3).map_or(19, |s| s.parse().unwrap());
    let pixels = side * side;
    let mut state = 88172645463325252u64;
    let mut next = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        150 + (state >> 57) as u16
    };
    let memory: Vec<Vec<u16>> = (0..64).map(|_| (0..pixels).map(|_| next()).collect()).collect();
    let planes: Vec<[&[u16]; 2]> = (0..32).map(|i| [&memory[2 * i][..], &memory[2 * i + 1][..]]).collect();
    let mut engine = CumulantEngine::<u16>::new(CumulantSettings::new(order, 2, 200), side, side).unwrap();
    let mut n = 0;
    let cpu = || {
        let mut t = String::new();
        use std::io::Read;
        std::fs::File::open("/proc/self/stat").unwrap().read_to_string(&mut t).unwrap();
        let f: Vec<&str> = t.split(' ').collect();
        (f[13].parse::<f64>().unwrap() + f[14].parse::<f64>().unwrap()) / 100.0
    };
    let (c, t) = (cpu(), std::time::Instant::now());
    for _ in 0..blocks {
        let e: Vec<_> =
            planes.iter().enumerate().map(|(i, p)| Exposure { index: n + i as u64, planes: p }).collect();
        engine.push(&AllCores, &e).unwrap();
        n += 32;
    }
    println!(
        "cpu ms/pair {:.2}  wall pairs/s {:.0}  cpu-bound 2-core {:.0}",
        (cpu() - c) * 1e3 / n as f64,
        n as f64 / t.elapsed().as_secs_f64(),
        2.0 * n as f64 / (cpu() - c)
    );
}
