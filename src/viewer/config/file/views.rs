//! The views and scenes of a configuration file; the module [`file`](super) documents the format. Main thread.

use std::collections::BTreeMap;
use std::fmt;
use std::path::Path;

use serde::Deserialize;
use serde::de::{Deserializer, Error, MapAccess, Visitor};

use super::values::{Entries, Invalid, MAX_ENTRIES, Number, Numbers, Object, limits, present};
use super::windows::CameraFields;
use crate::fetch;
use crate::viewer::config::view_setup::{SceneSetup, ViewCamera, ViewSetup};
use crate::viewer::view::set_bounds::ViewFrom;

limits! {
    /// A heading, degrees clockwise from north.
    HeadingDeg: -360.0, 360.0, false;
    /// A pitch, degrees above the horizon.
    PitchDeg: -90.0, 90.0, false;
    /// The distance of a camera from the middle of a set, metres.
    RangeM: 1e-3, 1e12, false;
    /// A channel of an sRGB colour.
    Channel: 0.0, 255.0, true;
}

/// The fields of a view.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ViewFields {
    #[serde(default, deserialize_with = "present")]
    scene: Option<String>,
    #[serde(default, deserialize_with = "present")]
    heading_deg: Option<Number<HeadingDeg>>,
    #[serde(default, deserialize_with = "present")]
    pitch_deg: Option<Number<PitchDeg>>,
    #[serde(default, deserialize_with = "present")]
    range_m: Option<Number<RangeM>>,
    #[serde(default, deserialize_with = "present")]
    background: Option<Numbers<3, Channel>>,
    #[serde(default, deserialize_with = "present")]
    cameras: Option<Entries<Object<CameraFields>>>,
}

/// Names of scenes and their sources, in the order of the names.
#[derive(Debug)]
pub(super) struct ScenesField(BTreeMap<String, Source>);

impl<'de> Deserialize<'de> for ScenesField {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct ScenesVisitor;
        impl<'de> Visitor<'de> for ScenesVisitor {
            type Value = BTreeMap<String, Source>;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(f, "an object of up to {MAX_ENTRIES} names and sources")
            }

            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self::Value, A::Error> {
                let mut scenes = BTreeMap::new();
                while let Some((name, source)) = map.next_entry()? {
                    scenes.insert(name, source);
                    if scenes.len() > MAX_ENTRIES {
                        return Err(A::Error::invalid_length(scenes.len(), &self));
                    }
                }
                Ok(scenes)
            }
        }
        deserializer.deserialize_map(ScenesVisitor).map(Self)
    }
}

/// A path or a URL; never empty.
#[derive(Debug)]
struct Source(String);

impl<'de> Deserialize<'de> for Source {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = String::deserialize(deserializer)?;
        if text.is_empty() {
            Err(D::Error::custom("expected a path or a URL, got an empty string"))
        } else {
            Ok(Self(text))
        }
    }
}

impl ScenesField {
    /// Converts the scenes; paths are relative to `folder`.
    pub fn into_setups(self, folder: &Path) -> Vec<SceneSetup> {
        let setup = |(name, Source(source)): (String, Source)| SceneSetup {
            name,
            source: if fetch::is_remote(&source) { source } else { folder.join(source).display().to_string() },
        };
        self.0.into_iter().map(setup).collect()
    }
}

/// Converts the views of a file; they refer to scenes by name and to windows by index.
pub(super) fn view_setups(
    views: Vec<Object<ViewFields>>,
    scenes: &[SceneSetup],
    window_count: usize,
) -> Result<Vec<ViewSetup>, Invalid> {
    let convert = |(index, Object(fields)): (usize, Object<ViewFields>)| {
        fields.into_setup(&format!("views[{index}]"), scenes, window_count)
    };
    views.into_iter().enumerate().map(convert).collect()
}

