//! Polynomials in the channels: one coefficient per way to share the pixels of a tuple among the cameras.
//!
//! The product over the pixels of a tuple of `R + z T` has as coefficient of `z^u` the sum over all ways to take
//! `u` of the pixels from T (Eq. S2); with more channels it has one coefficient per monomial (Eq. S4).
//! Moments, cumulants and changes of reference are all products of such polynomials.
//!
//! In: number of channels and highest degree. Out: monomials, multiplicities, products.

/// How many pixels one polynomial coefficient is computed for at a time.
pub(super) const LANES: usize = 16;

/// One coefficient for [`LANES`] neighboring pixels.
pub(super) type Lanes = [f64; LANES];

/// A polynomial for [`LANES`] neighboring pixels; only the coefficients of its degree are in use.
pub(super) type Polynomial = Vec<Lanes>;

/// Monomials of every degree in a fixed number of channels, and how they multiply.
#[derive(Debug, Clone)]
pub(super) struct ChannelAlgebra {
    channels: usize,
    monomials: Vec<Vec<Vec<usize>>>,
    products: Vec<Vec<Vec<usize>>>,
}

impl ChannelAlgebra {
    pub(super) fn new(channels: usize, highest_degree: usize) -> Self {
        let monomials: Vec<_> = (0..=highest_degree).map(|degree| monomials(channels, degree)).collect();
        let products = (0..=highest_degree)
            .map(|a| (0..=highest_degree - a).map(|b| product_table(&monomials, a, b)).collect())
            .collect();
        Self { channels, monomials, products }
    }

    #[inline(always)]
    pub(super) fn channels(&self) -> usize {
        self.channels
    }

    /// Exponents of each channel in the monomials of one degree; with two channels `u` of T counts up from 0.
    pub(super) fn monomials(&self, degree: usize) -> &[Vec<usize>] {
        &self.monomials[degree]
    }

    /// Number of coefficients of one degree: `C(degree + channels - 1, channels - 1)` (Eq. 1).
    #[inline(always)]
    pub(super) fn coefficients(&self, degree: usize) -> usize {
        self.monomials[degree].len()
    }

    /// In how many ways the pixels of a tuple can be shared among the channels as the monomial says.
    pub(super) fn multiplicity(&self, degree: usize, coefficient: usize) -> f64 {
        let factorial = |n: usize| (1..=n).map(|k| k as f64).product::<f64>();
        let shares = self.monomials[degree][coefficient].iter().map(|&exponent| factorial(exponent));
        factorial(degree) / shares.product::<f64>()
    }

    /// Index of the monomial that is the product of coefficient `i` of degree `a` and `j` of degree `b`.
    #[inline(always)]
    pub(super) fn product_index(&self, a: usize, b: usize, i: usize, j: usize) -> usize {
        self.products[a][b][i * self.coefficients(b) + j]
    }

    /// `sum += factor * left * right`.
    #[inline(always)]
    pub(super) fn add_product(
        &self,
        (left, a): (&[Lanes], usize),
        (right, b): (&[Lanes], usize),
        factor: f64,
        sum: &mut [Lanes],
    ) {
        for (i, x) in left.iter().enumerate().take(self.coefficients(a)) {
            for (j, y) in right.iter().enumerate().take(self.coefficients(b)) {
                let target = if self.channels <= 2 { i + j } else { self.product_index(a, b, i, j) };
                for lane in 0..LANES {
                    sum[target][lane] += factor * x[lane] * y[lane];
                }
            }
        }
    }
}

/// All exponent vectors of one degree, the first channel's exponent falling.
fn monomials(channels: usize, degree: usize) -> Vec<Vec<usize>> {
    if channels == 1 {
        return vec![vec![degree]];
    }
    let with_first = |first: usize| {
        monomials(channels - 1, degree - first).into_iter().map(move |rest| {
            let mut exponents = vec![first];
            exponents.extend(rest);
            exponents
        })
    };
    (0..=degree).rev().flat_map(with_first).collect()
}

fn product_table(monomials: &[Vec<Vec<usize>>], a: usize, b: usize) -> Vec<usize> {
    let index_of = |left: &[usize], right: &[usize]| {
        let sum: Vec<usize> = left.iter().zip(right).map(|(i, j)| i + j).collect();
        let found = monomials[a + b].iter().position(|exponents| *exponents == sum);
        found.expect("the product of two monomials is a monomial of the summed degree")
    };
    monomials[a].iter().flat_map(|left| monomials[b].iter().map(move |right| index_of(left, right))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_channels_count_the_pixels_from_t() {
        let algebra = ChannelAlgebra::new(2, 4);
        assert_eq!(algebra.monomials(2), [vec![2, 0], vec![1, 1], vec![0, 2]]);
        let ways: Vec<f64> = (0..=4).map(|u| algebra.multiplicity(4, u)).collect();
        assert_eq!(ways, [1.0, 4.0, 6.0, 4.0, 1.0]);
    }

    #[test]
    fn products_of_three_channels_agree_with_exponents() {
        let algebra = ChannelAlgebra::new(3, 5);
        assert_eq!(algebra.coefficients(4), 15);
        for i in 0..algebra.coefficients(2) {
            for j in 0..algebra.coefficients(3) {
                let product = &algebra.monomials(5)[algebra.product_index(2, 3, i, j)];
                for (channel, exponent) in product.iter().enumerate() {
                    let sum = algebra.monomials(2)[i][channel] + algebra.monomials(3)[j][channel];
                    assert_eq!(*exponent, sum);
                }
            }
        }
    }
}
