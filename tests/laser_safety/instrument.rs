//! The process that holds the light: what the sequencer does with the guard, without cameras, and on order all that
//! can go wrong with it.

use crate::bench::{Bench, PROGRAM, wait};
use crossbeam_channel::{Receiver, RecvTimeoutError, bounded};
use rustix::process::{Pid, Signal, getpid, kill_process};
use sofiscope::guard::client::{GuardClient, start_process};
use sofiscope_hal::DeviceError;
use sofiscope_virtual::monotonic;
use std::collections::BTreeMap;
use std::io::{BufRead, BufReader, Read, Write};
use std::os::unix::net::UnixStream;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

const FILE: &str = "SOFISCOPE_TEST_SAFETY_INSTRUMENT";
const PERIOD_MS: &str = "SOFISCOPE_TEST_SAFETY_PERIOD_MS";
/// One turn of the loop that proves its progress.
const TURN: Duration = Duration::from_millis(20);
const POWER_MW: f64 = 5.0;

/// Power of every line.
pub(crate) fn light() -> BTreeMap<u32, f64> {
    BTreeMap::from([(488, POWER_MW)])
}

/// The guard as a process, and the socket to it.
pub(crate) fn guard() -> (Child, UnixStream) {
    let mut program = Command::new(PROGRAM);
    program.arg("laser-guard");
    start_process(program).unwrap()
}

fn say(word: &str, text: impl std::fmt::Display) {
    println!("\n@{word} {} {text}", monotonic().as_nanos());
}

#[test]
#[ignore = "run by the trials"]
fn process() {
    let (Ok(file), Ok(period)) = (std::env::var(FILE), std::env::var(PERIOD_MS)) else { return };
    let period = Duration::from_millis(period.parse().unwrap());
    // As from a terminal of its own: Linux shares its processors among sessions first.
    rustix::process::setsid().unwrap();
    let (orders, waiting) = bounded(8);
    std::thread::spawn(move || {
        for line in std::io::stdin().lines().map_while(Result::ok) {
            orders.send(line).unwrap();
        }
    });
    let (child, socket) = guard();
    say("guard", child.id());
    let silence = Arc::new(AtomicBool::new(false));
    let socket = relay(socket, &silence);
    let (client, _) = GuardClient::set_up(socket, &std::fs::read_to_string(file).unwrap()).unwrap();
    let stays = Arc::new(AtomicBool::new(false));
    let holder = Holder { client, period, silence, stays: Arc::clone(&stays), told: false };
    let sequencer: JoinHandle<()> = std::thread::Builder::new()
        .name("sequencer".to_owned())
        .spawn(move || holder.live(&waiting))
        .unwrap();
    let outcome = sequencer.join();
    while stays.load(Ordering::Relaxed) {
        // The rest of the program lives on without the thread that has failed.
        std::thread::park();
    }
    outcome.unwrap();
}

/// Hands on what comes from both ends until silence falls: then nothing is read or sent, and nothing is closed.
fn relay(guard: UnixStream, silence: &Arc<AtomicBool>) -> UnixStream {
    let (ours, theirs) = UnixStream::pair().unwrap();
    let ends = (guard.try_clone().unwrap(), theirs.try_clone().unwrap());
    for (mut from, mut to) in [(guard, theirs), (ends.1, ends.0)] {
        let silence = Arc::clone(silence);
        std::thread::spawn(move || {
            let mut bytes = [0; 4096];
            while let Ok(num_bytes @ 1..) = from.read(&mut bytes) {
                while silence.load(Ordering::Relaxed) {
                    std::thread::park();
                }
                if to.write_all(&bytes[..num_bytes]).is_err() {
                    break;
                }
            }
            let _ = to.shutdown(std::net::Shutdown::Both);
        });
    }
    ours
}

struct Holder {
    client: GuardClient,
    period: Duration,
    silence: Arc<AtomicBool>,
    stays: Arc<AtomicBool>,
    told: bool,
}

impl Holder {
    /// The loop whose progress is proved.
    fn live(mut self, orders: &Receiver<String>) {
        loop {
            match orders.recv_timeout(TURN) {
                Ok(order) => self.obey(&order),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return,
            }
            self.client.prove();
            if let Some(trip) = self.client.trip().filter(|_| !self.told) {
                self.told = true;
                say("tripped", trip);
            }
        }
    }

    fn obey(&mut self, order: &str) {
        match order {
            "arm" => {
                self.told = false;
                tell("armed", self.client.arm());
            }
            "shine" => {
                let lit = self.client.light(&light());
                tell("lit", lit.and_then(|()| self.client.start_train(self.period, None)));
            }
            fault => {
                say("cause", fault);
                self.fail(fault);
            }
        }
    }

