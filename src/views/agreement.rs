//! How far maps agree with exact casts.
//!
//! # Measure
//! Every texel whose middle lies in its view's field and in the disc of its half gets a grid of rays from the view's
//! position.
//! - **Emptiness** agrees where the texel is empty and no ray hits, or is filled and one hits. Points and voxels that
//!   touch a texel fill it, so that this is what splatting can reach at best; by *most* rays, or where the rays are
//!   *clear* (all hit, or none), the same map is measured without that allowance.
//! - **Depth** agrees where the texel is filled, rays hit, and the distance lies between the nearest and the farthest that
//!   rays of the texel and of its eight neighbours meet, widened by two voxels. Neighbours of a texel at the rim are in
//!   the other half. By the texel's *own* rays alone it is stricter.
//! - The **error** of a depth is relative to the ray through the texel's middle, where that hits.
//!
//! A cone seldom ends between texels: methods may drop what the middle's field does not hold though the texel does. So
//! all is counted twice, over all texels and over those of which every ray is in the field ([`Agreement::whole`]).
//!
//! Distances count as if from the view's position, wherever the map's center is: that is what they are used as.

use super::raycast::rays_of_texel;
use super::{PassSink, Surfaces, View, ViewError, ViewMaps, ViewRenderer, ViewSettings};
use manyview_shaders::paraboloid::{self, texel_count};
use rayon::prelude::*;

/// How maps are compared.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AgreementSettings {
    /// Rays a side of a texel's grid.
    pub rays: u32,
    /// By how much the range of exact depths is widened, metres: two voxels.
    pub slack_metres: f64,
}

impl AgreementSettings {
    /// 8 × 8 rays and two voxels of this edge.
    pub fn of_voxel(voxel_metres: f64) -> Self {
        Self { rays: 8, slack_metres: 2.0 * voxel_metres }
    }
}

/// Texels that agree, and those that do not.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Counts {
    /// Texels that were looked at.
    pub texels: u64,
    /// Filled where a ray hits, or empty where none does.
    pub emptiness: u64,
    /// Filled where more than half of the rays hit, or empty where no more do.
    pub emptiness_by_most: u64,
    /// Texels whose rays all hit or all miss.
    pub clear: u64,
    /// Those of them that are filled or empty as they should be.
    pub clear_emptiness: u64,
    /// Filled though no ray hits.
    pub filled_wrongly: u64,
    /// Empty though a ray hits.
    pub empty_wrongly: u64,
    /// Filled, and a ray hits.
    pub filled: u64,
    /// Those of them whose depth agrees.
    pub depth: u64,
    /// Those of them whose depth is in the range of their own rays, widened.
    pub depth_by_own: u64,
}

impl Counts {
    fn add(&mut self, other: &Self) {
        self.texels += other.texels;
        self.emptiness += other.emptiness;
        self.emptiness_by_most += other.emptiness_by_most;
        self.clear += other.clear;
        self.clear_emptiness += other.clear_emptiness;
        self.filled_wrongly += other.filled_wrongly;
        self.empty_wrongly += other.empty_wrongly;
        self.filled += other.filled;
        self.depth += other.depth;
        self.depth_by_own += other.depth_by_own;
    }

    /// Share of texels whose emptiness agrees; 1 of none.
    pub fn emptiness_share(&self) -> f64 {
        share(self.emptiness, self.texels)
    }

    /// Share of texels filled in both whose depth agrees; 1 of none.
    pub fn depth_share(&self) -> f64 {
        share(self.depth, self.filled)
    }
}

fn share(part: u64, whole: u64) -> f64 {
    if whole == 0 { 1.0 } else { part as f64 / whole as f64 }
}

/// What a comparison found.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Agreement {
    /// Views that have maps.
    pub views: u64,
    /// All texels whose middle is in the field of their view.
    pub all: Counts,
    /// Those of which every ray is.
    pub whole: Counts,
    /// Relative errors of depths, in no order.
    errors: Vec<f32>,
}

