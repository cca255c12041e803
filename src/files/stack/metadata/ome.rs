//! OME-XML (schema 2016-06 and older ones alike): the first `Pixels` element and its channels.
//!
//! In: the text. Out: [`Metadata`].
//! Never: fetches anything the text points to. Fails: a sentence, when the text is no XML or orders its planes unusually.

use std::collections::BTreeSet;

use quick_xml::Reader;
use quick_xml::XmlVersion;
use quick_xml::events::{BytesStart, Event};

use super::{Dialect, Metadata, duration, nanometers_per, seconds_per};

/// Sizes and order of the axes of `Pixels`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Axes {
    /// Axis letter and size, the fastest first; X and Y left out.
    sizes: [(char, u64); 3],
}

pub(super) fn parse(text: &str) -> Result<Metadata, String> {
    let mut reader = Reader::from_str(text);
    let mut metadata = Metadata { dialect: Dialect::Ome, channels: 1, run: 1, ..Metadata::default() };
    let mut axes: Option<Axes> = None;
    let mut num_pixels = 0;
    let mut unusual: Option<String> = None;
    let mut file_names = BTreeSet::new();
    loop {
        let event = reader.read_event().map_err(|error| format!("the OME-XML cannot be read ({error})"))?;
        let (Event::Start(element) | Event::Empty(element)) = event else {
            if matches!(event, Event::Eof) {
                // In a set of files, page numbers of several files follow one another.
                return match unusual {
                    Some(detail) if file_names.len() <= 1 => Err(detail),
                    _ => finish(metadata, axes, num_pixels),
                };
            }
            continue;
        };
        let attributes = attributes(&element)?;
        match element.local_name().as_ref() {
            "Pixels" => {
                num_pixels += 1;
                if num_pixels == 1 {
                    axes = Some(read_pixels(&attributes, &mut metadata)?);
                }
            }
            "Channel" if num_pixels == 1 => {
                metadata.channel_names.push(attributes.text("Name").unwrap_or_default().to_owned());
            }
            "TiffData" if num_pixels == 1 => {
                let usual = axes.map_or(Ok(()), |axes| ensure_usual_order(&attributes, axes));
                unusual = unusual.or(usual.err());
            }
            "UUID" if num_pixels == 1 => {
                file_names.insert(attributes.text("FileName").unwrap_or_default().to_owned());
            }
            _ => {}
        }
    }
}

fn finish(mut metadata: Metadata, axes: Option<Axes>, num_pixels: usize) -> Result<Metadata, String> {
    if num_pixels > 1 {
        return Err(format!("the OME-XML lists {num_pixels} images where one is read"));
    }
    let Some(axes) = axes else {
        return Ok(metadata);
    };
    let product = |total: u64, (_, size): &(char, u64)| total.saturating_mul(*size);
    metadata.planes = Some(axes.sizes.iter().fold(1, product));
    let before_channel = axes.sizes.iter().take_while(|(axis, _)| *axis != 'C');
    metadata.run = before_channel.fold(1, product);
    Ok(metadata)
}

fn read_pixels(attributes: &Attributes, metadata: &mut Metadata) -> Result<Axes, String> {
    let size = |axis: char| -> Result<u64, String> {
        match attributes.text(&format!("Size{axis}")) {
            None => Ok(1),
            Some(text) => match text.parse() {
                Ok(size) if size > 0 => Ok(size),
                _ => Err(format!("Size{axis} of the OME-XML is {text}")),
            },
        }
    };
    let order = attributes.text("DimensionOrder").unwrap_or("XYCZT");
    let mut axes = order.chars().filter(|axis| !"XY".contains(*axis));
    let mut sizes = [(' ', 1); 3];
    for slot in &mut sizes {
        let axis = axes.next().filter(|axis| "CZT".contains(*axis));
        let axis = axis.ok_or_else(|| format!("DimensionOrder of the OME-XML is {order}"))?;
        *slot = (axis, size(axis)?);
    }
    metadata.channels = size('C')?;
    metadata.pixel_size_nm = match (length_nm(attributes, 'X'), length_nm(attributes, 'Y')) {
        (Some(x), Some(y)) => Some([x, y]),
        _ => None,
    };
    let interval_unit = seconds_per(attributes.text("TimeIncrementUnit").unwrap_or("s"));
    let interval = attributes.text("TimeIncrement").and_then(|text| text.parse::<f64>().ok());
    metadata.frame_interval = match (interval, interval_unit) {
        (Some(interval), Some(unit)) => duration(interval * unit),
        _ => None,
    };
    Ok(Axes { sizes })
}

