//! Implicit tiling: trees of tiles that follow from the bits of subtree files. Sets are made here. No GPU.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::Arc;

use base64::Engine as _;
use glam::DVec3;
use kit::subtrees::{Availability, Scheme, Subtree};
use terrane::fetch::{IoError, Limits, read_file, root_uri};
use terrane::formats::{Content, ReadOptions, companions, decode_node, dependencies, inspect, verify};
use terrane::math::{BoundingVolume, OrientedBox, Region, WGS84, random};
use terrane::scene::{Node, NodeKind, PagedLod, RangeMode, ReaderData, Refine};

/// The tiles with content of a set, by the URI of the content.
#[derive(Default)]
pub(super) struct Found {
    pub contents: BTreeMap<String, PagedLod>,
    /// Subtree files that were read.
    files: u64,
    /// Parts that were made from subtrees in memory.
    parts: u64,
    pub errors: Vec<IoError>,
}

impl Found {
    pub fn of(source: &Path) -> Self {
        let root = root_uri(source.to_str().unwrap()).unwrap();
        let mut found = Self::default();
        found.load(&root, None, &ReadOptions::for_root(&root, Limits::default()));
        found
    }

    fn load(&mut self, uri: &Arc<str>, reader_data: Option<ReaderData>, options: &ReadOptions) {
        match node_of(uri, reader_data, options) {
            Ok(node) => self.walk(&node, &options.below(uri)),
            Err(error) => self.errors.push(error),
        }
    }

    fn walk(&mut self, node: &Node, options: &ReadOptions) {
        if let NodeKind::PagedLod(tile) = &node.kind
            && let Some(uri) = &tile.content
        {
            let data = tile.reader_data.as_ref();
            if data.is_some_and(ReaderData::continues_tileset) {
                let is_part = data.is_some_and(ReaderData::is_whole_content);
                self.parts += u64::from(is_part);
                self.files += u64::from(!is_part);
                self.load(uri, tile.reader_data.clone(), options);
            } else {
                self.contents.insert(uri.to_string(), PagedLod::clone(tile));
            }
        }
        node.children.iter().for_each(|child| self.walk(child, options));
    }

    /// Names of the contents, without their folder.
    fn names(&self) -> BTreeSet<&str> {
        self.contents.keys().map(|uri| uri.rsplit_once("/c/").unwrap().1).collect()
    }
}

fn node_of(uri: &Arc<str>, reader_data: Option<ReaderData>, options: &ReadOptions) -> Result<Node, IoError> {
    let data = reader_data.as_ref();
    let bytes = match data.is_some_and(ReaderData::is_whole_content) {
        true => Vec::new(),
        false => read_file(uri, &options.limits)?,
    };
    let others = companions(uri, data).into_iter().chain(dependencies(uri, &bytes, data, &[], options));
    let others = others.map(|uri| (uri.clone(), read_file(&uri, &options.limits))).collect();
    decode_node(Content { uri: uri.clone(), bytes, reader_data, companions: others }, options)
}

pub(super) fn error_m(tile: &PagedLod) -> f64 {
    let RangeMode::ScreenSpaceError { geometric_error_m } = tile.range_mode else { panic!("by error") };
    geometric_error_m
}

/// The coordinates of a tile in its level.
type Tile = (u32, [u32; 3]);

/// Writes a subtree to a file.
type Write<'a> = &'a dyn Fn(&Subtree, &Path);

/// An implicit tree with random tiles.
struct Forest {
    scheme: Scheme,
    subtree_levels: u32,
    tiles: BTreeSet<Tile>,
    contents: BTreeSet<Tile>,
}

