//! Tests of the container: what is written is what is read, as documented, and nothing else is accepted.

mod hostile;
mod masks;
mod round_trip;

use std::io::Cursor;

use super::format::{HEADER_BYTES, Header, Index};
use super::{Archive, ArchiveError, ArchiveWriter, Section};
use crate::digest::Digest;

/// Name, item and content of sections.
type Content<'a> = &'a [(&'a str, u32, &'a [u8])];

fn writer() -> ArchiveWriter<Cursor<Vec<u8>>> {
    ArchiveWriter::in_memory().unwrap()
}

fn write(content: Content<'_>) -> Vec<u8> {
    let mut writer = writer();
    for &(name, item, raw) in content {
        writer.begin_section(name, item).unwrap();
        writer.append_raw(raw).unwrap();
    }
    writer.finish().unwrap().0
}

/// A small archive with a raw chunk, a compressed chunk, an empty section and padding.
fn small() -> Vec<u8> {
    write(&[
        ("meta", 0, b"manyview"),
        ("svo.mask", 3, &[0x5a; 1000]),
        ("svo.mask", 4, b""),
        ("rows", 0, &[7; 301]),
    ])
}

fn open(bytes: &[u8]) -> Result<Archive, ArchiveError> {
    Archive::from_bytes(bytes.to_vec())
}

/// Opens an archive that must not open.
fn refused(bytes: &[u8]) -> ArchiveError {
    match open(bytes) {
        Ok(archive) => panic!("accepted {:?}", archive.sections()),
        Err(error) => error,
    }
}

/// Opens, reads and verifies everything; the first thing that is wrong.
fn check(bytes: &[u8]) -> Result<(), ArchiveError> {
    let archive = open(bytes)?;
    for section in archive.sections() {
        archive.read_section(section)?;
    }
    archive.verify().failures.into_iter().next().map_or(Ok(()), Err)
}

/// The archive of `payload` (from the end of the header on) and an index, however wrong.
fn assemble(payload: &[u8], index: &Index) -> Vec<u8> {
    let index = index.encode().unwrap();
    let mut bytes = vec![0; HEADER_BYTES];
    bytes.extend(payload);
    bytes.extend(&*index);
    reseal(&mut bytes, index.len());
    bytes
}

/// Writes the header that fits the index in the last `index_bytes`.
fn reseal(bytes: &mut [u8], index_bytes: usize) {
    let index_offset = bytes.len() - index_bytes;
    let header = Header {
        index_offset: index_offset as u64,
        index_bytes: index_bytes as u32,
        file_bytes: bytes.len() as u64,
        index_digest: Digest::of(&bytes[index_offset..]),
    };
    bytes[..HEADER_BYTES].copy_from_slice(&header.encode());
}

/// Takes an archive apart, for [`assemble`].
fn disassemble(bytes: &[u8]) -> (Vec<u8>, Index) {
    let archive = open(bytes).unwrap();
    let index = Index { sections: archive.sections().to_vec(), chunks: archive.chunks().to_vec() };
    (bytes[HEADER_BYTES..archive.header().index_offset as usize].to_vec(), index)
}

fn section(archive: &Archive, name: &str, item: u32) -> Section {
    archive.expect_section(name, item).unwrap().clone()
}
