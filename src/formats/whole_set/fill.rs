//! Downloads a part of a tile set into the disk cache; the counterpart of OSG's `osgfilecache`.
//!
//! Files that are already cached are not requested again, so an interrupted run continues where it stopped.

use std::collections::{HashMap, HashSet};
use std::ops::{ControlFlow, RangeInclusive};
use std::sync::Arc;
use std::time::Duration;

use glam::DAffine3;
use tokio::task::JoinSet;

use super::region;
use super::tree::Known;
use crate::fetch::markup::refuse_markup;
use crate::fetch::{
    CacheStats, HttpBody, HttpClient, HttpConfig, IoError, Limits, RootScope, encoding, guarded, is_remote, root_uri,
    runtime, shown,
};
use crate::formats::options::{Content, Fetched, ReadOptions};
use crate::formats::read::{companion_fallback, companions, decode_node, dependencies};
use crate::formats::terrain;
use crate::formats::tile::{Tile, TileContent};
use crate::formats::tileset::{body_of, is_tileset, may_be_tileset, may_refer_to_files, read_tiles};
use crate::math::{BoundingVolume, Ellipsoid, Region, WGS84};
use crate::scene::ReaderData;

/// The maximum number of failures that are listed.
const MAX_LISTED: usize = 100;

/// The part of a tile set to download, and how.
#[derive(Clone, Debug)]
pub struct FillOptions {
    /// Only tiles over this region of the earth, or of the body of the set, whatever their height. `None` means all tiles.
    pub region: Option<Region>,
    /// Only contents on these levels of the tree; the root has level 0. The root of an external tileset is one level below the
    /// tile that refers to it.
    pub levels: RangeInclusive<u32>,
    /// The maximum number of requests in flight.
    pub in_flight: usize,
    /// Revalidates files that are already cached.
    pub refresh: bool,
    /// Upper limits on the data.
    pub limits: Limits,
}

impl Default for FillOptions {
    fn default() -> Self {
        Self { region: None, levels: 0..=u32::MAX, in_flight: 16, refresh: false, limits: Limits::default() }
    }
}

/// Progress of [`fill`], and its result at the end.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Filled {
    /// Number of wanted files found so far: contents, imagery, tilesets.
    pub found: u64,
    /// Number of files that were already cached.
    pub kept: u64,
    /// Number of files downloaded.
    pub fetched: u64,
    /// Number of files that failed.
    pub failed: u64,
    /// Bytes received over the network.
    pub bytes: u64,
    /// The first failures: URI, as [`shown`] returns it, and reason.
    pub errors: Vec<(String, String)>,
    /// True if `progress` stopped the download.
    pub stopped: bool,
    /// Statistics of the cache, set at the end.
    pub cache: CacheStats,
}

/// The position of a tileset in the tree.
#[derive(Clone)]
struct Position {
    /// Level of its root tile.
    level: u32,
    /// Maps the tileset's frame to the frame of the whole set.
    world: DAffine3,
    /// URIs of the tilesets above, root first.
    chain: Arc<[Arc<str>]>,
}

/// A file to fetch.
struct Job {
    uri: Arc<str>,
    /// The position of a known tileset.
    tileset: Option<Position>,
    /// The position of a file that may turn out to be a tileset, since its file extension does not rule it out.
    possible_tileset: Option<Box<Position>>,
    /// The content that a subtree is, if the file is one.
    subtree: Option<TileContent>,
    /// The URI at which the file is looked for if its own has none.
    fallback: Option<Arc<str>>,
    /// True for a tileset that was counted before and is read once more for another position.
    is_again: bool,
}

/// URI, level and bits of the transform of a tileset.
type PositionKey = (Arc<str>, u32, [u64; 12]);

struct Done {
    job: Job,
    /// The bytes of a known or possible tileset; empty for other files.
    result: Result<Vec<u8>, IoError>,
    /// The URL that redirects led to.
    location: Option<Arc<str>>,
    /// The files that a subtree refers to.
    companions: Vec<Fetched>,
    was_cached: bool,
    network_bytes: u64,
}

/// A file that was read.
struct ReadFile<'a> {
    bytes: Vec<u8>,
    location: Option<Arc<str>>,
    companions: &'a [Fetched],
}

impl Done {
    fn new(job: Job, result: Result<Vec<u8>, IoError>, was_cached: bool) -> Self {
        Self { job, result, location: None, companions: Vec::new(), was_cached, network_bytes: 0 }
    }
}

