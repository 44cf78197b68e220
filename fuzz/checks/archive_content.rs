//! Any content in a container that is sound, so that no digest tells: the loader refuses it, or gives what its types
//! promise, in bounded memory.
//!
//! The data are edits of a small bake: a byte for the section, a byte for what to do, two bytes for where, one for the
//! value; five bytes each.

use manyview::Archive;
use manyview_cache::archive::{Archive as Container, ArchiveWriter};

const MAX_MEMORY_BYTES: u64 = 64 << 20;
const MAX_EDITS: usize = 8;

/// The sections that are edited: name, item and content of each.
pub(crate) type Sections = Vec<(String, u32, Vec<u8>)>;

/// Takes a bake apart.
pub(crate) fn sections(archive: &[u8]) -> Sections {
    let container = Container::from_bytes(archive.to_vec()).expect("a sound archive");
    let content = |section| container.read_section(section).expect("a sound section");
    container
        .sections()
        .iter()
        .map(|section| (section.id.name.as_str().to_owned(), section.id.item, content(section)))
        .collect()
}

/// Fails if the rule is broken for these edits of a bake.
pub(crate) fn check(sound: &Sections, data: &[u8]) {
    let mut sections = sound.clone();
    for &[section, action, low, high, value] in data.as_chunks().0.iter().take(MAX_EDITS) {
        let count = sections.len();
        let Some((_, item, content)) = sections.get_mut(usize::from(section) % count.max(1)) else { return };
        let at = usize::from(u16::from_le_bytes([low, high])) % content.len().max(1);
        match action % 8 {
            // Another byte, most often.
            0..4 if !content.is_empty() => content[at] = value,
            4 => content.truncate(at),
            5 => content.extend_from_slice(&vec![value; at % 4096]),
            6 => *item = u32::from(value),
            7 => drop(sections.remove(usize::from(section) % count)),
            _ => {}
        }
    }
    let mut writer = ArchiveWriter::in_memory().expect("memory");
    for (name, item, content) in &sections {
        // Two sections of one name, or one without content: not an archive that can be written.
        if writer.begin_section(name, *item).and_then(|()| writer.append_raw(content)).is_err() {
            return;
        }
    }
    let Ok((bytes, _)) = writer.finish() else { return };
    let Ok(archive) = Archive::from_bytes(bytes) else { return };
    let archive = archive.with_memory_limit(MAX_MEMORY_BYTES);
    if let Ok(svo) = archive.svo() {
        svo.validate().expect("a loaded octree is sound");
        assert_eq!(svo.levels[svo.levels.len() - 1].colors.len() as u64, archive.svo_info().leaves);
    }
    for level in 0..=archive.svo_info().levels {
        _ = archive.svo_level_alone(level);
    }
    if let Ok(lights) = archive.lights() {
        assert_eq!(lights.len() as u64, archive.scene_info().lights);
    }
    if let Some(info) = archive.rows_info() {
        _ = archive.frames().map(|frames| assert_eq!(frames.len() as u32, info.directions));
        for block in 0..archive.row_block_count().min(4) {
            _ = archive.row_block(block);
        }
        _ = archive.direction_rows(info.directions - 1);
    }
}
