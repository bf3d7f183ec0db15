//! Materials of glTF 2.0: what is drawn, and what is listed because it is not.

use std::path::Path;
use std::sync::Arc;

use glam::{Affine2, Vec2};
use kit::skip::skipped;
use serde_json::{Value, json};
use terrane::fetch::Limits;
use terrane::formats::ReadOptions;
use terrane::scene::{AlphaMode, AttributeFormat, MapParts, Material, MetallicRoughness, SecondUv, Texture};
use terrane::state::FilterMode;

use crate::gltf_builder::*;

const RED: [f32; 4] = [1.0, 0.0, 0.0, 1.0];

/// Returns a triangle with a material and one texture, whose image is one blue pixel.
fn with_material(material: Value) -> GltfBuilder {
    let mut gltf = GltfBuilder::new();
    let positions = gltf.floats("VEC3", &TRIANGLE);
    let uvs = gltf.floats("VEC2", &[0.0; 6]);
    gltf.push("images", json!({ "uri": data_uri(&png(1, [0, 0, 255])) }));
    gltf.push("textures", json!({ "source": 0 }));
    gltf.push("materials", material);
    gltf.draw(json!({ "attributes": { "POSITION": positions, "TEXCOORD_0": uvs }, "material": 0 }));
    gltf
}

fn read(material: Value) -> (Material, Vec<String>) {
    let read = with_material(material).read();
    let ignored = read.ignored.iter().map(|(kind, _)| kind.to_owned()).collect();
    (read.mesh().1.material, ignored)
}

#[test]
fn a_black_surface_that_emits_light_has_its_colour() {
    let (material, ignored) = read(json!({
        "pbrMetallicRoughness": { "baseColorFactor": [0, 0, 0, 1], "metallicFactor": 0 }, "emissiveFactor": [1, 0, 0],
    }));
    assert_eq!((material.base_color, material.unlit, ignored.len()), (RED, true, 0));
    let (material, _) = read(json!({
        "pbrMetallicRoughness": { "baseColorFactor": [0, 0, 0, 1] }, "emissiveFactor": [1, 0, 0],
        "emissiveTexture": { "index": 0 }, "extensions": { "KHR_materials_emissive_strength": { "emissiveStrength": 5 } },
    }));
    assert!(material.texture.is_some() && material.base_color == RED);
    let (material, ignored) =
        read(json!({ "pbrMetallicRoughness": { "metallicFactor": 0 }, "emissiveFactor": [1, 0, 0] }));
    assert_eq!((material.base_color, material.unlit, ignored.len()), ([1.0; 4], false, 0));
    assert_eq!(material.metallic_roughness.unwrap().emissive, [1.0, 0.0, 0.0]);
}

/// Returns a material of KHR_materials_pbrSpecularGlossiness.
fn specular_glossiness(values: Value) -> Value {
    json!({ "extensions": { "KHR_materials_pbrSpecularGlossiness": values } })
}

