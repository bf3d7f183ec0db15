//! [`ImplicitTiling`]: what all tiles of an implicit tree have in common, and the volumes that follow from it. Immutable.

use std::f64::consts::{PI, TAU};
use std::sync::Arc;

use glam::DAffine3;

use super::coordinates::{MAX_LEVEL, Subdivision, TileCoordinates};
use super::json::ImplicitTilingJson;
use super::semantics::{Overrides, Shape, VolumeOverrides};
use super::subtree::SubtreeShape;
use super::template::UriTemplate;
use crate::fetch::IoError;
use crate::formats::height::{HeightSet, HeightTileJson, PlacedErrors};
use crate::formats::options::ReadOptions;
use crate::formats::properties::Schema;
use crate::formats::tile::{ContentData, S2Cell, TileContent, UpAxis};
use crate::math::{BoundingVolume, Ellipsoid, OrientedBox, Region, max_scale};
use crate::scene::{Metadata, ReaderData, Refine, TileMetadata};

/// The volume of the root of an implicit tree, which is halved for the tiles below.
#[derive(Clone, Copy, Debug)]
pub(in crate::formats) enum RootVolume {
    /// In the frame of the root tile.
    Box(OrientedBox),
    /// On the globe.
    Region(Region),
    /// A cell on the globe between two heights, metres.
    S2 { cell: S2Cell, heights_m: [f64; 2] },
}

/// The root tile of an implicit tree, as the reader of the tileset knows it.
pub(in crate::formats) struct ImplicitRoot<'a> {
    /// The file that has the tile.
    pub uri: &'a Arc<str>,
    /// The options with which references are resolved.
    pub options: &'a ReadOptions,
    pub volume: RootVolume,
    /// Maps from the frame of the whole set to that of the tileset, for volumes on the globe; `None` is the identity.
    pub tileset_from_set: Option<DAffine3>,
    /// The geometric error, metres before the scale of the tile.
    pub geometric_error: f64,
    pub refine: Refine,
    /// Maps contents to the tileset's frame.
    pub content_transform: DAffine3,
    /// Maps from the frame of the tile above the root to the tileset's frame.
    pub parent_transform: DAffine3,
    /// True if a content above is replaced by the tiles below.
    pub is_replaced: bool,
    /// The contents.
    pub contents: Vec<ContentTemplate<'a>>,
    /// The properties of height tiles, if the contents are some.
    pub heights: Option<HeightTemplate<'a>>,
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

/// The properties that the height tiles of an implicit tree may have.
pub(in crate::formats) struct HeightTemplate<'a> {
    pub set: HeightSet,
    /// The level of the root of the implicit tree in its tileset.
    pub root_level: u32,
    /// The errors of the tile above the root.
    pub above: Option<PlacedErrors>,
    /// The rectangle of the root, which is halved for the tiles below; `None` for a root with a region.
    pub plane: Option<[f64; 4]>,
    /// The reference to the image of each tile, with placeholders.
    pub imagery: Option<&'a str>,
}

/// The properties of the height tiles of an implicit tree.
#[derive(Debug)]
struct ImplicitHeights {
    set: HeightSet,
    root_level: u32,
    above: Option<PlacedErrors>,
    plane: Option<[f64; 4]>,
    imagery: Option<UriTemplate>,
}

