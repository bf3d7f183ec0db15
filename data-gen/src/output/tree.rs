//! Describes tiles as 3D Tiles JSON. Each block has a tileset of its own: `tileset.json` of the root's, and the others are
//! external tilesets, so that neither writers nor readers hold the whole tree.

use std::collections::HashMap;
use std::f64::consts::{FRAC_PI_2, PI, TAU};

use glam::{DAffine3, DMat4};
use rayon::prelude::*;
use serde_json::{Value, json};
use terrane::math::{Ellipsoid, WGS84};

use super::corner_errors::{CornerErrors, RATIO};
use super::implicit::{Entry, SUBTREE_LEVELS, SUBTREES, tile_class};
use super::mesh;
use super::options::Tiling;
use super::tile_set::{form, skirt_m};
use crate::Extent;
use crate::args::{Color, ContentKind, GenArgs, Voids};
use crate::body;
use crate::color::TEXELS;
use crate::georeference::ROUNDING;
use crate::pyramid::{Below, Block, CELLS, Coverage, QUANTUM_M, TileKey, Totals};

/// Describes the tiles of a block.
pub(crate) struct Tree<'a> {
    args: &'a GenArgs,
    block: &'a Block<'a>,
    /// The region of each tile: west, south, east and north in radians, lowest and highest height in metres.
    regions: HashMap<TileKey, [f64; 6]>,
    below: HashMap<TileKey, Below>,
    /// [`Written::distances_m`](super::tile_set::Written::distances_m).
    distances_m: HashMap<TileKey, f64>,
    /// The depth of each tile's skirt in metres.
    skirts_m: HashMap<TileKey, f64>,
    /// The geometric error of each tile in metres.
    errors_m: HashMap<TileKey, f64>,
}

impl<'a> Tree<'a> {
    pub fn new(args: &'a GenArgs, block: &'a Block<'a>, distances_m: HashMap<TileKey, f64>) -> Self {
        let below = block.below.iter().map(|below| (below.root, *below)).collect();
        let mut keys: Vec<TileKey> = block.keys().collect();
        let skirts_m = keys.par_iter().map(|key| (*key, skirt_m(args, block, *key))).collect();
        let ratio = if args.content == ContentKind::Height { RATIO } else { 1.0 };
        let (regions, errors_m) = (HashMap::new(), HashMap::new());
        let mut tree = Self { args, block, regions, below, distances_m, skirts_m, errors_m };
        keys.reverse();
        for key in keys {
            let mut region = tree.own_region(key);
            let mut error_m = tree.own_error_m(key);
            // The skirts of fine tiles may be the deeper ones.
            for child in key.children() {
                if let Some(child) = tree.regions.get(&child).or(tree.below.get(&child).map(|below| &below.region)) {
                    (region[4], region[5]) = (region[4].min(child[4]), region[5].max(child[5]));
                }
                let of_child = tree.errors_m.get(&child).copied();
                let of_child = of_child.or(tree.below.get(&child).map(|below| below.geometric_error_m));
                error_m = error_m.max(ratio * of_child.unwrap_or(0.0));
            }
            tree.regions.insert(key, region);
            tree.errors_m.insert(key, error_m);
        }
        tree
    }

    /// Returns the region of the block's root tile; an empty one if it has no data.
    pub fn root_region(&self) -> [f64; 6] {
        self.regions.get(&self.block.root).copied().unwrap_or_default()
    }

    fn own_region(&self, key: TileKey) -> [f64; 6] {
        let e = self.block.extent(key);
        let f = self.block.facts(key);
        let low_m = f64::from(f.min_height_m)
            - self.skirt_m(key)
            - sagitta_m(&self.block.ellipsoid(), &e)
            - self.distance_m(key);
        let high_m = f64::from(f.max_height_m);
        let slack_m = 0.1 + self.half_step_m(key);
        // A region across the date line has its west edge east of its east edge in 3D Tiles.
        let [mut west, mut east] = [e.west, e.east].map(|l| if l > PI + ROUNDING { l - TAU } else { l });
        // Tiles of aligned sets reach beyond the earth's coordinates.
        if e.east - e.west >= TAU {
            (west, east) = (-PI, PI);
        }
        let [south, north] = [e.south, e.north].map(|l| l.clamp(-FRAC_PI_2, FRAC_PI_2));
        [west.max(-PI), south, east, north, low_m - slack_m, high_m + slack_m]
    }

