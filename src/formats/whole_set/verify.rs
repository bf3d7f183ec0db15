//! Reads and decodes a whole tile set as the pager would, for `terrane info --verify`. One content at a time; blocking.

use std::collections::{BTreeMap, HashSet};
use std::sync::Arc;

use serde::Serialize;

use super::overlay::verify_overlay;
use super::report::{InfoError, record, too_many};
use super::tree::{load, read_companions};
#[cfg(feature = "http")]
use crate::fetch::HttpConfig;
use crate::fetch::{IoError, Limits, Loaded, Source, root_uri};
use crate::formats::options::{Content, Fetched, ReadOptions};
use crate::formats::osg;
use crate::formats::overlay;
use crate::formats::read::{self, decode, decode_node};
use crate::formats::terrain::{self, TerrainPage};
use crate::formats::tileset;
use crate::scene::{Node, NodeKind, ReaderData};

/// The result of [`verify`].
#[derive(Clone, Debug, Default, Serialize)]
pub struct Verified {
    /// Number of contents, decoded or failed.
    pub contents: u64,
    /// Bytes read: contents, their companions, and tilesets.
    pub bytes: u64,
    /// Number of failed contents, companions and tilesets.
    pub failed: u64,
    /// The first thousand failures.
    pub errors: Vec<InfoError>,
    /// The properties that contents have and their readers leave out, counted by kind.
    pub ignored: BTreeMap<String, u64>,
}

/// A content that must still be read.
struct Job {
    uri: Arc<str>,
    reader_data: Option<ReaderData>,
    /// The options for the contents of its tileset.
    options: ReadOptions,
    is_tileset: bool,
    /// True if a file of OpenSceneGraph refers to it: it is read once, however many files do.
    is_read_once: bool,
}

/// Reads and decodes every content of a tile set, and calls `progress` after each. Fails only if the root cannot be read.
pub fn verify(source: &str, limits: &Limits, progress: &mut dyn FnMut(&Verified)) -> Result<Verified, IoError> {
    let root = root_uri(source)?;
    verify_from(&root, limits, &Source::new(*limits, &root), progress)
}

/// Like [`verify`], with a configuration for servers.
#[cfg(feature = "http")]
pub fn verify_with(
    source: &str,
    limits: &Limits,
    http: HttpConfig,
    progress: &mut dyn FnMut(&Verified),
) -> Result<Verified, IoError> {
    let root = root_uri(source)?;
    verify_from(&root, limits, &Source::new(*limits, &root).with_http(http), progress)
}

fn verify_from(
    root: &Arc<str>,
    limits: &Limits,
    from: &Source,
    progress: &mut dyn FnMut(&Verified),
) -> Result<Verified, IoError> {
    // Metadata that is invalid is named too.
    let options = ReadOptions { keep_features: true, ..ReadOptions::for_root(root, *limits) };
    let (mut verified, mut jobs) = (Verified::default(), Vec::new());
    let Loaded { bytes, location, .. } = from.load(root)?;
    if let Some(document) = overlay::describe(&bytes) {
        return verify_overlay(root, &bytes, document, (from, limits), progress);
    }
    let mut options = ReadOptions { base: location, ..options };
    verified.bytes += bytes.len() as u64;
    let limit = limits.max_elements as u64;
    let mut nodes = 0;
    if tileset::is_tileset(root, &bytes, limits) || terrain::is_layer(root, &bytes, limits) {
        let companions = read_companions(from, root, &bytes, None, &mut options, &mut verified.bytes);
        verified.fail_each(&companions);
        let content = Content { uri: root.clone(), bytes, reader_data: None, companions };
        nodes = collect(&decode_node(content, &options)?, &options.below(root), &mut jobs);
    } else {
        verified.bytes = 0;
        let (reader_data, options) = (None, options.clone());
        jobs.push(Job { uri: root.clone(), reader_data, options, is_tileset: false, is_read_once: false });
    }
    let mut known = HashSet::new();
    while let Some(job) = jobs.pop() {
        // A file that contains itself is read once more, and fails.
        if job.is_read_once && !job.options.chain.contains(&job.uri) && !known.insert(job.uri.clone()) {
            continue;
        }
        if nodes > limit {
            verified.fail(&too_many(root, limit));
            break;
        }
        match verified.read(from, job, &mut jobs) {
            Ok(more) => nodes += more,
            Err(error) => verified.fail(&error),
        }
        progress(&verified);
    }
    let ignored = options.ignored.snapshot();
    verified.ignored = ignored.iter().map(|(kind, count)| (kind.to_owned(), count)).collect();
    Ok(verified)
}

