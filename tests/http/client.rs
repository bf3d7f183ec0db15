//! The HTTP client with local servers: retries, pauses, redirects, credentials, proxies, HTTP/2.

use std::time::{Duration, Instant, SystemTime};

use kit::server::{How, Reply, Server};
use terrane::fetch::{Credential, HttpBody, HttpClient, HttpConfig, IoError, Limits, RootScope};

const MS: Duration = Duration::from_millis(1);

/// The timeout of requests to servers that answer: it does not end on a busy machine either.
const LONG: Duration = Duration::from_secs(60);

fn quick() -> HttpConfig {
    HttpConfig {
        first_byte_timeout: LONG,
        read_timeout: LONG,
        retry_backoff: 4 * MS,
        max_wait: 1500 * MS,
        ..HttpConfig::default()
    }
}

fn runtime() -> tokio::runtime::Runtime {
    tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap()
}

fn get_with(config: &HttpConfig, url: &str) -> Result<HttpBody, IoError> {
    let client = HttpClient::new(config).unwrap();
    runtime().block_on(client.get(url, &Limits::default()))
}

fn get(url: &str) -> Result<HttpBody, IoError> {
    get_with(&quick(), url)
}

#[test]
fn connections_are_reused() {
    let server = Server::start(|r| Reply::ok(r.target.clone()).how(if r.nth == 0 { How::Whole } else { How::Chunked }));
    let client = HttpClient::new(&quick()).unwrap();
    runtime().block_on(async {
        for i in 0..10 {
            let body = client.get(&format!("{}/{}", server.url, i % 5), &Limits::default()).await.unwrap();
            assert_eq!((body.bytes, body.network_bytes), (format!("/{}", i % 5).into_bytes(), 2));
        }
    });
    assert!(server.seen().iter().all(|r| r.connection == 0), "{:?}", server.seen());
    assert_eq!(server.seen()[0].header("accept-encoding"), Some("zstd, br, gzip"));
}

#[test]
fn failures_and_redirects_keep_the_connection() {
    let server = Server::start(|r| match r.path() {
        "/gone" => Reply::new(404, "There is nothing here."),
        "/moved" => Reply::new(302, "Over there.").with("Location", "/x"),
        _ => Reply::ok("body"),
    });
    let client = HttpClient::new(&quick()).unwrap();
    runtime().block_on(async {
        for path in ["gone", "moved", "x", "gone", "x"] {
            let result = client.get(&format!("{}/{path}", server.url), &Limits::default()).await;
            assert_eq!(result.is_ok(), path != "gone");
        }
    });
    assert!(server.seen().iter().all(|r| r.connection == 0), "{:?}", server.seen());
}

/// Regression: contents of servers that answer 201, or 206 without being asked for a range, were lost.
#[test]
fn whole_bodies_of_other_statuses_are_read() {
    let server = Server::start(|r| match r.path() {
        "/201" => Reply::new(201, "whole"),
        "/203" => Reply::new(203, "whole"),
        "/206" => Reply::new(206, "whole"),
        "/all" => Reply::new(206, "whole").with("Content-Range", "bytes 0-4/5"),
        "/begin" => Reply::new(206, "whole").with("Content-Range", "bytes 0-4/9"),
        "/end" => Reply::new(206, "whole").with("Content-Range", "bytes 4-8/9"),
        "/open" => Reply::new(206, "whole").with("Content-Range", "bytes 0-4/*"),
        _ => Reply::new(206, "whole").with("Content-Range", "bytes 0-18446744073709551615/5"),
    });
    for path in ["201", "203", "206", "all"] {
        assert_eq!(get(&format!("{}/{path}", server.url)).unwrap().bytes, b"whole", "{path}");
    }
    for path in ["begin", "end", "open", "odd"] {
        let error = get(&format!("{}/{path}", server.url)).unwrap_err();
        assert!(error.reason().contains("a part of the file that was not asked for (bytes "), "{path}: {error}");
    }
}

