//! How a tile of rows is stored: each byte that is not zero under a probability that its neighbours tell.
//!
//! Bit voxelizations of surfaces are mostly zero, and what is not is alike from row to row. So a tile is coded line by
//! line (a *line* is all rows of one v, n rows of n / 8 bytes); of each line first *where* bytes are not zero, then
//! *what* they are:
//!
//! 1. The line's *map*, n² / 64 bytes: bit r of the map's bytes of place i tells whether byte i of row r is not zero.
//!    Bytes of the map that are zero are left out; one bit for each, the *map of the map*, tells so and comes first.
//! 2. The bytes that are not zero, by place, then by row.
//!
//! Every one of these bytes is a symbol of an arithmetic code (rANS: Duda, "Asymmetric numeral systems", 2013; here four
//! interleaved states of 32 bits, renormalized by 16), whose probabilities follow from a *context* of what is decoded
//! already: the same byte of the line before, its neighbours there, whether left and right in this line there is
//! something. The probabilities are fixed, part of this codec ([`row_model`](super::row_model)): so a tile needs no
//! tables of its own and may be small.
//!
//! Measured on a forest that the probabilities were not learned from (`examples/row_code.rs`): 20 times smaller than the
//! voxels, where the same bytes in larger tiles under zstd are 16 times smaller; made as fast, decoded half as fast.

use super::error::{ArchiveError, corrupt};
use super::row_model::{CONTENT, MAP, MAP_OF_MAP, Model, PROBABILITY_BITS, escape};

/// Content of a tile. A power of two of BLAKE3's chunks, so that tiles have subtrees of the content's digest.
pub const TILE_BYTES: usize = 16 << 10;

/// Bytes of a row, at least and at most: of 32 and of 256 voxels.
const ROW_BYTES: std::ops::RangeInclusive<usize> = 4..=32;
const MAX_ROW: usize = *ROW_BYTES.end();
/// Of a line of the longest rows.
const MAP_BYTES: usize = MAX_ROW * MAX_ROW;
/// Each state is at least this between symbols; the coder begins, so the decoder ends, with it.
const STATE_MIN: u32 = 1 << 16;
/// States that take turns, so that a processor works on several symbols at once.
const STATES: usize = 4;
/// All states.
const HEAD_BYTES: usize = 4 * STATES;

/// How rows lie in content.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Shape {
    /// Bytes of a row, a power of two.
    row: usize,
}

impl Shape {
    /// Rows of so many bytes, if content may have them.
    pub(super) fn new(row_bytes: usize) -> Option<Self> {
        (row_bytes.is_power_of_two() && ROW_BYTES.contains(&row_bytes)).then_some(Self { row: row_bytes })
    }

    /// Bytes of a row.
    pub(super) fn row_bytes(self) -> usize {
        self.row
    }

    /// Bytes of a line.
    pub(super) fn line_bytes(self) -> usize {
        self.row * self.row * 8
    }
}

/// One direction of the coder, as [`Lines::walk`] sees it.
pub(super) trait Symbols {
    /// Whether the bytes are known before the walk.
    const ENCODES: bool;

    /// The next symbol: `known` where that is so, else what the code says.
    fn next(&mut self, context: usize, known: u8) -> u8;
}

/// Room for a tile and its maps. Sizes are those of the largest rows, so that indices need no questions.
pub(super) struct Lines {
    /// A row and a line of zeros, then the tile: what lies before the tile needs no questions.
    bytes: [u8; 1 << 15],
    /// Maps of this line and of the last, each behind one place of zeros.
    maps: [[u8; MAP_BYTES + MAX_ROW]; 2],
    /// Likewise.
    maps_of_maps: [[u8; MAP_BYTES / 8 + MAX_ROW]; 2],
    /// Where in `bytes` this line has content (16 bits), and [`SIDES`] and [`BELOW`]. Eight are written at once.
    list: [u32; MAX_ROW * MAP_BYTES / 4 + 8],
}

/// In an entry of the list, from here on: whether there is something at the same place of the row right of this one, and
/// of the row left of it.
const SIDES: u32 = 18;
/// In an entry of the list: 1 where there is a byte before this one in its row.
const BELOW: u32 = 16;

impl Lines {
    pub(super) fn new() -> Box<Self> {
        Box::new(Self { bytes: [0; _], maps: [[0; _]; 2], maps_of_maps: [[0; _]; 2], list: [0; _] })
    }

    fn tile(&mut self, shape: Shape, bytes: usize) -> &mut [u8] {
        &mut self.bytes[shape.row + shape.line_bytes()..][..bytes]
    }

