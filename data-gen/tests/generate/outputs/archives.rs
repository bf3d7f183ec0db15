//! Archives and gzip files, read back by the library and by the crate `zip`.

use std::io::Read as _;

use md5::{Digest as _, Md5};
use terrane::fetch::Limits;
use terrane::formats::verify;
use terrane_data_gen::{ArchiveFormat, ContentKind, GenArgs, GenError, OutputArgs, run};

use crate::files::files_below;

fn small(out: std::path::PathBuf) -> GenArgs {
    GenArgs { levels: Some(2), size: 10_000.0, content: ContentKind::Mesh, ..GenArgs::new(out) }
}

fn archived(out: std::path::PathBuf) -> GenArgs {
    let output = OutputArgs { archive: Some(ArchiveFormat::ThreeTz), ..OutputArgs::default() };
    GenArgs { output, ..small(out) }
}

#[test]
fn archives_have_the_files_of_folders() {
    let folder = tempfile::tempdir().unwrap();
    let plain = small(folder.path().join("plain"));
    let wanted = run(&plain).unwrap();
    let args = archived(folder.path().join("set.3tz"));
    let summary = run(&args).unwrap();
    assert_eq!((summary.tiles, summary.out.as_path()), (wanted.tiles, &*args.out));
    assert_eq!(summary.bytes, args.out.metadata().unwrap().len());
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 2, "nothing else is left");
    let mut files = files_below(&plain.out);
    let mut zip = zip::ZipArchive::new(std::fs::File::open(&args.out).unwrap()).unwrap();
    let mut last = String::new();
    for k in 0..zip.len() {
        let mut member = zip.by_index(k).unwrap();
        last = member.name().unwrap().into_owned();
        let mut bytes = Vec::new();
        member.read_to_end(&mut bytes).unwrap();
        assert!(last == "@3dtilesIndex1@" || files.remove(&last).unwrap() == bytes, "{last}");
    }
    assert!(files.is_empty() && last == "@3dtilesIndex1@", "{:?}", files.keys());
    let verified = verify(&args.out.to_string_lossy(), &Limits::default(), &mut |_| ()).unwrap();
    assert_eq!((verified.contents, verified.failed), (5, 0), "{verified:?}");
    // Bytes do not depend on the time or the number of threads.
    let before = std::fs::read(&args.out).unwrap();
    check_index(&mut zip, &before);
    assert!(matches!(run(&args), Err(GenError::Exists(_))));
    run(&GenArgs { overwrite: true, jobs: Some(1), ..args.clone() }).unwrap();
    assert!(std::fs::read(&args.out).unwrap() == before);
}

/// Checks that the index has the hash of each name with the offset of its local header, in the order of two little-endian numbers.
fn check_index(zip: &mut zip::ZipArchive<std::fs::File>, archive: &[u8]) {
    let mut index = Vec::new();
    zip.by_name("@3dtilesIndex1@").unwrap().read_to_end(&mut index).unwrap();
    let entries = index.as_chunks::<24>().0;
    assert_eq!(entries.len() + 1, zip.len());
    let number = |bytes: &[u8]| u64::from_le_bytes(bytes.try_into().unwrap());
    assert!(entries.is_sorted_by_key(|entry| [number(&entry[..8]), number(&entry[8..16])]));
    for entry in entries {
        let at = number(&entry[16..]) as usize;
        let length = usize::from(u16::from_le_bytes([archive[at + 26], archive[at + 27]]));
        let name = &archive[at + 30..at + 30 + length];
        assert_eq!((&archive[at..at + 4], Md5::digest(name)[..] == entry[..16]), (&b"PK\x03\x04"[..], true));
    }
}

#[test]
fn archives_replace_archives_only() {
    let folder = tempfile::tempdir().unwrap();
    let args = GenArgs { overwrite: true, ..archived(folder.path().join("set.3tz")) };
    std::fs::write(&args.out, "notes").unwrap();
    let error = run(&args).unwrap_err().to_string();
    assert!(error.contains("is no archive"), "{error}");
    assert_eq!(std::fs::read_to_string(&args.out).unwrap(), "notes");
    for (args, name) in [
        (archived(folder.path().join("set.zip")), "must end in .3tz"),
        (GenArgs { content: ContentKind::QuantizedMesh, ..archived(folder.path().join("a.3tz")) }, "--archive"),
        (
            GenArgs {
                output: OutputArgs { gzip: true, archive: Some(ArchiveFormat::ThreeTz), ..OutputArgs::default() },
                ..small(folder.path().join("b.3tz"))
            },
            "--gzip",
        ),
    ] {
        let error = run(&args).unwrap_err().to_string();
        assert!(error.contains(name), "{error}");
    }
}

#[test]
fn compressed_sets_keep_their_names_and_are_read() {
    let folder = tempfile::tempdir().unwrap();
    let output = OutputArgs { gzip: true, ..OutputArgs::default() };
    for content in [ContentKind::Height, ContentKind::Mesh, ContentKind::QuantizedMesh] {
        let levels = Some(if content == ContentKind::QuantizedMesh { 12 } else { 2 });
        let plain = GenArgs { content, levels, ..small(folder.path().join(format!("plain-{content:?}"))) };
        let args = GenArgs { output: output.clone(), out: folder.path().join(format!("{content:?}")), ..plain.clone() };
        run(&plain).unwrap();
        let summary = run(&args).unwrap();
        let (plain, packed) = (files_below(&plain.out), files_below(&args.out));
        assert_eq!(summary.bytes, packed.values().map(|bytes| bytes.len() as u64).sum::<u64>());
        assert!(plain.keys().eq(packed.keys()));
        for (name, bytes) in &packed {
            let is_image = name.ends_with("exr") || name.ends_with("jpg");
            assert_eq!(bytes.starts_with(&[0x1f, 0x8b]), !is_image, "{name}");
        }
        let verified = verify(&args.out.to_string_lossy(), &Limits::default(), &mut |_| ()).unwrap();
        assert!(verified.failed == 0 && verified.contents > 2, "{verified:?}");
    }
}
