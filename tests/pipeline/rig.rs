//! Simulated cameras, the real grabbers and dispatch, and consumers of a chosen speed.
//!
//! Speeds are ratios of counts, not of times: a consumer that is 1.5 times too slow takes its next pair only when
//! the cameras have delivered 1.5 times as many frames as it has taken.

use sofiscope::acquisition::{
    Accounts, Dispatch, ExposureRecord, FramePair, FramePool, Grabber, GrabberStatus, HostClock, LeaveOut,
    Loss, Pairing, PairingEvent, PairingSettings, Patience, PressureGauge, Progress, Surroundings,
};
use sofiscope::pipeline::{Bell, Publisher, Received, Receiver, Viewer, WhenFull, bounded, latest};
use sofiscope_hal::{
    Camera, CameraSettings, Channel, ExposureIndex, FrameStream, Region, TriggerMode, TriggerSource,
};
use sofiscope_sim::{Film, InstrumentSettings, Oracle, SimulatedInstrument};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

const SIDE: u32 = 64;
/// A prime, so that no usual shift shows the same frame.
const FILM_FRAMES: usize = 97;
const POOL: usize = 256;
const PERIOD: Duration = Duration::from_millis(20);

/// By how much the cameras are faster than a consumer; `None` for one that keeps up.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Rates {
    pub(crate) analysis: Option<f64>,
    pub(crate) recording: Option<f64>,
    /// The preview is drawn by the thread of the analysis from its pairs, into the latest picture.
    pub(crate) preview: Option<f64>,
}

/// The cameras as the slow consumers see them.
struct Source {
    status: Arc<GrabberStatus>,
    ended: AtomicBool,
    /// Nothing more comes for the preview.
    analyzed: AtomicBool,
}

/// What a run came to.
pub(crate) struct Outcome {
    pub(crate) accounts: Accounts,
    pub(crate) oracle: Oracle,
    pub(crate) records: u64,
    pub(crate) records_in_order: bool,
    pub(crate) recorded: [u64; 2],
    pub(crate) analyzed: u64,
    pub(crate) wrong_frames: u64,
    /// Pairs with a frame of another exposure.
    pub(crate) wrong_pairs: u64,
    pub(crate) missed_triggers: usize,
    pub(crate) extra_triggers: usize,
    /// Pictures that the preview took, and pairs that it went without.
    pub(crate) previews_shown: u64,
    pub(crate) previews_skipped: u64,
    /// Pairs that the analysis lost to a full queue while the preview was still allowed to work.
    pub(crate) analysis_lost_beside_preview: u64,
    /// Exposures whose frames the recording lost while their pair went to the analysis.
    pub(crate) recording_lost_beside_analysis: u64,
}

/// Exposures of a run.
pub(crate) fn exposures() -> u64 {
    let wanted = std::env::var("SOFISCOPE_TEST_EXPOSURES").ok();
    wanted.map_or(100_000, |text| text.parse().expect("SOFISCOPE_TEST_EXPOSURES is a number"))
}

/// What the recording's end saw.
#[derive(Default)]
struct Recorded {
    records: u64,
    in_order: bool,
    frames: [u64; 2],
    wrong: u64,
    lost_beside_analysis: u64,
}

