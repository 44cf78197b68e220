//! Morph targets, skins and animations.

use super::builder::{Builder, U8};
use glam::{DVec3, Vec3};
use serde_json::json;

/// A triangle whose one morph target lifts all corners by 10 along z.
fn morphed() -> Builder {
    let mut builder = Builder::triangle();
    let target = builder.floats("VEC3", &[0.0, 0.0, 10.0, 0.0, 0.0, 10.0, 0.0, 0.0, 10.0]);
    builder.primitive()["targets"] = json!([{"POSITION": target}]);
    builder
}

fn height(builder: &Builder, time: Option<f64>) -> f32 {
    let imported = time.map_or_else(|| builder.import(), |time| builder.import_at(time));
    imported.unwrap().scene.meshes[0].positions[0].z
}

#[test]
fn weights_of_the_node_go_before_those_of_the_mesh() {
    let mut builder = morphed();
    assert_eq!(height(&builder, None), 0.0);
    builder.json["meshes"][0]["weights"] = json!([0.5]);
    assert_eq!(height(&builder, None), 5.0);
    builder.json["nodes"][0]["weights"] = json!([0.25]);
    assert_eq!(height(&builder, None), 2.5);
}

#[test]
fn nodes_with_other_weights_get_other_meshes() {
    let mut builder = morphed();
    builder.json["nodes"] = json!([{"mesh": 0}, {"mesh": 0, "weights": [1]}, {"mesh": 0, "weights": [0]}]);
    builder.json["scenes"] = json!([{"nodes": [0, 1, 2]}]);
    let scene = builder.import().unwrap().scene;
    let meshes: Vec<u32> = scene.instances.iter().map(|instance| instance.mesh).collect();
    assert_eq!(meshes, [0, 1, 0]);
    assert_eq!(scene.meshes[1].positions[0].z, 10.0);
}

#[test]
fn animated_weights_are_interpolated_and_held_at_the_ends() {
    let mut builder = morphed();
    let times = builder.floats("SCALAR", &[1.0, 3.0]);
    let weights = builder.floats("SCALAR", &[0.0, 1.0]);
    builder.push(
        "animations",
        json!({"samplers": [{"input": times, "output": weights}],
            "channels": [{"sampler": 0, "target": {"node": 0, "path": "weights"}}]}),
    );
    let heights = [0.0, 1.0, 2.0, 3.0, 99.0].map(|time| height(&builder, Some(time)));
    assert_eq!(heights, [0.0, 0.0, 5.0, 10.0, 10.0]);
    assert_eq!(height(&builder, None), 0.0, "the rest pose is not the animation's start");
    builder.json["animations"][0]["samplers"][0]["interpolation"] = json!("STEP");
    assert_eq!(height(&builder, Some(2.9)), 0.0);
}

#[test]
fn animated_transforms_replace_those_of_the_node() {
    let mut builder = Builder::triangle();
    builder.json["nodes"][0] = json!({"mesh": 0, "translation": [7, 7, 7], "scale": [2, 2, 2]});
    let times = builder.floats("SCALAR", &[0.0, 1.0]);
    let half = std::f32::consts::FRAC_1_SQRT_2;
    let rotations = builder.floats("VEC4", &[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, half, half]);
    // Cubic: tangent in, value, tangent out for each keyframe; a straight line with slope 4.
    let line = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 4.0, 0.0, 0.0, 4.0, 0.0, 0.0, 4.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    let translations = builder.floats("VEC3", &line);
    builder.push(
        "animations",
        json!({"samplers": [{"input": times, "output": rotations}, {"input": times, "output": translations, "interpolation": "CUBICSPLINE"}],
            "channels": [{"sampler": 0, "target": {"node": 0, "path": "rotation"}}, {"sampler": 1, "target": {"node": 0, "path": "translation"}}]}),
    );
    let scene = builder.import_at(0.5).unwrap().scene;
    // 45 degrees: (1, 0) turns to (s, s), times the scale of 2, moved by 2.
    let s = std::f64::consts::FRAC_1_SQRT_2 * 2.0;
    let corner = scene.instances[0].world_from_object.transform_point3(DVec3::X);
    assert!(corner.abs_diff_eq(DVec3::new(s + 2.0, s, 0.0), 1e-6), "{corner}");
}

/// A triangle bound to two joints: the last corner follows the second one, the others share both.
fn skinned() -> Builder {
    let mut builder = Builder::triangle();
    let joints = builder.accessor("VEC4", U8, 3, &[0, 1, 0, 0, 0, 1, 0, 0, 1, 99, 0, 0]);
    let weights = builder.floats("VEC4", &[0.5, 0.5, 0.0, 0.0, 0.5, 0.5, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]);
    builder.primitive()["attributes"]["JOINTS_0"] = json!(joints);
    builder.primitive()["attributes"]["WEIGHTS_0"] = json!(weights);
    let mut matrices = [0.0_f32; 32];
    for (matrix, x) in matrices.as_chunks_mut::<16>().0.iter_mut().zip([0.0, -1.0]) {
        [0, 5, 10, 15].iter().for_each(|i| matrix[*i] = 1.0);
        matrix[12] = x;
    }
    let matrices = builder.floats("MAT4", &matrices);
    builder.json["nodes"] = json!([{"mesh": 0, "skin": 0, "translation": [1000, 0, 0]}, {"translation": [0, 0, 8], "children": [2]}, {"translation": [3, 0, 0]}]);
    builder.json["scenes"] = json!([{"nodes": [0]}]);
    builder.json["skins"] = json!([{"joints": [1, 2], "inverseBindMatrices": matrices}]);
    builder
}

#[test]
fn joints_place_a_skinned_mesh_and_its_node_does_not() {
    let scene = skinned().import().unwrap().scene;
    // The first joint moves by (0, 0, 8); the second one by (3, 0, 8), after its inverse bind matrix has moved by -1.
    let expected = [Vec3::new(1.0, 0.0, 8.0), Vec3::new(2.0, 0.0, 8.0), Vec3::new(2.0, 1.0, 8.0)];
    assert_eq!(scene.meshes[0].positions, expected);
    assert_eq!(scene.instances[0].world_from_object, glam::DMat4::IDENTITY);
}

#[test]
fn a_vertex_that_follows_a_missing_joint_is_refused() {
    let mut builder = skinned();
    let joints = builder.accessor("VEC4", U8, 3, &[2, 0, 0, 0].repeat(3));
    builder.primitive()["attributes"]["JOINTS_0"] = json!(joints);
    let message = builder.refusal();
    assert!(message.contains("skins[0]") && message.contains("joint 2"), "{message}");
}
