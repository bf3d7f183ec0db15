//! LOD, PagedLOD and ProxyNode.
//!
//! The children of a PagedLOD become a chain of tiles, the coarsest on top: each is replaced by the next at the end of its
//! range. A child that is in the file itself becomes an [`InlinePart`]: a content in memory, which is made into a page when
//! it is wanted. So it leaves in the same frame in which the file that replaces it is complete.

use std::collections::HashMap;
use std::sync::Arc;

use glam::{DAffine3, DVec3};

use super::sizes::{self, Size};
use super::textures::external_images;
use super::{Builder, Source, bounds};
use crate::fetch::IoError;
use crate::formats::ignored::Notes;
use crate::formats::options::{Fetched, ReadOptions};
use crate::formats::osg::file_names::escaped;
use crate::formats::osg::objects::{
    CenterMode, LodObject, NodeObject, Object, PagedObject, ProxyMode, ProxyObject, StateObject, TerrainSettings,
};
use crate::formats::tile::{ContentData, TileContent};
use crate::math::{BoundingSphere, BoundingVolume};
use crate::scene::{
    Node, NodeKind, PagedLod, PagingOptions, ProxyLoading, ProxyNode, RangeMode, ReaderData, ReaderValue, Refine,
};

/// Ranges end here or above for children that are shown from anywhere; OSG's writers use 1e30 or the largest float.
const ENDLESS: f64 = 1e29;
/// The range of a child that has none: it is never shown.
const NEVER: [f64; 2] = [f64::MAX, f64::MAX];

/// A child of a PagedLOD that is in the file of its parent.
#[derive(Debug)]
pub(in crate::formats) struct InlinePart {
    file: Arc<PartFile>,
    objects: Vec<Object>,
    /// The state sets above, outermost first: they say how drawables look.
    states: Vec<Arc<StateObject>>,
    /// The settings of the Terrain above.
    terrain: TerrainSettings,
    /// The name of the part in its file; empty for the whole file.
    name: String,
    size_bytes: u64,
}

/// A file that was read before it is wanted. Its objects stay in memory, so that it is not read again.
pub(in super::super) struct HeldFile {
    root: Object,
    /// The bytes that its objects take.
    pub size_bytes: u64,
}

impl HeldFile {
    /// Returns `None` if the file refers to images, which are not in memory, or has nothing to draw.
    pub fn new(root: &Object) -> Option<Self> {
        let is_whole = matches!(root, Object::Node(_)) && external_images(root).is_empty();
        let size_bytes = sizes::of_object(root, &mut HashMap::new()).bytes;
        is_whole.then(|| Self { root: root.clone(), size_bytes })
    }

    /// Returns a tile whose content is the file.
    pub fn into_tile(self, uri: &Arc<str>, sphere: BoundingSphere) -> Node {
        let file = Arc::new(PartFile { uri: uri.clone(), base: uri.clone(), companions: Vec::new() });
        let (objects, size_bytes) = (vec![self.root], self.size_bytes);
        let (states, terrain, name) = (Vec::new(), TerrainSettings::default(), String::new());
        let part = InlinePart { file, objects, states, terrain, name, size_bytes };
        let content = TileContent::new(uri.clone(), Some(ReaderData::of(part)));
        let reach = Reach { sphere, center: sphere.center, is_by_pixel_size: false };
        reach.tile(reach.range_mode(None), content, PagingOptions::default())
    }
}

/// The address and images of a file, which its parts share.
#[derive(Debug)]
pub(super) struct PartFile {
    uri: Arc<str>,
    base: Arc<str>,
    companions: Vec<Fetched>,
}

impl ReaderValue for InlinePart {
    fn is_whole_content(&self) -> bool {
        true
    }

    fn continues_tileset(&self) -> bool {
        true
    }

    fn size_bytes(&self) -> u64 {
        self.size_bytes
    }
}

impl InlinePart {
    /// Returns true for a whole file.
    pub fn is_file(&self) -> bool {
        self.name.is_empty()
    }

