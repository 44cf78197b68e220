//! Every method by its name draws the same scene, as far as it can.
#![cfg(feature = "bake")]

mod support;

use serde_json::Value;
use support::expect_exit;

#[test]
fn methods_agree_with_exact_rays_as_far_as_they_can() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (scene, archive) = (at("s.glb"), at("a.mvb"));
    expect_exit(0, &["scene", "city", "--triangles", "3000", "-o", &scene]);
    expect_exit(
        0,
        &["bake", &scene, "-o", &archive, "--levels", "9", "--rows", "64", "--directions", "latlong:30x30"],
    );
    let render = |method: &str, more: &[&str]| {
        let (exr, bits) = (at(&format!("{method}.exr")), at(&format!("{method}.npy")));
        let common = ["--size", "64x48", "--lights", "random:40", "--backend", "cpu", "--visibility", method];
        let files = ["-o", exr.as_str(), "--light-bits", bits.as_str()];
        expect_exit(0, &[&["render", scene.as_str()][..], &common, &files, more].concat());
        (exr, bits)
    };
    let (exact, exact_bits) = render("raytrace", &[]);
    for (method, most) in [("bvh", 0.005), ("brickmap", 0.06), ("rows", 0.15), ("ism", 0.4)] {
        let reads = method == "brickmap" || method == "rows";
        let bake = ["--bake", archive.as_str()];
        let (exr, bits) = render(method, if reads { &bake } else { &[] });
        let arguments = ["compare", &exact, &exr, "--light-bits", &exact_bits, &bits, "--format", "json"];
        let (stdout, _) = expect_exit(0, &arguments);
        let found: Value = serde_json::from_str(&stdout).unwrap();
        let eps_v = found["eps_v"].as_f64().unwrap();
        eprintln!("{method}: eps_v {eps_v}");
        assert!(eps_v < most, "{method}: {eps_v}");
        assert!(found["eps_s"].as_f64().unwrap() <= eps_v + 1e-6);
    }
}

#[test]
fn an_archive_without_rows_is_refused_by_rows() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (scene, archive) = (at("s.glb"), at("a.mvb"));
    expect_exit(0, &["scene", "city", "--triangles", "1000", "-o", &scene]);
    expect_exit(0, &["bake", &scene, "-o", &archive, "--levels", "6", "--rows", "0"]);
    let (_, stderr) = expect_exit(
        3,
        &["render", &scene, "--bake", &archive, "--visibility", "rows", "-o", &at("p.png"), "--size", "8x8"],
    );
    assert!(stderr.contains("--visibility rows") && stderr.contains("a.mvb"), "{stderr}");
}
