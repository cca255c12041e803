//! The instrument and the plans that ship with the program fit each other, and faults name their place.

#[cfg(test)]
mod tests {
    use sofiscope::config::{AnalysisSettings, Instrument};
    use sofiscope::control::plan::Plan;
    use std::path::PathBuf;

    fn folder(name: &str) -> PathBuf {
        PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("config").join(name)
    }

    fn plans() -> Vec<(PathBuf, String)> {
        let entries = std::fs::read_dir(folder("plans")).unwrap();
        let paths = entries.map(|entry| entry.unwrap().path());
        paths.map(|path| (path.clone(), std::fs::read_to_string(path).unwrap())).collect()
    }

    #[test]
    fn every_shipped_plan_works_on_the_simulated_instrument() {
        let text = std::fs::read_to_string(folder("simulated.toml")).unwrap();
        let instrument = Instrument::from_toml(&text).unwrap();
        let limits = instrument.limits();
        assert!(plans().len() >= 2);
        for (path, text) in plans() {
            let plan = Plan::from_text(&text).unwrap_or_else(|error| panic!("{}:\n{error}", path.display()));
            assert!(plan.duration().is_some(), "{} ends for certain", path.display());
            assert!(plan.cameras().period >= limits.shortest_period.unwrap());
            assert!(plan.cameras().exposure <= limits.longest_exposure.unwrap());
            let settings = AnalysisSettings::try_from(plan.analysis().clone()).unwrap();
            assert_eq!(settings.dichroic.as_deref(), instrument.dichroic());
            assert_eq!(Plan::from_text(&plan.to_yaml()).unwrap(), plan);
        }
    }

    #[test]
    fn every_key_of_a_plan_misspelled_is_refused_with_its_line() {
        for (path, text) in plans() {
            for (number, line) in text.lines().enumerate().filter(|(_, line)| !line.starts_with('#')) {
                let Some((key, _)) = line.split_once(':') else { continue };
                let key = key.trim_start_matches([' ', '-']);
                // Other programs keep metadata of their own beside ours.
                // A letter that is wrong is near to no other.
                if key.trim() == "sofiscope" || key.trim().len() == 1 {
                    continue;
                }
                let wrong = line.replacen(key, &format!("{key}x"), 1);
                let broken = text.replacen(&format!("{line}\n"), &format!("{wrong}\n"), 1);
                let error = Plan::from_text(&broken).unwrap_err();
                let of_line = error.faults.iter().find(|fault| fault.line == Some(number + 1));
                let fault = of_line.unwrap_or_else(|| panic!("{}: {wrong}: {error}", path.display()));
                assert!(fault.remedy.contains(&format!("`{}`", key.trim())), "{wrong}: {fault}");
            }
        }
    }
}