/// Returns what clones of a client get that ask for a URL at the same time.
async fn at_once(client: &HttpClient, url: &str, count: usize) -> Vec<Result<HttpBody, IoError>> {
    let mut tasks = tokio::task::JoinSet::new();
    for _ in 0..count {
        let (client, url) = (client.clone(), url.to_owned());
        tasks.spawn(async move { client.get(&url, &Limits::default()).await });
    }
    tasks.join_all().await
}

/// Regression: each scene sent a request of its own for the same tile.
#[test]
fn equal_requests_at_the_same_time_are_one() {
    let server = Server::start(|r| {
        let status = if r.path() == "/a" { 200 } else { 403 };
        let mut reply = Reply::new(status, format!("{}", r.nth));
        reply.delay = 100 * MS;
        reply
    });
    let (client, a) = (HttpClient::new(&quick()).unwrap(), format!("{}/a", server.url));
    runtime().block_on(async {
        let bodies: Vec<HttpBody> = at_once(&client, &a, 5).await.into_iter().map(Result::unwrap).collect();
        assert!(bodies.iter().all(|body| body.bytes == b"0"));
        assert_eq!(bodies.iter().map(|body| body.network_bytes).sum::<u64>(), 1, "bytes are counted once");
        assert_eq!(bodies.iter().filter(|body| body.asked).count(), 1);
        assert_eq!(client.get(&a, &Limits::default()).await.unwrap().bytes, b"1", "a later request asks");
        let errors = at_once(&client, &format!("{}/b", server.url), 5).await;
        assert!(errors.iter().all(|error| matches!(error, Err(IoError::Status { status: 403, .. }))), "{errors:?}");
        assert_eq!(server.count(), 3);
        // Another set may not reach this server, whoever else asks it.
        let stranger = client.within(&RootScope::of("http://8.8.8.8/tileset.json"));
        let (own, refused) = tokio::join!(at_once(&client, &a, 1), at_once(&stranger, &a, 1));
        assert!(own[0].is_ok() && matches!(refused[0], Err(IoError::HostRefused { .. })), "{refused:?}");
    });
}

/// A content that is no longer wanted does not take the request of another one with it.
#[test]
fn waiting_request_takes_over_from_an_aborted_one() {
    let server = Server::start(|r| Reply::ok("body").how(if r.nth == 0 { How::Silent } else { How::Whole }));
    let client = HttpClient::new(&quick()).unwrap();
    runtime().block_on(async {
        let get = || {
            let (client, url) = (client.clone(), server.url.clone());
            tokio::spawn(async move { client.get(&url, &Limits::default()).await })
        };
        let first = get();
        while server.count() == 0 {
            tokio::time::sleep(MS).await;
        }
        let second = get();
        tokio::time::sleep(20 * MS).await;
        assert_eq!(server.count(), 1, "it waits");
        first.abort();
        assert_eq!(second.await.unwrap().unwrap().bytes, b"body");
        assert_eq!(server.count(), 2);
    });
}

#[test]
fn many_requests_share_few_http2_connections() {
    let (address, connections) = http2_server(0);
    let client = HttpClient::new(&HttpConfig { http2_only: true, ..quick() }).unwrap();
    runtime().block_on(async {
        let mut tasks = tokio::task::JoinSet::new();
        for i in 0..50 {
            let (client, url) = (client.clone(), format!("http://{address}/{i}"));
            tasks.spawn(async move { (i, client.get(&url, &Limits::default()).await.unwrap().bytes) });
        }
        while let Some(done) = tasks.join_next().await {
            let (i, bytes) = done.unwrap();
            assert_eq!(bytes, format!("HTTP/2.0 /{i}").into_bytes());
        }
    });
    assert_eq!(connections.load(std::sync::atomic::Ordering::Relaxed), 1);
}

