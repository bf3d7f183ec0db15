//! The pager over HTTP: a local server that answers, fails, stalls and closes connections. No GPU.

use std::collections::HashMap;
use std::io::{Read as _, Write as _};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use glam::DVec3;
use kit::pager::Run;
use terrane::fetch::{HttpConfig, IoError, Limits, root_uri};
use terrane::formats::ReadOptions;
use terrane::formats::writers::{GlbMesh, write_glb};
use terrane::pager::{DatabasePager, ErrorRecord, PagerConfig, PagerStats};
use terrane::scene::{NodeId, SlotState};

/// The server's reaction to a request.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Answer {
    Whole,
    Status(u16),
    /// The head announces the whole body, which ends half way.
    Truncated,
    /// Half of the body, then nothing until the client closes the connection.
    Stalled,
    /// No answer until the client closes the connection.
    Silent,
    /// The connection is closed immediately.
    Broken,
    /// An error page with status 200.
    Page,
    /// A body that is not content, with status 200.
    Rubbish,
    /// The whole body after 20 ms.
    Slow,
    /// A redirect to another address.
    Moved(&'static str),
}

/// The requests that the server has seen.
#[derive(Default)]
struct Seen {
    requests: Vec<String>,
    /// Paths of requests that the client cancelled.
    given_up: Vec<String>,
}

struct Server {
    url: String,
    seen: Arc<Mutex<Seen>>,
}

impl Server {
    /// Serves `files`. `plan` decides about the n-th request (from 0) for a path.
    fn start(files: HashMap<String, Vec<u8>>, plan: impl Fn(&str, usize) -> Answer + Send + Sync + 'static) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let url = format!("http://{}", listener.local_addr().unwrap());
        let seen = Arc::new(Mutex::new(Seen::default()));
        let (files, plan, log) = (Arc::new(files), Arc::new(plan), seen.clone());
        // The thread ends with the process.
        std::thread::spawn(move || {
            for stream in listener.incoming().flatten() {
                let (files, plan, log) = (files.clone(), plan.clone(), log.clone());
                std::thread::spawn(move || serve(stream, &files, &*plan, &log));
            }
        });
        Self { url, seen }
    }

    fn requests(&self, path: &str) -> usize {
        self.seen.lock().unwrap().requests.iter().filter(|p| *p == path).count()
    }

    fn given_up(&self) -> Vec<String> {
        self.seen.lock().unwrap().given_up.clone()
    }
}

fn serve(
    mut stream: TcpStream,
    files: &HashMap<String, Vec<u8>>,
    plan: &dyn Fn(&str, usize) -> Answer,
    log: &Mutex<Seen>,
) -> Option<()> {
    let mut head = Vec::new();
    let mut byte = [0u8];
    while !head.ends_with(b"\r\n\r\n") {
        (stream.read(&mut byte).ok()? == 1).then_some(())?;
        head.push(byte[0]);
    }
    let head = String::from_utf8(head).ok()?;
    let path = head.split(' ').nth(1)?.to_owned();
    let nth = {
        let mut log = log.lock().unwrap();
        log.requests.push(path.clone());
        log.requests.iter().filter(|p| **p == path).count() - 1
    };
    let answer = plan(&path, nth);
    let body = files.get(&path).map_or(&[][..], Vec::as_slice);
    let head = |status: &str, length: usize| {
        format!("HTTP/1.1 {status}\r\nContent-Length: {length}\r\nConnection: close\r\n\r\n")
    };
    let until_given_up = |stream: &mut TcpStream| {
        // The client can only close the connection.
        while matches!(stream.read(&mut [0; 64]), Ok(n) if n > 0) {}
        log.lock().unwrap().given_up.push(path.clone());
    };
    match answer {
        Answer::Broken => stream.shutdown(Shutdown::Both).ok()?,
        Answer::Silent => until_given_up(&mut stream),
        Answer::Status(code) => stream.write_all(head(&format!("{code} No"), 0).as_bytes()).ok()?,
        Answer::Moved(to) => {
            let text =
                format!("HTTP/1.1 302 Found\r\nLocation: {to}\r\nContent-Length: 0\r\nConnection: close\r\n\r\n");
            stream.write_all(text.as_bytes()).ok()?;
        }
        Answer::Page | Answer::Rubbish => {
            let page: &[u8] = if answer == Answer::Page { b"<html><body>Sorry</body></html>" } else { b"glTE" };
            stream.write_all(head("200 OK", page.len()).as_bytes()).ok()?;
            stream.write_all(page).ok()?;
        }
        Answer::Whole | Answer::Slow if !files.contains_key(&path) => {
            stream.write_all(head("404 Not Found", 0).as_bytes()).ok()?;
        }
        Answer::Whole | Answer::Slow => {
            if answer == Answer::Slow {
                std::thread::sleep(Duration::from_millis(20));
            }
            stream.write_all(head("200 OK", body.len()).as_bytes()).ok()?;
            stream.write_all(body).ok()?;
        }
        Answer::Truncated | Answer::Stalled => {
            stream.write_all(head("200 OK", body.len()).as_bytes()).ok()?;
            stream.write_all(&body[..body.len() / 2]).ok()?;
            if answer == Answer::Stalled {
                until_given_up(&mut stream);
            }
        }
    }
    Some(())
}

