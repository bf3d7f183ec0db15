//! These tests check where the requests of a client may go, and where its credentials go. Names that resolve to local
//! addresses are tested in `src/fetch/http/client.rs`, whose tests bring their own resolver.

use std::time::Duration;

use kit::server::{Reply, Request, Server};
use terrane::fetch::{Credential, HttpClient, HttpConfig, IoError, Limits, RootScope};

fn config(allowed: &[&str]) -> HttpConfig {
    HttpConfig {
        allowed_hosts: allowed.iter().map(|host| host.parse().unwrap()).collect(),
        retry_backoff: Duration::from_millis(4),
        ..HttpConfig::default()
    }
}

/// Requests a URL for the set whose root is at `root`; without a root for an application.
fn get(config: &HttpConfig, root: Option<&str>, url: &str) -> Result<Vec<u8>, IoError> {
    let client = HttpClient::new(config).unwrap();
    let client = root.map_or(client.clone(), |root| client.within(&RootScope::of(root)));
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(client.get(url, &Limits::default())).map(|body| body.bytes)
}

fn echo(request: &Request) -> Reply {
    Reply::ok(request.target.clone())
}

#[test]
fn sets_reach_their_own_server_and_no_other_local_one() {
    let (own, beside, other) = (Server::start(echo), Server::start(echo), Server::start_at("127.0.0.2", echo));
    let root = format!("{}/set/tileset.json", own.url);
    assert_eq!(get(&config(&[]), Some(&root), &format!("{}/a", own.url)).unwrap(), b"/a");
    for server in [&beside, &other] {
        let url = format!("{}/a", server.url);
        let error = get(&config(&[]), Some(&root), &url).unwrap_err();
        let IoError::HostRefused { uri, host, address, kind } = &error else { panic!("{error:?}") };
        assert_eq!(
            (uri, host.as_str(), address.to_string(), *kind),
            (&url, server.host(), host.rsplit_once(':').unwrap().0.to_owned(), "loopback")
        );
        assert!(error.to_string().contains(&format!("--allow-host {host}")) && !error.is_transient(), "{error}");
        // A set from elsewhere reaches neither.
        for elsewhere in
            ["http://192.0.2.1/set/", "https://tiles.example/set/", "/data/set/tileset.json", "s3://bucket/set/"]
        {
            let error = get(&config(&[]), Some(elsewhere), &format!("{}/a", own.url)).unwrap_err();
            assert!(matches!(error, IoError::HostRefused { .. }), "{elsewhere}: {error:?}");
        }
        let ip = server.host().split(':').next().unwrap();
        for of_another in ["127.0.0.3", &format!("{ip}:{}", server.port() ^ 1), "localhost"] {
            assert!(get(&config(&[of_another]), Some(&root), &url).is_err(), "{of_another}");
        }
        assert_eq!((server.count(), own.count()), (0, 1), "nothing was sent");
        assert_eq!(get(&config(&[server.host()]), Some(&root), &url).unwrap(), b"/a");
        assert_eq!(get(&config(&[ip]), Some(&root), &url).unwrap(), b"/a");
        assert_eq!(server.count(), 2);
    }
}

#[test]
fn addresses_are_refused_in_every_spelling() {
    let server = Server::start(echo);
    let port = server.port();
    for host in [
        "127.0.0.1",
        "2130706433",
        "0x7f.1",
        "0177.0.0.1",
        "127.1",
        "0",
        "[::]",
        "[::1]",
        "[::ffff:127.0.0.1]",
        "[::127.0.0.1]",
        "[64:ff9b::127.0.0.1]",
        "[2002:7f00:1::]",
        "localhost",
        "LocalHost.",
        "a.localhost",
        "me:pass@127.0.0.1",
        "10.0.0.1",
        "192.168.0.1",
        "169.254.169.254",
        "[fd00::1]",
        "[fe80::1]",
        "100.64.0.1",
        "255.255.255.255",
    ] {
        let url = format!("http://{host}:{port}/a");
        let error = get(&config(&[]), Some("http://192.0.2.1/set/"), &url).unwrap_err();
        assert!(matches!(error, IoError::HostRefused { .. }), "{host}: {error:?}");
        assert!(!format!("{error}").contains("pass"), "{error}");
    }
    assert_eq!(server.count(), 0);
    // The own server is found in another spelling too.
    let root = format!("http://127.1:{port}/set/");
    assert_eq!(get(&config(&[]), Some(&root), &format!("http://0x7f000001:{port}/a")).unwrap(), b"/a");
}

#[test]
fn redirects_are_checked_at_each_step() {
    let secret = Server::start_at("127.0.0.2", echo);
    let (to_secret, port) = (format!("{}/secret", secret.url), secret.port());
    let server = Server::start(move |request| match request.path() {
        "/moved" => Reply::new(302, "").with("Location", &to_secret),
        "/odd" => Reply::new(307, "").with("Location", format!("//0x7f.2:{port}/secret")),
        "/twice" => Reply::new(301, "").with("Location", "/moved"),
        "/within" => Reply::new(308, "").with("Location", "/there"),
        _ => echo(request),
    });
    let at = |config: &HttpConfig, path: &str| {
        let url = format!("{}{path}", server.url);
        // An application's own request is followed to as few servers as that of a set.
        let (of_set, own) = (get(config, Some(&server.url), &url), get(config, None, &url));
        assert_eq!(of_set, own, "{path}");
        own
    };
    for path in ["/moved", "/odd", "/twice"] {
        let before = server.count();
        let error = at(&config(&[]), path).unwrap_err();
        assert!(
            matches!(&error, IoError::HostRefused { uri, host, .. } if uri.ends_with(path) && host == secret.host()),
            "{error:?}"
        );
        let requests = if path == "/twice" { 4 } else { 2 };
        assert_eq!((server.count() - before, secret.count()), (requests, 0), "{path} is not retried");
    }
    for (nth, path) in ["/moved", "/odd", "/twice"].into_iter().enumerate() {
        assert_eq!(at(&config(&[secret.host()]), path).unwrap(), b"/secret");
        assert_eq!(secret.count(), 2 * (nth + 1));
    }
    assert_eq!(at(&config(&[]), "/within").unwrap(), b"/there");
}

