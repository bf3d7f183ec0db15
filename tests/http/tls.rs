//! Encrypted connections: private certificate authorities, invalid certificates, negotiation of HTTP/2.

use std::collections::HashMap;
use std::path::PathBuf;
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use kit::pager::{Run, above};
use kit::process::test_name;
use kit::tile_sets::{WORLD_M, write_quadtree};
use rcgen::{BasicConstraints, CertificateParams, IsCa, Issuer, KeyPair, KeyUsagePurpose, date_time_ymd};
use rustls::pki_types::PrivateKeyDer;
use terrane::fetch::{HttpClient, HttpConfig, IoError, Limits};
use terrane::pager::PagerConfig;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};

fn runtime() -> tokio::runtime::Runtime {
    tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap()
}

/// A new certificate authority, and the file with its certificate.
struct Authority {
    issuer: Issuer<'static, KeyPair>,
    folder: tempfile::TempDir,
}

impl Authority {
    fn new() -> Self {
        let key = KeyPair::generate().unwrap();
        let mut params = CertificateParams::new(Vec::new()).unwrap();
        // Each authority has a different name. With equal names, the signature would be the error.
        static COUNT: AtomicUsize = AtomicUsize::new(0);
        let name = format!("test authority {}", COUNT.fetch_add(1, Ordering::Relaxed));
        params.distinguished_name.push(rcgen::DnType::CommonName, name);
        params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
        params.key_usages = vec![KeyUsagePurpose::KeyCertSign];
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("ca.pem"), params.self_signed(&key).unwrap().pem()).unwrap();
        Self { issuer: Issuer::new(params, key), folder }
    }

    fn file(&self) -> PathBuf {
        self.folder.path().join("ca.pem")
    }

    /// A server with a certificate for a name, with optional changes.
    fn server(&self, name: &str, protocols: &[&str], change: impl FnOnce(&mut CertificateParams)) -> Server {
        let key = KeyPair::generate().unwrap();
        let mut params = CertificateParams::new(vec![name.to_owned()]).unwrap();
        change(&mut params);
        let certificate = params.signed_by(&key, &self.issuer).unwrap();
        let provider = Arc::new(rustls::crypto::ring::default_provider());
        let config =
            rustls::ServerConfig::builder_with_provider(provider).with_safe_default_protocol_versions().unwrap();
        let key = PrivateKeyDer::try_from(key.serialize_der()).unwrap();
        let mut config = config.with_no_client_auth().with_single_cert(vec![certificate.der().clone()], key).unwrap();
        config.alpn_protocols = protocols.iter().map(|p| p.as_bytes().to_vec()).collect();
        Server::start(config, HashMap::new())
    }
}

/// Answers with the file of the path, or with version and path.
struct Server {
    url: String,
    connections: Arc<AtomicUsize>,
    files: Arc<std::sync::Mutex<HashMap<String, Vec<u8>>>>,
}

type Stream = tokio_rustls::server::TlsStream<tokio::net::TcpStream>;

impl Server {
    fn start(config: rustls::ServerConfig, files: HashMap<String, Vec<u8>>) -> Self {
        let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        listener.set_nonblocking(true).unwrap();
        let url = format!("https://127.0.0.1:{}", listener.local_addr().unwrap().port());
        let connections = Arc::new(AtomicUsize::new(0));
        let files = Arc::new(std::sync::Mutex::new(files));
        let (count, of) = (connections.clone(), files.clone());
        let acceptor = tokio_rustls::TlsAcceptor::from(Arc::new(config));
        // The thread ends with the process.
        std::thread::spawn(move || {
            runtime().block_on(async move {
                let listener = tokio::net::TcpListener::from_std(listener).unwrap();
                loop {
                    let (stream, _) = listener.accept().await.unwrap();
                    count.fetch_add(1, Ordering::Relaxed);
                    let (acceptor, files) = (acceptor.clone(), of.clone());
                    tokio::spawn(async move {
                        // A client that does not trust the certificate closes the connection.
                        let Ok(stream) = acceptor.accept(stream).await else { return };
                        let answer = move |version: &str, path: &str| {
                            let file = files.lock().unwrap().get(path).cloned();
                            file.unwrap_or_else(|| format!("{version} {path}").into_bytes())
                        };
                        if stream.get_ref().1.alpn_protocol() == Some(b"h2") {
                            serve_h2(stream, answer).await;
                        } else {
                            let _ = serve_h1(stream, answer).await;
                        }
                    });
                }
            });
        });
        Self { url, connections, files }
    }
}

async fn serve_h2(stream: Stream, answer: impl Fn(&str, &str) -> Vec<u8>) {
    let Ok(mut connection) = h2::server::handshake(stream).await else { return };
    while let Some(Ok((request, mut respond))) = connection.accept().await {
        let bytes = answer("HTTP/2.0", request.uri().path());
        let mut body = respond.send_response(http::Response::new(()), false).unwrap();
        body.send_data(bytes.into(), true).unwrap();
    }
}