    /// Visits the symbols of a tile.
    fn walk<S: Symbols>(&mut self, shape: Shape, bytes: usize, symbols: &mut S) {
        self.maps[1].fill(0);
        match shape.row {
            4 => self.walk_rows::<4, S>(bytes, symbols),
            8 => self.walk_rows::<8, S>(bytes, symbols),
            16 => self.walk_rows::<16, S>(bytes, symbols),
            _ => self.walk_rows::<32, S>(bytes, symbols),
        }
    }

    /// Visits the symbols of a tile in their order, with their contexts; the bytes are read where they are known, else
    /// written.
    ///
    /// A context refers to nothing that comes later. Left of a line's first row it meets the end of the line before, right
    /// of the last row of the line before the start of this one: known too, and not worth a question.
    fn walk_rows<const ROW: usize, S: Symbols>(&mut self, tile_bytes: usize, symbols: &mut S) {
        let line = 8 * ROW * ROW;
        let map_bytes = ROW * ROW;
        let place_above = (ROW / 8).max(1);
        let Self { bytes, maps: [map, last_map], maps_of_maps: [above, last_above], list } = self;
        let first = ROW + line;
        for start in (first..first + tile_bytes).step_by(line) {
            let is_first = start == first;
            map[ROW..ROW + map_bytes].fill(0);
            if S::ENCODES {
                fill_map::<ROW>(&bytes[start..start + line], &mut map[ROW..ROW + map_bytes]);
            }
            for at in 0..map_bytes / 8 {
                let known = if S::ENCODES { bits_of(&map[ROW + at * 8..]) } else { 0 };
                let (last, before) = (last_above[at + place_above], above[at]);
                let context = if is_first { 256 + usize::from(before) } else { last.into() };
                above[at + place_above] = symbols.next(MAP_OF_MAP + context, known);
            }
            for (eight, &present) in above[place_above..place_above + map_bytes / 8].iter().enumerate() {
                for at in ones(present).map(|bit| ROW + eight * 8 + bit) {
                    let (last, before) = (usize::from(last_map[at]), 256 + usize::from(map[at - ROW]));
                    let context = if last == 0 { before } else { last };
                    map[at] = symbols.next(MAP + context, map[at]);
                }
            }
            let maps = (&above[place_above..place_above + map_bytes / 8], &map[ROW..ROW + map_bytes]);
            let count = list_content::<ROW>(start, maps, list);
            if is_first {
                visit_content::<ROW, true, S>(bytes, &list[..count], symbols);
            } else {
                visit_content::<ROW, false, S>(bytes, &list[..count], symbols);
            }
            std::mem::swap(map, last_map);
            std::mem::swap(above, last_above);
        }
    }
}

/// Visits the bytes that are not zero of a line, the tile's first one or another.
#[inline(always)]
fn visit_content<const ROW: usize, const IS_FIRST: bool, S: Symbols>(
    bytes: &mut [u8; 1 << 15],
    list: &[u32],
    symbols: &mut S,
) {
    let line = 8 * ROW * ROW;
    for &entry in list {
        let at = (entry & 0x7fff) as usize;
        let below = usize::from(bytes[at - 1] >> 7) & (entry >> BELOW) as usize & 1;
        let above = usize::from(bytes[at + 1 - line] & 1);
        let around = (entry >> SIDES << 2) as usize | below << 1 | above;
        let (set, value) = if IS_FIRST {
            (2, bytes[at - ROW])
        } else {
            let beside = bytes[at - line - ROW] | bytes[at + ROW - line];
            let up = bytes[at - line];
            // Without a branch: nobody could foresee it.
            let is_new = usize::from(up == 0);
            (is_new, up | beside & (is_new as u8).wrapping_neg())
        };
        let context = (set << 8 | usize::from(value)) << 4 | around;
        bytes[at] = symbols.next(CONTENT + context, bytes[at]);
    }
}

/// The numbers of the set bits of a byte, then anything.
static ONES: [[u8; 8]; 256] = {
    let mut ones = [[0; 8]; 256];
    let mut byte = 0;
    while byte < 256 {
        let (mut bit, mut count) = (0, 0);
        while bit < 8 {
            if byte >> bit & 1 == 1 {
                ones[byte][count] = bit;
                count += 1;
            }
            bit += 1;
        }
        byte += 1;
    }
    ones
};

