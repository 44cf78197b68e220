//! Maps in files: an array that passes are written into as they come, or a picture of all maps.

use super::{ViewMaps, ViewSettings};
use crate::npy;
use crate::preview::NOTE_ATTRIBUTE;
use exr::prelude::{
    AnyChannel, AnyChannels, AttributeValue, Compression, Encoding, FlatSamples, Image, Layer,
    LayerAttributes, LineOrder, SmallVec, WritableImage,
};
use manyview_shaders::paraboloid::texel_count;
use manyview_shaders::srgb;
use std::io::{self, Seek, SeekFrom, Write};

/// A NumPy file of float32 (n, 2, R, R): view by view the front half and the back half, distances in metres.
///
/// Passes come in any order; each map goes to its place at once, so that memory holds one map.
#[derive(Debug)]
pub struct MapsArray<F> {
    file: F,
    start: u64,
    view_bytes: u64,
    /// Where the file stands.
    at: u64,
    views: u64,
    written: u64,
}

impl<F: Write + Seek> MapsArray<F> {
    /// Begins the array of `views` views.
    pub fn new(mut file: F, views: usize, resolution: u32) -> io::Result<Self> {
        let side = resolution as usize;
        npy::write_header::<f32>(&mut file, &[views, 2, side, side])?;
        let start = file.stream_position()?;
        let view_bytes = 4 * texel_count(resolution) as u64;
        Ok(Self { file, start, view_bytes, at: start, views: views as u64, written: 0 })
    }

    /// Writes the maps of a pass, views without maps as empty ones.
    pub fn write(&mut self, mut pass: ViewMaps) -> io::Result<()> {
        // Neighbours in the file behind each other.
        pass.sort();
        for (place, &view) in pass.views().iter().enumerate() {
            let at = self.start + u64::from(view) * self.view_bytes;
            if at != self.at {
                self.file.seek(SeekFrom::Start(at))?;
            }
            npy::write_elements(&mut self.file, &pass.view_depths(place))?;
            self.at = at + self.view_bytes;
            self.written += 1;
        }
        Ok(())
    }

    /// Ends the array and hands the file back.
    ///
    /// # Panics
    /// If views are missing.
    pub fn finish(self) -> F {
        assert_eq!(self.written, self.views, "each view is in exactly one pass");
        self.file
    }
}

/// A picture of all maps: tiles in rows, each the front half beside the back half.
#[derive(Debug)]
pub struct MapsPicture {
    resolution: u32,
    views: usize,
    /// Tiles side by side.
    columns: usize,
    depths: Vec<f32>,
    colors: Vec<[u8; 4]>,
}

impl MapsPicture {
    /// Bytes that the picture of `views` views takes in memory.
    pub fn bytes(views: usize, settings: &ViewSettings) -> u64 {
        let [width, height] = Self::size(views, settings.resolution);
        let pixel = if settings.with_colors { 8 + 12 } else { 4 };
        width as u64 * height as u64 * pixel
    }

    /// Pixels side by side and above each other: as near to a square as tiles allow.
    pub fn size(views: usize, resolution: u32) -> [usize; 2] {
        let columns = ((views as f64 / 2.0).sqrt().ceil() as usize).max(1);
        let side = resolution as usize;
        [columns * 2 * side, views.div_ceil(columns) * side]
    }

    /// An empty picture.
    pub fn new(views: usize, settings: &ViewSettings) -> Self {
        let [width, height] = Self::size(views, settings.resolution);
        let columns = width / (2 * settings.resolution as usize);
        let colors = vec![[0; 4]; if settings.with_colors { width * height } else { 0 }];
        let depths = vec![f32::INFINITY; width * height];
        Self { resolution: settings.resolution, views, columns, depths, colors }
    }

    /// Pixels side by side.
    pub fn width(&self) -> usize {
        self.columns * 2 * self.resolution as usize
    }

    /// Pixels above each other.
    pub fn height(&self) -> usize {
        self.depths.len() / self.width()
    }

    /// The distances, row by row, metres.
    pub fn depths(&self) -> &[f32] {
        &self.depths
    }

    /// Draws the maps of a pass at their places.
    pub fn draw(&mut self, pass: &ViewMaps) {
        let (side, width) = (self.resolution as usize, self.width());
        for (place, &view) in pass.views().iter().enumerate() {
            let map = pass.map_of()[place];
            if map == ViewMaps::NO_MAP {
                continue;
            }
            let corner = (view as usize / self.columns * width + view as usize % self.columns * 2) * side;
            for texel in 0..texel_count(self.resolution) {
                let (half, row, column) = (texel / (side * side), texel / side % side, texel % side);
                let at = corner + row * width + half * side + column;
                self.depths[at] = pass.depth(map as usize, texel);
                if !self.colors.is_empty() {
                    self.colors[at] = pass.colors()[map as usize * texel_count(self.resolution) + texel];
                }
            }
        }
    }

