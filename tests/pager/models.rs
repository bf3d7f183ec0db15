//! Contents that refer to further files: an i3dm whose model has its buffer and its image beside it. No GPU.

use std::sync::Mutex;
use std::time::Duration;

use kit::compressed::uastc_ktx2;
use kit::pager::{Run, above};
use kit::server::{Reply, Server};
use terrane::fetch::Limits;
use terrane::formats::verify;
use terrane::pager::PagerConfig;
use terrane::scene::{BlockFormats, TexelFormat};

const TILESET: &str = r#"{"asset":{"version":"1.0"},"geometricError":9,"root":{"refine":"ADD","geometricError":0,
    "boundingVolume":{"sphere":[0,0,0,20]},"content":{"uri":"a/trees.i3dm"}}}"#;
pub(super) const MODEL: &str = r#"{"asset":{"version":"2.0"},"scenes":[{"nodes":[0]}],"nodes":[{"mesh":0}],
    "meshes":[{"primitives":[{"attributes":{"POSITION":0},"material":0}]}],
    "materials":[{"pbrMetallicRoughness":{"metallicFactor":0,"baseColorTexture":{"index":0}}}],
    "textures":[{"source":0}],"images":[{"uri":"bark.png"}],
    "accessors":[{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3","min":[0,0,0],"max":[1,1,0]}],
    "bufferViews":[{"buffer":0,"byteLength":36}],"buffers":[{"byteLength":36,"uri":"tree.bin"}]}"#;

fn floats(numbers: &[f32]) -> Vec<u8> {
    numbers.iter().flat_map(|x| x.to_le_bytes()).collect()
}

/// Returns an i3dm with three instances of a model in another file.
fn trees() -> Vec<u8> {
    trees_of("../models/tree.gltf")
}

/// Returns an i3dm with three instances of the model that a reference leads to.
pub(super) fn trees_of(model: &str) -> Vec<u8> {
    let table = br#"{"INSTANCES_LENGTH":3,"POSITION":{"byteOffset":0}}      "#;
    let positions = floats(&[0.0, 0.0, 0.0, 3.0, 0.0, 0.0, 0.0, 3.0, 0.0]);
    let mut bytes = b"i3dm".to_vec();
    let length = 32 + table.len() + positions.len() + model.len();
    for word in [1, length, table.len(), positions.len(), 0, 0, 0] {
        bytes.extend((word as u32).to_le_bytes());
    }
    [&bytes[..], table, &positions, model.as_bytes()].concat()
}

fn bark() -> Vec<u8> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    image::RgbImage::new(4, 4).write_to(&mut bytes, image::ImageFormat::Png).unwrap();
    bytes.into_inner()
}

#[test]
fn model_buffer_and_image_are_fetched_with_their_content() {
    for has_image in [true, false] {
        let server = Server::start(move |request| match request.path() {
            "/set/tileset.json" => Reply::ok(TILESET),
            "/set/a/trees.i3dm" => Reply::ok(trees()),
            "/set/models/tree.gltf" => Reply::ok(MODEL),
            "/set/models/tree.bin" => Reply::ok(floats(&[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, -1.0])),
            "/set/models/bark.png" if has_image => Reply::ok(bark()),
            _ => Reply::new(404, ""),
        });
        let source = format!("{}/set/tileset.json", server.url);
        let mut run = Run::new(&source, PagerConfig::default());
        run.settle(above(30.0));
        assert!(run.pager.errors().is_empty(), "{:?}", run.pager.errors());
        assert_eq!(run.stage.leaf_count(), 3);
        let ignored = run.pager.ignored();
        assert_eq!(ignored.count("glTF: external image that is missing"), u64::from(!has_image), "{ignored:?}");
        // Each file is requested once.
        assert_eq!(server.count(), 5, "{:?}", server.seen().iter().map(|r| r.path().to_owned()).collect::<Vec<_>>());
        let verified = verify(&source, &Limits::default(), &mut |_| {}).unwrap();
        assert_eq!((verified.contents, verified.failed), (1, 0), "{verified:?}");
    }
}

/// Regression: files of the model were not fetched.
#[test]
fn root_may_be_a_model_of_several_files() {
    let server = Server::start(move |request| match request.path() {
        "/set/a/trees.i3dm" => Reply::ok(trees()),
        "/set/models/tree.gltf" => Reply::ok(MODEL),
        "/set/models/tree.bin" => Reply::ok(floats(&[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, -1.0])),
        "/set/models/bark.png" => Reply::ok(bark()),
        _ => Reply::new(404, ""),
    });
    let mut run = Run::new(&format!("{}/set/a/trees.i3dm", server.url), PagerConfig::default());
    run.settle(above(30.0));
    assert_eq!((run.stage.leaf_count(), server.count()), (3, 4));
}

