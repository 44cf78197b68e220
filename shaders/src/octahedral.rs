//! Unit vectors in two signed bytes, and cone angles in one.

/// Packs a unit vector octahedrally: each byte is 127 times a coordinate of the folded octahedron, rounded to nearest.
pub fn encode(n: [f64; 3]) -> [i8; 2] {
    let sum = n[0].abs() + n[1].abs() + n[2].abs();
    if sum <= 0.0 || !sum.is_finite() {
        return [0, 0];
    }
    let (mut x, mut y) = (n[0] / sum, n[1] / sum);
    if n[2] < 0.0 {
        (x, y) = ((1.0 - y.abs()) * sign(x), (1.0 - x.abs()) * sign(y));
    }
    [x, y].map(|c| (c * 127.0 + 0.5).floor() as i8)
}

/// Unpacks what [`encode`] packed; unit length.
pub fn decode(packed: [i8; 2]) -> [f64; 3] {
    let [mut x, mut y] = packed.map(|c| f64::from(c.max(-127)) / 127.0);
    let z = 1.0 - x.abs() - y.abs();
    if z < 0.0 {
        (x, y) = ((1.0 - y.abs()) * sign(x), (1.0 - x.abs()) * sign(y));
    }
    let length = (x * x + y * y + z * z).sqrt();
    [x / length, y / length, z / length]
}

/// Packs a cone's half angle given by its cosine: 255 times the sine of half of it, rounded up, so that the packed
/// cone contains the given one. 0 is a single direction, 255 all directions.
pub fn encode_cone(cos_half_angle: f64) -> u8 {
    (((1.0 - cos_half_angle).max(0.0) * 0.5).sqrt() * 255.0).ceil().min(255.0) as u8
}

/// Cosine of the half angle that [`encode_cone`] packed.
pub fn decode_cone(packed: u8) -> f64 {
    let sine = f64::from(packed) / 255.0;
    1.0 - 2.0 * sine * sine
}

fn sign(c: f64) -> f64 {
    if c < 0.0 { -1.0 } else { 1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn packed_normals_are_within_a_degree() {
        for i in 0..5000 {
            let z = 1.0 - 2.0 * (f64::from(i) + 0.5) / 5000.0;
            let (s, c) = crate::trig::sin_cos(f64::from(i) * 2.399_963);
            let r = (1.0 - z * z).sqrt();
            let n = [r * c, r * s, z];
            let d = decode(encode(n));
            let dot: f64 = (0..3).map(|i| n[i] * d[i]).sum();
            assert!(dot > 0.999_8, "{n:?} {d:?}");
        }
    }

    #[test]
    fn axes_are_exact_and_packing_is_idempotent() {
        for a in 0..3 {
            for s in [-1.0, 1.0] {
                let mut n = [0.0; 3];
                n[a] = s;
                assert_eq!(decode(encode(n)), n);
            }
        }
        for x in -127..=127i8 {
            for y in -127..=127i8 {
                let d = decode([x, y]);
                assert_eq!(decode(encode(d)), d);
            }
        }
    }

    #[test]
    fn packed_cones_contain_the_given_ones() {
        for i in 0..=1000 {
            let cos = f64::from(i) / 500.0 - 1.0;
            assert!(decode_cone(encode_cone(cos)) <= cos + 1e-12);
        }
        assert_eq!(encode_cone(1.0), 0);
        assert_eq!(encode_cone(-1.0), 255);
    }
}
