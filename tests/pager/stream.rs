//! The pager with real files: all valid tiles are loaded, and a failed one is one error and leaves its parent. No GPU.

use std::path::Path;
use std::time::{Duration, Instant};

use glam::{DAffine3, DVec3};
use kit::pager::{Run, above};
use kit::tile_sets::{WORLD_M, write_quadtree};
use terrane::cull::PageRequest;
use terrane::fetch::{HungReads, IoError, Limits, root_uri};
use terrane::formats::writers::{GlbMesh, write_glb};
use terrane::formats::{ConvertOptions, Converted, InfoError, ReadOptions, convert, crop, inspect, verify};
use terrane::math::{BoundingSphere, BoundingVolume};
use terrane::pager::{DatabasePager, PagerConfig};
use terrane::scene::{Node, NodeId, NodeKind, Page, PagedLod, PagingOptions, RangeMode, Refine, SlotState};
use terrane::viewer::{LoadedRoot, ViewerError};

/// Returns a root and four children around the origin, one glb each.
fn write_set(folder: &Path) {
    let glb = write_glb(&GlbMesh {
        positions: vec![[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
        indices: vec![0, 1, 2],
        base_color: [1.0; 4],
        ..GlbMesh::default()
    });
    let tile = |name: &str, error: f64, children: &str| {
        std::fs::write(folder.join(format!("{name}.glb")), &glb).unwrap();
        format!(
            r#"{{"boundingVolume":{{"sphere":[0,0,0,2]}},"geometricError":{error},"content":{{"uri":"{name}.glb"}},"children":[{children}]}}"#
        )
    };
    let children: Vec<String> = (0..4).map(|i| tile(&format!("child{i}"), 0.0, "")).collect();
    let root = tile("root", 5.0, &children.join(","));
    let json = format!(r#"{{"asset":{{"version":"1.1"}},"geometricError":9,"root":{root}}}"#);
    std::fs::write(folder.join("tileset.json"), json).unwrap();
}

#[test]
fn all_wanted_tiles_are_loaded_and_drawn() {
    let folder = tempfile::tempdir().unwrap();
    write_set(folder.path());
    let mut run = Run::new(folder.path().to_str().unwrap(), PagerConfig::default());
    run.settle(above(10.0));
    assert_eq!(run.pager.stats().merged, 5);
    assert_eq!(run.stage.counters.tiles_drawn, 4, "the four children instead of the root");
    assert!(run.pager.errors().is_empty());
}

#[test]
fn corrupt_child_leaves_its_parent_and_is_one_error() {
    let folder = tempfile::tempdir().unwrap();
    write_set(folder.path());
    std::fs::remove_file(folder.path().join("child2.glb")).unwrap();
    std::fs::write(folder.path().join("child3.glb"), b"glTF\x02\0\0\0").unwrap();
    let mut run = Run::new(folder.path().to_str().unwrap(), PagerConfig::default());
    run.settle(above(10.0));
    let read = run.pager.stats().failed;
    for _ in 0..50 {
        run.frame(above(10.0));
    }
    assert_eq!(run.pager.stats().failed, read, "failures are not retried in each frame");
    let counters = &run.stage.counters;
    assert_eq!((counters.tiles_drawn, counters.stand_ins), (2, 2), "the parent stays where the two would be");
    let errors = run.pager.errors();
    assert_eq!(errors.iter().map(|e| e.count).sum::<u64>(), 2, "{errors:?}");
    assert!(errors.iter().any(|e| e.uri.ends_with("child2.glb") && &*e.reason == "not found"), "{errors:?}");
    assert!(errors.iter().any(|e| e.uri.ends_with("child3.glb") && e.reason.contains("truncated")), "{errors:?}");
}

#[test]
fn unwanted_tiles_expire_within_the_tile_budget() {
    let folder = tempfile::tempdir().unwrap();
    write_set(folder.path());
    let config = PagerConfig { max_tiles: 5, expiry_time: Duration::ZERO, ..PagerConfig::default() };
    let mut run = Run::new(folder.path().to_str().unwrap(), config);
    run.settle(above(10.0));
    assert_eq!(run.pager.stats().resident, 5);
    for _ in 0..20 {
        // From far away only the root is wanted.
        run.frame(above(100_000.0));
    }
    assert!(run.pager.stats().expired >= 1 && run.stage.counters.tiles_drawn == 1, "{:?}", run.pager.stats());
    assert_eq!(run.context.slots_out, run.pager.stats().resident, "slots are released with their pages");
}

/// Regions have fixed positions on the earth with any transform of the tiles above. Regression: tiles below were culled
/// at a wrong position and left a hole.
#[test]
fn regions_in_a_tileset_below_a_transform_are_not_moved() {
    let folder = tempfile::tempdir().unwrap();
    let glb = write_glb(&GlbMesh {
        positions: vec![[-900.0, 0.0, 900.0], [900.0, 0.0, 900.0], [0.0, 0.0, -900.0]],
        indices: vec![0, 1, 2],
        base_color: [1.0; 4],
        ..GlbMesh::default()
    });
    // The eye is at the pole, where up is z.
    let top = 6_356_752.314_245;
    let region = r#""boundingVolume":{"region":[-3.14,1.57,3.14,1.5707963,-100,100]}"#;
    let set = |root: &str| format!(r#"{{"asset":{{"version":"1.1"}},"geometricError":9000,"root":{root}}}"#);
    let tile = |error: f64, uri: &str, more: &str| {
        format!(r#"{{{region},"refine":"REPLACE","geometricError":{error},"content":{{"uri":"{uri}"}}{more}}}"#)
    };
    let transform = format!(r#","transform":[1,0,0,0,0,1,0,0,0,0,1,0,0,0,{top},1]"#);
    let write = |name: &str, text: String| std::fs::write(folder.path().join(name), text).unwrap();
    std::fs::write(folder.path().join("outer.glb"), &glb).unwrap();
    std::fs::write(folder.path().join("inner.glb"), &glb).unwrap();
    write("innermost.json", set(&tile(0.0, "inner.glb", "")));
    write("inner.json", set(&tile(300.0, "innermost.json", "")));
    let below = tile(400.0, "inner.json", "");
    write("tileset.json", set(&tile(500.0, "outer.glb", &format!(r#"{transform},"children":[{below}]"#))));
    let mut run = Run::new(folder.path().to_str().unwrap(), PagerConfig::default());
    run.settle(above(top + 4000.0));
    assert_eq!(run.pager.stats().merged, 4, "{:?}", run.pager.errors());
    assert_eq!((run.stage.counters.tiles_drawn, run.stage.counters.leaves), (1, 1));
}

#[test]
fn blocking_mode_loads_the_same_each_time_and_pagers_stop() {
    let folder = tempfile::tempdir().unwrap();
    write_set(folder.path());
    for _ in 0..10 {
        let mut run =
            Run::new(folder.path().to_str().unwrap(), PagerConfig { blocking: true, ..PagerConfig::default() });
        let merged: Vec<u64> = (0..4)
            .map(|_| {
                run.frame(above(10.0));
                run.pager.stats().merged
            })
            .collect();
        assert_eq!(merged, [5, 5, 5, 5], "all wanted levels are requested together");
    }
}

#[test]
fn occluder_in_a_content_hides_while_it_is_resident() {
    // Two tiles lie above each other, seen from above. In glTF y is up.
    let write = |folder: &Path, occluder: &str| {
        let gltf = |extras: &str| {
            format!(
                r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],"nodes":[{{"mesh":0{extras}}}],
                "meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}}}}]}}],"buffers":[{{"byteLength":36,
                "uri":"data:application/octet-stream;base64,{}"}}],"bufferViews":[{{"buffer":0,"byteLength":36}}],
                "accessors":[{{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3","min":[-1,0,-1],"max":[1,0,1]}}]}}"#,
                // Corners at (-1, 0, -1), (1, 0, -1) and (0, 0, 1).
                "AACAvwAAAAAAAIC/AACAPwAAAAAAAIC/AAAAAAAAAAAAAIA/",
            )
        };
        std::fs::write(folder.join("upper.gltf"), gltf(occluder)).unwrap();
        std::fs::write(folder.join("lower.gltf"), gltf("")).unwrap();
        let tile = |name: &str, z: f64| {
            format!(
                r#"{{"boundingVolume":{{"sphere":[0,0,{z},2]}},"geometricError":0,"content":{{"uri":"{name}.gltf"}},
                "transform":[1,0,0,0,0,1,0,0,0,0,1,0,0,0,{z},1]}}"#
            )
            .replacen(&format!("[0,0,{z},2]"), "[0,0,0,2]", 1)
        };
        let json = format!(
            r#"{{"asset":{{"version":"1.1"}},"geometricError":90,"root":{{"refine":"ADD","geometricError":80,
            "boundingVolume":{{"sphere":[0,0,10,30]}},"children":[{},{}]}}}}"#,
            tile("upper", 20.0),
            tile("lower", 0.0)
        );
        std::fs::write(folder.join("tileset.json"), json).unwrap();
    };
    let plate = r#","extras":{"terrane":{"occluder":{"corners":[[-9,0,-9],[9,0,-9],[9,0,9],[-9,0,9]]}}}"#;
    for (occluder, drawn) in [(plate, 1), ("", 2)] {
        let folder = tempfile::tempdir().unwrap();
        write(folder.path(), occluder);
        let mut run = Run::new(folder.path().to_str().unwrap(), PagerConfig::default());
        run.settle(above(40.0));
        assert!(run.pager.errors().is_empty(), "{:?}", run.pager.errors());
        let counters = run.stage.counters;
        assert_eq!((counters.tiles_drawn, counters.occluded > 0), (drawn, drawn == 1), "{counters:?}");
        // From below the plate, the lower tile is visible.
        run.settle(above(10.0));
        assert_eq!(run.stage.counters.tiles_drawn, 1);
        run.settle(above(40.0));
        assert_eq!(run.stage.counters.tiles_drawn, drawn);
        // After the page of the plate is removed, the hidden tile is drawn in the same frame.
        let upper = run.scene.slots_of_page(run.scene.roots()[0]).next().unwrap();
        let SlotState::Resident(page) = run.scene.slot(upper).unwrap().state else { panic!("merged") };
        run.scene.detach(page).unwrap();
        run.cull(above(40.0));
        assert_eq!((run.stage.counters.tiles_drawn, run.stage.counters.occluded), (1, 0));
    }
}

/// Requests of one view are served while another view keeps requesting tiles of higher priority. Regression: they
/// starved.
#[test]
fn long_waiting_requests_are_served_before_newer_urgent_ones() {
    let folder = tempfile::tempdir().unwrap();
    write_set(folder.path());
    const MANY: usize = 4000;
    let tile = |_| {
        let node = PagedLod {
            bounds: BoundingVolume::Sphere(BoundingSphere::new(DVec3::ZERO, 10.0)),
            range_mode: RangeMode::ScreenSpaceError { geometric_error_m: 0.0 },
            refine: Refine::Replace,
            content: Some(folder.path().join("root.glb").display().to_string().into()),
            content_transform: DAffine3::IDENTITY,
            reader_data: None,
            request_volume: None,
            paging: PagingOptions::default(),
        };
        Node::new(NodeKind::PagedLod(Box::new(node)))
    };
    let root = Page::from_node(Node::group((0..MANY).map(tile).collect())).unwrap();
    let config =
        PagerConfig { file_threads: 1, decode_threads: 1, stale_time: Duration::MAX, ..PagerConfig::default() };
    let mut run = Run::of_page(root, folder.path().to_str().unwrap(), config);
    let slots: Vec<NodeId> = run.scene.slots_of_page(run.scene.roots()[0]).collect();
    let request = |(i, slot): (usize, &NodeId)| {
        let priority = if i == MANY / 2 { 1.0 } else { 1000.0 };
        PageRequest { slot: *slot, priority, error_px: priority, ahead_frames: 0 }
    };
    // The old request is loaded, with few others before it.
    let requests: Vec<PageRequest> = slots.iter().enumerate().map(request).collect();
    let end = Instant::now() + kit::MAX_WAIT;
    for round in 0.. {
        run.frame += 20;
        let first = if round == 0 { MANY / 2 } else { 0 };
        let time_s = f64::from(run.frame) / 60.0;
        run.pager.update_scene_graph(&mut run.scene, run.frame, time_s, &requests[first..], &mut [&mut run.context]);
        if run.scene.slot(slots[MANY / 2]).unwrap().state != SlotState::Empty {
            break;
        }
        assert!(Instant::now() < end, "{:?}", run.pager.stats());
        std::thread::sleep(Duration::from_micros(500));
    }
    let merged = run.pager.stats().merged as usize;
    assert!(merged < MANY - 100, "{merged} were before it");
}

/// Returns a configuration whose reads may take 100 ms.
fn impatient() -> PagerConfig {
    PagerConfig {
        file_threads: 1,
        limits: Limits { file_timeout: Duration::from_millis(100), ..Limits::default() },
        retry_after: Duration::from_millis(50),
        ..PagerConfig::default()
    }
}

fn path(folder: &Path, name: &str) -> String {
    folder.join(name).to_str().unwrap().to_owned()
}

/// Regression: the only file thread hung for ever, and the end of the pager with it.
#[test]
fn hung_file_fails_and_the_others_are_loaded() {
    let folder = tempfile::tempdir().unwrap();
    write_set(folder.path());
    let mut run = Run::new(folder.path().to_str().unwrap(), impatient());
    let file = path(folder.path(), "child2.glb");
    let hung = HungReads::of(&file);
    run.until(above(10.0), "a read fails and the others are merged", |run| {
        run.pager.stats().failed > 0 && run.pager.stats().merged == 4
    });
    let errors = run.pager.errors();
    assert_eq!((errors.len(), &*errors[0].uri), (1, file.as_str()), "{errors:?}");
    assert!(errors[0].reason.contains("timed out after 0.1 s"), "{errors:?}");
    // The disk comes back, and the threads that hung end.
    drop(hung);
    run.until(above(10.0), "the failed tile is loaded", |run| run.stage.counters.tiles_drawn == 4);
    assert_eq!(run.pager.stats().merged, 5);
    let hung = HungReads::of(&file);
    run.pager.clear(&mut run.scene, &mut [&mut run.context]);
    run.until(above(10.0), "all other tiles are merged", |run| run.pager.stats().merged == 5 + 4);
    // Ends although a thread hangs.
    drop(run);
    drop(hung);
}

/// On a disk that hangs each tile fails, with few threads, and the root is kept.
#[test]
fn hung_disk_stops_neither_frames_nor_the_end() {
    let folder = tempfile::tempdir().unwrap();
    write_quadtree(folder.path());
    let mut run = Run::new(folder.path().to_str().unwrap(), impatient());
    run.settle(above(1e7));
    let merged = run.pager.stats().merged;
    let hung = HungReads::of(folder.path().to_str().unwrap());
    run.max_sse_px = 0.1;
    let all = above(WORLD_M) + DVec3::new(WORLD_M / 2.0, WORLD_M / 2.0, 0.0);
    run.until(all, "more tiles fail than threads may hang", |run| run.pager.stats().failed > 40);
    assert_eq!(run.pager.stats().merged, merged);
    assert!(run.stage.counters.tiles_drawn > 0, "what was loaded stays");
    let errors = run.pager.errors();
    assert!(errors.iter().any(|error| error.reason.contains("all file threads wait")), "{errors:?}");
    #[cfg(target_os = "linux")]
    {
        let threads = std::fs::read_dir("/proc/self/task").unwrap().flatten();
        let is_file_thread = |name: String| name.starts_with("pager-file-");
        let names = threads.filter_map(|thread| std::fs::read_to_string(thread.path().join("comm")).ok());
        // Other tests of this process have some too.
        let count = names.filter(|name| is_file_thread(name.clone())).count();
        assert!(count < 40, "{count} file threads");
    }
    drop(run);
    drop(hung);
}

#[test]
fn hung_root_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    write_set(folder.path());
    let root = root_uri(folder.path().to_str().unwrap()).unwrap();
    let mut pager = DatabasePager::new(impatient(), ReadOptions::for_root(&root, Limits::default())).unwrap();
    let hung = HungReads::of(&root);
    let error = pager.read_root(&root).unwrap_err();
    assert!(matches!(&error, IoError::Timeout { uri, .. } if **uri == *root), "{error}");
    drop(hung);
    // A busy machine may take as long once.
    assert!((0..20).any(|_| pager.read_root(&root).is_ok()));
}

/// Regression: the search for the root, which asks the disk for several names, had no end.
#[test]
fn root_that_is_not_found_in_time_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    write_set(folder.path());
    let source = folder.path().to_str().unwrap();
    let hung = HungReads::of_metadata(source);
    let Err(ViewerError::Io(error)) = LoadedRoot::read(source, &impatient()) else { panic!("the root is loaded") };
    assert!(matches!(&error, IoError::Timeout { uri, .. } if uri == source), "{error}");
    drop(hung);
    assert!(LoadedRoot::read(source, &PagerConfig::default()).is_ok());
}

/// Reads a whole set of which some hangs. Returns the failures with their reasons, or the only error.
fn read_whole(job: &str, source: &str, out: &Path) -> Result<Vec<String>, String> {
    // Reads that do not hang take less on a busy machine too.
    let limits = Limits { file_timeout: Duration::from_millis(500), ..Limits::default() };
    let options = ConvertOptions { limits, threads: Some(1), check: false, ..ConvertOptions::default() };
    let of_infos = |errors: Vec<InfoError>| errors.into_iter().map(|e| format!("{}: {}", e.uri, e.reason)).collect();
    let of_pairs = |done: Converted| done.errors.iter().map(|(uri, reason)| format!("{uri}: {reason}")).collect();
    match job {
        "info" => inspect(source, &limits).map(|info| of_infos(info.errors)).map_err(|e| e.to_string()),
        "verify" => verify(source, &limits, &mut |_| ()).map(|done| of_infos(done.errors)).map_err(|e| e.to_string()),
        "convert" => convert(source, out, &options, &mut |_| ()).map(of_pairs).map_err(|e| e.to_string()),
        _ => {
            let options = ConvertOptions { rectangle_m: Some([-2.0, -2.0, 2.0, 2.0]), ..options };
            crop(source, out, &options, &mut |_| ()).map(of_pairs).map_err(|e| e.to_string())
        }
    }
}

/// Regression: reading a whole set had no end on a disk that hangs.
#[test]
fn hung_disk_stops_no_reading_of_a_whole_set() {
    for job in ["info", "verify", "convert", "crop"] {
        let folder = tempfile::tempdir().unwrap();
        write_set(folder.path());
        let (source, out) = (folder.path().to_str().unwrap(), folder.path().join("out"));
        // All but the first tile, since a new set needs one. Sizes are read as metadata.
        let hung =
            [HungReads::of(&path(folder.path(), "child")), HungReads::of_metadata(&path(folder.path(), "child"))];
        let errors = read_whole(job, source, &out).unwrap();
        let count = |reason: &str| errors.iter().filter(|error| error.ends_with(reason)).count();
        let timed_out = count("timed out after 0.5 s (reading the file)");
        let refused = count("not read, since 3 other files take longer than 0.5 s");
        // The last of them, and the first tile where it is read last.
        let expected = if job == "crop" { 2 } else { 1 };
        assert_eq!((timed_out, refused), (3, expected), "{job}: {errors:?}");
        drop(hung);
        for hung in [HungReads::of(source), HungReads::of_metadata(source)] {
            let error = read_whole(job, source, &out).unwrap_err();
            assert!(error.starts_with(source) && error.contains("timed out after 0.5 s"), "{job}: {error}");
            drop(hung);
        }
    }
}