/// Regression: answers that were lost because another one ended their connection counted as failures of their own.
#[test]
fn requests_survive_lost_http2_connections() {
    let (address, connections) = http2_server(6);
    let get = |max_retries| {
        let client = HttpClient::new(&HttpConfig { http2_only: true, max_retries, ..quick() }).unwrap();
        runtime().block_on(client.get(&format!("http://{address}/a"), &Limits::default()))
    };
    assert!(matches!(get(0), Err(IoError::Network { .. })), "nothing is retried without retries");
    assert_eq!(get(1).unwrap().bytes, b"HTTP/2.0 /a");
    assert_eq!(connections.load(std::sync::atomic::Ordering::Relaxed), 7);
    let (address, connections) = http2_server(usize::MAX);
    let client = HttpClient::new(&HttpConfig { http2_only: true, max_retries: 1, ..quick() }).unwrap();
    let got = runtime().block_on(client.get(&format!("http://{address}/a"), &Limits::default()));
    assert!(matches!(got, Err(IoError::Network { .. })), "{got:?}");
    assert_eq!(connections.load(std::sync::atomic::Ordering::Relaxed), 16 + 2, "they are not repeated forever");
}

/// Answers with the version and path of each request, and counts connections. The first `lost` connections end with the first
/// request.
fn http2_server(lost: usize) -> (std::net::SocketAddr, std::sync::Arc<std::sync::atomic::AtomicUsize>) {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    listener.set_nonblocking(true).unwrap();
    let address = listener.local_addr().unwrap();
    let connections = std::sync::Arc::new(std::sync::atomic::AtomicUsize::new(0));
    let count = connections.clone();
    std::thread::spawn(move || {
        runtime().block_on(async move {
            let listener = tokio::net::TcpListener::from_std(listener).unwrap();
            loop {
                let (stream, _) = listener.accept().await.unwrap();
                let is_lost = count.fetch_add(1, std::sync::atomic::Ordering::Relaxed) < lost;
                tokio::spawn(async move {
                    let mut connection = h2::server::handshake(stream).await.unwrap();
                    if is_lost {
                        let _ = connection.accept().await;
                        return;
                    }
                    while let Some(Ok((request, mut respond))) = connection.accept().await {
                        let text = format!("{:?} {}", request.version(), request.uri().path());
                        let mut body = respond.send_response(http::Response::new(()), false).unwrap();
                        body.send_data(text.into_bytes().into(), true).unwrap();
                    }
                });
            }
        });
    });
    (address, connections)
}

#[test]
fn only_transient_failures_are_retried() {
    let asked = |reply: Reply| {
        let first = reply.clone();
        let server = Server::start(move |r| if r.nth == 0 { first.clone() } else { Reply::ok("body") });
        let result = get(&format!("{}/x", server.url));
        (result.map(|b| b.bytes), server.count())
    };
    let whole = (Ok(b"body".to_vec()), 2);
    for status in [408, 429, 500, 502, 503, 504] {
        assert_eq!(asked(Reply::new(status, "")), whole, "{status}");
    }
    for how in [How::Cut, How::Reset] {
        assert_eq!(asked(Reply::ok("a long body").how(how)), whole, "{how:?}");
    }
    // These end with a timeout, within which the second answer has to arrive too.
    for how in [How::Stall, How::Silent] {
        let server = Server::start(move |r| Reply::ok("a long body").how(if r.nth == 0 { how } else { How::Whole }));
        let config = HttpConfig { first_byte_timeout: 1500 * MS, read_timeout: 1500 * MS, max_retries: 9, ..quick() };
        assert_eq!(get_with(&config, &server.url).unwrap().bytes, b"a long body", "{how:?}");
        assert!(server.count() >= 2, "{how:?}");
    }
    for status in [304, 400, 401, 403, 404, 410, 416, 451] {
        let (result, count) = asked(Reply::new(status, ""));
        assert!(result.is_err() && count == 1, "{status}: {result:?} {count}");
    }
    // Without a listening server the request is retried and then reported.
    let port = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    assert!(matches!(get(&format!("http://127.0.0.1:{port}/")), Err(IoError::Network { .. })));
}

#[test]
fn retries_are_limited() {
    let server = Server::start(|_| Reply::new(500, ""));
    let result = get_with(&HttpConfig { max_retries: 3, ..quick() }, &format!("{}/x", server.url));
    assert!(matches!(result, Err(IoError::Status { status: 500, .. })), "{result:?}");
    assert_eq!(server.count(), 4);
}

