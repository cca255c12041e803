//! Pictures with captions, as figures of a page.
//!
//! In: RGB pictures with what a reader must know about them. Out: `<figure>` elements.
//! Never: shows a picture without a scale bar when the pixel pitch is known; links to files.
//! Fails: [`ReportError::Picture`].

use base64::Engine;

use super::error::ReportError;
use super::text::{escape, number};
use crate::display::{Colormap, DisplayError, Limits, PngNotes, Rgb, RgbImage, hex};

/// Place of a picture on the way of the light.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Step {
    /// Mean images of the cameras and their overlay.
    Cameras,
    /// Spectral cross-cumulants.
    Cumulants,
    /// Species after unmixing.
    Unmixed,
    /// Species after flattening.
    Flattened,
    /// Species after linearization.
    Linearized,
    /// All species together: the large picture at the top.
    Composite,
}

/// One picture of the report.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// Which step it belongs to.
    pub step: Step,
    /// Short title, e.g. `κ₂ RR` or the species.
    pub title: String,
    /// One sentence or less below it; may be empty.
    pub caption: String,
    /// The picture, one pixel per image pixel and without scale bar; the page enlarges it and draws the bar.
    pub image: RgbImage,
    /// Size of its pixels in the sample, in nanometers.
    pub pixel_pitch_nm: Option<f64>,
    /// Which color is what, for overlays and composites.
    pub legend: Vec<LegendEntry>,
    /// Which color is which value, for single images.
    pub scale: Option<ColorScale>,
}

/// One color and what it stands for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LegendEntry {
    /// Name.
    pub label: String,
    /// Color.
    pub color: Rgb,
}

/// Colormap and contrast of a picture.
#[derive(Clone, Debug, PartialEq)]
pub struct ColorScale {
    /// Colormap.
    pub map: Colormap,
    /// Values of its first and last color.
    pub limits: Limits,
    /// Unit of the values, e.g. `counts` or `counts²`.
    pub unit: String,
}

/// Longer side of the large picture and of a panel, in picture pixels, before the browser fits them to the page.
const LARGE: usize = 960;
const PANEL: usize = 480;

impl Picture {
    /// The picture as a `<figure>`.
    pub(super) fn figure(&self) -> Result<String, ReportError> {
        let failed = |source| ReportError::Picture { title: self.title.clone(), source };
        let source = self.data_uri().map_err(failed)?;
        let (title, caption) = (escape(&self.title), escape(&self.caption));
        let (legend, scale) = (self.legend(), self.scale.as_ref().map(ColorScale::bar).unwrap_or_default());
        Ok(format!(
            "<figure><img src=\"{source}\" alt=\"{title}. {caption}\"/>\n\
             <figcaption><b>{title}</b> {legend}<span>{caption}</span></figcaption>{scale}</figure>\n"
        ))
    }

    fn data_uri(&self) -> Result<String, DisplayError> {
        let (mut image, factor) =
            self.image.fitted(if self.step == Step::Composite { LARGE } else { PANEL })?;
        let pixel_pitch_nm = self.pixel_pitch_nm.map(|pitch| pitch / factor);
        if let Some(pitch) = pixel_pitch_nm {
            image.draw_scale_bar(pitch);
        }
        let png = image.to_png(&PngNotes { title: Some(self.title.clone()), pixel_pitch_nm })?;
        Ok(format!("data:image/png;base64,{}", base64::engine::general_purpose::STANDARD.encode(png)))
    }

    fn legend(&self) -> String {
        self.legend.iter().map(|entry| chip(entry.color, &entry.label)).collect()
    }
}

impl ColorScale {
    fn bar(&self) -> String {
        let colors: Vec<_> = (0..=16).map(|index| hex(self.map.color(f64::from(index) / 16.0))).collect();
        let (low, high) = (number(self.limits.low), number(self.limits.high));
        let (colors, unit) = (colors.join(","), escape(&self.unit));
        format!(
            "<div class=\"scale\"><span>{low}</span><i style=\"background:linear-gradient(90deg,{colors})\"></i>\
             <span>{high} {unit}</span></div>"
        )
    }
}

/// A name with its color.
pub(super) fn chip(color: Rgb, label: &str) -> String {
    format!("<span class=\"chip\"><i style=\"background:{}\"></i>{}</span> ", hex(color), escape(label))
}

#[cfg(test)]
mod tests {
    use super::super::example;
    use super::*;

    #[test]
    fn figures_are_brought_to_a_size_that_fits_a_page() {
        let large = example::large_picture();
        let (image, factor) = large.image.fitted(LARGE).unwrap();
        assert_eq!((image.width(), factor), (1050, 0.5));
        assert!(large.figure().unwrap().contains("data:image/png;base64,"));
    }

    #[test]
    fn a_color_scale_tells_its_limits_and_unit() {
        let limits = Limits { low: -0.5, high: 1200.0 };
        let bar = ColorScale { map: Colormap::Gray, limits, unit: "counts²".to_owned() }.bar();
        assert!(bar.contains("−0.500") && bar.contains("1200 counts²") && bar.contains("#000000,"));
    }
}