impl Forest {
    fn new(scheme: Scheme, levels: u32, subtree_levels: u32, share: u64, seed: u64) -> Self {
        let mut random = random::SplitMix64::new(seed);
        let mut tiles = BTreeSet::from([(0, [0; 3])]);
        for level in 1..levels {
            let above: Vec<Tile> = tiles.iter().filter(|tile| tile.0 == level - 1).copied().collect();
            for (_, [x, y, z]) in above {
                for child in 0..scheme.child_count() {
                    if random.next_u64() % 100 < share {
                        let part = |at: u32, bit: u32| 2 * at + (child >> bit & 1);
                        tiles.insert((level, [part(x, 0), part(y, 1), part(z, 2)]));
                    }
                }
            }
        }
        let contents = tiles.iter().filter(|_| !random.next_u64().is_multiple_of(4)).copied().collect();
        Self { scheme, subtree_levels, tiles, contents }
    }

    fn names(&self) -> BTreeSet<String> {
        self.contents.iter().map(|(level, [x, y, z])| format!("{level}/{x}_{y}_{z}.glb")).collect()
    }

    /// The subtree whose root is a tile.
    fn subtree(&self, root: Tile) -> Subtree {
        let mut subtree = Subtree::new(self.scheme, self.subtree_levels, 1);
        let (root_level, [x, y, z]) = root;
        let mut add = |tiles: &BTreeSet<Tile>, content: bool| {
            for (level, [tx, ty, tz]) in tiles.iter().filter(|tile| tile.0 >= root_level) {
                let depth = level - root_level;
                if [tx >> depth, ty >> depth, tz >> depth] != [x, y, z] || depth > self.subtree_levels {
                    continue;
                }
                let mask = (1 << depth) - 1;
                let at = [tx & mask, ty & mask, tz & mask];
                match (depth == self.subtree_levels, content) {
                    (true, true) => {}
                    (true, false) => subtree.add_child(at),
                    (false, true) => subtree.add_content(0, depth, at),
                    (false, false) => subtree.add_tile(depth, at),
                }
            }
        };
        add(&self.tiles, false);
        add(&self.contents, true);
        subtree
    }

    /// Writes the set; `write` makes the file of a subtree.
    fn write(&self, folder: &Path, levels: u32, write: impl Fn(&Subtree, &Path)) {
        std::fs::create_dir_all(folder.join("s")).unwrap();
        let scheme = self.scheme.name();
        let subtree_levels = self.subtree_levels;
        let root = format!(
            r#"{{"asset":{{"version":"1.1"}},"geometricError":1000,"root":{{
            "boundingVolume":{{"box":[10,20,30, 8,0,0, 0,16,0, 0,0,32]}},"geometricError":64,"refine":"REPLACE",
            "content":{{"uri":"c/{{level}}/{{x}}_{{y}}_{}.glb"}},
            "implicitTiling":{{"subdivisionScheme":"{scheme}","subtreeLevels":{subtree_levels},"availableLevels":{levels},
            "subtrees":{{"uri":"s/{{level}}.{{x}}.{{y}}{}.subtree"}}}}}}}}"#,
            if self.scheme == Scheme::Octree { "{z}" } else { "0" },
            if self.scheme == Scheme::Octree { ".{z}" } else { ".0" },
        );
        std::fs::write(folder.join("tileset.json"), root).unwrap();
        for root in self.tiles.iter().filter(|tile| tile.0.is_multiple_of(subtree_levels)) {
            let (level, [x, y, z]) = root;
            write(&self.subtree(*root), &folder.join(format!("s/{level}.{x}.{y}.{z}.subtree")));
        }
    }
}