async fn serve_h1(mut stream: Stream, answer: impl Fn(&str, &str) -> Vec<u8>) -> std::io::Result<()> {
    let mut head = Vec::new();
    loop {
        while !head.ends_with(b"\r\n\r\n") {
            head.push(stream.read_u8().await?);
        }
        let path = String::from_utf8_lossy(&head).split(' ').nth(1).unwrap().to_owned();
        head.clear();
        if let Some(to) = path.strip_prefix("/to?") {
            let head = format!("HTTP/1.1 302 Found\r\nLocation: {to}\r\nContent-Length: 0\r\n\r\n");
            stream.write_all(head.as_bytes()).await?;
            continue;
        }
        let bytes = answer("HTTP/1.1", &path);
        stream.write_all(format!("HTTP/1.1 200 OK\r\nContent-Length: {}\r\n\r\n", bytes.len()).as_bytes()).await?;
        stream.write_all(&bytes).await?;
    }
}

fn trusting(authority: &Authority) -> HttpConfig {
    HttpConfig { root_certificates: vec![authority.file()], ..HttpConfig::default() }
}

fn get(config: &HttpConfig, url: &str) -> Result<String, IoError> {
    runtime().block_on(async {
        let body = HttpClient::new(config)?.get(url, &Limits::default()).await?;
        Ok(String::from_utf8(body.bytes).unwrap())
    })
}

#[test]
fn version_of_http_is_negotiated() {
    let authority = Authority::new();
    for (protocols, version) in
        [(&["h2", "http/1.1"][..], "HTTP/2.0"), (&["http/1.1"], "HTTP/1.1"), (&[], "HTTP/1.1"), (&["h2"], "HTTP/2.0")]
    {
        let server = authority.server("127.0.0.1", protocols, |_| {});
        assert_eq!(get(&trusting(&authority), &format!("{}/a", server.url)).unwrap(), format!("{version} /a"));
    }
}

#[test]
fn many_requests_share_an_encrypted_connection() {
    let authority = Authority::new();
    let server = authority.server("127.0.0.1", &["h2", "http/1.1"], |_| {});
    let client = HttpClient::new(&trusting(&authority)).unwrap();
    runtime().block_on(async {
        // Until the version is negotiated, each request may open a connection.
        client.get(&format!("{}/first", server.url), &Limits::default()).await.unwrap();
        let mut tasks = tokio::task::JoinSet::new();
        for i in 0..50 {
            let (client, url) = (client.clone(), format!("{}/{i}", server.url));
            tasks.spawn(async move { (i, client.get(&url, &Limits::default()).await.unwrap().bytes) });
        }
        while let Some(done) = tasks.join_next().await {
            let (i, bytes) = done.unwrap();
            assert_eq!(bytes, format!("HTTP/2.0 /{i}").into_bytes());
        }
    });
    assert_eq!(server.connections.load(Ordering::Relaxed), 1);
}

/// Returns the error of a server that must not be trusted. It is requested once.
fn refused(config: &HttpConfig, server: &Server) -> String {
    let url = format!("{}/tile.glb?token=hidden", server.url);
    let error = get(config, &url).unwrap_err();
    assert!(matches!(&error, IoError::Tls { uri, .. } if *uri == url), "{error:?}");
    assert!(!error.is_transient(), "a retry changes nothing");
    assert_eq!(server.connections.load(Ordering::Relaxed), 1, "{error}");
    let text = error.to_string();
    assert!(text.starts_with(&server.url) && !text.contains("hidden"), "{text}");
    text
}

#[test]
fn invalid_certificates_are_reported_once() {
    let (authority, other) = (Authority::new(), Authority::new());
    let good = || authority.server("127.0.0.1", &[], |_| {});
    for config in [HttpConfig::default(), trusting(&other)] {
        let text = refused(&config, &good());
        assert!(text.contains("certificate") && text.contains("UnknownIssuer"), "{text}");
    }
    let expired = authority.server("127.0.0.1", &[], |params| {
        (params.not_before, params.not_after) = (date_time_ymd(2001, 1, 1), date_time_ymd(2002, 1, 1));
    });
    let text = refused(&trusting(&authority), &expired);
    assert!(text.contains("expired"), "{text}");
    let early = authority.server("127.0.0.1", &[], |params| params.not_before = date_time_ymd(3000, 1, 1));
    let text = refused(&trusting(&authority), &early);
    assert!(text.contains("not valid yet"), "{text}");
    let wrong = authority.server("tiles.example", &[], |_| {});
    let text = refused(&trusting(&authority), &wrong);
    assert!(text.contains("not valid for name"), "{text}");
}

/// A redirect from https to http is refused: an open connection has no authenticated peer.
#[test]
fn redirects_from_https_to_http_are_refused() {
    let authority = Authority::new();
    let server = authority.server("127.0.0.1", &[], |_| {});
    let open = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    open.set_nonblocking(true).unwrap();
    let to = |url: &str| get(&trusting(&authority), &format!("{}/to?{url}", server.url));
    let error = to(&format!("http://{}/a?token=hidden", open.local_addr().unwrap())).unwrap_err();
    assert!(matches!(error, IoError::Uri { .. }) && !error.is_transient(), "{error:?}");
    assert!(error.reason().contains("redirected from https") && !error.reason().contains("hidden"), "{error}");
    assert!(open.accept().is_err(), "nobody came");
    assert_eq!(to(&format!("{}/a", server.url)).unwrap(), "HTTP/1.1 /a");
}

