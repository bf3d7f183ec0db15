//! The folder beside OUT in which a set is made, and how it gets to OUT when it is whole.

use std::fs::{self, File};
use std::io::{self, ErrorKind, Read as _, Write as _};
use std::path::{Path, PathBuf};

use crate::GenError;

/// A file in every such folder, locked by the run that writes there, gone before the set is in place.
const MARK: &str = ".terrane-gen";
/// What the mark says, so that no other file of its name is taken for one.
const MARK_TEXT: &str = "terrane gen writes here\n";

/// A folder beside OUT, removed when it is dropped before it is whole.
pub(crate) struct Partial {
    path: PathBuf,
    /// Held open for its lock.
    mark: Option<File>,
    is_done: bool,
}

impl Partial {
    /// Makes the folder; removes those that runs for the same OUT left behind when they were ended.
    pub fn beside(out: &Path) -> Result<Self, GenError> {
        let name = out.file_name().map_or_else(|| "set".into(), |n| n.to_string_lossy().into_owned());
        let prefix = format!(".{name}.partial-");
        if let Some(parent) = out.parent() {
            fs::create_dir_all(parent).map_err(GenError::file(parent))?;
            remove_left_behind(parent, &prefix);
        }
        let mut path = out.with_file_name(format!("{prefix}{}", std::process::id()));
        for k in 2.. {
            match fs::create_dir(&path) {
                Ok(()) => break,
                // Another run's of this process, or not ours.
                Err(e) if e.kind() == ErrorKind::AlreadyExists && k < 1000 => {
                    path = out.with_file_name(format!("{prefix}{}-{k}", std::process::id()));
                }
                Err(reason) => return Err(GenError::File { path, reason }),
            }
        }
        let mut partial = Self { path, mark: None, is_done: false };
        let at = partial.path.join(MARK);
        let mark = File::options().read(true).write(true).create_new(true).open(&at).map_err(GenError::file(&at))?;
        // Where files cannot be locked the folder counts as in use for ever. The text comes after the lock.
        let _ = mark.lock();
        (&mark).write_all(MARK_TEXT.as_bytes()).map_err(GenError::file(&at))?;
        partial.mark = Some(mark);
        Ok(partial)
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Moves what was made to OUT, in place of what is in it; a folder that is there stays, with whoever is in it. Where
    /// that fails what was made stays, and the error says where.
    pub fn put_in_place(self, out: &Path) -> Result<(), GenError> {
        self.put_after(out, || empty(out))
    }

    /// As [`Self::put_in_place`], `remove` takes away what is in OUT.
    fn put_after(mut self, out: &Path, remove: impl FnOnce() -> io::Result<()>) -> Result<(), GenError> {
        self.is_done = true;
        let removed = if out.exists() { remove() } else { Ok(()) };
        // Not before: that may take long, and what ends the run leaves a folder that a later one knows for its own.
        self.mark = None;
        let at = self.path.join(MARK);
        fs::remove_file(&at).map_err(GenError::file(&at))?;
        removed.and_then(|()| move_folder(&self.path, out, |from, to| fs::rename(from, to))).map_err(|e| {
            let reason = io::Error::new(e.kind(), format!("{e}; the new set is in {}", self.path.display()));
            GenError::File { path: out.to_path_buf(), reason }
        })
    }
}

impl Drop for Partial {
    fn drop(&mut self) {
        self.mark = None;
        if !self.is_done {
            // What was written so far is of no use; a failure to remove it changes nothing.
            let _ = fs::remove_dir_all(&self.path);
        }
    }
}

fn is_empty_folder(path: &Path) -> bool {
    fs::read_dir(path).is_ok_and(|mut entries| entries.next().is_none())
}

/// Removes what is in a folder.
fn empty(folder: &Path) -> io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let (entry, path) = entry.map(|e| (e.file_type(), e.path()))?;
        if entry?.is_dir() { fs::remove_dir_all(path)? } else { fs::remove_file(path)? }
    }
    Ok(())
}

/// Removes folders with a mark that nobody holds. One that cannot be removed is no reason not to begin.
fn remove_left_behind(parent: &Path, prefix: &str) {
    for entry in fs::read_dir(parent).into_iter().flatten().flatten() {
        let is_folder = entry.file_type().is_ok_and(|kind| kind.is_dir());
        if is_folder && entry.file_name().to_string_lossy().starts_with(prefix) && is_left_behind(&entry.path()) {
            let _ = fs::remove_dir_all(entry.path());
        }
    }
}

fn is_left_behind(folder: &Path) -> bool {
    let at = folder.join(MARK);
    // Not through a link, nor from a pipe, which would be waited for.
    let is_file = fs::symlink_metadata(&at).is_ok_and(|m| m.is_file());
    let Some(mut mark) = is_file.then(|| File::open(&at).ok()).flatten() else { return false };
    let mut text = String::new();
    mark.try_lock().is_ok() && (&mut mark).take(100).read_to_string(&mut text).is_ok() && text == MARK_TEXT
}

