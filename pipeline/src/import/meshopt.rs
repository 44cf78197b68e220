//! `EXT_meshopt_compression` and `KHR_meshopt_compression`: buffer views packed by meshoptimizer.
//!
//! The entropy decoders are meshoptimizer's own, which are made for untrusted input. The filters after them are here:
//! meshoptimizer's differ in their last bits between instruction sets, and the bake must not.

use super::error::ImportError;
use super::json::Json;

/// How a buffer view is packed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Mode {
    Attributes,
    Triangles,
    Indices,
}

/// What is done to attributes after unpacking.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Filter {
    None,
    Octahedral,
    Quaternion,
    Exponential,
    Color,
}

/// One buffer view to unpack; its numbers are checked against what the packed bytes can hold.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Job {
    mode: Mode,
    filter: Filter,
    count: usize,
    stride: usize,
}

impl Job {
    /// Reads the extension object of a buffer view that has `encoded_bytes` of packed data.
    pub(super) fn parse(extension: &Json<'_>, encoded_bytes: usize) -> Result<Self, ImportError> {
        let count = extension.required_index("count")?;
        let stride = extension.required_index("byteStride")?;
        let mode = match extension.string("mode")? {
            Some("ATTRIBUTES") => Mode::Attributes,
            Some("TRIANGLES") => Mode::Triangles,
            Some("INDICES") => Mode::Indices,
            _ => return Err(extension.malformed_at("mode", "must be ATTRIBUTES, TRIANGLES or INDICES")),
        };
        let filter = match extension.string("filter")? {
            None | Some("NONE") => Filter::None,
            Some("OCTAHEDRAL") => Filter::Octahedral,
            Some("QUATERNION") => Filter::Quaternion,
            Some("EXPONENTIAL") => Filter::Exponential,
            Some("COLOR") => Filter::Color,
            Some(other) => {
                return Err(extension.malformed_at("filter", format!("\"{other}\" is no known filter")));
            }
        };
        let stride_fits = match (mode, filter) {
            (Mode::Attributes, Filter::None | Filter::Exponential) => {
                stride.is_multiple_of(4) && (4..=256).contains(&stride)
            }
            (Mode::Attributes, Filter::Octahedral | Filter::Color) => stride == 4 || stride == 8,
            (Mode::Attributes, Filter::Quaternion) => stride == 8,
            (_, Filter::None) => stride == 2 || stride == 4,
            _ => return Err(extension.malformed_at("filter", "applies to the mode ATTRIBUTES only")),
        };
        if !stride_fits {
            return Err(
                extension.malformed_at("byteStride", format!("{stride} does not fit the mode and filter"))
            );
        }
        if mode == Mode::Triangles && !count.is_multiple_of(3) {
            return Err(extension.malformed_at("count", format!("{count} is not divisible by 3")));
        }
        // The least that each codec spends: a byte a triangle or index; two bits for 16 bytes of an attribute in blocks of
        // at least 16 elements, where constant channels of version 1 cost nothing but a quarter byte each and block.
        let possible = match mode {
            Mode::Triangles => count / 3 + 17 <= encoded_bytes,
            Mode::Indices => count.saturating_add(5) <= encoded_bytes,
            Mode::Attributes => {
                count.saturating_mul(stride) <= encoded_bytes.saturating_mul(1024).saturating_add(8192)
            }
        };
        if !possible {
            return Err(extension
                .malformed_at("count", format!("{count} elements cannot come from {encoded_bytes} bytes")));
        }
        Ok(Self { mode, filter, count, stride })
    }

    /// Size of the unpacked data.
    pub(super) fn decoded_bytes(&self) -> u64 {
        self.count as u64 * self.stride as u64
    }

