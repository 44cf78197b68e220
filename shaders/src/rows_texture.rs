//! How the rows of many directions lie in one texture.
//!
//! # Practice
//! WebGPU's default limits bind 128 MiB of a storage buffer, and the rows of the paper's set take 2 GiB. A 2D-array
//! texture of format `rgba32uint` holds them within those limits: one texel is 128 voxels of a row. Shaders read it
//! with `textureLoad`; nothing is filtered.
//!
//! - A row of `2^bits` voxels is [`RowsTexture::texels_a_row`] texels side by side: one up to 128 voxels (the upper
//!   words of rows of 32 or 64 voxels are 0), two for 256.
//! - The rows of a direction are a *tile*: row u, v begins `u · texels_a_row` texels to the right of the tile's corner
//!   and v texels below. Which direction is in which tile is up to the scene.
//! - Tiles fill a layer from left to right, then from top to bottom, then the next layer. Layers are at most 8192
//!   texels wide and high. There are as few lines of tiles as that allows, all of one length, in 32 layers of one height
//!   (fewer for fewer lines, more where they would be too high). Layers are small because drivers zero a layer as a whole
//!   when its first tile arrives: what is to be usable soon should not have to wait for gigabytes of zeros.
//!
//! The paper's 90 × 90 directions of 128³ voxels are 64 × 4 tiles of 128 × 128 texels in each of 32 layers of 8192 × 512
//! texels, 2 GiB. Tile 4,175 is in layer 16, line 1, column 15: its corner is texel (1920, 128, 16), and row u = 3,
//! v = 2 of it is texel (1923, 130, 16).

use std::sync::Arc;

use thiserror::Error;

/// WebGPU's default limit of a texture's width and height, texels.
pub const MAX_TEXTURE_SIDE: u32 = 8192;
/// WebGPU's default limit of a texture's layers.
pub const MAX_TEXTURE_LAYERS: u32 = 256;
/// Layers are made as many as that, where there are so many lines of tiles.
const USUAL_LAYERS: u32 = 32;
/// Words of a texel.
pub const TEXEL_WORDS: u32 = 4;

/// Rows that no texture within WebGPU's default limits holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
#[error(
    "{directions} directions of {side}³ voxels do not fit a texture within WebGPU's default limits, which hold {most}; take a smaller set or fewer voxels",
    side = 1u64 << bits
)]
pub struct RowsTextureError {
    /// log2 of voxels a side.
    pub bits: u32,
    /// Directions asked for.
    pub directions: u32,
    /// Directions that a texture holds: 0 where there is no layout for so many voxels a side.
    pub most: u32,
}

/// Where the rows of each direction are in a texture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RowsTexture {
    bits: u32,
    tiles: u32,
    tiles_across: u32,
    tiles_down: u32,
    layers: u32,
}

impl RowsTexture {
    /// The layout for a number of directions of `2^bits` voxels a side (5 to 8 bits).
    pub fn new(bits: u32, directions: u32) -> Result<Self, RowsTextureError> {
        let most = Self::most_directions(bits);
        if directions > most {
            return Err(RowsTextureError { bits, directions, most });
        }
        let [across, down] = tiles_a_side(bits);
        let lines = directions.div_ceil(across).max(1);
        let tiles_across = directions.div_ceil(lines).max(1);
        let tiles_down = lines.div_ceil(USUAL_LAYERS).min(down);
        Ok(Self { bits, tiles: directions, tiles_across, tiles_down, layers: lines.div_ceil(tiles_down) })
    }

    /// Directions of `2^bits` voxels a side that a texture holds; 0 for other than 5 to 8 bits.
    pub fn most_directions(bits: u32) -> u32 {
        if (5..=8).contains(&bits) {
            tiles_a_side(bits).iter().product::<u32>() * MAX_TEXTURE_LAYERS
        } else {
            0
        }
    }

    /// log2 of voxels a side.
    pub fn bits(&self) -> u32 {
        self.bits
    }

    /// Directions, and tiles.
    pub fn directions(&self) -> u32 {
        self.tiles
    }

    /// Texels that one row takes.
    pub fn texels_a_row(&self) -> u32 {
        texels_a_row(self.bits)
    }

    /// Words of one row as the archive has it.
    pub fn words_a_row(&self) -> u32 {
        (1 << self.bits) / 32
    }

    /// Words of one direction's rows as the archive has them.
    pub fn words_a_direction(&self) -> usize {
        1 << (3 * self.bits - 5)
    }

