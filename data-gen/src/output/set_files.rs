//! The files in the folder of a set.

use std::path::{Path, PathBuf};

use crate::GenError;

/// The file of a complete set that the journal is packed into.
pub(crate) const MANIFEST: &str = "manifest.zip";

/// Calls with the files of each folder below one, in the order of their names, but not with the manifest and with those whose
/// names begin with a dot.
pub(crate) fn each_folder(
    folder: &Path,
    call: &mut dyn FnMut(&[PathBuf]) -> Result<(), GenError>,
) -> Result<(), GenError> {
    let (mut files, mut folders) = (Vec::new(), Vec::new());
    for entry in std::fs::read_dir(folder).map_err(GenError::file(folder))? {
        let entry = entry.map_err(GenError::file(folder))?;
        if entry.file_name().to_string_lossy().starts_with('.') || entry.file_name() == *MANIFEST {
            continue;
        }
        let is_folder = entry.file_type().map_err(GenError::file(entry.path()))?.is_dir();
        if is_folder { folders.push(entry.path()) } else { files.push(entry.path()) }
    }
    files.sort();
    folders.sort();
    call(&files)?;
    folders.iter().try_for_each(|folder| each_folder(folder, call))
}

/// Writes a file under another name and renames it, so that a killed run leaves no part of a file under its name. Returns the
/// number of bytes.
pub(crate) fn write_whole(path: &Path, bytes: &[u8]) -> Result<u64, GenError> {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let unfinished = path.with_file_name(format!(".{name}.unfinished"));
    std::fs::write(&unfinished, bytes).map_err(GenError::file(path))?;
    std::fs::rename(&unfinished, path).map_err(GenError::file(path))?;
    Ok(bytes.len() as u64)
}