fn length_nm(attributes: &Attributes, axis: char) -> Option<f64> {
    let size: f64 = attributes.text(&format!("PhysicalSize{axis}"))?.parse().ok()?;
    let unit = attributes.text(&format!("PhysicalSize{axis}Unit")).unwrap_or("µm");
    let size_nm = size * nanometers_per(unit)?;
    (size_nm.is_finite() && size_nm > 0.0).then_some(size_nm)
}

/// Refuses files whose pages do not follow `DimensionOrder`: a wrong pair of frames is worse than none.
fn ensure_usual_order(attributes: &Attributes, axes: Axes) -> Result<(), String> {
    let number = |name: &str| attributes.text(name).and_then(|text| text.parse::<u64>().ok());
    let Some(page) = number("IFD") else {
        return Ok(());
    };
    let mut usual = 0_u64;
    let mut stride = 1_u64;
    for (axis, size) in axes.sizes {
        let first = number(&format!("First{axis}")).unwrap_or(0);
        usual = usual.saturating_add(first.saturating_mul(stride));
        stride = stride.saturating_mul(size);
    }
    if usual == page {
        return Ok(());
    }
    Err(format!(
        "the OME-XML puts plane {usual} (from 0) on page {page}, an order that is not read; save the stack again with Fiji"
    ))
}

/// The attributes of one element by their local names.
struct Attributes(Vec<(String, String)>);

impl Attributes {
    fn text(&self, name: &str) -> Option<&str> {
        let found = self.0.iter().find(|(candidate, _)| candidate == name);
        found.map(|(_, value)| value.as_str())
    }
}

fn attributes(element: &BytesStart<'_>) -> Result<Attributes, String> {
    let mut found = Vec::new();
    for attribute in element.attributes() {
        let attribute = attribute.map_err(|error| format!("the OME-XML cannot be read ({error})"))?;
        let value = attribute
            .normalized_value(XmlVersion::Implicit1_0)
            .map_err(|error| format!("the OME-XML cannot be read ({error})"))?;
        found.push((attribute.key.local_name().as_ref().to_owned(), value.into_owned()));
    }
    Ok(Attributes(found))
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEAD: &str = r#"<?xml version="1.0"?><OME xmlns="http://www.openmicroscopy.org/Schemas/OME/2016-06"><Image ID="Image:0">"#;

    #[test]
    fn channel_order_and_units_are_understood() {
        let text = format!(
            r#"{HEAD}<Pixels DimensionOrder="XYTCZ" SizeC="2" SizeT="5" SizeZ="1" PhysicalSizeX="0.108" PhysicalSizeXUnit="&#181;m" PhysicalSizeY="108" PhysicalSizeYUnit="nm" TimeIncrement="20" TimeIncrementUnit="ms"><Channel Name="a &amp; b"/><Channel/><TiffData IFD="5" FirstC="1"/></Pixels></Image></OME>"#
        );
        let metadata = parse(&text).unwrap();
        assert_eq!((metadata.planes, metadata.channels, metadata.run), (Some(10), 2, 5));
        assert_eq!(metadata.channel_names, ["a & b", ""]);
        let [x, y] = metadata.pixel_size_nm.unwrap();
        assert!((x - 108.0).abs() < 1e-9 && y == 108.0);
        assert_eq!(metadata.frame_interval, Some(std::time::Duration::from_millis(20)));
    }

    #[test]
    fn sets_of_several_files_may_count_their_pages_anew() {
        let plane = |channel: usize, file: &str| {
            format!(r#"<TiffData FirstC="{channel}" IFD="0"><UUID FileName="{file}">u</UUID></TiffData>"#)
        };
        let pixels = |last: &str| {
            let planes = plane(0, "r.tif") + &plane(1, last);
            format!(r#"{HEAD}<Pixels SizeC="2">{planes}</Pixels></Image></OME>"#)
        };
        assert!(parse(&pixels("t.tif")).is_ok());
        assert!(parse(&pixels("r.tif")).is_err());
    }

    #[test]
    fn unusual_order_broken_xml_and_two_images_are_refused() {
        let shuffled = format!(
            r#"{HEAD}<Pixels SizeC="2" SizeT="5"><TiffData IFD="1" FirstT="1"/></Pixels></Image></OME>"#
        );
        assert!(parse(&shuffled).unwrap_err().contains("page 1"));
        assert!(parse("<OME><Image").is_err());
        let two = format!(r#"{HEAD}<Pixels/></Image><Image><Pixels/></Image></OME>"#);
        assert!(parse(&two).unwrap_err().contains("2 images"));
    }
}
