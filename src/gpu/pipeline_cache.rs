//! What the driver compiled, kept on disk for the next start. Draw thread; written when the context is closed.
//!
//! A file is what wgpu gave, behind a mark and a hash of ours: what was cut off, changed or written by somebody else
//! does not get to the driver. It lies under the adapter's name; the driver's version is checked by wgpu.

use std::path::{Path, PathBuf};
use std::{fs, io};

use highway::{HighwayHash as _, HighwayHasher, Key};

use super::GpuError;

/// A larger cache is given up: what nobody needs any more cannot be taken out of it.
const MOST_BYTES: usize = 64 << 20;
/// What files begin with; the last character is the version.
const MARK: &[u8; 8] = b"terrane1";
const HASH_BYTES: usize = 32;
const HEADER_BYTES: usize = MARK.len() + HASH_BYTES;

/// The pipelines of one device.
pub(super) struct PipelineCache {
    cache: wgpu::PipelineCache,
    folder: PathBuf,
    file: PathBuf,
    /// Of what is in the file.
    saved: Option<[u8; HASH_BYTES]>,
}

impl PipelineCache {
    /// The cache of an adapter in a folder, with what is there, and how many bytes that were. Where that cannot be used
    /// it begins empty: why not.
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
        let (found, told) = match read(&file) {
            Ok(found) => {
                let bytes = found.as_ref().map_or(0, |found| found.len() as u64);
                (found, Ok(bytes))
            }
            Err(reason) => (None, Err(GpuError::PipelineCache { file: file.clone(), reason })),
        };
        let cache = make(device, found.as_deref());
        let saved = found.map(|found| hash(&found));
        Ok((Self { cache, folder: folder.to_owned(), file, saved }, told))
    }

    pub(super) fn cache(&self) -> &wgpu::PipelineCache {
        &self.cache
    }

    pub(super) fn folder(&self) -> &Path {
        &self.folder
    }

    /// Writes what there is now, unless that is in the file: beside it and renamed, so that whoever reads finds the
    /// old, the new or nothing. Its bytes.
    pub(super) fn save(&mut self) -> Result<u64, GpuError> {
        let Some(data) = self.cache.get_data() else { return Ok(0) };
        let hash = hash(&data);
        if self.saved == Some(hash) {
            return Ok(data.len() as u64);
        }
        let written = if data.len() > MOST_BYTES {
            log::info!("{}: {} bytes of pipelines are too many; they begin anew", self.file.display(), data.len());
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

#[allow(unsafe_code, reason = "wgpu cannot know where the data comes from")]
fn make(device: &wgpu::Device, data: Option<&[u8]>) -> wgpu::PipelineCache {
    let descriptor = wgpu::PipelineCacheDescriptor { label: Some("pipelines"), data, fallback: true };
    // SAFETY: `data` is what `PipelineCache::get_data` gave for an adapter with the same `pipeline_cache_key`: it comes
    // from `read`, which takes only what `write` has written, with its hash, under the file name that is that key.
    unsafe { device.create_pipeline_cache(&descriptor) }
}

fn hash(data: &[u8]) -> [u8; HASH_BYTES] {
    // Against accidents: who may write into the user's folder needs no forged cache.
    let mut hasher = HighwayHasher::new(Key([0x7465_7272_616e_6531; 4]));
    hasher.append(data);
    let mut bytes = [0; HASH_BYTES];
    for (to, word) in bytes.chunks_exact_mut(8).zip(hasher.finalize256()) {
        to.copy_from_slice(&word.to_le_bytes());
    }
    bytes
}

/// What a file holds; `None` without a file. Why it is not to be used.
fn read(file: &Path) -> Result<Option<Vec<u8>>, String> {
    let size = match fs::metadata(file) {
        Ok(metadata) => metadata.len(),
        Err(e) if e.kind() == io::ErrorKind::NotFound => return Ok(None),
        Err(e) => return Err(e.to_string()),
    };
    if size > (MOST_BYTES + HEADER_BYTES) as u64 {
        return Err(format!("{size} bytes are more than there can be"));
    }
    let bytes = fs::read(file).map_err(|e| e.to_string())?;
    let data = bytes.strip_prefix(MARK).and_then(|rest| rest.split_at_checked(HASH_BYTES));
    match data {
        Some((expected, data)) if hash(data) == expected => Ok(Some(data.to_vec())),
        Some(_) => Err("its hash is another".into()),
        None => Err("it is no file of pipelines".into()),
    }
}

fn write(folder: &Path, file: &Path, hash: &[u8; HASH_BYTES], data: &[u8]) -> io::Result<()> {
    fs::create_dir_all(folder)?;
    let temporary = file.with_extension(format!("{}.tmp", std::process::id()));
    let bytes = [MARK, &hash[..], data].concat();
    let written = fs::write(&temporary, bytes).and_then(|()| fs::rename(&temporary, file));
    if written.is_err() {
        // A full disk should not keep the rest of it.
        let _ = fs::remove_file(&temporary);
    }
    written
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_was_written_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let place = folder.path().join("new").join("file");
        let data: Vec<u8> = (0..1000u32).map(|i| (i * 7) as u8).collect();
        assert_eq!(read(&place), Ok(None));
        write(&folder.path().join("new"), &place, &hash(&data), &data).unwrap();
        assert_eq!(read(&place), Ok(Some(data.clone())));
        let whole = fs::read(&place).unwrap();
        for at in [0, 7, 8, 39, 40, 700, whole.len() - 1] {
            let mut changed = whole.clone();
            changed[at] ^= 0x10;
            fs::write(&place, &changed).unwrap();
            assert!(read(&place).is_err(), "{at}");
            fs::write(&place, &whole[..at]).unwrap();
            assert!(read(&place).is_err(), "{at}");
        }
        // Not read into memory.
        fs::File::create(&place).unwrap().set_len((MOST_BYTES + HEADER_BYTES + 1) as u64).unwrap();
        assert!(read(&place).unwrap_err().contains("more than"));
        // Nothing is left beside it.
        assert_eq!(fs::read_dir(folder.path().join("new")).unwrap().count(), 1);
        assert!(write(&place, &place.join("x"), &hash(&data), &data).is_err(), "a file is no folder");
    }
}
