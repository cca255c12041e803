//! What each command does, and the texts of its answer.

use std::time::Duration;

use super::IbeamSmart;
use super::words::in_full;

const UNKNOWN: &str = "%SYS-E-00022, unknown command";
const PARAMETER: &str = "%SYS-E-00025, parameter error";

impl IbeamSmart {
    pub(super) fn execute(&mut self, command: &str, now: Duration) -> Vec<String> {
        let words = in_full(command);
        let words: Vec<&str> = words.iter().map(String::as_str).collect();
        match words.as_slice() {
            ["reset", "system"] => {
                self.restart(now);
                Vec::new()
            }
            ["echo" | "prompt" | "talk", ..] => self.mind_manners(&words),
            ["id" | "serial" | "version" | "status" | "show" | "help", ..] => {
                let texts = self.query(&words, now);
                // `talk quiet` swallows the texts of queries.
                if self.manners.quiet { Vec::new() } else { texts }
            }
            _ => match self.faults.refuses_with.clone() {
                Some(refusal) if !matches!(words[..], ["laser", "off"] | ["disable", _]) => vec![refusal],
                _ => self.set(&words),
            },
        }
    }

    fn mind_manners(&mut self, words: &[&str]) -> Vec<String> {
        match words {
            ["echo", "on"] => self.manners.echo = true,
            ["echo", "off"] => self.manners.echo = false,
            ["prompt", "on"] => self.manners.prompt = true,
            ["prompt", "off"] => self.manners.prompt = false,
            ["talk", "quiet"] => self.manners.quiet = true,
            ["talk", "usual" | "gabby" | "robot"] => self.manners.quiet = false,
            _ => return vec![PARAMETER.to_owned()],
        }
        Vec::new()
    }

    fn set(&mut self, words: &[&str]) -> Vec<String> {
        let done = match words {
            ["laser", "on"] => {
                self.on = true;
                true
            }
            ["laser", "off"] => {
                self.on &= self.faults.stuck_on;
                true
            }
            ["enable" | "disable", "ext"] => {
                self.ext = words[0] == "enable";
                true
            }
            ["enable" | "disable", channel] => self.enable(channel, words[0] == "enable"),
            ["channel", channel, "power", power] => self.set_level(channel, power, 1000.0),
            ["channel", channel, "power", power, "micro"] => self.set_level(channel, power, 1.0),
            ["fine", ..] => self.set_fine(words),
            ["ini", "laser"] => true,
            _ => return vec![UNKNOWN.to_owned()],
        };
        if done { Vec::new() } else { vec![PARAMETER.to_owned()] }
    }

    fn enable(&mut self, channel: &str, enabled: bool) -> bool {
        let kept = if enabled { self.faults.channels_dead } else { self.faults.stuck_on };
        match channel.parse::<usize>() {
            Ok(0) if !enabled => {
                self.channels.iter_mut().for_each(|channel| channel.enabled &= kept);
                true
            }
            Ok(number @ 1..=5) => {
                let channel = &mut self.channels[number - 1];
                channel.enabled = if kept { channel.enabled } else { enabled };
                true
            }
            _ => false,
        }
    }

    fn set_level(&mut self, channel: &str, power: &str, unit_uw: f64) -> bool {
        let power_uw = power.parse::<f64>().unwrap_or(f64::NAN) * unit_uw;
        let allowed = (0.0..=self.max_mw * 1000.0).contains(&power_uw);
        match channel.parse::<usize>() {
            Ok(number @ 1..=5) if allowed => {
                self.channels[number - 1].power_uw = power_uw * (1.0 + self.faults.level_error);
                true
            }
            _ => false,
        }
    }

    fn set_fine(&mut self, words: &[&str]) -> bool {
        let percent = words.get(2).and_then(|word| word.parse::<f64>().ok());
        let percent = percent.filter(|percent| (0.0..=100.0).contains(percent));
        match (words, percent) {
            (["fine", "on"], _) => self.fine.on = true,
            (["fine", "off"], _) => self.fine.on = false,
            (["fine", "a", _], Some(percent)) => self.fine.a_percent = percent,
            (["fine", "b", _], Some(percent)) => self.fine.b_percent = percent,
            _ => return false,
        }
        true
    }

    fn query(&mut self, words: &[&str], now: Duration) -> Vec<String> {
        let text = match words {
            ["id"] => "iBEAM-SMART-488-S-HP".to_owned(),
            ["serial"] | ["show", "serial"] => format!("SN: {}", self.serial),
            ["version"] => "iBPs-001A01-05 virtual".to_owned(),
            ["status", "laser"] => on_off(self.on),
            ["status", "ext"] => on_off(self.ext),
            ["status", "fine"] => on_off(self.fine.on),
            ["status", "clip"] => self.clip.to_owned(),
            ["status", "uptime"] => self.uptime(now),
            ["status", "channel", number] => match number.parse::<usize>() {
                Ok(number @ 1..=5) => on_off(self.channels[number - 1].enabled),
                _ => PARAMETER.to_owned(),
            },
            ["show", "power"] => format!("PIC  = {:06.0} uW  ", self.measured_uw()),
            ["show", "current"] => format!("LDC  = {:.1} mA", 30.0 + self.head.power_mw()),
            ["show", "temperature"] => format!("TEMP = {:.0} C", 25.0 + self.drift(now)),
            ["show", "temperature", "system"] => format!("TEMP = {:.0} C", 28.0 + self.drift(now)),
            ["show", "limit"] => format!("Pmax: {:.0} mW", self.max_mw),
            ["show", "level", "power"] => return self.levels(),
            ["show", "satellite"] => return self.satellite(),
            ["show", "data"] => return self.data(),
            ["show", "system"] => return vec!["pulse board: no".into(), "SPP modes: CW (On2)".into()],
            ["help"] => return vec!["status ext".into(), "status laser".into(), "show power".into()],
            _ => UNKNOWN.to_owned(),
        };
        vec![text]
    }

    /// Temperatures move by 0.2 K over minutes.
    fn drift(&self, now: Duration) -> f64 {
        0.2 * (now.as_secs_f64() / 120.0).sin()
    }

    fn uptime(&self, now: Duration) -> String {
        let minutes = now.as_secs() / 60;
        format!("PowerUP: {} h + {} m", minutes / 60, minutes % 60)
    }

    fn levels(&self) -> Vec<String> {
        let numbered = self.channels.iter().enumerate();
        numbered
            .map(|(index, channel)| format!("CH{}, PWR: {:.3} mW", index + 1, channel.power_uw / 1000.0))
            .collect()
    }

    fn satellite(&self) -> Vec<String> {
        let mut texts = vec![format!("Pmax: {:.0} mW", self.max_mw)];
        let numbered = self.channels.iter().enumerate();
        texts
            .extend(numbered.map(|(index, channel)| {
                format!("CH{} setp: {:.1} mW", index + 1, channel.power_uw / 1000.0)
            }));
        texts
    }

    fn data(&self) -> Vec<String> {
        let ext = if self.ext { "enabled" } else { "disabled" };
        let mut texts = vec![
            format!("fine a -> {:.0} %", self.fine.a_percent),
            format!("fine b -> {:.0} %", self.fine.b_percent),
            format!("enable EXT: {ext}"),
        ];
        texts.extend(self.satellite());
        texts
    }
}

fn on_off(on: bool) -> String {
    if on { "ON" } else { "OFF" }.to_owned()
}
