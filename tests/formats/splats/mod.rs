//! Gaussian splats of glTF: accessors and SPZ files, their drafts, and broken ones.

use glam::{Quat, Vec3};
use kit::splats::{WrittenSplat, accessor_glb, gzip, spz_glb, spz_header, spz_plain};
use serde_json::json;
use terrane::fetch::{IoError, Limits};
use terrane::formats::{ConvertOptions, ReadOptions, convert, inspect};
use terrane::scene::{AlphaMode, Geometry, Splat, Splats};

use crate::gltf_builder::{GltfBuilder, Read, SHORT, TRIANGLE, read, read_with};

fn written() -> Vec<WrittenSplat> {
    let rotation = |x, y, z, angle: f32| Quat::from_axis_angle(Vec3::new(x, y, z).normalize(), angle).to_array();
    vec![
        WrittenSplat {
            position: [1.5, -2.25, 3.125],
            scale: [0.5, 0.25, 0.125],
            rotation: [0.0, 0.0, 0.0, 1.0],
            color: [0.25, 0.5, 0.75, 0.5],
        },
        WrittenSplat {
            position: [-100.0, 0.0, 0.5],
            scale: [0.01, 2.0, 0.01],
            rotation: rotation(1.0, 2.0, -0.5, 2.5),
            color: [1.0, 0.0, 0.0, 1.0],
        },
        WrittenSplat {
            position: [0.0, 7.0, 0.0],
            scale: [1.0, 1.0, 3.0],
            rotation: rotation(-1.0, 0.1, 0.3, -1.5),
            color: [0.0, 1.0, 0.5, 0.1],
        },
    ]
}

/// Returns the only splats of a content.
fn splats(read: &Read) -> Splats {
    let drawables = read.node_drawables();
    let [drawable] = &drawables[..] else { panic!("{} drawables", drawables.len()) };
    assert_eq!(drawable.material.alpha, AlphaMode::Blend);
    let Geometry::Splats(splats) = &drawable.geometry else { panic!("splats") };
    Splats::clone(splats)
}

fn error(bytes: Vec<u8>) -> String {
    let error = read(bytes, Vec::new()).unwrap_err();
    assert!(!error.uri().is_empty());
    error.to_string()
}

/// Checks splats against those that were written, within the steps of SPZ.
fn is_near(read: &[Splat], expected: &[WrittenSplat]) {
    assert_eq!(read.len(), expected.len());
    for (splat, expected) in read.iter().zip(expected) {
        assert!(Vec3::from(splat.position).distance(expected.position.into()) < 1e-3, "{splat:?}");
        assert!(splat.scale.iter().zip(expected.scale).all(|(a, b)| (a / b).ln().abs() < 0.04), "{splat:?}");
        let rotation = Quat::from_array(splat.rotation.map(|q| f32::from(q) / 32767.0));
        let apart = rotation.normalize().angle_between(Quat::from_array(expected.rotation));
        assert!(apart < 0.05, "{apart} rad: {splat:?}");
        for (got, wanted) in splat.color.iter().zip(expected.color) {
            assert!((f32::from(*got) / 255.0 - wanted).abs() < 0.006, "{splat:?} {expected:?}");
        }
    }
}

#[test]
fn accessors_and_spz_files_hold_the_same_splats() {
    let expected = written();
    let read_all = |bytes: Vec<u8>| read(bytes, Vec::new()).unwrap();
    let by_accessors = read_all(accessor_glb(&expected));
    assert!(by_accessors.ignored.is_empty(), "{:?}", by_accessors.ignored);
    let by_accessors = splats(&by_accessors);
    is_near(by_accessors.list(), &expected);
    assert_eq!(by_accessors.list()[0].scale, [0.5, 0.25, 0.125]);
    for version in [2, 3] {
        let of_file = read_all(spz_glb(&gzip(&spz_plain(&expected, version, 0))));
        assert!(of_file.ignored.is_empty(), "{:?}", of_file.ignored);
        is_near(splats(&of_file).list(), &expected);
    }
    // Three standard deviations of the largest axis.
    let bounds = by_accessors.bounds();
    assert!((bounds.min.x - -106.0).abs() < 1e-3 && (bounds.max.z - 9.0).abs() < 1e-3, "{bounds:?}");
}

