//! [`ImplicitTiling`]: what all tiles of an implicit tree have in common, and the volumes that follow from it. Immutable.

use std::f64::consts::{PI, TAU};
use std::sync::Arc;

use glam::{DAffine3, DMat3, DVec3};

use super::coordinates::{MAX_LEVEL, Subdivision, TileCoordinates};
use super::json::ImplicitTilingJson;
use super::semantics::Overrides;
use super::subtree::SubtreeShape;
use super::template::UriTemplate;
use crate::fetch::IoError;
use crate::formats::options::ReadOptions;
use crate::formats::properties::Schema;
use crate::formats::tile::{ContentData, S2Cell, TileContent, UpAxis};
use crate::math::{BoundingSphere, BoundingVolume, OrientedBox, Region, max_scale};
use crate::scene::{Metadata, ReaderData, Refine, TileMetadata};

/// The volume of the root of an implicit tree, which is halved for the tiles below.
#[derive(Clone, Copy, Debug)]
pub(in crate::formats) enum RootVolume {
    /// In the frame of the tileset.
    Box(OrientedBox),
    /// On the globe. `tileset_from_set` maps from the frame of the whole set; `None` is the identity.
    Region { region: Region, tileset_from_set: Option<DAffine3> },
    /// A cell on the globe between two heights, metres.
    S2 { cell: S2Cell, heights_m: [f64; 2], tileset_from_set: Option<DAffine3> },
}

/// The root tile of an implicit tree, as the reader of the tileset knows it.
pub(in crate::formats) struct ImplicitRoot<'a> {
    /// The file that has the tile.
    pub uri: &'a Arc<str>,
    /// The options with which references are resolved.
    pub options: &'a ReadOptions,
    pub volume: RootVolume,
    /// The geometric error, metres of the tileset's frame.
    pub geometric_error_m: f64,
    pub refine: Refine,
    /// Maps contents to the tileset's frame.
    pub content_transform: DAffine3,
    /// True if a content above is replaced by the tiles below.
    pub is_replaced: bool,
    /// The contents.
    pub contents: Vec<ContentTemplate<'a>>,
    /// The up axis of glTF contents.
    pub up_axis: UpAxis,
    /// The schema of the tileset's metadata.
    pub schema: Option<Arc<Schema>>,
    /// The metadata of the groups, if it is kept.
    pub groups: Arc<[Option<Arc<Metadata>>]>,
}

/// A content that all tiles of an implicit tree may have.
pub(in crate::formats) struct ContentTemplate<'a> {
    /// The reference, with placeholders.
    pub reference: &'a str,
    /// The metadata of its group.
    pub group: Option<Arc<Metadata>>,
}

/// The properties that all tiles of an implicit tree share.
#[derive(Debug)]
pub(in crate::formats) struct ImplicitTiling {
    /// The file of the tileset, and where redirects led.
    uri: Arc<str>,
    base: Option<Arc<str>>,
    pub(super) shape: SubtreeShape,
    /// Tiles are in levels below this number.
    pub(super) available_levels: u32,
    subtrees: UriTemplate,
    contents: Vec<UriTemplate>,
    /// The metadata of the groups of the contents, by the number of the content.
    content_groups: Vec<Option<Arc<Metadata>>>,
    /// The metadata of all groups of the tileset.
    groups: Arc<[Option<Arc<Metadata>>]>,
    volume: RootVolume,
    geometric_error_m: f64,
    pub(super) refine: Refine,
    pub(super) content_transform: DAffine3,
    pub(super) is_replaced: bool,
    /// Reader data of all contents that need no other.
    content_data: Option<ReaderData>,
    up_axis: UpAxis,
    /// The schema of the tiles' metadata.
    schema: Option<Arc<Schema>>,
}

