//! NumPy's array files: what `numpy.save` and `numpy.load` write and read.
//!
//! Written as version 1.0; read in versions 1.0, 2.0 and 3.0 ([`ArrayReader`]), piece by piece, so that neither takes
//! more memory than the caller's buffer. Arrays are in C order (last axis fastest) and little-endian.

mod header;
mod read;

pub use header::{Header, HeaderProblem};
pub use read::{ArrayReader, ReadError};

use std::io::{self, Write};

/// A type that an array file can hold.
pub trait Element: bytemuck::Pod {
    /// NumPy's name of the type, byte order included.
    const DESCR: &'static str;
    /// What people call it.
    const NAME: &'static str;
}

impl Element for i32 {
    const DESCR: &'static str = "<i4";
    const NAME: &'static str = "int32";
}

impl Element for u32 {
    const DESCR: &'static str = "<u4";
    const NAME: &'static str = "uint32";
}

impl Element for u8 {
    const DESCR: &'static str = "|u1";
    const NAME: &'static str = "uint8";
}

impl Element for f32 {
    const DESCR: &'static str = "<f4";
    const NAME: &'static str = "float32";
}

/// Writes the header of a C-ordered array of `shape`. The elements follow, last axis fastest.
pub fn write_header<T: Element>(file: &mut impl Write, shape: &[usize]) -> io::Result<()> {
    let mut text = format!("{{'descr': '{}', 'fortran_order': False, 'shape': (", T::DESCR);
    for size in shape {
        text.push_str(&format!("{size}, "));
    }
    // Python's tuples: `(5, 3)`, but `(5,)`.
    if shape.len() > 1 {
        text.truncate(text.len() - 2);
    } else if shape.len() == 1 {
        text.truncate(text.len() - 1);
    }
    text.push_str("), }");
    // The elements begin at a multiple of 64; the header ends in a line feed.
    let unpadded = 10 + text.len() + 1;
    text.push_str(&" ".repeat(unpadded.next_multiple_of(64) - unpadded));
    text.push('\n');
    file.write_all(b"\x93NUMPY\x01\x00")?;
    file.write_all(&u16::try_from(text.len()).map_err(io::Error::other)?.to_le_bytes())?;
    file.write_all(text.as_bytes())
}

/// Writes elements behind a header, on little-endian machines as they are in memory.
pub fn write_elements<T: Element>(file: &mut impl Write, elements: &[T]) -> io::Result<()> {
    file.write_all(bytemuck::cast_slice(elements))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_array_has_numpys_bytes() {
        let mut file = Vec::new();
        write_header::<i32>(&mut file, &[2, 3]).unwrap();
        write_elements(&mut file, &[1, 2, 3, 4, 5, -1]).unwrap();
        let mut expected =
            b"\x93NUMPY\x01\x00v\x00{'descr': '<i4', 'fortran_order': False, 'shape': (2, 3), }".to_vec();
        expected.resize(127, b' ');
        expected.push(b'\n');
        for value in [1i32, 2, 3, 4, 5, -1] {
            expected.extend(value.to_le_bytes());
        }
        assert_eq!(file, expected);
    }

    #[test]
    fn shapes_are_python_tuples() {
        for (shape, tuple) in [(&[][..], "()"), (&[5], "(5,)"), (&[0, 3], "(0, 3)")] {
            let mut file = Vec::new();
            write_header::<u8>(&mut file, shape).unwrap();
            assert!(String::from_utf8_lossy(&file).contains(&format!("'shape': {tuple}, }}")), "{tuple}");
            assert_eq!(file.len() % 64, 0);
        }
    }
}
