//! The temporary folder beside OUT in which a set is written, and its move to OUT when it is complete.
//!
//! The folder contains a marker file that its run keeps locked. A later run removes folders whose marker is not locked:
//! their run was killed.

use std::fs::{self, File};
use std::io::{self, ErrorKind, Read as _, Write as _};
use std::path::{Path, PathBuf};

use crate::GenError;

/// The marker file, locked by the run that writes the folder. It is removed before the set is moved to OUT.
const MARKER: &str = ".terrane-gen";
/// The content of the marker, so that other files of the same name are not taken for one.
const MARKER_TEXT: &str = "terrane gen writes here\n";

/// A temporary folder beside the folder OUT of a set. Dropping it before [`Self::put_in_place`] removes it.
#[derive(Debug)]
pub struct PartialFolder {
    path: PathBuf,
    /// The marker, kept open for its lock.
    marker: Option<File>,
    is_done: bool,
}

impl PartialFolder {
    /// Creates the folder, and removes folders of killed runs for the same OUT.
    pub fn beside(out: &Path) -> Result<Self, GenError> {
        let name = out.file_name().map_or_else(|| "set".into(), |n| n.to_string_lossy().into_owned());
        let prefix = format!(".{name}.partial-");
        if let Some(parent) = out.parent() {
            fs::create_dir_all(parent).map_err(GenError::file(parent))?;
            remove_abandoned(parent, &prefix);
        }
        let mut path = out.with_file_name(format!("{prefix}{}", std::process::id()));
        for k in 2.. {
            match fs::create_dir(&path) {
                Ok(()) => break,
                // The folder belongs to another run in this process, or to another program.
                Err(e) if e.kind() == ErrorKind::AlreadyExists && k < 1000 => {
                    path = out.with_file_name(format!("{prefix}{}-{k}", std::process::id()));
                }
                Err(reason) => return Err(GenError::File { path, reason }),
            }
        }
        let mut partial = Self { path, marker: None, is_done: false };
        let at = partial.path.join(MARKER);
        let marker = File::options().read(true).write(true).create_new(true).open(&at).map_err(GenError::file(&at))?;
        // If files cannot be locked, the folder counts as in use forever. The text is written after locking, so that
        // another run never sees an unlocked marker with it.
        let _ = marker.lock();
        (&marker).write_all(MARKER_TEXT.as_bytes()).map_err(GenError::file(&at))?;
        partial.marker = Some(marker);
        Ok(partial)
    }

    /// Returns the path of the folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Moves the set to OUT and removes the old content of OUT. An existing folder OUT stays the same folder, because
    /// processes may have it as their working directory. On failure the new set is kept, and the error names its path.
    pub fn put_in_place(self, out: &Path) -> Result<(), GenError> {
        self.put_after(out, || empty(out))
    }

    /// Like [`Self::put_in_place`]; `remove` removes the old content of OUT.
    fn put_after(mut self, out: &Path, remove: impl FnOnce() -> io::Result<()>) -> Result<(), GenError> {
        self.is_done = true;
        let removed = if out.exists() { remove() } else { Ok(()) };
        // The marker stays until here, because removal may take long: if the run is killed before, a later run still
        // recognises the folder.
        self.marker = None;
        let at = self.path.join(MARKER);
        fs::remove_file(&at).map_err(GenError::file(&at))?;
        removed.and_then(|()| move_folder(&self.path, out, |from, to| fs::rename(from, to))).map_err(|e| {
            let reason = io::Error::new(e.kind(), format!("{e}; the new set is in {}", self.path.display()));
            GenError::File { path: out.to_path_buf(), reason }
        })
    }
}

impl Drop for PartialFolder {
    fn drop(&mut self) {
        self.marker = None;
        if !self.is_done {
            // A failure to remove the incomplete set is harmless: a later run tries again.
            let _ = fs::remove_dir_all(&self.path);
        }
    }
}

fn is_empty_folder(path: &Path) -> bool {
    fs::read_dir(path).is_ok_and(|mut entries| entries.next().is_none())
}

/// Removes the content of a folder.
fn empty(folder: &Path) -> io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let (entry, path) = entry.map(|e| (e.file_type(), e.path()))?;
        if entry?.is_dir() { fs::remove_dir_all(path)? } else { fs::remove_file(path)? }
    }
    Ok(())
}