/// Runs the cameras through grabbers and dispatch to both consumers.
pub(crate) fn run(settings: InstrumentSettings, rates: Rates) -> Outcome {
    let film = Film::noise(SIDE as usize, SIDE as usize, FILM_FRAMES, 11);
    let shown = film.clone();
    let instrument =
        SimulatedInstrument::new(film, InstrumentSettings { exposures: Some(exposures()), ..settings });
    let region = Region { left: 0, top: 0, width: SIDE, height: SIDE };
    let camera = CameraSettings { region, exposure: PERIOD, period: PERIOD, trigger: TriggerMode::External };
    let mut cameras = instrument.cameras();
    let streams = cameras.each_mut().map(|each| {
        each.configure(&camera).expect("the film has this size");
        each.arm().expect("nothing keeps it from being armed")
    });
    let (bell, stop, clock) = (Bell::default(), Arc::new(AtomicBool::new(false)), HostClock::start());
    let mut queues = Vec::new();
    let mut grabbers = Vec::new();
    for (channel, stream) in Channel::BOTH.into_iter().zip(streams) {
        let (grabber, queue) = grabber(channel, stream, &bell, &stop, clock);
        queues.push(queue);
        grabbers.push(grabber);
    }
    let status = Arc::clone(&grabbers[0].status);
    let gauge = PressureGauge::default();
    // Who keeps up is waited for, as threads of a test are not scheduled like those of a microscope.
    let when_full = |ratio: Option<f64>| if ratio.is_some() { WhenFull::Refuse } else { WhenFull::Wait };
    let (to_analysis, pairs) =
        bounded("pair→analyze", POOL * 3 / 8, when_full(rates.analysis), &Bell::default());
    let (to_recording, records) =
        bounded("pair→record", POOL / 2, when_full(rates.recording), &Bell::default());
    let settings = PairingSettings { period: PERIOD, reorder: 16, lead: None };
    let dispatch = Dispatch {
        from_grabbers: queues.try_into().expect("two queues"),
        bell,
        pairing: Pairing::new(settings, 2 * POOL),
        to_analysis: Some(to_analysis),
        to_recording: Some(to_recording),
        to_look: None,
        leave_out: LeaveOut::default(),
        gauge: gauge.clone(),
        progress: latest(Progress::default()).0,
        stop,
    };
    instrument.trigger().start(PERIOD, Some(exposures())).expect("the trigger is idle");
    let source = &Source { status, ended: AtomicBool::new(false), analyzed: AtomicBool::new(false) };
    let film = &shown;
    thread::scope(|scope| {
        let grabbing: Vec<_> =
            grabbers.into_iter().map(|grabber| scope.spawn(move || grabber.run())).collect();
        let dispatching = scope.spawn(move || dispatch.run());
        let (pictures, shown) = latest(0);
        let preview = Preview { pictures, gauge, withheld: 0 };
        let analyzing = scope.spawn(move || analyze(pairs, rates.analysis, source, film, preview));
        let previewing = scope.spawn(move || watch(shown, rates.preview, source));
        let recording = scope.spawn(move || record(records, rates.recording, source, film));
        grabbing.into_iter().for_each(|grabber| drop(grabber.join().expect("a grabber does not panic")));
        source.ended.store(true, Ordering::Relaxed);
        let report = dispatching.join().expect("the dispatch does not panic");
        let (analyzed, wrong_pairs, withheld) = analyzing.join().expect("the analysis does not panic");
        let (previews_shown, replaced) = previewing.join().expect("the preview does not panic");
        let recorded = recording.join().expect("the recording does not panic");
        let missed = |event: &&PairingEvent| matches!(event, PairingEvent::MissedTriggers { .. });
        let extra = |event: &&PairingEvent| matches!(event, PairingEvent::ExtraTriggers { .. });
        Outcome {
            missed_triggers: report.events.iter().filter(missed).count(),
            analysis_lost_beside_preview: report.lost_beside_preview,
            accounts: report.accounts,
            oracle: instrument.oracle(),
            records: recorded.records,
            records_in_order: recorded.in_order,
            recorded: recorded.frames,
            analyzed,
            wrong_pairs,
            extra_triggers: report.events.iter().filter(extra).count(),
            previews_shown,
            previews_skipped: replaced + withheld,
            wrong_frames: wrong_pairs + recorded.wrong,
            recording_lost_beside_analysis: recorded.lost_beside_analysis,
        }
    })
}

fn grabber(
    channel: Channel,
    stream: Box<dyn FrameStream>,
    bell: &Bell,
    stop: &Arc<AtomicBool>,
    clock: HostClock,
) -> (Grabber, Receiver<sofiscope::acquisition::Grabbed>) {
    let pixels = (SIDE * SIDE) as usize;
    let (to_pairing, queue) = bounded("grab→pair", POOL + 4096, WhenFull::Refuse, bell);
    let grabber = Grabber {
        channel,
        stream,
        pool: FramePool::new(POOL, pixels).expect("memory"),
        pixels,
        to_pairing,
        // The cameras wait for memory only; what overflows are the queues behind the pairing.
        patience: Patience::Patient,
        clock,
        surroundings: Surroundings::default(),
        stop: Arc::clone(stop),
        status: Arc::default(),
    };
    (grabber, queue)
}