impl ImplicitTiling {
    /// Checks the JSON of an implicit root.
    pub fn new(json: &ImplicitTilingJson, root: ImplicitRoot<'_>) -> Result<Self, IoError> {
        let bad = |reason: String| IoError::invalid(root.uri, format!("implicitTiling.{reason}"));
        let scheme = json.subdivision_scheme.0.as_deref().unwrap_or_default();
        let subdivision = match scheme.to_ascii_uppercase().as_str() {
            "QUADTREE" => Subdivision::Quadtree,
            "OCTREE" => Subdivision::Octree,
            _ => return Err(bad(format!("subdivisionScheme is {scheme:?}, expected QUADTREE or OCTREE"))),
        };
        let max_levels = subdivision.max_subtree_levels();
        let levels = json.subtree_levels.filter(|levels| (1..=max_levels).contains(levels));
        let levels = levels.ok_or_else(|| {
            let got = json.subtree_levels.map_or("missing".to_owned(), |levels| levels.to_string());
            bad(format!("subtreeLevels is {got}, expected 1 to {max_levels}"))
        })?;
        let available = json.available_levels.or(json.maximum_level.map(|level| level.saturating_add(1)));
        let available_levels = available.filter(|levels| *levels > 0);
        let available_levels =
            available_levels.ok_or_else(|| bad("availableLevels is missing or 0".to_owned()))?.min(MAX_LEVEL + 1);
        let subtrees = json.subtrees.as_ref().and_then(|subtrees| subtrees.uri.0.as_deref());
        let subtrees = subtrees.ok_or_else(|| bad("subtrees.uri is missing".to_owned()))?;
        let resolve = |template: &str| UriTemplate::resolve(root.uri, template, root.options);
        let content_data = (root.up_axis != UpAxis::Y)
            .then(|| ReaderData::of(ContentData { up_axis: root.up_axis, ..ContentData::default() }));
        let contents = root.contents.iter().map(|of| resolve(of.reference)).collect::<Result<Vec<_>, _>>()?;
        Ok(Self {
            uri: root.uri.clone(),
            base: root.options.base.clone(),
            content_groups: root.contents.into_iter().map(|of| of.group).collect(),
            groups: root.groups,
            shape: SubtreeShape { subdivision, levels, contents: contents.len() },
            available_levels,
            subtrees: resolve(subtrees)?,
            contents,
            volume: root.volume,
            geometric_error_m: root.geometric_error_m,
            refine: root.refine,
            content_transform: root.content_transform,
            is_replaced: root.is_replaced,
            content_data,
            up_axis: root.up_axis,
            schema: root.schema,
        })
    }

    /// Returns the URI of the subtree whose root is a tile.
    pub fn subtree_uri(&self, root: TileCoordinates) -> Arc<str> {
        self.subtrees.fill(root)
    }

    /// Returns the URI at which a subtree is looked for if its own has none.
    pub fn subtree_fallback(&self, root: TileCoordinates) -> Option<Arc<str>> {
        self.subtrees.fill_fallback(root)
    }

    /// Returns a content of a tile.
    pub(super) fn content(&self, tile: TileCoordinates, content: usize) -> Option<TileContent> {
        let template = self.contents.get(content)?;
        Some(TileContent::new(template.fill(tile), self.content_data(template.fill_fallback(tile))))
    }

    /// Returns the reader data of a content that is looked for at `fallback` if its own URI has none.
    pub(super) fn content_data(&self, fallback: Option<Arc<str>>) -> Option<ReaderData> {
        if fallback.is_none() {
            return self.content_data.clone();
        }
        let data = ContentData { up_axis: self.up_axis, fallback, ..ContentData::default() };
        Some(ReaderData::of(data))
    }

    /// Returns the metadata of a content and of its group: that with the index `group`, or that of the template.
    pub(super) fn content_metadata(
        &self,
        content: usize,
        group: Option<usize>,
        own: Option<Arc<Metadata>>,
    ) -> Option<Arc<TileMetadata>> {
        let group = match group {
            Some(group) => self.groups.get(group),
            None => self.content_groups.get(content),
        };
        TileMetadata { content: own, group: group.cloned().flatten(), ..TileMetadata::default() }.shared()
    }

    /// Returns the file that references in metadata are relative to.
    pub(super) fn uri(&self) -> &str {
        &self.uri
    }

    /// Returns the URL that redirects of that file led to.
    pub(super) fn base(&self) -> Option<&Arc<str>> {
        self.base.as_ref()
    }

    /// Returns the schema of the tiles' metadata.
    pub(super) fn schema(&self) -> Option<&Schema> {
        self.schema.as_deref()
    }

    /// Returns the geometric error of a tile of a level, metres of the tileset's frame.
    pub(super) fn geometric_error_m(&self, level: u32, overrides: &Overrides) -> f64 {
        match overrides.geometric_error.filter(|error| *error >= 0.0) {
            Some(error) => error * max_scale(&self.content_transform.matrix3),
            None => self.geometric_error_m / level_scale(level),
        }
    }