    /// Returns the largest rounding of quantized vertices in metres. It is added to the volume and to the error.
    fn half_step_m(&self, key: TileKey) -> f64 {
        let f = self.block.facts(key);
        half_step_m(
            &self.block.ellipsoid(),
            &self.block.extent(key),
            f64::from(f.max_height_m - f.min_height_m) + self.skirt_m(key),
        )
    }

    fn skirt_m(&self, key: TileKey) -> f64 {
        self.skirts_m.get(&key).copied().unwrap_or(0.0)
    }

    /// Returns the largest distance of a tile's triangles from those of the whole grid, in metres.
    fn distance_m(&self, key: TileKey) -> f64 {
        self.distances_m.get(&key).copied().unwrap_or(0.0)
    }

    fn own_error_m(&self, key: TileKey) -> f64 {
        let is_quantized = form(self.args, self.block, key) == ContentKind::Mesh && !self.args.float_vertices;
        let rounding_m = if is_quantized { self.half_step_m(key) } else { 0.0 };
        let error_m = self.block.facts(key).error_m + self.distance_m(key) + rounding_m;
        error_m.max(self.texel_m(key))
    }

    /// Returns the size of a texel of a height tile in metres; 0 for a tile that has no finer image. With a smaller error the
    /// images of flat ground would stay coarse.
    fn texel_m(&self, key: TileKey) -> f64 {
        let has_finer_image = self.args.color != Color::None && key.level + 1 < self.block.levels();
        if self.args.content != ContentKind::Height || !has_finer_image {
            return 0.0;
        }
        let e = self.block.extent(key);
        (e.north - e.south) * self.block.ellipsoid().semi_major_m / TEXELS as f64
    }

    /// Returns the geometric error of a tile with data in metres, at least that of each child; of height tiles at least
    /// [`RATIO`] times that.
    pub fn geometric_error_m(&self, key: TileKey) -> f64 {
        self.errors_m.get(&key).copied().unwrap_or(0.0)
    }

    /// Returns the tile of the block's root with its descendants in an external tileset, as JSON.
    pub fn external_root(&self) -> String {
        let mut tree = self.tile(self.block.root, DAffine3::IDENTITY, "../../");
        tree["refine"] = "REPLACE".into();
        tree.to_string()
    }

    /// Returns the tiles of the block for subtree files.
    pub fn entries(&self) -> Vec<Entry> {
        let contents = self.contents();
        let entry = |key: TileKey| {
            let region = self.regions.get(&key)?;
            let form = form(self.args, self.block, key);
            let content = contents.iter().position(|content| *content == form)?;
            let geometric_error_m = self.geometric_error_m(key);
            let heights_m = [region[4], region[5]];
            Some(Entry { key, contents: 1 << content, geometric_error_m, heights_m, corner_errors_m: None })
        };
        self.block.keys().filter_map(entry).collect()
    }

