//! `terrane serve` over HTTP/2 and TLS: the same answers, and the same faults for the same seed.

use std::future::Future;
use std::path::Path;
use std::process::Command;
use std::sync::Arc;
use std::time::{Duration, Instant};

use crate::serve::served::Server;
use h2::client::{Builder, SendRequest};
use h2::{Reason, RecvStream};
use http::{HeaderMap, Request};
use terrane::fetch::{HttpClient, HttpConfig, IoError, Limits};
use tokio::net::TcpStream;
use tokio_rustls::TlsConnector;
use tokio_rustls::rustls::pki_types::pem::PemObject as _;
use tokio_rustls::rustls::pki_types::{CertificateDer, ServerName};
use tokio_rustls::rustls::{ClientConfig, RootCertStore, crypto};

type Sender = SendRequest<std::io::Cursor<Vec<u8>>>;

/// The timeout of a test, after which an answer counts as missing.
fn within<T>(future: impl Future<Output = T>) -> T {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async { tokio::time::timeout(Duration::from_secs(60), future).await.expect("it hangs") })
}

async fn connect(server: &Server, builder: &Builder) -> Sender {
    let stream = TcpStream::connect(&server.address).await.unwrap();
    let (sender, connection) = builder.handshake(stream).await.unwrap();
    // The task ends with the connection or with the test.
    tokio::spawn(connection);
    sender.ready().await.unwrap()
}

/// The received part of an answer, and its end.
#[derive(Debug, Default)]
struct Got {
    status: u16,
    headers: HeaderMap,
    body: Vec<u8>,
    error: Option<h2::Error>,
}

async fn ask(sender: &Sender, method: &str, path: &str, headers: &[(&str, &str)]) -> Got {
    let mut request = Request::builder().method(method).uri(format!("http://x{path}"));
    for (name, value) in headers {
        request = request.header(*name, *value);
    }
    let answer = async {
        let mut sender = sender.clone().ready().await?;
        sender.send_request(request.body(()).unwrap(), true)?.0.await
    };
    let response = match answer.await {
        Ok(response) => response,
        Err(error) => return Got { error: Some(error), ..Got::default() },
    };
    let (head, mut body) = response.into_parts();
    let mut got = Got { status: head.status.as_u16(), headers: head.headers, ..Got::default() };
    while got.error.is_none() {
        match piece(&mut body).await {
            None => break,
            Some(Ok(bytes)) => got.body.extend(bytes),
            Some(Err(error)) => got.error = Some(error),
        }
    }
    got
}

async fn piece(body: &mut RecvStream) -> Option<Result<Vec<u8>, h2::Error>> {
    let bytes = match body.data().await? {
        Ok(bytes) => bytes,
        Err(error) => return Some(Err(error)),
    };
    // Fails if the stream has ended.
    let _ = body.flow_control().release_capacity(bytes.len());
    Some(Ok(bytes.to_vec()))
}

#[test]
fn files_are_served_whole_and_in_parts() {
    let folder = tempfile::tempdir().unwrap();
    let bytes: Vec<u8> = (0..300_000u32).map(|i| (i * 7) as u8).collect();
    std::fs::write(folder.path().join("a b.glb"), &bytes).unwrap();
    std::fs::write(folder.path().join("empty"), "").unwrap();
    let server = Server::start(folder.path(), &["--http2", "--max-age", "9"]);
    within(async {
        let sender = connect(&server, &Builder::new()).await;
        let get = async |headers: &[(&str, &str)]| ask(&sender, "GET", "/a%20b.glb?v=1", headers).await;
        let whole = get(&[]).await;
        assert!(whole.status == 200 && whole.body == bytes && whole.error.is_none(), "{:?}", whole.error);
        let said = |name: &str| whole.headers[name].to_str().unwrap().to_owned();
        assert_eq!((said("content-length"), said("content-type")), ("300000".into(), "model/gltf-binary".into()));
        assert_eq!((said("cache-control"), whole.headers.get("connection")), ("max-age=9".into(), None));
        let part = get(&[("range", "bytes=10-19")]).await;
        assert_eq!((part.status, &part.body[..]), (206, &bytes[10..20]));
        assert_eq!(part.headers["content-range"], "bytes 10-19/300000");
        assert_eq!(get(&[("range", "bytes=300000-")]).await.status, 416);
        let kept = get(&[("if-none-match", &said("etag"))]).await;
        assert!(kept.status == 304 && kept.error.is_none(), "{kept:?}");
        let head = ask(&sender, "HEAD", "/a%20b.glb", &[]).await;
        assert_eq!((head.status, head.body.len(), head.error.is_none()), (200, 0, true));
        let empty = ask(&sender, "GET", "/empty", &[]).await;
        assert_eq!((empty.status, empty.body.len(), empty.error.is_none()), (200, 0, true));
        for (method, path, status) in [("GET", "/none", 404), ("GET", "/%2e%2e/x", 404), ("POST", "/empty", 405)] {
            assert_eq!(ask(&sender, method, path, &[]).await.status, status, "{method} {path}");
        }
    });
}

