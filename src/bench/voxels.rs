//! The octree's occupancy against brute force.
//!
//! The raster's promise: a voxel is occupied iff it holds the point of a triangle at a pixel centre of one of the three
//! projections. Whether the octree keeps it is checked against the definition, fragment by fragment. How many of the
//! voxels that the surface touches are missed by such a rule is measured against exact triangle-box overlap.

use super::overlap::touched_cells;
use super::{BenchError, BenchScene, Cell, Table};
use crate::reference::world_triangle;
use glam::DVec3;
use manyview_pipeline::appearance::Appearance;
use manyview_pipeline::bake::{BakeError, Progress};
use manyview_pipeline::cube::SceneCube;
use manyview_pipeline::octree::{self, Brick, Bricks, brick_fragments};
use manyview_pipeline::triangles::LatticeTriangles;
use manyview_shaders::raster::{Grid, Raster, VoxelBox, fragments_basic};
use manyview_shaders::svo::Svo;
use rayon::prelude::*;

/// Octree levels that are compared: 32³, 64³ and 128³.
pub const LEVELS: [u32; 3] = [5, 6, 7];

/// A set of voxels: one bit each.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Voxels {
    bits: u32,
    words: Vec<u64>,
}

impl Voxels {
    fn new(bits: u32) -> Self {
        Self { bits, words: vec![0; 1 << (3 * bits).saturating_sub(6)] }
    }

    #[inline]
    fn insert(&mut self, cell: [u32; 3]) {
        let index = (cell[2] << self.bits | cell[1]) << self.bits | cell[0];
        self.words[(index >> 6) as usize] |= 1 << (index & 63);
    }

    /// Number of voxels.
    pub fn count(&self) -> u64 {
        self.words.iter().map(|w| u64::from(w.count_ones())).sum()
    }

    /// Number of voxels that are in `self` but not in `other`.
    pub fn count_without(&self, other: &Self) -> u64 {
        self.words.iter().zip(&other.words).map(|(a, b)| u64::from((a & !b).count_ones())).sum()
    }

    /// The voxels that `insert_of` finds for the triangles `0 .. count`.
    fn of_triangles(bits: u32, count: usize, insert_of: impl Fn(usize, &mut Voxels) + Sync) -> Self {
        (0..count)
            .into_par_iter()
            .fold(
                || Self::new(bits),
                |mut voxels, index| {
                    insert_of(index, &mut voxels);
                    voxels
                },
            )
            .reduce(
                || Self::new(bits),
                |mut a, b| {
                    a.words.iter_mut().zip(&b.words).for_each(|(a, b)| *a |= b);
                    a
                },
            )
    }
}

/// Occupancies of one scene at one level.
pub struct Occupancy {
    /// What the snapped triangles touch, alpha ignored.
    pub touched_snapped: Voxels,
    /// What the triangles as they are touch, alpha ignored.
    pub touched: Voxels,
    /// What the raster covers, alpha ignored.
    pub covered: Voxels,
    /// What the rule promises, alpha included, by its definition.
    pub promised: Voxels,
    /// What the octree has.
    pub octree: Voxels,
}

