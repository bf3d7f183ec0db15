//! The bytes that are on their way to a scene stay within their budget, however many contents are wanted at once.

use std::fmt::Write as _;
use std::io::Write as _;
use std::path::Path;
use std::time::{Duration, Instant};

use kit::pager::{Run, above};
use kit::process::runs_alone;
use kit::server::{How, Reply, Request, Server};
use terrane::fetch::CacheConfig;
use terrane::pager::{PagerConfig, PagerStats};

const TILES: usize = 64;
/// Far more than a busy machine needs.
const MAX_TIME: Duration = Duration::from_secs(600);

/// Returns a tileset.json with tiles of this name side by side, all visible at once.
fn tileset(tile: &str) -> String {
    let mut children = String::new();
    for k in 0..TILES {
        let comma = if k == 0 { "" } else { "," };
        let bounds = r#""boundingVolume":{"sphere":[0,0,0,2]},"geometricError":0"#;
        write!(children, r#"{comma}{{{bounds},"content":{{"uri":"{k}{tile}"}}}}"#).unwrap();
    }
    let root = r#""boundingVolume":{"sphere":[0,0,0,2]},"geometricError":9,"refine":"ADD""#;
    format!(r#"{{"asset":{{"version":"1.1"}},"geometricError":9,"root":{{{root},"children":[{children}]}}}}"#)
}

/// Returns the beginning of a glb of `bytes` bytes with one triangle, and how many zeros follow.
fn glb(bytes: usize) -> (Vec<u8>, usize) {
    let header = |bin: usize| {
        let json = format!(
            r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],"nodes":[{{"mesh":0}}],
            "meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}}}}]}}],
            "accessors":[{{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3","min":[0,0,0],"max":[1,1,0]}}],
            "bufferViews":[{{"buffer":0,"byteLength":36}},{{"buffer":0,"byteOffset":36,"byteLength":{}}}],
            "buffers":[{{"byteLength":{bin}}}]}}"#,
            bin - 36
        );
        let json = format!("{json:<width$}", width = json.len().next_multiple_of(4));
        let size = |bytes: usize| (bytes as u32).to_le_bytes();
        let total = 12 + 8 + json.len() + 8 + bin;
        let chunk = [&size(json.len()), b"JSON", json.as_bytes(), &size(bin), b"BIN\0"].concat();
        [b"glTF", &2u32.to_le_bytes(), &size(total)[..], &chunk].concat()
    };
    let bin = (bytes - header(bytes).len()).next_multiple_of(4);
    let corners: [[f32; 3]; 3] = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
    let corners = corners.as_flattened().iter().flat_map(|x| x.to_le_bytes());
    (header(bin).into_iter().chain(corners).collect(), bin - 36)
}

/// Returns a whole glb.
fn whole_glb(bytes: usize) -> Vec<u8> {
    let (mut glb, zeros) = glb(bytes);
    glb.resize(glb.len() + zeros, 0);
    glb
}

/// Serves a tile set whose tiles have this size.
fn serve(tile_bytes: usize, reply: impl Fn(&Request, Reply) -> Reply + Send + Sync + 'static) -> Server {
    let (glb, zeros) = glb(tile_bytes);
    Server::start(move |request| match request.path() {
        "/tileset.json" => Reply::ok(tileset(".glb")).with("Cache-Control", "max-age=1000"),
        _ => reply(request, Reply::ok(glb.clone()).then_zeros(zeros)),
    })
}

/// Loads all tiles, and returns the counters.
fn load_all(source: &str, config: PagerConfig) -> PagerStats {
    let mut run = Run::new(source, config);
    let until = Instant::now() + MAX_TIME;
    // Bytes that are being written to the cache count too.
    while run.pager.stats().merged < TILES as u64 || run.pager.stats().loading_bytes > 0 {
        assert!(Instant::now() < until, "{:?} {:?}", run.pager.stats(), run.pager.errors());
        run.frame(above(10.0));
        std::thread::sleep(Duration::from_millis(1));
    }
    let stats = *run.pager.stats();
    assert!(run.pager.errors().is_empty(), "{:?}", run.pager.errors());
    stats
}

/// Four tiles fit into each half.
fn small_budget(tile_bytes: usize) -> PagerConfig {
    PagerConfig { max_bytes_loading: 8 * tile_bytes as u64 + 8192, ..PagerConfig::default() }
}

/// Checks that loads have waited and that the budget was kept.
fn check_kept(stats: &PagerStats, config: &PagerConfig) {
    assert!(stats.loading_waits > 0, "they want more at once than fits: {stats:?}");
    assert!(stats.loading_bytes_peak <= config.max_bytes_loading, "{stats:?} {}", config.max_bytes_loading);
}

/// Regression: all requests in flight took memory, 2.5 GB.
#[cfg(target_os = "linux")]
#[test]
fn many_large_tiles_at_once_take_less_than_a_gigabyte() {
    if runs_alone(module_path!(), "many_large_tiles_at_once_take_less_than_a_gigabyte") {
        return;
    }
    let server = serve(40 << 20, |_, reply| reply);
    let mut config = PagerConfig::default();
    (config.http.read_timeout, config.http.total_timeout) = (MAX_TIME, MAX_TIME);
    let stats = load_all(&server.url, config);
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let peak = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).unwrap();
    let peak_kib: u64 = peak.trim().trim_end_matches(" kB").parse().unwrap();
    assert!(peak_kib < 1_000_000, "{peak_kib} KiB: {stats:?}");
    assert!(stats.bytes_read > (TILES * 40) as u64 * 1_000_000, "{stats:?}");
}

const SMALL: usize = 200_000;

#[test]
fn answers_with_and_without_a_length_stay_within_the_budget() {
    for how in [How::Whole, How::Chunked] {
        let server = serve(SMALL, move |_, reply| reply.how(how));
        let config = small_budget(SMALL);
        let stats = load_all(&server.url, config.clone());
        check_kept(&stats, &config);
    }
}

/// Few bytes become many.
#[test]
fn compressed_answers_stay_within_the_budget() {
    let body = {
        let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
        encoder.write_all(&whole_glb(SMALL)).unwrap();
        encoder.finish().unwrap()
    };
    for encoding in ["gzip", "identity"] {
        let body = body.clone();
        let server = serve(SMALL, move |_, _| Reply::ok(body.clone()).with("Content-Encoding", encoding));
        let config = small_budget(SMALL);
        let stats = load_all(&server.url, config.clone());
        check_kept(&stats, &config);
    }
}

#[test]
fn tile_larger_than_the_whole_budget_is_loaded_alone() {
    for how in [How::Whole, How::Chunked] {
        let server = serve(SMALL, move |_, reply| reply.how(how));
        let config = PagerConfig { max_bytes_loading: SMALL as u64, ..PagerConfig::default() };
        let stats = load_all(&server.url, config);
        // One that is read, and one page; a body without a length grows as its buffer does.
        assert!(stats.loading_bytes_peak < 4 * SMALL as u64, "{stats:?}");
    }
}

/// An answer that ends early gives back what it has announced, and so does a request that is aborted.
#[test]
fn failed_answers_give_back_what_they_announced() {
    let server = serve(SMALL, |request, reply| match request.nth {
        0 => Reply::ok(whole_glb(SMALL)).how(How::Cut),
        _ => reply,
    });
    let mut config = small_budget(SMALL);
    config.http.max_retries = 3;
    config.http.retry_backoff = Duration::from_millis(1);
    let stats = load_all(&server.url, config.clone());
    assert!(stats.loading_bytes_peak <= config.max_bytes_loading, "{stats:?}");
}

#[test]
fn requests_that_wait_are_aborted_without_a_trace() {
    let server = serve(SMALL, |_, reply| reply);
    let mut config = small_budget(SMALL);
    (config.abort_time, config.stale_time) = (Duration::ZERO, Duration::ZERO);
    let mut run = Run::new(&server.url, config.clone());
    // The pages wait for their uploads, so that requests wait for them.
    run.context.holds = true;
    run.until(above(10.0), "no load waits", |run| run.pager.stats().loading_waits > 0);
    let far = above(1e7);
    run.until(far, "they are not aborted", |run| run.pager.stats().cancelled > 0);
    run.context.holds = false;
    run.until(far, "they give nothing back", |run| run.pager.stats().loading_bytes == 0);
    run.settle(above(10.0));
    assert_eq!((run.pager.stats().resident, run.pager.stats().loading_bytes), (TILES as u64, 0));
    assert!(run.pager.stats().loading_bytes_peak <= config.max_bytes_loading, "{:?}", run.pager.stats());
}

fn write_folder(folder: &Path) {
    std::fs::write(folder.join("tileset.json"), tileset(".glb")).unwrap();
    let glb = whole_glb(SMALL);
    (0..TILES).for_each(|k| std::fs::write(folder.join(format!("{k}.glb")), &glb).unwrap());
}

#[test]
fn local_files_stay_within_the_budget() {
    let folder = tempfile::tempdir().unwrap();
    write_folder(folder.path());
    // More threads than files that fit.
    let config = PagerConfig { file_threads: 16, ..small_budget(SMALL) };
    let stats = load_all(folder.path().to_str().unwrap(), config.clone());
    assert!(stats.loading_bytes_peak <= config.max_bytes_loading, "{stats:?}");
}

#[test]
fn cache_hits_stay_within_the_budget() {
    let server = serve(SMALL, |_, reply| reply.with("Cache-Control", "max-age=1000"));
    let folder = tempfile::tempdir().unwrap();
    let mut config = small_budget(SMALL);
    config.http.cache = Some(CacheConfig::new(folder.path()));
    load_all(&server.url, config.clone());
    let asked = server.count();
    let stats = load_all(&server.url, config.clone());
    assert_eq!(server.count(), asked, "all are in the cache");
    check_kept(&stats, &config);
}

/// Contents wait for others to be merged, which wait for room on the GPU.
#[test]
fn full_gpu_budget_blocks_no_loads() {
    let server = serve(SMALL, |_, reply| reply);
    let room = 8;
    let config = PagerConfig { max_bytes_gpu: room * kit::pager::PAGE_GPU_BYTES, ..small_budget(SMALL) };
    let mut run = Run::new(&server.url, config);
    run.until(above(10.0), "the budget is not used", |run| run.pager.stats().resident == room);
    (0..100).for_each(|_| run.frame(above(10.0)));
    // Others are wanted, and all that is shown leaves.
    run.until(above(1e7), "nothing is given back", |run| run.pager.stats().loading_bytes == 0);
}
