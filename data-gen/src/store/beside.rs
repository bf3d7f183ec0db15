//! The files beside a source, on the same disk or server: world files, reference systems, metadata, masks and overviews.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::cache::BlockCache;
use super::remote::{RemoteBytes, is_remote};
use crate::GenError;

/// The largest file whose text is read.
const MAX_TEXT_BYTES: u64 = 64 << 20;

/// Returns the names of a file beside another, with another extension in place of its own. On disks the file that exists is
/// returned, also with an extension in capitals.
pub(crate) fn with_extension(path: &Path, extension: &str) -> PathBuf {
    renamed(path, |name| match name.rfind('.') {
        Some(dot) if !name[dot..].contains(['/', '\\']) => format!("{}.{extension}", &name[..dot]),
        _ => format!("{name}.{extension}"),
    })
}

/// Like [`with_extension`], with one more extension.
pub(crate) fn with_more(path: &Path, extension: &str) -> PathBuf {
    renamed(path, |name| format!("{name}.{extension}"))
}

fn renamed(path: &Path, rename: impl Fn(&str) -> String) -> PathBuf {
    if is_remote(path) {
        let address = path.to_string_lossy();
        let (name, query) = address.split_at(address.find(['?', '#']).unwrap_or(address.len()));
        return PathBuf::from(rename(name) + query);
    }
    let Some(name) = path.file_name().and_then(|name| name.to_str()) else { return path.with_extension("none") };
    let usual = path.with_file_name(rename(name));
    let own = usual.extension().map(|e| e.to_string_lossy().to_ascii_uppercase()).unwrap_or_default();
    let capitals = usual.with_extension(own);
    if !usual.exists() && capitals.exists() { capitals } else { usual }
}

/// Returns the text of a file; `None` if it is missing, or larger than such a file can be. `is_wanted` is shown the first
/// bytes, since some servers answer with a page of theirs.
pub(crate) fn text_of(
    path: &Path,
    cache: &Arc<BlockCache>,
    is_wanted: impl Fn(&[u8]) -> bool,
) -> Result<Option<String>, GenError> {
    let bytes = if is_remote(path) {
        let Some(file) = RemoteBytes::open_if_present(path, cache)? else { return Ok(None) };
        if file.size() > MAX_TEXT_BYTES || !is_wanted(file.head()) {
            return Ok(None);
        }
        file.read(0, file.size() as usize)?
    } else {
        let is_text = path.metadata().is_ok_and(|found| found.is_file() && found.len() <= MAX_TEXT_BYTES);
        if !is_text {
            return Ok(None);
        }
        let bytes = std::fs::read(path).map_err(GenError::file(path))?;
        if !is_wanted(&bytes) {
            return Ok(None);
        }
        bytes
    };
    Ok(Some(String::from_utf8_lossy(&bytes).trim_start_matches('\u{feff}').to_owned()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_keep_the_query_of_an_address() {
        let beside = |path: &str| [with_extension(Path::new(path), "tfw"), with_more(Path::new(path), "ovr")];
        let names = |names: [&str; 2]| names.map(PathBuf::from);
        assert_eq!(beside("a/b.c/d.tif"), names(["a/b.c/d.tfw", "a/b.c/d.tif.ovr"]));
        assert_eq!(beside("a/b.c/d"), names(["a/b.c/d.tfw", "a/b.c/d.ovr"]));
        let address = "https://example.com/b.c/d.tif?key=1.5";
        let expected = ["https://example.com/b.c/d.tfw?key=1.5", "https://example.com/b.c/d.tif.ovr?key=1.5"];
        assert_eq!(beside(address), names(expected));
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("A.TFW"), "").unwrap();
        assert_eq!(with_extension(&folder.path().join("A.TIF"), "tfw"), folder.path().join("A.TFW"));
    }
}