#[test]
fn servers_without_tls_are_reported() {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let url = format!("https://{}/a", listener.local_addr().unwrap());
    std::thread::spawn(move || {
        for mut stream in listener.incoming().flatten() {
            let _ = std::io::Write::write_all(&mut stream, b"HTTP/1.1 400 Bad Request\r\nContent-Length: 0\r\n\r\n");
        }
    });
    let error = get(&HttpConfig::default(), &url).unwrap_err();
    assert!(matches!(error, IoError::Tls { .. }), "{error:?}");
}

#[test]
fn flight_uses_an_encrypted_connection() {
    let folder = tempfile::tempdir().unwrap();
    write_quadtree(folder.path());
    let authority = Authority::new();
    let server = authority.server("127.0.0.1", &["h2", "http/1.1"], |_| {});
    for entry in std::fs::read_dir(folder.path()).unwrap() {
        let path = entry.unwrap().path();
        let name = format!("/{}", path.file_name().unwrap().to_str().unwrap());
        server.files.lock().unwrap().insert(name, std::fs::read(&path).unwrap());
    }
    let flown = |source: &str, http: HttpConfig| {
        let mut run = Run::new(source, PagerConfig { http, ..PagerConfig::default() });
        run.max_sse_px = 0.1;
        run.settle(above(WORLD_M) + glam::DVec3::new(WORLD_M / 2.0, WORLD_M / 2.0, 0.0));
        run
    };
    let whole = flown(folder.path().to_str().unwrap(), HttpConfig::default());
    let run = flown(&format!("{}/", server.url), trusting(&authority));
    let (tiles, stats) = (whole.stage.counters.tiles_drawn, *run.pager.stats());
    assert!(tiles > 20, "{tiles}");
    assert_eq!((run.stage.counters.tiles_drawn, stats.failed), (tiles, 0), "{:?}", run.pager.errors());
    assert_eq!(server.connections.load(Ordering::Relaxed), 1, "the root's connection is used for the tiles");

    // A trusted server refers to an untrusted one. Each such tile is one error, and the rest is drawn.
    let stranger = Authority::new().server("127.0.0.1", &[], |_| {});
    let set = String::from_utf8(std::fs::read(folder.path().join("tileset.json")).unwrap()).unwrap();
    let set = set.replacen("4_0_0.glb", &format!("{}/4_0_0.glb", stranger.url), 1);
    server.files.lock().unwrap().insert("/tileset.json".to_owned(), set.into_bytes());
    let allowed_hosts = vec![stranger.url.trim_start_matches("https://").parse().unwrap()];
    let run = flown(&format!("{}/", server.url), HttpConfig { allowed_hosts, ..trusting(&authority) });
    let errors = run.pager.errors();
    assert_eq!(errors.len(), 1, "{errors:?}");
    assert!(errors[0].count == 1 && errors[0].reason.contains("UnknownIssuer"), "{errors:?}");
    assert_eq!(stranger.connections.load(Ordering::Relaxed), 1);
}

#[test]
fn invalid_certificate_files_are_errors() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str, text: &str| {
        std::fs::write(folder.path().join(name), text).unwrap();
        folder.path().join(name)
    };
    for (file, part) in [
        (folder.path().join("none.pem"), "not found"),
        (file("empty.pem", ""), "no certificate"),
        (file("odd.pem", "-----BEGIN CERTIFICATE-----\nAAAA\n-----END CERTIFICATE-----\n"), "certificate"),
    ] {
        let config = HttpConfig { root_certificates: vec![file.clone()], ..HttpConfig::default() };
        let error = HttpClient::new(&config).map(|_| ()).unwrap_err();
        assert_eq!(error.uri(), file.to_str().unwrap());
        assert!(error.to_string().contains(part), "{error}");
    }
}

/// Run by [`an_authority_from_the_environment`] in a separate process.
#[test]
fn asks_as_another_process() {
    let Ok(url) = std::env::var("TERRANE_TEST_TLS_URL") else { return };
    assert_eq!(get(&HttpConfig::default(), &url).unwrap(), "HTTP/1.1 /a");
}

#[test]
#[cfg(target_os = "linux")]
fn an_authority_from_the_environment() {
    let authority = Authority::new();
    let server = authority.server("127.0.0.1", &[], |_| {});
    let ask = |name: &str| {
        let mut command = Command::new(std::env::current_exe().unwrap());
        command
            .args(["--exact", &test_name(module_path!(), "asks_as_another_process")])
            .env("TERRANE_TEST_TLS_URL", format!("{}/a", server.url));
        command.env(name, authority.file()).output().unwrap().status.success()
    };
    assert!(ask("SSL_CERT_FILE"));
    assert!(!ask("TERRANE_NO_SUCH_VARIABLE"));
}
