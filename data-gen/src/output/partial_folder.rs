//! The temporary folder beside OUT in which a set is written, and its move to OUT when it is complete.
//!
//! The folder contains a marker file that its run keeps locked. The run of a folder whose marker is not locked was killed.
//! A later run continues that folder if it has the run's fingerprint, and removes it otherwise.

use std::fs::{self, File};
use std::io::{self, ErrorKind, Read as _, Write as _};
use std::path::{Path, PathBuf};

use crate::{GenError, interrupt};

/// The marker file, locked by the run that writes the folder. It is removed before the set is moved to OUT.
pub(crate) const MARKER: &str = ".terrane-gen";
/// The content of the marker, so that other files of the same name are not taken for one.
const MARKER_TEXT: &str = "terrane gen writes here\n";

/// The names of files that make a folder a set.
pub(crate) const ROOTS: [&str; 2] = ["tileset.json", "layer.json"];

/// A temporary folder beside the folder OUT of a set. Dropping it before [`Self::put_in_place`] removes it. Until then
/// [`exit_on_interrupt`](crate::exit_on_interrupt) knows it.
#[derive(Debug)]
pub struct PartialFolder {
    path: PathBuf,
    /// The marker, kept open for its lock.
    marker: Option<File>,
    is_done: bool,
}

impl PartialFolder {
    /// Creates the folder for a run with a fingerprint, or takes the one of a killed run with the same fingerprint. Removes
    /// folders of other killed runs for the same OUT. Fails if another run writes to OUT.
    pub fn beside(out: &Path, fingerprint: u64) -> Result<Self, GenError> {
        let partial = Self::create(out, fingerprint)?;
        interrupt::add(&partial.path, true);
        Ok(partial)
    }

