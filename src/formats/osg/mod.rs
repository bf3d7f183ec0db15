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

use std::sync::Arc;

pub(super) use self::build::InlinePart;
pub(super) use self::folder::{is_metadata, read_folder, tile_files};
pub(super) use self::input::is_native;

use self::build::Source;
use self::classes::read_file;
use super::ignored::Notes;
use super::options::{Fetched, ReadOptions};
use crate::fetch::{IoError, Limits};
use crate::math::BoundingSphere;
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
    let file = read_file(bytes, &options.limits, &|kind| notes.add(kind)).map_err(|error| error.at(uri))?;
    build::node_of_file(&file.root, Source { uri, base, companions, options, notes })
}

/// Returns the references to the external images of a file; none if it is invalid.
pub(super) fn references(bytes: &[u8], limits: &Limits) -> Vec<String> {
    let file = read_file(bytes, limits, &|_| {});
    file.map_or(Vec::new(), |file| build::external_images(&file.root))
}

/// Returns the sphere around what a file holds, as its levels of detail declare it; `None` if it is unknown.
fn sphere_of(bytes: &[u8], limits: &Limits) -> Option<BoundingSphere> {
    let file = read_file(bytes, limits, &|_| {}).ok()?;
    Some(build::sphere_of_file(&file.root)).filter(|sphere| !sphere.is_empty())
}

/// Returns the name of a file's format with the version of OSG that wrote it.
pub(super) fn format_name(bytes: &[u8], limits: &Limits) -> String {
    let encoding = if bytes.starts_with(b"#") { "osgt" } else { "osgb" };
    match read_file(bytes, limits, &|_| {}) {
        Ok(file) => format!("OpenSceneGraph ({encoding}, version {})", file.version),
        Err(_) => format!("OpenSceneGraph ({encoding})"),
    }
}