/// Removes folders with an unlocked marker. Failures are ignored, because the new run does not depend on it.
fn remove_abandoned(parent: &Path, prefix: &str) {
    for entry in fs::read_dir(parent).into_iter().flatten().flatten() {
        let is_folder = entry.file_type().is_ok_and(|kind| kind.is_dir());
        if is_folder && entry.file_name().to_string_lossy().starts_with(prefix) && is_abandoned(&entry.path()) {
            let _ = fs::remove_dir_all(entry.path());
        }
    }
}

/// Returns true if the folder has a marker that no process has locked.
fn is_abandoned(folder: &Path) -> bool {
    let at = folder.join(MARKER);
    // Links are not followed, and opening a pipe would block.
    let is_file = fs::symlink_metadata(&at).is_ok_and(|m| m.is_file());
    let Some(mut marker) = is_file.then(|| File::open(&at).ok()).flatten() else { return false };
    let mut text = String::new();
    marker.try_lock().is_ok() && (&mut marker).take(100).read_to_string(&mut text).is_ok() && text == MARKER_TEXT
}

/// Moves a folder to a path that may hold an empty folder. If it does, the entries of `from` are moved into it, because
/// the folder itself may be a mount point that cannot be replaced. `tileset.json` is moved last, so that an incomplete
/// set is never visible as one. On failure the moved entries are removed.
fn move_folder(from: &Path, to: &Path, rename: impl Fn(&Path, &Path) -> io::Result<()>) -> io::Result<()> {
    if !is_empty_folder(to) {
        return rename(from, to);
    }
    let mut names = fs::read_dir(from)?.map(|entry| entry.map(|e| e.file_name())).collect::<io::Result<Vec<_>>>()?;
    names.sort_by_key(|name| name == "tileset.json");
    let moved = names.iter().try_for_each(|name| {
        let (from, to) = (from.join(name), to.join(name));
        // Renaming fails between file systems.
        rename(&from, &to).or_else(|_| copy(&from, &to))
    });
    if moved.is_err() {
        for name in &names {
            let path = to.join(name);
            let _ = if path.is_dir() { fs::remove_dir_all(&path) } else { fs::remove_file(&path) };
        }
        return moved;
    }
    // The set is complete at its new path; leftovers of the copy are harmless.
    let _ = fs::remove_dir_all(from);
    Ok(())
}

