//! OpenSceneGraph's own files, .osgb, .osgt, .ive and .osg, and the folders of oblique photogrammetry that are made of them.
//!
//! [`input`] reads values in both encodings, [`classes`] the members of OSG's classes, [`ive`] and [`dot_osg`] the older
//! binary and text formats, and [`build`] makes nodes of the objects. A PagedLOD or ProxyNode becomes the node of the same name, whose other files the pager loads. Layouts follow
//! OSG's `src/osgDB/InputStream.cpp` and `src/osgWrappers/serializers/osg`. Decode threads.

mod build;
mod classes;
mod dot_osg;
mod error;
mod file_names;
mod folder;
mod input;
mod ive;
mod motion;
mod objects;
mod read_ahead;
mod text;

use std::sync::Arc;

use glam::{DAffine3, DMat3, DVec3};

pub(super) use self::build::{InlinePart, TerrainBelow};
pub(super) use self::folder::{is_metadata, read_folder, reference_system, tile_files};
pub use self::read_ahead::ReadAhead;

use self::build::Source;
use self::folder::earth_from_system;
use self::objects::{NodeClass, Object, TerrainSettings};
use super::ignored::Notes;
use super::options::{Fetched, ReadOptions};
use super::tile::TileVolume;
use crate::fetch::IoError;
use crate::math::OrientedBox;
use crate::scene::Node;

/// Returns true for the first bytes of an .osgb, .osgt, .ive or .osg file.
pub(super) fn is_native(bytes: &[u8]) -> bool {
    input::is_native(bytes) || ive::is_ive(bytes) || dot_osg::is_dot_osg(bytes)
}

/// Reads a file. `base` is the address that references are relative to, `companions` are the images that it refers to, `below`
/// says what Terrain is above it.
pub(super) fn read(
    (uri, base): (&Arc<str>, &str),
    bytes: &[u8],
    companions: &[Fetched],
    below: Option<&TerrainBelow>,
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
    let above = below.map_or(TerrainSettings::default(), |below| below.settings);
    let node = build::node_of_file(&file.root, above, Source { uri, base, companions, options, notes })?;
    Ok(match set_from_file(&file.root, options, notes) {
        Some(map) => Node::transform(map, vec![node]),
        None => node,
    })
}

/// Returns the map from the coordinate system of a file that is a whole set, such as the projection of a terrain: to the earth
/// if the system is known, and else to the surroundings of the origin. `None` if it stays as it is.
fn set_from_file(root: &Object, options: &ReadOptions, notes: &Notes) -> Option<DAffine3> {
    /// Sets that are farther from the origin count as earth-centred, metres.
    const MAX_LOCAL_M: f64 = 1e6;
    let Object::Node(node) = root else { return None };
    let (NodeClass::CoordinateSystem(system) | NodeClass::Terrain(_, system)) = &node.class else { return None };
    if system.is_empty() || !options.chain.is_empty() {
        return None;
    }
    let center = build::sphere_of_file(root).center;
    let map = earth_from_system(system, center);
    if map.is_none() && center.length() > MAX_LOCAL_M {
        notes.add("OpenSceneGraph: an unknown coordinate system (what it has is drawn around the origin)");
        return Some(DAffine3::from_translation(-center));
    }
    map
}

/// Returns the references to the external images of a file; none if it is invalid.
pub(super) fn references(bytes: &[u8], options: &ReadOptions) -> Vec<String> {
    let file = options.read_ahead.file(bytes, &options.limits);
    file.map_or(Vec::new(), |file| build::external_images(&file.root))
}

/// Returns a box around the objects of a file that no tile declares a volume for, and the geometric error that overlays
/// choose their resolution by. `None` for other formats and for files without a bound.
pub(super) fn own_volume(bytes: &[u8], options: &ReadOptions) -> Option<TileVolume> {
    /// Twice the error over the 16 pixels of a screen error is a texel, so that the file is some 1,000 texels wide.
    const RADIUS_PER_ERROR: f64 = 64.0;
    if !is_native(bytes) {
        return None;
    }
    let file = options.read_ahead.file(bytes, &options.limits).ok()?;
    let sphere = build::sphere_of_file(&file.root);
    if sphere.is_empty() {
        return None;
    }
    let sphere = match set_from_file(&file.root, options, &Notes::default()) {
        Some(map) => sphere.transformed(&map),
        None => sphere,
    };
    let sphere = sphere.transformed(&options.set_from_content);
    let half_axes = DMat3::from_diagonal(DVec3::splat(sphere.radius_m));
    let bounds = OrientedBox { center: sphere.center, half_axes };
    Some(TileVolume { bounds, geometric_error_m: sphere.radius_m / RADIUS_PER_ERROR })
}

/// Returns the name of a file's format with the version of OSG that wrote it, or of the format for .ive.
pub(super) fn format_name(bytes: &[u8], options: &ReadOptions) -> String {
    if dot_osg::is_dot_osg(bytes) {
        return "OpenSceneGraph (osg)".to_owned();
    }
    let encoding = match bytes.first() {
        _ if ive::is_ive(bytes) => "ive",
        Some(b'#') => "osgt",
        _ => "osgb",
    };
    match options.read_ahead.file(bytes, &options.limits) {
        Ok(file) => format!("OpenSceneGraph ({encoding}, version {})", file.version),
        Err(_) => format!("OpenSceneGraph ({encoding})"),
    }
}