#[test]
fn specular_glossiness_is_converted_to_metallic_roughness() {
    // A dielectric: the diffuse map stays as it is.
    let dielectric = specular_glossiness(json!({
        "diffuseFactor": [0.48, 0.24, 0, 0.5], "diffuseTexture": { "index": 0 }, "specularFactor": [0, 0, 0],
        "glossinessFactor": 0.75,
    }));
    let (material, ignored) = read(dielectric);
    let close = |got: [f32; 4], expected: [f32; 4]| got.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-5);
    assert!(close(material.base_color, [0.5, 0.25, 0.0, 0.5]), "{:?}", material.base_color);
    let model = material.metallic_roughness.unwrap();
    assert_eq!((model.metallic, model.roughness), (0.0, 0.25));
    assert_eq!((material.texture.unwrap().mips[0].as_slice(), ignored.len()), (&[0, 0, 255, 255][..], 0));
    // Without a specular colour the diffuse one is drawn.
    let plain = specular_glossiness(json!({ "diffuseFactor": RED, "diffuseTexture": { "index": 0 } }));
    let (material, ignored) = read(plain);
    assert_eq!((material.base_color, material.texture.unwrap().mips[0].as_slice()), (RED, &[0, 0, 255, 255][..]));
    assert_eq!(ignored, ["glTF material: white specular colour (drawn as a dielectric)"]);
    // A metal: the specular colour is that of the surface.
    let (material, _) =
        read(specular_glossiness(json!({ "diffuseFactor": [0, 0, 0, 1], "specularFactor": [1, 0.5, 0.25] })));
    assert!(close(material.base_color, [1.0, 0.5, 0.25, 1.0]), "{:?}", material.base_color);
    let model = material.metallic_roughness.unwrap();
    assert!((model.metallic - 1.0).abs() < 1e-5 && model.roughness == 0.0, "{model:?}");
    // A rough dielectric is matte.
    let rough = json!({ "diffuseFactor": [1, 0, 0, 1], "specularFactor": [0.04, 0.04, 0.04], "glossinessFactor": 0 });
    assert!(read(specular_glossiness(rough)).0.metallic_roughness.is_none());
}

#[test]
fn maps_of_specular_glossiness_are_converted() {
    let rgba = |width: u32, height: u32, texel: fn(u32, u32) -> [u8; 4]| {
        let mut bytes = std::io::Cursor::new(Vec::new());
        let image = image::RgbaImage::from_fn(width, height, |x, y| image::Rgba(texel(x, y)));
        image.write_to(&mut bytes, image::ImageFormat::Png).unwrap();
        data_uri(&bytes.into_inner())
    };
    let mut material = specular_glossiness(json!({
        "diffuseFactor": [1, 1, 1, 0.5], "diffuseTexture": { "index": 0 }, "specularFactor": [1, 1, 1],
        "glossinessFactor": 0.5, "specularGlossinessTexture": { "index": 1 },
    }));
    material["occlusionTexture"] = json!({ "index": 2 });
    let mut gltf = with_material(material);
    // A gray dielectric left, a half transparent black metal right.
    gltf.json["images"][0]["uri"] = rgba(4, 2, |x, _| if x < 2 { [188, 188, 188, 255] } else { [0, 0, 0, 128] }).into();
    // No reflection left, a red one right; rough at the top and glossy at the bottom.
    let map = rgba(2, 2, |x, y| [if x == 0 { 0 } else { 255 }, 0, 0, if y == 0 { 0 } else { 255 }]);
    gltf.push("images", json!({ "uri": map }));
    gltf.push("images", json!({ "uri": rgba(4, 2, |_, _| [77, 0, 0, 255]) }));
    // Without filters between texels the values are exact but where the smaller map is enlarged.
    gltf.push("textures", json!({ "source": 1 }));
    gltf.push("textures", json!({ "source": 2 }));
    let read = gltf.read();
    let material = read.mesh().1.material;
    assert!(read.ignored.is_empty(), "{:?}", read.ignored);
    assert_eq!(material.base_color, [1.0, 1.0, 1.0, 0.5]);
    let base_color = material.texture.unwrap();
    assert_eq!((base_color.width, base_color.height, base_color.mips.len()), (4, 2, 3));
    let texel = |of: &terrane::scene::Texture, x: usize, y: usize| -> [u8; 4] {
        of.mips[0][4 * (4 * y + x)..][..4].try_into().unwrap()
    };
    // 188 is half of the light, divided by the 0.96 that a dielectric does not reflect: 191.6.
    assert_eq!(texel(&base_color, 0, 0), [191, 191, 191, 255]);
    assert_eq!(texel(&base_color, 3, 1), [255, 0, 0, 128]);
    let model = material.metallic_roughness.unwrap();
    assert_eq!((model.metallic, model.roughness, model.occlusion_strength), (1.0, 1.0, 1.0));
    let rest = model.occlusion_roughness_metallic.unwrap();
    let corners = [(0, 0), (3, 0), (0, 1), (3, 1)].map(|(x, y)| texel(&rest, x, y));
    assert_eq!(corners, [[255, 255, 0, 255], [255; 4], [255, 128, 0, 255], [255, 128, 255, 255]]);
    assert_eq!(texel(&model.occlusion_map.unwrap(), 0, 0), [77, 0, 0, 255]);

    // The diffuse map alone: the metallic share depends on its texels if the specular colour is bright.
    let material = &mut gltf.json["materials"][0];
    *material = specular_glossiness(json!({ "diffuseTexture": { "index": 0 }, "specularFactor": [0.3, 0.3, 0.3] }));
    let material = gltf.read().mesh().1.material;
    let rest = material.metallic_roughness.unwrap().occlusion_roughness_metallic.unwrap();
    let [gray, black] = [texel(&rest, 0, 0)[2], texel(&rest, 3, 0)[2]];
    assert!(gray < 160 && black == 255, "{gray} {black}");

    // Maps with other coordinates, and missing ones, are left out.
    let material = &mut gltf.json["materials"][0];
    *material = specular_glossiness(json!({
        "diffuseTexture": { "index": 0 }, "specularFactor": [0, 0, 0],
        "specularGlossinessTexture": { "index": 1, "texCoord": 1 },
    }));
    let read = gltf.read();
    let kind = "glTF material: map with other texture coordinates than the base colour";
    assert_eq!(read.ignored.count(kind), 1, "{:?}", read.ignored);
    assert!(read.mesh().1.material.metallic_roughness.unwrap().occlusion_roughness_metallic.is_none());
    gltf.json["images"][1]["uri"] = "missing.png".into();
    gltf.json["materials"][0]["extensions"]["KHR_materials_pbrSpecularGlossiness"]["specularGlossinessTexture"]["texCoord"] =
        0.into();
    let read = gltf.read();
    assert_eq!(read.ignored.count("glTF: external image that is missing"), 1, "{:?}", read.ignored);
    assert_eq!(texel(&read.mesh().1.material.texture.unwrap(), 0, 0), [191, 191, 191, 255]);
}

