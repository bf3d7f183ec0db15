//! The cache on disk: flights that fill it and that use it, `terrane cache`, and proxies.

use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};

use kit::skip::no_adapter;
use serde_json::Value;

fn terrane(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_terrane")).args(args).output().unwrap()
}

fn said(args: &[&str]) -> String {
    let out = terrane(args);
    assert!(out.status.success(), "{args:?}: {}", String::from_utf8_lossy(&out.stderr));
    String::from_utf8(out.stdout).unwrap()
}

fn refused(args: &[&str]) -> String {
    let out = terrane(args);
    assert_eq!(out.status.code(), Some(1), "{args:?}");
    String::from_utf8(out.stderr).unwrap()
}

struct Server(Child, String);

impl Server {
    fn start(folder: &Path, options: &[&str]) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_terrane"));
        command.args(["serve", folder.to_str().unwrap(), "--port", "0"]).args(options).stdout(Stdio::piped());
        let mut child = command.spawn().unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let url = format!("http://{}", line.trim().rsplit("http://").next().unwrap());
        Self(child, url)
    }

    fn stop(mut self) {
        self.0.kill().unwrap();
        self.0.wait().unwrap();
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn flight_without_a_server_draws_from_the_cache() {
    if no_adapter() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (set, cache) = (path("set"), path("cache"));
    said(&["gen", &set, "--levels", "3", "--size", "5000", "--seed", "3"]);
    let server = Server::start(Path::new(&set), &["--max-age", "1000"]);
    let url = server.1.clone();
    let fly = |name: &str, more: &[&str]| {
        let (report, picture) = (path(&format!("{name}.json")), path(&format!("{name}.png")));
        let mut args = vec!["fly", &url, "--offscreen", "--settle", "--size", "160x90", "--sse", "0.02"];
        args.extend(["--report", &report, "--screenshot", &picture, "--cache", &cache]);
        args.extend(more);
        let text = said(&args);
        let report: Value = serde_json::from_slice(&std::fs::read(report).unwrap()).unwrap();
        (text, report, std::fs::read(picture).unwrap())
    };
    let (_, first, picture) = fly("first", &[]);
    let loaded = first["tiles"]["loaded"].as_u64().unwrap();
    assert!(loaded > 5 && first["cache"]["stored"].as_u64().unwrap() > loaded, "{first}");
    assert_eq!(first["cache"]["hits"], 0);
    server.stop();
    let (text, second, again) = fly("second", &["--offline"]);
    assert_eq!((&second["errors"], second["bytes"]["http"].as_u64()), (&serde_json::json!([]), Some(0)), "{second}");
    assert_eq!(second["settled"], first["settled"]);
    assert!(picture == again, "the same image");
    assert!(text.contains("answers from the cache"), "{text}");

    let info: Value = serde_json::from_str(&said(&["cache", "info", "--cache", &cache, "--json"])).unwrap();
    // Bodies in flight when the report was written are stored as well.
    assert!(info["entries"].as_u64() >= first["cache"]["stored"].as_u64(), "{info} {first}");
    assert_eq!(info["fresh"], info["entries"]);
    let verified: Value = serde_json::from_str(&said(&["cache", "verify", "--cache", &cache, "--json"])).unwrap();
    assert_eq!((&verified["broken"], &verified["orphans"]), (&0.into(), &0.into()));
    assert!(said(&["cache", "clear", "--cache", &cache]).contains("removed"));
    let error = refused(&["fly", &url, "--offscreen", "--cache", &cache, "--offline"]);
    assert!(error.contains("offline"), "{error}");
}

/// With all faults of the server, only valid tiles are cached, and in the end all of them.
#[test]
fn faults_do_not_stay_in_the_cache() {
    if no_adapter() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (set, cache, report) = (path("set"), path("cache"), path("report.json"));
    said(&["gen", &set, "--levels", "3", "--size", "5000", "--seed", "4"]);
    let fly = |url: &str, more: &[&str]| -> Value {
        let mut args = vec!["fly", url, "--offscreen", "--settle", "--size", "160x90", "--sse", "0.02"];
        args.extend(["--report", &report]);
        args.extend(more);
        let out = terrane(&args);
        // The root may fail at random as well.
        if !out.status.success() {
            return Value::Null;
        }
        serde_json::from_slice(&std::fs::read(&report).unwrap()).unwrap()
    };
    let whole = fly(&set, &[]);
    let faults = ["--error-rate", "0.1", "--truncate-rate", "0.1", "--reset-rate", "0.1", "--page-rate", "0.2"];
    let server = Server::start(Path::new(&set), &[&faults[..], &["--max-age", "1000", "--seed", "8"]].concat());
    let mut flights = 0;
    loop {
        let report = fly(&server.1, &["--cache", &cache]);
        if report["tiles"]["failed"] == 0 {
            assert_eq!(report["settled"], whole["settled"], "flight {flights}");
            break;
        }
        flights += 1;
        assert!(flights < 30, "{report}");
    }
    assert!(flights > 0, "the server had no faults");
    let url = server.1.clone();
    server.stop();
    assert_eq!(fly(&url, &["--cache", &cache, "--offline"])["settled"], whole["settled"]);
}

#[test]
fn filled_cache_needs_no_server() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (set, cache) = (path("set"), path("cache"));
    said(&["gen", &set, "--levels", "4", "--size", "5000", "--seed", "3"]);
    let server = Server::start(Path::new(&set), &["--error-rate", "0.3", "--seed", "2"]);
    let url = server.1.clone();
    let fill = |more: &[&str]| {
        let args = [&["cache", "fill", &url, "--cache", &cache], more].concat();
        let out = terrane(&args);
        (out.status.code(), String::from_utf8_lossy(&out.stdout).into_owned(), out.stderr)
    };
    // All attempts for a file may fail at random, so the command is repeated until all files are cached.
    let until_whole = |more: &[&str]| {
        for _ in 0..20 {
            let (code, text, stderr) = fill(more);
            if code == Some(0) {
                return text;
            }
            assert!(text.contains("failed") && !stderr.is_empty(), "{text}");
        }
        panic!("the cache was not filled");
    };
    let text = until_whole(&["--region", "-100,0,-99,1"]);
    assert!(text.starts_with("1 files"), "another part of the earth: {text}");
    let text = until_whole(&["--level", "0-1"]);
    assert!(!text.starts_with("1 files"), "{text}");
    until_whole(&[]);
    let (_, text, _) = fill(&[]);
    assert!(text.contains(" 0 fetched (0.0 MiB), 0 failed"), "{text}");
    server.stop();
    let info = |source: &str, more: &[&str]| -> Value {
        serde_json::from_str(&said(&[&["info", source, "--json"], more].concat())).unwrap()
    };
    let (of_cache, of_folder) = (info(&url, &["--cache", &cache, "--offline"]), info(&set, &[]));
    assert_eq!((&of_cache["contents"], &of_cache["tiles"]), (&of_folder["contents"], &of_folder["tiles"]));
    let kept: Value = serde_json::from_str(&said(&["cache", "info", "--cache", &cache, "--json"])).unwrap();
    assert!(kept["entries"].as_u64() > of_folder["contents"].as_u64(), "imagery and tilesets too: {kept}");
    assert!(refused(&["cache", "fill", &set, "--cache", &cache]).contains("only tile sets on servers"));
    assert!(refused(&["cache", "fill", &url, "--cache", &cache, "--offline"]).contains("offline"));
}

