//! Where camera R sees what camera T sees: a mirror, then an affine map.
//!
//! In: points `[y, x]` in pixels of T. Out: points `[y, x]` in pixels of R, and back.
//! Never: guesses a mirror. Fails: [`TransformError`] for a map that cannot be undone.

/// How camera T is flipped before the affine map.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Mirror {
    /// Not at all.
    #[default]
    None,
    /// Left becomes right: `x -> width - 1 - x`.
    Horizontal,
    /// Top becomes bottom: `y -> height - 1 - y`.
    Vertical,
    /// Both, which is half a turn.
    Both,
}

impl Mirror {
    /// Every mirror with the name it has in files.
    pub const NAMES: [(&'static str, Self); 4] = [
        ("none", Self::None),
        ("horizontal", Self::Horizontal),
        ("vertical", Self::Vertical),
        ("both", Self::Both),
    ];

    /// The name in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        Self::NAMES.iter().find(|(_, mirror)| *mirror == self).map_or("none", |(name, _)| name)
    }

    /// Whether rows change their order, and whether columns do.
    #[must_use]
    pub fn flips(self) -> [bool; 2] {
        match self {
            Self::None => [false, false],
            Self::Horizontal => [false, true],
            Self::Vertical => [true, false],
            Self::Both => [true, true],
        }
    }

    /// The point in an image of `[height, width]` pixels that was flipped; the same back again.
    #[must_use]
    pub fn apply(self, point: [f64; 2], size: [usize; 2]) -> [f64; 2] {
        let flips = self.flips();
        std::array::from_fn(
            |axis| {
                if flips[axis] { size[axis] as f64 - 1.0 - point[axis] } else { point[axis] }
            },
        )
    }
}

/// `p = matrix * q + shift`, both `[y, x]`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Affine {
    /// Rows for y and x, columns for y and x.
    pub matrix: [[f64; 2]; 2],
    /// Pixels.
    pub shift: [f64; 2],
}

impl Affine {
    /// Every point stays where it is.
    pub const IDENTITY: Self = Self { matrix: [[1.0, 0.0], [0.0, 1.0]], shift: [0.0, 0.0] };

    /// Where a point goes.
    #[must_use]
    pub fn apply(&self, point: [f64; 2]) -> [f64; 2] {
        std::array::from_fn(|axis| {
            let [to_y, to_x] = self.matrix[axis];
            to_y * point[0] + to_x * point[1] + self.shift[axis]
        })
    }

    /// The way back; `None` for a map that makes all points lie on a line.
    #[must_use]
    pub fn inverse(&self) -> Option<Self> {
        let [[a, b], [c, d]] = self.matrix;
        let determinant = a * d - b * c;
        if !(determinant.is_finite() && determinant.abs() > 1e-9) {
            return None;
        }
        let matrix = [[d, -b], [-c, a]].map(|row| row.map(|entry| entry / determinant));
        let moved = Self { matrix, shift: [0.0; 2] }.apply(self.shift);
        Some(Self { matrix, shift: moved.map(|entry| -entry) })
    }
}

/// Why a map cannot be used.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum TransformError {
    /// All points would fall onto a line.
    #[error("the registration maps the camera onto a line; calibrate it again")]
    Singular,
    /// More than the resampling of rows can follow.
    #[error(
        "the registration turns camera T by {rotation_deg:.1} degrees and stretches it by {stretch_percent:.1} %; \
         at most about 3 degrees and 5 % can be undone, so turn the camera and calibrate again"
    )]
    TooFar {
        /// Rotation after the mirror, degrees.
        rotation_deg: f64,
        /// The larger stretch of both axes, percent.
        stretch_percent: f64,
    },
    /// The map was made for images of another size.
    #[error(
        "the registration is for regions of {} x {} pixels and the frames have {} x {}; \
         use the regions of the calibration or calibrate again", made_for[1], made_for[0], frames[1], frames[0]
    )]
    Size {
        /// Height and width of the calibration.
        made_for: [usize; 2],
        /// Height and width of the frames.
        frames: [usize; 2],
    },
}