/// The properties that all tiles of an implicit tree share. More than 16 fields: one for each property of the root.
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
    /// The ellipsoid of regions and of S2 cells.
    ellipsoid: Ellipsoid,
    tileset_from_set: Option<DAffine3>,
    /// The error of the root, metres before the scale of the tile.
    geometric_error: f64,
    pub(super) refine: Refine,
    content_transform: DAffine3,
    parent_transform: DAffine3,
    pub(super) is_replaced: bool,
    /// Reader data of all contents that need no other.
    content_data: Option<ReaderData>,
    /// Present if the contents are height tiles.
    heights: Option<ImplicitHeights>,
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
        if root.heights.is_some() && subdivision == Subdivision::Octree {
            return Err(IoError::unsupported(root.uri, "an octree of height tiles"));
        }
        let heights = root.heights.map(|HeightTemplate { set, root_level, above, plane, imagery }| {
            let imagery = imagery.map(resolve).transpose()?;
            Ok::<_, IoError>(ImplicitHeights { set, root_level, above, plane, imagery })
        });
        Ok(Self {
            heights: heights.transpose()?,
            uri: root.uri.clone(),
            base: root.options.base.clone(),
            content_groups: root.contents.into_iter().map(|of| of.group).collect(),
            groups: root.groups,
            shape: SubtreeShape { subdivision, levels, contents: contents.len() },
            available_levels,
            subtrees: resolve(subtrees)?,
            contents,
            volume: root.volume,
            ellipsoid: root.options.ellipsoid,
            tileset_from_set: root.tileset_from_set,
            geometric_error: root.geometric_error,
            refine: root.refine,
            content_transform: root.content_transform,
            parent_transform: root.parent_transform,
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

    /// Returns the errors of a height tile and its reader data. It has its part of the root, whatever its metadata says, so that
    /// neighbours meet. `above` are the errors of the tile above; `None` for the root of the tree. Returns `None` if the
    /// contents are no height tiles.
    pub(super) fn height_data(
        &self,
        tile: TileCoordinates,
        overrides: &Overrides,
        transform: &DAffine3,
        above: Option<&PlacedErrors>,
    ) -> Option<Result<(PlacedErrors, Arc<str>), IoError>> {
        let heights = self.heights.as_ref()?;
        let bounds = self.bounds(tile, &VolumeOverrides::default(), transform);
        let plane = heights.plane.map(|[west, south, east, north]| {
            let [x, y, _] = self.parts(tile);
            let (width, height) = (east - west, north - south);
            [west + width * x.0, south + height * y.0, west + width * x.1, south + height * y.1]
        });
        let described = HeightTileJson {
            level: heights.root_level + tile.level,
            bounds: &bounds,
            plane,
            region: None,
            imagery: heights.imagery.as_ref().map(|template| template.fill(tile)),
            corner_errors_m: overrides.corner_errors_m,
            geometric_error_m: self.geometric_error_m(tile.level, overrides, transform),
        };
        let errors = heights.set.errors(&self.uri, &described, above.or(heights.above.as_ref()));
        Some(errors.and_then(|errors| Ok((errors, heights.set.tile_data(&self.uri, described, &errors)?))))
    }

    /// Returns true if the contents are height tiles.
    pub(super) fn has_heights(&self) -> bool {
        self.heights.is_some()
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

    /// Returns the transform from a tile to the tileset's frame. `above` is that of the tile above; `None` for the root of the
    /// tree, whose transform in the tileset `own` replaces. `own` maps to the frame of the tile above.
    pub(super) fn tile_transform(&self, above: Option<&DAffine3>, own: Option<&DAffine3>) -> DAffine3 {
        match (above, own) {
            (None, None) => self.content_transform,
            (None, Some(own)) => self.parent_transform * *own,
            (Some(above), None) => *above,
            (Some(above), Some(own)) => *above * *own,
        }
    }

    /// Returns the geometric error of a tile of a level, metres of the tileset's frame.
    pub(super) fn geometric_error_m(&self, level: u32, overrides: &Overrides, transform: &DAffine3) -> f64 {
        let by_level = self.geometric_error / level_scale(level);
        overrides.geometric_error.unwrap_or(by_level) * max_scale(&transform.matrix3)
    }

    /// Returns the volume of a tile or of its content: that of the metadata, or the tile's part of the root's. `transform` is
    /// that of the tile.
    pub(super) fn bounds(
        &self,
        tile: TileCoordinates,
        overrides: &VolumeOverrides,
        transform: &DAffine3,
    ) -> BoundingVolume {
        match overrides.shape.unwrap_or_else(|| self.part(tile)) {
            Shape::Box(own) => BoundingVolume::Box(own.transformed(transform)),
            Shape::Sphere(own) => BoundingVolume::Sphere(own.transformed(transform)),
            Shape::Region(own) => {
                let min_height_m = overrides.min_height_m.unwrap_or(own.min_height_m);
                let max_height_m = overrides.max_height_m.unwrap_or(own.max_height_m);
                let region = Region { min_height_m, max_height_m, ellipsoid: self.ellipsoid, ..own };
                match &self.tileset_from_set {
                    None => BoundingVolume::Region(region),
                    Some(map) => BoundingVolume::Box(region.oriented_box().transformed(map)),
                }
            }
            Shape::S2(cell) => {
                let [low, high] = self.heights_m(tile);
                let (low, high) = (overrides.min_height_m.unwrap_or(low), overrides.max_height_m.unwrap_or(high));
                let b = cell.oriented_box(&self.ellipsoid, low, high);
                BoundingVolume::Box(self.tileset_from_set.map_or(b, |map| b.transformed(&map)))
            }
        }
    }

    /// Returns the shape that follows from the position of a tile.
    fn part(&self, tile: TileCoordinates) -> Shape {
        match &self.volume {
            RootVolume::Box(root) => Shape::Box(self.part_of_box(root, tile)),
            RootVolume::Region(root) => Shape::Region(self.part_of_region(root, tile)),
            RootVolume::S2 { cell, .. } => Shape::S2(cell.part(tile.level, tile.x, tile.y)),
        }
    }

    /// Returns the lowest and the highest height that follow from the position of a tile, metres; 0 in a tree of boxes.
    fn heights_m(&self, tile: TileCoordinates) -> [f64; 2] {
        let [low, high] = match &self.volume {
            RootVolume::Box(_) => [0.0; 2],
            RootVolume::Region(root) => [root.min_height_m, root.max_height_m],
            RootVolume::S2 { heights_m, .. } => *heights_m,
        };
        let (from, to) = self.parts(tile)[2];
        [low + (high - low) * from, low + (high - low) * to]
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
            ellipsoid: root.ellipsoid,
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
