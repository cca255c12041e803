//! Several plots below each other in one SVG file.
//!
//! In: plots. Out: one `<svg>` element on white, for files. Never: refers to anything outside.
//! Fails: never; no plots make an empty picture.

use super::plot::{LinePlot, WIDTH, for_files};
use super::text::escape;

/// The plots below each other, each with its title for readers who cannot see it.
#[must_use]
pub fn stacked(title: &str, plots: &[LinePlot]) -> String {
    let (mut top, mut panels) = (0.0, String::new());
    for plot in plots {
        let (content, height) = plot.content();
        let content = for_files(content);
        panels += &format!("<g transform=\"translate(0 {top})\">\n{content}</g>\n");
        top += height;
    }
    let title = escape(title);
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {top}\" width=\"{WIDTH}\" height=\"{top}\" \
         role=\"img\" font-family=\"system-ui, sans-serif\" font-size=\"12\" color=\"#222222\" fill=\"#222222\">\n\
         <title>{title}</title>\n<rect width=\"100%\" height=\"100%\" fill=\"#ffffff\"/>\n{panels}</svg>\n"
    )
}

#[cfg(test)]
mod tests {
    use super::super::plot::{Axis, Series};
    use super::*;

    #[test]
    fn plots_stand_below_each_other_in_one_document() {
        let plot = |label: &str| LinePlot {
            title: format!("plot <{label}>"),
            x: Axis::new("wavelength", "nm"),
            y: Axis::new("value", ""),
            series: vec![Series { label: label.to_owned(), points: vec![(0.0, 1.0), (1.0, 2.0)] }],
        };
        let svg = stacked("both & more", &[plot("a"), plot("b")]);
        let document = roxmltree::Document::parse(&svg).unwrap();
        let places: Vec<_> = document.descendants().filter_map(|node| node.attribute("transform")).collect();
        assert!(
            places.contains(&"translate(0 0)") && places.iter().any(|place| place.contains("translate(0 3"))
        );
        let texts: Vec<_> = document.descendants().filter_map(|node| node.text()).collect();
        assert!(!svg.contains("var(") && svg.contains("stroke=\"#0072b2\""));
        assert!(["both & more", "plot <a>", "plot <b>"].iter().all(|text| texts.contains(text)));
        assert!(roxmltree::Document::parse(&stacked("nothing", &[])).is_ok());
    }
}
