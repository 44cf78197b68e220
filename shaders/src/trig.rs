//! Sine and cosine that give the same bits on every host.
//!
//! The standard library calls the platform's libm, whose last bit differs between systems. Here only IEEE additions,
//! subtractions, multiplications, divisions and `floor` are used, all of which are exactly defined. The argument is
//! reduced to [-π/4, π/4] by multiples of π/2 kept in three parts (Cody and Waite, *Software Manual for the Elementary
//! Functions*, 1980), then both Taylor series are summed.

/// π/2 to 33 bits: its product with an integer below 2²⁰ is exact.
const HALF_PI_HIGH: f64 = f64::from_bits(0x3ff9_21fb_5440_0000);
/// The next 33 bits of π/2.
const HALF_PI_MIDDLE: f64 = f64::from_bits(0x3dd0_b461_1a60_0000);
/// What remains of π/2, rounded.
const HALF_PI_LOW: f64 = f64::from_bits(0x3ba3_198a_2e03_7073);

/// Largest magnitude of an argument of [`sin_cos`], radians.
pub const MAX_RADIANS: f64 = 1.0e6;

/// Sine and cosine of an angle in radians, each within about 2e-16 of the true value.
///
/// Both are NaN where the angle is not finite or beyond [`MAX_RADIANS`] in magnitude.
///
/// ```
/// assert_eq!(manyview_shaders::trig::sin_cos(0.0), (0.0, 1.0));
/// ```
pub fn sin_cos(radians: f64) -> (f64, f64) {
    // Written so that NaN is refused too.
    if !(-MAX_RADIANS..=MAX_RADIANS).contains(&radians) {
        return (f64::NAN, f64::NAN);
    }
    let quarter_turns = (radians * std::f64::consts::FRAC_2_PI + 0.5).floor();
    let high = radians - quarter_turns * HALF_PI_HIGH;
    let middle = quarter_turns * HALF_PI_MIDDLE;
    let partial = high - middle;
    // What rounding lost in the line above, and the rest of the subtrahend.
    let low = quarter_turns * HALF_PI_LOW - ((high - partial) - middle);
    let angle = partial - low;
    let tail = (partial - angle) - low;
    let (sin, cos) = small_sin_cos(angle, tail);
    rotate_quarter_turns((quarter_turns as i64).rem_euclid(4), sin, cos)
}

/// Sine and cosine of `numerator / denominator` turns, reduced in integers: multiples of a quarter turn are exact, and
/// angles that differ by whole turns give the same bits.
///
/// Both are NaN where `denominator` is 0.
///
/// ```
/// assert_eq!(manyview_shaders::trig::sin_cos_turns(1, 4), (1.0, 0.0));
/// ```
pub fn sin_cos_turns(numerator: u32, denominator: u32) -> (f64, f64) {
    if denominator == 0 {
        return (f64::NAN, f64::NAN);
    }
    let denominator = i64::from(denominator);
    let numerator = i64::from(numerator) % denominator;
    let quarter_turns = (8 * numerator + denominator) / (2 * denominator);
    let rest = (4 * numerator - quarter_turns * denominator) as f64 / denominator as f64;
    let (sin, cos) = small_sin_cos(rest * std::f64::consts::FRAC_PI_2, 0.0);
    rotate_quarter_turns(quarter_turns % 4, sin, cos)
}

/// Adds `quarter_turns` (0 to 3) to the angle whose sine and cosine are given.
fn rotate_quarter_turns(quarter_turns: i64, sin: f64, cos: f64) -> (f64, f64) {
    // Zero minus, unlike negation, never makes a negative zero of zero.
    match quarter_turns {
        0 => (sin, cos),
        1 => (cos, 0.0 - sin),
        2 => (0.0 - sin, 0.0 - cos),
        _ => (0.0 - cos, sin),
    }
}

