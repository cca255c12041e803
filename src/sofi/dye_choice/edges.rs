//! Ideal step edges in place of dichroics: how the choice changes with their wavelengths, and where it is best.
//!
//! In: what each channel would see of each dye at every wavelength. Out: shares, merits, [`BestEdges`].
//! Never: puts a longer wavelength into a shorter channel. Fails: [`ChoiceError`].

use ndarray::{Array2, ArrayRef2};

use super::merit::mixture;
use super::{ChoiceError, Criterion, Merit};
use crate::sofi::spectra::Spectrum;
use crate::sofi::unmixing::{MAX_CONDITION, SingularValues, pseudo_inverse};

/// Sets of edges that are tried before the best is refined.
const MOST_STARTS: usize = 2000;
/// Steps of the refinement, nanometers.
const REFINEMENTS_NM: [f64; 7] = [8.0, 4.0, 2.0, 1.0, 0.5, 0.2, 0.1];

/// Where edges may be.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EdgeRange {
    /// Lowest wavelength, nanometers.
    pub from_nm: f64,
    /// Highest wavelength, nanometers.
    pub to_nm: f64,
}

impl EdgeRange {
    fn checked(self) -> Result<Self, ChoiceError> {
        let Self { from_nm, to_nm } = self;
        let is_good = from_nm > 0.0 && to_nm > from_nm && to_nm.is_finite();
        if is_good { Ok(self) } else { Err(ChoiceError::Range { from_nm, to_nm }) }
    }
}

/// Dyes whose light ideal edges divide among channels, the shortest wavelengths to channel 0.
#[derive(Debug, Clone, PartialEq)]
pub struct EdgeSplit {
    /// By dye, then by channel: what the channel sees of each wavelength that comes its way.
    weights: Vec<Vec<Tail>>,
    channels: usize,
}

/// The best edges found.
#[derive(Debug, Clone, PartialEq)]
pub struct BestEdges {
    /// Their wavelengths, increasing, one less than there are channels, nanometers.
    pub edges_nm: Vec<f64>,
    /// Shares of light behind them, `[channel, dye]`.
    pub shares: Array2<f64>,
    /// What they are worth.
    pub merit: Merit,
}

impl EdgeSplit {
    /// Emissions divided among channels that see every wavelength alike.
    ///
    /// # Errors
    /// [`ChoiceError::Empty`] without a dye or a channel.
    pub fn alike(emissions: &[Spectrum], channels: usize) -> Result<Self, ChoiceError> {
        Self::weighted(emissions.iter().map(|emission| vec![emission.clone(); channels]).collect())
    }

    /// By dye, then by channel: the emission times all that stands before that channel.
    ///
    /// # Errors
    /// [`ChoiceError::Empty`] without a dye or a channel, or with unlike numbers of channels.
    pub fn weighted(weights: Vec<Vec<Spectrum>>) -> Result<Self, ChoiceError> {
        let channels = weights.first().map_or(0, Vec::len);
        if channels == 0 || weights.iter().any(|of_dye| of_dye.len() != channels) {
            return Err(ChoiceError::Empty { dyes: weights.len(), channels, order: 1 });
        }
        let tails = |of_dye: Vec<Spectrum>| of_dye.into_iter().map(Tail::new).collect();
        Ok(Self { weights: weights.into_iter().map(tails).collect(), channels })
    }

    /// Shares `[channel, dye]` behind increasing edges, one less than there are channels; they add up to 1.
    ///
    /// # Errors
    /// [`ChoiceError::Dark`] for a dye that no channel sees.
    pub fn shares(&self, edges_nm: &[f64]) -> Result<Array2<f64>, ChoiceError> {
        let mut shares = Array2::zeros((self.channels, self.weights.len()));
        for (dye, of_dye) in self.weights.iter().enumerate() {
            for (channel, weight) in of_dye.iter().enumerate() {
                let begin = channel.checked_sub(1).and_then(|edge| edges_nm.get(edge));
                let above =
                    |edge: Option<&f64>, otherwise: f64| edge.map_or(otherwise, |&edge| weight.above(edge));
                let whole = weight.above(f64::NEG_INFINITY);
                shares[[channel, dye]] = above(begin, whole) - above(edges_nm.get(channel), 0.0);
            }
        }
        normalized(shares)
    }

    /// What edges are worth.
    ///
    /// # Errors
    /// [`ChoiceError`].
    pub fn merit(&self, order: usize, edges_nm: &[f64]) -> Result<Merit, ChoiceError> {
        Merit::of(order, &self.shares(edges_nm)?)
    }

    /// The merit of one edge at every `step_nm`, as in Figure S2b; two channels.
    ///
    /// # Errors
    /// [`ChoiceError::Range`] for a range without wavelengths, and those of [`EdgeSplit::merit`].
    pub fn sweep(
        &self,
        order: usize,
        range: EdgeRange,
        step_nm: f64,
    ) -> Result<Vec<(f64, Merit)>, ChoiceError> {
        let EdgeRange { from_nm, to_nm } = range.checked()?;
        let count = ((to_nm - from_nm) / step_nm + 1e-9).clamp(0.0, 1e5) as u32;
        let places = (0..=count).map(|k| from_nm + f64::from(k) * step_nm);
        places.map(|edge| Ok((edge, self.merit(order, &[edge])?))).collect()
    }

