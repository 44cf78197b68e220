//! `bake --watch`.
#![cfg(unix)]

use crate::scenes::split_glb;
use crate::village::{CORNERS, SETTINGS, texture, village};
use crate::workplace::{Run, Workplace, glb};
use serde_json::{Value, json};
use std::io::{BufRead as _, BufReader};
use std::process::{Child, ChildStderr, Stdio};

/// A running `bake --watch`.
struct Watch {
    child: Child,
    events: BufReader<ChildStderr>,
}

impl Watch {
    fn start(work: &Workplace, scene: &str) -> Self {
        let usual = ["bake", scene, "-o", "out.mvb", "--cache", "cache", "--format", "json", "--watch"];
        let mut command = work.command();
        command.args(usual).args(SETTINGS).stderr(Stdio::piped()).stdout(Stdio::null());
        let mut child = command.spawn().unwrap();
        let events = BufReader::new(child.stderr.take().unwrap());
        Self { child, events }
    }

    /// Waits for an event, and gives all up to it.
    fn until(&mut self, event: &str) -> Vec<Value> {
        let mut all = Vec::new();
        loop {
            let mut line = String::new();
            assert!(self.events.read_line(&mut line).unwrap() > 0, "it ended before {event}: {all:?}");
            all.push(serde_json::from_str::<Value>(&line).unwrap_or_default());
            if all.last().is_some_and(|value| value["event"] == event) {
                return all;
            }
        }
    }

    fn stop(mut self) {
        let kill = format!("kill -INT {}", self.child.id());
        Run::of(std::process::Command::new("sh").args(["-c", &kill])).succeeded();
        // Its pipe must not fill.
        std::io::copy(&mut self.events, &mut std::io::sink()).unwrap();
        assert_eq!(self.child.wait().unwrap().code(), Some(130));
    }
}

impl Drop for Watch {
    fn drop(&mut self) {
        // Where a test has failed.
        _ = self.child.kill();
        _ = self.child.wait();
    }
}

fn clean(work: &Workplace, scene: &str) -> Vec<u8> {
    work.run([&["bake", scene, "-o", "clean.mvb", "--no-cache"], &SETTINGS[..]].concat()).succeeded();
    work.read("clean.mvb")
}

#[test]
fn a_changed_scene_is_baked_again_and_a_touched_one_is_not() {
    let work = Workplace::new();
    work.write_scene("scene.glb", &village());
    let mut watch = Watch::start(&work, "scene.glb");
    watch.until("watching");
    assert!(work.read("out.mvb") == clean(&work, "scene.glb"));
    let mut scene = village();
    scene.instances[CORNERS].world_from_object.w_axis.y += 0.5;
    // As editors save: another file, renamed.
    work.write("scene.tmp", &glb(&scene));
    fs_err::rename(work.path("scene.tmp"), work.path("scene.glb")).unwrap();
    let changed = watch.until("watching");
    assert!(
        changed.iter().any(|event| event["event"] == "changed" && event["files"] == json!(["scene.glb"]))
    );
    assert!(changed.iter().any(|event| event["event"] == "step_begin"));
    assert!(work.read("out.mvb") == clean(&work, "scene.glb"));
    // The same bytes with another time.
    work.write_scene("scene.glb", &scene);
    let touched = watch.until("watching");
    assert!(touched.iter().all(|event| event["event"] != "step_begin"), "{touched:?}");
    // A scene that is broken for a while: the archive stays.
    let good = work.read("out.mvb");
    work.write("scene.glb", b"not yet written");
    watch.until("error");
    watch.until("watching");
    assert!(work.read("out.mvb") == good);
    work.write_scene("scene.glb", &village());
    watch.until("watching");
    assert!(work.read("out.mvb") == clean(&work, "scene.glb"));
    watch.stop();
}

#[test]
fn files_that_were_missing_are_watched_too() {
    let work = Workplace::new();
    let (mut json, binary) = split_glb(&glb(&village()));
    json["buffers"][0]["uri"] = json!("scene.bin");
    json["images"][0] = json!({"uri": "wall.png"});
    work.write("scene.gltf", &serde_json::to_vec(&json).unwrap());
    let mut watch = Watch::start(&work, "scene.gltf");
    // Without its buffer there is no scene.
    watch.until("error");
    let watching = watch.until("watching").pop().unwrap();
    assert!(
        watching["files"]
            .as_array()
            .unwrap()
            .iter()
            .any(|file| file.as_str().unwrap().ends_with("scene.bin"))
    );
    work.write("scene.bin", &binary);
    watch.until("watching");
    assert!(work.read("out.mvb") == clean(&work, "scene.gltf"));
    let without = work.read("out.mvb");
    let image = texture([[9, 200, 9, 255]; 4]);
    let mut png = std::io::Cursor::new(Vec::new());
    let pixels = image.texels.concat();
    let encoded = image::RgbaImage::from_raw(2, 2, pixels).unwrap();
    encoded.write_to(&mut png, image::ImageFormat::Png).unwrap();
    work.write("wall.png", png.get_ref());
    watch.until("watching");
    assert!(work.read("out.mvb") != without);
    assert!(work.read("out.mvb") == clean(&work, "scene.gltf"));
    watch.stop();
}