#[test]
fn each_timeout_names_its_phase() {
    let server =
        Server::start(|r| Reply::ok("a long body").how(if r.target == "/silent" { How::Silent } else { How::Stall }));
    let config = HttpConfig { max_retries: 0, ..quick() };
    let first = HttpConfig { first_byte_timeout: 100 * MS, ..config.clone() };
    let rest = HttpConfig { read_timeout: 100 * MS, ..config.clone() };
    let whole = HttpConfig { total_timeout: 100 * MS, ..config };
    let phase = |config: &HttpConfig, path: &str| match get_with(config, &format!("{}{path}", server.url)) {
        Err(IoError::Timeout { phase, .. }) => phase,
        other => panic!("{other:?}"),
    };
    assert_eq!(phase(&first, "/silent"), "waiting for the answer");
    assert_eq!(phase(&rest, "/stall"), "reading the answer");
    assert_eq!(phase(&whole, "/stall"), "the whole answer");
}

/// The backlog of the listening socket is full, so that the server does not answer.
#[cfg(target_os = "linux")]
#[test]
fn connection_timeout_names_its_phase() {
    let listener = runtime().block_on(async {
        let socket = tokio::net::TcpSocket::new_v4().unwrap();
        socket.bind("127.0.0.1:0".parse().unwrap()).unwrap();
        socket.listen(1).unwrap().into_std().unwrap()
    });
    let address = listener.local_addr().unwrap();
    let connect = || std::net::TcpStream::connect_timeout(&address, 300 * MS);
    let waiting: Vec<_> = (0..100).map_while(|_| connect().ok()).collect();
    assert!(waiting.len() < 100);
    let config = HttpConfig { connect_timeout: 200 * MS, first_byte_timeout: 60_000 * MS, max_retries: 0, ..quick() };
    match get_with(&config, &format!("http://{address}/a")) {
        Err(IoError::Timeout { phase, seconds, .. }) => assert_eq!((phase, seconds), ("connecting", 0.2)),
        other => panic!("{other:?}"),
    }
}

/// Large bodies arrive over a slow connection: the timeout limits silence, not the whole transfer.
#[test]
fn steady_transfers_may_exceed_the_timeout() {
    let server = Server::start(|_| Reply::ok([7; 40]).how(How::Slowly));
    let get = |min_bytes_per_s| {
        let config = HttpConfig { total_timeout: 100 * MS, min_bytes_per_s, max_retries: 0, ..quick() };
        get_with(&config, &server.url)
    };
    for rate in [0, 1] {
        // On a busy machine the first byte may come after the timeout.
        let whole = (0..20).find_map(|_| get(rate).ok()).unwrap();
        assert_eq!(whole.bytes.len(), 40, "{rate}");
    }
    let slower = get(100_000);
    assert!(matches!(slower, Err(IoError::Timeout { phase: "the whole answer", .. })), "{slower:?}");
}

#[test]
fn retry_after_is_respected() {
    let times = std::sync::Mutex::new(Vec::new());
    let server = Server::start(move |r| {
        times.lock().unwrap().push(Instant::now());
        match (r.target.as_str(), r.nth) {
            ("/seconds", 0) => Reply::new(429, "").with("Retry-After", "1"),
            ("/date", 0) => {
                let at = SystemTime::now() + Duration::from_secs(2);
                Reply::new(503, "").with("Retry-After", httpdate::fmt_http_date(at))
            }
            ("/never", _) => Reply::new(503, "").with("Retry-After", "3600"),
            _ => Reply::ok("body"),
        }
    });
    for path in ["seconds", "date"] {
        let start = Instant::now();
        // A date has whole seconds, so of two seconds more than one is left.
        get_with(&HttpConfig { max_wait: 5000 * MS, ..quick() }, &format!("{}/{path}", server.url)).unwrap();
        assert!(start.elapsed() >= 950 * MS, "{path}: {:?}", start.elapsed());
    }
    let before = server.count();
    let error = get(&format!("{}/never", server.url)).unwrap_err();
    assert_eq!(error.retry_after(), Some(Duration::from_secs(3600)));
    assert_eq!(server.count() - before, 1, "a pause above the limit: not requested again");
}