impl Agreement {
    /// Mean relative error of depths; 0 of none.
    pub fn mean_error(&self) -> f64 {
        self.errors.iter().map(|&e| f64::from(e)).sum::<f64>() / self.errors.len().max(1) as f64
    }

    /// The relative error of depths that a share of them does not exceed: 0.5 is the median. 0 of none.
    pub fn error_at(&self, share: f64) -> f64 {
        let mut errors = self.errors.clone();
        if errors.is_empty() {
            return 0.0;
        }
        let at = ((errors.len() - 1) as f64 * share.clamp(0.0, 1.0)).round() as usize;
        f64::from(*errors.select_nth_unstable_by(at, f32::total_cmp).1)
    }

    fn add(&mut self, other: Self) {
        self.views += other.views;
        self.all.add(&other.all);
        self.whole.add(&other.whole);
        self.errors.extend(other.errors);
    }

    /// Draws views and compares them, pass by pass.
    pub fn of_renderer(
        renderer: &dyn ViewRenderer,
        surfaces: &impl Surfaces,
        views: &[View],
        drawing: &ViewSettings,
        settings: &AgreementSettings,
    ) -> Result<Self, ViewError> {
        let mut found = Self::default();
        let sink: &mut PassSink<'_> = &mut |maps| {
            found.add(Self::of_maps(&maps, surfaces, views, settings));
            Ok(())
        };
        renderer.render_passes(views, drawing, sink)?;
        Ok(found)
    }

    /// Compares maps of some of `views`, the list that was asked for, with casts at `surfaces`.
    pub fn of_maps(
        maps: &ViewMaps,
        surfaces: &impl Surfaces,
        views: &[View],
        settings: &AgreementSettings,
    ) -> Self {
        let mut found = Self::default();
        for (place, &view) in maps.views().iter().enumerate() {
            if maps.map_of()[place] != ViewMaps::NO_MAP {
                let depths = maps.view_depths(place);
                found.add(of_view(&depths, maps.resolution(), surfaces, &views[view as usize], settings));
            }
        }
        found
    }
}

/// What the rays of one texel found.
#[derive(Debug, Clone, Copy)]
struct Cast {
    rays: u32,
    hits: u32,
    /// Rays in the view's field.
    in_field: u32,
    nearest: f64,
    farthest: f64,
}

fn of_view(
    depths: &[f32],
    resolution: u32,
    surfaces: &impl Surfaces,
    view: &View,
    settings: &AgreementSettings,
) -> Agreement {
    let (axis, [cosine, _]) = view.cone();
    let in_field = |d: [f64; 3]| (0..3).map(|i| d[i] * f64::from(axis[i])).sum::<f64>() >= f64::from(cosine);
    let position = view.position.map(f64::from);
    // Texels outside all fields are needed only beside ones inside: those are few, and drawn all the same.
    let casts: Vec<Cast> = (0..texel_count(resolution) as u32)
        .into_par_iter()
        .map(|texel| {
            let none = Cast { rays: 0, hits: 0, in_field: 0, nearest: f64::INFINITY, farthest: 0.0 };
            rays_of_texel(texel, resolution, settings.rays).fold(none, |mut cast, direction| {
                cast.rays += 1;
                cast.in_field += u32::from(in_field(direction));
                if let Some(seen) = surfaces.cast(position, direction) {
                    cast.hits += 1;
                    cast.nearest = cast.nearest.min(seen.distance);
                    cast.farthest = cast.farthest.max(seen.distance);
                }
                cast
            })
        })
        .collect();
    let mut found = Agreement { views: 1, ..Agreement::default() };
    for texel in (0..texel_count(resolution) as u32).filter(|&t| paraboloid::is_inside(t, resolution)) {
        let middle = rays_of_texel(texel, resolution, 1).next();
        let Some(middle) = middle.filter(|&middle| in_field(middle)) else { continue };
        let (depth, cast) = (f64::from(depths[texel as usize]), casts[texel as usize]);
        let counts = of_texel(depth, texel, resolution, &casts, settings.slack_metres);
        if cast.in_field == cast.rays {
            found.whole.add(&counts);
        }
        found.all.add(&counts);
        if depth.is_finite()
            && let Some(seen) = surfaces.cast(position, middle)
        {
            let off = (depth - seen.distance).abs();
            found.errors.push((off / seen.distance.max(f64::MIN_POSITIVE)) as f32);
        }
    }
    found
}

