//! Exact maps: a ray, or a grid of rays, through every texel. The judge of the methods that approximate.

use super::texels::{Piece, draw_passes};
use super::{PassSink, Seen, Surfaces, View, ViewError, ViewRenderer, ViewSettings};
use manyview_shaders::paraboloid;

/// Casts rays from views.
///
/// # Texels
/// A texel holds the distance along the ray through its middle; with more rays a texel, the nearest of what they meet.
/// Texels whose middle is outside the unit disc stay empty.
///
/// # Fields of view
/// Maps are drawn all around, whatever a view's field: culling only saves work, and there is none to be saved here.
#[derive(Debug, Clone)]
pub struct RayCast<S> {
    surfaces: S,
    rays: u32,
}

impl<S: Surfaces> RayCast<S> {
    /// One ray a texel.
    pub fn new(surfaces: S) -> Self {
        Self { surfaces, rays: 1 }
    }

    /// A grid of `rays` × `rays` a texel.
    ///
    /// # Panics
    /// If there are none.
    #[must_use]
    pub fn with_rays(self, rays: u32) -> Self {
        assert!(rays > 0, "a ray at least");
        Self { rays, ..self }
    }

    /// What rays are cast at.
    pub fn surfaces(&self) -> &S {
        &self.surfaces
    }
}

impl<S: Surfaces> ViewRenderer for RayCast<S> {
    fn name(&self) -> &'static str {
        self.surfaces.name()
    }

    fn render_passes(
        &self,
        views: &[View],
        settings: &ViewSettings,
        sink: &mut PassSink<'_>,
    ) -> Result<(), ViewError> {
        if settings.with_colors && !self.surfaces.has_colors() {
            let problem = "draws no colours: leave them out, or use `raycast`";
            return Err(ViewError::Unsupported { method: self.name(), problem });
        }
        let resolution = settings.resolution;
        draw_passes(views, settings, resolution as usize, sink, |piece| {
            let Piece { view, texels, depths, colors } = piece;
            for (at, texel) in texels.enumerate() {
                if !paraboloid::is_inside(texel, resolution) {
                    continue;
                }
                let seen = rays_of_texel(texel, resolution, self.rays)
                    .filter_map(|direction| self.surfaces.cast(view.position.map(f64::from), direction))
                    .min_by(|a, b| a.distance.total_cmp(&b.distance));
                if let Some(Seen { distance, color }) = seen {
                    depths[at] = distance as f32;
                    if let Some(place) = colors.get_mut(at) {
                        *place = color;
                    }
                }
            }
        })
    }
}

