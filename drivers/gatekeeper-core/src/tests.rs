//! The firmware on a bench, byte by byte.

#[cfg(test)]
mod bench;
#[cfg(test)]
mod fuzz;
#[cfg(test)]
mod random;
#[cfg(test)]
mod shell;

use bench::{Answer, Bench, command, crc, frame, status, trip};

const SECOND: u64 = 1_000_000;

#[test]
fn the_check_sum_is_the_one_in_the_tables() {
    assert_eq!(crc(b"123456789"), 0x29B1);
}

#[test]
fn hello_tells_who_it_is() {
    let mut bench = Bench::new();
    let line = bench.say(&frame(7, command::HELLO, 0, &[]));
    let sent = String::from_utf8(line).unwrap();
    let expected = ":000781000500474B01010000002A0804010000FA01";
    assert_eq!(&sent[..sent.len() - 9], expected);
    assert_eq!(sent[sent.len() - 9..][..4], format!("{:04X}", bench.config()));
}

#[test]
fn nothing_opens_before_it_is_armed() {
    let mut bench = Bench::new();
    assert_eq!(bench.state().trip, trip::RESET);
    assert_eq!(bench.command(command::GATES, &[1]).status, status::NOT_ARMED);
    assert_eq!(bench.outputs.gates, 0);
    bench.arm();
    assert_eq!(bench.command(command::GATES, &[0b101]).open, 0b101);
    assert_eq!(bench.outputs.gates, 0b101);
    assert_eq!(bench.command(command::DISARM, &[]).open, 0);
    assert_eq!(bench.command(command::DISARM, &[]).status, status::OK, "twice is fine");
    assert_eq!(bench.command(command::GATES, &[1]).status, status::NOT_ARMED);
}

#[test]
fn without_heartbeats_gates_close_at_a_quarter_second_and_stay_closed() {
    let mut bench = Bench::new();
    bench.arm();
    bench.command(command::GATES, &[1]);
    let armed = bench.now_us;
    for _ in 0..3 {
        bench.pass(200_000);
        assert_eq!(bench.command(command::HEARTBEAT, &[]).status, status::OK);
    }
    let last = bench.now_us;
    assert!(last - armed >= 600_000, "heartbeats hold it");
    bench.pass(249_999);
    assert_eq!(bench.outputs.gates, 1);
    bench.pass(1);
    assert_eq!(bench.outputs.gates, 0, "closed {} µs after the last heartbeat", bench.now_us - last);
    assert_eq!(bench.command(command::HEARTBEAT, &[]).status, status::NOT_ARMED, "latched");
    let state = bench.state();
    assert_eq!((state.trip, state.is_armed()), (trip::WATCHDOG, false));
    bench.arm();
    assert_eq!(bench.state().trip, trip::NONE);
    assert_eq!(bench.outputs.gates, 0, "arming opens nothing");
}

#[test]
fn an_open_interlock_closes_and_closing_it_opens_nothing() {
    let mut bench = Bench::new();
    bench.arm();
    bench.command(command::GATES, &[3]);
    bench.interlock_closed = false;
    bench.step(None);
    assert_eq!(bench.outputs.gates, 0);
    assert_eq!(bench.try_arm().status, status::INTERLOCK_OPEN);
    bench.interlock_closed = true;
    bench.pass(1000);
    let state = bench.state();
    assert_eq!((state.open, state.trip, state.is_armed()), (0, trip::INTERLOCK, false));
    bench.arm();
}

#[test]
fn a_gate_closes_after_its_longest_time() {
    let mut bench = Bench::new();
    assert_eq!(bench.command(command::LIMIT, &[1, 0, 0, 0x27, 0x10]).status, status::OK);
    bench.arm();
    assert_eq!(bench.command(command::LIMIT, &[1, 0, 0, 1, 0]).status, status::BUSY, "not while armed");
    bench.command(command::GATES, &[0b10]);
    bench.pass(9_999);
    assert_eq!(bench.outputs.gates, 0b10);
    bench.pass(1);
    assert_eq!(bench.outputs.gates, 0);
    assert_eq!(bench.state().trip, trip::ON_TIME);
}

#[test]
fn limits_have_limits() {
    let mut bench = Bench::new();
    let mut limit = |gate: u8, us: u32| {
        let [a, b, c, d] = us.to_be_bytes();
        bench.command(command::LIMIT, &[gate, a, b, c, d]).status
    };
    assert_eq!(limit(0, 1_800_000_000), status::OK);
    assert_eq!([limit(0, 0), limit(0, 1_800_000_001), limit(8, 1)], [status::RANGE; 3]);
}

