//! A brick's results as they are kept and written: byte planes of its levels.

use super::RegionGrid;
use crate::sections::planes;
use crate::steps::Reader;
use manyview_cache::archive::{CompressedChunk, DEFAULT_LEVEL};
use manyview_shaders::svo::SvoLevel;
use rayon::prelude::*;

/// A piece of a brick's result: bytes of the coarse levels, chunks of the fine ones in a fixed order.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Part {
    /// Nodes of each level, the brick's root first; empty in an empty brick.
    pub(super) counts: Vec<u32>,
    pub(super) coarse: Vec<u8>,
    /// One list for each byte plane of each fine level.
    pub(super) fine: Vec<Vec<CompressedChunk>>,
}

impl Part {
    pub(super) fn save(&self) -> Vec<u8> {
        let mut value = Vec::new();
        value.extend((self.counts.len() as u32).to_le_bytes());
        self.counts.iter().for_each(|count| value.extend(count.to_le_bytes()));
        let coarse = CompressedChunk::compress_all(&self.coarse, DEFAULT_LEVEL);
        for chunks in std::iter::once(&coarse).chain(&self.fine) {
            value.extend((chunks.len() as u32).to_le_bytes());
            chunks.iter().for_each(|chunk| chunk.save(&mut value));
        }
        value
    }

    pub(super) fn load(value: &[u8], lists: usize) -> Option<Self> {
        let mut reader = Reader(value);
        let levels = reader.u32()?;
        let counts: Vec<u32> = (0..levels).map(|_| reader.u32()).collect::<Option<_>>()?;
        let mut list = || -> Option<Vec<CompressedChunk>> {
            let chunks = reader.u32()?;
            (0..chunks).map(|_| CompressedChunk::load(&mut reader.0)).collect()
        };
        let mut coarse = Vec::new();
        for chunk in list()? {
            coarse.extend(chunk.content().ok()?);
        }
        let fine = (0..if levels == 0 { 0 } else { lists }).map(|_| list()).collect::<Option<_>>()?;
        reader.end()?;
        Some(Self { counts, coarse, fine })
    }

    pub(super) fn nothing() -> Self {
        Self { counts: Vec::new(), coarse: Vec::new(), fine: Vec::new() }
    }
}

/// How many byte planes a level's shape has.
pub(super) const SHAPE_PLANES: usize = 2;

/// How many byte planes a level's look has.
pub(super) fn look_plane_count(emits: bool) -> usize {
    if emits { 10 } else { 6 }
}

/// Byte planes of a level's shape, in the order of their chunks and sections.
pub(super) fn shape_planes(level: &SvoLevel) -> [Vec<u8>; SHAPE_PLANES] {
    [level.child_masks.clone(), level.coverages.clone()]
}

/// Byte planes of a level's look.
pub(super) fn look_planes(level: &SvoLevel, emits: bool) -> Vec<Vec<u8>> {
    let split = |planes: Vec<u8>, count: usize| -> Vec<Vec<u8>> {
        let each = planes.len() / count;
        (0..count).map(|i| planes[i * each..(i + 1) * each].to_vec()).collect()
    };
    let mut all = split(planes(&level.colors, |c| *c), 3);
    all.extend(split(planes(&level.normals, |n| n.map(|c| c as u8)), 2));
    all.push(level.cones.clone());
    if emits {
        all.extend(split(planes(&level.emissive, |e| e.to_le_bytes()), 4));
    }
    all
}

/// All byte planes of a level.
pub(crate) fn byte_planes(level: &SvoLevel) -> Vec<Vec<u8>> {
    let mut all = look_planes(level, !level.emissive.is_empty());
    all.extend(shape_planes(level));
    all
}

/// A level from its byte planes.
pub(super) fn level_of(shape: &[Vec<u8>], look: &[Vec<u8>]) -> Option<SvoLevel> {
    let nodes = look.first()?.len();
    let byte = |plane: usize, node: usize| look[plane][node];
    Some(SvoLevel {
        child_masks: shape.first().cloned().unwrap_or_default(),
        coverages: shape.get(1).cloned().unwrap_or_default(),
        colors: (0..nodes).map(|i| [byte(0, i), byte(1, i), byte(2, i)]).collect(),
        normals: (0..nodes).map(|i| [byte(3, i) as i8, byte(4, i) as i8]).collect(),
        cones: look[5].clone(),
        emissive: if look.len() > 6 {
            (0..nodes).map(|i| u32::from_le_bytes([byte(6, i), byte(7, i), byte(8, i), byte(9, i)])).collect()
        } else {
            Vec::new()
        },
    })
}

/// Cuts a brick's levels into its two parts.
pub(super) fn split(grid: RegionGrid, emits: bool, levels: &[SvoLevel]) -> [Part; 2] {
    let counts: Vec<u32> = levels.iter().map(|level| level.colors.len() as u32).collect();
    let cut = |planes_of: &dyn Fn(&SvoLevel) -> Vec<Vec<u8>>, levels: &[SvoLevel]| {
        let mut coarse = Vec::new();
        let mut fine = Vec::new();
        for (local, level) in (0..).zip(levels) {
            for plane in planes_of(level) {
                if grid.is_fine(local) {
                    fine.push(plane);
                } else {
                    coarse.extend(plane);
                }
            }
        }
        (coarse, fine)
    };
    let part = |(coarse, fine): (Vec<u8>, Vec<Vec<u8>>)| {
        let fine = fine.par_iter().map(|plane| CompressedChunk::compress_all(plane, DEFAULT_LEVEL)).collect();
        Part { counts: counts.clone(), coarse, fine }
    };
    let inner = &levels[..levels.len() - 1];
    let mut shape = cut(&|level| shape_planes(level).to_vec(), inner);
    let masks: Vec<&[u8]> = inner.iter().map(|level| &level.child_masks[..]).collect();
    let first = masks.len() - shape.1.len() / SHAPE_PLANES;
    // They are coded together, as none has a place without those above.
    shape.1.iter_mut().step_by(SHAPE_PLANES).for_each(|plane| *plane = Vec::new());
    let mut shape = part(shape);
    for (list, chunk) in
        shape.fine.iter_mut().step_by(SHAPE_PLANES).zip(CompressedChunk::compress_masks(&masks, first))
    {
        *list = vec![chunk];
    }
    [shape, part(cut(&|level| look_planes(level, emits), levels))]
}