    /// The best edges in a range: all sets of a grid, then the best one step by step.
    ///
    /// # Errors
    /// [`ChoiceError::Range`] for a range without wavelengths, and those of [`EdgeSplit::merit`].
    pub fn best(
        &self,
        order: usize,
        range: EdgeRange,
        criterion: Criterion,
    ) -> Result<BestEdges, ChoiceError> {
        let range = range.checked()?;
        let mut best: Option<(f64, Vec<f64>)> = None;
        for edges in starts(range, self.channels - 1) {
            let value = value(order, &self.shares(&edges)?, criterion)?;
            if best.as_ref().is_none_or(|(most, _)| value > *most) {
                best = Some((value, edges));
            }
        }
        let (mut most, mut edges) = best.unwrap_or_default();
        for step in REFINEMENTS_NM {
            while let Some((better, moved)) = self.better(order, range, criterion, &edges, step, most)? {
                (most, edges) = (better, moved);
            }
        }
        let shares = self.shares(&edges)?;
        Ok(BestEdges { merit: Merit::of(order, &shares)?, shares, edges_nm: edges })
    }

    /// The best of all sets with one edge moved by a step, if it is better.
    fn better(
        &self,
        order: usize,
        range: EdgeRange,
        criterion: Criterion,
        edges: &[f64],
        step_nm: f64,
        most: f64,
    ) -> Result<Option<(f64, Vec<f64>)>, ChoiceError> {
        let mut best = None;
        let mut most = most;
        for place in 0..edges.len() {
            for by in [-step_nm, step_nm] {
                let mut moved = edges.to_vec();
                moved[place] += by;
                let is_inside = (range.from_nm..=range.to_nm).contains(&moved[place]);
                if !is_inside || !moved.is_sorted() {
                    continue;
                }
                let value = value(order, &self.shares(&moved)?, criterion)?;
                if value > most {
                    most = value;
                    best = Some((value, moved));
                }
            }
        }
        Ok(best)
    }
}

/// A spectrum with its integrals from each of its points to its end.
#[derive(Debug, Clone, PartialEq)]
struct Tail {
    spectrum: Spectrum,
    above: Vec<f64>,
}

impl Tail {
    fn new(spectrum: Spectrum) -> Self {
        let (places, values) = (spectrum.wavelengths_nm(), spectrum.values());
        let mut above = vec![0.0; places.len()];
        for k in (0..places.len() - 1).rev() {
            above[k] = above[k + 1] + 0.5 * (values[k] + values[k + 1]) * (places[k + 1] - places[k]);
        }
        Self { spectrum, above }
    }

    /// [`Spectrum::integral_above`] without another sum.
    fn above(&self, edge_nm: f64) -> f64 {
        let (places, values) = (self.spectrum.wavelengths_nm(), self.spectrum.values());
        match places.partition_point(|&place| place < edge_nm) {
            0 => self.above[0],
            next if next == places.len() => 0.0,
            next => {
                let rest = 0.5 * (self.spectrum.at(edge_nm) + values[next]) * (places[next] - edge_nm);
                self.above[next] + rest
            }
        }
    }
}

/// [`Merit::by`] with no more work than the criterion needs.
fn value(order: usize, shares: &ArrayRef2<f64>, criterion: Criterion) -> Result<f64, ChoiceError> {
    let matrix = mixture(order, shares)?;
    let values = SingularValues::of(&matrix).values;
    let smallest = values.last().copied().unwrap_or(0.0);
    Ok(match criterion {
        Criterion::Product => values.iter().product(),
        Criterion::SmallestSingularValue => smallest,
        Criterion::Noise if values[0] > MAX_CONDITION * smallest => 0.0,
        Criterion::Noise => {
            1.0 / pseudo_inverse(&matrix).row_iter().map(|row| row.norm()).fold(0.0, f64::max)
        }
    })
}

fn normalized(mut shares: Array2<f64>) -> Result<Array2<f64>, ChoiceError> {
    for (dye, mut column) in shares.columns_mut().into_iter().enumerate() {
        column.mapv_inplace(|share| share.max(0.0));
        let total = column.sum();
        if total.is_nan() || total <= 0.0 {
            return Err(ChoiceError::Dark { dye });
        }
        column.mapv_inplace(|share| (share / total).min(1.0));
    }
    Ok(shares)
}

/// Increasing sets of edges on a grid as fine as the limit allows.
fn starts(range: EdgeRange, edges: usize) -> Vec<Vec<f64>> {
    let span = range.to_nm - range.from_nm;
    let mut places = edges + 1;
    while sets(places + 1, edges) <= MOST_STARTS as f64 && (places as f64) <= span {
        places += 1;
    }
    let grid: Vec<f64> =
        (0..places).map(|k| range.from_nm + span * (k as f64 + 0.5) / places as f64).collect();
    let mut sets: Vec<Vec<usize>> = vec![Vec::new()];
    for chosen in 0..edges {
        let longer = sets.iter().flat_map(|set| {
            let next = set.last().map_or(0, |last| last + 1);
            // As many places stay free as edges are still to come.
            (next..=places - (edges - chosen)).map(move |place| [&set[..], &[place]].concat())
        });
        sets = longer.collect();
    }
    sets.into_iter().map(|set| set.into_iter().map(|place| grid[place]).collect()).collect()
}

/// `C(places, edges)`.
fn sets(places: usize, edges: usize) -> f64 {
    (0..edges).map(|k| (places - k) as f64 / (edges - k) as f64).product()
}
