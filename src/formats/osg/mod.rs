//! OpenSceneGraph's own files, .osgb and .osgt, and the folders of oblique photogrammetry that are made of them.
//!
//! [`input`] reads values in both encodings, [`classes`] the members of OSG's classes, and [`build`] makes nodes of the
//! objects. A PagedLOD or ProxyNode becomes the node of the same name, whose other files the pager loads. Layouts follow
//! OSG's `src/osgDB/InputStream.cpp` and `src/osgWrappers/serializers/osg`. Decode threads.

mod build;
mod classes;
mod error;
mod folder;
mod input;
mod objects;
mod read_ahead;

use std::sync::Arc;

pub(super) use self::build::InlinePart;
pub(super) use self::folder::{is_metadata, read_folder, reference_system, tile_files};
pub(super) use self::input::is_native;
pub use self::read_ahead::ReadAhead;

use self::build::Source;
use super::ignored::Notes;
use super::options::{Fetched, ReadOptions};
use crate::fetch::IoError;
use crate::scene::Node;

/// Reads a file. `base` is the address that references are relative to, `companions` are the images that it refers to.
pub(super) fn read(
    (uri, base): (&Arc<str>, &str),
    bytes: &[u8],
    companions: &[Fetched],
    options: &ReadOptions,
    notes: &Notes,
) -> Result<Node, IoError> {
    if options.chain.iter().any(|above| above == uri) {
        return Err(IoError::unsupported(uri, "the file contains itself"));
    }
    let (got, limit) = (options.chain.len() as u64, u64::from(options.limits.max_depth));
    if got >= limit {
        return Err(IoError::TooLarge { uri: uri.to_string(), what: "depth of files", got: got + 1, limit });
    }
    let file = options.read_ahead.take(bytes, &options.limits).map_err(|error| error.at(uri))?;
    notes.merge(&file.ignored);
    build::node_of_file(&file.root, Source { uri, base, companions, options, notes })
}

/// Returns the references to the external images of a file; none if it is invalid.
pub(super) fn references(bytes: &[u8], options: &ReadOptions) -> Vec<String> {
    let file = options.read_ahead.file(bytes, &options.limits);
    file.map_or(Vec::new(), |file| build::external_images(&file.root))
}

/// Returns the name of a file's format with the version of OSG that wrote it.
pub(super) fn format_name(bytes: &[u8], options: &ReadOptions) -> String {
    let encoding = if bytes.starts_with(b"#") { "osgt" } else { "osgb" };
    match options.read_ahead.file(bytes, &options.limits) {
        Ok(file) => format!("OpenSceneGraph ({encoding}, version {})", file.version),
        Err(_) => format!("OpenSceneGraph ({encoding})"),
    }
}
