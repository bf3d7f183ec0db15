//! Shards in a bucket: their files lie in folders beside the set, as those on a disk do, each with its manifest written last. A
//! merge downloads them.

use std::path::{Path, PathBuf};

use rayon::prelude::*;
use terrane::fetch::{HttpConfig, IoError, ObjectFolder, ObjectHeaders};

use super::{Bucket, MAX_UPLOADS, pool_of};
use crate::output::write_whole;
use crate::shards::{MANIFEST, Manifest, Shard};
use crate::{GenArgs, GenError, Progress};

/// The folder of a shard in a bucket.
pub(super) struct ShardFolder {
    pub shard: Shard,
    folder: ObjectFolder,
    /// The address of the folder.
    pub at: PathBuf,
}

impl ShardFolder {
    /// Returns the folder of a shard beside a set; sends no request.
    pub fn beside(out: &Path, shard: Shard) -> Result<Self, GenError> {
        let at = shard.folder(out);
        let address = at.to_str().ok_or_else(|| GenError::invalid(&at, "an address that is not UTF-8"))?;
        let folder = ObjectFolder::open(address, &HttpConfig::default()).map_err(|e| GenError::remote(&at, &e))?;
        Ok(Self { shard, folder, at })
    }

    fn error(&self) -> impl Fn(IoError) -> GenError + '_ {
        |e| GenError::remote(Path::new(e.uri()), &e)
    }

    /// Returns the manifest; `None` if the shard is not complete.
    fn manifest(&self) -> Result<Option<Vec<u8>>, GenError> {
        match self.folder.read(MANIFEST) {
            Ok(bytes) => Ok(Some(bytes)),
            Err(IoError::NotFound { .. }) => Ok(None),
            Err(error) => Err(self.error()(error)),
        }
    }

    /// Returns true if the shard is complete and was made with the fingerprint. Fails if it was made with another one.
    pub fn is_made(&self, fingerprint: u64) -> Result<bool, GenError> {
        let Some(bytes) = self.manifest()? else { return Ok(false) };
        match Manifest::parse(&self.at.join(MANIFEST), &bytes)?.is_of(fingerprint) {
            true => Ok(true),
            false => Err(GenError::Exists(self.at.clone())),
        }
    }

    /// Uploads a shard's folder, its manifest last.
    pub fn upload(&self, folder: &Path) -> Result<(), GenError> {
        let headers = ObjectHeaders { content_type: "application/octet-stream", is_gzip: false };
        let names = Manifest::read(folder)?.names();
        let progress = Progress::new("uploading", names.len() as u64, "files");
        pool_of(MAX_UPLOADS)?.install(|| {
            names.par_iter().try_for_each(|name| {
                self.folder.write_file(name, &folder.join(name), headers).map_err(self.error())?;
                progress.advance(1);
                Ok::<_, GenError>(())
            })
        })?;
        self.folder.write_file(MANIFEST, &folder.join(MANIFEST), headers).map_err(self.error()).map(|_| ())
    }

    /// Downloads the files of a shard, unless they are there. Objects that are missing are left out: the merge names them.
    fn download(&self, folder: &Path) -> Result<(), GenError> {
        if folder.join(MANIFEST).is_file() {
            return Ok(());
        }
        let Some(bytes) = self.manifest()? else { return Ok(()) };
        let names = Manifest::parse(&self.at.join(MANIFEST), &bytes)?.names();
        names.par_iter().try_for_each(|name| {
            let path = folder.join(name);
            if path.is_file() {
                return Ok(());
            }
            let to = path.parent().unwrap_or(folder);
            std::fs::create_dir_all(to).map_err(GenError::file(to))?;
            match self.folder.read_file(name, &path) {
                Ok(()) | Err(IoError::NotFound { .. }) => Ok(()),
                Err(error) => Err(self.error()(error)),
            }
        })?;
        std::fs::create_dir_all(folder).map_err(GenError::file(folder))?;
        write_whole(&folder.join(MANIFEST), &bytes).map(|_| ())
    }

    /// Removes the shard, its manifest first.
    fn remove(&self) -> Result<(), GenError> {
        let Some(bytes) = self.manifest()? else { return Ok(()) };
        let names = Manifest::parse(&self.at.join(MANIFEST), &bytes)?.names();
        self.folder.remove(MANIFEST).map_err(self.error())?;
        names.par_iter().try_for_each(|name| self.folder.remove(name).map_err(self.error()))
    }
}

/// Returns the folders of shards beside a set, in order.
fn beside(bucket: &Bucket) -> Result<Vec<ShardFolder>, GenError> {
    let out = bucket.out.to_string_lossy();
    let (parent, name) = out.rsplit_once('/').unwrap_or((&out, ""));
    let folder = ObjectFolder::open(parent, &HttpConfig::default()).map_err(|e| GenError::remote(&bucket.out, &e))?;
    let folders = folder.list("").map_err(|e| GenError::remote(&bucket.out, &e))?.folders;
    let mut shards: Vec<Shard> = folders.iter().filter_map(|folder| Shard::of_folder(name, folder)).collect();
    shards.sort();
    shards.into_iter().map(|shard| ShardFolder::beside(&bucket.out, shard)).collect()
}

/// Downloads all shards of a set beside a folder on this machine.
pub(super) fn download(bucket: &Bucket, set: &Path) -> Result<(), GenError> {
    let shards = beside(bucket)?;
    let progress = Progress::new("downloading", shards.len() as u64, "shards");
    pool_of(MAX_UPLOADS)?.install(|| {
        shards.iter().try_for_each(|shard| {
            shard.download(&shard.shard.folder(set))?;
            progress.advance(1);
            Ok(())
        })
    })
}

/// Removes the shards of a set that is complete.
pub(super) fn remove(bucket: &Bucket) -> Result<(), GenError> {
    let shards = beside(bucket)?;
    pool_of(MAX_UPLOADS)?.install(|| shards.iter().try_for_each(ShardFolder::remove))
}

/// Returns the shards of a set in the bucket that are complete and were made with the fingerprint.
pub(crate) fn complete_shards(args: &GenArgs, fingerprint: u64) -> Result<Vec<Shard>, GenError> {
    let bucket = Bucket::open(args)?;
    let is_made = |shard: &ShardFolder| match shard.is_made(fingerprint) {
        Err(GenError::Exists(_)) => Ok(false),
        found => found,
    };
    let mut complete = Vec::new();
    for shard in beside(&bucket)? {
        if is_made(&shard)? {
            complete.push(shard.shard);
        }
    }
    Ok(complete)
}