    /// Writes an EXR: distances in channel Y, linear colours, if there are any, in R, G, B. Its attribute `manyview`
    /// says how tiles lie.
    pub fn write_exr(self, file: &mut (impl Write + Seek)) -> io::Result<()> {
        let size = (self.width(), self.height());
        let note = format!(
            "{{\"views\":{},\"resolution\":{},\"columns\":{}}}",
            self.views, self.resolution, self.columns
        );
        let mut channels: SmallVec<[_; 4]> = SmallVec::new();
        if !self.colors.is_empty() {
            for (i, name) in ["R", "G", "B"].into_iter().enumerate() {
                let linear = |c: &[u8; 4]| srgb::linear(c[i]);
                let values = self.colors.iter().map(linear).collect();
                channels.push(AnyChannel::new(name, FlatSamples::F32(values)));
            }
        }
        channels.push(AnyChannel::new("Y", FlatSamples::F32(self.depths)));
        let encoding = Encoding {
            compression: Compression::ZIP16,
            line_order: LineOrder::Increasing,
            blocks: exr::image::Blocks::ScanLines,
        };
        let mut attributes = LayerAttributes::default();
        attributes.other.insert(NOTE_ATTRIBUTE.into(), AttributeValue::Text(note.as_str().into()));
        let layer = Layer::new(size, attributes, encoding, AnyChannels::sort(channels));
        Image::from_layer(layer).write().to_buffered(file).map_err(io::Error::other)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::views::Depths;
    use std::io::Cursor;

    fn pass(views: &[u32], maps: &[u32], first: f32) -> ViewMaps {
        let count = maps.iter().filter(|&&m| m != ViewMaps::NO_MAP).max().map_or(0, |m| m + 1) as usize;
        let depths = (0..count * 128).map(|i| first + i as f32).collect();
        let centers = vec![[0.0; 3]; count];
        ViewMaps::from_parts(8, views.to_vec(), maps.to_vec(), centers, Depths::Full(depths), Vec::new())
    }

    #[test]
    fn passes_in_any_order_make_one_array() {
        let mut array = MapsArray::new(Cursor::new(Vec::new()), 5, 8).unwrap();
        array.write(pass(&[4, 2], &[0, 1], 1000.0)).unwrap();
        array.write(pass(&[1, 0, 3], &[0, 0, ViewMaps::NO_MAP], 5000.0)).unwrap();
        let bytes = array.finish().into_inner();
        let mut reader =
            npy::ArrayReader::<f32, _>::new("d", bytes.as_slice(), &[&[None, Some(2), Some(8), Some(8)]])
                .unwrap();
        let mut values = vec![0.0; 5 * 128];
        assert_eq!(reader.shape(), [5, 2, 8, 8]);
        assert_eq!(reader.read(&mut values).unwrap(), 640);
        assert_eq!(values[4 * 128 + 7], 1007.0);
        assert_eq!(values[2 * 128 + 7], 1135.0);
        assert!(values[7] == 5007.0 && values[128 + 7] == 5007.0);
        assert!(values[3 * 128..4 * 128].iter().all(|d| *d == f32::INFINITY));
    }

    #[test]
    #[should_panic(expected = "each view is in exactly one pass")]
    fn missing_views_are_noticed() {
        MapsArray::new(Cursor::new(Vec::new()), 2, 8).unwrap().finish();
    }

    #[test]
    fn tiles_lie_in_a_near_square() {
        assert_eq!(MapsPicture::size(1, 16), [32, 16]);
        assert_eq!(MapsPicture::size(8, 16), [64, 64]);
        assert_eq!(MapsPicture::size(1000, 16), [23 * 32, 44 * 16]);
        let mut picture = MapsPicture::new(5, &ViewSettings::new(8));
        assert_eq!((picture.width(), picture.height()), (32, 24));
        picture.draw(&pass(&[4, 3], &[0, 1], 0.0));
        // View 4 is the left tile of the third row, its back half beside the front one.
        assert_eq!(picture.depths()[16 * 32], 0.0);
        assert_eq!(picture.depths()[16 * 32 + 8], 64.0);
        assert_eq!(picture.depths()[17 * 32 + 9], 73.0);
        assert_eq!(picture.depths()[8 * 32 + 16], 128.0);
        assert_eq!(picture.depths()[0], f32::INFINITY);
        assert_eq!(MapsPicture::bytes(5, &ViewSettings::new(8)), 4 * 32 * 24);
        let mut file = Cursor::new(Vec::new());
        picture.write_exr(&mut file).unwrap();
        assert_eq!(file.into_inner()[..4], [0x76, 0x2f, 0x31, 0x01]);
    }
}
