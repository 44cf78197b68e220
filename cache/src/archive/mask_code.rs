//! The code of an octree's child masks: bit by bit, each under a probability that is learned from the chunk itself, by
//! what is known around the child.
//!
//! # Theory
//! Occupancy under the occupancy of neighbours is how point clouds are coded (MPEG's G-PCC, ISO/IEC 23090-9); the
//! arithmetic code is that of Martin, "Range encoding", 1979.
//!
//! A surface that comes to a child from a neighbour mostly goes on in it. So a child's context has: which of the eight
//! it is; whether the six neighbours are filled that share a face or an edge with it and come before it (those of its
//! own size: at −x, −y, −z and two of them together); whether the parent has a neighbour at +x, +y, +z, which is all that
//! is known of what comes after; and whether the masks are those of 128³ cells. That is 13 bits, chosen greedily among 375
//! questions (the 5³ cells around, of both sizes) by the entropy that they leave in generated scenes. The probabilities
//! start at one half: there is no model to be learned and kept.
//!
//! Neighbours need positions, and these need the levels above. So one form has all levels of a cube from its root, and
//! the form of a level is the beginning of the form of the next one: an archive stores the deepest one, and the
//! levels above are parts of it ([the format](crate)). Where cubes meet, neighbours count as empty.
//!
//! Of 2048³ voxels, all masks, in bits a voxel: a scanned bunny 1.85 under zstd, 0.92 so; a mansion 1.31, 0.91; cities
//! 1.19, 0.65 and 1.16, 0.53; a forest 2.52, 1.88. Three contexts of up to 21 bits, mixed as PAQ does, would bring the
//! bunny to 0.8 and the forest to 1.75, at several times the work for a bit. A DAG of equal subtrees, its references at
//! their entropy, takes more than zstd does: 1.98, 1.69, 1.39, 1.27, 3.37.
//!
//! # Practice
//! The stored form of a level:
//!
//! | bytes | what |
//! |---|---|
//! | 1 | levels of the first part: the root's level and others, 1 to 8 |
//! | 4, … | the first part: how many bytes follow, and the code of its levels |
//! | 4, … | for each further level down to this one: how many bytes follow, and its code |
//!
//! Within a level nodes are in Morton order, and the children of a node from bit 0 to bit 7. No mask is zero, so that bit
//! 7 is not coded where the others are zero. Each part ends with the four bytes that bring the decoder to zero: anything
//! else than what the encoder makes is refused.

use super::error::{ArchiveError, corrupt};

/// The most levels of a form: the deepest masks are then of 128³ cells.
pub const MAX_LEVELS: usize = 8;

/// log2 of the number of contexts.
const CONTEXT_BITS: u32 = 13;
/// log2 of what the shares of 0 and 1 sum up to in the range coder.
const SHARE_BITS: u32 = 12;
/// The coder's range is at least this before a bit.
const MIN_RANGE: u32 = 1 << 24;
/// Probabilities follow the mean of what was seen, and after so many bits the younger ones.
const MEMORY: usize = 128;

/// By how much of 2^15 a probability moves towards a bit, of the number of bits seen in its context.
const RATES: [u16; MEMORY] = {
    let mut rates = [0; MEMORY];
    let mut seen = 0;
    while seen < MEMORY {
        // One over the number of bits, this one included, and a little more, as if 0.6 bits had been seen before.
        rates[seen] = (327_680 / (seen * 10 + 16)) as u16;
        seen += 1;
    }
    rates
};

/// What a context has learned: in the upper half the probability of a one, of 2^16; in the lower half how many bits were
/// seen, up to [`MEMORY`] less one.
#[derive(Clone, Copy)]
struct Chance(u32);

impl Chance {
    const EVEN: Self = Self(1 << 31);

    /// The share of a one: never nothing, never all.
    #[inline(always)]
    fn share(self) -> u32 {
        (self.0 >> (32 - SHARE_BITS)).max(1)
    }

