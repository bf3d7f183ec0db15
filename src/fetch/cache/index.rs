//! [`Index`]: sizes and last uses of all files of a cache, in the embedded store redb, so that an eviction costs what it
//! removes and not what it keeps. The thread that evicts; blocks on the disk.
//!
//! The files stay the truth, and the index only says where to look. A process opens it for one eviction at a time, so that
//! several processes take turns. It then takes up the files that were written since ([`Changes`]), and looks at each file
//! again before it is removed: a file that was used meanwhile stays. An index that is missing, broken or a week old is
//! rebuilt from the files.

use std::fs;
use std::io;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use redb::{Builder, Database, ReadableTable as _, Table, TableDefinition, WriteTransaction};

use super::changes::Changes;
use super::files::{FileId, Files, Found, INDEX};

/// The memory that the store may use for pages.
const STORE_CACHE_BYTES: usize = 32 << 20;
/// An index is rebuilt after this time, so that files are found that it misses: those of older versions, and those that were
/// written before the machine stopped.
const MAX_AGE: Duration = Duration::from_secs(7 * 24 * 3600);

/// Size and last use of each file, by [`FileId::to_bytes`].
const FILES: TableDefinition<&[u8; FileId::BYTES], (u64, u64)> = TableDefinition::new("files");
/// The files in the order of their last use: the time, big-endian, and [`FileId::to_bytes`].
const BY_USE: TableDefinition<&[u8; FileId::BYTES + 8], ()> = TableDefinition::new("by_use");
/// Numbers by name.
const NUMBERS: TableDefinition<&str, u64> = TableDefinition::new("numbers");
/// The sum of all sizes.
const BYTES: &str = "bytes";
/// The time at which the index was built, in nanoseconds since 1970. Missing until it is complete.
const BUILT: &str = "built";

/// Why an index cannot be used.
#[derive(Debug)]
pub(super) enum IndexError {
    /// The disk is full or fails, or the file is read-only or in use.
    Io(String),
    /// The file is damaged, or of another version.
    Broken(String),
}

impl<E: Into<redb::Error>> From<E> for IndexError {
    fn from(error: E) -> Self {
        let error: redb::Error = error.into();
        let text = error.to_string();
        match error {
            redb::Error::Io(e) if matches!(e.kind(), io::ErrorKind::InvalidData | io::ErrorKind::UnexpectedEof) => {
                Self::Broken(text)
            }
            redb::Error::Io(_) | redb::Error::PreviousIo | redb::Error::DatabaseAlreadyOpen => Self::Io(text),
            _ => Self::Broken(text),
        }
    }
}

/// An open index. The caller holds the lock of the cache.
pub(super) struct Index<'a> {
    files: &'a Files,
    store: Database,
}

impl<'a> Index<'a> {
    /// Opens the index, or creates an empty one.
    pub fn open(files: &'a Files) -> Result<Self, IndexError> {
        let store = Builder::new().set_cache_size(STORE_CACHE_BYTES).create(files.folder.join(INDEX))?;
        Ok(Self { files, store })
    }

    /// Takes up all changes and hands the files to `evict`, which may remove some. Rebuilds the index if it is due.
    pub fn with_files<T>(
        &self,
        evict: impl FnOnce(&mut IndexedFiles<'_>) -> Result<T, IndexError>,
    ) -> Result<T, IndexError> {
        let mut transaction = self.store.begin_write()?;
        // After a crash the store opens at once instead of checking all its pages.
        transaction.set_quick_repair(true);
        if !is_current(&transaction)? {
            rebuild(&transaction, self.files)?;
        }
        let changes = Changes::take(self.files);
        let evicted = {
            let mut files = IndexedFiles::open(self.files, &transaction)?;
            for id in changes.ids() {
                files.look_at(*id)?;
            }
            let evicted = evict(&mut files)?;
            files.store_bytes(&transaction)?;
            evicted
        };
        match transaction.commit() {
            Ok(()) => changes.discard(),
            // The files are removed all the same; the next eviction finds them missing.
            Err(e) => log::debug!("the index of the cache {} cannot be written: {e}", self.files.folder.display()),
        }
        Ok(evicted)
    }
}

fn is_current(transaction: &WriteTransaction) -> Result<bool, IndexError> {
    let numbers = transaction.open_table(NUMBERS)?;
    let built = numbers.get(BUILT)?.map(|built| UNIX_EPOCH + Duration::from_nanos(built.value()));
    // A clock that was set back makes it older than it is.
    Ok(built.and_then(|built| SystemTime::now().duration_since(built).ok()).is_some_and(|age| age < MAX_AGE))
}

/// Replaces the index by what a scan of the folder finds.
fn rebuild(transaction: &WriteTransaction, files: &Files) -> Result<(), IndexError> {
    transaction.delete_table(FILES)?;
    transaction.delete_table(BY_USE)?;
    let mut indexed = IndexedFiles {
        files,
        table: transaction.open_table(FILES)?,
        by_use: transaction.open_table(BY_USE)?,
        bytes: 0,
    };
    let mut failed = Ok(());
    files
        .scan_each(|found| {
            if failed.is_ok() {
                failed = indexed.set(found.id, Some(&found));
            }
        })
        .map_err(redb::Error::Io)?;
    failed?;
    indexed.store_bytes(transaction)?;
    transaction.open_table(NUMBERS)?.insert(BUILT, nanoseconds(SystemTime::now()))?;
    Ok(())
}

/// The files of the index in one transaction.
pub(super) struct IndexedFiles<'t> {
    files: &'t Files,
    table: Table<'t, &'static [u8; FileId::BYTES], (u64, u64)>,
    by_use: Table<'t, &'static [u8; FileId::BYTES + 8], ()>,
    bytes: u64,
}