/// Where camera R sees a point of camera T: the mirror about the middle of T's region, then the affine map.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReflectedFromTransmitted {
    /// The flip of T.
    pub mirror: Mirror,
    /// From flipped T to R.
    pub affine: Affine,
    /// Height and width of both regions, pixels.
    pub size: [usize; 2],
}

impl ReflectedFromTransmitted {
    /// Both cameras see the same.
    #[must_use]
    pub fn identity(size: [usize; 2]) -> Self {
        Self { mirror: Mirror::None, affine: Affine::IDENTITY, size }
    }

    /// Where R sees a point of T.
    #[must_use]
    pub fn apply(&self, in_transmitted: [f64; 2]) -> [f64; 2] {
        self.affine.apply(self.mirror.apply(in_transmitted, self.size))
    }

    /// Where T sees a point of R; `None` for a map that cannot be undone.
    #[must_use]
    pub fn undo(&self, in_reflected: [f64; 2]) -> Option<[f64; 2]> {
        Some(self.mirror.apply(self.affine.inverse()?.apply(in_reflected), self.size))
    }

    /// The same map between parts of both regions that begin at `[y, x]` of R and of T and have this height and width.
    #[must_use]
    pub fn cropped(&self, [in_reflected, in_transmitted]: [[usize; 2]; 2], size: [usize; 2]) -> Self {
        let flips = self.mirror.flips();
        // A point q of the flipped part is the point q + moved of the flipped region.
        let moved: [f64; 2] = std::array::from_fn(|axis| {
            let beyond = self.size[axis].saturating_sub(in_transmitted[axis] + size[axis]);
            if flips[axis] { beyond as f64 } else { in_transmitted[axis] as f64 }
        });
        let at = self.affine.apply(moved);
        let shift = std::array::from_fn(|axis| at[axis] - in_reflected[axis] as f64);
        Self { affine: Affine { shift, ..self.affine }, size, ..*self }
    }

    /// Rotation after the mirror in degrees, positive from the x axis towards the y axis.
    #[must_use]
    pub fn rotation_deg(&self) -> f64 {
        let [[yy, yx], [xy, xx]] = self.affine.matrix;
        libm::atan2(yx - xy, yy + xx).to_degrees()
    }

    /// Magnification of R over T, the mean of both axes.
    #[must_use]
    pub fn scale(&self) -> f64 {
        let [[yy, yx], [xy, xx]] = self.affine.matrix;
        (yy * xx - yx * xy).abs().sqrt()
    }

    /// How far the middle of T's region lies from the middle of R's, `[y, x]` in pixels of R.
    #[must_use]
    pub fn central_shift(&self) -> [f64; 2] {
        let center = self.size.map(|side| (side as f64 - 1.0) / 2.0);
        let moved = self.apply(center);
        std::array::from_fn(|axis| moved[axis] - center[axis])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn any_map() -> impl Strategy<Value = ReflectedFromTransmitted> {
        let numbers = (-0.03..0.03, 0.97..1.03, -40.0..40.0, -40.0..40.0);
        (numbers, 0..4usize).prop_map(|((turn, scale, y, x), mirror)| ReflectedFromTransmitted {
            mirror: Mirror::NAMES[mirror].1,
            affine: Affine { matrix: [[scale, turn], [-turn, scale]], shift: [y, x] },
            size: [48, 64],
        })
    }

    proptest! {
        #[test]
        fn undoing_leads_back(map in any_map(), y in -10.0..60.0, x in -10.0..70.0) {
            let back = map.undo(map.apply([y, x])).unwrap();
            prop_assert!((back[0] - y).abs() < 1e-9 && (back[1] - x).abs() < 1e-9);
        }

        #[test]
        fn a_part_is_mapped_like_the_whole(map in any_map(), y in 0.0..20.0, x in 0.0..20.0) {
            let in_part = map.cropped([[8, 12], [5, 9]], [24, 30]).apply([y, x]);
            let in_whole = map.apply([y + 5.0, x + 9.0]);
            prop_assert!((in_part[0] + 8.0 - in_whole[0]).abs() < 1e-9);
            prop_assert!((in_part[1] + 12.0 - in_whole[1]).abs() < 1e-9);
        }
    }
}