/// Moves a folder to where an empty one may be, which need not be movable itself: then what is in `from` goes into it,
/// `tileset.json` last, so that there is no set before it is whole. What of it is there when that fails is removed.
fn move_folder(from: &Path, to: &Path, rename: impl Fn(&Path, &Path) -> io::Result<()>) -> io::Result<()> {
    if !is_empty_folder(to) {
        return rename(from, to);
    }
    let mut names = fs::read_dir(from)?.map(|entry| entry.map(|e| e.file_name())).collect::<io::Result<Vec<_>>>()?;
    names.sort_by_key(|name| name == "tileset.json");
    let moved = names.iter().try_for_each(|name| {
        let (from, to) = (from.join(name), to.join(name));
        // Another file system has to be written to.
        rename(&from, &to).or_else(|_| copy(&from, &to))
    });
    if moved.is_err() {
        for name in &names {
            let path = to.join(name);
            let _ = if path.is_dir() { fs::remove_dir_all(&path) } else { fs::remove_file(&path) };
        }
        return moved;
    }
    // It is whole where it should be; what is left of the copy does no harm.
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

    /// What a run leaves that is ended: its folder, and a mark that nobody locks.
    fn leave_behind(folder: &Path, name: &str) -> PathBuf {
        let path = folder.join(name);
        fs::create_dir_all(path.join("0/0")).unwrap();
        fs::write(path.join("0/0/0.exr"), "half").unwrap();
        fs::write(path.join(MARK), MARK_TEXT).unwrap();
        path
    }

    #[test]
    fn only_what_runs_left_behind_is_removed() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("set");
        leave_behind(folder.path(), ".set.partial-999999");
        leave_behind(folder.path(), ".other.partial-999999");
        leave_behind(folder.path(), "set.partial-1");
        let unmarked = leave_behind(folder.path(), ".set.partial-1");
        fs::remove_file(unmarked.join(MARK)).unwrap();
        fs::write(leave_behind(folder.path(), ".set.partial-2").join(MARK), "mine").unwrap();
        fs::write(folder.path().join(".set.partial-3"), "a file").unwrap();
        // Under way in another run, and in this process.
        let busy = leave_behind(folder.path(), ".set.partial-4");
        let lock = File::open(busy.join(MARK)).unwrap();
        lock.lock().unwrap();
        let first = Partial::beside(&out).unwrap();
        let second = Partial::beside(&out).unwrap();
        assert_ne!(first.path(), second.path());
        let mut expected = [".other.partial-999999", ".set.partial-1", ".set.partial-2", ".set.partial-3"].to_vec();
        let own = [first.path(), second.path()].map(|p| p.file_name().unwrap().to_str().unwrap().to_owned());
        expected.extend([".set.partial-4", "set.partial-1", &own[0], &own[1]]);
        expected.sort_unstable();
        assert_eq!(names(folder.path()), expected);
        drop(lock);
        drop((first, second));
        let third = Partial::beside(&out).unwrap();
        assert!(!busy.exists(), "nobody writes there any more");
        drop(third);
        assert_eq!(names(folder.path()).len(), 5);
    }

    #[test]
    fn what_is_in_place_has_no_mark() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("below/set");
        for text in ["one", "two"] {
            let partial = Partial::beside(&out).unwrap();
            fs::write(partial.path().join("tileset.json"), text).unwrap();
            partial.put_in_place(&out).unwrap();
            assert_eq!((names(&out), names(out.parent().unwrap())), (vec!["tileset.json".into()], vec!["set".into()]));
            assert_eq!(fs::read_to_string(out.join("tileset.json")).unwrap(), text);
        }
    }

    /// A run that was ended while it removed the old set left its own for good.
    #[test]
    fn the_mark_stays_until_the_old_set_is_gone() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("set");
        let partial = Partial::beside(&out).unwrap();
        let mark = partial.path().join(MARK);
        fs::create_dir(&out).unwrap();
        fs::write(out.join("old"), "old").unwrap();
        let removed = || {
            assert!(mark.is_file());
            empty(&out)
        };
        partial.put_after(&out, removed).unwrap();
        assert!(is_empty_folder(&out));
        // What cannot be put in its place is whole, and nobody's to remove.
        fs::write(out.join("old"), "old").unwrap();
        let partial = Partial::beside(&out).unwrap();
        let path = partial.path().to_owned();
        let error = partial.put_after(&out, || Err(ErrorKind::PermissionDenied.into())).unwrap_err().to_string();
        assert!(error.contains(&*path.to_string_lossy()) && is_empty_folder(&path), "{error}");
    }

    /// Who made a set in the folder he was in was in none any more.
    #[cfg(unix)]
    #[test]
    fn a_folder_that_is_there_stays() {
        use std::os::unix::fs::MetadataExt as _;
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("set");
        fs::create_dir(&out).unwrap();
        let number = fs::metadata(&out).unwrap().ino();
        for text in ["1", "2"] {
            let partial = Partial::beside(&out).unwrap();
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

    /// A mount point cannot be renamed over, nor anything be renamed into another file system.
    #[test]
    fn an_empty_folder_that_stays_is_filled() {
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
            // What is not empty stays as it is.
            fs::create_dir_all(from.join("1")).unwrap();
            assert_eq!(move_folder(&from, &to, rename).unwrap_err().kind(), ErrorKind::ResourceBusy);
            assert_eq!((names(&to).len(), names(&from).len()), (2, 1));
            fs::remove_dir_all(&to).unwrap();
            fs::remove_dir_all(&from).unwrap();
        }
    }
}