    #[inline(always)]
    fn after(self, bit: bool) -> Self {
        let (one, seen) = ((self.0 >> 16) as i32, self.0 as usize % MEMORY);
        let target = if bit { 0xffff } else { 0 };
        // Between the old value and the target.
        let one = one + (((target - one) * i32::from(RATES[seen])) >> 15);
        Self((one as u32) << 16 | (seen + usize::from(seen < MEMORY - 1)) as u32)
    }
}

struct Chances(Box<[Chance; 1 << CONTEXT_BITS]>);

impl Chances {
    fn new() -> Self {
        Self(Box::new([Chance::EVEN; 1 << CONTEXT_BITS]))
    }

    #[inline(always)]
    fn of(&mut self, context: u32) -> &mut Chance {
        &mut self.0[context as usize & ((1 << CONTEXT_BITS) - 1)]
    }
}

/// Codes or decodes bits.
trait Bits {
    /// The next bit: `known` where it is coded.
    fn next(&mut self, chance: &mut Chance, known: bool) -> bool;
}

struct Encoder {
    low: u64,
    range: u32,
    bytes: Vec<u8>,
}

impl Encoder {
    fn new() -> Self {
        Self { low: 0, range: u32::MAX, bytes: Vec::new() }
    }

    /// Puts out the upper byte of `low`.
    fn shift(&mut self) {
        if self.low >> 32 != 0 {
            // The carry cannot run off the front: the code stays below one.
            for byte in self.bytes.iter_mut().rev() {
                *byte = byte.wrapping_add(1);
                if *byte != 0 {
                    break;
                }
            }
        }
        self.bytes.push((self.low >> 24) as u8);
        self.low = (self.low & 0x00ff_ffff) << 8;
    }

    fn finish(mut self) -> Vec<u8> {
        (0..4).for_each(|_| self.shift());
        self.bytes
    }
}

impl Bits for Encoder {
    #[inline(always)]
    fn next(&mut self, chance: &mut Chance, known: bool) -> bool {
        let bound = (self.range >> SHARE_BITS) * chance.share();
        *chance = chance.after(known);
        if known {
            self.range = bound;
        } else {
            self.low += u64::from(bound);
            self.range -= bound;
        }
        while self.range < MIN_RANGE {
            self.range <<= 8;
            self.shift();
        }
        known
    }
}

struct Decoder<'a> {
    code: u32,
    range: u32,
    bytes: &'a [u8],
    next: usize,
}

impl<'a> Decoder<'a> {
    fn new(bytes: &'a [u8]) -> Self {
        let mut decoder = Self { code: 0, range: u32::MAX, bytes, next: 0 };
        (0..4).for_each(|_| decoder.shift());
        decoder
    }

    #[inline(always)]
    fn shift(&mut self) {
        // Past the end, zeros: what comes out then is refused at the end.
        self.code = self.code << 8 | u32::from(self.bytes.get(self.next).copied().unwrap_or_default());
        self.next += 1;
    }

    fn is_at_end(&self) -> bool {
        self.code == 0 && self.next == self.bytes.len()
    }
}

impl Bits for Decoder<'_> {
    #[inline(always)]
    fn next(&mut self, chance: &mut Chance, _: bool) -> bool {
        let before = *chance;
        let bound = (self.range >> SHARE_BITS) * before.share();
        let bit = self.code < bound;
        *chance = before.after(bit);
        if bit {
            self.range = bound;
        } else {
            self.code -= bound;
            self.range -= bound;
        }
        while self.range < MIN_RANGE {
            self.range <<= 8;
            self.shift();
        }
        bit
    }
}

/// The masks of a level by position, with empty cells around.
struct Grid {
    /// Cells a side, the empty ones included.
    side: usize,
    masks: Vec<u8>,
}

impl Grid {
    fn new(level: usize) -> Self {
        let side = (1 << level) + 2;
        Self { side, masks: vec![0; side * side * side] }
    }

    #[inline(always)]
    fn index(&self, [x, y, z]: [u32; 3]) -> usize {
        ((z as usize + 1) * self.side + y as usize + 1) * self.side + x as usize + 1
    }

