//! Bad input and bad connections in a flight: each is reported as one error, its parent stays visible, and requests are
//! not repeated endlessly. No GPU.

use std::collections::HashMap;
use std::io::Write as _;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use kit::pager::{Run, above};
use kit::process::runs_alone;
use kit::server::{Reply, Server};
use kit::skip::skipped;
use terrane::fetch::{CacheConfig, HttpConfig, IoError, Limits};
use terrane::formats::writers::{GlbMesh, write_glb};
use terrane::gpu::AdapterChoice;
use terrane::pager::PagerConfig;
use terrane::viewer::{Viewer, ViewerConfig};

fn glb() -> Vec<u8> {
    write_glb(&GlbMesh {
        positions: vec![[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
        indices: vec![0, 1, 2],
        base_color: [1.0; 4],
        ..GlbMesh::default()
    })
}

/// Returns a root with children of these names.
fn tileset(children: &[&str]) -> String {
    let tile = |name: &str, error: f64, children: &str| {
        format!(
            r#"{{"boundingVolume":{{"sphere":[0,0,0,2]}},"geometricError":{error},"content":{{"uri":"{name}"}},"children":[{children}]}}"#
        )
    };
    let below: Vec<String> = children.iter().map(|name| tile(name, 0.0, "")).collect();
    format!(r#"{{"asset":{{"version":"1.1"}},"geometricError":9,"root":{}}}"#, tile("root.glb", 5.0, &below.join(",")))
}

fn write_set(folder: &Path, children: &[(&str, Vec<u8>)]) {
    let names: Vec<&str> = children.iter().map(|(name, _)| *name).collect();
    std::fs::write(folder.join("tileset.json"), tileset(&names)).unwrap();
    std::fs::write(folder.join("root.glb"), glb()).unwrap();
    for (name, bytes) in children {
        std::fs::write(folder.join(name), bytes).unwrap();
    }
}

fn gzip(bytes: impl Iterator<Item = Vec<u8>>) -> Vec<u8> {
    let mut packed = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::best());
    bytes.for_each(|piece| packed.write_all(&piece).unwrap());
    packed.finish().unwrap()
}

/// Returns the error of the only child. The root is drawn instead of it.
fn refused(child: Vec<u8>, limits: Limits) -> String {
    let folder = tempfile::tempdir().unwrap();
    write_set(folder.path(), &[("child.glb", child)]);
    let mut run = Run::new(folder.path().to_str().unwrap(), PagerConfig { limits, ..PagerConfig::default() });
    run.settle(above(10.0));
    for _ in 0..20 {
        run.frame(above(10.0));
    }
    let errors = run.pager.errors();
    assert_eq!((errors.len(), run.pager.stats().failed, run.stage.counters.tiles_drawn), (1, 1, 1), "{errors:?}");
    assert!(errors[0].uri.ends_with("child.glb") && errors[0].count == 1, "{errors:?}");
    errors[0].reason.to_string()
}

#[test]
fn decompression_bombs_are_refused() {
    let limits = Limits { max_file_bytes: 4 << 20, max_image_bytes: 4 << 20, ..Limits::default() };
    // 64 MiB of zeros become 64 KiB, compressed once more.
    let zeros = gzip((0..64).map(|_| vec![0; 1 << 20]));
    assert!(zeros.len() < 1 << 17);
    let start = Instant::now();
    assert!(refused(zeros.clone(), limits).contains("limit"));
    refused(gzip([zeros].into_iter()), limits);
    // The header of the image gives a width of 60,000 pixels.
    let mut png = std::io::Cursor::new(Vec::new());
    image::RgbImage::new(4, 4).write_to(&mut png, image::ImageFormat::Png).unwrap();
    let mut png = png.into_inner();
    png[16..24].copy_from_slice(&[0, 0, 0xea, 0x60, 0, 0, 0xea, 0x60]);
    let with_image = write_glb(&GlbMesh {
        positions: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
        uvs: vec![[0.0; 2]; 3],
        indices: vec![0, 1, 2],
        image: Some(png),
        base_color: [1.0; 4],
        ..GlbMesh::default()
    });
    // It is not decoded, and the mesh is drawn without it.
    let folder = tempfile::tempdir().unwrap();
    write_set(folder.path(), &[("child.glb", with_image)]);
    let mut run = Run::new(folder.path().to_str().unwrap(), PagerConfig { limits, ..PagerConfig::default() });
    run.settle(above(10.0));
    assert_eq!((run.pager.stats().failed, run.stage.counters.tiles_drawn), (0, 1));
    let ignored = run.pager.ignored();
    assert!(ignored.iter().any(|(kind, _)| kind == "glTF: image that cannot be read"), "{ignored:?}");
    assert!(start.elapsed() < Duration::from_secs(20));
}

#[test]
fn huge_and_deep_json_is_refused() {
    let limits = Limits { max_file_bytes: 1 << 20, max_elements: 1000, ..Limits::default() };
    let folder = tempfile::tempdir().unwrap();
    let nested = |count: usize| vec!["a.glb"; count];
    let (many, huge) = (tileset(&nested(1001)), tileset(&nested(20_000)));
    let deep = format!(
        r#"{}{}"#,
        r#"{"asset":{"version":"1.1"},"geometricError":1,"root":"#,
        r#"{"children":[ "#.repeat(100_000)
    );
    for (name, text, why) in [("many.json", many, "limit"), ("huge.json", huge, "limit"), ("deep.json", deep, "")] {
        write_set(folder.path(), &[(name, text.into_bytes())]);
        let mut run = Run::new(folder.path().to_str().unwrap(), PagerConfig { limits, ..PagerConfig::default() });
        run.settle(above(10.0));
        let errors = run.pager.errors();
        assert!(errors.len() == 1 && errors[0].reason.contains(why), "{name}: {errors:?}");
        assert_eq!(run.stage.counters.tiles_drawn, 1, "{name}: the root stays");
    }
}

/// The answers of a server for the child.
fn over_http(answer: impl Fn() -> Reply + Send + Sync + 'static) -> (Run, Server) {
    let server = Server::start(move |request| match request.path() {
        "/tileset.json" => Reply::ok(tileset(&["child.glb"])),
        "/root.glb" => Reply::ok(glb()),
        _ => answer(),
    });
    let http = HttpConfig { max_retries: 0, ..HttpConfig::default() };
    let config = PagerConfig { http, max_tries: Some(1), ..PagerConfig::default() };
    let mut run = Run::new(&format!("{}/tileset.json", server.url.trim_end_matches('/')), config);
    // The root is waited for separately, because it need not load if the child is loaded before it.
    let fine_px = std::mem::replace(&mut run.max_sse_px, 1e9);
    run.settle(above(10.0));
    run.max_sse_px = fine_px;
    run.settle(above(10.0));
    (run, server)
}

#[test]
fn content_types_of_servers_are_not_trusted() {
    for kind in ["text/html", "image/png", "application/json; charset=x", "", "///"] {
        let (run, _server) = over_http(move || Reply::ok(glb()).with("content-type", kind));
        assert_eq!((run.pager.stats().failed, run.stage.counters.tiles_drawn), (0, 1), "{kind}");
        assert_eq!(run.pager.stats().merged, 2, "{kind}");
    }
    // A web page with status 200 and the content type of a tile.
    let page = "<!DOCTYPE html><html><body>Sign in</body></html>";
    for kind in ["text/html", "model/gltf-binary"] {
        let (mut run, server) = over_http(move || Reply::ok(page).with("content-type", kind));
        let asked = server.count();
        for _ in 0..100 {
            run.frame(above(10.0));
        }
        assert_eq!((run.pager.stats().merged, run.stage.counters.tiles_drawn, server.count()), (1, 1, asked));
        let errors = run.pager.errors();
        assert!(errors.len() == 1 && errors[0].reason.contains("error page"), "{errors:?}");
    }
}

#[test]
fn contents_may_change_between_requests() {
    let folder = tempfile::tempdir().unwrap();
    write_set(folder.path(), &[("child.glb", glb())]);
    let mut run = Run::new(folder.path().to_str().unwrap(), PagerConfig::default());
    let clear = |run: &mut Run| {
        let contexts: &mut [&mut dyn terrane::pager::CompileContext] = &mut [&mut run.context];
        run.pager.clear(&mut run.scene, contexts);
        run.settle(above(10.0));
    };
    run.settle(above(10.0));
    assert_eq!(run.pager.stats().merged, 2);
    // A tile becomes a tileset, a corrupt file, an empty one, and itself again.
    let of_one = tileset(&[]).replace("root.glb", "other.glb");
    std::fs::write(folder.path().join("other.glb"), glb()).unwrap();
    std::fs::write(folder.path().join("child.glb"), of_one).unwrap();
    clear(&mut run);
    assert_eq!((run.stage.counters.tiles_drawn, run.pager.stats().failed), (1, 0), "{:?}", run.pager.errors());
    std::fs::write(folder.path().join("child.glb"), b"glTF").unwrap();
    clear(&mut run);
    assert_eq!((run.stage.counters.tiles_drawn, run.pager.stats().failed), (1, 1));
    std::fs::remove_file(folder.path().join("child.glb")).unwrap();
    clear(&mut run);
    assert_eq!((run.stage.counters.tiles_drawn, run.pager.stats().failed), (1, 2));
    std::fs::write(folder.path().join("child.glb"), glb()).unwrap();
    clear(&mut run);
    assert_eq!((run.pager.stats().failed, run.pager.stats().resident), (2, 2));
    // A body changes on the server while the cache has the old one.
    let (cache, bodies) = (tempfile::tempdir().unwrap(), Arc::new(AtomicU64::new(0)));
    let of_server = bodies.clone();
    let server = Server::start(move |request| match request.path() {
        "/tileset.json" => Reply::ok(tileset(&["child.glb"])),
        "/root.glb" => Reply::ok(glb()),
        _ => match of_server.load(Ordering::Relaxed) {
            0 => Reply::ok(glb()).with("etag", "\"1\""),
            1 => Reply::ok("<html>sorry</html>").with("etag", "\"2\""),
            _ => Reply::ok(glb()).with("etag", "\"3\""),
        },
    });
    let source = format!("{}/tileset.json", server.url.trim_end_matches('/'));
    let mut failed = Vec::new();
    for body in 0..3 {
        bodies.store(body, Ordering::Relaxed);
        let http = HttpConfig { cache: Some(CacheConfig::new(cache.path())), max_retries: 0, ..HttpConfig::default() };
        let mut run = Run::new(&source, PagerConfig { http, max_tries: Some(1), ..PagerConfig::default() });
        run.settle(above(10.0));
        assert_eq!(run.stage.counters.tiles_drawn, 1);
        failed.push(run.pager.stats().failed);
    }
    assert_eq!(failed, [0, 1, 0]);
}

#[test]
fn clock_jumps_do_not_change_images() {
    let folder = tempfile::tempdir().unwrap();
    write_set(folder.path(), &[("child.glb", glb())]);
    let config = ViewerConfig {
        size_px: [32, 32],
        adapter: AdapterChoice::Noop,
        validation: false,
        pager: PagerConfig { blocking: true, ..PagerConfig::default() },
        ..ViewerConfig::default()
    };
    let mut viewer = Viewer::new_offscreen(&config).unwrap();
    viewer.load(folder.path().to_str().unwrap()).unwrap();
    for time_s in [5.0, 4.0, -1e9, f64::NAN, f64::INFINITY, 1e300, 0.0, 7.0, f64::NEG_INFINITY] {
        viewer.frame_at(time_s).unwrap();
        assert!(viewer.is_settled() && viewer.stats().last().unwrap().tiles_drawn == 1, "{time_s}");
    }
}

#[test]
fn unreadable_files_are_reported() {
    let folder = tempfile::tempdir().unwrap();
    write_set(folder.path(), &[("child.glb", glb()), ("other.glb", glb())]);
    std::fs::remove_file(folder.path().join("child.glb")).unwrap();
    std::fs::create_dir(folder.path().join("child.glb")).unwrap();
    let mut expected = vec!["folder"];
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt as _;
        let other = folder.path().join("other.glb");
        std::fs::set_permissions(&other, std::fs::Permissions::from_mode(0o000)).unwrap();
        if std::fs::read(&other).is_err() {
            expected.push("ermission denied");
        } else {
            skipped("an unreadable file: this user may read everything");
        }
    }
    let mut run = Run::new(folder.path().to_str().unwrap(), PagerConfig::default());
    run.settle(above(10.0));
    let errors = run.pager.errors();
    assert_eq!((errors.len(), run.stage.counters.tiles_drawn), (expected.len(), 1), "{errors:?}");
    assert!(expected.iter().all(|why| errors.iter().any(|e| e.reason.contains(why))), "{errors:?}");
}

/// Recorded log lines of warnings and errors.
static LINES: AtomicU64 = AtomicU64::new(0);

struct Count;

impl log::Log for Count {
    fn enabled(&self, metadata: &log::Metadata<'_>) -> bool {
        metadata.level() <= log::Level::Warn && metadata.target().starts_with("terrane")
    }

    fn log(&self, record: &log::Record<'_>) {
        LINES.fetch_add(u64::from(self.enabled(record.metadata())), Ordering::Relaxed);
    }

    fn flush(&self) {}
}

#[test]
fn thousands_of_failing_uris_cause_no_flood_of_requests_or_log_lines() {
    if runs_alone(module_path!(), "thousands_of_failing_uris_cause_no_flood_of_requests_or_log_lines") {
        return;
    }
    const CHILDREN: usize = 5000;
    log::set_logger(&Count).unwrap();
    log::set_max_level(log::LevelFilter::Warn);
    let names: Vec<String> = (0..CHILDREN).map(|i| format!("none-{i}.glb")).collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    // No file exists on disk, and none is looked for twice.
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("tileset.json"), tileset(&names)).unwrap();
    std::fs::write(folder.path().join("root.glb"), glb()).unwrap();
    let mut run = Run::new(folder.path().to_str().unwrap(), PagerConfig::default());
    run.settle(above(10.0));
    let start = Instant::now();
    for _ in 0..100 {
        run.frame(above(10.0));
    }
    let per_frame = start.elapsed() / 100;
    let (stats, errors) = (*run.pager.stats(), run.pager.errors());
    assert_eq!((stats.failed, stats.requested, stats.retried), (CHILDREN as u64, CHILDREN as u64 + 1, 0), "{stats:?}");
    assert!(errors.len() <= 1001, "{} lines", errors.len());
    assert_eq!(errors.iter().map(|e| e.count).sum::<u64>(), CHILDREN as u64);
    assert_eq!(run.stage.counters.tiles_drawn, 1, "the root stays");
    assert!(per_frame < Duration::from_millis(500), "{per_frame:?} a frame");

    // A failing server gets the configured number of requests for each URI, with growing pauses.
    let asked: Arc<Mutex<HashMap<String, u64>>> = Arc::default();
    let of_server = asked.clone();
    let set = tileset(&names[..400]);
    let server = Server::start(move |request| match request.path() {
        "/tileset.json" => Reply::ok(set.clone()),
        "/root.glb" => Reply::ok(glb()),
        path => {
            *of_server.lock().unwrap().entry(path.to_owned()).or_default() += 1;
            Reply::new(503, "")
        }
    });
    let http = HttpConfig { max_retries: 0, ..HttpConfig::default() };
    let (max_tries, retry_after) = (3, Duration::from_millis(20));
    let config = PagerConfig { http, max_tries: Some(max_tries), retry_after, ..PagerConfig::default() };
    let mut run = Run::new(&format!("{}/tileset.json", server.url.trim_end_matches('/')), config);
    let all = 400 * u64::from(max_tries);
    run.until(above(10.0), "not all retries were made", |r| r.pager.stats().failed == all);
    for _ in 0..200 {
        run.frame(above(10.0));
        std::thread::sleep(Duration::from_millis(1));
    }
    let counts: Vec<u64> = asked.lock().unwrap().values().copied().collect();
    assert!(counts.len() == 400 && counts.iter().all(|n| *n == u64::from(max_tries)), "{counts:?}");
    assert_eq!(run.pager.stats().retried, all - 400);
    assert_eq!(run.pager.errors().iter().map(|e| e.count).sum::<u64>(), all);
    assert!(LINES.load(Ordering::Relaxed) < 20, "{} lines in the log", LINES.load(Ordering::Relaxed));
}

