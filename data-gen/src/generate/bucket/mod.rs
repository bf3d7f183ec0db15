//! A bucket of an object store as OUT. The set is made in a scratch folder on this machine and uploaded, its root last, so that
//! an incomplete set is never visible as one. Files are removed from the scratch folder when they are uploaded: a run that was
//! killed continues with the others.

mod old_set;
mod parts;

use std::path::{Path, PathBuf};
use std::time::Instant;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use terrane::fetch::{HttpConfig, IoError, ObjectFolder, ObjectHeaders};
use terrane::math::random::fnv1a;

use self::old_set::BucketSet;
use self::parts::ShardFolder;
pub(crate) use self::parts::complete_shards;
use crate::fingerprint::fingerprint;
use crate::generate::{check, expanded};
use crate::output::{MANIFEST, ROOTS, each_folder, write_whole};
use crate::update::OldSet as _;
use crate::{ArchiveFormat, GenArgs, GenError, PartialFolder, Prediction, Progress, RunArgs, Summary, generate};

/// An object that is written and removed before work starts.
const PROBE: &str = ".terrane-gen-probe";
/// The summary of a set that is complete in the scratch folder.
const SUMMARY: &str = "summary.json";
/// The same, of an update.
const UPDATE_SUMMARY: &str = "update.json";
/// A file in the scratch folder that says that the old set has been removed from the bucket.
const CLEARED: &str = "cleared";
/// Files that are uploaded at the same time.
const MAX_UPLOADS: usize = 16;
/// Files whose names are in memory at a time.
const MAX_NAMES: usize = 4096;

/// The place of a set in a bucket.
struct Bucket {
    folder: ObjectFolder,
    /// The name of the archive in the folder; `None` for a set of files.
    archive: Option<String>,
    /// The address of the set.
    out: PathBuf,
}

/// A set that is complete in the scratch folder.
#[derive(Serialize, Deserialize)]
struct Made {
    summary: Summary,
    /// The files of the old set in the bucket that an update keeps.
    kept: Vec<String>,
}

/// Makes a set, or a shard of one, and uploads it. The same options continue a run that was killed.
pub(crate) fn run(args: &GenArgs) -> Result<Summary, GenError> {
    let start = Instant::now();
    let args = &expanded(args)?;
    check(args)?;
    let bucket = Bucket::open(args)?;
    bucket.check_writable()?;
    let fingerprint = fingerprint(args)?;
    let shard = args.sharding.shard.map(|shard| ShardFolder::beside(&bucket.out, shard)).transpose()?;
    let out = shard.as_ref().map_or_else(|| bucket.out.clone(), |shard| shard.at.clone());
    if let Some(shard) = &shard
        && shard.is_made(fingerprint)?
    {
        return Ok(Summary { out, notes: vec!["the shard was complete".to_owned()], ..Summary::default() });
    }
    let partial = PartialFolder::beside(&scratch(&out), fingerprint)?;
    check_owner(partial.path())?;
    // The folder of an update has only a part of the set: no other run continues it.
    let (at, set) = if args.run.update { (UPDATE_SUMMARY, "update") } else { (SUMMARY, bucket.set_name(args)) };
    let (at, set) = (partial.path().join(at), partial.path().join(set));
    let made: Option<Made> = std::fs::read(&at).ok().and_then(|json| serde_json::from_slice(&json).ok());
    let made = match made {
        Some(made) => made,
        None => {
            let made = match bucket.make(args, &set, partial.path()) {
                Err(unfinished @ GenError::Unfinished { .. }) => {
                    partial.keep();
                    return Err(unfinished);
                }
                made => made?,
            };
            let json = serde_json::to_vec(&made).map_err(|e| GenError::Encode(e.to_string()))?;
            write_whole(&at, &json)?;
            made
        }
    };
    let uploaded = match &shard {
        Some(shard) => shard.upload(&shard.shard.folder(&set)),
        None if args.run.update => bucket.upload_update(args, &set, &made.kept),
        None => bucket.upload(args, &set, partial.path()),
    };
    let uploaded = uploaded.and_then(|()| if args.sharding.merge { parts::remove(&bucket) } else { Ok(()) });
    if let Err(reason) = uploaded {
        return Err(GenError::Unfinished { reason: Box::new(reason), folder: partial.keep() });
    }
    Ok(Summary { out, seconds: start.elapsed().as_secs_f64(), ..made.summary })
}

/// Predicts a run. Fails as it would, as far as that is known before.
pub(crate) fn predict(args: &GenArgs) -> Result<Prediction, GenError> {
    check(&expanded(args)?)?;
    let bucket = Bucket::open(args)?;
    bucket.check_writable()?;
    if !args.run.update {
        bucket.check_free(args)?;
    }
    let out = scratch(&bucket.out).join(bucket.set_name(args));
    generate::predict(&GenArgs { out, ..args.clone() })
}

