//! Looking at the bits of a row: any bit, or the first one.

use crate::row_test::RowPart;

/// The rows of one direction.
#[derive(Debug, Clone, Copy)]
pub struct DirectionBits<'a> {
    /// Layout of `rows.bits` ([`crate::sections`]).
    pub words: &'a [u32],
    /// log2 of voxels a side, at least 5.
    pub bits: u32,
    /// Whether a bit needs bits beside it.
    pub consensus: bool,
}

/// Bits `first ..= last` of a row, as far as they are in its word number `word`.
#[inline(always)]
pub fn word_mask(word: i32, first: i32, last: i32) -> u32 {
    let (from, to) = ((first - word * 32).max(0), (last - word * 32).min(31));
    if from > to { 0 } else { (u32::MAX >> (31 - (to - from))) << from }
}

/// The bits `first ..= last` of a row of 128, in two halves; none if `first > last`. Without a branch.
#[inline(always)]
pub fn row_mask(first: i32, last: i32) -> [u64; 2] {
    let half = |start: i32| {
        let (from, to) = (first - start, last - start);
        let is_met = u64::from((from <= 63) & (to >= 0) & (first <= last));
        let (from, to) = (from.clamp(0, 63), to.clamp(0, 63));
        (u64::MAX << from) & (u64::MAX >> (63 - to)) & is_met.wrapping_neg()
    };
    [half(0), half(64)]
}

/// A row of 128 bits in two halves.
#[inline(always)]
pub fn row_of_128(words: &[u32], row: usize) -> [u64; 2] {
    let row: &[u32; 4] = &words.as_chunks().0[row];
    [0, 2].map(|i| u64::from(row[i]) | u64::from(row[i + 1]) << 32)
}