/// Regression: each frame examined all URIs that had ever failed.
#[test]
fn failures_out_of_view_are_forgotten_if_there_are_thousands() {
    let folder = tempfile::tempdir().unwrap();
    for (children, remembered) in [(4_000, 4_000), (5_000, 0)] {
        let names: Vec<String> = (0..children).map(|k| format!("missing {k}.glb")).collect();
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        std::fs::write(folder.path().join("tileset.json"), tileset(&names)).unwrap();
        std::fs::write(folder.path().join("root.glb"), glb()).unwrap();
        let mut run = Run::new(folder.path().to_str().unwrap(), PagerConfig::default());
        let (near, far) = (above(5.0), above(1e7));
        run.settle(near);
        assert_eq!((run.pager.stats().failed, run.pager.request_states().count()), (children, children as usize));
        (0..100).for_each(|_| run.frame(near));
        assert_eq!(run.pager.request_states().count(), children as usize, "visible ones are not requested again");
        (0..100).for_each(|_| run.frame(far));
        assert_eq!(run.pager.request_states().count(), remembered);
        run.settle(near);
        let again = children - remembered as u64;
        assert_eq!(run.pager.stats().failed, children + again, "one more request when the camera returns");
    }
}

/// Regression: a disk that failed once lost a tile until the program was restarted.
#[cfg(target_os = "linux")]
#[test]
fn transient_file_errors_are_retried() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("tileset.json"), tileset(&["a.glb", "b.glb", "c.glb"])).unwrap();
    for name in ["root.glb", "a.glb"] {
        std::fs::write(folder.path().join(name), glb()).unwrap();
    }
    // Address 0 of the process's memory is not mapped, so reading it is an I/O error.
    let (broken, well) = (folder.path().join("b.glb"), folder.path().join("a.glb"));
    std::os::unix::fs::symlink("/proc/self/mem", &broken).unwrap();
    std::fs::create_dir(folder.path().join("c.glb")).unwrap();
    let limits = Limits { follow_links: true, ..Limits::default() };
    let config = PagerConfig { retry_after: std::time::Duration::from_millis(20), limits, ..PagerConfig::default() };
    let mut run = Run::new(folder.path().to_str().unwrap(), config.clone());
    let near = above(5.0);
    run.until(near, "no failure was reported", |r| r.pager.stats().failed >= 2);
    std::fs::remove_file(&broken).unwrap();
    std::fs::copy(&well, &broken).unwrap();
    run.until(near, "no retry was made", |r| r.pager.stats().merged == 3);
    let errors = run.pager.errors();
    let of = |name: &str| errors.iter().find(|e| e.uri.ends_with(name)).unwrap();
    assert!(of("b.glb").reason.contains("os error 5"), "{errors:?}");
    assert_eq!(of("c.glb").count, 1, "a folder is a permanent error");
    // The number of retries is limited.
    std::fs::remove_file(&broken).unwrap();
    std::os::unix::fs::symlink("/proc/self/mem", &broken).unwrap();
    let wait = std::time::Duration::from_millis(1);
    let mut run = Run::new(folder.path().to_str().unwrap(), PagerConfig { retry_after: wait, ..config });
    let end = std::time::Instant::now() + 200 * wait;
    run.until(near, "it is retried forever", |r| r.pager.stats().failed >= 6 && std::time::Instant::now() > end);
    assert_eq!(run.pager.stats().failed, 5 + 1);
}