/// Every way to store a tree gives the same tiles.
#[test]
fn trees_are_read_from_every_kind_of_subtree() {
    for (seed, (scheme, levels, subtree_levels, share)) in [
        (Scheme::Quadtree, 6, 3, 60),
        (Scheme::Quadtree, 7, 7, 80),
        (Scheme::Quadtree, 5, 1, 70),
        (Scheme::Octree, 4, 2, 40),
        (Scheme::Octree, 4, 4, 60),
    ]
    .into_iter()
    .enumerate()
    {
        let forest = Forest::new(scheme, levels, subtree_levels, share, seed as u64);
        let writers: [Write<'_>; 4] = [
            &|subtree, file| std::fs::write(file, subtree.binary()).unwrap(),
            &|subtree, file| {
                let buffer = file.with_extension("bin");
                std::fs::write(&buffer, subtree.buffer()).unwrap();
                std::fs::write(file, subtree.json(buffer.file_name().unwrap().to_str().unwrap())).unwrap();
            },
            &|subtree, file| {
                let data =
                    format!("data:;base64,{}", base64::engine::general_purpose::STANDARD.encode(subtree.buffer()));
                std::fs::write(file, subtree.json(&data)).unwrap();
            },
            &|subtree, file| std::fs::write(file, subtree.binary_of_1_0()).unwrap(),
        ];
        for write in writers {
            let folder = tempfile::tempdir().unwrap();
            forest.write(folder.path(), levels, write);
            let found = Found::of(folder.path());
            assert!(found.errors.is_empty(), "{scheme:?}: {:?}", found.errors);
            let expected = forest.names();
            assert_eq!(found.names(), expected.iter().map(String::as_str).collect(), "{scheme:?} {levels}");
            let files = forest.tiles.iter().filter(|tile| tile.0.is_multiple_of(subtree_levels)).count() as u64;
            assert_eq!(found.files, files);
            let info = inspect(folder.path().to_str().unwrap(), &Limits::default()).unwrap();
            let counted = (info.tiles, info.contents, info.subtrees);
            assert_eq!(counted, (forest.tiles.len() as u64, forest.contents.len() as u64, files), "{info}");
            // The contents are not there.
            let verified = verify(folder.path().to_str().unwrap(), &Limits::default(), &mut |_| {}).unwrap();
            assert_eq!(verified.contents, forest.contents.len() as u64);
            assert_eq!(verified.failed, verified.contents);
        }
    }
}

#[test]
fn volumes_and_errors_are_halved() {
    for scheme in [Scheme::Quadtree, Scheme::Octree] {
        let forest = Forest::new(scheme, 5, 2, 70, 9);
        let folder = tempfile::tempdir().unwrap();
        forest.write(folder.path(), 5, |subtree, file| std::fs::write(file, subtree.binary()).unwrap());
        let found = Found::of(folder.path());
        for (level, [x, y, z]) in &forest.contents {
            let name = format!("/c/{level}/{x}_{y}_{z}.glb");
            let (_, tile) = found.contents.iter().find(|(uri, _)| uri.ends_with(&name)).unwrap();
            assert_eq!((error_m(tile), tile.refine), (64.0 / f64::from(1 << level), Refine::Replace));
            let BoundingVolume::Box(OrientedBox { center, half_axes }) = tile.bounds else { panic!("a box") };
            let side = |whole: f64| whole / f64::from(1 << level);
            let (low, rise) = match scheme {
                Scheme::Quadtree => (-2.0, 64.0),
                Scheme::Octree => (-2.0 + side(64.0) * f64::from(*z), side(64.0)),
            };
            let half = 0.5 * DVec3::new(side(16.0), side(32.0), rise);
            let corner = DVec3::new(2.0 + side(16.0) * f64::from(*x), 4.0 + side(32.0) * f64::from(*y), low);
            assert!(center.distance(corner + half) < 1e-9, "{name}: {center}");
            assert!((half_axes * DVec3::ONE).distance(half) < 1e-9, "{name}: {half_axes}");
        }
    }
}

