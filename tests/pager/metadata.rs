//! Metadata of tiles that a pager loads: a picked point leads to its content, group, tile and tileset. No GPU.

use glam::DVec3;
use kit::pager::{Run, above};
use kit::server::{Reply, Server};
use terrane::formats::writers::{GlbMesh, write_glb};
use terrane::pager::PagerConfig;
use terrane::scene::{IntersectionVisitor, LineSegmentIntersector, TileMetadata};

#[test]
fn picked_points_lead_to_the_metadata_of_their_tiles() {
    let folder = tempfile::tempdir().unwrap();
    let glb = write_glb(&GlbMesh {
        positions: vec![[-1.0, 0.0, 1.0], [1.0, 0.0, 1.0], [0.0, 0.0, -1.0]],
        indices: vec![0, 1, 2],
        base_color: [1.0; 4],
        ..GlbMesh::default()
    });
    std::fs::write(folder.path().join("a.glb"), glb).unwrap();
    let named = |name: &str| format!(r#"{{"class":"c","properties":{{"name":"{name}"}}}}"#);
    let [set, group, tile, content, below, leaf] = ["set", "group", "tile", "content", "below", "leaf"].map(named);
    let schema = r#""schema":{"id":"s","classes":{"c":{"properties":{"name":{"type":"STRING","semantic":"NAME"}}}}}"#;
    let volume = r#""boundingVolume":{"sphere":[0,0,0,2]}"#;
    let head = r#""asset":{"version":"1.1"},"geometricError":9"#;
    let tileset = format!(
        r#"{{{head},{schema},"metadata":{set},"groups":[{group}],"root":{{{volume},"geometricError":9,"refine":"REPLACE",
        "metadata":{tile},"content":{{"uri":"below.json","group":0,"metadata":{content}}}}}}}"#
    );
    let below = format!(
        r#"{{{head},{schema},"metadata":{below},"root":{{{volume},"geometricError":0,"refine":"ADD","metadata":{leaf},
        "content":{{"uri":"a.glb"}}}}}}"#
    );
    std::fs::write(folder.path().join("tileset.json"), tileset).unwrap();
    std::fs::write(folder.path().join("below.json"), below).unwrap();
    for keep_features in [true, false] {
        let config = PagerConfig { keep_features, build_kd_trees: true, ..PagerConfig::default() };
        let mut run = Run::new(folder.path().to_str().unwrap(), config);
        run.settle(above(10.0));
        assert!(run.pager.errors().is_empty(), "{:?}", run.pager.errors());
        let mut line = LineSegmentIntersector::new(DVec3::new(0.0, 0.0, 9.0), DVec3::new(0.0, 0.0, -9.0));
        IntersectionVisitor::new().traverse(&run.scene, &mut line);
        let path = line.intersections()[0].node_path.clone();
        let along = |part: fn(&TileMetadata) -> Option<&std::sync::Arc<terrane::scene::Metadata>>| {
            let parts = path.iter().filter_map(|node| part(run.scene.metadata(*node)?));
            let names = parts.map(|part| part.value_by_semantic("NAME").unwrap().to_string());
            names.collect::<Vec<_>>().join(" ")
        };
        let found = [
            along(|m| m.tileset.as_ref()),
            along(|m| m.group.as_ref()),
            along(|m| m.tile.as_ref()),
            along(|m| m.content.as_ref()),
        ];
        assert_eq!(found, if keep_features { ["set below", "group", "tile leaf", "content"] } else { [""; 4] });
    }
}

/// A tileset whose text is large is parsed twice: for the reference to its schema on a thread beside the requests, and by its
/// decoder.
#[test]
fn schemas_of_large_external_tilesets_are_fetched_with_them() {
    let tile = r#""boundingVolume":{"sphere":[0,0,0,2]},"geometricError":0"#;
    let named = r#"{"class":"c","properties":{"name":"below"}}"#;
    let head = r#""asset":{"version":"1.1"},"geometricError":9"#;
    let padding = " ".repeat(200_000);
    let below = format!(
        r#"{{{padding}{head},"schemaUri":"meta/s.json","metadata":{named},"root":{{{tile},"refine":"ADD","content":{{"uri":"a.glb"}}}}}}"#
    );
    let root = format!(r#"{{{head},"root":{{{tile},"refine":"ADD","content":{{"uri":"sub/below.json"}}}}}}"#);
    let glb = write_glb(&GlbMesh {
        positions: vec![[-1.0, 0.0, 1.0], [1.0, 0.0, 1.0], [0.0, 0.0, -1.0]],
        indices: vec![0, 1, 2],
        base_color: [1.0; 4],
        ..GlbMesh::default()
    });
    let server = Server::start(move |request| match request.path() {
        "/tileset.json" => Reply::ok(root.clone()),
        "/sub/below.json" => Reply::ok(below.clone()),
        "/sub/meta/s.json" => Reply::ok(r#"{"classes":{"c":{"properties":{"name":{"type":"STRING"}}}}}"#),
        "/sub/a.glb" => Reply::ok(glb.clone()),
        _ => Reply::new(404, ""),
    });
    let config = PagerConfig { keep_features: true, ..PagerConfig::default() };
    let mut run = Run::new(&format!("{}/tileset.json", server.url), config);
    run.settle(above(10.0));
    assert!(run.pager.errors().is_empty(), "{:?}", run.pager.errors());
    assert!(run.pager.ignored().is_empty(), "{:?}", run.pager.ignored());
    assert_eq!((run.stage.leaf_count(), server.count()), (1, 4));
}