impl ViewFields {
    fn into_setup(self, path: &str, scenes: &[SceneSetup], window_count: usize) -> Result<ViewSetup, Invalid> {
        let from = self.from();
        let scene = match self.scene {
            None => None,
            Some(name) => match scenes.iter().position(|scene| scene.name == name) {
                Some(index) => Some(index),
                None => return Invalid::err(format!("{path}.scene"), format!("`{name}` is not a name in `scenes`")),
            },
        };
        let cameras = match self.cameras {
            None => vec![ViewCamera::default()],
            Some(Entries(cameras)) => {
                let convert = |(index, Object(fields)): (usize, Object<CameraFields>)| {
                    view_camera(fields, &format!("{path}.cameras[{index}]"), index == 0, window_count)
                };
                cameras.into_iter().enumerate().map(convert).collect::<Result<_, _>>()?
            }
        };
        Ok(ViewSetup { scene, from, background: self.background.map(|color| color.values.map(|v| v as u8)), cameras })
    }

    /// Returns the starting pose; `None` when no field of it is given.
    fn from(&self) -> Option<ViewFrom> {
        if self.heading_deg.is_none() && self.pitch_deg.is_none() && self.range_m.is_none() {
            return None;
        }
        let default = ViewFrom::default();
        Some(ViewFrom {
            heading: self.heading_deg.as_ref().map_or(default.heading, |heading| heading.value.to_radians()),
            pitch: self.pitch_deg.as_ref().map_or(default.pitch, |pitch| pitch.value.to_radians()),
            range_m: self.range_m.as_ref().map(|range| range.value),
        })
    }
}

fn view_camera(fields: CameraFields, path: &str, is_master: bool, window_count: usize) -> Result<ViewCamera, Invalid> {
    let window = fields.window.as_ref().map_or(0, |window| window.value as usize);
    if window >= window_count {
        return Invalid::err(
            format!("{path}.window"),
            format!("there is no window {window}: there are {window_count} windows, counted from 0"),
        );
    }
    Ok(ViewCamera { window, camera: fields.into_setup(path, is_master)? })
}

#[cfg(test)]
mod tests {
    use glam::DMat4;

    use super::*;
    use crate::viewer::ArrangementError;
    use crate::viewer::config::{Arrangement, CameraSetup, ViewsSetup, WindowSetup};
    use crate::viewer::view::viewport::ViewArea;

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
        assert_eq!((master.window, master.camera.viewport), (1, ViewArea::Pixels([1, 2, 3, 4])));
        assert_eq!((slave.window, slave.camera.viewport), (0, ViewArea::Whole));
        assert_ne!(slave.camera.projection_offset, DMat4::IDENTITY);
        assert_eq!(CameraSetup { eyes: master.camera.eyes, ..CameraSetup::default() }.eyes, master.camera.eyes);
    }

    #[test]
    fn errors_name_the_field_and_the_reason() {
        for (text, field, says) in [
            (r#"{"views": []}"#, "views", "list of 1"),
            (r#"{"views": {}}"#, "views", "list of 1"),
            (r#"{"views": [3]}"#, "views[0]", "expected an object"),
            (r#"{"views": [{}, {"camera": []}]}"#, "views[1].camera", "cameras"),
            (r#"{"views": [{"scene": "a"}]}"#, "views[0].scene", "`scenes`"),
            (r#"{"views": [{"scene": 4}], "scenes": {"a": "b"}}"#, "views[0].scene", "string"),
            (r#"{"views": [{}], "scenes": ["a"]}"#, "scenes", "names and sources"),
            (r#"{"views": [{}], "scenes": {"a": 1}}"#, "scenes.a", "string"),
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
            (r#"{"views": [{}], "windows": [{"cameras": [{}]}]}"#, "windows[0].cameras", "`views`"),
            (r#"{"views": [{}], "windows": [{"size_px": 1}]}"#, "windows[0].size_px", "2 numbers"),
            (r#"{"windows": [{}], "scenes": {}}"#, "scenes", "no `views`"),
            (r#"{"windows": [{}], "share_pager": true}"#, "share_pager", "no `views`"),
            (r#"{"views": [{}], "share_pager": 1}"#, "share_pager", "boolean"),
        ] {
            let error = read(text).unwrap_err();
            assert_eq!(error.field, field, "{text}: {error}");
            assert!(error.reason.contains(says) && error.to_string().contains(field), "{text}: {error}");
        }
        // Without `windows` there is one default window.
        assert_eq!(read(r#"{"views": [{}]}"#).unwrap().windows, [WindowSetup::default()]);
    }
}
