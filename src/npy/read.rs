use super::Element;
use super::header::{Header, HeaderProblem};
use std::io::{self, Read};
use std::marker::PhantomData;
use thiserror::Error;

/// Why an array was not read.
#[derive(Debug, Error)]
pub enum ReadError {
    /// The system could not read the file.
    #[error("{name}: cannot be read: {source}")]
    Read {
        /// The file.
        name: String,
        /// What the system says.
        source: io::Error,
    },
    /// It is no array file, or one that cannot be read.
    #[error("{name}: {problem}")]
    Header {
        /// The file.
        name: String,
        /// What is wrong.
        problem: HeaderProblem,
    },
    /// The array is another one than was asked for.
    #[error("{name}: expected {expected}, found {found}{fix}")]
    Unexpected {
        /// The file.
        name: String,
        /// Types and shapes that would do.
        expected: String,
        /// What is there.
        found: String,
        /// How to make the one from the other, if that is easy.
        fix: &'static str,
    },
    /// The file ends before the array does.
    #[error("{name}: the file ends {missing_bytes} bytes before its array does: copy it again")]
    Truncated {
        /// The file.
        name: String,
        /// Bytes that are not there.
        missing_bytes: u64,
    },
    /// The file goes on behind the array.
    #[error("{name}: there is more behind the array of {found}: save one array in a file")]
    TrailingBytes {
        /// The file.
        name: String,
        /// What the header says.
        found: String,
    },
}

/// Reads an array of `T` from front to back.
#[derive(Debug)]
pub struct ArrayReader<T, R> {
    name: String,
    source: R,
    header: Header,
    left: u64,
    element: PhantomData<T>,
}

impl<T: Element, R: Read> ArrayReader<T, R> {
    /// Reads the header. The array must be of type `T`, in C order, and of one of the `shapes`, in which `None` is any
    /// size. `name` is the file's, for messages.
    pub fn new(name: impl Into<String>, mut source: R, shapes: &[&[Option<u64>]]) -> Result<Self, ReadError> {
        let name = name.into();
        let header = match read_header(&mut source) {
            Ok(header) => header,
            Err(HeaderError::Problem(problem)) => return Err(ReadError::Header { name, problem }),
            Err(HeaderError::Read(source)) => return Err(ReadError::Read { name, source }),
        };
        let is_type =
            header.descr == T::DESCR || (size_of::<T>() == 1 && header.descr.get(1..) == T::DESCR.get(1..));
        let fits = |shape: &&[Option<u64>]| {
            shape.len() == header.shape.len()
                && shape.iter().zip(&header.shape).all(|(wanted, size)| wanted.is_none_or(|w| w == *size))
        };
        // The order of a single axis, or of nothing, is both.
        let axes = header.shape.iter().filter(|&&size| size > 1).count();
        let is_ordered = !header.fortran_order || axes <= 1 || header.shape.contains(&0);
        if !is_type || !is_ordered || !shapes.iter().any(fits) {
            let expected: Vec<_> = shapes.iter().map(|shape| pattern_text(shape)).collect();
            let order = if header.fortran_order { " in Fortran order" } else { "" };
            return Err(ReadError::Unexpected {
                expected: format!("{} {}", T::NAME, expected.join(" or ")),
                found: format!("{} {}{order}", header.type_name(), header.shape_text()),
                fix: match (is_type, is_ordered) {
                    (false, _) => ": convert it with `astype`",
                    (true, false) => ": save `numpy.ascontiguousarray` of it",
                    (true, true) => "",
                },
                name,
            });
        }
        let left = header.shape.iter().product();
        Ok(Self { name, source, header, left, element: PhantomData })
    }

    /// Sizes along the axes.
    pub fn shape(&self) -> &[u64] {
        &self.header.shape
    }

    /// Elements that were not read yet.
    pub fn left(&self) -> u64 {
        self.left
    }

    /// Fills the front of `elements` with the next ones and returns how many: fewer than there is room for only at the
    /// array's end.
    pub fn read(&mut self, elements: &mut [T]) -> Result<usize, ReadError> {
        let count = self.left.min(elements.len() as u64) as usize;
        let bytes: &mut [u8] = bytemuck::cast_slice_mut(&mut elements[..count]);
        let mut done = 0;
        while done < bytes.len() {
            match self.source.read(&mut bytes[done..]) {
                Ok(0) => {
                    let missing_bytes = self.left * size_of::<T>() as u64 - done as u64;
                    return Err(ReadError::Truncated { name: self.name.clone(), missing_bytes });
                }
                Ok(more) => done += more,
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(source) => return Err(ReadError::Read { name: self.name.clone(), source }),
            }
        }
        self.left -= count as u64;
        if self.left == 0 {
            self.expect_end()?;
        }
        Ok(count)
    }

    fn expect_end(&mut self) -> Result<(), ReadError> {
        let mut byte = [0];
        match fill(&mut self.source, &mut byte) {
            Ok(0) => Ok(()),
            Ok(_) => {
                let found = format!("{} {}", self.header.type_name(), self.header.shape_text());
                Err(ReadError::TrailingBytes { name: self.name.clone(), found })
            }
            Err(source) => Err(ReadError::Read { name: self.name.clone(), source }),
        }
    }
}

