use proptest::prelude::*;

use super::*;

const MINIMAL: &str = include_str!("../../tests/minimal.toml");

fn faults(text: &str) -> Vec<Fault> {
    Scene::from_toml(text).expect_err("this scene is faulty").faults
}

fn faults_with(from: &str, to: &str) -> Vec<Fault> {
    assert!(MINIMAL.contains(from), "{from}");
    faults(&MINIMAL.replacen(from, to, 1))
}

#[test]
fn every_shipped_scene_parses_under_its_own_name() {
    assert_eq!(Scene::built_in_names().count(), 9);
    for name in Scene::built_in_names() {
        let text = Scene::built_in(name).unwrap();
        let scene = Scene::from_toml(text).unwrap_or_else(|error| panic!("{name}: {error}"));
        assert_eq!(scene.name(), name);
        assert!(!scene.about().is_empty());
    }
    assert!(Scene::built_in("figure-99").is_none());
}

#[test]
fn the_three_filaments_have_the_numbers_of_the_paper() {
    let scene = Scene::from_toml(Scene::built_in("figure-s4").unwrap()).unwrap();
    for (species, transmission) in scene.species().iter().zip([0.02, 0.35, 0.98]) {
        assert_eq!(species.transmission, transmission);
        assert_eq!(species.shapes.len(), 1);
        assert!((species.shapes[0].axis().unwrap().length() - 48.0).abs() < 1e-3);
        // 48 px x 0.4 px of (0.108 um)^2 at 1000 per um^2.
        assert_eq!(species.shapes[0].num_emitters(108.0), 224);
        assert_eq!(species.photophysics.on_ratio(), 0.1);
    }
}

#[test]
fn missing_and_unknown_keys_and_bad_values_are_told_at_once() {
    let text = MINIMAL
        .replace("frames = 10\n", "frame = 10\n")
        .replace("width_px = 40", "width_px = -3")
        .replace("numerical_aperture = 1.27", "numerical_aperture = nan")
        .replace("tau_off_ms = 180.0\n", "")
        .replace("width_px = 0.4", "width_pix = 0.4");
    let found = faults(&text);
    let keys: Vec<&str> = found.iter().map(|fault| fault.key.as_str()).collect();
    for key in [
        "frame",
        "frames",
        "width_px",
        "optics.numerical_aperture",
        "species[0].tau_off_ms",
        "species[0].filament[0].width_pix",
        "species[0].filament[0].width_px",
    ] {
        assert!(keys.contains(&key), "{key} in {keys:?}");
    }
    assert_eq!(found.len(), 7, "{found:#?}");
    let unknown = found.iter().find(|fault| fault.key == "frame").unwrap();
    assert_eq!(unknown.line, Some(3));
    assert!(unknown.remedy.contains("`frames`"), "{}", unknown.remedy);
    assert!(found.iter().all(|fault| !fault.remedy.is_empty()));
}

#[test]
fn hostile_values_are_faults() {
    for (from, to, key) in [
        ("frames = 10", "frames = 0", "frames"),
        ("frames = 10", "frames = 99999999999999999999", "frames"),
        ("frames = 10", "frames = \"many\"", "frames"),
        ("height_px = 32", "height_px = 1000000000", "height_px"),
        ("exposure_ms = 20.0", "exposure_ms = inf", "exposure_ms"),
        ("exposure_ms = 20.0", "exposure_ms = -1", "exposure_ms"),
        ("seed = 1", "seed = -1", "seed"),
        ("name = \"minimal\"", "name = \"\"", "name"),
        ("transmission = 0.35", "transmission = 1.5", "species[0].transmission"),
        ("transmission = 0.35", "transmission = 0.7\nreflection = 0.7", "species[0].reflection"),
        ("tau_on_ms = 20.0", "tau_on_ms = 1e-9", "species[0].tau_on_ms"),
        ("tau_on_ms = 20.0", "tau_on_ms = 20.0\nsteady = true", "species[0].tau_on_ms"),
        ("from_px = [5.0, 5.0]", "from_px = [5.0]", "species[0].filament[0].from_px"),
        ("from_px = [5.0, 5.0]", "from_px = [nan, 1e300]", "species[0].filament[0].from_px"),
        ("density_per_um2 = 1000.0", "density_per_um2 = 1e12", "species[0].filament[0].density_per_um2"),
        ("width_px = 0.4\ndensity_per_um2 = 1000.0", "width_px = 900\ndensity_per_um2 = 1e6", "species"),
        ("emission_nm = 592.0", "emission_nm = [592.0]", "species[0].emission_nm"),
        ("[optics]\npixel_pitch_nm = 108.0\nnumerical_aperture = 1.27", "", "optics"),
        (
            "pixel_pitch_nm = 108.0\nnumerical_aperture = 1.27",
            "pixel_pitch_nm = 10\nnumerical_aperture = 0.1",
            "optics",
        ),
        (
            "[[species]]",
            "[camera]\ngain_counts_per_electron = 0\n[[species]]",
            "camera.gain_counts_per_electron",
        ),
        (
            "[[species]]",
            "[camera.transmitted.view]\nmirror = \"up\"\n[[species]]",
            "camera.transmitted.view.mirror",
        ),
    ] {
        let found = faults_with(from, to);
        assert!(found.iter().any(|fault| fault.key == key), "{to}: {found:#?}");
    }
}

