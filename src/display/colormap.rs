//! Colormaps: 256 colors each, computed once from published control points.
//!
//! In: a name, or a fraction between 0 and 1. Out: a color.
//! Never: shows NaN as a value (see [`NAN_COLOR`]). Fails: [`DisplayError::UnknownColormap`].
//!
//! Sources:
//! - morgenstemning, isolum, ametrine: control points published with M. Geissbuehler and T. Lasser,
//!   "How to display data by color schemes compatible with red-green color perception deficiencies",
//!   Optics Express 21, 9862 (2013). Gray value there: `(mean of channel^1.8)^(1/1.8)`.
//! - viridis: S. van der Walt and N. Smith (2015), CC0.
//! - cyan, yellow, magenta hot: black, color, white; the color sits at its own lightness.

use std::sync::LazyLock;

use serde::{Deserialize, Serialize};

use super::color::{CYAN, MAGENTA, NAN_COLOR, Rgb, YELLOW};
use super::error::DisplayError;
use super::viridis::VIRIDIS;

/// The 256 colors of one map, lowest value first.
pub type Table = [Rgb; 256];

/// Display gamma of Geissbuehler and Lasser.
const GAMMA: f64 = 1.8;

/// A colormap by name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Colormap {
    /// Black to white, all channels equal.
    Gray,
    /// Perceptually uniform, dark violet to yellow.
    Viridis,
    /// Black over blue, red and yellow to white; the gray value grows linearly.
    Morgenstemning,
    /// Constant gray value, blue to yellow; for maps shown with a brightness of their own.
    Isolum,
    /// Nearly constant gray value with more color contrast than isolum.
    Ametrine,
    /// Black, cyan, white.
    CyanHot,
    /// Black, yellow, white.
    YellowHot,
    /// Black, magenta, white.
    MagentaHot,
}

impl Colormap {
    /// All maps, in the order menus show them.
    pub const ALL: [Self; 8] = [
        Self::Gray,
        Self::Viridis,
        Self::Morgenstemning,
        Self::Isolum,
        Self::Ametrine,
        Self::CyanHot,
        Self::YellowHot,
        Self::MagentaHot,
    ];

    /// The name used in files and commands.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Gray => "gray",
            Self::Viridis => "viridis",
            Self::Morgenstemning => "morgenstemning",
            Self::Isolum => "isolum",
            Self::Ametrine => "ametrine",
            Self::CyanHot => "cyan-hot",
            Self::YellowHot => "yellow-hot",
            Self::MagentaHot => "magenta-hot",
        }
    }

    /// Finds a map by name; case does not matter, and space or underscore may stand for the hyphen.
    ///
    /// # Errors
    /// [`DisplayError::UnknownColormap`], which lists all names.
    pub fn by_name(name: &str) -> Result<Self, DisplayError> {
        let wanted = name.trim().to_lowercase().replace([' ', '_'], "-");
        let found = Self::ALL.into_iter().find(|map| map.name() == wanted);
        found.ok_or_else(|| DisplayError::UnknownColormap {
            name: name.to_owned(),
            known: Self::ALL.map(Self::name).join(", "),
        })
    }

    /// The hot map of species number `index` (0-based): cyan, yellow, magenta in turn, as in the paper's Figure S4.
    #[must_use]
    pub fn of_species(index: usize) -> Self {
        [Self::CyanHot, Self::YellowHot, Self::MagentaHot][index % 3]
    }

    /// The 256 colors.
    #[must_use]
    pub fn table(self) -> &'static Table {
        static TABLES: LazyLock<[Table; 8]> = LazyLock::new(|| Colormap::ALL.map(build));
        &TABLES[self as usize]
    }

    /// The color of a value's place between the contrast limits: 0 is the lowest entry, 1 the highest.
    /// Values outside are clipped; NaN gives [`NAN_COLOR`].
    #[must_use]
    pub fn color(self, fraction: f64) -> Rgb {
        color_in(self.table(), fraction)
    }
}

