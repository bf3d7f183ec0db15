//! Fuzzes all parsers of outside data with almost valid inputs. Each returns a value or an error that names the input
//! and the reason, never panics, and ends soon. This test makes random changes for a short time; `tools/fuzz` feeds the
//! same parsers with inputs guided by code coverage. `FUZZ_SECS` sets the duration, `FUZZ_SEED` the random seed.

use std::sync::Arc;

use kit::compressed::{Triangles, uastc_ktx2};
use kit::contents::{GLTF_1, b3dm_bytes, cmpt_bytes, glb_1, padded, pnts_bytes, pnts_with_batches};
use kit::fuzz::Parser;
use kit::splats::{SPZ_4_DEGREE_1, SPZ_4_DEGREE_4, WrittenSplat, from_hex, gzip as gzipped, spz_glb, spz_plain};
use kit::subtrees::{Scheme, Subtree};
use terrane::fetch::{DECODER_PANICKED, FileReader, IoError, Limits};
use terrane::fetch::{RootScope, is_http, resolve, root_uri};
use terrane::fetch::{fuzz_index, fuzz_pmtiles, fuzz_url};
use terrane::formats::writers::{GlbMesh, write_glb, write_height_exr, write_packed_heights};
use terrane::formats::{Content, Fetched, ReadOptions, Style, decode, decode_node, dependencies, inspect};
use terrane::scene::{Node, NodeKind, ReaderData};
use terrane::viewer::{AnimationPath, Arrangement, DisplaySettings, FieldOfView};

fn limits() -> Limits {
    Limits { max_image_side_px: 256, max_file_bytes: 8 << 20, ..Limits::default() }
}

fn is_told(error: &IoError) {
    assert!(!error.uri().is_empty() && !error.reason().is_empty(), "{error:?}");
    assert_ne!(error.reason(), DECODER_PANICKED);
}

fn content(bytes: &[u8], reader_data: Option<&str>, companions: Vec<Fetched>) {
    let content = Content {
        uri: "/set/tile".into(),
        bytes: bytes.to_vec(),
        reader_data: reader_data.map(Into::into),
        companions,
    };
    let mut options = ReadOptions::for_root("/set/tileset.json", limits());
    (options.build_kd_trees, options.keep_features) = (true, true);
    options.vertex_attributes = ["POSITION", "TEXCOORD_0", "TANGENT", "_HEAT"].map(Arc::from).into();
    match decode(content, &options) {
        Ok(page) => assert!(page.size_bytes() < 1 << 30),
        Err(error) => is_told(&error),
    }
}

fn image_bytes(format: image::ImageFormat) -> Vec<u8> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    image::RgbImage::from_fn(8, 8, |x, y| image::Rgb([x as u8 * 30, y as u8 * 30, 9]))
        .write_to(&mut bytes, format)
        .unwrap();
    bytes.into_inner()
}

fn glb_bytes(image: Option<Vec<u8>>) -> Vec<u8> {
    write_glb(&GlbMesh {
        positions: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 1.0, 0.5]],
        normals: vec![[0.0, 0.0, 1.0]; 4],
        uvs: vec![[0.0; 2]; 4],
        indices: vec![0, 1, 2, 2, 1, 3],
        quantized: image.is_none(),
        image,
        base_color: [1.0; 4],
        ..GlbMesh::default()
    })
}

const TILESET: &str = r#"{"asset":{"version":"1.1","extras":{"a":1}},"geometricError":500.5,"extensionsUsed":["X"],"root":{"refine":"REPLACE","transform":[1,0,0,0,0,1,0,0,0,0,1,0,10,20,30,1],"boundingVolume":{"box":[0,0,0,100,0,0,0,100,0,0,0,10]},"viewerRequestVolume":{"sphere":[0,0,0,1000]},"geometricError":100,"content":{"uri":"a/b%20c.glb"},"children":[{"boundingVolume":{"sphere":[1,2,3,50]},"geometricError":10,"contents":[{"uri":"d.b3dm"},{"uri":"e.pnts"}]},{"boundingVolume":{"region":[0.1,0.8,0.11,0.81,-10,100]},"geometricError":0,"content":{"url":"inner/tileset.json"}}]}}"#;
const HEIGHTS: &str = r#"{"asset":{"version":"1.1","extras":{"terrane":{"border":1,"content":"height","format":1,"layout":"wgs84","level_errors_m":[22.5,0.0],"above_errors_m":[[40,40,50,50]],"quantum_m":0.0078125,"side":5}}},"geometricError":500,"root":{"refine":"REPLACE","boundingVolume":{"region":[0.1,0.8,0.11,0.81,-10,100]},"geometricError":22.5,"content":{"uri":"0.exr"},"extras":{"terrane":{"imagery":"0.jpg","corner_errors_m":[1,2,3,4]}},"children":[{"boundingVolume":{"region":[0.1,0.8,0.105,0.805,-10,100]},"geometricError":0,"content":{"uri":"1.exr"}}]}}"#;
const HEIGHT_DATA: &str = r#"{"region":[0.1,0.8,0.11,0.81],"side":5,"border":1,"level":1,"errors_m":[[1,1,1,1],[2,2,3,3]],"imagery":"/set/0.png"}"#;
const IMPLICIT: &str = r#"{"asset":{"version":"1.1"},"geometricError":50,"root":{"boundingVolume":{"region":[0.1,0.8,0.11,0.81,0,9]},"geometricError":9,"refine":"REPLACE","content":{"uri":"c/{level}/{x}/{y}.glb"},"implicitTiling":{"subdivisionScheme":"QUADTREE","subtreeLevels":2,"availableLevels":3,"subtrees":{"uri":"s/{level}/{x}/{y}.subtree"}}}}"#;