fn of_texel(depth: f64, texel: u32, resolution: u32, casts: &[Cast], slack: f64) -> Counts {
    let cast = casts[texel as usize];
    let (is_filled, is_hit) = (depth.is_finite(), cast.hits > 0);
    let is_clear = cast.hits == 0 || cast.hits == cast.rays;
    let agrees = |is_hit: bool| u64::from(is_filled == is_hit);
    let mut counts = Counts {
        texels: 1,
        emptiness: agrees(is_hit),
        emptiness_by_most: agrees(2 * cast.hits > cast.rays),
        clear: u64::from(is_clear),
        clear_emptiness: if is_clear { agrees(is_hit) } else { 0 },
        filled_wrongly: u64::from(is_filled && !is_hit),
        empty_wrongly: u64::from(!is_filled && is_hit),
        ..Counts::default()
    };
    if is_filled && is_hit {
        let holds =
            |nearest: f64, farthest: f64| u64::from(nearest - slack <= depth && depth <= farthest + slack);
        let (mut nearest, mut farthest) = (cast.nearest, cast.farthest);
        for neighbour in neighbours(texel, resolution) {
            nearest = nearest.min(casts[neighbour as usize].nearest);
            farthest = farthest.max(casts[neighbour as usize].farthest);
        }
        counts.filled = 1;
        counts.depth = holds(nearest, farthest);
        counts.depth_by_own = holds(cast.nearest, cast.farthest);
    }
    counts
}

