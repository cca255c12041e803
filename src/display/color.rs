//! The colors that carry a meaning everywhere in the program.
//!
//! In: a number of channels. Out: one color for each.
//! Never: depends on data. Fails: never.

/// One 8-bit color: red, green, blue.
pub type Rgb = [u8; 3];

/// Color of a pixel that could not be computed (NaN): dark green.
///
/// No colormap holds it, and it stays far from all of them, so a hole cannot pass for a value.
pub const NAN_COLOR: Rgb = [0, 104, 28];

/// Color of a pixel whose *raw counts* reached the top of the camera's range: red.
pub const SATURATED_COLOR: Rgb = [255, 0, 0];

/// First species color of the paper (Figure S4 d).
pub const CYAN: Rgb = [0, 255, 255];
/// Second species color of the paper (Figure S4 e).
pub const YELLOW: Rgb = [255, 255, 0];
/// Third species color of the paper (Figure S4 f), and the transmission channel in overlays.
pub const MAGENTA: Rgb = [255, 0, 255];
/// The reflection channel in overlays: green and magenta add up to white for every kind of color vision.
pub const GREEN: Rgb = [0, 255, 0];
/// A single channel.
pub const WHITE: Rgb = [255, 255, 255];

const MORE: [Rgb; 6] = [CYAN, YELLOW, MAGENTA, GREEN, [255, 128, 0], [96, 128, 255]];

/// Colors for `num_channels` channels shown together.
///
/// One: white. Two: green and magenta. Three: cyan, yellow, magenta as in the paper's Figure S4.
/// More: green, orange and blue follow, then the list starts again.
#[must_use]
pub fn default_colors(num_channels: usize) -> Vec<Rgb> {
    match num_channels {
        1 => vec![WHITE],
        2 => vec![GREEN, MAGENTA],
        _ => MORE.iter().copied().cycle().take(num_channels).collect(),
    }
}

/// The color as `#rrggbb`.
#[must_use]
pub fn hex([red, green, blue]: Rgb) -> String {
    format!("#{red:02x}{green:02x}{blue:02x}")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Lightness and two colors (CIELAB, D65) of a color as people see it who have no cones of one kind
    /// (G. M. Machado et al., IEEE Trans. Vis. Comput. Graph. 15, 1291 (2009), severity 1), rows of red, green, blue.
    fn seen(color: Rgb, missing: [[f64; 3]; 3]) -> [f64; 3] {
        let linear = color.map(|level| {
            let level = f64::from(level) / 255.0;
            if level <= 0.04045 { level / 12.92 } else { libm::pow((level + 0.055) / 1.055, 2.4) }
        });
        let times = |rows: [[f64; 3]; 3], column: [f64; 3]| {
            rows.map(|row| row.iter().zip(column).map(|(a, b)| a * b).sum::<f64>())
        };
        let xyz = [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]];
        let seen = times(missing, linear).map(|level| level.clamp(0.0, 1.0));
        let [x, y, z] = times(xyz, seen);
        let [x, y, z] = [x / 0.9505, y, z / 1.089]
            .map(|share| if share > 0.008_856 { libm::cbrt(share) } else { 7.787 * share + 16.0 / 116.0 });
        [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
    }

    #[test]
    fn default_colors_are_told_apart_by_the_color_blind() {
        let protanopia = [
            [0.152_286, 1.052_583, -0.204_868],
            [0.114_503, 0.786_281, 0.099_216],
            [-0.003_882, -0.048_116, 1.051_998],
        ];
        let deuteranopia = [
            [0.367_322, 0.860_646, -0.227_968],
            [0.280_085, 0.672_501, 0.047_413],
            [-0.011_820, 0.042_940, 0.968_881],
        ];
        let tritanopia = [
            [1.255_528, -0.076_749, -0.178_779],
            [-0.078_411, 0.930_809, 0.147_602],
            [0.004_733, 0.691_367, 0.303_900],
        ];
        for missing in [protanopia, deuteranopia, tritanopia] {
            for channels in [2, 3] {
                let colors: Vec<_> =
                    default_colors(channels).into_iter().map(|color| seen(color, missing)).collect();
                for (i, a) in colors.iter().enumerate() {
                    for b in &colors[..i] {
                        let apart = a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum::<f64>().sqrt();
                        // A just noticeable difference is about 2.3.
                        assert!(apart > 25.0, "{channels} colors: {a:?} and {b:?} are {apart:.0} apart");
                    }
                }
            }
        }
    }

    #[test]
    fn three_species_get_the_colors_of_the_paper() {
        assert_eq!(default_colors(3), [CYAN, YELLOW, MAGENTA]);
        assert_eq!(default_colors(0), Vec::<Rgb>::new());
        assert_eq!(default_colors(7).len(), 7);
    }

    #[test]
    fn hexadecimal() {
        assert_eq!(hex([0, 255, 16]), "#00ff10");
    }
}
