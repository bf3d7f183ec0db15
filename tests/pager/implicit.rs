//! Implicit tiling through the pager: subtrees are pages that are loaded, refined and expired like others. No GPU.

use std::time::Duration;

use kit::pager::{Run, above};
use kit::server::{Reply, Server};
use kit::subtrees::{Scheme, Subtree};
use kit::tile_sets::{WORLD_M, write_implicit};
use terrane::pager::PagerConfig;
use terrane::scene::{ReaderData, SlotState};

/// Contents that are resident, and pages of tiles.
fn resident(run: &Run) -> (Vec<String>, usize) {
    let (mut contents, mut pages) = (Vec::new(), 0);
    for tile in run.scene.tiles() {
        let Some(slot) = run.scene.slot(tile.node).filter(|slot| matches!(slot.state, SlotState::Resident(_))) else {
            continue;
        };
        if slot.reader_data.is_some_and(ReaderData::continues_tileset) {
            pages += 1;
        } else {
            contents.push(slot.uri.rsplit('/').next().unwrap().to_owned());
        }
    }
    contents.sort_unstable();
    (contents, pages)
}

/// A page of subtrees is neither a content nor a reason to wait, wherever the tree is cut.
#[test]
fn implicit_trees_settle_on_the_same_tiles_however_they_are_cut() {
    let mut settled = Vec::new();
    for (levels, subtrees) in [(6, 1), (3, 2), (2, 3), (1, 6)] {
        let folder = tempfile::tempdir().unwrap();
        write_implicit(folder.path(), levels, subtrees);
        let mut run = Run::new(folder.path().to_str().unwrap(), PagerConfig::default());
        run.settle(above(40.0));
        assert!(run.pager.errors().is_empty(), "{:?}", run.pager.errors());
        let (contents, pages) = resident(&run);
        assert!(contents.iter().any(|name| name.starts_with("5_")), "the finest level is seen: {contents:?}");
        assert!(pages >= subtrees as usize, "{pages} pages");
        let drawn = run.stage.leaf_count();
        settled.push((contents, drawn));
    }
    for (contents, drawn) in &settled[1..] {
        assert_eq!((contents, drawn), (&settled[0].0, &settled[0].1));
    }
}

/// The tree counts against the budgets, and leaves memory with its tiles.
#[test]
fn subtrees_that_are_not_looked_at_expire() {
    let folder = tempfile::tempdir().unwrap();
    write_implicit(folder.path(), 2, 3);
    let config = PagerConfig { expiry_time: Duration::ZERO, max_tiles: 60, ..PagerConfig::default() };
    let mut run = Run::new(folder.path().to_str().unwrap(), config);
    let corners = [(100.0, 100.0), (4000.0, 4000.0), (100.0, 4000.0), (4000.0, 100.0)];
    let mut pages = Vec::new();
    for _ in 0..3 {
        for (x, y) in corners {
            let eye = glam::DVec3::new(x, y, 20.0);
            run.settle(eye);
            for _ in 0..40 {
                run.frame(eye);
            }
            assert!(run.pager.stats().resident <= 60, "{:?}", run.pager.stats());
            pages.push(resident(&run).1);
        }
    }
    assert!(run.pager.errors().is_empty(), "{:?}", run.pager.errors());
    assert!(run.pager.stats().expired > 50, "{:?}", run.pager.stats());
    let most = pages.iter().max().unwrap();
    // 1 + 16 + 256 subtrees are in the files.
    assert!(*most < 100, "pages of tiles: {pages:?}");
}

/// A subtree that is missing or damaged fails alone: the tile above stays.
#[test]
fn missing_subtrees_keep_the_tile_above() {
    for damage in [None, Some(&b"rubbish"[..])] {
        let folder = tempfile::tempdir().unwrap();
        write_implicit(folder.path(), 2, 3);
        let file = folder.path().join("2.0.0.subtree");
        match damage {
            None => std::fs::remove_file(&file).unwrap(),
            Some(bytes) => std::fs::write(&file, bytes).unwrap(),
        }
        let mut run = Run::new(folder.path().to_str().unwrap(), PagerConfig::default());
        let eye = glam::DVec3::new(600.0, 600.0, 20.0);
        run.until(eye, "does not fail", |run| run.pager.stats().failed > 0 && run.pager.is_idle());
        run.settle(eye);
        let errors = run.pager.errors();
        assert!(errors.len() == 1 && errors[0].uri.ends_with("2.0.0.subtree"), "{errors:?}");
        let (contents, _) = resident(&run);
        assert!(contents.contains(&"1_0_0.glb".to_owned()), "{contents:?}");
    }
}

/// The tree below a subtree is no nested tileset: many small subtrees are no cycle.
#[test]
fn many_levels_of_subtrees_are_no_nested_tilesets() {
    let folder = tempfile::tempdir().unwrap();
    let half = WORLD_M / 2.0;
    let json = format!(
        r#"{{"asset":{{"version":"1.1"}},"geometricError":1000,"root":{{
        "boundingVolume":{{"box":[{half},{half},0,{half},0,0,0,{half},0,0,0,1]}},"geometricError":1e9,"refine":"ADD",
        "content":{{"uri":"none.glb"}},"implicitTiling":{{"subdivisionScheme":"QUADTREE",
        "subtreeLevels":1,"availableLevels":32,"subtrees":{{"uri":"one.subtree"}}}}}}}}"#
    );
    std::fs::write(folder.path().join("tileset.json"), json).unwrap();
    // Each subtree has one child, the south-western.
    let mut subtree = Subtree::new(Scheme::Quadtree, 1, 0);
    subtree.fill();
    subtree.add_child([0; 3]);
    std::fs::write(folder.path().join("one.subtree"), subtree.binary()).unwrap();
    let mut run = Run::new(folder.path().to_str().unwrap(), PagerConfig::default());
    run.settle(above(10.0));
    assert!(run.pager.errors().is_empty(), "{:?}", run.pager.errors());
    assert_eq!(resident(&run).1, 32);
}

/// A subtree holds up everything in it: with one request at a time it comes before the contents beside it.
#[cfg(feature = "http")]
#[test]
fn subtrees_are_requested_before_the_contents_beside_them() {
    let folder = tempfile::tempdir().unwrap();
    write_implicit(folder.path(), 2, 2);
    let files = folder.path().to_owned();
    let server =
        Server::start(move |request| match std::fs::read(files.join(request.path().trim_start_matches('/'))) {
            Ok(bytes) => Reply::ok(bytes),
            Err(_) => Reply::new(404, ""),
        });
    let config = PagerConfig { http_in_flight: 1, http_in_flight_max: 1, ..PagerConfig::default() };
    let mut run = Run::new(&format!("{}/tileset.json", server.url), config);
    run.settle(above(40.0));
    assert!(run.pager.errors().is_empty(), "{:?}", run.pager.errors());
    let paths: Vec<String> = server.seen().iter().map(|request| request.path().to_owned()).collect();
    let position =
        |name: &str| paths.iter().position(|path| path == name).unwrap_or_else(|| panic!("{name}: {paths:?}"));
    assert!(position("/2.0.0.subtree") < position("/1_0_0.glb"), "{paths:?}");
}