fn copy(from: &Path, to: &Path) -> io::Result<()> {
    if !from.is_dir() {
        return fs::copy(from, to).map(|_| ());
    }
    fs::create_dir(to)?;
    for entry in fs::read_dir(from)? {
        let name = entry?.file_name();
        copy(&from.join(&name), &to.join(&name))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let entries = fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap());
        let mut names: Vec<String> = entries.collect();
        names.sort();
        names
    }

    /// Creates the folder of a killed run: with an unlocked marker.
    fn abandoned_folder(folder: &Path, name: &str) -> PathBuf {
        let path = folder.join(name);
        fs::create_dir_all(path.join("0/0")).unwrap();
        fs::write(path.join("0/0/0.exr"), "half").unwrap();
        fs::write(path.join(MARKER), MARKER_TEXT).unwrap();
        path
    }

    #[test]
    fn only_folders_of_killed_runs_are_removed() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("set");
        abandoned_folder(folder.path(), ".set.partial-999999");
        abandoned_folder(folder.path(), ".other.partial-999999");
        abandoned_folder(folder.path(), "set.partial-1");
        let unmarked = abandoned_folder(folder.path(), ".set.partial-1");
        fs::remove_file(unmarked.join(MARKER)).unwrap();
        fs::write(abandoned_folder(folder.path(), ".set.partial-2").join(MARKER), "mine").unwrap();
        fs::write(folder.path().join(".set.partial-3"), "a file").unwrap();
        // A run in another process, and one in this process.
        let busy = abandoned_folder(folder.path(), ".set.partial-4");
        let lock = File::open(busy.join(MARKER)).unwrap();
        lock.lock().unwrap();
        let first = PartialFolder::beside(&out).unwrap();
        let second = PartialFolder::beside(&out).unwrap();
        assert_ne!(first.path(), second.path());
        let mut expected = [".other.partial-999999", ".set.partial-1", ".set.partial-2", ".set.partial-3"].to_vec();
        let own = [first.path(), second.path()].map(|p| p.file_name().unwrap().to_str().unwrap().to_owned());
        expected.extend([".set.partial-4", "set.partial-1", &own[0], &own[1]]);
        expected.sort_unstable();
        assert_eq!(names(folder.path()), expected);
        drop(lock);
        drop((first, second));
        let third = PartialFolder::beside(&out).unwrap();
        assert!(!busy.exists(), "its marker is not locked any more");
        drop(third);
        assert_eq!(names(folder.path()).len(), 5);
    }

    #[test]
    fn finished_set_has_no_marker() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("below/set");
        for text in ["one", "two"] {
            let partial = PartialFolder::beside(&out).unwrap();
            fs::write(partial.path().join("tileset.json"), text).unwrap();
            partial.put_in_place(&out).unwrap();
            assert_eq!((names(&out), names(out.parent().unwrap())), (vec!["tileset.json".into()], vec!["set".into()]));
            assert_eq!(fs::read_to_string(out.join("tileset.json")).unwrap(), text);
        }
    }

    /// Regression: the folder of a run that was killed while it removed the old set was never removed.
    #[test]
    fn marker_stays_until_the_old_set_is_removed() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("set");
        let partial = PartialFolder::beside(&out).unwrap();
        let marker = partial.path().join(MARKER);
        fs::create_dir(&out).unwrap();
        fs::write(out.join("old"), "old").unwrap();
        let removed = || {
            assert!(marker.is_file());
            empty(&out)
        };
        partial.put_after(&out, removed).unwrap();
        assert!(is_empty_folder(&out));
        // A set that cannot be moved to OUT is complete, and no later run may remove it.
        fs::write(out.join("old"), "old").unwrap();
        let partial = PartialFolder::beside(&out).unwrap();
        let path = partial.path().to_owned();
        let error = partial.put_after(&out, || Err(ErrorKind::PermissionDenied.into())).unwrap_err().to_string();
        assert!(error.contains(&*path.to_string_lossy()) && is_empty_folder(&path), "{error}");
    }

    /// Regression: after replacing the current directory, the process was in a deleted folder.
    #[cfg(unix)]
    #[test]
    fn existing_output_folder_is_kept() {
        use std::os::unix::fs::MetadataExt as _;
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("set");
        fs::create_dir(&out).unwrap();
        let number = fs::metadata(&out).unwrap().ino();
        for text in ["1", "2"] {
            let partial = PartialFolder::beside(&out).unwrap();
            fs::create_dir(partial.path().join(text)).unwrap();
            fs::write(partial.path().join("tileset.json"), text).unwrap();
            partial.put_in_place(&out).unwrap();
            assert_eq!(
                (fs::metadata(&out).unwrap().ino(), names(&out)),
                (number, vec![text.into(), "tileset.json".into()])
            );
            assert_eq!(names(folder.path()), ["set"]);
        }
    }

    /// A mount point cannot be replaced by renaming, and files cannot be renamed into another file system.
    #[test]
    fn empty_folder_that_cannot_be_replaced_is_filled() {
        let folder = tempfile::tempdir().unwrap();
        let (from, to) = (folder.path().join("from"), folder.path().join("to"));
        for is_other_device in [false, true] {
            fs::create_dir_all(from.join("0/0")).unwrap();
            fs::write(from.join("0/0/0.exr"), "heights").unwrap();
            fs::write(from.join("tileset.json"), "{}").unwrap();
            fs::create_dir(&to).unwrap();
            let rename = |a: &Path, b: &Path| match b == to || is_other_device {
                true => Err(ErrorKind::ResourceBusy.into()),
                false => fs::rename(a, b),
            };
            move_folder(&from, &to, rename).unwrap();
            assert!(!from.exists());
            assert_eq!(names(&to), ["0", "tileset.json"]);
            assert_eq!(fs::read_to_string(to.join("0/0/0.exr")).unwrap(), "heights");
            // A folder that is not empty is not changed.
            fs::create_dir_all(from.join("1")).unwrap();
            assert_eq!(move_folder(&from, &to, rename).unwrap_err().kind(), ErrorKind::ResourceBusy);
            assert_eq!((names(&to).len(), names(&from).len()), (2, 1));
            fs::remove_dir_all(&to).unwrap();
            fs::remove_dir_all(&from).unwrap();
        }
    }
}
