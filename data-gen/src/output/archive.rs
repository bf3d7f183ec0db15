//! Writes a folder as a 3D Tiles archive (3D Tiles Archive Format 1.3): a zip file whose last entry is the index of the others
//! by the MD5 hashes of their names. Memory is about 90 bytes for each file; the crate `zip` keeps several hundred, and
//! compresses on one thread.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use flate2::Compression;
use flate2::write::DeflateEncoder;
use md5::{Digest as _, Md5};
use rayon::prelude::*;

use super::set_files::each_folder;
use crate::GenError;

/// The name of the index.
const INDEX: &str = "@3dtilesIndex1@";
/// Extensions of files that are compressed already; they are stored as they are.
const STORED_EXTENSIONS: [&str; 6] = ["jpg", "png", "webp", "ktx2", "exr", "3tz"];
/// Files that are in memory at a time.
const MAX_FILES_AT_A_TIME: usize = 256;
/// The version that is needed to read zip64.
const VERSION: u16 = 45;
const STORED: u16 = 0;
const DEFLATED: u16 = 8;
/// 1 January 1980, the first day of zip: the bytes do not depend on the time.
const DATE: u16 = 0x0021;

/// The content of a file in the archive.
struct Packed {
    name: String,
    method: u16,
    checksum: u32,
    size: u32,
    bytes: Vec<u8>,
}

impl Packed {
    fn new(name: String, content: Vec<u8>) -> std::io::Result<Self> {
        let too_large = || std::io::Error::other("is too large for an archive");
        let (checksum, size) = (crc32fast::hash(&content), u32::try_from(content.len()).map_err(|_| too_large())?);
        let is_packed = Path::new(&name).extension().is_some_and(|e| STORED_EXTENSIONS.iter().any(|of| e == *of));
        let mut packed = Self { name, method: STORED, checksum, size, bytes: content };
        if !is_packed && packed.name != INDEX {
            let mut encoder = DeflateEncoder::new(Vec::new(), Compression::default());
            encoder.write_all(&packed.bytes)?;
            let deflated = encoder.finish()?;
            if deflated.len() < packed.bytes.len() {
                (packed.method, packed.bytes) = (DEFLATED, deflated);
            }
        }
        Ok(packed)
    }

    /// Returns the fields that the local header and the directory have in common, from the version on.
    fn header(&self, extra: u16) -> Vec<u8> {
        let mut out = Vec::with_capacity(26);
        // Flags and time are 0.
        [VERSION, 0, self.method, 0, DATE].iter().for_each(|field| out.extend(field.to_le_bytes()));
        [self.checksum, self.bytes.len() as u32, self.size].iter().for_each(|field| out.extend(field.to_le_bytes()));
        [self.name.len() as u16, extra].iter().for_each(|field| out.extend(field.to_le_bytes()));
        out
    }
}

/// An archive that is written.
struct Writer {
    out: BufWriter<File>,
    offset: u64,
    directory: Vec<u8>,
    count: u64,
    /// The hash of each name as two little-endian numbers, and the offset of the file.
    index: Vec<([u64; 2], u64)>,
}

impl Writer {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<()> {
        self.offset += bytes.len() as u64;
        self.out.write_all(bytes)
    }

    fn add(&mut self, packed: &Packed) -> std::io::Result<()> {
        let offset = self.offset;
        self.write(&0x0403_4b50u32.to_le_bytes())?;
        self.write(&packed.header(0))?;
        self.write(packed.name.as_bytes())?;
        self.write(&packed.bytes)?;
        // An offset of zip64 is in the extra field of the directory.
        let wide = offset >= u64::from(u32::MAX);
        let directory = &mut self.directory;
        directory.extend(0x0201_4b50u32.to_le_bytes());
        directory.extend(VERSION.to_le_bytes());
        directory.extend(packed.header(if wide { 12 } else { 0 }));
        // Comment, disk, and attributes.
        directory.extend([0; 10]);
        directory.extend(if wide { u32::MAX } else { offset as u32 }.to_le_bytes());
        directory.extend(packed.name.as_bytes());
        if wide {
            [1u16, 8].iter().for_each(|field| directory.extend(field.to_le_bytes()));
            directory.extend(offset.to_le_bytes());
        }
        self.count += 1;
        let hash = Md5::digest(packed.name.as_bytes());
        let number = |from: usize| (0..8).rev().fold(0, |number, k| number << 8 | u64::from(hash[from + k]));
        self.index.push(([number(0), number(8)], offset));
        Ok(())
    }

