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