impl Occupancy {
    /// Finds them all.
    pub fn new(scene: &BenchScene, bits: u32) -> Result<Self, BenchError> {
        let refuse = |source| BenchError::Scene { scene: scene.name.clone(), source };
        let (min, max) = scene.scene.bounds().unwrap_or_default();
        let (min, max) = (min.to_array(), max.to_array());
        let cube = SceneCube::around(min, max).ok_or_else(|| refuse(BakeError::Bounds { min, max }))?;
        let grid = Grid::new(bits);
        let (cutouts, origin) = (&scene.cutouts, DVec3::from_array(cube.origin));
        let triangles = LatticeTriangles::new(&scene.scene, cutouts, |p| cube.snap(grid, p.to_array()));
        let count = triangles.triangles.len();
        let snapped = |index: usize| triangles.triangles[index].map(|v| v.map(i32::from));
        let whole = VoxelBox::whole(grid);
        let step = f64::from(1u32 << grid.sub_bits);
        let cell_of = |voxel: [i32; 3]| voxel.map(|c| c as u32);

        let touched_snapped = Voxels::of_triangles(bits, count, |index, voxels| {
            let triangle = snapped(index).map(|v| DVec3::from_array(v.map(f64::from)));
            touched_cells(&triangle, bits, step, &mut |cell| voxels.insert(cell));
        });
        let touched = Voxels::of_triangles(bits, count, |index, voxels| {
            let source = triangles.sources[index];
            let triangle = world_triangle(&scene.scene, source.instance, source.triangle);
            let edge = cube.size / f64::from(grid.size());
            touched_cells(&triangle.map(|p| p - origin), bits, edge, &mut |cell| voxels.insert(cell));
        });
        let covered = Voxels::of_triangles(bits, count, |index, voxels| {
            let triangle = snapped(index);
            for raster in (0..3).filter_map(|axis| Raster::new(grid, &triangle, axis)) {
                raster.voxels(&whole, |voxel| voxels.insert(cell_of(voxel)));
            }
        });
        let promised = Voxels::of_triangles(bits, count, |index, voxels| {
            let triangle = snapped(index);
            let mask = triangles.mask(cutouts, index);
            let clip = bounds_in_voxels(&triangle, grid);
            for fragment in fragments_basic(grid, &triangle, &clip) {
                if mask.is_none_or(|m| m.passes(&cutouts.planes, fragment.barycentric)) {
                    voxels.insert(cell_of(fragment.voxel));
                }
            }
        });
        let octree = octree_voxels(scene, cube, grid, &triangles);
        Ok(Self { touched_snapped, touched, covered, promised, octree })
    }
}

/// The voxels that a triangle's corners span.
fn bounds_in_voxels(triangle: &[[i32; 3]; 3], grid: Grid) -> VoxelBox {
    let range = |i: usize| triangle.iter().map(move |v| v[i] >> grid.sub_bits);
    VoxelBox {
        min: [0, 1, 2].map(|i| range(i).min().expect("three corners")),
        max: [0, 1, 2].map(|i| range(i).max().expect("three corners") + 1),
    }
}

/// The leaves of the octree that the bake builds.
fn octree_voxels(scene: &BenchScene, cube: SceneCube, grid: Grid, triangles: &LatticeTriangles) -> Voxels {
    let appearance = Appearance::new(&scene.scene, cube.size / f64::from(grid.size()));
    let bricks = Bricks::new(grid, 5, &triangles.triangles);
    let built: Vec<Brick> = (0..bricks.len())
        .into_par_iter()
        .filter_map(|i| {
            let (code, clip, members) = bricks.brick(i);
            let fragments = brick_fragments(grid, &clip, triangles, &scene.cutouts, &members);
            Brick::new(code, bricks.brick_bits, fragments, &members, triangles, &appearance)
        })
        .collect();
    let mut voxels = Voxels::new(grid.bits);
    if !built.is_empty() {
        let levels = octree::join(grid.bits, bricks.brick_bits, built);
        let svo = Svo { origin: cube.origin, size: cube.size, levels };
        for cell in svo.cells(grid.bits as usize) {
            voxels.insert(cell.map(u32::from));
        }
    }
    voxels
}

/// The table's columns.
const COLUMNS: [&str; 12] = [
    "scene",
    "level",
    "touched, snapped triangles",
    "covered by the raster",
    "missed of touched, snapped %",
    "extra to touched, snapped",
    "touched, exact triangles",
    "missed of touched, exact %",
    "extra to touched, exact",
    "promised with alpha",
    "promised but not in the octree",
    "in the octree but not promised",
];

/// Compares the occupancy of scenes at [`LEVELS`], one row each; scenes are asked for one after the other.
pub fn run(
    scenes: impl IntoIterator<Item = Result<BenchScene, BenchError>>,
    progress: &dyn Progress,
) -> Result<Table, BenchError> {
    let mut table = Table::new("voxels", "Octree occupancy against exact overlap", &COLUMNS);
    for scene in scenes {
        add_scene(&mut table, &scene?, &LEVELS, progress)?;
    }
    Ok(table)
}