/// The texels beside a texel: in its half, and at the rim in the other, by direction.
fn neighbours(texel: u32, resolution: u32) -> impl Iterator<Item = u32> {
    let (row, column) = (texel / resolution, texel % resolution);
    let (half, row) = (row / resolution, row % resolution);
    let beside = (0..9).filter(|&i| i != 4).map(|i| (i % 3 - 1, i / 3 - 1));
    beside.flat_map(move |(right, down)| {
        let (column, row) = (column as i32 + right, row as i32 + down);
        let side = 0..resolution as i32;
        let same = (side.contains(&column) && side.contains(&row))
            .then(|| (half * resolution + row as u32) * resolution + column as u32);
        let outside = same.is_none_or(|texel| !paraboloid::is_inside(texel, resolution));
        let other = outside.then(|| {
            let d = paraboloid::direction(half, [column as f32 + 0.5, row as f32 + 0.5], resolution);
            paraboloid::texel(d, 1.0, resolution)
        });
        // A texel that the rim cuts is in both halves.
        same.into_iter().chain(other)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::views::raycast::tests::{room, sphere};
    use crate::views::{Depths, OctreeSurfaces, RayCast};
    use manyview_shaders::paraboloid::{is_inside, texel_direction};

    fn settings(surfaces: &OctreeSurfaces) -> AgreementSettings {
        AgreementSettings::of_voxel(surfaces.voxel())
    }

    #[test]
    fn exact_casts_agree_with_themselves() {
        for (svo, position) in [(room(), [3.3, 7.1, 8.2]), (sphere(), [-2.5, 0.3, 0.1])] {
            let surfaces = OctreeSurfaces::new(&svo, false);
            let cast = RayCast::new(surfaces.clone()).with_rays(8);
            for half_angle in [4.0, 1.5, 0.3] {
                let views = [View::new(position, [1.0, 0.2, 0.1], half_angle), View::around([f32::NAN; 3])];
                let drawing = ViewSettings::new(16);
                let found =
                    Agreement::of_renderer(&cast, &surfaces, &views, &drawing, &settings(&surfaces)).unwrap();
                let Counts { texels, emptiness, filled, depth, depth_by_own, clear, clear_emptiness, .. } =
                    found.all;
                assert!(texels > 0 && filled > 0 && found.views == 1);
                assert_eq!((emptiness, depth, depth_by_own), (texels, filled, filled));
                assert_eq!(clear_emptiness, clear);
                assert!(found.whole.texels < texels || half_angle > 3.0);
                assert!(found.error_at(0.5) < 0.1);
            }
        }
    }

    #[test]
    fn one_ray_in_the_middle_is_right_where_there_are_no_edges() {
        let surfaces = OctreeSurfaces::new(&room(), false);
        let cast = RayCast::new(surfaces.clone());
        let views = [View::around([3.3, 7.1, 8.2])];
        let drawing = ViewSettings::new(16);
        let found = Agreement::of_renderer(&cast, &surfaces, &views, &drawing, &settings(&surfaces)).unwrap();
        assert_eq!((found.all.emptiness_share(), found.all.depth_share()), (1.0, 1.0));
        assert!(found.error_at(1.0) < 1e-6 && found.mean_error() < 1e-6);
        assert_eq!(found.all.clear, found.all.texels);
    }

    #[test]
    fn what_is_wrong_is_counted() {
        let surfaces = OctreeSurfaces::new(&room(), false);
        let views = [View::around([5.0, 6.0, 7.0])];
        let maps = RayCast::new(surfaces.clone()).render_views(&views, &ViewSettings::new(16)).unwrap();
        let mut depths = maps.view_depths(0);
        let inside: Vec<usize> = (0..512).filter(|&i| is_inside(i as u32, 16)).collect();
        // Walls are 3.75 to 6.5 m away.
        depths[inside[0]] = 9.0;
        depths[inside[9]] = 1.0;
        depths[inside[19]] = f32::INFINITY;
        let maps = ViewMaps::from_parts(
            16,
            vec![0],
            vec![0],
            maps.centers().to_vec(),
            Depths::Full(depths),
            Vec::new(),
        );
        let found = Agreement::of_maps(&maps, &surfaces, &views, &settings(&surfaces)).all;
        let texels = inside.len() as u64;
        assert_eq!(
            (found.texels, found.emptiness, found.filled, found.depth),
            (texels, texels - 1, texels - 1, texels - 3)
        );
        assert_eq!((found.empty_wrongly, found.filled_wrongly), (1, 0));
    }

    #[test]
    fn what_fills_too_much_is_counted() {
        let surfaces = OctreeSurfaces::new(&sphere(), false);
        let views = [View::around([-2.5, 0.0, 0.0])];
        let depths = Depths::Full(vec![1.6; 512]);
        let maps = ViewMaps::from_parts(16, vec![0], vec![0], vec![views[0].position], depths, Vec::new());
        let found = Agreement::of_maps(&maps, &surfaces, &views, &settings(&surfaces)).all;
        assert_eq!(found.filled_wrongly + found.emptiness, found.texels);
        assert_eq!(found.emptiness, found.filled);
        assert!(found.emptiness_by_most < found.emptiness && found.empty_wrongly == 0);
        // The sphere's cap is 5 % of all directions.
        assert!((0.02..0.12).contains(&found.emptiness_share()), "{}", found.emptiness_share());
    }

    #[test]
    fn neighbours_are_beside_in_direction() {
        for index in (0..512u32).filter(|&index| is_inside(index, 16)) {
            let d = texel_direction(index, 16);
            let beside: Vec<u32> = neighbours(index, 16).collect();
            assert!(beside.len() >= 8 && !beside.contains(&index));
            for other in beside {
                let e = texel_direction(other, 16);
                // 1.5 texels of a quarter radian each at most.
                assert!((0..3).map(|i| d[i] * e[i]).sum::<f32>() > 0.8, "{index} {other}");
            }
        }
        // One at the rim has some in the other half.
        let rim = paraboloid::texel([0.01, 1.0, 0.0], 1.0, 16);
        assert!(neighbours(rim, 16).any(|other| other >= 256));
    }
}
