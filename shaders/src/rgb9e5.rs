//! Three non-negative numbers with a shared exponent in 32 bits (the GPU's `rgb9e5` texel).
//!
//! Bits 0–8, 9–17, 18–26: mantissas of r, g, b; bits 27–31: exponent e; value = mantissa · 2^(e − 24).

/// Largest value there is: 511 · 2^7.
pub const MAX: f64 = 65408.0;

/// Packs r, g, b, clamped to 0 ..= [`MAX`] and rounded to nearest; NaN becomes 0.
pub fn encode(rgb: [f64; 3]) -> u32 {
    let rgb = rgb.map(|c| if c > 0.0 { c.min(MAX) } else { 0.0 });
    let largest = rgb[0].max(rgb[1]).max(rgb[2]);
    // Smallest exponent whose 9-bit mantissa holds the largest after rounding.
    let mut exponent = 0u32;
    let mut step = 1.0 / f64::from(1u32 << 24);
    while largest >= 511.5 * step && exponent < 31 {
        exponent += 1;
        step *= 2.0;
    }
    let mantissa = rgb.map(|c| ((c / step + 0.5).floor() as u32).min(511));
    mantissa[0] | mantissa[1] << 9 | mantissa[2] << 18 | exponent << 27
}

/// Unpacks r, g, b.
pub fn decode(packed: u32) -> [f64; 3] {
    let step = f64::from(1u32 << (packed >> 27)) / f64::from(1u32 << 24);
    [packed & 511, packed >> 9 & 511, packed >> 18 & 511].map(|m| f64::from(m) * step)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_round_trip_within_a_part_in_500() {
        for i in 0..2000u32 {
            let v = f64::from(i * i) * 0.0137;
            let rgb = [v, v * 0.5, v * 0.001];
            let back = decode(encode(rgb));
            for c in 0..3 {
                assert!((rgb[c] - back[c]).abs() <= v / 500.0 + 1e-7, "{rgb:?} {back:?}");
            }
        }
        assert_eq!(encode([0.0, -1.0, f64::NAN]), 0);
        assert_eq!(decode(encode([1e30, 0.0, 1.0]))[0], MAX);
    }

    #[test]
    fn packing_is_idempotent() {
        for i in 0..100_000u32 {
            let packed = i.wrapping_mul(2_654_435_761);
            let once = encode(decode(packed));
            assert_eq!(encode(decode(once)), once);
        }
    }
}
