//! Servers that redirect, answer without content, or that a set may not reach. No GPU.

use std::collections::HashMap;
use std::time::Duration;

use kit::pager::{Run, above};
use kit::server::{Reply, Server};
use kit::subtrees::{Availability, Scheme, Subtree};
use terrane::fetch::{Credential, HttpConfig, Limits};
use terrane::formats::writers::{GlbMesh, write_glb, write_height_exr};
use terrane::formats::{inspect, verify, verify_with};
use terrane::pager::PagerConfig;

use crate::models::{MODEL, trees_of};

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

/// Returns the files of sets that refer to a stranger in each possible way, by a name for the way. `there` is the URL of the
/// stranger, to which `/moved` redirects.
fn ways_to(there: &str) -> Vec<(&'static str, HashMap<&'static str, Vec<u8>>)> {
    let set = |contents: &str| tileset(&[contents]).into_bytes();
    let implicit = |content: &str, subtrees: &str| {
        let json = r#"{"asset":{"version":"1.1"},"geometricError":1000,"root":{"geometricError":256,"refine":"ADD",
            "boundingVolume":{"box":[0,0,0, 50,0,0, 0,50,0, 0,0,50]},"content":{"uri":"CONTENT"},"implicitTiling":{
            "subdivisionScheme":"QUADTREE","subtreeLevels":1,"availableLevels":1,"subtrees":{"uri":"SUBTREES"}}}}"#;
        json.replace("CONTENT", content).replace("SUBTREES", subtrees).into_bytes()
    };
    let mut subtree = Subtree::new(Scheme::Quadtree, 1, 1);
    subtree.fill();
    subtree.set_children(Availability::Constant(false));
    let schema = format!(r#""asset":{{"version":"1.1"}},"schemaUri":"{there}/schema.json""#);
    let with_schema = tileset(&["a.glb"]).replacen(r#""asset":{"version":"1.1"}"#, &schema, 1);
    let heights = r#"{"asset":{"version":"1.1","extras":{"terrane":{"content":"height","side":3,"border":1,"level_errors_m":[9]}}},
        "geometricError":1000,"root":{"boundingVolume":{"box":[0,0,0, 50,0,0, 0,50,0, 0,0,50]},"geometricError":0,
        "refine":"REPLACE","content":{"uri":"a.exr"},"extras":{"terrane":{"plane":[-50,-50,50,50],"imagery":"THERE/a.png"}}}}"#;
    let exr = write_height_exr("a.exr", 5, vec![0.0; 25]).unwrap();
    let (root, model) =
        ("/set/tileset.json", |from: &str| MODEL.replace(from, &format!("{there}/{from}")).into_bytes());
    vec![
        ("content", HashMap::from([(root, set(&format!("{there}/a.glb")))])),
        ("redirected content", HashMap::from([(root, set("/moved"))])),
        ("external tileset", HashMap::from([(root, set(&format!("{there}/more.json")))])),
        ("archive", HashMap::from([(root, set(&format!("{there}/more.3tz")))])),
        ("subtree", HashMap::from([(root, implicit("a.glb", &format!("{there}/{{level}}.{{x}}.{{y}}.subtree")))])),
        (
            "content of a subtree",
            HashMap::from([
                (root, implicit(&format!("{there}/{{level}}.glb"), "a.subtree")),
                ("/set/a.subtree", subtree.binary()),
            ]),
        ),
        ("schema", HashMap::from([(root, with_schema.into_bytes()), ("/set/a.glb", glb())])),
        ("buffer", HashMap::from([(root, set("a.gltf")), ("/set/a.gltf", model("tree.bin"))])),
        (
            "image",
            HashMap::from([(root, set("a.gltf")), ("/set/a.gltf", model("bark.png")), ("/set/tree.bin", vec![0; 36])]),
        ),
        ("model", HashMap::from([(root, set("a.i3dm")), ("/set/a.i3dm", trees_of(&format!("{there}/tree.gltf")))])),
        ("imagery", HashMap::from([(root, heights.replace("THERE", there).into_bytes()), ("/set/a.exr", exr)])),
    ]
}

