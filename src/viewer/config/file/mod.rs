//! Configuration files of windows and views, in JSON. Read on the main thread before windows open.
//!
//! ```json
//! { "windows": [
//!     { "title": "ahead", "position_px": [640, 0], "size_px": [640, 480], "screen": 0,
//!       "full_screen": false, "decorated": true, "samples": 4, "vsync": true },
//!     { "position_px": [0, 0], "size_px": [640, 480], "shares_device": true,
//!       "cameras": [ { "viewport_px": [0, 0, 640, 480], "turn_deg": [-40, 0, 0] } ] } ] }
//! ```
//!
//! `windows` is the only required field. The fields of a window are those of
//! [`WindowSetup`](crate::viewer::WindowSetup); every one may be left out. The fields of a camera:
//!
//! | field | meaning |
//! |---|---|
//! | `viewport_px` | x, y, width and height in pixels from the window's upper left corner |
//! | `viewport` | the same as fractions of the window, 0 to 1, which follow its size |
//! | `resize` | the angle of view that follows the image's shape: "HORIZONTAL", "VERTICAL" or "FIXED"; master only |
//! | `turn_deg` | rotation from the master: to the right, upwards, clockwise |
//! | `move_m` | offset from the master's eye: to the right, upwards, backwards |
//! | `shift` | offset in the master's image plane, in image widths to the right and image heights upwards |
//! | `zoom` | magnification, horizontal and vertical |
//! | `eyes` | the eyes it draws for in stereo: "BOTH", "LEFT", "RIGHT" or "MIDDLE" |
//!
//! The first camera of the first window is the master. It accepts `viewport_px`, `viewport`, `resize` and `eyes`.
//!
//! A file may describe several views instead:
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
//!
//! The windows then have no `cameras`: the cameras of the views draw into them, in the order of the views. Every field of
//! a view may be left out:
//!
//! | field | meaning | default |
//! |---|---|---|
//! | `scene` | a name from `scenes` | the tile set that the program was started with |
//! | `cameras` | as above, with `window` counted from 0; the first is the view's master | one that fills the first window |
//! | `heading_deg`, `pitch_deg`, `range_m` | the starting pose, from the middle of the set | the default view of the set |
//! | `background` | an sRGB colour instead of sky and haze | sky and haze |
//!
//! `scenes` maps names to sources as on the command line; paths are relative to the file's folder. With `share_pager` one
//! pager with one budget loads all scenes.

mod values;
mod views;
mod windows;

use std::path::Path;

use serde::Deserialize;

use self::values::{Entries, Invalid, Object, present};
use self::views::{ScenesField, ViewFields};
use self::windows::WindowFields;
use super::arrangement::Arrangement;
use super::view_setup::ViewsSetup;
use super::window_setup::WindowSetup;
use crate::viewer::ArrangementError;

/// The size above which a file is refused, bytes.
const MAX_FILE_BYTES: u64 = 1 << 20;

/// The fields of the whole file.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct FileFields {
    #[serde(default, deserialize_with = "present")]
    windows: Option<Entries<Object<WindowFields>>>,
    #[serde(default, deserialize_with = "present")]
    scenes: Option<ScenesField>,
    #[serde(default, deserialize_with = "present")]
    share_pager: Option<bool>,
    #[serde(default, deserialize_with = "present")]
    views: Option<Entries<Object<ViewFields>>>,
}

/// Reads a configuration file; errors name the file and the field.
pub(super) fn read(file: &Path) -> Result<Arrangement, ArrangementError> {
    let folder = file.parent().unwrap_or(Path::new(""));
    let arrangement = read_bytes(file)
        .map_err(|reason| Invalid { field: String::new(), reason })
        .and_then(|bytes| parse(&bytes))
        .and_then(|fields| arrangement(fields, folder));
    arrangement.map_err(|Invalid { field, reason }| ArrangementError {
        source_name: file.display().to_string(),
        field,
        reason,
    })
}

fn read_bytes(file: &Path) -> Result<Vec<u8>, String> {
    let size = std::fs::metadata(file).map_err(|e| e.to_string())?.len();
    if size > MAX_FILE_BYTES {
        return Err(format!("the file has {size} bytes; at most {MAX_FILE_BYTES} are allowed"));
    }
    std::fs::read(file).map_err(|e| e.to_string())
}

fn parse(bytes: &[u8]) -> Result<FileFields, Invalid> {
    let mut json = serde_json::Deserializer::from_slice(bytes);
    let Object(fields) = serde_path_to_error::deserialize(&mut json).map_err(|error| {
        let field = error.path().to_string();
        match error.into_inner() {
            // The path "." is the whole file.
            error if error.is_data() => {
                Invalid { field: field.trim_matches('.').to_owned(), reason: error.to_string() }
            }
            error => Invalid { field: String::new(), reason: format!("invalid JSON: {error}") },
        }
    })?;
    json.end().map_err(|error| Invalid { field: String::new(), reason: format!("invalid JSON: {error}") })?;
    Ok(fields)
}

/// Converts the fields, and checks those that depend on each other. `folder` is the file's folder.
fn arrangement(fields: FileFields, folder: &Path) -> Result<Arrangement, Invalid> {
    let FileFields { windows, scenes, share_pager, views } = fields;
    let windows = match windows {
        Some(Entries(windows)) => windows::window_setups(windows, views.is_some())?,
        None if views.is_some() => vec![WindowSetup::default()],
        None => return Invalid::err("", "the field `windows` is missing"),
    };
    let Some(Entries(views)) = views else {
        return match (scenes, share_pager) {
            (_, Some(_)) => Invalid::err("share_pager", "there are no `views` whose scenes could share a pager"),
            (Some(_), None) => Invalid::err("scenes", "there are no `views` to show them"),
            (None, None) => Ok(Arrangement::Windows(windows)),
        };
    };
    let scenes = scenes.map(|scenes| scenes.into_setups(folder)).unwrap_or_default();
    let views = views::view_setups(views, &scenes, windows.len())?;
    Ok(Arrangement::Views(ViewsSetup { windows, scenes, share_pager: share_pager.unwrap_or(false), views }))
}
