//! The piezo: a second-order closed loop, solved exactly between calls.
//!
//! In: targets, time passed. Out: where it is. Never: reads a clock. Fails: never; it saturates at its ends.

/// A damped oscillation towards the target: `z'' = ω² (target - z) - 2 ζ ω z'`, `ζ < 1`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Plant {
    /// Travel, micrometers.
    pub(crate) range_um: f64,
    /// Angular frequency, 1/s.
    pub(crate) omega: f64,
    /// Damping.
    pub(crate) zeta: f64,
    pub(crate) target_um: f64,
    pub(crate) z_um: f64,
    speed_um_per_s: f64,
}

impl Plant {
    /// A stage of 300 µm at 30 Hz with a damping of 0.8.
    pub(crate) const NEW: Self = Self {
        range_um: 300.0,
        omega: std::f64::consts::TAU * 30.0,
        zeta: 0.8,
        target_um: 0.0,
        z_um: 0.0,
        speed_um_per_s: 0.0,
    };

    /// Lets time pass.
    pub(crate) fn advance(&mut self, seconds: f64) {
        let Self { omega, zeta, .. } = *self;
        let damped = omega * (1.0 - zeta * zeta).sqrt();
        let (x, v) = (self.z_um - self.target_um, self.speed_um_per_s);
        let decay = (-zeta * omega * seconds).exp();
        let (sin, cos) = (damped * seconds).sin_cos();
        let swing = (v + zeta * omega * x) / damped;
        self.z_um = self.target_um + decay * (x * cos + swing * sin);
        self.speed_um_per_s = decay * (v * cos - (zeta * omega * v + omega * omega * x) / damped * sin);
        if !(0.0..=self.range_um).contains(&self.z_um) {
            self.z_um = self.z_um.clamp(0.0, self.range_um);
            self.speed_um_per_s = 0.0;
        }
    }

    /// Whether it moves by less than a picometer.
    pub(crate) fn is_settled(&self) -> bool {
        (self.z_um - self.target_um).abs() < 1e-6 && self.speed_um_per_s.abs() < 1e-3
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The slow, obvious twin: small Euler steps.
    fn euler(mut plant: Plant, seconds: f64) -> f64 {
        let steps = 200_000;
        let step = seconds / f64::from(steps);
        for _ in 0..steps {
            let force = plant.omega.powi(2) * (plant.target_um - plant.z_um)
                - 2.0 * plant.zeta * plant.omega * plant.speed_um_per_s;
            plant.speed_um_per_s += step * force;
            plant.z_um += step * plant.speed_um_per_s;
        }
        plant.z_um
    }

    #[test]
    fn the_exact_solution_is_that_of_small_steps() {
        let plant = Plant { z_um: 100.0, target_um: 110.0, speed_um_per_s: 500.0, ..Plant::NEW };
        for seconds in [0.001, 0.005, 0.02, 0.06] {
            let mut exact = plant;
            exact.advance(seconds);
            assert!((exact.z_um - euler(plant, seconds)).abs() < 1e-3, "{seconds} s");
        }
    }

    #[test]
    fn many_steps_are_one_and_it_comes_to_rest() {
        let mut once = Plant { z_um: 100.0, target_um: 150.0, ..Plant::NEW };
        let mut often = once;
        once.advance(0.01);
        (0..100).for_each(|_| often.advance(0.0001));
        assert!((once.z_um - often.z_um).abs() < 1e-9);
        once.advance(0.5);
        assert!(once.is_settled() && (once.z_um - 150.0).abs() < 1e-6);
    }

    #[test]
    fn it_stops_at_its_ends() {
        let mut plant = Plant { z_um: 250.0, target_um: 300.0, speed_um_per_s: 1e5, ..Plant::NEW };
        plant.advance(0.003);
        assert_eq!(plant.z_um, 300.0);
    }
}