    /// Writes the index and the directory. Returns the size of the archive in bytes.
    fn finish(mut self) -> std::io::Result<u64> {
        let mut entries = std::mem::take(&mut self.index);
        entries.sort_unstable();
        let bytes = entries.iter().flat_map(|([a, b], offset)| [*a, *b, *offset]).flat_map(u64::to_le_bytes);
        self.add(&Packed::new(INDEX.to_owned(), bytes.collect())?)?;
        let (start, directory) = (self.offset, std::mem::take(&mut self.directory));
        self.write(&directory)?;
        let (end, size, count) = (self.offset, directory.len() as u64, self.count);
        let is_wide = start >= u64::from(u32::MAX) || size >= u64::from(u32::MAX) || count >= u64::from(u16::MAX);
        if is_wide {
            let mut wide = 0x0606_4b50u32.to_le_bytes().to_vec();
            wide.extend(44u64.to_le_bytes());
            [VERSION, VERSION].iter().for_each(|field| wide.extend(field.to_le_bytes()));
            wide.extend([0; 8]);
            [count, count, size, start].iter().for_each(|field| wide.extend(field.to_le_bytes()));
            // The locator of the record.
            wide.extend(0x0706_4b50u32.to_le_bytes());
            wide.extend(0u32.to_le_bytes());
            wide.extend(end.to_le_bytes());
            wide.extend(1u32.to_le_bytes());
            self.write(&wide)?;
        }
        let mut last = 0x0605_4b50u32.to_le_bytes().to_vec();
        last.extend([0; 4]);
        let count = if is_wide { u16::MAX } else { count as u16 };
        [count, count].iter().for_each(|field| last.extend(field.to_le_bytes()));
        [size, start]
            .iter()
            .for_each(|field| last.extend(if is_wide { u32::MAX } else { *field as u32 }.to_le_bytes()));
        last.extend([0; 2]);
        self.write(&last)?;
        self.out.flush()?;
        self.out.get_ref().sync_all()?;
        Ok(self.offset)
    }
}

/// Writes the files below a folder into an archive, but not those whose names begin with a dot. Returns its size in bytes.
pub(super) fn write_archive(folder: &Path, archive: &Path) -> Result<u64, GenError> {
    let file = File::create(archive).map_err(GenError::file(archive))?;
    let out = BufWriter::with_capacity(1 << 20, file);
    let mut writer = Writer { out, offset: 0, directory: Vec::new(), count: 0, index: Vec::new() };
    each_folder(folder, &mut |files: &[PathBuf]| {
        for files in files.chunks(MAX_FILES_AT_A_TIME) {
            let pack = |path: &PathBuf| {
                let parts = path.strip_prefix(folder).unwrap_or(path).iter().map(|part| part.to_string_lossy());
                let name = parts.collect::<Vec<_>>().join("/");
                let content = std::fs::read(path).map_err(GenError::file(path))?;
                Packed::new(name, content).map_err(GenError::file(path))
            };
            let packed: Vec<Packed> = files.par_iter().map(pack).collect::<Result<_, GenError>>()?;
            packed.iter().try_for_each(|packed| writer.add(packed)).map_err(GenError::file(archive))?;
        }
        Ok(())
    })?;
    writer.finish().map_err(GenError::file(archive))
}
