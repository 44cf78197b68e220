//! Content of rows, cut into tiles that are stored each on its own: the form that [`Codec::Rows`](super::Codec::Rows) has.
//!
//! Where a little of a chunk changes, a writer keeps the other tiles as they are: neither decoded nor coded nor digested
//! again ([`TileEditor`]).
//!
//! The stored bytes of content of n tiles are, one after the other:
//!
//! | bytes | what |
//! |---|---|
//! | 1 | bytes of a row, 4 to 32. A line is 8 times as many rows; the content is whole lines |
//! | 2 · n | of each tile: 0 if it is all zero, 65,535 if it is stored as it is, else the size of its [coded form](super::row_code) |
//! | … | the tiles |
//!
//! A tile has 16 KiB of content, the last one what is left.

use blake3::hazmat::{ChainingValue, HasherExt as _, Mode, merge_subtrees_non_root, merge_subtrees_root};

use super::chunk::CompressedChunk;
use super::error::{ArchiveError, corrupt};
use super::row_code::{self, Lines, Shape, TILE_BYTES};
use crate::digest::Digest;

/// How a tile is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Zero,
    Raw,
    Coded,
}

/// The head of a tile that is stored as it is. Coded forms are smaller than a tile.
const RAW: u16 = u16::MAX;

/// A tile as it is stored, and its part of the content's digest.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Tile {
    kind: Kind,
    stored: Vec<u8>,
    digest: ChainingValue,
}

impl Tile {
    /// Codes the tile that begins at `offset` in its chunk. A chunk of one tile has no use for a part of a digest.
    fn encode(lines: &mut Lines, shape: Shape, raw: &[u8], offset: usize) -> Self {
        let digest = blake3::Hasher::new().set_input_offset(offset as u64).update(raw).finalize_non_root();
        let mut stored = Vec::new();
        let kind = if raw.iter().all(|&byte| byte == 0) {
            Kind::Zero
        } else if row_code::encode(lines, shape, raw, &mut stored) {
            Kind::Coded
        } else {
            stored = raw.to_vec();
            Kind::Raw
        };
        Self { kind, stored, digest }
    }

    fn part(&self) -> Part<'_> {
        (self.kind, &self.stored, self.digest)
    }
}

/// How a tile is stored, and its bytes.
type Stored<'a> = (Kind, &'a [u8]);

/// A tile, wherever its bytes are.
type Part<'a> = (Kind, &'a [u8], ChainingValue);

/// How many tiles content of this size has.
pub(super) fn tile_count(raw_bytes: usize) -> usize {
    raw_bytes.div_ceil(TILE_BYTES)
}

fn tile_range(tile: usize, raw_bytes: usize) -> std::ops::Range<usize> {
    tile * TILE_BYTES..raw_bytes.min((tile + 1) * TILE_BYTES)
}

/// The digest of content whose tiles have these parts of it.
fn content_digest(tiles: &[ChainingValue], raw: impl FnOnce() -> Digest) -> Digest {
    fn merged(tiles: &[ChainingValue]) -> ChainingValue {
        match tiles {
            [tile] => *tile,
            _ => {
                let [left, right] = halves(tiles);
                merge_subtrees_non_root(&merged(left), &merged(right), Mode::Hash)
            }
        }
    }
    /// BLAKE3's tree: on the left as many tiles as the largest power of two below all.
    fn halves(tiles: &[ChainingValue]) -> [&[ChainingValue]; 2] {
        let (left, right) = tiles.split_at(tiles.len().next_power_of_two() / 2);
        [left, right]
    }
    if tiles.len() < 2 {
        return raw();
    }
    let [left, right] = halves(tiles);
    Digest(*merge_subtrees_root(&merged(left), &merged(right), Mode::Hash).as_bytes())
}

/// The stored form of content in whole lines of rows of so many bytes, with the content's digest and the tiles' parts of
/// it. `None` where it would be no smaller than the content, or the content is other.
pub(super) fn encode(raw: &[u8], row_bytes: usize) -> Option<(Vec<u8>, Digest, Vec<ChainingValue>)> {
    let shape = Shape::new(row_bytes).filter(|shape| raw.len().is_multiple_of(shape.line_bytes()))?;
    let mut lines = Lines::new();
    let tile = |index: usize| {
        let range = tile_range(index, raw.len());
        Tile::encode(&mut lines, shape, &raw[range.clone()], range.start)
    };
    let tiles: Vec<Tile> = (0..tile_count(raw.len())).map(tile).collect();
    join(shape, &tiles.iter().map(Tile::part).collect::<Vec<_>>(), raw.len(), || Digest::of(raw))
}

