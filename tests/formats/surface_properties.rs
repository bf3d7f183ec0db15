//! Feature ids in textures, property textures and property attributes: by point of a mesh, and by pixel of a view.

use std::path::Path;

use glam::DVec3;
use kit::frames::pixel;
use kit::rig::{plain, unit_camera};
use kit::viewer::{Settle, offscreen};
use serde_json::{Value, json};
use terrane::fetch::Limits;
use terrane::formats::{ReadOptions, Style, UpAxis};
use terrane::gpu::AdapterChoice;
use terrane::pager::PagerConfig;
use terrane::scene::{
    DrawableFeatures, Intersection, IntersectionLimit, IntersectionVisitor, LineSegmentIntersector, Page, Scene,
    SurfacePoint,
};
use terrane::viewer::ViewerConfig;

use crate::gltf_builder::*;

const NEAREST: u32 = 9728;
const REPEAT: u32 = 10497;
const CLAMP: u32 = 33071;

fn options() -> ReadOptions {
    let options = ReadOptions::for_root("/set/tileset.json", Limits::default());
    ReadOptions { keep_features: true, gltf_up_axis: UpAxis::Z, ..options }
}

/// Returns a PNG whose texels are `texel(x, y)`.
fn png_of(width: u32, height: u32, texel: impl Fn(u32, u32) -> [u8; 4]) -> Vec<u8> {
    let image = image::RgbaImage::from_fn(width, height, |x, y| image::Rgba(texel(x, y)));
    let mut bytes = std::io::Cursor::new(Vec::new());
    image.write_to(&mut bytes, image::ImageFormat::Png).unwrap();
    bytes.into_inner()
}

/// The texels of the image of ids: the number of the texel, and others that follow from it.
fn texel(x: u32, y: u32) -> [u8; 4] {
    let i = (4 * y + x) as u8;
    [i, 100 + i, 10 * i, 255 - i]
}

/// A square from -1 to 1 whose image of 4 x 2 texels covers it; v points down. Its second coordinates are twice as large.
fn square() -> GltfBuilder {
    let mut gltf = GltfBuilder::new();
    let image = gltf.push("images", json!({ "uri": data_uri(&png_of(4, 2, texel)) }));
    let sampler = |wrap: u32| json!({ "wrapS": wrap, "wrapT": wrap, "magFilter": NEAREST, "minFilter": NEAREST });
    let (clamped, repeated) = (gltf.push("samplers", sampler(CLAMP)), gltf.push("samplers", sampler(REPEAT)));
    gltf.push("textures", json!({ "source": image, "sampler": clamped }));
    gltf.push("textures", json!({ "source": image, "sampler": repeated }));
    gltf
}

/// Draws the square with the extensions of its primitive.
fn draw(gltf: &mut GltfBuilder, extensions: Value) {
    let positions = gltf.floats("VEC3", &[-1.0, -1.0, 0.0, 1.0, -1.0, 0.0, -1.0, 1.0, 0.0, 1.0, 1.0, 0.0]);
    let uvs = [0.0, 1.0, 1.0, 1.0, 0.0, 0.0, 1.0, 0.0];
    let twice = gltf.floats("VEC2", &uvs.map(|uv| 2.0 * uv));
    let uvs = gltf.floats("VEC2", &uvs);
    let heat = gltf.floats("SCALAR", &[1.0, 2.0, 3.0, -9.0]);
    let kinds = gltf.accessor(UNSIGNED_BYTE, "SCALAR", 4, &[0, 1, 2, 1]);
    let indices = gltf.accessor(UNSIGNED_SHORT, "SCALAR", 6, &shorts(&[0, 1, 2, 2, 1, 3]));
    gltf.json["extensionsUsed"] = json!(["KHR_materials_unlit"]);
    let material = gltf.push(
        "materials",
        json!({
            "extensions": { "KHR_materials_unlit": {} },
            "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 } },
        }),
    );
    gltf.draw(json!({
        "attributes": { "POSITION": positions, "TEXCOORD_0": uvs, "TEXCOORD_1": twice, "_HEAT": heat, "_KIND": kinds },
        "indices": indices, "material": material, "extensions": extensions,
    }));
}