    /// Unpacks `encoded`, or tells what is wrong with it.
    pub(super) fn decode(&self, encoded: &[u8]) -> Result<Vec<u8>, String> {
        let mut bytes = match (self.mode, self.stride) {
            (Mode::Triangles, 2) => meshopt::decode_index_buffer::<u16>(encoded, self.count).map(words_16),
            (Mode::Triangles, _) => meshopt::decode_index_buffer::<u32>(encoded, self.count).map(words_32),
            (Mode::Indices, 2) => meshopt::decode_index_sequence::<u16>(encoded, self.count).map(words_16),
            (Mode::Indices, _) => meshopt::decode_index_sequence::<u32>(encoded, self.count).map(words_32),
            (Mode::Attributes, stride) => decode_attributes(encoded, self.count, stride),
        }
        .map_err(|error| format!("its packed data is broken: {error}"))?;
        match (self.filter, self.stride) {
            (Filter::None, _) => {}
            (Filter::Octahedral, 4) => bytes.as_chunks_mut::<4>().0.iter_mut().for_each(octahedral_8),
            (Filter::Octahedral, _) => words(&mut bytes, octahedral_16),
            (Filter::Quaternion, _) => words(&mut bytes, quaternion),
            (Filter::Exponential, _) => bytes.as_chunks_mut::<4>().0.iter_mut().for_each(exponential),
            (Filter::Color, 4) => bytes.as_chunks_mut::<4>().0.iter_mut().for_each(color_8),
            (Filter::Color, _) => words(&mut bytes, color_16),
        }
        Ok(bytes)
    }
}

fn words_16(words: Vec<u16>) -> Vec<u8> {
    words.into_iter().flat_map(u16::to_le_bytes).collect()
}

fn words_32(words: Vec<u32>) -> Vec<u8> {
    words.into_iter().flat_map(u32::to_le_bytes).collect()
}

/// The decoder takes the element size as a type; these are all sizes that the extension allows.
fn decode_attributes(encoded: &[u8], count: usize, stride: usize) -> meshopt::Result<Vec<u8>> {
    /// As long as one element, with a default value, which large arrays lack.
    #[derive(Clone, Copy)]
    struct Quads<const N: usize>([[u8; 4]; N]);
    impl<const N: usize> Default for Quads<N> {
        fn default() -> Self {
            Self([[0; 4]; N])
        }
    }
    macro_rules! by_stride {
        ($($quads:literal)*) => {
            match stride / 4 {
                $($quads => {
                    let elements = meshopt::decode_vertex_buffer::<Quads<$quads>>(encoded, count)?;
                    Ok(elements.iter().flat_map(|element| element.0.as_flattened()).copied().collect())
                })*
                _ => unreachable!("the stride was checked when the job was parsed"),
            }
        };
    }
    by_stride!(1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 19 20 21 22 23 24 25 26 27 28 29 30 31 32
        33 34 35 36 37 38 39 40 41 42 43 44 45 46 47 48 49 50 51 52 53 54 55 56 57 58 59 60 61 62 63 64)
}

/// Applies `filter` to every four 16-bit words.
fn words(bytes: &mut [u8], filter: impl Fn([i16; 4]) -> [i16; 4]) {
    for element in bytes.as_chunks_mut::<8>().0 {
        let mut input = [0; 4];
        for (word, bytes) in input.iter_mut().zip(element.as_chunks::<2>().0) {
            *word = i16::from_le_bytes(*bytes);
        }
        for (bytes, word) in element.as_chunks_mut::<2>().0.iter_mut().zip(filter(input)) {
            *bytes = word.to_le_bytes();
        }
    }
}

/// Half away from zero; saturates, and makes zero of what is no number.
fn round(x: f32) -> i32 {
    (x + if x >= 0.0 { 0.5 } else { -0.5 }) as i32
}

/// Unit vector of octahedral coordinates, where `one` stands for 1 at the precision of x and y.
fn octahedral([x, y, one]: [f32; 3], largest: f32) -> [i32; 3] {
    let z = one - x.abs() - y.abs();
    let fold = z.min(0.0);
    let x = x + if x >= 0.0 { fold } else { -fold };
    let y = y + if y >= 0.0 { fold } else { -fold };
    let scale = largest / (x * x + y * y + z * z).sqrt();
    [round(x * scale), round(y * scale), round(z * scale)]
}