#[test]
fn pause_applies_to_all_requests_to_the_server() {
    let server = Server::start(|r| match (r.target.as_str(), r.nth) {
        ("/first", 0) => Reply::new(429, "").with("Retry-After", "1"),
        _ => Reply::ok("body"),
    });
    let client = HttpClient::new(&HttpConfig { max_retries: 0, ..quick() }).unwrap();
    runtime().block_on(async {
        let limits = Limits::default();
        let start = Instant::now();
        assert!(client.get(&format!("{}/first", server.url), &limits).await.is_err());
        client.get(&format!("{}/second", server.url), &limits).await.unwrap();
        assert!(start.elapsed() > 800 * MS, "{:?}", start.elapsed());
    });
}

/// Regression: the pause was applied to the redirecting server instead of the one that asked for it.
#[test]
fn pause_applies_to_the_server_that_asked_for_it() {
    let other = Server::start(|_| Reply::new(503, "").with("Retry-After", "600"));
    let to_other = format!("{}/there", other.url);
    let server = Server::start(move |r| match r.path() {
        "/moved" => Reply::new(302, "").with("Location", &to_other),
        _ => Reply::ok("body"),
    });
    let client =
        HttpClient::new(&HttpConfig { allowed_hosts: vec![other.host().parse().unwrap()], ..quick() }).unwrap();
    runtime().block_on(async {
        let limits = Limits::default();
        let moved = format!("{}/moved", server.url);
        assert!(client.get(&moved, &limits).await.is_err());
        client.get(&format!("{}/own", server.url), &limits).await.unwrap();
        let direct = client.get(&format!("{}/direct", other.url), &limits).await.unwrap_err();
        let again = client.get(&moved, &limits).await.unwrap_err();
        for error in [direct, again] {
            assert!(error.retry_after().is_some_and(|left| left > Duration::from_secs(500)), "{error:?}");
        }
    });
    assert_eq!((other.count(), server.count()), (1, 3), "the pause applies to all redirects to that server");
}

/// Regression: a pause was cut to the maximum wait of a request. Then all waiting requests were sent at once,
/// repeatedly.
#[test]
fn long_pause_is_respected_without_requests() {
    let server = Server::start(|r| match r.target.as_str() {
        "/first" => Reply::new(503, "").with("Retry-After", "600"),
        _ => Reply::ok("body"),
    });
    let client = HttpClient::new(&HttpConfig { max_wait: 20 * MS, ..quick() }).unwrap();
    runtime().block_on(async {
        let limits = Limits::default();
        assert!(client.get(&format!("{}/first", server.url), &limits).await.is_err());
        tokio::time::sleep(50 * MS).await;
        for k in 0..5 {
            let error = client.get(&format!("{}/{k}", server.url), &limits).await.unwrap_err();
            assert!(matches!(error, IoError::Status { status: 503, .. }), "{error}");
            assert!(error.retry_after().is_some_and(|left| left > Duration::from_secs(500)), "{error:?}");
        }
    });
    assert_eq!(server.count(), 1);
}

#[test]
fn redirects_are_followed_to_http_only() {
    let other = Server::start(|r| Reply::ok(format!("other {}", r.target)));
    let to_other = format!("{}/there?a=b", other.url);
    let server = Server::start(move |r| match r.target.as_str() {
        "/relative" => Reply::new(307, "").with("Location", "sub/next"),
        "/sub/next" => Reply::new(301, "").with("Location", &to_other),
        "/file" => Reply::new(302, "").with("Location", "file:///etc/passwd"),
        "/data" => Reply::new(302, "").with("Location", "data:text/plain,x"),
        "/loop" => Reply::new(308, "").with("Location", "/loop"),
        "/odd" => Reply::new(302, "").with("Location", "http://[::1"),
        "/nowhere" => Reply::new(302, ""),
        _ => Reply::new(404, ""),
    });
    let config = HttpConfig { allowed_hosts: vec![other.host().parse().unwrap()], ..quick() };
    let at = |path: &str| get_with(&config, &format!("{}{path}", server.url));
    assert_eq!(at("/relative").unwrap().bytes, b"other /there?a=b");
    for path in ["/file", "/data", "/loop", "/odd"] {
        let error = at(path).unwrap_err();
        assert!(matches!(error, IoError::Uri { .. }) && error.uri().ends_with(path), "{path}: {error:?}");
    }
    assert!(matches!(at("/nowhere"), Err(IoError::Status { status: 302, .. })));
    assert_eq!(server.seen().iter().filter(|r| r.target == "/loop").count(), 9, "eight redirects");
}

