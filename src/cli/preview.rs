//! `manyview preview`.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use clap::ValueEnum;
use glam::DVec3;
use manyview::Archive;
use manyview::preview::{
    Axis, CameraChoice, Mode, Picture, PictureFormat, Scene, ViewSettings, choose_camera, picture_rows,
    picture_slice, picture_view, write_picture,
};
use manyview_shaders::directions::DirectionSet;
use manyview_shaders::sections::SceneInfo;

use super::camera_file::{describe, read_camera};
use super::cancel;
use super::error::{CliError, CliResult, Exit};
use super::overwrite::check_outputs;

/// The most pixels of a picture; each takes about 200 bytes while it is made.
const MAX_PIXELS: u64 = 1 << 26;
/// The deepest level of a slice, which has one pixel a cell.
const MAX_SLICE_LEVEL: u32 = 13;

/// Options of `preview`.
#[derive(Debug, clap::Args)]
#[command(after_help = CAMERA_HELP)]
pub(crate) struct Options {
    /// The archive
    #[arg(value_name = "A.mvb")]
    archive: PathBuf,
    /// The picture: .png for a screen, .exr for 32-bit floats (linear colour in R, G, B; further layers depth,
    /// normal and position in metres, +infinity where there is nothing)
    #[arg(short, long, value_name = "P.png|P.exr")]
    output: PathBuf,
    /// What a view shows
    #[arg(long, value_enum, default_value_t = ModeName::Shaded)]
    mode: ModeName,
    /// Pixels of a view
    #[arg(long, value_name = "WIDTHxHEIGHT", default_value = "1280x720")]
    size: Size,
    /// `auto` (from inside where the scene is mostly rooms), `inside`, or a file
    #[arg(long, value_name = "auto|inside|FILE", default_value = "auto")]
    camera: String,
    /// The deepest level of the octree to look at [default: all]
    #[arg(long, value_name = "L")]
    level: Option<u32>,
    /// Rays a pixel
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = clap::value_parser!(u32).range(1..=1024))]
    samples: u32,
    /// One layer of cells instead of a view, a pixel each: at a
    /// fraction of the scene's extent (with a point: `y=0.5`), or a cell's index in the cube (`y=12`)
    #[arg(long, value_name = "x|y|z=WHERE", conflicts_with = "direction")]
    slice: Option<SliceAt>,
    /// The rows of one direction instead of a view, left the depth of each row's first voxel, right how many it has:
    /// an index, or angles in degrees (theta from +Y, phi from +X towards +Z), of which the nearest direction is taken
    #[arg(long, value_name = "I|THETA,PHI", allow_hyphen_values = true)]
    direction: Option<DirectionAt>,
}

const CAMERA_HELP: &str = "A camera file is JSON or TOML with eye and target ([x, y, z], metres), and if need be up \
([x, y, z], +Y unless given) and fov (vertical, degrees, 40 unless given).";

/// Names of modes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum ModeName {
    /// Colours in the light of a sun and a sky, with shadows and glow
    Shaded,
    /// Base colours as they are stored
    Color,
    /// World-space normals: -1 … 1 as 0 … 1
    Normal,
    /// The level whose cells are about as large as a pixel, one hue each
    Level,
    /// Emitted light
    Emissive,
    /// Distance from the camera: near is bright
    Depth,
}

impl From<ModeName> for Mode {
    fn from(name: ModeName) -> Self {
        match name {
            ModeName::Shaded => Mode::Shaded,
            ModeName::Color => Mode::Color,
            ModeName::Normal => Mode::Normal,
            ModeName::Level => Mode::Level,
            ModeName::Emissive => Mode::Emissive,
            ModeName::Depth => Mode::Depth,
        }
    }
}

/// A picture size.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Size {
    width: u32,
    height: u32,
}

impl FromStr for Size {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let side = |text: &str| text.parse::<u32>().ok().filter(|side| (1..=65536).contains(side));
        text.split_once('x')
            .and_then(|(width, height)| Some(Size { width: side(width)?, height: side(height)? }))
            .filter(|size| u64::from(size.width) * u64::from(size.height) <= MAX_PIXELS)
            .ok_or_else(|| format!("write WIDTHxHEIGHT, such as 1280x720, of at most {MAX_PIXELS} pixels"))
    }
}

