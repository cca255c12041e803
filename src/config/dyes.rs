//! The dyes and dichroics that the program knows by name (paper, Table S1).
//!
//! In: names as people type them. Out: [`Species`] for the unmixing.
//! Never: guesses a coefficient, takes one dichroic's number for another's.
//! Fails: [`DyeError`] with the nearest known names; [`CatalogueError`] with all faults of both files.

mod checked;
mod raw;

use std::collections::BTreeMap;

use super::Fault;
use super::names::suggestion;
use crate::sofi::spectra::{Species, SpectralResponse};
use sofiscope_form::{Faults, nearest, plain};

const FLUOROPHORES: &str = include_str!("../../config/fluorophores.toml");
const DICHROICS: &str = include_str!("../../config/dichroics.toml");

/// A dye.
#[derive(Debug, Clone, PartialEq)]
pub struct Fluorophore {
    name: String,
    aliases: Vec<String>,
    emission_nm: Option<f64>,
}

impl Fluorophore {
    /// Its name.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Other names that are understood.
    #[must_use]
    pub fn aliases(&self) -> &[String] {
        &self.aliases
    }

    /// Wavelength of the emission maximum in nanometers, where known.
    #[must_use]
    pub fn emission_nm(&self) -> Option<f64> {
        self.emission_nm
    }
}

/// A dichroic mirror and the coefficients known for it.
#[derive(Debug, Clone, PartialEq)]
pub struct Dichroic {
    name: String,
    aliases: Vec<String>,
    about: String,
    /// By place of the fluorophore in the catalogue.
    responses: BTreeMap<usize, SpectralResponse>,
}

impl Dichroic {
    /// Its name.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Where its numbers come from; may be empty.
    #[must_use]
    pub fn about(&self) -> &str {
        &self.about
    }
}

/// Something that has a name and other names.
trait Named {
    fn names(&self) -> (&str, &[String]);

    fn is_called(&self, asked: &str) -> bool {
        let (name, aliases) = self.names();
        let asked = plain(asked);
        plain(name) == asked || aliases.iter().any(|alias| plain(alias) == asked)
    }
}

impl Named for Fluorophore {
    fn names(&self) -> (&str, &[String]) {
        (&self.name, &self.aliases)
    }
}

impl Named for Dichroic {
    fn names(&self) -> (&str, &[String]) {
        (&self.name, &self.aliases)
    }
}

/// Names of the entries that are called most alike.
fn nearest_names<T: Named>(asked: &str, known: &[T]) -> Vec<String> {
    let all = known.iter().flat_map(|entry| {
        let (name, aliases) = entry.names();
        aliases.iter().map(String::as_str).chain([name])
    });
    let mut names: Vec<String> = Vec::new();
    for called in nearest(asked, all) {
        let owner = known.iter().find(|entry| entry.is_called(called)).map(|entry| entry.names().0);
        if let Some(owner) = owner.filter(|owner| !names.iter().any(|name| name == owner)) {
            names.push(owner.to_owned());
        }
    }
    names
}

/// Why a choice of dyes and dichroic is refused.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum DyeError {
    /// No fluorophore was given.
    #[error("no fluorophore was given; give at least one")]
    NoName,
    /// No fluorophore is called so.
    #[error("no fluorophore is called \"{name}\".{}", nearest_or_all(.nearest, .known))]
    UnknownFluorophore {
        /// The name as given.
        name: String,
        /// Known names that are most alike, the best first; may be empty.
        nearest: Vec<String>,
        /// All known names.
        known: Vec<String>,
    },
    /// No dichroic is called so.
    #[error("no dichroic is called \"{name}\".{}", nearest_or_all(.nearest, .known))]
    UnknownDichroic {
        /// The name as given.
        name: String,
        /// Known names that are most alike, the best first; may be empty.
        nearest: Vec<String>,
        /// All known names.
        known: Vec<String>,
    },
    /// The dye was never measured or calculated behind that dichroic.
    #[error("no coefficient is known for {fluorophore} behind {dichroic}; {}", elsewhere(.available))]
    NoCoefficient {
        /// Name of the fluorophore.
        fluorophore: String,
        /// Name of the dichroic.
        dichroic: String,
        /// Dichroics for which there is one.
        available: Vec<String>,
    },
    /// The same dye was given twice, perhaps under two names.
    #[error("{0} was given twice; give each fluorophore once")]
    Repeated(String),
}

/// What to write instead of an unknown name: the nearest ones, or any when none is near.
fn nearest_or_all(nearest: &[String], known: &[String]) -> String {
    match nearest {
        [] => format!(" Known are: {}.", known.join(", ")),
        some => suggestion(some),
    }
}

