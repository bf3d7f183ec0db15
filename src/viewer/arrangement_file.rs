//! Files of windows: JSON, read before anything opens. Main thread.
//!
//! ```json
//! { "windows": [
//!     { "title": "ahead", "position_px": [640, 0], "size_px": [640, 480], "screen": 0,
//!       "full_screen": false, "decorated": true, "samples": 4, "vsync": true },
//!     { "position_px": [0, 0], "size_px": [640, 480], "shares_device": true,
//!       "cameras": [ { "viewport_px": [0, 0, 640, 480], "turn_deg": [-40, 0, 0] } ] } ] }
//! ```
//! Every field may be left out but `windows`, which has at least one. A camera's fields: `viewport_px` (x, y, width,
//! height in pixels from the window's upper left corner) or `viewport` (the same as shares of the window, 0 to 1, which
//! follow it when it changes its size); `resize` ("HORIZONTAL", "VERTICAL", "FIXED"), the angle of view that changes with
//! the shape of the picture, of the master alone; `turn_deg` (to the right, upwards, clockwise) and `move_m` (to the right,
//! upwards, backwards), from the master's eye; `shift` (to the right, upwards, in pictures of the master) and `zoom`
//! (across, upwards), what it shows of the master's picture plane; `eyes` ("BOTH", "LEFT", "RIGHT", "MIDDLE"), which of them
//! it draws for in stereo. The first camera of the first window is the master and has `viewport_px` or `viewport`, `resize`
//! and `eyes` alone. A file may name several views instead: `views_file.rs` has what it says then.

use std::path::Path;

use glam::{DAffine3, DMat4, DQuat, DVec3, EulerRot};
use serde_json::{Map, Value};

use super::arrangement::{Arrangement, ArrangementError, CameraSetup, WindowSetup};
use super::camera::ResizePolicy;
use super::view::Eyes;
use super::viewport::Viewport;
use super::views_file;
use super::views_setup::ViewsSetup;

/// A file that is larger is not read.
const MOST_BYTES: u64 = 1 << 20;
/// Windows, views and scenes that a file may have, and cameras of one of them.
pub(super) const MOST: usize = 64;
/// Sides of windows and viewports, pixels.
const MOST_PX: f64 = 16_384.0;
/// Of shares that come to the whole window, as thirds.
const ROUNDING: f64 = 1e-3;
/// Metres that a camera may be from the master.
const MOST_M: f64 = 1e6;

/// A value of the file, and where it is.
pub(super) struct Field<'a> {
    pub value: &'a Value,
    path: String,
}

/// Where, and what is wrong.
pub(super) type Wrong = (String, String);

/// Fields of a camera.
pub(super) const CAMERA_FIELDS: [&str; 8] =
    ["viewport_px", "viewport", "resize", "turn_deg", "move_m", "shift", "zoom", "eyes"];

pub(super) fn read_arrangement(file: &Path) -> Result<Arrangement, ArrangementError> {
    let wrong = |(field, reason): Wrong| ArrangementError { source_name: file.display().to_string(), field, reason };
    let read = || -> Result<Vec<u8>, String> {
        let size = std::fs::metadata(file).map_err(|e| e.to_string())?.len();
        if size > MOST_BYTES {
            return Err(format!("{size} bytes are more than the {MOST_BYTES} that such a file may have"));
        }
        std::fs::read(file).map_err(|e| e.to_string())
    };
    let bytes = read().map_err(|reason| wrong((String::new(), reason)))?;
    let value: Value = serde_json::from_slice(&bytes).map_err(|e| wrong((String::new(), format!("no JSON: {e}"))))?;
    let folder = file.parent().unwrap_or(Path::new(""));
    arrangement(&Field { value: &value, path: String::new() }, folder).map_err(wrong)
}

