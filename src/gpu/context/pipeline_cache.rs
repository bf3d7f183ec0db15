//! [`PipelineCache`]: the driver's compiled pipelines, kept on disk for the next run. Draw thread; written when the context
//! is dropped.
//!
//! A file has a magic number and a hash before wgpu's data, so that a truncated, changed or foreign file does not reach the
//! driver. It is named after the adapter; wgpu checks the driver's version.

use std::path::{Path, PathBuf};
use std::{fs, io};

use highway::{HighwayHash as _, HighwayHasher, Key};

use crate::gpu::GpuError;

/// A larger cache is discarded, since unused pipelines cannot be removed from it.
const MAX_BYTES: usize = 64 << 20;
/// The magic number of files; its last character is the version.
const MAGIC: &[u8; 8] = b"terrane1";
const HASH_BYTES: usize = 32;
const HEADER_BYTES: usize = MAGIC.len() + HASH_BYTES;

/// The pipelines of one device.
pub(super) struct PipelineCache {
    cache: wgpu::PipelineCache,
    folder: PathBuf,
    file: PathBuf,
    /// The hash of the data in the file.
    saved: Option<[u8; HASH_BYTES]>,
}

impl PipelineCache {
    /// Opens the cache of an adapter in a folder. Returns it with the number of bytes found. If the file is not usable, the
    /// cache begins empty, and the reason is returned instead.
    pub(super) fn open(
        device: &wgpu::Device,
        adapter: &wgpu::AdapterInfo,
        folder: &Path,
    ) -> Result<(Self, Result<u64, GpuError>), GpuError> {
        let has_feature = device.features().contains(wgpu::Features::PIPELINE_CACHE);
        let Some(name) = wgpu::util::pipeline_cache_key(adapter).filter(|_| has_feature) else {
            return Err(GpuError::NoPipelineCache { adapter: adapter.name.clone() });
        };
        let file = folder.join(name);
        let (found, result) = match read(&file) {
            Ok(found) => {
                let bytes = found.as_ref().map_or(0, |found| found.len() as u64);
                (found, Ok(bytes))
            }
            Err(reason) => (None, Err(GpuError::PipelineCache { file: file.clone(), reason })),
        };
        let cache = create_cache(device, found.as_deref());
        let saved = found.map(|found| hash(&found));
        Ok((Self { cache, folder: folder.to_owned(), file, saved }, result))
    }

    pub(super) fn cache(&self) -> &wgpu::PipelineCache {
        &self.cache
    }

    pub(super) fn folder(&self) -> &Path {
        &self.folder
    }

    /// Writes the compiled pipelines, unless the file has them already. Writes a temporary file and renames it, so that
    /// readers find the old file, the new one or none. Returns the size in bytes.
    pub(super) fn save(&mut self) -> Result<u64, GpuError> {
        let Some(data) = self.cache.get_data() else { return Ok(0) };
        let hash = hash(&data);
        if self.saved == Some(hash) {
            return Ok(data.len() as u64);
        }
        let written = if data.len() > MAX_BYTES {
            log::info!("{}: {} bytes of pipelines are too many and are discarded", self.file.display(), data.len());
            fs::remove_file(&self.file).or_else(|e| if e.kind() == io::ErrorKind::NotFound { Ok(()) } else { Err(e) })
        } else {
            write(&self.folder, &self.file, &hash, &data)
        };
        match written {
            Ok(()) => {
                self.saved = Some(hash);
                Ok(data.len() as u64)
            }
            Err(e) => Err(GpuError::PipelineCache { file: self.file.clone(), reason: e.to_string() }),
        }
    }
}

impl Drop for PipelineCache {
    fn drop(&mut self) {
        if let Err(error) = self.save() {
            log::warn!("{error}");
        }
    }
}

#[allow(unsafe_code, reason = "wgpu cannot check the origin of the data")]
fn create_cache(device: &wgpu::Device, data: Option<&[u8]>) -> wgpu::PipelineCache {
    let descriptor = wgpu::PipelineCacheDescriptor { label: Some("pipelines"), data, fallback: true };
    // SAFETY: `data` was returned by `PipelineCache::get_data` for an adapter with the same `pipeline_cache_key`. It is the
    // result of `read`, which accepts only data that `write` has written, with its hash, to the file named by that key.
    unsafe { device.create_pipeline_cache(&descriptor) }
}

fn hash(data: &[u8]) -> [u8; HASH_BYTES] {
    // Protects against accidents. An attacker who can write to the user's folder needs no forged cache.
    let mut hasher = HighwayHasher::new(Key([0x7465_7272_616e_6531; 4]));
    hasher.append(data);
    let mut bytes = [0; HASH_BYTES];
    for (to, word) in bytes.chunks_exact_mut(8).zip(hasher.finalize256()) {
        to.copy_from_slice(&word.to_le_bytes());
    }
    bytes
}

/// Returns the data in a file; `None` without a file, and the reason if the file is not usable.
fn read(file: &Path) -> Result<Option<Vec<u8>>, String> {
    let size = match fs::metadata(file) {
        Ok(metadata) => metadata.len(),
        Err(e) if e.kind() == io::ErrorKind::NotFound => return Ok(None),
        Err(e) => return Err(e.to_string()),
    };
    if size > (MAX_BYTES + HEADER_BYTES) as u64 {
        return Err(format!("{size} bytes are more than a cache can have"));
    }
    let bytes = fs::read(file).map_err(|e| e.to_string())?;
    let data = bytes.strip_prefix(MAGIC).and_then(|rest| rest.split_at_checked(HASH_BYTES));
    match data {
        Some((expected, data)) if hash(data) == expected => Ok(Some(data.to_vec())),
        Some(_) => Err("its hash does not match its data".into()),
        None => Err("it is no file of pipelines".into()),
    }
}

fn write(folder: &Path, file: &Path, hash: &[u8; HASH_BYTES], data: &[u8]) -> io::Result<()> {
    fs::create_dir_all(folder)?;
    let temporary = file.with_extension(format!("{}.tmp", std::process::id()));
    let bytes = [MAGIC, &hash[..], data].concat();
    let written = fs::write(&temporary, bytes).and_then(|()| fs::rename(&temporary, file));
    if written.is_err() {
        // Removes the partial file, for example of a full disk.
        let _ = fs::remove_file(&temporary);
    }
    written
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn damaged_files_are_not_read() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("new").join("file");
        let data: Vec<u8> = (0..1000u32).map(|i| (i * 7) as u8).collect();
        assert_eq!(read(&file), Ok(None));
        write(&folder.path().join("new"), &file, &hash(&data), &data).unwrap();
        assert_eq!(read(&file), Ok(Some(data.clone())));
        let whole = fs::read(&file).unwrap();
        for at in [0, 7, 8, 39, 40, 700, whole.len() - 1] {
            let mut changed = whole.clone();
            changed[at] ^= 0x10;
            fs::write(&file, &changed).unwrap();
            assert!(read(&file).is_err(), "{at}");
            fs::write(&file, &whole[..at]).unwrap();
            assert!(read(&file).is_err(), "{at}");
        }
        // A huge file is refused before it is read.
        fs::File::create(&file).unwrap().set_len((MAX_BYTES + HEADER_BYTES + 1) as u64).unwrap();
        assert!(read(&file).unwrap_err().contains("more than"));
        // No temporary file remains.
        assert_eq!(fs::read_dir(folder.path().join("new")).unwrap().count(), 1);
        assert!(write(&file, &file.join("x"), &hash(&data), &data).is_err(), "a file is no folder");
    }
}