/// A scene of one content, which lines meet.
struct Met {
    scene: Scene,
}

impl Met {
    fn new(text: Vec<u8>, options: &ReadOptions) -> Self {
        let node = read_with(text, Vec::new(), options).unwrap().node;
        let mut page = Page::from_node(node).unwrap();
        page.build_kd_trees();
        // A pager uploads the payloads. The features stay.
        page.take_drawables();
        let mut scene = Scene::new();
        scene.add_root(page);
        Self { scene }
    }

    fn hit(&self, x: f64, y: f64) -> Intersection {
        self.hits(x, y).remove(0)
    }

    fn hits(&self, x: f64, y: f64) -> Vec<Intersection> {
        let mut line = LineSegmentIntersector::new(DVec3::new(x, y, 5.0), DVec3::new(x, y, -5.0));
        IntersectionVisitor::new().traverse(&self.scene, &mut line);
        line.intersections().to_vec()
    }

    fn features(&self, hit: &Intersection) -> &DrawableFeatures {
        self.scene.page(hit.node().unwrap().page).unwrap().features(hit.drawable).unwrap()
    }

    /// Returns labels and ids of the features at a point.
    fn ids(&self, x: f64, y: f64) -> Vec<(String, u32)> {
        let hit = self.hit(x, y);
        self.features(&hit).at_point(hit.surface_point()).map(|of| (of.label.to_owned(), of.id)).collect()
    }

    /// Returns the values of surface properties at a point.
    fn values(&self, x: f64, y: f64) -> String {
        let hit = self.hit(x, y);
        let values = self.features(&hit).properties_at(hit.surface_point());
        values.map(|(of, value)| format!("{}.{}={value}", of.class, of.info.name)).collect::<Vec<_>>().join(" ")
    }
}

/// A point inside of a texel of the image.
fn inside(x: u32, y: u32) -> [f64; 2] {
    [-1.0 + (f64::from(x) + 0.3) / 2.0, 1.0 - (f64::from(y) + 0.3)]
}

/// Adds a property table with a letter for each of eight features.
fn add_names(gltf: &mut GltfBuilder) {
    let names = gltf.view(b"abcdefgh", None);
    let ends = gltf.view(&(0..9u32).flat_map(|i| i.to_le_bytes()).collect::<Vec<_>>(), None);
    let properties = json!({ "name": { "values": names, "stringOffsets": ends } });
    gltf.json["extensions"] = json!({ "EXT_structural_metadata": {
        "schema": { "classes": { "c": { "properties": { "name": { "type": "STRING" } } } } },
        "propertyTables": [{ "class": "c", "count": 8, "properties": properties }],
    } });
}

#[test]
fn texels_are_feature_ids() {
    let mut gltf = square();
    add_names(&mut gltf);
    let transform =
        |scale: [f32; 2]| json!({ "KHR_texture_transform": { "offset": [0.25, 0], "scale": scale, "texCoord": 0 } });
    draw(
        &mut gltf,
        json!({ "EXT_mesh_features": { "featureIds": [
        { "featureCount": 8, "label": "plain", "nullFeatureId": 5, "propertyTable": 0, "texture": { "index": 0 } },
        { "featureCount": 8, "label": "wide", "texture": { "index": 0, "channels": [1, 2] } },
        { "featureCount": 8, "label": "twice", "texture": { "index": 1, "texCoord": 1 } },
        { "featureCount": 8, "label": "moved",
            "texture": { "index": 1, "texCoord": 1, "extensions": transform([1.0, 0.5]) } },
        { "featureCount": 4, "label": "vertex" },
        { "featureCount": 8, "label": "image", "texture": { "index": 9 } },
        { "featureCount": 8, "label": "channel", "texture": { "index": 0, "channels": [4] } },
        { "featureCount": 8, "label": "coordinates", "texture": { "index": 0, "texCoord": 7 } },
    ] } }),
    );
    let met = Met::new(gltf.text(), &options());
    for (x, y) in (0..2).flat_map(|y| (0..4).map(move |x| (x, y))) {
        let [at_x, at_y] = inside(x, y);
        let i = 4 * y + x;
        let vertex = met.hit(at_x, at_y).surface_point().nearest_vertex();
        let mut expected = vec![
            ("plain", i),
            ("wide", (100 + i) | (10 * i) << 8),
            // The second coordinates repeat the image twice along each axis.
            ("twice", 2 * x % 4),
            // The image begins a texel later, and its upper half covers the square.
            ("moved", (x + 1) % 4),
            ("vertex", vertex),
        ];
        expected.retain(|of| *of != ("plain", 5));
        let found = met.ids(at_x, at_y);
        assert_eq!(found.iter().map(|(label, id)| (label.as_str(), *id)).collect::<Vec<_>>(), expected, "{x} {y}");
    }
    let hit = met.hit(-0.75, 0.5);
    let feature = met.features(&hit).at_point(hit.surface_point()).next().unwrap();
    assert_eq!(feature.table.unwrap().value("name", feature.id as usize).unwrap().as_str(), Some("a"));
    assert_eq!(met.features(&hit).at_vertex(0).count(), 1, "ids in images belong to points");
    let read = read_with(gltf.text(), Vec::new(), &options()).unwrap();
    assert_eq!(read.ignored.count("glTF: feature ids whose texture is missing or invalid"), 3);
}

