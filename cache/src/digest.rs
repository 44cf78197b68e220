//! BLAKE3 digests, and the stable encoding of keys.
//!
//! A key is the digest of a sequence of typed values. `std::hash::Hash` is not fit for this: what it feeds to a hasher
//! may change between compiler versions, word sizes and byte orders. Here every value is written as one tag byte and a
//! fixed little-endian form, so equal values give equal keys everywhere, and values of different types or borders
//! (`"ab", "c"` and `"a", "bc"`) never meet.

use std::fmt;
use std::str::FromStr;

/// A BLAKE3 digest: the identity of a sequence of bytes.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Digest(pub [u8; 32]);

impl Digest {
    /// The digest of `bytes`, computed on the calling thread.
    pub fn of(bytes: &[u8]) -> Self {
        Self(*blake3::hash(bytes).as_bytes())
    }

    /// The 32 bytes.
    pub const fn as_bytes(&self) -> &[u8; 32] {
        &self.0
    }
}

impl fmt::Display for Digest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

impl fmt::Debug for Digest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Digest({self})")
    }
}

/// A text that is not a digest.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("not a digest: expected 64 hexadecimal digits, found {found:?}")]
pub struct ParseDigestError {
    /// The text, cut to its first 80 characters.
    pub found: String,
}

impl FromStr for Digest {
    type Err = ParseDigestError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let not_a_digest = || ParseDigestError { found: text.chars().take(80).collect() };
        let digits = text.as_bytes();
        if digits.len() != 64 {
            return Err(not_a_digest());
        }
        let mut bytes = [0; 32];
        for (byte, pair) in bytes.iter_mut().zip(digits.chunks_exact(2)) {
            let nibble = |digit: u8| char::from(digit).to_digit(16).ok_or_else(not_a_digest);
            *byte = u8::try_from(nibble(pair[0])? << 4 | nibble(pair[1])?).map_err(|_| not_a_digest())?;
        }
        Ok(Self(bytes))
    }
}

/// Digests bytes that arrive in pieces; the borders of the pieces leave no trace.
#[derive(Clone, Default)]
pub struct DigestBuilder(blake3::Hasher);

impl DigestBuilder {
    /// Of nothing, so far.
    pub fn new() -> Self {
        Self::default()
    }

    /// Appends `bytes`.
    pub fn update(&mut self, bytes: &[u8]) -> &mut Self {
        self.0.update(bytes);
        self
    }

    /// The digest of all bytes so far.
    pub fn finish(&self) -> Digest {
        Digest(*self.0.finalize().as_bytes())
    }
}

/// A value with a stable encoding, fit to be part of a key.
pub trait KeyPart {
    /// Writes the value. What is written, and its order, is part of every key on disk: changing it makes new keys.
    fn encode(&self, key: &mut KeyEncoder);
}

/// Builds the digest of a sequence of typed values.
///
/// ```
/// use manyview_cache::digest::KeyEncoder;
/// let mut key = KeyEncoder::new("manyview.step");
/// key.text("voxels").unsigned(3).sequence(2).float(0.5).float(1.5);
/// assert!(key.finish().to_string().starts_with("a81a9e59c7537562"), "on every machine");
/// ```
#[derive(Clone)]
pub struct KeyEncoder(DigestBuilder);

impl KeyEncoder {
    /// An empty key of a `domain`, a name that keeps keys for different purposes apart.
    pub fn new(domain: &str) -> Self {
        let mut key = Self(DigestBuilder::new());
        key.text(domain);
        key
    }

    /// Appends any value with a stable encoding.
    pub fn part(&mut self, value: &impl KeyPart) -> &mut Self {
        value.encode(self);
        self
    }

    /// Appends an unsigned integer of any width.
    pub fn unsigned(&mut self, value: u64) -> &mut Self {
        self.tagged(b'u', &value.to_le_bytes())
    }

    /// Appends a signed integer of any width. The signed and the unsigned 3 differ.
    pub fn signed(&mut self, value: i64) -> &mut Self {
        self.tagged(b'i', &value.to_le_bytes())
    }

    /// Appends a floating-point number; singles go in as the doubles they equal. Both zeros are the same value, and so are all NaNs.
    pub fn float(&mut self, value: f64) -> &mut Self {
        let canonical = if value == 0.0 {
            0.0
        } else if value.is_nan() {
            f64::from_bits(0x7ff8_0000_0000_0000)
        } else {
            value
        };
        self.tagged(b'f', &canonical.to_bits().to_le_bytes())
    }