/// Unit directions through the middles of `rays` × `rays` parts of a texel; without those of the other hemisphere, whose
/// places are outside the unit disc.
pub(super) fn rays_of_texel(texel: u32, resolution: u32, rays: u32) -> impl Iterator<Item = [f64; 3]> {
    let (row, column) = (texel / resolution, texel % resolution);
    let (half, row) = (row / resolution, row % resolution);
    let scale = 2.0 / f64::from(resolution * rays);
    (0..rays * rays).filter_map(move |ray| {
        let at = |texel: u32, part: u32| (f64::from(texel * rays + part) + 0.5) * scale - 1.0;
        let (a, b) = (at(column, ray % rays), at(row, ray / rays));
        let square = a * a + b * b;
        let x = (1.0 - square) / (1.0 + square);
        let (y, z) = (2.0 * a / (1.0 + square), 2.0 * b / (1.0 + square));
        (square <= 1.0).then_some([if half == 0 { x } else { -x }, y, z])
    })
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::views::{Depths, OctreeSurfaces, ViewMaps};
    use manyview_shaders::paraboloid::{is_inside, texel, texel_count, texel_direction};
    use manyview_shaders::svo::Svo;

    /// An octree of the cells that `is_there` accepts, coloured by their coordinates.
    pub(crate) fn octree(
        origin: [f64; 3],
        size: f64,
        depth: u32,
        is_there: impl Fn([u32; 3]) -> bool,
    ) -> Svo {
        let side = 1u32 << depth;
        let along = || 0..side;
        let cells = along().flat_map(|z| along().flat_map(move |y| along().map(move |x| [x, y, z])));
        let mut svo = Svo::of_cells(origin, size, depth, cells.filter(|&cell| is_there(cell)));
        let cells = svo.cells(depth as usize);
        svo.levels[depth as usize].colors = cells.into_iter().map(|cell| cell.map(|c| c as u8)).collect();
        svo.validate().unwrap();
        svo
    }

    /// A closed room of walls one voxel thick that fills the cube from (1, 2, 3), 32 voxels of 0.25 m a side.
    pub(crate) fn room() -> Svo {
        octree([1.0, 2.0, 3.0], 8.0, 5, |cell| cell.iter().any(|&c| c == 0 || c == 31))
    }

    /// The cells of a cube of edge 4 around the origin that a sphere of radius 1 passes through.
    pub(crate) fn sphere() -> Svo {
        let edge = 4.0 / 64.0;
        octree([-2.0; 3], 4.0, 6, |cell| {
            let corner = |high: u32| {
                let reach = cell.map(|c| {
                    let (a, b) =
                        ((f64::from(c) * edge - 2.0).abs(), ((f64::from(c) + 1.0) * edge - 2.0).abs());
                    if high == 1 { a.max(b) } else { a.min(b) }
                });
                reach.iter().map(|c| c * c).sum::<f64>()
            };
            corner(0) <= 1.0 && corner(1) >= 1.0
        })
    }

    fn draw<S: Surfaces>(cast: &RayCast<S>, views: &[View], settings: &ViewSettings) -> ViewMaps {
        cast.render_views(views, settings).unwrap()
    }

    #[test]
    fn the_walls_of_a_room_are_where_they_are_in_every_direction() {
        let cast = RayCast::new(OctreeSurfaces::new(&room(), true));
        let settings = ViewSettings { with_colors: true, ..ViewSettings::new(32) };
        let position = [2.0f32, 7.0, 8.5];
        let maps = draw(&cast, &[View::around(position)], &settings);
        for index in 0..texel_count(32) as u32 {
            let depth = maps.depth(0, index as usize);
            if !is_inside(index, 32) {
                assert_eq!(depth, f32::INFINITY);
                continue;
            }
            let d = texel_direction(index, 32);
            // Inner faces of the walls.
            let walls = [[1.25, 8.75], [2.25, 9.75], [3.25, 10.75]];
            let to = |i: usize| (walls[i][usize::from(d[i] > 0.0)] - position[i]) / d[i];
            let expected = to(0).min(to(1)).min(to(2));
            assert!((depth / expected - 1.0).abs() < 1e-4, "{index}: {depth} {expected}");
            let [x, y, z, _] = maps.colors()[index as usize];
            assert!([x, y, z].iter().any(|&c| c == 0 || c == 31));
        }
    }

    #[test]
    fn a_sphere_fills_the_directions_that_it_fills() {
        let svo = sphere();
        let cast = RayCast::new(OctreeSurfaces::new(&svo, false));
        let maps = draw(&cast, &[View::around([-3.0, 0.0, 0.0])], &ViewSettings::new(64));
        let voxel = 4.0 / 64.0f32;
        for index in 0..texel_count(64) as u32 {
            let (depth, d) = (maps.depth(0, index as usize), texel_direction(index, 64));
            // The nearest point of the ray to the sphere's middle.
            let along = 3.0 * d[0];
            let away = (9.0 - along * along).sqrt();
            if along < 0.0 || away > 1.0 + 2.0 * voxel {
                assert_eq!(depth, f32::INFINITY);
            } else if away < 1.0 - 2.0 * voxel {
                let expected = along - (1.0 - away * away).sqrt();
                assert!((depth - expected).abs() < 6.0 * voxel, "{depth} {expected}");
                assert!(depth <= expected + 1e-4, "voxels hold the sphere");
            }
        }
    }

    #[test]
    fn a_view_does_not_see_the_voxel_that_it_is_in() {
        let cast = RayCast::new(OctreeSurfaces::new(&room(), false));
        // In the floor's voxel layer, at a corner of four voxels and in the middle of one.
        for position in [[3.0, 2.1, 6.0], [3.125, 2.125, 6.125], [1.25, 2.0, 3.25]] {
            let maps = draw(&cast, &[View::new(position, [0.0, 1.0, 0.0], 1.5)], &ViewSettings::new(16));
            let up = maps.distance(0, [1e-4, 1.0, 1e-4]);
            if position[0] > 2.0 {
                // The middle of the texel is up to a tenth of a radian off.
                assert!((up - (9.75 - position[1])).abs() < 0.05, "{up}");
            }
            for index in (0..512u32).filter(|&index| is_inside(index, 16)) {
                let depth = maps.depth(0, index as usize);
                let down = texel_direction(index, 16)[1] < 0.0;
                // Neighbouring voxels of the floor are seen where the ray leaves its own.
                assert!(down || (0.0..20.0).contains(&depth), "{position:?} {index}: {depth}");
            }
        }
    }

    #[test]
    fn passes_keep_to_the_budget_and_change_nothing() {
        let cast = RayCast::new(OctreeSurfaces::new(&sphere(), false));
        let mut views: Vec<View> = (0..20u8).map(|i| View::around([-3.0, 0.1 * f32::from(i), 0.2])).collect();
        views[4].position[1] = f32::NAN;
        views[9].position[0] = f32::INFINITY;
        let settings = ViewSettings::new(8);
        let all = draw(&cast, &views, &settings);
        assert_eq!(all.centers().len(), 18);
        assert!(all.map_of()[4] == ViewMaps::NO_MAP && all.map_of()[9] == ViewMaps::NO_MAP);
        let small = ViewSettings { budget_bytes: 3 * (settings.map_bytes() + 20), ..settings };
        let (mut passes, mut together) = (0, ViewMaps::new(&small));
        cast.render_passes(&views, &small, &mut |pass| {
            assert!(pass.bytes() <= small.budget_bytes);
            passes += 1;
            together.append(pass);
            Ok(())
        })
        .unwrap();
        assert_eq!(passes, 7);
        for i in 0..20 {
            assert_eq!(all.view_depths(i), together.view_depths(i));
        }
        let none = ViewSettings { budget_bytes: 100, ..settings };
        assert!(matches!(cast.render_passes(&views, &none, &mut |_| Ok(())), Err(ViewError::Budget { .. })));
        let mut called = false;
        let mut sink = |_| {
            called = true;
            Ok(())
        };
        cast.render_passes(&[], &none, &mut sink).unwrap();
        assert!(!called, "no view is no pass");
        let half = ViewSettings { half_depths: true, ..settings };
        let half = draw(&cast, &views, &half);
        assert!(matches!(half.depths(), Depths::Half(_)));
        for (a, b) in all.view_depths(0).iter().zip(half.view_depths(0)) {
            assert!(a == &b || (a / b - 1.0).abs() < 1e-3);
        }
    }

    #[test]
    fn rays_of_a_texel_fall_into_it() {
        for index in (0..512u32).filter(|&index| is_inside(index, 16)) {
            let rays: Vec<_> = rays_of_texel(index, 16, 3).collect();
            assert!((4..=9).contains(&rays.len()));
            for ray in rays {
                assert_eq!(texel(ray.map(|c| c as f32), 1.0, 16), index);
            }
        }
    }

    #[test]
    fn more_rays_find_the_nearest() {
        let svo = sphere();
        let view = [View::around([-3.0, 0.3, 0.1])];
        let one = draw(&RayCast::new(OctreeSurfaces::new(&svo, false)), &view, &ViewSettings::new(16));
        let many =
            draw(&RayCast::new(OctreeSurfaces::new(&svo, false)).with_rays(5), &view, &ViewSettings::new(16));
        let pairs = one.view_depths(0).into_iter().zip(many.view_depths(0));
        let filled = |maps: &ViewMaps| maps.view_depths(0).iter().filter(|d| d.is_finite()).count();
        assert!(pairs.into_iter().all(|(one, many)| many <= one));
        assert!(filled(&many) > filled(&one));
    }
}
