use thiserror::Error;

/// Most bytes of a header: NumPy writes a few hundred at most for arrays without fields.
const MAX_HEADER_BYTES: u32 = 1 << 16;
/// NumPy's own limit on axes.
const MAX_AXES: usize = 64;

/// What an array file says of its content.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Header {
    /// NumPy's name of the element type, such as `<f4`.
    pub descr: String,
    /// Whether the first axis is the fastest.
    pub fortran_order: bool,
    /// Sizes along the axes.
    pub shape: Vec<u64>,
}

/// What is wrong with the start of an array file.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum HeaderProblem {
    /// Other bytes come first.
    #[error("it does not begin with \\x93NUMPY: write it with `numpy.save`")]
    Magic,
    /// A version of the format that is not known.
    #[error("it has format version {major}.{minor}; versions 1.0, 2.0 and 3.0 can be read")]
    Version {
        /// First number.
        major: u8,
        /// Second number.
        minor: u8,
    },
    /// The header claims to be longer than any real one.
    #[error("its header claims {bytes} bytes, more than the {MAX_HEADER_BYTES} allowed")]
    TooLong {
        /// What it claims.
        bytes: u32,
    },
    /// The file ends within the header.
    #[error("it ends within its header")]
    Truncated,
    /// The header is no dictionary of the three entries that the format asks for.
    #[error("its header is wrong at byte {at}: {rule}")]
    Syntax {
        /// Bytes from the header's start.
        at: usize,
        /// What must stand there.
        rule: &'static str,
    },
    /// The sizes multiply to more bytes than a file can have.
    #[error("its shape has more elements than fit in 63 bits of bytes")]
    Overflow,
}

impl Header {
    /// Bytes before the header's text: magic, version and its length. The first eight tell how many there are.
    pub(super) fn prefix_bytes(start: &[u8; 8]) -> Result<usize, HeaderProblem> {
        if &start[..6] != b"\x93NUMPY" {
            return Err(HeaderProblem::Magic);
        }
        match (start[6], start[7]) {
            (1, 0) => Ok(10),
            (2 | 3, 0) => Ok(12),
            (major, minor) => Err(HeaderProblem::Version { major, minor }),
        }
    }

    /// Bytes of the header's text, from the length field: two bytes in version 1.0, four later.
    pub(super) fn text_bytes(length: &[u8]) -> Result<usize, HeaderProblem> {
        let bytes = length.iter().rev().fold(0u32, |value, &byte| value << 8 | u32::from(byte));
        if bytes > MAX_HEADER_BYTES { Err(HeaderProblem::TooLong { bytes }) } else { Ok(bytes as usize) }
    }

    /// Reads the header's text: a Python dictionary of literals.
    pub fn parse(text: &[u8]) -> Result<Self, HeaderProblem> {
        let mut cursor = Cursor { text, at: 0 };
        let (mut descr, mut fortran_order, mut shape) = (None, None, None);
        cursor.expect(b'{', "a dictionary begins with {")?;
        while !cursor.take(b'}') {
            let key_at = cursor.at;
            let key = cursor.string("a key in quotes")?;
            cursor.expect(b':', "a colon after the key")?;
            let is_new = match key {
                "descr" => descr.replace(cursor.descr()?).is_none(),
                "fortran_order" => fortran_order.replace(cursor.boolean()?).is_none(),
                "shape" => shape.replace(cursor.tuple()?).is_none(),
                _ => false,
            };
            if !is_new {
                return Err(HeaderProblem::Syntax {
                    at: key_at,
                    rule: "the keys are descr, fortran_order and shape, each once",
                });
            }
            if !cursor.take(b',') {
                cursor.expect(b'}', "a comma or } after a value")?;
                break;
            }
        }
        cursor.skip_blanks();
        if cursor.at < text.len() {
            return Err(cursor.problem("nothing but blanks after the dictionary"));
        }
        let (Some(descr), Some(fortran_order), Some(shape)) = (descr, fortran_order, shape) else {
            return Err(cursor.problem("all of descr, fortran_order and shape"));
        };
        // An axis of size 0 must not hide that the others are absurd.
        let sizes = shape.iter().map(|&size| size.max(1));
        if sizes.clone().try_fold(16u64, u64::checked_mul).is_none_or(|bytes| bytes > i64::MAX as u64) {
            return Err(HeaderProblem::Overflow);
        }
        Ok(Self { descr, fortran_order, shape })
    }

