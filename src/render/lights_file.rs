//! Files of lights.
//!
//! | ending | content |
//! |---|---|
//! | `.json` | a list of lights, or an object with the list as `lights` |
//! | `.toml` | an array of tables `[[lights]]` |
//! | `.npy` | float32 (n, 3) positions, or (n, 6) positions and colours times candela |
//! | `.csv` | a line for each light: `x,y,z`, or `x,y,z,r,g,b`; a first line that is no numbers is taken for names |
//!
//! A light of JSON or TOML has `position` ([x, y, z], metres), and if need be `color` ([r, g, b], linear, white unless
//! given), `intensity` (candela, 1 unless given; colour and intensity multiply), `range` (metres), `direction`
//! ([x, y, z], makes it a spot) with `inner_angle` and `outer_angle` (degrees from the axis, 0 and 45 unless given).

use super::lights::{MAX_LIGHTS, point_light};
use crate::npy::{ArrayReader, ReadError};
use fs_err::File;
use glam::Vec3;
use manyview_pipeline::scene::{LightKind, PunctualLight};
use serde_json::{Map, Value};
use std::io::BufReader;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// The largest file of lights.
const MAX_FILE_BYTES: u64 = 64 << 20;

/// What is wrong with a file of lights.
#[derive(Debug, Error)]
#[error(
    "{}: {reason}; a file of lights is JSON, TOML, CSV or NumPy, as in [{{\"position\": [0, 3, 0], \"color\": [1, 0.8, 0.6], \
     \"intensity\": 40}}]", path.display()
)]
pub struct LightsFileError {
    /// The file.
    pub path: PathBuf,
    /// What is wrong, and where.
    pub reason: String,
}

/// Reads a file of lights.
pub(super) fn read_lights(path: &Path) -> Result<Vec<PunctualLight>, LightsFileError> {
    read(path).map_err(|reason| LightsFileError { path: path.to_owned(), reason })
}

fn read(path: &Path) -> Result<Vec<PunctualLight>, String> {
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or("").to_ascii_lowercase();
    if !["json", "toml", "csv", "npy"].contains(&extension.as_str()) {
        return Err(format!("`.{extension}` is no ending of a file of lights"));
    }
    let unreadable = |error: std::io::Error| format!("cannot read the lights: {error}");
    let size = fs_err::metadata(path).map_err(unreadable)?.len();
    if size > MAX_FILE_BYTES {
        return Err(format!("{size} bytes are more than the {MAX_FILE_BYTES} of the largest file of lights"));
    }
    if extension == "npy" {
        return array(path, File::open(path).map_err(unreadable)?);
    }
    let text = fs_err::read_to_string(path).map_err(unreadable)?;
    let lights = match extension.as_str() {
        "json" => list(&serde_json::from_str(&text).map_err(|error| format!("not JSON: {error}"))?)?,
        "toml" => list(&toml::from_str(&text).map_err(|error| format!("not TOML: {}", error.message()))?)?,
        _ => csv(&text)?,
    };
    check_count(lights.len() as u64)?;
    Ok(lights)
}

fn check_count(count: u64) -> Result<(), String> {
    match count > MAX_LIGHTS as u64 {
        true => Err(format!("{count} lights are more than {MAX_LIGHTS}")),
        false => Ok(()),
    }
}

fn array(path: &Path, file: File) -> Result<Vec<PunctualLight>, String> {
    let name = path.file_name().unwrap_or(path.as_os_str()).to_string_lossy();
    let shapes: [&[Option<u64>]; 2] = [&[None, Some(3)], &[None, Some(6)]];
    let told = |error: ReadError| error.to_string();
    let mut reader = ArrayReader::<f32, _>::new(name, BufReader::new(file), &shapes).map_err(told)?;
    let (count, columns) = (reader.shape()[0], reader.shape()[1] as usize);
    check_count(count)?;
    let mut numbers = vec![0.0; count as usize * columns];
    reader.read(&mut numbers).map_err(told)?;
    let rows = numbers.chunks(columns).enumerate();
    rows.map(|(index, row)| {
        let intensity = if columns == 6 { Vec3::from_slice(&row[3..]) } else { Vec3::ONE };
        light(Vec3::from_slice(row), intensity).map_err(|reason| format!("light {index}: {reason}"))
    })
    .collect()
}