fn join(
    shape: Shape,
    tiles: &[Part<'_>],
    raw_bytes: usize,
    raw_digest: impl FnOnce() -> Digest,
) -> Option<(Vec<u8>, Digest, Vec<ChainingValue>)> {
    let bytes = 1 + tiles.iter().map(|(_, stored, _)| stored.len() + 2).sum::<usize>();
    if bytes >= raw_bytes {
        return None;
    }
    let mut stored = Vec::with_capacity(bytes);
    stored.push(shape.row_bytes() as u8);
    for (kind, bytes, _) in tiles {
        let head = match kind {
            Kind::Zero => 0,
            Kind::Raw => RAW,
            Kind::Coded => bytes.len() as u16,
        };
        stored.extend(head.to_le_bytes());
    }
    tiles.iter().for_each(|(_, bytes, _)| stored.extend_from_slice(bytes));
    let digests: Vec<ChainingValue> = tiles.iter().map(|(_, _, digest)| *digest).collect();
    let digest = content_digest(&digests, raw_digest);
    Some((stored, digest, digests))
}

/// How rows lie, and each tile of a stored form: how, and its bytes. Sizes are checked.
fn parse(stored: &[u8], raw_bytes: usize) -> Result<(Shape, Vec<Stored<'_>>), ArchiveError> {
    let broken = |found: &str| corrupt("tiles", "the form of its size", found);
    let (&row_bytes, rest) = stored.split_first().ok_or_else(|| broken("too few bytes"))?;
    let shape = Shape::new(row_bytes.into())
        .filter(|shape| raw_bytes.is_multiple_of(shape.line_bytes()))
        .ok_or_else(|| broken("rows that do not fit its size"))?;
    let count = tile_count(raw_bytes);
    let (heads, mut rest) = rest.split_at_checked(count * 2).ok_or_else(|| broken("too few bytes"))?;
    let mut tiles = Vec::with_capacity(count);
    for (tile, head) in heads.as_chunks::<2>().0.iter().enumerate() {
        let (kind, size) = match u16::from_le_bytes(*head) {
            0 => (Kind::Zero, 0),
            RAW => (Kind::Raw, tile_range(tile, raw_bytes).len()),
            size => (Kind::Coded, size.into()),
        };
        let bytes;
        (bytes, rest) = rest.split_at_checked(size).ok_or_else(|| broken("too few bytes"))?;
        tiles.push((kind, bytes));
    }
    if rest.is_empty() { Ok((shape, tiles)) } else { Err(broken("too many bytes")) }
}

/// Decodes one tile into its content, which is all zero.
fn decode_tile(
    lines: &mut Lines,
    shape: Shape,
    kind: Kind,
    stored: &[u8],
    raw: &mut [u8],
) -> Result<(), ArchiveError> {
    match kind {
        Kind::Zero => {}
        Kind::Raw => raw.copy_from_slice(stored),
        Kind::Coded => row_code::decode(lines, shape, stored, raw)?,
    }
    Ok(())
}

/// Decodes a stored form into `raw`, which is all zero.
pub(super) fn decode_into_zeros(stored: &[u8], raw: &mut [u8]) -> Result<(), ArchiveError> {
    let (shape, tiles) = parse(stored, raw.len())?;
    let mut lines = Lines::new();
    for ((kind, bytes), raw) in tiles.into_iter().zip(raw.chunks_mut(TILE_BYTES)) {
        decode_tile(&mut lines, shape, kind, bytes, raw)?;
    }
    Ok(())
}

/// Makes a chunk from another one by replacing some tiles.
///
/// ```
/// use manyview_cache::archive::{CompressedChunk, TILE_BYTES, TileEditor};
/// let mut raw = vec![0; 4 * TILE_BYTES];
/// raw[100] = 1;
/// let old = CompressedChunk::compress_rows(&raw, 16);
/// let mut editor = TileEditor::new(&old)?.expect("it is stored in tiles");
/// let mut tile = vec![0; TILE_BYTES];
/// editor.read(2, &mut tile)?;
/// tile[7] = 9;
/// editor.replace(2, &tile);
/// raw[2 * TILE_BYTES + 7] = 9;
/// assert_eq!(editor.finish(), Some(CompressedChunk::compress_rows(&raw, 16)));
/// # Ok::<(), manyview_cache::archive::ArchiveError>(())
/// ```
pub struct TileEditor<'a> {
    old: &'a CompressedChunk,
    shape: Shape,
    lines: Box<Lines>,
    tiles: Vec<Stored<'a>>,
    new: Vec<Option<Tile>>,
}

impl<'a> TileEditor<'a> {
    /// Starts from a chunk; `None` if it is not stored in several tiles.
    pub fn new(old: &'a CompressedChunk) -> Result<Option<Self>, ArchiveError> {
        let count = tile_count(old.raw_bytes() as usize);
        if old.tile_digests().len() != count || count < 2 {
            return Ok(None);
        }
        let (shape, tiles) = parse(old.stored(), old.raw_bytes() as usize)?;
        Ok(Some(Self { old, shape, lines: Lines::new(), tiles, new: vec![None; count] }))
    }

    /// Reads a tile of the old chunk into `raw`, which is all zero and as large as the tile.
    pub fn read(&mut self, tile: usize, raw: &mut [u8]) -> Result<(), ArchiveError> {
        let (kind, stored) = self.tiles[tile];
        decode_tile(&mut self.lines, self.shape, kind, stored, raw)
    }

