//! One axis of the stage: a spindle between two end switches.
//!
//! In: where to go and when it was told. Out: where it is at a time. Never: reads a clock.
//! Lengths are micrometers from the lower end switch, times are seconds.

use super::Jam;

/// Micrometers from switch to switch of the SCANplus IM 120x80.
pub(super) const TRAVELS_UM: [f64; 2] = [120_000.0, 80_000.0];
/// Limits before they were measured.
const UNMEASURED_UM: f64 = 1e6;

/// A time with one acceleration.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Piece {
    time: f64,
    acceleration: f64,
}

/// A motion: from a place with a speed, piece after piece, to a place.
#[derive(Debug, Clone, PartialEq)]
struct Profile {
    begun: f64,
    from: f64,
    speed: f64,
    pieces: Vec<Piece>,
    to: f64,
}

impl Profile {
    /// Brakes, and then goes to `to` on a trapezoid: as fast as `speed` with `acceleration`.
    fn new(begun: f64, (from, moving): (f64, f64), to: f64, speed: f64, acceleration: f64) -> Self {
        let mut pieces = brake(moving, acceleration);
        let begin = from + moving * moving.abs() / (2.0 * acceleration);
        let way = (to - begin).abs();
        let forward = acceleration * (to - begin).signum();
        let rise = (speed / acceleration).min((way / acceleration).sqrt());
        let cruise = (way / (acceleration * rise) - rise).max(0.0);
        if way > 0.0 {
            let piece = |time, acceleration| Piece { time, acceleration };
            pieces.extend([piece(rise, forward), piece(cruise, 0.0), piece(rise, -forward)]);
        }
        Self { begun, from, speed: moving, pieces, to }
    }

    /// Brakes.
    fn braking(begun: f64, (from, moving): (f64, f64), acceleration: f64) -> Self {
        let to = from + moving * moving.abs() / (2.0 * acceleration);
        Self { begun, from, speed: moving, pieces: brake(moving, acceleration), to }
    }

    fn end(&self) -> f64 {
        self.begun + self.pieces.iter().map(|piece| piece.time).sum::<f64>()
    }

    /// Place and speed.
    fn at(&self, now: f64) -> (f64, f64) {
        if now >= self.end() {
            return (self.to, 0.0);
        }
        let (mut place, mut speed, mut left) = (self.from, self.speed, (now - self.begun).max(0.0));
        for piece in &self.pieces {
            let time = left.min(piece.time);
            place += speed * time + 0.5 * piece.acceleration * time * time;
            speed += piece.acceleration * time;
            left -= time;
        }
        (place, speed)
    }
}

fn brake(moving: f64, acceleration: f64) -> Vec<Piece> {
    if moving == 0.0 {
        return Vec::new();
    }
    vec![Piece { time: moving.abs() / acceleration, acceleration: -acceleration * moving.signum() }]
}

/// Why an axis moves.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Purpose {
    Target,
    Calibration,
    RangeMeasure,
    Stop,
    Jam(Jam),
}

#[derive(Debug, Clone)]
pub(super) struct Axis {
    place: f64,
    motion: Option<(Profile, Purpose)>,
    travel: f64,
    /// Where coordinate 0 is.
    origin: f64,
    /// Limits as coordinates.
    pub(super) limits: [f64; 2],
    /// Bit 0: calibrated, bit 1: range measured.
    pub(super) calibration: u8,
    pub(super) letter: char,
    pub(super) velocity_mm_s: f64,
    pub(super) acceleration_m_s2: f64,
    pub(super) backlash_um: f64,
}

impl Axis {
    /// An axis as power-up leaves it, wherever it stands: coordinate 0 is there.
    pub(super) fn new(travel: f64, place: f64) -> Self {
        Self {
            place,
            motion: None,
            travel,
            origin: place,
            limits: [-UNMEASURED_UM, UNMEASURED_UM],
            calibration: 0,
            letter: '@',
            velocity_mm_s: 10.0,
            acceleration_m_s2: 0.2,
            backlash_um: 0.0,
        }
    }

    /// Coordinate.
    pub(super) fn coordinate(&self, now: f64) -> f64 {
        self.at(now).0 - self.origin
    }

    /// Micrometers from the lower end switch.
    pub(super) fn place(&self, now: f64) -> f64 {
        self.at(now).0
    }

    /// Makes the present place coordinate `value`.
    pub(super) fn set_coordinate(&mut self, now: f64, value: f64) {
        let shift = self.place(now) - value - self.origin;
        self.origin += shift;
        self.limits = self.limits.map(|limit| limit - shift);
    }

    pub(super) fn is_moving(&self) -> bool {
        self.motion.is_some() || self.letter == 'M'
    }

    /// When the present motion ends.
    pub(super) fn end(&self) -> Option<f64> {
        self.motion.as_ref().map(|(profile, _)| profile.end())
    }

    pub(super) fn allows(&self, coordinate: f64) -> bool {
        (self.limits[0]..=self.limits[1]).contains(&coordinate)
    }