/// Sine and cosine of `angle + tail`, where |angle| ≤ π/4 and `tail` is below half a unit in the last place of it.
fn small_sin_cos(angle: f64, tail: f64) -> (f64, f64) {
    // Coefficients of the Taylor series in angle²; the first term left out is below 1e-19.
    const SIN: [f64; 8] = [
        -1.0 / 6.0,
        1.0 / 120.0,
        -1.0 / 5_040.0,
        1.0 / 362_880.0,
        -1.0 / 39_916_800.0,
        1.0 / 6_227_020_800.0,
        -1.0 / 1_307_674_368_000.0,
        1.0 / 355_687_428_096_000.0,
    ];
    const COS: [f64; 8] = [
        1.0 / 24.0,
        -1.0 / 720.0,
        1.0 / 40_320.0,
        -1.0 / 3_628_800.0,
        1.0 / 479_001_600.0,
        -1.0 / 87_178_291_200.0,
        1.0 / 20_922_789_888_000.0,
        -1.0 / 6_402_373_705_728_000.0,
    ];
    let square = angle * angle;
    let horner = |coefficients: &[f64]| coefficients.iter().rev().fold(0.0, |sum, c| sum * square + c);
    let sin = angle + (angle * square * horner(&SIN) + tail * (1.0 - 0.5 * square));
    let half_square = 0.5 * square;
    let leading = 1.0 - half_square;
    // `1 - leading - half_square` is what the subtraction above rounded away.
    let cos = leading + (((1.0 - leading) - half_square) + (square * square * horner(&COS) - angle * tail));
    (sin, cos)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[allow(clippy::disallowed_methods, reason = "the standard library is the judge here")]
    fn assert_near_std(radians: f64) {
        let (sin, cos) = sin_cos(radians);
        let (std_sin, std_cos) = (radians.sin(), radians.cos());
        assert!((sin - std_sin).abs() <= 3e-16, "sin({radians}) = {sin}, std {std_sin}");
        assert!((cos - std_cos).abs() <= 3e-16, "cos({radians}) = {cos}, std {std_cos}");
    }

    #[test]
    fn agrees_with_the_standard_library_over_the_whole_range() {
        for i in -20_000..=20_000 {
            assert_near_std(f64::from(i) * 49.998_765_432_1);
            assert_near_std(f64::from(i) * 1.0e-3);
            assert_near_std(f64::from(i) * 1.0e-9);
        }
        for i in -636_000..=636_000 {
            if i % 97 == 0 {
                // Next to multiples of π/2, where the reduction cancels most.
                assert_near_std(f64::from(i) * std::f64::consts::FRAC_PI_2);
                assert_near_std((f64::from(i) + 0.5) * std::f64::consts::FRAC_PI_2);
            }
        }
        assert_near_std(MAX_RADIANS);
        assert_near_std(-MAX_RADIANS);
    }

    #[test]
    fn refuses_what_it_cannot_reduce() {
        for radians in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1.000_001e6, -1.0e300] {
            let (sin, cos) = sin_cos(radians);
            assert!(sin.is_nan() && cos.is_nan());
        }
        assert!(sin_cos_turns(1, 0).0.is_nan());
    }

    #[test]
    fn quarter_turns_are_exact() {
        let expected = [(0.0, 1.0), (1.0, 0.0), (0.0, -1.0), (-1.0, 0.0)];
        for i in 0..16_u32 {
            assert_eq!(sin_cos_turns(i, 4), expected[i as usize % 4]);
            assert_eq!(sin_cos_turns(i * 90, 360), expected[i as usize % 4]);
        }
    }

    #[test]
    fn turns_agree_with_radians() {
        for denominator in [1, 2, 3, 7, 8, 90, 360, 4_096, 1_000_003, u32::MAX] {
            for i in 0..200_u32 {
                let numerator = i.wrapping_mul(2_654_435_761) % denominator;
                let radians = f64::from(numerator) / f64::from(denominator) * std::f64::consts::TAU;
                let (sin, cos) = sin_cos_turns(numerator, denominator);
                let (sin_radians, cos_radians) = sin_cos(radians);
                // The angle in radians is itself rounded, by at most a few units of 2⁻⁵¹.
                assert!((sin - sin_radians).abs() < 1.5e-15);
                assert!((cos - cos_radians).abs() < 1.5e-15);
            }
        }
    }

    /// Frozen bits: a change here changes every archive.
    #[test]
    fn bits_are_frozen() {
        let (sin, cos) = sin_cos(1.0);
        assert_eq!((sin.to_bits(), cos.to_bits()), (0x3fea_ed54_8f09_0cee, 0x3fe1_4a28_0fb5_068c));
    }
}
