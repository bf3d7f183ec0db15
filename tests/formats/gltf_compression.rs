//! Compressed parts of glTF 2.0: Draco meshes, meshopt buffer views, WebP and KTX2 images.

use kit::compressed::{ETC1S_64, Triangles, uastc_ktx2, uastc_mosaic};
use meshoptimizer_rs::codec::{ExpMode, IndexEncoding, VertexEncoding};
use meshoptimizer_rs::{Workspace, codec};
use serde_json::{Value, json};
use terrane::fetch::Limits;
use terrane::formats::{Content, IgnoredLog, ReadOptions, decode};
use terrane::scene::{BlockFormats, TexelFormat, Texture};

use crate::gltf_builder::*;

/// The grid has `SIDE` x `SIDE` vertices.
const SIDE: u32 = 9;

/// Returns the positions of a triangle list, triangle by triangle, in an order that does not depend on the encoder.
fn triangles(mesh: &terrane::scene::Mesh) -> Vec<[[i32; 3]; 3]> {
    let corner = |i: &u32| mesh.vertices[*i as usize].position.map(|x| (x * 100.0).round() as i32);
    let mut triangles: Vec<[[i32; 3]; 3]> =
        mesh.indices.chunks_exact(3).map(|t| [&t[0], &t[1], &t[2]].map(corner)).collect();
    // The first corner of a triangle may differ, its orientation may not.
    for triangle in &mut triangles {
        let first = (0..3).min_by_key(|i| triangle[*i]).unwrap();
        triangle.rotate_left(first);
    }
    triangles.sort_unstable();
    triangles
}

fn plain_grid() -> GltfBuilder {
    let mut gltf = GltfBuilder::new();
    let grid = Triangles::grid(SIDE);
    let positions = gltf.floats("VEC3", &grid.positions);
    let bytes: Vec<u8> = grid.indices.iter().flat_map(|i| i.to_le_bytes()).collect();
    let indices = gltf.accessor(UNSIGNED_INT, "SCALAR", grid.indices.len(), &bytes);
    gltf.draw(json!({ "attributes": { "POSITION": positions }, "indices": indices }));
    gltf
}

fn draco_grid(compression_level: i32) -> GltfBuilder {
    let grid = Triangles::grid(SIDE);
    let count = grid.vertex_count();
    let mut gltf = GltfBuilder::new();
    let view = gltf.view(&grid.draco(compression_level), None);
    let accessor = |component: u32, kind: &str, count: usize, normalized: bool| json!({ "componentType": component, "type": kind, "count": count, "normalized": normalized });
    let positions = gltf.push("accessors", accessor(FLOAT, "VEC3", count, false));
    let colors = gltf.push("accessors", accessor(UNSIGNED_BYTE, "VEC4", count, true));
    let indices = gltf.push("accessors", accessor(UNSIGNED_SHORT, "SCALAR", grid.indices.len(), false));
    gltf.json["extensionsUsed"] = json!(["KHR_draco_mesh_compression"]);
    gltf.json["extensionsRequired"] = json!(["KHR_draco_mesh_compression"]);
    let compressed = json!({ "bufferView": view, "attributes": { "POSITION": 0, "COLOR_0": 1 } });
    gltf.draw(json!({
        "attributes": { "POSITION": positions, "COLOR_0": colors }, "indices": indices,
        "extensions": { "KHR_draco_mesh_compression": compressed },
    }));
    gltf
}

#[test]
fn draco_meshes_equal_plain_ones() {
    let expected = triangles(&plain_grid().read().mesh().0);
    // Sequential and edge-breaker connectivity.
    for level in [0, 5, 10] {
        let read = draco_grid(level).read();
        let (mesh, _) = read.mesh();
        assert_eq!(triangles(&mesh), expected, "level {level}");
        for vertex in &mesh.vertices {
            let number = (vertex.position[1].round() * SIDE as f32 + vertex.position[0].round()) as u8;
            assert_eq!(vertex.color, [number, 0, 255 - number, 255], "level {level}");
        }
        assert!(read.ignored.is_empty());
    }
}

