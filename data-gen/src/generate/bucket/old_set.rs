//! The set in a bucket that `--update` takes tiles from. Tiles that stay the same are neither read nor written.

use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use rayon::prelude::*;

use super::Bucket;
use crate::GenError;
use crate::output::{Journal, MANIFEST, ROOTS, write_whole};
use crate::update::OldSet;

/// A set in a bucket.
pub(super) struct BucketSet<'a> {
    bucket: &'a Bucket,
    /// A folder with the journal of the set.
    folder: PathBuf,
    /// The sizes of all objects of the set by name.
    sizes: HashMap<String, u64>,
    /// The files that are kept. Written by all threads.
    kept: Mutex<HashSet<String>>,
}

impl<'a> BucketSet<'a> {
    /// Lists the objects of a set, and puts its journal into an empty or missing folder.
    pub fn open(bucket: &'a Bucket, folder: &Path) -> Result<Self, GenError> {
        let objects = bucket.objects("")?;
        std::fs::create_dir_all(folder).map_err(GenError::file(folder))?;
        let journal = folder.join(MANIFEST);
        if objects.iter().any(|(name, _)| name == MANIFEST) {
            write_whole(&journal, &bucket.read(MANIFEST)?)?;
        } else if journal.is_file() {
            std::fs::remove_file(&journal).map_err(GenError::file(&journal))?;
        }
        let sizes = objects.into_iter().collect();
        Ok(Self { bucket, folder: folder.to_path_buf(), sizes, kept: Mutex::default() })
    }

    /// Returns the names of the files that are kept, in order.
    pub fn into_kept(self) -> Vec<String> {
        let mut kept: Vec<String> =
            self.kept.into_inner().unwrap_or_else(PoisonError::into_inner).into_iter().collect();
        kept.sort();
        kept
    }

    /// Returns the bytes of some files as they are stored.
    pub fn bytes_of_kept(&self) -> u64 {
        let kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        kept.iter().filter_map(|name| self.sizes.get(name)).sum()
    }
}

impl OldSet for BucketSet<'_> {
    fn name(&self) -> String {
        self.bucket.out.display().to_string()
    }

    fn exists(&self) -> bool {
        ROOTS.iter().any(|root| self.sizes.contains_key(*root))
    }

    fn journal(&self) -> Journal {
        Journal::new(&self.folder)
    }

    fn size(&self, name: &str) -> Option<u64> {
        self.sizes.get(name).copied()
    }

    /// A compressed file would have to be read.
    fn plain_size(&self, _: &str, _: u64) -> Result<Option<u64>, GenError> {
        Ok(None)
    }

    fn keep(&self, name: &str, _: &Path) -> Result<(), GenError> {
        self.kept.lock().unwrap_or_else(PoisonError::into_inner).insert(name.to_owned());
        Ok(())
    }

    fn read(&self, name: &str) -> Result<Vec<u8>, GenError> {
        self.bucket.read(name)
    }
}

impl Bucket {
    pub(super) fn read(&self, name: &str) -> Result<Vec<u8>, GenError> {
        self.folder.read(name).map_err(self.error())
    }

    /// Returns the names and sizes of all objects below a folder.
    fn objects(&self, folder: &str) -> Result<Vec<(String, u64)>, GenError> {
        let list = self.folder.list(folder).map_err(self.error())?;
        let at = |name: &String| if folder.is_empty() { name.clone() } else { format!("{folder}/{name}") };
        let below: Vec<Vec<(String, u64)>> =
            list.folders.par_iter().map(|name| self.objects(&at(name))).collect::<Result<_, GenError>>()?;
        let own = list.objects.iter().map(at).zip(list.sizes.iter().copied());
        Ok(own.chain(below.into_iter().flatten()).collect())
    }

    /// Uploads what an update has changed. The old set stays readable: tiles are replaced first, the root then, and files that
    /// the new set does not have are removed at last. Without its manifest nothing of an incomplete set is kept by a later
    /// update.
    pub(super) fn upload_update(&self, args: &crate::GenArgs, set: &Path, kept: &[String]) -> Result<(), GenError> {
        self.folder.remove(MANIFEST).map_err(self.error())?;
        let kept: HashSet<&str> = kept.iter().map(String::as_str).collect();
        // Files leave the folder when they are uploaded, so that a run that was killed does not know them any more.
        let list = set.with_extension("names");
        let names: Vec<String> = match std::fs::read(&list) {
            Ok(json) => serde_json::from_slice(&json).map_err(|e| GenError::invalid(&list, e.to_string()))?,
            Err(_) => {
                let names = super::names_of(set)?;
                let json = serde_json::to_vec(&names).map_err(|e| GenError::Encode(e.to_string()))?;
                write_whole(&list, &json)?;
                names
            }
        };
        self.send(args, set)?;
        let names: HashSet<&str> = names.iter().map(String::as_str).chain(kept).collect();
        let stale: Vec<String> =
            self.objects("")?.into_iter().map(|(name, _)| name).filter(|name| !names.contains(&**name)).collect();
        stale.par_iter().try_for_each(|name| self.folder.remove(name).map_err(self.error()))
    }
}
