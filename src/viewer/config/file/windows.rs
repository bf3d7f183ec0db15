//! The windows of a configuration file and their cameras; the module [`file`](super) documents the format. Main thread.

use glam::{DAffine3, DMat4, DQuat, DVec3, EulerRot};
use serde::Deserialize;

use super::values::{Entries, Invalid, Number, Numbers, Object, limits, present};
use crate::viewer::camera::ResizePolicy;
use crate::viewer::config::window_setup::{CameraSetup, MAX_SIDE_PX, WindowSetup};
use crate::viewer::view::Eyes;
use crate::viewer::view::viewport::ViewArea;

/// How far the fractions of a viewport may exceed the window: room for rounded thirds.
const FRACTION_TOLERANCE: f64 = 1e-3;

limits! {
    /// A coordinate of a window's corner, pixels.
    PositionPx: -(MAX_SIDE_PX as f64), MAX_SIDE_PX as f64, true;
    /// A side of a window, pixels.
    SidePx: 1.0, MAX_SIDE_PX as f64, true;
    /// The number of a screen.
    ScreenNumber: 0.0, 64.0, true;
    /// Samples per pixel, of which 1 and 4 are supported.
    Samples: 1.0, 4.0, true;
    /// A corner or side of a viewport, pixels.
    ViewportPx: 0.0, MAX_SIDE_PX as f64, true;
    /// A corner or side of a viewport as a fraction of the window.
    Fraction: 0.0, 1.0, false;
    /// An angle, degrees.
    AngleDeg: -360.0, 360.0, false;
    /// The distance of a camera from the master, metres.
    OffsetM: -1e6, 1e6, false;
    /// An offset in the image plane, in image sizes.
    Shift: -1e3, 1e3, false;
    /// A magnification.
    Zoom: 1e-3, 1e3, false;
    /// The index of a window.
    WindowIndex: 0.0, 64.0, true;
}

/// The fields of a window.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct WindowFields {
    #[serde(default, deserialize_with = "present")]
    title: Option<String>,
    #[serde(default, deserialize_with = "present")]
    position_px: Option<Numbers<2, PositionPx>>,
    #[serde(default, deserialize_with = "present")]
    size_px: Option<Numbers<2, SidePx>>,
    #[serde(default, deserialize_with = "present")]
    screen: Option<Number<ScreenNumber>>,
    #[serde(default)]
    full_screen: bool,
    #[serde(default, deserialize_with = "present")]
    decorated: Option<bool>,
    #[serde(default)]
    shares_device: bool,
    #[serde(default, deserialize_with = "present")]
    samples: Option<Number<Samples>>,
    #[serde(default, deserialize_with = "present")]
    vsync: Option<bool>,
    #[serde(default, deserialize_with = "present")]
    cameras: Option<Entries<Object<CameraFields>>>,
}

/// The fields of a camera. `window` belongs to the cameras of views.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CameraFields {
    #[serde(default, deserialize_with = "present")]
    pub window: Option<Number<WindowIndex>>,
    #[serde(default, deserialize_with = "present")]
    viewport_px: Option<Numbers<4, ViewportPx>>,
    #[serde(default, deserialize_with = "present")]
    viewport: Option<Numbers<4, Fraction>>,
    #[serde(default, deserialize_with = "present")]
    resize: Option<ResizeName>,
    #[serde(default, deserialize_with = "present")]
    turn_deg: Option<Numbers<3, AngleDeg>>,
    #[serde(default, deserialize_with = "present")]
    move_m: Option<Numbers<3, OffsetM>>,
    #[serde(default, deserialize_with = "present")]
    shift: Option<Numbers<2, Shift>>,
    #[serde(default, deserialize_with = "present")]
    zoom: Option<Numbers<2, Zoom>>,
    #[serde(default)]
    eyes: EyesName,
}

/// The names of [`ResizePolicy`].
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "UPPERCASE")]
enum ResizeName {
    Horizontal,
    Vertical,
    Fixed,
}

/// The names of [`Eyes`].
#[derive(Clone, Copy, Debug, Default, Deserialize)]
#[serde(rename_all = "UPPERCASE")]
enum EyesName {
    #[default]
    Both,
    Left,
    Right,
    Middle,
}