/// The fault of an answer depends on the seed, not on the version. A reset is that of a stream or of a connection.
#[test]
fn faults_equal_those_of_http_1() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("f"), vec![b'x'; 1000]).unwrap();
    let rates = [["--error-rate", "0.15"], ["--truncate-rate", "0.15"], ["--corrupt-rate", "0.15"]].concat();
    let rates = [&rates[..], &["--reset-rate", "0.3", "--page-rate", "0.1"]].concat();
    let open = Server::start(folder.path(), &rates);
    let first: Vec<_> = (0..80)
        .map(|_| {
            let (status, _, body) = open.ask("GET", "/f", "");
            (status, body.len(), body.iter().filter(|b| **b != b'x').count())
        })
        .collect();
    let server = Server::start(folder.path(), &[&rates[..], &["--http2"]].concat());
    let (mut streams, mut connections) = ([0, 0], [0, 0]);
    within(async {
        let mut sender = connect(&server, &Builder::new()).await;
        for (place, expected) in first.iter().enumerate() {
            let got = ask(&sender, "GET", "/f", &[]).await;
            let bent = got.body.iter().filter(|b| **b != b'x').count();
            let half = usize::from(!got.body.is_empty());
            match &got.error {
                // The client reports that the body was shorter than announced.
                Some(e) if e.is_library() && e.reason() == Some(Reason::PROTOCOL_ERROR) => {
                    assert_eq!(got.body.len(), 500)
                }
                Some(e) if e.is_remote() && e.reason() == Some(Reason::INTERNAL_ERROR) => streams[half] += 1,
                Some(e) if e.is_io() => {
                    connections[half] += 1;
                    sender = connect(&server, &Builder::new()).await;
                }
                Some(e) => panic!("{place}: {e:?}"),
                None => {}
            }
            // A lost connection loses data that the client has not read.
            let is_lost = got.error.as_ref().is_some_and(h2::Error::is_io) && expected.0 <= 200;
            assert!(
                is_lost || (got.status, got.body.len(), bent) == *expected,
                "{place}: {} {} {bent}, {expected:?}",
                got.status,
                got.body.len()
            );
        }
    });
    // Instead of an answer, and half way through it.
    assert!(streams.iter().all(|n| *n > 0) && connections.iter().sum::<i32>() > 1, "{streams:?} {connections:?}");
    for seen in [(200, 1000, 0), (200, 500, 0), (200, 1000, 1), (0, 0, 0)] {
        assert!(first.contains(&seen), "{seen:?}: {first:?}");
    }
}

/// Requests that stop half way or get no answer do not block others on their connection.
#[test]
fn stalled_request_does_not_block_others() {
    let folder = tempfile::tempdir().unwrap();
    (0..100).for_each(|k| std::fs::write(folder.path().join(format!("{k}")), vec![b'x'; 50_000]).unwrap());
    let server = Server::start(folder.path(), &["--http2", "--stall-rate", "0.4", "--silent-rate", "0.2"]);
    within(async {
        let mut builder = Builder::new();
        builder.initial_window_size(20_000).initial_connection_window_size(65_535);
        let sender = connect(&server, &builder).await;
        // Cancelled requests free their slots: a connection has 128 at the same time, and more than that stall in
        // total.
        let mut stopped = 0;
        for _ in 0..3 {
            let mut asked = tokio::task::JoinSet::new();
            for k in 0..100 {
                let sender = sender.clone();
                asked.spawn(async move { ask(&sender, "GET", &format!("/{k}"), &[]).await.body.len() });
            }
            let mut whole = 0;
            while let Ok(Some(ended)) = tokio::time::timeout(Duration::from_secs(2), asked.join_next()).await {
                assert_eq!(ended.unwrap(), 50_000);
                whole += 1;
            }
            assert!((25..=55).contains(&whole) && asked.len() == 100 - whole, "{whole}");
            stopped += asked.len();
        }
        assert!(stopped > 128, "{stopped}");
    });
}

#[test]
fn flow_control_window_of_one_byte_suffices() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("f"), vec![b'x'; 300]).unwrap();
    let server = Server::start(folder.path(), &["--http2"]);
    let got = within(async {
        let sender = connect(&server, Builder::new().initial_window_size(1)).await;
        ask(&sender, "GET", "/f", &[]).await
    });
    assert_eq!((got.status, got.body.len(), got.error.is_none()), (200, 300, true));
}

/// The bandwidth is that of the connection, not of each request.
#[test]
fn requests_share_the_bandwidth() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("f"), vec![b'x'; 4000]).unwrap();
    let server = Server::start(folder.path(), &["--http2", "--bandwidth", "16000", "--latency-ms", "100"]);
    let start = Instant::now();
    within(async {
        let sender = connect(&server, &Builder::new()).await;
        let mut asked = tokio::task::JoinSet::new();
        for _ in 0..4 {
            let sender = sender.clone();
            asked.spawn(async move { assert_eq!(ask(&sender, "GET", "/f", &[]).await.body.len(), 4000) });
        }
        asked.join_all().await;
    });
    assert!(start.elapsed() > Duration::from_millis(1050), "{:?}", start.elapsed());
}