    /// Returns the volume of a tile: that of its metadata, or its part of the root's.
    pub(super) fn bounds(&self, tile: TileCoordinates, overrides: &Overrides) -> BoundingVolume {
        if let Some([cx, cy, cz, axes @ ..]) = overrides.oriented_box {
            let [x, y, z] = [0, 3, 6].map(|at| DVec3::from_slice(&axes[at..]));
            let own = OrientedBox { center: DVec3::new(cx, cy, cz), half_axes: DMat3::from_cols(x, y, z) };
            return BoundingVolume::Box(own.transformed(&self.content_transform));
        }
        let tileset_from_set = match &self.volume {
            RootVolume::Box(_) => None,
            RootVolume::Region { tileset_from_set, .. } | RootVolume::S2 { tileset_from_set, .. } => {
                tileset_from_set.as_ref()
            }
        };
        if let Some([west, south, east, north, min_height_m, max_height_m]) = overrides.region {
            let own = Region { west, south, east, north, min_height_m, max_height_m };
            return placed(with_heights(own, overrides), tileset_from_set);
        }
        if let Some([x, y, z, radius_m]) = overrides.sphere {
            let own = BoundingSphere::new(DVec3::new(x, y, z), radius_m.max(0.0));
            return BoundingVolume::Sphere(own.transformed(&self.content_transform));
        }
        match self.volume {
            RootVolume::Box(root) => BoundingVolume::Box(self.part_of_box(&root, tile)),
            RootVolume::Region { region, tileset_from_set } => {
                placed(with_heights(self.part_of_region(&region, tile), overrides), tileset_from_set.as_ref())
            }
            RootVolume::S2 { cell, heights_m: [low, high], tileset_from_set } => {
                let (from, to) = self.parts(tile)[2];
                let (part_low, part_high) = (low + (high - low) * from, low + (high - low) * to);
                let low = overrides.min_height_m.unwrap_or(part_low);
                let high = overrides.max_height_m.unwrap_or(part_high);
                let b = cell.part(tile.level, tile.x, tile.y).oriented_box(low, high);
                BoundingVolume::Box(tileset_from_set.map_or(b, |map| b.transformed(&map)))
            }
        }
    }

    fn part_of_box(&self, root: &OrientedBox, tile: TileCoordinates) -> OrientedBox {
        let [x, y, z] = self.parts(tile).map(|(from, to)| (from + to - 1.0, to - from));
        let axes = &root.half_axes;
        let mut part = *root;
        part.center += axes.x_axis * x.0 + axes.y_axis * y.0 + axes.z_axis * z.0;
        part.half_axes.x_axis *= x.1;
        part.half_axes.y_axis *= y.1;
        part.half_axes.z_axis *= z.1;
        part
    }

    fn part_of_region(&self, root: &Region, tile: TileCoordinates) -> Region {
        let [x, y, z] = self.parts(tile);
        let (width, height, rise) = (root.width(), root.north - root.south, root.max_height_m - root.min_height_m);
        // A part of a region that crosses the antimeridian may lie beyond it.
        let wrapped = |longitude: f64| if longitude > PI { longitude - TAU } else { longitude };
        let (west, east) = (wrapped(root.west + width * x.0), wrapped(root.west + width * x.1));
        Region {
            west,
            south: root.south + height * y.0,
            east,
            north: root.south + height * y.1,
            min_height_m: root.min_height_m + rise * z.0,
            max_height_m: root.min_height_m + rise * z.1,
        }
    }

    /// Returns the ends of a tile along x, y and z as shares of the root's length.
    fn parts(&self, tile: TileCoordinates) -> [(f64, f64); 3] {
        let count = level_scale(tile.level);
        let part = |at: u32| (f64::from(at) / count, (f64::from(at) + 1.0) / count);
        let z = match self.shape.subdivision {
            Subdivision::Quadtree => (0.0, 1.0),
            Subdivision::Octree => part(tile.z),
        };
        [part(tile.x), part(tile.y), z]
    }

    /// Returns the bytes of CPU memory.
    pub(super) fn size_bytes(&self) -> u64 {
        let texts = self.contents.iter().chain([&self.subtrees]).map(UriTemplate::size_bytes).sum::<u64>();
        size_of::<Self>() as u64 + texts
    }
}

/// Returns the number of tiles along an axis of a level.
fn level_scale(level: u32) -> f64 {
    f64::from(level).exp2()
}

/// Returns a region with the heights of a tile's metadata.
fn with_heights(region: Region, overrides: &Overrides) -> Region {
    let min_height_m = overrides.min_height_m.unwrap_or(region.min_height_m);
    let max_height_m = overrides.max_height_m.unwrap_or(region.max_height_m);
    Region { min_height_m, max_height_m, ..region }
}

/// Returns the volume of a region for a tileset that transforms above it move. The inverse keeps the region in its position.
fn placed(region: Region, tileset_from_set: Option<&DAffine3>) -> BoundingVolume {
    match tileset_from_set {
        None => BoundingVolume::Region(region),
        Some(map) => BoundingVolume::Box(region.oriented_box().transformed(map)),
    }
}
