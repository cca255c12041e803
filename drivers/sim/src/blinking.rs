//! When an emitter shines: two-state Markov blinking, ended by bleaching.
//!
//! In: mean on, off and bleaching times in exposures. Out: on-intervals, and the on-fraction of every exposure.
//! Never: samples at instants; the on-state is integrated over each exposure.
//! Paper, Materials and methods: Simulations; started in equilibrium, all times exponential.

use rand_xoshiro::Xoshiro256PlusPlus;

use crate::random::{exponential, uniform};

/// Mean times of one emitter, all in exposures.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Kinetics {
    /// Mean on and off times; `None` for an emitter that never blinks.
    pub(crate) switching: Option<Switching>,
    /// Mean time until bleaching; `None` for an emitter that never bleaches.
    pub(crate) bleaching: Option<f64>,
}

/// Mean on and off times in exposures.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Switching {
    pub(crate) on: f64,
    pub(crate) off: f64,
}

impl Switching {
    /// Share of the time in the on-state in equilibrium.
    pub(crate) fn on_ratio(self) -> f64 {
        self.on / (self.on + self.off)
    }
}

/// The on-intervals `(from, to)` of one emitter in order, up to an end; all in exposures.
pub(crate) struct OnIntervals {
    rng: Xoshiro256PlusPlus,
    switching: Option<Switching>,
    now: f64,
    end: f64,
    starts_on: bool,
}

impl OnIntervals {
    /// Draws the bleaching time and the state at time zero; the rest follows on demand.
    pub(crate) fn new(kinetics: Kinetics, end: f64, mut rng: Xoshiro256PlusPlus) -> Self {
        let bleached = kinetics.bleaching.map_or(end, |mean| exponential(&mut rng, mean));
        let starts_on = kinetics.switching.is_none_or(|switching| uniform(&mut rng) < switching.on_ratio());
        Self { rng, switching: kinetics.switching, now: 0.0, end: end.min(bleached), starts_on }
    }
}

impl Iterator for OnIntervals {
    type Item = (f64, f64);

    fn next(&mut self) -> Option<(f64, f64)> {
        let Some(switching) = self.switching else {
            let interval = (self.now, self.end);
            self.now = self.end;
            return (interval.0 < interval.1).then_some(interval);
        };
        // An exponential time has no memory, so the first interval needs no special law.
        if !std::mem::take(&mut self.starts_on) {
            self.now += exponential(&mut self.rng, switching.off);
        }
        let from = self.now;
        if from >= self.end {
            return None;
        }
        self.now += exponential(&mut self.rng, switching.on);
        Some((from, self.now.min(self.end)))
    }
}

/// On-fractions `(exposure, fraction)` of all exposures in which the emitter shines, in order.
pub(crate) fn on_fractions(intervals: impl Iterator<Item = (f64, f64)>) -> Vec<(u32, f32)> {
    let mut fractions: Vec<(u32, f32)> = Vec::new();
    for (from, to) in intervals {
        let mut exposure = from.floor();
        while exposure < to {
            let lit = (to.min(exposure + 1.0) - from.max(exposure)) as f32;
            match fractions.last_mut() {
                Some((last, fraction)) if *last == exposure as u32 => *fraction += lit,
                _ => fractions.push((exposure as u32, lit)),
            }
            exposure += 1.0;
        }
    }
    fractions
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Stream;

    fn intervals(kinetics: Kinetics, end: f64, emitter: u64) -> OnIntervals {
        let stream = Stream::Trajectory { species: 0, emitter };
        OnIntervals::new(kinetics, end, stream.generator(99))
    }

    fn blinking(on: f64, off: f64) -> Kinetics {
        Kinetics { switching: Some(Switching { on, off }), bleaching: None }
    }

    /// Largest distance of the sample from the exponential law, times the root of the sample size.
    fn kolmogorov_smirnov(mut sample: Vec<f64>, mean: f64) -> f64 {
        sample.sort_by(f64::total_cmp);
        let n = sample.len() as f64;
        let distance = sample.iter().enumerate().fold(0.0_f64, |most, (rank, &time)| {
            let law = 1.0 - (-time / mean).exp();
            most.max((law - rank as f64 / n).abs()).max((law - (rank + 1) as f64 / n).abs())
        });
        distance * n.sqrt()
    }

    #[test]
    fn on_and_off_times_are_exponential() {
        let all: Vec<(f64, f64)> = intervals(blinking(1.0, 9.0), 200_000.0, 0).collect();
        let inner = &all[1..all.len() - 1];
        let on: Vec<f64> = inner.iter().map(|(from, to)| to - from).collect();
        let off: Vec<f64> = inner.windows(2).map(|pair| pair[1].0 - pair[0].1).collect();
        for (times, mean) in [(on, 1.0), (off, 9.0)] {
            let n = times.len() as f64;
            assert!(n > 15_000.0);
            let average = times.iter().sum::<f64>() / n;
            assert!((average - mean).abs() < 4.0 * mean / n.sqrt(), "{average} for {mean}");
            // 1.95 is passed by one sample in a thousand.
            assert!(kolmogorov_smirnov(times, mean) < 1.95);
        }
    }

    #[test]
    fn the_first_exposure_is_as_bright_as_a_late_one() {
        let (num_emitters, exposures) = (20_000_u64, 60.0);
        let (mut first, mut late) = (0.0, 0.0);
        for emitter in 0..num_emitters {
            for (exposure, fraction) in on_fractions(intervals(blinking(1.0, 9.0), exposures, emitter)) {
                match exposure {
                    0 => first += f64::from(fraction),
                    59 => late += f64::from(fraction),
                    _ => {}
                }
            }
        }
        // The on-fraction of one exposure varies by less than a coin of probability 0.1.
        let error = (0.1 * 0.9 / num_emitters as f64).sqrt();
        assert!((first / num_emitters as f64 - 0.1).abs() < 4.0 * error);
        assert!((late / num_emitters as f64 - 0.1).abs() < 4.0 * error);
    }

    #[test]
    fn bleaching_times_are_exponential_and_final() {
        let kinetics = Kinetics { switching: None, bleaching: Some(40.0) };
        let times: Vec<f64> = (0..5000)
            .filter_map(|emitter| intervals(kinetics, 1e9, emitter).last())
            .map(|(_, to)| to)
            .collect();
        assert_eq!(times.len(), 5000);
        assert!(kolmogorov_smirnov(times, 40.0) < 1.95);
    }

    #[test]
    fn fractions_are_the_overlap_with_each_exposure() {
        let fractions = on_fractions([(0.25, 0.5), (0.75, 3.25)].into_iter());
        assert_eq!(fractions, [(0, 0.5), (1, 1.0), (2, 1.0), (3, 0.25)]);
        assert!(on_fractions(std::iter::empty()).is_empty());
    }
}