fn csv(text: &str) -> Result<Vec<PunctualLight>, String> {
    let mut lights = Vec::new();
    let lines = text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty());
    for (place, (number, line)) in lines.enumerate() {
        let numbers: Option<Vec<f32>> = line.split(',').map(|n| n.trim().parse().ok()).collect();
        lights.push(
            match numbers.as_deref() {
                Some(&[x, y, z]) => light(Vec3::new(x, y, z), Vec3::ONE),
                Some(&[x, y, z, r, g, b]) => light(Vec3::new(x, y, z), Vec3::new(r, g, b)),
                None if place == 0 => continue,
                _ => Err("it must be x,y,z or x,y,z,r,g,b in numbers".to_owned()),
            }
            .map_err(|reason| format!("line {}: {reason}", number + 1))?,
        );
    }
    Ok(lights)
}

fn light(position: Vec3, intensity: Vec3) -> Result<PunctualLight, String> {
    if !position.is_finite() {
        return Err("the position must be finite numbers".to_owned());
    }
    if !(intensity.is_finite() && intensity.min_element() >= 0.0) {
        return Err("colour and intensity must be finite numbers of at least 0".to_owned());
    }
    Ok(point_light(position, intensity))
}

fn list(value: &Value) -> Result<Vec<PunctualLight>, String> {
    let list = match value {
        Value::Object(fields) => fields.get("lights").and_then(Value::as_array),
        value => value.as_array(),
    };
    let list = list.ok_or("there is no list of lights")?;
    list.iter()
        .enumerate()
        .map(|(index, value)| {
            let fields = value.as_object().ok_or("it must have fields, such as `position`".to_owned());
            fields.and_then(light_of).map_err(|reason| format!("light {index}: {reason}"))
        })
        .collect()
}

const FIELDS: [&str; 7] =
    ["position", "color", "intensity", "range", "direction", "inner_angle", "outer_angle"];