    /// Makes the nodes of the part.
    pub fn read(&self, options: &ReadOptions, notes: &Notes) -> Result<Node, IoError> {
        let PartFile { uri, base, companions } = &*self.file;
        let mut builder = Builder::new(Source { uri, base, companions, options, notes });
        builder.states.clone_from(&self.states);
        builder.spheres.terrain = self.terrain;
        builder.shared_file = Some(self.file.clone());
        builder.part.clone_from(&self.name);
        let nodes = builder.children(&self.objects)?;
        builder.finish(Node::group(nodes))
    }
}

/// A file below a Terrain, whose settings its tiles have.
#[derive(Debug)]
pub(in crate::formats) struct TerrainBelow {
    pub(in super::super) settings: TerrainSettings,
    /// The URI at which the file is looked for if its own has none.
    fallback: Option<Arc<str>>,
}

impl ReaderValue for TerrainBelow {
    fn fallback_uri(&self) -> Option<Arc<str>> {
        self.fallback.clone()
    }

    fn size_bytes(&self) -> u64 {
        size_of::<Self>() as u64
    }
}

/// A range of a PagedLOD with what is shown in it.
struct Level {
    range: [f64; 2],
    inline: Vec<Object>,
    /// The numbers of the children that are files.
    files: Vec<usize>,
    /// The number of the first child.
    child: usize,
}

/// The centre and the sphere of levels of detail.
#[derive(Clone, Copy)]
struct Reach {
    sphere: BoundingSphere,
    center: DVec3,
    is_by_pixel_size: bool,
}

impl Reach {
    /// Returns the node that shows its child in a range.
    fn node(&self, ranges: Vec<[f64; 2]>, children: Vec<Node>) -> Node {
        let Self { sphere, center, is_by_pixel_size } = *self;
        let kind = match is_by_pixel_size {
            true => NodeKind::LodByPixelSize { center: sphere.center, radius_m: sphere.radius_m, ranges_px: ranges },
            false => NodeKind::Lod { center, ranges_m: ranges },
        };
        Node { children, ..Node::new(kind) }
    }

    /// Returns a tile.
    fn tile(&self, range_mode: RangeMode, content: TileContent, paging: PagingOptions) -> Node {
        let sphere = if self.sphere.radius_m > 0.0 { self.sphere } else { BoundingSphere::EVERYTHING };
        Node::new(NodeKind::PagedLod(Box::new(PagedLod {
            bounds: BoundingVolume::Sphere(sphere),
            range_mode,
            refine: Refine::Replace,
            content: Some(content.uri),
            content_transform: DAffine3::IDENTITY,
            reader_data: content.reader_data,
            request_volume: None,
            paging,
        })))
    }

    /// Returns when a level is replaced by the next finer one, if there is one.
    fn range_mode(&self, finer: Option<[f64; 2]>) -> RangeMode {
        let Self { sphere, center, is_by_pixel_size } = *self;
        match is_by_pixel_size {
            true => {
                let size_px = finer.map_or(f64::INFINITY, |range| range[0]);
                RangeMode::PixelSize { center: sphere.center, radius_m: sphere.radius_m, size_px }
            }
            false => RangeMode::Distance { center, range_m: finer.map_or(0.0, |range| range[1]) },
        }
    }
}