    /// Appends a truth value.
    pub fn boolean(&mut self, value: bool) -> &mut Self {
        self.tagged(b'b', &[u8::from(value)])
    }

    /// Appends a text.
    pub fn text(&mut self, value: &str) -> &mut Self {
        self.tagged(b't', &(value.len() as u64).to_le_bytes());
        self.0.update(value.as_bytes());
        self
    }

    /// Appends bytes.
    pub fn bytes(&mut self, value: &[u8]) -> &mut Self {
        self.tagged(b'y', &(value.len() as u64).to_le_bytes());
        self.0.update(value);
        self
    }

    /// Appends a digest, such as that of another step's output.
    pub fn digest(&mut self, value: &Digest) -> &mut Self {
        self.tagged(b'd', &value.0)
    }

    /// Starts a sequence of `count` values; the values follow.
    pub fn sequence(&mut self, count: usize) -> &mut Self {
        self.tagged(b's', &(count as u64).to_le_bytes())
    }

    /// Appends the absence of an optional value.
    pub fn none(&mut self) -> &mut Self {
        self.tagged(b'n', &[])
    }

    /// The key.
    pub fn finish(&self) -> Digest {
        self.0.finish()
    }

    fn tagged(&mut self, tag: u8, value: &[u8]) -> &mut Self {
        self.0.update(&[tag]).update(value);
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// BLAKE3 of nothing, from the paper's test vectors.
    const OF_NOTHING: &str = "af1349b9f5f9a1a6a0404dea36dcc9499bcb25c9adc112b7cc9a93cae41f3262";

    #[test]
    fn the_digest_is_blake3_in_lowercase_hex() {
        assert_eq!(Digest::of(b"").to_string(), OF_NOTHING);
        assert_eq!(OF_NOTHING.parse(), Ok(Digest::of(b"")));
        assert_eq!(OF_NOTHING.to_uppercase().parse(), Ok(Digest::of(b"")));
        assert_eq!(DigestBuilder::new().update(b"ab").update(b"c").finish(), Digest::of(b"abc"));
    }

    #[test]
    fn other_texts_are_not_digests() {
        for text in ["", "af", &OF_NOTHING[1..], &format!("{OF_NOTHING}0"), &OF_NOTHING.replace('f', "g")] {
            let error = text.parse::<Digest>().unwrap_err();
            assert!(error.to_string().contains("64 hexadecimal digits"), "{error}");
        }
        // 64 bytes, but not 64 digits.
        assert!("é".repeat(32).parse::<Digest>().is_err());
        assert!(("+1".repeat(32)).parse::<Digest>().is_err());
    }

    #[test]
    fn a_key_is_the_digest_of_the_documented_bytes() {
        let mut key = KeyEncoder::new("k");
        key.unsigned(3).signed(-1).float(0.5).boolean(true).bytes(b"\0").none().sequence(7);
        let mut expected = vec![b't', 1, 0, 0, 0, 0, 0, 0, 0, b'k', b'u', 3, 0, 0, 0, 0, 0, 0, 0];
        expected.push(b'i');
        expected.extend([0xff; 8]);
        expected.extend([b'f', 0, 0, 0, 0, 0, 0, 0xe0, 0x3f, b'b', 1]);
        expected.extend([b'y', 1, 0, 0, 0, 0, 0, 0, 0, 0, b'n', b's', 7, 0, 0, 0, 0, 0, 0, 0]);
        assert_eq!(key.finish(), Digest::of(&expected));
    }

    #[test]
    fn borders_and_types_are_part_of_a_key() {
        let key = |build: &dyn Fn(&mut KeyEncoder)| {
            let mut key = KeyEncoder::new("k");
            build(&mut key);
            key.finish()
        };
        let keys = [
            key(&|k| _ = k.text("ab").text("c")),
            key(&|k| _ = k.text("a").text("bc")),
            key(&|k| _ = k.bytes(b"ab").bytes(b"c")),
            key(&|k| _ = k.unsigned(1)),
            key(&|k| _ = k.signed(1)),
            key(&|k| _ = k.float(1.0)),
            key(&|k| _ = k.boolean(true)),
            key(&|_| ()),
            key(&|k| _ = k.none()),
        ];
        for (i, a) in keys.iter().enumerate() {
            assert!(keys[..i].iter().all(|b| a != b), "key {i} is not its own");
        }
        assert_eq!(key(&|k| _ = k.float(0.0)), key(&|k| _ = k.float(-0.0)));
        assert_eq!(key(&|k| _ = k.float(f64::NAN)), key(&|k| _ = k.float(-f64::NAN)));
    }
}