/// Ctrl-C ends the program while a server does not answer.
#[cfg(unix)]
#[test]
fn interrupt_does_not_wait_for_the_server() {
    let folder = tempfile::tempdir().unwrap();
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let url = format!("http://{}/set/", listener.local_addr().unwrap());
    let interrupted = |args: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_terrane"));
        command.args(args).args(["--cache", folder.path().to_str().unwrap()]);
        // A window opens, if there is a display, once everything is read.
        command.env("DISPLAY", ":999");
        let child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        // The request is in flight and gets no answer.
        let stream = listener.accept().unwrap();
        let id = rustix::process::Pid::from_child(&child);
        rustix::process::kill_process(id, rustix::process::Signal::INT).unwrap();
        let out = child.wait_with_output().unwrap();
        drop(stream);
        out
    };
    let out = interrupted(&["cache", "fill", &url]);
    let said = String::from_utf8_lossy(&out.stdout).into_owned() + &String::from_utf8_lossy(&out.stderr);
    assert!(out.status.code() == Some(1) && said.contains("stopped, the same command continues"), "{said}");
    let out = interrupted(&["fly", &url, "--offscreen"]);
    assert_eq!(out.status.code(), Some(130), "{out:?}");
    // The same if the views of a window have separate sets.
    let config = folder.path().join("views.json");
    std::fs::write(&config, format!(r#"{{"scenes": {{"far": "{url}"}}, "views": [{{"scene": "far"}}]}}"#)).unwrap();
    let out = interrupted(&["view", "--config", config.to_str().unwrap()]);
    assert_eq!(out.status.code(), Some(130), "{out:?}");
}

#[test]
fn folder_that_is_no_cache_is_not_changed() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("letter"), "dear").unwrap();
    let home = folder.path().to_str().unwrap();
    for command in ["info", "clear", "verify"] {
        assert!(refused(&["cache", command, "--cache", home]).contains("no cache"));
        assert!(refused(&["cache", command, "--cache", &format!("{home}/none")]).contains("no cache"));
    }
    assert!(folder.path().join("letter").exists() && !folder.path().join("none").exists());
}

/// The proxy of the environment gets the whole URL, and no secret is printed.
#[test]
fn proxies_are_taken_from_the_environment() {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let proxy = format!("http://{}", listener.local_addr().unwrap());
    let seen = std::thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        let mut head = Vec::new();
        while !head.ends_with(b"\r\n\r\n") {
            let mut byte = [0];
            stream.read_exact(&mut byte).unwrap();
            head.push(byte[0]);
        }
        stream.write_all(b"HTTP/1.1 403 No\r\nContent-Length: 0\r\nConnection: close\r\n\r\n").unwrap();
        String::from_utf8(head).unwrap()
    });
    let out = Command::new(env!("CARGO_BIN_EXE_terrane"))
        .args([
            "fly",
            "http://tiles.invalid/set/",
            "--offscreen",
            "--query",
            "key=hidden",
            "--header",
            "X-Key: hidden2",
        ])
        .env("http_proxy", proxy)
        .env_remove("no_proxy")
        .env_remove("NO_PROXY")
        .output()
        .unwrap();
    let error = String::from_utf8_lossy(&out.stderr).into_owned();
    assert!(out.status.code() == Some(1) && error.contains("403") && !error.contains("hidden"), "{error}");
    let head = seen.join().unwrap();
    assert!(head.starts_with("GET http://tiles.invalid/set/tileset.json?key=hidden HTTP/1.1"), "{head}");
    assert!(head.to_ascii_lowercase().contains("x-key: hidden2"), "{head}");
}
