//! Gaussian splats of glTF: accessors and SPZ files, their drafts, and broken ones.

use glam::{Quat, Vec3};
use kit::splats::{
    SPZ_3_DEGREE_4, SPZ_4_DEGREE_1, SPZ_4_DEGREE_4, WrittenSplat, accessor_glb, from_hex, glb_with_harmonics, gzip,
    spz_glb, spz_header, spz_plain, spz_with_harmonics,
};
use serde_json::json;
use terrane::fetch::{IoError, Limits};
use terrane::formats::{ConvertOptions, ReadOptions, convert, inspect};
use terrane::scene::{AlphaMode, Geometry, Splat, SplatHarmonics, Splats};

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

/// The files are made of [`written`] and [`harmonics`].
#[test]
fn files_of_the_library_of_spz_are_read() {
    const DEGREE_4: &str = "glTF: harmonics of degree 4 of Gaussian splats";
    for (file, degree, ignored) in
        [(SPZ_4_DEGREE_1, 1, &[][..]), (SPZ_4_DEGREE_4, 3, &[DEGREE_4][..]), (SPZ_3_DEGREE_4, 3, &[DEGREE_4][..])]
    {
        let read = read(spz_glb(&from_hex(file)), Vec::new()).unwrap();
        assert_eq!(read.ignored.iter().map(|(kind, _)| kind).collect::<Vec<_>>(), ignored);
        is_near(splats(&read).list(), &written());
        have_harmonics(&splats(&read), &harmonics(degree), 1.0 / 128.0);
    }
}

#[test]
fn records_and_flags_of_spz_files_are_named() {
    let expected = ["glTF: antialiasing of Gaussian splats", "glTF: records of an SPZ file"];
    // In version 4 they stand before the table, in older versions at the end.
    let mut file = from_hex(SPZ_4_DEGREE_1);
    (file[14], file[16]) = (3, 40);
    file.splice(32..32, [9; 8]);
    let mut plain = spz_plain(&written(), 3, 0);
    plain[14] = 3;
    plain.extend([9; 8]);
    for file in [file, gzip(&plain)] {
        let read = read(spz_glb(&file), Vec::new()).unwrap();
        assert_eq!(read.ignored.iter().map(|(kind, _)| kind).collect::<Vec<_>>(), expected);
        is_near(splats(&read).list(), &written());
    }
}

#[test]
fn broken_streams_of_spz_are_errors_that_say_why() {
    let whole = from_hex(SPZ_4_DEGREE_1);
    let with = |at: usize, bytes: &[u8]| [&whole[..at], bytes, &whole[at + bytes.len()..]].concat();
    for (file, reason) in [
        (whole[..20].to_vec(), "ends within the values"),
        (whole[..100].to_vec(), "ends within the values"),
        (whole[..whole.len() - 1].to_vec(), "ends within the values"),
        (with(16, &[255; 4]), "ends within the values"),
        (with(32, &[255; 8]), "ends within the values"),
        (with(40, &[255; 8]), "stream 0 does not unpack to its 27 bytes"),
        (with(128, &[0; 4]), "stream 0: zstd"),
        (with(8, &[2]), "stream 0 does not unpack to its 18 bytes"),
    ] {
        let error = error(spz_glb(&file));
        assert!(error.contains(reason), "{error}");
    }
    // Sizes are checked before anything is unpacked.
    let huge = read(spz_glb(&with(8, &[255; 4])), Vec::new()).unwrap_err();
    assert!(matches!(huge, IoError::TooLarge { got: 4_294_967_295, .. }), "{huge}");
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
    // So are those with such harmonics; the others keep theirs.
    let mut harmonics = harmonics(1);
    harmonics[1][2][0] = f32::NAN;
    let read_some = read(glb_with_harmonics(&written(), &harmonics, "srgb_rec709_display"), Vec::new()).unwrap();
    assert_eq!(read_some.ignored.count("glTF: Gaussian splat with invalid values"), 1);
    let kept = splats(&read_some);
    harmonics.remove(1);
    have_harmonics(&kept, &harmonics, 0.003);
}

/// Returns coefficients of the three splats of [`written`].
fn harmonics(degree: u8) -> Vec<Vec<[f32; 3]>> {
    let count = SplatHarmonics::coefficients_of(degree);
    let value = |splat: usize, n: usize, k: usize| ((splat * 51 + n * 17 + k * 7) % 129) as f32 / 64.0 - 1.0;
    (0..3).map(|splat| (0..count).map(|n| [0, 1, 2].map(|k| value(splat, n, k))).collect()).collect()
}