fn add_scene(
    table: &mut Table,
    scene: &BenchScene,
    levels: &[u32],
    progress: &dyn Progress,
) -> Result<(), BenchError> {
    progress.begin("voxels", levels.len() as u64, "levels");
    for &level in levels {
        if progress.cancelled() {
            return Err(BenchError::Cancelled);
        }
        let all = Occupancy::new(scene, level)?;
        let missed = |touched: &Voxels| Cell::percent(touched.count_without(&all.covered), touched.count());
        let extra = |touched: &Voxels| Cell::Count(all.covered.count_without(touched));
        table.push(vec![
            Cell::Text(scene.name.clone()),
            Cell::Count(u64::from(level)),
            Cell::Count(all.touched_snapped.count()),
            Cell::Count(all.covered.count()),
            missed(&all.touched_snapped),
            extra(&all.touched_snapped),
            Cell::Count(all.touched.count()),
            missed(&all.touched),
            extra(&all.touched),
            Cell::Count(all.promised.count()),
            Cell::Count(all.promised.count_without(&all.octree)),
            Cell::Count(all.octree.count_without(&all.promised)),
        ]);
        progress.advance(1);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DMat4, Vec3};
    use manyview_pipeline::bake::Silent;
    use manyview_pipeline::generate::{SceneKind, generate};
    use manyview_pipeline::scene::{Instance, Mesh, Scene};

    #[test]
    fn a_wall_through_the_middle_of_voxels_is_covered_whole() {
        // The cube around it is [0, 1]³ times 1.25; a level of 2 bits has voxels of 0.3125.
        let scene = Scene {
            meshes: vec![Mesh {
                positions: vec![
                    Vec3::new(0.0, 0.0, 0.15),
                    Vec3::new(1.0, 0.0, 0.15),
                    Vec3::new(1.0, 1.0, 0.15),
                    Vec3::new(0.0, 1.0, 0.15),
                ],
                triangles: vec![[0, 1, 2], [0, 2, 3]],
                ..Mesh::default()
            }],
            instances: vec![Instance { mesh: 0, world_from_object: DMat4::IDENTITY }],
            ..Scene::default()
        };
        let all = Occupancy::new(&BenchScene::new("wall".to_owned(), scene).unwrap(), 2).unwrap();
        assert_eq!(all.touched_snapped.count(), 16);
        assert_eq!(all.touched.count(), 16);
        // Its last row of voxels is entered by a fifth: no pixel centre there.
        assert_eq!(all.covered.count(), 9);
        assert_eq!(all.promised, all.octree);
        assert_eq!(all.covered, all.octree);
    }

    #[test]
    fn a_generated_scene_keeps_every_promise_and_adds_nothing() {
        // Hairs are far thinner than these voxels: most of what they touch has no pixel centre.
        for (kind, misses) in [(SceneKind::Town, 5.0..70.0), (SceneKind::Hairball, 50.0..95.0)] {
            let scene = BenchScene::new(kind.to_string(), generate(kind, 3000, 1)).unwrap();
            let mut table = Table::new("t", "t", &COLUMNS);
            add_scene(&mut table, &scene, &[5, 6], &Silent).unwrap();
            for row in &table.rows {
                let zero = Cell::Count(0);
                assert_eq!((&row[5], &row[10], &row[11]), (&zero, &zero, &zero), "{row:?}");
                let Cell::Number(missed, _) = row[4] else { panic!("{row:?}") };
                assert!(misses.contains(&missed), "{row:?}");
            }
        }
    }

    #[test]
    fn sets_count_their_differences() {
        let (mut a, mut b) = (Voxels::new(2), Voxels::new(2));
        a.insert([0, 0, 0]);
        a.insert([3, 3, 3]);
        b.insert([3, 3, 3]);
        b.insert([1, 2, 3]);
        assert_eq!((a.count(), a.count_without(&b), b.count_without(&a)), (2, 1, 1));
    }
}