#[test]
fn draco_that_disagrees_with_its_accessors_is_refused() {
    let good = draco_grid(5);
    let extension = "/meshes/0/primitives/0/extensions/KHR_draco_mesh_compression";
    let changed = |pointer: &str, value: Value| {
        let mut gltf = GltfBuilder { json: good.json.clone(), buffer: good.buffer.clone() };
        *gltf.json.pointer_mut(pointer).unwrap() = value;
        gltf.error()
    };
    for (pointer, value) in [
        (format!("{extension}/bufferView"), json!(99)),
        (format!("{extension}/attributes"), json!([])),
        (format!("{extension}/attributes/POSITION"), json!(7)),
        (format!("{extension}/attributes/POSITION"), json!("0")),
        ("/accessors/0/count".to_owned(), json!(3)),
    ] {
        let reason = changed(&pointer, value.clone());
        assert!(reason.starts_with("glTF"), "{pointer} {value}: {reason}");
    }
    // Colours are not needed.
    let mut gltf = GltfBuilder { json: good.json.clone(), buffer: good.buffer.clone() };
    gltf.json["accessors"][1]["type"] = "VEC3".into();
    let read = gltf.read();
    assert!(read.drawables().len() == 1 && read.ignored.iter().count() == 1, "{:?}", read.ignored);
}

/// Exporters declare a few vertices less than they compress.
#[test]
fn draco_mesh_has_its_own_number_of_vertices() {
    let expected = triangles(&plain_grid().read().mesh().0);
    let vertices = Triangles::grid(SIDE).vertex_count();
    for declared in [vertices - 1, vertices + 1] {
        let mut gltf = draco_grid(5);
        for accessor in 0..2 {
            gltf.json["accessors"][accessor]["count"] = declared.into();
        }
        let read = gltf.read();
        assert_eq!(triangles(&read.mesh().0), expected, "{declared}");
        let kind = "glTF: Draco mesh with another number of vertices than its accessors (drawn as compressed)";
        assert_eq!(read.ignored.count(kind), 1);
    }
    // An attribute that is not compressed must have as many elements.
    let mut gltf = draco_grid(5);
    let normals = gltf.floats("VEC3", &vec![0.0; 3 * (vertices - 1)]);
    gltf.json["meshes"][0]["primitives"][0]["attributes"]["NORMAL"] = normals.into();
    let read = gltf.read();
    assert_eq!(read.ignored.count("glTF: NORMAL of the wrong type or length (drawn without it)"), 1);
    assert_eq!(read.mesh().0.vertices[0].normal, [0; 4]);
}

/// Compresses a view with one of the extensions. The plain bytes are in no buffer.
fn compress(gltf: &mut GltfBuilder, extension: &str, view: usize, object: Value) {
    let length = object["count"].as_u64().unwrap() * object["byteStride"].as_u64().unwrap();
    let data = gltf.json["bufferViews"][view].clone();
    let mut compressed = object;
    for property in ["byteOffset", "byteLength"] {
        compressed[property] = data[property].clone();
    }
    compressed["buffer"] = 0.into();
    let mut view_json = json!({ "buffer": 1, "byteLength": length, "extensions": { extension: compressed } });
    if compressed_stride_matters(&compressed) {
        view_json["byteStride"] = compressed["byteStride"].clone();
    }
    gltf.json["bufferViews"][view] = view_json;
}

fn compressed_stride_matters(compressed: &Value) -> bool {
    compressed["mode"] == "ATTRIBUTES"
}