#[test]
fn property_textures_and_attributes_have_values_at_points() {
    let scalar = |component: &str| json!({ "type": "SCALAR", "componentType": component });
    let mut gltf = square();
    let schema = json!({
        "classes": { "ground": { "properties": {
            "wetness": { "type": "SCALAR", "componentType": "UINT8", "normalized": true, "scale": 255, "noData": 3, "default": -1 },
            "kind": { "type": "ENUM", "enumType": "kind" },
            "depth": { "type": "SCALAR", "componentType": "UINT16" },
            "pair": { "type": "VEC2", "componentType": "UINT8" },
            "list": { "type": "SCALAR", "componentType": "INT8", "array": true, "count": 2 },
            "heat": { "type": "SCALAR", "componentType": "FLOAT32", "noData": -9, "offset": 0.5, "semantic": "HEAT" },
            "text": { "type": "STRING" }, "real": scalar("FLOAT32"),
        } } },
        "enums": { "kind": { "valueType": "UINT8", "values": [{ "name": "grass", "value": 1 }, { "name": "rock", "value": 2 }] } },
    });
    gltf.json["extensions"] = json!({ "EXT_structural_metadata": {
        "schema": schema,
        "propertyTextures": [{ "class": "ground", "properties": {
            "wetness": { "index": 0, "channels": [0], "offset": 1 },
            "kind": { "index": 0 },
            "depth": { "index": 0, "channels": [0, 1] },
            "pair": { "index": 0, "channels": [2, 3] },
            "list": { "index": 0, "channels": [0, 3] },
            "text": { "index": 0 }, "real": { "index": 0, "channels": [0] }, "unknown": { "index": 0 },
        } }],
        "propertyAttributes": [{ "class": "ground", "properties": {
            "heat": { "attribute": "_HEAT", "max": 8 }, "kind": { "attribute": "_KIND" },
            "real": { "attribute": "_KIND" }, "depth": { "attribute": "_MISSING" },
        } }],
    } });
    draw(
        &mut gltf,
        json!({ "EXT_structural_metadata": { "propertyTextures": [0, 5], "propertyAttributes": [0, "x"] } }),
    );
    let met = Met::new(gltf.text(), &options());
    let at = |x: u32, y: u32| met.values(inside(x, y)[0], inside(x, y)[1]);
    assert_eq!(
        at(1, 0),
        "ground.depth=25857 ground.kind=grass ground.list=[1, -2] ground.pair=[10, 254] ground.wetness=2 \
         ground.heat=3.5 ground.kind=rock"
    );
    assert_eq!(
        at(3, 0),
        "ground.depth=26371 ground.kind=3 ground.list=[3, -4] ground.pair=[30, 252] ground.wetness=-1 \
         ground.heat=null ground.kind=grass"
    );
    let hit = met.hit(0.0, 0.0);
    let (heat, _) =
        met.features(&hit).properties_at(hit.surface_point()).find(|(of, _)| of.info.semantic == "HEAT").unwrap();
    assert_eq!(heat.info.max.as_f64(), Some(8.0));
    let read = read_with(gltf.text(), Vec::new(), &options()).unwrap();
    let noted = |kind: &str| read.ignored.count(kind);
    assert_eq!(noted("metadata: a property that is invalid"), 1, "{:?}", read.ignored);
    assert_eq!(
        noted("metadata: a property texture whose image, coordinates or channels are missing or invalid"),
        2,
        "{:?}",
        read.ignored
    );
    assert_eq!(noted("metadata: a property attribute that is missing or of another type"), 2, "{:?}", read.ignored);
    assert_eq!(noted("metadata: a property texture that the file lacks"), 1);
    assert_eq!(noted("metadata: a property attribute that the file lacks"), 1);
}