#[test]
fn errors_of_all_kinds_name_the_problem_and_the_reason() {
    let uri = || "http://h/t.glb".to_owned();
    for error in [
        IoError::NotFound { uri: uri() },
        IoError::File { uri: uri(), reason: "no".to_owned(), may_pass: false },
        IoError::Network { uri: uri(), reason: "no".to_owned() },
        IoError::TooLarge { uri: uri(), what: "file", got: 2, limit: 1 },
        IoError::HostRefused { uri: uri(), host: "h".to_owned(), address: [10, 0, 0, 1].into(), kind: "private" },
        IoError::LinkRefused { uri: uri(), target: "/a/t.glb".into(), folder: "/b".into() },
        IoError::OutsideRefused { uri: uri(), folder: "/b".into() },
    ] {
        assert!(error.uri() == "http://h/t.glb" && !error.reason().is_empty() && error.to_string().contains("t.glb"));
    }
}

/// A set from a stranger could name any file of the machine by a link.
#[cfg(unix)]
#[test]
fn links_out_of_a_set_are_followed_only_on_request() {
    use std::os::unix::fs::symlink;

    let home = tempfile::tempdir().unwrap();
    let at = |name: &str| home.path().join(name);
    std::fs::create_dir_all(at("set/own")).unwrap();
    std::fs::create_dir(at("outside")).unwrap();
    // A name that begins like the set's folder is another folder.
    std::fs::create_dir(at("set2")).unwrap();
    for file in ["set/root.glb", "set/own/a.glb", "outside/b.glb", "set2/c.glb"] {
        std::fs::write(at(file), glb()).unwrap();
    }
    let contents = ["own/a.glb", "within.glb", "folder/b.glb", "file.glb", "beside.glb"];
    std::fs::write(at("set/tileset.json"), tileset(&contents)).unwrap();
    symlink("own/a.glb", at("set/within.glb")).unwrap();
    symlink(at("outside"), at("set/folder")).unwrap();
    symlink("../outside/b.glb", at("set/file.glb")).unwrap();
    symlink("../set2/c.glb", at("set/beside.glb")).unwrap();
    // A link to the folder is the user's own way to the set. The root may be a link as well.
    symlink(at("set"), at("link")).unwrap();
    for source in ["set", "link", "link/tileset.json"] {
        let source = at(source).to_str().unwrap().to_owned();
        let run = |follow_links: bool| {
            let limits = Limits { follow_links, ..Limits::default() };
            let mut run = Run::new(
                &source,
                PagerConfig { limits, retry_after: Duration::from_millis(1), ..PagerConfig::default() },
            );
            run.settle(above(5.0));
            let verified = terrane::formats::verify(&source, &limits, &mut |_| {}).unwrap();
            (run.pager.stats().merged, run.pager.errors(), verified.failed)
        };
        let (merged, errors, failed) = run(false);
        assert_eq!((merged, errors.len(), failed), (3, 3, 3), "{errors:?}");
        for error in &errors {
            assert!(error.count == 1 && error.reason.contains("--follow-links"), "{error:?}");
            assert!(error.reason.contains("outside") || error.reason.contains("set2"), "{error:?}");
        }
        let (merged, errors, failed) = run(true);
        assert_eq!((merged, errors.len(), failed), (6, 0, 0), "{errors:?}");
    }
}