/// Two small files of long and narrow maps asked for half a gigabyte.
#[test]
fn converted_maps_are_bounded() {
    let narrow = |width: u32, height: u32| {
        let mut bytes = std::io::Cursor::new(Vec::new());
        image::RgbaImage::new(width, height).write_to(&mut bytes, image::ImageFormat::Png).unwrap();
        data_uri(&bytes.into_inner())
    };
    let mut gltf = with_material(specular_glossiness(json!({
        "diffuseTexture": { "index": 0 }, "specularGlossinessTexture": { "index": 1 },
    })));
    gltf.json["images"][0]["uri"] = narrow(64, 1).into();
    gltf.push("images", json!({ "uri": narrow(1, 64) }));
    gltf.push("textures", json!({ "source": 1 }));
    let read_within = |max_image_bytes: u64| {
        let limits = Limits { max_image_bytes, ..Limits::default() };
        read_with(gltf.text(), Vec::new(), &ReadOptions::for_root("/set/tileset.json", limits))
    };
    assert!(read_within(4 * 64 * 64).is_ok());
    let error = read_within(4 * 64 * 64 - 1).unwrap_err().to_string();
    assert!(error.contains("converted image of a glTF is 16384, the limit is 16383"), "{error}");
}

/// Regression: the whole surface glowed.
#[test]
fn surfaces_without_their_emissive_image_do_not_glow() {
    let emissive = |image: Value| {
        let mut gltf = with_material(json!({ "emissiveFactor": [1, 1, 1], "emissiveTexture": { "index": 0 } }));
        gltf.json["images"][0] = image;
        gltf.read().mesh().1.material.metallic_roughness.unwrap().emissive
    };
    assert_eq!(emissive(json!({ "uri": data_uri(&png(1, [0, 0, 255])) })), [1.0; 3]);
    assert_eq!(emissive(json!({ "uri": "missing.png" })), [0.0; 3]);
}

