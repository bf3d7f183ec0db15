//! Writes a folder as a 3D Tiles archive (3tz): a zip whose last file is an index of the others by the MD5 of their names.

use std::fs::File;
use std::io::{BufWriter, Cursor, Write as _};
use std::path::Path;

use anyhow::{Context as _, Result};
use md5::{Digest as _, Md5};
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipArchive, ZipWriter};

const INDEX: &str = "@3dtilesIndex1@";

/// Writes all files below a folder into an archive.
pub fn write(folder: &Path, archive: &Path) -> Result<()> {
    let options = SimpleFileOptions::default().compression_method(CompressionMethod::Stored);
    let mut writer = ZipWriter::new(Cursor::new(Vec::new()));
    add(&mut writer, folder, "", options)?;
    let zip = writer.finish()?;
    let index = index(&mut ZipArchive::new(zip.clone())?)?;
    let mut writer = ZipWriter::new_append(zip)?;
    writer.start_file(INDEX, options)?;
    writer.write_all(&index)?;
    let bytes = writer.finish()?.into_inner();
    let file = File::create(archive).with_context(|| archive.display().to_string())?;
    let mut out = BufWriter::new(file);
    out.write_all(&bytes).and_then(|()| out.flush()).with_context(|| archive.display().to_string())
}

/// Adds the content of a folder. `below` is the prefix of the names, empty or ending with a slash.
fn add(writer: &mut ZipWriter<Cursor<Vec<u8>>>, folder: &Path, below: &str, options: SimpleFileOptions) -> Result<()> {
    let entries = std::fs::read_dir(folder).with_context(|| folder.display().to_string())?;
    let mut paths = entries.map(|entry| Ok(entry?.path())).collect::<Result<Vec<_>>>()?;
    paths.sort();
    for path in paths {
        let name = path.file_name().and_then(|name| name.to_str()).context("a file name that is not UTF-8")?;
        if path.is_dir() {
            add(writer, &path, &format!("{below}{name}/"), options)?;
        } else {
            writer.start_file(format!("{below}{name}"), options)?;
            writer.write_all(&std::fs::read(&path).with_context(|| path.display().to_string())?)?;
        }
    }
    Ok(())
}

/// Returns the index: hashes of names with the offsets of their files, sorted by the hashes as two 64-bit numbers.
fn index(zip: &mut ZipArchive<Cursor<Vec<u8>>>) -> Result<Vec<u8>> {
    let mut entries = Vec::new();
    for number in 0..zip.len() {
        let file = zip.by_index_raw(number)?;
        let hash: [u8; 16] = Md5::digest(file.name()?.as_bytes()).into();
        // The first eight bytes are the more significant number.
        entries.push((u128::from_le_bytes(hash).rotate_left(64), hash, file.header_start()));
    }
    entries.sort_unstable_by_key(|(order, ..)| *order);
    Ok(entries.iter().flat_map(|(_, hash, at)| hash.iter().copied().chain(at.to_le_bytes())).collect())
}

#[cfg(test)]
mod tests {
    use terrane::fetch::{FileReader, Limits};

    use super::*;

    #[test]
    fn archive_has_the_content_of_its_folder() {
        let folder = tempfile::tempdir().unwrap();
        let set = folder.path().join("set");
        std::fs::create_dir_all(set.join("1/0")).unwrap();
        std::fs::write(set.join("tileset.json"), "{}").unwrap();
        std::fs::write(set.join("1/0/0.glb"), "mesh").unwrap();
        let archive = folder.path().join("set.3tz");
        write(&set, &archive).unwrap();
        let reader = FileReader::new(Limits::default());
        let read = |name: &str| reader.read(archive.join(name).to_str().unwrap());
        assert_eq!(read("tileset.json").unwrap(), b"{}");
        assert_eq!(read("1/0/0.glb").unwrap(), b"mesh");
        assert!(read("1/0/1.glb").is_err());
        // The index is the last file, and sorted.
        let bytes = std::fs::read(&archive).unwrap();
        let at = bytes.windows(INDEX.len()).position(|w| w == INDEX.as_bytes()).unwrap() + INDEX.len();
        let order = |entry: &[u8]| u128::from_le_bytes(entry[..16].try_into().unwrap()).rotate_left(64);
        assert!(order(&bytes[at..at + 24]) < order(&bytes[at + 24..at + 48]));
    }
}