fn tileset() -> Parser {
    let seeds = [TILESET, HEIGHTS, IMPLICIT].map(|s| s.as_bytes().to_vec());
    Parser::new("tileset", seeds, move |bytes| content(bytes, None, Vec::new()))
}

/// `inspect` has a separate reader for the JSON of tiles.
fn inspection() -> Parser {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("tileset.json");
    let limits = Limits { max_elements: 10_000, ..limits() };
    Parser::new("inspection", [TILESET, HEIGHTS, IMPLICIT], move |bytes| {
        std::fs::write(&file, bytes).unwrap();
        match inspect(folder.path().to_str().unwrap(), &limits) {
            Ok(info) => assert!(info.errors.iter().all(|e| !e.uri.is_empty() && !e.reason.is_empty()), "{info}"),
            Err(error) => is_told(&error),
        }
    })
}

/// Subtrees of a quadtree with metadata; the tiles that they become are made too.
fn subtree() -> Parser {
    let options = ReadOptions { keep_features: true, ..ReadOptions::for_root("/set/tileset.json", limits()) };
    let content = |uri: &str, bytes: &[u8], reader_data| Content {
        uri: uri.into(),
        bytes: bytes.to_vec(),
        reader_data,
        companions: Vec::new(),
    };
    let schema = r#""schema":{"id":"s","classes":{"tile":{"properties":{
        "low":{"type":"SCALAR","componentType":"UINT8","semantic":"TILE_MINIMUM_HEIGHT"},
        "box":{"type":"SCALAR","array":true,"count":12,"componentType":"INT8","semantic":"TILE_BOUNDING_BOX"}}}}},"#;
    let set = IMPLICIT.replace(r#""subtreeLevels":2,"availableLevels":3"#, r#""subtreeLevels":6,"availableLevels":20"#);
    let set = set.replacen('{', &format!("{{{schema}"), 1);
    let root = decode_node(content("/set/tileset.json", set.as_bytes(), None), &options).unwrap();
    let NodeKind::PagedLod(tile) = root.kind else { panic!("a tile") };
    let source = tile.reader_data;
    assert!(source.as_ref().is_some_and(ReaderData::continues_tileset));
    let mut full = Subtree::new(Scheme::Quadtree, 6, 1);
    full.fill();
    full.add_child([1, 2, 0]);
    let json = r#"{"buffers":[{"byteLength":8,"uri":"data:;base64,AQIDBAUGBwg="}],"bufferViews":[
        {"buffer":0,"byteOffset":0,"byteLength":3}],"tileAvailability":{"bitstream":0},
        "contentAvailability":{"constant":1},"childSubtreeAvailability":{"constant":1},"tileMetadata":0,"contentMetadata":[0],
        "propertyTables":[{"class":"tile","count":3,"properties":{"low":{"values":0},"box":{"values":0}}}]}"#;
    let seeds = [full.binary(), full.binary_of_1_0(), json.as_bytes().to_vec(), full.json("../../a.bin").into_bytes()];
    Parser::new("subtree", seeds, move |bytes| {
        dependencies("/set/s", bytes, source.as_ref(), &[], &options);
        match decode(content("/set/s", bytes, source.clone()), &options) {
            Ok(page) => assert!(page.size_bytes() < 1 << 28),
            Err(error) => return is_told(&error),
        }
        // Parts are made to the end of one branch.
        let mut next = decode_node(content("/set/s", bytes, source.clone()), &options).ok();
        for _ in 0..40 {
            let Some(part) = next.as_ref().and_then(last_part) else { break };
            next = decode_node(content("/set/part", &[], Some(part)), &options).ok();
        }
    })
}

/// The last part of a tile tree that is made from what was read.
fn last_part(node: &Node) -> Option<ReaderData> {
    let own = match &node.kind {
        NodeKind::PagedLod(tile) => tile.reader_data.clone().filter(ReaderData::is_whole_content),
        _ => None,
    };
    node.children.iter().rev().find_map(last_part).or(own)
}