    /// Whether a cell of the next level is filled.
    #[inline(always)]
    fn has(&self, [x, y, z]: [u32; 3]) -> bool {
        let mask = self.masks[self.index([x >> 1, y >> 1, z >> 1])];
        mask >> (x & 1 | (y & 1) << 1 | (z & 1) << 2) & 1 != 0
    }
}

/// Where the children of a cell lie in a window of 3³ cells of their size, of which the first in each direction are of
/// the cell's neighbours: at x + 3·y + 9·z. For the cell itself and its neighbours at −x (bit 0 of the first index), −y
/// (bit 1), −z (bit 2), the window's bits of each mask.
static WINDOWS: [[u32; 256]; 8] = {
    let mut windows = [[0; 256]; 8];
    let mut at = 0;
    while at < 8 * 256 * 8 {
        let (neighbour, mask, child) = (at >> 11, at >> 3 & 255, at & 7);
        let (x, y, z) = (1 + (child & 1), 1 + (child >> 1 & 1), 1 + (child >> 2));
        let (dx, dy, dz) = (2 * (neighbour & 1), 2 * (neighbour >> 1 & 1), 2 * (neighbour >> 2));
        if mask >> child & 1 != 0 && x >= dx && y >= dy && z >= dz {
            windows[neighbour][mask] |= 1 << (x - dx + 3 * (y - dy) + 9 * (z - dz));
        }
        at += 1;
    }
    windows
};

/// Where a cell is: 8 bits a coordinate.
#[derive(Clone, Copy)]
struct Cell(u32);

impl Cell {
    #[inline(always)]
    fn coordinates(self) -> [u32; 3] {
        [self.0 & 255, self.0 >> 8 & 255, self.0 >> 16]
    }

    #[inline(always)]
    fn child(self, child: u32) -> Self {
        Self(self.0 << 1 | child & 1 | (child & 2) << 7 | (child & 4) << 14)
    }
}

/// The levels of a cube from the root on, as far as they are known.
struct Walk {
    chances: Chances,
    /// The last level that is known.
    above: Grid,
    /// The nodes of the next one.
    cells: Vec<Cell>,
}

impl Walk {
    fn new() -> Self {
        let mut above = Grid::new(0);
        let root = above.index([0; 3]);
        above.masks[root] = 1;
        Self { chances: Chances::new(), above, cells: vec![Cell(0)] }
    }

    /// Codes or decodes the masks of the next level.
    fn level(&mut self, level: usize, masks: &mut [u8], bits: &mut impl Bits) {
        let mut here = Grid::new(level);
        let side = here.side;
        let deepest = u32::from(level == MAX_LEVELS - 1) << 12;
        for (cell, mask) in self.cells.iter().zip(masks) {
            let [x, y, z] = cell.coordinates();
            let index = here.index([x, y, z]);
            let mut window = 0;
            for (neighbour, windows) in WINDOWS.iter().enumerate().skip(1) {
                let behind = (neighbour & 1) + (neighbour >> 1 & 1) * side + (neighbour >> 2) * side * side;
                window |= windows[usize::from(here.masks[index - behind])];
            }
            let ahead = u32::from(self.above.has([x + 1, y, z]))
                | u32::from(self.above.has([x, y + 1, z])) << 1
                | u32::from(self.above.has([x, y, z + 1])) << 2;
            let context = deepest | ahead << 9;
            let known = *mask;
            let mut found = 0;
            for child in 0..8u32 {
                let place = (child & 1) + 3 * (child >> 1 & 1) + 9 * (child >> 2);
                // Bit 13 is the child; a face at −x is bit 12, at −y 10, at −z 4; edges are bits 9, 3 and 1.
                let around = window >> place;
                let before =
                    around >> 12 & 1 | (around >> 9 & 3) << 1 | (around >> 3 & 3) << 3 | (around & 2) << 4;
                let bit = if child == 7 && found == 0 {
                    true
                } else {
                    bits.next(self.chances.of(context | before << 3 | child), known >> child & 1 != 0)
                };
                found |= u8::from(bit) << child;
                window |= u32::from(bit) << (place + 13);
            }
            *mask = found;
            here.masks[index] = found;
        }
        self.above = here;
    }