/// Returns the path of the set in the scratch folder.
fn scratch(out: &Path) -> PathBuf {
    let number = fnv1a(out.to_string_lossy().as_bytes());
    std::env::temp_dir().join(format!("terrane-gen-{number:016x}"))
}

/// Refuses a scratch folder of another user of this machine.
#[cfg(unix)]
fn check_owner(folder: &Path) -> Result<(), GenError> {
    use std::os::unix::fs::MetadataExt as _;
    let failed = GenError::file(folder);
    let owners = || -> std::io::Result<[u32; 2]> {
        Ok([folder.metadata()?.uid(), tempfile::tempfile_in(folder)?.metadata()?.uid()])
    };
    match owners().map_err(failed)? {
        [owner, own] if owner != own => {
            Err(GenError::invalid(folder, "belongs to another user; TMPDIR selects another place"))
        }
        _ => Ok(()),
    }
}

#[cfg(not(unix))]
fn check_owner(_: &Path) -> Result<(), GenError> {
    Ok(())
}

impl Bucket {
    /// Opens the place of a set; sends no request.
    fn open(args: &GenArgs) -> Result<Self, GenError> {
        let out = args.out.to_str().ok_or_else(|| GenError::invalid(&args.out, "an address that is not UTF-8"))?;
        let out = out.trim_end_matches('/');
        let (folder, archive) = match args.output.archive {
            None => (out, None),
            Some(_) => out.rsplit_once('/').map_or((out, None), |(folder, name)| (folder, Some(name.to_owned()))),
        };
        let out = PathBuf::from(out);
        let folder = ObjectFolder::open(folder, &HttpConfig::default()).map_err(|e| GenError::remote(&args.out, &e))?;
        Ok(Self { folder, archive, out })
    }

