//! glTF 1.0: files of the tests' own, beside equal ones of glTF 2.0.

use base64::Engine as _;
use glam::DVec3;
use kit::contents::{GLTF_1, b3dm_with_batches, glb_1};
use serde_json::{Value, json};
use terrane::fetch::{IoError, Limits};
use terrane::formats::{Content, ReadOptions, decode, decode_noting, dependencies};
use terrane::scene::{AlphaMode, AttributeFormat, Material, NodeKind, Topology};

use crate::gltf_builder::*;
use crate::instances::i3dm;

/// The corners of a box.
const CORNERS: [f32; 24] = [
    0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 1.0, 1.0, 0.0, 1.0, 0.0, 1.0, 1.0, 1.0, 1.0,
    1.0,
];
const UVS: [f32; 16] = [0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 1.0, 0.0, 0.5, 1.0, 0.5, 0.5, 1.0, 0.5, 0.0];
const INDICES: [u16; 36] =
    [0, 2, 1, 1, 2, 3, 4, 5, 6, 5, 7, 6, 0, 1, 4, 1, 5, 4, 2, 6, 3, 3, 6, 7, 0, 4, 2, 2, 4, 6, 1, 3, 5, 3, 7, 5];

/// A glTF 1.0 that is being built.
struct Old {
    json: Value,
    buffer: Vec<u8>,
}

impl Old {
    fn new() -> Self {
        Self { json: json!({ "asset": { "version": "1.0" } }), buffer: Vec::new() }
    }

    fn set(&mut self, list: &str, id: &str, object: Value) {
        self.json[list][id] = object;
    }

    /// Adds a view of new bytes.
    fn view(&mut self, id: &str, bytes: &[u8]) {
        self.buffer.resize(self.buffer.len().next_multiple_of(4), 0);
        let (offset, length) = (self.buffer.len(), bytes.len());
        self.set("bufferViews", id, json!({ "buffer": "binary_glTF", "byteOffset": offset, "byteLength": length }));
        self.buffer.extend(bytes);
    }

    /// Adds an accessor of a new view with the same id.
    fn accessor(&mut self, id: &str, component: u32, kind: &str, count: usize, bytes: &[u8]) {
        self.view(id, bytes);
        let accessor = json!({ "bufferView": id, "componentType": component, "count": count, "type": kind });
        self.set("accessors", id, accessor);
    }

    fn floats(&mut self, id: &str, kind: &str, components: usize, values: &[f32]) {
        self.accessor(id, FLOAT, kind, values.len() / components, &floats(values));
    }

    /// Adds a mesh, a node that draws it, and a scene with the node.
    fn draw(&mut self, primitive: Value) {
        self.set("meshes", "mesh", json!({ "primitives": [primitive] }));
        self.set("nodes", "node", json!({ "meshes": ["mesh"] }));
        self.set("scenes", "scene", json!({ "nodes": ["node"] }));
        self.json["scene"] = "scene".into();
    }

    /// Returns the document with its buffer as a `data:` URI.
    fn text(&self) -> Vec<u8> {
        let mut json = self.json.clone();
        json["buffers"]["binary_glTF"] = json!({ "byteLength": self.buffer.len(), "uri": data_uri(&self.buffer) });
        json.to_string().into_bytes()
    }

    /// Returns the document as a binary glTF whose body has this name.
    fn glb(&self, body: &str) -> Vec<u8> {
        let mut json = self.json.clone();
        json["buffers"][body] = json!({ "byteLength": self.buffer.len(), "type": "arraybuffer", "uri": "data:," });
        let text = json.to_string().replace("\"binary_glTF\"", &format!("{body:?}"));
        glb_1(&text, &self.buffer)
    }

    fn read(&self) -> Read {
        read(self.text(), Vec::new()).unwrap()
    }

    fn error(&self) -> String {
        read(self.text(), Vec::new()).map(|_| ()).unwrap_err().reason()
    }
}

/// Returns a triangle with a material, and one texture `texture` with a blue image.
fn with_material(material: Value) -> Old {
    let mut old = Old::new();
    old.floats("positions", "VEC3", 3, &TRIANGLE);
    old.floats("uvs", "VEC2", 2, &[0.0; 6]);
    old.set("images", "image", json!({ "uri": data_uri(&png(1, [0, 0, 255])) }));
    old.set("textures", "texture", json!({ "source": "image", "target": 3553 }));
    old.set("materials", "material", material);
    old.draw(json!({ "attributes": { "POSITION": "positions", "TEXCOORD": "uvs" }, "material": "material" }));
    old
}

