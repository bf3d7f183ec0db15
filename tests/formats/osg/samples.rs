//! Files that OpenSceneGraph's own writers made, compared with what OSG itself reads from them.

use std::collections::BTreeSet;
use std::path::Path;

use glam::DVec3;
use serde_json::Value;
use terrane::fetch::Limits;
use terrane::formats::{Content, ReadOptions, decode, decode_node, decode_noting, dependencies, inspect, verify};
use terrane::scene::{Node, NodeKind, Page};

use super::read_part;

/// The contents of a file.
#[derive(Default)]
struct Found {
    paged: BTreeSet<String>,
    images: BTreeSet<(u32, u32)>,
    /// Corners of the box around everything.
    low: DVec3,
    high: DVec3,
}

impl Found {
    fn add(&mut self, node: &Node, above: glam::DAffine3) {
        let mut here = above;
        let file_name = |uri: &str| uri.rsplit('/').next().unwrap_or_default().to_owned();
        match &node.kind {
            NodeKind::Transform(map) => here = above * *map,
            NodeKind::Geode(drawables) => {
                for drawable in drawables {
                    let bounds = drawable.bounds().transformed(&above);
                    (self.low, self.high) = (self.low.min(bounds.min), self.high.max(bounds.max));
                    self.images.extend(drawable.material.texture.iter().map(|texture| (texture.width, texture.height)));
                }
            }
            NodeKind::PagedLod(tile) if tile.reader_data.as_ref().is_some_and(|data| data.is_whole_content()) => {
                self.add(&read_part(tile).unwrap(), above);
            }
            NodeKind::PagedLod(tile) => drop(self.paged.insert(file_name(tile.content.as_deref().unwrap()))),
            NodeKind::ProxyNode(proxy) => drop(self.paged.insert(file_name(&proxy.uri))),
            _ => {}
        }
        node.children.iter().for_each(|child| self.add(child, here));
    }
}

#[test]
fn files_of_osg_hold_what_osg_reads() {
    let samples = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/samples/osg");
    let Ok(expected) = std::fs::read_to_string(samples.join("expected.jsonl")) else {
        return kit::skip::skipped(format!("no files at {}", samples.display()));
    };
    let (mut count, mut ive) = (0, 0);
    for line in expected.lines() {
        let line: Value = serde_json::from_str(line).unwrap();
        let name = line["file"].as_str().unwrap();
        (count, ive) = (count + 1, ive + u32::from(name.ends_with(".ive")));
        let file = samples.join(name);
        let uri = file.to_str().unwrap();
        let bytes = std::fs::read(&file).unwrap();
        let options = ReadOptions::for_root(uri, Limits::default());
        let files = dependencies(uri, &bytes, None, &[], &options);
        let companions = files.into_iter().map(|file| (file.clone(), Ok(std::fs::read(&*file).unwrap()))).collect();
        let content = Content { uri: uri.into(), bytes, reader_data: None, companions };
        let page: Page = decode(content.clone(), &options).unwrap_or_else(|error| panic!("{error}"));
        let mut found = Found { low: DVec3::INFINITY, high: DVec3::NEG_INFINITY, ..Found::default() };
        found.add(&decode_node(content, &options).unwrap(), glam::DAffine3::IDENTITY);
        assert!(options.ignored.snapshot().is_empty(), "{name}: {:?}", options.ignored.snapshot());
        let info = inspect(uri, &Limits::default()).unwrap();
        let model = info.model.unwrap();
        assert_eq!(model.triangles, line["triangles"].as_u64().unwrap(), "{name}");
        let is_shape = !line["classes"]["ShapeDrawable"].is_null();
        if !is_shape {
            assert_eq!(model.vertices, line["vertices"].as_u64().unwrap(), "{name}");
        }
        let list = |key: &str| line[key].as_array().unwrap().clone();
        let paged: BTreeSet<String> = list("paged").iter().map(|file| file.as_str().unwrap().to_owned()).collect();
        assert_eq!(found.paged, paged, "{name}");
        let sizes: BTreeSet<(u32, u32)> =
            list("images").into_iter().map(|size| serde_json::from_value(size).unwrap()).collect();
        assert_eq!(found.images, sizes, "{name}");
        if model.triangles > 0 {
            // OSG printed positions of the earth with the precision of a float.
            let slack = if name.starts_with("states-far") { 0.3 } else { 2e-3 };
            for (corner, key) in [(found.low, "min"), (found.high, "max")] {
                let expected: [f64; 3] = serde_json::from_value(line[key].clone()).unwrap();
                assert!(
                    corner.distance(DVec3::from_array(expected)) < slack * 2.0,
                    "{name}: {corner} {key} {expected:?}"
                );
            }
            assert!(page.bounding_sphere().radius_m > 1.0, "{name}");
        }
    }
    assert!(count > 40, "{count} files");
    assert!(ive > 7, "{ive} files in .ive");
    let folder = samples.join("oblique");
    let verified = verify(folder.to_str().unwrap(), &Limits::default(), &mut |_| {}).unwrap();
    // The metadata, and one, four and sixteen files.
    assert_eq!((verified.contents, verified.failed), (22, 0), "{verified:?}");
}

/// Returns the nodes and notes of a file as text, without its name.
fn nodes_of(file: &Path) -> String {
    let uri = file.with_extension("osgb").to_str().unwrap().to_owned();
    let options = ReadOptions::for_root(&uri, Limits::default());
    let bytes = std::fs::read(file).unwrap();
    let images = dependencies(&uri, &bytes, None, &[], &options);
    let companions = images.into_iter().map(|image| (image.clone(), Ok(std::fs::read(&*image).unwrap()))).collect();
    let content = Content { uri: uri.into(), bytes, reader_data: None, companions };
    let (node, ignored) = decode_noting(content, &options).unwrap_or_else(|error| panic!("{error}"));
    format!("{node:#?}\n{ignored:#?}")
}

#[test]
fn files_in_ive_read_as_those_in_osgb() {
    let samples = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/samples/osg");
    if !samples.is_dir() {
        return kit::skip::skipped(format!("no files at {}", samples.display()));
    }
    // OSG wrote the shapes of states-far.ive as meshes, the image of external.ive as pixels, and no proxy.ive.
    for name in ["blend", "inline", "lod", "modes", "switch", "triangles"] {
        let [ive, osgb] = ["ive", "osgb"].map(|extension| nodes_of(&samples.join(name).with_extension(extension)));
        for (line, expected) in ive.lines().zip(osgb.lines()) {
            assert_eq!(line, expected, "{name}");
        }
        assert_eq!(ive.lines().count(), osgb.lines().count(), "{name}");
    }
}