const CHILDREN: usize = 6;

/// Returns a root and its children around the origin, one glb each, by path.
fn set() -> HashMap<String, Vec<u8>> {
    let glb = write_glb(&GlbMesh {
        positions: vec![[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
        indices: vec![0, 1, 2],
        base_color: [1.0; 4],
        ..GlbMesh::default()
    });
    let mut files = HashMap::new();
    let mut tile = |name: &str, error: f64, children: &str| {
        files.insert(format!("/set/{name}.glb"), glb.clone());
        format!(
            r#"{{"boundingVolume":{{"sphere":[0,0,0,2]}},"geometricError":{error},"content":{{"uri":"{name}.glb"}},"children":[{children}]}}"#
        )
    };
    let children: Vec<String> = (0..CHILDREN).map(|i| tile(&format!("child{i}"), 0.0, "")).collect();
    let root = tile("root", 5.0, &children.join(","));
    let json = format!(r#"{{"asset":{{"version":"1.1"}},"geometricError":9,"root":{root}}}"#);
    files.insert("/set/tileset.json".to_owned(), json.into_bytes());
    files
}

/// The timeouts are short, but long enough for a busy machine when there is an answer.
fn impatient() -> PagerConfig {
    PagerConfig {
        http: HttpConfig {
            connect_timeout: Duration::from_secs(10),
            first_byte_timeout: Duration::from_secs(2),
            read_timeout: Duration::from_secs(2),
            total_timeout: Duration::from_secs(20),
            max_retries: 1,
            retry_backoff: Duration::from_millis(5),
            ..HttpConfig::default()
        },
        max_tries: Some(1),
        ..PagerConfig::default()
    }
}

/// The timeouts are longer than a test.
fn patient() -> PagerConfig {
    let long = Duration::from_secs(100);
    let mut config = impatient();
    config.http.first_byte_timeout = long;
    config.http.read_timeout = long;
    config.http.total_timeout = long;
    config
}

const NEAR: DVec3 = DVec3::new(0.0, 0.0, 10.0);
const FAR: DVec3 = DVec3::new(0.0, 0.0, 100_000.0);

fn run_of(server: &Server, config: PagerConfig) -> Run {
    Run::new(&format!("{}/set/", server.url), config)
}

fn error_of(run: &Run, name: &str) -> ErrorRecord {
    let errors = run.pager.errors();
    let found: Vec<_> = errors.iter().filter(|e| e.uri.ends_with(name)).cloned().collect();
    assert_eq!(found.len(), 1, "one error for {name}: {errors:?}");
    found[0].clone()
}

#[test]
fn set_is_streamed_completely() {
    let files = set();
    let bytes: u64 = files.values().map(|f| f.len() as u64).sum();
    for answer in [Answer::Whole, Answer::Slow] {
        let server = Server::start(files.clone(), move |_, _| answer);
        let mut run = run_of(&server, impatient());
        run.settle(NEAR);
        let stats = *run.pager.stats();
        assert_eq!((stats.merged, stats.failed), (CHILDREN as u64 + 1, 0), "{:?}", run.pager.errors());
        assert_eq!((stats.bytes_http, stats.bytes_read), (bytes, bytes), "all bytes are loaded once");
        assert_eq!(run.stage.counters.tiles_drawn, CHILDREN as u32);
        assert_eq!(server.seen.lock().unwrap().requests.len(), CHILDREN + 2, "all files are requested once");
    }
}

#[test]
fn each_fault_is_one_error_and_affects_no_other_tile() {
    let plan = |path: &str, _: usize| match path {
        "/set/child0.glb" => Answer::Status(404),
        "/set/child1.glb" => Answer::Status(500),
        "/set/child2.glb" => Answer::Truncated,
        "/set/child3.glb" => Answer::Stalled,
        "/set/child4.glb" => Answer::Page,
        _ => Answer::Whole,
    };
    let server = Server::start(set(), plan);
    let mut run = run_of(&server, impatient());
    run.settle(NEAR);
    for (name, why) in [
        ("child0.glb", "not found"),
        ("child1.glb", "HTTP status 500"),
        ("child2.glb", ""),
        ("child3.glb", "timed out"),
        ("child4.glb", "web page"),
    ] {
        let error = error_of(&run, name);
        assert!(error.uri.starts_with("http://127.0.0.1") && !error.reason.is_empty(), "{error:?}");
        assert!(error.reason.contains(why), "{error:?}");
        assert_eq!(error.count, 1, "{error:?}");
    }
    let stats = *run.pager.stats();
    assert_eq!((stats.failed, stats.merged), (5, 2), "the root and the valid child are resident: {stats:?}");
    let counters = &run.stage.counters;
    assert_eq!((counters.tiles_drawn, counters.stand_ins), (1, 5), "the parent stays where the others would be");
    // Permanent failures are requested once, transient ones are retried.
    assert_eq!(["0", "1", "3"].map(|i| server.requests(&format!("/set/child{i}.glb"))), [1, 2, 2]);
    let before = server.seen.lock().unwrap().requests.len();
    for _ in 0..50 {
        run.frame(NEAR);
    }
    assert_eq!(server.seen.lock().unwrap().requests.len(), before, "failures are not requested repeatedly");
}

#[test]
fn transient_failures_are_retried() {
    for fault in [Answer::Status(503), Answer::Broken, Answer::Truncated] {
        let server = Server::start(
            set(),
            move |path, nth| {
                if path == "/set/child2.glb" && nth == 0 { fault } else { Answer::Whole }
            },
        );
        let mut run = run_of(&server, impatient());
        run.settle(NEAR);
        assert_eq!(run.stage.counters.tiles_drawn, CHILDREN as u32, "{fault:?}: {:?}", run.pager.errors());
        assert_eq!((server.requests("/set/child2.glb"), run.pager.stats().failed), (2, 0), "{fault:?}");
    }
    // After the retries of the client come those of the pager.
    let server =
        Server::start(
            set(),
            |path, nth| {
                if path == "/set/child2.glb" && nth < 2 { Answer::Status(503) } else { Answer::Whole }
            },
        );
    let mut run =
        run_of(&server, PagerConfig { max_tries: Some(3), retry_after: Duration::from_millis(20), ..impatient() });
    run.until(NEAR, "it did not recover", |r| r.stage.counters.tiles_drawn == CHILDREN as u32);
    assert_eq!((error_of(&run, "child2.glb").count, server.requests("/set/child2.glb")), (1, 3));
}

/// Regression: after four attempts, which is a minute without a network, tiles were missing until the program was
/// restarted.
#[test]
fn tiles_load_after_a_long_outage() {
    let server =
        Server::start(
            set(),
            |path, nth| {
                if path == "/set/child2.glb" && nth < 12 { Answer::Status(503) } else { Answer::Whole }
            },
        );
    let max_tries = PagerConfig::default().max_tries;
    let mut run = run_of(&server, PagerConfig { max_tries, retry_after: Duration::from_millis(2), ..impatient() });
    run.until(NEAR, "it did not recover", |r| r.stage.counters.tiles_drawn == CHILDREN as u32);
    // Each attempt is two requests.
    assert_eq!((error_of(&run, "child2.glb").count, server.requests("/set/child2.glb")), (6, 13));
}

/// A network wants a login first and answers every request. Regression: tiles were missing until the program was
/// restarted.
#[test]
fn web_page_instead_of_a_tile_is_retried() {
    let server = Server::start(set(), |path, nth| match nth {
        0 if path == "/set/child2.glb" => Answer::Page,
        _ => Answer::Whole,
    });
    let mut run =
        run_of(&server, PagerConfig { max_tries: None, retry_after: Duration::from_millis(2), ..impatient() });
    run.until(NEAR, "it did not recover", |r| r.stage.counters.tiles_drawn == CHILDREN as u32);
    let error = error_of(&run, "child2.glb");
    assert!(error.reason.contains("web page") && error.count == 1, "{error:?}");
    assert_eq!(server.requests("/set/child2.glb"), 2);
}

/// Regression: one corrupted answer made a tile missing until the program was restarted.
#[test]
fn corrupted_content_is_retried_a_few_times() {
    let url = "/set/child2.glb";
    for (broken, requests) in [(2, 3), (usize::MAX, 5)] {
        let is_broken = move |path: &str, nth| path == url && nth < broken;
        let server =
            Server::start(set(), move |path, nth| if is_broken(path, nth) { Answer::Rubbish } else { Answer::Whole });
        let wait = Duration::from_millis(2);
        let mut run = run_of(&server, PagerConfig { max_tries: None, retry_after: wait, ..impatient() });
        run.until(NEAR, "no retry was made", |r| server.requests(url) == requests && r.pager.is_idle());
        let end = Instant::now() + 100 * wait;
        run.until(NEAR, "", |_| Instant::now() > end);
        let is_whole = run.stage.counters.tiles_drawn == CHILDREN as u32;
        assert_eq!((server.requests(url), is_whole), (requests, broken < 5), "{:?}", run.pager.errors());
        assert_eq!(error_of(&run, "child2.glb").count, broken.min(5) as u64);
    }
}

/// A tile out of view keeps its number of attempts until it is visible again.
#[test]
fn attempts_are_remembered_out_of_view() {
    let server =
        Server::start(set(), |path, _| if path == "/set/child2.glb" { Answer::Status(503) } else { Answer::Whole });
    let wait = Duration::from_millis(20);
    let mut run = run_of(&server, PagerConfig { max_tries: Some(2), retry_after: wait, ..impatient() });
    let rest = |run: &mut Run, eye| {
        let end = Instant::now() + 10 * wait;
        run.until(eye, "", |_| Instant::now() > end);
    };
    run.until(NEAR, "no failure was reported", |r| r.pager.stats().failed == 1);
    rest(&mut run, FAR);
    assert_eq!((run.pager.stats().failed, run.pager.stats().stale), (1, 0));
    run.until(NEAR, "no retry was made", |r| r.pager.stats().failed == 2);
    rest(&mut run, FAR);
    rest(&mut run, NEAR);
    assert_eq!((run.pager.stats().failed, run.pager.stats().retried), (2, 1));
}

/// A retry that is no longer wanted keeps its number of attempts, whether it waits or is in flight.
#[test]
fn attempts_are_remembered_when_a_request_becomes_stale() {
    let url = "/set/child2.glb";
    let server = Server::start(set(), move |path, n| match n {
        0 | 2.. if path == url => Answer::Status(503),
        1 if path == url => Answer::Silent,
        _ => Answer::Whole,
    });
    let wait = Duration::from_millis(20);
    let http = HttpConfig { max_retries: 0, ..patient().http };
    let mut run = run_of(&server, PagerConfig { max_tries: Some(2), retry_after: wait, http, ..impatient() });
    run.until(NEAR, "no failure was reported", |r| r.pager.stats().failed == 1);
    run.pager.set_paused(true);
    run.until(NEAR, "the retry does not wait", |r| r.pager.stats().retried == 1);
    run.until(FAR, "the retry did not become stale", |r| r.pager.stats().stale == 1);
    run.pager.set_paused(false);
    run.until(NEAR, "it was not read again", |_| server.requests(url) == 2);
    run.until(FAR, "it was not cancelled", |r| r.pager.stats().cancelled == 1);
    run.until(NEAR, "the second failure was not reported", |r| r.pager.stats().failed == 2);
    let end = Instant::now() + 10 * wait;
    run.until(NEAR, "", |_| Instant::now() > end);
    assert_eq!((run.pager.stats().failed, server.requests(url)), (2, 3));
}

/// Failed tiles that no frame wants are not requested. Regression: they were requested and cancelled forever.
#[test]
fn failed_tiles_are_retried_by_the_view_that_wants_them() {
    let url = "/set/root.glb";
    let server = Server::start(set(), move |path, n| match n {
        0 if path == url => Answer::Status(503),
        _ if path == url => Answer::Silent,
        _ => Answer::Whole,
    });
    let wait = Duration::from_millis(20);
    let http = HttpConfig { max_retries: 0, ..patient().http };
    let mut run = run_of(&server, PagerConfig { max_tries: None, retry_after: wait, http, ..patient() });
    let has_children = |s: &PagerStats| (s.merged, s.failed, s.in_flight) == (CHILDREN as u64, 1, 0);
    run.until(NEAR, "the children were not loaded", |r| has_children(r.pager.stats()));
    // The server may count a cancelled request late, so the pager's own counters are compared.
    let sent = |r: &Run| r.pager.stats().requested + r.pager.stats().retried;
    let (before, end) = (sent(&run), Instant::now() + 10 * wait);
    run.until(NEAR, "", |_| Instant::now() > end);
    assert_eq!((run.stage.counters.tiles_drawn, sent(&run)), (CHILDREN as u32, before));
    run.until(FAR, "it was not requested", |r| sent(r) == before + 1 && server.requests(url) >= 2);
}

#[test]
fn hung_request_blocks_no_other() {
    let server = Server::start(set(), |path, _| if path == "/set/child0.glb" { Answer::Silent } else { Answer::Whole });
    let mut run = run_of(&server, patient());
    run.until(NEAR, "the other requests wait", |r| r.pager.stats().merged == CHILDREN as u64);
    // The server may read its requests more slowly than the others.
    run.until(NEAR, "it was not requested", |_| server.requests("/set/child0.glb") == 1);
    assert_eq!(run.pager.stats().in_flight, 1);
}

#[test]
fn hung_server_blocks_no_other() {
    let hung = Server::start(HashMap::new(), |_, _| Answer::Silent);
    let mut files = set();
    // Twenty more children are on a server that never answers. Each server has a limit of four requests.
    let json = String::from_utf8(files["/set/tileset.json"].clone()).unwrap();
    let elsewhere: String = (0..20)
        .map(|i| {
            format!(
                r#"{{"boundingVolume":{{"sphere":[0,0,0,2]}},"geometricError":0,"content":{{"uri":"{}/x{i}.glb"}}}},"#,
                hung.url
            )
        })
        .collect();
    let json = json.replacen(r#""children":[{"#, &format!(r#""children":[{elsewhere}{{"#), 1);
    files.insert("/set/tileset.json".to_owned(), json.into_bytes());
    let server = Server::start(files, |_, _| Answer::Whole);
    let allowed_hosts = vec![hung.url.trim_start_matches("http://").parse().unwrap()];
    let http = HttpConfig { allowed_hosts, ..patient().http };
    let mut run = run_of(&server, PagerConfig { http_in_flight: 4, http_in_flight_max: 4, http, ..patient() });
    run.until(NEAR, "the other requests wait", |r| r.pager.stats().merged == CHILDREN as u64 + 1);
    // The server may read its requests more slowly than the others.
    run.until(NEAR, "fewer requests than the limit", |_| hung.seen.lock().unwrap().requests.len() >= 4);
    assert_eq!(hung.seen.lock().unwrap().requests.len(), 4, "no more requests than the limit");
    assert_eq!(run.pager.stats().in_flight, 4);
}

#[test]
fn unwanted_request_is_aborted() {
    let server = Server::start(set(), |path, _| if path == "/set/child0.glb" { Answer::Silent } else { Answer::Whole });
    let mut run = run_of(&server, PagerConfig { abort_time: Duration::from_millis(80), ..patient() });
    // The root and the other children are loaded.
    let is_left_alone = |r: &Run| server.requests("/set/child0.glb") == 1 && r.pager.stats().merged == CHILDREN as u64;
    run.until(NEAR, "it was not requested", is_left_alone);
    run.until(FAR, "not aborted", |r| r.pager.stats().cancelled == 1 && server.given_up() == ["/set/child0.glb"]);
    run.until(FAR, "the pager does not settle", |r| r.pager.is_idle());
    assert!(run.pager.errors().is_empty(), "unwanted requests are not reported: {:?}", run.pager.errors());
    // When it is wanted again, it is requested again.
    run.until(NEAR, "it was not requested again", |_| server.requests("/set/child0.glb") == 2);
}

/// Requests that started after the last list are aborted too. Regression: they occupied the server until it answered.
#[test]
fn requests_that_just_started_are_aborted_by_clear() {
    let server = Server::start(set(), |path, _| if path.contains("child") { Answer::Silent } else { Answer::Whole });
    let mut run = run_of(&server, PagerConfig { http_in_flight: 3, http_in_flight_max: 3, ..patient() });
    let children = || server.seen.lock().unwrap().requests.iter().filter(|path| path.contains("child")).count();
    let mut asked = 0;
    for round in 1..=20 {
        run.until(NEAR, "it was not requested", |_| children() >= asked + 3);
        asked = children();
        let contexts: &mut [&mut dyn terrane::pager::CompileContext] = &mut [&mut run.context];
        run.pager.clear(&mut run.scene, contexts);
        run.until(FAR, "it was not cancelled", |_| server.given_up().len() == 3 * round);
    }
}

#[test]
fn stale_request_never_reaches_the_server() {
    let server = Server::start(set(), |path, _| if path.contains("child") { Answer::Silent } else { Answer::Whole });
    let config = PagerConfig { http_in_flight: 1, http_in_flight_max: 1, abort_time: Duration::MAX, ..patient() };
    let mut run = run_of(&server, config);
    run.until(NEAR, "no request is in flight", |r| {
        r.pager.stats().merged == 1 && server.seen.lock().unwrap().requests.len() == 3
    });
    let waiting = run.pager.stats().waiting;
    assert_eq!(waiting, CHILDREN as u64 - 1);
    run.until(FAR, "no request became stale", |r| r.pager.stats().stale == waiting);
    assert_eq!(server.seen.lock().unwrap().requests.len(), 3, "the set, the root and one child");
}

#[test]
fn pager_ends_with_requests_in_flight() {
    let server = Server::start(set(), |path, _| if path.ends_with("glb") { Answer::Silent } else { Answer::Whole });
    let mut run = run_of(&server, patient());
    run.until(NEAR, "no request is in flight", |_| server.seen.lock().unwrap().requests.len() == CHILDREN + 2);
    let start = Instant::now();
    drop(run);
    assert!(start.elapsed() < Duration::from_secs(30), "it does not wait for the server");
}

#[test]
fn distant_server_gets_more_concurrent_requests() {
    use std::sync::atomic::{AtomicUsize, Ordering};
    const MANY: usize = 300;
    let files = set();
    let glb = files["/set/root.glb"].clone();
    let tile = |i: usize| {
        format!(r#"{{"boundingVolume":{{"sphere":[0,0,0,2]}},"geometricError":0,"content":{{"uri":"{i}.glb"}}}}"#)
    };
    let children: Vec<String> = (0..MANY).map(tile).collect();
    let json = format!(
        r#"{{"asset":{{"version":"1.1"}},"geometricError":9,"root":{{"boundingVolume":{{"sphere":[0,0,0,2]}},
            "geometricError":5,"children":[{}]}}}}"#,
        children.join(",")
    );
    for (most, expected) in [(4, 4..=4), (64, 5..=64)] {
        let (now, peak) = (Arc::new(AtomicUsize::new(0)), Arc::new(AtomicUsize::new(0)));
        let (json, glb, running, highest) = (json.clone(), glb.clone(), now.clone(), peak.clone());
        let server = kit::server::Server::start(move |r| {
            highest.fetch_max(running.fetch_add(1, Ordering::SeqCst) + 1, Ordering::SeqCst);
            std::thread::sleep(Duration::from_millis(60));
            running.fetch_sub(1, Ordering::SeqCst);
            kit::server::Reply::ok(if r.path().ends_with("json") { json.clone().into() } else { glb.clone() })
        });
        let config = PagerConfig { http_in_flight: 4, http_in_flight_max: most, ..patient() };
        let mut run = Run::new(&format!("{}/set/", server.url), config);
        run.settle(NEAR);
        assert_eq!((run.pager.stats().merged, server.count()), (MANY as u64, MANY + 1));
        let peak = peak.load(Ordering::SeqCst);
        assert!(expected.contains(&peak), "{most}: {peak}");
    }
}

/// Returns the error of a root that cannot be read.
fn root_error(url: &str) -> IoError {
    let uri = root_uri(url).unwrap();
    let mut pager = DatabasePager::new(impatient(), ReadOptions::for_root(&uri, Limits::default())).unwrap();
    let error = pager.read_root(&uri).err().unwrap();
    assert!(error.uri().starts_with("http://127.0.0.1"), "{error}");
    error
}

#[test]
fn root_that_cannot_be_read_names_the_reason() {
    let server = Server::start(set(), |path, _| match path {
        "/gone/tileset.json" => Answer::Status(410),
        "/file/tileset.json" => Answer::Moved("file:///etc/passwd"),
        _ => Answer::Whole,
    });
    assert!(matches!(root_error(&format!("{}/none/", server.url)), IoError::NotFound { .. }));
    assert!(matches!(root_error(&format!("{}/gone/", server.url)), IoError::NotFound { .. }));
    let to_file = root_error(&format!("{}/file/", server.url));
    assert!(matches!(to_file, IoError::Uri { .. }), "a remote set cannot refer to files: {to_file:?}");
    // The port was free a moment ago, so no server listens.
    let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    assert!(matches!(root_error(&format!("http://127.0.0.1:{port}/set/")), IoError::Network { .. }));
}

/// Regression: the error ended the start of the program, or of one scene.
#[test]
fn corrupted_root_is_requested_again() {
    let url = "/set/tileset.json";
    for answer in [Answer::Rubbish, Answer::Page] {
        let server =
            Server::start(set(), move |path, nth| if path == url && nth == 0 { answer } else { Answer::Whole });
        let mut run = run_of(&server, impatient());
        assert_eq!(server.requests(url), 2);
        run.settle(NEAR);
        assert_eq!(run.stage.counters.tiles_drawn, CHILDREN as u32);
    }
    let server = Server::start(set(), |_, _| Answer::Rubbish);
    assert!(matches!(root_error(&format!("{}/set/", server.url)), IoError::Invalid { .. }));
    assert_eq!(server.requests(url), 2, "as often as a missing answer");
}

/// Regression: the request stayed with its earlier attempts, and no camera wanted it.
#[test]
fn cancelled_pages_are_loaded_for_the_application() {
    let url = "/set/child2.glb";
    let server = Server::start(set(), move |path, nth| match nth {
        0 if path == url => Answer::Status(503),
        1 if path == url => Answer::Silent,
        _ => Answer::Whole,
    });
    let http = HttpConfig { max_retries: 0, ..patient().http };
    let retry_after = Duration::from_millis(20);
    let mut run = run_of(&server, PagerConfig { max_tries: None, retry_after, http, ..impatient() });
    run.until(NEAR, "it was not read again", |_| server.requests(url) == 2);
    run.until(FAR, "it was not cancelled", |r| r.pager.stats().cancelled == 1);
    let root = run.scene.roots()[0];
    let is_it = |slot: &NodeId| run.scene.slot(*slot).is_some_and(|slot| slot.uri.ends_with(url));
    let slot = run.scene.slots_of_page(root).find(is_it).unwrap();
    assert_eq!(run.scene.slot(slot).unwrap().state, SlotState::Empty);
    run.scene.load_proxy(slot).unwrap();
    let is_there = |r: &Run| matches!(r.scene.slot(slot).unwrap().state, SlotState::Resident(_));
    run.until(FAR, "it was not loaded", is_there);
    assert_eq!((server.requests(url), run.pager.stats().failed), (3, 1));
}
