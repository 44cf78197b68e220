//! What a URI in a scene stands for: bytes written out, or a file in the scene's folder.

use super::error::ImportError;
use base64::Engine;
use base64::alphabet;
use base64::engine::{DecodePaddingMode, GeneralPurpose, GeneralPurposeConfig};
use percent_encoding::percent_decode_str;
use std::path::{Path, PathBuf};

/// Exporters differ in padding and in the last bits; both are harmless.
const BASE64: GeneralPurpose = GeneralPurpose::new(
    &alphabet::STANDARD,
    GeneralPurposeConfig::new()
        .with_decode_padding_mode(DecodePaddingMode::Indifferent)
        .with_decode_allow_trailing_bits(true),
);

/// What a URI stands for.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Location {
    /// The bytes of a data URI.
    Data(Vec<u8>),
    /// A file, which need not exist.
    File {
        /// Where it is on this machine.
        path: PathBuf,
        /// Where it is seen from the scene's folder, with `/` between names.
        relative: String,
    },
}

/// Finds out what the URI `text` at `place` stands for.
pub(super) fn locate(
    file: &str,
    place: &str,
    text: &str,
    folder: &Path,
    allow_outside: bool,
) -> Result<Location, ImportError> {
    let malformed =
        |rule: String| ImportError::Malformed { file: file.to_owned(), place: place.to_owned(), rule };
    if text.get(..5).is_some_and(|start| start.eq_ignore_ascii_case("data:")) {
        return data(&text[5..]).map(Location::Data).map_err(malformed);
    }
    let scheme = text.split_once(':').map(|(scheme, _)| scheme).filter(|scheme| is_scheme(scheme));
    if let Some(scheme) = scheme {
        return Err(ImportError::Unsupported {
            file: file.to_owned(),
            place: place.to_owned(),
            feature: format!("the URI scheme \"{scheme}:\""),
            way_out: "download the file, put it beside the scene and refer to it by a relative path"
                .to_owned(),
        });
    }
    let decoded = percent_decode_str(text).decode_utf8().map_err(|_| malformed("is not UTF-8".to_owned()))?;
    if decoded.is_empty() || decoded.contains('\0') {
        return Err(malformed("is no path".to_owned()));
    }
    // Names with a literal percent sign occur unescaped, too.
    let decoded = match normalize(&decoded) {
        Some(path)
            if !folder.join(&path).exists()
                && normalize(text).is_some_and(|raw| folder.join(raw).exists()) =>
        {
            text
        }
        _ => &*decoded,
    };
    let outside =
        || ImportError::Outside { file: file.to_owned(), place: place.to_owned(), uri: text.to_owned() };
    let relative = match normalize(decoded) {
        Some(path) => path,
        None if allow_outside => decoded.replace('\\', "/"),
        None => return Err(outside()),
    };
    let path = folder.join(&relative);
    if !allow_outside {
        // A symbolic link can leave the folder, too. What does not exist is reported when it is read.
        let root = fs_err::canonicalize(folder).ok();
        let target = fs_err::canonicalize(&path).ok();
        if let (Some(root), Some(target)) = (root, target)
            && !target.starts_with(&root)
        {
            return Err(outside());
        }
    }
    Ok(Location::File { path, relative })
}

/// Letters and digits before a colon, as in `https:`; a Windows drive letter counts as well.
fn is_scheme(text: &str) -> bool {
    text.starts_with(|first: char| first.is_ascii_alphabetic())
        && text.chars().all(|c| c.is_ascii_alphanumeric() || "+-.".contains(c))
}

/// The path without `.` and `..`, or `None` if it is absolute or climbs above its start.
fn normalize(path: &str) -> Option<String> {
    if path.starts_with(['/', '\\']) {
        return None;
    }
    let mut names: Vec<&str> = Vec::new();
    for name in path.split(['/', '\\']) {
        match name {
            "" | "." => {}
            ".." => {
                names.pop()?;
            }
            _ => names.push(name),
        }
    }
    (!names.is_empty()).then(|| names.join("/"))
}

/// The bytes of a data URI, whose text follows `data:`.
fn data(text: &str) -> Result<Vec<u8>, String> {
    let (header, body) = text.split_once(',').ok_or("a data URI needs a comma before its data")?;
    if !header.to_ascii_lowercase().ends_with(";base64") {
        return Ok(percent_decode_str(body).collect());
    }
    let clean: Vec<u8> =
        if body.contains('%') { percent_decode_str(body).collect() } else { body.as_bytes().to_vec() };
    let clean: Vec<u8> = clean.into_iter().filter(|byte| !byte.is_ascii_whitespace()).collect();
    BASE64.decode(clean).map_err(|error| format!("its base64 data is broken: {error}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn find(text: &str, allow_outside: bool) -> Result<Location, ImportError> {
        locate("s.gltf", "buffers[0].uri", text, Path::new("/nonexistent-folder"), allow_outside)
    }

    fn relative(text: &str) -> String {
        match find(text, false).unwrap() {
            Location::File { relative, .. } => relative,
            Location::Data(_) => panic!("{text} is a file"),
        }
    }

    #[test]
    fn percent_escapes_and_dots_are_resolved() {
        assert_eq!(relative("a%20b/./c/../d%C3%A9.bin"), "a b/d\u{e9}.bin");
        assert_eq!(relative("textures\\x.png"), "textures/x.png");
        assert_eq!(relative("100%.bin"), "100%.bin");
    }

    #[test]
    fn leaving_the_folder_is_refused_however_it_is_written() {
        for text in [
            "../x.bin",
            "a/../../x.bin",
            "/etc/passwd",
            "%2e%2e/x.bin",
            "..%2fx.bin",
            "a/..\\..\\x.bin",
            "\\x",
        ] {
            assert!(matches!(find(text, false), Err(ImportError::Outside { .. })), "{text}");
        }
        let Ok(Location::File { relative, .. }) = find("../x.bin", true) else { panic!("allowed") };
        assert_eq!(relative, "../x.bin");
    }

    #[test]
    fn schemes_are_refused_by_name() {
        for text in ["http://example.org/x.bin", "file:///etc/passwd", "C:/x.bin"] {
            assert!(matches!(find(text, true), Err(ImportError::Unsupported { .. })), "{text}");
        }
    }

    #[cfg(unix)]
    #[test]
    fn a_symbolic_link_out_of_the_folder_is_refused() {
        let outside = tempfile::tempdir().unwrap();
        let folder = tempfile::tempdir().unwrap();
        fs_err::write(outside.path().join("x.bin"), b"x").unwrap();
        std::os::unix::fs::symlink(outside.path().join("x.bin"), folder.path().join("x.bin")).unwrap();
        let find = |allow| locate("s.gltf", "buffers[0].uri", "x.bin", folder.path(), allow);
        assert!(matches!(find(false), Err(ImportError::Outside { .. })));
        assert!(matches!(find(true), Ok(Location::File { .. })));
    }

    #[test]
    fn data_uris_are_decoded() {
        let data = |text| {
            find(text, false).map(|location| match location {
                Location::Data(bytes) => bytes,
                Location::File { .. } => panic!("{text} is data"),
            })
        };
        assert_eq!(data("data:application/octet-stream;base64,AQID").unwrap(), [1, 2, 3]);
        assert_eq!(data("data:;base64,AQ").unwrap(), [1], "padding may be missing");
        assert_eq!(data("data:text/plain,a%20b").unwrap(), b"a b");
        assert!(data("data:application/octet-stream;base64,A!ID").is_err());
        assert!(data("data:nothing").is_err());
    }
}
