//! The files that contents refer to: external buffers and images of a glTF, the model of an i3dm, the images of an OSG file,
//! and the schemas of glTF and tilesets. CPU only; any thread.

use std::sync::Arc;

use super::options::{Fetched, ReadOptions};
use super::{b3dm, cmpt, gltf, i3dm, osg, terrain, tileset};
use crate::fetch::markup::text_and_first_byte;
use crate::fetch::{encoding, guarded, resolve};

/// Returns the files that a model or a tileset refers to, known or not. `base` is the address that references are relative to.
pub(super) fn of_model(base: &str, bytes: &[u8], known: &[Fetched], options: &ReadOptions) -> Vec<Arc<str>> {
    match bytes.starts_with(&[0x1f, 0x8b]) {
        true => {
            let plain = encoding::gunzip(base, bytes.to_vec(), &options.limits);
            plain.map_or(Vec::new(), |plain| of_part(base, &plain, known, options, 0))
        }
        false => of_part(base, bytes, known, options, 0),
    }
}

/// Returns the files of a model inside `depth` composites.
fn of_part(base: &str, bytes: &[u8], known: &[Fetched], options: &ReadOptions, depth: u32) -> Vec<Arc<str>> {
    let of_gltf = |bytes: &[u8]| -> Vec<Arc<str>> {
        let references = gltf::references(base, bytes, options);
        references.iter().filter_map(|reference| resolve(base, reference, &options.root).ok()).collect()
    };
    let of_application = || Ok(options.reader_of(base, bytes).map(|reader| reader.references(base, bytes)));
    // A reader that panics has no files here; it panics again in the decoder, which reports it.
    match guarded(base, of_application) {
        Ok(None) => {}
        Ok(Some(references)) => {
            return references.iter().filter_map(|reference| resolve(base, reference, &options.root).ok()).collect();
        }
        Err(_) => return Vec::new(),
    }
    let (text, first) = text_and_first_byte(bytes);
    match bytes.get(..4) {
        Some(b"glTF") => of_gltf(bytes),
        Some(b"b3dm") => b3dm::unwrap(base, bytes, &options.limits).map_or(Vec::new(), |b3dm| of_gltf(b3dm.glb)),
        Some(b"i3dm") => i3dm::dependencies(base, bytes, known, options),
        Some(b"cmpt") => {
            let parts = cmpt::parts(base, bytes, depth).unwrap_or_default();
            parts.into_iter().flat_map(|part| of_part(base, part, known, options, depth + 1)).collect()
        }
        _ if osg::is_native(bytes) => {
            let references = osg::references(bytes, options);
            references.iter().filter_map(|reference| resolve(base, reference, &options.root).ok()).collect()
        }
        _ if osg::is_metadata(bytes) => osg::tile_files(base, known, options),
        _ if first == Some(b'{') && !begins_like_tileset(text) && terrain::is_layer_text(text) => {
            terrain::parent_files(base, text, known, options)
        }
        _ if first == Some(b'{') => {
            let schema = tileset::schema_reference(text, &options.limits);
            let schema = schema.and_then(|reference| resolve(base, &reference, &options.root).ok());
            // Tilesets may be large, and have no buffers.
            let files = if begins_like_tileset(text) { Vec::new() } else { of_gltf(text) };
            files.into_iter().chain(schema).collect()
        }
        _ => Vec::new(),
    }
}

/// Returns true if a property that only tilesets have is among the first kilobytes.
pub(super) fn begins_like_tileset(text: &[u8]) -> bool {
    const PROPERTY: &[u8] = b"\"geometricError\"";
    text[..text.len().min(4096)].windows(PROPERTY.len()).any(|window| window == PROPERTY)
}