fn cmpt() -> Parser {
    let points: Vec<u8> = (0..80).collect();
    let pnts = pnts_bytes(r#"{"POINTS_LENGTH":2,"POSITION":{"byteOffset":0}}"#, &points);
    let b3dm = b3dm_bytes(r#"{"BATCH_LENGTH":0}"#, &glb_bytes(None));
    let nested = cmpt_bytes(&[pnts.clone(), cmpt_bytes(&[b3dm.clone(), cmpt_bytes(std::slice::from_ref(&pnts))])]);
    Parser::new("cmpt", [cmpt_bytes(&[]), cmpt_bytes(&[pnts, b3dm]), nested], move |bytes| {
        content(bytes, None, Vec::new())
    })
}

fn glb() -> Parser {
    use image::ImageFormat::{Jpeg, Png};
    let seeds = [None, Some(Png), Some(Jpeg)].map(|format| glb_bytes(format.map(image_bytes)));
    let seeds = seeds.into_iter().chain([glb_1(GLTF_1, &[1; 92])]);
    Parser::new("glb", seeds, move |bytes| content(bytes, None, Vec::new()))
}

fn gltf_json() -> Parser {
    use base64::Engine as _;
    let floats = [0.0f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0].iter().flat_map(|f| f.to_le_bytes());
    let buffer: Vec<u8> = floats.chain([0, 1, 2, 0]).collect();
    let uri = base64::engine::general_purpose::STANDARD.encode(buffer);
    let gltf = format!(
        r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],"nodes":[{{"children":[1],"translation":[1,2,3],"rotation":[0,0,0,1],"scale":[1,2,1]}},{{"mesh":0,"matrix":[1,0,0,0,0,1,0,0,0,0,1,0,0,0,0,1]}}],"meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}},"indices":1,"mode":4,"material":0}}]}}],"materials":[{{"doubleSided":true,"alphaMode":"MASK","alphaCutoff":0.3,"pbrMetallicRoughness":{{"baseColorFactor":[1,0.5,0,1]}}}}],"accessors":[{{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3","min":[0,0,0],"max":[1,1,0]}},{{"bufferView":1,"componentType":5121,"count":3,"type":"SCALAR"}}],"bufferViews":[{{"buffer":0,"byteLength":36}},{{"buffer":0,"byteOffset":36,"byteLength":3}}],"buffers":[{{"byteLength":40,"uri":"data:application/octet-stream;base64,{uri}"}}]}}"#
    );
    // A node with an occluder.
    let occluder = r#""extras":{"terrane":{"occluder":{"corners":[[0,0,0],[4,0,0],[4,4,0],[0,4,0]],"holes":[[[1,1,0],[2,1,0],[2,2,0]]]}}},"mesh":0,"#;
    let occluding = gltf.replacen(r#""mesh":0,"#, occluder, 1);
    assert_ne!(occluding, gltf);
    Parser::new("gltf", [gltf, occluding, GLTF_1.to_owned()], |bytes| content(bytes, None, Vec::new()))
}

/// Returns a glTF of the grid whose buffer is the input.
fn wrapped(accessors: &str, view: &str, primitive: &str, buffer: &[u8]) -> Vec<u8> {
    use base64::Engine as _;
    let uri = base64::engine::general_purpose::STANDARD.encode(buffer);
    let length = buffer.len();
    format!(
        r#"{{"asset":{{"version":"2.0"}},"scenes":[{{"nodes":[0]}}],"nodes":[{{"mesh":0}}],"meshes":[{{"primitives":[{primitive}]}}],"accessors":[{accessors}],"bufferViews":[{view}],"buffers":[{{"byteLength":{length},"uri":"data:;base64,{uri}"}},{{"byteLength":9999}}]}}"#
    )
    .into_bytes()
}