    /// Returns the forms of content that tiles of the set may have.
    pub fn contents(&self) -> &'static [ContentKind] {
        match self.args.content {
            ContentKind::Height => &[ContentKind::Height, ContentKind::Mesh],
            _ => &[ContentKind::Mesh],
        }
    }

    /// Returns the set's root tile with its descendants in the block.
    pub fn root(&self) -> Value {
        match self.args.output.tiling {
            Tiling::Implicit => self.implicit_root(),
            Tiling::Explicit => self.tile(TileKey::ROOT, DAffine3::IDENTITY, ""),
        }
    }

    /// Returns the root tile of an implicit tiling.
    fn implicit_root(&self) -> Value {
        let levels = self.block.levels();
        let template = |extension: &str| format!("{{level}}/{{x}}/{{y}}.{extension}");
        let mut tile = json!({
            "boundingVolume": { "region": self.regions.get(&TileKey::ROOT) },
            "geometricError": self.geometric_error_m(TileKey::ROOT),
            "implicitTiling": {
                "subdivisionScheme": "QUADTREE", "subtreeLevels": SUBTREE_LEVELS, "availableLevels": levels,
                "subtrees": { "uri": SUBTREES },
            },
        });
        match self.args.content {
            ContentKind::Height => {
                tile["contents"] = json!([{ "uri": template(self.args.output.heights()) }, { "uri": template("glb") }]);
                if self.args.color != Color::None {
                    let imagery = template(self.args.tiles.texture.extension());
                    tile["extras"] = json!({ "terrane": { "imagery": imagery } });
                }
            }
            _ => tile["content"] = json!({ "uri": template("glb") }),
        }
        tile
    }

    /// Returns the tileset of the root's block. `tree` is [`Self::root`].
    pub fn tileset(&self, totals: &Totals, tree: Value) -> String {
        let args = self.args;
        let is_implicit = args.output.tiling == Tiling::Implicit;
        let facts = self.block.facts(TileKey::ROOT);
        let undrawn_m = undrawn_error_m(&self.block.ellipsoid(), &self.block.extent(TileKey::ROOT));
        let root_error_m = tree["geometricError"].as_f64().unwrap_or(facts.error_m);
        let mut tileset = json!({ "asset": asset(args, totals, 0, None), "geometricError": undrawn_m.max(2.0 * root_error_m), "root": tree });
        (tileset["schema"], tileset["metadata"]) = (schema(), metadata(args, &self.block.ellipsoid(), totals));
        if is_implicit {
            tileset["schema"]["classes"]["tile"] = tile_class(args.content == ContentKind::Height);
        }
        tileset["root"]["refine"] = "REPLACE".into();
        body::declare(&self.block.ellipsoid(), &mut tileset);
        tileset.to_string()
    }

    /// Returns the tile and its descendants with data. `ecef_from_parent` is the parent's frame, `up` the way from the tileset to
    /// the folder of the set.
    fn tile(&self, key: TileKey, ecef_from_parent: DAffine3, up: &str) -> Value {
        let name = format!("{up}{}/{}/{}", key.level, key.x, key.y);
        let mut tile = json!({
            "boundingVolume": { "region": self.regions.get(&key) },
            "geometricError": self.geometric_error_m(key),
        });
        let mut ecef_from_tile = DAffine3::IDENTITY;
        match form(self.args, self.block, key) {
            ContentKind::Height => {
                tile["content"] = json!({ "uri": format!("{name}.{}", self.args.output.heights()) });
                if self.args.color != Color::None {
                    tile["extras"] =
                        json!({ "terrane": { "imagery": format!("{name}.{}", self.args.tiles.texture.extension()) } });
                }
            }
            ContentKind::Mesh | ContentKind::QuantizedMesh => {
                tile["content"] = json!({ "uri": format!("{name}.glb") });
                ecef_from_tile = mesh::ecef_from_tile(self.block, key);
            }
        }
        set_transform(&mut tile, ecef_from_parent, ecef_from_tile);
        let mut children = Vec::new();
        for child in key.children() {
            if key.level < self.block.layer.finest {
                if self.block.facts(child).coverage != Coverage::None {
                    children.push(self.tile(child, ecef_from_tile, up));
                }
            } else if let Some(below) = self.below.get(&child) {
                let mut tile = json!({
                    "boundingVolume": { "region": below.region },
                    "geometricError": below.geometric_error_m,
                    "content": { "uri": format!("{up}{}", external_name(child)) },
                });
                set_transform(&mut tile, ecef_from_tile, DAffine3::IDENTITY);
                children.push(tile);
            }
        }
        if !children.is_empty() {
            tile["children"] = children.into();
        }
        tile
    }
}

