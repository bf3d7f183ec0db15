//! The fingerprint of a run: a hash of the options that change the bytes of the set, of the sources, and of this version. Runs
//! with equal fingerprints make equal sets, so that one continues what another has begun.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::UNIX_EPOCH;

use terrane::math::random::fnv1a;

use crate::georeference::files_beside;
use crate::store::{BlockCache, is_remote, remote_versions};
use crate::virtual_raster::{MAX_DEPTH, VirtualRaster, is_virtual};
use crate::{GenArgs, GenError, RunArgs, Sharding};

/// Returns the fingerprint of a run. The sources are files: lists and patterns have been expanded.
pub(crate) fn fingerprint(args: &GenArgs) -> Result<u64, GenError> {
    let mut text = options_text(args)?;
    for (kind, paths) in [("elevation", &args.dem), ("imagery", &args.imagery)] {
        text.push_str(&format!("\n{kind}"));
        for path in paths {
            text.push_str(&source_text(path, args)?);
        }
    }
    Ok(fnv1a(text.as_bytes()))
}

/// Returns the version, the options that change the bytes of the set, and the states of the grids; not the sources.
pub(crate) fn options_text(args: &GenArgs) -> Result<String, GenError> {
    let same = GenArgs {
        out: PathBuf::new(),
        dem: Vec::new(),
        imagery: Vec::new(),
        jobs: None,
        overwrite: false,
        sharding: Sharding::default(),
        run: RunArgs { aligned: args.run.aligned, ..RunArgs::default() },
        ..args.clone()
    };
    let mut text = format!("{} {same:?}", env!("CARGO_PKG_VERSION"));
    let grids = Some(PathBuf::from(args.vertical_datum.to_string())).filter(|path| path.is_file());
    for path in grids.iter().chain(&args.datum_grid) {
        text.push_str(&source_text(path, args)?);
    }
    Ok(text)
}

/// Returns the name, the size and the time of a source and of the files that place it.
pub(crate) fn source_text(path: &Path, args: &GenArgs) -> Result<String, GenError> {
    let mut text = String::new();
    if is_remote(path) {
        let files = remote_versions(path, &files_beside(path), &args.run.allow_host)?;
        return Ok(files.iter().map(|(path, version)| format!("\n{path:?} {version}")).collect());
    }
    add_file(path, &mut text)?;
    for beside in files_beside(path) {
        add_file(&beside, &mut text)?;
    }
    add_files_of(path, &mut text, 0)?;
    Ok(text)
}

/// Adds the files of a virtual raster, which is inside of `depth` others.
fn add_files_of(path: &Path, text: &mut String, depth: usize) -> Result<(), GenError> {
    if depth == MAX_DEPTH || !path.is_file() || !is_virtual(path, b"<") {
        return Ok(());
    }
    let files = VirtualRaster::open(path, &Arc::new(BlockCache::new(0)))?.files();
    files.iter().filter(|file| !is_remote(file)).try_for_each(|file| {
        add_file(file, text)?;
        add_files_of(file, text, depth + 1)
    })
}

/// Adds the name, size and time of modification of a file, or of all files below a folder.
fn add_file(path: &Path, text: &mut String) -> Result<(), GenError> {
    let file = path.metadata().map_err(GenError::file(path))?;
    if file.is_dir() {
        let entries = std::fs::read_dir(path).map_err(GenError::file(path))?;
        let names: Result<Vec<PathBuf>, _> = entries.map(|entry| entry.map(|entry| entry.path())).collect();
        let mut names = names.map_err(GenError::file(path))?;
        names.sort();
        return names.iter().try_for_each(|name| add_file(name, text));
    }
    let changed = file.modified().map_err(GenError::file(path))?.duration_since(UNIX_EPOCH).unwrap_or_default();
    let path = path.canonicalize().map_err(GenError::file(path))?;
    text.push_str(&format!("\n{path:?} {} {}", file.len(), changed.as_nanos()));
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fingerprints_change_with_options_and_sources() {
        let folder = tempfile::tempdir().unwrap();
        let dem = folder.path().join("a.asc");
        std::fs::write(&dem, "one").unwrap();
        let args = GenArgs { dem: vec![dem.clone()], ..GenArgs::new(folder.path().join("set")) };
        let first = fingerprint(&args).unwrap();
        let run = RunArgs { memory: Some(1 << 30), update: true, ..RunArgs::default() };
        let same = GenArgs { run, jobs: Some(3), overwrite: true, out: PathBuf::from("other"), ..args.clone() };
        assert_eq!(fingerprint(&same).unwrap(), first);
        assert_ne!(fingerprint(&GenArgs { levels: Some(2), ..args.clone() }).unwrap(), first);
        std::fs::write(folder.path().join("a.wld"), "1").unwrap();
        let placed = fingerprint(&args).unwrap();
        assert_ne!(placed, first);
        std::fs::write(&dem, "other").unwrap();
        assert_ne!(fingerprint(&args).unwrap(), placed);
        std::fs::remove_file(&dem).unwrap();
        assert!(fingerprint(&args).unwrap_err().to_string().contains("a.asc"));
    }
}