fn draco() -> Parser {
    let grid = Triangles::grid(5);
    let accessors = r#"{"componentType":5126,"count":25,"type":"VEC3"},{"componentType":5121,"normalized":true,"count":25,"type":"VEC4"},{"componentType":5123,"count":96,"type":"SCALAR"}"#;
    let primitive = r#"{"attributes":{"POSITION":0,"COLOR_0":1},"indices":2,"extensions":{"KHR_draco_mesh_compression":{"bufferView":0,"attributes":{"POSITION":0,"COLOR_0":1}}}}"#;
    Parser::new("draco", [0, 5, 10].map(|level| grid.draco(level)), move |bytes| {
        let view = format!(r#"{{"buffer":0,"byteLength":{}}}"#, bytes.len());
        content(&wrapped(accessors, &view, primitive, bytes), None, Vec::new());
    })
}

/// The first byte chooses mode and filter.
fn meshopt() -> Parser {
    let grid = Triangles::grid(5);
    let seed = |kind: u8, data: Vec<u8>| [vec![kind], data].concat();
    let seeds = [
        seed(0, grid.meshopt_positions()),
        seed(1, grid.meshopt_positions()),
        seed(2, grid.meshopt_indices()),
        seed(3, grid.meshopt_indices()),
    ];
    Parser::new("meshopt", seeds, move |bytes| {
        let Some((kind, bytes)) = bytes.split_first() else { return };
        let (mode, filter, count, stride) = [
            ("ATTRIBUTES", "NONE", 25, 12),
            ("ATTRIBUTES", "EXPONENTIAL", 25, 12),
            ("TRIANGLES", "NONE", 96, 2),
            ("INDICES", "NONE", 96, 2),
            ("ATTRIBUTES", "OCTAHEDRAL", 36, 8),
            ("ATTRIBUTES", "QUATERNION", 36, 8),
            ("ATTRIBUTES", "COLOR", 36, 8),
        ][usize::from(*kind) % 7];
        let (length, size) = (bytes.len(), count * stride);
        let view = format!(
            r#"{{"buffer":1,"byteLength":{size},"extensions":{{"KHR_meshopt_compression":{{"buffer":0,"byteLength":{length},"count":{count},"byteStride":{stride},"mode":"{mode}","filter":"{filter}"}}}}}}"#
        );
        let positions = r#"{"bufferView":0,"componentType":5126,"count":12,"type":"VEC3"}"#;
        let indices = r#"{"componentType":5126,"count":25,"type":"VEC3"},{"bufferView":0,"componentType":5123,"count":96,"type":"SCALAR"}"#;
        let (accessors, primitive) = match mode {
            "ATTRIBUTES" => (positions, r#"{"attributes":{"POSITION":0}}"#),
            _ => (indices, r#"{"attributes":{"POSITION":0},"indices":1}"#),
        };
        content(&wrapped(accessors, &view, primitive, bytes), None, Vec::new());
    })
}

fn i3dm() -> Parser {
    let numbers: Vec<u8> = (0..64u8).flat_map(|i| f32::from(i).to_le_bytes()).collect();
    let of = |table: &str, format: u32, body: &[u8]| {
        let table = padded(table);
        let mut out = b"i3dm".to_vec();
        let length = 32 + table.len() + numbers.len() + body.len();
        for word in [1, length as u32, table.len() as u32, numbers.len() as u32, 0, 0, format] {
            out.extend(word.to_le_bytes());
        }
        [out, table, numbers.clone(), body.to_vec()].concat()
    };
    let seeds = [
        of(
            r#"{"INSTANCES_LENGTH":2,"RTC_CENTER":[1,2,3],"POSITION":{"byteOffset":0},"NORMAL_UP":{"byteOffset":24},"NORMAL_RIGHT":{"byteOffset":48},"SCALE":{"byteOffset":72},"SCALE_NON_UNIFORM":{"byteOffset":80},"BATCH_ID":{"byteOffset":104,"componentType":"UNSIGNED_BYTE"}}"#,
            1,
            &glb_bytes(None),
        ),
        of(
            r#"{"INSTANCES_LENGTH":3,"EAST_NORTH_UP":true,"POSITION_QUANTIZED":{"byteOffset":0},"QUANTIZED_VOLUME_OFFSET":[1,2,3],"QUANTIZED_VOLUME_SCALE":[10,10,10]}"#,
            0,
            b"model.glb",
        ),
    ];
    let model = glb_bytes(None);
    Parser::new("i3dm", seeds, move |bytes| content(bytes, None, vec![("/set/model.glb".into(), Ok(model.clone()))]))
}

/// Features of glTF that plain files lack: sparse accessors, morph targets, skins, instances, external files.
fn gltf_features() -> Parser {
    let gltf = r#"{"asset":{"version":"2.0"},"scene":0,"scenes":[{"nodes":[0,1]}],"nodes":[{"mesh":0,"skin":0,"extensions":{"KHR_lights_punctual":{"light":0}}},{"mesh":0,"weights":[0.5],"translation":[1,0,0],"extensions":{"EXT_mesh_gpu_instancing":{"attributes":{"TRANSLATION":0,"ROTATION":2}}}}],"skins":[{"joints":[1],"inverseBindMatrices":4}],"meshes":[{"weights":[1],"primitives":[{"attributes":{"POSITION":0,"JOINTS_0":3,"WEIGHTS_0":2,"TEXCOORD_1":1},"targets":[{"POSITION":0}],"material":0,"extensions":{"CESIUM_primitive_outline":{"indices":5}}}]}],"materials":[{"pbrMetallicRoughness":{"baseColorTexture":{"index":0,"texCoord":1,"extensions":{"KHR_texture_transform":{"offset":[1,2],"rotation":1,"scale":[2,3]}}}},"extensions":{"KHR_techniques_webgl":{"technique":0,"values":{"u_diffuse":[1,0,0,1]}}}}],"extensions":{"KHR_lights_punctual":{"lights":[{"type":"spot","intensity":5,"range":9,"color":[1,0.5,0],"spot":{"innerConeAngle":0.1,"outerConeAngle":0.5}}]},"KHR_techniques_webgl":{"techniques":[{"uniforms":{"u_diffuse":{"value":{"index":0}}}}]}},"textures":[{"source":0,"extensions":{"EXT_texture_webp":{"source":1}}}],"images":[{"uri":"a.png"},{"bufferView":2,"mimeType":"image/webp"}],"accessors":[{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3","sparse":{"count":1,"indices":{"bufferView":1,"componentType":5121},"values":{"bufferView":0}}},{"bufferView":0,"componentType":5123,"normalized":true,"count":3,"type":"VEC2"},{"bufferView":0,"componentType":5126,"count":3,"type":"VEC4"},{"bufferView":1,"componentType":5121,"count":3,"type":"VEC4"},{"bufferView":0,"componentType":5126,"count":1,"type":"MAT4"},{"bufferView":1,"componentType":5121,"count":2,"type":"SCALAR"}],"bufferViews":[{"buffer":0,"byteLength":64},{"buffer":0,"byteOffset":64,"byteLength":16},{"buffer":0,"byteLength":40}],"buffers":[{"byteLength":80,"uri":"a.bin"}]}"#;
    // The same with ids and properties in textures and attributes.
    let metadata = r#""extensions":{"EXT_structural_metadata":{"schema":{"classes":{"c":{"properties":{"a":{"type":"VEC2","componentType":"UINT8","normalized":true,"noData":[1,2]},"b":{"type":"SCALAR","componentType":"UINT16"}}}}},"propertyTextures":[{"class":"c","properties":{"a":{"index":0,"texCoord":1,"channels":[0,3]}}}],"propertyAttributes":[{"class":"c","properties":{"b":{"attribute":"TEXCOORD_1"}}}]},"KHR_lights_punctual":{"lights""#;
    let primitive = r#"{"EXT_mesh_features":{"featureIds":[{"texture":{"index":0,"texCoord":1,"channels":[0,1]}},{"attribute":0}]},"EXT_structural_metadata":{"propertyTextures":[0],"propertyAttributes":[0]},"CESIUM_primitive_outline""#;
    let seed = gltf.replace(r#"{"CESIUM_primitive_outline""#, primitive);
    let seed = seed.replace(r#""extensions":{"KHR_lights_punctual":{"lights""#, metadata);
    let buffer: Vec<u8> = (0..20u8).flat_map(|i| f32::from(i % 3).to_le_bytes()).collect();
    let files =
        vec![("/set/a.bin".into(), Ok(buffer)), ("/set/a.png".into(), Ok(image_bytes(image::ImageFormat::Png)))];
    Parser::new("gltf-features", [gltf.to_owned(), seed], move |bytes| {
        let options = ReadOptions::for_root("/set/tileset.json", limits());
        assert!(dependencies("/set/tile", bytes, None, &[], &options).len() < 5000);
        content(bytes, None, files.clone());
    })
}

fn b3dm() -> Parser {
    let seeds = [
        b3dm_bytes(r#"{"BATCH_LENGTH":0,"RTC_CENTER":[1,2,3]}"#, &glb_bytes(None)),
        b3dm_bytes(r#"{"BATCH_LENGTH":2}"#, &glb_bytes(None)),
    ];
    Parser::new("b3dm", seeds, move |bytes| content(bytes, None, Vec::new()))
}

fn pnts() -> Parser {
    let points: Vec<u8> = (0..80).collect();
    let seeds = [
        pnts_bytes(
            r#"{"POINTS_LENGTH":2,"RTC_CENTER":[10,20,30],"POSITION":{"byteOffset":0},"RGB":{"byteOffset":24},"NORMAL_OCT16P":{"byteOffset":30}}"#,
            &points,
        ),
        pnts_bytes(
            r#"{"POINTS_LENGTH":4,"POSITION_QUANTIZED":{"byteOffset":0},"QUANTIZED_VOLUME_OFFSET":[1,2,3],"QUANTIZED_VOLUME_SCALE":[10,10,10],"CONSTANT_RGBA":[255,255,0,255]}"#,
            &points,
        ),
        pnts_bytes(
            r#"{"POINTS_LENGTH":3,"POSITION":{"byteOffset":0},"RGB565":{"byteOffset":36},"BATCH_ID":{"byteOffset":42,"componentType":"UNSIGNED_BYTE"},"BATCH_LENGTH":2}"#,
            &points,
        ),
    ];
    Parser::new("pnts", seeds, move |bytes| content(bytes, None, Vec::new()))
}

/// Styles with a point cloud that they apply to.
fn style() -> Parser {
    let seeds = [
        r#"{"show":"${Area} > 0","color":{"conditions":[["regExp('^a(.)','i').test(${name})","rgba(${red},1,2,(${v}>1?0.5:1.0))"],["true","color('red',0.5)*vec4(0.5)"]]},"pointSize":"${POSITION}.x+2"}"#,
        r#"{"defines":{"H":"clamp((${Height}-0.5)/2.0,1.0,255.0)"},"meta":{"a":"'Hello, ${name}.'+${H}"},"color":"mix(${COLOR},vec4(vec3(1),0.5),${NORMAL}[0])","show":"!(${a}===undefined||${b}!~regExp('x'))"}"#,
    ];
    let cloud = pnts_with_batches(
        r#"{"POINTS_LENGTH":3,"POSITION":{"byteOffset":0},"RGB":{"byteOffset":36}}"#,
        &(0..80).collect::<Vec<u8>>(),
        r#"{"Height":[50,70,null],"name":["ab","b",{"x":[1]}],"red":[1,"2",[3,4]]}"#,
    );
    Parser::new("style", seeds, move |bytes| match Style::from_json("s.json", bytes) {
        Ok(style) => {
            let style = Some(Arc::new(style));
            let options = ReadOptions { style, ..ReadOptions::for_root("/set/tileset.json", limits()) };
            let (uri, bytes) = ("/set/tile".into(), cloud.clone());
            decode(Content { uri, bytes, reader_data: None, companions: Vec::new() }, &options).unwrap();
        }
        Err(error) => assert!(error.to_string().starts_with("s.json: "), "{error}"),
    })
}

fn height_tile() -> Parser {
    let heights = (0..49).map(|i| i as f32 * 3.25 - 7.0).collect();
    let seeds = [write_height_exr("t", 7, heights).unwrap()];
    Parser::new("height-tile", seeds, move |bytes| content(bytes, Some(HEIGHT_DATA), Vec::new()))
}

fn packed_heights() -> Parser {
    let heights: Vec<f32> = (0..49).map(|i| i as f32 * 3.25 - 7.0).collect();
    // Bytes in a zstd frame: magic, no content size, a window of 1 KiB, one raw block.
    let frame = |bytes: &[u8]| {
        let block = ((bytes.len() as u32) << 3 | 1).to_le_bytes();
        Ok([&[0x28, 0xb5, 0x2f, 0xfd, 0, 0], &block[..3], bytes].concat())
    };
    let plain = write_packed_heights("t", 7, 0.25, &heights, frame).unwrap();
    let mut compressed = plain.clone();
    compressed[6] = 1;
    compressed.truncate(24);
    compressed.extend(frame(&plain[24..]).unwrap());
    let seeds = [plain, compressed, write_packed_heights("t", 7, 0.4, &heights, frame).unwrap()];
    Parser::new("packed-heights", seeds, move |bytes| content(bytes, Some(HEIGHT_DATA), Vec::new()))
}

fn height_data() -> Parser {
    let exr = write_height_exr("t", 7, vec![5.0; 49]).unwrap();
    let seeds = [HEIGHT_DATA.as_bytes().to_vec(), HEIGHT_DATA.replace("0.8,", "-1.5,").into_bytes()];
    Parser::new("height-data", seeds, move |bytes| {
        if let Ok(data) = std::str::from_utf8(bytes) {
            content(&exr, Some(data), Vec::new());
        }
    })
}

fn imagery() -> Parser {
    let exr = write_height_exr("t", 7, vec![5.0; 49]).unwrap();
    let seeds = [
        image_bytes(image::ImageFormat::Png),
        image_bytes(image::ImageFormat::Jpeg),
        image_bytes(image::ImageFormat::WebP),
        image_bytes(image::ImageFormat::Gif),
        image_bytes(image::ImageFormat::Bmp),
        image_bytes(image::ImageFormat::Tiff),
        uastc_ktx2([9, 80, 200, 255], 3),
    ];
    Parser::new("imagery", seeds, move |bytes| {
        content(&exr, Some(HEIGHT_DATA), vec![("/set/0.png".into(), Ok(bytes.to_vec()))]);
    })
}

fn gzip() -> Parser {
    use std::io::Write as _;
    let mut packed = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::best());
    packed.write_all(TILESET.as_bytes()).unwrap();
    Parser::new("gzip", [packed.finish().unwrap()], |bytes| content(bytes, None, Vec::new()))
}

fn archive_bytes() -> Vec<u8> {
    use std::io::Write as _;
    let mut writer = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    for (name, method) in [
        ("tileset.json", zip::CompressionMethod::Deflated),
        ("a/b.glb", zip::CompressionMethod::Stored),
        ("@3dtilesIndex1@", zip::CompressionMethod::Stored),
    ] {
        let options = zip::write::SimpleFileOptions::default().compression_method(method);
        writer.start_file(name, options).unwrap();
        writer.write_all(TILESET.as_bytes()).unwrap();
    }
    writer.finish().unwrap().into_inner()
}

fn archive() -> Parser {
    let folder = tempfile::tempdir().unwrap();
    let mut number = 0u64;
    Parser::new("archive", [archive_bytes()], move |bytes| {
        // The name is new each time, because facts about files are cached.
        number += 1;
        let path = folder.path().join(format!("{number}.3tz"));
        std::fs::write(&path, bytes).unwrap();
        let reader = FileReader::new(limits());
        for name in ["tileset.json", "a/b.glb", "none"] {
            match reader.read(path.join(name).to_str().unwrap()) {
                Ok(bytes) => assert!(bytes.len() as u64 <= limits().max_file_bytes),
                Err(error) => is_told(&error),
            }
        }
        std::fs::remove_file(&path).unwrap();
    })
}

/// Small archives contain their directory in the part that is read first, and need no index.
fn archive_index() -> Parser {
    use std::io::Write as _;
    let options = zip::write::SimpleFileOptions::default().compression_method(zip::CompressionMethod::Stored);
    let mut writer = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    for name in ["tileset.json", "a/b.glb"] {
        writer.start_file(name, options).unwrap();
        writer.write_all(b"a content").unwrap();
    }
    let bytes = writer.finish().unwrap().into_inner();
    let second = 1 + bytes[1..].windows(4).position(|w| w == b"PK\x03\x04").unwrap() as u64;
    let mut entries = [(TILESET_HASH, 0), (GLB_HASH, second)];
    let key = |hash: [u8; 16]| [0, 8].map(|at| u64::from_le_bytes(hash[at..at + 8].try_into().unwrap()));
    entries.sort_by_key(|(hash, _)| key(*hash));
    let mut writer = zip::ZipWriter::new_append(std::io::Cursor::new(bytes)).unwrap();
    writer.start_file("@3dtilesIndex1@", options).unwrap();
    for (hash, offset) in entries {
        writer.write_all(&[&hash[..], &u64::to_le_bytes(offset)].concat()).unwrap();
    }
    let seed = writer.finish().unwrap().into_inner();
    assert!(fuzz_index(&seed));
    Parser::new("archive-index", [seed], |bytes| {
        fuzz_index(bytes);
    })
}

/// MD5 of `tileset.json` and of `a/b.glb`.
const TILESET_HASH: [u8; 16] =
    [0xc0, 0x9b, 0xde, 0xa7, 0xe7, 0x45, 0x89, 0x4f, 0x49, 0x9a, 0x75, 0x17, 0xdb, 0x9a, 0x77, 0x09];
const GLB_HASH: [u8; 16] =
    [0xc0, 0xfd, 0x87, 0xfb, 0xad, 0x28, 0x7f, 0x84, 0xf1, 0x1f, 0x29, 0x70, 0xdf, 0x90, 0x55, 0x41];

/// A base and a reference, one per line.
fn uris() -> Parser {
    let seeds = [
        "http://h/set/tileset.json?key=1&b=2\n../a%20b.glb?key=3#f",
        "https://user:word@h:8080/a.3tz/tileset.json\nb/c.3TZ?token=x",
        "s3://bucket/set/tileset.json\n../other/%2e%2e/a.glb",
        "/data/set/sub/tileset.json\n../a%20b.glb?x=1",
        "http:///h\\x/\nhttp://a@b@c/d?e&f=g",
        "az://bucket/a.zip/b.zip/c\n//other/key",
    ];
    Parser::new("uris", seeds, |bytes| {
        let text = String::from_utf8_lossy(bytes);
        let (base, reference) = text.split_once('\n').unwrap_or((&text, "a.glb"));
        for uri in [base, reference] {
            fuzz_url(uri);
        }
        match root_uri(base) {
            Ok(uri) => {
                fuzz_url(&uri);
                assert_eq!(root_uri(&uri).as_deref(), Ok(&*uri));
            }
            Err(error) => assert!(!error.reason().is_empty()),
        }
        let root = |root: &str| RootScope::of(root);
        for scope in [root("http://h/a"), root("s3://bucket/a"), root("/data/set/t.json"), RootScope::Anywhere] {
            match (resolve(base, reference, &scope), &scope) {
                (Ok(uri), RootScope::Server(_)) => {
                    fuzz_url(&uri);
                    assert!(is_http(&uri), "{uri}");
                    let is_safe = |uri: &str| uri.to_ascii_lowercase().starts_with("https:");
                    assert!(is_safe(&uri) || !is_safe(base), "{base:?} {reference:?} {uri}");
                }
                (Ok(uri), RootScope::Bucket(bucket)) => {
                    fuzz_url(&uri);
                    let key = uri.strip_prefix(bucket.as_str());
                    assert!(key.is_some_and(|key| key.is_empty() || key.starts_with('/')), "{uri}");
                }
                (Ok(uri), RootScope::Folder(folder)) => {
                    let path = std::path::Path::new(&*uri);
                    let climbs = path.components().any(|part| part == std::path::Component::ParentDir);
                    assert!(path.starts_with(folder) && (!climbs || base.contains("..")), "{base:?} {uri}");
                }
                (Ok(uri), RootScope::Anywhere) => {
                    assert!(is_http(&uri) || !is_http(base), "{base:?} {reference:?} {uri}")
                }
                (Err(error), _) => assert!(!error.reason().is_empty()),
            }
        }
    })
}

fn pmtiles() -> Parser {
    // The archive has two tiles, one of them twice, and a directory below the root.
    let directory = [3, 0, 1, 2, 1, 2, 0, 9, 9, 5, 1, 10, 1];
    let mut bytes = vec![0u8; 127];
    bytes[..8].copy_from_slice(b"PMTiles\x03");
    for (at, value) in [(8, 127u64), (16, 13), (40, 127), (48, 13), (56, 127), (64, 90)] {
        bytes[at..at + 8].copy_from_slice(&value.to_le_bytes());
    }
    (bytes[97], bytes[98]) = (1, 1);
    bytes.extend_from_slice(&directory);
    Parser::new("pmtiles", [bytes], |bytes| fuzz_pmtiles(bytes, &limits()))
}

fn camera_path() -> Parser {
    let seeds =
        [b"# t px py pz qx qy qz qw\n0 1 2 3 0 0 0 1\n1.5 1e3 -2 3.25 0 0.7071 0 0.7071\n2 0 0 0 1 0 0 0\n".to_vec()];
    Parser::new("camera-path", seeds, move |bytes| {
        if let Ok(path) = AnimationPath::parse(&String::from_utf8_lossy(bytes)) {
            for share in [-1.0, 0.0, 0.3, 1.0, 7.0] {
                let pose = path.world_from_eye(path.first_s() + share * path.duration_s());
                assert!(pose.is_finite(), "{pose:?}");
            }
            let again = AnimationPath::parse(&path.to_text()).unwrap();
            assert_eq!(again.points(), path.points());
        }
    })
}

/// Configuration files of windows, and of windows and views.
fn arrangements() -> Parser {
    let seeds = [
        r#"{"windows":[{"title":"ahead","position_px":[640,0],"size_px":[640,480],"screen":0,"full_screen":false,"decorated":true,"samples":4,"vsync":true},{"position_px":[0,0],"shares_device":true,"cameras":[{"viewport_px":[0,0,640,480],"turn_deg":[-40,0,0],"move_m":[1,2,3]},{"viewport":[0,0,0.5,1],"shift":[1,0],"zoom":[2,2],"eyes":"LEFT"}]}]}"#,
        r#"{"windows":[{"size_px":[1280,480]},{"shares_device":true}],"scenes":{"before":"sets/1990","after":"https://host/2020/tileset.json"},"views":[{"scene":"before","cameras":[{"viewport":[0,0,0.5,1]}]},{"scene":"after","heading_deg":20,"pitch_deg":-60,"range_m":5000,"background":[0,0,40],"cameras":[{"viewport":[0.5,0,0.5,1],"resize":"HORIZONTAL"},{"window":1,"shift":[1,0]}]}]}"#,
    ];
    let folder = tempfile::tempdir().unwrap();
    Parser::new("arrangements", seeds, move |bytes| {
        let file = folder.path().join("windows.json");
        std::fs::write(&file, bytes).unwrap();
        match Arrangement::read(&file) {
            Ok(Arrangement::Windows(windows)) => assert!((1..=64).contains(&windows.len())),
            Ok(Arrangement::Views(views)) => assert!((1..=64).contains(&views.views.len())),
            Ok(other) => panic!("a file that is {other:?}"),
            Err(error) => assert!(!error.reason.is_empty(), "{error}"),
        }
    })
}

fn display_settings() -> Parser {
    let seeds = ["ON", "HORIZONTAL_SPLIT", "0.05", "12", "MONITOR", "LEFT_EYE_LEFT_VIEWPORT", "1280 720"];
    let seeds = seeds.map(|s| s.as_bytes().to_vec());
    Parser::new("display-settings", seeds, move |bytes| {
        let value = String::from_utf8_lossy(bytes).into_owned();
        let mut settings = DisplaySettings::default();
        if let Err(error) = settings.read_variables(|_| Some(value.clone())) {
            assert!(!error.to_string().is_empty());
        }
        let mut arguments: Vec<String> = value.split_whitespace().map(str::to_owned).collect();
        arguments.splice(0..0, ["--stereo".to_owned(), "--samples=4".to_owned()]);
        let _ = settings.read_command_line(&mut arguments);
        if let Some(FieldOfView::Vertical(angle) | FieldOfView::Horizontal(angle)) = settings.field_of_view() {
            assert!(angle.is_finite() && angle > 0.0, "{angle}");
        }
    })
}

/// The input is an SPZ file: of version 4, or before it is compressed, since no change would match the checksum.
fn splats() -> Parser {
    let splat = WrittenSplat { position: [1.0; 3], scale: [0.5; 3], rotation: [0.0, 0.0, 0.6, 0.8], color: [0.5; 4] };
    let seeds = [(2, 0), (3, 1), (3, 3)].map(|(version, degree)| spz_plain(&[splat; 3], version, degree));
    let seeds = seeds.into_iter().chain([SPZ_4_DEGREE_1, SPZ_4_DEGREE_4].map(from_hex));
    Parser::new("splats", seeds, |bytes| {
        let file = if bytes.get(4) == Some(&4) { bytes.to_vec() } else { gzipped(bytes) };
        content(&spz_glb(&file), None, Vec::new());
    })
}

kit::parsers! {
    tileset,
    inspection,
    subtree,
    glb,
    gltf_json,
    gltf_features,
    draco,
    meshopt,
    i3dm,
    b3dm,
    cmpt,
    pnts,
    splats,
    style,
    height_tile,
    packed_heights,
    height_data,
    imagery,
    gzip,
    archive,
    archive_index,
    uris,
    pmtiles,
    camera_path,
    arrangements,
    display_settings,
}