#[test]
fn diffuse_parts_of_webgl_techniques_are_found() {
    let with = |values: Value, uniforms: Value| {
        let mut gltf =
            with_material(json!({ "extensions": { "KHR_techniques_webgl": { "technique": 0, "values": values } } }));
        gltf.json["extensions"] = json!({ "KHR_techniques_webgl": { "techniques": [{ "uniforms": uniforms }] } });
        gltf.json["extensionsRequired"] = json!(["KHR_techniques_webgl"]);
        gltf.json["extensionsUsed"] = json!(["KHR_techniques_webgl"]);
        let read = gltf.read();
        assert_eq!(read.ignored.count("glTF extension KHR_techniques_webgl"), 1);
        read.mesh().1.material
    };
    let material = with(json!({ "u_diffuse": { "index": 0, "texCoord": 0 }, "u_shininess": 9 }), json!({}));
    assert!(material.texture.is_some() && material.base_color == [1.0; 4]);
    let material = with(json!({ "u_diffuse": [1, 0, 0, 1], "u_ambient": [0, 1, 0, 1] }), json!({}));
    assert!(material.texture.is_none() && material.base_color == RED);
    let material =
        with(json!({}), json!({ "u_diffuse": { "type": 35665, "value": [1, 0, 0] }, "u_tex": { "value": 7 } }));
    assert_eq!(material.base_color, RED);
    assert_eq!(with(json!({ "u_diffuse": { "index": "x" } }), json!(3)).base_color, [1.0; 4]);
}

#[test]
fn maps_of_the_metallic_roughness_model_are_read() {
    let mut gltf = with_material(json!({
        "pbrMetallicRoughness": {
            "metallicFactor": 0.5, "roughnessFactor": 0.25, "metallicRoughnessTexture": { "index": 1 },
        },
        "occlusionTexture": { "index": 2, "strength": 0.75 }, "normalTexture": { "index": 0, "scale": 2 },
        "emissiveFactor": [0, 0, 1], "emissiveTexture": { "index": 0 },
    }));
    gltf.push("images", json!({ "uri": data_uri(&png(1, [9, 20, 30])) }));
    gltf.push("images", json!({ "uri": data_uri(&png(2, [10, 99, 99])) }));
    for source in [1, 2, 1] {
        gltf.push("textures", json!({ "source": source }));
    }
    let model_of = |gltf: &GltfBuilder| gltf.read().mesh().1.material.metallic_roughness.unwrap();
    let texel = |map: Option<Arc<Texture>>| map.unwrap().mips[0][..3].to_vec();
    let model = model_of(&gltf);
    assert_eq!((model.metallic, model.roughness, model.occlusion_strength), (0.5, 0.25, 0.75));
    assert_eq!((model.normal_scale, model.emissive), (2.0, [0.0, 0.0, 1.0]));
    assert_eq!(texel(model.occlusion_roughness_metallic), [9, 20, 30]);
    assert_eq!(texel(model.occlusion_map), [10, 99, 99]);
    assert!(model.normal_map.is_some() && model.emissive_map.is_some());
    assert_eq!(model.second_uv, SecondUv::default());

    // One image for both, of the same texture or of another one.
    for texture in [1, 3] {
        gltf.json["materials"][0]["occlusionTexture"]["index"] = texture.into();
        let model = model_of(&gltf);
        assert!(model.occlusion_map.is_none() && model.occlusion_strength == 0.75);
        assert_eq!(texel(model.occlusion_roughness_metallic), [9, 20, 30]);
    }
    // Occlusion alone, and without its image.
    let material = &mut gltf.json["materials"][0];
    material["pbrMetallicRoughness"].as_object_mut().unwrap().remove("metallicRoughnessTexture");
    let model = model_of(&gltf);
    assert!(model.occlusion_roughness_metallic.is_none());
    assert_eq!(texel(model.occlusion_map), [9, 20, 30]);
    gltf.json["images"][1] = json!({ "uri": "missing.png" });
    let model = model_of(&gltf);
    assert!(model.occlusion_map.is_none() && model.occlusion_strength == 0.0);
}

