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

/// A triangle whose buffer is another file.
fn gltf(buffer: &str) -> String {
    format!(
        r#"{{"asset":{{"version":"2.0"}},"scenes":[{{"nodes":[0]}}],"nodes":[{{"mesh":0}}],
        "meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}}}}]}}],
        "accessors":[{{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3","min":[0,0,-1],"max":[1,0,0]}}],
        "bufferViews":[{{"buffer":0,"byteLength":36}}],"buffers":[{{"byteLength":36,"uri":"{buffer}"}}]}}"#
    )
}

fn corners() -> Vec<u8> {
    [0.0f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, -1.0].iter().flat_map(|x| x.to_le_bytes()).collect()
}

/// A set whose root has three contents, which are loaded together because its child would replace them.
fn several_contents() -> String {
    let tile = r#""boundingVolume":{"box":[0,0,0, 50,0,0, 0,50,0, 0,0,50]},"geometricError":0"#;
    format!(
        r#"{{"asset":{{"version":"1.1"}},"geometricError":0,"root":{{{tile},"refine":"REPLACE",
        "contents":[{{"uri":"a.gltf"}},{{"uri":"b.gltf"}},{{"uri":"c.gltf"}}],"children":[{{{tile}}}]}}}}"#
    )
}

fn assert_several_contents_are_read(source: &str) {
    assert_eq!(settle(source), (Vec::new(), 3));
    let verified = verify(source, &Limits::default(), &mut |_| {}).unwrap();
    assert_eq!((verified.contents, verified.failed), (1, 0), "{verified:?}");
    assert!(verified.ignored.is_empty(), "{verified:?}");
}

/// The files of a content were asked for beside its own address, unless it was the first of its tile.
#[test]
fn each_of_several_contents_has_its_own_redirect() {
    let server = Server::start(|request| match request.path() {
        "/latest/tileset.json" => Reply::new(302, "").with("Location", "/v3/tileset.json"),
        "/v3/tileset.json" => Reply::ok(several_contents()),
        "/v3/a.gltf" => Reply::new(302, "").with("Location", "/store/a/model.gltf"),
        "/v3/b.gltf" => Reply::new(302, "").with("Location", "/store/b/model.gltf"),
        "/store/a/model.gltf" | "/v3/c.gltf" => Reply::ok(gltf("a.bin")),
        "/store/b/model.gltf" => Reply::ok(gltf("b.bin")),
        "/store/a/a.bin" | "/store/b/b.bin" | "/v3/a.bin" => Reply::ok(corners()),
        _ => Reply::new(404, ""),
    });
    assert_several_contents_are_read(&format!("{}/latest/tileset.json", server.url));
}

/// Contents behind a signed URL of the tileset are where they were asked for, and so are their own files.
#[test]
fn several_contents_fall_back_to_the_address_asked_for() {
    for refusal in [403, 404] {
        let server = Server::start(move |request| match request.path() {
            "/download/tileset.json" => Reply::new(302, "").with("Location", "/store/7f3a?signature=1"),
            "/store/7f3a" => Reply::ok(several_contents()),
            "/download/a.gltf" | "/download/b.gltf" => Reply::ok(gltf("a.bin")),
            "/download/c.gltf" => Reply::new(302, "").with("Location", "/far/91bc?signature=2"),
            "/far/91bc" => Reply::ok(gltf("c.bin")),
            "/download/a.bin" | "/far/c.bin" => Reply::ok(corners()),
            _ => Reply::new(refusal, ""),
        });
        assert_several_contents_are_read(&format!("{}/download/tileset.json", server.url));
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