/// As [`Colormap::color`], with the table at hand.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clipped to 0..=255 first")]
pub(super) fn color_in(table: &Table, fraction: f64) -> Rgb {
    if fraction.is_nan() {
        return NAN_COLOR;
    }
    table[(fraction.clamp(0.0, 1.0) * 255.0).round() as usize]
}

fn build(map: Colormap) -> Table {
    match map {
        Colormap::Gray => sample(|t| [t; 3]),
        Colormap::Viridis => VIRIDIS.map(|rgb| {
            let [_, red, green, blue] = rgb.to_be_bytes();
            [red, green, blue]
        }),
        Colormap::Morgenstemning => morgenstemning(),
        Colormap::Isolum => isolum(),
        Colormap::Ametrine => ametrine(),
        // The lightness of the color on a scale of 0 to 1 (CIE L* of cyan 0.91, yellow 0.97, magenta 0.60),
        // kept below 0.85 so that some of the table remains for white.
        Colormap::CyanHot => hot(CYAN, 0.82),
        Colormap::YellowHot => hot(YELLOW, 0.85),
        Colormap::MagentaHot => hot(MAGENTA, 0.6),
    }
}

/// Interpolates along the control points in linear light, at the place where the gray value is `t`.
fn morgenstemning() -> Table {
    let points = [[0, 0, 0], [25, 53, 95], [192, 27, 111], [252, 229, 0], [255, 255, 255]];
    let linear = points.map(to_linear);
    let places = linear.map(mean);
    sample(|t| from_linear(piecewise(&places, &linear, t.powf(GAMMA))))
}

/// Scales the control points to one gray value and interpolates in linear light, which keeps it.
fn isolum() -> Table {
    let points = [[90, 190, 245], [157, 157, 200], [220, 150, 130], [245, 120, 80], [180, 180, 0]];
    let linear = points.map(to_linear);
    let grays = linear.map(|color| mean(color).powf(1.0 / GAMMA));
    let common = (grays.iter().sum::<f64>() / 5.0).powf(GAMMA);
    let equal = linear.map(|color| color.map(|channel| channel * common / mean(color)));
    let places = [1.0, 16.0, 32.0, 43.0, 64.0].map(|index| (index - 1.0) / 63.0);
    sample(|t| from_linear(piecewise(&places, &equal, t)))
}

fn ametrine() -> Table {
    let points = [[30, 60, 150], [180, 90, 155], [230, 85, 65], [220, 220, 0]];
    let places = [0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0];
    sample(|t| piecewise(&places, &points.map(to_unit), t))
}

fn hot(color: Rgb, place: f64) -> Table {
    let points = [[0.0; 3], to_unit(color), [1.0; 3]];
    sample(|t| piecewise(&[0.0, place, 1.0], &points, t))
}

fn sample(color_at: impl Fn(f64) -> [f64; 3]) -> Table {
    std::array::from_fn(|index| color_at(index as f64 / 255.0).map(to_byte))
}

/// Linear interpolation between `points` at growing `places`.
fn piecewise(places: &[f64], points: &[[f64; 3]], t: f64) -> [f64; 3] {
    let last = places.len() - 1;
    let right = places.partition_point(|&place| place < t).clamp(1, last);
    let (low, high) = (places[right - 1], places[right]);
    let share = ((t - low) / (high - low)).clamp(0.0, 1.0);
    std::array::from_fn(|c| points[right - 1][c] * (1.0 - share) + points[right][c] * share)
}

fn to_unit(color: Rgb) -> [f64; 3] {
    color.map(|channel| f64::from(channel) / 255.0)
}

fn to_linear(color: Rgb) -> [f64; 3] {
    to_unit(color).map(|channel| channel.powf(GAMMA))
}

fn from_linear(color: [f64; 3]) -> [f64; 3] {
    color.map(|channel| channel.powf(1.0 / GAMMA))
}

