//! Metadata of implicit tiles and contents that replaces transforms and volumes. Sets are made here. No GPU.

use base64::Engine as _;
use glam::{DMat4, DVec3};
use serde_json::{Map, Value, json};
use terrane::math::BoundingVolume;
use terrane::scene::PagedLod;

use super::implicit::{Found, error_m};

/// The values of a property of all rows, by the semantic of the property.
type Column<'a> = (&'a str, Vec<u8>);

fn f64s(values: impl IntoIterator<Item = f64>) -> Vec<u8> {
    values.into_iter().flat_map(f64::to_le_bytes).collect()
}

fn translation(x: f64, y: f64, z: f64) -> [f64; 16] {
    DMat4::from_translation(DVec3::new(x, y, z)).to_cols_array()
}

/// Returns the classes `tile` and `content`, whose properties have the names of their semantics.
fn schema() -> Value {
    let numbers = |count: usize| json!({ "type": "SCALAR", "componentType": "FLOAT64", "array": true, "count": count });
    let number = || json!({ "type": "SCALAR", "componentType": "FLOAT64", "noData": -99999.0 });
    let class = |prefix: &str| {
        let properties = [
            ("BOUNDING_BOX", numbers(12)),
            ("BOUNDING_SPHERE", numbers(4)),
            ("BOUNDING_REGION", numbers(6)),
            ("BOUNDING_S2_CELL", json!({ "type": "SCALAR", "componentType": "UINT64", "noData": 0 })),
            ("MINIMUM_HEIGHT", number()),
            ("MAXIMUM_HEIGHT", number()),
            ("HORIZON_OCCLUSION_POINT", json!({ "type": "VEC3", "componentType": "FLOAT64" })),
            ("TRANSFORM", json!({ "type": "MAT4", "componentType": "FLOAT64", "noData": vec![0.0; 16] })),
        ];
        let named = properties.into_iter().map(|(name, mut property)| {
            let semantic = format!("{prefix}_{name}");
            property["semantic"] = semantic.clone().into();
            (semantic, property)
        });
        json!({ "properties": named.collect::<Map<_, _>>() })
    };
    json!({ "id": "s", "classes": { "tile": class("TILE"), "content": class("CONTENT") } })
}

/// Returns a subtree with the tiles and child subtrees of two bytes of bits, a content of each tile, and tables with `rows` rows.
fn subtree(tiles: u8, children: u8, rows: usize, tile: &[Column<'_>], content: &[Column<'_>]) -> String {
    let mut buffer = vec![tiles, 0, 0, 0, 0, 0, 0, 0, children, 0, 0, 0, 0, 0, 0, 0];
    let mut views =
        vec![json!({ "buffer": 0, "byteLength": 1 }), json!({ "buffer": 0, "byteOffset": 8, "byteLength": 8 })];
    let mut table = |class: &str, columns: &[Column<'_>]| {
        let mut properties = Map::new();
        for (semantic, values) in columns {
            properties.insert((*semantic).to_owned(), json!({ "values": views.len() }));
            views.push(json!({ "buffer": 0, "byteOffset": buffer.len(), "byteLength": values.len() }));
            buffer.extend_from_slice(values);
        }
        json!({ "class": class, "count": rows, "properties": properties })
    };
    let tables = [table("tile", tile), table("content", content)];
    let uri = format!("data:;base64,{}", base64::engine::general_purpose::STANDARD.encode(&buffer));
    json!({
        "buffers": [{ "byteLength": buffer.len(), "uri": uri }], "bufferViews": views,
        "tileAvailability": { "bitstream": 0 }, "contentAvailability": [{ "bitstream": 0 }, { "bitstream": 0 }],
        "childSubtreeAvailability": { "bitstream": 1 }, "tileMetadata": 0, "contentMetadata": [1, 1],
        "propertyTables": tables,
    })
    .to_string()
}

/// A set with an implicit quadtree of two levels below a tile that is moved by 100 m along x.
struct Set(tempfile::TempDir);

impl Set {
    fn new(volume: &Value, subtree_levels: u32, contents: &[&str]) -> Self {
        let contents: Vec<Value> = contents.iter().map(|name| json!({ "uri": format!("c/{name}") })).collect();
        let set = json!({
            "asset": { "version": "1.1" }, "geometricError": 9, "schema": schema(),
            "root": {
                "boundingVolume": { "sphere": [0, 0, 0, 1e7] }, "geometricError": 9, "refine": "ADD",
                "transform": translation(100.0, 0.0, 0.0),
                "children": [{
                    "transform": [2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 1],
                    "boundingVolume": volume, "geometricError": 8, "contents": contents,
                    "implicitTiling": { "subdivisionScheme": "QUADTREE", "subtreeLevels": subtree_levels,
                        "availableLevels": 2, "subtrees": { "uri": "{level}_{x}_{y}.subtree" } },
                }],
            },
        });
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("tileset.json"), set.to_string()).unwrap();
        Self(folder)
    }

    fn write(&self, name: &str, subtree: String) {
        std::fs::write(self.0.path().join(format!("{name}.subtree")), subtree).unwrap();
    }

    /// Returns the tile of a content.
    fn tile(&self, name: &str) -> PagedLod {
        let found = Found::of(self.0.path());
        assert!(found.errors.is_empty(), "{:?}", found.errors);
        let (_, tile) = found.contents.into_iter().find(|(uri, _)| uri.ends_with(name)).expect(name);
        tile
    }
}

