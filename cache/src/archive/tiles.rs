//! Content cut into tiles that are stored each on its own: the form that [`Codec::Tiles`](super::Codec::Tiles) has.
//!
//! Where a little of a chunk changes, a writer keeps the other tiles as they are: neither decoded nor compressed nor
//! digested again ([`TileEditor`]). Measured on rows: 4 to 7 % larger than one sparse form a chunk.
//!
//! The stored bytes of content of n tiles are, one after the other:
//!
//! | bytes | what |
//! |---|---|
//! | 4 · n | for each tile, how it is stored (the upper two bits: 0 raw, 1 a zstd frame, 2 a zstd frame of the tile's [sparse form](super::sparse), 3 nothing: it is all zero) and how many bytes it has (the rest) |
//! | … | the tiles |
//!
//! A tile has 64 KiB of content, the last one what is left.

use blake3::hazmat::{ChainingValue, HasherExt as _, Mode, merge_subtrees_non_root, merge_subtrees_root};

use super::chunk::{CompressedChunk, compress_into, decompress};
use super::error::{ArchiveError, corrupt, expect_equal};
use super::sparse;
use crate::digest::Digest;

/// The content of a tile.
pub const TILE_BYTES: usize = 64 << 10;

/// How a tile is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Raw,
    Zstd,
    Sparse,
    Zero,
}

impl Kind {
    const ALL: [Self; 4] = [Self::Raw, Self::Zstd, Self::Sparse, Self::Zero];
}

/// A tile as it is stored, and its part of the content's digest.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Tile {
    kind: Kind,
    stored: Vec<u8>,
    digest: ChainingValue,
}

impl Tile {
    /// Compresses the tile that begins at `offset` in its chunk. A chunk of one tile has no use for a part of a digest.
    fn encode(raw: &[u8], offset: usize, level: i32) -> Self {
        let digest = blake3::Hasher::new().set_input_offset(offset as u64).update(raw).finalize_non_root();
        if raw.iter().all(|&byte| byte == 0) {
            return Self { kind: Kind::Zero, stored: Vec::new(), digest };
        }
        let mut compressed = vec![0; raw.len() - 1];
        let sparse = sparse::encode(raw);
        let form = sparse.as_deref().unwrap_or(raw);
        let (kind, stored) = match compress_into(form, level, &mut compressed) {
            Ok(size) => {
                compressed.truncate(size);
                (if sparse.is_some() { Kind::Sparse } else { Kind::Zstd }, compressed)
            }
            Err(_) => (Kind::Raw, raw.to_vec()),
        };
        Self { kind, stored, digest }
    }

    fn part(&self) -> Part<'_> {
        (self.kind, &self.stored, self.digest)
    }
}

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

/// The stored form of content, or `None` where it would be no smaller than the content.
pub(super) fn encode(raw: &[u8], level: i32) -> Option<(Vec<u8>, Digest, Vec<ChainingValue>)> {
    let tile = |index: usize| {
        let range = tile_range(index, raw.len());
        Tile::encode(&raw[range.clone()], range.start, level)
    };
    let tiles: Vec<Tile> = (0..tile_count(raw.len())).map(tile).collect();
    join(&tiles.iter().map(Tile::part).collect::<Vec<_>>(), raw.len(), || Digest::of(raw))
}