impl Verified {
    pub(super) fn fail(&mut self, error: &IoError) {
        record(error, &mut self.failed, &mut self.errors);
    }

    /// Lists the files that a tileset refers to and that cannot be read. The tileset is read without them.
    fn fail_each(&mut self, files: &[Fetched]) {
        files.iter().filter_map(|(_, read)| read.as_ref().err()).for_each(|error| self.fail(error));
    }

    /// Reads a content. Returns the number of nodes if it is a part of the tile tree, and 0 otherwise.
    fn read(&mut self, from: &Source, job: Job, jobs: &mut Vec<Job>) -> Result<u64, IoError> {
        let Job { uri, reader_data, options, is_tileset, .. } = job;
        let data = reader_data.as_ref();
        let (is_in_memory, continues) =
            (data.is_some_and(ReaderData::is_whole_content), data.is_some_and(ReaderData::continues_tileset));
        let loaded = if is_in_memory { Ok(Loaded::default()) } else { load(from, &uri, data) };
        // The name of a tileset may have any file extension.
        let is_one = |loaded: &Loaded| tileset::is_tileset(&uri, &loaded.bytes, &options.limits);
        let is_osg = |loaded: &Loaded| osg::is_native(&loaded.bytes) || osg::is_metadata(&loaded.bytes);
        let is_osg = loaded.as_ref().is_ok_and(is_osg);
        let is_tileset = (is_tileset && !is_osg) || loaded.as_ref().is_ok_and(is_one);
        let is_file = data.and_then(ReaderData::value::<osg::InlinePart>).is_some_and(osg::InlinePart::is_file);
        self.contents += u64::from(!is_tileset && (!continues || is_file));
        let Loaded { bytes, location, is_no_content, .. } = loaded?;
        self.bytes += bytes.len() as u64;
        // Other contents of the same tile are read without it.
        let is_joined = data.is_some_and(|data| data.text().is_none()) && !read::companions(&uri, data).is_empty();
        if is_no_content && !is_joined && !data.is_some_and(ReaderData::needs_content) {
            return Ok(0);
        }
        let mut options = ReadOptions { base: location, ..options };
        let companions = read_companions(from, &uri, &bytes, data, &mut options, &mut self.bytes);
        if is_tileset {
            self.fail_each(&companions);
        }
        let content = Content { bytes, uri: uri.clone(), reader_data, companions };
        if continues {
            return Ok(collect(&decode_node(content, &options)?, &options, jobs));
        }
        if is_tileset || is_osg {
            let node = decode_node(content, &options)?;
            let first = jobs.len();
            let nodes = collect(&node, &options.below(&uri), jobs);
            jobs[first..].iter_mut().for_each(|job| job.is_read_once = is_osg);
            return Ok(nodes);
        }
        decode(content, &options).map(|_| 0)
    }
}

/// Adds a job for each content that the nodes of a tile tree refer to. Returns the number of nodes.
fn collect(node: &Node, options: &ReadOptions, jobs: &mut Vec<Job>) -> u64 {
    let mut push = |uri: &Arc<str>, reader_data: Option<ReaderData>, is_tileset: bool| {
        let (uri, options) = (uri.clone(), options.clone());
        jobs.push(Job { uri, reader_data, options, is_tileset, is_read_once: false });
    };
    match &node.kind {
        NodeKind::PagedLod(tile) => {
            let page = tile.reader_data.as_ref().and_then(ReaderData::value::<TerrainPage>);
            // The ellipsoid has no files, and its levels continue to a very fine one.
            let is_ellipsoid = page.is_some_and(TerrainPage::is_ellipsoid);
            if let Some(uri) = tile.content.as_ref().filter(|_| !is_ellipsoid) {
                push(uri, tile.reader_data.clone(), false);
            }
        }
        NodeKind::ProxyNode(proxy) => push(&proxy.uri, None, true),
        _ => {}
    }
    1 + node.children.iter().map(|child| collect(child, options, jobs)).sum::<u64>()
}