fn meshopt_grid(extension: &str, index_mode: &str, filter: &str) -> GltfBuilder {
    let mut workspace = Workspace::default();
    let mut gltf = GltfBuilder::new();
    let grid = Triangles::grid(SIDE);
    let count = grid.vertex_count();
    let encoded = match filter {
        "EXPONENTIAL" => {
            let filtered =
                codec::encode_filter_exp(count, 12, 15, &grid.positions, ExpMode::Separate, &mut workspace).unwrap();
            codec::encode_vertex_buffer(&filtered, count, 12, VertexEncoding::default(), &mut workspace).unwrap()
        }
        _ => grid.meshopt_positions(),
    };
    let view = gltf.view(&encoded, None);
    compress(
        &mut gltf,
        extension,
        view,
        json!({ "mode": "ATTRIBUTES", "filter": filter, "count": count, "byteStride": 12 }),
    );
    let accessor = json!({ "bufferView": view, "componentType": FLOAT, "type": "VEC3", "count": count });
    let positions = gltf.push("accessors", accessor);
    let indices = &grid.indices;
    let encoded = match index_mode {
        "TRIANGLES" => grid.meshopt_indices(),
        _ => codec::encode_index_sequence(indices, IndexEncoding::default(), &mut workspace).unwrap(),
    };
    let view = gltf.view(&encoded, None);
    compress(&mut gltf, extension, view, json!({ "mode": index_mode, "count": indices.len(), "byteStride": 2 }));
    let accessor =
        json!({ "bufferView": view, "componentType": UNSIGNED_SHORT, "type": "SCALAR", "count": indices.len() });
    let indices = gltf.push("accessors", accessor);
    gltf.json["buffers"] = json!([
        { "byteLength": gltf.buffer.len(), "uri": data_uri(&gltf.buffer) },
        { "byteLength": 2000, "extensions": { extension: { "fallback": true } } },
    ]);
    gltf.json["extensionsUsed"] = json!([extension]);
    gltf.json["extensionsRequired"] = json!([extension]);
    gltf.draw(json!({ "attributes": { "POSITION": positions }, "indices": indices }));
    gltf
}

#[test]
fn meshopt_views_equal_plain_ones() {
    let expected = triangles(&plain_grid().read().mesh().0);
    for extension in ["EXT_meshopt_compression", "KHR_meshopt_compression"] {
        for index_mode in ["TRIANGLES", "INDICES"] {
            for filter in ["NONE", "EXPONENTIAL"] {
                let read = meshopt_grid(extension, index_mode, filter).read();
                assert_eq!(triangles(&read.mesh().0), expected, "{extension} {index_mode} {filter}");
                assert!(read.ignored.is_empty());
            }
        }
    }
}

#[test]
fn meshopt_that_asks_for_too_much_is_refused() {
    let good = meshopt_grid("EXT_meshopt_compression", "TRIANGLES", "NONE");
    let extension = "/bufferViews/0/extensions/EXT_meshopt_compression";
    for (property, value, why) in [
        ("count", json!(4_000_000_000u64), "bytes for a bufferView"),
        ("count", json!(80), "bytes for a bufferView"),
        ("count", json!(-1), "count"),
        ("byteStride", json!(13), "byteStride"),
        ("byteStride", json!(1024), "byteStride"),
        ("mode", json!("VERTICES"), "mode"),
        ("filter", json!("SHARPEN"), "filter"),
        ("filter", json!("QUATERNION"), "byteStride"),
        ("byteLength", json!(1_000_000), "beyond"),
        ("buffer", json!(1), "no data"),
        ("buffer", json!(7), "beyond"),
    ] {
        let mut gltf = GltfBuilder { json: good.json.clone(), buffer: good.buffer.clone() };
        gltf.json.pointer_mut(extension).unwrap()[property] = value.clone();
        assert!(gltf.error().contains(why), "{property} {value}: {}", gltf.error());
    }
    // View and extension agree on four gigabytes.
    let mut gltf = GltfBuilder { json: good.json.clone(), buffer: good.buffer };
    gltf.json.pointer_mut(extension).unwrap()["count"] = json!(357_913_941u64);
    gltf.json["bufferViews"][0]["byteLength"] = json!(4_294_967_292u64);
    assert!(gltf.error().contains("decompressed glTF"), "{}", gltf.error());
}

