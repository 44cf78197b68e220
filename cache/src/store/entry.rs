//! One entry: a header that covers every byte, and the content.

use std::io::{ErrorKind, Read};
use std::path::Path;

use crate::digest::{Digest, DigestBuilder};

const MAGIC: [u8; 8] = *b"\x89MVE\r\n\x1a\n";
const VERSION: u32 = 1;

/// The size of the header.
pub(super) const HEADER_BYTES: usize = 56;

/// Contents beyond this are digested by several threads.
const PARALLEL_BYTES: usize = 1 << 20;

/// The header of an entry.
pub(super) fn header(key: &Digest, parts: &[&[u8]]) -> [u8; HEADER_BYTES] {
    let mut digest = DigestBuilder::new();
    digest.update(key.as_bytes());
    parts.iter().for_each(|part| _ = digest.update(part));
    let mut header = [0; HEADER_BYTES];
    header[..8].copy_from_slice(&MAGIC);
    header[8..12].copy_from_slice(&VERSION.to_le_bytes());
    let size: usize = parts.iter().map(|part| part.len()).sum();
    header[16..24].copy_from_slice(&(size as u64).to_le_bytes());
    header[24..].copy_from_slice(digest.finish().as_bytes());
    header
}

/// Checks the bytes of a whole entry; `Err` says what is wrong.
pub(super) fn check(bytes: &[u8], key: &Digest) -> Result<(), String> {
    let Some((head, content)) = bytes.split_at_checked(HEADER_BYTES) else {
        return Err(format!("it has {} bytes, less than its header", bytes.len()));
    };
    check_parts(head, content, key)
}

fn check_parts(head: &[u8], content: &[u8], key: &Digest) -> Result<(), String> {
    if head[..8] != MAGIC {
        return Err("it does not begin like an entry".to_owned());
    }
    let version = u32::from_le_bytes([head[8], head[9], head[10], head[11]]);
    if version != VERSION {
        return Err(format!("its header has version {version}, expected {VERSION}"));
    }
    let mut size = [0; 8];
    size.copy_from_slice(&head[16..24]);
    if u64::from_le_bytes(size) != content.len() as u64 || head[12..16] != [0; 4] {
        return Err(format!("it has {} bytes of content, its header tells another number", content.len()));
    }
    let digest = if content.len() >= PARALLEL_BYTES {
        let mut hasher = blake3::Hasher::new();
        hasher.update(key.as_bytes());
        hasher.update_rayon(content);
        Digest(*hasher.finalize().as_bytes())
    } else {
        DigestBuilder::new().update(key.as_bytes()).update(content).finish()
    };
    if head[24..] != digest.0 { Err("its digest differs".to_owned()) } else { Ok(()) }
}

/// The content of the entry at `path`, noted as used; `None` if it is not there, `Err` with what is wrong with it.
pub(super) fn read(path: &Path, key: &Digest) -> Result<Option<Vec<u8>>, String> {
    let mut file = match fs_err::File::open(path) {
        Ok(file) => file,
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(error.to_string()),
    };
    let size = file.metadata().map_or(0, |metadata| metadata.len()) as usize;
    let Some(content_size) = size.checked_sub(HEADER_BYTES) else {
        return Err(format!("it has {size} bytes, less than its header"));
    };
    let mut content = Vec::new();
    content.try_reserve_exact(content_size).map_err(|_| format!("{size} bytes are too many"))?;
    let mut head = [0; HEADER_BYTES];
    file.read_exact(&mut head).map_err(|error| error.to_string())?;
    file.read_to_end(&mut content).map_err(|error| error.to_string())?;
    check_parts(&head, &content, key)?;
    super::touch(file.file());
    Ok(Some(content))
}
