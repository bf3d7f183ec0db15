//! The servers that tile sets may refer to: `--allow-host`, and proxies.

use std::process::{Command, Output};

use kit::server::{Reply, Server};
use terrane::formats::writers::{GlbMesh, write_glb};

fn glb() -> Vec<u8> {
    write_glb(&GlbMesh {
        positions: vec![[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]],
        indices: vec![0, 1, 2],
        base_color: [1.0; 4],
        ..GlbMesh::default()
    })
}

fn tileset(contents: &[String]) -> String {
    let tile = r#""boundingVolume":{"sphere":[0,0,0,9]},"geometricError":0"#;
    let children: Vec<_> = contents.iter().map(|uri| format!(r#"{{{tile},"content":{{"uri":"{uri}"}}}}"#)).collect();
    format!(
        r#"{{"asset":{{"version":"1.1"}},"geometricError":9,"root":{{{tile},"refine":"ADD","children":[{}]}}}}"#,
        children.join(",")
    )
}

fn verify(source: &str, more: &[&str], proxy: &str) -> (Output, String) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_terrane"));
    command.args(["info", source, "--verify"]).args(more).env("http_proxy", proxy);
    for name in ["no_proxy", "NO_PROXY", "HTTP_PROXY", "all_proxy", "ALL_PROXY"] {
        command.env_remove(name);
    }
    let out = command.output().unwrap();
    let text = String::from_utf8_lossy(&out.stdout).into_owned() + &String::from_utf8_lossy(&out.stderr);
    (out, text)
}

#[test]
fn sets_reach_local_servers_that_are_allowed() {
    let other = Server::start(|_| Reply::ok(glb()));
    let set = tileset(&[format!("{}/a.glb", other.url)]);
    let server = Server::start(move |_| Reply::ok(set.clone()));
    let source = format!("{}/set/", server.url);
    let (out, text) = verify(&source, &[], "");
    assert_eq!((out.status.code(), other.count()), (Some(1), 0), "{text}");
    let advice = format!("--allow-host {}", other.host());
    assert!(text.contains(&advice) && text.contains("loopback address 127.0.0.1"), "{text}");
    for host in [other.host(), "127.0.0.1"] {
        let (out, text) = verify(&source, &["--allow-host", "tiles.example", "--allow-host", host], "");
        assert!(out.status.success(), "{text}");
    }
    assert_eq!(other.count(), 2);
    let (out, text) = verify(&source, &["--allow-host", "http://127.0.0.1/"], "");
    assert!(out.status.code() == Some(2) && text.contains("expected HOST or HOST:PORT"), "{text}");
}

/// A proxy resolves names itself. Addresses in URLs are checked before it is asked.
#[test]
fn proxies_are_not_asked_for_local_addresses() {
    let hosts = ["tiles.invalid", "10.0.0.1", "0x7f.1", "[::1]", "localhost"];
    let set = tileset(&hosts.map(|host| format!("http://{host}/a.glb")));
    let proxy = Server::start(move |request| match request.target.ends_with(".glb") {
        true => Reply::ok(glb()),
        false => Reply::ok(set.clone()),
    });
    let (out, text) = verify("http://root.invalid/", &[], &proxy.url);
    assert_eq!(out.status.code(), Some(1), "{text}");
    let mut asked: Vec<String> = proxy.seen().iter().map(|request| request.target.clone()).collect();
    asked.dedup();
    assert_eq!(asked, ["http://root.invalid/tileset.json", "http://tiles.invalid/a.glb"]);
    assert_eq!(text.matches("--allow-host").count(), 4, "{text}");
}

#[cfg(unix)]
#[test]
fn links_out_of_a_set_are_refused_with_advice() {
    let home = tempfile::tempdir().unwrap();
    let (set, outside) = (home.path().join("set"), home.path().join("a.glb"));
    std::fs::create_dir(&set).unwrap();
    std::fs::write(&outside, glb()).unwrap();
    std::fs::write(set.join("tileset.json"), tileset(&["link.glb".to_owned()])).unwrap();
    std::os::unix::fs::symlink(&outside, set.join("link.glb")).unwrap();
    let source = set.to_str().unwrap();
    let (out, text) = verify(source, &[], "");
    assert!(out.status.code() == Some(1) && text.contains("--follow-links allows it"), "{text}");
    let (out, text) = verify(source, &["--follow-links"], "");
    assert!(out.status.success(), "{text}");
}

#[test]
fn references_out_of_a_set_are_refused_with_advice() {
    let home = tempfile::tempdir().unwrap();
    let server = Server::start(|_| Reply::ok(glb()));
    let set = home.path().join("set");
    std::fs::create_dir(&set).unwrap();
    std::fs::write(home.path().join("a.glb"), glb()).unwrap();
    let contents = ["../a.glb".to_owned(), format!("{}/b.glb", server.url)];
    std::fs::write(set.join("tileset.json"), tileset(&contents)).unwrap();
    let source = set.to_str().unwrap();
    let (out, text) = verify(source, &[], "");
    assert!(out.status.code() == Some(1) && text.matches("--allow-outside allows it").count() == 2, "{text}");
    assert_eq!(server.count(), 0);
    // The server has an address of this machine, which is another question.
    let (out, text) = verify(source, &["--allow-outside"], "");
    assert!(out.status.code() == Some(1) && text.contains("--allow-host 127.0.0.1"), "{text}");
    let (out, text) = verify(source, &["--allow-outside", "--allow-host", server.host()], "");
    assert!(out.status.success(), "{text}");
}