#[test]
fn texts_that_are_no_scene_are_faults() {
    for text in ["", "name = ", "[[[[", "\u{0}", "species = 3", "optics = []", "species = [1, 2]"] {
        assert!(!faults(text).is_empty(), "{text}");
    }
    let deep = format!("a = {}", "[".repeat(200_000));
    assert!(!faults(&deep).is_empty());
    let dotted = format!("{}a = 1", "a.".repeat(200_000));
    assert!(!faults(&dotted).is_empty());
    let long = format!("# {}", "x".repeat(MAX_TEXT_BYTES));
    assert_eq!(faults(&long).len(), 1);
}

#[test]
fn two_species_of_one_name_and_species_without_a_place_are_faults() {
    let species = MINIMAL.split_once("[[species]]").unwrap().1;
    let twice = format!("{MINIMAL}[[species]]{species}");
    assert!(faults(&twice).iter().any(|fault| fault.key == "species[1].name"));
    let nowhere = MINIMAL.split_once("[[species.filament]]").unwrap().0;
    assert!(faults(nowhere).iter().any(|fault| fault.key == "species[0].filament"));
}

#[test]
fn keys_of_one_camera_go_before_those_of_both() {
    let text = MINIMAL.replace(
        "[[species]]",
        "[camera]\noffset_counts = 200.0\n[camera.transmitted]\noffset_counts = 300.0\n[[species]]",
    );
    let scene = Scene::from_toml(&text).unwrap();
    assert_eq!(scene.cameras().map(|camera| camera.offset_counts), [200.0, 300.0]);
}

#[test]
fn frames_can_be_changed_within_limits() {
    let scene = Scene::from_toml(MINIMAL).unwrap();
    assert_eq!(scene.with_frames(7).unwrap().frames(), 7);
    assert!(scene.with_frames(0).is_err());
    assert!(scene.with_frames(u64::MAX).is_err());
}

#[test]
fn the_view_rotates_and_scales_then_shifts_then_mirrors() {
    let turned = View { rotation_deg: 90.0, scale: 2.0, ..View::default() };
    let at = |view: &View, point| view.apply(point, 11, 21).map(|x: f64| (x * 1e9).round() / 1e9);
    // The center is (5, 10); x turns towards y.
    assert_eq!(at(&turned, [5.0, 11.0]), [7.0, 10.0]);
    assert_eq!(at(&turned, [6.0, 10.0]), [5.0, 8.0]);
    let shifted = View { shift_px: [1.0, 3.0], mirror: Mirror::Horizontal, ..View::default() };
    assert_eq!(at(&shifted, [2.0, 4.0]), [3.0, 13.0]);
    let upside_down = View { shift_px: [1.0, 3.0], mirror: Mirror::Vertical, ..View::default() };
    assert_eq!(at(&upside_down, [2.0, 4.0]), [7.0, 7.0]);
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(300) })]

    #[test]
    fn damaged_scene_files_never_panic(cut in 0_usize..640, letter in any::<char>(), take in 0_usize..40) {
        let mut letters: Vec<char> = MINIMAL.chars().collect();
        let from = cut.min(letters.len());
        let to = (from + take).min(letters.len());
        letters.splice(from..to, [letter]);
        let _: Result<Scene, SceneError> = Scene::from_toml(&letters.iter().collect::<String>());
    }

    #[test]
    fn any_number_is_a_value_or_a_fault(number in prop::num::f64::ANY, line in 2_usize..22) {
        let text: Vec<String> = MINIMAL.lines().enumerate().map(|(index, text)| {
            match text.split_once(" = ") {
                Some((key, _)) if index == line => format!("{key} = {number:?}"),
                _ => text.to_owned(),
            }
        }).collect();
        let _: Result<Scene, SceneError> = Scene::from_toml(&text.join("\n"));
    }
}

#[test]
fn scenes_without_a_sample_say_so() {
    let flat = Scene::built_in("flat").unwrap();
    let scene = Scene::from_toml(flat).unwrap();
    assert!(scene.species().is_empty());
    assert!(
        scene.cameras().iter().all(|camera| camera.pixels.hot_share == 0.001 && !camera.pixels.is_even())
    );
    let forgotten = flat.replace("empty = true", "");
    assert!(Scene::from_toml(&forgotten).unwrap_err().to_string().contains("empty = true"));
    let s4 = Scene::built_in("figure-s4").unwrap();
    let both = format!("empty = true\n{s4}");
    assert!(Scene::from_toml(&both).unwrap_err().to_string().contains("contradicts `species`"));
    let exchanged = flat.replace("[200.0, 5000.0]", "[5000.0, 200.0]");
    assert!(Scene::from_toml(&exchanged).unwrap_err().to_string().contains("hot_electrons"));
}