fn arrangement(root: &Field<'_>, folder: &Path) -> Result<Arrangement, Wrong> {
    let object = root.object(&["windows", "scenes", "share_pager", "views"])?;
    let of = |name: &str| object.get(name).map(|value| root.child(name, value));
    let views = of("views");
    let windows = match of("windows") {
        Some(field) => windows(&field, views.is_some())?,
        None if views.is_some() => vec![WindowSetup::default()],
        None => return root.wrong("`windows` is missing"),
    };
    let share_pager = of("share_pager");
    if let (None, Some(field)) = (&views, &share_pager) {
        return field.wrong("there are no `views` of scenes that could share one");
    }
    match (views, of("scenes")) {
        (Some(views), scenes) => {
            let share_pager = share_pager.map_or(Ok(false), |field| field.bool())?;
            let setup = views_file::views(&views, scenes.as_ref(), windows, folder)?;
            Ok(Arrangement::Views(ViewsSetup { share_pager, ..setup }))
        }
        (None, Some(scenes)) => scenes.wrong("there are no `views` to show them"),
        (None, None) => Ok(Arrangement::Windows(windows)),
    }
}

fn windows(field: &Field<'_>, has_views: bool) -> Result<Vec<WindowSetup>, Wrong> {
    let list = field.list()?;
    let mut windows = Vec::with_capacity(list.len());
    for field in &list {
        if let Some(cameras) = field.value.get("cameras").filter(|_| has_views) {
            return field.child("cameras", cameras).wrong("the cameras are those of `views`");
        }
        windows.push(window(field, windows.is_empty())?);
    }
    Ok(windows)
}

fn window(field: &Field<'_>, is_first: bool) -> Result<WindowSetup, Wrong> {
    let known = [
        "title",
        "position_px",
        "size_px",
        "screen",
        "full_screen",
        "decorated",
        "shares_device",
        "samples",
        "vsync",
        "cameras",
    ];
    let object = field.object(&known)?;
    let of = |name: &str| object.get(name).map(|value| field.child(name, value));
    let mut window = WindowSetup::default();
    if let Some(title) = of("title") {
        let Some(text) = title.value.as_str() else { return title.wrong("not a text") };
        window.title = Some(text.to_owned());
    }
    if let Some(position) = of("position_px") {
        window.position_px = Some(position.numbers(-MOST_PX, MOST_PX, true)?.map(|v| v as i32));
    }
    if let Some(size) = of("size_px") {
        window.size_px = Some(size.numbers(1.0, MOST_PX, true)?.map(|v| v as u32));
    }
    if let Some(screen) = of("screen") {
        window.screen = Some(screen.number(0.0, MOST as f64, true)? as usize);
    }
    for (name, into) in [
        ("full_screen", &mut window.full_screen),
        ("decorated", &mut window.decorated),
        ("shares_device", &mut window.shares_device),
    ] {
        if let Some(field) = of(name) {
            *into = field.bool()?;
        }
    }
    if let Some(field) = of("shares_device").filter(|_| is_first && window.shares_device) {
        return field.wrong("the first window's device is what others share");
    }
    if let Some(samples) = of("samples") {
        let count = samples.number(1.0, 4.0, true)? as u32;
        if count != 1 && count != 4 {
            return samples.wrong("1 and 4 are possible");
        }
        window.samples = Some(count);
    }
    if let Some(vsync) = of("vsync") {
        window.vsync = Some(vsync.bool()?);
    }
    if let Some(cameras) = of("cameras") {
        window.cameras.clear();
        for (place, field) in cameras.list()?.iter().enumerate() {
            window.cameras.push(camera(field, field.object(&CAMERA_FIELDS)?, is_first && place == 0)?);
        }
    }
    Ok(window)
}

