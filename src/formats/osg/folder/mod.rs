//! Folders of oblique photogrammetry: a `metadata.xml` with the reference system, and `Data/Tile_*/Tile_*.osgb`.
//!
//! The tiles are not listed anywhere, so that the folder `Data` is listed, which only works on disk. Each tile is placed by
//! the map around its centre: a grid is bent over the earth, and one map for all would lift distant tiles.

mod metadata;
mod placement;

use std::sync::Arc;

use glam::{DAffine3, DVec3};

pub(in crate::formats) use self::metadata::is_metadata;

use self::metadata::Metadata;
use self::placement::Placement;
use super::build::{self, HeldFile};
use super::classes::read_file;
use super::file_names::escaped;
use crate::fetch::{IoError, is_remote, resolve};
use crate::formats::ignored::Notes;
use crate::formats::options::{Fetched, ReadOptions};
use crate::math::BoundingSphere;
use crate::scene::{Node, NodeKind, ProxyLoading, ProxyNode};

/// The reference to the list of what is in the folder of the tiles.
const LISTING: &str = "Data/*";
/// The maximum number of tiles whose top files are read for their bounds before anything is drawn. Further ones are drawn
/// and requested from anywhere until they are loaded.
const MAX_READ_FIRST: usize = 512;
/// The maximum number of bytes of the objects of top files that stay in memory. Further ones are read again when they are
/// wanted.
const MAX_HELD_BYTES: u64 = 64 << 20;

/// Returns the files that the metadata of a folder needs: the list of its tiles, and then the top files of the first tiles.
pub(in crate::formats) fn tile_files(base: &str, known: &[Fetched], options: &ReadOptions) -> Vec<Arc<str>> {
    let Ok(listing) = resolve(base, LISTING, &options.root) else { return Vec::new() };
    match known.iter().find(|(uri, _)| *uri == listing) {
        None => vec![listing],
        Some((_, Ok(names))) => {
            let tiles = tiles(names).into_iter().take(MAX_READ_FIRST);
            tiles.filter_map(|tile| resolve(base, &reference(&tile), &options.root).ok()).collect()
        }
        Some((_, Err(_))) => Vec::new(),
    }
}

/// Returns the reference system and the origin that a `metadata.xml` names.
pub(in crate::formats) fn reference_system(bytes: &[u8]) -> Option<(String, [f64; 3])> {
    let Metadata { srs, origin } = Metadata::parse(bytes).ok()?;
    Some((srs, origin.to_array()))
}

/// Returns the names of the tiles in a list of what is in their folder.
fn tiles(names: &[u8]) -> Vec<String> {
    let names = String::from_utf8_lossy(names);
    let folders: Vec<String> = names.lines().filter_map(|name| name.strip_suffix('/')).map(str::to_owned).collect();
    let is_tile = |name: &String| name.get(..5).is_some_and(|start| start.eq_ignore_ascii_case("tile_"));
    if folders.iter().any(is_tile) { folders.into_iter().filter(is_tile).collect() } else { folders }
}

/// Returns the reference to the top file of a tile.
fn reference(tile: &str) -> String {
    let tile = escaped(tile);
    format!("Data/{tile}/{tile}.osgb")
}

/// Returns the map from the surroundings of a point in a reference system, EPSG or WKT, to earth-centred coordinates; `None`
/// if the system is unknown or local.
pub(super) fn earth_from_system(system: &str, near: DVec3) -> Option<DAffine3> {
    match Placement::new(&Metadata { srs: system.to_owned(), origin: DVec3::ZERO }) {
        Ok(Placement::Local) | Err(_) => None,
        Ok(placement) => Some(placement.ecef_from_local(near)),
    }
}

/// Reads the metadata of a folder: one proxy for each tile, placed on the earth.
pub(in crate::formats) fn read_folder(
    (uri, base): (&Arc<str>, &str),
    bytes: &[u8],
    companions: &[Fetched],
    options: &ReadOptions,
    notes: &Notes,
) -> Result<Node, IoError> {
    let metadata = Metadata::parse(bytes).map_err(|reason| IoError::invalid(uri, format!("metadata.xml: {reason}")))?;
    let placement = Placement::new(&metadata)
        .map_err(|what| IoError::unsupported(uri, format!("metadata.xml: reference system {what}")))?;
    if metadata.srs.is_empty() {
        notes.add("oblique photogrammetry: no reference system (its own frame is kept)");
    }
    let listing = resolve(base, LISTING, &options.root)?;
    let names = match companions.iter().find(|(known, _)| *known == listing) {
        Some((_, Ok(names))) => names,
        _ if is_remote(&listing) => {
            return Err(IoError::unsupported(uri, "a folder of tiles on a server, which cannot list them"));
        }
        Some((_, Err(error))) => return Err(error.clone()),
        None => return Err(IoError::NotFound { uri: listing.to_string() }),
    };
    let (mut nodes, mut held_bytes) = (Vec::new(), 0u64);
    for tile in tiles(names) {
        let uri = resolve(base, &reference(&tile), &options.root)?;
        let top = companions.iter().find(|(known, _)| *known == uri).and_then(|(_, top)| top.as_ref().ok());
        // The loader of a broken file reports its error.
        let top = top.and_then(|bytes| read_file(bytes, &options.limits).ok());
        let sphere = top.as_ref().map_or(BoundingSphere::EMPTY, |top| build::sphere_of_file(&top.root));
        let (center, bounds) = match sphere.is_empty() {
            true => (DVec3::ZERO, BoundingSphere::EVERYTHING),
            false => (sphere.center, sphere),
        };
        let held = top.as_ref().and_then(|top| HeldFile::new(&top.root));
        let held = held.filter(|held| held_bytes.saturating_add(held.size_bytes) <= MAX_HELD_BYTES);
        let node = if let (Some(held), Some(top)) = (held, &top) {
            held_bytes += held.size_bytes;
            notes.merge(&top.ignored);
            held.into_tile(&uri, bounds)
        } else {
            let (content_transform, loading) = (DAffine3::IDENTITY, ProxyLoading::DeferToPager);
            Node::new(NodeKind::ProxyNode(Box::new(ProxyNode { uri, bounds, content_transform, loading })))
        };
        nodes.push(Node::transform(placement.ecef_from_local(center), vec![node]).named(&tile));
    }
    if nodes.is_empty() {
        return Err(IoError::invalid(uri, "metadata.xml: no folder of a tile in Data"));
    }
    Ok(Node::group(nodes))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folders_of_tiles_are_found_among_others() {
        assert_eq!(
            tiles(b"Tile_+000_+001/\nnotes.txt\nTile_-001_+000/\nthumbs/\n"),
            ["Tile_+000_+001", "Tile_-001_+000"]
        );
        assert_eq!(tiles(b"a/\nb/\nc.osgb\n"), ["a", "b"]);
        assert!(tiles(b"").is_empty());
        assert_eq!(reference("Tile_+1#2"), "Data/Tile_+1%232/Tile_+1%232.osgb");
    }
}