#[test]
fn version_1_of_spz_has_half_floats() {
    let mut file = spz_header(1, 1, 0, 12, 0);
    // 1.5, -2 and 0.25; opaque, grey, e^0, no rotation.
    file.extend([0x00, 0x3e, 0x00, 0xc0, 0x00, 0x34, 255, 128, 128, 128, 160, 160, 160, 128, 128, 128]);
    let read = read(spz_glb(&gzip(&file)), Vec::new()).unwrap();
    let splats = splats(&read);
    assert_eq!((splats.list()[0].position, splats.list()[0].scale), ([1.5, -2.0, 0.25], [1.0; 3]));
}

/// Returns a glTF of two splats as drafts of the extension have them; `scale` are the scales of both.
fn draft(scale: &[f32]) -> GltfBuilder {
    let mut builder = GltfBuilder::new();
    let position = builder.floats("VEC3", &[0.0, 0.0, 0.0, 1.0, 2.0, 3.0]);
    let quarter = (32767.0 * std::f32::consts::FRAC_1_SQRT_2) as i16;
    let rotation: Vec<u8> =
        [0, 0, 0, 32767, 0, 0, quarter, quarter].iter().flat_map(|q: &i16| q.to_le_bytes()).collect();
    let rotation = builder.accessor(SHORT, "VEC4", 2, &rotation);
    builder.json["accessors"][rotation]["normalized"] = true.into();
    let scale = builder.floats("VEC3", scale);
    let color = builder.floats("VEC4", &[1.0, 0.5, 0.0, 0.25, 0.0, 0.0, 1.0, 1.0]);
    builder.draw(json!({
        "attributes": { "POSITION": position, "_ROTATION": rotation, "_SCALE": scale, "COLOR_0": color },
        "mode": 0,
        "extensions": { "KHR_gaussian_splatting": { "colorSpace": "srgb_rec709_display" } },
    }));
    builder
}

#[test]
fn drafts_have_other_names_and_logarithms() {
    let lengths = splats(&draft(&[0.5, 1.0, 2.0, 0.5, 1.0, 2.0]).read());
    assert_eq!((lengths.list()[0].scale, lengths.list()[0].color), ([0.5, 1.0, 2.0], [255, 128, 0, 64]));
    assert!((i32::from(lengths.list()[1].rotation[2]) - 23170).abs() < 3, "{:?}", lengths.list()[1]);
    // A negative scale can be no length.
    let logarithms = splats(&draft(&[0.0, 0.0, 0.0, -1.0, 0.0, 1.0]).read());
    assert_eq!(logarithms.list()[0].scale, [1.0; 3]);
    let [a, b, c] = logarithms.list()[1].scale;
    assert!((a - 0.36788).abs() < 1e-4 && b == 1.0 && (c.ln() - 1.0).abs() < 1e-4);
    // Linear colours are stored as displayed.
    let mut linear = draft(&[1.0; 6]);
    linear.json["meshes"][0]["primitives"][0]["extensions"]["KHR_gaussian_splatting"]["colorSpace"] =
        "lin_rec709_display".into();
    assert_eq!(splats(&linear.read()).list()[0].color, [255, 188, 0, 64]);
    // SPZ below the name and at the place that it had first.
    let file = gzip(&spz_plain(&written(), 2, 0));
    let mut old = GltfBuilder::new();
    let view = old.view(&file, None);
    old.json["extensionsRequired"] = json!(["KHR_spz_gaussian_splats_compression"]);
    old.draw(json!({
        "attributes": {}, "mode": 0,
        "extensions": { "KHR_spz_gaussian_splats_compression": { "bufferView": view } },
    }));
    assert_eq!(splats(&old.read()).list().len(), 3);
}

#[test]
fn splats_without_finite_values_are_dropped_and_counted() {
    let mut list = written();
    list[0].scale[1] = f32::INFINITY;
    list[1].position[2] = f32::NAN;
    list.push(WrittenSplat { rotation: [0.0; 4], ..written()[0] });
    let read_some = read(accessor_glb(&list), Vec::new()).unwrap();
    assert_eq!(splats(&read_some).list().len(), 1);
    assert_eq!(read_some.ignored.count("glTF: Gaussian splat with invalid values"), 3);
    let none = error(accessor_glb(&list[..2]));
    assert!(none.contains("no Gaussian splat has finite values"), "{none}");
    // Higher harmonics are skipped and named.
    for degree in 1..=3 {
        let read = read(spz_glb(&gzip(&spz_plain(&written(), 3, degree))), Vec::new()).unwrap();
        assert_eq!((splats(&read).list().len(), splats(&read).harmonics()), (3, degree));
        assert_eq!(read.ignored.count("glTF: spherical harmonics of Gaussian splats above degree 0"), 1);
    }
}

