//! Progress of long work: a bar on a terminal, plain lines otherwise, always on stderr.

use indicatif::{ProgressBar, ProgressStyle};
use std::io::IsTerminal;
use std::time::{Duration, Instant};

/// Time between two plain lines.
const LINE_EVERY: Duration = Duration::from_secs(5);

/// Progress of one piece of work, counted in frames or the like.
#[derive(Debug)]
pub struct Progress {
    what: String,
    total: u64,
    done: u64,
    bar: Option<ProgressBar>,
    begun: Instant,
    last_line: Instant,
}

impl Progress {
    /// Begins work of `total` steps.
    #[must_use]
    pub fn begin(what: &str, total: u64) -> Self {
        let bar = std::io::stderr().is_terminal().then(|| bar(what, total));
        let now = Instant::now();
        Self { what: what.to_owned(), total, done: 0, bar, begun: now, last_line: now }
    }

    /// Adds steps done.
    pub fn advance(&mut self, steps: u64) {
        self.done += steps;
        match &self.bar {
            Some(bar) => bar.inc(steps),
            None if self.last_line.elapsed() >= LINE_EVERY => {
                self.last_line = Instant::now();
                // Work without a certain end has no total.
                let of = if self.total > 0 { format!(" of {}", self.total) } else { String::new() };
                eprintln!("{}: {}{of} ({:.0} per second)", self.what, self.done, self.rate());
            }
            None => {}
        }
    }

    /// Ends the work and says how fast it was.
    pub fn finish(self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
        let seconds = self.begun.elapsed().as_secs_f64();
        eprintln!("{}: {} in {seconds:.1} s ({:.0} per second)", self.what, self.done, self.rate());
    }

    fn rate(&self) -> f64 {
        self.done as f64 / self.begun.elapsed().as_secs_f64().max(1e-9)
    }
}

fn bar(what: &str, total: u64) -> ProgressBar {
    let style = "{msg} {wide_bar} {pos}/{len} {per_sec} {eta}";
    let style = ProgressStyle::with_template(style).unwrap_or_else(|_| ProgressStyle::default_bar());
    ProgressBar::new(total).with_style(style).with_message(what.to_owned())
}