    /// The type as people call it, its byte order where it is unusual.
    pub(super) fn type_name(&self) -> String {
        let (order, kind) = match self.descr.split_at_checked(1) {
            Some((order @ ("<" | ">" | "|" | "="), kind)) => (order, kind),
            _ => ("", self.descr.as_str()),
        };
        let name = match kind {
            "b1" => "bool".to_owned(),
            kind => {
                let bits = kind
                    .get(1..)
                    .and_then(|bytes| bytes.parse::<u8>().ok())
                    .map(|bytes| 8 * u32::from(bytes));
                let family = match kind.as_bytes().first() {
                    Some(b'f') => "float",
                    Some(b'i') => "int",
                    Some(b'u') => "uint",
                    Some(b'c') => "complex",
                    _ => "",
                };
                match (family, bits) {
                    ("", _) | (_, None) => format!("`{}`", self.descr),
                    (family, Some(bits)) => format!("{family}{bits}"),
                }
            }
        };
        if order == ">" { format!("big-endian {name}") } else { name }
    }

    /// The shape as Python writes it.
    pub(super) fn shape_text(&self) -> String {
        let sizes: Vec<_> = self.shape.iter().map(u64::to_string).collect();
        match sizes.as_slice() {
            [one] => format!("({one},)"),
            many => format!("({})", many.join(", ")),
        }
    }
}

/// A place in the header's text.
struct Cursor<'a> {
    text: &'a [u8],
    at: usize,
}

impl<'a> Cursor<'a> {
    fn problem(&self, rule: &'static str) -> HeaderProblem {
        HeaderProblem::Syntax { at: self.at, rule }
    }

    fn skip_blanks(&mut self) {
        while self.text.get(self.at).is_some_and(u8::is_ascii_whitespace) {
            self.at += 1;
        }
    }

    /// Skips blanks and `byte` if it comes next.
    fn take(&mut self, byte: u8) -> bool {
        self.skip_blanks();
        let is_there = self.text.get(self.at) == Some(&byte);
        self.at += usize::from(is_there);
        is_there
    }

    fn expect(&mut self, byte: u8, rule: &'static str) -> Result<(), HeaderProblem> {
        if self.take(byte) { Ok(()) } else { Err(self.problem(rule)) }
    }

    fn string(&mut self, rule: &'static str) -> Result<&'a str, HeaderProblem> {
        self.skip_blanks();
        let problem = self.problem(rule);
        let Some(&quote @ (b'\'' | b'"')) = self.text.get(self.at) else { return Err(problem) };
        let rest = &self.text[self.at + 1..];
        let length = rest.iter().position(|&byte| byte == quote).ok_or(problem.clone())?;
        let inside = std::str::from_utf8(&rest[..length]).map_err(|_| problem.clone())?;
        if inside.contains('\\') {
            return Err(problem);
        }
        self.at += length + 2;
        Ok(inside)
    }

    fn descr(&mut self) -> Result<String, HeaderProblem> {
        self.skip_blanks();
        if self.text.get(self.at) == Some(&b'[') {
            return Err(self.problem("one type for all elements; arrays of records cannot be read"));
        }
        self.string("the type in quotes").map(str::to_owned)
    }

    fn word(&mut self) -> &'a [u8] {
        self.skip_blanks();
        let rest = &self.text[self.at..];
        let length = rest.iter().position(|byte| !byte.is_ascii_alphanumeric()).unwrap_or(rest.len());
        self.at += length;
        &rest[..length]
    }

    fn boolean(&mut self) -> Result<bool, HeaderProblem> {
        let problem = self.problem("True or False");
        match self.word() {
            b"True" => Ok(true),
            b"False" => Ok(false),
            _ => Err(problem),
        }
    }

    fn tuple(&mut self) -> Result<Vec<u64>, HeaderProblem> {
        self.expect(b'(', "the shape in parentheses")?;
        let mut sizes = Vec::new();
        while !self.take(b')') {
            let problem = self.problem("a size");
            if sizes.len() == MAX_AXES {
                return Err(self.problem("at most 64 axes"));
            }
            let word = self.word();
            // Python 2 wrote long integers with an L.
            let digits = word.strip_suffix(b"L").unwrap_or(word);
            let size = std::str::from_utf8(digits).ok().and_then(|digits| digits.parse().ok());
            sizes.push(size.ok_or(problem)?);
            if !self.take(b',') {
                if sizes.len() == 1 {
                    return Err(self.problem("a comma after the only size"));
                }
                self.expect(b')', "a comma or a parenthesis after a size")?;
                break;
            }
        }
        Ok(sizes)
    }
}
