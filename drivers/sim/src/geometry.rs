//! Plane geometry of shapes: curves, nearest points, distances.
//!
//! In: points `[y, x]` in pixels. Out: lengths, positions along a line, signed distances in pixels.
//! Never: allocates per distance. Fails: never; an empty line is infinitely far away.

/// Straight pieces from point to point; coordinates `[y, x]`.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Line {
    points: Vec<[f64; 2]>,
}

/// The nearest place on a line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Nearest {
    /// Distance in pixels, at least 0.
    pub(crate) distance: f64,
    /// Distance with the side of the line as its sign.
    pub(crate) signed: f64,
    /// Whether the nearest place is an end of the line, so the distance is not perpendicular to it.
    pub(crate) at_end: bool,
}

impl Line {
    pub(crate) fn new(points: Vec<[f64; 2]>) -> Self {
        Self { points }
    }

    /// A smooth curve through the points (Catmull-Rom), in 16 straight pieces from point to point.
    pub(crate) fn smooth(points: &[[f64; 2]]) -> Self {
        const PIECES: usize = 16;
        let Some(&last) = points.last() else {
            return Self::new(Vec::new());
        };
        let at = |index: isize| points[index.clamp(0, points.len() as isize - 1) as usize];
        let mut smooth = Vec::with_capacity(points.len() * PIECES);
        for index in 0..points.len() as isize - 1 {
            let around = [at(index - 1), at(index), at(index + 1), at(index + 2)];
            smooth.extend((0..PIECES).map(|k| catmull_rom(&around, k as f64 / PIECES as f64)));
        }
        smooth.push(last);
        Self::new(smooth)
    }

    /// A closed ellipse of 256 straight pieces.
    pub(crate) fn ellipse(center: [f64; 2], radius: [f64; 2]) -> Self {
        let point = |k: i32| {
            let angle = std::f64::consts::TAU * f64::from(k) / 256.0;
            [center[0] + radius[0] * libm::sin(angle), center[1] + radius[1] * libm::cos(angle)]
        };
        Self::new((0..=256).map(point).collect())
    }

    /// Length in pixels.
    pub(crate) fn length(&self) -> f64 {
        self.points.windows(2).map(|ends| between(ends[0], ends[1])).sum()
    }

    /// The place `along` pixels from the start, `aside` pixels to its side.
    pub(crate) fn place(&self, along: f64, aside: f64) -> [f64; 2] {
        let mut left = along;
        let mut pieces = self.points.windows(2).peekable();
        while let Some(ends) = pieces.next() {
            let length = between(ends[0], ends[1]);
            if (left <= length || pieces.peek().is_none()) && length > 0.0 {
                let unit = [(ends[1][0] - ends[0][0]) / length, (ends[1][1] - ends[0][1]) / length];
                return [
                    ends[0][0] + left * unit[0] - aside * unit[1],
                    ends[0][1] + left * unit[1] + aside * unit[0],
                ];
            }
            left -= length;
        }
        self.points.last().copied().unwrap_or([f64::NAN; 2])
    }

    /// The place on the line nearest to a point.
    pub(crate) fn nearest(&self, point: [f64; 2]) -> Nearest {
        let far = f64::INFINITY;
        let mut nearest = Nearest { distance: far, signed: far, at_end: true };
        let last = self.points.len().saturating_sub(2);
        for (index, ends) in self.points.windows(2).enumerate() {
            let (along, signed, distance) = to_segment(ends[0], ends[1], point);
            if distance < nearest.distance {
                let at_end = (index == 0 && along <= 0.0) || (index == last && along >= 1.0);
                nearest = Nearest { distance, signed: signed.signum() * distance, at_end };
            }
        }
        nearest
    }
}

/// Fraction along the segment (clipped to 0..=1), signed offset from its axis, distance.
fn to_segment(from: [f64; 2], to: [f64; 2], point: [f64; 2]) -> (f64, f64, f64) {
    let (dy, dx) = (to[0] - from[0], to[1] - from[1]);
    let (py, px) = (point[0] - from[0], point[1] - from[1]);
    let squared = dy * dy + dx * dx;
    if squared == 0.0 {
        let distance = between(from, point);
        return (0.0, distance, distance);
    }
    let along = ((py * dy + px * dx) / squared).clamp(0.0, 1.0);
    let foot = [from[0] + along * dy, from[1] + along * dx];
    ((along), (dy * px - dx * py) / squared.sqrt(), between(foot, point))
}

/// Distance between two points.
pub(crate) fn between(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

fn catmull_rom(p: &[[f64; 2]; 4], t: f64) -> [f64; 2] {
    std::array::from_fn(|axis| {
        let [a, b, c, d] = [p[0][axis], p[1][axis], p[2][axis], p[3][axis]];
        0.5 * (2.0 * b
            + (c - a) * t
            + (2.0 * a - 5.0 * b + 4.0 * c - d) * t * t
            + (3.0 * b - 3.0 * c + d - a) * t * t * t)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distance_is_perpendicular_beside_and_radial_beyond_the_ends() {
        let line = Line::new(vec![[0.0, 0.0], [0.0, 10.0]]);
        assert_eq!(line.nearest([3.0, 4.0]).distance, 3.0);
        assert_eq!(line.nearest([3.0, 4.0]).signed, -line.nearest([-3.0, 4.0]).signed);
        let beyond = line.nearest([3.0, 14.0]);
        assert_eq!((beyond.distance, beyond.at_end), (5.0, true));
        assert!(!line.nearest([3.0, 4.0]).at_end);
        assert_eq!(Line::new(Vec::new()).nearest([0.0, 0.0]).distance, f64::INFINITY);
    }

    #[test]
    fn places_lie_on_the_line_at_their_offset() {
        let line = Line::new(vec![[0.0, 0.0], [0.0, 10.0], [5.0, 10.0]]);
        assert_eq!(line.length(), 15.0);
        let place = line.place(12.0, 0.2);
        assert!((line.nearest(place).distance - 0.2).abs() < 1e-12, "{place:?}");
        assert!((place[0] - 2.0).abs() < 1e-12);
    }

    #[test]
    fn curves_pass_through_their_points_and_ellipses_have_their_perimeter() {
        let points = [[0.0, 0.0], [3.0, 8.0], [-2.0, 20.0]];
        let curve = Line::smooth(&points);
        assert!(points.iter().all(|&point| curve.nearest(point).distance < 1e-12));
        let circle = Line::ellipse([5.0, 5.0], [10.0, 10.0]);
        assert!((circle.length() / (20.0 * std::f64::consts::PI) - 1.0).abs() < 1e-3);
    }
}
