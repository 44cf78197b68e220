//! A room with 400 mirrors, each with a small map of its own of what is around it, all drawn at once.
//!
//! `cargo run --release --example reflections -- [P.png [RESOLUTION [REFERENCE.png]]]`
//!
//! The room is an octree that is made here. MegaViews draws colours and distances around each mirror's middle, 64 texels a
//! side unless said otherwise; a reflected ray is met with them ([`manyview::reflect`]), and mirrors see each other by going
//! on from one's map to the next one's. The reference casts every reflected ray at the octree instead.

use std::error::Error;
use std::path::{Path, PathBuf};
use std::time::Instant;

use glam::Vec3;
use manyview::megaviews::{MegaViews, Sharing};
use manyview::preview::{Camera, Picture, PictureFormat, write_picture};
use manyview::reflect::{Mirrors, Reflected, Sphere, reflected_color};
use manyview::render::compare::{Color, Compared, compare};
use manyview::render::image::Exposure;
use manyview::views::{OctreeSurfaces, Surfaces, ViewMaps, ViewRenderer, ViewSettings};
use manyview_pipeline::reduce::reduce_level;
use manyview_shaders::scene_tree::SceneTree;
use manyview_shaders::srgb::{LINEAR_FROM_SRGB, srgb_from_linear};
use manyview_shaders::svo::Svo;
use rayon::prelude::*;

/// Levels of the octree, and its cells a side.
const LEVELS: u32 = 8;
const SIDE: u32 = 1 << LEVELS;
/// Edge of the octree, metres: the room's length and width.
const EDGE: f32 = 8.0;
/// Height of the room in cells.
const HEIGHT: u32 = SIDE / 2;
/// Mirrors a side of their grid.
const GRID: u32 = 20;
/// The picture's size in pixels, and rays a side of a pixel.
const SIZE: [u32; 2] = [672, 378];
const RAYS: u32 = 2;

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let path = arguments.next().map_or_else(|| PathBuf::from("bakes/out/reflections.png"), PathBuf::from);
    let resolution = match arguments.next() {
        Some(text) => {
            text.parse().map_err(|_| format!("`{text}` is no resolution: use 8, 16, 32, 64 or 128"))?
        }
        None => 64,
    };
    let reference_path = arguments.next().map(PathBuf::from);
    let mirrors = mirrors();
    let clock = Instant::now();
    let svo = room(&mirrors.spheres);
    println!(
        "{} mirrors in a room of {} voxels, made in {:.1} s",
        mirrors.spheres.len(),
        svo.node_count(LEVELS as usize),
        clock.elapsed().as_secs_f64()
    );

    let clock = Instant::now();
    let renderer = MegaViews::new(SceneTree::new(&svo, true).into()).with_sharing(Sharing::None);
    let loaded = clock.elapsed().as_secs_f64();
    let views: Vec<_> = mirrors.spheres.iter().map(Sphere::view).collect();
    // Points of one texel, not of 1.5: edges are seen in a mirror.
    let settings = ViewSettings { with_colors: true, texels: 1.0, ..ViewSettings::new(resolution) };
    let maps = renderer.render_views(&views, &settings)?;
    println!(
        "{} maps of {resolution}² texels a half, {:.1} MiB, in {:.3} s",
        maps.centers().len(),
        maps.bytes() as f64 / f64::from(1 << 20),
        clock.elapsed().as_secs_f64() - loaded
    );

    let surfaces = OctreeSurfaces::new(&svo, true);
    let cast = |origin: Vec3, direction: Vec3| see(&surfaces, origin, direction);
    let (by_maps, seconds) = draw(&mirrors, |mirror, origin, direction| match mirror {
        Some(mirror) => by_map(&maps, mirror, &mirrors.spheres[mirror], origin, direction),
        None => cast(origin, direction),
    })?;
    println!("a picture of {} × {} pixels by maps in {seconds:.1} s", SIZE[0], SIZE[1]);
    write(&path, &by_maps)?;

    let (by_rays, seconds) = draw(&mirrors, |_, origin, direction| cast(origin, direction))?;
    println!("by rays in {seconds:.1} s");
    if let Some(path) = &reference_path {
        write(path, &by_rays)?;
    }
    let (found, _) = compare(&compared(&by_rays), &compared(&by_maps), Exposure::Auto)?;
    println!("PSNR {:.1} dB, SSIM {:.3} of the whole picture", found.psnr_db, found.ssim.unwrap_or(f64::NAN));
    println!(
        "PSNR {:.1} dB of the pixels that show a mirror",
        psnr_of_mirrors(&mirrors, &by_rays, &by_maps)?
    );
    Ok(())
}

