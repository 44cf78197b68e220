//! The maps of some views.

use super::ViewSettings;
use crate::simd::prefetch;
use half::f16;
use manyview_shaders::paraboloid::{texel, texel_count};

/// Distances of all maps, metres, +infinity where nothing is; map after map, texels by
/// [`manyview_shaders::paraboloid`].
#[derive(Debug, Clone, PartialEq)]
pub enum Depths {
    /// In full.
    Full(Vec<f32>),
    /// As 16-bit floats.
    Half(Vec<f16>),
}

/// Maps of some views. Views at one place (or, for some methods, in one voxel) share a map.
#[derive(Debug, Clone, PartialEq)]
pub struct ViewMaps {
    resolution: u32,
    /// Which views, as indices of the list that was asked for.
    views: Vec<u32>,
    /// For each of [`ViewMaps::views`] the index of its map, or [`ViewMaps::NO_MAP`].
    map_of: Vec<u32>,
    /// The point that distances of each map are from, metres.
    centers: Vec<[f32; 3]>,
    depths: Depths,
    /// sRGB colours of all texels with an empty fourth byte, or empty.
    colors: Vec<[u8; 4]>,
}

impl ViewMaps {
    /// What views have that cannot be drawn.
    pub const NO_MAP: u32 = u32::MAX;

    /// No maps yet.
    pub fn new(settings: &ViewSettings) -> Self {
        let depths = if settings.half_depths { Depths::Half(Vec::new()) } else { Depths::Full(Vec::new()) };
        Self {
            resolution: settings.resolution,
            views: Vec::new(),
            map_of: Vec::new(),
            centers: Vec::new(),
            depths,
            colors: Vec::new(),
        }
    }

    /// Views that cannot be drawn.
    pub fn without_maps(settings: &ViewSettings, views: Vec<u32>) -> Self {
        Self { map_of: vec![Self::NO_MAP; views.len()], views, ..Self::new(settings) }
    }

    /// Takes maps: `depths` and, unless empty, `colors` have [`texel_count`] texels for each of `centers`.
    ///
    /// # Panics
    /// If lengths or indices do not fit.
    pub fn from_parts(
        resolution: u32,
        views: Vec<u32>,
        map_of: Vec<u32>,
        centers: Vec<[f32; 3]>,
        depths: Depths,
        colors: Vec<[u8; 4]>,
    ) -> Self {
        let texels = centers.len() * texel_count(resolution);
        assert_eq!(views.len(), map_of.len(), "a map for each view");
        assert!(
            map_of.iter().all(|&map| map == Self::NO_MAP || (map as usize) < centers.len()),
            "maps exist"
        );
        let maps = Self { resolution, views, map_of, centers, depths, colors };
        assert_eq!(maps.depth_count(), texels, "depths of all maps");
        assert!(maps.colors.is_empty() || maps.colors.len() == texels, "colours of all maps");
        maps
    }

    /// Texels a side of each half.
    pub fn resolution(&self) -> u32 {
        self.resolution
    }

    /// Which views these maps are of, as indices of the list that was asked for.
    pub fn views(&self) -> &[u32] {
        &self.views
    }

    /// For each of [`ViewMaps::views`] the index of its map, or [`ViewMaps::NO_MAP`].
    pub fn map_of(&self) -> &[u32] {
        &self.map_of
    }

    /// The point that distances of each map are from, metres.
    pub fn centers(&self) -> &[[f32; 3]] {
        &self.centers
    }

    /// Distances of all maps.
    pub fn depths(&self) -> &Depths {
        &self.depths
    }

    /// Colours of all maps, or empty.
    pub fn colors(&self) -> &[[u8; 4]] {
        &self.colors
    }

    fn depth_count(&self) -> usize {
        match &self.depths {
            Depths::Full(depths) => depths.len(),
            Depths::Half(depths) => depths.len(),
        }
    }

    /// The distance in a texel of a map, +infinity if nothing is there.
    #[inline]
    pub fn depth(&self, map: usize, texel: usize) -> f32 {
        let at = map * texel_count(self.resolution) + texel;
        match &self.depths {
            Depths::Full(depths) => depths[at],
            Depths::Half(depths) => depths[at].to_f32(),
        }
    }