/// Returns the external tileset of a block, from the JSON of its root tile. Its errors are those of the whole set, so that it is
/// written when all blocks are complete. `above` are the errors of the levels above height tiles.
pub(crate) fn external_tileset(
    args: &GenArgs,
    totals: &Totals,
    root: TileKey,
    error_m: f64,
    tile: &str,
    above: Option<&[CornerErrors]>,
) -> String {
    let (asset, error_m) = (asset(args, totals, root.level, above), json!(error_m));
    format!(r#"{{"asset":{asset},"geometricError":{error_m},"root":{tile}}}"#)
}

/// Returns how far meshes lie below the ellipsoid between their vertices, at most: the height of the arc above its chord.
pub(crate) fn sagitta_m(ellipsoid: &Ellipsoid, e: &Extent) -> f64 {
    let cell = (e.east - e.west).max(e.north - e.south) / CELLS as f64;
    ellipsoid.semi_major_m * cell * cell / 4.0
}

/// Returns the error in metres of a client that draws nothing of a set: the length of its longer side, at most two radii.
/// CesiumJS draws the root of a set only where this error is seen.
pub(crate) fn undrawn_error_m(ellipsoid: &Ellipsoid, e: &Extent) -> f64 {
    ellipsoid.semi_major_m * (e.east - e.west).max(e.north - e.south).min(2.0)
}

/// Returns the largest rounding of the quantized vertices of a mesh in metres. `high_m` is the difference of its heights.
pub(crate) fn half_step_m(ellipsoid: &Ellipsoid, e: &Extent, high_m: f64) -> f64 {
    let side = (e.east - e.west).max(e.north - e.south);
    (ellipsoid.semi_major_m * side + high_m + sagitta_m(ellipsoid, e)) / 131_070.0
}

/// The error of a tile without content in metres: it is refined at any distance.
const EMPTY_ERROR_M: f64 = 1e8;

/// Returns the tileset of a set whose coarsest tiles are the roots of external tilesets.
pub(crate) fn trunk_tileset(args: &GenArgs, ellipsoid: &Ellipsoid, totals: &Totals, below: &[Below]) -> String {
    let child = |below: &Below| {
        json!({
            "boundingVolume": { "region": below.region },
            "geometricError": below.geometric_error_m,
            "content": { "uri": external_name(below.root) },
        })
    };
    let error_m = below.iter().fold(EMPTY_ERROR_M, |error_m, below| error_m.max(2.0 * below.geometric_error_m));
    let mut region = below[0].region;
    for own in below.iter().map(|below| below.region) {
        // Neighbours are at most two, so that the western one begins west of the other also across the date line.
        let is_west_of = |a: f64, b: f64| (b - a).rem_euclid(TAU) < PI;
        region[0] = if is_west_of(own[0], region[0]) { own[0] } else { region[0] };
        region[2] = if is_west_of(region[2], own[2]) { own[2] } else { region[2] };
        (region[1], region[3]) = (region[1].min(own[1]), region[3].max(own[3]));
        (region[4], region[5]) = (region[4].min(own[4]), region[5].max(own[5]));
    }
    if below.iter().any(|below| below.root.level < 2) {
        (region[0], region[2]) = (-PI, PI);
    }
    let children: Vec<Value> = below.iter().map(child).collect();
    let mut tileset = json!({
        "asset": { "version": "1.1", "generator": "terrane" },
        "geometricError": error_m,
        "schema": schema(), "metadata": metadata(args, ellipsoid, totals),
        "root": {
            "boundingVolume": { "region": region }, "geometricError": error_m, "refine": "REPLACE", "children": children,
        },
    });
    body::declare(ellipsoid, &mut tileset);
    tileset.to_string()
}

/// Returns the metadata of a set, which `terrane info` prints.
fn metadata(args: &GenArgs, ellipsoid: &Ellipsoid, totals: &Totals) -> Value {
    let [min_height_m, max_height_m] = totals.range_m.map(f64::from);
    let [cut_samples, filled_samples] = voids(args, totals);
    let is_earth = *ellipsoid == WGS84;
    let datum = if is_earth { args.vertical_datum.to_string() } else { "ellipsoid of the body".to_owned() };
    let properties = json!({
        "minimumHeight": min_height_m, "maximumHeight": max_height_m,
        "finestError": totals.level_errors_m.last(),
        "samplesLeftOut": cut_samples, "samplesFilled": filled_samples,
        "sourceVerticalDatum": datum,
    });
    json!({ "class": "terrain", "properties": properties })
}

/// Returns the asset of a tileset whose root has a level of the set.
fn asset(args: &GenArgs, totals: &Totals, level: u32, above: Option<&[CornerErrors]>) -> Value {
    let mut asset = json!({ "version": "1.1", "generator": "terrane" });
    if args.content == ContentKind::Height {
        asset["extras"] = json!({ "terrane": {
            "format": 1, "content": "height", "layout": "wgs84", "side": CELLS + 1, "border": 1,
            "quantum_m": args.tiles.step_m(), "level_errors_m": level_errors_m(totals),
        } });
        if level > 0 {
            asset["extras"]["terrane"]["level"] = level.into();
        }
        if let Some(above) = above {
            asset["extras"]["terrane"]["above_errors_m"] = json!(above);
        }
    }
    asset
}

/// Sets the transform between two frames. Height tiles are placed by their region: their frame is the earth's, also below meshes.
fn set_transform(tile: &mut Value, ecef_from_parent: DAffine3, ecef_from_tile: DAffine3) {
    if ecef_from_tile != ecef_from_parent {
        tile["transform"] = json!(DMat4::from(ecef_from_parent.inverse() * ecef_from_tile).to_cols_array());
    }
}

/// Returns the name of the external tileset of a block, relative to the folder of the set.
pub(crate) fn external_name(root: TileKey) -> String {
    format!("{}/{}/{}.json", root.level, root.x, root.y)
}

/// Returns an error for each level in metres, root first: the largest of its tiles, at least 1.5 times that of the
/// next finer level. The factor keeps the ranges in which neighbouring levels morph apart.
pub(crate) fn level_errors_m(totals: &Totals) -> Vec<f64> {
    let mut errors = totals.level_errors_m.clone();
    for level in (0..errors.len().saturating_sub(1)).rev() {
        errors[level] = errors[level].max(1.5 * errors[level + 1]).max(QUANTUM_M);
    }
    errors
}

/// Returns the number of samples without data that were left out, and that were filled.
pub(crate) fn voids(args: &GenArgs, totals: &Totals) -> [u64; 2] {
    match args.voids {
        Voids::Cut => [totals.voids, 0],
        Voids::Fill | Voids::Sea => [0, totals.voids],
    }
}

/// Returns the schema of the set's metadata.
fn schema() -> Value {
    let number =
        |kind: &str, description: &str| json!({ "type": "SCALAR", "componentType": kind, "description": description });
    json!({ "id": "terrane", "classes": { "terrain": { "properties": {
        "minimumHeight": number("FLOAT64", "Lowest sample in metres above the ellipsoid"),
        "maximumHeight": number("FLOAT64", "Highest sample in metres above the ellipsoid"),
        "finestError": number("FLOAT64", "Largest difference of the finest level and the source in metres"),
        "samplesLeftOut": number("UINT64", "Samples of the finest level without data that were left out"),
        "samplesFilled": number("UINT64", "Samples of the finest level without data that were given heights"),
        "sourceVerticalDatum": { "type": "STRING", "description": "Surface that the source's heights are measured from" },
    } } } })
}