fn octahedral_8(element: &mut [u8; 4]) {
    let [x, y, one, _] = element.map(|byte| f32::from(byte as i8));
    for (byte, value) in element.iter_mut().zip(octahedral([x, y, one], 127.0)) {
        *byte = value as i8 as u8;
    }
}

fn octahedral_16([x, y, one, w]: [i16; 4]) -> [i16; 4] {
    let [x, y, z] = octahedral([f32::from(x), f32::from(y), f32::from(one)], 32767.0);
    [x as i16, y as i16, z as i16, w]
}

/// Three components and the position of the largest one, which follows from them.
fn quaternion(input: [i16; 4]) -> [i16; 4] {
    let scale = std::f32::consts::FRAC_1_SQRT_2 / f32::from(input[3] | 3);
    let [x, y, z] = [input[0], input[1], input[2]].map(|value| f32::from(value) * scale);
    let largest = (1.0 - x * x - y * y - z * z).max(0.0).sqrt();
    let position = (input[3] & 3) as usize;
    let mut output = [0; 4];
    for (step, value) in [largest, x, y, z].into_iter().enumerate() {
        output[(position + step) & 3] = round(value * 32767.0) as i16;
    }
    output
}

/// A number of 24 bits mantissa and 8 bits exponent, both signed.
fn exponential(element: &mut [u8; 4]) {
    let packed = i32::from_le_bytes(*element);
    let mantissa = (packed << 8) >> 8;
    let power = f64::from_bits(((packed >> 24) + 1023) as u64 * (1 << 52));
    *element = ((f64::from(mantissa) * power) as f32).to_le_bytes();
}

/// YCoCg and alpha to RGBA; the highest bit of alpha tells how many bits there are.
fn color(luma: i32, orange: i32, green: i32, alpha: i32, largest: f32) -> [i32; 4] {
    let mut ones = alpha;
    for shift in [1, 2, 4, 8] {
        ones |= ones >> shift;
    }
    let alpha = ((alpha << 1) & ones) | (alpha & 1);
    let scale = largest / ones as f32;
    [luma + orange - green, luma + green, luma - orange - green, alpha]
        .map(|value| (value as f32 * scale + 0.5).clamp(0.0, largest) as i32)
}

fn color_8(element: &mut [u8; 4]) {
    let [luma, orange, green, alpha] = *element;
    let rgba = color(luma.into(), (orange as i8).into(), (green as i8).into(), alpha.into(), 255.0);
    *element = rgba.map(|value| value as u8);
}

