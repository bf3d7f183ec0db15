//! tileset.json of OGC 3D Tiles 1.0 and 1.1 (explicit tilesets) to PagedLods and ProxyNodes.
//!
//! Transforms are multiplied down: a tile's volume and content transform end up in the tileset's frame, and the
//! scale of the transform scales the geometric error, as the specification says.

use std::sync::Arc;

use glam::{DAffine3, DMat3, DMat4, DVec3};
use serde::Deserialize;
use serde::de::IgnoredAny;

use super::extras::Extras;
use super::height::{HeightSet, SetExtras, TileExtras};
use super::uri::path_of;
use super::{IoError, ReadOptions, resolve};
use crate::math::{BoundingSphere, BoundingVolume, OrientedBox, Region};
use crate::scene::{Node, NodeKind, PagedLod, PagingOptions, ProxyLoading, ProxyNode, RangeMode, Refine};

/// Extensions that a tileset may require and that are read (or change nothing for drawing).
const KNOWN_EXTENSIONS: &[&str] = &["3DTILES_content_gltf"];

#[derive(Deserialize)]
pub(crate) struct TilesetJson {
    pub asset: AssetJson,
    #[serde(rename = "extensionsRequired", default)]
    pub extensions_required: Vec<String>,
    #[serde(rename = "extensionsUsed", default)]
    pub extensions_used: Vec<String>,

    pub root: TileJson,
}

#[derive(Deserialize)]
pub(crate) struct AssetJson {
    pub version: String,
    #[serde(default)]
    pub extras: Extras<SetExtras>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(crate) struct TileJson {
    pub bounding_volume: VolumeJson,
    #[serde(default)]
    pub viewer_request_volume: Option<VolumeJson>,
    pub geometric_error: f64,
    #[serde(default)]
    pub refine: Option<String>,
    #[serde(default)]
    pub transform: Option<Vec<f64>>,
    #[serde(default)]
    pub content: Option<ContentJson>,
    #[serde(default)]
    pub contents: Vec<ContentJson>,
    #[serde(default)]
    pub children: Vec<TileJson>,
    #[serde(default)]
    pub implicit_tiling: Option<IgnoredAny>,
    #[serde(default)]
    pub extensions: Option<TileExtensions>,
    #[serde(default)]
    pub extras: Extras<TileExtras>,
}

#[derive(Deserialize)]
pub(crate) struct TileExtensions {
    #[serde(rename = "3DTILES_implicit_tiling", default)]
    implicit_tiling: Option<IgnoredAny>,
}

#[derive(Deserialize)]
pub(crate) struct VolumeJson {
    #[serde(rename = "box", default)]
    pub oriented_box: Option<Vec<f64>>,
    #[serde(default)]
    pub region: Option<Vec<f64>>,
    #[serde(default)]
    pub sphere: Option<Vec<f64>>,
}

#[derive(Deserialize)]
pub(crate) struct ContentJson {
    #[serde(default)]
    pub uri: Option<String>,
    #[serde(default)]
    pub url: Option<String>,
}

impl ContentJson {
    pub fn uri(&self) -> Option<&str> {
        self.uri.as_deref().or(self.url.as_deref())
    }
}

/// Parses the JSON, a UTF-8 byte order mark tolerated. Depth is bounded by serde_json (128) and by the limits.
pub(crate) fn parse(uri: &str, bytes: &[u8]) -> Result<TilesetJson, IoError> {
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    let tileset: TilesetJson =
        serde_json::from_slice(bytes).map_err(|e| IoError::invalid(uri, format!("tileset JSON: {e}")))?;
    if !matches!(tileset.asset.version.as_str(), "0.0" | "1.0" | "1.1") {
        return Err(IoError::unsupported(uri, format!("3D Tiles version {}", tileset.asset.version)));
    }
    for name in &tileset.extensions_required {
        if !KNOWN_EXTENSIONS.contains(&name.as_str()) {
            return Err(IoError::unsupported(uri, format!("required extension {name}")));
        }
    }
    Ok(tileset)
}

/// An error that is seen from everywhere.
const ALWAYS_M: f64 = f64::MAX / 1e6;

/// What holds above a tile.
#[derive(Clone, Copy)]
struct Above {
    /// That of the parent, which a tile has that says none.
    refine: Refine,
    /// Content above gives way to what is below it.
    is_replaced: bool,
    level: u32,
}

/// A tileset as nodes: a tile is a PagedLod, an external tileset a ProxyNode.
pub(crate) fn read(uri: &Arc<str>, bytes: &[u8], options: &ReadOptions) -> Result<Node, IoError> {
    if options.chain.iter().any(|above| above == uri) {
        return Err(IoError::unsupported(uri, "the tileset contains itself"));
    }
    if options.chain.len() >= options.limits.max_external_depth {
        return Err(IoError::TooLarge {
            uri: uri.to_string(),
            what: "depth of external tilesets",
            got: options.chain.len() as u64 + 1,
            limit: options.limits.max_external_depth as u64,
        });
    }
    let tileset = parse(uri, bytes)?;
    let heights = HeightSet::from_extras(uri, tileset.asset.extras.0)?;
    let mut reader = Reader { uri, options, heights, tiles: 0 };
    // What shows an external tileset's place meanwhile is not known here.
    let above = Above { refine: Refine::Replace, is_replaced: !options.chain.is_empty(), level: 0 };
    reader.tile(tileset.root, DAffine3::IDENTITY, above)
}

struct Reader<'a> {
    uri: &'a Arc<str>,
    options: &'a ReadOptions,
    heights: Option<HeightSet>,
    tiles: usize,
}