#[test]
fn broken_splats_are_errors_that_say_why() {
    let plain = spz_plain(&written(), 3, 1);
    let with_header = |header: Vec<u8>| [header, plain[16..].to_vec()].concat();
    let cut = |bytes: &[u8]| bytes[..bytes.len() - 30].to_vec();
    for (file, reason) in [
        (gzip(&cut(&plain)), "ends within the values of 3 splats"),
        (cut(&gzip(&plain)), "SPZ: "),
        (gzip(&plain[..9]), "SPZ: "),
        (plain.clone(), "SPZ: version 3"),
        (gzip(&with_header(spz_header(4, 3, 1, 12, 0))), "SPZ: version 4; versions 1 to 3 are read"),
        (gzip(&with_header(spz_header(3, 3, 9, 12, 0))), "harmonics of degree 9"),
        (gzip(&with_header(spz_header(3, 3, 1, 99, 0))), "99 fractional bits"),
        (gzip(&with_header(spz_header(3, 3, 1, 12, 2))), "records after the header"),
        (gzip(b"SPZ? Not at all, it is text"), "magic"),
    ] {
        let error = error(spz_glb(&file));
        assert!(error.contains(reason), "{error}");
    }
    // Sizes are checked before anything is unpacked.
    let huge = spz_glb(&gzip(&with_header(spz_header(3, u32::MAX, 3, 12, 0))));
    let huge = read(huge, Vec::new()).unwrap_err();
    assert!(matches!(huge, IoError::TooLarge { got: 4_294_967_295, .. }), "{huge}");
    let small = Limits { max_file_bytes: 50, ..Limits::default() };
    let options = ReadOptions::for_root("/set/tileset.json", small);
    let large = read_with(spz_glb(&gzip(&plain)), Vec::new(), &options).unwrap_err();
    assert!(matches!(large, IoError::TooLarge { .. }), "{large}");
    // Accessors of the wrong count, and without what a splat needs.
    let wrong = draft(&[1.0; 9]).error();
    assert!(wrong.contains("SCALE of Gaussian splats has the wrong type or count"), "{wrong}");
    for (name, reason) in
        [("_SCALE", "without SCALE"), ("COLOR_0", "without colours"), ("POSITION", "without POSITION")]
    {
        let mut lacking = draft(&[1.0; 6]);
        lacking.json["meshes"][0]["primitives"][0]["attributes"].as_object_mut().unwrap().remove(name);
        let error = lacking.error();
        assert!(error.contains(reason), "{error}");
    }
    let mut nowhere = draft(&[1.0; 6]);
    nowhere.json["meshes"][0]["primitives"][0]["extensions"]["KHR_gaussian_splatting"]["extensions"] =
        json!({ "KHR_gaussian_splatting_compression_spz_2": { "bufferView": 99 } });
    assert!(nowhere.error().contains("bufferView is missing or leads nowhere"));
}

#[test]
fn splats_are_described_and_left_out_of_conversions_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("splats.glb");
    std::fs::write(&file, spz_glb(&gzip(&spz_plain(&written(), 2, 2)))).unwrap();
    let model = inspect(file.to_str().unwrap(), &Limits::default()).unwrap().model.unwrap();
    assert_eq!((model.splats, model.splat_harmonics, model.drawables), (3, 2, 1));
    // A triangle beside the splats is kept.
    let mut mixed = draft(&[1.0; 6]);
    let triangle = mixed.floats("VEC3", &TRIANGLE);
    let primitives = mixed.json["meshes"][0]["primitives"].as_array_mut().unwrap();
    primitives.push(json!({ "attributes": { "POSITION": triangle } }));
    let file = folder.path().join("mixed.gltf");
    std::fs::write(&file, mixed.text()).unwrap();
    let out = folder.path().join("out");
    let converted = convert(file.to_str().unwrap(), &out, &ConvertOptions::default(), &mut |_| {}).unwrap();
    assert_eq!((converted.written.triangles, converted.left_out.get("Gaussian splats")), (1, Some(&1)));
}
