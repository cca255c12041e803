//! The parametric spectra that come with the program, and files of one's own in the same form.
//!
//! In: text in TOML. Out: [`ParametricSpectra`]. Never: gives a curve without saying that it is parametric.
//! Fails: [`SpectrumFaults`] with all faults of the text.

use super::SpectrumFaults;
use crate::config::Fault;
use crate::sofi::spectra::{
    DichroicCurve, EdgeShape, EmissionShape, FilterShape, LightPath, SpectraError, Spectrum,
};
use sofiscope_form::{Faults, Form, plain, read};

const BUILT_IN: &str = include_str!("../../../config/parametric-spectra.toml");
/// Wavelengths of peaks and edges, nanometers.
const WAVELENGTHS_NM: std::ops::RangeInclusive<f64> = 300.0..=1200.0;
/// Widths of peaks and edges, nanometers.
const WIDTHS_NM: std::ops::RangeInclusive<f64> = 1.0..=200.0;
const SHARES: std::ops::RangeInclusive<f64> = 0.0..=1.0;

/// Emissions, filters and dichroics that are a few numbers each.
#[derive(Debug, Clone, PartialEq)]
pub struct ParametricSpectra {
    emissions: Vec<(String, Spectrum)>,
    filters: Vec<(String, Spectrum)>,
    dichroics: Vec<ParametricDichroic>,
}

/// A dichroic of parametric curves.
#[derive(Debug, Clone, PartialEq)]
pub struct ParametricDichroic {
    /// Its name, which says that it is parametric.
    pub name: String,
    /// Its curves.
    pub curve: DichroicCurve,
    /// The filters that its light has passed.
    pub path: LightPath,
}

impl ParametricSpectra {
    /// Those that come with the program, for the dyes of Table S1.
    #[must_use]
    pub fn built_in() -> Self {
        Self::from_toml(BUILT_IN).expect("the embedded file is read in a test of this module")
    }

    /// Reads a text in the form of `config/parametric-spectra.toml`.
    ///
    /// # Errors
    /// All faults at once: syntax, missing and unknown keys, values outside their limits, names given twice or unknown.
    pub fn from_toml(text: &str) -> Result<Self, SpectrumFaults> {
        let faults = Faults::new(text);
        let read = read(&faults, |form| {
            let emissions = form.tables("emission").iter().filter_map(emission).collect();
            let filters: Vec<_> = form.tables("filter").iter().filter_map(filter).collect();
            let dichroics = form.tables("edge").iter().filter_map(|form| edge(form, &filters)).collect();
            Self { emissions, filters, dichroics }
        });
        if let Some(read) = &read {
            read.note_repeated(&faults);
        }
        let list = faults.into_list();
        match read {
            Some(read) if list.is_empty() => Ok(read),
            _ => Err(SpectrumFaults { faults: list }),
        }
    }

    /// The faults of such a text.
    #[must_use]
    pub fn faults(text: &str) -> Vec<Fault> {
        Self::from_toml(text).err().map_or_else(Vec::new, |error| error.faults)
    }

    /// The emission of a fluorophore, peak 1; capitals, spaces and hyphens do not matter.
    #[must_use]
    pub fn emission(&self, fluorophore: &str) -> Option<&Spectrum> {
        find(&self.emissions, fluorophore)
    }

    /// The transmission of a filter.
    #[must_use]
    pub fn filter(&self, name: &str) -> Option<&Spectrum> {
        find(&self.filters, name)
    }

    /// Names of all filters.
    pub fn filters(&self) -> impl Iterator<Item = &str> {
        self.filters.iter().map(|(name, _)| name.as_str())
    }

    /// All dichroics.
    #[must_use]
    pub fn dichroics(&self) -> &[ParametricDichroic] {
        &self.dichroics
    }

    fn note_repeated(&self, faults: &Faults<'_>) {
        let of = |list: &[(String, Spectrum)]| list.iter().map(|(name, _)| plain(name)).collect::<Vec<_>>();
        let dichroics = self.dichroics.iter().map(|dichroic| plain(&dichroic.name)).collect();
        let kinds = [("emission", of(&self.emissions)), ("filter", of(&self.filters)), ("edge", dichroics)];
        for (kind, names) in kinds {
            if let Some(again) = (1..names.len()).find(|&i| names[..i].contains(&names[i])) {
                let message = format!("names \"{}\" twice", names[again]);
                faults.note(None, kind, message, "remove one of the two entries");
            }
        }
    }
}

fn find<'a>(list: &'a [(String, Spectrum)], name: &str) -> Option<&'a Spectrum> {
    let name = plain(name);
    list.iter().find(|(known, _)| plain(known) == name).map(|(_, spectrum)| spectrum)
}