/// Images stay in memory only if they hold wanted data, once for all drawables, and are counted.
#[test]
fn images_of_ids_are_counted_once() {
    let set = json!({ "EXT_mesh_features": { "featureIds": [{ "featureCount": 1, "texture": { "index": 0 } }] } });
    let large = data_uri(&png_of(256, 256, |x, _| [x as u8, 0, 0, 255]));
    let kept = |nodes: usize, keep_features: bool| {
        let mut gltf = square();
        gltf.json["images"][0]["uri"] = large.clone().into();
        draw(&mut gltf, set.clone());
        for _ in 1..nodes {
            let mesh = gltf.json["meshes"][0].clone();
            let mesh = gltf.push("meshes", mesh);
            let node = gltf.push("nodes", json!({ "mesh": mesh }));
            gltf.json["scenes"][0]["nodes"].as_array_mut().unwrap().push(node.into());
        }
        let node = read_with(gltf.text(), Vec::new(), &ReadOptions { keep_features, ..options() }).unwrap().node;
        let mut page = Page::from_node(node).unwrap();
        page.take_drawables();
        page.size_bytes()
    };
    let image = 4 * 256 * 256;
    assert!(kept(1, false) < image / 4);
    let (one, three) = (kept(1, true), kept(3, true));
    assert!((image..image + 8000).contains(&one) && three < one + 4000, "{one} {three}");
    // An image that is damaged or too large leaves the mesh.
    let mut gltf = square();
    draw(&mut gltf, set.clone());
    gltf.json["materials"] = json!([{}]);
    gltf.json["images"][0]["uri"] = data_uri(b"\x89PNG but no image").into();
    let read = read_with(gltf.text(), Vec::new(), &options()).unwrap();
    assert_eq!(read.ignored.count("glTF: an image of ids or properties that cannot be read"), 1);
    assert!(read.mesh().1.features.is_none());
    // Images are not halved: a mean of two ids is another id.
    let mut gltf = square();
    draw(&mut gltf, set);
    gltf.json["images"][0]["uri"] = large.into();
    let limits = Limits { max_image_side_px: 64, ..Limits::default() };
    let met = Met::new(gltf.text(), &ReadOptions { limits, ..options() });
    assert_eq!(met.ids(2.0 * (200.5 / 256.0) - 1.0, 0.3), [(String::new(), 200)]);
}