impl DirectionBits<'_> {
    /// [`DirectionBits::any`] with consensus, for rows of 128 and the part's [`row_mask`].
    #[inline(always)]
    pub fn agreed_of_128(&self, row: u32, sides: u32, mask: [u64; 2]) -> bool {
        let size = 1i32 << self.bits;
        let (u, v) = (row as i32 & (size - 1), row as i32 >> self.bits);
        let step = |side: u32| (side & 1) as i32 * 2 - 1;
        let here = row_of_128(self.words, row as usize);
        let [along_u, along_v] =
            [self.beside_of_128(u + step(sides), v), self.beside_of_128(u, v + step(sides >> 1))];
        let found = [0, 1].map(|i| here[i] & mask[i] & along_u[i] & along_v[i]);
        found != [0; 2]
    }

    #[inline(always)]
    fn beside_of_128(&self, u: i32, v: i32) -> [u64; 2] {
        let size = 1i32 << self.bits;
        if (u | v) & !(size - 1) != 0 {
            return [0; 2];
        }
        let [low, high] = row_of_128(self.words, (v << self.bits | u) as usize);
        [low | low << 1 | low >> 1 | high << 63, high | high << 1 | high >> 1 | low >> 63]
    }

    /// Whether any bit of `part` is set.
    #[inline]
    pub fn any(&self, part: &RowPart) -> bool {
        (part.first >> 5..=part.last >> 5).any(|word| self.found(part, word) != 0)
    }

    /// The first set bit of `part`, seen from its start (`upwards`) or from its end.
    #[inline]
    pub fn first(&self, part: &RowPart, upwards: bool) -> Option<i32> {
        if part.first > part.last {
            return None;
        }
        let words = part.first >> 5..=part.last >> 5;
        let in_word = |word: i32| {
            let found = self.found(part, word);
            let bit = if upwards { found.trailing_zeros() } else { 31 - found.leading_zeros().min(31) };
            (found != 0).then_some(word * 32 + bit as i32)
        };
        if upwards { words.into_iter().find_map(in_word) } else { words.rev().find_map(in_word) }
    }

    /// The bits of `part` in one word that count.
    #[inline]
    fn found(&self, part: &RowPart, word: i32) -> u32 {
        let first_word = (part.row as usize) << (self.bits - 5);
        let found = self.words[first_word + word as usize] & word_mask(word, part.first, part.last);
        if !self.consensus || found == 0 {
            return found;
        }
        let (size, row) = (1i32 << self.bits, part.row as i32);
        let (u, v) = (row & (size - 1), row >> self.bits);
        let step = |side: u32| (side & 1) as i32 * 2 - 1;
        found & self.beside(u + step(part.sides), v, word) & self.beside(u, v + step(part.sides >> 1), word)
    }

    /// A word of a row with every bit spread to its neighbours; nothing outside the grid.
    #[inline]
    fn beside(&self, u: i32, v: i32, word: i32) -> u32 {
        let size = 1i32 << self.bits;
        if (u | v) & !(size - 1) != 0 {
            return 0;
        }
        let words = size >> 5;
        let row = ((v << self.bits | u) * words) as usize;
        let at = |w: i32| if (0..words).contains(&w) { self.words[row + w as usize] } else { 0 };
        let here = at(word);
        here | here << 1 | here >> 1 | at(word - 1) >> 31 | at(word + 1) << 31
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn masks_keep_exactly_the_bits_between() {
        for first in 0..64 {
            for last in -1..64 {
                for bit in 0..64 {
                    let set = word_mask(bit / 32, first, last) >> (bit % 32) & 1 == 1;
                    assert_eq!(set, (first..=last).contains(&bit), "{first} {bit} {last}");
                }
            }
        }
    }

    #[test]
    fn rows_of_128_are_looked_at_like_others() {
        let mut state = 1u64;
        let mut random = |below: u32| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as u32 % below
        };
        let words: Vec<u32> = (0..1 << 16).map(|_| 1 << random(32) | 1 << random(32)).collect();
        let one = DirectionBits { words: &words, bits: 7, consensus: false };
        let agreed = DirectionBits { consensus: true, ..one };
        let mut hits = [0; 2];
        for _ in 0..20_000 {
            let [row, sides] = [random(1 << 14), random(4)];
            let part = RowPart { row, first: random(129) as i32, last: random(129) as i32 - 1, sides };
            let mask = row_mask(part.first, part.last);
            let here = row_of_128(&words, row as usize);
            let any = (here[0] & mask[0]) | (here[1] & mask[1]) != 0;
            assert_eq!(any, one.any(&part), "{part:?}");
            assert_eq!(agreed.agreed_of_128(row, sides, mask), agreed.any(&part), "{part:?}");
            hits[0] += u32::from(any);
            hits[1] += u32::from(agreed.any(&part));
        }
        assert!(hits.iter().all(|hits| (500..19_500).contains(hits)), "{hits:?}");
    }

    /// 64³ voxels, the given ones set.
    fn rows(voxels: &[[i32; 3]]) -> Vec<u32> {
        let mut words = vec![0; 1 << 13];
        for [u, v, w] in voxels {
            words[((v << 6 | u) * 2 + (w >> 5)) as usize] |= 1u32 << (w & 31);
        }
        words
    }

    fn part(u: u32, v: u32, first: i32, last: i32, sides: u32) -> RowPart {
        RowPart { row: v << 6 | u, first, last, sides }
    }

    #[test]
    fn the_first_bit_is_the_nearest_from_either_side() {
        let words = rows(&[[3, 5, 10], [3, 5, 40], [3, 5, 41], [3, 5, 63], [4, 5, 12]]);
        let bits = DirectionBits { words: &words, bits: 6, consensus: false };
        for (first, last, up, down) in [
            (0, 63, Some(10), Some(63)),
            (11, 62, Some(40), Some(41)),
            (11, 39, None, None),
            (41, 41, Some(41), Some(41)),
            (1, 0, None, None),
        ] {
            let part = part(3, 5, first, last, 0);
            assert_eq!((bits.first(&part, true), bits.first(&part, false)), (up, down), "{first} {last}");
            assert_eq!(bits.any(&part), up.is_some());
        }
    }

    #[test]
    fn consensus_asks_both_neighbours_on_the_segments_side() {
        // A bit at the end of a word; its neighbour along u is the next bit, in the next word.
        let words = rows(&[[3, 5, 31], [4, 5, 32], [3, 6, 31], [3, 4, 29]]);
        let bits = DirectionBits { words: &words, bits: 6, consensus: true };
        assert!(bits.any(&part(3, 5, 0, 63, 0b11)));
        assert!(!bits.any(&part(3, 5, 0, 63, 0b10)), "nothing at u − 1");
        assert!(!bits.any(&part(3, 5, 0, 63, 0b01)), "two bits away at v − 1");
        let border = rows(&[[0, 5, 7], [0, 6, 7]]);
        let bits = DirectionBits { words: &border, bits: 6, consensus: true };
        assert!(!bits.any(&part(0, 5, 0, 63, 0b10)), "outside the grid is nothing");
    }
}