#[test]
fn credentials_are_sent_to_their_server_only_and_never_printed() {
    let other = Server::start(|r| Reply::ok(r.target.clone()));
    let to_other = format!("{}/there", other.url);
    let server = Server::start(move |r| match r.path() {
        "/away" => Reply::new(302, "").with("Location", &to_other),
        "/again" => Reply::new(302, "").with("Location", "/tile"),
        "/tile" if r.header("x-api-key") == Some("hidden1") => Reply::ok(r.target.clone()),
        _ => Reply::new(401, ""),
    });
    let config = HttpConfig {
        credentials: vec![
            Credential::header(&server.url, "X-Api-Key", "hidden1").unwrap(),
            Credential::query(&server.url, "token", "hidden 2").unwrap(),
        ],
        allowed_hosts: vec![other.host().parse().unwrap()],
        ..quick()
    };
    let at = |path: &str| get_with(&config, &format!("{}{path}", server.url));
    assert_eq!(at("/tile").unwrap().bytes, b"/tile?token=hidden+2");
    assert_eq!(at("/tile?v=1").unwrap().bytes, b"/tile?v=1&token=hidden+2");
    assert_eq!(at("/tile?token=own").unwrap().bytes, b"/tile?token=own", "the set's own");
    assert_eq!(at("/again").unwrap().bytes, b"/tile?token=hidden+2", "after a redirect as well");
    assert_eq!(at("/away").unwrap().bytes, b"/there");
    assert!(other.seen().iter().all(|r| r.header("x-api-key").is_none()), "{:?}", other.seen());
    let refused = at("/none?session=hidden3").unwrap_err();
    let nobody = get_with(&config, "http://127.0.0.1:1/x?session=hidden3").unwrap_err();
    for error in [refused, nobody] {
        let text = format!("{error} {}", error.reason());
        assert!(!text.contains("hidden") && text.contains("session=..."), "{text}");
    }
}

#[test]
fn sizes_are_limited_before_and_after_decompression() {
    let gzip = |length: usize| {
        use std::io::Write as _;
        let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::best());
        encoder.write_all(&vec![7; length]).unwrap();
        encoder.finish().unwrap()
    };
    let server = Server::start(move |r| match r.target.as_str() {
        "/announced" => Reply::ok(vec![0; 20_000]),
        "/chunked" => Reply::ok(vec![0; 20_000]).how(How::Chunked),
        "/bomb" => Reply::ok(gzip(10_000_000)).with("Content-Encoding", "gzip"),
        "/packed" => Reply::ok(gzip(9_000)).with("Content-Encoding", "gzip"),
        _ => Reply::ok("x").with("Content-Encoding", "compress"),
    });
    let limits = Limits { max_file_bytes: 10_000, ..Limits::default() };
    let client = HttpClient::new(&quick()).unwrap();
    let runtime = runtime();
    let at = |path: &str| runtime.block_on(client.get(&format!("{}{path}", server.url), &limits));
    for path in ["/announced", "/chunked", "/bomb"] {
        assert!(matches!(at(path), Err(IoError::TooLarge { .. })), "{path}");
    }
    assert!(matches!(at("/compressed"), Err(IoError::Unsupported { .. })));
    let body = at("/packed").unwrap();
    assert!(body.bytes.len() == 9_000 && body.network_bytes < 100, "{}", body.network_bytes);
}
