//! What a test or a person tells the bench, as words.
//!
//! In: text such as `camera 0 lose 5; pulses 10000 100`. Out: [`Command`]s. Fails: with the words that are none.
//!
//! | words | what happens |
//! |---|---|
//! | `reset` | everything as at power-up, handles closed |
//! | `scene beads` or `scene /path/scene.toml` | what both cameras look at |
//! | `serials 000001 000002` | serial numbers |
//! | `table /path` | pulses come from an optical table |
//! | `pulses 10000 100`, `pulses 10000` | a train: period in microseconds, number |
//! | `stop-pulses` | the end of the train |
//! | `cable`, `no-cable` | camera 1 hears the first output of camera 0, or the trigger line |
//! | `camera 0 lose 5` | frame stamp 5 never arrives |
//! | `camera 0 miss 5` | pulse 5 of a capture is not heard |
//! | `camera 0 unplug`, `plug`, `unplug-after 7` | cable pulled, put back, pulled after 7 frames |
//! | `camera 0 busy 3` | the next 3 settings are refused as busy |
//! | `journal` | answers with the calls since the last `journal` |
//! | `open` | answers with the numbers of open cameras, waits and rings |

use std::time::Duration;

/// What happens to one camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Fault {
    Lose(u32),
    Miss(u64),
    Unplug,
    Plug,
    UnplugAfter(u32),
    Busy(u32),
}

/// What happens to the bench.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Command {
    Reset,
    Scene(String),
    Serials([String; 2]),
    Table(String),
    Pulses(Duration, Option<u64>),
    StopPulses,
    Cable(bool),
    Camera(usize, Fault),
    Journal,
    Open,
}

/// All commands of a text, separated by `;` or lines.
pub(crate) fn parse(text: &str) -> Result<Vec<Command>, String> {
    let commands = text.split([';', '\n']).map(str::trim).filter(|text| !text.is_empty());
    commands.map(|text| one(text).ok_or_else(|| format!("'{text}' is no command"))).collect()
}

fn one(text: &str) -> Option<Command> {
    let words: Vec<&str> = text.split_whitespace().collect();
    Some(match words.as_slice() {
        ["reset"] => Command::Reset,
        ["scene", name] => Command::Scene((*name).into()),
        ["serials", first, second] => Command::Serials([(*first).into(), (*second).into()]),
        ["table", path] => Command::Table((*path).into()),
        ["pulses", period] => Command::Pulses(microseconds(period)?, None),
        ["pulses", period, number] => Command::Pulses(microseconds(period)?, Some(number.parse().ok()?)),
        ["stop-pulses"] => Command::StopPulses,
        ["cable"] => Command::Cable(true),
        ["no-cable"] => Command::Cable(false),
        ["camera", camera @ ("0" | "1"), fault @ ..] => {
            Command::Camera(usize::from(*camera == "1"), fault_of(fault)?)
        }
        ["journal"] => Command::Journal,
        ["open"] => Command::Open,
        _ => return None,
    })
}

fn fault_of(words: &[&str]) -> Option<Fault> {
    Some(match words {
        ["lose", stamp] => Fault::Lose(stamp.parse().ok()?),
        ["miss", pulse] => Fault::Miss(pulse.parse().ok()?),
        ["unplug"] => Fault::Unplug,
        ["plug"] => Fault::Plug,
        ["unplug-after", frames] => Fault::UnplugAfter(frames.parse().ok()?),
        ["busy", times] => Fault::Busy(times.parse().ok()?),
        _ => return None,
    })
}

fn microseconds(word: &str) -> Option<Duration> {
    let value: f64 = word.parse().ok()?;
    (1.0..=1e10).contains(&value).then(|| Duration::from_nanos((value * 1e3).round() as u64))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_become_commands_and_others_are_refused() {
        let commands = parse("camera 1 lose 5; pulses 250.5 3\nstop-pulses").unwrap();
        let train = Command::Pulses(Duration::from_nanos(250_500), Some(3));
        assert_eq!(commands, [Command::Camera(1, Fault::Lose(5)), train, Command::StopPulses]);
        for text in ["camera 2 unplug", "pulses 0", "pulses -1", "lose", "serials 1"] {
            assert!(parse(text).unwrap_err().contains(text), "{text}");
        }
    }
}
