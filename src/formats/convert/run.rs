//! [`convert`]: worker threads take items last in, first out, so that the list of items stays short, and join their tiles
//! from the leaves upwards. Memory holds the contents in work and the tiles that are not in a file yet.

use std::collections::HashMap;
use std::path::Path;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use glam::{DAffine3, DVec3};

use super::contents::{ContentError, ContentWriter, Written, write_file};
use super::items::{Item, ItemContent, Refinement};
use super::report::{ConvertError, ConvertOptions, Converted};
use super::tiles::{Draft, ErrorScale, OutTile};
use super::written::levels_of;
use crate::fetch::{Source, root_uri_within};
use crate::formats::ignored::{Ignored, Notes};
use crate::formats::options::ReadOptions;
use crate::formats::tile::Body;
use crate::formats::whole_set::{is_on_body, overlaps};
use crate::math::{Aabb, BoundingVolume, Ellipsoid, Region, max_scale};

/// A part of the tree with this number of tiles gets a file of its own.
const TILES_PER_FILE: usize = 500;
/// The longest time between two calls of `progress`.
const PROGRESS_INTERVAL: Duration = Duration::from_millis(100);

/// An item to be converted.
struct Job {
    item: Item,
    /// The options for its content.
    options: Arc<ReadOptions>,
    parent: Option<Slot>,
    /// The number of contents above it.
    level: usize,
}

/// The place of a tile among the children of another one.
#[derive(Clone, Copy)]
struct Slot {
    tile: u64,
    number: usize,
}

/// A tile that waits for its children.
struct Pending {
    parent: Option<Slot>,
    /// `None` if the children take its place.
    draft: Option<Draft>,
    children: Vec<Vec<OutTile>>,
    missing: usize,
}

#[derive(Default)]
struct State {
    jobs: Vec<Job>,
    pending: HashMap<u64, Pending>,
    last_pending: u64,
    /// The number of threads that work on a job.
    busy: usize,
    report: Converted,
    left_out: Ignored,
    root: Vec<OutTile>,
    /// The body that the source declares.
    body: Option<Body>,
    error: Option<ConvertError>,
}

/// The work that threads share. One lock guards the state; threads read and write files without it.
struct Shared<'a> {
    state: Mutex<State>,
    /// Signalled when there are more jobs, or none any more.
    changed: Condvar,
    out: &'a Path,
    options: &'a ConvertOptions,
    errors: ErrorScale,
    /// The options for the root. They hold the list of what readers leave out.
    read_options: Arc<ReadOptions>,
}

/// Converts a set, or a single model, to 3D Tiles 1.1 in an empty folder. Blocking; `progress` is called on this thread at
/// least ten times a second.
///
/// Contents that cannot be read are left out and listed in the result. The tiles below them take their place.
///
/// # Errors
/// Fails if the root cannot be read, if no content could be converted, or if a file cannot be written. The folder then holds
/// a part of the set.
pub fn convert(
    source: &str,
    out: &Path,
    options: &ConvertOptions,
    progress: &mut dyn FnMut(&Converted),
) -> Result<Converted, ConvertError> {
    let root = root_uri_within(source, options.limits.file_timeout)?;
    let read_options =
        ReadOptions { keep_features: true, cluster_culling: false, ..ReadOptions::for_root(&root, options.limits) };
    let read_options = Arc::new(read_options);
    let errors = ErrorScale { max_sse_px: options.max_sse_px, px_per_radian: options.px_per_radian };
    let shared = Shared {
        state: Mutex::default(),
        changed: Condvar::new(),
        out,
        options,
        errors,
        read_options: read_options.clone(),
    };
    shared.lock().jobs.push(Job { item: Item::root(root.clone()), options: read_options, parent: None, level: 0 });
    let threads = options.threads.or_else(|| std::thread::available_parallelism().ok().map(usize::from)).unwrap_or(1);
    std::thread::scope(|scope| {
        let mut workers = Vec::new();
        for number in 0..threads.max(1) {
            let worker = std::thread::Builder::new().name(format!("convert {number}"));
            let (shared, root) = (&shared, &root);
            match worker.spawn_scoped(scope, move || shared.work(root)) {
                Ok(worker) => workers.push(worker),
                Err(error) => {
                    shared.fail(ConvertError::Thread(error));
                    break;
                }
            }
        }
        while workers.iter().any(|worker| !worker.is_finished()) {
            let state = shared.lock();
            let waited = shared.changed.wait_timeout(state, PROGRESS_INTERVAL).unwrap_or_else(PoisonError::into_inner);
            let report = waited.0.report.clone();
            drop(waited);
            progress(&report);
        }
    });
    shared.finish(&root)
}