fn elsewhere(dichroics: &[String]) -> String {
    match dichroics {
        [] => "it has none behind any dichroic, add one to dichroics.toml".to_owned(),
        some => format!("it has one behind: {}", some.join(", ")),
    }
}

/// All faults of the two files of a catalogue; at least one.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("the catalogue of dyes has faults:{}{}", list("fluorophores", .fluorophores), list("dichroics", .dichroics))]
pub struct CatalogueError {
    /// Faults of the text of fluorophores.
    pub fluorophores: Vec<Fault>,
    /// Faults of the text of dichroics.
    pub dichroics: Vec<Fault>,
}

fn list(of: &str, faults: &[Fault]) -> String {
    faults.iter().map(|fault| format!("\n  {of}, {fault}")).collect()
}

/// Fluorophores and dichroics by name.
///
/// ```
/// use sofiscope::config::Catalogue;
///
/// let catalogue = Catalogue::built_in();
/// let species = catalogue.species(&["AF488", "atto-565", "Alexa Fluor 647"], "zt 594 RDC")?;
/// assert_eq!(species[1].name, "Atto 565");
/// assert_eq!(species[1].response.transmission(), 0.35);
/// # Ok::<(), sofiscope::config::DyeError>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Catalogue {
    fluorophores: Vec<Fluorophore>,
    dichroics: Vec<Dichroic>,
    /// How many of the dichroics stand before the built-in ones.
    own: usize,
}

impl Catalogue {
    /// The catalogue that comes with the program: Table S1 of the paper and the measured coefficients of its authors.
    #[must_use]
    pub fn built_in() -> Self {
        Self::from_toml(FLUOROPHORES, DICHROICS)
            .expect("the embedded files are read in a test of this module")
    }

    /// Reads a catalogue from the texts of `fluorophores.toml` and `dichroics.toml`.
    ///
    /// # Errors
    /// All faults of both texts at once: syntax, missing and unknown keys, values outside their limits,
    /// names that mean two things, coefficients of unknown fluorophores.
    pub fn from_toml(fluorophores: &str, dichroics: &str) -> Result<Self, CatalogueError> {
        let (first, second) = (Faults::new(fluorophores), Faults::new(dichroics));
        let fluorophores = checked::fluorophores(raw::fluorophores(&first), &first);
        let dichroics = checked::dichroics(raw::dichroics(&second), &fluorophores, &second);
        let error = CatalogueError { fluorophores: first.into_list(), dichroics: second.into_list() };
        if error.fluorophores.is_empty() && error.dichroics.is_empty() {
            Ok(Self { fluorophores, dichroics, own: 0 })
        } else {
            Err(error)
        }
    }

    /// The built-in fluorophores, and the dichroics of a text before the built-in ones.
    ///
    /// # Errors
    /// All faults of the text at once.
    pub fn with_dichroics(text: &str) -> Result<Self, CatalogueError> {
        let mut catalogue = Self::from_toml(FLUOROPHORES, text)?;
        let ours = Self::built_in().dichroics;
        let is_new = |known: &Dichroic| !catalogue.dichroics.iter().any(|own| own.is_called(&known.name));
        let others: Vec<Dichroic> = ours.into_iter().filter(is_new).collect();
        catalogue.own = catalogue.dichroics.len();
        catalogue.dichroics.extend(others);
        Ok(catalogue)
    }

    /// The name of the dichroic of [`with_dichroics`](Self::with_dichroics), where its text has only one.
    #[must_use]
    pub fn measured(&self) -> Option<&str> {
        (self.own == 1).then(|| self.dichroics[0].name.as_str())
    }

    /// The faults of the text of a `fluorophores.toml` by itself.
    #[must_use]
    pub fn faults_of_fluorophores(text: &str) -> Vec<Fault> {
        let faults = Faults::new(text);
        checked::fluorophores(raw::fluorophores(&faults), &faults);
        faults.into_list()
    }

