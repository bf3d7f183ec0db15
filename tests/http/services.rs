//! Services with keys, against a server that speaks their protocols.

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};

use kit::server::{Reply, Server};
use terrane::fetch::services::{IonAsset, ServiceKind, google_tiles};
use terrane::fetch::{HttpClient, HttpConfig, IoError, Limits, RootScope};

fn runtime() -> tokio::runtime::Runtime {
    tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap()
}

/// A server of ion's API and of one asset, whose valid token is `t` and a number.
struct Ion {
    server: Server,
    valid: Arc<AtomicUsize>,
    issued: Arc<AtomicUsize>,
    is_revoked: Arc<AtomicBool>,
}

impl Ion {
    fn start() -> Self {
        let (valid, issued) = (Arc::new(AtomicUsize::new(0)), Arc::new(AtomicUsize::new(0)));
        let (now, count) = (valid.clone(), issued.clone());
        let is_revoked = Arc::new(AtomicBool::new(false));
        let revoked = is_revoked.clone();
        let server = Server::start(move |request| {
            let now = now.load(Ordering::SeqCst);
            match request.target.as_str() {
                "/v1/assets/7/endpoint?access_token=key" if !revoked.load(Ordering::SeqCst) => {
                    count.fetch_add(1, Ordering::SeqCst);
                    let host = request.header("host").unwrap();
                    Reply::ok(format!(
                        r#"{{"type":"3DTILES","url":"http://{host}/7/tileset.json?v=3","accessToken":"t{now}",
                            "attributions":[{{"html":"<b>Survey</b>"}}]}}"#
                    ))
                }
                target if target.contains("/endpoint") => {
                    let is_unknown = target.contains("access_token=key") && !revoked.load(Ordering::SeqCst);
                    Reply::new(if is_unknown { 404 } else { 401 }, "")
                }
                _ if request.header("authorization") == Some(&format!("Bearer t{now}")) => Reply::ok("content"),
                _ => Reply::new(401, ""),
            }
        });
        Self { server, valid, issued, is_revoked }
    }

    fn asset(&self, id: u64, token: &str) -> IonAsset {
        IonAsset { id, token: token.to_owned(), server: self.server.url.clone() }
    }
}

#[test]
fn ion_names_the_set_and_renews_its_token() {
    let ion = Ion::start();
    let source = ion.asset(7, "key").open(&HttpConfig::default()).unwrap();
    assert_eq!((source.kind, &source.attributions[..]), (ServiceKind::Tiles, &["Survey".to_owned()][..]));
    assert_eq!(source.uri, format!("{}/7/tileset.json?v=3", ion.server.url));
    let config = HttpConfig { credentials: source.credentials, ..HttpConfig::default() };
    assert!(!format!("{config:?}").contains("key"));
    let client = HttpClient::new(&config).unwrap().within(&RootScope::of(&source.uri));
    runtime().block_on(async {
        let get = async |path: &str| {
            let url = format!("{}{path}", ion.server.url);
            client.get(&url, &Limits::default()).await.map(|body| body.bytes)
        };
        assert_eq!(get("/7/a").await.unwrap(), b"content");
        assert_eq!(ion.issued.load(Ordering::SeqCst), 1);
        // The token expires while many requests are made: one new token serves all of them.
        ion.valid.store(1, Ordering::SeqCst);
        let mut tasks = tokio::task::JoinSet::new();
        for i in 0..20 {
            let (client, url) = (client.clone(), format!("{}/7/{i}", ion.server.url));
            tasks.spawn(async move { client.get(&url, &Limits::default()).await.unwrap().bytes });
        }
        assert!(tasks.join_all().await.iter().all(|bytes| bytes == b"content"));
        assert_eq!(ion.issued.load(Ordering::SeqCst), 2);
        // Regression: the renewal waited for itself when the service, on the same server, refused the user's key.
        ion.is_revoked.store(true, Ordering::SeqCst);
        ion.valid.store(2, Ordering::SeqCst);
        let refused = tokio::time::timeout(std::time::Duration::from_secs(60), get("/7/b")).await;
        assert!(matches!(refused, Ok(Err(IoError::Status { status: 401, .. }))), "{refused:?}");
    });
}

#[test]
fn refusals_are_errors_without_the_key() {
    let ion = Ion::start();
    let none = IonAsset { server: "http://127.0.0.1:1".to_owned(), ..ion.asset(7, "key") };
    for (asset, expected) in
        [(ion.asset(7, "wrong"), "401"), (ion.asset(8, "key"), "not"), (none, "http://127.0.0.1:1")]
    {
        let http = HttpConfig { max_retries: 0, ..HttpConfig::default() };
        let error = asset.open(&http).unwrap_err().to_string();
        assert!(error.contains(expected) && !error.contains("wrong") && !error.contains("=key"), "{error}");
    }
    // A token that stays refused ends with the refusal.
    let source = ion.asset(7, "key").open(&HttpConfig::default()).unwrap();
    let config = HttpConfig { credentials: source.credentials, ..HttpConfig::default() };
    let client = HttpClient::new(&config).unwrap();
    let refusing = Server::start(|_| Reply::new(401, ""));
    let error = runtime().block_on(client.get(&format!("{}/a", refusing.url), &Limits::default())).unwrap_err();
    assert!(matches!(error, IoError::Status { status: 401, .. }), "{error:?}");
    assert_eq!(ion.issued.load(Ordering::SeqCst), 1, "another server's refusal renews nothing");
}

#[test]
fn google_gets_its_key_and_session_with_each_request() {
    let seen = Arc::new(Mutex::new(Vec::new()));
    let targets = seen.clone();
    let server = Server::start(move |request| {
        targets.lock().unwrap().push(request.target.clone());
        Reply::ok("content")
    });
    let source = google_tiles(&server.url, "secret").unwrap();
    let config = HttpConfig { credentials: source.credentials, ..HttpConfig::default() };
    let scope = RootScope::of(&source.uri);
    let client = HttpClient::new(&config).unwrap().within(&scope);
    let below = |base: &str, reference: &str| terrane::fetch::resolve(base, reference, &scope).unwrap();
    let child = below(&source.uri, "/v1/3dtiles/datasets/a.json?session=s1");
    let tile = below(&child, "files/b.glb");
    runtime().block_on(async {
        for uri in [&source.uri[..], &child, &tile] {
            client.get(uri, &Limits::default()).await.unwrap();
        }
    });
    let expected =
        ["root.json?key=secret", "datasets/a.json?session=s1&key=secret", "datasets/files/b.glb?session=s1&key=secret"];
    assert_eq!(*seen.lock().unwrap(), expected.map(|path| format!("/v1/3dtiles/{path}")));
}
