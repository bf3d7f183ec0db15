//! Files of the cache: names by hash, and atomic writes. Any thread; several processes may share the folder.

use std::collections::hash_map::RandomState;
use std::fs;
use std::hash::BuildHasher as _;
use std::io::{self, Read as _, Write as _};
use std::path::{Path, PathBuf};
use std::sync::LazyLock;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, SystemTime};

use ring::digest;
use ring::rand::{SecureRandom as _, SystemRandom};

/// A SHA-256 hash.
pub(super) type Hash = [u8; 32];

/// The file that marks a folder as a cache.
pub(super) const MARKER: &str = "terrane-cache";
/// The file that the evicting process locks.
pub(super) const LOCK: &str = "lock";
/// The file with the size limit in bytes.
const LIMIT: &str = "limit";
/// The file with the secret of keyed hashes.
const SECRET: &str = "secret";
/// The file with the index.
pub(super) const INDEX: &str = "index.redb";
/// The folder with the lists of files that the index does not have yet.
pub(super) const CHANGES: &str = "changes";
const MARKER_TEXT: &[u8] = b"terrane cache 1\n";
/// Temporary files older than this are left by processes that were killed, and are removed.
const TEMPORARY_AGE: Duration = Duration::from_secs(3600);
/// The largest difference between the clocks of machines that share a folder.
const CLOCK_DRIFT: Duration = Duration::from_secs(180);

pub(super) fn hash(bytes: &[u8]) -> Hash {
    let mut out = Hash::default();
    out.copy_from_slice(digest::digest(&digest::SHA256, bytes).as_ref());
    out
}

pub(super) fn hex(hash: &Hash) -> String {
    use std::fmt::Write as _;
    hash.iter().fold(String::with_capacity(64), |mut text, byte| {
        // Writing to a String cannot fail.
        let _ = write!(text, "{byte:02x}");
        text
    })
}

pub(super) fn unhex(text: &str) -> Option<Hash> {
    let digits = text.as_bytes();
    if digits.len() != 64 {
        return None;
    }
    let digit = |b: u8| char::from(b).to_digit(16).filter(|_| !b.is_ascii_uppercase());
    let mut hash = Hash::default();
    for (byte, pair) in hash.iter_mut().zip(digits.chunks_exact(2)) {
        let &[high, low] = pair else { return None };
        *byte = (digit(high)? * 16 + digit(low)?) as u8;
    }
    Some(hash)
}

/// Returns a number that no other process has; on several machines processes may have the same process id.
pub(super) fn process_number() -> u64 {
    static PROCESS: LazyLock<u64> = LazyLock::new(|| RandomState::new().hash_one(std::process::id()));
    *PROCESS
}

/// The kind of content that a file of the cache has.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Kind {
    /// The entry of a URI.
    Key,
    /// A body.
    Blob,
}

impl Kind {
    fn folder(self) -> &'static str {
        match self {
            Self::Key => "keys",
            Self::Blob => "blobs",
        }
    }
}

/// Names a file of the cache. Of files of the same age, entries are removed before bodies.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct FileId {
    pub kind: Kind,
    pub hash: Hash,
}

impl FileId {
    /// The size of [`Self::to_bytes`].
    pub const BYTES: usize = 33;

    pub fn key(hash: Hash) -> Self {
        Self { kind: Kind::Key, hash }
    }

    pub fn blob(hash: Hash) -> Self {
        Self { kind: Kind::Blob, hash }
    }

    /// Returns bytes in the order of the names.
    pub fn to_bytes(self) -> [u8; Self::BYTES] {
        let mut bytes = [0; Self::BYTES];
        bytes[0] = u8::from(self.kind == Kind::Blob);
        bytes[1..].copy_from_slice(&self.hash);
        bytes
    }

    /// Parses the result of [`Self::to_bytes`].
    pub fn from_bytes(bytes: &[u8; Self::BYTES]) -> Option<Self> {
        let kind = match bytes[0] {
            0 => Kind::Key,
            1 => Kind::Blob,
            _ => return None,
        };
        let mut hash = Hash::default();
        hash.copy_from_slice(&bytes[1..]);
        Some(Self { kind, hash })
    }
}

