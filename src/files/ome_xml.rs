//! OME-XML 2016-06 for the files that this program writes.
//!
//! In: sizes, names, calibration and settings. Out: text of pure ASCII, as the TIFF description field wants it.
//! Never: an unescaped name, a character that XML forbids. Fails: not at all.

use std::fmt::Write;

/// What the description of one image says.
pub(crate) struct OmeImage<'a> {
    pub(crate) name: &'a str,
    pub(crate) description: &'a str,
    /// Sample type as OME names it: `uint16` or `float`.
    pub(crate) sample: &'static str,
    pub(crate) height: usize,
    pub(crate) width: usize,
    /// One name for each channel; the pages are all channels of the first frame, then of the next.
    pub(crate) channels: &'a [String],
    pub(crate) frames: usize,
    pub(crate) pixel_size_nm: Option<f64>,
    pub(crate) frame_interval_s: Option<f64>,
    /// Begin of each frame after the first, in s; empty if it is not known or not worth its room.
    pub(crate) delta_t_s: &'a [f64],
    pub(crate) settings: &'a [(String, String)],
}

const SCHEMA: &str = "http://www.openmicroscopy.org/Schemas/OME/2016-06";
const NAMESPACE: &str = "sofiscope/settings";

/// The document for one image.
pub(crate) fn document(image: &OmeImage<'_>) -> String {
    let has_settings = !image.settings.is_empty();
    let annotation = if has_settings { r#"<AnnotationRef ID="Annotation:0"/>"# } else { "" };
    format!(
        concat!(
            r#"<?xml version="1.0" encoding="UTF-8"?>"#,
            r#"<OME xmlns="{schema}" xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" "#,
            r#"xsi:schemaLocation="{schema} {schema}/ome.xsd" Creator="{creator}">"#,
            r#"<Image ID="Image:0" Name="{name}"><Description>{description}</Description>"#,
            r#"{pixels}{annotation}</Image>{settings}</OME>"#
        ),
        schema = SCHEMA,
        creator = escape(super::SOFTWARE),
        name = escape(image.name),
        description = escape(image.description),
        pixels = pixels(image),
        annotation = annotation,
        settings = settings(image.settings),
    )
}

fn pixels(image: &OmeImage<'_>) -> String {
    let mut calibration = String::new();
    if let Some(size_nm) = image.pixel_size_nm {
        let size = size_nm / 1e3;
        for axis in ["X", "Y"] {
            calibration += &format!(r#" PhysicalSize{axis}="{size}" PhysicalSize{axis}Unit="&#181;m""#);
        }
    }
    if let Some(interval) = image.frame_interval_s {
        calibration += &format!(r#" TimeIncrement="{interval}" TimeIncrementUnit="s""#);
    }
    let is_big_endian = cfg!(target_endian = "big");
    let size_c = image.channels.len();
    let num_planes = size_c * image.frames;
    let mut xml = format!(
        concat!(
            r#"<Pixels ID="Pixels:0" DimensionOrder="XYCZT" Type="{sample}" BigEndian="{order}" "#,
            r#"SizeX="{width}" SizeY="{height}" SizeZ="1" SizeC="{size_c}" SizeT="{frames}"{calibration}>"#
        ),
        sample = image.sample,
        order = is_big_endian,
        width = image.width,
        height = image.height,
        size_c = size_c,
        frames = image.frames,
        calibration = calibration,
    );
    for (index, name) in image.channels.iter().enumerate() {
        let name = escape(name);
        xml += &format!(r#"<Channel ID="Channel:0:{index}" Name="{name}" SamplesPerPixel="1"/>"#);
    }
    xml += &format!(r#"<TiffData IFD="0" PlaneCount="{num_planes}"/>"#);
    for (frame, seconds) in image.delta_t_s.iter().enumerate() {
        let place = format!(r#"TheZ="0" TheC="0" TheT="{frame}""#);
        xml += &format!(r#"<Plane {place} DeltaT="{seconds}" DeltaTUnit="s"/>"#);
    }
    xml + "</Pixels>"
}

fn settings(settings: &[(String, String)]) -> String {
    if settings.is_empty() {
        return String::new();
    }
    let mut xml =
        format!(r#"<StructuredAnnotations><MapAnnotation ID="Annotation:0" Namespace="{NAMESPACE}"><Value>"#);
    for (key, value) in settings {
        xml += &format!(r#"<M K="{}">{}</M>"#, escape(key), escape(value));
    }
    xml + "</Value></MapAnnotation></StructuredAnnotations>"
}

/// Text for XML in ASCII; control characters, which XML forbids, become spaces.
fn escape(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for character in text.chars() {
        match character {
            '&' => escaped.push_str("&amp;"),
            '<' => escaped.push_str("&lt;"),
            '>' => escaped.push_str("&gt;"),
            '"' => escaped.push_str("&quot;"),
            '\n' | '\r' | '\t' | ' '..='~' => push_plain(&mut escaped, character),
            '\0'..='\u{9f}' | '\u{fffe}' | '\u{ffff}' => escaped.push(' '),
            _ => {
                // Writing into a string cannot fail.
                let _ = write!(escaped, "&#{};", u32::from(character));
            }
        }
    }
    escaped
}

/// Line ends and tabs stay what they are inside attributes only as references.
fn push_plain(escaped: &mut String, character: char) {
    match character {
        '\n' => escaped.push_str("&#10;"),
        '\r' => escaped.push_str("&#13;"),
        '\t' => escaped.push_str("&#9;"),
        _ => escaped.push(character),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_is_escaped_into_ascii() {
        assert_eq!(escape("a<b> & \"µ\"\u{1}\n"), "a&lt;b&gt; &amp; &quot;&#181;&quot; &#10;");
        assert!(escape("κ_RR 𝛋").is_ascii());
    }
}
