//! The views of a file of windows: JSON, read before anything opens. Main thread.
//!
//! ```json
//! { "windows": [ { "size_px": [1280, 480] }, { "shares_device": true } ],
//!   "scenes": { "before": "sets/1990", "after": "https://host/2020/tileset.json" },
//!   "share_pager": true,
//!   "views": [
//!     { "scene": "before", "cameras": [ { "viewport": [0, 0, 0.5, 1] } ] },
//!     { "scene": "after", "heading_deg": 20, "pitch_deg": -60, "range_m": 5000, "background": [0, 0, 40],
//!       "cameras": [ { "viewport": [0.5, 0, 0.5, 1], "resize": "HORIZONTAL" }, { "window": 1, "shift": [1, 0] } ] },
//!     { "cameras": [ { "window": 1, "viewport_px": [0, 0, 200, 200] } ] } ] }
//! ```
//! A file with `views` has no `cameras` in its windows: those of the views are drawn in them, in the order of the views.
//! Every field of a view may be left out: without `scene` (a name of `scenes`) it shows what the program was asked to
//! show, without `cameras` all of the first window; without `heading_deg`, `pitch_deg` and `range_m` (from the middle of
//! the set) it sees the set as it is seen at first; `background` is sRGB. A camera has the fields that it has in a window,
//! and `window`, counted from 0; the first of a view is its master and has no offsets. The sources of `scenes` are as on
//! the command line, paths from the folder of the file. With `share_pager` one pager, with one budget, fills all of them.

use std::path::Path;

use serde_json::{Map, Value};

use super::arrangement::WindowSetup;
use super::arrangement_file::{CAMERA_FIELDS, Field, MOST, Wrong, camera};
use super::home::ViewFrom;
use super::views_setup::{SceneSetup, ViewCamera, ViewSetup, ViewsSetup};
use crate::io;

/// Metres that a camera may be from the middle of a set.
const MOST_RANGE_M: f64 = 1e12;

/// `folder` is that of the file.
pub(super) fn views(
    views: &Field<'_>,
    scenes: Option<&Field<'_>>,
    windows: Vec<WindowSetup>,
    folder: &Path,
) -> Result<ViewsSetup, Wrong> {
    let scenes = scenes.map_or(Ok(Vec::new()), |field| scene_setups(field, folder))?;
    let mut setup = ViewsSetup { windows, scenes, ..ViewsSetup::default() };
    for field in &views.list()? {
        let view = view(field, &setup)?;
        setup.views.push(view);
    }
    Ok(setup)
}

fn scene_setups(field: &Field<'_>, folder: &Path) -> Result<Vec<SceneSetup>, Wrong> {
    let Some(object) = field.value.as_object().filter(|object| object.len() <= MOST) else {
        return field.wrong(format!("not an object of up to {MOST} names and sources"));
    };
    let scene = |(name, value): (&String, &Value)| {
        let source = field.child(name, value);
        match source.value.as_str().filter(|text| !text.is_empty()) {
            Some(text) if io::is_remote(text) => Ok(SceneSetup { name: name.clone(), source: text.to_owned() }),
            Some(text) => Ok(SceneSetup { name: name.clone(), source: folder.join(text).display().to_string() }),
            None => source.wrong("neither a path nor a URL"),
        }
    };
    object.iter().map(scene).collect()
}

fn view(field: &Field<'_>, setup: &ViewsSetup) -> Result<ViewSetup, Wrong> {
    let object = field.object(&["scene", "heading_deg", "pitch_deg", "range_m", "background", "cameras"])?;
    let of = |name: &str| object.get(name).map(|value| field.child(name, value));
    let mut view = ViewSetup { cameras: vec![ViewCamera::default()], ..ViewSetup::default() };
    if let Some(scene) = of("scene") {
        let named = scene.value.as_str().and_then(|name| setup.scenes.iter().position(|s| s.name == name));
        if named.is_none() {
            return scene.wrong("no name of `scenes`");
        }
        view.scene = named;
    }
    view.from = from(field, object)?;
    if let Some(color) = of("background") {
        view.background = Some(color.numbers(0.0, 255.0, true)?.map(|v: f64| v as u8));
    }
    if let Some(cameras) = of("cameras") {
        view.cameras.clear();
        for (place, field) in cameras.list()?.iter().enumerate() {
            view.cameras.push(view_camera(field, place == 0, setup.windows.len())?);
        }
    }
    Ok(view)
}