/// The folder of a cache.
#[derive(Clone, Debug)]
pub(super) struct Files {
    pub folder: PathBuf,
}

/// A file of the cache that exists.
#[derive(Clone, Debug)]
pub(super) struct Found {
    pub id: FileId,
    pub path: PathBuf,
    pub size: u64,
    /// The last use, or the epoch if the file's time is unknown or in the future and so tells nothing about its use.
    pub modified: SystemTime,
}

impl Files {
    /// Opens a cache folder, or creates one at a path that is empty or does not exist. Fails for a folder with other files,
    /// since a cache may delete everything in its folder.
    pub fn open(folder: &Path) -> io::Result<Self> {
        let files = Self { folder: folder.to_path_buf() };
        let marker = folder.join(MARKER);
        match fs::read(&marker) {
            Ok(text) if text == MARKER_TEXT => return Ok(files),
            // A crash of the machine may leave the file empty.
            Ok(text) if text.is_empty() => {}
            Ok(_) => return Err(io::Error::other("is the cache of another version")),
            Err(e) if e.kind() == io::ErrorKind::NotFound => {}
            Err(e) => return Err(e),
        }
        match fs::create_dir_all(folder) {
            Err(e) if is_full(&e) => return Ok(files),
            other => other?,
        }
        // Another process may be creating the same cache at this moment.
        let parts = ["tmp", "keys", "blobs", CHANGES, INDEX, LOCK, LIMIT, SECRET, MARKER];
        for found in fs::read_dir(folder)? {
            if !found?.file_name().to_str().is_some_and(|name| parts.contains(&name)) {
                return Err(io::Error::other("is not empty and no cache"));
            }
        }
        match files.write(&marker, MARKER_TEXT) {
            // On a full disk the cache starts without a marker, and writes it when the folder is opened again.
            Err(e) if is_full(&e) => {}
            other => other?,
        }
        Ok(files)
    }

    /// Stores and returns the given size limit. Without one, returns the stored limit.
    pub fn limit(&self, given: Option<u64>) -> Option<u64> {
        let file = self.folder.join(LIMIT);
        let last = || fs::read_to_string(&file).ok()?.trim().parse().ok();
        if given.is_some() && given != last() {
            // Fails for a read-only folder or a full disk; the cache works nevertheless.
            let _ = self.write(&file, format!("{}\n", given.unwrap_or_default()).as_bytes());
        }
        given.or_else(last)
    }

    /// Returns the secret of this cache, which the first process that needs it makes at random. A process that can neither read
    /// nor write it uses a separate one. It then finds no entry of another process whose key depends on the secret.
    pub fn secret(&self) -> Hash {
        let (file, temporary) = (self.folder.join(SECRET), self.temporary());
        let read = || Hash::try_from(read_at_most(&file, 32).ok()?).ok();
        if let Some(secret) = read() {
            return secret;
        }
        let mut secret = Hash::default();
        if SystemRandom::new().fill(&mut secret).is_err() {
            // A secret that others can guess is at least not stored.
            log::error!("the system gives no random numbers for the secret of the cache {}", self.folder.display());
            return secret;
        }
        let written = write_new(&temporary, &secret).and_then(|()| {
            set_private(&temporary)?;
            // Unlike a rename, a link never replaces the secret of another process. A file that is no secret is replaced.
            match fs::hard_link(&temporary, &file) {
                Err(e) if e.kind() == io::ErrorKind::AlreadyExists && read().is_some() => Ok(()),
                Err(_) => fs::rename(&temporary, &file),
                linked => linked,
            }
        });
        let _ = fs::remove_file(&temporary);
        if let Err(e) = written {
            log::debug!("cache {}: its secret cannot be written: {e}", self.folder.display());
        }
        read().unwrap_or(secret)
    }

    pub fn key(&self, hash: &Hash) -> PathBuf {
        self.path(FileId::key(*hash))
    }

    pub fn blob(&self, hash: &Hash) -> PathBuf {
        self.path(FileId::blob(*hash))
    }