#[test]
fn sets_reach_no_other_local_server_in_any_way() {
    let ways: Vec<&str> = ways_to("").iter().map(|(way, _)| *way).collect();
    for (nth, way) in ways.into_iter().enumerate() {
        let stranger = Server::start_at("127.0.0.2", |_| Reply::new(404, ""));
        let (_, files) = ways_to(&stranger.url).swap_remove(nth);
        let moved = format!("{}/a.glb", stranger.url);
        let server = Server::start(move |request| match files.get(request.path()) {
            Some(bytes) => Reply::ok(bytes.clone()),
            None if request.path() == "/moved" => Reply::new(302, "").with("Location", &moved),
            None => Reply::new(404, ""),
        });
        let source = format!("{}/set/tileset.json", server.url);
        let run = |http: HttpConfig| {
            let retry_after = Duration::from_millis(1);
            let mut run =
                Run::new(&source, PagerConfig { http, keep_features: true, retry_after, ..PagerConfig::default() });
            run.settle(above(100.0));
            for _ in 0..20 {
                std::thread::sleep(Duration::from_millis(1));
                run.frame(above(100.0));
            }
            run
        };
        let refused = run(HttpConfig::default());
        let verified = verify(&source, &Limits::default(), &mut |_| {}).unwrap();
        assert_eq!(stranger.count(), 0, "{way}");
        let errors = refused.pager.errors();
        // Contents are drawn without these files, which are noted.
        let is_drawn = matches!(way, "schema" | "image");
        let note = format!("a file on {}, which --allow-host allows", stranger.host());
        assert_eq!(refused.pager.ignored().count(&note), u64::from(is_drawn), "{way}");
        assert!(verified.failed > 0 || verified.ignored.contains_key(&note), "{way}: {verified:?}");
        let says = |what: &str| errors.iter().any(|error| error.count == 1 && error.reason.contains(what));
        let allow =
            format!("loopback address 127.0.0.2, which this tile set may not reach; --allow-host {}", stranger.host());
        assert!(says(&allow) != is_drawn, "{way}: {errors:?}");
        let allowed = || HttpConfig { allowed_hosts: vec![stranger.host().parse().unwrap()], ..HttpConfig::default() };
        run(allowed());
        let asked = stranger.count();
        assert!(asked > 0, "{way}");
        verify_with(&source, &Limits::default(), allowed(), &mut |_| {}).unwrap();
        assert!(stranger.count() > asked, "{way}");
    }
}

/// An allowed stranger gets no credential of the set that refers to it, in whichever way the set does.
#[test]
fn no_way_takes_credentials_to_another_server() {
    for nth in 0..ways_to("").len() {
        // Another port is another origin.
        let stranger = Server::start(|_| Reply::new(404, ""));
        let (way, files) = ways_to(&stranger.url).swap_remove(nth);
        let moved = format!("{}/a.glb", stranger.url);
        let server = Server::start(move |request| match files.get(request.path()) {
            Some(bytes) => Reply::ok(bytes.clone()).with("Set-Cookie", "session=7"),
            None if request.path() == "/moved" => Reply::new(302, "").with("Location", &moved),
            None => Reply::new(404, ""),
        });
        let http = HttpConfig {
            credentials: vec![
                Credential::header(&server.url, "x-key", "header").unwrap(),
                Credential::query(&server.url, "token", "query").unwrap(),
            ],
            allowed_hosts: vec![stranger.host().parse().unwrap()],
            ..HttpConfig::default()
        };
        let source = format!("http://me:pass@{}/set/tileset.json?key=root", server.host());
        let mut run = Run::new(&source, PagerConfig { http, keep_features: true, ..PagerConfig::default() });
        run.settle(above(100.0));
        assert!(stranger.count() > 0, "{way}");
        for request in stranger.seen() {
            let secrets = ["authorization", "x-key", "cookie", "referer"].map(|name| request.header(name));
            assert_eq!((secrets, request.target.contains('?')), ([None; 4], false), "{way}: {request:?}");
        }
        let own = server.seen();
        assert!(own.iter().all(|request| request.header("x-key").is_some() && request.target.contains("token=query")));
    }
}

/// A set whose contents lie beside its folder or on a server was refused, without a way to allow it.
#[test]
fn sets_on_disk_lead_outside_only_on_request() {
    let home = tempfile::tempdir().unwrap();
    let server = Server::start(|request| match request.path() {
        "/more/tileset.json" => Reply::ok(tileset(&["b.glb", "../c.glb"])),
        "/more/b.glb" | "/c.glb" => Reply::ok(glb()),
        _ => Reply::new(404, ""),
    });
    let file = |name: &str, bytes: &[u8]| {
        let path = home.path().join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, bytes).unwrap();
    };
    let remote = format!("{}/more/tileset.json", server.url);
    file("set/tileset.json", tileset(&["own.glb", "../models/a.glb", &remote, "textured.gltf"]).as_bytes());
    file("set/own.glb", &glb());
    file("models/a.glb", &glb());
    file("set/textured.gltf", MODEL.replace("bark.png", &format!("{}/bark.png", server.url)).as_bytes());
    file("set/tree.bin", &[0; 36]);
    let source = home.path().join("set").to_str().unwrap().to_owned();
    let run = |allow_outside: bool| {
        let limits = Limits { allow_outside, ..Limits::default() };
        let http = HttpConfig { allowed_hosts: vec![server.host().parse().unwrap()], ..HttpConfig::default() };
        let verified = verify_with(&source, &limits, http.clone(), &mut |_| {}).unwrap();
        let mut run = Run::new(&source, PagerConfig { limits, http, ..PagerConfig::default() });
        run.settle(above(100.0));
        (run.pager.errors(), run.stage.leaf_count(), verified.failed)
    };
    let (errors, drawn, failed) = run(false);
    assert_eq!((errors.len(), drawn, failed, server.count()), (2, 2, 2, 0), "{errors:?}");
    assert!(errors.iter().all(|error| error.reason.contains("--allow-outside allows it")), "{errors:?}");
    let (errors, drawn, failed) = run(true);
    assert_eq!((errors.len(), drawn, failed), (0, 5, 0), "{errors:?}");
    let images = server.seen().iter().filter(|request| request.path() == "/bark.png").count();
    assert_eq!(images, 2, "by the pager and by the check");
}
