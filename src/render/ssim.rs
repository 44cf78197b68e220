//! Structural similarity.
//!
//! # Theory
//! Z. Wang, A. Bovik, H. Sheikh, E. Simoncelli, *Image Quality Assessment: From Error Visibility to Structural
//! Similarity*, IEEE TIP 13(4), 2004, doi 10.1109/TIP.2003.819861: means, variances and covariance within a Gaussian
//! window of 11 × 11 pixels (σ = 1.5), K1 = 0.01, K2 = 0.03, dynamic range 1.
//!
//! # Practice
//! As in the authors' program, only windows that lie within the picture count. A window with a pixel that is not
//! finite does not count either.

use rayon::prelude::*;

/// Pixels a side of the window.
pub const WINDOW: usize = 11;
const SIGMA: f64 = 1.5;
const C1: f64 = 0.01 * 0.01;
const C2: f64 = 0.03 * 0.03;

/// Mean structural similarity of two pictures of values 0 … 1, row by row; `None` where no window fits.
///
/// # Panics
/// If the slices differ in length, or are no whole rows.
pub fn ssim(a: &[f32], b: &[f32], width: usize) -> Option<f64> {
    assert_eq!(a.len(), b.len(), "pictures of one size");
    let height = a.len().checked_div(width).unwrap_or(0);
    assert_eq!(width * height, a.len(), "whole rows");
    if width < WINDOW || height < WINDOW {
        return None;
    }
    let kernel = kernel();
    // Along rows first: a, b, a², b², ab, and whether all are finite.
    let columns = width - WINDOW + 1;
    let rows: Vec<Vec<Moments>> = (0..height)
        .into_par_iter()
        .map(|y| {
            let row = y * width..(y + 1) * width;
            let (a, b) = (&a[row.clone()], &b[row]);
            (0..columns)
                .map(|x| {
                    let window = kernel.iter().zip(&a[x..]).zip(&b[x..]);
                    window.map(|((&weight, &a), &b)| Moments::of(weight, a, b)).sum()
                })
                .collect()
        })
        .collect();
    // Sums of rows, added in order: the same whatever the threads do.
    let sums: Vec<(f64, u64)> = (0..height - WINDOW + 1)
        .into_par_iter()
        .map(|y| {
            let of_column = |x: usize| -> Moments {
                kernel.iter().zip(&rows[y..]).map(|(&weight, row)| row[x].weighted(weight)).sum()
            };
            let finite = (0..columns).map(of_column).map(Moments::similarity).filter(|s| s.is_finite());
            finite.fold((0.0, 0), |(sum, count), s| (sum + s, count + 1))
        })
        .collect();
    let (sum, count) = sums.into_iter().fold((0.0, 0), |(s, c), (sum, count)| (s + sum, c + count));
    (count > 0).then(|| sum / count as f64)
}

fn kernel() -> [f64; WINDOW] {
    let weight = |i: usize| (-(i as f64 - (WINDOW / 2) as f64).powi(2) / (2.0 * SIGMA * SIGMA)).exp();
    let weights: [f64; WINDOW] = std::array::from_fn(weight);
    let sum: f64 = weights.iter().sum();
    weights.map(|weight| weight / sum)
}

/// Weighted sums over a window: a, b, a², b², ab.
#[derive(Clone, Copy)]
struct Moments([f64; 5]);

impl Moments {
    fn of(weight: f64, a: f32, b: f32) -> Self {
        let (a, b) = (f64::from(a), f64::from(b));
        Self([a, b, a * a, b * b, a * b]).weighted(weight)
    }

    fn weighted(self, weight: f64) -> Self {
        Self(self.0.map(|sum| sum * weight))
    }

    /// NaN if anything in the window is.
    fn similarity(self) -> f64 {
        let [a, b, aa, bb, ab] = self.0;
        let (variance_a, variance_b, covariance) = (aa - a * a, bb - b * b, ab - a * b);
        (2.0 * a * b + C1) * (2.0 * covariance + C2) / ((a * a + b * b + C1) * (variance_a + variance_b + C2))
    }
}