/// Parts of a styled mesh keep their texels; the style itself ignores ids in textures, and says so.
#[test]
fn styled_meshes_keep_ids_in_textures() {
    let mut gltf = square();
    add_names(&mut gltf);
    let sets = json!([
        { "featureCount": 8, "texture": { "index": 0 } },
        { "featureCount": 4, "propertyTable": 0 },
    ]);
    draw(&mut gltf, json!({ "EXT_mesh_features": { "featureIds": sets } }));
    let style = Style::from_json("style.json", br#"{ "show": "${name} !== 'a'" }"#).unwrap();
    let options = ReadOptions { style: Some(std::sync::Arc::new(style)), ..options() };
    let read = read_with(gltf.text(), Vec::new(), &options).unwrap();
    assert_eq!(read.ignored.count("style: feature ids in textures"), 1);
    // The triangle that begins with the first vertex is hidden.
    let met = Met::new(gltf.text(), &options);
    for (x, y) in [(2, 0), (3, 0), (3, 1)] {
        assert_eq!(met.ids(inside(x, y)[0], inside(x, y)[1])[0].1, 4 * y + x);
    }
    assert!(met.hits(-0.5, -0.5).is_empty());
}

/// The id at a picked pixel is that of the texel that the pixel shows.
#[test]
fn picked_pixels_have_the_ids_of_the_texels_that_they_show() {
    let mut gltf = square();
    draw(
        &mut gltf,
        json!({ "EXT_mesh_features": { "featureIds": [{ "featureCount": 8, "texture": { "index": 0 } }] } }),
    );
    // Colours that tell the texels apart: the image of ids is drawn too.
    gltf.json["images"][0]["uri"] = data_uri(&png_of(4, 2, |x, y| [(20 + 25 * (4 * y + x)) as u8, 90, 0, 255])).into();
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("a.gltf"), gltf.text()).unwrap();
    let tileset = r#"{"asset":{"version":"1.0","gltfUpAxis":"Z"},"geometricError":9,"root":{"refine":"ADD","geometricError":0,
        "boundingVolume":{"box":[0,0,0,1,0,0,0,1,0,0,0,0.1]},"content":{"uri":"a.gltf"}}}"#;
    let file = folder.path().join("tileset.json");
    std::fs::write(&file, tileset).unwrap();
    let side = 64;
    let config = ViewerConfig {
        size_px: [side, side],
        adapter: AdapterChoice::Software,
        pager: PagerConfig { blocking: true, keep_features: true, build_kd_trees: true, ..PagerConfig::default() },
        ..ViewerConfig::default()
    };
    let Some(mut viewer) = offscreen(&config) else { return };
    viewer.load(file.to_str().unwrap()).unwrap();
    viewer.view_mut().environment = plain();
    viewer.view_mut().camera.world_from_eye = unit_camera(side).eye_from_world.inverse();
    viewer.settle(2);
    viewer.want_picture();
    viewer.frame().unwrap();
    viewer.finish().unwrap();
    let (_, picture) = viewer.take_pictures().pop().unwrap();
    let mut seen = [0; 8];
    for (x, y) in (0..side).flat_map(|y| (0..side).map(move |x| (x, y))) {
        let hits = viewer.compute_intersections(f64::from(x) + 0.5, f64::from(y) + 0.5, IntersectionLimit::Nearest);
        let Some(hit) = hits.first() else { continue };
        let page = viewer.scene().page(hit.node().unwrap().page).unwrap();
        let feature = page.features(hit.drawable).unwrap().at_point(hit.surface_point()).next().unwrap();
        let [red, _, _] = pixel(&picture, x, y);
        assert!(red.abs_diff(feature.id as u8) <= 1, "{x} {y}: {red} {}", feature.id);
        seen[usize::from((red - 19) / 25)] += 1;
    }
    assert!(seen.iter().all(|count| *count > 10), "{seen:?}");
}

/// A file that others wrote: a square with a property texture.
#[test]
fn the_sample_with_a_property_texture_has_values() {
    let file = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../shared/samples/3d-tiles/SimplePropertyTexture/SimplePropertyTexture.gltf");
    let Some(path) = file.to_str().filter(|_| file.exists()) else {
        return kit::skip::skipped(format!("no sample at {}", file.display()));
    };
    let uri = terrane::fetch::root_uri(path).unwrap();
    let options = ReadOptions { keep_features: true, ..ReadOptions::for_root(&uri, Limits::default()) };
    let read = |uri: &str| terrane::fetch::read_file(uri, &options.limits);
    let bytes = read(&uri).unwrap();
    let others = terrane::formats::dependencies(&uri, &bytes, None, &[], &options);
    let companions = others.into_iter().map(|other| (other.clone(), read(&other))).collect();
    let content = terrane::formats::Content { uri, bytes, reader_data: None, companions };
    let page = terrane::formats::decode(content, &options).unwrap();
    let at = SurfacePoint { vertices: [0, 1, 2], weights: [0.8, 0.1, 0.1] };
    let values = page.features(0).unwrap().properties_at(at).map(|(of, value)| format!("{}={value}", of.info.name));
    assert_eq!(
        values.collect::<Vec<_>>(),
        ["insideTemperature=19", "insulation=0.19607843137254902", "outsideTemperature=11"]
    );
    assert!(options.ignored.snapshot().is_empty(), "{:?}", options.ignored.snapshot());
}
