//! ImageJ's description: lines of `key=value`.
//!
//! In: the text and the resolution of the first page. Out: [`Metadata`].
//! Never: reads the file. Fails: not at all, what is missing stays unknown.

use super::{Dialect, Metadata, duration, nanometers_per, seconds_per};

/// `resolution` is in pixels per unit, x and y.
pub(super) fn parse(text: &str, resolution: [Option<f64>; 2]) -> Metadata {
    let value = |key: &str| {
        text.lines()
            .filter_map(|line| line.split_once('='))
            .find(|(name, _)| *name == key)
            .map(|(_, value)| value.trim())
    };
    let number = |key: &str| value(key).and_then(|value| value.parse::<f64>().ok());
    let count = |key: &str| value(key).and_then(|value| value.parse::<u64>().ok());
    let unit_nm = value("unit").and_then(nanometers_per);
    let interval_unit = seconds_per(value("tunit").unwrap_or("sec")).unwrap_or(1.0);
    Metadata {
        dialect: Dialect::ImageJ,
        planes: Some(count("images").unwrap_or(1)),
        channels: count("channels").unwrap_or(1).max(1),
        run: 1,
        channel_names: Vec::new(),
        pixel_size_nm: match (unit_nm, resolution) {
            (Some(unit), [Some(x), Some(y)]) => Some([unit / x, unit / y]),
            _ => None,
        },
        frame_interval: number("finterval").and_then(|interval| duration(interval * interval_unit)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn a_calibrated_hyperstack_is_understood() {
        let text = "ImageJ=1.53t\nimages=20\nchannels=2\nframes=10\nhyperstack=true\nunit=\\u00B5m\nfinterval=0.02\n";
        let metadata = parse(text, [Some(10.0), Some(5.0)]);
        assert_eq!((metadata.planes, metadata.channels), (Some(20), 2));
        assert_eq!(metadata.pixel_size_nm, Some([100.0, 200.0]));
        assert_eq!(metadata.frame_interval, Some(Duration::from_millis(20)));
    }
}
