//! [`OldSet`]: the set that an update takes tiles from, in a folder or in a bucket.

use std::io::{ErrorKind, Read as _, Seek as _, SeekFrom};
use std::path::{Path, PathBuf};

use flate2::read::GzDecoder;

use crate::GenError;
use crate::output::{Journal, ROOTS, write_whole};

/// The first bytes of gzip.
const GZIP_MAGIC: [u8; 2] = [0x1f, 0x8b];
/// A tile that is compressed is not larger.
const MAX_TILE_BYTES: u64 = 1 << 30;

/// A complete set. Threads share it.
pub(crate) trait OldSet: Sync {
    /// Returns the name of the set for people.
    fn name(&self) -> String;

    /// Returns true if there is a set.
    fn exists(&self) -> bool;

    /// Opens the journal of the set.
    fn journal(&self) -> Journal;

    /// Returns the size of a file as it is stored; `None` if it is missing.
    fn size(&self, name: &str) -> Option<u64>;

    /// Returns the size of a file before `--gzip` compresses it; `None` if it is not known without reading the file.
    fn plain_size(&self, name: &str, size: u64) -> Result<Option<u64>, GenError>;

    /// Makes a file a part of the new set in a folder.
    fn keep(&self, name: &str, folder: &Path) -> Result<(), GenError>;

    /// Returns the content of a file as it is stored.
    fn read(&self, name: &str) -> Result<Vec<u8>, GenError>;

    /// Puts the content of a file into a folder, as it is without `--gzip`.
    fn copy_plain(&self, name: &str, folder: &Path) -> Result<(), GenError> {
        write_plain(name, self.read(name)?, folder)
    }
}

/// Writes the content of a file into a folder, decompressed.
fn write_plain(name: &str, mut content: Vec<u8>, folder: &Path) -> Result<(), GenError> {
    if content.starts_with(&GZIP_MAGIC) {
        let mut plain = Vec::new();
        let read = GzDecoder::new(&*content).take(MAX_TILE_BYTES).read_to_end(&mut plain);
        read.map_err(GenError::file(Path::new(name)))?;
        content = plain;
    }
    let to = folder.join(name);
    make_folder_of(&to)?;
    write_whole(&to, &content).map(|_| ())
}

/// A set in a folder.
pub(crate) struct LocalSet(pub PathBuf);

impl OldSet for LocalSet {
    fn name(&self) -> String {
        self.0.display().to_string()
    }

    fn exists(&self) -> bool {
        ROOTS.iter().any(|root| self.0.join(root).is_file())
    }

    fn journal(&self) -> Journal {
        Journal::new(&self.0)
    }

    fn size(&self, name: &str) -> Option<u64> {
        let file = self.0.join(name).symlink_metadata().ok()?;
        file.is_file().then_some(file.len())
    }

    /// A compressed file ends with it.
    fn plain_size(&self, name: &str, size: u64) -> Result<Option<u64>, GenError> {
        if size < 20 {
            return Ok(Some(size));
        }
        let path = self.0.join(name);
        let read = || {
            let mut file = std::fs::File::open(&path)?;
            let (mut magic, mut end) = ([0; 2], [0; 4]);
            file.read_exact(&mut magic)?;
            file.seek(SeekFrom::End(-4))?;
            file.read_exact(&mut end)?;
            Ok(if magic == GZIP_MAGIC { u32::from_le_bytes(end).into() } else { size })
        };
        read().map(Some).map_err(GenError::file(&path))
    }

    /// Links the file, or copies it.
    fn keep(&self, name: &str, folder: &Path) -> Result<(), GenError> {
        let (from, to) = (self.0.join(name), folder.join(name));
        make_folder_of(&to)?;
        match std::fs::hard_link(&from, &to) {
            Ok(()) => Ok(()),
            // A killed run has linked it.
            Err(e) if e.kind() == ErrorKind::AlreadyExists => Ok(()),
            Err(_) => {
                let content = std::fs::read(&from).map_err(GenError::file(&from))?;
                write_whole(&to, &content).map(|_| ())
            }
        }
    }

    fn read(&self, name: &str) -> Result<Vec<u8>, GenError> {
        let path = self.0.join(name);
        std::fs::read(&path).map_err(GenError::file(&path))
    }

    /// Links the file unless it is compressed.
    fn copy_plain(&self, name: &str, folder: &Path) -> Result<(), GenError> {
        let size = self.size(name).unwrap_or(0);
        match self.plain_size(name, size)? {
            Some(plain) if plain == size => self.keep(name, folder),
            _ => write_plain(name, self.read(name)?, folder),
        }
    }
}

fn make_folder_of(file: &Path) -> Result<(), GenError> {
    let Some(folder) = file.parent() else { return Ok(()) };
    std::fs::create_dir_all(folder).map_err(GenError::file(folder))
}