#[test]
fn maps_may_have_their_own_texture_coordinates() {
    let mut gltf = with_material(json!({
        "pbrMetallicRoughness": {
            "baseColorTexture": { "index": 0 }, "metallicRoughnessTexture": { "index": 0 },
        },
        "occlusionTexture": { "index": 0, "texCoord": 1 },
        "normalTexture": { "index": 0 },
        "emissiveFactor": [1, 1, 1],
        "emissiveTexture": { "index": 0, "extensions": { "KHR_texture_transform": {
            "texCoord": 1, "offset": [0.5, 0], "rotation": std::f64::consts::FRAC_PI_2, "scale": [2, 4],
        } } },
    }));
    let first = gltf.floats("VEC2", &[0.0; 6]);
    let corners: Vec<u8> = [0u16, 0, 65535, 0, 0, 65535].iter().flat_map(|part| part.to_le_bytes()).collect();
    let uvs = gltf.accessor(UNSIGNED_SHORT, "VEC2", 3, &corners);
    gltf.json["accessors"][uvs]["normalized"] = true.into();
    let attributes = &mut gltf.json["meshes"][0]["primitives"][0]["attributes"];
    (attributes["TEXCOORD_0"], attributes["TEXCOORD_1"]) = (first.into(), uvs.into());
    let read = gltf.read();
    let (mesh, drawable) = read.mesh();
    let model = drawable.material.metallic_roughness.unwrap();
    let SecondUv { normal, occlusion_roughness_metallic, emissive, occlusion, .. } = model.second_uv;
    assert_eq!((normal, occlusion_roughness_metallic, occlusion), (None, None, Some(Affine2::IDENTITY)));
    // One image for both is two maps here.
    assert!(Arc::ptr_eq(&model.occlusion_map.unwrap(), &model.occlusion_roughness_metallic.unwrap()));
    let emissive = emissive.unwrap();
    // The formula of KHR_texture_transform: scale, rotation, then offset.
    assert!(emissive.transform_point2(Vec2::new(1.0, 0.0)).abs_diff_eq(Vec2::new(0.5, -2.0), 1e-6));
    assert!(emissive.transform_point2(Vec2::new(0.0, 1.0)).abs_diff_eq(Vec2::new(4.5, 0.0), 1e-6));
    let (format, bytes) = mesh.attributes.get(SecondUv::ATTRIBUTE).unwrap();
    assert_eq!(format, AttributeFormat::Float32x2);
    assert_eq!(bytemuck::cast_slice::<u8, f32>(bytes), [0.0, 0.0, 1.0, 0.0, 0.0, 1.0]);
    assert!(read.ignored.is_empty(), "{:?}", read.ignored);

    // A transform that all maps share belongs to the vertices, whatever kind of map has it.
    let mut shared = GltfBuilder { json: gltf.json.clone(), buffer: gltf.buffer.clone() };
    let transform = json!({ "KHR_texture_transform": { "texCoord": 1, "scale": [2, 2] } });
    let map = json!({ "index": 0, "extensions": transform });
    shared.json["materials"][0] = json!({
        "pbrMetallicRoughness": { "baseColorTexture": map, "metallicRoughnessTexture": map },
        "occlusionTexture": map, "normalTexture": map,
    });
    let (mesh, drawable) = shared.read().mesh();
    assert_eq!(drawable.material.metallic_roughness.unwrap().second_uv, SecondUv::default());
    assert_eq!((mesh.vertices[1].uv, mesh.attributes.get(SecondUv::ATTRIBUTE)), ([2.0, 0.0], None));

    // A third set is listed, and so is a set that the mesh lacks.
    gltf.json["materials"][0]["normalTexture"]["texCoord"] = 2.into();
    let read = gltf.read();
    assert_eq!(read.ignored.count("glTF material: map with a third set of texture coordinates"), 2);
    assert!(read.mesh().1.material.metallic_roughness.unwrap().occlusion_map.is_none(), "the normal map comes first");
    let attributes = gltf.json["meshes"][0]["primitives"][0]["attributes"].as_object_mut().unwrap();
    attributes.remove("TEXCOORD_1");
    assert_eq!(gltf.read().ignored.count("glTF: texture without its coordinates"), 1);
}

