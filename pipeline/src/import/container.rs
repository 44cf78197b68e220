//! The two containers of glTF 2.0: plain JSON, and GLB with its chunks.

use super::error::ImportError;
use std::ops::Range;

const GLB_MAGIC: &[u8; 4] = b"glTF";
const JSON_CHUNK: &[u8; 4] = b"JSON";
const BIN_CHUNK: &[u8; 4] = b"BIN\0";
const HEADER_BYTES: usize = 12;
const CHUNK_HEADER_BYTES: usize = 8;

/// Where the parts of a scene file lie.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Container {
    /// The JSON text, without a byte order mark.
    pub(super) json: Range<usize>,
    /// The binary chunk of a GLB.
    pub(super) bin: Option<Range<usize>>,
}

/// Finds the parts of a scene file. A file that starts like a GLB is one; its name does not matter, except for messages.
pub(super) fn split(file: &str, bytes: &[u8]) -> Result<Container, ImportError> {
    let malformed = |place: &str, rule: String| ImportError::Malformed {
        file: file.to_owned(),
        place: place.to_owned(),
        rule,
    };
    if !bytes.starts_with(GLB_MAGIC) {
        if file.to_ascii_lowercase().ends_with(".glb") {
            return Err(malformed("GLB header", "does not start with \"glTF\"".to_owned()));
        }
        return Ok(Container { json: without_byte_order_mark(bytes, 0..bytes.len()), bin: None });
    }
    let word = |at: usize| {
        let word = bytes.get(at..at + 4)?;
        Some(u32::from_le_bytes([word[0], word[1], word[2], word[3]]))
    };
    let (Some(version), Some(length)) = (word(4), word(8)) else {
        let rule =
            format!("the file ends after {} bytes, within the header of {HEADER_BYTES} bytes", bytes.len());
        return Err(malformed("GLB header", rule));
    };
    if version != 2 {
        return Err(ImportError::Unsupported {
            file: file.to_owned(),
            place: "GLB header".to_owned(),
            feature: format!("GLB version {version}"),
            way_out: "export the scene as glTF 2.0".to_owned(),
        });
    }
    let length = length as usize;
    if length > bytes.len() {
        let rule =
            format!("the header tells {length} bytes, but the file has {}: it is truncated", bytes.len());
        return Err(malformed("GLB header", rule));
    }
    let mut json = None;
    let mut bin = None;
    let mut at = HEADER_BYTES;
    let mut number = 0;
    while at + CHUNK_HEADER_BYTES <= length {
        let chunk_bytes = word(at).unwrap_or(0) as usize;
        let kind = &bytes[at + 4..at + 8];
        let start = at + CHUNK_HEADER_BYTES;
        let place = format!("GLB chunk {number}");
        if chunk_bytes > length - start {
            let rule = format!("tells {chunk_bytes} bytes, but only {} are left in the file", length - start);
            return Err(malformed(&place, rule));
        }
        let range = start..start + chunk_bytes;
        match number {
            0 if kind == JSON_CHUNK => json = Some(without_byte_order_mark(bytes, range)),
            0 => return Err(malformed(&place, "the first chunk must be JSON".to_owned())),
            1 if kind == BIN_CHUNK => bin = Some(range),
            _ => {}
        }
        at = start + chunk_bytes;
        number += 1;
    }
    let json = json.ok_or_else(|| malformed("GLB", "has no JSON chunk".to_owned()))?;
    Ok(Container { json, bin })
}

fn without_byte_order_mark(bytes: &[u8], range: Range<usize>) -> Range<usize> {
    let mark = if bytes[range.clone()].starts_with(b"\xEF\xBB\xBF") { 3 } else { 0 };
    range.start + mark..range.end
}

#[cfg(test)]
mod tests {
    use super::*;

    fn glb(chunks: &[(&[u8; 4], &[u8])]) -> Vec<u8> {
        let mut bytes = b"glTF\x02\0\0\0\0\0\0\0".to_vec();
        for (kind, data) in chunks {
            bytes.extend((data.len() as u32).to_le_bytes());
            bytes.extend(*kind);
            bytes.extend(*data);
        }
        let length = (bytes.len() as u32).to_le_bytes();
        bytes[8..12].copy_from_slice(&length);
        bytes
    }

    #[test]
    fn chunks_are_found() {
        let bytes = glb(&[(b"JSON", b"{}  "), (b"BIN\0", &[1, 2, 3, 4])]);
        assert_eq!(split("a.glb", &bytes).unwrap(), Container { json: 20..24, bin: Some(32..36) });
    }

    #[test]
    fn every_truncation_is_refused() {
        let bytes = glb(&[(b"JSON", b"{}  "), (b"BIN\0", &[1, 2, 3, 4])]);
        for end in 0..bytes.len() {
            assert!(split("a.glb", &bytes[..end]).is_err(), "cut at {end}");
        }
    }

    #[test]
    fn a_chunk_longer_than_the_file_is_refused() {
        let mut bytes = glb(&[(b"JSON", b"{}  ")]);
        bytes[12..16].copy_from_slice(&u32::MAX.to_le_bytes());
        let message = split("a.glb", &bytes).unwrap_err().to_string();
        assert!(message.contains("GLB chunk 0") && message.contains("4294967295"), "{message}");
    }

    #[test]
    fn version_one_is_refused_by_name() {
        let mut bytes = glb(&[(b"JSON", b"{}  ")]);
        bytes[4] = 1;
        assert!(matches!(split("a.glb", &bytes), Err(ImportError::Unsupported { .. })));
    }

    #[test]
    fn a_byte_order_mark_is_skipped() {
        assert_eq!(split("a.gltf", b"\xEF\xBB\xBF{}").unwrap().json, 3..5);
    }
}
