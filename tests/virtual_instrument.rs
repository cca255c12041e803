//! The whole microscope of the paper as virtual devices in processes of their own, driven by the real drivers.
//!
//! What the cameras of such a run recorded is compared with the frames that `simulate` makes of the same sample:
//! the same bits mean that lasers, gates, trigger, stage, focus lock and both cameras did what the plan asked.

#[cfg(test)]
#[cfg(feature = "aravis")]
mod tests {
    use serde_json::Value;
    use sofiscope_virtual::log::{Note, read};
    use std::fs;
    use std::io::{BufRead, BufReader, Read};
    use std::path::{Path, PathBuf};
    use std::process::{Child, Command, Stdio};

    const PROGRAM: &str = env!("CARGO_BIN_EXE_sofiscope");
    const EXPOSURES: u64 = 200;

    /// The shipped virtual instrument in a directory of its own and on addresses of its own, with its devices up.
    struct Microscope {
        folder: tempfile::TempDir,
        devices: Child,
    }

    impl Microscope {
        fn up(network: u8, drift_nm_per_s: f64) -> Self {
            let folder = tempfile::tempdir().unwrap();
            let shipped = fs::read_to_string("config/virtual.toml").unwrap();
            let text = shipped
                .replace("/tmp/sofiscope-virtual", &folder.path().join("devices").display().to_string())
                .replace("127.0.0.", &format!("127.0.{network}."))
                .replace(
                    "drift_nm_per_s = 5.0",
                    &format!("drift_nm_per_s = {drift_nm_per_s:?}\nframes = {EXPOSURES}"),
                );
            fs::write(folder.path().join("virtual.toml"), text).unwrap();
            let mut devices = Command::new(PROGRAM)
                .args(["devices", "virtual", "up"])
                .arg(folder.path().join("virtual.toml"))
                .stdout(Stdio::piped())
                .spawn()
                .unwrap();
            let told = BufReader::new(devices.stdout.take().unwrap()).lines().map_while(Result::ok);
            assert!(
                told.into_iter().any(|line| line.starts_with("up;")),
                "the virtual devices did not start"
            );
            Self { folder, devices }
        }

        fn path(&self, name: &str) -> PathBuf {
            self.folder.path().join(name)
        }

        /// Runs a command of the program on this instrument; standard output, and whether it went well.
        fn command(&self, arguments: &[&str]) -> (String, String, bool) {
            let instrument = self.path("virtual.toml").display().to_string();
            let arguments = arguments.iter().map(|word| word.replace("INSTRUMENT", &instrument));
            let output =
                Command::new(PROGRAM).args(arguments).current_dir(self.folder.path()).output().unwrap();
            let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
            (text(&output.stdout), text(&output.stderr), output.status.success())
        }

        fn log(&self, device: &str) -> Vec<Note> {
            read(&self.path("devices").join(format!("{device}.log"))).unwrap()
        }

        fn plan(&self, focus: &str) -> String {
            let shipped = fs::read_to_string("config/plans/three-color.yaml").unwrap();
            let text = shipped
                .replace("loops: 400", &format!("loops: {EXPOSURES}"))
                .replace("recording: ome-tiff", &format!("recording: ome-tiff\n    focus_lock: {focus}"));
            // One place is enough here.
            let (before, rest) = text.split_once("  - name: cell 2").unwrap();
            let after = rest.split_once("time_plan:").unwrap().1;
            fs::write(self.path("plan.yaml"), format!("{before}time_plan:{after}")).unwrap();
            "plan.yaml".to_owned()
        }
    }

    impl Drop for Microscope {
        fn drop(&mut self) {
            // The devices end when their starter does, whatever way it goes.
            self.devices.kill().unwrap();
            self.devices.wait().unwrap();
        }
    }

    /// All pixels of all frames of a stack.
    fn frames(path: &Path) -> Vec<Vec<u16>> {
        let file = BufReader::new(fs::File::open(path).unwrap());
        let mut stack = tiff::decoder::Decoder::new(file).unwrap();
        let mut frames = Vec::new();
        loop {
            match stack.read_image().unwrap() {
                tiff::decoder::DecodingResult::U16(counts) => frames.push(counts),
                other => panic!("{other:?}"),
            }
            if !stack.more_images() {
                return frames;
            }
            stack.next_image().unwrap();
        }
    }

    fn recorded(folder: &Path, camera: &str) -> Vec<Vec<u16>> {
        let found = fs::read_dir(folder).unwrap().flatten().map(|entry| entry.path());
        let stack = found.into_iter().find(|path| {
            let name = path.file_name().unwrap().to_string_lossy().into_owned();
            name.starts_with(camera) && name.ends_with(".ome.tif")
        });
        frames(&stack.unwrap_or_else(|| panic!("no stack of {camera} in {}", folder.display())))
    }

