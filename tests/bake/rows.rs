//! Rows of scenes whose rows are known.

use crate::scenes::{baked, box_mesh, cut_in_half, floor_mesh, one_mesh, small};
use crate::workplace::Workplace;
use glam::Vec3;
use manyview::Archive;
use manyview_pipeline::rows::RowsFrom;
use manyview_pipeline::scene::Material;
use manyview_shaders::directions::Fit;

const WAYS: [RowsFrom; 3] = [RowsFrom::Peel, RowsFrom::Rotate, RowsFrom::Points];

/// Rows of the direction along +Y (the first of a latitude-longitude set): word `v · 32 + u`, one bit per voxel
/// upwards; u runs along +Z and v along +X.
fn upwards(archive: &Archive) -> Vec<u32> {
    assert_eq!(archive.direction_set().unwrap().frame(0)[2], [0.0, 1.0, 0.0]);
    archive.direction_rows(0).unwrap()
}

/// The rows that are not at the border of the grid.
fn inner(rows: &[u32]) -> impl Iterator<Item = u32> {
    (2..30).flat_map(|v| (2..30).map(move |u| (v, u))).map(|(v, u)| rows[v * 32 + u])
}

#[test]
fn a_box_is_hit_below_and_above_in_every_row() {
    let scene = one_mesh(box_mesh(Vec3::new(-3.0, 0.0, 1.0), Vec3::new(5.0, 2.0, 5.0)), Material::default());
    for way in WAYS {
        for row in inner(&upwards(&baked(&scene, &small(way)))) {
            assert_eq!(row.count_ones(), 2, "{way}: {row:032b}");
            assert!(row.trailing_zeros() <= 1 && row.leading_zeros() <= 1, "{way}: {row:032b}");
        }
    }
}

#[test]
fn a_floor_is_one_voxel_in_every_row() {
    let scene = one_mesh(floor_mesh(-7.0, 9.0, 3.0), Material::default());
    for way in WAYS {
        let archive = baked(&scene, &small(way));
        let rows = upwards(&archive);
        assert!(inner(&rows).all(|row| row.count_ones() == 1), "{way}");
        // At the border the grid has a margin.
        assert!(rows.iter().filter(|row| **row != 0).count() >= 30 * 30, "{way}");
        // Seen edge-on, the floor is a line: along u it fills rows, across them it is thin.
        let sideways = archive.direction_set().unwrap();
        let along_x = (0..sideways.count())
            .find(|&d| sideways.frame(d)[2][0] > 0.999_999)
            .expect("a direction of the set runs along +X");
        let full =
            archive.direction_rows(along_x).unwrap().iter().filter(|row| row.count_ones() >= 30).count();
        assert!((30..=64).contains(&full), "{way}: {full} full rows");
    }
}

#[test]
fn alpha_cuts_the_same_half_from_the_rows() {
    let (material, texture) = cut_in_half();
    let mut scene = one_mesh(floor_mesh(-7.0, 9.0, 3.0), material);
    scene.textures.push(texture);
    for way in WAYS {
        let mut options = small(way);
        if let Some(rows) = &mut options.rows {
            // The grid fitted to what is left would be narrower than the scene's bounds.
            rows.fit = Fit::Cube;
        }
        let whole = {
            let scene = one_mesh(floor_mesh(-7.0, 9.0, 3.0), Material::default());
            upwards(&baked(&scene, &options))
        };
        let half = upwards(&baked(&scene, &options));
        // The texture's u runs along x, which is v here; the middle row may belong to either side.
        for v in (0..32).filter(|v| !(15..=16).contains(v)) {
            for u in 0..32 {
                let expected = if v < 16 { 0 } else { whole[v * 32 + u] };
                assert_eq!(half[v * 32 + u], expected, "{way}: v = {v}, u = {u}");
            }
        }
        let set = |rows: &[u32]| rows.iter().map(|row| row.count_ones()).sum::<u32>();
        assert!(set(&half).abs_diff(set(&whole) / 2) <= 32, "{way}: {} of {}", set(&half), set(&whole));
    }
}

#[test]
fn no_direction_is_empty_and_opposite_borders_are_reached() {
    let scene = one_mesh(box_mesh(Vec3::ZERO, Vec3::new(4.0, 1.0, 2.0)), Material::default());
    for way in WAYS {
        let archive = baked(&scene, &small(way));
        for direction in 0..36 {
            let rows = archive.direction_rows(direction).unwrap();
            let along = rows.iter().fold(0, |all, row| all | row);
            assert!(
                along.trailing_zeros() <= 1 && along.leading_zeros() <= 1,
                "{way}: {direction}: {along:032b}"
            );
        }
    }
}

#[test]
fn rows_that_miss_all_of_a_thin_thing_are_sound() {
    // A sliver along the diagonal: voxels of the octree are finer than it, those of the rows far coarser.
    let mut sliver = floor_mesh(0.0, 1.0, 0.0);
    sliver.positions = vec![Vec3::new(0.013, 0.0, 0.007), Vec3::ONE, Vec3::new(1.0, 1.0, 0.996)];
    sliver.base_color_uvs.clear();
    sliver.triangles = vec![[0, 1, 2]];
    let work = Workplace::new();
    work.write_scene("scene.glb", &one_mesh(sliver, Material::default()));
    let arguments = ["--levels", "10", "--rows", "32", "--directions", "latlong:6x6", "--rows-from", "peel"];
    work.run([&["bake", "scene.glb", "-o", "out.mvb", "--backend", "cpu"], &arguments[..]].concat())
        .succeeded();
    let report = work.run(["verify", "out.mvb"]).succeeded();
    assert!(report.stdout.contains("directions without any"), "{}", report.stdout);
    assert!(report.stdout.contains("sound"), "{}", report.stdout);
}