/// Converts the windows of a file. With views, the windows must not have cameras.
pub(super) fn window_setups(windows: Vec<Object<WindowFields>>, has_views: bool) -> Result<Vec<WindowSetup>, Invalid> {
    let convert = |(index, Object(fields)): (usize, Object<WindowFields>)| {
        let path = format!("windows[{index}]");
        if has_views && fields.cameras.is_some() {
            return Invalid::err(
                format!("{path}.cameras"),
                "the file has `views`, whose cameras draw into the windows",
            );
        }
        fields.into_setup(&path, index == 0)
    };
    windows.into_iter().enumerate().map(convert).collect()
}

impl WindowFields {
    fn into_setup(self, path: &str, is_first: bool) -> Result<WindowSetup, Invalid> {
        if is_first && self.shares_device {
            return Invalid::err(
                format!("{path}.shares_device"),
                "the first window creates the device that other windows share",
            );
        }
        let samples = self.samples.map(|samples| samples.value as u32);
        if samples.is_some_and(|samples| !matches!(samples, 1 | 2 | 4 | 8 | 16)) {
            return Invalid::err(format!("{path}.samples"), "1, 2, 4, 8 and 16 are possible");
        }
        let cameras = match self.cameras {
            None => vec![CameraSetup::default()],
            Some(Entries(cameras)) => {
                let convert = |(index, Object(fields)): (usize, Object<CameraFields>)| {
                    let path = format!("{path}.cameras[{index}]");
                    match fields.window {
                        Some(_) => Invalid::err(format!("{path}.window"), "only the cameras of `views` name a window"),
                        None => fields.into_setup(&path, is_first && index == 0),
                    }
                };
                cameras.into_iter().enumerate().map(convert).collect::<Result<_, _>>()?
            }
        };
        Ok(WindowSetup {
            title: self.title,
            position_px: self.position_px.map(|position| position.values.map(|v| v as i32)),
            size_px: self.size_px.map(|size| size.values.map(|v| v as u32)),
            screen: self.screen.map(|screen| screen.value as usize),
            full_screen: self.full_screen,
            decorated: self.decorated.unwrap_or(true),
            shares_device: self.shares_device,
            samples,
            vsync: self.vsync,
            cameras,
        })
    }
}

impl CameraFields {
    /// Converts a camera; `path` names it in errors.
    pub fn into_setup(self, path: &str, is_master: bool) -> Result<CameraSetup, Invalid> {
        let viewport = self.viewport(path)?;
        if is_master && let Some(name) = self.first_offset() {
            return Invalid::err(format!("{path}.{name}"), "the first camera is the master, which has no offsets");
        }
        if !is_master && self.resize.is_some() {
            return Invalid::err(format!("{path}.resize"), "only the master's angle of view can be set");
        }
        let [right, up, clockwise] = self.turn_deg.map_or([0.0; 3], |turn| turn.values.map(f64::to_radians));
        let master_from_slave = DAffine3::from_rotation_translation(
            DQuat::from_euler(EulerRot::YXZ, -right, up, -clockwise),
            DVec3::from_array(self.move_m.map_or([0.0; 3], |offset| offset.values)),
        );
        let [shift_x, shift_y] = self.shift.map_or([0.0; 2], |shift| shift.values);
        let [zoom_x, zoom_y] = self.zoom.map_or([1.0; 2], |zoom| zoom.values);
        // Clip space is 2 units wide and high.
        let center_in_clip = DVec3::new(2.0 * shift_x, 2.0 * shift_y, 0.0);
        Ok(CameraSetup {
            viewport,
            resize: self.resize.map(|name| match name {
                ResizeName::Horizontal => ResizePolicy::Horizontal,
                ResizeName::Vertical => ResizePolicy::Vertical,
                ResizeName::Fixed => ResizePolicy::Fixed,
            }),
            projection_offset: DMat4::from_scale(DVec3::new(zoom_x, zoom_y, 1.0))
                * DMat4::from_translation(-center_in_clip),
            view_offset: master_from_slave.inverse(),
            eyes: match self.eyes {
                EyesName::Both => Eyes::Both,
                EyesName::Left => Eyes::Left,
                EyesName::Right => Eyes::Right,
                EyesName::Middle => Eyes::Middle,
            },
        })
    }

