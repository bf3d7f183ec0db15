//! Reading all of a tile set as the pager would: for `terrane info --verify`. Blocking; one content after the other.

use std::sync::Arc;

use serde::Serialize;

use super::{
    Content, InfoError, IoError, Limits, ReadOptions, Source, companions, decode, decode_node, root_uri, shown,
};
use crate::io::info::{TOLD, too_many};
use crate::io::read;
use crate::scene::{Node, NodeKind};

/// What reading everything came to.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Verified {
    /// Contents that were read and decoded, or failed.
    pub contents: u64,
    /// Bytes read: contents, what came with them, and tilesets.
    pub bytes: u64,
    /// Contents, tilesets and what came with them that failed.
    pub failed: u64,
    /// The first thousand of them.
    pub errors: Vec<InfoError>,
}

/// What is still to be read.
struct Job {
    uri: Arc<str>,
    reader_data: Option<Arc<str>>,
    options: ReadOptions,
    is_tileset: bool,
}

/// Reads and decodes every content of a set. `progress` is called after each. Fails only when the root cannot be read.
pub fn verify(source: &str, limits: &Limits, progress: &mut dyn FnMut(&Verified)) -> Result<Verified, IoError> {
    verify_from(source, limits, &Source::new(*limits), progress)
}

/// [`verify`], for a source on a server that is talked to in a certain way.
#[cfg(feature = "http")]
pub fn verify_with(
    source: &str,
    limits: &Limits,
    http: super::HttpConfig,
    progress: &mut dyn FnMut(&Verified),
) -> Result<Verified, IoError> {
    verify_from(source, limits, &Source::with_http(*limits, http), progress)
}

fn verify_from(
    source: &str,
    limits: &Limits,
    from: &Source,
    progress: &mut dyn FnMut(&Verified),
) -> Result<Verified, IoError> {
    let root = root_uri(source)?;
    let options = ReadOptions::for_root(&root, *limits);
    let (mut verified, mut jobs) = (Verified::default(), Vec::new());
    let bytes = from.read(&root)?;
    verified.bytes += bytes.len() as u64;
    let content = Content { uri: root.clone(), bytes, reader_data: None, companions: Vec::new() };
    let limit = limits.max_elements as u64;
    let mut met = collect(&decode_node(content, &options)?, &root, &options, &mut jobs);
    while let Some(job) = jobs.pop() {
        if met > limit {
            verified.fail(&too_many(&root, limit));
            break;
        }
        match verified.read(from, job, &mut jobs) {
            Ok(more) => met += more,
            Err(error) => verified.fail(&error),
        }
        progress(&verified);
    }
    Ok(verified)
}

impl Verified {
    fn fail(&mut self, error: &IoError) {
        self.failed += 1;
        if self.errors.len() < TOLD {
            self.errors.push(InfoError { uri: shown(error.uri()).into_owned(), reason: error.reason() });
        }
    }

    /// Returns how many tiles and tilesets that has brought.
    fn read(&mut self, from: &Source, job: Job, jobs: &mut Vec<Job>) -> Result<u64, IoError> {
        let Job { uri, reader_data, options, is_tileset } = job;
        let mut fetch = |uri: &Arc<str>| {
            let bytes = from.read(uri)?;
            self.bytes += bytes.len() as u64;
            Ok(bytes)
        };
        let companions = if is_tileset { Vec::new() } else { companions(&uri, reader_data.as_ref()) };
        let companions = companions.into_iter().map(|of| (of.clone(), fetch(&of))).collect();
        let bytes = fetch(&uri);
        // Its name need not say it.
        let is_one = |bytes: &Vec<u8>| read::is_tileset(&uri, bytes, &options.limits);
        let is_tileset = is_tileset || bytes.as_ref().is_ok_and(is_one);
        self.contents += u64::from(!is_tileset);
        let content = Content { bytes: bytes?, uri: uri.clone(), reader_data, companions };
        if is_tileset {
            return Ok(collect(&decode_node(content, &options)?, &uri, &options, jobs));
        }
        decode(content, &options).map(|_| 0)
    }
}

/// What a tileset's nodes name. Returns how many nodes there are.
fn collect(node: &Node, tileset: &Arc<str>, options: &ReadOptions, jobs: &mut Vec<Job>) -> u64 {
    let mut push = |uri: &Arc<str>, reader_data: Option<Arc<str>>, is_tileset: bool| {
        jobs.push(Job { uri: uri.clone(), reader_data, options: options.below(tileset), is_tileset });
    };
    match &node.kind {
        NodeKind::PagedLod(tile) => {
            if let Some(uri) = &tile.content {
                push(uri, tile.reader_data.clone(), false);
            }
        }
        NodeKind::ProxyNode(proxy) => push(&proxy.uri, None, true),
        _ => {}
    }
    1 + node.children.iter().map(|child| collect(child, tileset, options, jobs)).sum::<u64>()
}