impl Shared<'_> {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Stops all threads.
    fn fail(&self, error: ConvertError) {
        let mut state = self.lock();
        state.error.get_or_insert(error);
        state.jobs.clear();
        self.changed.notify_all();
    }

    /// Takes jobs until there are none, and none can come.
    fn work(&self, root: &str) {
        let from = Source::new(self.options.limits, root);
        #[cfg(feature = "http")]
        let from = from.with_http(self.options.http.clone());
        let writer = ContentWriter { from, out: self.out, options: self.options };
        let mut state = self.lock();
        loop {
            if let Some(job) = state.jobs.pop() {
                state.busy += 1;
                drop(state);
                if let Err(error) = self.convert(job, &writer) {
                    self.fail(error);
                }
                state = self.lock();
                state.busy -= 1;
                self.changed.notify_all();
            } else if state.busy == 0 {
                return;
            } else {
                state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
            }
        }
    }

    /// Converts the content of an item, and adds jobs for the items below it.
    fn convert(&self, job: Job, writer: &ContentWriter<'_>) -> Result<(), ConvertError> {
        let Job { mut item, options, parent, level } = job;
        let notes = Notes::default();
        let uri = match &item.content {
            ItemContent::File { uri, .. } => uri.clone(),
            ItemContent::Nothing | ItemContent::Inline(_) => item.name.as_str().into(),
        };
        let had_content = !matches!(item.content, ItemContent::Nothing);
        let mut read = match writer.read(&mut item, &options, &notes) {
            Ok(read) => Some(read),
            Err(error) if parent.is_none() => return Err(error.into()),
            Err(error) => {
                self.lock().report.fail(&error);
                None
            }
        };
        let mut below = std::mem::take(&mut item.children);
        let mut items = Vec::new();
        let (mut draft, mut written, mut beside) = (None, None, Vec::new());
        if let Some(read) = &mut read {
            if parent.is_none() {
                self.lock().body = read.body.take();
            }
            items = std::mem::take(&mut read.split.items);
            let leaves = std::mem::take(&mut read.split.leaves);
            // Tiles in a content stand beside its own geometry, unless finer tiles replace or join both.
            if !items.is_empty() && !below.is_empty() {
                notes.add("tiles in a content that has finer tiles below it");
                items.clear();
            }
            if !leaves.is_empty() {
                match writer.write(&item.name, &uri, leaves, read, &notes) {
                    Ok(content) => written = Some(content),
                    Err(ContentError::Broken(error)) => self.lock().report.fail(&error),
                    Err(ContentError::Fatal(error)) => return Err(error),
                }
            }
            let is_kept = written.is_some() || (!had_content && item.is_worth_keeping());
            if is_kept {
                draft = Some(item.draft(written.as_ref(), read.set_from_model));
            }
            if !items.is_empty()
                && let Some(own) = draft.take()
            {
                // The declared volume holds the other tiles too.
                let own = Draft { declared: None, refinement: Refinement::Error { error_m: 0.0 }, ..own };
                beside = own.finish(Vec::new(), &self.errors).into_iter().collect();
            }
        }
        let level_below = level + usize::from(written.is_some());
        let options_below = read.map_or(options.clone(), |read| read.below);
        let mut children: Vec<(Item, Arc<ReadOptions>, usize)> = Vec::new();
        children.extend(below.drain(..).map(|child| (child, options.clone(), level_below)));
        children.extend(items.into_iter().map(|child| (child, options_below.clone(), level)));
        children.retain(|(Item { bounds, set_from_item, .. }, of, _)| {
            bounds.is_none_or(|bounds| is_wanted(self.options, &bounds, set_from_item, &of.ellipsoid))
        });
        self.count(level, notes, written.as_ref());
        if children.is_empty() {
            let own = draft.and_then(|draft| draft.finish(Vec::new(), &self.errors));
            return self.deliver(parent, beside.into_iter().chain(own).collect());
        }
        let mut slots = vec![beside];
        slots.resize_with(children.len() + 1, Vec::new);
        self.wait_for(Pending { parent, draft, children: slots, missing: children.len() }, children);
        Ok(())
    }

    /// Adds a content of a level to the report.
    fn count(&self, level: usize, notes: Notes, written: Option<&Written>) {
        let mut state = self.lock();
        state.left_out.merge(&notes.into_ignored());
        if let Some(written) = written {
            let report = &mut state.report;
            report.files += 1;
            report.bytes += written.bytes;
            report.source.merge(&written.source);
            report.written.merge(&written.written);
            report.source.add_content(level);
        }
    }

    /// Keeps a tile until its children are converted, and adds jobs for these. Their slots follow that of the tiles beside them.
    fn wait_for(&self, pending: Pending, children: Vec<(Item, Arc<ReadOptions>, usize)>) {
        let mut state = self.lock();
        state.last_pending += 1;
        let tile = state.last_pending;
        state.pending.insert(tile, pending);
        for (number, (item, options, level)) in (1..).zip(children).collect::<Vec<_>>().into_iter().rev() {
            state.jobs.push(Job { item, options, parent: Some(Slot { tile, number }), level });
        }
        self.changed.notify_all();
    }

    /// Puts tiles into their slot, and completes the tiles above that wait for nothing else.
    fn deliver(&self, mut slot: Option<Slot>, mut tiles: Vec<OutTile>) -> Result<(), ConvertError> {
        loop {
            for tile in &mut tiles {
                self.externalise(tile)?;
            }
            let complete = {
                let mut state = self.lock();
                let Some(Slot { tile, number }) = slot else {
                    state.root = tiles;
                    return Ok(());
                };
                let Some(pending) = state.pending.get_mut(&tile) else { return Ok(()) };
                pending.children[number] = tiles;
                pending.missing -= 1;
                if pending.missing > 0 {
                    return Ok(());
                }
                state.pending.remove(&tile)
            };
            let Some(Pending { parent, draft, children, .. }) = complete else { return Ok(()) };
            let children: Vec<OutTile> = children.into_iter().flatten().collect();
            tiles = match draft {
                Some(draft) => draft.finish(children, &self.errors).into_iter().collect(),
                None => children,
            };
            slot = parent;
        }
    }

    /// Writes a large part of the tree to a file, and replaces it by a reference.
    fn externalise(&self, tile: &mut OutTile) -> Result<(), ConvertError> {
        if tile.count < TILES_PER_FILE {
            return Ok(());
        }
        let file = format!("{}.json", tile.name);
        let folder = tile.name.rfind('/').map_or("", |end| &tile.name[..=end]);
        self.write_tileset(&file, tile, false, folder)?;
        *tile = tile.reference(&file);
        Ok(())
    }

    fn write_tileset(&self, file: &str, root: &OutTile, is_whole: bool, folder: &str) -> Result<(), ConvertError> {
        let mut tileset = root.tileset(is_whole, folder);
        if let Some(body) = &self.lock().body {
            body.declare_in(&mut tileset);
        }
        let bytes = tileset.to_string().into_bytes();
        write_file(&self.out.join(file), &bytes)?;
        let mut state = self.lock();
        state.report.files += 1;
        state.report.bytes += bytes.len() as u64;
        Ok(())
    }

    /// Writes the root, and returns the report.
    fn finish(self, uri: &str) -> Result<Converted, ConvertError> {
        let mut state = std::mem::take(&mut *self.lock());
        if let Some(error) = state.error.take() {
            return Err(error);
        }
        let Some(root) = OutTile::group(std::mem::take(&mut state.root), &self.errors) else {
            let first = state.report.errors.first();
            let nothing = reason_for_nothing(self.options).to_owned();
            let reason = first.map_or(nothing, |(uri, reason)| format!("{uri}: {reason}"));
            return Err(ConvertError::Nothing { uri: crate::fetch::shown(uri).into_owned(), reason });
        };
        let mut shared = self.lock();
        (shared.report, shared.body) = (state.report, state.body);
        drop(shared);
        self.write_tileset("tileset.json", &root, true, "")?;
        let mut report = std::mem::take(&mut self.lock().report);
        report.written.levels = levels_of(self.out)?;
        state.left_out.merge(&self.read_options.ignored.snapshot());
        report.left_out = state.left_out.iter().map(|(kind, count)| (kind.to_owned(), count)).collect();
        Ok(report)
    }
}