/// Returns the negotiated version, `None` if there is none in common.
async fn agreed(server: &Server, certificate: &Path, offers: &[&str]) -> Option<String> {
    let mut roots = RootCertStore::empty();
    roots.add(CertificateDer::from_pem_file(certificate).unwrap()).unwrap();
    let provider = Arc::new(crypto::ring::default_provider());
    let config = ClientConfig::builder_with_provider(provider).with_safe_default_protocol_versions().unwrap();
    let mut config = config.with_root_certificates(roots).with_no_client_auth();
    config.alpn_protocols = offers.iter().map(|name| name.as_bytes().to_vec()).collect();
    let stream = TcpStream::connect(&server.address).await.unwrap();
    let name = ServerName::try_from("127.0.0.1").unwrap();
    let stream = TlsConnector::from(Arc::new(config)).connect(name, stream).await.ok()?;
    Some(String::from_utf8(stream.get_ref().1.alpn_protocol().unwrap_or_default().to_vec()).unwrap())
}

#[test]
fn encrypted_connections_negotiate_a_version() {
    let folder = tempfile::tempdir().unwrap();
    let bytes = vec![b'x'; 100_000];
    std::fs::write(folder.path().join("f"), &bytes).unwrap();
    let file = folder.path().join("certificate.pem");
    let (both, old, new) = (&["h2", "http/1.1"][..], &["http/1.1"][..], &["h2"][..]);
    for (options, of_both, of_old, of_new) in [
        (&[][..], Some("h2"), Some("http/1.1"), Some("h2")),
        (&["--http1"], Some("http/1.1"), Some("http/1.1"), None),
        (&["--http2"], Some("h2"), None, Some("h2")),
    ] {
        let server = Server::start(folder.path(), &[&["--tls", file.to_str().unwrap()], options].concat());
        assert!(server.url.starts_with("https://127.0.0.1:"), "{}", server.url);
        within(async {
            for (offers, version) in [(both, of_both), (old, of_old), (new, of_new)] {
                assert_eq!(agreed(&server, &file, offers).await.as_deref(), version, "{options:?} {offers:?}");
            }
            let trusting = HttpConfig { root_certificates: vec![file.clone()], ..HttpConfig::default() };
            let get = async |config: &HttpConfig| {
                let client = HttpClient::new(config).unwrap();
                client.get(&format!("{}f", server.url), &Limits::default()).await
            };
            assert_eq!(get(&trusting).await.unwrap().bytes, bytes, "{options:?}");
            let stranger = get(&HttpConfig::default()).await.unwrap_err();
            assert!(matches!(stranger, IoError::Tls { .. }), "{stranger:?}");
        });
    }
}

/// With a client of HTTP/1.1 and one of HTTP/2, both encrypted, the same faults cause errors of the same kind.
#[test]
fn faults_cause_the_same_errors_through_encryption() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("f"), vec![b'x'; 100_000]).unwrap();
    let file = folder.path().join("certificate.pem");
    let long = Duration::from_secs(60);
    let config = HttpConfig {
        root_certificates: vec![file.clone()],
        max_retries: 0,
        first_byte_timeout: long,
        read_timeout: long,
        ..HttpConfig::default()
    };
    // Only where an answer does not arrive the client gives up soon.
    let soon = Duration::from_millis(200);
    let silent = HttpConfig { first_byte_timeout: soon, ..config.clone() };
    let stalled = HttpConfig { read_timeout: soon, ..config.clone() };
    for version in ["--http1", "--http2"] {
        for fault in ["--truncate-rate", "--reset-rate", "--stall-rate", "--silent-rate", "--error-rate"] {
            let server = Server::start(folder.path(), &["--tls", file.to_str().unwrap(), version, fault, "1"]);
            within(async {
                let config = match fault {
                    "--stall-rate" => &stalled,
                    "--silent-rate" => &silent,
                    _ => &config,
                };
                let client = HttpClient::new(config).unwrap();
                for _ in 0..3 {
                    let error = client.get(&format!("{}f", server.url), &Limits::default()).await.unwrap_err();
                    let is_it = match fault {
                        "--error-rate" => matches!(error, IoError::Status { status: 429 | 500 | 503, .. }),
                        "--stall-rate" => matches!(error, IoError::Timeout { phase: "reading the answer", .. }),
                        "--silent-rate" => matches!(error, IoError::Timeout { phase: "waiting for the answer", .. }),
                        _ => matches!(error, IoError::Network { .. }),
                    };
                    assert!(is_it && error.is_transient(), "{version} {fault}: {error:?}");
                }
            });
        }
    }
}

#[test]
fn invalid_arguments_are_reported() {
    for (arguments, code, word) in [
        (&["--http1", "--http2"][..], 2, "--http2"),
        (&["--tls", "/no/such/folder/certificate.pem"], 1, "/no/such/folder/certificate.pem"),
    ] {
        let out =
            Command::new(env!("CARGO_BIN_EXE_terrane")).args(["serve", ".", "--port", "0"]).args(arguments).output();
        let out = out.unwrap();
        let said = String::from_utf8_lossy(&out.stderr).into_owned();
        assert!(out.status.code() == Some(code) && said.contains(word), "{said}");
    }
}
