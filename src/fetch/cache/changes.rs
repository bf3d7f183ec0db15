//! [`Changes`]: the files that were written or removed since the index was last updated. Any thread; blocks on the
//! disk.
//!
//! Each process appends the names of files to a separate list, without waiting for others and without a transaction. The
//! process that evicts takes all lists, and looks at the files that they name. A list that is lost, or a name that another
//! process appends at the very moment in which its list is taken, is made up for when the index is rebuilt.

use std::collections::BTreeSet;
use std::fs;
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};

use super::files::{CHANGES, FileId, Files, process_number, read_at_most, read_dir};

/// The lists of changes are read up to this size together; the rest waits for the next eviction.
const MAX_BYTES: u64 = 256 << 20;
/// The extension of lists that were taken.
const TAKEN: &str = "taken";

/// Appends files to the list of this process.
pub(super) fn append(files: &Files, ids: &[FileId]) -> io::Result<()> {
    let folder = files.folder.join(CHANGES);
    let path = folder.join(format!("{:016x}", process_number()));
    let bytes: Vec<u8> = ids.iter().flat_map(|id| id.to_bytes()).collect();
    let open = || fs::File::options().append(true).create(true).open(&path);
    let mut list = match open() {
        Err(e) if e.kind() == io::ErrorKind::NotFound => {
            fs::create_dir_all(&folder)?;
            open()?
        }
        opened => opened?,
    };
    // One call, so that lists of several threads are not mixed within a name.
    list.write_all(&bytes)
}

/// The changes that one eviction takes up.
pub(super) struct Changes {
    ids: BTreeSet<FileId>,
    lists: Vec<PathBuf>,
}

impl Changes {
    /// Returns true if there are lists that no eviction has taken.
    pub fn are_waiting(files: &Files) -> bool {
        read_dir(&files.folder.join(CHANGES)).is_ok_and(|lists| !lists.iter().all(|path| is_taken(path)))
    }

    /// Takes the lists of all processes. The caller holds the lock of the cache.
    pub fn take(files: &Files) -> Self {
        let mut changes = Self { ids: BTreeSet::new(), lists: Vec::new() };
        let mut bytes_left = MAX_BYTES;
        for path in read_dir(&files.folder.join(CHANGES)).unwrap_or_default() {
            // Lists that an eviction has taken and not finished are taken as they are.
            let is_taken = is_taken(&path);
            let taken = match is_taken {
                true => path.clone(),
                false => path.with_extension(format!("{}.{TAKEN}", files.temporary_name())),
            };
            if !is_taken && fs::rename(&path, &taken).is_err() {
                continue;
            }
            let Ok(bytes) = read_at_most(&taken, bytes_left) else { continue };
            if bytes.len() as u64 > bytes_left {
                continue;
            }
            bytes_left -= bytes.len() as u64;
            // A name that a crash has cut off is left out.
            changes.ids.extend(bytes.as_chunks::<{ FileId::BYTES }>().0.iter().filter_map(FileId::from_bytes));
            changes.lists.push(taken);
        }
        changes
    }

    pub fn ids(&self) -> &BTreeSet<FileId> {
        &self.ids
    }

    /// Removes the lists, once the index has their changes.
    pub fn discard(self) {
        for list in self.lists {
            let _ = fs::remove_file(list);
        }
    }
}

fn is_taken(list: &Path) -> bool {
    list.extension().is_some_and(|extension| extension == TAKEN)
}
