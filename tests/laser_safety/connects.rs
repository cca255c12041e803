//! Connecting makes no light.

use crate::bench::{Bench, GATES, LASER, num_trials, wait};
use crate::instrument::{guard, light};
use sofiscope::guard::client::GuardClient;
use sofiscope_hal::{Emission, GatePattern};
use sofiscope_virtual::monotonic;
use std::time::Duration;

/// 500 connects in a thorough run.
const CONNECTS_PER_TRIAL: u32 = 25;
const PARALLEL: u32 = 10;
/// Devices are switched off and on this often.
const POWER_CYCLE_EVERY: u32 = 5;
const EXPOSURE: Duration = Duration::from_secs(20);

#[test]
fn connecting_makes_no_light() {
    let num_connects = (num_trials() * CONNECTS_PER_TRIAL).div_ceil(PARALLEL);
    let begun = monotonic();
    std::thread::scope(|scope| {
        for _ in 0..PARALLEL {
            scope.spawn(|| connect(num_connects));
        }
    });
    let seconds = (monotonic() - begun).as_secs_f64();
    println!("{} connects in {seconds:.0} s: no open gate, no emission", num_connects * PARALLEL);
}

fn connect(num_connects: u32) {
    let mut bench = Bench::new(EXPOSURE);
    let text = std::fs::read_to_string(bench.instrument()).unwrap();
    for number in 0..num_connects {
        if number % POWER_CYCLE_EVERY == POWER_CYCLE_EVERY - 1 {
            for device in [GATES, LASER] {
                bench.kill(device);
                bench.start(device);
            }
        }
        let (mut child, socket) = guard();
        let (mut client, state) = GuardClient::set_up(socket, &text).unwrap();
        assert!(state.has_watchdog);
        let state = if state.gates.is_some() { state } else { told(&mut client) };
        assert_eq!(state.gates.unwrap().open, GatePattern::CLOSED);
        assert!(
            state
                .lines
                .iter()
                .all(|line| line.laser.as_ref().is_none_or(|laser| { laser.emission == Emission::Off }))
        );
        drop(client);
        assert!(child.wait().unwrap().success());
    }
    assert!(bench.gates().iter().all(|note| note.value == 0.0), "{:?}", bench.gates());
    assert!(bench.laser().iter().all(|note| note.value == 0.0), "{:?}", bench.laser());
    assert!(!bench.laser().is_empty(), "the laser's judge was there");
    // The same judges see light when there is some.
    let (mut child, socket) = guard();
    let (mut client, _) = GuardClient::set_up(socket, &text).unwrap();
    client.arm().unwrap();
    client.light(&light()).unwrap();
    client.start_train(EXPOSURE, None).unwrap();
    bench.await_light(Duration::from_secs(5)).unwrap();
    drop(client);
    child.wait().unwrap();
}

/// Asks until the controller has been asked.
fn told(client: &mut GuardClient) -> sofiscope::guard::message::LightsState {
    for _ in 0..500 {
        let state = client.state().unwrap();
        if state.gates.is_some() {
            return state;
        }
        wait(Duration::from_millis(10));
    }
    panic!("the controller was never asked");
}
