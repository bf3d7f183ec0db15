//! Filling the cache with a part of a tile set before anybody flies there; OSG's `osgfilecache`.
//!
//! What is kept already is not asked for again, so that a run that was stopped goes on where it was.

mod extent;

use std::collections::HashSet;
use std::ops::{ControlFlow, RangeInclusive};
use std::sync::Arc;
use std::time::Duration;

use glam::DAffine3;
use tokio::task::JoinSet;

use super::{
    CacheStats, Content, HttpClient, HttpConfig, IoError, Limits, ReadOptions, RootScope, companions, decode_node,
    http, is_remote, root_uri, shown,
};
use crate::io::read::refuse_markup;
use crate::io::tileset::TILE_OF_SEVERAL;
use crate::math::{BoundingVolume, Region};
use crate::scene::{Node, NodeKind};

/// Failures that are told one by one.
const TOLD: usize = 100;

/// What to fetch.
#[derive(Clone, Debug)]
pub struct FillOptions {
    /// Tiles over this region of the earth; heights do not count. `None` for all.
    pub region: Option<Region>,
    /// Levels of the tree, root 0; the root of an external tileset is one below the tile that names it.
    pub levels: RangeInclusive<u32>,
    /// Requests at once.
    pub in_flight: usize,
    /// Ask again about what is kept.
    pub refresh: bool,
    /// How much is accepted from outside.
    pub limits: Limits,
}

impl Default for FillOptions {
    fn default() -> Self {
        Self { region: None, levels: 0..=u32::MAX, in_flight: 16, refresh: false, limits: Limits::default() }
    }
}

/// How far it is; at the end, what was done.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Filled {
    /// Files that belong to what was asked for, as far as they are known: contents, imagery, tilesets.
    pub found: u64,
    /// Those that were kept already.
    pub kept: u64,
    /// Those that came.
    pub fetched: u64,
    /// Those that did not.
    pub failed: u64,
    /// Bytes that came over the network.
    pub bytes: u64,
    /// The first of the failures: URI, as [`shown`] has it, and reason.
    pub errors: Vec<(String, String)>,
    /// Stopped before the end.
    pub stopped: bool,
    /// What the cache did; filled in at the end.
    pub cache: CacheStats,
}

/// A tileset with its place in the tree.
#[derive(Clone)]
struct Tileset {
    level: u32,
    world: DAffine3,
    chain: Arc<[Arc<str>]>,
}

/// A file to fetch; with what is below it if it is a tileset.
struct Job {
    uri: Arc<str>,
    tileset: Option<Tileset>,
}

struct Done {
    job: Job,
    /// The bytes of a tileset; empty for others.
    result: Result<Vec<u8>, IoError>,
    was_kept: bool,
    network_bytes: u64,
}

struct Fill<'a> {
    options: &'a FillOptions,
    scope: RootScope,
    filled: Filled,
    /// Last in, first out: what lies below a tile comes before its neighbours, which keeps this short.
    jobs: Vec<Job>,
    /// What was asked for, so that a file with several names in the tree comes once.
    seen: HashSet<Arc<str>>,
}

/// The longest pause of a server that is waited for.
const PATIENCE: Duration = Duration::from_secs(600);
/// The longest time between two calls of `progress`.
const LOOK: Duration = Duration::from_millis(100);

/// Fetches a part of the tile set at a URL into the cache of the configuration. `progress` is called on this thread
/// after each file, and meanwhile ten times a second; with `Break` it stops at once: what is under way is given up, what
/// has come is kept. Fails only for a root that cannot be read, or without a cache.
pub fn fill(
    source: &str,
    config: &HttpConfig,
    options: &FillOptions,
    progress: &mut dyn FnMut(&Filled) -> ControlFlow<()>,
) -> Result<Filled, IoError> {
    let root = root_uri(source)?;
    if !is_remote(&root) {
        return Err(IoError::Uri { uri: root.to_string(), reason: "only what is on a server is cached".to_owned() });
    }
    // Nobody looks at a picture meanwhile: a server that asks for a pause gets it.
    let client = HttpClient::new(&HttpConfig { max_wait: config.max_wait.max(PATIENCE), ..config.clone() })?;
    let client = if options.refresh { client.asking() } else { client };
    if client.cache().is_none() {
        return Err(IoError::Uri { uri: root.to_string(), reason: "there is no cache to fill".to_owned() });
    }
    let runtime = http::runtime("fill");
    let runtime = runtime.map_err(|e| IoError::Network { uri: root.to_string(), reason: e.to_string() })?;
    let tileset = Tileset { level: 0, world: DAffine3::IDENTITY, chain: Arc::new([]) };
    let mut fill = Fill {
        options,
        scope: RootScope::of(&root),
        filled: Filled::default(),
        jobs: Vec::new(),
        seen: HashSet::new(),
    };
    fill.push(root.clone(), Some(tileset));
    let end = runtime.block_on(async {
        let end = fill.run(&client, &root, progress).await;
        client.flush().await;
        end
    });
    // Looking up a server's name cannot be given up; nobody waits for it.
    runtime.shutdown_background();
    end?;
    fill.filled.cache = client.cache().map(|cache| cache.stats()).unwrap_or_default();
    Ok(fill.filled)
}

