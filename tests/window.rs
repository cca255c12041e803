//! The real window, drawn by OpenGL on a virtual display, with the simulated microscope behind it and a hand on
//! keyboard and mouse. Pictures of the screen are kept in `target/window/`.
//!
//! Needs Xvfb, xdotool and ImageMagick, which `./test` installs; says that it skips where they are missing.

#[cfg(test)]
mod tests {
    use std::fs;
    use std::io::{BufRead, BufReader, Read};
    use std::path::{Path, PathBuf};
    use std::process::{Child, Command, Stdio};
    use std::sync::mpsc::{Receiver, sync_channel};
    use std::time::{Duration, Instant};

    /// Where the plan of the paper is chosen.
    const PAPER: [u32; 2] = [1123, 125];
    /// Far longer than anything here takes.
    const PATIENCE: Duration = Duration::from_secs(90);

    fn has(program: &str) -> bool {
        Command::new("sh")
            .args(["-c", &format!("command -v {program}")])
            .stdout(Stdio::null())
            .status()
            .is_ok_and(|s| s.success())
    }

    /// A display, the program on it, and what it says.
    struct Bench {
        display: String,
        xvfb: Child,
        program: Child,
        said: Receiver<String>,
        log: Vec<String>,
        folder: tempfile::TempDir,
    }

    impl Bench {
        /// None where the programs are missing.
        fn start(instrument: Option<&str>) -> Option<Self> {
            for program in ["Xvfb", "xdotool", "import"] {
                if !has(program) {
                    eprintln!("skipped: {program} is missing; ./test installs it");
                    return None;
                }
            }
            let mut xvfb = Command::new("Xvfb")
                .args(["-displayfd", "1", "-screen", "0", "1280x800x24", "-nolisten", "tcp"])
                .stdout(Stdio::piped())
                .stderr(Stdio::null())
                .spawn()
                .unwrap();
            let mut number = String::new();
            BufReader::new(xvfb.stdout.take().unwrap()).read_line(&mut number).unwrap();
            let display = format!(":{}", number.trim());
            let folder = tempfile::tempdir().unwrap();
            let mut command = Command::new(env!("CARGO_BIN_EXE_sofiscope"));
            command.arg("live");
            if let Some(text) = instrument {
                let path = folder.path().join("instrument.toml");
                fs::write(&path, text).unwrap();
                command.arg("--instrument").arg(path);
            }
            let mut program = command
                .current_dir(folder.path())
                .env("DISPLAY", &display)
                .env_remove("WAYLAND_DISPLAY")
                .env("LIBGL_ALWAYS_SOFTWARE", "1")
                .env("XDG_DATA_HOME", folder.path())
                .env("SOFISCOPE_LOG", "sofiscope=info")
                .env("NO_COLOR", "1")
                .stderr(Stdio::piped())
                .spawn()
                .unwrap();
            let lines = BufReader::new(program.stderr.take().unwrap());
            let (sender, said) = sync_channel(10_000);
            std::thread::spawn(move || {
                for line in lines.lines().map_while(Result::ok) {
                    if sender.send(line).is_err() {
                        return;
                    }
                }
            });
            Some(Self { display, xvfb, program, said, log: Vec::new(), folder })
        }

        /// Waits until the program says something, and gives the line.
        fn hear(&mut self, part: &str) -> String {
            let begun = Instant::now();
            loop {
                match self.said.recv_timeout(PATIENCE.saturating_sub(begun.elapsed())) {
                    Ok(line) => {
                        self.log.push(line.clone());
                        if line.contains(part) {
                            return line;
                        }
                    }
                    Err(_) => panic!("{part:?} was not heard; {:#?}", self.log),
                }
            }
        }

        fn xdotool(&self, arguments: &[&str]) -> String {
            let output =
                Command::new("xdotool").args(arguments).env("DISPLAY", &self.display).output().unwrap();
            String::from_utf8_lossy(&output.stdout).trim().to_owned()
        }

        /// Waits until the window is on the screen, and gives it the keyboard.
        fn window(&self) {
            let found = self.xdotool(&["search", "--sync", "--onlyvisible", "--name", "sofiscope"]);
            let window = found.lines().last().unwrap_or_default().to_owned();
            self.xdotool(&["windowfocus", "--sync", &window]);
        }

        fn key(&self, keys: &str) {
            self.xdotool(&["key", "--clearmodifiers", keys]);
        }

        fn click(&self, button: &str, x: u32, y: u32) {
            // Two steps, so that the window hears of the pointer before the click.
            self.xdotool(&["mousemove", &(x - 1).to_string(), &y.to_string()]);
            self.xdotool(&["mousemove", &x.to_string(), &y.to_string()]);
            self.xdotool(&["click", button]);
        }