    fn create(out: &Path, fingerprint: u64) -> Result<Self, GenError> {
        let name = out.file_name().map_or_else(|| "set".into(), |n| n.to_string_lossy().into_owned());
        let prefix = format!(".{name}.partial-");
        let own = format!("{prefix}{fingerprint:016x}");
        if let Some(parent) = out.parent() {
            fs::create_dir_all(parent).map_err(GenError::file(parent))?;
            remove_abandoned(parent, &prefix, &own).map_err(|()| GenError::Busy(out.to_path_buf()))?;
        }
        let mut path = out.with_file_name(&own);
        for k in 2.. {
            match fs::create_dir(&path) {
                Ok(()) => break,
                Err(e) if e.kind() == ErrorKind::AlreadyExists => {}
                Err(reason) => return Err(GenError::File { path, reason }),
            }
            match marker_of(&path) {
                Marker::Unlocked(marker) => {
                    let partial = Self { path, marker: Some(marker), is_done: false };
                    if partial.has_rival(&prefix) {
                        partial.keep();
                        return Err(GenError::Busy(out.to_path_buf()));
                    }
                    return Ok(partial);
                }
                Marker::Locked => return Err(GenError::Busy(out.to_path_buf())),
                // The folder belongs to another program, or its run was killed before it wrote the marker.
                Marker::None if k < 1000 => path = out.with_file_name(format!("{own}-{k}")),
                Marker::None => return Err(GenError::File { path, reason: ErrorKind::AlreadyExists.into() }),
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
        // A run that started at the same time may have created its marker before this one looked, and locked it after. Each run
        // looks again when its own marker is locked, so that two runs never both continue; both may be refused.
        if partial.has_rival(&prefix) { Err(GenError::Busy(out.to_path_buf())) } else { Ok(partial) }
    }

    /// Returns whether another run has locked a folder beside this one whose name starts with `prefix`.
    fn has_rival(&self, prefix: &str) -> bool {
        let folders = self.path.parent().and_then(|parent| fs::read_dir(parent).ok());
        folders.into_iter().flatten().flatten().any(|entry| {
            entry.file_name().to_string_lossy().starts_with(prefix)
                && entry.path() != self.path
                && matches!(marker_of(&entry.path()), Marker::Locked)
        })
    }

    /// Creates the folder for a run that no other continues. Otherwise as [`Self::beside`].
    pub fn fresh(out: &Path) -> Result<Self, GenError> {
        let since = std::time::UNIX_EPOCH.elapsed().unwrap_or_default();
        let partial = Self::create(out, (since.as_nanos() as u64) ^ (u64::from(std::process::id()) << 32))?;
        interrupt::add(&partial.path, false);
        Ok(partial)
    }

    /// Leaves the folder where it is, so that a run with the same fingerprint continues. Returns its path.
    pub fn keep(mut self) -> PathBuf {
        self.is_done = true;
        self.path.clone()
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
        interrupt::remove(&self.path);
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

/// Removes folders with an unlocked marker, except the one with the name `own`. Failures are ignored, because the new run does
/// not depend on it. Fails if a run has locked one of the folders.
fn remove_abandoned(parent: &Path, prefix: &str, own: &str) -> Result<(), ()> {
    for entry in fs::read_dir(parent).into_iter().flatten().flatten() {
        let (is_folder, name) = (entry.file_type().is_ok_and(|kind| kind.is_dir()), entry.file_name());
        if !is_folder || !name.to_string_lossy().starts_with(prefix) {
            continue;
        }
        match marker_of(&entry.path()) {
            Marker::Locked => return Err(()),
            Marker::Unlocked(_) if name != *own => {
                let _ = fs::remove_dir_all(entry.path());
            }
            Marker::Unlocked(_) | Marker::None => {}
        }
    }
    Ok(())
}

/// The marker of a folder.
enum Marker {
    /// There is none, or it is not one of ours, or files cannot be locked.
    None,
    /// A run has locked it.
    Locked,
    /// Its run was killed. This process has locked it now, until the file is dropped.
    Unlocked(File),
}

fn marker_of(folder: &Path) -> Marker {
    let at = folder.join(MARKER);
    // Links are not followed, and opening a pipe would block.
    let is_file = fs::symlink_metadata(&at).is_ok_and(|m| m.is_file());
    let Some(marker) = is_file.then(|| File::open(&at).ok()).flatten() else { return Marker::None };
    let mut text = String::new();
    let is_ours = |text: &mut String| (&marker).take(100).read_to_string(text).is_ok() && text == MARKER_TEXT;
    match marker.try_lock() {
        Ok(()) if is_ours(&mut text) => Marker::Unlocked(marker),
        Err(std::fs::TryLockError::WouldBlock) => Marker::Locked,
        Ok(()) | Err(_) => Marker::None,
    }
}

/// Moves a folder to a path that may hold an empty folder. If it does, the entries of `from` are moved into it, because
/// the folder itself may be a mount point that cannot be replaced. `tileset.json` or `layer.json` is moved last, so that an
/// incomplete set is never visible as one. On failure the moved entries are removed.
fn move_folder(from: &Path, to: &Path, rename: impl Fn(&Path, &Path) -> io::Result<()>) -> io::Result<()> {
    if !is_empty_folder(to) {
        return rename(from, to);
    }
    let mut names = fs::read_dir(from)?.map(|entry| entry.map(|e| e.file_name())).collect::<io::Result<Vec<_>>>()?;
    names.sort_by_key(|name| ROOTS.iter().any(|root| name == root));
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
        let first = PartialFolder::beside(&out, 7).unwrap();
        let mut expected = [".other.partial-999999", ".set.partial-1", ".set.partial-2", ".set.partial-3"].to_vec();
        let own = first.path().file_name().unwrap().to_str().unwrap().to_owned();
        expected.extend(["set.partial-1", &own]);
        expected.sort_unstable();
        assert_eq!(names(folder.path()), expected);
        drop(first);
        assert_eq!(names(folder.path()).len(), 5);
        // A run in this process or another one has locked a folder.
        let busy = abandoned_folder(folder.path(), ".set.partial-4");
        let lock = File::open(busy.join(MARKER)).unwrap();
        lock.lock().unwrap();
        assert!(matches!(PartialFolder::beside(&out, 7), Err(GenError::Busy(_))));
        drop(lock);
        drop(PartialFolder::beside(&out, 7).unwrap());
        assert!(!busy.exists(), "its marker is not locked any more");
    }

    #[test]
    fn of_runs_that_start_at_once_at_most_one_continues() {
        let folder = tempfile::tempdir().unwrap();
        let barrier = std::sync::Barrier::new(4);
        let mut continued = 0;
        for round in 0..100 {
            let out = folder.path().join(format!("set{round}"));
            let begin = &|fingerprint: u64| {
                barrier.wait();
                let partial = PartialFolder::beside(&out, fingerprint);
                barrier.wait();
                partial.is_ok()
            };
            let running = std::thread::scope(|scope| {
                let runs: Vec<_> = (0..4).map(|k| scope.spawn(move || begin(k))).collect();
                runs.into_iter().filter_map(|run| run.join().unwrap().then_some(())).count()
            });
            assert!(running <= 1, "{running} runs write to {}", out.display());
            continued += running;
        }
        assert!(continued > 0);
    }

    #[test]
    fn run_with_the_same_fingerprint_takes_the_folder_of_a_killed_one() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("set");
        let path = PartialFolder::beside(&out, 7).unwrap().keep();
        fs::write(path.join("done"), "tiles").unwrap();
        let second = PartialFolder::beside(&out, 7).unwrap();
        assert_eq!((second.path(), names(&path)), (&*path, vec![MARKER.into(), "done".into()]));
        assert!(matches!(PartialFolder::beside(&out, 7), Err(GenError::Busy(_))), "two writers");
        assert!(matches!(PartialFolder::beside(&out, 8), Err(GenError::Busy(_))), "two writers");
        let path = second.keep();
        let other = PartialFolder::beside(&out, 8).unwrap();
        assert!(!path.exists() && other.path() != path);
    }

    #[test]
    fn finished_set_has_no_marker() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("below/set");
        for text in ["one", "two"] {
            let partial = PartialFolder::beside(&out, 7).unwrap();
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
        let partial = PartialFolder::beside(&out, 7).unwrap();
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
        let partial = PartialFolder::beside(&out, 7).unwrap();
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
            let partial = PartialFolder::beside(&out, 7).unwrap();
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