fn kinds(read: &Read) -> Vec<&str> {
    read.ignored.iter().map(|(kind, _)| kind).collect()
}

const SHADERS: &str = "glTF material: WebGL shaders (drawn with their diffuse colour)";

/// Returns a box with a texture, whose image is `image`.
fn textured_box(image: Value) -> Old {
    let mut old = Old::new();
    old.floats("positions", "VEC3", 3, &CORNERS);
    old.floats("uvs", "VEC2", 2, &UVS);
    old.accessor("indices", UNSIGNED_SHORT, "SCALAR", 36, &shorts(&INDICES));
    old.json["accessors"]["indices"]["byteStride"] = 0.into();
    old.json["accessors"]["uvs"]["byteStride"] = 8.into();
    old.set("images", "an image", image);
    old.set("samplers", "a sampler", json!({ "magFilter": 9728, "minFilter": 9984, "wrapS": 33071, "wrapT": 33648 }));
    old.set("textures", "a texture", json!({ "source": "an image", "sampler": "a sampler", "format": 6408 }));
    let parameters = json!({ "diffuse": { "type": 35678 }, "projection": { "semantic": "PROJECTION", "type": 35676 } });
    old.set("techniques", "t", json!({ "parameters": parameters, "states": { "enable": [2929, 2884] } }));
    old.set("materials", "m", json!({ "technique": "t", "values": { "diffuse": "a texture", "shininess": 9 } }));
    let attributes = json!({ "POSITION": "positions", "TEXCOORD_0": "uvs" });
    old.draw(json!({ "attributes": attributes, "indices": "indices", "material": "m", "mode": 4 }));
    old.set("nodes", "root", json!({ "children": ["node"], "translation": [6_378_137.25, 0.125, 0.0] }));
    old.json["scenes"]["scene"]["nodes"] = json!(["root"]);
    old
}

/// Returns the same box as a glTF 2.0.
fn box_of_version_2() -> GltfBuilder {
    let mut new = GltfBuilder::new();
    let positions = new.floats("VEC3", &CORNERS);
    let uvs = new.floats("VEC2", &UVS);
    let indices = new.accessor(UNSIGNED_SHORT, "SCALAR", 36, &shorts(&INDICES));
    new.push("images", json!({ "uri": data_uri(&png(4, [10, 20, 30])) }));
    new.push("samplers", json!({ "magFilter": 9728, "minFilter": 9984, "wrapS": 33071, "wrapT": 33648 }));
    new.push("textures", json!({ "source": 0, "sampler": 0 }));
    let pbr = json!({ "baseColorTexture": { "index": 0 }, "metallicFactor": 0 });
    new.push("materials", json!({ "pbrMetallicRoughness": pbr }));
    let attributes = json!({ "POSITION": positions, "TEXCOORD_0": uvs });
    let node = new.draw(json!({ "attributes": attributes, "indices": indices, "material": 0 }));
    let root = new.push("nodes", json!({ "children": [node], "translation": [6_378_137.25, 0.125, 0.0] }));
    new.json["scenes"][0]["nodes"] = json!([root]);
    new
}

#[test]
fn a_textured_box_equals_that_of_version_2() {
    let old = textured_box(json!({ "uri": data_uri(&png(4, [10, 20, 30])) })).read();
    let new = box_of_version_2().read();
    assert_eq!(format!("{:?}", old.node), format!("{:?}", new.node));
    assert_eq!(kinds(&old), [SHADERS]);
}