        /// The screen, kept under a name: width and RGB.
        fn screen(&self, name: &str) -> (usize, Vec<[u8; 3]>) {
            let place = pictures();
            fs::create_dir_all(&place).unwrap();
            let path = place.join(format!("{name}.png"));
            let taken = Command::new("import")
                .args(["-window", "root", "-depth", "8", "-type", "TrueColor"])
                .arg(format!("PNG24:{}", path.display()))
                .env("DISPLAY", &self.display)
                .status()
                .unwrap();
            assert!(taken.success());
            read(&path)
        }

        /// Looks at the screen until it shows something; the pause is a wait for whatever the program says meanwhile.
        fn see(&mut self, name: &str, mut shows: impl FnMut(usize, &[[u8; 3]]) -> bool) {
            let begun = Instant::now();
            loop {
                let (width, pixels) = self.screen(name);
                if shows(width, &pixels) {
                    return;
                }
                assert!(begun.elapsed() < PATIENCE, "{name} was not seen; look at {}", pictures().display());
                if let Ok(line) = self.said.recv_timeout(Duration::from_millis(200)) {
                    self.log.push(line);
                }
            }
        }

        /// The process of the window.
        fn window_process(&self) -> String {
            let instrument = self.program.id().to_string();
            let found =
                Command::new("pgrep").args(["-P", &instrument, "-f", "sofiscope window"]).output().unwrap();
            let found = String::from_utf8_lossy(&found.stdout).trim().to_owned();
            assert_eq!(found.lines().count(), 1, "one window belongs to the instrument: {found:?}");
            found
        }

        fn signal(&self, name: &str, process: &str) {
            assert!(Command::new("kill").args([name, process]).status().unwrap().success());
        }

        /// Exposures in the ledger of the recording under way.
        fn exposures_recorded(&self) -> usize {
            let recording = self.folder.path().join("sofiscope-run");
            let ledger = fs::read_to_string(recording.join("ledger.csv")).unwrap_or_default();
            ledger.lines().count().saturating_sub(1) / 2
        }

        /// Waits until so many exposures more are recorded; the pause is a wait for whatever the program says.
        fn record(&mut self, exposures: usize) {
            let (begun, first) = (Instant::now(), self.exposures_recorded());
            while self.exposures_recorded() < first + exposures {
                assert!(begun.elapsed() < PATIENCE, "{first} exposures were recorded; {:#?}", self.log);
                if let Ok(line) = self.said.recv_timeout(Duration::from_millis(100)) {
                    self.log.push(line);
                }
            }
        }

        /// Closes the window by its key, and gives the exit code.
        fn close(mut self) -> Option<i32> {
            self.key("ctrl+q");
            let begun = Instant::now();
            while begun.elapsed() < PATIENCE {
                if let Some(status) = self.program.try_wait().unwrap() {
                    return status.code();
                }
                if let Ok(line) = self.said.recv_timeout(Duration::from_millis(50)) {
                    self.log.push(line);
                }
            }
            panic!("it does not end; {:#?}", self.log)
        }
    }

    impl Drop for Bench {
        fn drop(&mut self) {
            let _ = self.program.kill();
            let _ = self.xvfb.kill();
            let _ = (self.program.wait(), self.xvfb.wait());
        }
    }

    fn pictures() -> PathBuf {
        Path::new(env!("CARGO_TARGET_TMPDIR")).parent().unwrap().join("window")
    }

    fn read(path: &Path) -> (usize, Vec<[u8; 3]>) {
        let mut bytes = Vec::new();
        fs::File::open(path).unwrap().read_to_end(&mut bytes).unwrap();
        let mut reader = png::Decoder::new(std::io::Cursor::new(bytes)).read_info().unwrap();
        let mut data = vec![0; reader.output_buffer_size().unwrap()];
        let info = reader.next_frame(&mut data).unwrap();
        assert_eq!((info.color_type, info.bit_depth), (png::ColorType::Rgb, png::BitDepth::Eight));
        (info.width as usize, data.chunks_exact(3).map(|rgb| [rgb[0], rgb[1], rgb[2]]).collect())
    }

    /// Pixels of the middle of the screen, where the result is.
    fn result(width: usize, pixels: &[[u8; 3]]) -> Vec<[u8; 3]> {
        let rows = 110..510;
        rows.flat_map(|row| pixels[row * width + 360..row * width + 880].to_vec()).collect()
    }

    fn count(pixels: &[[u8; 3]], is: impl Fn([i32; 3]) -> bool) -> usize {
        pixels.iter().filter(|pixel| is(pixel.map(i32::from))).count()
    }