/// Lists where a line that begins at `start` has content, by place, then by row; how much there is.
#[inline(always)]
fn list_content<const ROW: usize>(
    start: usize,
    (map_of_map, map): (&[u8], &[u8]),
    list: &mut [u32],
) -> usize {
    let row_shift = ROW.trailing_zeros();
    let mut count = 0;
    for (eight, &present) in map_of_map.iter().enumerate() {
        for index in ones(present).map(|bit| eight * 8 + bit) {
            // Eight rows at one place. Beyond the line's ends there is nothing.
            let (i, group) = (index >> row_shift, index & (ROW - 1));
            let present = map[index];
            let left = if group == 0 { 0 } else { map[index - 1] >> 7 };
            let right = if group == ROW - 1 { 0 } else { map[index + 1] & 1 };
            let (left, right) =
                (u32::from(present) << 1 | u32::from(left), u32::from(present) >> 1 | u32::from(right) << 7);
            let first = (start + group * 8 * ROW + i) as u32 | u32::from(i > 0) << BELOW;
            // All eight are written, without a question; the next byte's overwrite what was no set bit.
            let room = &mut list[count..count + 8];
            for (entry, &bit) in room.iter_mut().zip(&ONES[usize::from(present)]) {
                let sides = (left >> bit & 1) << 1 | (right >> bit & 1);
                *entry = (first + (u32::from(bit) << row_shift)) | sides << SIDES;
            }
            count += present.count_ones() as usize;
        }
    }
    count
}

/// The set bits of a byte.
#[inline(always)]
fn ones(mut byte: u8) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        (byte != 0).then(|| {
            let bit = byte.trailing_zeros() as usize;
            byte &= byte - 1;
            bit
        })
    })
}

/// Which of eight bytes are not zero.
#[inline(always)]
fn bits_of(bytes: &[u8]) -> u8 {
    let word =
        u64::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3], bytes[4], bytes[5], bytes[6], bytes[7]]);
    const LOW: u64 = 0x7f7f_7f7f_7f7f_7f7f;
    // The upper bit of each byte that is not zero, then all of them together.
    let some = (((word & LOW) + LOW) | word) & !LOW;
    ((some >> 7).wrapping_mul(0x0102_0408_1020_4080) >> 56) as u8
}

/// The map of a line, into zeros.
fn fill_map<const ROW: usize>(line: &[u8], map: &mut [u8]) {
    // Eight rows, eight places at once.
    let places = ROW.min(8);
    for (group, rows) in line.chunks_exact(8 * ROW).enumerate() {
        for first in (0..ROW).step_by(8) {
            let mut bits = 0;
            for r in 0..8 {
                let at = r * ROW + first;
                let of_row = if places == 8 {
                    bits_of(&rows[at..at + 8])
                } else {
                    let [a, b, c, d] = [rows[at], rows[at + 1], rows[at + 2], rows[at + 3]];
                    bits_of(&[a, b, c, d, 0, 0, 0, 0])
                };
                bits |= u64::from(of_row) << (8 * r);
            }
            if bits == 0 {
                continue;
            }
            let by_place = transposed(bits).to_le_bytes();
            for (i, of_place) in by_place[..places].iter().enumerate() {
                map[(first + i) * ROW + group] = *of_place;
            }
        }
    }
}

/// Bit 8·r + i becomes bit 8·i + r (Warren, "Hacker's Delight", 7-3).
fn transposed(mut bits: u64) -> u64 {
    for (mask, shift) in
        [(0x00aa_00aa_00aa_00aa, 7), (0x0000_cccc_0000_cccc, 14), (0x0000_0000_f0f0_f0f0, 28)]
    {
        let swapped = (bits ^ (bits >> shift)) & mask;
        bits ^= swapped ^ (swapped << shift);
    }
    bits
}

/// The coded form of a tile, which is a multiple of lines, appended to `stored`; `false`, and nothing appended, where
/// it would be no smaller than the tile.
pub(super) fn encode(lines: &mut Lines, shape: Shape, tile: &[u8], stored: &mut Vec<u8>) -> bool {
    lines.tile(shape, tile.len()).copy_from_slice(tile);
    let mut gather = Gather { model: Model::get(), symbols: Vec::with_capacity(tile.len() / 4) };
    lines.walk(shape, tile.len(), &mut gather);
    let Gather { model, symbols } = gather;

    // The decoder takes last what the coder puts first.
    let mut states = [STATE_MIN; STATES];
    let mut words = Vec::with_capacity(symbols.len() / 2);
    for (number, &symbol) in symbols.iter().enumerate().rev() {
        let state = &mut states[number % STATES];
        let (start, share) = model.interval(symbol);
        if u64::from(*state) >= u64::from(share) << (32 - PROBABILITY_BITS) {
            words.push(*state as u16);
            *state >>= 16;
        }
        *state = ((*state / share) << PROBABILITY_BITS) + *state % share + start;
        if HEAD_BYTES + words.len() * 2 >= tile.len() {
            return false;
        }
    }
    states.iter().for_each(|state| stored.extend(state.to_le_bytes()));
    words.iter().rev().for_each(|word| stored.extend(word.to_le_bytes()));
    true
}