/// Spheres over the floor in waves.
fn mirrors() -> Mirrors {
    let sphere = |number: u32| {
        let [u, v] = [number % GRID, number / GRID].map(|i| (i as f32 + 0.5) / GRID as f32);
        let wave = (u * 9.0).sin() * (v * 7.0 + 1.0).cos();
        let center = Vec3::new(0.7 + 6.6 * u, 0.75 + 0.35 * wave, 0.7 + 6.6 * v);
        Sphere { center, radius: 0.115 + 0.03 * (u * 31.0 + v * 17.0).sin() }
    };
    let spheres = (0..GRID * GRID).map(sphere).collect();
    Mirrors { spheres, tint: Vec3::new(0.93, 0.92, 0.9), bounces: 4 }
}

/// The room's voxels, lit.
fn room(spheres: &[Sphere]) -> Svo {
    let cells = (0..HEIGHT).flat_map(|y| (0..SIDE * SIDE).map(move |i| [i % SIDE, y, i / SIDE]));
    let is_wall = |cell: &[u32; 3]| {
        let [x, y, z] = *cell;
        x == 0 || z == 0 || x == SIDE - 1 || z == SIDE - 1 || y == 0 || y == HEIGHT - 1
    };
    let mut svo = Svo::of_cells([0.0; 3], f64::from(EDGE), LEVELS, cells.filter(is_wall));
    let voxel = EDGE / SIDE as f32;
    let cells = svo.cells(LEVELS as usize);
    let color = |cell: &[u16; 3]| {
        let at = Vec3::from(cell.map(|c| (f32::from(c) + 0.5) * voxel));
        let light = paint(cell.map(u32::from)) * brightness(at, spheres);
        light.to_array().map(|c| srgb_from_linear((c.clamp(0.0, 1.0) * 65535.0) as u16))
    };
    svo.levels[LEVELS as usize].colors = cells.par_iter().map(color).collect();
    for level in (0..LEVELS as usize).rev() {
        let masks = svo.levels[level].child_masks.clone();
        svo.levels[level] = reduce_level(masks, &svo.levels[level + 1]);
    }
    svo
}

/// Linear colour of a cell of the walls; more than 1 for what glows.
fn paint(cell: [u32; 3]) -> Vec3 {
    let [x, y, z] = cell;
    let is_odd = |a: u32, b: u32, size: u32| (a / size + b / size) % 2 == 1;
    let pattern = |odd: bool, a: [f32; 3], b: [f32; 3]| Vec3::from(if odd { a } else { b });
    if y == HEIGHT - 1 {
        let is_panel = |c: u32| c % 64 >= 16 && c % 64 < 48;
        return if is_panel(x) && is_panel(z) { Vec3::new(4.0, 3.7, 3.2) } else { Vec3::splat(0.7) };
    }
    if y == 0 {
        return pattern(is_odd(x, z, 16), [0.75, 0.72, 0.66], [0.1, 0.11, 0.14]);
    }
    match (x, z) {
        (0, _) => pattern(is_odd(y, z + 8 * (y / 16 % 2), 16), [0.7, 0.13, 0.08], [0.5, 0.08, 0.06]),
        (_, 0) => pattern((x / 10).is_multiple_of(2), [0.12, 0.3, 0.65], [0.7, 0.75, 0.8]),
        (x, _) if x == SIDE - 1 => {
            pattern(is_odd(z + y, SIDE + z - y, 24), [0.1, 0.5, 0.2], [0.65, 0.7, 0.3])
        }
        _ => pattern((y / 12).is_multiple_of(2), [0.8, 0.5, 0.1], [0.75, 0.7, 0.6]),
    }
}

/// Light that reaches a place of the walls, somewhat: from the panels, less what the spheres take of it.
fn brightness(at: Vec3, spheres: &[Sphere]) -> f32 {
    let height = EDGE * HEIGHT as f32 / SIDE as f32;
    if at.y > height * 0.99 {
        return 1.0;
    }
    let mut light = 0.12;
    for panel in 0..16u32 {
        let to_panel = Vec3::new((panel % 4) as f32 * 2.0 + 1.0, height, (panel / 4) as f32 * 2.0 + 1.0) - at;
        light += 0.45 * to_panel.y / to_panel.length() / to_panel.length_squared();
    }
    // A sphere hides its share of the sky.
    let shade = |sphere: &Sphere| {
        let away = sphere.center - at;
        let share = sphere.radius * sphere.radius / away.length_squared();
        1.0 - (share * away.normalize_or_zero().y.max(0.0) * 3.0).min(0.8)
    };
    light * spheres.iter().map(shade).product::<f32>()
}