/// Connections are kept for other sets of the same client. They must not lend their reach.
#[test]
fn open_connections_are_not_used_for_other_sets() {
    let server = Server::start(echo);
    let url = format!("{}/a", server.url);
    let client = HttpClient::new(&config(&[])).unwrap();
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let limits = Limits::default();
        let (own, other) = (client.within(&RootScope::of(&url)), client.within(&RootScope::of("http://192.0.2.1/")));
        assert!(own.get(&url, &limits).await.is_ok());
        assert!(matches!(other.get(&url, &limits).await, Err(IoError::HostRefused { .. })));
        assert!(own.get(&url, &limits).await.is_ok());
    });
    assert_eq!(server.seen().iter().map(|r| r.connection).collect::<Vec<_>>(), [0, 0]);
}

#[test]
fn archives_are_refused_like_other_files() {
    let (own, other) = (Server::start(echo), Server::start_at("127.0.0.2", echo));
    for name in ["a.3tz/tileset.json", "a.zip/b.glb", "a.pmtiles/0/0/0"] {
        let error = get(&config(&[]), Some(&own.url), &format!("{}/{name}", other.url)).unwrap_err();
        assert!(matches!(error, IoError::HostRefused { .. }), "{error:?}");
    }
    assert_eq!(other.count(), 0);
}

#[test]
fn http2_is_checked_too() {
    let server = Server::start(echo);
    let config = HttpConfig { http2_only: true, ..config(&[]) };
    let error = get(&config, Some("http://192.0.2.1/"), &server.url).unwrap_err();
    assert!(matches!(error, IoError::HostRefused { .. }) && server.count() == 0, "{error:?}");
}

/// Every kind of credential, for every way to another origin: a redirect, a reference of a set, another port, a name.
#[test]
fn credentials_stay_at_their_origin() {
    let secrets = |request: &Request| {
        let headers =
            request.headers.iter().filter(|(name, _)| matches!(name.as_str(), "authorization" | "x-key" | "cookie"));
        let all: Vec<String> = headers.map(|(name, value)| format!("{name}: {value}")).collect();
        (request.target.clone(), all)
    };
    for address in ["127.0.0.1", "127.0.0.2"] {
        let other = Server::start_at(address, echo);
        let to_other = format!("{}/there", other.url);
        let server = Server::start(move |request| match request.path() {
            "/away" => Reply::new(302, "").with("Location", &to_other),
            "/again" => Reply::new(302, "").with("Location", "/tile"),
            _ => echo(request).with("Set-Cookie", "session=cookie"),
        });
        let config = HttpConfig {
            credentials: vec![
                Credential::header(&server.url, "X-Key", "header").unwrap(),
                Credential::query(&server.url, "token", "query").unwrap(),
            ],
            ..config(&[other.host()])
        };
        let root = format!("http://me:pass@{}/tileset.json?key=root", server.host());
        let client = HttpClient::new(&config).unwrap().within(&RootScope::of(&root));
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        let to = |reference: &str| terrane::fetch::resolve(&root, reference, &RootScope::of(&root)).unwrap();
        let get = |url: &str| runtime.block_on(client.get(url, &Limits::default())).map(|body| body.bytes).unwrap();
        get(&root);
        get(&to("tile"));
        get(&to("again"));
        let own = server.seen();
        let basic = "authorization: Basic bWU6cGFzcw==".to_owned();
        let all = |cookie: bool| {
            let mut all = vec![basic.clone(), "x-key: header".to_owned()];
            all.extend(cookie.then(|| "cookie: session=cookie".to_owned()));
            all.sort();
            all
        };
        let sorted = |request: &Request| {
            let (target, mut all) = secrets(request);
            all.sort();
            (target, all)
        };
        assert_eq!(sorted(&own[0]), ("/tileset.json?key=root&token=query".to_owned(), all(false)));
        assert_eq!(sorted(&own[1]), ("/tile?key=root&token=query".to_owned(), all(true)));
        assert_eq!(sorted(&own[2]), ("/again?key=root&token=query".to_owned(), all(true)));
        // A redirect names all that it leads to, except what belongs to the server.
        assert_eq!(own[3].target, "/tile?token=query");
        for url in [to("away"), to(&format!("{}/there", other.url)), to(&format!("//{}/there", other.host()))] {
            assert_eq!(get(&url), b"/there", "{url}");
        }
        for request in other.seen() {
            assert_eq!(secrets(&request), ("/there".to_owned(), Vec::new()));
            assert_eq!(request.header("referer"), None);
        }
        assert_eq!(other.count(), 3);
    }
}
