//! The probabilities of [`row_code`](super::row_code): fixed, learned once from rows of generated scenes.
//!
//! Thousands of contexts share some tables, alike contexts one table. A table has 256 shares of [`ONE`], one for each
//! symbol. Symbols too rare to have a share are escaped: symbol 0, which nothing else needs where there are escapes,
//! then the symbol under the last table.
//!
//! `row_model.bin` is a zstd frame of the table of each context (one byte each), then the shares of all tables (two
//! bytes each, little-endian). `cargo run --release -p manyview-cache --example learn_rows` makes it. Any change of it
//! is another codec: archives would decode to something else.

use std::sync::OnceLock;

/// log2 of [`ONE`].
pub(super) const PROBABILITY_BITS: u32 = 10;
/// The sum of a table's shares.
pub const ONE: u32 = 1 << PROBABILITY_BITS;

/// The first context of the maps of the maps; 256 with the byte of the line before, 256 of the first line.
pub const MAP_OF_MAP: usize = 0;
/// The first context of the maps: 256 with the byte of the line before, 256 with that of the place before.
pub const MAP: usize = 512;
/// The first context of the content: three sets with one byte and four bits each.
pub const CONTENT: usize = 1024;
/// All contexts.
pub const CONTEXTS: usize = CONTENT + 3 * 256 * 16;
/// Tables for what, in their order: the map of the map, the map, the content; at last one for escaped symbols.
pub const TABLES: [usize; 4] = [8, 16, 32, 1];
/// The symbol that announces a rare one, in a context. Zero does not occur in the map and in the content; of the map of
/// the map it is the symbol that is rarest itself.
pub const fn escape(context: usize) -> u8 {
    if context < MAP { 0x55 } else { 0 }
}

const TABLE_COUNT: usize = TABLES[0] + TABLES[1] + TABLES[2] + TABLES[3];
const MODEL: &[u8] = include_bytes!("row_model.bin");
/// Of the content of [`MODEL`].
const MODEL_BYTES: usize = CONTEXTS + TABLE_COUNT * 512;

/// The tables, ready for both directions.
pub(super) struct Model {
    /// Sizes are powers of two, so that indices need no questions.
    table_of: [u8; 1 << 14],
    /// Start and share of each symbol of each table, in the lower and the upper half.
    intervals: [u32; MAX_TABLES << 8],
    /// What each part of [`ONE`] belongs to, of each table.
    slots: [Slot; MAX_TABLES << PROBABILITY_BITS],
}

const MAX_TABLES: usize = 64;
const _: () = assert!(TABLE_COUNT <= MAX_TABLES && CONTEXTS <= 1 << 14);

/// A symbol (8 bits), its share less one (12 bits), and how far a part of [`ONE`] is behind the symbol's start (12).
#[derive(Clone, Copy, Default)]
pub(super) struct Slot(u32);

impl Slot {
    #[inline(always)]
    pub(super) fn symbol(self) -> u8 {
        self.0 as u8
    }

    #[inline(always)]
    pub(super) fn share(self) -> u32 {
        (self.0 >> 8 & 0xfff) + 1
    }

    #[inline(always)]
    pub(super) fn offset(self) -> u32 {
        self.0 >> 20
    }
}

impl Model {
    /// The one model.
    pub(super) fn get() -> &'static Self {
        static THE_MODEL: OnceLock<Box<Model>> = OnceLock::new();
        // That the committed bytes are sound, a test tells.
        THE_MODEL.get_or_init(|| Self::of(&zstd::bulk::decompress(MODEL, MODEL_BYTES).unwrap_or_default()))
    }

    fn of(bytes: &[u8]) -> Box<Self> {
        let mut model = Box::new(Self { table_of: [0; _], intervals: [0; _], slots: [Slot(0); _] });
        let (table_of, shares) = bytes.split_at(bytes.len().min(CONTEXTS));
        model.table_of[..table_of.len()].copy_from_slice(table_of);
        for (number, table) in shares.chunks(512).enumerate() {
            let mut start = 0;
            for (symbol, share) in table.as_chunks::<2>().0.iter().enumerate() {
                let share = u32::from(u16::from_le_bytes(*share));
                model.intervals[number << 8 | symbol] = start | share << 16;
                for offset in 0..share {
                    let slot = Slot(symbol as u32 | (share - 1) << 8 | offset << 20);
                    model.slots[number << PROBABILITY_BITS | (start + offset) as usize] = slot;
                }
                start += share;
            }
        }
        model
    }

    /// The table of a context.
    #[inline(always)]
    pub(super) fn table(&self, context: usize) -> usize {
        self.table_of[context & ((1 << 14) - 1)].into()
    }

    pub(super) fn rare_table(&self) -> usize {
        TABLE_COUNT - 1
    }

    /// What a part of [`ONE`] belongs to.
    #[inline(always)]
    pub(super) fn slot(&self, table: usize, part: u32) -> Slot {
        self.slots[(table << PROBABILITY_BITS | part as usize) & ((MAX_TABLES << PROBABILITY_BITS) - 1)]
    }

    /// The number of a symbol in a context, among all tables' symbols.
    #[inline(always)]
    pub(super) fn place(&self, context: usize, symbol: u8) -> u16 {
        (self.table(context) << 8 | usize::from(symbol)) as u16
    }

    /// The number of an escaped symbol.
    pub(super) fn rare(&self, symbol: u8) -> u16 {
        (self.rare_table() << 8 | usize::from(symbol)) as u16
    }

    /// Whether a symbol has no share.
    #[inline(always)]
    pub(super) fn is_rare(&self, place: u16) -> bool {
        self.intervals[usize::from(place) & ((MAX_TABLES << 8) - 1)] >> 16 == 0
    }

    /// Start and share of a symbol.
    #[inline(always)]
    pub(super) fn interval(&self, place: u16) -> (u32, u32) {
        let interval = self.intervals[usize::from(place) & ((MAX_TABLES << 8) - 1)];
        (interval & 0xffff, interval >> 16)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_model_is_sound() {
        let bytes = zstd::bulk::decompress(MODEL, MODEL_BYTES).unwrap();
        assert_eq!(bytes.len(), MODEL_BYTES);
        let (table_of, shares) = bytes.split_at(CONTEXTS);
        let firsts = [0, TABLES[0], TABLES[0] + TABLES[1], TABLE_COUNT - 1];
        for (context, &table) in table_of.iter().enumerate() {
            let kind = usize::from(context >= MAP) + usize::from(context >= CONTENT);
            assert!((firsts[kind]..firsts[kind + 1]).contains(&table.into()), "context {context}");
        }
        for (table, shares) in shares.chunks(512).enumerate() {
            let share =
                |symbol: usize| u32::from(u16::from_le_bytes([shares[symbol * 2], shares[symbol * 2 + 1]]));
            assert_eq!((0..256).map(share).sum::<u32>(), ONE, "table {table}");
            let has_all = |symbols: std::ops::Range<usize>| symbols.clone().all(|symbol| share(symbol) > 0);
            match table {
                _ if table < firsts[1] => assert!(share(0) > 0 && share(escape(MAP_OF_MAP).into()) > 0),
                _ if table < firsts[3] => assert!(share(escape(MAP).into()) > 0, "table {table}"),
                _ => assert!(has_all(1..256) && share(0) == 0, "table {table}"),
            }
        }
    }
}
