//! The files that the values of `--dem` and `--imagery` name: files, folders, patterns, lists and addresses.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use rayon::prelude::*;

use super::context::SourceContext;
use super::formats::{RasterOptions, is_text_raster};
use super::raster::Raster;
use crate::GenError;
use crate::store::is_remote;
use crate::web_tiles::{TileContent, is_folder_of_tiles};

/// The extensions of elevation files in folders.
const ELEVATION: &[&str] = &[
    "tif", "tiff", "hgt", "zip", "gz", "asc", "png", "exr", "pmtiles", "mbtiles", "dt0", "dt1", "dt2", "bil", "bip",
    "bsq", "flt", "xyz", "nc", "grd", "sdat", "img", "jp2", "j2k", "dem", "cub",
];
/// The extensions of imagery in folders.
const IMAGERY: &[&str] = &["tif", "tiff", "png", "jpg", "jpeg", "webp", "jp2", "j2k", "pmtiles", "mbtiles"];

/// Returns the files that paths name, in their order. A folder stands for its files with elevation or imagery by name, unless
/// it is a folder of web tiles; a file name with `*` or `?` for the files that match it; a text file for the paths in its
/// lines, relative to it. Addresses stand for themselves.
pub(crate) fn expand(paths: &[PathBuf], content: TileContent) -> Result<Vec<PathBuf>, GenError> {
    let (extensions, none) = match content {
        TileContent::Heights => (ELEVATION, "a folder without elevation files and without tiles z/x/y.png"),
        TileContent::Colors => (IMAGERY, "a folder without images and without tiles z/x/y.png, .jpg or .webp"),
    };
    let mut files = Vec::new();
    for path in paths {
        let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        if is_remote(path) {
            files.push(path.clone());
        } else if path.is_dir() && !is_folder_of_tiles(path) {
            let is_wanted = |file: &Path| {
                let extension = file.extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
                file.is_file() && extension.is_some_and(|extension| extensions.contains(&extension.as_str()))
            };
            let found = files_of(path, is_wanted)?;
            if found.is_empty() {
                return Err(GenError::invalid(path, none));
            }
            files.extend(found);
        } else if name.contains(['*', '?']) && !path.exists() {
            let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
            let is_match = |file: &Path| {
                file.file_name().is_some_and(|own| matches(name.as_bytes(), own.to_string_lossy().as_bytes()))
            };
            let found = files_of(folder, is_match)?;
            if found.is_empty() {
                return Err(GenError::invalid(path, "no file matches"));
            }
            files.extend(found);
        } else if path.extension().is_some_and(|e| e.eq_ignore_ascii_case("txt"))
            && path.is_file()
            && !(content == TileContent::Heights && is_text_raster(path)?)
        {
            let text = std::fs::read_to_string(path).map_err(GenError::file(path))?;
            let lines = text.lines().map(str::trim).filter(|line| !line.is_empty());
            let folder = path.parent().unwrap_or(Path::new(""));
            let before = files.len();
            let file = |line: &str| match is_remote(Path::new(line)) {
                true => PathBuf::from(line),
                false => folder.join(line),
            };
            files.extend(lines.map(file));
            if files.len() == before {
                return Err(GenError::invalid(path, "a list without files"));
            }
        } else {
            files.push(path.clone());
        }
    }
    Ok(files)
}

/// Opens elevation files in their order. Only their headers are read, and blocks of one file until one has a height.
pub(crate) fn open_all(
    paths: &[PathBuf],
    options: &RasterOptions,
    context: &Arc<SourceContext>,
) -> Result<Vec<Raster>, GenError> {
    let open = |path: &PathBuf| Raster::open(path, options, context);
    let rasters: Vec<Raster> = paths.par_iter().map(open).collect::<Result<_, _>>()?;
    for raster in &rasters {
        if raster.has_heights()? {
            return Ok(rasters);
        }
    }
    Err(rasters.first().map_or_else(|| GenError::Argument("--dem names no file".to_owned()), Raster::without_heights))
}

/// Replaces rasters by overviews of them, as coarse as samples at distances of `step` allow, east and north, in radians. Returns
/// their number.
pub(crate) fn use_overviews(
    rasters: &mut [Raster],
    step: [f64; 2],
    options: &RasterOptions,
    context: &Arc<SourceContext>,
) -> Result<usize, GenError> {
    let replace = |raster: &mut Raster| match raster.overview(step, options, context)? {
        Some(overview) => {
            *raster = overview;
            Ok(1)
        }
        None => Ok(0),
    };
    rasters.par_iter_mut().map(replace).sum()
}

/// Returns the entries of a folder that pass a test, by name.
fn files_of(folder: &Path, is_wanted: impl Fn(&Path) -> bool) -> Result<Vec<PathBuf>, GenError> {
    let entries = std::fs::read_dir(folder).map_err(GenError::file(folder))?;
    let mut paths: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).filter(|path| is_wanted(path)).collect();
    paths.sort();
    Ok(paths)
}

/// Returns true if a name matches a pattern, in which `*` stands for any bytes and `?` for one.
fn matches(pattern: &[u8], name: &[u8]) -> bool {
    match (pattern, name) {
        ([], []) => true,
        ([b'*', rest @ ..], _) => (0..=name.len()).any(|skipped| matches(rest, &name[skipped..])),
        ([b'?', pattern @ ..], [_, name @ ..]) => matches(pattern, name),
        ([a, pattern @ ..], [b, name @ ..]) => a == b && matches(pattern, name),
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patterns_match_names() {
        for (pattern, name, is_match) in [
            ("*.tif", "a.tif", true),
            ("*.tif", "a.tiff", false),
            ("N4?E*.hgt", "N42E001.hgt", true),
            ("N4?E*.hgt", "N52E001.hgt", false),
            ("a*b*c", "axxbyyc", true),
            ("a*b*c", "axxbyy", false),
        ] {
            assert_eq!(matches(pattern.as_bytes(), name.as_bytes()), is_match, "{pattern} {name}");
        }
    }
}