#[test]
fn rough_surfaces_without_metal_and_maps_are_matte() {
    let model = |metallic: f64, roughness: f64| {
        let factors = json!({ "pbrMetallicRoughness": { "metallicFactor": metallic, "roughnessFactor": roughness } });
        read(factors).0.metallic_roughness
    };
    assert!(model(0.0, 1.0).is_none());
    assert!(model(0.0, 0.5).is_some() && model(0.5, 1.0).is_some());
    assert!(read(json!({})).0.metallic_roughness.is_some_and(|model| model.metallic == 1.0), "glTF's default is metal");
}

/// Returns a rough material with extensions.
fn extended(extensions: Value) -> Value {
    json!({ "pbrMetallicRoughness": { "metallicFactor": 0 }, "extensions": extensions })
}

#[test]
fn ior_specular_and_clearcoat_are_read() {
    let (material, ignored) = read(extended(json!({
        "KHR_materials_ior": { "ior": 2.25 },
        "KHR_materials_specular": {
            "specularFactor": 0.5, "specularColorFactor": [2, 0.5, 0],
            "specularTexture": { "index": 0 }, "specularColorTexture": { "index": 0 },
        },
        "KHR_materials_clearcoat": {
            "clearcoatFactor": 0.75, "clearcoatRoughnessFactor": 0.125, "clearcoatRoughnessTexture": { "index": 0 },
            "clearcoatNormalTexture": { "index": 0, "scale": 0.5 },
        },
    })));
    assert!(ignored.is_empty(), "{ignored:?}");
    let MetallicRoughness { dielectric, clearcoat, .. } = material.metallic_roughness.unwrap();
    assert_eq!((dielectric.ior, dielectric.specular, dielectric.specular_color), (2.25, 0.5, [2.0, 0.5, 0.0]));
    assert!(dielectric.map.is_some() && dielectric.map_parts == MapParts::Both);
    assert_eq!((clearcoat.strength, clearcoat.roughness, clearcoat.normal_scale), (0.75, 0.125, 0.5));
    assert!(clearcoat.normal_map.is_some());
    assert!(clearcoat.map.is_some() && clearcoat.map_parts == MapParts::Second);
    // The defaults are those of a plain surface, which is matte if it is rough.
    let plain = json!({
        "KHR_materials_ior": {}, "KHR_materials_specular": { "specularFactor": null },
        "KHR_materials_clearcoat": { "clearcoatTexture": { "index": 0 } },
    });
    let (material, ignored) = read(extended(plain));
    assert!(material.metallic_roughness.is_none() && ignored.is_empty(), "{ignored:?}");
}