fn linear([r, g, b, _]: [u8; 4]) -> Vec3 {
    Vec3::from([r, g, b].map(|c| f32::from(LINEAR_FROM_SRGB[usize::from(c)]) / 65535.0))
}

/// What of the room a ray meets.
fn see(surfaces: &OctreeSurfaces, origin: Vec3, direction: Vec3) -> Option<Reflected> {
    let [origin, direction] = [origin, direction].map(|v| v.to_array().map(f64::from));
    let seen = surfaces.cast(origin, direction)?;
    Some(Reflected { color: linear(seen.color), distance: seen.distance as f32 })
}

fn by_map(
    maps: &ViewMaps,
    mirror: usize,
    sphere: &Sphere,
    point: Vec3,
    direction: Vec3,
) -> Option<Reflected> {
    reflected_color(maps, maps.map_of()[mirror] as usize, sphere.center, point, direction)
}

fn camera() -> Camera {
    Camera {
        eye: glam::DVec3::new(7.5, 2.1, 7.5),
        target: glam::DVec3::new(4.4, 0.6, 4.4),
        up: glam::DVec3::Y,
        fov_degrees: 42.0,
    }
}

/// Linear colours of a picture, and seconds that they took.
type Drawn = (Vec<[f32; 3]>, f64);

fn draw(
    mirrors: &Mirrors,
    see: impl Fn(Option<usize>, Vec3, Vec3) -> Option<Reflected> + Sync,
) -> Result<Drawn, Box<dyn Error>> {
    let clock = Instant::now();
    let rays = camera().ray_maker(SIZE[0], SIZE[1])?;
    let pixel = |index: u32| {
        let sum: Vec3 = (0..RAYS * RAYS)
            .map(|ray| {
                let part = |i: u32| (f64::from(i) + 0.5) / f64::from(RAYS);
                let (x, y) = (index % SIZE[0], index / SIZE[0]);
                let ray = rays.ray(f64::from(x) + part(ray % RAYS), f64::from(y) + part(ray / RAYS));
                let [origin, direction] =
                    [ray.origin, ray.direction].map(|v| Vec3::from(v.map(|c| c as f32)));
                mirrors.trace(origin, direction, &see)
            })
            .sum();
        (sum / (RAYS * RAYS) as f32).to_array()
    };
    let colors = (0..SIZE[0] * SIZE[1]).into_par_iter().map(pixel).collect();
    Ok((colors, clock.elapsed().as_secs_f64()))
}

fn picture(colors: &[[f32; 3]]) -> Picture {
    Picture::of_colors(SIZE[0], SIZE[1], colors.to_vec())
}

fn write(path: &Path, colors: &[[f32; 3]]) -> Result<(), Box<dyn Error>> {
    if let Some(folder) = path.parent() {
        fs_err::create_dir_all(folder)?;
    }
    write_picture(path, PictureFormat::Png, &picture(colors))?;
    println!("{}", path.display());
    Ok(())
}

/// A picture as a screen shows it.
fn compared(colors: &[[f32; 3]]) -> Compared {
    let codes = picture(colors).display.iter().map(|c| c.map(|c| f32::from(c) / 255.0)).collect();
    Compared {
        width: SIZE[0],
        height: SIZE[1],
        color: Color::Codes(codes),
        shadow: None,
        surface: None,
        lights: None,
        exposure_stops: None,
    }
}

/// PSNR of the pixels in whose middle a mirror is seen.
fn psnr_of_mirrors(mirrors: &Mirrors, a: &[[f32; 3]], b: &[[f32; 3]]) -> Result<f64, Box<dyn Error>> {
    let rays = camera().ray_maker(SIZE[0], SIZE[1])?;
    let [a, b] = [a, b].map(|colors| compared(colors).color);
    let (mut squares, mut count) = (0.0, 0);
    for (index, (p, q)) in (0u32..).zip(a.values().iter().zip(b.values())) {
        let ray = rays.ray(f64::from(index % SIZE[0]) + 0.5, f64::from(index / SIZE[0]) + 0.5);
        let [origin, direction] = [ray.origin, ray.direction].map(|v| Vec3::from(v.map(|c| c as f32)));
        if mirrors.first(origin, direction, None).is_some() {
            squares += (0..3).map(|c| f64::from(p[c] - q[c]).powi(2)).sum::<f64>();
            count += 3;
        }
    }
    Ok(-10.0 * (squares / f64::from(count)).log10())
}