    pub fn path(&self, id: FileId) -> PathBuf {
        let name = hex(&id.hash);
        self.folder.join(id.kind.folder()).join(&name[..2]).join(name)
    }

    /// Returns a name that no other process and no other call uses.
    pub fn temporary_name(&self) -> String {
        static NUMBER: AtomicU64 = AtomicU64::new(0);
        format!("{:016x}-{}", process_number(), NUMBER.fetch_add(1, Ordering::Relaxed))
    }

    fn temporary(&self) -> PathBuf {
        self.folder.join("tmp").join(self.temporary_name())
    }

    /// Writes a file atomically: a reader finds the old content, the new content, or no file.
    pub fn write(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        let temporary = self.temporary();
        let written = write_new(&temporary, bytes).and_then(|()| match fs::rename(&temporary, path) {
            Err(e) if e.kind() == io::ErrorKind::NotFound => {
                let parent = path.parent().unwrap_or(&self.folder);
                fs::create_dir_all(parent)?;
                fs::rename(&temporary, path)
            }
            // A folder has this name. Only files of the cache belong here, so it is removed.
            Err(e) if e.kind() == io::ErrorKind::IsADirectory => {
                fs::remove_dir_all(path)?;
                fs::rename(&temporary, path)
            }
            other => other,
        });
        if written.is_err() {
            // Free the space of a partly written file, since the disk may be full.
            let _ = fs::remove_file(&temporary);
        }
        written
    }

    /// Returns a file if it exists.
    pub fn find(&self, id: FileId) -> Option<Found> {
        self.found(id, self.path(id))
    }

    fn found(&self, id: FileId, path: PathBuf) -> Option<Found> {
        let metadata = fs::metadata(&path).ok()?;
        let latest = SystemTime::now() + CLOCK_DRIFT;
        let modified = metadata.modified().ok().filter(|time| *time <= latest).unwrap_or(SystemTime::UNIX_EPOCH);
        Some(Found { id, path, size: metadata.len(), modified })
    }

    /// Returns all entries or all bodies.
    pub fn scan(&self, kind: Kind) -> io::Result<Vec<Found>> {
        let mut found = Vec::new();
        self.scan_kind(kind, &mut |file| found.push(file))?;
        Ok(found)
    }

    /// Hands all files whose name is a hash to `each`.
    pub fn scan_each(&self, mut each: impl FnMut(Found)) -> io::Result<()> {
        self.scan_kind(Kind::Key, &mut each)?;
        self.scan_kind(Kind::Blob, &mut each)
    }

    fn scan_kind(&self, kind: Kind, each: &mut impl FnMut(Found)) -> io::Result<()> {
        for folder in read_dir(&self.folder.join(kind.folder()))? {
            let paths = match read_dir(&folder) {
                Ok(paths) => paths,
                // An unreadable folder, such as another user's, is left out.
                Err(e) => {
                    log::warn!("cache: {}: {e}", folder.display());
                    continue;
                }
            };
            for path in paths {
                let Some(hash) = path.file_name().and_then(|n| n.to_str()).and_then(unhex) else { continue };
                // Another process may have removed the file.
                self.found(FileId { kind, hash }, path).into_iter().for_each(&mut *each);
            }
        }
        Ok(())
    }

    /// Removes temporary files of processes that were killed.
    pub fn remove_leftovers(&self) -> io::Result<()> {
        let now = SystemTime::now();
        for path in read_dir(&self.folder.join("tmp"))? {
            let Ok(modified) = fs::metadata(&path).and_then(|m| m.modified()) else { continue };
            let is_old = match now.duration_since(modified) {
                Ok(age) => age > TEMPORARY_AGE,
                // The file is from before the clock was set back.
                Err(ahead) => ahead.duration() > CLOCK_DRIFT,
            };
            if is_old {
                let _ = fs::remove_file(&path);
            }
        }
        Ok(())
    }
}

/// Returns true if a write failed for lack of space: on the disk, or for this user or process.
fn is_full(error: &io::Error) -> bool {
    is_disk_full(error) || error.kind() == io::ErrorKind::FileTooLarge
}

/// Returns true if a write failed for lack of space that removing files would free.
pub(super) fn is_disk_full(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded)
}