/// Visits the symbols of a tile and their contexts, to count them.
pub fn visit_symbols(row_bytes: usize, tile: &[u8], visit: &mut dyn FnMut(usize, u8)) {
    struct Visit<'a>(&'a mut dyn FnMut(usize, u8));
    impl Symbols for Visit<'_> {
        const ENCODES: bool = true;

        fn next(&mut self, context: usize, known: u8) -> u8 {
            (self.0)(context, known);
            known
        }
    }
    if let Some(shape) = Shape::new(row_bytes).filter(|shape| tile.len().is_multiple_of(shape.line_bytes())) {
        let mut lines = Lines::new();
        lines.tile(shape, tile.len()).copy_from_slice(tile);
        lines.walk(shape, tile.len(), &mut Visit(visit));
    }
}

/// Collects what is to be coded: places in the model.
struct Gather {
    model: &'static Model,
    symbols: Vec<u16>,
}

impl Symbols for Gather {
    const ENCODES: bool = true;

    #[inline(always)]
    fn next(&mut self, context: usize, known: u8) -> u8 {
        let symbol = self.model.place(context, known);
        if known == escape(context) || self.model.is_rare(symbol) {
            self.symbols.push(self.model.place(context, escape(context)));
            self.symbols.push(self.model.rare(known));
        } else {
            self.symbols.push(symbol);
        }
        known
    }
}

/// Decodes a tile into `raw`, a multiple of lines.
pub(super) fn decode(
    lines: &mut Lines,
    shape: Shape,
    stored: &[u8],
    raw: &mut [u8],
) -> Result<(), ArchiveError> {
    let broken = |found: &str| corrupt("coded rows", "the form of its size", found);
    let (head, words) = stored.split_first_chunk::<HEAD_BYTES>().ok_or_else(|| broken("too few bytes"))?;
    let state = |at: usize| u32::from_le_bytes([head[at], head[at + 1], head[at + 2], head[at + 3]]);
    let states = (state(0), state(4), state(8), state(12));
    let (words, rest) = words.as_chunks::<2>();
    let mut decoder = Decoder { model: Model::get(), states, words, next: 0 };
    lines.tile(shape, raw.len()).fill(0);
    lines.walk(shape, raw.len(), &mut decoder);
    if decoder.states != (STATE_MIN, STATE_MIN, STATE_MIN, STATE_MIN)
        || decoder.next != words.len()
        || !rest.is_empty()
    {
        return Err(broken("other bytes than the coder makes"));
    }
    raw.copy_from_slice(lines.tile(shape, raw.len()));
    Ok(())
}

struct Decoder<'a> {
    model: &'static Model,
    /// First that of the next symbol.
    states: (u32, u32, u32, u32),
    words: &'a [[u8; 2]],
    next: usize,
}

impl Decoder<'_> {
    #[inline(always)]
    fn symbol(&mut self, table: usize) -> u8 {
        let now = self.states.0;
        let slot = self.model.slot(table, now & ((1 << PROBABILITY_BITS) - 1));
        let mut state = slot.share() * (now >> PROBABILITY_BITS) + slot.offset();
        // Past the end, zeros: what comes out then is refused at the end. No branch: nobody could foresee it.
        let word = self.words.get(self.next).copied().unwrap_or_default();
        let is_small = state < STATE_MIN;
        let filled = state << 16 | u32::from(u16::from_le_bytes(word));
        state = if is_small { filled } else { state };
        self.next += usize::from(is_small);
        self.states = (self.states.1, self.states.2, self.states.3, state);
        slot.symbol()
    }
}

impl Symbols for Decoder<'_> {
    const ENCODES: bool = false;

    #[inline(always)]
    fn next(&mut self, context: usize, _: u8) -> u8 {
        let symbol = self.symbol(self.model.table(context));
        if symbol == escape(context) { self.symbol(self.model.rare_table()) } else { symbol }
    }
}