impl Builder<'_> {
    pub(super) fn lod(&mut self, object: &Arc<NodeObject>, lod: &LodObject) -> Result<Node, IoError> {
        let children = self.children(&object.children)?;
        let mut ranges = lod.ranges.clone();
        ranges.resize(children.len(), NEVER);
        if ranges.iter().all(|range| range[0] <= 0.0 && range[1] >= ENDLESS) {
            return Ok(Node::group(children));
        }
        Ok(self.reach(object, lod).node(ranges, children))
    }

    fn reach(&mut self, object: &NodeObject, lod: &LodObject) -> Reach {
        let known = &mut self.spheres;
        let children = || {
            let spheres = object.children.iter().map(|child| bounds::sphere(child, known));
            spheres.fold(BoundingSphere::EMPTY, |all, sphere| all.union(&sphere))
        };
        let sphere = bounds::of_lod(lod, children);
        let sphere = if sphere.is_empty() { BoundingSphere::new(DVec3::ZERO, 0.0) } else { sphere };
        let own = lod.user_center.filter(|_| lod.center_mode != CenterMode::BoundingSphere);
        let center = own.map_or(sphere.center, |(center, _)| center);
        Reach { sphere, center, is_by_pixel_size: lod.is_by_pixel_size }
    }

    pub(super) fn paged_lod(
        &mut self,
        object: &Arc<NodeObject>,
        lod: &LodObject,
        paged: &PagedObject,
    ) -> Result<Node, IoError> {
        if paged.files.iter().all(String::is_empty) {
            return self.lod(object, lod);
        }
        let reach = self.reach(object, lod);
        let levels = levels(object, lod, paged);
        let mut tiles = Vec::new();
        let mut finer = None;
        for level in levels.iter().rev() {
            let mut contents = Vec::new();
            if !level.inline.is_empty() {
                contents.push((self.part(level.inline.clone())?, level.child));
            }
            contents.extend(level.files.iter().map(|child| (self.file_content(paged, *child), *child)));
            if contents.len() > 1 && !tiles.is_empty() {
                self.note("OpenSceneGraph: PagedLOD with several children in one range above a finer one");
            }
            let range_mode = reach.range_mode(finer);
            let mut below = std::mem::take(&mut tiles);
            for (content, child) in contents {
                let tile = reach.tile(range_mode, content, paging(paged, child));
                tiles.push(Node { children: std::mem::take(&mut below), ..tile });
            }
            finer = Some(level.range);
        }
        // Nearer than the finest level and farther than the coarsest, nothing is shown.
        let all = levels.iter().fold([f64::INFINITY, 0.0], |all: [f64; 2], level| {
            [all[0].min(level.range[0]), all[1].max(level.range[1])]
        });
        if all[0] > 0.0 || all[1] < ENDLESS {
            return Ok(reach.node(vec![all], vec![Node::group(tiles)]));
        }
        Ok(if tiles.len() == 1 { tiles.swap_remove(0) } else { Node::group(tiles) })
    }

    /// Returns a content that is in the file itself.
    fn part(&mut self, objects: Vec<Object>) -> Result<TileContent, IoError> {
        let sizes = &mut self.sizes;
        let size = objects.iter().fold(Size::default(), |size, object| size.plus(sizes::of_object(object, sizes)));
        self.count_nodes(size.nodes)?;
        self.parts += 1;
        let name = match self.part.is_empty() {
            true => self.parts.to_string(),
            false => format!("{}.{}", self.part, self.parts),
        };
        let Source { uri, base, companions, .. } = self.source;
        let file = self.shared_file.get_or_insert_with(|| {
            Arc::new(PartFile { uri: uri.clone(), base: base.into(), companions: companions.to_vec() })
        });
        let states = self.states.clone();
        let (terrain, size_bytes) = (self.spheres.terrain, size.bytes);
        let part = InlinePart { file: file.clone(), objects, states, terrain, name, size_bytes };
        let name = format!("{uri}#part-{}", part.name);
        Ok(TileContent::new(name.into(), Some(ReaderData::of(part))))
    }

    /// Returns the content of a child that is a file. A file outside of the set is a content that cannot be loaded.
    fn file_content(&self, paged: &PagedObject, child: usize) -> TileContent {
        let name = paged.files.get(child).map_or("", String::as_str);
        self.file(&paged.database_path, name)
    }

    fn file(&self, database_path: &str, name: &str) -> TileContent {
        let Source { uri, options, .. } = self.source;
        let settings = self.spheres.terrain;
        match options.resolve(uri, &self.reference(database_path, name)) {
            Ok((uri, fallback)) if settings != TerrainSettings::default() => {
                TileContent::new(uri, Some(ReaderData::of(TerrainBelow { settings, fallback })))
            }
            Ok((uri, None)) => TileContent::new(uri, None),
            Ok((uri, fallback)) => {
                TileContent::new(uri, Some(ReaderData::of(ContentData { fallback, ..ContentData::default() })))
            }
            Err(error) => TileContent::refused(format!("{uri}#{name}").into(), error),
        }
    }

    /// Returns a reference to a file as a relative URI. OSG looks for it below the database path, which tools often leave
    /// absolute: then it is the folder of the file.
    fn reference(&self, database_path: &str, name: &str) -> String {
        let path = database_path.replace('\\', "/");
        let is_relative = !path.is_empty() && !path.starts_with('/') && !path.contains(':');
        if !path.is_empty() && !is_relative {
            self.note("OpenSceneGraph: an absolute database path (files are looked for beside the file)");
        }
        let name = escaped(name);
        if is_relative { format!("{}/{name}", escaped(path.trim_end_matches('/'))) } else { name }
    }

    pub(super) fn proxy(&mut self, object: &Arc<NodeObject>, proxy: &ProxyObject) -> Result<Node, IoError> {
        let sphere = bounds::of_center(proxy.center_mode, proxy.user_center, || BoundingSphere::EVERYTHING);
        let loading = match proxy.loading {
            ProxyMode::Immediately => ProxyLoading::Immediately,
            ProxyMode::DeferToPager => ProxyLoading::DeferToPager,
            ProxyMode::Never => ProxyLoading::Never,
        };
        let mut nodes = self.children(&object.children)?;
        for name in proxy.files.iter().filter(|name| !name.is_empty()) {
            let content = self.file(&proxy.database_path, name);
            if content.is_in_memory() {
                let reach = Reach { sphere, center: DVec3::ZERO, is_by_pixel_size: false };
                nodes.push(reach.tile(reach.range_mode(None), content, PagingOptions::default()));
                continue;
            }
            if self.spheres.terrain != TerrainSettings::default() {
                self.note("OpenSceneGraph: settings of a Terrain, which tiles in the file of a ProxyNode do not get");
            }
            let proxy = ProxyNode { uri: content.uri, bounds: sphere, content_transform: DAffine3::IDENTITY, loading };
            nodes.push(Node::new(NodeKind::ProxyNode(Box::new(proxy))));
        }
        Ok(if nodes.len() == 1 { nodes.swap_remove(0) } else { Node::group(nodes) })
    }
}