impl Fill<'_> {
    async fn run(
        &mut self,
        client: &HttpClient,
        root: &Arc<str>,
        progress: &mut dyn FnMut(&Filled) -> ControlFlow<()>,
    ) -> Result<(), IoError> {
        let mut tasks: JoinSet<Done> = JoinSet::new();
        loop {
            while !self.filled.stopped
                && tasks.len() < self.options.in_flight.max(1)
                && let Some(job) = self.jobs.pop()
            {
                let (client, limits, refresh) = (client.clone(), self.options.limits, self.options.refresh);
                tasks.spawn(async move { fetch(&client, job, &limits, refresh).await });
            }
            match tokio::time::timeout(LOOK, tasks.join_next()).await {
                Ok(None) => return Ok(()),
                Ok(Some(Ok(done))) => self.take(client, done, root)?,
                // Given up.
                Ok(Some(Err(_))) => continue,
                Err(_) => {}
            }
            let is_over = self.jobs.is_empty() && tasks.is_empty();
            if !self.filled.stopped && progress(&self.filled).is_break() && !is_over {
                self.filled.stopped = true;
                tasks.abort_all();
            }
        }
    }

    fn take(&mut self, client: &HttpClient, done: Done, root: &Arc<str>) -> Result<(), IoError> {
        self.filled.bytes += done.network_bytes;
        let result = done.result.and_then(|bytes| match &done.job.tileset {
            Some(tileset) => self.tileset(&done.job.uri, bytes, tileset),
            None => refuse_markup(&done.job.uri, &bytes),
        });
        if let Some(cache) = client.cache()
            && result.as_ref().is_err_and(IoError::is_no_content)
        {
            // An error page, say: asked for again next time.
            cache.forget(&done.job.uri);
        }
        match result {
            Ok(()) if done.was_kept => self.filled.kept += 1,
            Ok(()) => self.filled.fetched += 1,
            Err(error) if done.job.uri == *root => return Err(error),
            Err(error) => {
                self.filled.failed += 1;
                if self.filled.errors.len() < TOLD {
                    self.filled.errors.push((shown(error.uri()).into_owned(), error.reason()));
                }
            }
        }
        Ok(())
    }

    fn push(&mut self, uri: Arc<str>, tileset: Option<Tileset>) {
        if self.seen.insert(uri.clone()) {
            self.filled.found += 1;
            self.jobs.push(Job { uri, tileset });
        }
    }

    fn tileset(&mut self, uri: &Arc<str>, bytes: Vec<u8>, tileset: &Tileset) -> Result<(), IoError> {
        let options = ReadOptions {
            root: self.scope.clone(),
            limits: self.options.limits,
            chain: tileset.chain.clone(),
            // Regions are wanted as they are.
            set_from_content: DAffine3::IDENTITY,
            build_kd_trees: false,
            sharing: None,
        };
        let content = Content { uri: uri.clone(), bytes, reader_data: None, companions: Vec::new() };
        let node = decode_node(content, &options)?;
        let is_root = tileset.chain.is_empty();
        if is_root
            && self.options.region.is_some()
            && let NodeKind::PagedLod(tile) = &node.kind
            && !extent::is_on_earth(&tile.bounds, &tileset.world)
        {
            return Err(IoError::unsupported(uri, "a region of a set that is not on the earth"));
        }
        let below = Tileset { chain: options.below(uri).chain, ..tileset.clone() };
        self.node(&node, &below);
        Ok(())
    }

    fn node(&mut self, node: &Node, tileset: &Tileset) {
        match &node.kind {
            NodeKind::PagedLod(tile) if node.name == TILE_OF_SEVERAL => {
                if self.is_wanted(&tile.bounds, tileset) {
                    // One tile of the tileset.
                    for child in &node.children {
                        self.node(child, tileset);
                    }
                }
                return;
            }
            NodeKind::PagedLod(tile) => {
                if !self.is_wanted(&tile.bounds, tileset) {
                    return;
                }
                if let Some(uri) = tile.content.as_ref().filter(|_| self.options.levels.contains(&tileset.level)) {
                    for companion in companions(uri, tile.reader_data.as_ref()) {
                        self.push(companion, None);
                    }
                    self.push(uri.clone(), None);
                }
            }
            NodeKind::ProxyNode(proxy) => {
                if self.is_wanted(&BoundingVolume::Sphere(proxy.bounds), tileset) {
                    let world = tileset.world * proxy.content_transform;
                    self.push(proxy.uri.clone(), Some(Tileset { world, ..tileset.clone() }));
                }
                return;
            }
            _ => {}
        }
        let below = Tileset { level: tileset.level + 1, ..tileset.clone() };
        for child in &node.children {
            self.node(child, &below);
        }
    }

    fn is_wanted(&self, bounds: &BoundingVolume, tileset: &Tileset) -> bool {
        tileset.level <= *self.options.levels.end()
            && self.options.region.as_ref().is_none_or(|region| extent::overlaps(bounds, &tileset.world, region))
    }
}

async fn fetch(client: &HttpClient, job: Job, limits: &Limits, refresh: bool) -> Done {
    if !refresh {
        // A tileset has to be read, of others it is enough that they are there.
        let kept = match job.tileset {
            Some(_) => client.kept(&job.uri, limits).await,
            None => client.is_kept(&job.uri).await.then(Vec::new),
        };
        if let Some(bytes) = kept {
            return Done { job, result: Ok(bytes), was_kept: true, network_bytes: 0 };
        }
    }
    match client.get(&job.uri, limits).await {
        Ok(body) => Done {
            job,
            result: Ok(body.bytes),
            was_kept: refresh && body.network_bytes == 0,
            network_bytes: body.network_bytes,
        },
        Err(error) => Done { job, result: Err(error), was_kept: false, network_bytes: 0 },
    }
}