pub(super) fn camera(field: &Field<'_>, object: &Map<String, Value>, is_master: bool) -> Result<CameraSetup, Wrong> {
    let of = |name: &str| object.get(name).map(|value| field.child(name, value));
    if is_master && let Some(offset) = ["turn_deg", "move_m", "shift", "zoom"].into_iter().find_map(of) {
        return offset.wrong("the first camera is the master, which the others are beside");
    }
    let mut camera = CameraSetup::default();
    if let Some(viewport) = of("viewport_px") {
        let rect @ [_, _, width, height] = viewport.numbers(0.0, MOST_PX, true)?.map(|v: f64| v as u32);
        if width == 0 || height == 0 {
            return viewport.wrong("a part without pixels");
        }
        camera.viewport = Viewport::Pixels(rect);
    }
    if let Some(field) = of("viewport") {
        if object.contains_key("viewport_px") {
            return field.wrong("`viewport_px` says which part already");
        }
        let shares @ [x, y, width, height] = field.numbers(0.0, 1.0, false)?;
        if width == 0.0 || height == 0.0 {
            return field.wrong("a part without pixels");
        }
        if x + width > 1.0 + ROUNDING || y + height > 1.0 + ROUNDING {
            return field.wrong("reaches beyond the window");
        }
        camera.viewport = Viewport::Shares(shares);
    }
    if let Some(field) = of("resize") {
        camera.resize = Some(match field.value.as_str() {
            _ if !is_master => return field.wrong("the angle of view is the master's"),
            Some("HORIZONTAL") => ResizePolicy::Horizontal,
            Some("VERTICAL") => ResizePolicy::Vertical,
            Some("FIXED") => ResizePolicy::Fixed,
            _ => return field.wrong("none of HORIZONTAL, VERTICAL, FIXED"),
        });
    }
    if let Some(eyes) = of("eyes") {
        camera.eyes = match eyes.value.as_str() {
            Some("BOTH") => Eyes::Both,
            Some("LEFT") => Eyes::Left,
            Some("RIGHT") => Eyes::Right,
            Some("MIDDLE") => Eyes::Middle,
            _ => return eyes.wrong("none of BOTH, LEFT, RIGHT, MIDDLE"),
        };
    }
    let mut eye_of_camera = DAffine3::IDENTITY;
    if let Some(turn) = of("turn_deg") {
        let [right, up, clockwise] = turn.numbers(-360.0, 360.0, false)?.map(f64::to_radians);
        eye_of_camera = DAffine3::from_quat(DQuat::from_euler(EulerRot::YXZ, -right, up, -clockwise));
    }
    if let Some(moved) = of("move_m") {
        eye_of_camera.translation = DVec3::from_array(moved.numbers(-MOST_M, MOST_M, false)?);
    }
    camera.view_offset = eye_of_camera.inverse();
    let [mut shift, mut zoom] = [[0.0; 2], [1.0; 2]];
    if let Some(field) = of("shift") {
        shift = field.numbers(-1e3, 1e3, false)?;
    }
    if let Some(field) = of("zoom") {
        zoom = field.numbers(1e-3, 1e3, false)?;
    }
    // Clip space is two wide.
    let at = DVec3::new(2.0 * shift[0], 2.0 * shift[1], 0.0);
    camera.projection_offset = DMat4::from_scale(DVec3::new(zoom[0], zoom[1], 1.0)) * DMat4::from_translation(-at);
    Ok(camera)
}

impl<'a> Field<'a> {
    pub(super) fn wrong<T>(&self, reason: impl Into<String>) -> Result<T, Wrong> {
        Err((self.path.clone(), reason.into()))
    }

    pub(super) fn child(&self, name: &str, value: &'a Value) -> Self {
        let dot = if self.path.is_empty() { "" } else { "." };
        Field { value, path: format!("{}{dot}{name}", self.path) }
    }