    /// Returns the name of the first field that sets an offset from the master.
    fn first_offset(&self) -> Option<&'static str> {
        let offsets = [
            ("turn_deg", self.turn_deg.is_some()),
            ("move_m", self.move_m.is_some()),
            ("shift", self.shift.is_some()),
            ("zoom", self.zoom.is_some()),
        ];
        offsets.into_iter().find_map(|(name, is_set)| is_set.then_some(name))
    }

    fn viewport(&self, path: &str) -> Result<ViewArea, Invalid> {
        const EMPTY: &str = "width and height must be above 0";
        let name = |field: &str| format!("{path}.{field}");
        match (&self.viewport_px, &self.viewport) {
            (None, None) => Ok(ViewArea::Whole),
            (Some(_), Some(_)) => Invalid::err(name("viewport"), "`viewport_px` is given already"),
            (Some(Numbers { values, .. }), None) => match values.map(|v| v as u32) {
                [_, _, 0, _] | [_, _, _, 0] => Invalid::err(name("viewport_px"), EMPTY),
                rect => Ok(ViewArea::Pixels(rect)),
            },
            (None, Some(Numbers { values: rect @ [x, y, width, height], .. })) => {
                if *width == 0.0 || *height == 0.0 {
                    return Invalid::err(name("viewport"), EMPTY);
                }
                if x + width > 1.0 + FRACTION_TOLERANCE || y + height > 1.0 + FRACTION_TOLERANCE {
                    return Invalid::err(name("viewport"), "the viewport extends beyond the window");
                }
                Ok(ViewArea::Shares(*rect))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::viewer::ArrangementError;
    use crate::viewer::config::Arrangement;

    fn read(text: &str) -> Result<Vec<WindowSetup>, ArrangementError> {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), text).unwrap();
        let read = Arrangement::read(file.path()).map(|read| match read {
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
                viewport: ViewArea::Pixels([1, 2, 30, 40]),
                resize: Some(ResizePolicy::Vertical),
                ..CameraSetup::default()
            }],
        };
        assert_eq!(windows[0], first);
        let second = WindowSetup { shares_device: true, cameras: windows[1].cameras.clone(), ..WindowSetup::default() };
        assert_eq!(windows[1], second);
        let [plain, turned, shifted] = &second.cameras[..] else { panic!("{:?}", second.cameras) };
        assert_eq!(*plain, CameraSetup::default());
        // A point to the right of the moved eye is in front of the turned camera.
        let shown = turned.view_offset.transform_point3(DVec3::new(1.0 + 7.0, 2.0, 3.0));
        assert!((shown - DVec3::new(0.0, 0.0, -7.0)).length() < 1e-9, "{shown}");
        // The centre of its image is one image width to the right of the master's and half an image height down.
        let shown = shifted.projection_offset.project_point3(DVec3::new(2.0, -1.0, 0.5));
        assert!((shown - DVec3::new(0.0, 0.0, 0.5)).length() < 1e-12, "{shown}");
        assert_eq!((shifted.projection_offset.x_axis.x, shifted.eyes), (2.0, Eyes::Right));
        assert_eq!(shifted.viewport, ViewArea::Shares([0.25, 0.0, 0.75, 1.0]));
        // Thirds, rounded to four digits.
        let thirds = r#"{"windows": [{"cameras": [{"viewport": [0.6667, 0, 0.3334, 1]}]}]}"#;
        assert_eq!(read(thirds).unwrap()[0].cameras[0].viewport, ViewArea::Shares([0.6667, 0.0, 0.3334, 1.0]));
        assert_eq!(read(r#"{"windows": [{}]}"#).unwrap(), [WindowSetup::default()]);
    }

    #[test]
    fn errors_name_the_field_and_the_reason() {
        for (text, field, says) in [
            ("", "", "invalid JSON"),
            ("{", "", "line 1"),
            ("[]", "", "expected an object"),
            ("{}", "", "`windows` is missing"),
            (r#"{"windows": []}"#, "windows", "list of 1"),
            (r#"{"windows": {}}"#, "windows", "list of 1"),
            (r#"{"window": []}"#, "window", "unknown field"),
            (r#"{"windows": [7]}"#, "windows[0]", "expected an object"),
            (r#"{"windows": [{"siez_px": [1, 2]}]}"#, "windows[0].siez_px", "size_px"),
            (r#"{"windows": [{"size_px": [640]}]}"#, "windows[0].size_px", "2 numbers"),
            (r#"{"windows": [{"size_px": [640, 0]}]}"#, "windows[0].size_px[1]", "whole number from 1"),
            (r#"{"windows": [{"size_px": [640, 1.5]}]}"#, "windows[0].size_px[1]", "whole number"),
            (r#"{"windows": [{"position_px": ["a", 0]}]}"#, "windows[0].position_px[0]", "whole number"),
            (r#"{"windows": [{"title": 5}]}"#, "windows[0].title", "string"),
            (r#"{"windows": [{"screen": -1}]}"#, "windows[0].screen", "from 0"),
            (r#"{"windows": [{"full_screen": 1}]}"#, "windows[0].full_screen", "boolean"),
            (r#"{"windows": [{"shares_device": true}]}"#, "windows[0].shares_device", "first window"),
            (r#"{"windows": [{"samples": 3}]}"#, "windows[0].samples", "1, 2, 4, 8 and 16"),
            (r#"{"windows": [{"vsync": null}]}"#, "windows[0].vsync", "boolean"),
            (r#"{"windows": [{"cameras": []}]}"#, "windows[0].cameras", "list of 1"),
            (r#"{"windows": [{"cameras": [{"shift": [1, 0]}]}]}"#, "windows[0].cameras[0].shift", "master"),
            (
                r#"{"windows": [{}, {"cameras": [{"viewport_px": [0, 0, 0, 5]}]}]}"#,
                "windows[1].cameras[0].viewport_px",
                "above 0",
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
                "above 0",
            ),
            (r#"{"windows": [{"cameras": [{"viewport": [0, 0, 1]}]}]}"#, "windows[0].cameras[0].viewport", "4 numbers"),
            (
                r#"{"windows": [{"cameras": [{"viewport": [0, 0, 1, 1], "viewport_px": [0, 0, 5, 5]}]}]}"#,
                "windows[0].cameras[0].viewport",
                "already",
            ),
            (
                r#"{"windows": [{"cameras": [{"resize": "BOTH"}]}]}"#,
                "windows[0].cameras[0].resize",
                "expected one of `HORIZ",
            ),
            (r#"{"windows": [{"cameras": [{}, {"resize": "FIXED"}]}]}"#, "windows[0].cameras[1].resize", "master's"),
            (r#"{"windows": [{}, {"cameras": [{"zoom": [0, 1]}]}]}"#, "windows[1].cameras[0].zoom[0]", "number from"),
            (r#"{"windows": [{}, {"cameras": [{"turn_deg": [1e9, 0, 0]}]}]}"#, "windows[1].cameras[0].turn_deg[0]", ""),
            (
                r#"{"windows": [{"cameras": [{"eyes": "NOSE"}]}]}"#,
                "windows[0].cameras[0].eyes",
                "expected one of `BOTH",
            ),
            (r#"{"windows": [{"cameras": [{"window": 0}]}]}"#, "windows[0].cameras[0].window", "of `views`"),
            (r#"{"windows": [["ahead"]]}"#, "windows[0]", "expected an object"),
            (r#"{"windows": [{"size_px": [1, 2, 3]}]}"#, "windows[0].size_px", "2 numbers"),
            (r#"{"windows": [{}]} 7"#, "", "invalid JSON"),
            (r#"{"windows": [{}, {"cameras": [{"fov": 3}]}]}"#, "windows[1].cameras[0].fov", "turn_deg"),
        ] {
            let error = read(text).unwrap_err();
            assert_eq!(error.field, field, "{text}: {error}");
            assert!(error.reason.contains(says) && error.to_string().contains(field), "{text}: {error}");
        }
        let large = read(&" ".repeat(2 << 20)).unwrap_err();
        assert!(large.reason.contains("bytes"), "{large}");
        let none = Arrangement::read(Path::new("/no/such/file.json")).unwrap_err();
        assert!(none.to_string().starts_with("/no/such/file.json: "), "{none}");
    }
}
