//! Filling the cache with a part of a tile set before anybody flies there; OSG's `osgfilecache`.
//!
//! What is kept already is not asked for again, so that a run that was stopped goes on where it was.

mod extent;

use std::collections::{HashMap, HashSet};
use std::ops::{ControlFlow, RangeInclusive};
use std::sync::Arc;
use std::time::Duration;

use glam::DAffine3;
use tokio::task::JoinSet;

use super::{
    CacheStats, Content, HttpClient, HttpConfig, IoError, Limits, ReadOptions, RootScope, companions, decode_node,
    http, is_remote, root_uri, shown,
};
use crate::io::read::{is_tileset, may_be_tileset, refuse_markup};
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
    /// Its name does not say what it is: where it lies if it is a tileset.
    maybe: Option<Box<Tileset>>,
    /// It was counted: a tileset that is met in another place once more.
    is_again: bool,
}

/// A tileset, its level and its transform.
type Place = (Arc<str>, u32, [u64; 12]);

struct Done {
    job: Job,
    /// The bytes of what is a tileset, or may be one; empty for others.
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
    /// Where tilesets lie. Used only where levels or a region say what is wanted of them.
    places: HashSet<Place>,
    /// Tilesets that are on their way, with further places of them.
    coming: HashMap<Arc<str>, Vec<Tileset>>,
    /// Nodes met in tilesets that were met before.
    met_again: u64,
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
        places: HashSet::new(),
        coming: HashMap::new(),
        met_again: 0,
    };
    fill.place(root.clone(), tileset);
    let end = runtime.block_on(async {
        let end = fill.run(&client, &root, progress).await;
        client.flush().await;
        end
    });
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
        let mut under_way = HashMap::new();
        loop {
            while !self.filled.stopped
                && tasks.len() < self.options.in_flight.max(1)
                && let Some(job) = self.jobs.pop()
            {
                let (client, limits, refresh) = (client.clone(), self.options.limits, self.options.refresh);
                let of = (job.uri.clone(), job.is_again);
                let task = tasks.spawn(async move { fetch(&client, job, &limits, refresh).await });
                under_way.insert(task.id(), of);
            }
            match tokio::time::timeout(LOOK, tasks.join_next_with_id()).await {
                Ok(None) => return Ok(()),
                Ok(Some(Ok((id, done)))) => {
                    under_way.remove(&id);
                    self.take(client, done, root)?;
                }
                // Given up.
                Ok(Some(Err(e))) if e.is_cancelled() => continue,
                // A panic.
                Ok(Some(Err(e))) => {
                    let (uri, is_again) = under_way.remove(&e.id()).unwrap_or_else(|| (root.clone(), false));
                    let error =
                        IoError::Network { uri: uri.to_string(), reason: "the thread for it stopped".to_owned() };
                    self.failed((&uri, is_again), error, root)?;
                }
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
            Some(tileset) => self.tileset_in_its_places(&done.job, bytes, tileset),
            None => self.content(&done.job, bytes),
        });
        if result.as_ref().is_err_and(IoError::is_no_content) {
            // An error page, say: asked for again next time.
            client.forget(&done.job.uri);
        }
        match result {
            Ok(()) if done.job.is_again => {}
            Ok(()) if done.was_kept => self.filled.kept += 1,
            Ok(()) => self.filled.fetched += 1,
            Err(error) => self.failed((&done.job.uri, done.job.is_again), error, root)?,
        }
        Ok(())
    }

    fn failed(&mut self, of: (&Arc<str>, bool), error: IoError, root: &Arc<str>) -> Result<(), IoError> {
        let (uri, is_again) = of;
        if uri == root {
            return Err(error);
        }
        self.filled.found += u64::from(is_again);
        self.fail(&error);
        Ok(())
    }

    fn fail(&mut self, error: &IoError) {
        self.filled.failed += 1;
        if self.filled.errors.len() < TOLD {
            self.filled.errors.push((shown(error.uri()).into_owned(), error.reason()));
        }
    }

    fn push(&mut self, uri: Arc<str>, maybe: Option<Box<Tileset>>) {
        if self.seen.insert(uri.clone()) {
            self.filled.found += 1;
            self.jobs.push(Job { uri, tileset: None, maybe, is_again: false });
        }
    }

    /// What is not called a tileset may be one; of several places it has the first.
    fn content(&mut self, job: &Job, bytes: Vec<u8>) -> Result<(), IoError> {
        refuse_markup(&job.uri, &bytes)?;
        match &job.maybe {
            Some(tileset)
                if !tileset.chain.contains(&job.uri) && is_tileset(&job.uri, &bytes, &self.options.limits) =>
            {
                self.tileset(&job.uri, bytes, tileset).map(drop)
            }
            _ => Ok(()),
        }
    }

    /// A tileset in a place: another part of it may be wanted in each.
    fn place(&mut self, uri: Arc<str>, tileset: Tileset) {
        let is_new = self.seen.insert(uri.clone());
        let takes_all = self.options.region.is_none() && self.options.levels == (0..=u32::MAX);
        let key = || (uri.clone(), tileset.level, tileset.world.to_cols_array().map(f64::to_bits));
        // One that contains itself is refused where it is flown over.
        if takes_all && !is_new || tileset.chain.contains(&uri) || !takes_all && !self.places.insert(key()) {
            return;
        }
        if is_new {
            self.filled.found += 1;
            self.coming.insert(uri.clone(), Vec::new());
        } else if let Some(places) = self.coming.get_mut(&uri) {
            places.push(tileset);
            return;
        }
        self.jobs.push(Job { uri, tileset: Some(tileset), maybe: None, is_again: !is_new });
    }

    fn tileset_in_its_places(&mut self, job: &Job, bytes: Vec<u8>, tileset: &Tileset) -> Result<(), IoError> {
        let further = self.coming.remove(&job.uri).unwrap_or_default();
        self.met_again += self.tileset(&job.uri, bytes.clone(), tileset)? * u64::from(job.is_again);
        for place in &further {
            self.met_again += self.tileset(&job.uri, bytes.clone(), place)?;
        }
        Ok(())
    }

    /// Returns how many nodes it has.
    fn tileset(&mut self, uri: &Arc<str>, bytes: Vec<u8>, tileset: &Tileset) -> Result<u64, IoError> {
        let limit = self.options.limits.max_elements as u64;
        if self.met_again > limit {
            // Few files that name each other often enough.
            let what = "tiles of tilesets in several places";
            return Err(IoError::TooLarge { uri: uri.to_string(), what, got: self.met_again, limit });
        }
        let options = ReadOptions {
            root: self.scope.clone(),
            limits: self.options.limits,
            chain: tileset.chain.clone(),
            // Regions are wanted as they are.
            set_from_content: DAffine3::IDENTITY,
            build_kd_trees: false,
            vertex_attributes: Arc::default(),
            sharing: None,
        };
        let content = Content { uri: uri.clone(), bytes, reader_data: None, companions: Vec::new() };
        let node = decode_node(content, &options)?;
        let is_root = tileset.chain.is_empty();
        if is_root
            && self.options.region.is_some()
            && let NodeKind::PagedLod(tile) | NodeKind::MultiContentTile(tile) = &node.kind
            && !extent::is_on_earth(&tile.bounds, &tileset.world)
        {
            return Err(IoError::unsupported(uri, "a region of a set that is not on the earth"));
        }
        let below = Tileset { chain: options.below(uri).chain, ..tileset.clone() };
        Ok(self.node(&node, &below))
    }

    /// Returns how many nodes were looked at.
    fn node(&mut self, node: &Node, tileset: &Tileset) -> u64 {
        match &node.kind {
            NodeKind::MultiContentTile(tile) => {
                if !self.is_wanted(&tile.bounds, tileset) {
                    return 1;
                }
                // One tile of the tileset.
                return 1 + node.children.iter().map(|child| self.node(child, tileset)).sum::<u64>();
            }
            NodeKind::PagedLod(tile) => {
                if !self.is_wanted(&tile.bounds, tileset) {
                    return 1;
                }
                if let Some(uri) = &tile.content {
                    let maybe = may_be_tileset(uri).then(|| {
                        let (level, world) = (tileset.level + 1, tileset.world * tile.content_transform);
                        Box::new(Tileset { level, world, chain: tileset.chain.clone() })
                    });
                    // What lies above the levels may lead to them.
                    if maybe.is_some() || self.options.levels.contains(&tileset.level) {
                        for companion in companions(uri, tile.reader_data.as_ref()) {
                            self.push(companion, None);
                        }
                        self.push(uri.clone(), maybe);
                    }
                }
            }
            NodeKind::ProxyNode(proxy) => {
                if self.is_wanted(&BoundingVolume::Sphere(proxy.bounds), tileset) {
                    let world = tileset.world * proxy.content_transform;
                    self.place(proxy.uri.clone(), Tileset { world, ..tileset.clone() });
                }
                return 1;
            }
            _ => {}
        }
        let below = Tileset { level: tileset.level + 1, ..tileset.clone() };
        1 + node.children.iter().map(|child| self.node(child, &below)).sum::<u64>()
    }

    fn is_wanted(&self, bounds: &BoundingVolume, tileset: &Tileset) -> bool {
        tileset.level <= *self.options.levels.end()
            && self.options.region.as_ref().is_none_or(|region| extent::overlaps(bounds, &tileset.world, region))
    }
}

async fn fetch(client: &HttpClient, job: Job, limits: &Limits, refresh: bool) -> Done {
    if !refresh {
        // A tileset has to be read, of others it is enough that they are there.
        let kept = match (&job.tileset, &job.maybe) {
            (None, None) => client.is_kept(&job.uri).await.then(Vec::new),
            _ => client.kept(&job.uri, limits).await,
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