#[test]
fn other_settings_than_expected_are_not_armed() {
    let mut bench = Bench::new();
    let [high, low] = bench.config().wrapping_add(1).to_be_bytes();
    assert_eq!(bench.command(command::ARM, &[high, low]).status, status::CONTENT);
    assert!(!bench.state().is_armed());
}

#[test]
fn levels_are_driven_only_while_armed() {
    let mut bench = Bench::new();
    assert_eq!(bench.command(command::LEVEL, &[2, 0x0F, 0xFF]).status, status::OK);
    assert_eq!(bench.outputs.levels, [0; 4]);
    bench.arm();
    assert_eq!(bench.outputs.levels, [0, 0, 4095, 0]);
    bench.say(b"!");
    assert_eq!(bench.outputs.levels, [0; 4]);
    for wrong in [[4, 0, 0], [0, 0x10, 0]] {
        assert_eq!(bench.command(command::LEVEL, &wrong).status, status::RANGE);
    }
}

#[test]
fn one_byte_closes_everything_for_good() {
    let mut bench = Bench::new();
    bench.arm();
    bench.command(command::GATES, &[0xFF]);
    bench.say(b":00!");
    assert_eq!(bench.outputs.gates, 0);
    assert_eq!(bench.state().trip, trip::COMMANDED);
}

#[test]
fn the_same_command_again_is_answered_and_not_done_again() {
    let mut bench = Bench::new();
    bench.arm();
    let beat = frame(bench.number.wrapping_add(1), command::HEARTBEAT, bench.epoch, &[]);
    let first = Answer::read(&bench.say(&beat)).unwrap();
    bench.number = bench.number.wrapping_add(1);
    bench.pass(249_000);
    assert_eq!(Answer::read(&bench.say(&beat)).unwrap().status, first.status);
    bench.pass(1_000);
    assert_eq!(bench.state().trip, trip::WATCHDOG, "a repeated heartbeat is no sign of life");
}

#[test]
fn stale_commands_open_nothing_and_closing_is_never_stale() {
    let mut bench = Bench::new();
    bench.arm();
    let open = frame(bench.number.wrapping_add(1), command::GATES, bench.epoch, &[1]);
    bench.say(&open);
    bench.number = bench.number.wrapping_add(1);
    bench.command(command::GATES, &[0]);
    assert_eq!(Answer::read(&bench.say(&open)).unwrap().status, status::NUMBER);
    assert_eq!(bench.outputs.gates, 0);
    bench.command(command::GATES, &[1]);
    let close = frame(bench.number.wrapping_sub(9), command::GATES, bench.epoch ^ 1, &[0]);
    assert_eq!(Answer::read(&bench.say(&close)).unwrap().status, status::EPOCH);
    assert_eq!(bench.outputs.gates, 0, "closed all the same");
}

#[test]
fn a_reset_board_takes_no_orders_meant_for_the_one_before() {
    let mut bench = Bench::new();
    bench.arm();
    bench.command(command::GATES, &[1]);
    let epoch = bench.epoch;
    bench.reset();
    bench.step(None);
    assert_eq!((bench.outputs.gates, bench.outputs.levels), (0, [0; 4]));
    let order = frame(bench.number.wrapping_add(1), command::HEARTBEAT, epoch, &[]);
    let answer = Answer::read(&bench.say(&order)).unwrap();
    assert_eq!((answer.status, answer.epoch, answer.trip), (status::EPOCH, bench.epoch, trip::RESET));
}

#[test]
fn a_sequence_follows_the_camera_and_shows_no_half_exposure() {
    let mut bench = Bench::new();
    bench.arm();
    bench.load(&[1, 2, 0, 4]);
    bench.exposing = true;
    bench.step(None);
    assert_eq!(bench.begin(&[1, 2, 0, 4], 0).status, status::OK);
    assert_eq!(bench.outputs.gates, 0, "this exposure began before");
    let mut seen = Vec::new();
    for _ in 0..5 {
        bench.exposing = false;
        bench.pass(100);
        assert_eq!(bench.outputs.gates, 0, "closed between exposures");
        bench.exposing = true;
        bench.pass(100);
        seen.push(bench.outputs.gates);
    }
    assert_eq!(seen, [1, 2, 0, 4, 1]);
    assert_eq!(bench.command(command::GATES, &[1]).status, status::BUSY);
    assert_eq!(bench.state().exposures, 5);
    assert_eq!(bench.command(command::END, &[]).open, 0);
}