    pub(super) fn object(&self, known: &[&str]) -> Result<&'a Map<String, Value>, Wrong> {
        let Some(object) = self.value.as_object() else { return self.wrong("not an object") };
        match object.iter().find(|(name, _)| !known.contains(&name.as_str())) {
            Some((name, value)) => {
                self.child(name, value).wrong(format!("no such field; there are {}", known.join(", ")))
            }
            None => Ok(object),
        }
    }

    /// At least one, and not too many.
    pub(super) fn list(&self) -> Result<Vec<Field<'a>>, Wrong> {
        match self.value.as_array() {
            Some(list) if (1..=MOST).contains(&list.len()) => {
                let at = |(place, value)| Field { value, path: format!("{}[{place}]", self.path) };
                Ok(list.iter().enumerate().map(at).collect())
            }
            _ => self.wrong(format!("not a list of 1 to {MOST}")),
        }
    }

    fn bool(&self) -> Result<bool, Wrong> {
        self.value.as_bool().map_or_else(|| self.wrong("neither true nor false"), Ok)
    }

    pub(super) fn number(&self, from: f64, to: f64, is_whole: bool) -> Result<f64, Wrong> {
        let fits = |v: &f64| (from..=to).contains(v) && (!is_whole || v.fract() == 0.0);
        let kind = if is_whole { "whole number" } else { "number" };
        self.value.as_f64().filter(fits).map_or_else(|| self.wrong(format!("not a {kind} from {from} to {to}")), Ok)
    }

    pub(super) fn numbers<const N: usize>(&self, from: f64, to: f64, is_whole: bool) -> Result<[f64; N], Wrong> {
        let Some(list) = self.value.as_array().filter(|list| list.len() == N) else {
            return self.wrong(format!("not a list of {N} numbers"));
        };
        let mut numbers = [0.0; N];
        for (place, (number, value)) in numbers.iter_mut().zip(list).enumerate() {
            *number = Field { value, path: format!("{}[{place}]", self.path) }.number(from, to, is_whole)?;
        }
        Ok(numbers)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Vec<WindowSetup>, ArrangementError> {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), text).unwrap();
        let read = read_arrangement(file.path()).map(|read| match read {
            Arrangement::Windows(windows) => windows,
            other => panic!("{other:?}"),
        });
        assert!(read.as_ref().err().is_none_or(|e| e.source_name == file.path().display().to_string()));
        read
    }

    #[test]
    fn every_field_is_read() {
        let windows = read(
            r#"{"windows": [
                {"title": "ahead", "position_px": [-5, 6], "size_px": [640, 480], "screen": 2, "full_screen": true,
                 "decorated": false, "samples": 4, "vsync": false, "cameras": [{"viewport_px": [1, 2, 30, 40], "resize": "VERTICAL"}]},
                {"shares_device": true, "cameras": [{}, {"turn_deg": [90, 0, 0], "move_m": [1, 2, 3]},
                 {"shift": [1, -0.5], "zoom": [2, 3], "eyes": "RIGHT", "viewport": [0.25, 0, 0.75, 1]}]}]}"#,
        )
        .unwrap();
        let first = WindowSetup {
            title: Some("ahead".to_owned()),
            position_px: Some([-5, 6]),
            size_px: Some([640, 480]),
            screen: Some(2),
            full_screen: true,
            decorated: false,
            shares_device: false,
            samples: Some(4),
            vsync: Some(false),
            cameras: vec![CameraSetup {
                viewport: Viewport::Pixels([1, 2, 30, 40]),
                resize: Some(ResizePolicy::Vertical),
                ..CameraSetup::default()
            }],
        };
        assert_eq!(windows[0], first);
        let second = WindowSetup { shares_device: true, cameras: windows[1].cameras.clone(), ..WindowSetup::default() };
        assert_eq!(windows[1], second);
        let [plain, turned, shifted] = &second.cameras[..] else { panic!("{:?}", second.cameras) };
        assert_eq!(*plain, CameraSetup::default());
        // What is to the right of the moved eye is before it.
        let seen = turned.view_offset.transform_point3(DVec3::new(1.0 + 7.0, 2.0, 3.0));
        assert!((seen - DVec3::new(0.0, 0.0, -7.0)).length() < 1e-9, "{seen}");
        // The middle of its picture is one picture to the right of the master's, and half of one down.
        let seen = shifted.projection_offset.project_point3(DVec3::new(2.0, -1.0, 0.5));
        assert!((seen - DVec3::new(0.0, 0.0, 0.5)).length() < 1e-12, "{seen}");
        assert_eq!((shifted.projection_offset.x_axis.x, shifted.eyes), (2.0, Eyes::Right));
        assert_eq!(shifted.viewport, Viewport::Shares([0.25, 0.0, 0.75, 1.0]));
        // Thirds, as far as they are written out.
        let thirds = r#"{"windows": [{"cameras": [{"viewport": [0.6667, 0, 0.3334, 1]}]}]}"#;
        assert_eq!(read(thirds).unwrap()[0].cameras[0].viewport, Viewport::Shares([0.6667, 0.0, 0.3334, 1.0]));
        assert_eq!(read(r#"{"windows": [{}]}"#).unwrap(), [WindowSetup::default()]);
    }

    #[test]
    fn what_is_wrong_is_named_with_its_field() {
        for (text, field, says) in [
            ("", "", "no JSON"),
            ("{", "", "line 1"),
            ("[]", "", "not an object"),
            ("{}", "", "`windows` is missing"),
            (r#"{"windows": []}"#, "windows", "list of 1"),
            (r#"{"windows": {}}"#, "windows", "list of 1"),
            (r#"{"window": []}"#, "window", "no such field"),
            (r#"{"windows": [7]}"#, "windows[0]", "not an object"),
            (r#"{"windows": [{"siez_px": [1, 2]}]}"#, "windows[0].siez_px", "size_px"),
            (r#"{"windows": [{"size_px": [640]}]}"#, "windows[0].size_px", "2 numbers"),
            (r#"{"windows": [{"size_px": [640, 0]}]}"#, "windows[0].size_px[1]", "whole number from 1"),
            (r#"{"windows": [{"size_px": [640, 1.5]}]}"#, "windows[0].size_px[1]", "whole number"),
            (r#"{"windows": [{"position_px": ["a", 0]}]}"#, "windows[0].position_px[0]", "whole number"),
            (r#"{"windows": [{"title": 5}]}"#, "windows[0].title", "text"),
            (r#"{"windows": [{"screen": -1}]}"#, "windows[0].screen", "from 0"),
            (r#"{"windows": [{"full_screen": 1}]}"#, "windows[0].full_screen", "neither true nor false"),
            (r#"{"windows": [{"shares_device": true}]}"#, "windows[0].shares_device", "first window"),
            (r#"{"windows": [{"samples": 2}]}"#, "windows[0].samples", "1 and 4"),
            (r#"{"windows": [{"vsync": null}]}"#, "windows[0].vsync", "neither"),
            (r#"{"windows": [{"cameras": []}]}"#, "windows[0].cameras", "list of 1"),
            (r#"{"windows": [{"cameras": [{"shift": [1, 0]}]}]}"#, "windows[0].cameras[0].shift", "master"),
            (
                r#"{"windows": [{}, {"cameras": [{"viewport_px": [0, 0, 0, 5]}]}]}"#,
                "windows[1].cameras[0].viewport_px",
                "without pixels",
            ),
            (
                r#"{"windows": [{"cameras": [{"viewport": [0, 0, 2, 1]}]}]}"#,
                "windows[0].cameras[0].viewport[2]",
                "from 0 to 1",
            ),
            (
                r#"{"windows": [{"cameras": [{"viewport": [0.5, 0, 0.6, 1]}]}]}"#,
                "windows[0].cameras[0].viewport",
                "beyond the window",
            ),
            (
                r#"{"windows": [{"cameras": [{"viewport": [0.5, 0, 0.5, 0]}]}]}"#,
                "windows[0].cameras[0].viewport",
                "without pixels",
            ),
            (r#"{"windows": [{"cameras": [{"viewport": [0, 0, 1]}]}]}"#, "windows[0].cameras[0].viewport", "4 numbers"),
            (
                r#"{"windows": [{"cameras": [{"viewport": [0, 0, 1, 1], "viewport_px": [0, 0, 5, 5]}]}]}"#,
                "windows[0].cameras[0].viewport",
                "already",
            ),
            (r#"{"windows": [{"cameras": [{"resize": "BOTH"}]}]}"#, "windows[0].cameras[0].resize", "none of HORIZ"),
            (r#"{"windows": [{"cameras": [{}, {"resize": "FIXED"}]}]}"#, "windows[0].cameras[1].resize", "master's"),
            (r#"{"windows": [{}, {"cameras": [{"zoom": [0, 1]}]}]}"#, "windows[1].cameras[0].zoom[0]", "number from"),
            (r#"{"windows": [{}, {"cameras": [{"turn_deg": [1e9, 0, 0]}]}]}"#, "windows[1].cameras[0].turn_deg[0]", ""),
            (r#"{"windows": [{"cameras": [{"eyes": "NOSE"}]}]}"#, "windows[0].cameras[0].eyes", "none of BOTH"),
            (r#"{"windows": [{}, {"cameras": [{"fov": 3}]}]}"#, "windows[1].cameras[0].fov", "turn_deg"),
        ] {
            let error = read(text).unwrap_err();
            assert_eq!(error.field, field, "{text}: {error}");
            assert!(error.reason.contains(says) && error.to_string().contains(field), "{text}: {error}");
        }
        let large = read(&" ".repeat(2 << 20)).unwrap_err();
        assert!(large.reason.contains("bytes"), "{large}");
        let none = read_arrangement(Path::new("/no/such/file.json")).unwrap_err();
        assert!(none.to_string().starts_with("/no/such/file.json: "), "{none}");
    }
}
