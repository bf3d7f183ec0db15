//! An application reads its own format: roots, tiles below, and files that they refer to.

use std::sync::Arc;

use glam::DVec3;
use kit::shapes::quad;

use terrane::formats::{ContentReader, Fetched, ReadOptions};
use terrane::gpu::AdapterChoice;
use terrane::math::{BoundingSphere, BoundingVolume};
use terrane::pager::PagerConfig;
use terrane::scene::{Node, NodeKind, PagedLod, PagingOptions, RangeMode, Refine};
use terrane::viewer::{Viewer, ViewerConfig};

/// Reads lines: `quad FILE`, a square whose colour is in another file, and `tile FILE`, a tile below.
#[derive(Debug)]
struct Lines;

fn lines(bytes: &[u8]) -> impl Iterator<Item = (&str, &str)> {
    let text = std::str::from_utf8(bytes).unwrap_or_default();
    text.lines().skip(1).filter_map(|line| line.split_once(' '))
}

impl ContentReader for Lines {
    fn accepts(&self, _uri: &str, bytes: &[u8]) -> bool {
        bytes.starts_with(b"LINES\n")
    }

    fn references(&self, _uri: &str, bytes: &[u8]) -> Vec<String> {
        assert!(!bytes.ends_with(b"broken references\n"), "another error of the application");
        lines(bytes).filter(|(what, _)| *what == "quad").map(|(_, file)| file.to_owned()).collect()
    }

    fn read(&self, uri: &str, bytes: &[u8], files: &[Fetched], _options: &ReadOptions) -> Result<Node, String> {
        let folder = uri.rsplit_once('/').map_or("", |(folder, _)| folder);
        let node = |(what, file): (&str, &str)| {
            let path = format!("{folder}/{file}");
            match what {
                "quad" => {
                    let (_, found) = files.iter().find(|(uri, _)| **uri == *path).ok_or("a file was not fetched")?;
                    let bytes = found.as_ref().map_err(ToString::to_string)?;
                    let [r, g, b] = bytes[..] else { return Err(format!("{file} has {} bytes, not 3", bytes.len())) };
                    let color = [r, g, b, 255].map(|c| f32::from(c) / 255.0);
                    Ok(Node::geode(vec![quad([0.0; 3], [2.0; 2], color)]))
                }
                "tile" => {
                    let lod = PagedLod {
                        bounds: BoundingVolume::Sphere(BoundingSphere::new(DVec3::ZERO, 3.0)),
                        range_mode: RangeMode::Distance { center: DVec3::ZERO, range_m: 0.0 },
                        refine: Refine::Replace,
                        content: Some(Arc::from(path)),
                        content_transform: glam::DAffine3::IDENTITY,
                        reader_data: None,
                        paging: PagingOptions::default(),
                        request_volume: None,
                    };
                    Ok(Node::new(NodeKind::PagedLod(Box::new(lod))))
                }
                "panic" => panic!("an error of the application"),
                _ => Err(format!("unknown line {what}")),
            }
        };
        lines(bytes).map(node).collect::<Result<Vec<_>, _>>().map(Node::group)
    }
}

#[test]
fn own_formats_are_read_as_roots_and_tiles() {
    let folder = tempfile::tempdir().unwrap();
    let write = |file: &str, bytes: &[u8]| std::fs::write(folder.path().join(file), bytes).unwrap();
    write("root.lines", b"LINES\ntile good.lines\ntile bad.lines\ntile broken.lines\ntile unlisted.lines\n");
    write("good.lines", b"LINES\nquad color.bin\nquad color.bin\n");
    write("bad.lines", b"LINES\ncircle 1\n");
    write("broken.lines", b"LINES\npanic 1\n");
    write("unlisted.lines", b"LINES\nquad color.bin\nbroken references\n");
    write("color.bin", &[255, 0, 0]);
    let config = ViewerConfig {
        size_px: [64, 64],
        adapter: AdapterChoice::Noop,
        validation: false,
        pager: PagerConfig { content_readers: Arc::new([Arc::new(Lines)]), blocking: true, ..PagerConfig::default() },
        ..ViewerConfig::default()
    };
    let mut viewer = Viewer::new_offscreen(&config).unwrap();
    viewer.load(folder.path().join("root.lines").to_str().unwrap()).unwrap();
    viewer.view_mut().camera.look_at(DVec3::new(0.0, 0.0, 10.0), DVec3::ZERO, DVec3::Y);
    for frame in 0..4 {
        viewer.frame_at(f64::from(frame)).unwrap();
    }
    viewer.finish().unwrap();
    let pager = viewer.pager().unwrap();
    let stats = pager.stats();
    assert_eq!((stats.merged, stats.failed), (1, 3), "{stats:?}");
    assert_eq!(viewer.stats().last().unwrap().triangles, 4);
    let reasons: Vec<String> = pager.errors().iter().map(|error| error.reason.to_string()).collect();
    assert!(reasons.iter().any(|reason| reason.contains("unknown line circle")), "{reasons:?}");
    assert!(reasons.iter().any(|reason| reason.contains("panicked")), "{reasons:?}");
}
