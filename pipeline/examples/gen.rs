use manyview_pipeline::{generate::generate, glb::write_glb};
#[allow(clippy::disallowed_methods)]
fn main() {
    let a: Vec<String> = std::env::args().collect();
    let t = std::time::Instant::now();
    let s = generate(a[1].parse().unwrap(), a[2].parse().unwrap(), a[3].parse().unwrap());
    let unique: usize = s.meshes.iter().map(|m| m.triangles.len()).sum();
    eprintln!(
        "{} drawn {} unique {} meshes {} inst {} lights {} bounds {:?} in {:?}",
        a[1],
        s.drawn_triangles(),
        unique,
        s.meshes.len(),
        s.instances.len(),
        s.lights.len(),
        s.bounds(),
        t.elapsed()
    );
    let mut by = std::collections::BTreeMap::new();
    for i in &s.instances {
        let m = &s.meshes[i.mesh as usize];
        *by.entry(m.name.split(' ').next().unwrap().to_owned()).or_insert(0) += m.triangles.len();
    }
    eprintln!("{by:?}");
    let f = fs_err::File::create(&a[4]).unwrap();
    write_glb(&s, &mut std::io::BufWriter::new(f)).unwrap();
    eprintln!("{:?}", t.elapsed());
}