fn join(
    tiles: &[Part<'_>],
    raw_bytes: usize,
    raw_digest: impl FnOnce() -> Digest,
) -> Option<(Vec<u8>, Digest, Vec<ChainingValue>)> {
    let bytes = tiles.iter().map(|(_, stored, _)| stored.len() + 4).sum();
    if bytes >= raw_bytes {
        return None;
    }
    let mut stored = Vec::with_capacity(bytes);
    for (kind, bytes, _) in tiles {
        stored.extend(((*kind as u32) << 30 | bytes.len() as u32).to_le_bytes());
    }
    tiles.iter().for_each(|(_, bytes, _)| stored.extend_from_slice(bytes));
    let digests: Vec<ChainingValue> = tiles.iter().map(|(_, _, digest)| *digest).collect();
    let digest = content_digest(&digests, raw_digest);
    Some((stored, digest, digests))
}

/// Each tile of a stored form: how, and its bytes. Sizes are checked.
fn parse(stored: &[u8], raw_bytes: usize) -> Result<Vec<(Kind, &[u8])>, ArchiveError> {
    let broken = |found: &str| corrupt("tiles", "the form of its size", found);
    let count = tile_count(raw_bytes);
    let (heads, mut rest) = stored.split_at_checked(count * 4).ok_or_else(|| broken("too few bytes"))?;
    let (heads, _) = heads.as_chunks::<4>();
    let mut tiles = Vec::with_capacity(count);
    for head in heads {
        let head = u32::from_le_bytes(*head);
        let kind = Kind::ALL[(head >> 30) as usize];
        let bytes;
        (bytes, rest) =
            rest.split_at_checked((head & 0x3fff_ffff) as usize).ok_or_else(|| broken("too few bytes"))?;
        tiles.push((kind, bytes));
    }
    if rest.is_empty() { Ok(tiles) } else { Err(broken("too many bytes")) }
}

/// Decodes one tile into its content, which is all zero.
fn decode_tile(kind: Kind, stored: &[u8], raw: &mut [u8]) -> Result<(), ArchiveError> {
    match kind {
        Kind::Zero => expect_equal("stored size of an empty tile", 0, stored.len()),
        Kind::Raw => {
            expect_equal("stored size of a raw tile", raw.len(), stored.len())?;
            raw.copy_from_slice(stored);
            Ok(())
        }
        Kind::Zstd => {
            let written = decompress(stored, raw)?;
            expect_equal("content of the zstd frame", raw.len(), written)
        }
        Kind::Sparse => {
            // A sparse form is smaller than its content.
            let mut form = [0; TILE_BYTES];
            let form = &mut form[..raw.len()];
            let written = decompress(stored, form)?;
            sparse::decode_into_zeros(&form[..written], raw)
        }
    }
}

/// Decodes a stored form into `raw`, which is all zero.
pub(super) fn decode_into_zeros(stored: &[u8], raw: &mut [u8]) -> Result<(), ArchiveError> {
    for ((kind, bytes), raw) in parse(stored, raw.len())?.into_iter().zip(raw.chunks_mut(TILE_BYTES)) {
        decode_tile(kind, bytes, raw)?;
    }
    Ok(())
}

/// Makes a chunk from another one by replacing some tiles.
///
/// ```
/// use manyview_cache::archive::{CompressedChunk, TILE_BYTES, TileEditor};
/// let mut raw = vec![0; 4 * TILE_BYTES];
/// raw[100] = 1;
/// let old = CompressedChunk::compress_tiles(&raw, 3);
/// let mut editor = TileEditor::new(&old)?.expect("it is stored in tiles");
/// let mut tile = vec![0; TILE_BYTES];
/// editor.read(2, &mut tile)?;
/// tile[7] = 9;
/// editor.replace(2, &tile, 3);
/// raw[2 * TILE_BYTES + 7] = 9;
/// assert_eq!(editor.finish(), Some(CompressedChunk::compress_tiles(&raw, 3)));
/// # Ok::<(), manyview_cache::archive::ArchiveError>(())
/// ```
pub struct TileEditor<'a> {
    old: &'a CompressedChunk,
    tiles: Vec<(Kind, &'a [u8])>,
    new: Vec<Option<Tile>>,
}

impl<'a> TileEditor<'a> {
    /// Starts from a chunk; `None` if it is not stored in several tiles.
    pub fn new(old: &'a CompressedChunk) -> Result<Option<Self>, ArchiveError> {
        let count = tile_count(old.raw_bytes() as usize);
        if old.tile_digests().len() != count || count < 2 {
            return Ok(None);
        }
        let tiles = parse(old.stored(), old.raw_bytes() as usize)?;
        Ok(Some(Self { old, tiles, new: vec![None; count] }))
    }

    /// Reads a tile of the old chunk into `raw`, which is all zero and as large as the tile.
    pub fn read(&self, tile: usize, raw: &mut [u8]) -> Result<(), ArchiveError> {
        let (kind, stored) = self.tiles[tile];
        decode_tile(kind, stored, raw)
    }

    /// Puts other content in place of a tile, compressed at a zstd `level`.
    pub fn replace(&mut self, tile: usize, raw: &[u8], level: i32) {
        self.new[tile] = Some(Tile::encode(raw, tile * TILE_BYTES, level));
    }

    /// The new chunk, the same as if its whole content had been compressed; `None` where that would not be stored in
    /// tiles.
    pub fn finish(self) -> Option<CompressedChunk> {
        let digests = self.old.tile_digests();
        let raw_bytes = self.old.raw_bytes() as usize;
        let old = self.tiles.iter().zip(digests).map(|((kind, stored), digest)| (*kind, *stored, *digest));
        let tiles: Vec<Part<'_>> =
            self.new.iter().zip(old).map(|(new, old)| new.as_ref().map_or(old, Tile::part)).collect();
        // There are at least two tiles, so nobody asks for the digest of the whole.
        let (stored, digest, digests) = join(&tiles, raw_bytes, || self.old.raw_digest())?;
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
        let chunk = CompressedChunk::compress_tiles(&raw, 1);
        let stored = chunk.stored();
        assert_eq!(stored[..4], [0, 0, 0, 0xc0], "nothing");
        assert_eq!(
            (stored[7], usize::from(stored[4]), stored[5]),
            (0x80, stored.len() - 8, 0),
            "a sparse form"
        );
        assert_eq!(chunk.raw_digest(), Digest::of(&raw));
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 40, ..ProptestConfig::default() })]

        #[test]
        fn tiles_round_trip_and_edits_are_as_compressing_anew(
            tiles in prop::collection::vec((prop_oneof![Just(0usize), Just(1), 2usize..900], 1u8..), 1..7),
            last in 1usize..TILE_BYTES,
            edits in prop::collection::vec((any::<u16>(), any::<u32>(), any::<u8>()), 0..5),
        ) {
            let mut raw = content(&tiles, last);
            let chunk = CompressedChunk::compress_tiles(&raw, 1);
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
                editor.replace(range.start / TILE_BYTES, &raw[range], 1);
            }
            let again = CompressedChunk::compress_tiles(&raw, 1);
            match editor.finish() {
                Some(edited) => prop_assert_eq!(edited, again),
                None => prop_assert_eq!(again.codec(), Codec::Raw),
            }
        }

        #[test]
        fn any_bytes_decode_or_fail(stored in prop::collection::vec(any::<u8>(), 0..300), size in 1usize..200_000) {
            _ = decode_into_zeros(&stored, &mut vec![0; size]);
        }

        #[test]
        fn cut_or_longer_forms_are_refused(cut in 1usize..40) {
            let raw = content(&[(0, 1), (3, 5), (77, 9)], 5000);
            let chunk = CompressedChunk::compress_tiles(&raw, 1);
            let stored = chunk.stored();
            let mut back = vec![0; raw.len()];
            prop_assert!(decode_into_zeros(&stored[..stored.len() - cut], &mut back).is_err());
            let longer = [stored, &vec![0; cut]].concat();
            prop_assert!(decode_into_zeros(&longer, &mut vec![0; raw.len()]).is_err());
        }
    }
}