struct Fill<'a> {
    options: &'a FillOptions,
    scope: RootScope,
    /// The ellipsoid of the root, once it is read.
    ellipsoid: Ellipsoid,
    filled: Filled,
    /// Last in, first out: the files below a tile precede its siblings, which keeps the list short.
    jobs: Vec<Job>,
    /// URIs found so far. A file that the tree refers to several times is fetched once.
    seen: HashSet<Arc<str>>,
    /// Positions of tilesets so far. Used only with levels or a region, which may select other files in each position.
    positions: HashSet<PositionKey>,
    /// Tilesets in flight, with their additional positions.
    in_flight: HashMap<Arc<str>, Vec<Position>>,
    /// Number of tiles and contents visited in additional positions of tilesets.
    revisited: u64,
}

/// The longest pause that a server may ask for.
const MAX_SERVER_PAUSE: Duration = Duration::from_secs(600);
/// The longest time between two calls of `progress`.
const PROGRESS_INTERVAL: Duration = Duration::from_millis(100);

/// Downloads a part of the tile set at a URL into the cache of the configuration. Blocking.
///
/// `progress` is called on this thread after each file, and at least ten times a second. If it returns `Break`, requests in
/// flight are cancelled; downloaded files stay in the cache.
///
/// # Errors
/// Fails if the root cannot be read, or if no cache is configured. Other failures are listed in the result.
pub fn fill(
    source: &str,
    config: &HttpConfig,
    options: &FillOptions,
    progress: &mut dyn FnMut(&Filled) -> ControlFlow<()>,
) -> Result<Filled, IoError> {
    let root = root_uri(source)?;
    if !is_remote(&root) {
        return Err(IoError::Uri { uri: root.to_string(), reason: "only tile sets on servers are cached".to_owned() });
    }
    // No frame waits for the files. The client may therefore wait for a pause of minutes.
    let config = HttpConfig { max_wait: config.max_wait.max(MAX_SERVER_PAUSE), ..config.clone() };
    let scope = RootScope::of(&root);
    let client = HttpClient::new(&config)?.within(&scope);
    let client = if options.refresh { client.revalidating() } else { client };
    if client.cache().is_none() {
        return Err(IoError::Uri { uri: root.to_string(), reason: "there is no cache to fill".to_owned() });
    }
    let runtime = runtime("fill");
    let runtime = runtime.map_err(|e| IoError::Network { uri: root.to_string(), reason: e.to_string() })?;
    let position = Position { level: 0, world: DAffine3::IDENTITY, chain: Arc::new([]) };
    let mut fill = Fill {
        options,
        scope,
        ellipsoid: WGS84,
        filled: Filled::default(),
        jobs: Vec::new(),
        seen: HashSet::new(),
        positions: HashSet::new(),
        in_flight: HashMap::new(),
        revisited: 0,
    };
    fill.add_position(root.clone(), position, None);
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
        let mut uris = HashMap::new();
        loop {
            while !self.filled.stopped
                && tasks.len() < self.options.in_flight.max(1)
                && let Some(job) = self.jobs.pop()
            {
                let (client, limits, refresh) = (client.clone(), self.options.limits, self.options.refresh);
                let scope = self.scope.clone();
                let of = (job.uri.clone(), job.is_again);
                let task = tasks.spawn(async move { fetch(&client, &scope, job, &limits, refresh).await });
                uris.insert(task.id(), of);
            }
            match tokio::time::timeout(PROGRESS_INTERVAL, tasks.join_next_with_id()).await {
                Ok(None) => return Ok(()),
                Ok(Some(Ok((id, done)))) => {
                    uris.remove(&id);
                    self.take(client, done, root)?;
                }
                // A task that was cancelled.
                Ok(Some(Err(e))) if e.is_cancelled() => continue,
                // A task that panicked.
                Ok(Some(Err(e))) => {
                    let (uri, is_again) = uris.remove(&e.id()).unwrap_or_else(|| (root.clone(), false));
                    let error =
                        IoError::Network { uri: uri.to_string(), reason: "its worker thread panicked".to_owned() };
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
        if done.job.subtree.is_none() && !done.job.is_again {
            // A tileset is read without its schema; a subtree fails without its buffers.
            done.companions.iter().filter_map(|(_, read)| read.as_ref().err()).for_each(|error| self.fail(error));
        }
        let result = done.result.and_then(|bytes| {
            let read = ReadFile { bytes, location: done.location.clone(), companions: &done.companions };
            match &done.job.tileset {
                Some(position) => self.add_tileset_in_all_positions(&done.job, &read, position),
                None => self.check_content(&done.job, &read),
            }
        });
        if result.as_ref().is_err_and(IoError::is_no_content) {
            // The bytes are invalid, such as an error page: the next run requests the file again.
            client.forget(&done.job.uri);
        }
        match result {
            Ok(()) if done.job.is_again => {}
            Ok(()) if done.was_cached => self.filled.kept += 1,
            Ok(()) => self.filled.fetched += 1,
            Err(error) => self.failed((&done.job.uri, done.job.is_again), error, root)?,
        }
        Ok(())
    }

    /// Records a failed file. Fails if it is the root.
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
        if self.filled.errors.len() < MAX_LISTED {
            self.filled.errors.push((shown(error.uri()).into_owned(), error.reason()));
        }
    }

    fn add_file(&mut self, uri: Arc<str>, possible_tileset: Option<Box<Position>>, fallback: Option<Arc<str>>) {
        if self.seen.insert(uri.clone()) {
            self.filled.found += 1;
            self.jobs.push(Job { uri, tileset: None, possible_tileset, subtree: None, fallback, is_again: false });
        }
    }

    /// Checks a content, queues the files that it refers to, and reads it if it is a tileset. If it has several positions,
    /// only the first one counts.
    fn check_content(&mut self, job: &Job, read: &ReadFile<'_>) -> Result<(), IoError> {
        refuse_markup(&job.uri, &read.bytes)?;
        let options = options_of(job, &self.scope, read.location.clone(), self.options.limits);
        for dependency in dependencies(&job.uri, &read.bytes, None, read.companions, &options) {
            self.add_file(dependency, None, None);
        }
        match &job.possible_tileset {
            Some(position)
                if !position.chain.contains(&job.uri) && is_tileset(&job.uri, &read.bytes, &self.options.limits) =>
            {
                self.add_tileset(&job.uri, read, position).map(drop)
            }
            _ => Ok(()),
        }
    }

    /// Adds a position of a tileset, or of a subtree. In each position other files below it may be wanted.
    fn add_position(&mut self, uri: Arc<str>, position: Position, subtree: Option<TileContent>) {
        let is_new = self.seen.insert(uri.clone());
        let takes_all = self.options.region.is_none() && self.options.levels == (0..=u32::MAX);
        let key = || (uri.clone(), position.level, position.world.to_cols_array().map(f64::to_bits));
        // A tileset that contains itself is an error only for the pager.
        if takes_all && !is_new || position.chain.contains(&uri) || !takes_all && !self.positions.insert(key()) {
            return;
        }
        if is_new {
            self.filled.found += 1;
            self.in_flight.insert(uri.clone(), Vec::new());
        } else if let Some(positions) = self.in_flight.get_mut(&uri) {
            positions.push(position);
            return;
        }
        let fallback = subtree.as_ref().and_then(|content| content.reader_data.as_ref()?.fallback_uri());
        let (tileset, possible_tileset) = (Some(position), None);
        self.jobs.push(Job { uri, tileset, possible_tileset, subtree, fallback, is_again: !is_new });
    }

    fn add_tileset_in_all_positions(
        &mut self,
        job: &Job,
        read: &ReadFile<'_>,
        first: &Position,
    ) -> Result<(), IoError> {
        let others = self.in_flight.remove(&job.uri).unwrap_or_default();
        let mut add = |position: &Position| match &job.subtree {
            Some(content) => self.add_pages(content, read, position),
            None => self.add_tileset(&job.uri, read, position),
        };
        let mut revisited = add(first)? * u64::from(job.is_again);
        for position in &others {
            revisited += add(position)?;
        }
        self.revisited += revisited;
        Ok(())
    }

    /// Queues the files that a subtree, or a page of terrain, in one position refers to. Returns its number of tiles and
    /// contents.
    fn add_pages(&mut self, content: &TileContent, read: &ReadFile<'_>, position: &Position) -> Result<u64, IoError> {
        let bytes = encoding::gunzip(&content.uri, read.bytes.clone(), &self.options.limits)?;
        let (root, base) = (self.scope.clone(), read.location.clone());
        let ellipsoid = self.ellipsoid;
        let options = ReadOptions { root, base, ellipsoid, ..ReadOptions::for_root(&content.uri, self.options.limits) };
        let tiles = guarded(&content.uri, || match Known::of(content) {
            Known::Subtree(source) => source.read(&content.uri, bytes, read.companions, &options),
            // The ellipsoid has no files, and its levels continue to a very fine one.
            Known::Terrain(page) if !page.is_ellipsoid() => page.read(&content.uri, bytes, read.companions, &options),
            _ => Ok(Vec::new()),
        })?;
        Ok(tiles.iter().map(|tile| self.add_tile(tile, position)).sum())
    }

    /// Queues the files that a tileset in one position refers to. Returns its number of tiles and contents.
    fn add_tileset(&mut self, uri: &Arc<str>, read: &ReadFile<'_>, position: &Position) -> Result<u64, IoError> {
        let limit = self.options.limits.max_elements as u64;
        if self.revisited > limit {
            // A few files that refer to each other often enough form an almost endless tree.
            let what = "tiles of tilesets in several places";
            return Err(IoError::TooLarge { uri: uri.to_string(), what, got: self.revisited, limit });
        }
        let is_root = position.chain.is_empty();
        if let Some(body) = is_root.then(|| body_of(uri, &read.bytes, &self.options.limits)).flatten() {
            self.ellipsoid = body.ellipsoid();
        }
        let options = ReadOptions {
            root: self.scope.clone(),
            ellipsoid: self.ellipsoid,
            chain: position.chain.clone(),
            base: read.location.clone(),
            // Regions must stay regions to be compared with the wanted one: the set's frame is taken for the content's.
            ..ReadOptions::for_root(uri, self.options.limits)
        };
        let Some(tiles) = read_root_tiles(uri, read, &options)? else { return Ok(1) };
        let is_on_body = || tiles.iter().all(|tile| region::is_on_body(&tile.bounds, &position.world, &self.ellipsoid));
        if is_root && self.options.region.is_some() && !is_on_body() {
            return Err(IoError::unsupported(uri, "a region of a set that is not on the earth"));
        }
        let below = Position { chain: options.below(uri).chain, ..position.clone() };
        Ok(tiles.iter().map(|tile| self.add_tile(tile, &below)).sum())
    }

    /// Queues the wanted files of a tile and its descendants. `position.level` is the level of the tile. Returns the number of
    /// tiles visited; each further content of a tile counts as one, too.
    fn add_tile(&mut self, tile: &Tile, position: &Position) -> u64 {
        if !self.is_wanted(&tile.bounds, position) {
            return 1;
        }
        let mut visited = tile.contents.len().max(1) as u64;
        for content in &tile.contents {
            if content.continues_tileset() {
                visited += self.add_part(content, position);
                continue;
            }
            let uri = match Known::of(content) {
                Known::File => &content.uri,
                Known::Refused(error) => {
                    self.fail(error);
                    continue;
                }
                _ => continue,
            };
            let possible_tileset = may_be_tileset(uri).then(|| {
                let (level, world) = (position.level + 1, position.world * tile.content_transform);
                Box::new(Position { level, world, chain: position.chain.clone() })
            });
            // A content above the wanted levels is fetched only if it may be a tileset that leads to them.
            if possible_tileset.is_some() || self.options.levels.contains(&position.level) {
                for companion in companions(uri, content.reader_data.as_ref()) {
                    let fallback = companion_fallback(&companion, content.reader_data.as_ref());
                    self.add_file(companion, None, fallback);
                }
                let fallback = content.reader_data.as_ref().and_then(ReaderData::fallback_uri);
                self.add_file(uri.clone(), possible_tileset, fallback);
            }
        }
        let below = Position { level: position.level + 1, ..position.clone() };
        for TileContent { uri, .. } in &tile.external_tilesets {
            visited += 1;
            if self.is_wanted(&BoundingVolume::Sphere(tile.bounds.bounding_sphere()), &below) {
                let world = below.world * tile.content_transform;
                self.add_position(uri.clone(), Position { world, ..below.clone() }, None);
            }
        }
        for part in &tile.continuations {
            if self.is_wanted(&part.bounds, &below) {
                visited += self.add_part(&part.content, &below);
            }
        }
        visited + tile.children.iter().map(|child| self.add_tile(child, &below)).sum::<u64>()
    }

    /// Queues the files of a part of a tile tree whose first level is `position.level`. Returns the number of tiles visited.
    fn add_part(&mut self, content: &TileContent, position: &Position) -> u64 {
        match Known::of(content) {
            Known::Part(part) => {
                let root = self.scope.clone();
                let ellipsoid = self.ellipsoid;
                let options =
                    ReadOptions { root, ellipsoid, ..ReadOptions::for_root(&content.uri, self.options.limits) };
                let tiles = part.read(&options).unwrap_or_else(|error| {
                    self.fail(&error);
                    Vec::new()
                });
                tiles.iter().map(|tile| self.add_tile(tile, position)).sum()
            }
            Known::Terrain(_) if content.is_in_memory() => {
                let read = ReadFile { bytes: Vec::new(), location: None, companions: &[] };
                self.add_pages(content, &read, position).unwrap_or_else(|error| {
                    self.fail(&error);
                    0
                })
            }
            Known::Subtree(_) | Known::Terrain(_) => {
                self.add_position(content.uri.clone(), position.clone(), Some(content.clone()));
                1
            }
            _ => 0,
        }
    }

    fn is_wanted(&self, bounds: &BoundingVolume, position: &Position) -> bool {
        let is_over = |region: &Region| region::overlaps(bounds, &position.world, region, &self.ellipsoid);
        position.level <= *self.options.levels.end() && self.options.region.as_ref().is_none_or(is_over)
    }
}

/// Parses the root tile of a tileset, or those of a terrain service. Returns `None` for another content, such as a glTF that
/// a tile refers to as `.json`.
fn read_root_tiles(uri: &Arc<str>, read: &ReadFile<'_>, options: &ReadOptions) -> Result<Option<Vec<Tile>>, IoError> {
    guarded(uri, || {
        let bytes = encoding::gunzip(uri, read.bytes.clone(), &options.limits)?;
        if is_tileset(uri, &bytes, &options.limits) {
            return read_tiles(uri, &bytes, read.companions, options).map(|tile| Some(vec![tile]));
        }
        if terrain::is_layer(uri, &bytes, &options.limits) {
            return terrain::read_tiles(uri, &bytes, read.companions, options).map(Some);
        }
        let content = Content { uri: uri.clone(), bytes, reader_data: None, companions: Vec::new() };
        decode_node(content, options).map(|_| None)
    })
}

async fn fetch(client: &HttpClient, scope: &RootScope, job: Job, limits: &Limits, refresh: bool) -> Done {
    if !refresh {
        // Files that refer to others must be read; for images and the like it is enough that they are cached.
        let cached = if job.tileset.is_some() || may_refer_to_files(&job.uri) {
            client.get_cached(&job.uri, limits).await
        } else {
            client.is_cached(&job.uri).await.then(HttpBody::default)
        };
        if let Some(body) = cached {
            let HttpBody { bytes, location, .. } = body;
            return with_companions(client, scope, limits, Done { location, ..Done::new(job, Ok(bytes), true) }).await;
        }
    }
    let mut body = client.get(&job.uri, limits).await;
    if let (Some(fallback), Err(error)) = (&job.fallback, &body)
        && error.may_be_elsewhere()
    {
        body = client.get(fallback, limits).await;
        if let Ok(body) = &mut body {
            body.location.get_or_insert_with(|| fallback.clone());
        }
    }
    let done = match body {
        Ok(HttpBody { bytes, network_bytes, location, .. }) => {
            let was_cached = refresh && network_bytes == 0;
            Done { network_bytes, location, ..Done::new(job, Ok(bytes), was_cached) }
        }
        Err(error) => Done::new(job, Err(error), false),
    };
    with_companions(client, scope, limits, done).await
}

/// Returns the options with which the references in a file are found.
fn options_of(job: &Job, scope: &RootScope, base: Option<Arc<str>>, limits: Limits) -> ReadOptions {
    // The cache also serves applications that keep features, which have schemas.
    ReadOptions { root: scope.clone(), base, keep_features: true, ..ReadOptions::for_root(&job.uri, limits) }
}

/// Fetches the external buffers of a subtree, or the schema of a tileset.
async fn with_companions(client: &HttpClient, scope: &RootScope, limits: &Limits, mut done: Done) -> Done {
    let Done { job, result: Ok(bytes), .. } = &done else { return done };
    let is_part = job.tileset.is_some() || job.possible_tileset.is_some() && is_tileset(&job.uri, bytes, limits);
    if is_part {
        let options = options_of(job, scope, done.location.clone(), *limits);
        let data = job.subtree.as_ref().and_then(|content| content.reader_data.as_ref());
        for uri in companions(&job.uri, data).into_iter().chain(dependencies(&job.uri, bytes, data, &[], &options)) {
            let body = client.get(&uri, limits).await;
            done.network_bytes += body.as_ref().map_or(0, |body| body.network_bytes);
            done.companions.push((uri, body.map(|body| body.bytes)));
        }
    }
    done
}