fn color_16([luma, orange, green, alpha]: [i16; 4]) -> [i16; 4] {
    let rgba = color((luma as u16).into(), orange.into(), green.into(), (alpha as u16).into(), 65535.0);
    rgba.map(|value| value as u16 as i16)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn job(json: &serde_json::Value, bytes: usize) -> Result<Job, String> {
        Job::parse(&Json::root("s.gltf", json), bytes).map_err(|error| error.to_string())
    }

    #[test]
    fn attributes_come_back() {
        let elements: Vec<[u32; 3]> = (0..1000).map(|i| [i, i * i, 7]).collect();
        let encoded = meshopt::encode_vertex_buffer(&elements).unwrap();
        let json = json!({"count": 1000, "byteStride": 12, "mode": "ATTRIBUTES"});
        let decoded = job(&json, encoded.len()).unwrap().decode(&encoded).unwrap();
        assert_eq!(decoded, bytemuck::cast_slice::<_, u8>(&elements));
    }

    #[test]
    fn triangles_come_back_up_to_rotation() {
        let indices = [0, 1, 2, 2, 1, 3, 4, 6, 5, 7, 8, 9];
        let encoded = meshopt::encode_index_buffer(&indices, 10).unwrap();
        for stride in [2_usize, 4] {
            let json = json!({"count": 12, "byteStride": stride, "mode": "TRIANGLES"});
            let decoded = job(&json, encoded.len()).unwrap().decode(&encoded).unwrap();
            let decoded: Vec<u32> = decoded.chunks(stride).map(|word| u32::from(word[0])).collect();
            for (before, after) in indices.as_chunks::<3>().0.iter().zip(decoded.as_chunks::<3>().0) {
                let rotated = (0..3).any(|by| (0..3).all(|i| before[(i + by) % 3] == after[i]));
                assert!(rotated, "{before:?} became {after:?}");
            }
        }
    }

    #[test]
    fn filters_agree_with_meshoptimizer_within_one_step() {
        let mut ours: Vec<u8> = Vec::new();
        let mut theirs: Vec<[i16; 4]> = Vec::new();
        for i in 0..200_i32 {
            let x = (i * 37 % 400 - 200) as i16;
            let element = [x, ((i * 91) % (401 - i32::from(x.abs()) * 2).max(1)) as i16, 511, i as i16];
            theirs.push(element);
            ours.extend(element.iter().flat_map(|word| word.to_le_bytes()));
        }
        let mut ours_quaternion = ours.clone();
        let mut theirs_quaternion = theirs.clone();
        words(&mut ours, octahedral_16);
        meshopt::decode_filter_oct(&mut theirs);
        words(&mut ours_quaternion, quaternion);
        meshopt::decode_filter_quat(&mut theirs_quaternion);
        for (ours, theirs) in [(ours, theirs), (ours_quaternion, theirs_quaternion)] {
            for (ours, theirs) in ours.as_chunks::<2>().0.iter().zip(theirs.as_flattened()) {
                let ours = i16::from_le_bytes(*ours);
                assert!((i32::from(ours) - i32::from(*theirs)).abs() <= 1, "{ours} and {theirs}");
            }
        }
    }

    #[test]
    fn exponents_are_powers_of_two() {
        let decoded = |packed: u32| {
            let mut element = packed.to_le_bytes();
            exponential(&mut element);
            f32::from_le_bytes(element)
        };
        assert_eq!(decoded(0x0000_0001), 1.0);
        assert_eq!(decoded(0xFF00_0003), 1.5);
        assert_eq!(decoded(0x02FF_FFFF), -4.0);
    }

    #[test]
    fn grey_stays_grey() {
        // Eight bits of luma, no chroma, alpha one.
        assert_eq!(color(100, 0, 0, 255, 255.0), [100, 100, 100, 255]);
        // Seven bits: luma 127 of 127 is white.
        assert_eq!(color(127, 0, 0, 0b100_0000 | 63, 255.0), [255, 255, 255, 255]);
    }

    #[test]
    fn claims_beyond_the_data_are_refused_before_they_are_allocated() {
        for mode in ["ATTRIBUTES", "TRIANGLES", "INDICES"] {
            let json = json!({"count": 3_000_000_000_u64, "byteStride": 4, "mode": mode});
            let message = job(&json, 100).unwrap_err();
            assert!(message.contains("cannot come from 100 bytes"), "{message}");
        }
    }

    #[test]
    fn every_truncation_and_flipped_byte_is_survived() {
        let elements: Vec<[u16; 4]> = (0..300).map(|i| [i, 300 - i, 511, i * 7]).collect();
        let encoded = meshopt::encode_vertex_buffer(&elements).unwrap();
        let json = json!({"count": 300, "byteStride": 8, "mode": "ATTRIBUTES", "filter": "OCTAHEDRAL"});
        for end in 0..encoded.len() {
            if let Ok(job) = job(&json, end) {
                assert!(job.decode(&encoded[..end]).is_err(), "cut at {end}");
            }
        }
        for at in 0..encoded.len() {
            let mut broken = encoded.clone();
            broken[at] ^= 0xA5;
            let _either = job(&json, broken.len()).unwrap().decode(&broken);
        }
    }
}
