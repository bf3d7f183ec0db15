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

/// Sends each answer to the user that the request names, and lets it be stored for long.
fn server_of_users() -> Server {
    Server::start(|r| {
        let query = r.target.split_once("key=").map_or("", |(_, key)| key);
        let user = r.header("authorization").or(r.header("x-key")).unwrap_or(query).to_owned();
        let by_vary = r.path().strip_prefix("/vary/").unwrap_or("accept-encoding").to_owned();
        let control = if r.path() == "/private" { "private, max-age=1000" } else { "max-age=1000" };
        Reply::ok(format!("of {user}")).with("Cache-Control", control).with("Vary", by_vary)
    })
}

/// Regression: keys were the URI alone, so that one user got the tiles of another from a common folder.
#[test]
fn users_do_not_see_the_answers_of_others() {
    let (server, folder) = (server_of_users(), tempfile::tempdir().unwrap());
    let url = format!("{}/a", server.url);
    let header = |name: &str, value: &str| vec![Credential::header(&server.url, name, value).unwrap()];
    let query = |value: &str| vec![Credential::query(&server.url, "key", value).unwrap()];
    let of = |credentials: &[Credential]| {
        get(&HttpConfig { credentials: credentials.to_vec(), ..config(folder.path()) }, &url)
    };
    let users = [
        (Vec::new(), "of "),
        (header("authorization", "Bearer one"), "of Bearer one"),
        (header("authorization", "Bearer two"), "of Bearer two"),
        (header("x-key", "one"), "of one"),
        (query("three"), "of three"),
        (query("four"), "of four"),
    ];
    for round in 0..2 {
        for (credentials, body) in &users {
            assert_eq!(of(credentials), *body, "round {round}");
        }
        assert_eq!(server.count(), users.len(), "each user has an entry, round {round}");
    }
    // Neither the keys nor a hash of them that anyone could compute is on the disk.
    for path in files(folder.path()) {
        let (name, bytes) = (path.display().to_string(), std::fs::read(&path).unwrap());
        let text = String::from_utf8_lossy(&bytes);
        assert!(
            name.contains("blobs") || ["one", "two", "three", "four"].iter().all(|key| !text.contains(key)),
            "{name}"
        );
    }
}

fn files(folder: &Path) -> Vec<std::path::PathBuf> {
    let paths = std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path());
    paths.flat_map(|p| if p.is_dir() { files(&p) } else { vec![p] }).collect()
}

/// Regression: several users may share the folder, and `private` answers were stored.
#[test]
fn private_answers_and_those_that_vary_by_cookies_are_not_stored() {
    for (path, requests) in [("a", 1), ("private", 2), ("vary/Accept, *", 2), ("vary/Cookie", 2), ("vary/origin", 1)] {
        let (server, folder) = (server_of_users(), tempfile::tempdir().unwrap());
        let credentials = vec![Credential::header(&server.url, "authorization", "me").unwrap()];
        let config = HttpConfig { credentials, ..config(folder.path()) };
        let url = format!("{}/{}", server.url, path.replace(' ', ""));
        assert_eq!([get(&config, &url), get(&config, &url)], ["of me", "of me"], "{path}");
        assert_eq!(server.count(), requests, "{path}");
    }
}

/// Regression: only the final answer was checked, so that requests with another credential were redirected like the
/// first.
#[test]
fn redirects_depend_on_credentials() {
    let folder = tempfile::tempdir().unwrap();
    let server = Server::start(|r| match r.path() {
        "/mine" => {
            let to = format!("/of/{}", r.header("authorization").unwrap_or("nobody"));
            Reply::new(302, "").with("Location", to).with("Cache-Control", "max-age=1000")
        }
        path => Reply::ok(path).with("Cache-Control", "max-age=1000"),
    });
    let as_user = |user: &str| {
        let credentials = vec![Credential::header(&server.url, "authorization", user).unwrap()];
        get(&HttpConfig { credentials, ..config(folder.path()) }, &format!("{}/mine", server.url))
    };
    assert_eq!([as_user("a"), as_user("b"), as_user("a")], ["/of/a", "/of/b", "/of/a"]);
    assert_eq!(server.count(), 4);
}

/// The key of an entry has the credentials of the first server only.
#[test]
fn answer_behind_a_redirect_to_a_server_with_credentials_is_not_stored() {
    let folder = tempfile::tempdir().unwrap();
    let other = Server::start(|r| {
        let user = r.header("authorization").unwrap_or("nobody").to_owned();
        Reply::ok(user).with("Cache-Control", "max-age=1000")
    });
    let to = format!("{}/a", other.url);
    let server = Server::start(move |_| Reply::new(301, "").with("Location", &to));
    let url = format!("{}/a", server.url);
    for (credentials, body, requests) in [
        (vec![Credential::header(&other.url, "authorization", "one").unwrap()], "one", 2),
        (vec![Credential::header(&other.url, "authorization", "two").unwrap()], "two", 2),
        (Vec::new(), "nobody", 1),
    ] {
        let allowed_hosts = vec!["127.0.0.1".parse().unwrap()];
        let config = HttpConfig { credentials, allowed_hosts, ..config(folder.path()) };
        let before = other.count();
        assert_eq!([get(&config, &url), get(&config, &url)], [body, body]);
        assert_eq!(other.count() - before, requests, "{body}");
    }
}