enum HeaderError {
    Problem(HeaderProblem),
    Read(io::Error),
}

impl From<HeaderProblem> for HeaderError {
    fn from(problem: HeaderProblem) -> Self {
        Self::Problem(problem)
    }
}

fn read_header(source: &mut impl Read) -> Result<Header, HeaderError> {
    let mut part = |bytes: &mut [u8]| match fill(source, bytes).map_err(HeaderError::Read)? {
        found if found == bytes.len() => Ok(()),
        _ => Err(HeaderError::Problem(HeaderProblem::Truncated)),
    };
    let mut start = [0; 8];
    part(&mut start).map_err(|error| match error {
        // Too short for its first bytes: something else altogether.
        HeaderError::Problem(_) => HeaderError::Problem(HeaderProblem::Magic),
        read => read,
    })?;
    let mut length = [0; 4];
    let length = &mut length[..Header::prefix_bytes(&start)? - 8];
    part(length)?;
    let mut text = vec![0; Header::text_bytes(length)?];
    part(&mut text)?;
    Ok(Header::parse(&text)?)
}

/// Reads until `bytes` are full or the source ends; returns how many there were.
fn fill(source: &mut impl Read, bytes: &mut [u8]) -> io::Result<usize> {
    let mut done = 0;
    while done < bytes.len() {
        match source.read(&mut bytes[done..]) {
            Ok(0) => break,
            Ok(more) => done += more,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    Ok(done)
}

fn pattern_text(shape: &[Option<u64>]) -> String {
    let sizes: Vec<_> =
        shape.iter().map(|size| size.map_or("n".to_owned(), |size| size.to_string())).collect();
    match sizes.as_slice() {
        [one] => format!("({one},)"),
        many => format!("({})", many.join(", ")),
    }
}

#[cfg(test)]
mod tests {
    use super::super::{write_elements, write_header};
    use super::*;
    use proptest::prelude::*;

    const RAYS: &[&[Option<u64>]] = &[&[None, Some(6)], &[None, Some(9)]];

    fn file(version: u8, text: &str, elements: &[u8]) -> Vec<u8> {
        let mut bytes = b"\x93NUMPY".to_vec();
        bytes.extend([version, 0]);
        match version {
            1 => bytes.extend((text.len() as u16).to_le_bytes()),
            _ => bytes.extend((text.len() as u32).to_le_bytes()),
        }
        bytes.extend(text.as_bytes());
        bytes.extend(elements);
        bytes
    }

    fn refusal<T: Element>(bytes: &[u8], shapes: &[&[Option<u64>]]) -> String {
        let mut reader = match ArrayReader::<T, _>::new("a.npy", bytes, shapes) {
            Ok(reader) => reader,
            Err(error) => return error.to_string(),
        };
        let mut elements = vec![T::zeroed(); 64];
        loop {
            match reader.read(&mut elements) {
                Ok(0) => panic!("it was read"),
                Ok(_) => {}
                Err(error) => return error.to_string(),
            }
        }
    }

    fn float_header(shape: &str) -> String {
        format!("{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}, }}\n")
    }

    #[test]
    fn what_is_written_is_read_in_pieces() {
        let values: Vec<f32> = (0..18).map(|i| i as f32 * 0.5).collect();
        let mut bytes = Vec::new();
        write_header::<f32>(&mut bytes, &[3, 6]).unwrap();
        write_elements(&mut bytes, &values).unwrap();
        let mut reader = ArrayReader::<f32, _>::new("a.npy", bytes.as_slice(), RAYS).unwrap();
        assert_eq!((reader.shape(), reader.left()), (&[3, 6][..], 18));
        let (mut found, mut piece) = (Vec::<f32>::new(), [0.0; 7]);
        loop {
            let count = reader.read(&mut piece).unwrap();
            if count == 0 {
                break;
            }
            found.extend(&piece[..count]);
        }
        assert_eq!(found, values);
    }

    #[test]
    fn every_version_and_spelling_of_the_header_is_read() {
        let elements = bytemuck::bytes_of(&[1u32, 2]).to_vec();
        for version in 1..=3 {
            for text in [
                "{'descr': '<u4', 'fortran_order': False, 'shape': (2,), }   \n",
                "{\"shape\":(2L,),\"fortran_order\":True,\"descr\":\"<u4\"}",
                " { 'shape' : ( 2 , ) , 'descr' : '<u4' , 'fortran_order' : False } ",
            ] {
                let bytes = file(version, text, &elements);
                let mut reader = ArrayReader::<u32, _>::new("a", bytes.as_slice(), &[&[None]]).unwrap();
                let mut found = [0; 3];
                assert_eq!(reader.read(&mut found).unwrap(), 2, "version {version} of {text}");
                assert_eq!(found, [1, 2, 0]);
            }
        }
        let empty = file(1, &float_header("(0, 6)"), &[]);
        let mut reader = ArrayReader::<f32, _>::new("a", empty.as_slice(), RAYS).unwrap();
        assert_eq!(reader.read(&mut [0.0; 4]).unwrap(), 0);
    }

    #[test]
    fn another_array_is_refused_with_what_is_expected_and_found() {
        let wrong = |text: &str| refusal::<f32>(&file(1, text, &[0; 48]), RAYS);
        assert_eq!(
            wrong("{'descr': '<f8', 'fortran_order': False, 'shape': (1, 6)}"),
            "a.npy: expected float32 (n, 6) or (n, 9), found float64 (1, 6): convert it with `astype`"
        );
        assert_eq!(
            wrong("{'descr': '>f4', 'fortran_order': False, 'shape': (1, 6)}"),
            "a.npy: expected float32 (n, 6) or (n, 9), found big-endian float32 (1, 6): convert it with `astype`"
        );
        assert_eq!(
            wrong(&float_header("(12,)")),
            "a.npy: expected float32 (n, 6) or (n, 9), found float32 (12,)"
        );
        assert_eq!(
            wrong("{'descr': '<f4', 'fortran_order': True, 'shape': (2, 6)}"),
            "a.npy: expected float32 (n, 6) or (n, 9), found float32 (2, 6) in Fortran order: save \
             `numpy.ascontiguousarray` of it"
        );
        assert!(wrong("{'descr': '|b1', 'fortran_order': False, 'shape': ()}").contains("found bool ()"));
        assert!(
            wrong("{'descr': [('x', '<f4')], 'fortran_order': False, 'shape': (1, 6)}").contains("records")
        );
    }

    #[test]
    fn broken_files_are_refused_by_what_is_broken() {
        let whole = file(1, &float_header("(2, 6)"), &[0; 48]);
        for length in 0..whole.len() {
            let message = refusal::<f32>(&whole[..length], RAYS);
            let expected = match length {
                0..8 => "does not begin with \\x93NUMPY",
                _ if length < whole.len() - 48 => "ends within its header",
                _ => "bytes before its array does",
            };
            assert!(message.contains(expected), "{length} bytes: {message}");
        }
        let mut longer = whole.clone();
        longer.push(0);
        assert!(refusal::<f32>(&longer, RAYS).contains("more behind the array of float32 (2, 6)"));
        assert!(refusal::<f32>(&file(4, "", &[]), RAYS).contains("version 4.0"));
        let claims = [b"\x93NUMPY\x02\x00".as_slice(), &u32::MAX.to_le_bytes()].concat();
        assert!(refusal::<f32>(&claims, RAYS).contains("claims 4294967295 bytes"));
        let absurd = file(1, &float_header("(4611686018427387904, 6)"), &[]);
        assert!(refusal::<f32>(&absurd, RAYS).contains("63 bits"));
        let hidden = file(1, &float_header("(0, 18446744073709551615, 18446744073709551615)"), &[]);
        assert!(refusal::<f32>(&hidden, RAYS).contains("63 bits"));
        for (text, rule) in [
            ("", "begins with {"),
            ("{'descr': '<f4'}", "all of descr"),
            ("{'descr': '<f4', 'descr': '<f4'}", "each once"),
            ("{'a': 1}", "each once"),
            ("{'shape': (6)}", "a comma after the only size"),
            ("{'shape': (-1, 6)}", "a size"),
            ("{'fortran_order': 0}", "True or False"),
            ("{'descr': '<f4", "in quotes"),
        ] {
            let message = refusal::<f32>(&file(1, text, &[]), RAYS);
            assert!(message.contains(rule), "{text}: {message}");
        }
    }

    proptest! {
        /// Whatever is done to a header: an error, or an array as long as its shape says, never a panic.
        #[test]
        fn mutated_files_are_refused_or_read_to_their_end(
            edits in prop::collection::vec((0usize..140, any::<u8>()), 0..6),
            cut in 0usize..180,
            version in 1u8..4,
        ) {
            let mut bytes = file(version, &float_header("(2, 6)"), &[7; 48]);
            for (at, value) in edits {
                let at = at % bytes.len();
                bytes[at] = value;
            }
            bytes.truncate(bytes.len().min(cut.max(1)).max(1));
            if let Ok(mut reader) = ArrayReader::<f32, _>::new("a", bytes.as_slice(), &[&[None, None]]) {
                let elements: u64 = reader.shape().iter().product();
                let mut piece = [0.0; 5];
                let mut read = 0;
                while let Ok(count @ 1..) = reader.read(&mut piece) {
                    read += count as u64;
                }
                prop_assert!(read <= elements && read <= 12 + 30);
            }
        }

        /// Texts of the header's own characters get deeper into the parser than random bytes.
        #[test]
        fn any_text_is_parsed_or_refused(text in "[{}()':,<f4 descrfortan_shpTuFl019L]{0,60}") {
            _ = Header::parse(text.as_bytes());
        }
    }
}
