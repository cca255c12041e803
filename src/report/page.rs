//! `report.html`: one page that a scientist can show, mail and print.
//!
//! In: the report and its pictures. Out: HTML that is also well-formed XML, with style, plots and pictures inside.
//! Never: runs scripts; loads anything; leaves text unescaped. Fails: [`ReportError`].

use std::path::Path;

use super::error::ReportError;
use super::facts;
use super::figure::{Picture, Step};
use super::json::write_whole;
use super::model::{AnalysisReport, Crosstalk};
use super::sections;
use super::text::{count, escape, number, percent, plural};
use super::verdict::verdict;

/// The page.
///
/// Pictures keep their order within a step; those of [`Step::Composite`] come first and large.
///
/// # Errors
/// [`ReportError::Picture`] if a picture cannot be encoded.
pub fn html(report: &AnalysisReport, pictures: &[Picture]) -> Result<String, ReportError> {
    let title = if report.title.is_empty() { "SOFI analysis" } else { &report.title };
    let body = [
        head(report, title),
        hero(report, pictures)?,
        sections::light_path(pictures)?,
        sections::species(report),
        sections::crosstalk(report),
        sections::resolution(report),
        sections::bleaching(report),
        sections::mixing(report),
        facts::facts(report),
        foot(report),
    ]
    .concat();
    Ok(format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head><meta charset=\"utf-8\"/>\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\"/>\
         <meta name=\"color-scheme\" content=\"light dark\"/>\n<title>{}</title>\n<style>\n{}</style></head>\n\
         <body>\n<main>\n{body}</main>\n</body>\n</html>\n",
        escape(title),
        include_str!("page.css"),
    ))
}

/// Writes `report.html`.
///
/// # Errors
/// [`ReportError::Picture`], [`ReportError::File`].
pub fn write_html(report: &AnalysisReport, pictures: &[Picture], path: &Path) -> Result<(), ReportError> {
    write_whole(path, &html(report, pictures)?)
}

fn head(report: &AnalysisReport, title: &str) -> String {
    let banner = if report.simulated {
        "<p class=\"banner\" role=\"note\"><b>Simulated data.</b> No microscope and no sample were involved.</p>\n"
    } else {
        ""
    };
    let (title, sentence, created) = (escape(title), escape(&verdict(report)), escape(&report.created));
    format!(
        "<header>{banner}<p class=\"date\">{created}</p><h1>{title}</h1>\n<p class=\"verdict\">{sentence}</p></header>\n{}",
        warnings(&report.warnings)
    )
}

fn warnings(sentences: &[String]) -> String {
    if sentences.is_empty() {
        return String::new();
    }
    let heading = plural(sentences.len(), "warning");
    let items: String = sentences.iter().map(|sentence| format!("<li>{}</li>\n", escape(sentence))).collect();
    format!("<aside class=\"warnings\" role=\"alert\"><h2>⚠ {heading}</h2><ul>{items}</ul></aside>\n")
}

fn hero(report: &AnalysisReport, pictures: &[Picture]) -> Result<String, ReportError> {
    let large = pictures.iter().filter(|picture| picture.step == Step::Composite);
    let large = large.map(Picture::figure).collect::<Result<String, _>>()?;
    Ok(format!("<div class=\"hero\"><div class=\"large\">{large}</div>\n{}</div>\n", key_numbers(report)))
}

fn key_numbers(report: &AnalysisReport) -> String {
    let order = report.settings.order;
    let fine =
        report.settings.camera_pixel_pitch_nm.filter(|_| order > 0).map(|pitch| pitch / f64::from(order));
    let worst = report.crosstalk.as_ref().and_then(|crosstalk| Crosstalk::worst(&crosstalk.linearized));
    let resolution = report.resolution.iter().flat_map(|r| &r.values).map(|value| value.nanometers);
    let best = resolution.filter(|value| value.is_finite()).min_by(f64::total_cmp);
    let condition = report.unmixing.as_ref().map(|unmixing| unmixing.condition_number);
    let speed = report.timing.as_ref().map(|timing| timing.pairs_per_second);
    let tiles = [
        ("frames used", Some(count(report.frames.used as f64)), ""),
        ("cumulant order", Some(order.to_string()), ""),
        ("output pixel", fine.map(number), "nm"),
        ("condition number", condition.map(number), ""),
        ("worst crosstalk, linearized", worst.map(percent), "%"),
        ("best resolution", best.map(number), "nm"),
        ("analysis speed", speed.map(number), "pairs/s"),
    ];
    let tile = |(name, value, unit): (&str, Option<String>, &str)| {
        value.map(|value| format!("<div><dd>{value} <small>{unit}</small></dd><dt>{name}</dt></div>\n"))
    };
    format!("<dl class=\"key\">{}</dl>", tiles.into_iter().filter_map(tile).collect::<String>())
}