fn write_new(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let open = || fs::File::options().write(true).create_new(true).open(path);
    let mut file = match open() {
        Err(e) if e.kind() == io::ErrorKind::NotFound => {
            fs::create_dir_all(path.parent().unwrap_or(path))?;
            open()?
        }
        other => other?,
    };
    file.write_all(bytes)
}

/// Makes a file readable for its owner only.
#[cfg(unix)]
fn set_private(path: &Path) -> io::Result<()> {
    use std::os::unix::fs::PermissionsExt as _;
    fs::set_permissions(path, fs::Permissions::from_mode(0o600))
}

/// Does nothing: the file inherits the permissions of its folder.
#[cfg(not(unix))]
fn set_private(_: &Path) -> io::Result<()> {
    Ok(())
}

/// Returns the paths in a folder; none if it does not exist.
pub(super) fn read_dir(folder: &Path) -> io::Result<Vec<PathBuf>> {
    match fs::read_dir(folder) {
        Ok(entries) => Ok(entries.flatten().map(|e| e.path()).collect()),
        Err(e) if matches!(e.kind(), io::ErrorKind::NotFound | io::ErrorKind::NotADirectory) => Ok(Vec::new()),
        Err(e) => Err(e),
    }
}

/// Reads a file up to one byte beyond `max_bytes`, so that the caller notices a longer file.
pub(super) fn read_at_most(path: &Path, max_bytes: u64) -> io::Result<Vec<u8>> {
    let file = fs::File::open(path)?;
    let mut bytes = Vec::with_capacity(max_bytes.min(file.metadata()?.len().saturating_add(1)) as usize);
    file.take(max_bytes.saturating_add(1)).read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// Sets the time of a file, which is its last use, to now.
pub(super) fn touch(path: &Path) -> io::Result<()> {
    fs::File::options().write(true).open(path)?.set_modified(SystemTime::now())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hashes_as_text() {
        let of = hash(b"abc");
        assert_eq!(hex(&of), "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
        assert_eq!(unhex(&hex(&of)), Some(of));
        for odd in ["", "ba78", &hex(&of).to_uppercase(), &"g".repeat(64), &"é".repeat(32)] {
            assert_eq!(unhex(odd), None, "{odd}");
        }
    }

    /// Temporary files with a time in the future used to stay forever.
    #[test]
    fn leftovers_are_removed_whatever_the_clock() {
        let folder = tempfile::tempdir().unwrap();
        let files = Files::open(folder.path()).unwrap();
        let (now, hour) = (SystemTime::now(), Duration::from_secs(3600));
        let times =
            [("old", now - 2 * hour), ("ahead", now + 24 * hour), ("new", now), ("drifted", now + CLOCK_DRIFT / 2)];
        for (name, time) in times {
            let file = fs::File::create(folder.path().join("tmp").join(name)).unwrap();
            file.set_modified(time).unwrap();
        }
        files.remove_leftovers().unwrap();
        let left = times.map(|(name, _)| folder.path().join("tmp").join(name).exists());
        assert_eq!(left, [false, false, true, true]);
    }

    #[test]
    fn only_caches_and_empty_folders_are_opened() {
        let folder = tempfile::tempdir().unwrap();
        let cache = folder.path().join("new/cache");
        Files::open(&cache).unwrap();
        Files::open(&cache).unwrap();
        // The marker is missing, because the disk was full, or empty after a crash.
        fs::write(cache.join(LOCK), "").unwrap();
        fs::remove_file(cache.join(MARKER)).unwrap();
        Files::open(&cache).unwrap();
        fs::write(cache.join(MARKER), "").unwrap();
        Files::open(&cache).unwrap();
        assert_eq!(fs::read(cache.join(MARKER)).unwrap(), MARKER_TEXT);
        fs::write(cache.join(MARKER), "terrane cache 7\n").unwrap();
        assert!(Files::open(&cache).is_err());
        let home = folder.path().join("home");
        fs::create_dir(&home).unwrap();
        fs::write(home.join("letter"), "dear").unwrap();
        assert!(Files::open(&home).is_err());
        assert!(Files::open(&home.join("letter")).is_err());
    }
}