/// Waits until the cameras are far enough ahead of a consumer that is too slow by `ratio`, or have ended.
fn keep_slow(ratio: Option<f64>, taken: u64, source: &Source) {
    let Some(ratio) = ratio else { return };
    let frames = || source.status.frames.load(Ordering::Relaxed) as f64;
    while frames() < ratio * taken as f64 && !source.ended.load(Ordering::Relaxed) {
        thread::yield_now();
    }
}

/// What the analysis shows of its work.
struct Preview {
    pictures: Publisher<u64>,
    gauge: PressureGauge,
    /// Pairs after which nothing was shown, as the preview had to go without.
    withheld: u64,
}

impl Preview {
    fn offer(&mut self, exposure: ExposureIndex) {
        if self.gauge.preview_is_off() {
            self.withheld += 1;
        } else {
            self.pictures.publish(exposure.0);
        }
    }
}

/// Pictures that the preview took, and those that were replaced before it came.
fn watch(mut shown: Viewer<u64>, ratio: Option<f64>, source: &Source) -> (u64, u64) {
    let (mut taken, mut newest) = (0, 0);
    loop {
        let is_last = source.analyzed.load(Ordering::Acquire);
        if let Some((number, _)) = shown.look_if_new() {
            taken += 1;
            newest = number;
            keep_slow(ratio, taken, source);
        } else if is_last {
            return (taken, newest - taken);
        } else {
            thread::yield_now();
        }
    }
}

/// Pairs taken, how many of them show something else than their exposure, and after how many nothing was shown.
fn analyze(
    mut pairs: Receiver<FramePair>,
    ratio: Option<f64>,
    source: &Source,
    film: &Film,
    mut preview: Preview,
) -> (u64, u64, u64) {
    let (mut taken, mut wrong) = (0, 0);
    loop {
        match pairs.receive(Duration::from_secs(1)) {
            Received::Value(FramePair { exposure, frames }) => {
                taken += 1;
                let differs =
                    |channel: Channel| !shows(film, channel, exposure, frames[channel.index()].counts());
                wrong += u64::from(Channel::BOTH.into_iter().any(differs));
                preview.offer(exposure);
                keep_slow(ratio, taken, source);
            }
            Received::Empty => {}
            Received::Closed => {
                source.analyzed.store(true, Ordering::Release);
                return (taken, wrong, preview.withheld);
            }
        }
    }
}

fn record(
    mut records: Receiver<ExposureRecord>,
    ratio: Option<f64>,
    source: &Source,
    film: &Film,
) -> Recorded {
    let mut seen = Recorded { in_order: true, ..Recorded::default() };
    let mut taken = 0;
    loop {
        match records.receive(Duration::from_secs(1)) {
            Received::Value(record) => {
                seen.take(&record, film);
                // Rows of lost frames cost a recorder nothing.
                taken += u64::from(record.sides.iter().any(|side| side.frame().is_some()));
                keep_slow(ratio, taken, source);
            }
            Received::Empty => {}
            Received::Closed => return seen,
        }
    }
}

impl Recorded {
    fn take(&mut self, record: &ExposureRecord, film: &Film) {
        use sofiscope::acquisition::{Analysis, Side};
        self.in_order &= record.exposure == ExposureIndex(self.records);
        self.records += 1;
        for channel in Channel::BOTH {
            match record.side(channel) {
                Side::Frame(frame) => {
                    self.frames[channel.index()] += 1;
                    self.wrong += u64::from(!shows(film, channel, record.exposure, frame.counts()));
                }
                Side::Lost(Loss::QueueFull, _) if record.analysis == Analysis::Analyzed => {
                    self.lost_beside_analysis += 1;
                }
                Side::Lost(..) => {}
            }
        }
    }
}

/// Whether a frame has the pixels of its exposure; a few rows tell.
fn shows(film: &Film, channel: Channel, exposure: ExposureIndex, counts: &[u16]) -> bool {
    let truth = film.frame(channel, exposure);
    counts.len() == truth.len() && counts[..128] == truth[..128] && counts.last() == truth.last()
}