fn root_box() -> Value {
    json!({ "box": [0, 0, 0, 8, 0, 0, 0, 8, 0, 0, 0, 8] })
}

const NAME: &str = "{level}_{x}_{y}.glb";

/// A transform replaces that of the tileset at the root of the tree, and is multiplied below it, also in other subtree files.
#[test]
fn transforms_of_metadata_move_contents_and_volumes() {
    let maps = |maps: &[[f64; 16]]| vec![("TILE_TRANSFORM", f64s(maps.as_flattened().iter().copied()))];
    let (root, first, none) = (translation(0.0, 50.0, 0.0), translation(0.0, 0.0, 7.0), [0.0; 16]);
    let of_one_file = Set::new(&root_box(), 2, &[NAME]);
    // The root and its first and last child.
    of_one_file.write("0_0_0", subtree(0b1_0011, 0, 3, &maps(&[root, first, none]), &[]));
    let of_files = Set::new(&root_box(), 1, &[NAME]);
    of_files.write("0_0_0", subtree(1, 0b1001, 1, &maps(&[root]), &[]));
    of_files.write("1_0_0", subtree(1, 0, 1, &maps(&[first]), &[]));
    of_files.write("1_1_1", subtree(1, 0, 1, &[], &[]));
    for set in [of_one_file, of_files] {
        let expected = [
            ("0_0_0.glb", [100.0, 50.0, 0.0], [100.0, 50.0, 0.0], 8.0, 8.0),
            ("1_0_0.glb", [100.0, 50.0, 7.0], [96.0, 46.0, 7.0], 4.0, 4.0),
            ("1_1_1.glb", [100.0, 50.0, 0.0], [104.0, 54.0, 0.0], 4.0, 4.0),
        ];
        for (name, origin, center, half_m, error) in expected {
            let tile = set.tile(name);
            assert_eq!(tile.content_transform.translation.to_array(), origin, "{name}");
            assert_eq!(
                tile.content_transform.matrix3,
                glam::DMat3::IDENTITY,
                "the transform of the tileset is replaced"
            );
            let BoundingVolume::Box(b) = tile.bounds else { panic!("{name}: a box") };
            assert_eq!((b.center.to_array(), b.half_axes.x_axis.x), (center, half_m), "{name}");
            assert_eq!(error_m(&tile), error, "{name}");
        }
    }
    // Without metadata the transform of the tileset holds.
    let plain = Set::new(&root_box(), 2, &[NAME]);
    plain.write("0_0_0", subtree(0b1_0011, 0, 3, &maps(&[none, first, none]), &[]));
    let tile = plain.tile("1_0_0.glb");
    assert_eq!(tile.content_transform.translation.to_array(), [100.0, 0.0, 14.0]);
    let BoundingVolume::Box(b) = tile.bounds else { panic!("a box") };
    assert_eq!((b.center.to_array(), b.half_axes.x_axis.x, error_m(&tile)), ([92.0, -8.0, 14.0], 8.0, 8.0));
}

/// A content below which nothing is has its own volume; several contents of a tile have one each.
#[test]
fn volumes_of_contents_replace_those_of_tiles_without_children() {
    let spheres = [[0.0, 0.0, 0.0, 5.0], [1.0, 2.0, 3.0, 4.0], [3.0, 2.0, 1.0, 0.5]];
    let spheres = vec![("CONTENT_BOUNDING_SPHERE", f64s(spheres.as_flattened().iter().copied()))];
    for names in [&[NAME][..], &[NAME, "{level}_{x}_{y}-2.glb"]] {
        let set = Set::new(&root_box(), 2, names);
        set.write("0_0_0", subtree(0b1_0011, 0, 3, &[], &spheres));
        assert!(matches!(set.tile("0_0_0.glb").bounds, BoundingVolume::Box(_)), "the root has children");
        for name in names.iter().map(|name| name.replace("{level}_{x}_{y}", "1_0_0")) {
            let BoundingVolume::Sphere(s) = set.tile(&name).bounds else { panic!("{name}: a sphere") };
            assert_eq!((s.center.to_array(), s.radius_m), ([102.0, 4.0, 6.0], 8.0), "in the frame of the tile");
        }
    }
    let boxes = f64s([[0.0; 12], [0.0; 12], [1.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]].concat());
    let set = Set::new(&root_box(), 2, &[NAME]);
    set.write("0_0_0", subtree(0b1_0011, 0, 3, &[], &[("CONTENT_BOUNDING_BOX", boxes)]));
    let BoundingVolume::Box(b) = set.tile("1_1_1.glb").bounds else { panic!("a box") };
    assert_eq!((b.center.to_array(), b.half_axes.x_axis.x), ([102.0, 2.0, 0.0], 2.0));
}