    /// Three dyes in their colors on black: something cyan, something yellow, something magenta.
    fn shows_three_dyes(width: usize, pixels: &[[u8; 3]]) -> bool {
        let image = result(width, pixels);
        let cyan = count(&image, |[r, g, b]| g > r + 80 && b > r + 80);
        let yellow = count(&image, |[r, g, b]| r > b + 80 && g > b + 80);
        let magenta = count(&image, |[r, g, b]| r > g + 80 && b > g + 80);
        let dark = count(&image, |[r, g, b]| r + g + b < 90);
        cyan > 100 && yellow > 100 && magenta > 100 && 2 * dark > image.len()
    }

    #[test]
    fn a_person_sees_the_composite_appear_changes_the_view_moves_the_stage_and_stops() {
        let Some(mut bench) = Bench::start(None) else { return };
        bench.window();
        bench.see("1-start", |width, pixels| pixels[247 * width + 460] != [27, 27, 27]);
        bench.click("1", 640, 247);
        bench.hear("is open (SIMULATED");
        bench.hear("the cameras are in the window");
        bench.hear("the result is in the window");
        bench.see("2-live", shows_three_dyes);
        bench.key("m");
        bench.see("3-beside-the-mean", |width, pixels| {
            // The divider is a white line from below the labels to the bottom.
            let image = result(width, pixels);
            (0..520).any(|column| {
                (30..400).all(|row| count(&[image[row * 520 + column]], |[r, g, b]| r + g + b > 500) == 1)
            })
        });
        bench.key("m");
        bench.key("o");
        bench.see("4-both-cameras", |width, pixels| !shows_three_dyes(width, pixels));
        bench.key("5");
        bench.key("e");
        bench.hear("saved: sofiscope-picture.png");
        bench.click("3", 700, 200);
        bench.hear("the stage is at");
        bench.key("ctrl+period");
        bench.hear("STOP: lasers off, motion stopped, run aborted");
        bench.hear("aborted");
        bench.screen("5-stopped");
        assert_eq!(bench.close(), Some(0));
    }

    #[test]
    fn a_camera_that_dies_is_named_and_the_window_goes_on() {
        let simulated = fs::read_to_string("config/simulated.toml").unwrap();
        let broken = format!("{simulated}\n[faults.transmitted]\ndie_at = 150\n");
        let Some(mut bench) = Bench::start(Some(&broken)) else { return };
        bench.window();
        bench.hear("is open (SIMULATED");
        bench.key("l");
        bench.hear("the result is in the window");
        let error = bench.hear("ERROR");
        assert!(error.contains("camera T"), "{error}");
        bench.see("6-camera-lost", |width, pixels| {
            // The error stands below the bar at the top, in vermilion.
            let top: Vec<_> = pixels[36 * width..70 * width].to_vec();
            count(&top, |[r, g, b]| r > 180 && g < 140 && b < 100) > 50
        });
        assert_eq!(bench.close(), Some(0));
    }

    #[test]
    fn a_run_outlives_its_window_and_loses_nothing() {
        let Some(mut bench) = Bench::start(None) else { return };
        bench.window();
        bench.see("1-start", |width, pixels| pixels[247 * width + 460] != [27, 27, 27]);
        bench.click("1", 640, 247);
        bench.hear("the result is in the window");
        bench.key("f");
        bench.key("ctrl+Return");
        bench.see("7-plan", |width, pixels| {
            // The chosen plan stands on blue.
            count(&[pixels[125 * width + 990]], |[r, _, b]| b > r + 60) == 1
        });
        // The plan of the paper, which records.
        bench.click("1", PAPER[0], PAPER[1]);
        // The cameras are simulated, which the check warns of: it is wanted all the same.
        bench.key("ctrl+Return");
        bench.see("8-warned", |width, pixels| {
            // Warnings stand below the plan in orange.
            let side: Vec<_> =
                (480..620).flat_map(|row| pixels[row * width + 980..row * width + 1270].to_vec()).collect();
            count(&side, |[r, g, b]| r > 180 && g > 100 && b < 60) > 100
        });
        bench.key("ctrl+Return");
        bench.record(50);
        bench.screen("9-run");
        let frozen = bench.window_process();
        bench.signal("-STOP", &frozen);
        // 10 seconds and more, at 20 ms each.
        bench.record(520);
        bench.signal("-KILL", &frozen);
        bench.hear("the window was lost");
        bench.hear("the cameras are in the window");
        assert_ne!(bench.window_process(), frozen);
        bench.window();
        bench.record(50);
        bench.screen("10-another-window");
        bench.key("f");
        let books = bench.hear("frames received");
        assert!(books.contains(" 0 lost; "), "{books}");
        assert_eq!(bench.close(), Some(0));
    }
}
