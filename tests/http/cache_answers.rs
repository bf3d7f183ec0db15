//! The answers that the cache on disk stores, and the entries that they replace.

use std::ops::ControlFlow;
use std::path::Path;

use kit::server::{Reply, Server};
use terrane::fetch::{CacheConfig, Credential, HttpClient, HttpConfig, Limits};
use terrane::formats::{FillOptions, fill};

const DATE: &str = "Sun, 09 Sep 2001 01:46:40 GMT";

fn config(folder: &Path) -> HttpConfig {
    HttpConfig { cache: Some(CacheConfig::new(folder)), max_retries: 0, ..HttpConfig::default() }
}

/// Returns the body that a new process gets.
fn get(config: &HttpConfig, url: &str) -> String {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    let client = HttpClient::new(config).unwrap();
    runtime.block_on(async {
        let body = client.get(url, &Limits::default()).await.unwrap();
        client.flush().await;
        String::from_utf8(body.bytes).unwrap()
    })
}

/// Regression: the old body was used and stored with the validator of the new one, so that it would have stayed
/// forever.
#[test]
fn not_modified_with_another_validator_is_requested_again() {
    for (first, second, answers) in [
        ("\"a\"", "\"b\"", ["v1", "v2", "v2"]),
        ("W/\"a\"", "W/\"b\"", ["v1", "v2", "v2"]),
        // The tag is equal by weak comparison.
        ("\"a\"", "W/\"a\"", ["v1", "v1", "v1"]),
    ] {
        let folder = tempfile::tempdir().unwrap();
        let server = Server::start(move |r| match (r.nth, r.header("if-modified-since")) {
            (0, _) => Reply::ok("v1").with("ETag", first).with("Last-Modified", DATE),
            (_, Some(_)) => Reply::new(304, "").with("ETag", second).with("Last-Modified", DATE),
            _ => Reply::ok("v2").with("ETag", second).with("Last-Modified", DATE),
        });
        let config = config(folder.path());
        let got: Vec<String> = (0..2).map(|_| get(&config, &format!("{}/a", server.url))).collect();
        assert_eq!(got, answers[..2], "{first} {second}");
        let requests = if answers[1] == "v2" { 3 } else { 2 };
        assert_eq!(server.count(), requests, "{first} {second}");
        // The stored entry has the validator of its body.
        assert_eq!(get(&config, &format!("{}/a", server.url)), answers[2], "{first} {second}");
    }
}

/// A new answer that must not be stored invalidates the old one. Regression: the old one was used while fresh.
#[test]
fn answer_that_is_not_stored_invalidates_the_old_one() {
    let large = "2".repeat(200_000);
    for (new, how) in [("v2", "no-store"), (large.as_str(), "max-age=1000")] {
        let folder = tempfile::tempdir().unwrap();
        let answer = new.to_owned();
        let server = Server::start(move |r| match (r.path(), r.nth) {
            ("/tileset.json", _) => Reply::ok(
                r#"{"asset":{"version":"1.1"},"geometricError":1,"root":{"geometricError":0,
                "boundingVolume":{"sphere":[0,0,0,1]},"content":{"uri":"a.glb"}}}"#,
            )
            .with("Cache-Control", "max-age=1000"),
            ("/a.glb", 0) => Reply::ok("v1").with("Cache-Control", "max-age=1000"),
            ("/a.glb", _) => Reply::ok(answer.clone()).with("Cache-Control", how),
            // The body is that of the old answer.
            _ => Reply::ok("v1").with("Cache-Control", "max-age=1000"),
        });
        let cache = CacheConfig { max_bytes: Some(1_000_000), ..CacheConfig::new(folder.path()) };
        let config = HttpConfig { cache: Some(cache), ..config(folder.path()) };
        let of = |name: &str| get(&config, &format!("{}/{name}", server.url));
        assert_eq!([of("a.glb"), of("a.glb"), of("other")], ["v1", "v1", "v1"]);
        let refresh = FillOptions { refresh: true, ..FillOptions::default() };
        fill(&format!("{}/tileset.json", server.url), &config, &refresh, &mut |_| ControlFlow::Continue(())).unwrap();
        assert!(of("a.glb") == new, "{how}");
        let asked = server.count();
        assert_eq!(of("other"), "v1");
        assert_eq!(server.count(), asked, "an entry that shares the old body keeps it");
    }
}

/// Regression: only the final answer was checked, so that requests with another credential were redirected like the
/// first.
#[test]
fn redirect_that_varies_by_credentials_is_not_cached() {
    let folder = tempfile::tempdir().unwrap();
    let server = Server::start(|r| match r.path() {
        "/mine" => {
            let to = format!("/of/{}", r.header("authorization").unwrap_or("nobody"));
            let moved = Reply::new(302, "").with("Location", to);
            moved.with("Cache-Control", "max-age=1000").with("Vary", "Authorization")
        }
        path => Reply::ok(path).with("Cache-Control", "max-age=1000"),
    });
    let as_user = |user: &str| {
        let credentials = vec![Credential::header(&server.url, "authorization", user).unwrap()];
        get(&HttpConfig { credentials, ..config(folder.path()) }, &format!("{}/mine", server.url))
    };
    assert_eq!([as_user("a"), as_user("b")], ["/of/a", "/of/b"]);
}