    /// The text of the built-in `fluorophores.toml`, to start an own one from.
    #[must_use]
    pub fn fluorophores_toml() -> &'static str {
        FLUOROPHORES
    }

    /// The text of the built-in `dichroics.toml`, to start an own one from.
    #[must_use]
    pub fn dichroics_toml() -> &'static str {
        DICHROICS
    }

    /// All fluorophores in the order of their file.
    #[must_use]
    pub fn fluorophores(&self) -> &[Fluorophore] {
        &self.fluorophores
    }

    /// All dichroics in the order of their file.
    #[must_use]
    pub fn dichroics(&self) -> &[Dichroic] {
        &self.dichroics
    }

    /// The fluorophore of that name; capitals, spaces and hyphens do not matter, and aliases are names too.
    ///
    /// # Errors
    /// [`DyeError::UnknownFluorophore`] with the nearest names.
    pub fn fluorophore(&self, name: &str) -> Result<&Fluorophore, DyeError> {
        self.place_of(name).map(|place| &self.fluorophores[place])
    }

    /// The dichroic of that name; capitals, spaces and hyphens do not matter, and aliases are names too.
    ///
    /// # Errors
    /// [`DyeError::UnknownDichroic`] with the nearest names.
    pub fn dichroic(&self, name: &str) -> Result<&Dichroic, DyeError> {
        self.dichroics.iter().find(|known| known.is_called(name)).ok_or_else(|| DyeError::UnknownDichroic {
            name: name.to_owned(),
            nearest: nearest_names(name, &self.dichroics),
            known: self.dichroics.iter().map(|known| known.name.clone()).collect(),
        })
    }

    /// The shares of light of a fluorophore behind a dichroic, both by name; `None` where none is known.
    ///
    /// # Errors
    /// [`DyeError`] for unknown names.
    pub fn response(&self, fluorophore: &str, dichroic: &str) -> Result<Option<SpectralResponse>, DyeError> {
        let place = self.place_of(fluorophore)?;
        Ok(self.dichroic(dichroic)?.responses.get(&place).copied())
    }

    /// The species of these names behind this dichroic, in the order given, under their full names.
    ///
    /// # Errors
    /// [`DyeError`] for no name, unknown or repeated names, and fluorophores without a coefficient for the dichroic.
    pub fn species<S: AsRef<str>>(
        &self,
        fluorophores: &[S],
        dichroic: &str,
    ) -> Result<Vec<Species>, DyeError> {
        let dichroic = self.dichroic(dichroic)?;
        let places =
            fluorophores.iter().map(|name| self.place_of(name.as_ref())).collect::<Result<Vec<_>, _>>()?;
        if places.is_empty() {
            return Err(DyeError::NoName);
        }
        if let Some(again) = (1..places.len()).find(|&i| places[..i].contains(&places[i])) {
            return Err(DyeError::Repeated(self.fluorophores[places[again]].name.clone()));
        }
        places.into_iter().map(|place| self.behind(place, dichroic)).collect()
    }

    fn behind(&self, place: usize, dichroic: &Dichroic) -> Result<Species, DyeError> {
        let fluorophore = &self.fluorophores[place];
        let Some(&response) = dichroic.responses.get(&place) else {
            let others = self.dichroics.iter().filter(|other| other.responses.contains_key(&place));
            return Err(DyeError::NoCoefficient {
                fluorophore: fluorophore.name.clone(),
                dichroic: dichroic.name.clone(),
                available: others.map(|other| other.name.clone()).collect(),
            });
        };
        Ok(Species { name: fluorophore.name.clone(), response, emission_nm: fluorophore.emission_nm })
    }

    fn place_of(&self, name: &str) -> Result<usize, DyeError> {
        self.fluorophores.iter().position(|known| known.is_called(name)).ok_or_else(|| {
            DyeError::UnknownFluorophore {
                name: name.to_owned(),
                nearest: nearest_names(name, &self.fluorophores),
                known: self.fluorophores.iter().map(|known| known.name.clone()).collect(),
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Table S1 of the paper, and its authors' measured values, typed once more.
    const TABLE_S1: [(&str, [Option<f64>; 3], f64); 6] = [
        ("Alexa Fluor 488", [Some(0.02), Some(0.04), Some(0.03)], 520.0),
        ("Janelia Fluor 549", [Some(0.16), None, Some(0.37)], 571.0),
        ("Abberior Flip 565", [Some(0.26), None, None], 580.0),
        ("Atto 565", [Some(0.35), Some(0.18), Some(0.44)], 592.0),
        ("Alexa Fluor 568", [Some(0.47), None, Some(0.57)], 603.0),
        ("Alexa Fluor 647", [Some(0.98), Some(0.97), Some(0.99)], 668.0),
    ];
    const DICHROIC_NAMES: [&str; 3] = ["zt 594 RDC", "HC BS 640", "zt 594 RDC (measured)"];

    #[test]
    fn the_built_in_catalogue_is_table_s1() {
        let catalogue = Catalogue::built_in();
        assert_eq!(catalogue.fluorophores().len(), TABLE_S1.len());
        assert_eq!(catalogue.dichroics().len(), DICHROIC_NAMES.len());
        for (name, transmissions, emission_nm) in TABLE_S1 {
            assert_eq!(catalogue.fluorophore(name).unwrap().emission_nm(), Some(emission_nm));
            for (dichroic, transmission) in DICHROIC_NAMES.into_iter().zip(transmissions) {
                let response = catalogue.response(name, dichroic).unwrap();
                assert_eq!(response.map(|response| response.transmission()), transmission, "{name}");
                assert_eq!(
                    response.map(|response| response.reflection()),
                    transmission.map(|share| 1.0 - share)
                );
            }
        }
    }

    #[test]
    fn names_are_understood_however_they_are_typed() {
        let catalogue = Catalogue::built_in();
        for (typed, meant) in [
            ("AF488", "Alexa Fluor 488"),
            ("alexa-fluor 488", "Alexa Fluor 488"),
            ("Atto565", "Atto 565"),
            ("A647", "Alexa Fluor 647"),
            ("AbberiorFlip 565", "Abberior Flip 565"),
            ("jf 549", "Janelia Fluor 549"),
        ] {
            assert_eq!(catalogue.fluorophore(typed).unwrap().name(), meant);
        }
        for (typed, meant) in [("ZT594-RDC", "zt 594 RDC"), ("hcbs640", "HC BS 640")] {
            assert_eq!(catalogue.dichroic(typed).unwrap().name(), meant);
        }
    }

    #[test]
    fn unknown_names_bring_the_nearest_ones() {
        let catalogue = Catalogue::built_in();
        let said =
            |names: &[&str], dichroic: &str| catalogue.species(names, dichroic).unwrap_err().to_string();
        assert!(said(&["Alexa Flour 674"], "zt 594 RDC").contains("Did you mean Alexa Fluor 647"));
        assert!(said(&["AF567"], "zt 594 RDC").contains("Alexa Fluor 568"));
        assert!(said(&["Atto 565"], "zt 549 RDC").contains("Did you mean zt 594 RDC"));
        assert!(said(&["Atto 565", "AT565"], "zt 594").contains("Atto 565 was given twice"));
        let without = said(&["Flip 565"], "HC BS 640");
        assert!(without.ends_with("it has one behind: zt 594 RDC"), "{without}");
        assert_eq!(catalogue.species::<&str>(&[], "zt 594"), Err(DyeError::NoName));
    }

    #[test]
    fn all_faults_of_both_files_are_said_at_once() {
        let fluorophores =
            "[[fluorophore]]\nname = \"A\"\nemission = 5\n\n[[fluorophore]]\nname = \"a\"\nemission_nm = 5";
        let dichroics = "[[dichroic]]\nname = \"D\"\ncoefficients = [\n{ fluorophore = \"B\", transmission = 1.5 },\n{ fluorophore = \"A\" } ]";
        let error = Catalogue::from_toml(fluorophores, dichroics).unwrap_err();
        let lines = |faults: &[Fault]| faults.iter().map(|fault| fault.line).collect::<Vec<_>>();
        assert_eq!(lines(&error.fluorophores), [Some(3), Some(6), Some(7)], "{error}");
        assert_eq!(lines(&error.dichroics), [Some(4), Some(4), Some(5)], "{error}");
        let said = error.to_string();
        assert!(said.contains("write `emission_nm`"), "{said}");
        assert!(said.contains("`dichroic[0].coefficients[0].transmission` is 1.5"), "{said}");
    }

    #[test]
    fn a_file_of_measured_shares_stands_before_the_built_in_dichroics() {
        let text = "[[dichroic]]\nname = \"zt 594 RDC\"\ndate = \"2026-01-02\"\ncoefficients = [{ fluorophore = \"AF488\", \
                    transmission = 0.031, transmission_uncertainty = 0.002, recording = \"a\" }]";
        let catalogue = Catalogue::with_dichroics(text).unwrap();
        assert_eq!(catalogue.measured(), Some("zt 594 RDC"));
        let measured = catalogue.species(&["AF488"], "zt 594 RDC").unwrap();
        assert_eq!(measured[0].response.transmission(), 0.031);
        assert!(
            catalogue.species(&["Atto 565"], "zt 594 RDC").is_err(),
            "measured and calculated shares mixed"
        );
        assert!(catalogue.species(&["Atto 565"], "HC BS 640").is_ok());
        assert_eq!(Catalogue::built_in().measured(), None);
    }

    #[test]
    fn measured_reflections_are_taken_as_they_are() {
        let dichroics = "[[dichroic]]\nname = \"D\"\ncoefficients = [{ fluorophore = \"AF488\", transmission = 0.3, reflection = 0.5 }]";
        let catalogue = Catalogue::from_toml(FLUOROPHORES, dichroics).unwrap();
        let species = catalogue.species(&["AF488"], "D").unwrap();
        assert_eq!((species[0].response.transmission(), species[0].response.reflection()), (0.3, 0.5));
    }
}