fn foot(report: &AnalysisReport) -> String {
    let software = &report.software;
    format!(
        "<footer>{} {}. Dark green pixels could not be computed (no value).</footer>\n",
        escape(&software.name),
        escape(&software.version)
    )
}

#[cfg(test)]
mod tests {
    use super::super::example;
    use super::*;

    fn parse(page: &str) -> roxmltree::Document<'_> {
        let options = roxmltree::ParsingOptions { allow_dtd: true, ..roxmltree::ParsingOptions::default() };
        roxmltree::Document::parse_with_options(page, options).unwrap()
    }

    #[test]
    fn the_page_is_well_formed_and_complete() {
        let page = html(&example::report(), &example::pictures()).unwrap();
        let document = parse(&page);
        let num = |tag: &str| document.descendants().filter(|node| node.has_tag_name(tag)).count();
        assert_eq!(num("img"), 17);
        assert_eq!(num("h1"), 1);
        assert!(document.descendants().filter(|n| n.has_tag_name("img")).all(|n| n.has_attribute("alt")));
        for words in
            ["Simulated data", "2 warnings", "Linearized", "For comparison: paper, Table 2", "mean per pixel"]
        {
            assert!(page.contains(words), "{words}");
        }
    }

    #[test]
    fn nothing_outside_the_page_is_needed() {
        let page = html(&example::report(), &example::pictures()).unwrap();
        let document = parse(&page);
        for node in document.descendants().filter(roxmltree::Node::is_element) {
            assert!(!matches!(node.tag_name().name(), "script" | "link" | "iframe" | "object"));
            for attribute in node.attributes().filter(|a| matches!(a.name(), "src" | "href" | "action")) {
                assert!(attribute.value().starts_with("data:image/png;base64,"));
            }
        }
        assert!(!page.contains("url(") && !page.contains("@import"));
    }

    #[test]
    fn text_cannot_become_markup() {
        let evil = "<script>alert('x')</script>\" onload=\"".to_owned();
        let mut report = example::report();
        let mut pictures = example::pictures();
        report.species[0].name.clone_from(&evil);
        report.title.clone_from(&evil);
        report.command.clone_from(&evil);
        report.warnings.push(evil.clone());
        report.settings.other.push((evil.clone(), evil.clone()));
        pictures[0].title.clone_from(&evil);
        pictures[0].caption.clone_from(&evil);
        if let Some(crosstalk) = &mut report.crosstalk {
            crosstalk.species[1].clone_from(&evil);
        }
        let page = html(&report, &pictures).unwrap();
        assert!(!page.contains("<script"));
        let document = parse(&page);
        assert!(document.descendants().all(|node| !node.has_attribute("onload")));
    }

    #[test]
    fn an_empty_report_is_a_page_too() {
        let page = html(&AnalysisReport::default(), &[]).unwrap();
        parse(&page);
        assert!(!page.contains("Simulated data.") && !page.contains("class=\"warnings\""));
    }

    #[test]
    fn the_page_is_written_whole() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("report.html");
        write_html(&example::report(), &example::pictures(), &path).unwrap();
        assert!(std::fs::read_to_string(&path).unwrap().ends_with("</html>\n"));
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
        // A place to look at the page: SOFISCOPE_REPORT_EXAMPLE=/tmp/report.html cargo test report
        if let Some(place) = std::env::var_os("SOFISCOPE_REPORT_EXAMPLE") {
            std::fs::copy(&path, place).unwrap();
        }
    }
}
