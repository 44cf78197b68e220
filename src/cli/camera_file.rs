//! Camera files.

use std::path::Path;

use glam::DVec3;
use manyview::preview::Camera;
use serde_json::Value;

use super::error::CliError;

/// Vertical field of view where a file has none, degrees.
const DEFAULT_FOV: f64 = 40.0;
/// The largest camera file.
const MAX_FILE_BYTES: u64 = 1 << 20;

/// Reads a camera from a JSON or TOML file.
pub(crate) fn read_camera(path: &Path) -> Result<Camera, CliError> {
    let fail = |reason: String| {
        CliError::bad_input(format!(
            "{}: {reason}; a camera file is JSON or TOML with eye and target, as in \
             {{\"eye\": [0, 2, 5], \"target\": [0, 1, 0], \"fov\": 40}}",
            path.display()
        ))
    };
    let is_json = path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("json"));
    let size =
        fs_err::metadata(path).map_err(|error| fail(format!("cannot read the camera: {error}")))?.len();
    if size > MAX_FILE_BYTES {
        return Err(fail(format!("{size} bytes are too many for a camera")));
    }
    let text =
        fs_err::read_to_string(path).map_err(|error| fail(format!("cannot read the camera: {error}")))?;
    let value: Value = if is_json {
        serde_json::from_str(&text).map_err(|error| fail(format!("not JSON: {error}")))?
    } else {
        toml::from_str(&text).map_err(|error| fail(format!("not TOML: {}", error.message())))?
    };
    parse_camera(&value).map_err(fail)
}

/// The chosen camera as a line that can be made a camera file of.
pub(crate) fn describe(camera: &Camera) -> String {
    let vector = |v: DVec3| format!("[{:.4}, {:.4}, {:.4}]", v.x, v.y, v.z);
    format!(
        "camera: {{\"eye\": {}, \"target\": {}, \"fov\": {}}}",
        vector(camera.eye),
        vector(camera.target),
        camera.fov_degrees
    )
}

fn parse_camera(value: &Value) -> Result<Camera, String> {
    let Value::Object(fields) = value else { return Err("not a table of fields".to_owned()) };
    if let Some(unknown) = fields.keys().find(|key| !["eye", "target", "up", "fov"].contains(&key.as_str())) {
        return Err(format!("the field `{unknown}` is unknown"));
    }
    let vector = |field: &str, default: Option<DVec3>| {
        let Some(value) = fields.get(field) else {
            return default.ok_or_else(|| format!("the field `{field}` is missing"));
        };
        let numbers: Option<Vec<f64>> =
            value.as_array().and_then(|numbers| numbers.iter().map(Value::as_f64).collect());
        match numbers.as_deref() {
            Some(&[x, y, z]) => Ok(DVec3::new(x, y, z)),
            _ => Err(format!("the field `{field}` must be three numbers")),
        }
    };
    let fov_degrees = match fields.get("fov") {
        None => DEFAULT_FOV,
        Some(value) => value.as_f64().ok_or("the field `fov` must be a number")?,
    };
    let camera = Camera {
        eye: vector("eye", None)?,
        target: vector("target", None)?,
        up: vector("up", Some(DVec3::Y))?,
        fov_degrees,
    };
    camera.ray_maker(1, 1).map_err(|error| error.to_string())?;
    Ok(camera)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_formats_give_the_same_camera() {
        let folder = tempfile::tempdir().unwrap();
        let (json, toml) = (folder.path().join("c.json"), folder.path().join("c.toml"));
        fs_err::write(&json, r#"{"eye": [1, 2.5, 3], "target": [0, 0, 0], "fov": 55}"#).unwrap();
        fs_err::write(&toml, "eye = [1, 2.5, 3]\ntarget = [0, 0, 0]\nfov = 55\n").unwrap();
        let camera = read_camera(&json).unwrap();
        assert_eq!(camera, read_camera(&toml).unwrap());
        assert_eq!((camera.eye, camera.up, camera.fov_degrees), (DVec3::new(1.0, 2.5, 3.0), DVec3::Y, 55.0));
    }

    #[test]
    fn what_is_no_camera_is_named() {
        for (text, part) in [
            ("[]", "not a table"),
            (r#"{"eye": [0, 0, 0]}"#, "`target` is missing"),
            (r#"{"eye": [0, 0], "target": [0, 0, 1]}"#, "`eye` must be three"),
            (r#"{"eye": [0, 0, 0], "target": [0, 0, 0]}"#, "same point"),
            (r#"{"eye": [0, 0, 0], "target": [0, 0, 1], "fov": 180}"#, "field of view"),
            (r#"{"eye": [0, 0, 0], "target": [0, 0, 1], "zoom": 2}"#, "`zoom` is unknown"),
        ] {
            let error = parse_camera(&serde_json::from_str(text).unwrap()).unwrap_err();
            assert!(error.contains(part), "{text}: {error}");
        }
    }
}