/// Returns the levels of a PagedLOD, the coarsest first. Children with the same range share a level.
fn levels(object: &NodeObject, lod: &LodObject, paged: &PagedObject) -> Vec<Level> {
    let (mut levels, mut by_range) = (Vec::<Level>::new(), HashMap::new());
    for child in 0..paged.files.len().max(object.children.len()) {
        let range = lod.ranges.get(child).copied().unwrap_or(NEVER);
        let is_file = paged.files.get(child).is_some_and(|name| !name.is_empty());
        let inline = object.children.get(child).filter(|_| !is_file);
        // A range without extent is never shown; neither is NaN.
        if range[0] < range[1] && (is_file || inline.is_some()) {
            let at = *by_range.entry(range.map(f64::to_bits)).or_insert(levels.len());
            if at == levels.len() {
                levels.push(Level { range, inline: Vec::new(), files: Vec::new(), child });
            }
            levels[at].inline.extend(inline.cloned());
            if is_file {
                levels[at].files.push(child);
            }
        }
    }
    // Coarse levels are for small sizes or large distances.
    match lod.is_by_pixel_size {
        true => levels.sort_by(|a, b| a.range[0].total_cmp(&b.range[0])),
        false => levels.sort_by(|a, b| b.range[1].total_cmp(&a.range[1])),
    }
    levels
}

fn paging(paged: &PagedObject, child: usize) -> PagingOptions {
    let [offset, scale] = paged.priorities.get(child).copied().unwrap_or([0.0, 1.0]);
    let cannot_expire = child < paged.children_that_cannot_expire as usize && paged.children_that_cannot_expire > 1;
    PagingOptions { priority_scale: scale, priority_offset: offset, cannot_expire, ..PagingOptions::default() }
}