#[test]
fn binary_files_have_their_buffer_and_images_in_the_body() {
    let image = json!({ "bufferView": "an image", "mimeType": "image/png", "width": 4, "height": 4 });
    let mut old = textured_box(json!({ "uri": "data:,", "extensions": { "KHR_binary_glTF": image } }));
    old.view("an image", &png(4, [10, 20, 30]));
    // A buffer whose id comes before that of the body.
    old.set("buffers", "a", json!({ "byteLength": 1, "uri": "data:,x" }));
    old.json["extensionsUsed"] = json!(["KHR_binary_glTF"]);
    let new = format!("{:?}", box_of_version_2().read().node);
    for body in ["binary_glTF", "KHR_binary_glTF"] {
        let read = read(old.glb(body), Vec::new()).unwrap();
        assert_eq!(format!("{:?}", read.node), new, "{body}");
        assert_eq!(kinds(&read), [SHADERS]);
    }
    // Assimp does not list it.
    let text = old.json.to_string();
    assert!(!text.contains(r#""binary_glTF":"#));
    let unlisted = read(glb_1(&text, &old.buffer), Vec::new()).unwrap();
    assert_eq!(format!("{:?}", unlisted.node), new);
    let whole = old.glb("binary_glTF");
    for length in 4..whole.len() {
        assert!(read(whole[..length].to_vec(), Vec::new()).is_err(), "cut to {length} bytes");
    }
    let mut other = whole;
    other[16] = 1;
    assert!(read(other, Vec::new()).unwrap_err().reason().contains("content format Some(1)"));
}

#[test]
fn strides_move_to_views() {
    let mut old = Old::new();
    // A position, a colour, and texture coordinates of 16 bits that end before the stride does.
    let mut bytes = Vec::new();
    for (i, corner) in TRIANGLE.chunks(3).enumerate() {
        bytes.extend(floats(corner));
        bytes.extend([255, 0, 0, 255]);
        bytes.extend(shorts(&[i as u16, 7]));
        bytes.extend([0xee; 3]);
    }
    bytes.truncate(bytes.len() - 3);
    old.view("all", &bytes);
    // Absent lengths are those that the accessors need.
    old.json["bufferViews"]["all"].as_object_mut().unwrap().remove("byteLength");
    let accessor = |offset: usize, component: u32, kind: &str| {
        json!({ "bufferView": "all", "byteOffset": offset, "byteStride": 23, "componentType": component, "count": 3,
            "type": kind })
    };
    old.set("accessors", "p", accessor(0, FLOAT, "VEC3"));
    old.set("accessors", "c", accessor(12, UNSIGNED_BYTE, "VEC4"));
    old.set("accessors", "t", accessor(16, UNSIGNED_SHORT, "VEC2"));
    // Without a stride, in the same view.
    old.set(
        "accessors",
        "i",
        json!({ "bufferView": "all", "componentType": UNSIGNED_BYTE, "count": 3, "type": "SCALAR" }),
    );
    old.draw(json!({ "attributes": { "POSITION": "p", "COLOR": "c", "TEXCOORD": "t" }, "indices": "i" }));
    let read = old.read();
    let (mesh, _) = read.mesh();
    assert_eq!(mesh.vertices.iter().flat_map(|vertex| vertex.position).collect::<Vec<_>>(), TRIANGLE);
    assert!(mesh.vertices.iter().all(|vertex| vertex.color == [255, 0, 0, 255]));
    assert_eq!(mesh.vertices.iter().map(|vertex| vertex.uv).collect::<Vec<_>>(), [[0.0, 7.0], [1.0, 7.0], [2.0, 7.0]]);
    assert_eq!(*mesh.indices, [0, 0, 0]);
    assert!(read.ignored.is_empty());
    for (name, value, why) in [
        ("byteStride", json!(4), "byteStride below"),
        ("count", json!(4), "beyond its buffer"),
        ("count", json!(u64::MAX), "glTF"),
        ("byteOffset", json!(u64::MAX), "beyond its buffer"),
        ("componentType", json!(5124), "accessors[2] is invalid"),
        ("type", json!("VEC9"), "accessors[2] is invalid"),
        ("bufferView", Value::Null, "bufferView"),
    ] {
        let was = std::mem::replace(&mut old.json["accessors"]["p"][name], value);
        assert!(old.error().contains(why), "{name}: {}", old.error());
        old.json["accessors"]["p"][name] = was;
    }
}

#[test]
fn nodes_draw_all_their_meshes() {
    let mut old = with_material(json!({}));
    old.set("meshes", "other", old.json["meshes"]["mesh"].clone());
    old.set(
        "nodes",
        "node",
        json!({ "meshes": ["mesh", "other", "mesh"], "children": ["child"], "translation": [1, 0, 0] }),
    );
    old.set("nodes", "child", json!({ "meshes": ["mesh"], "translation": [0, 5, 0] }));
    let at: Vec<DVec3> = old.read().drawables().iter().map(|(map, _)| map.translation).collect();
    assert_eq!(at, [DVec3::X, DVec3::new(1.0, 5.0, 0.0), DVec3::X, DVec3::X]);
    let meshes: Vec<&str> = std::iter::repeat_n("mesh", 9).collect();
    old.set("nodes", "node", json!({ "meshes": meshes }));
    let limits = Limits { max_json_bytes: 1 << 14, ..Limits::default() };
    let few = read_with(old.text(), Vec::new(), &ReadOptions::for_root("/set/tileset.json", limits));
    assert!(matches!(few, Err(IoError::TooLarge { .. })), "{few:?}");
}

#[test]
fn techniques_are_drawn_with_their_diffuse_part() {
    let draw = |technique: Value, values: Value| -> Material {
        let mut old = with_material(json!({ "technique": "t", "values": values }));
        old.set("techniques", "t", technique);
        let read = old.read();
        assert_eq!(kinds(&read), [SHADERS]);
        read.mesh().1.material
    };
    // sRGB 0.5 is 0.214 in linear light.
    let grey = [0.214_041_14, 0.214_041_14, 1.0, 0.5];
    let cull = json!({ "states": { "enable": [2929, 2884] } });
    let material = draw(cull.clone(), json!({ "diffuse": [0.5, 0.5, 1, 0.5], "specular": [1, 1, 1, 1] }));
    assert_eq!((material.base_color, material.alpha, material.double_sided), (grey, AlphaMode::Opaque, false));
    assert!(material.metallic_roughness.is_none() && !material.unlit && material.texture.is_none());
    let blend = json!({ "states": { "enable": [3042] } });
    let material = draw(blend, json!({ "diffuse": "texture", "transparency": 0.25 }));
    assert_eq!(
        (material.base_color, material.alpha, material.double_sided),
        ([1.0, 1.0, 1.0, 0.25], AlphaMode::Blend, true)
    );
    assert_eq!(material.texture.unwrap().mips[0], [0, 0, 255, 255]);
    // The name of the uniform or the semantic says that a parameter is diffuse; its default counts without a value.
    let by_uniform =
        json!({ "parameters": { "p": { "value": [0.5, 0.5, 1, 0.5] } }, "uniforms": { "u_diffuse": "p" } });
    assert_eq!(draw(by_uniform, json!({})).base_color, grey);
    let by_semantic = json!({ "parameters": { "p": { "semantic": "_3DTILESDIFFUSE", "value": [0, 0, 0] } } });
    assert_eq!(draw(by_semantic.clone(), json!({})).base_color, [0.0, 0.0, 0.0, 1.0]);
    assert_eq!(draw(by_semantic, json!({ "p": [0.5, 0.5, 1, 0.5] })).base_color, grey);
    // A shader without normals is not lit.
    let reads = |semantics: &[&str]| {
        let parameters: Value = semantics.iter().map(|of| ((*of).to_owned(), json!({ "semantic": of }))).collect();
        draw(json!({ "parameters": parameters }), json!({ "u_tex": "texture" }))
    };
    let unlit = reads(&["POSITION", "TEXCOORD_0"]);
    assert!(unlit.unlit && unlit.texture.is_some() && !reads(&["POSITION", "NORMAL"]).unlit);
    let texture = json!({ "parameters": { "tex": { "value": "texture" } } });
    assert!(draw(texture, json!({ "other": 1 })).texture.is_some());
    assert_eq!(draw(json!({ "parameters": 7, "uniforms": [], "states": "x" }), json!(9)).base_color, [1.0; 4]);
    let mut old =
        with_material(json!({ "instanceTechnique": { "technique": "t", "values": { "diffuse": [1, 0, 0, 1] } } }));
    old.set("techniques", "t", cull);
    assert_eq!(old.read().mesh().1.material.base_color, [1.0, 0.0, 0.0, 1.0]);
}

#[test]
fn common_materials_are_converted() {
    let draw = |common: Value| {
        let mut old = with_material(json!({ "extensions": { "KHR_materials_common": common } }));
        old.json["extensionsUsed"] = json!(["KHR_materials_common"]);
        old.read()
    };
    let material = |common: Value| draw(common).mesh().1.material;
    let read = draw(json!({ "technique": "PHONG", "doubleSided": true, "transparent": true, "values": {
        "diffuse": [0.5, 0.5, 1, 1], "transparency": 0.5, "specular": [0.2, 0.2, 0.2, 1], "shininess": 9,
        "ambient": [1, 1, 1, 1], "emission": [0, 0, 0, 1],
    } }));
    let phong = read.mesh().1.material;
    assert_eq!(phong.base_color, [0.214_041_14, 0.214_041_14, 1.0, 0.5]);
    assert_eq!((phong.alpha, phong.double_sided, phong.unlit), (AlphaMode::Blend, true, false));
    assert!(phong.metallic_roughness.is_none());
    assert_eq!(kinds(&read), ["glTF 1.0 material: specular colour"]);
    let lambert =
        material(json!({ "technique": "LAMBERT", "values": { "diffuse": "texture", "emission": [0.5, 0, 0, 1] } }));
    assert_eq!((lambert.base_color, lambert.alpha, lambert.double_sided), ([1.0; 4], AlphaMode::Opaque, false));
    assert_eq!(lambert.texture.unwrap().mips[0], [0, 0, 255, 255]);
    assert_eq!(lambert.metallic_roughness.unwrap().emissive, [0.214_041_14, 0.0, 0.0]);
    let constant =
        material(json!({ "technique": "CONSTANT", "values": { "emission": "texture", "transparency": 0.5 } }));
    assert!(constant.unlit && constant.texture.is_some() && constant.base_color == [1.0, 1.0, 1.0, 0.5]);
    let constant = material(json!({ "technique": "CONSTANT", "values": { "ambient": [1, 0, 0, 1] } }));
    assert!(constant.unlit && constant.base_color == [1.0, 0.0, 0.0, 1.0]);
    // A surface that only emits light is drawn in its colour.
    let lamp = material(json!({ "technique": "BLINN", "values": { "emission": [0, 1, 0, 1] } }));
    assert!(lamp.unlit && lamp.base_color == [0.0, 1.0, 0.0, 1.0]);
    for odd in [json!({}), json!({ "technique": 7, "values": 3, "transparent": "x" })] {
        assert_eq!(material(odd).base_color, [1.0; 4]);
    }
    // Numbers beyond their range.
    let odd = json!({ "values": { "diffuse": [7, -1, 0], "transparency": 9, "emission": [-1, 0] } });
    assert_eq!(material(odd).base_color, [1.0, 0.0, 0.0, 1.0]);
}

#[test]
fn b3dm_and_i3dm_hold_version_1() {
    let mut old = textured_box(json!({ "uri": data_uri(&png(4, [10, 20, 30])) }));
    old.floats("batches", "SCALAR", 1, &[1.0; 8]);
    old.json["meshes"]["mesh"]["primitives"][0]["attributes"]["BATCHID"] = "batches".into();
    old.json["extensions"] = json!({ "CESIUM_RTC": { "center": [100, 200, 300] } });
    old.json["extensionsUsed"] = json!(["CESIUM_RTC", "KHR_binary_glTF"]);
    let glb = old.glb("binary_glTF");
    let b3dm = b3dm_with_batches(r#"{"BATCH_LENGTH":2}"#, r#"{"name":["a","b"]}"#, &glb);
    let options = ReadOptions { keep_features: true, ..ReadOptions::for_root("/set/tileset.json", Limits::default()) };
    let content = |bytes| Content { uri: URI.into(), bytes, reader_data: None, companions: Vec::new() };
    let mut page = decode(content(b3dm), &options).unwrap();
    page.take_drawables();
    let features = page.features(0).unwrap();
    let found: Vec<String> =
        features.at_vertex(3).map(|feature| format!("{} {:?}", feature.id, feature.properties())).collect();
    assert!(found.len() == 1 && found[0].starts_with("1 ") && found[0].contains("\"b\""), "{found:?}");
    // The centre is z-up; the translation of the node is y-up.
    let (node, _) = decode_noting(content(glb.clone()), &options).unwrap();
    let NodeKind::Transform(map) = node.kind else { panic!("a transform") };
    assert_eq!(map.translation, DVec3::new(100.0, 200.0, 300.0));

    let table = r#"{"INSTANCES_LENGTH":2,"POSITION":{"byteOffset":0}}"#;
    let (node, _) =
        decode_noting(content(i3dm(table, &floats(&[0.0, 0.0, 0.0, 9.0, 9.0, 9.0]), 1, &glb)), &options).unwrap();
    assert_eq!(Read { node, ignored: Default::default() }.node_drawables().len(), 2);
}

type Change = fn(&mut Value);

#[test]
fn ids_of_no_object_are_named() {
    let old = |change: &dyn Fn(&mut Value)| {
        let mut old = textured_box(json!({ "uri": data_uri(&png(4, [10, 20, 30])) }));
        change(&mut old.json);
        read(old.text(), Vec::new())
    };
    let changes: [(Change, &str); 7] = [
        (|json| json["meshes"]["mesh"]["primitives"][0]["indices"] = "x".into(), r#"a mesh refers to accessor "x""#),
        (
            |json| json["meshes"]["mesh"]["primitives"][0]["attributes"]["POSITION"] = 7.into(),
            r#"refers to accessor "7""#,
        ),
        (|json| json["accessors"]["uvs"]["bufferView"] = "x".into(), r#"an accessor refers to bufferView "x""#),
        (|json| json["bufferViews"]["uvs"]["buffer"] = json!({}), r#"a bufferView refers to buffer """#),
        (|json| json["nodes"]["root"]["children"] = json!(["x"]), r#"a node refers to node "x""#),
        (|json| json["nodes"]["node"]["meshes"] = json!(["x"]), r#"a node refers to mesh "x""#),
        (|json| json["scenes"]["scene"]["nodes"] = json!(["x"]), r#"a scene refers to node "x""#),
    ];
    for (change, why) in changes {
        let error = old(&change).unwrap_err().reason();
        assert!(error.contains(why), "{error}");
    }
    let changes: [(Change, &str); 6] = [
        (|json| json["meshes"]["mesh"]["primitives"][0]["material"] = "x".into(), "material"),
        (|json| json["materials"]["m"]["technique"] = "x".into(), "technique"),
        (|json| json["materials"]["m"]["values"]["diffuse"] = "x".into(), "texture"),
        (|json| json["textures"]["a texture"]["source"] = "x".into(), "image"),
        (|json| json["textures"]["a texture"]["sampler"] = "x".into(), "sampler"),
        (|json| json["scene"] = "x".into(), "scene"),
    ];
    for (change, kind) in changes {
        let read = old(&change).unwrap();
        assert_eq!(read.ignored.count(&format!("glTF 1.0: reference to a {kind} that does not exist")), 1, "{kind}");
        assert_eq!(read.drawables().len(), 1);
    }
    for wrong in ["accessors", "bufferViews", "meshes", "nodes", "scenes", "textures", "images"] {
        for value in [json!([1]), json!({ "a": 7 }), json!("x")] {
            let error = old(&|json: &mut Value| json[wrong] = value.clone()).map(|_| ());
            assert!(error.is_err(), "{wrong}: {value}");
        }
    }
}

#[test]
fn everything_that_is_left_out_is_listed() {
    let mut old = with_material(json!({}));
    for list in ["animations", "cameras", "skins"] {
        old.set(list, "x", json!({ "name": "x" }));
    }
    old.json["extensions"] = json!({ "KHR_materials_common": { "lights": { "l": { "type": "ambient" } } } });
    old.json["extensionsUsed"] = json!(["KHR_binary_glTF", "KHR_materials_common", "VENDOR_x"]);
    assert_eq!(
        kinds(&old.read()),
        [
            "glTF 1.0: lights of KHR_materials_common",
            "glTF 1.0: skins (drawn at rest)",
            "glTF extension VENDOR_x",
            "glTF: animations (drawn at rest)",
            "glTF: cameras",
        ]
    );
    old.json["extensionsUsed"] = json!(["Open3DGC-compression"]);
    assert!(old.error().contains("glTF 1.0 extension Open3DGC-compression"), "{}", old.error());
}

#[test]
fn external_files_are_found() {
    let mut old = with_material(json!({ "technique": "t", "values": { "diffuse": "texture" } }));
    old.set("techniques", "t", json!({ "program": "p" }));
    old.set("shaders", "s", json!({ "type": 35632, "uri": "a.glsl" }));
    old.set("images", "image", json!({ "uri": "a.png" }));
    old.set("buffers", "binary_glTF", json!({ "byteLength": old.buffer.len(), "uri": "data/a.bin" }));
    let text = old.json.to_string().into_bytes();
    let options = ReadOptions::for_root("/set/tileset.json", Limits::default());
    let files = dependencies(URI, &text, None, &[], &options);
    let names: Vec<&str> = files.iter().map(|uri| uri.rsplit_once("/set/").unwrap().1).collect();
    assert_eq!(names, ["data/a.bin", "a.png"]);
    let bytes = [old.buffer.clone(), png(1, [0, 0, 255])];
    let read = read(text, files.into_iter().zip(bytes.map(Ok)).collect()).unwrap();
    assert!(read.mesh().1.material.texture.is_some());
    assert_eq!(kinds(&read), [SHADERS]);
}

#[test]
fn quantized_attributes_are_decoded() {
    let mut old = Old::new();
    old.accessor("p", UNSIGNED_SHORT, "VEC3", 3, &shorts(&[0, 0, 0, 100, 0, 0, 0, 200, 0]));
    old.accessor("t", UNSIGNED_SHORT, "VEC2", 3, &shorts(&[0, 1, 10, 1, 0, 1]));
    let positions = json!([0.5, 0, 0, 0, 0, 0.25, 0, 0, 0, 0, 1, 0, 10, 20, 30, 1]);
    old.json["accessors"]["p"]["extensions"] = json!({ "WEB3D_quantized_attributes": { "decodeMatrix": positions } });
    let uvs = json!([0.1, 0, 0, 0, 1, 0, 0, 2, 1]);
    old.json["accessors"]["t"]["extensions"] = json!({ "WEB3D_quantized_attributes": { "decodeMatrix": uvs } });
    old.json["extensionsUsed"] = json!(["WEB3D_quantized_attributes"]);
    old.draw(json!({ "attributes": { "POSITION": "p", "TEXCOORD_0": "t" } }));
    let options = ReadOptions::for_root("/set/tileset.json", Limits::default());
    let options = ReadOptions { vertex_attributes: ["POSITION".into()].into(), ..options };
    let read = read_with(old.text(), Vec::new(), &options).unwrap();
    assert_eq!(read.positions(), [[10.0, 20.0, 30.0], [60.0, 20.0, 30.0], [10.0, 70.0, 30.0]]);
    let (mesh, _) = read.mesh();
    assert_eq!(mesh.vertices.iter().map(|vertex| vertex.uv).collect::<Vec<_>>(), [[0.0, 3.0], [1.0, 3.0], [0.0, 3.0]]);
    let (format, kept) = mesh.attributes.get("POSITION").unwrap();
    assert_eq!((format, &kept[..12]), (AttributeFormat::Float32x3, &floats(&[10.0, 20.0, 30.0])[..]));
    assert!(read.ignored.is_empty(), "{:?}", read.ignored);
    for matrix in [json!([1, 0, 0, 1]), json!(null), json!(["a"])] {
        old.json["accessors"]["p"]["extensions"]["WEB3D_quantized_attributes"]["decodeMatrix"] = matrix;
        assert!(old.error().contains("decodeMatrix has not 16 numbers"), "{}", old.error());
    }
}

#[test]
fn version_0_8_is_read() {
    let mut old = with_material(json!({}));
    old.json["asset"] = json!({ "version": 0.8 });
    // An axis and an angle.
    let quarter = std::f64::consts::FRAC_PI_2;
    old.set("nodes", "node", json!({ "instanceSkin": { "meshes": ["mesh"] }, "rotation": [0, 0, 2, quarter] }));
    old.json["meshes"]["mesh"]["primitives"][0]["primitive"] = 1.into();
    old.floats("positions", "VEC3", 3, &TRIANGLE[..6]);
    old.floats("uvs", "VEC2", 2, &[0.0; 4]);
    let read = old.read();
    assert_eq!(read.positions(), [[0.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
    assert_eq!(read.mesh().0.topology, Topology::Lines);
    for odd in [json!([0, 0, 0, 1]), json!("x"), json!([1])] {
        old.json["nodes"]["node"]["rotation"] = odd;
        assert_eq!(old.read().positions()[1], [1.0, 0.0, 0.0]);
    }
}

#[test]
fn the_seed_of_the_fuzzer_is_valid() {
    let text = read(GLTF_1.as_bytes().to_vec(), Vec::new()).unwrap();
    assert_eq!(text.drawables().len(), 3);
    let json: Value = serde_json::from_str(GLTF_1).unwrap();
    let uri = json["buffers"]["binary_glTF"]["uri"].as_str().unwrap();
    let body = base64::engine::general_purpose::STANDARD.decode(uri.split_once(',').unwrap().1).unwrap();
    let binary = read(glb_1(GLTF_1, &body), Vec::new()).unwrap();
    assert_eq!(format!("{:?}", binary.node), format!("{:?}", text.node));
}
