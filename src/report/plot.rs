//! Line plots as SVG, for pages and for files.
//!
//! In: series of points and two axes with quantity and unit. Out: one `<svg>` element.
//! Never: refers to anything outside; distinguishes series by color alone (dashes differ too).
//! Fails: never; points that are not finite break the line.
//!
//! Colors: Okabe and Ito, "Color Universal Design" (2008). A page may replace them through the CSS
//! variables `--series-0` to `--series-5`, e.g. for a dark background.

use super::text::{escape, superscript};
use super::ticks::{self, Scale};

/// Width of a plot, SVG units.
pub(super) const WIDTH: f64 = 720.0;
const PLOT_HEIGHT: f64 = 230.0;
const LEFT: f64 = 68.0;
const RIGHT: f64 = 18.0;
const BELOW: f64 = 50.0;
const LEGEND_LINE: f64 = 20.0;
/// Mean width of a letter at the font size used, to place legend entries.
const LETTER: f64 = 6.6;

const COLORS: [&str; 6] = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9"];
const DASHES: [&str; 6] = ["", "7 3", "2 3", "9 3 2 3", "4 2", "12 3"];

/// One axis: what is on it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Axis {
    /// Quantity, e.g. `time`.
    pub quantity: String,
    /// Unit, e.g. `s`; empty for plain numbers.
    pub unit: String,
    /// Which values it spans.
    pub range: AxisRange,
}

/// Which values an axis spans.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum AxisRange {
    /// From the least to the greatest value.
    #[default]
    Fit,
    /// As `Fit`, with zero included.
    FromZero,
    /// From `low` to `high`; lines are clipped there.
    Fixed {
        /// Start.
        low: f64,
        /// End.
        high: f64,
    },
}

impl Axis {
    /// An axis that fits the data.
    #[must_use]
    pub fn new(quantity: &str, unit: &str) -> Self {
        Self { quantity: quantity.to_owned(), unit: unit.to_owned(), range: AxisRange::Fit }
    }

    /// The same axis with another range.
    #[must_use]
    pub fn with_range(self, range: AxisRange) -> Self {
        Self { range, ..self }
    }

    fn label(&self, exponent: i32) -> String {
        let power = if exponent == 0 { String::new() } else { format!("10{}", superscript(exponent)) };
        let unit = [power, self.unit.clone()].join(" ");
        match unit.trim() {
            "" => escape(&self.quantity),
            unit => escape(&format!("{} ({unit})", self.quantity)),
        }
    }

    /// `exact` ends for the horizontal axis; the vertical one ends on ticks.
    fn scale(&self, values: impl Iterator<Item = f64>, choose: fn(f64, f64) -> Scale) -> Scale {
        let finite = values.filter(|value| value.is_finite());
        let (low, high) = finite.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        match self.range {
            AxisRange::Fit => choose(low, high),
            AxisRange::FromZero => choose(low.min(0.0), high.max(0.0)),
            AxisRange::Fixed { low, high } => ticks::exact(low.min(high), low.max(high)),
        }
    }
}

/// One line.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Series {
    /// Its name in the legend.
    pub label: String,
    /// Points `(x, y)` in the order they are joined.
    pub points: Vec<(f64, f64)>,
}

/// Lines over two axes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LinePlot {
    /// What is shown, for readers who cannot see it.
    pub title: String,
    /// Horizontal axis.
    pub x: Axis,
    /// Vertical axis.
    pub y: Axis,
    /// The lines.
    pub series: Vec<Series>,
}

impl LinePlot {
    /// The plot as one `<svg>` element, which is also a valid SVG file.
    #[must_use]
    pub fn to_svg(&self) -> String {
        let (content, height) = self.content();
        format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {height}\" role=\"img\" \
             font-family=\"system-ui, sans-serif\" font-size=\"12\" fill=\"currentColor\">\n{content}</svg>\n"
        )
    }

    /// What stands inside the `<svg>`, and its height.
    pub(super) fn content(&self) -> (String, f64) {
        let points = || self.series.iter().flat_map(|series| series.points.iter());
        let x = self.x.scale(points().map(|point| point.0), ticks::exact);
        let y = self.y.scale(points().map(|point| point.1), ticks::outward);
        let (legend, lines) = self.legend();
        let frame = Frame { x, y, top: 10.0 + LEGEND_LINE * lines };
        let curves: String = (0..self.series.len()).map(|index| self.curve(index, &frame)).collect();
        let (title, grid) = (escape(&self.title), frame.grid());
        let labels = frame.labels(&self.x, &self.y);
        (format!("<title>{title}</title>\n{legend}{grid}{labels}{curves}"), frame.bottom() + BELOW)
    }

    /// Legend entries from left to right, and the number of lines they take.
    fn legend(&self) -> (String, f64) {
        let (mut left, mut line, mut entries) = (LEFT, 0.0, String::new());
        for (index, series) in self.series.iter().enumerate() {
            let width = 44.0 + LETTER * series.label.chars().count() as f64;
            if left > LEFT && left + width > WIDTH {
                (left, line) = (LEFT, line + 1.0);
            }
            let (y, end) = (12.0 + LEGEND_LINE * line, left + 26.0);
            let style = stroke(index);
            let (text_left, text_y, label) = (left + 32.0, y + 4.0, escape(&series.label));
            entries += &format!(
                "<path d=\"M{left:.1} {y}H{end:.1}\" {style}/><text x=\"{text_left:.1}\" y=\"{text_y}\">{label}</text>\n"
            );
            left += width;
        }
        (entries, line + 1.0)
    }

    fn curve(&self, index: usize, frame: &Frame) -> String {
        let mut path = String::new();
        let mut pen_down = false;
        for &(x, y) in &self.series[index].points {
            let (px, py) = (frame.x_px(x), frame.y_px(y));
            if px.is_finite() && py.is_finite() {
                path += &format!("{}{px:.1} {py:.1}", if pen_down { 'L' } else { 'M' });
            }
            pen_down = px.is_finite() && py.is_finite();
        }
        let style = stroke(index);
        if path.is_empty() { path } else { format!("<path d=\"{path}\" {style}/>\n") }
    }
}