/// A slice, before the level is known.
#[derive(Debug, Clone, Copy, PartialEq)]
struct SliceAt {
    axis: Axis,
    place: Place,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Place {
    Fraction(f64),
    Index(u32),
}

impl FromStr for SliceAt {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parse = || {
            let (axis, place) = text.split_once('=')?;
            let axis = match axis {
                "x" => Axis::X,
                "y" => Axis::Y,
                "z" => Axis::Z,
                _ => return None,
            };
            let place = match place.parse::<u32>() {
                Ok(index) => Place::Index(index),
                Err(_) => Place::Fraction(place.parse().ok().filter(|f| (0.0..=1.0).contains(f))?),
            };
            Some(SliceAt { axis, place })
        };
        parse().ok_or_else(|| {
            "write an axis and where: a fraction with a point, as in y=0.5, or a cell's index, as in y=12"
                .to_owned()
        })
    }
}

/// A direction, before the set is known.
#[derive(Debug, Clone, Copy, PartialEq)]
enum DirectionAt {
    Index(u32),
    /// Theta and phi, degrees.
    Angles(f64, f64),
}

impl FromStr for DirectionAt {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let angle = |text: &str| text.trim().parse::<f64>().ok().filter(|angle| angle.abs() <= 36000.0);
        let angles = text.split_once(',').and_then(|(t, p)| Some(Self::Angles(angle(t)?, angle(p)?)));
        angles
            .or_else(|| text.parse().ok().map(Self::Index))
            .ok_or_else(|| "write a direction's index, or two angles in degrees, as in 45,120".to_owned())
    }
}

/// Runs `preview`.
pub(crate) fn run(options: &Options) -> CliResult {
    let format = PictureFormat::of_path(&options.output).ok_or_else(|| {
        let path = options.output.display();
        CliError::usage(format!("{path}: name the picture with the ending .png or .exr"))
    })?;
    check_outputs(&[("A.mvb", &*options.archive)], &[("--output", &*options.output)])?;
    let archive = Archive::open(&options.archive)?;
    let levels = archive.svo_info().levels;
    let level = options.level.unwrap_or(levels);
    if level > levels {
        let message = format!("{}: there is no level {level}; use --level 0 to {levels}", archive.name());
        return Err(CliError::usage(message));
    }
    _ = cancel::watch();
    // What cannot be written is not worth the work.
    drop(manyview_cache::atomic::AtomicFile::create(&options.output)?);
    let picture = if let Some(at) = options.direction {
        direction_picture(&archive, at)?
    } else if let Some(at) = options.slice {
        slice_picture(&archive, level, at)?
    } else {
        view_picture(&archive, options, level)?
    };
    cancel::check()?;
    write_picture(&options.output, format, &picture)?;
    eprintln!("{}: {} × {} pixels", options.output.display(), picture.width, picture.height);
    Ok(Exit::Done)
}

/// Draws a view of `archive` with the default options, from a camera file if there is one.
pub(crate) fn draw_default(archive: &Path, picture: &Path, camera: Option<&Path>) -> Result<(), CliError> {
    #[derive(clap::Parser)]
    struct Defaults {
        #[command(flatten)]
        options: Options,
    }
    let camera = camera.map_or(OsStr::new("auto"), Path::as_os_str);
    let (archive, picture) = (archive.as_os_str(), picture.as_os_str());
    let arguments = ["preview".as_ref(), archive, "-o".as_ref(), picture, "--camera".as_ref(), camera];
    let Defaults { options } = clap::Parser::try_parse_from(arguments).map_err(CliError::usage)?;
    run(&options).map(|_| ())
}

fn view_picture(archive: &Archive, options: &Options, level: u32) -> Result<Picture, CliError> {
    let Size { width, height } = options.size;
    let given = match options.camera.as_str() {
        "auto" => Err(CameraChoice::Auto),
        "inside" => Err(CameraChoice::Inside),
        file => Ok(read_camera(file.as_ref())?),
    };
    let scene = Scene::new(archive.svo_levels(..=level)?);
    cancel::check()?;
    let bounds = scene_bounds(archive.scene_info());
    let aspect = f64::from(width) / f64::from(height);
    let camera = given.unwrap_or_else(|choice| {
        let camera = choose_camera(&scene, bounds, aspect, choice);
        eprintln!("{}", describe(&camera));
        camera
    });
    let settings = ViewSettings {
        mode: options.mode.into(),
        width,
        height,
        level,
        samples: options.samples,
        extent: (bounds[1] - bounds[0]).max_element(),
    };
    Ok(picture_view(&scene, &camera, &settings, cancel::watch())??)
}