/// Checks the coefficients of splats against those that were written.
fn have_harmonics(splats: &Splats, expected: &[Vec<[f32; 3]>], tolerance: f32) {
    assert_eq!(splats.list().len(), expected.len());
    for (number, expected) in expected.iter().enumerate() {
        let values: Vec<_> = splats.harmonics().values(number).skip(1).collect();
        assert_eq!(values.len(), expected.len());
        for (value, expected) in values.iter().flatten().zip(expected.iter().flatten()) {
            assert!(
                (value - expected).abs() <= 1.0 / 254.0 + tolerance,
                "splat {number}: {value}, expected {expected}"
            );
        }
    }
}

#[test]
fn harmonics_are_read_in_the_order_of_degrees() {
    for degree in 1..=3 {
        let expected = harmonics(degree);
        let by_accessors = read(glb_with_harmonics(&written(), &expected, "srgb_rec709_display"), Vec::new()).unwrap();
        assert!(by_accessors.ignored.is_empty(), "{:?}", by_accessors.ignored);
        have_harmonics(&splats(&by_accessors), &expected, 1e-6);
        is_near(splats(&by_accessors).list(), &written());
        for version in [2, 3] {
            let file = spz_with_harmonics(&written(), version, &expected);
            let of_file = read(spz_glb(&gzip(&file)), Vec::new()).unwrap();
            assert!(of_file.ignored.is_empty(), "{:?}", of_file.ignored);
            assert_eq!(splats(&of_file).harmonics().degree(), degree);
            have_harmonics(&splats(&of_file), &expected, 1.0 / 128.0);
            is_near(splats(&of_file).list(), &written());
        }
    }
    // A file of version 1.
    let mut file = spz_header(1, 1, 1, 12, 0);
    file.extend([0, 0, 0, 0, 0, 0, 255, 128, 128, 128, 160, 160, 160, 128, 128, 128]);
    file.extend([0, 128, 192, 128, 64, 128, 128, 128, 255]);
    let of_file = read(spz_glb(&gzip(&file)), Vec::new()).unwrap();
    have_harmonics(&splats(&of_file), &[vec![[-1.0, 0.0, 0.5], [0.0, -0.5, 0.0], [0.0, 0.0, 127.0 / 128.0]]], 1e-6);
    // The names of drafts.
    let mut draft = draft(&[1.0; 6]);
    for n in 0..3 {
        let values = draft.floats("VEC3", &[0.5, 0.25, n as f32, 0.0, 1.0, -1.0]);
        draft.json["meshes"][0]["primitives"][0]["attributes"][format!("_SH_DEGREE_1_COEF_{n}")] = values.into();
    }
    let values: Vec<_> = splats(&draft.read()).harmonics().values(1).collect();
    assert_eq!(values, [[0.0; 3], [0.0, 1.0, -1.0], [0.0, 1.0, -1.0], [0.0, 1.0, -1.0]]);
}