fn mean(color: [f64; 3]) -> f64 {
    color.iter().sum::<f64>() / 3.0
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clipped to 0..=255 first")]
fn to_byte(channel: f64) -> u8 {
    (channel.clamp(0.0, 1.0) * 255.0).round() as u8
}

#[cfg(test)]
mod tests {
    use super::super::color::SATURATED_COLOR;
    use super::*;

    /// CIE L* of an sRGB color, 0 to 100.
    fn lightness(color: Rgb) -> f64 {
        let linear =
            to_unit(color).map(|c| if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) });
        let y = 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2];
        if y > 0.008_856 { 116.0 * y.cbrt() - 16.0 } else { 903.3 * y }
    }

    fn gray_value(color: Rgb) -> f64 {
        mean(to_linear(color)).powf(1.0 / GAMMA)
    }

    #[test]
    fn names_lead_back_to_their_map() {
        for map in Colormap::ALL {
            assert_eq!(Colormap::by_name(map.name()).unwrap(), map);
            assert_eq!(serde_json::to_value(map).unwrap(), map.name());
        }
        assert_eq!(Colormap::by_name("Cyan Hot").unwrap(), Colormap::CyanHot);
        let message = Colormap::by_name("jet").unwrap_err().to_string();
        assert!(message.contains("jet") && message.contains("viridis"));
    }

    #[test]
    fn endpoints() {
        let ends = |map: Colormap| (map.color(0.0), map.color(1.0));
        let black_to_white = ([0, 0, 0], [255, 255, 255]);
        assert_eq!(ends(Colormap::Gray), black_to_white);
        assert_eq!(ends(Colormap::Morgenstemning), black_to_white);
        assert_eq!(ends(Colormap::CyanHot), black_to_white);
        assert_eq!(ends(Colormap::YellowHot), black_to_white);
        assert_eq!(ends(Colormap::MagentaHot), black_to_white);
        assert_eq!(ends(Colormap::Viridis), ([0x44, 1, 0x54], [0xFD, 0xE7, 0x25]));
        assert_eq!(ends(Colormap::Ametrine), ([30, 60, 150], [220, 220, 0]));
        assert_eq!(Colormap::Gray.color(-3.0), [0, 0, 0]);
        assert_eq!(Colormap::Gray.color(f64::INFINITY), [255; 3]);
    }

    #[test]
    fn lightness_grows_where_promised() {
        use Colormap::{CyanHot, Gray, MagentaHot, Morgenstemning, Viridis, YellowHot};
        for map in [Gray, Viridis, Morgenstemning, CyanHot, YellowHot, MagentaHot] {
            for pair in map.table().windows(2) {
                assert!(lightness(pair[1]) >= lightness(pair[0]) - 0.25, "{map:?} {pair:?}");
            }
            assert!(lightness(map.color(0.75)) > lightness(map.color(0.25)) + 20.0);
        }
    }

    #[test]
    fn morgenstemning_has_a_linear_gray_value_and_passes_its_control_points() {
        for (index, &color) in Colormap::Morgenstemning.table().iter().enumerate() {
            assert!((gray_value(color) - index as f64 / 255.0).abs() < 0.005, "{index}");
        }
        let red = Colormap::Morgenstemning.color(gray_value([192, 27, 111]));
        assert!(red.iter().zip([192, 27, 111]).all(|(&a, b)| a.abs_diff(b) < 4), "{red:?}");
    }

    #[test]
    fn isolum_keeps_its_gray_value() {
        let first = gray_value(Colormap::Isolum.color(0.0));
        assert!(Colormap::Isolum.table().iter().all(|&c| (gray_value(c) - first).abs() < 0.01));
    }

    #[test]
    fn nan_and_saturation_are_no_entry_of_any_map() {
        for map in Colormap::ALL {
            assert_eq!(map.color(f64::NAN), NAN_COLOR);
            for entry in map.table() {
                let distance =
                    |a: Rgb| a.iter().zip(entry).map(|(&a, &b)| i32::from(a.abs_diff(b)).pow(2)).sum::<i32>();
                assert!(distance(NAN_COLOR) > 40 * 40, "{map:?} {entry:?}");
                assert!(distance(SATURATED_COLOR) > 40 * 40, "{map:?} {entry:?}");
            }
        }
    }
}