#[test]
fn invalid_values_of_material_extensions_are_clamped_and_listed() {
    let out_of_range = |name: &str| format!("glTF material: value out of range in {name}");
    for (given, expected) in [(json!(0.5), 1.0), (json!(-2), 1.5), (json!("glass"), 1.5), (json!(1e60), 1.5)] {
        let (material, ignored) = read(extended(json!({
            "KHR_materials_ior": { "ior": given }, "KHR_materials_specular": { "specularFactor": 0.5 },
        })));
        assert_eq!(material.metallic_roughness.unwrap().dielectric.ior, expected);
        assert_eq!(ignored, [out_of_range("KHR_materials_ior")]);
    }
    let (material, mut ignored) = read(extended(json!({
        "KHR_materials_specular": { "specularFactor": 7, "specularColorFactor": [0.5, -1] },
        "KHR_materials_clearcoat": { "clearcoatFactor": 2, "clearcoatTexture": "none" },
    })));
    let MetallicRoughness { dielectric, clearcoat, .. } = material.metallic_roughness.unwrap();
    assert_eq!((dielectric.specular, dielectric.specular_color), (1.0, [0.5, 1.0, 1.0]));
    assert!(clearcoat.strength == 1.0 && clearcoat.map.is_none());
    ignored.sort();
    assert_eq!(ignored, ["KHR_materials_clearcoat", "KHR_materials_specular"].map(out_of_range));
}

/// Two maps of a kind must be parts of one image. Others are listed.
#[test]
fn further_maps_of_material_extensions_are_listed() {
    let mut gltf = with_material(extended(json!({
        "KHR_materials_specular": { "specularTexture": { "index": 1 }, "specularColorTexture": { "index": 0 } },
        "KHR_materials_clearcoat": { "clearcoatFactor": 1, "clearcoatTexture": { "index": 0 } },
    })));
    gltf.push("textures", json!({ "source": 0 }));
    let read = gltf.read();
    let surface = read.mesh().1.material.metallic_roughness.unwrap();
    assert_eq!((surface.dielectric.map_parts, surface.clearcoat.map_parts), (MapParts::First, MapParts::First));
    let kind = "glTF material: second specular map that is not in the image of the first";
    assert_eq!((read.ignored.count(kind), read.ignored.iter().count()), (1, 1), "{:?}", read.ignored);
}

#[test]
fn transmission_is_drawn_by_alpha() {
    let transmission = |of: Value| extended(json!({ "KHR_materials_transmission": of }));
    let look = |material: Value| {
        let (material, ignored) = read(material);
        (material.alpha, material.base_color[3], ignored.len())
    };
    assert_eq!(look(transmission(json!({ "transmissionFactor": 1 }))), (AlphaMode::Blend, 0.25, 0));
    assert_eq!(look(transmission(json!({ "transmissionFactor": 0 }))), (AlphaMode::Opaque, 1.0, 0));
    // A texture says where the surface is opaque, which is most of it.
    let by_texture = json!({ "transmissionFactor": 1, "transmissionTexture": { "index": 0 } });
    assert_eq!(look(transmission(by_texture)), (AlphaMode::Opaque, 1.0, 1));
    let mut blended = transmission(json!({ "transmissionFactor": 0.5 }));
    (blended["alphaMode"], blended["pbrMetallicRoughness"]["baseColorFactor"]) =
        ("BLEND".into(), json!([1, 1, 1, 0.5]));
    assert_eq!(look(blended), (AlphaMode::Blend, 0.3125, 0));
}

#[test]
fn everything_that_is_not_drawn_is_listed() {
    let mut gltf = with_material(json!({
        "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 }, "metallicRoughnessTexture": { "index": 0 } },
        "normalTexture": { "index": 0 }, "occlusionTexture": { "index": 0 }, "emissiveFactor": [0.1, 0.1, 0.1],
    }));
    gltf.json["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"]["texCoord"] = 1.into();
    gltf.json["extensionsUsed"] = json!(["KHR_xmp_json_ld", "VENDOR_unknown", "KHR_materials_unlit"]);
    gltf.json["cameras"] = json!([{ "type": "perspective", "perspective": { "yfov": 1, "znear": 1 } }]);
    gltf.json["animations"] = json!([{ "channels": [], "samplers": [] }]);
    let ignored = gltf.read().ignored;
    for kind in [
        "glTF extension KHR_xmp_json_ld",
        "glTF extension VENDOR_unknown",
        "glTF: animations (drawn at rest)",
        "glTF: cameras",
        "glTF: texture without its coordinates",
    ] {
        assert_eq!(ignored.count(kind), 1, "{kind}: {ignored:?}");
    }
    assert_eq!(ignored.iter().count(), 5, "{ignored:?}");
}