/// Regression: all files that a content refers to were requested at the same time.
#[test]
fn few_files_of_a_content_are_requested_at_once() {
    const IMAGES: usize = 40;
    let in_flight = std::sync::Arc::new(Mutex::new((0, 0)));
    let counted = in_flight.clone();
    let list = |item: &dyn Fn(usize) -> String| (0..IMAGES).map(item).collect::<Vec<_>>().join(",");
    let materials = list(&|i| format!(r#"{{"pbrMetallicRoughness":{{"baseColorTexture":{{"index":{i}}}}}}}"#));
    let primitives = list(&|i| format!(r#"{{"attributes":{{"POSITION":0}},"material":{i}}}"#));
    let (textures, images) = (list(&|i| format!(r#"{{"source":{i}}}"#)), list(&|i| format!(r#"{{"uri":"{i}.png"}}"#)));
    let model = format!(
        r#"{{"asset":{{"version":"2.0"}},"scenes":[{{"nodes":[0]}}],"nodes":[{{"mesh":0}}],
        "meshes":[{{"primitives":[{primitives}]}}],"materials":[{materials}],"textures":[{textures}],"images":[{images}],
        "accessors":[{{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3","min":[0,0,0],"max":[1,1,0]}}],
        "bufferViews":[{{"buffer":0,"byteLength":36}}],"buffers":[{{"byteLength":36,"uri":"tree.bin"}}]}}"#
    );
    let server = Server::start(move |request| match request.path() {
        "/set/tileset.json" => Reply::ok(TILESET.replace("a/trees.i3dm", "model.gltf")),
        "/set/model.gltf" => Reply::ok(model.clone()),
        "/set/tree.bin" => Reply::ok(floats(&[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, -1.0])),
        path if path.ends_with(".png") => {
            let mut count = counted.lock().unwrap();
            count.0 += 1;
            count.1 = count.1.max(count.0);
            drop(count);
            std::thread::sleep(Duration::from_millis(10));
            counted.lock().unwrap().0 -= 1;
            Reply::ok(bark())
        }
        _ => Reply::new(404, ""),
    });
    let mut run = Run::new(&format!("{}/set/tileset.json", server.url), PagerConfig::default());
    run.settle(above(30.0));
    assert!(run.pager.errors().is_empty(), "{:?}", run.pager.errors());
    assert_eq!((run.stage.leaf_count(), server.count()), (IMAGES, 3 + IMAGES));
    let most = in_flight.lock().unwrap().1;
    assert!((1..=8).contains(&most), "{most}");
}

/// Contents are decoded to formats that all contexts have, also those that were decoded before a context was added.
#[test]
fn images_get_the_formats_of_all_contexts() {
    let server = Server::start(move |request| match request.path() {
        "/set/tileset.json" => Reply::ok(TILESET.replace("a/trees.i3dm", "tree.gltf")),
        "/set/tree.gltf" => Reply::ok(MODEL),
        "/set/tree.bin" => Reply::ok(floats(&[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, -1.0])),
        "/set/bark.png" => Reply::ok(uastc_ktx2([1, 2, 3, 255], 3)),
        _ => Reply::new(404, ""),
    });
    let start = |block_formats| {
        let mut run = Run::new(&format!("{}/set/tileset.json", server.url), PagerConfig::default());
        run.context.block_formats = block_formats;
        run
    };
    let bc = BlockFormats { bc: true, ..BlockFormats::NONE };
    let astc = BlockFormats { astc: true, ..BlockFormats::NONE };
    for (formats, expected) in
        [(bc, TexelFormat::Bc7), (astc, TexelFormat::Astc4x4), (BlockFormats::NONE, TexelFormat::Rgba8)]
    {
        let mut run = start(formats);
        run.settle(above(30.0));
        assert_eq!(run.context.texture_formats, [expected], "{formats:?}");
    }
    // A context without the formats is added while the content is decoded.
    let mut run = start(bc);
    run.frame(above(30.0));
    run.frame(above(30.0));
    std::thread::sleep(Duration::from_millis(300));
    run.context.block_formats = astc;
    run.settle(above(30.0));
    assert_eq!(run.context.texture_formats, [TexelFormat::Astc4x4]);
    assert!(run.pager.errors().is_empty() && run.stage.leaf_count() == 1, "{:?}", run.pager.errors());
    // Another context is added later: everything is loaded again.
    run.context.block_formats = BlockFormats::NONE;
    run.pager.page_anew(&mut run.scene, &mut [&mut run.context]);
    run.settle(above(30.0));
    assert_eq!(run.context.texture_formats, [TexelFormat::Astc4x4, TexelFormat::Rgba8]);
}

#[test]
fn missing_model_is_one_error() {
    let server = Server::start(move |request| match request.path() {
        "/set/tileset.json" => Reply::ok(TILESET),
        "/set/a/trees.i3dm" => Reply::ok(trees()),
        _ => Reply::new(404, ""),
    });
    let mut run = Run::new(&format!("{}/set/tileset.json", server.url), PagerConfig::default());
    run.settle(above(30.0));
    let [error] = &run.pager.errors()[..] else { panic!("{:?}", run.pager.errors()) };
    assert!(error.reason.contains("not found"), "{error:?}");
}

/// Regression: each content requested the images that all of them share.
#[test]
fn shared_images_are_requested_once() {
    const TILES: usize = 100;
    let server = Server::start(move |request| match request.path() {
        "/set/tileset.json" => {
            let tile = |i: usize| {
                format!(
                    r#"{{"geometricError":0,"boundingVolume":{{"sphere":[0,0,0,20]}},"content":{{"uri":"{i}.gltf"}}}}"#
                )
            };
            let children = (0..TILES).map(tile).collect::<Vec<_>>().join(",");
            Reply::ok(format!(
                r#"{{"asset":{{"version":"1.1"}},"geometricError":99,"root":{{"refine":"ADD","geometricError":99,
                "boundingVolume":{{"sphere":[0,0,0,20]}},"children":[{children}]}}}}"#
            ))
        }
        "/set/tree.bin" => Reply::ok(floats(&[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, -1.0])),
        "/set/bark.png" => Reply::ok(bark()),
        "/set/moss.png" => Reply::ok(bark()),
        path if path.ends_with("5.gltf") => Reply::ok(MODEL.replace("bark.png", "moss.png")),
        path if path.ends_with(".gltf") => Reply::ok(MODEL),
        _ => Reply::new(404, ""),
    });
    let mut run = Run::new(&format!("{}/set/tileset.json", server.url), PagerConfig::default());
    run.settle(above(30.0));
    assert!(run.pager.errors().is_empty(), "{:?}", run.pager.errors());
    let files = ["tree.bin", "bark.png", "moss.png"].len();
    assert_eq!((run.stage.leaf_count(), server.count()), (TILES, 1 + TILES + files));
}

/// Each file of the content is within the limit of files, and all together are beyond that of a content.
#[test]
fn files_of_a_content_are_bounded_together() {
    // More than the megabyte that a load reserves before it.
    const FILE_BYTES: usize = 2 << 20;
    let files = || {
        let with_zeros = |mut bytes: Vec<u8>| {
            bytes.resize(FILE_BYTES, 0);
            bytes
        };
        let triangle = floats(&[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, -1.0]);
        [
            ("tileset.json", TILESET.replace("a/trees.i3dm", "tree.gltf").into_bytes()),
            ("tree.gltf", MODEL.into()),
            ("tree.bin", with_zeros(triangle)),
            ("bark.png", with_zeros(bark())),
        ]
    };
    let server = Server::start(move |request| {
        let name = request.path().rsplit('/').next().unwrap_or_default();
        let found = files().into_iter().find(|(file, _)| *file == name);
        found.map_or(Reply::new(404, ""), |(_, bytes)| Reply::ok(bytes))
    });
    let folder = tempfile::tempdir().unwrap();
    for (name, bytes) in files() {
        std::fs::write(folder.path().join(name), bytes).unwrap();
    }
    let sources =
        [format!("{}/set/tileset.json", server.url), folder.path().join("tileset.json").display().to_string()];
    for source in sources {
        for (max_content_bytes, fits) in [(FILE_BYTES as u64 * 3 / 2, false), (FILE_BYTES as u64 * 3, true)] {
            let limits = Limits { max_content_bytes, ..Limits::default() };
            let mut run = Run::new(&source, PagerConfig { limits, ..PagerConfig::default() });
            run.settle(above(30.0));
            assert_eq!(run.stage.leaf_count(), usize::from(fits), "{source}");
            let reasons: Vec<_> = run.pager.errors().iter().map(|error| error.reason.clone()).collect();
            let is_told = |reason: &std::sync::Arc<str>| reason.contains("the files of one content together");
            assert!(reasons.len() == usize::from(!fits) && reasons.iter().all(is_told), "{source}: {reasons:?}");
            // The image is the file beyond the limit.
            let verified = verify(&source, &limits, &mut |_| {}).unwrap();
            let is_missing = verified.ignored.keys().any(|kind| kind.contains("external image that is missing"));
            assert_eq!(is_missing, !fits, "{source}: {:?}", verified.ignored);
        }
    }
}