fn emission(form: &Form<'_>) -> Option<(String, Spectrum)> {
    let name = form.text("fluorophore");
    let shape = EmissionShape {
        peak_nm: form.number("peak_nm", WAVELENGTHS_NM),
        short_half_width_nm: form.number("short_half_width_nm", WIDTHS_NM),
        long_half_width_nm: form.number("long_half_width_nm", WIDTHS_NM),
    };
    form.finish();
    Some((name, good(form, "peak_nm", shape.spectrum())?))
}

fn filter(form: &Form<'_>) -> Option<(String, Spectrum)> {
    let name = form.text("name");
    let shape = FilterShape {
        bands_nm: form.points("bands_nm", WAVELENGTHS_NM),
        width_nm: form.number("edge_width_nm", WIDTHS_NM),
        ceiling: form.number("ceiling", SHARES),
    };
    form.finish();
    Some((name, good(form, "bands_nm", shape.spectrum())?))
}

fn edge(form: &Form<'_>, filters: &[(String, Spectrum)]) -> Option<ParametricDichroic> {
    let name = form.text("dichroic");
    let shape = EdgeShape {
        edge_nm: form.number("edge_nm", WAVELENGTHS_NM),
        width_nm: form.number("edge_width_nm", WIDTHS_NM),
        floor: form.number("floor", SHARES),
        ceiling: form.number("ceiling", SHARES),
    };
    let mut common = Vec::new();
    for behind in form.texts_if_any("behind", 0..=usize::MAX) {
        match find(filters, &behind) {
            Some(filter) => common.push(filter.clone()),
            None => form.fault(
                "behind",
                format!("names \"{behind}\", which is no filter of this file"),
                "add it as [[filter]] or correct the name",
            ),
        }
    }
    form.finish();
    let curve = good(form, "edge_nm", shape.spectrum().and_then(DichroicCurve::lossless))?;
    Some(ParametricDichroic { name, curve, path: LightPath { common, ..LightPath::default() } })
}

/// The curve, or a fault.
fn good<T>(form: &Form<'_>, key: &str, curve: Result<T, SpectraError>) -> Option<T> {
    match curve {
        Ok(curve) => Some(curve),
        Err(error) => {
            form.fault(key, format!("makes no curve: {error}"), "correct the numbers of this entry");
            None
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Catalogue;

    /// Table S1 of the paper for zt 594 RDC, typed once more.
    const TABLE_S1: [(&str, f64); 6] = [
        ("Alexa Fluor 488", 0.02),
        ("Janelia Fluor 549", 0.16),
        ("Abberior Flip 565", 0.26),
        ("Atto 565", 0.35),
        ("Alexa Fluor 568", 0.47),
        ("Alexa Fluor 647", 0.98),
    ];

    #[test]
    fn the_built_in_spectra_reproduce_table_s1() {
        let spectra = ParametricSpectra::built_in();
        let [dichroic] = spectra.dichroics() else { panic!("one dichroic") };
        for (name, expected) in TABLE_S1 {
            let emission = spectra.emission(name).unwrap();
            let found = dichroic.path.detected(emission, &dichroic.curve).unwrap().response.transmission();
            println!("{name}: T = {found:.4}, Table S1 {expected}, difference {:+.4}", found - expected);
            assert!((found - expected).abs() <= 0.03, "{name}: {found} for {expected}");
        }
    }

    #[test]
    fn every_curve_says_that_it_is_parametric_and_peaks_where_the_catalogue_says() {
        let spectra = ParametricSpectra::built_in();
        let named =
            spectra.filters().chain(spectra.dichroics().iter().map(|dichroic| dichroic.name.as_str()));
        assert!(named.into_iter().all(|name| name.contains("parametric")));
        assert!(BUILT_IN.starts_with("# PARAMETRIC"));
        for dye in Catalogue::built_in().fluorophores() {
            let emission = spectra.emission(dye.name()).unwrap();
            assert!((emission.at(dye.emission_nm().unwrap()) - 1.0).abs() < 1e-9, "{}", dye.name());
        }
    }

    #[test]
    fn all_faults_of_a_text_are_said_at_once() {
        let text = "[[emission]]\nfluorophore = \"A\"\npeak_nm = 20\nshort_half_width_nm = 15\n\n[[edge]]\ndichroic = \
                    \"D\"\nedge_nm = 600\nedge_width_nm = 5\nfloor = 0\nceiling = 1\nbehind = [\"F\"]\nfour = 1\n";
        let faults = ParametricSpectra::faults(text);
        let lines: Vec<_> = faults.iter().filter_map(|fault| fault.line).collect();
        assert_eq!(lines, [1, 3, 12, 13], "{faults:?}");
        let twice = "[[emission]]\nfluorophore = \"A\"\npeak_nm = 500\nshort_half_width_nm = 15\nlong_half_width_nm = 20\n";
        assert!(ParametricSpectra::faults(&twice.repeat(2))[0].message.contains("twice"));
        assert!(ParametricSpectra::faults(BUILT_IN).is_empty());
    }
}