impl Item {
    /// Returns true for a tile without content that says when it is refined, or from where it is seen.
    fn is_worth_keeping(&self) -> bool {
        self.request_volume.is_some() || self.refinement != Refinement::Always
    }

    /// Returns the tile of the item. Without a content its frame is that of the item.
    fn draft(&self, written: Option<&Written>, set_from_model: DAffine3) -> Draft {
        let set_from_tile = written.map_or(set_from_model, |written| written.set_from_tile);
        let is_moved = set_from_tile != self.set_from_item;
        let tile_from_item = if is_moved { set_from_tile.inverse() * self.set_from_item } else { DAffine3::IDENTITY };
        let move_volume = |volume: BoundingVolume| volume_in(volume, &tile_from_item);
        Draft {
            name: self.name.clone(),
            set_from_tile,
            declared: self.bounds.map(move_volume),
            request_volume: self.request_volume.map(move_volume),
            content_box: written.map_or(Aabb::EMPTY, |written| written.bounds),
            content: written.map(|written| written.file.clone()),
            refine: self.refine,
            refinement: self.refinement.scaled(&tile_from_item),
        }
    }
}

impl Refinement {
    fn scaled(self, tile_from_item: &DAffine3) -> Self {
        let scale = max_scale(&tile_from_item.matrix3);
        match self {
            Self::Error { error_m } => Self::Error { error_m: error_m * scale },
            Self::Nearer { center, distance_m } => {
                Self::Nearer { center: tile_from_item.transform_point3(center), distance_m: distance_m * scale }
            }
            Self::Always => Self::Always,
        }
    }
}