    /// Asks for a texel that will be read soon.
    #[inline]
    pub(crate) fn prefetch_depth(&self, map: usize, texel: usize) {
        let at = map * texel_count(self.resolution) + texel;
        match &self.depths {
            Depths::Full(depths) => prefetch(depths, at),
            Depths::Half(depths) => prefetch(depths, at),
        }
    }

    /// The distance from a map's center in the direction of `offset`, of any length but 0.
    #[inline]
    pub fn distance(&self, map: usize, offset: [f32; 3]) -> f32 {
        let length = (offset[0] * offset[0] + offset[1] * offset[1] + offset[2] * offset[2]).sqrt();
        self.depth(map, texel(offset, length, self.resolution) as usize)
    }

    /// All texels of the map of `views()[place]`, front half first; all +infinity if it has none.
    pub fn view_depths(&self, place: usize) -> Vec<f32> {
        let map = self.map_of[place];
        let texels = 0..texel_count(self.resolution);
        match map {
            Self::NO_MAP => texels.map(|_| f32::INFINITY).collect(),
            map => texels.map(|texel| self.depth(map as usize, texel)).collect(),
        }
    }

    /// Bytes that the maps take.
    pub fn bytes(&self) -> u64 {
        let depth = match &self.depths {
            Depths::Full(depths) => 4 * depths.len(),
            Depths::Half(depths) => 2 * depths.len(),
        };
        (depth + 4 * self.colors.len() + 12 * self.centers.len() + 8 * self.views.len()) as u64
    }

    /// Puts other maps behind these.
    ///
    /// # Panics
    /// If they were drawn with other settings.
    pub fn append(&mut self, other: Self) {
        assert_eq!(self.resolution, other.resolution, "one resolution");
        let first = self.centers.len() as u32;
        let moved = |map: &u32| if *map == Self::NO_MAP { *map } else { first + map };
        self.map_of.extend(other.map_of.iter().map(moved));
        self.views.extend(other.views);
        self.centers.extend(other.centers);
        self.colors.extend(other.colors);
        match (&mut self.depths, other.depths) {
            (Depths::Full(depths), Depths::Full(more)) => append(depths, more),
            (Depths::Half(depths), Depths::Half(more)) => append(depths, more),
            _ => panic!("depths of one kind"),
        }
    }

    /// Sorts [`ViewMaps::views`]; if all are there, a view's place is its index.
    pub fn sort(&mut self) {
        let mut order: Vec<(u32, u32)> =
            self.views.iter().copied().zip(self.map_of.iter().copied()).collect();
        order.sort_unstable();
        (self.views, self.map_of) = order.into_iter().unzip();
    }
}

/// Without a copy where there is nothing yet.
fn append<T>(list: &mut Vec<T>, more: Vec<T>) {
    if list.is_empty() { *list = more } else { list.extend(more) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn passes_are_put_together() {
        let pass = |views: &[u32], maps: &[u32], depth: f32| {
            let count = maps.iter().filter(|&&m| m != ViewMaps::NO_MAP).max().map_or(0, |m| m + 1) as usize;
            let depths = Depths::Full(vec![depth; count * texel_count(8)]);
            ViewMaps::from_parts(
                8,
                views.to_vec(),
                maps.to_vec(),
                vec![[depth; 3]; count],
                depths,
                Vec::new(),
            )
        };
        let mut all = ViewMaps::new(&ViewSettings::new(8));
        all.append(pass(&[3, 1], &[0, ViewMaps::NO_MAP], 5.0));
        all.append(pass(&[0, 2], &[0, 0], 7.0));
        all.sort();
        assert_eq!((all.views(), all.map_of()), (&[0, 1, 2, 3][..], &[1, ViewMaps::NO_MAP, 1, 0][..]));
        assert_eq!(all.view_depths(0)[3], 7.0);
        assert_eq!(all.view_depths(3)[127], 5.0);
        assert!(all.view_depths(1).iter().all(|d| *d == f32::INFINITY));
        assert_eq!(all.distance(0, [0.0, 1.0, 0.0]), 5.0);
        assert_eq!(all.bytes(), 2 * (128 * 4 + 12) + 4 * 8);
    }
}