fn scene_bounds(info: &SceneInfo) -> [DVec3; 2] {
    [info.bounds_min.into(), info.bounds_max.into()]
}

fn slice_picture(archive: &Archive, level: u32, at: SliceAt) -> Result<Picture, CliError> {
    let side = 1u32 << level.min(MAX_SLICE_LEVEL);
    let index = match at.place {
        Place::Index(index) if index < side => index,
        Place::Index(index) => {
            let message = format!(
                "--slice: there is no cell {index} at level {level}; use 0 to {}, or a fraction with a point",
                side - 1
            );
            return Err(CliError::usage(message));
        }
        Place::Fraction(fraction) => {
            let axis = at.axis as usize;
            let [min, max] = scene_bounds(archive.scene_info());
            let place = min[axis] + (max[axis] - min[axis]) * fraction;
            let svo = archive.svo_info();
            // `as` saturates.
            (((place - svo.origin[axis]) / svo.size * f64::from(side)) as u32).min(side - 1)
        }
    };
    let svo = archive.svo_levels(..=level)?;
    Ok(picture_slice(&svo, level, at.axis, index))
}

fn direction_picture(archive: &Archive, at: DirectionAt) -> Result<Picture, CliError> {
    let Some((info, set)) = archive.rows_info().zip(archive.direction_set()) else {
        let message = format!("{}: the bake has no rows to show; leave out --direction", archive.name());
        return Err(CliError::bad_input(message));
    };
    let index = match at {
        DirectionAt::Index(index) if index < info.directions => index,
        DirectionAt::Index(index) => {
            let message = format!(
                "--direction: there is no direction {index} in {set}; use 0 to {}",
                info.directions - 1
            );
            return Err(CliError::usage(message));
        }
        DirectionAt::Angles(theta, phi) => nearest(set, theta, phi),
    };
    let [_, _, w] = set.frame(index);
    eprintln!("direction {index} of {set}: ({:.4}, {:.4}, {:.4})", w[0], w[1], w[2]);
    Ok(picture_rows(&archive.direction_rows(index)?, info.bits))
}

fn nearest(set: DirectionSet, theta_degrees: f64, phi_degrees: f64) -> u32 {
    let (theta, phi) = (theta_degrees.to_radians(), phi_degrees.to_radians());
    let ((sin_t, cos_t), (sin_p, cos_p)) =
        (manyview_shaders::trig::sin_cos(theta), manyview_shaders::trig::sin_cos(phi));
    set.nearest([sin_t * cos_p, cos_t, sin_t * sin_p].map(|c| c as f32))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_parse() {
        assert_eq!("y=0.5".parse(), Ok(SliceAt { axis: Axis::Y, place: Place::Fraction(0.5) }));
        assert_eq!("x=7".parse(), Ok(SliceAt { axis: Axis::X, place: Place::Index(7) }));
        for bad in ["", "y", "w=1", "y=-1", "y=1.5", "y=NaN", "y="] {
            assert!(bad.parse::<SliceAt>().is_err(), "{bad}");
        }
        assert_eq!("12".parse(), Ok(DirectionAt::Index(12)));
        assert_eq!("45,-30.5".parse(), Ok(DirectionAt::Angles(45.0, -30.5)));
        for bad in ["", "-3", "1,", "1,2,3", "NaN,0", "1e9,0"] {
            assert!(bad.parse::<DirectionAt>().is_err(), "{bad}");
        }
        assert_eq!("3x4".parse(), Ok(Size { width: 3, height: 4 }));
        for bad in ["", "3", "0x4", "3x", "-1x3", "65536x65536"] {
            assert!(bad.parse::<Size>().is_err(), "{bad}");
        }
    }

    #[test]
    fn angles_find_their_direction() {
        let set = DirectionSet::LatLong { thetas: 90, phis: 90 };
        assert_eq!(nearest(set, 90.0, 0.0), 45 * 90);
        assert_eq!(nearest(set, 44.0, 120.0), 22 * 90 + 60);
    }
}