/// Regions are halved in longitude and latitude, also across the antimeridian, and do not move with transforms.
#[test]
fn regions_are_halved_on_the_globe() {
    for (west, east) in [(0.1, 0.3), (3.1, -3.1)] {
        for scheme in [Scheme::Quadtree, Scheme::Octree] {
            let folder = tempfile::tempdir().unwrap();
            let json = format!(
                r#"{{"asset":{{"version":"1.0"}},"geometricError":9,"extensionsRequired":["3DTILES_implicit_tiling"],"root":{{
                "transform":[2,0,0,0, 0,2,0,0, 0,0,2,0, 5,0,0,1],
                "boundingVolume":{{"region":[{west},0.2,{east},0.4,-10,90]}},"geometricError":8,"refine":"ADD",
                "content":{{"url":"c/{{level}}_{{x}}_{{y}}_{{z}}.b3dm"}},
                "extensions":{{"3DTILES_implicit_tiling":{{"subdivisionScheme":"{}","subtreeLevels":2,"maximumLevel":1,
                "subtrees":{{"uri":"all.json"}}}}}}}}}}"#,
                scheme.name()
            );
            std::fs::write(folder.path().join("tileset.json"), json).unwrap();
            let all = r#"{"tileAvailability":{"constant":1},"contentAvailability":{"constant":1},
                "childSubtreeAvailability":{"constant":0}}"#;
            std::fs::write(folder.path().join("all.json"), all).unwrap();
            let found = Found::of(folder.path());
            assert_eq!(found.contents.len() as u32, 1 + scheme.child_count(), "{:?}", found.errors);
            let width = if west < east { east - west } else { east - west + std::f64::consts::TAU };
            for (uri, tile) in found.contents.iter().filter(|(uri, _)| uri.contains("/c/1_")) {
                let BoundingVolume::Region(r) = tile.bounds else { panic!("a region") };
                assert!(
                    (r.width() - 0.5 * width).abs() < 1e-12 && r.west.abs() <= std::f64::consts::PI,
                    "{uri}: {r:?}"
                );
                assert!((r.north - r.south - 0.1).abs() < 1e-12);
                let rise = if scheme == Scheme::Octree { 50.0 } else { 100.0 };
                assert!((r.max_height_m - r.min_height_m - rise).abs() < 1e-9);
                assert_eq!((error_m(tile), tile.refine), (8.0, Refine::Add), "the transform scales the error");
                assert_eq!(tile.content_transform.translation.x, 5.0);
            }
            let south_west: Region = Region {
                west,
                south: 0.2,
                east: if west < east { 0.2 } else { -std::f64::consts::PI },
                north: 0.3,
                min_height_m: -10.0,
                max_height_m: if scheme == Scheme::Octree { 40.0 } else { 90.0 },
                ellipsoid: WGS84,
            };
            let (_, first) = found.contents.iter().find(|(uri, _)| uri.contains("1_0_0_0")).unwrap();
            let BoundingVolume::Region(r) = first.bounds else { panic!("a region") };
            assert!((r.west - south_west.west).abs() < 1e-12 && (r.south - 0.2).abs() < 1e-12, "{r:?}");
            assert!((r.north - 0.3).abs() < 1e-12 && r.max_height_m == south_west.max_height_m, "{r:?}");
        }
    }
}

/// A subtree of 12 levels has 5.6 million tiles; a page has few of them.
#[test]
fn large_subtrees_are_read_as_far_as_they_are_wanted() {
    let folder = tempfile::tempdir().unwrap();
    let json = r#"{"asset":{"version":"1.1"},"geometricError":9,"root":{
        "boundingVolume":{"box":[0,0,0, 8,0,0, 0,8,0, 0,0,1]},"geometricError":8,"content":{"uri":"{level}_{x}_{y}.glb"},
        "implicitTiling":{"subdivisionScheme":"QUADTREE","subtreeLevels":12,"availableLevels":12,
        "subtrees":{"uri":"all.subtree"}}}}"#;
    std::fs::write(folder.path().join("tileset.json"), json).unwrap();
    let mut subtree = Subtree::new(Scheme::Quadtree, 12, 1);
    subtree.fill();
    let bytes = subtree.binary();
    assert!(bytes.len() > 1_300_000, "{} bytes", bytes.len());
    std::fs::write(folder.path().join("all.subtree"), &bytes).unwrap();
    let root = root_uri(folder.path().to_str().unwrap()).unwrap();
    let options = ReadOptions::for_root(&root, Limits::default());
    let mut node = node_of(&root, None, &options).unwrap();
    // Down along one corner of the tree.
    let (mut levels, mut pages) = (0, 0);
    loop {
        let NodeKind::PagedLod(tile) = &node.kind else {
            node = node.children.swap_remove(0);
            continue;
        };
        if tile.reader_data.as_ref().is_some_and(ReaderData::continues_tileset) {
            let page = node_of(tile.content.as_ref().unwrap(), tile.reader_data.clone(), &options).unwrap();
            let count = count(&page);
            assert!(count <= 2048, "{count} nodes");
            pages += 1;
            node = page;
        } else {
            levels += 1;
            let Some(child) = node.children.into_iter().next() else { break };
            node = child;
        }
    }
    assert_eq!(levels, 12);
    assert!((2..=4).contains(&pages), "{pages} pages");
}