/// Returns why there is nothing to write although nothing failed.
pub(super) fn reason_for_nothing(options: &ConvertOptions) -> &'static str {
    match (options.region, options.rectangle_m) {
        (None, None) => "it draws nothing",
        _ => "none overlaps the given part; `terrane info` prints the bounds of the set",
    }
}

/// Returns true if a volume overlaps the region and the rectangle of the options, as far as there are some. `set_from_item` is
/// the frame of the volume, `ellipsoid` that of the set.
pub(super) fn is_wanted(
    options: &ConvertOptions,
    volume: &BoundingVolume,
    set_from_item: &DAffine3,
    ellipsoid: &Ellipsoid,
) -> bool {
    let is_over = |region: &Region| {
        is_on_body(volume, set_from_item, ellipsoid) && overlaps(volume, set_from_item, region, ellipsoid)
    };
    options.region.as_ref().is_none_or(is_over)
        && options.rectangle_m.as_ref().is_none_or(|of| is_over_rectangle(*volume, set_from_item, of))
}

/// Returns true if a volume overlaps a rectangle of x and y. A region of the earth does not.
fn is_over_rectangle(volume: BoundingVolume, set_from_item: &DAffine3, rectangle_m: &[f64; 4]) -> bool {
    let [min_x, min_y, max_x, max_y] = *rectangle_m;
    let bounds = match volume {
        BoundingVolume::Region(_) => return false,
        BoundingVolume::Box(b) => b.transformed(set_from_item).aabb(),
        BoundingVolume::Sphere(sphere) => {
            let sphere = sphere.transformed(set_from_item);
            let reach = DVec3::splat(sphere.radius_m);
            Aabb { min: sphere.center - reach, max: sphere.center + reach }
        }
    };
    bounds.min.x < max_x && bounds.max.x > min_x && bounds.min.y < max_y && bounds.max.y > min_y
}

/// Returns a volume in another frame. Transforms do not move regions.
fn volume_in(volume: BoundingVolume, map: &DAffine3) -> BoundingVolume {
    match volume {
        _ if *map == DAffine3::IDENTITY => volume,
        BoundingVolume::Sphere(sphere) => BoundingVolume::Sphere(sphere.transformed(map)),
        BoundingVolume::Box(bounds) => BoundingVolume::Box(bounds.transformed(map)),
        BoundingVolume::Region(_) => volume,
    }
}