    fn error(&self) -> impl Fn(IoError) -> GenError + '_ {
        |e| GenError::remote(Path::new(e.uri()), &e)
    }

    /// Returns the name of the set in the scratch folder.
    fn set_name(&self, args: &GenArgs) -> &'static str {
        match args.output.archive.filter(|_| self.archive.is_some()) {
            None => "set",
            Some(ArchiveFormat::ThreeTz) => "set.3tz",
            Some(ArchiveFormat::Packed) => "set.terrane",
        }
    }

    /// Makes a set, or a shard of one, in the scratch folder.
    fn make(&self, args: &GenArgs, set: &Path, scratch: &Path) -> Result<Made, GenError> {
        if args.run.update {
            let old = BucketSet::open(self, &scratch.join("old"))?;
            if old.exists() {
                let local = GenArgs { out: set.to_path_buf(), ..args.clone() };
                let mut summary = generate::run_with(&local, &old)?;
                if args.output.gzip {
                    // The folder has only the files that were made.
                    summary.bytes += old.bytes_of_kept();
                }
                return Ok(Made { summary, kept: old.into_kept() });
            }
        }
        if args.sharding.shard.is_none() {
            self.check_free(args)?;
        }
        if args.sharding.merge {
            parts::download(self, set)?;
        }
        let overwrite = args.sharding.shard.is_none();
        let run = RunArgs { update: false, ..args.run.clone() };
        let local = GenArgs { out: set.to_path_buf(), overwrite, run, ..args.clone() };
        Ok(Made { summary: generate::run(&local)?, kept: Vec::new() })
    }

    /// Writes a small object and removes it.
    fn check_writable(&self) -> Result<(), GenError> {
        let headers = ObjectHeaders { content_type: "text/plain", is_gzip: false };
        self.folder.write(PROBE, b"terrane gen writes here\n".to_vec(), headers).map_err(self.error())?;
        self.folder.remove(PROBE).map_err(self.error())
    }

    /// Fails if there is something else than a set, or a set that shall not be replaced.
    fn check_free(&self, args: &GenArgs) -> Result<(), GenError> {
        let (is_occupied, is_set) = match &self.archive {
            Some(name) => {
                let is_there = self.folder.has(name).map_err(self.error())?;
                (is_there, true)
            }
            None => {
                let list = self.folder.list("").map_err(self.error())?;
                let is_set = ROOTS.iter().any(|root| list.objects.iter().any(|name| name == root));
                (!list.objects.is_empty() || !list.folders.is_empty(), is_set)
            }
        };
        if !is_occupied {
            return Ok(());
        }
        if !args.overwrite {
            return Err(GenError::Exists(self.out.clone()));
        }
        if !is_set {
            return Err(GenError::invalid(&self.out, "holds no tile set; --overwrite replaces tile sets only"));
        }
        match args.dem.iter().chain(&args.imagery).find(|path| path.starts_with(&self.out)) {
            Some(path) => Err(GenError::Argument(format!("--overwrite would remove {}", path.display()))),
            None => Ok(()),
        }
    }

    /// Uploads a complete set, its root last, and removes each file of the scratch folder that is uploaded.
    fn upload(&self, args: &GenArgs, set: &Path, scratch: &Path) -> Result<(), GenError> {
        if let Some(name) = &self.archive {
            // A run that was killed may have uploaded it.
            return if set.exists() { self.upload_file(args, set, name) } else { Ok(()) };
        }
        let cleared = scratch.join(CLEARED);
        if args.overwrite && !cleared.is_file() {
            for root in ROOTS {
                self.folder.remove(root).map_err(self.error())?;
            }
            pool_of(MAX_UPLOADS)?.install(|| self.clear(""))?;
            write_whole(&cleared, b"")?;
        }
        self.send(args, set)
    }

    /// Uploads the files of a set, its root last but for its manifest, and removes each from the folder.
    fn send(&self, args: &GenArgs, set: &Path) -> Result<(), GenError> {
        let pool = pool_of(MAX_UPLOADS)?;
        let progress = Progress::new("uploading", names_of(set)?.len() as u64, "files");
        let (mut names, mut roots) = (Vec::new(), Vec::new());
        let send = |names: &mut Vec<(PathBuf, String)>| {
            pool.install(|| {
                names.par_drain(..).try_for_each(|(path, name)| {
                    self.upload_file(args, &path, &name)?;
                    progress.advance(1);
                    Ok::<_, GenError>(())
                })
            })
        };
        each_folder(set, &mut |files: &[PathBuf]| {
            for path in files {
                let name = name_in(set, path);
                let is_root = ROOTS.contains(&&*name);
                if is_root { &mut roots } else { &mut names }.push((path.clone(), name));
            }
            if names.len() >= MAX_NAMES { send(&mut names) } else { Ok(()) }
        })?;
        send(&mut names)?;
        send(&mut roots)?;
        let manifest = set.join(MANIFEST);
        if manifest.is_file() { self.upload_file(args, &manifest, MANIFEST) } else { Ok(()) }
    }

    /// Removes all objects below a folder.
    fn clear(&self, folder: &str) -> Result<(), GenError> {
        let list = self.folder.list(folder).map_err(self.error())?;
        let at = |name: &String| if folder.is_empty() { name.clone() } else { format!("{folder}/{name}") };
        list.objects.par_iter().try_for_each(|name| self.folder.remove(&at(name)).map_err(self.error()))?;
        list.folders.iter().try_for_each(|name| self.clear(&at(name)))
    }

    fn upload_file(&self, args: &GenArgs, path: &Path, name: &str) -> Result<(), GenError> {
        self.folder.write_file(name, path, headers(args, path)).map_err(self.error())?;
        std::fs::remove_file(path).map_err(GenError::file(path))
    }
}

/// Returns the names of the files of a set, relative to its folder.
fn names_of(set: &Path) -> Result<Vec<String>, GenError> {
    let mut names = Vec::new();
    let own = set.join(MANIFEST);
    each_folder(set, &mut |files: &[PathBuf]| {
        names.extend(files.iter().map(|path| name_in(set, path)));
        Ok(())
    })?;
    names.extend(own.is_file().then(|| MANIFEST.to_owned()));
    Ok(names)
}

fn name_in(set: &Path, path: &Path) -> String {
    let parts = path.strip_prefix(set).unwrap_or(path).iter().map(|part| part.to_string_lossy());
    parts.collect::<Vec<_>>().join("/")
}

fn pool_of(threads: usize) -> Result<rayon::ThreadPool, GenError> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
    pool.map_err(|e| GenError::Argument(format!("{threads} threads for uploads: {e}")))
}

/// Returns what the store says about a file of a set.
fn headers(args: &GenArgs, path: &Path) -> ObjectHeaders {
    let extension = path.extension().map(|extension| extension.to_string_lossy().into_owned()).unwrap_or_default();
    let content_type = match &*extension {
        "json" => "application/json",
        "glb" => "model/gltf-binary",
        "jpg" => "image/jpeg",
        "png" => "image/png",
        "webp" => "image/webp",
        "exr" => "image/x-exr",
        "terrain" => "application/vnd.quantized-mesh",
        "3tz" => "application/zip",
        _ => "application/octet-stream",
    };
    ObjectHeaders { content_type, is_gzip: args.output.gzip && crate::output::is_compressible(path) }
}