fn from(field: &Field<'_>, object: &Map<String, Value>) -> Result<Option<ViewFrom>, Wrong> {
    let number = |name: &str, least: f64, most: f64| {
        object.get(name).map(|value| field.child(name, value).number(least, most, false)).transpose()
    };
    let heading = number("heading_deg", -360.0, 360.0)?;
    let pitch = number("pitch_deg", -90.0, 90.0)?;
    let range_m = number("range_m", 1e-3, MOST_RANGE_M)?;
    if heading.is_none() && pitch.is_none() && range_m.is_none() {
        return Ok(None);
    }
    let usual = ViewFrom::default();
    Ok(Some(ViewFrom {
        heading: heading.map_or(usual.heading, f64::to_radians),
        pitch: pitch.map_or(usual.pitch, f64::to_radians),
        range_m,
    }))
}

fn view_camera(field: &Field<'_>, is_master: bool, windows: usize) -> Result<ViewCamera, Wrong> {
    let known: Vec<&str> = CAMERA_FIELDS.into_iter().chain(["window"]).collect();
    let object = field.object(&known)?;
    let mut window = 0;
    if let Some(value) = object.get("window") {
        let place = field.child("window", value);
        window = place.number(0.0, MOST as f64, true)? as usize;
        if window >= windows {
            return place.wrong(format!("there are {windows} windows, counted from 0"));
        }
    }
    Ok(ViewCamera { window, camera: camera(field, object, is_master)? })
}

#[cfg(test)]
mod tests {
    use glam::DMat4;

    use super::super::arrangement::{Arrangement, ArrangementError, CameraSetup};
    use super::super::viewport::Viewport;
    use super::*;

