//! The virtual spot is where the table says, with the noise of its light.

use super::*;

const REGION: Region = Region { left: 200, top: 100, width: 200, height: 64 };

fn table(error_nm: f64) -> OpticalTable {
    let table = OpticalTable::private().unwrap();
    table.set(Quantity::PiezoZ, error_nm);
    table
}

fn frame(table: &OpticalTable, scene: SpotScene, exposure: u64) -> Vec<u16> {
    let mut counts = vec![9; REGION.num_pixels()];
    FocusSpot::new(table.clone(), scene).render(REGION, exposure, Duration::ZERO, &mut counts);
    counts
}

/// Center of mass above the background, in columns of the sensor, and light above it.
fn center(counts: &[u16], background: f64) -> (f64, f64) {
    let (mut moment, mut light) = (0.0, 0.0);
    for (place, &count) in counts.iter().enumerate() {
        let above = f64::from(count) - background;
        moment += above * (200 + place % 200) as f64;
        light += above;
    }
    (moment / light, light)
}

#[test]
fn the_spot_follows_the_focus_error_within_the_capture_range() {
    let scene = SpotScene { background_counts: 0.0, ..SpotScene::default() };
    for (error_nm, place, share) in
        [(0.0, 300.0, 1.0), (400.0, 326.0, 1.0), (-1000.0, 235.0, 1.0), (1800.0, 378.0, 0.607)]
    {
        let (found, light) = center(&frame(&table(error_nm), scene.clone(), 3), 0.0);
        assert!((found - place).abs() < 0.1, "{error_nm} nm: {found} instead of {place}");
        let full = 1000.0 * std::f64::consts::TAU * 16.0;
        assert!((light / full - share).abs() < 0.02, "{error_nm} nm: {light}");
    }
}

#[test]
fn two_spots_part_by_the_focus_error() {
    let scene = SpotScene { pattern: SpotPattern::Two(80.0), ..SpotScene::default() };
    let (places, share) = FocusSpot::new(table(200.0), scene).truth(Duration::ZERO);
    assert_eq!((places, share), (SpotPlaces::Two(253.5, 346.5), 1.0));
}

#[test]
fn a_blocked_beam_a_lost_focus_and_nonsense_are_dark() {
    let blocked = table(0.0);
    blocked.set(Quantity::FocusBeamBlocked, 1.0);
    for dark in [blocked, table(20_000.0), table(f64::NAN)] {
        let counts = frame(&dark, SpotScene::default(), 0);
        let mean = counts.iter().map(|&count| f64::from(count)).sum::<f64>() / counts.len() as f64;
        assert!((mean - 20.0).abs() < 0.3, "only background is left, but there are {mean} counts");
    }
}

#[test]
fn noise_is_that_of_photons_and_the_same_for_the_same_exposure() {
    for background_counts in [3.0, 30.0] {
        let scene = SpotScene { peak_counts: 0.0, background_counts, ..SpotScene::default() };
        let counts = frame(&table(0.0), scene.clone(), 5);
        assert_eq!(counts, frame(&table(0.0), scene.clone(), 5));
        assert_ne!(counts, frame(&table(0.0), scene, 6));
        let number = counts.len() as f64;
        let mean = counts.iter().map(|&count| f64::from(count)).sum::<f64>() / number;
        let variance = counts.iter().map(|&count| (f64::from(count) - mean).powi(2)).sum::<f64>() / number;
        assert!((mean / background_counts - 1.0).abs() < 0.02, "{mean}");
        assert!((variance / background_counts - 1.0).abs() < 0.06, "{variance}");
    }
}

#[test]
fn pixels_saturate() {
    let scene = SpotScene { peak_counts: 9000.0, ..SpotScene::default() };
    let counts = frame(&table(0.0), scene, 0);
    assert_eq!(counts.iter().max(), Some(&4095));
}
