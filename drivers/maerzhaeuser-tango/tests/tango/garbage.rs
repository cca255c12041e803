//! Bytes that are lost and bytes that come from nowhere: a move is done only when the stage is there.

use sofiscope_hal::{Motion, Stage};

use crate::bench::{Bench, place};

/// Deterministic random numbers (splitmix64).
struct Random(u64);

impl Random {
    fn below(&mut self, end: u64) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut mixed = self.0;
        mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        (mixed ^ (mixed >> 31)) % end
    }
}

fn disturb(bench: &Bench, random: &mut Random) {
    let (kind, number) = (random.below(4), random.below(12));
    let garbage = (0..number).map(|_| b"\r0@9.M\x00\xff- E\x80"[random.below(12) as usize]).collect();
    bench.port.with(|wire, _| match kind {
        0 => wire.faults().swallow = number as usize,
        1 => wire.faults().garbage = garbage,
        2 => wire.model().faults().silent = 1,
        _ => {}
    });
}

#[test]
fn a_move_over_a_bad_line_is_done_only_at_its_target() {
    let seed = 560;
    let mut random = Random(seed);
    let (mut done, mut failed) = (0, 0);
    for trial in 0..300 {
        let mut bench = Bench::homed();
        for _ in 0..5 {
            let target = place(5000.0 + random.below(95_000) as f64, random.below(60_000) as f64);
            disturb(&bench, &mut random);
            let taken = bench.stage.move_to(target);
            disturb(&bench, &mut random);
            if taken.is_err() || bench.ended().ok() != Some(Motion::Still) {
                failed += 1;
                break;
            }
            done += 1;
            let there = bench.port.with(|wire, now| wire.model().place_um(now));
            let off = (there[0] - target.x.value()).abs().max((there[1] - target.y.value()).abs());
            assert!(off <= 1.0, "trial {trial} of seed {seed}: {there:?} is taken for {target:?}");
        }
    }
    println!("seed {seed}: {done} moves done, {failed} given up");
    assert!(done > 100 && failed > 10, "{done} done, {failed} given up: the line must be bad, but not dead");
}
