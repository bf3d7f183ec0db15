//! Textures of state sets in the budget of the GPU.

use std::path::Path;
use std::sync::Arc;

use kit::pager::{PAGE_GPU_BYTES, Run, above};
use kit::shapes::quad;
use terrane::formats::{ContentReader, Fetched, ReadOptions};
use terrane::pager::PagerConfig;
use terrane::scene::Node;
use terrane::state::{Attribute, Sampler, StateSet, TextureBinding, TextureObject};

const TILES: usize = 12;
const SIDE: u32 = 64;
const TEXTURE_BYTES: u64 = (SIDE * SIDE * 4) as u64;

/// Reads a tile as a square with a texture in its state set: one of its own, or that of all tiles.
#[derive(Debug)]
struct Textured {
    shared: Option<Arc<TextureObject>>,
}

fn texture() -> Arc<TextureObject> {
    TextureObject::image("ground", [SIDE, SIDE], vec![7; TEXTURE_BYTES as usize])
}

impl ContentReader for Textured {
    fn accepts(&self, _uri: &str, bytes: &[u8]) -> bool {
        bytes == b"TEXTURED"
    }

    fn read(&self, _uri: &str, _bytes: &[u8], _files: &[Fetched], _options: &ReadOptions) -> Result<Node, String> {
        let texture = self.shared.clone().unwrap_or_else(texture);
        let binding = TextureBinding { texture, sampler: Sampler::default() };
        let set = StateSet::default().with(Attribute::Texture(0, binding));
        Ok(Node::geode(vec![quad([0.0; 3], [1.0; 2], [1.0; 4])]).with_state_set(Arc::new(set)))
    }
}

/// Writes tiles that are all visible, each without children.
fn write_set(folder: &Path) {
    let volume = r#""boundingVolume": {"sphere": [0, 0, 0, 2]}"#;
    let tiles = (0..TILES).map(|tile| {
        std::fs::write(folder.join(format!("{tile}.textured")), "TEXTURED").unwrap();
        format!(r#"{{{volume}, "geometricError": 0, "content": {{"uri": "{tile}.textured"}}}}"#)
    });
    let children = tiles.collect::<Vec<_>>().join(",");
    let root = format!(r#"{{{volume}, "geometricError": 1000, "refine": "ADD", "children": [{children}]}}"#);
    let tileset = format!(r#"{{"asset": {{"version": "1.1"}}, "geometricError": 1000, "root": {root}}}"#);
    std::fs::write(folder.join("tileset.json"), tileset).unwrap();
}

/// Regression: pages that are all visible exceeded the budget by the textures of their state sets.
#[test]
fn textures_of_state_sets_count_with_their_pages_and_once() {
    let folder = tempfile::tempdir().unwrap();
    write_set(folder.path());
    for (shared, pages) in [(None, 4), (Some(texture()), TILES as u64)] {
        let config = PagerConfig {
            max_bytes_gpu: 4 * TEXTURE_BYTES + TILES as u64 * PAGE_GPU_BYTES,
            content_readers: Arc::new([Arc::new(Textured { shared: shared.clone() })]),
            sharing: terrane::scene::ShareModes::NONE,
            ..PagerConfig::default()
        };
        let max_bytes = config.max_bytes_gpu;
        let mut run = Run::new(folder.path().to_str().unwrap(), config);
        for _ in 0..60 {
            run.frame(above(5.0));
            run.work_until_idle();
            let stats = run.pager.stats();
            assert!(stats.gpu_bytes <= max_bytes, "{stats:?}");
        }
        let stats = run.pager.stats();
        assert_eq!((stats.resident, stats.failed, stats.expired), (pages, 0, 0), "{stats:?}");
        let textures = if shared.is_some() { 1 } else { pages };
        assert_eq!(stats.gpu_bytes, pages * PAGE_GPU_BYTES + textures * TEXTURE_BYTES, "{stats:?}");
    }
}