fn light_of(fields: &Map<String, Value>) -> Result<PunctualLight, String> {
    if let Some(unknown) = fields.keys().find(|key| !FIELDS.contains(&key.as_str())) {
        return Err(format!("the field `{unknown}` is unknown; there are {}", FIELDS.join(", ")));
    }
    let vector = |field: &str| -> Result<Option<Vec3>, String> {
        let Some(value) = fields.get(field) else { return Ok(None) };
        let numbers: Option<Vec<f64>> =
            value.as_array().and_then(|numbers| numbers.iter().map(Value::as_f64).collect());
        match numbers.as_deref() {
            Some(&[x, y, z]) => Ok(Some(Vec3::new(x as f32, y as f32, z as f32))),
            _ => Err(format!("the field `{field}` must be three numbers")),
        }
    };
    let number = |field: &str, default: f32| match fields.get(field) {
        None => Ok(default),
        Some(value) => match value.as_f64() {
            Some(number) if number >= 0.0 => Ok(number as f32),
            _ => Err(format!("the field `{field}` must be a number of at least 0")),
        },
    };
    let position = vector("position")?.ok_or("the field `position` is missing")?;
    let intensity = vector("color")?.unwrap_or(Vec3::ONE) * number("intensity", 1.0)?;
    let mut light = light(position, intensity)?;
    light.range = number("range", f32::INFINITY)?;
    if light.range == 0.0 {
        return Err("the field `range` must be more than 0".to_owned());
    }
    let (inner, outer) = (number("inner_angle", 0.0)?, number("outer_angle", 45.0)?);
    match vector("direction")? {
        Some(direction) => {
            light.direction =
                direction.try_normalize().ok_or("the field `direction` must not be zero".to_owned())?;
            if !(inner <= outer && outer <= 90.0) {
                return Err("`inner_angle` ≤ `outer_angle` ≤ 90 must hold".to_owned());
            }
            light.kind = LightKind::Spot { inner_angle: inner.to_radians(), outer_angle: outer.to_radians() };
        }
        None if fields.contains_key("inner_angle") || fields.contains_key("outer_angle") => {
            return Err("angles need the field `direction`".to_owned());
        }
        None => {}
    }
    Ok(light)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::npy;
    use std::f32::consts::FRAC_PI_4;

    fn parse(name: &str, text: &str) -> Result<Vec<PunctualLight>, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(name);
        fs_err::write(&path, text).unwrap();
        read_lights(&path).map_err(|error| error.to_string())
    }

    #[test]
    fn all_formats_say_the_same() {
        let json =
            r#"[{"position": [1, 2, 3], "color": [1, 0.5, 0], "intensity": 4}, {"position": [0, 0, 0]}]"#;
        let toml = "[[lights]]\nposition = [1, 2, 3]\ncolor = [1, 0.5, 0]\nintensity = 4\n\
                    [[lights]]\nposition = [0, 0, 0]";
        let csv = "x,y,z,r,g,b\n1, 2, 3, 4, 2, 0\n\n0,0,0,1,1,1\n";
        let expected = vec![
            point_light(Vec3::new(1.0, 2.0, 3.0), Vec3::new(4.0, 2.0, 0.0)),
            point_light(Vec3::ZERO, Vec3::ONE),
        ];
        for (name, text) in [("l.json", json), ("l.toml", toml), ("l.CSV", csv)] {
            assert_eq!(parse(name, text).as_ref(), Ok(&expected), "{name}");
        }
        assert_eq!(parse("l.json", r#"{"lights": []}"#), Ok(Vec::new()));
        assert_eq!(parse("l.csv", "1,2,3").unwrap().len(), 1);
    }

    #[test]
    fn arrays_have_three_or_six_columns() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("l.npy");
        let read = |shape: &[usize], numbers: &[f32]| {
            let mut bytes = Vec::new();
            npy::write_header::<f32>(&mut bytes, shape).unwrap();
            npy::write_elements(&mut bytes, numbers).unwrap();
            fs_err::write(&path, bytes).unwrap();
            read_lights(&path).map_err(|error| error.to_string())
        };
        let white = vec![point_light(Vec3::X, Vec3::ONE), point_light(Vec3::Y, Vec3::ONE)];
        assert_eq!(read(&[2, 3], &[1.0, 0.0, 0.0, 0.0, 1.0, 0.0]), Ok(white));
        let red = vec![point_light(Vec3::Y, Vec3::X * 5.0)];
        assert_eq!(read(&[1, 6], &[0.0, 1.0, 0.0, 5.0, 0.0, 0.0]), Ok(red));
        assert_eq!(read(&[0, 3], &[]), Ok(Vec::new()));
        assert!(read(&[1, 4], &[0.0; 4]).unwrap_err().contains("(n, 3) or (n, 6)"));
        assert!(read(&[1 << 40, 3], &[0.0; 3]).unwrap_err().contains("more than 100000"));
        assert!(read(&[1, 3], &[f32::NAN; 3]).unwrap_err().contains("light 0"));
    }

    #[test]
    fn a_direction_makes_a_spot() {
        let text = r#"[{"position": [0, 5, 0], "direction": [0, -2, 0], "outer_angle": 45, "range": 9}]"#;
        let light = parse("l.json", text).unwrap()[0];
        assert_eq!((light.direction, light.range), (Vec3::NEG_Y, 9.0));
        assert!(
            matches!(light.kind, LightKind::Spot { outer_angle, .. } if (outer_angle - FRAC_PI_4).abs() < 1e-6)
        );
    }

    #[test]
    fn what_is_wrong_is_named() {
        for (name, text, part) in [
            ("l.json", "[", "not JSON"),
            ("l.toml", "lights = 3", "no list of lights"),
            ("l.json", "[3]", "light 0: it must have fields"),
            ("l.json", "[{}]", "light 0: the field `position` is missing"),
            ("l.json", r#"[{"position": [0, 0]}]"#, "three numbers"),
            ("l.json", r#"[{"position": [0, 0, 1e60]}]"#, "finite"),
            ("l.json", r#"[{"position": [0, 0, 0], "colour": 1}]"#, "`colour` is unknown"),
            ("l.json", r#"[{"position": [0, 0, 0], "intensity": -1}]"#, "at least 0"),
            ("l.json", r#"[{"position": [0, 0, 0], "outer_angle": 9}]"#, "direction"),
            ("l.csv", "x,y,z\n0,0,0\n1,2", "line 3"),
            ("l.csv", "0,0,nan", "line 1"),
            ("l.txt", "", "no ending"),
        ] {
            let error = parse(name, text).unwrap_err();
            assert!(error.contains(part) && error.contains(name), "{text}: {error}");
        }
        let missing = read_lights(Path::new("no-such.json")).unwrap_err().to_string();
        assert!(missing.contains("no-such.json"), "{missing}");
    }
}