fn count(node: &Node) -> usize {
    1 + node.children.iter().map(count).sum::<usize>()
}

#[test]
fn broken_subtrees_are_refused_by_name() {
    let mut good = Subtree::new(Scheme::Quadtree, 2, 1);
    good.fill();
    let read = |bytes: Vec<u8>| {
        let folder = tempfile::tempdir().unwrap();
        let json = r#"{"asset":{"version":"1.1"},"geometricError":9,"root":{
            "boundingVolume":{"box":[0,0,0, 8,0,0, 0,8,0, 0,0,1]},"geometricError":8,"content":{"uri":"c/{level}_{x}_{y}.glb"},
            "implicitTiling":{"subdivisionScheme":"QUADTREE","subtreeLevels":2,"availableLevels":2,
            "subtrees":{"uri":"all.subtree"}}}}"#;
        std::fs::write(folder.path().join("tileset.json"), json).unwrap();
        std::fs::write(folder.path().join("all.subtree"), bytes).unwrap();
        Found::of(folder.path())
    };
    assert_eq!(read(good.binary()).contents.len(), 5);
    let refused = |bytes: Vec<u8>| {
        let found = read(bytes);
        assert!(found.contents.is_empty());
        let [error] = &found.errors[..] else { panic!("{:?}", found.errors) };
        assert!(error.uri().ends_with("all.subtree"), "{error}");
        error.reason()
    };
    let whole = good.binary();
    for length in 0..whole.len() {
        refused(whole[..length].to_vec());
    }
    let changed = |at: usize, byte: u8| {
        let mut bytes = whole.clone();
        bytes[at] = byte;
        refused(bytes)
    };
    assert!(changed(4, 2).contains("version 2"));
    assert!(changed(15, 0x7f).contains("JSON of"));
    assert!(changed(23, 0x7f).contains("binary chunk"));
    let json = |text: &str| refused(text.as_bytes().to_vec());
    let rest = r#""childSubtreeAvailability":{"constant":0}"#;
    assert!(json(&format!(r#"{{"tileAvailability":{{}},{rest}}}"#)).contains("neither bitstream nor constant"));
    assert!(json(&format!(r#"{{"tileAvailability":{{"bitstream":7}},{rest}}}"#)).contains("no bufferView 7"));
    assert!(json(&format!(r#"{{"tileAvailability":{{"constant":0}},{rest}}}"#)).contains("root tile"));
    assert!(json(&format!(r#"{{{rest}}}"#)).contains("root tile"));
    let buffers = |buffers: &str, views: &str| {
        json(&format!(
            r#"{{"buffers":[{buffers}],"bufferViews":[{views}],"tileAvailability":{{"bitstream":0}},{rest}}}"#
        ))
    };
    let view = r#"{"buffer":0,"byteOffset":0,"byteLength":1}"#;
    assert!(buffers(r#"{"byteLength":1}"#, view).contains("no buffer 0"));
    assert!(buffers(r#"{"byteLength":1,"uri":"data:;base64,AA=="}"#, view).contains("root tile"));
    let far = r#"{"buffer":0,"byteOffset":18446744073709551615,"byteLength":1}"#;
    assert!(buffers(r#"{"byteLength":1,"uri":"data:;base64,AA=="}"#, far).contains("beyond its buffer"));
    let short = r#"{"buffer":0,"byteOffset":0,"byteLength":0}"#;
    assert!(buffers(r#"{"byteLength":1,"uri":"data:;base64,AA=="}"#, short).contains("expected 1"));
    let outside = format!(
        r#"{{"buffers":[{{"byteLength":1,"uri":"../../x.bin"}}],"bufferViews":[{view}],"tileAvailability":{{"bitstream":0}},{rest}}}"#
    );
    let found = read(outside.into_bytes());
    assert!(found.errors[0].to_string().contains("all.subtree"), "{:?}", found.errors);
}

/// The tree ends where the numbers of the tileset say, whatever the bits are.
#[test]
fn tiles_beyond_the_available_levels_are_left_out() {
    let folder = tempfile::tempdir().unwrap();
    let json = |tiling: &str| {
        format!(
            r#"{{"asset":{{"version":"1.1"}},"geometricError":9,"root":{{"boundingVolume":{{"sphere":[0,0,0,9]}},
            "geometricError":9,"refine":"ADD","content":{{"uri":"c/root.glb"}},"children":[{{
            "boundingVolume":{{"box":[0,0,0, 8,0,0, 0,8,0, 0,0,1]}},"geometricError":8,"content":{{"uri":"c/{{level}}_{{x}}_{{y}}.glb"}},
            "implicitTiling":{{{tiling}}}}}]}}}}"#
        )
    };
    let mut subtree = Subtree::new(Scheme::Quadtree, 2, 1);
    subtree.fill();
    subtree.set_children(Availability::Constant(true));
    std::fs::write(folder.path().join("all.subtree"), subtree.binary()).unwrap();
    let read = |tiling: &str| {
        std::fs::write(folder.path().join("tileset.json"), json(tiling)).unwrap();
        Found::of(folder.path())
    };
    let subtrees = r#""subtrees":{"uri":"all.subtree"}"#;
    for (levels, contents) in [(1, 1), (2, 5), (3, 21), (4, 85)] {
        let found =
            read(&format!(r#""subdivisionScheme":"QUADTREE","subtreeLevels":2,"availableLevels":{levels},{subtrees}"#));
        assert_eq!((found.contents.len(), found.errors.len()), (1 + contents, 0), "{levels} levels");
    }
    // A root that is invalid fails alone.
    for (tiling, reason) in [
        (r#""subdivisionScheme":"BINARY","subtreeLevels":2,"availableLevels":2,"#, "subdivisionScheme"),
        (r#""subdivisionScheme":"QUADTREE","subtreeLevels":0,"availableLevels":2,"#, "subtreeLevels"),
        (r#""subdivisionScheme":"QUADTREE","subtreeLevels":31,"availableLevels":2,"#, "subtreeLevels is 31"),
        (r#""subdivisionScheme":"QUADTREE","subtreeLevels":2,"availableLevels":0,"#, "availableLevels"),
    ] {
        let found = read(&format!("{tiling}{subtrees}"));
        assert_eq!(found.contents.len(), 2, "the failed tile is one");
        let info = inspect(folder.path().to_str().unwrap(), &Limits::default()).unwrap();
        assert!(info.errors.iter().any(|error| error.reason.contains(reason)), "{info}");
    }
}

/// Metadata replaces what follows from the position of a tile; its rows are those of the available tiles.
#[test]
fn metadata_of_tiles_replaces_volumes_and_errors() {
    let folder = tempfile::tempdir().unwrap();
    let property = |id: &str, kind: &str, semantic: &str| format!(r#""{id}":{{{kind},"semantic":"{semantic}"}}"#);
    let float = r#""type":"SCALAR","componentType":"FLOAT32""#;
    let class = [
        property("low", float, "TILE_MINIMUM_HEIGHT"),
        property("high", r#""type":"SCALAR","componentType":"INT16""#, "TILE_MAXIMUM_HEIGHT"),
        property("error", float, "TILE_GEOMETRIC_ERROR"),
        property("strange", r#""type":"STRING""#, "TILE_BOUNDING_BOX"),
        property("name", r#""type":"STRING""#, "NAME"),
    ];
    let schema = format!(r#"{{"id":"s","classes":{{"tile":{{"properties":{{{}}}}}}}}}"#, class.join(","));
    let tileset = |volume: &str, schema: &str| {
        format!(
            r#"{{"asset":{{"version":"1.1"}},"geometricError":9,"schema":{schema},"root":{{
            "transform":[2,0,0,0, 0,2,0,0, 0,0,2,0, 0,0,0,1],
            "boundingVolume":{{{volume}}},"geometricError":8,"content":{{"uri":"c/{{level}}_{{x}}_{{y}}.glb"}},
            "implicitTiling":{{"subdivisionScheme":"QUADTREE","subtreeLevels":2,"availableLevels":2,
            "subtrees":{{"uri":"all.subtree"}}}}}}}}"#
        )
    };
    let region = r#""region":[0.1,0.2,0.3,0.4,-1000,9000]"#;
    std::fs::write(folder.path().join("tileset.json"), tileset(region, &schema)).unwrap();
    // The root and its first and last child.
    let mut buffer = vec![0b1_0011, 0, 0, 0, 0, 0, 0, 0];
    buffer.extend([5.0_f32, 10.0, 15.0].iter().flat_map(|low| low.to_le_bytes()));
    buffer.extend([100_i16, 200, 300, 0].iter().flat_map(|high| high.to_le_bytes()));
    buffer.extend([7.0_f32, 3.0, 1.5].iter().flat_map(|error| error.to_le_bytes()));
    let data = base64::engine::general_purpose::STANDARD.encode(&buffer);
    let subtree = |table: &str| {
        format!(
            r#"{{"buffers":[{{"byteLength":{},"uri":"data:;base64,{data}"}}],"bufferViews":[
            {{"buffer":0,"byteOffset":0,"byteLength":1}},{{"buffer":0,"byteOffset":8,"byteLength":12}},
            {{"buffer":0,"byteOffset":20,"byteLength":6}},{{"buffer":0,"byteOffset":28,"byteLength":12}}],
            "tileAvailability":{{"bitstream":0}},"contentAvailability":[{{"bitstream":0}}],
            "childSubtreeAvailability":{{"constant":0}},{table}}}"#,
            buffer.len()
        )
    };
    let table = r#""tileMetadata":0,"propertyTables":[{"class":"tile","count":3,"properties":{
        "low":{"values":1},"high":{"values":2},"error":{"values":3},"strange":{"values":1},"name":{"values":1}}}]"#;
    std::fs::write(folder.path().join("all.subtree"), subtree(table)).unwrap();
    let values = |found: &Found| -> Vec<(String, [f64; 3])> {
        let of = |(uri, tile): (&String, &PagedLod)| {
            let BoundingVolume::Region(r) = tile.bounds else { panic!("a region") };
            (uri.rsplit('/').next().unwrap().to_owned(), [r.min_height_m, r.max_height_m, error_m(tile)])
        };
        found.contents.iter().map(of).collect()
    };
    let found = Found::of(folder.path());
    let expected =
        [("0_0_0.glb", [5.0, 100.0, 14.0]), ("1_0_0.glb", [10.0, 200.0, 6.0]), ("1_1_1.glb", [15.0, 300.0, 3.0])];
    let expected = expected.map(|(name, values)| (name.to_owned(), values));
    assert_eq!(values(&found), expected, "{:?}", found.errors);
    // The schema may be in another file, by the property of 1.1 or of the extension. Without it the tiles stay.
    let inline = tileset(region, &schema);
    let own = format!(r#""schema":{schema}"#);
    std::fs::create_dir(folder.path().join("meta")).unwrap();
    for reference in [
        r#""schemaUri":"meta/s.json""#.to_owned(),
        r#""extensions":{"3DTILES_metadata":{"schemaUri":"meta/s.json"}}"#.to_owned(),
        format!(r#""schemaUri":"data:application/json,{}""#, schema.replace('"', "%22")),
    ] {
        let external = inline.replace(&own, &reference);
        assert_ne!(external, inline);
        std::fs::write(folder.path().join("tileset.json"), external).unwrap();
        for file in [Some(format!("\u{feff}{schema}")), Some("<html>".to_owned()), Some("7".to_owned()), None] {
            let path = folder.path().join("meta/s.json");
            let _ = std::fs::remove_file(&path);
            let is_valid = reference.contains("data:") || file.as_ref().is_some_and(|text| text.contains("classes"));
            file.iter().for_each(|text| std::fs::write(&path, text).unwrap());
            let found = Found::of(folder.path());
            assert_eq!(values(&found) == expected, is_valid, "{reference} {file:?} {:?}", found.errors);
            assert_eq!(found.contents.len(), 3);
            let info = inspect(folder.path().to_str().unwrap(), &Limits::default()).unwrap();
            assert_eq!(info.ignored.contains_key("metadata: a schema that cannot be read"), !is_valid, "{info}");
        }
    }
    std::fs::write(folder.path().join("tileset.json"), &inline).unwrap();
    // Tables that are damaged replace nothing.
    for (was, now) in
        [("\"values\":3", "\"values\":9"), ("\"class\":\"tile\"", "\"class\":\"no\""), (":0,\"prop", ":7,\"prop")]
    {
        let damaged = table.replace(was, now);
        assert_ne!(damaged, table);
        std::fs::write(folder.path().join("all.subtree"), subtree(&damaged)).unwrap();
        let found = Found::of(folder.path());
        assert_eq!(found.contents.len(), 3, "{:?}", found.errors);
        assert_eq!(values(&found)[0].1[2], 16.0);
    }
}

/// Cells of S2 are volumes, and roots of implicit trees.
#[test]
fn s2_cells_are_divided() {
    let folder = tempfile::tempdir().unwrap();
    let s2 = r#""extensions":{"3DTILES_bounding_volume_S2":{"token":"3","minimumHeight":-100,"maximumHeight":900}}"#;
    let set = |volume: &str| {
        format!(
            r#"{{"asset":{{"version":"1.1"}},"geometricError":9,"extensionsRequired":["3DTILES_bounding_volume_S2"],
            "root":{{"boundingVolume":{{{volume}}},"geometricError":8,"content":{{"uri":"c/{{level}}_{{x}}_{{y}}.glb"}},
            "implicitTiling":{{"subdivisionScheme":"QUADTREE","subtreeLevels":2,"availableLevels":2,
            "subtrees":{{"uri":"all.subtree"}}}}}}}}"#
        )
    };
    std::fs::write(folder.path().join("tileset.json"), set(s2)).unwrap();
    let mut subtree = Subtree::new(Scheme::Quadtree, 2, 1);
    subtree.fill();
    std::fs::write(folder.path().join("all.subtree"), subtree.binary()).unwrap();
    let found = Found::of(folder.path());
    assert_eq!((found.contents.len(), found.errors.len()), (5, 0), "{:?}", found.errors);
    let boxes: Vec<OrientedBox> = found.contents.values().map(|tile| tile.bounds.oriented_box().unwrap()).collect();
    // Face 1 is around 90 degrees east on the equator.
    for (i, b) in boxes.iter().enumerate() {
        assert!(b.center.y > 3e6 && b.center.x.abs() < 4e6 && b.center.z.abs() < 4e6, "{i}: {}", b.center);
        assert!(boxes[0].distance_to(b.center) < 1.0, "{i}");
    }
    for bad in [s2.replace("\"3\"", "\"X\""), s2.replace("900", "-900"), s2.replace("900", "null")] {
        std::fs::write(folder.path().join("tileset.json"), set(&bad)).unwrap();
        let found = Found::of(folder.path());
        assert!(found.errors.len() == 1 && found.errors[0].reason().contains("S2"), "{:?}", found.errors);
    }
}
