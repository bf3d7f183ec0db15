//! Servers that redirect, or answer without content. No GPU.

use kit::pager::{Run, above};
use kit::server::{Reply, Server};
use terrane::fetch::Limits;
use terrane::formats::writers::{GlbMesh, write_glb};
use terrane::formats::{inspect, verify};
use terrane::pager::PagerConfig;

fn glb() -> Vec<u8> {
    write_glb(&GlbMesh {
        positions: vec![[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]],
        indices: vec![0, 1, 2],
        base_color: [1.0; 4],
        ..GlbMesh::default()
    })
}

fn tileset(contents: &[&str]) -> String {
    let tile = r#""boundingVolume":{"box":[0,0,0, 50,0,0, 0,50,0, 0,0,50]},"geometricError":0"#;
    let child = |uri: &&str| format!(r#"{{{tile},"content":{{"uri":"{uri}"}}}}"#);
    let children: Vec<String> = contents.iter().map(child).collect();
    format!(
        r#"{{"asset":{{"version":"1.1"}},"geometricError":1000,"root":{{
        "boundingVolume":{{"box":[0,0,0, 50,0,0, 0,50,0, 0,0,50]}},"geometricError":1000,"refine":"ADD","children":[{}]}}}}"#,
        children.join(",")
    )
}

/// Runs a set to its end; returns the errors, and how many contents are drawn.
fn settle(source: &str) -> (Vec<String>, usize) {
    let mut run = Run::new(source, PagerConfig::default());
    run.settle(above(100.0));
    let errors = run.pager.errors().iter().map(|error| format!("{}: {}", error.uri, error.reason)).collect();
    (errors, run.stage.leaf_count())
}

/// Contents were asked for beside the address that the application gave.
#[test]
fn references_are_relative_to_where_redirects_led() {
    let server = Server::start(|request| match request.path() {
        "/latest/tileset.json" => Reply::new(302, "").with("Location", "/v3/tileset.json"),
        "/v3/tileset.json" => Reply::ok(tileset(&["a.glb", "more.json"])),
        "/v3/more.json" => Reply::new(301, "").with("Location", "/v3/deep/more.json"),
        "/v3/deep/more.json" => Reply::ok(tileset(&["b.glb"])),
        "/v3/a.glb" | "/v3/deep/b.glb" => Reply::ok(glb()),
        _ => Reply::new(404, ""),
    });
    let source = format!("{}/latest/tileset.json", server.url);
    assert_eq!(settle(&source), (Vec::new(), 2));
    let verified = verify(&source, &Limits::default(), &mut |_| {}).unwrap();
    assert_eq!((verified.contents, verified.failed), (2, 0), "{verified:?}");
    let info = inspect(&source, &Limits::default()).unwrap();
    assert_eq!((info.tiles, info.contents, info.failed), (5, 2, 0), "{info}");
}

/// Servers that redirect to a signed URL expect each file at its own address.
#[test]
fn references_fall_back_to_the_address_asked_for() {
    for refusal in [403, 404] {
        let server = Server::start(move |request| match request.path() {
            "/download/tileset.json" => Reply::new(302, "").with("Location", "/store/7f3a?signature=1"),
            "/download/a.glb" => Reply::new(302, "").with("Location", "/store/91bc?signature=2"),
            "/store/7f3a" => Reply::ok(tileset(&["a.glb"])),
            "/store/91bc" => Reply::ok(glb()),
            _ => Reply::new(refusal, ""),
        });
        let source = format!("{}/download/tileset.json", server.url);
        assert_eq!(settle(&source), (Vec::new(), 1));
        let verified = verify(&source, &Limits::default(), &mut |_| {}).unwrap();
        assert_eq!((verified.contents, verified.failed), (1, 0), "{verified:?}");
    }
}

#[test]
fn answers_without_content_are_empty_tiles() {
    let server = Server::start(|request| match request.path() {
        "/tileset.json" => Reply::ok(tileset(&["a.glb", "sea.glb"])),
        "/a.glb" => Reply::ok(glb()),
        _ => Reply::new(204, ""),
    });
    let source = format!("{}/tileset.json", server.url);
    assert_eq!(settle(&source), (Vec::new(), 1));
    let asked = server.seen().iter().filter(|request| request.path() == "/sea.glb").count();
    assert_eq!(asked, 1, "it is not asked for again");
    let verified = verify(&source, &Limits::default(), &mut |_| {}).unwrap();
    assert_eq!((verified.contents, verified.failed), (2, 0), "{verified:?}");
}

/// Servers of paid imagery start a session with the tileset and refuse tiles without its cookie.
#[test]
fn cookies_of_the_root_are_sent_with_contents() {
    let server = Server::start(|request| match request.path() {
        "/set/tileset.json" => Reply::ok(tileset(&["a.glb"])).with("Set-Cookie", "session=7; Path=/set; HttpOnly"),
        "/set/a.glb" if request.header("cookie") == Some("session=7") => Reply::ok(glb()),
        _ => Reply::new(403, ""),
    });
    let source = format!("{}/set/tileset.json", server.url);
    assert_eq!(settle(&source), (Vec::new(), 1));
    let verified = verify(&source, &Limits::default(), &mut |_| {}).unwrap();
    assert_eq!((verified.contents, verified.failed), (1, 0), "{verified:?}");
}