    /// Puts other content in place of a tile.
    pub fn replace(&mut self, tile: usize, raw: &[u8]) {
        self.new[tile] = Some(Tile::encode(&mut self.lines, self.shape, raw, tile * TILE_BYTES));
    }

    /// The new chunk, the same as if its whole content had been coded; `None` where that would not be stored in
    /// tiles.
    pub fn finish(self) -> Option<CompressedChunk> {
        let digests = self.old.tile_digests();
        let raw_bytes = self.old.raw_bytes() as usize;
        let old = self.tiles.iter().zip(digests).map(|((kind, stored), digest)| (*kind, *stored, *digest));
        let tiles: Vec<Part<'_>> =
            self.new.iter().zip(old).map(|(new, old)| new.as_ref().map_or(old, Tile::part)).collect();
        // There are at least two tiles, so nobody asks for the digest of the whole.
        let (stored, digest, digests) = join(self.shape, &tiles, raw_bytes, || self.old.raw_digest())?;
        Some(CompressedChunk::of_tiles(stored, raw_bytes, digest, digests))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::archive::Codec;
    use proptest::prelude::*;

    fn content(tiles: &[(usize, u8)], last: usize) -> Vec<u8> {
        let mut raw = Vec::new();
        for (i, (step, byte)) in tiles.iter().enumerate() {
            let size = if i + 1 == tiles.len() { last } else { TILE_BYTES };
            // Zeros, sparse content, or bytes that nothing compresses.
            let mut state = 1u64 + u64::from(*byte);
            raw.extend((0..size).map(|at| {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                if *step == 0 || at % step != 0 {
                    0
                } else if *step == 1 {
                    (state >> 56) as u8
                } else {
                    *byte
                }
            }));
        }
        raw
    }

    #[test]
    fn a_known_form() {
        let mut raw = vec![0; TILE_BYTES + 2048];
        raw[TILE_BYTES + 5] = 3;
        let chunk = CompressedChunk::compress_rows(&raw, 16);
        let stored = chunk.stored();
        assert_eq!((stored[0], &stored[1..3]), (16, &[0, 0][..]), "rows of 16 bytes, an empty tile");
        assert_eq!(usize::from(u16::from_le_bytes([stored[3], stored[4]])), stored.len() - 5, "a coded tile");
        assert_eq!(chunk.raw_digest(), Digest::of(&raw));
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 60, ..ProptestConfig::default() })]

        #[test]
        fn tiles_round_trip_and_edits_are_as_coding_anew(
            tiles in prop::collection::vec((prop_oneof![Just(0usize), Just(1), 2usize..900], 1u8..), 1..7),
            row_shift in 2u32..6, last in 1usize..=TILE_BYTES,
            edits in prop::collection::vec((any::<u16>(), any::<u32>(), any::<u8>()), 0..5),
        ) {
            let row_bytes = 1 << row_shift;
            let mut raw = content(&tiles, last.next_multiple_of(row_bytes * row_bytes * 8));
            let chunk = CompressedChunk::compress_rows(&raw, row_bytes);
            prop_assert_eq!(chunk.raw_digest(), Digest::of(&raw));
            prop_assert_eq!(&chunk.content().unwrap(), &raw);
            let mut value = Vec::new();
            chunk.save(&mut value);
            let mut rest = &value[..];
            prop_assert_eq!(CompressedChunk::load(&mut rest), Some(chunk.clone()));
            prop_assert!(rest.is_empty());
            let Some(mut editor) = TileEditor::new(&chunk).unwrap() else {
                prop_assert!(tiles.len() < 2 || chunk.codec() == Codec::Raw);
                return Ok(());
            };
            for (tile, at, byte) in edits {
                let range = tile_range(usize::from(tile) % tiles.len(), raw.len());
                let at = range.start + at as usize % range.len();
                raw[at] = byte;
                editor.replace(range.start / TILE_BYTES, &raw[range]);
            }
            let again = CompressedChunk::compress_rows(&raw, row_bytes);
            match editor.finish() {
                Some(edited) => prop_assert_eq!(edited, again),
                None => prop_assert_eq!(again.codec(), Codec::Raw),
            }
        }

        #[test]
        fn any_bytes_decode_or_fail(stored in prop::collection::vec(any::<u8>(), 0..300), lines in 1usize..100) {
            _ = decode_into_zeros(&stored, &mut vec![0; lines * 2048]);
            let rows = [&[16, 9, 0][..], &stored].concat();
            _ = decode_into_zeros(&rows, &mut vec![0; (lines % 8 + 1) * 2048]);
        }

        #[test]
        fn cut_or_longer_forms_are_refused(cut in 1usize..40) {
            let raw = content(&[(0, 1), (3, 5), (77, 9)], 6144);
            let chunk = CompressedChunk::compress_rows(&raw, 16);
            let stored = chunk.stored();
            let mut back = vec![0; raw.len()];
            prop_assert!(decode_into_zeros(&stored[..stored.len() - cut], &mut back).is_err());
            let longer = [stored, &vec![0; cut]].concat();
            prop_assert!(decode_into_zeros(&longer, &mut vec![0; raw.len()]).is_err());
        }
    }
}