    /// Texels of a tile along x and y.
    pub fn tile_size(&self) -> [u32; 2] {
        [texels_a_row(self.bits) << self.bits, 1 << self.bits]
    }

    /// Tiles side by side, and one above the other, in a layer.
    pub fn tiles_a_layer(&self) -> [u32; 2] {
        [self.tiles_across, self.tiles_down]
    }

    /// Width and height in texels, and layers.
    pub fn size(&self) -> [u32; 3] {
        let [width, height] = self.tile_size();
        [self.tiles_across * width, self.tiles_down * height, self.layers]
    }

    /// Bytes of the whole texture.
    pub fn bytes(&self) -> u64 {
        self.size().iter().map(|&side| u64::from(side)).product::<u64>() * 16
    }

    /// The texel (x, y, layer) at the corner of a tile.
    ///
    /// # Panics
    /// In a debug build, if there is no such tile.
    #[inline]
    pub fn tile_origin(&self, tile: u32) -> [u32; 3] {
        debug_assert!(tile < self.tiles, "{tile} of {} tiles", self.tiles);
        let [width, height] = self.tile_size();
        let line = tile / self.tiles_across;
        [tile % self.tiles_across * width, line % self.tiles_down * height, line / self.tiles_down]
    }

    /// The tile that a texel (x, y, layer) is in, and the first word of the texel in the rows of the tile's direction as
    /// the archive has them; `None` outside all tiles.
    #[inline]
    pub fn word_of(&self, [x, y, layer]: [u32; 3]) -> Option<(u32, usize)> {
        let [width, height] = self.tile_size();
        let (column, line) = (x / width, y / height);
        if column >= self.tiles_across || line >= self.tiles_down {
            return None;
        }
        let tile = (layer * self.tiles_down + line) * self.tiles_across + column;
        let words = TEXEL_WORDS.min(self.words_a_row());
        let word = (y % height) as usize * (width * words) as usize + (x % width * words) as usize;
        (tile < self.tiles).then_some((tile, word))
    }

    /// Writes the texels of a direction, line by line, from its rows as the archive has them.
    ///
    /// # Panics
    /// If `rows` is not one direction's.
    pub fn write_tile(&self, rows: &[u32], texels: &mut Vec<[u32; 4]>) {
        assert_eq!(rows.len(), self.words_a_direction(), "words of one direction");
        texels.clear();
        match self.words_a_row() {
            1 => texels.extend(rows.iter().map(|&word| [word, 0, 0, 0])),
            2 => texels.extend(rows.as_chunks().0.iter().map(|&[low, high]| [low, high, 0, 0])),
            _ => texels.extend_from_slice(rows.as_chunks().0),
        }
    }
}

/// A rows texture on the CPU. The rows are not copied: tile i is what is the i-th direction in memory.
#[derive(Debug, Clone)]
pub struct RowsImage {
    layout: RowsTexture,
    rows: Arc<Vec<u32>>,
}

impl RowsImage {
    /// The texture of a layout over rows as the archive has them, direction after direction.
    ///
    /// # Panics
    /// If there are other than the layout's directions.
    pub fn new(layout: RowsTexture, rows: Arc<Vec<u32>>) -> Self {
        let words = layout.directions() as usize * layout.words_a_direction();
        assert_eq!(rows.len(), words, "words of {} directions", layout.directions());
        Self { layout, rows }
    }

    /// Where directions are.
    pub fn layout(&self) -> &RowsTexture {
        &self.layout
    }

    /// The rows, direction after direction.
    pub fn rows(&self) -> &Arc<Vec<u32>> {
        &self.rows
    }

    /// What `textureLoad` gives at (x, y, layer); zero where there is no direction.
    #[inline]
    pub fn texel(&self, at: [u32; 3]) -> [u32; 4] {
        let mut texel = [0; 4];
        if let Some((tile, word)) = self.layout.word_of(at) {
            let first = tile as usize * self.layout.words_a_direction() + word;
            let words = self.layout.words_a_row().min(TEXEL_WORDS) as usize;
            texel[..words].copy_from_slice(&self.rows[first..first + words]);
        }
        texel
    }
}

fn texels_a_row(bits: u32) -> u32 {
    ((1u32 << bits) / 128).max(1)
}