#[test]
fn colours_beyond_the_range_are_kept_for_harmonics() {
    let mut list = written();
    list[0].color = [1.5, -0.25, 0.5, 1.0];
    let read_all = |color_space| {
        let read = read(glb_with_harmonics(&list, &harmonics(2), color_space), Vec::new()).unwrap();
        splats(&read)
    };
    let displayed = read_all("srgb_rec709_display");
    assert!(!displayed.harmonics().is_linear());
    let linear = read_all("lin_rec709_display");
    assert!(linear.harmonics().is_linear());
    for splats in [&displayed, &linear] {
        let [r, g, b] = splats.harmonics().values(0).next().unwrap();
        assert!((r - 0.5).abs() < 0.005 && (g + 0.25).abs() < 0.005 && b == 0.0, "{r} {g} {b}");
    }
    assert_eq!((displayed.list()[0].color, linear.list()[0].color), ([255, 0, 128, 255], [255, 0, 188, 255]));
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
        (gzip(&with_header(spz_header(4, 3, 1, 12, 0))), "SPZ: version 4; versions 1 to 3 within gzip"),
        (with_header(spz_header(5, 3, 1, 12, 0)), "SPZ: version 5"),
        (gzip(&with_header(spz_header(3, 3, 9, 12, 0))), "harmonics of degree 9"),
        (gzip(&with_header(spz_header(3, 3, 1, 99, 0))), "99 fractional bits"),
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
    // Degrees are whole, and so are those below them.
    for (names, reason) in [
        (&["_SH_DEGREE_1_COEF_0", "_SH_DEGREE_1_COEF_2"][..], "without SH_DEGREE_1_COEF_1"),
        (&["_SH_DEGREE_2_COEF_4"][..], "without SH_DEGREE_1_COEF_0"),
    ] {
        let mut lacking = draft(&[1.0; 6]);
        let values = lacking.floats("VEC3", &[0.5; 6]);
        for name in names {
            lacking.json["meshes"][0]["primitives"][0]["attributes"][*name] = values.into();
        }
        let error = lacking.error();
        assert!(error.contains(reason), "{error}");
    }
    let mut short = draft(&[1.0; 6]);
    for (n, count) in [(0, 6), (1, 3), (2, 6)] {
        let values = short.floats("VEC3", &[0.5; 6][..count]);
        short.json["meshes"][0]["primitives"][0]["attributes"][format!("_SH_DEGREE_1_COEF_{n}")] = values.into();
    }
    let short = short.error();
    assert!(short.contains("SH_DEGREE_1_COEF_1 of Gaussian splats has the wrong type or count"), "{short}");
    let mut nowhere = draft(&[1.0; 6]);
    nowhere.json["meshes"][0]["primitives"][0]["extensions"]["KHR_gaussian_splatting"]["extensions"] =
        json!({ "KHR_gaussian_splatting_compression_spz_2": { "bufferView": 99 } });
    assert!(nowhere.error().contains("bufferView is missing or leads nowhere"));
}

#[test]
fn splats_are_described_and_kept_by_conversions() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("splats.glb");
    std::fs::write(&file, spz_glb(&gzip(&spz_plain(&written(), 2, 2)))).unwrap();
    let model = inspect(file.to_str().unwrap(), &Limits::default()).unwrap().model.unwrap();
    assert_eq!((model.splats, model.splat_harmonics, model.drawables), (3, 2, 1));
    // A triangle beside the splats.
    let mut mixed = draft(&[1.0; 6]);
    let triangle = mixed.floats("VEC3", &TRIANGLE);
    let primitives = mixed.json["meshes"][0]["primitives"].as_array_mut().unwrap();
    primitives.push(json!({ "attributes": { "POSITION": triangle } }));
    let file = folder.path().join("mixed.gltf");
    std::fs::write(&file, mixed.text()).unwrap();
    let out = folder.path().join("out");
    let converted = convert(file.to_str().unwrap(), &out, &ConvertOptions::default(), &mut |_| {}).unwrap();
    assert_eq!((converted.written.triangles, converted.written.splats), (1, 2));
    assert!(converted.left_out.is_empty(), "{:?}", converted.left_out);
    // Splats are read again as they were written, whatever the colour space, compressed or not.
    let mut list = written();
    list[0].color[1] = 1.5;
    for (color_space, degree, meshopt) in
        [("srgb_rec709_display", 0, false), ("srgb_rec709_display", 3, true), ("lin_rec709_display", 2, false)]
    {
        let file = folder.path().join(format!("{color_space}-{degree}.glb"));
        std::fs::write(&file, glb_with_harmonics(&list, &harmonics(degree), color_space)).unwrap();
        let out = folder.path().join(format!("of-{color_space}-{degree}"));
        let options = ConvertOptions { meshopt, ..ConvertOptions::default() };
        let converted = convert(file.to_str().unwrap(), &out, &options, &mut |_| {}).unwrap();
        assert_eq!((converted.source.splats, converted.written.splats), (3, 3));
        assert!(converted.errors.is_empty() && converted.left_out.is_empty(), "{converted:?}");
        let glb = std::fs::read_dir(&out).unwrap().map(|entry| entry.unwrap().path());
        let glb = glb.into_iter().find(|path| path.extension().is_some_and(|end| end == "glb")).unwrap();
        let [before, after] = [file, glb].map(|file| splats(&read(std::fs::read(file).unwrap(), Vec::new()).unwrap()));
        assert_eq!(before.list(), after.list());
        assert_eq!(
            (after.harmonics().degree(), after.harmonics().is_linear()),
            (degree, color_space.starts_with("lin"))
        );
        for number in 0..3 {
            for (a, b) in before.harmonics().values(number).zip(after.harmonics().values(number)) {
                assert!((0..3).all(|k| (a[k] - b[k]).abs() < 0.005), "{a:?} {b:?}");
            }
        }
    }
}
