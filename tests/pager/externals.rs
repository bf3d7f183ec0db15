//! The tile tree itself is paged: external tilesets leave memory like contents, and come back. No GPU.

use std::path::Path;
use std::time::Duration;

use glam::DVec3;
use kit::pager::Run;
use terrane::formats::writers::{GlbMesh, write_glb};
use terrane::pager::PagerConfig;
use terrane::scene::SlotState;

/// External tilesets along each side of the world, and tiles along each side of a tileset.
const SETS: usize = 8;
const TILES: usize = 8;
/// Side of a tile, metres.
const TILE_M: f64 = 64.0;

/// Writes a root with an external tileset for each square; each has a coarse tile and fine ones.
fn write_sets(folder: &Path, extension: &str) {
    let glb = write_glb(&GlbMesh {
        positions: vec![[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]],
        indices: vec![0, 1, 2],
        base_color: [1.0; 4],
        ..GlbMesh::default()
    });
    std::fs::write(folder.join("a.glb"), glb).unwrap();
    let volume = |x: f64, y: f64, side: f64| {
        let half = 0.5 * side;
        format!(r#""boundingVolume":{{"box":[{},{},0,{half},0,0,0,{half},0,0,0,1]}}"#, x + half, y + half)
    };
    let set = |root: String| format!(r#"{{"asset":{{"version":"1.1"}},"geometricError":4000,"root":{root}}}"#);
    let side = TILES as f64 * TILE_M;
    let mut children = Vec::new();
    for (i, j) in (0..SETS).flat_map(|i| (0..SETS).map(move |j| (i, j))) {
        let (x, y) = (i as f64 * side, j as f64 * side);
        let name = format!("{i}_{j}{extension}");
        children.push(format!(r#"{{{},"geometricError":100,"content":{{"uri":"{name}"}}}}"#, volume(x, y, side)));
        let tile = |k: usize| {
            let (x, y) = (x + (k % TILES) as f64 * TILE_M, y + (k / TILES) as f64 * TILE_M);
            format!(r#"{{{},"geometricError":0,"content":{{"uri":"a.glb"}}}}"#, volume(x, y, TILE_M))
        };
        let tiles: Vec<String> = (0..TILES * TILES).map(tile).collect();
        let root = format!(
            r#"{{{},"geometricError":8,"refine":"REPLACE","content":{{"uri":"a.glb"}},"children":[{}]}}"#,
            volume(x, y, side),
            tiles.join(",")
        );
        std::fs::write(folder.join(name), set(root)).unwrap();
    }
    let root = format!(
        r#"{{{},"geometricError":1000,"refine":"ADD","children":[{}]}}"#,
        volume(0.0, 0.0, SETS as f64 * side),
        children.join(",")
    );
    std::fs::write(folder.join("tileset.json"), set(root)).unwrap();
}

/// External tilesets that are resident, and known tiles.
fn tree(run: &Run) -> (usize, usize) {
    let is_set = |uri: &str| !uri.ends_with(".glb");
    let resident = run.scene.tiles().filter_map(|tile| run.scene.slot(tile.node));
    let sets = resident.filter(|slot| is_set(slot.uri) && matches!(slot.state, SlotState::Resident(_))).count();
    (sets, run.scene.tiles().count())
}

/// A tree of 4,096 tiles whose sets do not fit together, flown over twice: it stays within the budget.
#[test]
fn external_tilesets_expire_with_the_budget() {
    for extension in [".json", ".v1"] {
        let folder = tempfile::tempdir().unwrap();
        write_sets(folder.path(), extension);
        let source = folder.path().to_str().unwrap();
        // The memory of the whole tree.
        let mut whole = Run::new(source, PagerConfig::default());
        whole.max_sse_px = 1e-3;
        let center = 0.5 * (SETS * TILES) as f64 * TILE_M;
        whole.settle(DVec3::new(center, center, 10_000.0));
        let (sets, tiles) = tree(&whole);
        assert_eq!(sets, SETS * SETS);
        let all_bytes = whole.pager.stats().cpu_bytes;
        let budget = all_bytes / 6;
        let config = PagerConfig { max_bytes_cpu: budget, expiry_time: Duration::ZERO, ..PagerConfig::default() };
        let mut run = Run::new(source, config);
        for step in 0..20 {
            let along = f64::from(step) / 20.0 * 2.0 * center;
            run.settle(DVec3::new(along, center, 150.0));
            assert!(run.pager.stats().cpu_bytes <= budget, "{:?}", run.pager.stats());
        }
        assert!(run.pager.errors().is_empty(), "{:?}", run.pager.errors());
        let (left, known) = tree(&run);
        assert!(left < sets / 2 && known < tiles / 2, "{left} of {sets} sets, {known} of {tiles} tiles");
        assert!(run.pager.stats().expired > 0, "{:?}", run.pager.stats());
    }
}

/// Tilesets that refer to each other: one error, and the rest is drawn.
#[test]
fn cycles_of_tilesets_end_in_one_error() {
    for names in [["tileset.json", "other.json"], ["tileset.json", "other"]] {
        let folder = tempfile::tempdir().unwrap();
        let tile = r#""boundingVolume":{"sphere":[0,0,0,50]},"geometricError":100"#;
        for (name, below) in [(names[0], names[1]), (names[1], names[0])] {
            let json = format!(
                r#"{{"asset":{{"version":"1.1"}},"geometricError":100,"root":{{{tile},"refine":"ADD","children":[
                {{{tile},"content":{{"uri":"a.glb"}}}},{{{tile},"content":{{"uri":"{below}"}}}}]}}}}"#
            );
            std::fs::write(folder.path().join(name), json).unwrap();
        }
        let glb = GlbMesh {
            positions: vec![[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]],
            indices: vec![0, 1, 2],
            base_color: [1.0; 4],
            ..GlbMesh::default()
        };
        std::fs::write(folder.path().join("a.glb"), write_glb(&glb)).unwrap();
        let mut run = Run::new(folder.path().to_str().unwrap(), PagerConfig::default());
        run.settle(DVec3::new(0.0, 0.0, 100.0));
        let errors = run.pager.errors();
        assert!(errors.len() == 1 && errors[0].reason.contains("contains itself"), "{errors:?}");
        assert_eq!(run.stage.leaf_count(), 2, "the content of each tileset");
    }
}