fn webp(color: [u8; 3]) -> Vec<u8> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    image::RgbImage::from_pixel(4, 4, image::Rgb(color)).write_to(&mut bytes, image::ImageFormat::WebP).unwrap();
    bytes.into_inner()
}

/// Returns a textured triangle whose texture has an image of an extension, and a blue PNG if that is not read.
fn textured(extension: &str, mime: &str, image: &[u8], has_fallback: bool) -> GltfBuilder {
    let mut gltf = GltfBuilder::new();
    let positions = gltf.floats("VEC3", &TRIANGLE);
    let uvs = gltf.floats("VEC2", &[0.0; 6]);
    let view = gltf.view(image, None);
    gltf.push("images", json!({ "bufferView": view, "mimeType": mime }));
    gltf.push("images", json!({ "uri": data_uri(&png(4, [0, 0, 255])) }));
    let mut texture = json!({ "extensions": { extension: { "source": 0 } } });
    if has_fallback {
        texture["source"] = 1.into();
    }
    gltf.push("textures", texture);
    gltf.push(
        "materials",
        json!({ "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 }, "metallicFactor": 0 } }),
    );
    gltf.json["extensionsUsed"] = json!([extension]);
    if !has_fallback {
        gltf.json["extensionsRequired"] = json!([extension]);
    }
    gltf.draw(json!({ "attributes": { "POSITION": positions, "TEXCOORD_0": uvs }, "material": 0 }));
    gltf
}

#[test]
fn webp_and_ktx2_images_are_decoded() {
    let color = [200, 100, 50];
    let [r, g, b] = color;
    for (extension, mime, image) in [
        ("EXT_texture_webp", "image/webp", webp(color)),
        ("KHR_texture_basisu", "image/ktx2", uastc_ktx2([r, g, b, 255], 1)),
        ("KHR_texture_basisu", "image/ktx2", uastc_ktx2([r, g, b, 255], 3)),
    ] {
        for has_fallback in [false, true] {
            let read = textured(extension, mime, &image, has_fallback).read();
            let texture = read.mesh().1.material.texture.unwrap();
            assert_eq!((texture.width, texture.height, texture.mips.len()), (4, 4, 3), "{extension}");
            for level in &texture.mips {
                for pixel in level.chunks_exact(4) {
                    let near = pixel.iter().zip([r, g, b, 255]).all(|(got, expected)| got.abs_diff(expected) <= 1);
                    assert!(near, "{extension}: {pixel:?}");
                }
            }
            assert!(read.ignored.is_empty(), "{:?}", read.ignored);
        }
    }
    // An image of another format leaves the fallback.
    let read = textured("EXT_texture_webp", "image/webp", b"\0\0\0 ftypavif", true).read();
    assert_eq!(read.mesh().1.material.texture.unwrap().mips[0][..4], [0, 0, 255, 255]);
    assert_eq!(read.ignored.count("glTF: image that is neither PNG, JPEG, WebP, KTX2, DDS, GIF, BMP nor TIFF"), 1);
    assert!(
        textured("EXT_texture_webp", "image/webp", b"\0\0\0 ftypavif", false)
            .read()
            .mesh()
            .1
            .material
            .texture
            .is_none()
    );
}

const BC: BlockFormats = BlockFormats { bc: true, ..BlockFormats::NONE };
const ETC2: BlockFormats = BlockFormats { etc2: true, ..BlockFormats::NONE };
const ASTC: BlockFormats = BlockFormats { astc: true, ..BlockFormats::NONE };
const ALL: BlockFormats = BlockFormats { bc: true, etc2: true, astc: true };

/// Reads a document for an adapter with these formats.
fn read_for(gltf: &GltfBuilder, block_formats: BlockFormats) -> Read {
    let options = ReadOptions { block_formats, ..ReadOptions::for_root("/set/tileset.json", Limits::default()) };
    read_with(gltf.text(), Vec::new(), &options).unwrap()
}

/// Checks that a texture has all levels, each of the size of its format.
fn assert_whole(texture: &Texture) {
    assert_eq!(texture.mips.len() as u32, 32 - texture.width.max(texture.height).leading_zeros(), "{texture:?}");
    for (level, mip) in texture.mips.iter().enumerate() {
        let [width, height] = [texture.width, texture.height].map(|side| (side >> level).max(1));
        assert_eq!(mip.len() as u64, texture.format.image_bytes(width, height), "level {level} of {texture:?}");
    }
}

#[test]
fn ktx2_images_get_the_format_of_the_adapter() {
    let uastc = uastc_mosaic([16, 8], 1, |[_, x, y]| [200, (x * 50) as u8, (y * 90) as u8, 255]);
    let whole_uastc = uastc_mosaic([16, 8], 5, |_| [1, 2, 3, 255]);
    for (image, formats, expected) in [
        (&uastc[..], BC, TexelFormat::Bc7),
        (&uastc, ETC2, TexelFormat::Etc2Rgba),
        (&uastc, ASTC, TexelFormat::Astc4x4),
        (&uastc, ALL, TexelFormat::Bc7),
        (&uastc, BlockFormats::NONE, TexelFormat::Rgba8),
        (&whole_uastc, BC, TexelFormat::Bc7),
        (ETC1S_64, BC, TexelFormat::Bc1),
        (ETC1S_64, ETC2, TexelFormat::Etc2Rgb),
        (ETC1S_64, ASTC, TexelFormat::Astc4x4),
        (ETC1S_64, BlockFormats::NONE, TexelFormat::Rgba8),
    ] {
        let read = read_for(&textured("KHR_texture_basisu", "image/ktx2", image, false), formats);
        let texture = read.mesh().1.material.texture.unwrap();
        assert_eq!(texture.format, expected, "{formats:?}");
        // Levels that the file lacks are compressed too.
        assert_whole(&texture);
        assert!(read.ignored.is_empty(), "{:?}", read.ignored);
    }
    let webp = read_for(&textured("EXT_texture_webp", "image/webp", &webp([1, 2, 3]), false), ALL);
    assert_eq!(webp.mesh().1.material.texture.unwrap().format, TexelFormat::Rgba8);
}

/// Returns the RGBA texels of a level by another decoder than the transcoder's.
fn decompressed(texture: &Texture, level: usize) -> Vec<u8> {
    let [width, height] = [texture.width, texture.height].map(|side| (side as usize >> level).max(1));
    let decode = match texture.format {
        TexelFormat::Rgba8 => return texture.mips[level].clone(),
        TexelFormat::Bc1 => texture2ddecoder::decode_bc1,
        TexelFormat::Bc3 => texture2ddecoder::decode_bc3,
        TexelFormat::Bc7 => texture2ddecoder::decode_bc7,
        TexelFormat::Etc2Rgb => texture2ddecoder::decode_etc2_rgb,
        TexelFormat::Etc2Rgba => texture2ddecoder::decode_etc2_rgba8,
        TexelFormat::Astc4x4 => texture2ddecoder::decode_astc_4_4,
    };
    let mut texels = vec![0; width * height];
    decode(&texture.mips[level], width, height, &mut texels).unwrap();
    texels.into_iter().flat_map(|texel: u32| [2, 1, 0, 3].map(|part| texel.to_le_bytes()[part])).collect()
}

/// Drivers without a family of formats skip the comparison of pictures in `tests/draw`; here the blocks are decoded.
#[test]
fn texels_of_all_formats_are_those_of_rgba8() {
    let part = |factor: u32, [level, x, y]: [u32; 3]| (40 + (level * 97 + x * 61 + y * 29) * factor % 200) as u8;
    let image = uastc_mosaic([64, 32], 7, |at| [1, 3, 7, 5].map(|factor| part(factor, at)));
    let gltf = textured("KHR_texture_basisu", "image/ktx2", &image, false);
    let [plain, bc, etc2, astc] =
        [BlockFormats::NONE, BC, ETC2, ASTC].map(|formats| read_for(&gltf, formats).mesh().1.material.texture.unwrap());
    for texture in [bc, etc2, astc] {
        assert_ne!(texture.format, TexelFormat::Rgba8);
        for level in 0..plain.mips.len() {
            let [a, b] = [&texture, &plain].map(|texture| decompressed(texture, level));
            assert_eq!(a.len(), b.len());
            let mean = a.iter().zip(&b).map(|(a, b)| f64::from(a.abs_diff(*b))).sum::<f64>() / a.len() as f64;
            assert!(mean < 3.0, "{:?}, level {level}: {mean}", texture.format);
        }
    }
}

#[test]
fn ktx2_images_of_other_sides_than_multiples_of_4_stay_uncompressed() {
    let gltf = textured("KHR_texture_basisu", "image/ktx2", &uastc_mosaic([6, 8], 1, |_| [9, 8, 7, 255]), false);
    let kind = "KTX2 image whose sides are no multiples of 4 (held as RGBA8)";
    for (formats, count) in [(ALL, 1), (BlockFormats::NONE, 0)] {
        let read = read_for(&gltf, formats);
        let texture = read.mesh().1.material.texture.unwrap();
        assert_eq!((texture.format, texture.width, texture.height), (TexelFormat::Rgba8, 6, 8));
        assert_whole(&texture);
        assert_eq!(read.ignored.count(kind), count, "{:?}", read.ignored);
    }
}

/// Regression: a separate occlusion image was combined with the other map in RGBA8.
#[test]
fn separate_maps_stay_compressed() {
    let image = uastc_mosaic([8, 8], 4, |_| [10, 20, 30, 255]);
    let mut gltf = textured("KHR_texture_basisu", "image/ktx2", &image, false);
    let other = uastc_mosaic([8, 8], 4, |_| [99, 40, 50, 255]);
    let view = gltf.view(&other, None);
    let other = gltf.push("images", json!({ "bufferView": view, "mimeType": "image/ktx2" }));
    gltf.push("textures", json!({ "extensions": { "KHR_texture_basisu": { "source": other } } }));
    gltf.json["materials"][0] = json!({
        "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 }, "metallicRoughnessTexture": { "index": 0 } },
        "occlusionTexture": { "index": 1 }, "normalTexture": { "index": 0 },
    });
    let material = read_for(&gltf, BC).mesh().1.material;
    let model = material.metallic_roughness.unwrap();
    for map in [material.texture, model.normal_map, model.occlusion_roughness_metallic, model.occlusion_map] {
        assert_eq!(map.unwrap().format, TexelFormat::Bc7);
    }
}

/// The kind under which an invalid image is counted. Its mesh is drawn without it.
const UNREADABLE: &str = "glTF: image that cannot be read";

#[test]
fn ktx2_levels_of_wrong_sizes_are_no_texture() {
    let good = uastc_mosaic([16, 16], 3, |_| [1, 2, 3, 255]);
    for level in 0..3usize {
        let size_at = 80 + 24 * level + 8;
        for bytes in [0u64, 8, 15] {
            let mut image = good.clone();
            // The size in the file, and the size before supercompression.
            image[size_at..size_at + 16].copy_from_slice(&[bytes, bytes].map(u64::to_le_bytes).concat());
            for block_formats in [BlockFormats::NONE, BC, ETC2, ASTC] {
                let options =
                    ReadOptions { block_formats, ..ReadOptions::for_root("/set/tileset.json", Limits::default()) };
                let gltf = textured("KHR_texture_basisu", "image/ktx2", &image, false);
                let read = read_with(gltf.text(), Vec::new(), &options).unwrap();
                assert_eq!(read.ignored.count(UNREADABLE), 1, "level {level}: {bytes} {block_formats:?}");
                assert!(read.mesh().1.material.texture.is_none());
            }
        }
    }
}

/// Regression of a decoder: a header of a few bytes allocated 17 GB.
#[test]
fn ktx2_headers_are_bounded() {
    let good = uastc_ktx2([1, 2, 3, 255], 1);
    let changed = |at: usize, bytes: &[u8]| {
        let mut image = good.clone();
        image[at..at + bytes.len()].copy_from_slice(bytes);
        read(textured("KHR_texture_basisu", "image/ktx2", &image, false).text(), Vec::new())
    };
    let huge = u32::MAX.to_le_bytes();
    // Width and height, depth, layers, faces, levels.
    assert!(changed(20, &[huge, huge].concat()).unwrap_err().reason().contains("image"));
    for at in [28, 32, 36] {
        assert!(changed(at, &huge).unwrap().mesh().1.material.texture.is_none(), "{at}");
    }
    assert_eq!(changed(40, &huge).unwrap().ignored.count(UNREADABLE), 1);
    // zstd with an uncompressed length of 16 GB.
    let mut zstd = good;
    zstd[44..48].copy_from_slice(&2u32.to_le_bytes());
    zstd[96..104].copy_from_slice(&(16u64 << 30).to_le_bytes());
    let error = read(textured("KHR_texture_basisu", "image/ktx2", &zstd, false).text(), Vec::new()).unwrap_err();
    assert!(error.reason().contains("limit"), "{error}");
}

/// Truncated and changed bytes in every decoder: an error or a content, no panic, and no more memory than the limits allow.
#[test]
fn damaged_compressed_data_is_an_error() {
    let limits =
        Limits { max_elements: 1 << 16, max_image_bytes: 1 << 20, max_file_bytes: 4 << 20, ..Limits::default() };
    let options = ReadOptions { block_formats: BC, ..ReadOptions::for_root("/set/tileset.json", limits) };
    let cases = [
        ("draco", draco_grid(5)),
        ("draco, sequential", draco_grid(10)),
        ("meshopt", meshopt_grid("EXT_meshopt_compression", "TRIANGLES", "EXPONENTIAL")),
        ("meshopt sequence", meshopt_grid("KHR_meshopt_compression", "INDICES", "NONE")),
        ("webp", textured("EXT_texture_webp", "image/webp", &webp([1, 2, 3]), false)),
        ("ktx2", textured("KHR_texture_basisu", "image/ktx2", &uastc_ktx2([1, 2, 3, 255], 3), false)),
        ("ktx2, ETC1S", textured("KHR_texture_basisu", "image/ktx2", ETC1S_64, false)),
    ];
    for (name, gltf) in cases {
        let mut state = 88_172_645_463_325_252u64;
        let mut random = move |below: usize| {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            state as usize % below
        };
        let (mut read, mut failed) = (0, 0);
        for round in 0..400 {
            let mut damaged = GltfBuilder { json: gltf.json.clone(), buffer: gltf.buffer.clone() };
            for _ in 0..=round % 4 {
                let at = random(damaged.buffer.len());
                damaged.buffer[at] = [0, 0xff, damaged.buffer[at] ^ 1 << random(8), random(256) as u8][random(4)];
            }
            if round % 3 == 0 {
                // The end is cut off: zeros follow.
                let at = random(damaged.buffer.len());
                damaged.buffer[at..].fill(0);
            }
            if let Some(uri) = damaged.json.pointer_mut("/buffers/0/uri") {
                *uri = data_uri(&damaged.buffer).into();
            }
            let content = Content { uri: URI.into(), bytes: damaged.text(), reader_data: None, companions: Vec::new() };
            let log = IgnoredLog::default();
            match decode(content, &ReadOptions { ignored: log.clone(), ..options.clone() }) {
                Ok(page) => {
                    assert!(page.size_bytes() < 16 << 20, "{name}");
                    let is_whole = log.snapshot().is_empty();
                    (read, failed) = (read + i32::from(is_whole), failed + i32::from(!is_whole));
                }
                Err(error) => {
                    failed += 1;
                    assert_ne!(error.reason(), terrane::fetch::DECODER_PANICKED, "{name}");
                }
            }
        }
        assert!(failed > 20 && read + failed == 400, "{name}: {read} read, {failed} failed");
    }
}