    pub(super) fn move_to(&mut self, now: f64, coordinate: f64, jam: Option<Jam>) {
        let wanted = coordinate + self.origin;
        let reached = wanted.clamp(0.0, self.travel);
        match jam {
            Some(jam) => self.go(now, f64::midpoint(self.place(now), reached), Purpose::Jam(jam)),
            None if reached == wanted => self.go(now, wanted, Purpose::Target),
            None => self.go(now, reached, Purpose::Jam(Jam::Switch)),
        }
    }

    pub(super) fn calibrate(&mut self, now: f64) {
        self.calibration = 0;
        self.go(now, 0.0, Purpose::Calibration);
    }

    pub(super) fn measure_range(&mut self, now: f64) {
        self.calibration &= 1;
        self.go(now, self.travel, Purpose::RangeMeasure);
    }

    pub(super) fn stop(&mut self, now: f64) {
        if self.motion.is_some() {
            let profile = Profile::braking(now, self.at(now), self.acceleration_um_s2());
            self.motion = Some((profile, Purpose::Stop));
        } else if self.letter == 'M' {
            self.letter = 'E';
        }
    }

    /// A hand moves it.
    pub(super) fn push(&mut self, way: f64) {
        self.place = (self.place + way).clamp(0.0, self.travel);
    }

    /// What the end of a motion changes; tells whether an end switch was hit.
    pub(super) fn settle(&mut self, now: f64) -> bool {
        let Some((profile, purpose)) = self.motion.take_if(|(profile, _)| now >= profile.end()) else {
            return false;
        };
        self.place = profile.to;
        self.letter = match purpose {
            Purpose::Target | Purpose::Jam(Jam::Short) => '@',
            Purpose::Calibration => {
                (self.calibration, self.origin) = (1, self.place);
                self.limits = [0.0, UNMEASURED_UM];
                'A'
            }
            Purpose::RangeMeasure => {
                self.calibration |= 2;
                self.limits[1] = self.place - self.origin;
                'D'
            }
            // storm-control and others have seen the letter stay until the next move.
            Purpose::Stop => 'E',
            Purpose::Jam(Jam::Moving) => 'M',
            Purpose::Jam(Jam::Timeout) => 'T',
            Purpose::Jam(Jam::Switch) => 'S',
        };
        purpose == Purpose::Jam(Jam::Switch)
    }

    fn go(&mut self, now: f64, to: f64, purpose: Purpose) {
        let speed = 1e3 * self.velocity_mm_s;
        let profile = Profile::new(now, self.at(now), to, speed, self.acceleration_um_s2());
        (self.motion, self.letter) = (Some((profile, purpose)), 'M');
    }

    fn at(&self, now: f64) -> (f64, f64) {
        self.motion.as_ref().map_or((self.place, 0.0), |(profile, _)| profile.at(now))
    }

    fn acceleration_um_s2(&self) -> f64 {
        1e6 * self.acceleration_m_s2
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// However motions follow each other, the place never jumps and is never faster than allowed.
        #[test]
        fn motion_is_smooth(targets in prop::collection::vec((0.0..120_000.0, 0.0..3.0), 1..6), stop in 0.0..3.0) {
            let mut axis = Axis::new(TRAVELS_UM[0], 30_000.0);
            axis.origin = 0.0;
            let (mut now, mut before) = (0.0, axis.place(0.0));
            let mut follow = |axis: &mut Axis, time: f64| {
                let until = now + time;
                while now < until {
                    now += 1e-3;
                    axis.settle(now);
                    let place = axis.place(now);
                    assert!((place - before).abs() <= 10.0 + 1e-6, "from {before} to {place} in 1 ms");
                    before = place;
                }
                now
            };
            for (target, time) in targets {
                let now = follow(&mut axis, time);
                axis.move_to(now, target, None);
                let now = follow(&mut axis, 14.0);
                prop_assert_eq!((axis.coordinate(now), axis.letter), (target, '@'));
                axis.move_to(now, 60_000.0, None);
            }
            let now = follow(&mut axis, stop);
            axis.stop(now);
            let now = follow(&mut axis, 0.06);
            prop_assert!(!axis.is_moving(), "it brakes within 50 ms");
            let place = axis.place(now);
            let now = follow(&mut axis, 1.0);
            prop_assert_eq!(axis.place(now), place);
        }
    }

    #[test]
    fn a_trapezoid_takes_the_time_that_the_formula_says() {
        let profile = Profile::new(0.0, (0.0, 0.0), 50_000.0, 10_000.0, 200_000.0);
        assert!((profile.end() - (50_000.0 / 10_000.0 + 10_000.0 / 200_000.0)).abs() < 1e-9);
        let short = Profile::new(0.0, (0.0, 0.0), 200.0, 10_000.0, 200_000.0);
        assert!((short.end() - 2.0 * (200.0_f64 / 200_000.0).sqrt()).abs() < 1e-9);
    }
}