impl std::iter::Sum for Moments {
    fn sum<I: Iterator<Item = Self>>(moments: I) -> Self {
        moments.fold(Self([0.0; 5]), |sum, m| Self(std::array::from_fn(|i| sum.0[i] + m.0[i])))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::Random;

    fn noise(seed: u64, count: usize) -> Vec<f32> {
        let mut random = Random::new(seed);
        (0..count).map(|_| random.unit() as f32).collect()
    }

    /// The definition, written down: weighted means, then weighted deviations from them.
    fn by_definition(a: &[f32], b: &[f32], width: usize) -> f64 {
        let height = a.len() / width;
        let (mut sum, mut count) = (0.0, 0.0);
        for y in 5..height - 5 {
            for x in 5..width - 5 {
                let window: Vec<(f64, f64, f64)> = (0..121)
                    .map(|i| {
                        let (dx, dy) = (i % 11, i / 11);
                        let distance2 = (dx as f64 - 5.0).powi(2) + (dy as f64 - 5.0).powi(2);
                        let at = (y + dy - 5) * width + x + dx - 5;
                        ((-distance2 / 4.5).exp(), f64::from(a[at]), f64::from(b[at]))
                    })
                    .collect();
                let total: f64 = window.iter().map(|(w, ..)| w).sum();
                let mean = |f: &dyn Fn(f64, f64) -> f64| {
                    window.iter().map(|&(w, a, b)| w * f(a, b)).sum::<f64>() / total
                };
                let (ma, mb) = (mean(&|a, _| a), mean(&|_, b| b));
                let va = mean(&|a, _| (a - ma).powi(2));
                let vb = mean(&|_, b| (b - mb).powi(2));
                let cov = mean(&|a, b| (a - ma) * (b - mb));
                sum += (2.0 * ma * mb + C1) * (2.0 * cov + C2) / ((ma * ma + mb * mb + C1) * (va + vb + C2));
                count += 1.0;
            }
        }
        sum / count
    }

    #[test]
    fn it_is_what_its_definition_says() {
        let (a, noise_b) = (noise(1, 23 * 17), noise(2, 23 * 17));
        let b: Vec<f32> = a.iter().zip(&noise_b).map(|(a, b)| a * 0.7 + b * 0.3).collect();
        let expected = by_definition(&a, &b, 23);
        assert!((0.3..0.95).contains(&expected), "{expected}");
        assert!((ssim(&a, &b, 23).unwrap() - expected).abs() < 1e-9);
    }

    #[test]
    fn known_answers() {
        let a = noise(3, 400);
        assert!((ssim(&a, &a, 20).unwrap() - 1.0).abs() < 1e-12);
        // Of flat pictures only the means differ.
        let (p, q) = (0.2, 0.6);
        let expected = (2.0 * p * q + C1) / (p * p + q * q + C1);
        let found = ssim(&[p as f32; 121], &[q as f32; 121], 11).unwrap();
        assert!((found - expected).abs() < 1e-6, "{found} {expected}");
        let negative: Vec<f32> = a.iter().map(|v| 1.0 - v).collect();
        assert!(ssim(&a, &negative, 20).unwrap() < -0.5, "structure turned round");
    }

    #[test]
    fn windows_must_fit_and_be_finite() {
        assert_eq!(ssim(&[0.5; 10 * 30], &[0.5; 10 * 30], 10), None);
        assert_eq!(ssim(&[], &[], 0), None);
        let mut a = noise(4, 11 * 12);
        a[5] = f32::NAN;
        assert_eq!(ssim(&a, &noise(5, 132), 12), None);
        let mut wide = noise(6, 11 * 30);
        let b = noise(7, 11 * 30);
        wide[0] = f32::INFINITY;
        assert!(ssim(&wide, &b, 30).unwrap().is_finite());
    }
}