    fn fail(&mut self, fault: &str) {
        match fault {
            "panic-of-a-thread" => {
                self.stays.store(true, Ordering::Relaxed);
                panic!("as ordered");
            }
            "panic" => panic!("as ordered"),
            "abort" => std::process::abort(),
            "stack-overflow" => say("deep", deep(0)),
            "segmentation-fault" => loop {
                // The first one is caught by the watch for stack overflows.
                kill_process(getpid(), Signal::SEGV).unwrap();
            },
            "lock" => {
                let lock = std::sync::Mutex::new(());
                let _held = lock.lock();
                // Deadlock with itself, or a panic where the system notices: it never returns.
                let _never = lock.lock();
            }
            "spin" => loop {
                std::hint::spin_loop();
            },
            "silence" => self.silence.store(true, Ordering::Relaxed),
            "stop-train" => self.client.stop_train().unwrap(),
            other => panic!("no order: {other}"),
        }
    }
}

fn tell(word: &str, outcome: Result<(), DeviceError>) {
    match outcome {
        Ok(()) => say(word, ""),
        Err(error) => say("refused", error),
    }
}

fn deep(depth: u64) -> u64 {
    let frame = std::hint::black_box([depth; 512]);
    if depth == u64::MAX { 0 } else { deep(depth + 1) + frame[7] }
}

/// What the process said.
#[derive(Debug)]
pub(crate) struct Said {
    pub(crate) word: String,
    /// When, by its own clock.
    pub(crate) at: Duration,
    pub(crate) text: String,
}

/// The process in the hand of a trial.
pub(crate) struct Instrument {
    child: Child,
    said: Receiver<Said>,
    pub(crate) guard: u32,
}

impl Instrument {
    /// Starts it; all devices are open and dark afterwards.
    pub(crate) fn start(bench: &Bench, period: Duration) -> Result<Self, String> {
        let mut child = Command::new(std::env::current_exe().unwrap())
            .args(["--exact", "instrument::process", "--ignored", "--nocapture", "--test-threads", "1"])
            .env("RUST_BACKTRACE", "0")
            .env(FILE, bench.instrument())
            .env(PERIOD_MS, period.as_millis().to_string())
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(std::fs::File::create(bench.path("instrument.err")).unwrap())
            .spawn()
            .unwrap();
        let lines = BufReader::new(child.stdout.take().unwrap()).lines();
        let (sender, said) = bounded(64);
        std::thread::spawn(move || {
            lines.map_while(Result::ok).filter_map(|line| parse(&line)).all(|said| sender.send(said).is_ok())
        });
        let mut instrument = Self { child, said, guard: 0 };
        let guard = instrument.await_word("guard", Duration::from_secs(20))?;
        instrument.guard = guard.text.parse().unwrap();
        Ok(instrument)
    }

    pub(crate) fn order(&mut self, order: &str) {
        // One that is dead does not listen; the trial sees it by what it does not say.
        let _ = writeln!(self.child.stdin.as_mut().unwrap(), "{order}");
    }

    /// Orders and waits for the answer, which is `word` or an error.
    pub(crate) fn ask(&mut self, order: &str, word: &str) -> Result<Said, String> {
        self.order(order);
        self.await_word(word, Duration::from_secs(30))
    }

    /// Waits for a word; what else is said meanwhile is let go, but not a refusal.
    pub(crate) fn await_word(&mut self, word: &str, within: Duration) -> Result<Said, String> {
        let until = monotonic() + within;
        while let Ok(said) = self.said.recv_timeout(until.saturating_sub(monotonic())) {
            if said.word == word {
                return Ok(said);
            }
            if said.word == "refused" {
                return Err(format!("refused: {}", said.text));
            }
        }
        Err(format!("the instrument did not say {word}"))
    }

    /// The first trip that was said, if any.
    pub(crate) fn tripped(&mut self) -> Option<String> {
        self.said.try_iter().find(|said| said.word == "tripped").map(|said| said.text)
    }

    pub(crate) fn signal(&self, signal: Signal) {
        send(self.child.id(), signal);
    }
}

impl Drop for Instrument {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
        // The guard makes everything dark and goes by itself; its devices wait for it.
        let path = format!("/proc/{}", self.guard);
        for _ in 0..500 {
            if !std::path::Path::new(&path).exists() {
                break;
            }
            wait(Duration::from_millis(10));
        }
    }
}

/// Sends a signal to a process.
pub(crate) fn send(process: u32, signal: Signal) {
    let process = Pid::from_raw(i32::try_from(process).unwrap()).unwrap();
    kill_process(process, signal).unwrap();
}

fn parse(line: &str) -> Option<Said> {
    let mut words = line.strip_prefix('@')?.splitn(3, ' ');
    let word = words.next()?.to_owned();
    let at = Duration::from_nanos(words.next()?.parse().ok()?);
    Some(Said { word, at, text: words.next().unwrap_or_default().to_owned() })
}
