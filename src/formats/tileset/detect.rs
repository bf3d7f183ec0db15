//! Recognizes tilesets by their content and by their file extension.

use crate::fetch::markup::text_and_first_byte;
use crate::fetch::{IoError, Limits, encoding, path_of};

/// Returns true for the JSON of a tileset, false for other JSON such as a glTF.
pub(crate) fn is_tileset_text(uri: &str, text: &[u8]) -> Result<bool, IoError> {
    #[derive(serde::Deserialize)]
    struct Probe {
        root: Option<serde::de::IgnoredAny>,
        #[serde(rename = "geometricError")]
        geometric_error: Option<serde::de::IgnoredAny>,
    }
    let text = &*String::from_utf8_lossy(text);
    match serde_json::from_str::<Probe>(text) {
        Ok(probe) => Ok(probe.root.is_some() || probe.geometric_error.is_some()),
        // The parser of tilesets has the better error, and reads repeated members.
        Err(_) if text.contains("\"geometricError\"") => Ok(true),
        Err(error) => Err(IoError::invalid(uri, format!("JSON: {error}"))),
    }
}

/// Returns true for the bytes of a tileset, whatever its name.
pub(crate) fn is_tileset(uri: &str, bytes: &[u8], limits: &Limits) -> bool {
    let is_text = |bytes: &[u8]| {
        let (text, first) = text_and_first_byte(bytes);
        first == Some(b'{') && is_tileset_text(uri, text).unwrap_or(false)
    };
    if bytes.starts_with(&[0x1f, 0x8b]) {
        return encoding::gunzip(uri, bytes.to_vec(), limits).is_ok_and(|bytes| is_text(&bytes));
    }
    is_text(bytes)
}

/// Returns false only if the file extension rules out a tileset.
pub(crate) fn may_be_tileset(uri: &str) -> bool {
    const OTHERS: [&str; 17] = [
        "glb", "gltf", "b3dm", "i3dm", "pnts", "cmpt", "subtree", "exr", "png", "jpg", "jpeg", "webp", "tif", "ktx2",
        "terrain", "bin", "heights",
    ];
    !has_extension(uri, &OTHERS)
}

/// Returns false only if the file extension rules out that the file refers to other files.
#[cfg(feature = "http")]
pub(crate) fn may_refer_to_files(uri: &str) -> bool {
    !has_extension(uri, &["pnts", "exr", "heights", "png", "jpg", "jpeg", "webp", "tif", "ktx2", "terrain", "bin"])
}

fn has_extension(uri: &str, extensions: &[&str]) -> bool {
    let name = path_of(uri).rsplit('/').next();
    let extension = name.and_then(|name| name.rsplit_once('.')).map(|(_, extension)| extension);
    extension.is_some_and(|extension| extensions.iter().any(|other| extension.eq_ignore_ascii_case(other)))
}
