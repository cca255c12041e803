//! A window in another process is served: the same pictures, STOP past everything, and what becomes of light and
//! runs without it.

use super::{QUICK, is, simulated, text_of, until};
use crate::app::window::bench::LocalBench;
use crate::app::window::remote::RemoteBench;
use crate::app::window::serve::{Left, serve};
use crate::app::window::wire::{FromWindow, send};
use crate::pipeline::{Stage, spawn};
use crate::viewer::bench::{Activity, Bench, BenchCommand, BenchStatus, Gravity};
use std::io::Write as _;
use std::os::unix::net::UnixStream;

/// A window's ends of both lines, and what serves them.
fn served(bench: &LocalBench) -> (UnixStream, UnixStream, Stage<Left>) {
    let ((wire, of_window), (stop, stop_of_window)) =
        (UnixStream::pair().unwrap(), UnixStream::pair().unwrap());
    let bench = bench.another();
    let serving = spawn("serve", move || serve(&bench, &wire, stop)).unwrap();
    (of_window, stop_of_window, serving)
}

#[test]
fn another_process_sees_the_same_and_is_obeyed() {
    let bench = simulated();
    let (wire, stop, serving) = served(&bench);
    let (window, _exchange) = RemoteBench::start(wire, stop).unwrap();
    until(&window, "the instrument", |status| status.instrument.clone());
    window.ask(BenchCommand::Live(QUICK)).unwrap();
    until(&window, "quality", |status| (!status.quality.is_empty()).then_some(()));
    until(&window, "both pictures", |_| {
        let pictures = window.pictures();
        pictures.cameras.and(pictures.sofi)
    });
    window.ask(BenchCommand::Finish).unwrap();
    until(&window, "the end", is(&Activity::Idle));
    // Curves of the correlation are not sent.
    let sent = |status: &BenchStatus| postcard::to_stdvec(status).unwrap();
    until(&window, "the newest status", |status| (sent(status) == sent(&bench.status())).then_some(()));
    let (here, there) = (bench.pictures(), window.pictures());
    assert_eq!(there.cameras.unwrap(), here.cameras.unwrap());
    let (here, there) = (here.sofi.unwrap(), there.sofi.unwrap());
    assert_eq!((there.samples, &there.label), (here.samples, &here.label));
    assert_eq!(there.images.len(), here.images.len());
    for (there, here) in there.images.iter().zip(&here.images) {
        assert_eq!((there.stage, &there.name), (here.stage, &here.name));
        assert!(there.image.iter().map(|value| value.to_bits()).eq(here.image.iter().map(|v| v.to_bits())));
    }
    let before = window.pictures();
    until(&window, "another look", |_| Some(()));
    let after = window.pictures();
    assert!(std::sync::Arc::ptr_eq(&before.sofi.unwrap(), &after.sofi.unwrap()), "nothing is sent twice");
    assert!(window.judge_plan("nonsense").is_err());
    let plan = include_str!("../../../../config/plans/quick-look.yaml");
    assert_eq!(window.judge_plan(plan), bench.judge_plan(plan));
    window.tell(Gravity::Note, "a note of the window");
    until(&window, "the note", |status| {
        text_of(status, Gravity::Note).iter().any(|text| text == "a note of the window").then_some(())
    });
    window.leave(FromWindow::Closed);
    assert_eq!(serving.join().unwrap(), Left::Closed);
}

#[test]
fn stop_comes_past_a_window_that_reads_nothing() {
    let bench = simulated();
    bench.ask(BenchCommand::Live(QUICK)).unwrap();
    until(&bench, "pictures", |_| bench.pictures().sofi);
    let (mut wire, mut stop, serving) = served(&bench);
    // More looks than the line has room for answers: whoever serves them waits for this window.
    let mut asked = 0;
    wire.set_write_timeout(Some(std::time::Duration::from_millis(200))).unwrap();
    while send(&mut wire, &FromWindow::Look).is_ok() {
        asked += 1;
    }
    assert!(asked > 0);
    stop.write_all(&[1]).unwrap();
    until(&bench, "STOP", |status| {
        text_of(status, Gravity::Warning).iter().any(|text| text.starts_with("STOP")).then_some(())
    });
    until(&bench, "standstill", is(&Activity::Idle));
    drop((wire, stop));
    assert_eq!(serving.join().unwrap(), Left::Lost { has_looked: true });
}

#[test]
fn the_dark_live_view_waits_for_a_window_that_does_not_look() {
    let bench = simulated();
    let (mut wire, _stop, serving) = served(&bench);
    send(&mut wire, &FromWindow::Ask(BenchCommand::Live(QUICK))).unwrap();
    // Twice as many exposures as it would take to be noticed, at 2 ms each.
    until(&bench, "exposures", |status| (status.run.exposures > 3000).then_some(()));
    assert_eq!(bench.status().activity, Activity::Live);
    bench.ask(BenchCommand::Finish).unwrap();
    until(&bench, "the end", is(&Activity::Idle));
    drop(wire);
    assert_eq!(serving.join().unwrap(), Left::Lost { has_looked: false });
}