fn tiles_a_side(bits: u32) -> [u32; 2] {
    [MAX_TEXTURE_SIDE / (texels_a_row(bits) << bits), MAX_TEXTURE_SIDE >> bits]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_papers_set_takes_two_gibibytes() {
        let layout = RowsTexture::new(7, 8100).unwrap();
        assert_eq!(layout.size(), [8192, 512, 32]);
        assert_eq!(layout.bytes(), 2 << 30);
        assert_eq!(layout.tile_origin(0), [0, 0, 0]);
        assert_eq!(layout.tile_origin(63), [8064, 0, 0]);
        assert_eq!(layout.tile_origin(64), [0, 128, 0]);
        assert_eq!(layout.tile_origin(255), [8064, 384, 0]);
        assert_eq!(layout.tile_origin(4175), [1920, 128, 16]);
        assert_eq!(layout.word_of([1923, 130, 16]), Some((4175, (2 * 128 + 3) * 4)));
    }

    #[test]
    fn few_directions_take_a_small_texture() {
        for (bits, directions, size) in [
            (5, 1, [32, 32, 1]),
            (5, 36, [36 * 32, 32, 1]),
            (6, 8100, [127 * 64, 2 * 64, 32]),
            (7, 0, [128, 128, 1]),
            (7, 65, [33 * 128, 128, 2]),
            (7, 4097, [8192, 3 * 128, 22]),
            (8, 17, [9 * 512, 256, 2]),
            (8, 8100, [8192, 16 * 256, 32]),
            // Full height: more layers than usual.
            (7, 64 * 64 * 33, [8192, 8192, 33]),
        ] {
            let layout = RowsTexture::new(bits, directions).unwrap();
            assert_eq!(layout.size(), size, "{directions} of {bits} bits");
        }
    }

    #[test]
    fn layouts_stay_within_the_default_limits() {
        for bits in 5..=8 {
            let most = RowsTexture::most_directions(bits);
            for directions in [1, 63, 64, 65, 4097, 8100, most] {
                let layout = RowsTexture::new(bits, directions.min(most)).unwrap();
                let [width, height, layers] = layout.size();
                assert!(
                    width <= MAX_TEXTURE_SIDE && height <= MAX_TEXTURE_SIDE && layers <= MAX_TEXTURE_LAYERS
                );
            }
            let error = RowsTexture::new(bits, most + 1).unwrap_err();
            assert_eq!(error, RowsTextureError { bits, directions: most + 1, most });
        }
        assert!(RowsTexture::new(4, 1).is_err() && RowsTexture::new(9, 1).is_err());
        assert!(RowsTexture::new(8, 1 << 18).unwrap_err().to_string().contains("256³"));
    }

    /// Every texel of every tile holds the words that the tile's own loops put there, and no two tiles overlap.
    #[test]
    fn texels_are_the_archives_words() {
        for (bits, directions) in [(5, 300), (6, 130), (7, 66), (8, 18)] {
            let layout = RowsTexture::new(bits, directions).unwrap();
            let words = layout.words_a_direction();
            let rows: Vec<u32> =
                (0..directions as usize * words).map(|i| (i as u32).wrapping_mul(2_654_435_761)).collect();
            let image = RowsImage::new(layout, Arc::new(rows.clone()));
            let [width, height] = layout.tile_size();
            let mut texels = Vec::new();
            for direction in [0, 1, directions / 2, directions - 1] {
                let rows = &rows[direction as usize * words..][..words];
                layout.write_tile(rows, &mut texels);
                assert_eq!(texels.len() as u32, width * height);
                let corner = layout.tile_origin(direction);
                let a_row = layout.words_a_row() as usize;
                for v in [0, 1, (1 << bits) - 1] {
                    for u in [0, 3, (1 << bits) - 1] {
                        let row = &rows[((v << bits) + u) * a_row..][..a_row];
                        for part in 0..layout.texels_a_row() {
                            let x = u as u32 * layout.texels_a_row() + part;
                            let texel = image.texel([corner[0] + x, corner[1] + v as u32, corner[2]]);
                            let expected = &row[part as usize * 4..][..a_row.min(4)];
                            assert_eq!(&texel[..expected.len()], expected);
                            assert!(texel[expected.len()..].iter().all(|&word| word == 0));
                            assert_eq!(texels[v * width as usize + x as usize], texel);
                        }
                    }
                }
            }
            assert_eq!(image.texel([MAX_TEXTURE_SIDE, 0, 0]), [0; 4]);
            assert_eq!(image.texel([0, 0, 300]), [0; 4]);
        }
    }
}
