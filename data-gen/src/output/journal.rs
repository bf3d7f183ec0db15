//! The journal of a run: one file for each block that is complete, with its record. It lies in the folder that the run writes, so that
//! a run that was killed is continued from it.

use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use super::tile_set::write_whole;
use crate::GenError;
use crate::pyramid::{Record, TileKey};

/// The journal's folder inside the folder of the set; removed when the set is complete.
pub(crate) const JOURNAL: &str = ".terrane-gen-journal";

/// The records of the blocks that are complete. Threads share it.
pub(crate) struct Journal {
    folder: PathBuf,
}

impl Journal {
    /// Opens the journal in the folder of a set.
    pub fn new(set: &Path) -> Self {
        Self { folder: set.join(JOURNAL) }
    }

    fn path(&self, root: TileKey) -> PathBuf {
        self.folder.join(format!("{}/{}/{}", root.level, root.x, root.y))
    }

    /// Returns the record of a block; `None` if the block is not complete, or if its file is damaged.
    pub fn load(&self, root: TileKey) -> Result<Option<Record>, GenError> {
        let path = self.path(root);
        match std::fs::read(&path) {
            Ok(bytes) => Ok(Record::from_bytes(&bytes)),
            Err(e) if e.kind() == ErrorKind::NotFound => Ok(None),
            Err(reason) => Err(GenError::File { path, reason }),
        }
    }

    /// Returns the JSON of the root tile of a block that is complete.
    pub fn load_tree(&self, root: TileKey) -> Result<String, GenError> {
        let path = self.path(root).with_extension("json");
        std::fs::read_to_string(&path).map_err(GenError::file(path))
    }

    /// Stores the record of a block and the JSON of its root tile. Its tiles have been written.
    pub fn save(&self, root: TileKey, record: &Record, tree: &str) -> Result<(), GenError> {
        let path = self.path(root);
        if let Some(folder) = path.parent() {
            std::fs::create_dir_all(folder).map_err(GenError::file(folder))?;
        }
        write_whole(&path.with_extension("json"), tree.as_bytes())?;
        // The block is complete once its record is there.
        write_whole(&path, &record.to_bytes()).map(|_| ())
    }

    /// Returns true if any block is complete.
    pub fn has_blocks(&self) -> bool {
        self.folder.is_dir()
    }

    /// Removes the journal.
    pub fn remove(&self) -> Result<(), GenError> {
        match std::fs::remove_dir_all(&self.folder) {
            Err(reason) if reason.kind() != ErrorKind::NotFound => {
                Err(GenError::File { path: self.folder.clone(), reason })
            }
            _ => Ok(()),
        }
    }
}