impl Reader<'_> {
    fn tile(&mut self, json: TileJson, parent: DAffine3, above: Above) -> Result<Node, IoError> {
        let level = above.level;
        let limits = &self.options.limits;
        self.tiles += 1;
        if self.tiles > limits.max_elements || level > limits.max_depth {
            return Err(IoError::TooLarge {
                uri: self.uri.to_string(),
                what: "tile tree",
                got: self.tiles as u64,
                limit: limits.max_elements as u64,
            });
        }
        let implicit_1_0 = json.extensions.as_ref().is_some_and(|e| e.implicit_tiling.is_some());
        if json.implicit_tiling.is_some() || implicit_1_0 {
            return Err(IoError::unsupported(self.uri, "implicit tiling"));
        }
        let world = match &json.transform {
            Some(m) => parent * self.affine(m)?,
            None => parent,
        };
        let refine = match json.refine.as_deref() {
            Some(r) if r.eq_ignore_ascii_case("add") => Refine::Add,
            Some(r) if r.eq_ignore_ascii_case("replace") => Refine::Replace,
            _ => above.refine,
        };
        let bounds = self.volume(&json.bounding_volume, &world)?;
        let request_volume = json.viewer_request_volume.as_ref().map(|v| self.volume(v, &world)).transpose()?;
        if !(json.geometric_error.is_finite() && json.geometric_error >= 0.0) {
            return Err(IoError::invalid(self.uri, format!("geometricError {} of a tile", json.geometric_error)));
        }
        let scale = crate::math::max_scale(&world.matrix3);
        let mut geometric_error_m = json.geometric_error * scale;
        let mut reader_data = None;
        if let Some(heights) = &self.heights {
            geometric_error_m = heights.level_error_m(level).unwrap_or(geometric_error_m);
            reader_data = heights.tile_data(self.uri, level, &bounds, json.extras.0.as_ref(), &self.options.root)?;
        }
        let mut children = Vec::with_capacity(json.children.len());
        let mut contents: Vec<Arc<str>> = Vec::new();
        for content in json.content.iter().chain(&json.contents) {
            let reference = content.uri().ok_or_else(|| IoError::invalid(self.uri, "content without a uri"))?;
            let uri = resolve(self.uri, reference, &self.options.root)?;
            if path_of(&uri).ends_with(".json") {
                children.push(Node::new(NodeKind::ProxyNode(Box::new(ProxyNode {
                    uri,
                    bounds: bounds.bounding_sphere(),
                    content_transform: world,
                    loading: ProxyLoading::DeferToPager,
                }))));
            } else {
                contents.push(uri);
            }
        }
        // An external tileset is the tile's only refinement: without other content the tile is an empty one.
        let mut contents = contents.into_iter();
        let first = contents.next();
        // Without content it shows nothing where its error is small, which leaves a hole where content above has given way.
        // External tilesets are refined to wherever they are met.
        if first.is_none() && (above.is_replaced || !children.is_empty()) {
            geometric_error_m = ALWAYS_M;
        }
        let replaces = first.is_some() && refine == Refine::Replace;
        let below = Above { refine, is_replaced: above.is_replaced || replaces, level: level + 1 };
        let extra: Vec<Node> = contents
            .map(|uri| {
                Node::new(NodeKind::PagedLod(Box::new(PagedLod {
                    bounds,
                    range_mode: RangeMode::ScreenSpaceError { geometric_error_m: 0.0 },
                    refine,
                    content: Some(uri),
                    content_transform: world,
                    reader_data: None,
                    request_volume,
                    paging: PagingOptions::default(),
                })))
            })
            .collect();
        for child in json.children {
            children.push(self.tile(child, world, below)?);
        }
        let tile = Node {
            children,
            ..Node::new(NodeKind::PagedLod(Box::new(PagedLod {
                bounds,
                range_mode: RangeMode::ScreenSpaceError { geometric_error_m },
                refine,
                content: first,
                content_transform: world,
                reader_data,
                request_volume,
                paging: PagingOptions::default(),
            })))
        };
        if extra.is_empty() {
            return Ok(tile);
        }
        // Several contents of one tile: they come and go together as leaves of an empty ADD tile beside the first.
        if tile.children.is_empty() || refine == Refine::Add {
            let mut all = vec![tile];
            all.extend(extra);
            return Ok(Node {
                children: all,
                ..Node::new(NodeKind::MultiContentTile(Box::new(PagedLod {
                    bounds,
                    range_mode: RangeMode::ScreenSpaceError { geometric_error_m: ALWAYS_M },
                    refine: Refine::Add,
                    content: None,
                    content_transform: world,
                    reader_data: None,
                    request_volume,
                    paging: PagingOptions::default(),
                })))
            });
        }
        Err(IoError::unsupported(self.uri, "several contents in a tile that its children replace"))
    }

    fn affine(&self, m: &[f64]) -> Result<DAffine3, IoError> {
        let m: [f64; 16] =
            m.try_into().map_err(|_| IoError::invalid(self.uri, format!("transform of {} numbers", m.len())))?;
        let m = DMat4::from_cols_array(&m);
        if !m.is_finite() || m.row(3) != glam::DVec4::W {
            return Err(IoError::invalid(self.uri, "transform of a tile is not affine and finite"));
        }
        Ok(DAffine3::from_mat4(m))
    }

    fn volume(&self, json: &VolumeJson, world: &DAffine3) -> Result<BoundingVolume, IoError> {
        let bad = |what: &str, v: &[f64]| IoError::invalid(self.uri, format!("bounding {what} {v:?}"));
        if let Some(v) = &json.oriented_box {
            let &[cx, cy, cz, ax, ay, az, bx, by, bz, gx, gy, gz] = v.as_slice() else { return Err(bad("box", v)) };
            let b = OrientedBox {
                center: DVec3::new(cx, cy, cz),
                half_axes: DMat3::from_cols(DVec3::new(ax, ay, az), DVec3::new(bx, by, bz), DVec3::new(gx, gy, gz)),
            };
            if !v.iter().all(|x| x.is_finite() && x.abs() < 1e15) {
                return Err(bad("box", v));
            }
            return Ok(BoundingVolume::Box(b.transformed(world)));
        }
        if let Some(v) = &json.region {
            let &[west, south, east, north, min_height_m, max_height_m] = v.as_slice() else {
                return Err(bad("region", v));
            };
            let pi = std::f64::consts::PI + 1e-6;
            let finite = v.iter().all(|x| x.is_finite() && x.abs() < 1e9);
            let angles = west.abs() <= pi && east.abs() <= pi && south.abs() <= 0.5 * pi && north.abs() <= 0.5 * pi;
            if !finite || !angles || south > north || min_height_m > max_height_m {
                return Err(bad("region", v));
            }
            let region = BoundingVolume::Region(Region { west, south, east, north, min_height_m, max_height_m });
            // A region stays where it is, whatever transforms the tiles above this tileset have.
            let content_from_set = self.options.set_from_content.inverse();
            if self.options.set_from_content == DAffine3::IDENTITY || !content_from_set.is_finite() {
                return Ok(region);
            }
            let placed = region.oriented_box().map(|b| BoundingVolume::Box(b.transformed(&content_from_set)));
            return Ok(
                placed.unwrap_or(BoundingVolume::Sphere(region.bounding_sphere().transformed(&content_from_set)))
            );
        }
        if let Some(v) = &json.sphere {
            let &[x, y, z, radius_m] = v.as_slice() else { return Err(bad("sphere", v)) };
            if !v.iter().all(|x| x.is_finite() && x.abs() < 1e15) || radius_m < 0.0 {
                return Err(bad("sphere", v));
            }
            let s = BoundingSphere::new(DVec3::new(x, y, z), radius_m);
            return Ok(BoundingVolume::Sphere(s.transformed(world)));
        }
        Err(IoError::invalid(self.uri, "boundingVolume has neither box, region nor sphere"))
    }
}