    /// Goes down to the children of a level's nodes.
    fn descend(&mut self, masks: &[u8]) {
        let children = masks.iter().map(|mask| mask.count_ones() as usize).sum();
        let mut cells = Vec::with_capacity(children);
        for (cell, &mask) in self.cells.iter().zip(masks) {
            let mut rest = u32::from(mask);
            while rest != 0 {
                cells.push(cell.child(rest.trailing_zeros()));
                rest &= rest - 1;
            }
        }
        self.cells = cells;
    }
}

/// The stored forms of the levels from `first` on, each the beginning of the next, of a cube's `levels` from its root on.
///
/// # Panics
/// Unless there are 1 to [`MAX_LEVELS`] levels and one from `first` on, the first level has one mask, each other as many
/// as the one above has bits, and no mask is zero.
pub(super) fn encode(levels: &[&[u8]], first: usize) -> Vec<Vec<u8>> {
    assert!(first < levels.len() && levels.len() <= MAX_LEVELS, "levels {first}.. of {}", levels.len());
    let mut walk = Walk::new();
    let mut stored = vec![first as u8 + 1];
    let mut forms = Vec::new();
    let mut encoder = Encoder::new();
    for (level, masks) in levels.iter().enumerate() {
        assert_eq!(masks.len(), walk.cells.len(), "masks of level {level}");
        assert!(!masks.contains(&0), "an inner node without children in level {level}");
        walk.level(level, &mut masks.to_vec(), &mut encoder);
        if level >= first {
            let bytes = std::mem::replace(&mut encoder, Encoder::new()).finish();
            stored.extend((bytes.len() as u32).to_le_bytes());
            stored.extend(bytes);
            forms.push(stored.clone());
        }
        walk.descend(masks);
    }
    forms
}

/// How many levels the first part of a form has, and its parts.
fn parse(stored: &[u8]) -> Result<(usize, Vec<&[u8]>), ArchiveError> {
    let broken = |found: &str| corrupt("coded masks", "the form of its size", found);
    let (&first, mut rest) = stored.split_first().ok_or_else(|| broken("nothing"))?;
    let first = usize::from(first);
    let mut parts = Vec::new();
    while !rest.is_empty() || parts.is_empty() {
        let (size, bytes) = rest.split_first_chunk::<4>().ok_or_else(|| broken("too few bytes"))?;
        let part;
        (part, rest) = bytes
            .split_at_checked(u32::from_le_bytes(*size) as usize)
            .ok_or_else(|| broken("too few bytes"))?;
        parts.push(part);
        if first == 0 || first + parts.len() > MAX_LEVELS + 1 {
            return Err(broken("other levels than there can be"));
        }
    }
    Ok((first, parts))
}

/// Where the forms end with which a form begins, in ascending order; the last one is the form itself. None of what is no
/// form.
pub(super) fn ends(stored: &[u8]) -> Vec<usize> {
    let Ok((_, parts)) = parse(stored) else { return Vec::new() };
    let next = |end: &mut usize, part: &&[u8]| {
        *end += 4 + part.len();
        Some(*end)
    };
    parts.iter().scan(1, next).collect()
}

/// Decodes a form into the masks of its last level.
pub(super) fn decode(stored: &[u8], raw: &mut [u8]) -> Result<(), ArchiveError> {
    let broken = |found: &str| corrupt("coded masks", "the form of its size", found);
    let (first, parts) = parse(stored)?;
    let mut walk = Walk::new();
    let mut level = 0;
    for (number, part) in parts.iter().enumerate() {
        let mut decoder = Decoder::new(part);
        let end = first + number;
        while level < end {
            if level + 1 == end && number + 1 == parts.len() {
                if walk.cells.len() != raw.len() {
                    return Err(broken("another number of nodes"));
                }
                walk.level(level, raw, &mut decoder);
            } else {
                let mut masks = vec![0; walk.cells.len()];
                walk.level(level, &mut masks, &mut decoder);
                walk.descend(&masks);
            }
            level += 1;
        }
        if !decoder.is_at_end() {
            return Err(broken("other bytes than the coder makes"));
        }
    }
    Ok(())
}
