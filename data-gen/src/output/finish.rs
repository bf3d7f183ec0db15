//! The last step of a run: a complete set is compressed or packed into an archive, and takes its place at OUT.

use std::io::{Read as _, Write as _};
use std::path::{Path, PathBuf};

use flate2::Compression;
use flate2::write::GzEncoder;
use rayon::prelude::*;

use super::PartialFolder;
use super::archive::write_archive;
use super::journal::Journal;
use super::packed::{self, write_packed_set};
use super::set_files::{each_folder, write_whole};
use crate::{ArchiveFormat, GenArgs, GenError};

/// Extensions of files that `--gzip` compresses. Images and EXR are compressed already.
const GZIP_EXTENSIONS: [&str; 4] = ["json", "glb", "subtree", "terrain"];
/// The first bytes of gzip.
const GZIP_MAGIC: [u8; 2] = [0x1f, 0x8b];
/// The name of an unfinished archive in the folder of its set.
const UNFINISHED: &str = ".archive.unfinished";

/// Puts a complete set, or a shard of one, in place at OUT. Returns the size of the set, which is `bytes` unless it is
/// compressed. Called on the threads of the current rayon pool.
pub(crate) fn finish(args: &GenArgs, partial: PartialFolder, out: &Path, bytes: u64) -> Result<u64, GenError> {
    // Shards are compressed when they are merged.
    let is_shard = args.sharding.shard.is_some();
    if let Some(format) = args.output.archive.filter(|_| !is_shard) {
        let archive = partial.path().join(UNFINISHED);
        let bytes = match format {
            ArchiveFormat::ThreeTz => write_archive(partial.path(), &archive)?,
            ArchiveFormat::Packed => write_packed_set(partial.path(), &archive)?,
        };
        std::fs::rename(&archive, out).map_err(GenError::file(out))?;
        // The folder of the set is removed with `partial`.
        return Ok(bytes);
    }
    let bytes = if args.output.gzip && !is_shard { gzip(partial.path())? } else { bytes };
    if !is_shard {
        let journal = Journal::new(partial.path());
        // Procedural terrain is not updated.
        if args.dem.is_empty() { journal.remove()? } else { journal.pack()? }
    }
    partial.put_in_place(out)?;
    Ok(bytes)
}

/// Compresses the files of a set and keeps their names. Files that are compressed stay: another run may have been killed here.
/// Returns the size of all files in bytes.
fn gzip(folder: &Path) -> Result<u64, GenError> {
    let mut total = 0;
    each_folder(folder, &mut |files: &[PathBuf]| {
        let compress = |path: &PathBuf| {
            let size = || Ok(path.metadata().map_err(GenError::file(path))?.len());
            if !is_compressible(path) {
                return size();
            }
            let content = std::fs::read(path).map_err(GenError::file(path))?;
            if content.starts_with(&GZIP_MAGIC) {
                return size();
            }
            let mut encoder = GzEncoder::new(Vec::new(), Compression::default());
            encoder.write_all(&content).map_err(GenError::file(path))?;
            write_whole(path, &encoder.finish().map_err(GenError::file(path))?)
        };
        let sizes: Vec<u64> = files.par_iter().map(compress).collect::<Result<_, GenError>>()?;
        total += sizes.iter().sum::<u64>();
        Ok(())
    })?;
    Ok(total)
}

/// Returns true for files that `--gzip` compresses.
pub(crate) fn is_compressible(path: &Path) -> bool {
    path.extension().is_some_and(|extension| GZIP_EXTENSIONS.iter().any(|of| extension == *of))
}

/// Returns true if an archive is at OUT. Fails for anything else there, and for an archive that shall not be replaced.
pub(crate) fn is_archive_at(args: &GenArgs, out: &Path) -> Result<bool, GenError> {
    if !out.exists() {
        return Ok(false);
    }
    let mut magic = [0; 8];
    let is_archive = out.is_file()
        && std::fs::File::open(out).and_then(|mut file| file.read_exact(&mut magic)).is_ok()
        && (magic.starts_with(b"PK") || magic == *packed::MAGIC);
    match is_archive {
        true if args.overwrite => Ok(true),
        true => Err(GenError::Exists(out.to_path_buf())),
        false => Err(GenError::invalid(out, "is no archive; --overwrite replaces archives only")),
    }
}