impl<'t> IndexedFiles<'t> {
    fn open(files: &'t Files, transaction: &'t WriteTransaction) -> Result<Self, IndexError> {
        let bytes = transaction.open_table(NUMBERS)?.get(BYTES)?.map_or(0, |bytes| bytes.value());
        Ok(Self { files, table: transaction.open_table(FILES)?, by_use: transaction.open_table(BY_USE)?, bytes })
    }

    fn store_bytes(&self, transaction: &WriteTransaction) -> Result<(), IndexError> {
        transaction.open_table(NUMBERS)?.insert(BYTES, self.bytes)?;
        Ok(())
    }

    /// Returns the sum of all sizes in bytes.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Takes the least recently used file out of the index.
    pub fn take_oldest(&mut self) -> Result<Option<(FileId, SystemTime)>, IndexError> {
        let Some((time, key)) = self.by_use.pop_first()?.map(|(key, _)| split(key.value())) else { return Ok(None) };
        let id = FileId::from_bytes(&key).ok_or_else(|| IndexError::Broken("a file of an unknown kind".to_owned()))?;
        if let Some((size, _)) = self.table.remove(&key)?.map(|before| before.value()) {
            self.bytes = self.bytes.saturating_sub(size);
        }
        Ok(Some((id, UNIX_EPOCH + Duration::from_nanos(time))))
    }

    /// Takes the file as it is now into the index, or out of it if it is gone.
    pub fn look_at(&mut self, id: FileId) -> Result<(), IndexError> {
        let found = self.files.find(id);
        self.set(id, found.as_ref())
    }

    fn set(&mut self, id: FileId, found: Option<&Found>) -> Result<(), IndexError> {
        let key = id.to_bytes();
        let before = match found {
            Some(found) => self.table.insert(&key, (found.size, nanoseconds(found.modified)))?,
            None => self.table.remove(&key)?,
        };
        if let Some((size, time)) = before.map(|before| before.value()) {
            self.bytes = self.bytes.saturating_sub(size);
            self.by_use.remove(&joined(time, &key))?;
        }
        if let Some(found) = found {
            self.bytes = self.bytes.saturating_add(found.size);
            self.by_use.insert(&joined(nanoseconds(found.modified), &key), ())?;
        }
        Ok(())
    }

    /// Returns all files that the index has, for tests.
    #[cfg(test)]
    pub fn ids(&self) -> std::collections::BTreeSet<FileId> {
        let ids = self.table.iter().unwrap().map(|entry| FileId::from_bytes(entry.unwrap().0.value()).unwrap());
        ids.collect()
    }
}

fn joined(time: u64, id: &[u8; FileId::BYTES]) -> [u8; FileId::BYTES + 8] {
    let mut key = [0; FileId::BYTES + 8];
    key[..8].copy_from_slice(&time.to_be_bytes());
    key[8..].copy_from_slice(id);
    key
}

fn split(key: &[u8; FileId::BYTES + 8]) -> (u64, [u8; FileId::BYTES]) {
    let (mut time, mut id) = ([0; 8], [0; FileId::BYTES]);
    time.copy_from_slice(&key[..8]);
    id.copy_from_slice(&key[8..]);
    (u64::from_be_bytes(time), id)
}

/// Returns the nanoseconds since 1970, which 64 bits hold until the year 2554.
fn nanoseconds(time: SystemTime) -> u64 {
    time.duration_since(UNIX_EPOCH).map_or(0, |d| u64::try_from(d.as_nanos()).unwrap_or(u64::MAX))
}

impl Files {
    /// Removes the index, so that the next eviction rebuilds it.
    pub fn remove_index(&self) {
        // Fails if there is none, or if another process has it open on Windows.
        let _ = fs::remove_file(self.folder.join(INDEX));
    }
}
