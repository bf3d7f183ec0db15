//! No input panics, hangs or exhausts memory. Every failure is one typed error with URI and reason. No GPU.

use proptest::prelude::*;
use terrane::fetch::{DECODER_PANICKED, IoError, Limits};
use terrane::formats::writers::{GlbMesh, write_glb, write_height_exr};
use terrane::formats::{Content, ReadOptions, decode, decode_node, inspect, verify};
use terrane::scene::{NodeKind, Page, ReaderData};

const ROOT: &str = "/set/tileset.json";

fn read(bytes: &[u8], reader_data: Option<&str>) -> Result<Page, IoError> {
    let limits = Limits { max_image_side_px: 64, ..Limits::default() };
    let content = Content {
        uri: "/set/tile".into(),
        bytes: bytes.to_vec(),
        reader_data: reader_data.map(ReaderData::from),
        companions: Vec::new(),
    };
    decode(content, &ReadOptions::for_root(ROOT, limits))
}

/// Returns the error, which must contain the problem and its reason.
fn refused(bytes: &[u8]) -> String {
    let error = read(bytes, None).unwrap_err();
    assert!(!error.uri().is_empty() && !error.reason().is_empty(), "{error:?}");
    assert_ne!(error.reason(), DECODER_PANICKED);
    error.reason()
}

fn png(side: u32) -> Vec<u8> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    image::RgbImage::from_pixel(side, side, image::Rgb([200, 30, 10]))
        .write_to(&mut bytes, image::ImageFormat::Png)
        .unwrap();
    bytes.into_inner()
}

fn triangle(image: Vec<u8>) -> Vec<u8> {
    write_glb(&GlbMesh {
        positions: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
        normals: vec![[0.0, 0.0, 1.0]; 3],
        uvs: vec![[0.0; 2]; 3],
        indices: vec![0, 1, 2],
        image: Some(image),
        base_color: [1.0; 4],
        ..GlbMesh::default()
    })
}

fn tileset(volume: &str, error: &str, content: &str) -> Vec<u8> {
    format!(
        r#"{{"asset":{{"version":"1.1"}},"geometricError":9,"root":{{"refine":"ADD","boundingVolume":{{{volume}}},"geometricError":{error},"content":{{"uri":"{content}"}}}}}}"#
    )
    .into_bytes()
}