/// Heights of contents replace those of the region that is the content's, or else the tile's.
#[test]
fn heights_of_contents_replace_those_of_regions() {
    let set = Set::new(&json!({ "region": [0.1, 0.2, 0.3, 0.4, -1000, 9000] }), 2, &[NAME]);
    let none = -99999.0;
    let tile = [("TILE_MINIMUM_HEIGHT", f64s([none, 10.0, 10.0])), ("TILE_MAXIMUM_HEIGHT", f64s([none, 90.0, 90.0]))];
    let heights = ("CONTENT_MINIMUM_HEIGHT", f64s([20.0, 20.0, none]));
    let regions = f64s([[0.1, 0.2, 0.11, 0.21, 1.0, 2.0]; 3].concat());
    let region = |set: &Set, name: &str| {
        let BoundingVolume::Region(r) = set.tile(name).bounds else { panic!("{name}: a region") };
        [r.east, r.min_height_m, r.max_height_m]
    };
    set.write("0_0_0", subtree(0b1_0011, 0, 3, &tile, std::slice::from_ref(&heights)));
    assert_eq!(region(&set, "0_0_0.glb"), [0.3, -1000.0, 9000.0]);
    assert_eq!(region(&set, "1_0_0.glb"), [0.2, 20.0, 90.0]);
    assert_eq!(region(&set, "1_1_1.glb"), [0.3, 10.0, 90.0]);
    set.write("0_0_0", subtree(0b1_0011, 0, 3, &tile, &[heights, ("CONTENT_BOUNDING_REGION", regions)]));
    assert_eq!(region(&set, "1_0_0.glb"), [0.11, 20.0, 2.0]);
    assert_eq!(region(&set, "1_1_1.glb"), [0.11, 1.0, 2.0]);
}

/// Cells are 64-bit ids: the token 3 is the id 3 << 60.
#[test]
fn s2_cells_of_metadata_are_volumes() {
    let s2 = |token: &str, low: f64, high: f64| {
        json!({ "extensions": { "3DTILES_bounding_volume_S2":
            { "token": token, "minimumHeight": low, "maximumHeight": high } } })
    };
    let ids = |ids: [u64; 3]| ids.iter().flat_map(|id| id.to_le_bytes()).collect::<Vec<_>>();
    let bounds = |set: &Set, name: &str| set.tile(name).bounds.oriented_box().unwrap();
    let cell = |token: &str, low: f64, high: f64| {
        let set = Set::new(&s2(token, low, high), 1, &[NAME]);
        set.write("0_0_0", subtree(1, 0, 1, &[], &[]));
        bounds(&set, "0_0_0.glb")
    };
    let set = Set::new(&s2("3", -100.0, 900.0), 2, &[NAME]);
    let tile = [
        ("TILE_BOUNDING_S2_CELL", ids([0, 0x0008_9c25_u64 << 44, 0])),
        ("TILE_MAXIMUM_HEIGHT", f64s([900.0, 50.0, 900.0])),
    ];
    set.write("0_0_0", subtree(0b1_0011, 0, 3, &tile, &[]));
    assert_eq!(bounds(&set, "0_0_0.glb"), cell("3", -100.0, 900.0));
    assert_eq!(bounds(&set, "1_0_0.glb"), cell("89c25", -100.0, 50.0));
    // A cell of the content lies between the heights of the tile. Points on the horizon have no effect, and are counted.
    let content = [
        ("CONTENT_BOUNDING_S2_CELL", ids([0, 0x0008_9c24_u64 << 44, 0])),
        ("CONTENT_HORIZON_OCCLUSION_POINT", f64s([0.0; 9])),
    ];
    set.write("0_0_0", subtree(0b1_0011, 0, 3, &tile, &content));
    assert_eq!(bounds(&set, "1_0_0.glb"), cell("89c24", -100.0, 50.0));
    let info = terrane::formats::inspect(set.0.path().to_str().unwrap(), &terrane::fetch::Limits::default()).unwrap();
    assert_eq!(info.ignored.get("metadata semantic CONTENT_HORIZON_OCCLUSION_POINT"), Some(&1), "{info}");
}