    #[test]
    fn a_run_with_every_driver_records_what_the_simulated_sample_shows() {
        let microscope = Microscope::up(11, 5.0);
        let (told, log, is_fine) = microscope.command(&["devices", "check", "INSTRUMENT", "--json"]);
        assert!(is_fine, "{log}");
        let told: Value = serde_json::from_str(&told).unwrap();
        assert_eq!(told["devices"].as_array().unwrap().len(), 9);
        assert_eq!(told["is_virtual"], Value::Bool(true));
        let (_, log, is_fine) = microscope.command(&["devices", "home", "INSTRUMENT"]);
        assert!(is_fine, "{log}");
        let plan = microscope.plan("hold");
        let (told, log, is_fine) =
            microscope.command(&["run", &plan, "--instrument", "INSTRUMENT", "--out", "run", "--json"]);
        assert!(is_fine, "{log}");
        let ended: Value = serde_json::from_str(&told).unwrap();
        assert_eq!(ended["frames_recorded"], Value::from(2 * EXPOSURES), "{ended}\n{log}");
        assert_eq!(ended["frames_lost"], Value::Object(serde_json::Map::new()), "{ended}");
        assert_eq!(ended["simulated"], Value::Bool(true));

        // 5 nm/s for the seconds of the run would be far more than this.
        let rms = log.lines().find_map(|line| line.strip_prefix("focus error while it held: "));
        let rms: f64 = rms.unwrap_or_else(|| panic!("{log}")).split(' ').next().unwrap().parse().unwrap();
        println!("focus error while it held: {rms} nm rms");
        assert!(rms < 20.0, "{rms} nm");

        let number = EXPOSURES.to_string();
        let scene = concat!(env!("CARGO_MANIFEST_DIR"), "/config/scenes/figure-s4.toml");
        let (_, log, is_fine) =
            microscope.command(&["simulate", scene, "--out", "truth", "--seed", "1", "--frames", &number]);
        assert!(is_fine, "{log}");
        for camera in ["reflection", "transmission"] {
            let taken = recorded(&microscope.path("run"), camera);
            let truth = frames(&microscope.path("truth").join(format!("{camera}.ome.tif")));
            assert_eq!(taken.len(), truth.len());
            let same = taken.iter().zip(&truth).filter(|(taken, truth)| taken == truth).count();
            println!("{camera}: {same} of {} frames have the bits of the simulated ones", truth.len());
            // An exposure whose light came late on a busy computer is dark; nothing else may differ.
            let dark = taken.iter().filter(|frame| frame.iter().all(|count| *count == 100)).count();
            assert!(dark <= 5 && same + dark == truth.len(), "{same} the same, {dark} dark");
        }

        // The gates were open during exposures only, and everything was dark at the end.
        let gates = microscope.log("gates");
        assert!(gates.iter().any(|note| note.value == f64::from(0b1110)), "488, 561 and 635 nm together");
        assert!(gates.iter().all(|note| [0.0, f64::from(0b1110)].contains(&note.value)), "no other pattern");
        for pair in gates.windows(2).filter(|pair| pair[0].value != 0.0) {
            assert!(
                pair[1].at - pair[0].at < std::time::Duration::from_millis(71),
                "open for longer than it may be"
            );
        }
        for device in ["gates", "laser-488", "laser-561", "laser-635"] {
            let notes = microscope.log(device);
            assert!(notes.iter().any(|note| note.value > 0.0), "{device} never shone");
            assert_eq!(notes.last().unwrap().value, 0.0, "{device} shines after the run");
        }
        assert!(microscope.log("laser-405").iter().all(|note| note.value == 0.0), "not in the plan");
    }

    #[test]
    fn a_stage_that_does_not_know_its_place_is_not_moved() {
        let microscope = Microscope::up(12, 0.0);
        let plan = microscope.plan("none");
        let (_, log, is_fine) =
            microscope.command(&["run", &plan, "--instrument", "INSTRUMENT", "--out", "run", "--json"]);
        assert!(!is_fine && log.contains("home it first"), "{log}");
        assert!(microscope.log("laser-488").iter().all(|note| note.value == 0.0));
        assert!(microscope.log("gates").iter().all(|note| note.value == 0.0));
    }

    #[test]
    fn devices_that_are_not_there_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let missing = folder.path().join("none").display().to_string();
        let shipped = fs::read_to_string("config/virtual.toml").unwrap();
        let instrument = folder.path().join("virtual.toml");
        fs::write(&instrument, shipped.replace("/tmp/sofiscope-virtual", &missing)).unwrap();
        let mut child = Command::new(PROGRAM)
            .args(["devices", "check"])
            .arg(&instrument)
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut log = String::new();
        child.stderr.take().unwrap().read_to_string(&mut log).unwrap();
        assert_eq!(child.wait().unwrap().code(), Some(3), "{log}");
        assert!(log.contains("gatekeeper") && log.contains("no such port"), "{log}");
    }
}