#[test]
fn invalid_occluders_are_refused() {
    let gltf = |occluder: &str| {
        format!(
            r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],"nodes":[{{"children":[1]}},{{"extras":{{"terrane":{{"occluder":{occluder}}}}}}}]}}"#
        )
    };
    let polygon = |corners: &str| gltf(&format!(r#"{{"corners":[{corners}]}}"#));
    assert!(read(polygon("[0,0,0],[1,0,0],[0,1,0]").as_bytes(), None).is_ok());
    let many = vec!["[0,0,0]"; 65].join(",");
    for (occluder, reason) in [
        (gltf("7"), "invalid type"),
        (polygon("[0,0,0],[1,0]"), "invalid length"),
        (polygon("[0,0,0],[1,0,0]"), "2 corners"),
        (polygon(&many), "65 corners"),
        (polygon("[0,0,0],[1,0,0],[2,0,0]"), "no area"),
        (polygon("[0,0,0],[1e300,0,0],[0,1e300,0]"), "no area"),
        (polygon("[0,0,0],[1,0,0],[1,1,0.2],[0,1,0]"), "in a plane"),
        (polygon("[0,0,0],[2,0,0],[0.5,0.5,0],[0,2,0]"), "not convex"),
        (gltf(r#"{"corners":[[0,0,0],[1,0,0],[0,1,0]],"holes":[[[0,0,0]]]}"#), "1 corners"),
    ] {
        let said = refused(occluder.as_bytes());
        assert!(said.contains("occluder of node 1") && said.contains(reason), "{said}");
    }
}

/// The parts of these small files are within the limits, but all of them together would need gigabytes.
#[test]
fn totals_of_a_gltf_are_limited() {
    use base64::Engine as _;
    let data = |bytes: &[u8]| format!("data:;base64,{}", base64::engine::general_purpose::STANDARD.encode(bytes));
    let limits = Limits { max_elements: 1000, max_image_bytes: 64 * 64 * 4, ..Limits::default() };
    // The file has 900 indices, all 0, the given number of positions, and an image for each primitive.
    let gltf = |primitives: usize, mode: u32, indices: usize, image: Option<&[u8]>| {
        let list = |of: &dyn Fn(usize) -> String| (0..primitives).map(of).collect::<Vec<_>>().join(",");
        let material = |i: usize| if image.is_some() { format!(r#","material":{i}"#) } else { String::new() };
        let primitive = |i: usize| {
            let material = material(i);
            format!(r#"{{"attributes":{{"POSITION":{}}},"indices":0,"mode":{mode}{material}}}"#, i + 1)
        };
        let positions = |i: usize| {
            let at = 12 * i;
            format!(
                r#"{{"bufferView":1,"byteOffset":{at},"componentType":5126,"count":1,"type":"VEC3","min":[0,0,0],"max":[0,0,0]}}"#
            )
        };
        let pictures = image.map_or(String::new(), |image| {
            let of = |name: &str, each: &dyn Fn(usize) -> String| format!(r#","{name}":[{}]"#, list(each));
            [
                of("materials", &|i| format!(r#"{{"pbrMetallicRoughness":{{"baseColorTexture":{{"index":{i}}}}}}}"#)),
                of("textures", &|i| format!(r#"{{"source":{i}}}"#)),
                of("images", &|_| format!(r#"{{"uri":"{}"}}"#, data(image))),
            ]
            .concat()
        });
        let buffer = vec![0; 900 + 12 * primitives];
        format!(
            r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],"nodes":[{{"mesh":0}}],"meshes":[{{"primitives":[{}]}}],"accessors":[{{"bufferView":0,"componentType":5121,"count":{indices},"type":"SCALAR"}},{}],"bufferViews":[{{"buffer":0,"byteLength":900}},{{"buffer":0,"byteOffset":900,"byteLength":{}}}],"buffers":[{{"byteLength":{},"uri":"{}"}}]{pictures}}}"#,
            list(&primitive),
            list(&positions),
            12 * primitives,
            buffer.len(),
            data(&buffer),
        )
    };
    let read = |text: String| {
        let bytes = text.into_bytes();
        let content = Content { uri: "/set/tile".into(), bytes, reader_data: None, companions: Vec::new() };
        decode(content, &ReadOptions::for_root(ROOT, limits))
    };
    let nodes = |nodes: &str| {
        format!(r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],"nodes":[{nodes}]}}"#)
    };
    // The file has many drawables without vertices at many positions.
    let instanced = |primitives: usize, places: usize| {
        let all = |what: &str, count: usize| vec![what; count].join(",");
        let roots: Vec<String> = (0..places).map(|i| i.to_string()).collect();
        format!(
            r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[{}]}}],"nodes":[{}],"meshes":[{{"primitives":[{}]}}],"accessors":[{{"bufferView":0,"componentType":5126,"count":0,"type":"VEC3","min":[0,0,0],"max":[0,0,0]}}],"bufferViews":[{{"buffer":0,"byteLength":4}}],"buffers":[{{"byteLength":4,"uri":"{}"}}]}}"#,
            roots.join(","),
            all(r#"{"mesh":0}"#, places),
            all(r#"{"attributes":{"POSITION":0}}"#, primitives),
            data(&[0; 4]),
        )
    };
    let picture = png(64);
    let [strip, triangles] = [5, 4];
    for good in [gltf(2, strip, 900, None), gltf(60, triangles, 900, None), gltf(3, triangles, 900, Some(&picture))] {
        read(good).unwrap();
    }
    for (bad, why) in [
        (gltf(3, strip, 900, None), "indices of a glTF is 9000"),
        (gltf(20, triangles, 899, None), "indices of a glTF"),
        (gltf(9, triangles, 900, Some(&picture)), "images of a glTF"),
        (gltf(63, triangles, 900, None), "primitives of a glTF is 63"),
        (instanced(40, 40), "primitives of a glTF"),
        (nodes(r#"{"matrix":[1,0,0,0,0,1,0,0,0,0,1,0,0,0,0,2]}"#), "not affine"),
    ] {
        let reason = read(bad).unwrap_err().to_string();
        assert!(reason.contains(why), "{reason}");
    }
}

const SPHERE: &str = r#""sphere":[0,0,0,5]"#;

#[test]
fn valid_input_is_read() {
    assert_eq!(read(&triangle(png(4)), None).unwrap().drawable_count(), 1);
    assert!(read(&tileset(SPHERE, "1", "a.glb"), None).unwrap().is_tile_tree());
}

#[test]
fn glb_cut_anywhere_is_refused() {
    let whole = triangle(png(4));
    for length in 0..whole.len() {
        refused(&whole[..length]);
    }
}

#[test]
fn wrong_magic_web_pages_and_foreign_formats_are_named() {
    assert!(refused(b"\x01\x02\x03\x04rubbish").contains("of no known format"));
    assert!(refused(b"<html>404</html>").contains("error page"));
    assert!(refused(b"").contains("empty"));
    assert!(refused(b"version https://git-lfs.github.com/spec/v1\noid sha256:1\nsize 1\n").contains("git lfs pull"));
    assert!(refused(b"SQLite format 3\0").contains(".3dtiles"));
    for (magic, name) in
        [("i3dm", "i3dm"), ("cmpt", "cmpt"), ("subt", "implicit"), ("vctr", "vector tile"), ("geom", "geometry tile")]
    {
        assert!(refused(magic.as_bytes()).contains(name));
    }
    assert!(refused(br#"{"type":"FeatureCollection","features":[]}"#).contains("GeoJSON"));
    // An old version is in the words of its errors.
    assert!(refused(br#"{"asset":{"version":"1.0"},"meshes":7}"#).contains("glTF 1.0 JSON: invalid type"));
    // An unknown extension replaces properties that are required.
    let voxels = r#"{"asset":{"version":"2.0"},"extensionsUsed":["EXT_primitive_voxels"],"extensionsRequired":["EXT_primitive_voxels"],
        "meshes":[{"extensions":{}}]}"#;
    assert!(refused(voxels.as_bytes()).contains("required glTF extension EXT_primitive_voxels"));
}

/// These faults pass the validation of the gltf crate.
#[test]
fn glb_with_an_invalid_reference_is_refused() {
    let whole = triangle(png(4));
    for (was, now, why) in [
        ("\"accessors\"", "\"accessor_\"", "of 0, the indices of a primitive"),
        ("\"bufferViews\"", "\"bufferView_\"", "glTF"),
        ("\"meshes\"", "\"meshez\"", "glTF"),
    ] {
        let mut changed = whole.clone();
        let at = whole.windows(was.len()).position(|w| w == was.as_bytes()).unwrap();
        changed[at..at + now.len()].copy_from_slice(now.as_bytes());
        let reason = refused(&changed);
        assert!(reason.contains(why), "{was}: {reason}");
    }
    // The mesh is drawn without a texture whose image does not exist.
    let at = whole.windows(8).position(|w| w == b"\"images\"").unwrap();
    let mut changed = whole;
    changed[at + 6] = b'z';
    assert_eq!(read(&changed, None).unwrap().drawable_count(), 1);
}

#[test]
fn size_of_images_is_checked_before_they_are_decoded() {
    let limits = Limits { max_image_bytes: 64 * 64 * 4, ..Limits::default() };
    let content = |bytes| Content { uri: "/set/tile".into(), bytes, reader_data: None, companions: Vec::new() };
    let options = ReadOptions::for_root(ROOT, limits);
    assert!(decode(content(triangle(png(65))), &options).unwrap_err().reason().contains("limit"));
    let mut empty = png(4);
    empty[16..24].fill(0);
    // An image that cannot be read leaves its mesh.
    assert!(decode(content(triangle(empty)), &options).is_ok());
}

/// A side that is longer than the limit does not refuse the tile.
#[test]
fn images_with_long_sides_are_halved() {
    let mut page = read(&triangle(png(65)), None).unwrap();
    let texture = page.take_drawables().remove(0).material.texture.unwrap();
    assert_eq!((texture.width, texture.height, texture.mips.len(), texture.mips[0].len()), (32, 32, 6, 32 * 32 * 4));
}

#[test]
fn invalid_bounds_and_errors_are_refused() {
    for volume in [
        r#""sphere":[0,0,0,-1]"#,
        r#""sphere":[0,0,1e300,1]"#,
        r#""sphere":[0,0,0]"#,
        r#""box":[1,2,3]"#,
        r#""region":[0,0,99,0.5,0,10]"#,
        r#""region":[0,0,0.1,2,0,10]"#,
        "",
    ] {
        refused(&tileset(volume, "1", "a.glb"));
    }
    refused(&tileset(SPHERE, "NaN", "a.glb"));
    refused(&tileset(SPHERE, "1e999", "a.glb"));
    for (volume, reason) in [(r#""box":[1,2,3]"#, "box has 3 numbers, expected 12"), (r#""region":[0]"#, "expected 6")]
    {
        assert!(refused(&tileset(volume, "1", "a.glb")).contains(reason), "{volume}");
    }
}

#[test]
fn references_stay_in_the_folder_of_the_set() {
    for escape in ["../../etc/passwd", "/etc/passwd", "file:///etc/passwd", "%2e%2e/x.glb", "http://other/x.glb"] {
        // The tile is refused, and not the set.
        let content = Content {
            uri: ROOT.into(),
            bytes: tileset(SPHERE, "1", escape),
            reader_data: None,
            companions: Vec::new(),
        };
        let options = ReadOptions::for_root(ROOT, Limits::default());
        let NodeKind::PagedLod(tile) = decode_node(content, &options).unwrap().kind else { panic!("a tile") };
        let (uri, reader_data) = (tile.content.unwrap(), tile.reader_data);
        assert!(reader_data.as_ref().is_some_and(ReaderData::is_whole_content), "{escape} would be read");
        let content = Content { uri, bytes: Vec::new(), reader_data, companions: Vec::new() };
        assert!(matches!(decode(content, &options), Err(IoError::Uri { .. })), "{escape}");
    }
}

/// A few small files have a tree of a hundred thousand tiles, or any number with more files.
#[test]
fn tilesets_with_many_references_to_each_other_are_limited() {
    let folder = tempfile::tempdir().unwrap();
    for file in 0..5 {
        let name = if file == 0 { "tileset.json".to_owned() } else { format!("{file}.json") };
        let below = format!(r#"{{"uri":"{}.json"}}"#, file + 1);
        let contents = if file < 4 { vec![below; 10].join(",") } else { String::new() };
        let json = format!(
            r#"{{"asset":{{"version":"1.1"}},"geometricError":1,"root":{{"boundingVolume":{{"sphere":[0,0,0,9]}},
            "geometricError":1,"contents":[{contents}]}}}}"#
        );
        std::fs::write(folder.path().join(name), json).unwrap();
    }
    let source = folder.path().to_str().unwrap();
    let limits = Limits { max_elements: 500, ..Limits::default() };
    let info = inspect(source, &limits).unwrap();
    let [error] = &info.errors[..] else { panic!("{info}") };
    assert!((200..=500).contains(&info.tiles) && error.reason.contains("tiles and tilesets"), "{info}");
    let verified = verify(source, &limits, &mut |_| {}).unwrap();
    let [error] = &verified.errors[..] else { panic!("{verified:?}") };
    assert!(error.reason.contains("tiles and tilesets") && verified.bytes < 200_000, "{verified:?}");
    // The list of errors is limited, their count is not.
    std::fs::write(folder.path().join("4.json"), "broken").unwrap();
    let info = inspect(source, &Limits::default()).unwrap();
    assert_eq!((info.failed, info.errors.len()), (10_000, 1000));
}

/// Regression: three bytes of text became hundreds in memory before any limit was looked at.
#[test]
fn json_that_grows_when_it_is_parsed_is_refused_before() {
    let limits = Limits { max_json_bytes: 1 << 20, ..Limits::default() };
    let many = vec!["{}"; 100_000].join(",");
    let tile = r#""boundingVolume":{"sphere":[0,0,0,9]},"geometricError":1"#;
    let subtree = format!(r#"{{"buffers":[{many}],"tileAvailability":{{"constant":1}}}}"#);
    let gltf = format!(r#"{{"asset":{{"version":"2.0"}},"nodes":[{many}]}}"#);
    let mut glb = b"glTF".to_vec();
    for word in [2, 20 + gltf.len(), gltf.len()] {
        glb.extend((word as u32).to_le_bytes());
    }
    glb.extend(b"JSON");
    glb.extend(gltf.as_bytes());
    let tables = ["b3dm", "i3dm", "pnts"].map(|magic| {
        let json = format!(r#"{{"extras":[{many}]}}"#);
        let mut file = magic.as_bytes().to_vec();
        let header = if magic == "i3dm" { 32 } else { 28 };
        for word in [1, header + json.len() + glb.len(), json.len(), 0, 0, 0] {
            file.extend((word as u32).to_le_bytes());
        }
        file.resize(header, 0);
        if magic == "i3dm" {
            file[28] = 1; // the model is in the file
        }
        [&file, json.as_bytes(), &glb].concat()
    });
    let tilesets = [
        format!(r#"{{"asset":{{"version":"1.1"}},"geometricError":1,"root":{{{tile},"contents":[{many}]}}}}"#),
        format!(r#"{{"asset":{{"version":"1.1"}},"geometricError":1,"root":{{{tile},"children":[{many}]}}}}"#),
        format!(r#"{{"asset":{{"version":"1.1"}},"geometricError":1,"root":{{{tile}}},"extras":[{many}]}}"#),
    ];
    let texts = tilesets.iter().map(|text| text.as_bytes()).chain([gltf.as_bytes()]);
    for bytes in texts.chain([&glb[..]]).chain(tables.iter().map(|file| &file[..])) {
        let options = ReadOptions::for_root(ROOT, limits);
        let content =
            Content { uri: "/set/tile".into(), bytes: bytes.to_vec(), reader_data: None, companions: Vec::new() };
        let error = decode(content, &options).unwrap_err();
        assert!(error.reason().contains("memory of parsed JSON"), "{error}");
    }
    // Subtrees are read through their tileset.
    let folder = tempfile::tempdir().unwrap();
    let tiling = r#""implicitTiling":{"subdivisionScheme":"QUADTREE","subtreeLevels":1,"availableLevels":1,"subtrees":{"uri":"{level}.{x}.{y}.json"}},"content":{"uri":"{x}.glb"}"#;
    let volume = r#""boundingVolume":{"region":[0,0,1,1,0,9]},"geometricError":1"#;
    let set = format!(r#"{{"asset":{{"version":"1.1"}},"geometricError":1,"root":{{{volume},{tiling}}}}}"#);
    std::fs::write(folder.path().join("tileset.json"), set).unwrap();
    std::fs::write(folder.path().join("0.0.0.json"), subtree).unwrap();
    let info = inspect(folder.path().to_str().unwrap(), &limits).unwrap();
    let [error] = &info.errors[..] else { panic!("{info}") };
    assert!(error.reason.contains("memory of parsed JSON"), "{error:?}");
}

/// Regression: a tileset with another extension was read as content, and its children were not verified.
#[test]
fn tilesets_with_any_name_are_verified() {
    let folder = tempfile::tempdir().unwrap();
    for (name, content) in [("tileset.json", "inner"), ("inner", "deeper.v1"), ("deeper.v1", "missing.glb")] {
        std::fs::write(folder.path().join(name), tileset(SPHERE, "1", content)).unwrap();
    }
    let verified = verify(folder.path().to_str().unwrap(), &Limits::default(), &mut |_| {}).unwrap();
    assert_eq!((verified.contents, verified.failed), (1, 1));
    assert!(verified.errors[0].uri.ends_with("missing.glb"), "{verified:?}");
}

/// Regression: names of extensions and versions moved the cursor of the terminal that they were printed to.
#[test]
fn names_of_strangers_have_no_control_characters() {
    let evil = "x\u{1b}]0;t\u{7}\u{1b}[2J\nerror: none\u{9b}1A";
    let set = |required: &str| {
        let volume = r#""boundingVolume":{"sphere":[0,0,0,9]},"geometricError":1,"content":{"uri":"\u001b[31m.glb"}"#;
        let name = serde_json::to_string(evil).unwrap();
        format!(
            r#"{{"asset":{{"version":"1.1","x":{name}}},"extensionsUsed":[{name}],{required}"geometricError":1,"root":{{{volume}}}}}"#
        )
    };
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("tileset.json"), set("")).unwrap();
    let source = folder.path().to_str().unwrap();
    let info = inspect(source, &Limits::default()).unwrap();
    let verified = verify(source, &Limits::default(), &mut |_| {}).unwrap();
    assert_eq!((info.extensions.len(), verified.ignored.len(), verified.errors.len()), (1, 1, 1));
    let ignored = verified.ignored.keys().map(String::as_str);
    let errors = verified.errors.iter().map(|error| error.uri.as_str());
    let refused = refused(set(r#""extensionsRequired":["y\u001b[2J\u009b"],"#).as_bytes());
    assert!(refused.contains('y'), "{refused}");
    for text in ignored.chain(errors).chain(info.extensions.iter().map(String::as_str)).chain([&*refused]) {
        assert!(!text.contains(char::is_control), "{text:?}");
    }
}

#[test]
fn tilesets_that_contain_themselves_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path().join("tileset.json");
    std::fs::write(&root, tileset(SPHERE, "1", "other.json")).unwrap();
    std::fs::write(folder.path().join("other.json"), tileset(SPHERE, "1", "tileset.json")).unwrap();
    let info = inspect(root.to_str().unwrap(), &Limits::default()).unwrap();
    assert_eq!((info.tiles, info.errors.len()), (2, 1));
    assert!(info.errors[0].reason.contains("contains itself"));
    let options = ReadOptions::for_root(ROOT, Limits::default()).below(&"/set/tile".into());
    let content = Content {
        uri: "/set/tile".into(),
        bytes: tileset(SPHERE, "1", "a.glb"),
        reader_data: None,
        companions: vec![],
    };
    assert!(decode(content, &options).unwrap_err().reason().contains("contains itself"));
}

#[test]
fn deep_nesting_is_refused() {
    refused(&[b"{\"root\":".repeat(5000), b"1".to_vec()].concat());
}

const HEIGHT: &str =
    r#"{"region":[0.1,0.8,0.11,0.81],"side":5,"border":1,"level":1,"errors_m":[[1,1,1,1],[2,2,2,2]],"imagery":null}"#;

#[test]
fn height_tiles_are_checked() {
    let exr = |side: usize, h: f32| write_height_exr("t", side, vec![h; side * side]).unwrap();
    assert_eq!(read(&exr(7, 12.0), Some(HEIGHT)).unwrap().drawable_count(), 1);
    for (bytes, data) in [(exr(7, 1.0), None), (exr(9, 1.0), Some(HEIGHT)), (exr(7, f32::NAN), Some(HEIGHT))] {
        assert!(!read(&bytes, data).unwrap_err().reason().is_empty());
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    /// With any change of bytes, reading gives a page or an error, and never panics.
    #[test]
    fn flipped_bytes_never_panic(
        flips in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
        which in 0..3usize,
    ) {
        let (mut bytes, data) = match which {
            0 => (triangle(png(4)), None),
            1 => (tileset(SPHERE, "1", "a.glb"), None),
            _ => (write_height_exr("t", 7, vec![5.0; 49]).unwrap(), Some(HEIGHT)),
        };
        for (index, value) in flips {
            let at = index.index(bytes.len());
            bytes[at] = value;
        }
        if let Err(error) = read(&bytes, data) {
            prop_assert!(!error.uri().is_empty() && !error.reason().is_empty());
            prop_assert_ne!(error.reason(), DECODER_PANICKED);
        }
    }
}
