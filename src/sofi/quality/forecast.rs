//! How many subsequences a wanted quality takes.
//!
//! In: the quality reached, after how many subsequences, and the one wanted.
//! Out: subsequences in all. Never: promises what bleaching forbids. Fails: `None` when it cannot be reached.
//!
//! Subsequences are independent, so the standard error of their mean falls, and the signal-to-noise grows, with
//! the square root of their number. In Fourier space the same law is one of power: the spectral signal-to-noise
//! ratio grows with the number, and `FRC = SSNR / (1 + SSNR)` (Unser, Trus and Steven 1987; Penczek 2010).

use super::frc::{FourierRingCorrelation, THRESHOLD};

/// More subsequences than this are never.
const NEVER: u64 = 1_000_000;

/// Subsequences in all for a wanted signal-to-noise, when `reached` came after `subsequences`.
///
/// With bleaching, `time_constant` in subsequences, the `j`-th adds `exp(-j / time_constant)` as much signal
/// (cumulants of independent emitters add up) and as much noise as ever, so that the signal-to-noise grows with
/// `sum_j exp(-j / time_constant) / sqrt(k)`, which has its highest point near 1.26 time constants: what lies above
/// it is never reached. The noise of the emitters themselves fades with them, so this errs to the safe side.
#[must_use]
pub fn subsequences_for_signal_to_noise(
    reached: f64,
    subsequences: u64,
    wanted: f64,
    time_constant: Option<f64>,
) -> Option<u64> {
    if !(reached > 0.0 && wanted > 0.0 && reached.is_finite() && wanted.is_finite()) || subsequences == 0 {
        return None;
    }
    if wanted <= reached {
        return Some(subsequences);
    }
    let Some(tau) = time_constant.filter(|tau| tau.is_finite() && *tau > 0.0) else {
        return whole(subsequences as f64 * (wanted / reached).powi(2));
    };
    let growth = |k: u64| -(-(k as f64) / tau).exp_m1() / (k as f64).sqrt();
    let target = growth(subsequences) * wanted / reached;
    let most = (1.3 * tau).ceil() as u64;
    (subsequences..=most.min(NEVER)).find(|&k| growth(k) >= target)
}

/// Subsequences in all for a wanted resolution, pixels of the correlated images, when the curve came after
/// `subsequences`.
///
/// At the frequency wanted, the curve must rise to the threshold. `None` where it shows no more than chance.
#[must_use]
pub fn subsequences_for_resolution(
    curve: &FourierRingCorrelation,
    subsequences: u64,
    wanted_px: f64,
) -> Option<u64> {
    if !(wanted_px.is_finite() && wanted_px > 0.0) {
        return None;
    }
    if curve.resolution_px.is_some_and(|reached| reached <= wanted_px) {
        return Some(subsequences);
    }
    let frequency = 1.0 / wanted_px;
    let now = curve.at(frequency)?;
    // A ring of frequency q in rings of step d holds about pi q / d independent frequencies; chance gives each
    // ring of the curve one over the root of their number.
    let independent = std::f64::consts::PI * frequency / curve.frequency_step;
    if now < 2.0 / independent.sqrt() || now >= 1.0 {
        return None;
    }
    let power = |correlation: f64| correlation / (1.0 - correlation);
    whole(subsequences as f64 * (power(THRESHOLD) / power(now)).max(1.0))
}

fn whole(subsequences: f64) -> Option<u64> {
    let subsequences = (subsequences - 1e-9).ceil();
    (subsequences <= NEVER as f64).then_some(subsequences as u64)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn curve(correlation: f64) -> FourierRingCorrelation {
        let smoothed = vec![correlation; 101];
        let curve = smoothed.clone();
        FourierRingCorrelation { curve, smoothed, frequency_step: 0.005, resolution_px: None }
    }

    #[test]
    fn twice_the_signal_to_noise_takes_four_times_as_long() {
        assert_eq!(subsequences_for_signal_to_noise(5.0, 10, 10.0, None), Some(40));
        assert_eq!(subsequences_for_signal_to_noise(5.0, 10, 4.0, None), Some(10));
        assert_eq!(subsequences_for_signal_to_noise(0.0, 10, 4.0, None), None);
        assert_eq!(subsequences_for_signal_to_noise(5.0, 10, f64::NAN, None), None);
    }

    #[test]
    fn bleaching_makes_it_longer_and_at_last_impossible() {
        assert_eq!(subsequences_for_signal_to_noise(5.0, 10, 10.0, Some(1e5)), Some(41));
        let longer = subsequences_for_signal_to_noise(5.0, 10, 10.0, Some(100.0)).unwrap();
        assert!(longer > 45, "{longer}");
        assert_eq!(subsequences_for_signal_to_noise(5.0, 10, 10.0, Some(20.0)), None);
    }

    #[test]
    fn the_spectral_signal_to_noise_grows_with_the_number() {
        // SSNR 1/12 must become 1/6.
        let now = curve(1.0 / 13.0);
        assert_eq!(subsequences_for_resolution(&now, 10, 2.2), None, "no more than chance");
        let fine = FourierRingCorrelation { frequency_step: 0.0005, smoothed: vec![1.0 / 13.0; 1001], ..now };
        assert_eq!(subsequences_for_resolution(&fine, 10, 3.0), Some(20));
        assert_eq!(subsequences_for_resolution(&fine, 10, 1.0), None, "beyond the pixels");
    }
}