#[test]
fn a_camera_that_stops_while_exposing_is_cut_by_the_longest_on_time() {
    let mut bench = Bench::new();
    bench.command(command::LIMIT, &[0, 0, 0, 0xC3, 0x50]);
    bench.arm();
    bench.load(&[1]);
    bench.begin(&[1], 0);
    bench.exposing = true;
    bench.step(None);
    let begun = bench.now_us;
    let changes = bench.pass(200_000);
    let closed = changes.iter().find(|change| change.gates == 0).unwrap();
    assert_eq!(closed.at_us - begun, 50_000);
    assert_eq!(bench.state().trip, trip::ON_TIME);
}

#[test]
fn a_train_gives_its_pulses_and_opens_gates_only_in_its_window() {
    let mut bench = Bench::new();
    bench.arm();
    bench.load(&[1, 2]);
    bench.begin(&[1, 2], 1);
    let begun = bench.now_us;
    assert_eq!(bench.train(10_000, 3, 1_000, 2_000, 5_000).status, status::OK);
    assert_eq!(bench.train(10_000, 3, 1_000, 2_000, 5_000).status, status::BUSY);
    assert!(bench.outputs.pulse(), "the first pulse comes at once");
    let changes: Vec<_> =
        bench.pass(60_000).iter().map(|change| (change.at_us - begun, change.pulse, change.gates)).collect();
    let expected = [
        (1_000, false, 0),
        (2_000, false, 1),
        (7_000, false, 0),
        (10_000, true, 0),
        (11_000, false, 0),
        (12_000, false, 2),
        (17_000, false, 0),
        (20_000, true, 0),
        (21_000, false, 0),
        (22_000, false, 1),
        (27_000, false, 0),
    ];
    assert_eq!(changes, expected);
    let state = bench.state();
    assert_eq!((state.pulses, state.exposures, state.runs_train()), (3, 3, false));
}

#[test]
fn trains_that_cannot_be_made_are_refused() {
    let mut bench = Bench::new();
    for (period, width, delay, open) in [
        (99, 10, 0, 10),
        (60_000_001, 10, 0, 10),
        (1000, 0, 0, 10),
        (1000, 1000, 0, 10),
        (1000, 10, 1000, 0),
        (1000, 10, 500, 501),
        (1000, 10, 500, u32::MAX),
    ] {
        let answer = bench.train(period, 0, width, delay, open);
        assert_eq!((answer.status, answer.pulses), (status::RANGE, 0), "{period} {width} {delay} {open}");
    }
}

#[test]
fn patterns_that_are_not_those_meant_do_not_begin() {
    let mut bench = Bench::new();
    bench.arm();
    bench.load(&[1, 2, 3]);
    assert_eq!(bench.begin(&[1, 2, 4], 0).status, status::CONTENT);
    assert_eq!(bench.begin(&[], 0).status, status::RANGE);
    assert_eq!(bench.command(command::LOAD, &[0, 255, 1, 1]).status, status::RANGE);
    assert_eq!(bench.command(command::LOAD, &[0, 255, 1]).status, status::OK);
}

#[test]
fn a_clock_that_begins_again_changes_nothing() {
    let mut bench = Bench::new();
    bench.now_us = (1 << 32) - 300_000;
    bench.reset();
    bench.arm();
    bench.command(command::GATES, &[1]);
    for _ in 0..4 {
        bench.pass(200_000);
        assert_eq!(bench.command(command::HEARTBEAT, &[]).open, 1);
    }
    assert!(bench.now_us > 1 << 32);
    bench.pass(250_000);
    assert_eq!(bench.outputs.gates, 0);
}

#[test]
fn a_board_switched_on_five_hundred_times_is_never_high() {
    let mut bench = Bench::new();
    let mut high = 0;
    for boot in 0..500 {
        bench.reset();
        bench.exposing = boot % 2 == 0;
        // What a boot loader or a wrong baud rate leaves on the line.
        for byte in [0_u8, 0xFF, b':', b'0', 0xC0, b'\n'] {
            high += u32::from(bench.step(Some(byte)).gates != 0);
        }
        high += bench.pass(SECOND).iter().filter(|change| change.gates != 0).count() as u32;
    }
    assert_eq!(high, 0);
}