    fn read(text: &str) -> Result<ViewsSetup, ArrangementError> {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("views.json");
        std::fs::write(&file, text).unwrap();
        match Arrangement::read(&file)? {
            Arrangement::Views(mut setup) => {
                let of_folder = format!("{}/", folder.path().display());
                setup.scenes.iter_mut().for_each(|s| s.source = s.source.replace(&of_folder, "FOLDER/"));
                Ok(setup)
            }
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn every_field_is_read() {
        let setup = read(
            r#"{"windows": [{"size_px": [640, 480]}, {"shares_device": true}],
                "scenes": {"b": "sets/b", "a": "https://host/tileset.json", "c": "/abs/olute"}, "share_pager": true,
                "views": [
                  {},
                  {"scene": "b", "heading_deg": 90, "background": [1, 2, 255],
                   "cameras": [{"window": 1, "viewport_px": [1, 2, 3, 4], "eyes": "LEFT"},
                               {"shift": [1, 0]}]},
                  {"scene": "a", "pitch_deg": -45, "range_m": 10}]}"#,
        )
        .unwrap();
        assert_eq!((setup.windows.len(), setup.share_pager), (2, true));
        assert!(!read(r#"{"views": [{}]}"#).unwrap().share_pager);
        let scenes: Vec<_> = setup.scenes.iter().map(|s| (&*s.name, &*s.source)).collect();
        assert_eq!(scenes, [("a", "https://host/tileset.json"), ("b", "FOLDER/sets/b"), ("c", "/abs/olute")]);
        let [plain, rich, third] = &setup.views[..] else { panic!("{setup:?}") };
        assert_eq!(*plain, ViewSetup { cameras: vec![ViewCamera::default()], ..ViewSetup::default() });
        assert!(setup.needs_root());
        assert_eq!((rich.scene, rich.background, third.scene), (Some(1), Some([1, 2, 255]), Some(0)));
        let from = rich.from.unwrap();
        assert_eq!((from.heading, from.pitch), (std::f64::consts::FRAC_PI_2, ViewFrom::default().pitch));
        assert_eq!(third.from.unwrap().range_m, Some(10.0));
        let [master, slave] = &rich.cameras[..] else { panic!("{rich:?}") };
        assert_eq!((master.window, master.camera.viewport), (1, Viewport::Pixels([1, 2, 3, 4])));
        assert_eq!((slave.window, slave.camera.viewport), (0, Viewport::Whole));
        assert_ne!(slave.camera.projection_offset, DMat4::IDENTITY);
        assert_eq!(CameraSetup { eyes: master.camera.eyes, ..CameraSetup::default() }.eyes, master.camera.eyes);
    }

    #[test]
    fn what_is_wrong_is_named_with_its_field() {
        for (text, field, says) in [
            (r#"{"views": []}"#, "views", "list of 1"),
            (r#"{"views": {}}"#, "views", "list of 1"),
            (r#"{"views": [3]}"#, "views[0]", "not an object"),
            (r#"{"views": [{}, {"camera": []}]}"#, "views[1].camera", "cameras"),
            (r#"{"views": [{"scene": "a"}]}"#, "views[0].scene", "`scenes`"),
            (r#"{"views": [{"scene": 4}], "scenes": {"a": "b"}}"#, "views[0].scene", "`scenes`"),
            (r#"{"views": [{}], "scenes": ["a"]}"#, "scenes", "names and sources"),
            (r#"{"views": [{}], "scenes": {"a": 1}}"#, "scenes.a", "path"),
            (r#"{"views": [{}], "scenes": {"a": ""}}"#, "scenes.a", "path"),
            (r#"{"views": [{"pitch_deg": -91}]}"#, "views[0].pitch_deg", "number from -90"),
            (r#"{"views": [{"range_m": 0}]}"#, "views[0].range_m", "number from"),
            (r#"{"views": [{"background": [1, 2]}]}"#, "views[0].background", "3 numbers"),
            (r#"{"views": [{"background": [1, 2, 256]}]}"#, "views[0].background[2]", "to 255"),
            (r#"{"views": [{"cameras": []}]}"#, "views[0].cameras", "list of 1"),
            (r#"{"views": [{"cameras": [{"window": 1}]}]}"#, "views[0].cameras[0].window", "there are 1 windows"),
            (r#"{"views": [{"cameras": [{"window": -1}]}]}"#, "views[0].cameras[0].window", "whole number"),
            (r#"{"views": [{"cameras": [{"zoom": [2, 2]}]}]}"#, "views[0].cameras[0].zoom", "master"),
            (r#"{"views": [{"cameras": [{}, {"fov": 1}]}]}"#, "views[0].cameras[1].fov", "window"),
            (r#"{"views": [{}], "windows": [{"cameras": [{}]}]}"#, "windows[0].cameras", "of `views`"),
            (r#"{"views": [{}], "windows": [{"size_px": 1}]}"#, "windows[0].size_px", "2 numbers"),
            (r#"{"windows": [{}], "scenes": {}}"#, "scenes", "no `views`"),
            (r#"{"windows": [{}], "share_pager": true}"#, "share_pager", "no `views`"),
            (r#"{"views": [{}], "share_pager": 1}"#, "share_pager", "neither"),
        ] {
            let error = read(text).unwrap_err();
            assert_eq!(error.field, field, "{text}: {error}");
            assert!(error.reason.contains(says) && error.to_string().contains(field), "{text}: {error}");
        }
        // One window is there where none is said.
        assert_eq!(read(r#"{"views": [{}]}"#).unwrap().windows, [WindowSetup::default()]);
    }
}