#[test]
fn unknown_required_extensions_are_refused_by_name() {
    let mut gltf = with_material(json!({}));
    gltf.json["extensionsRequired"] = json!(["KHR_materials_unlit", "VENDOR_unknown"]);
    assert!(gltf.error().contains("required glTF extension VENDOR_unknown"));
    gltf.json["extensionsRequired"] = json!(["KHR_xmp_json_ld", "KHR_materials_sheen"]);
    gltf.json["extensionsUsed"] = gltf.json["extensionsRequired"].clone();
    let read = gltf.read();
    assert_eq!(read.ignored.count("glTF extension KHR_xmp_json_ld"), 1);
    // Materials have a sensible look without what refines them, also by extensions that are new.
    gltf.json["extensionsRequired"] = json!(["KHR_materials_of_tomorrow"]);
    assert_eq!(gltf.read().drawables().len(), 1);
    assert_eq!(read.ignored.count("glTF extension KHR_materials_sheen"), 1);
    // An image that only AV1 decoders read leaves the mesh without it.
    gltf.json["extensionsRequired"] = json!(["EXT_texture_avif"]);
    assert_eq!(gltf.read().drawables().len(), 1);
}

/// Files that others' viewers draw, and that were drawn wrongly once.
#[test]
fn sample_cases_have_their_colours() {
    let cases = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/samples/cases");
    if !cases.exists() {
        return skipped(format!("no samples at {}", cases.display()));
    }
    let read =
        |case: &str| super::gltf_builder::read(std::fs::read(cases.join(case).join("model.glb")).unwrap(), Vec::new());
    for case in ["gltf-emissive-only", "gltf-specular-glossiness"] {
        let read = read(case).unwrap();
        let colors: Vec<[f32; 4]> = read.drawables().iter().map(|(_, drawable)| drawable.material.base_color).collect();
        assert_eq!(colors, [RED, RED], "{case}");
    }
    let sampled = read("gltf-sampler-nearest").unwrap();
    let sampling = sampled.mesh().1.material.texture.unwrap().sampling;
    assert_eq!([sampling.mag, sampling.min], [FilterMode::Nearest; 2]);
    assert!(sampled.ignored.is_empty(), "{:?}", sampled.ignored);
}

/// Regression: maps of values were averaged as colours, so that slopes to both sides leaned to one.
#[test]
fn maps_of_values_are_averaged_as_they_are() {
    let mut bytes = std::io::Cursor::new(Vec::new());
    let image = image::RgbaImage::from_fn(2, 1, |x, _| image::Rgba([64 + 128 * x as u8, 128, 238, 255]));
    image.write_to(&mut bytes, image::ImageFormat::Png).unwrap();
    let map = json!({ "index": 0 });
    let mut gltf = with_material(json!({
        "pbrMetallicRoughness": { "baseColorTexture": map, "metallicRoughnessTexture": map },
        "normalTexture": map, "occlusionTexture": map, "emissiveTexture": map, "emissiveFactor": [1, 1, 1],
    }));
    gltf.json["images"][0]["uri"] = data_uri(&bytes.into_inner()).into();
    let material = gltf.read().mesh().1.material;
    let model = material.metallic_roughness.unwrap();
    let mean = |texture: &Option<Arc<Texture>>| texture.as_ref().unwrap().mips[1][0];
    assert_eq!([mean(&model.normal_map), mean(&model.occlusion_roughness_metallic)], [128; 2]);
    assert!(model.occlusion_map.is_none(), "one image for both is one map");
    // Half of the light of 192, and a little of that of 64.
    assert!([&material.texture, &model.emissive_map].iter().all(|map| (140..150).contains(&mean(map))));
}