/// Where the axes are, in SVG units.
struct Frame {
    x: Scale,
    y: Scale,
    top: f64,
}

impl Frame {
    fn bottom(&self) -> f64 {
        self.top + PLOT_HEIGHT
    }

    fn x_px(&self, value: f64) -> f64 {
        LEFT + self.x.place(value).clamp(0.0, 1.0) * (WIDTH - LEFT - RIGHT)
    }

    fn y_px(&self, value: f64) -> f64 {
        self.bottom() - self.y.place(value).clamp(0.0, 1.0) * PLOT_HEIGHT
    }

    fn grid(&self) -> String {
        let (bottom, right) = (self.bottom(), WIDTH - RIGHT);
        let mut lines = String::new();
        for (value, label) in &self.y.ticks {
            let (y, text_y, text_x) = (self.y_px(*value), self.y_px(*value) + 4.0, LEFT - 8.0);
            lines += &format!(
                "<path d=\"M{LEFT} {y:.1}H{right}\" stroke=\"currentColor\" stroke-opacity=\"0.14\"/>\
                 <text x=\"{text_x}\" y=\"{text_y:.1}\" text-anchor=\"end\">{label}</text>\n"
            );
        }
        for (value, label) in &self.x.ticks {
            let (x, tick, text_y) = (self.x_px(*value), bottom + 5.0, bottom + 19.0);
            lines += &format!(
                "<path d=\"M{x:.1} {bottom}V{tick}\" stroke=\"currentColor\"/>\
                 <text x=\"{x:.1}\" y=\"{text_y}\" text-anchor=\"middle\">{label}</text>\n"
            );
        }
        let top = self.top;
        lines
            + &format!("<path d=\"M{LEFT} {top}V{bottom}H{right}\" fill=\"none\" stroke=\"currentColor\"/>\n")
    }

    fn labels(&self, x: &Axis, y: &Axis) -> String {
        let (center, below) = ((LEFT + WIDTH - RIGHT) / 2.0, self.bottom() + 42.0);
        let middle = self.top + PLOT_HEIGHT / 2.0;
        let (x_label, y_label) = (x.label(self.x.exponent), y.label(self.y.exponent));
        format!(
            "<text x=\"{center}\" y=\"{below}\" text-anchor=\"middle\" font-size=\"13\">{x_label}</text>\n\
             <text transform=\"translate(15 {middle}) rotate(-90)\" text-anchor=\"middle\" font-size=\"13\">{y_label}</text>\n"
        )
    }
}

fn stroke(index: usize) -> String {
    let (index, color) = (index % COLORS.len(), COLORS[index % COLORS.len()]);
    let (dash, style) = (DASHES[index], page_style(index));
    let dashes = if dash.is_empty() { String::new() } else { format!(" stroke-dasharray=\"{dash}\"") };
    format!("fill=\"none\" stroke=\"{color}\" {style}stroke-width=\"2\"{dashes}")
}

/// Lets a page replace the color of a series.
fn page_style(index: usize) -> String {
    format!("style=\"stroke: var(--series-{index}, {})\" ", COLORS[index])
}

/// The same without what only pages use: many programs that draw files draw no line in the color of a variable.
pub(super) fn for_files(svg: String) -> String {
    (0..COLORS.len()).fold(svg, |svg, index| svg.replace(&page_style(index), ""))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plot() -> LinePlot {
        let points = (0..50).map(|i| (f64::from(i), 1e6 * (-f64::from(i) / 20.0).exp())).collect();
        LinePlot {
            title: "Bleaching <of> R".to_owned(),
            x: Axis::new("time", "s"),
            y: Axis::new("mean", "counts").with_range(AxisRange::FromZero),
            series: vec![
                Series { label: "R & T".to_owned(), points },
                Series { label: "gap".to_owned(), points: vec![(0.0, 1.0), (1.0, f64::NAN), (2.0, 3.0)] },
            ],
        }
    }

    #[test]
    fn svg_is_well_formed_and_says_its_units() {
        let svg = plot().to_svg();
        let document = roxmltree::Document::parse(&svg).unwrap();
        let texts: Vec<_> = document.descendants().filter_map(|node| node.text()).collect();
        for wanted in ["Bleaching <of> R", "time (s)", "mean (10⁶ counts)", "R & T"] {
            assert!(texts.contains(&wanted), "{wanted}: {texts:?}");
        }
    }

    #[test]
    fn a_missing_point_breaks_the_line() {
        let frame = Frame { x: ticks::exact(0.0, 2.0), y: ticks::exact(0.0, 4.0), top: 0.0 };
        let curve = plot().curve(1, &frame);
        assert_eq!((curve.matches('M').count(), curve.matches('L').count()), (2, 0));
    }

    #[test]
    fn nothing_to_plot_is_still_a_plot() {
        for series in
            [vec![], vec![Series::default()], vec![Series { points: vec![(1.0, 1.0)], ..Series::default() }]]
        {
            let svg = LinePlot { series, ..LinePlot::default() }.to_svg();
            assert!(roxmltree::Document::parse(&svg).is_ok() && !svg.contains("NaN"));
        }
    }
}
