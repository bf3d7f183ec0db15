//! The states of requests that the pager reports. Each state is held and checked. No GPU.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use kit::pager::{Run, above};
use kit::server::{How, Reply, Request, Server};
use terrane::fetch::HttpConfig;
use terrane::formats::writers::{GlbMesh, write_glb};
use terrane::pager::{PagerConfig, RequestState};

const CHILDREN: usize = 8;

/// Returns a square of `side` x `side` vertices.
fn glb(side: u16) -> Vec<u8> {
    let corners = |row: u16| (0..side).map(move |column| [f32::from(column), 0.0, f32::from(row)]);
    let cell = |at: u16| [at, at + 1, at + side, at + 1, at + side + 1, at + side];
    let cells = (0..side - 1).flat_map(|row| (0..side - 1).map(move |column| row * side + column));
    write_glb(&GlbMesh {
        positions: (0..side).flat_map(corners).collect(),
        indices: cells.flat_map(cell).collect(),
        base_color: [1.0; 4],
        ..GlbMesh::default()
    })
}

/// Returns a root that needs its eight children.
fn set() -> String {
    let tile = |name: &str, error: f64, children: &str| {
        format!(
            r#"{{"boundingVolume":{{"sphere":[0,0,0,2]}},"geometricError":{error},"content":{{"uri":"{name}.glb"}},"children":[{children}]}}"#
        )
    };
    let children: Vec<String> = (0..CHILDREN).map(|i| tile(&format!("child{i}"), 0.0, "")).collect();
    let root = tile("root", 5.0, &children.join(","));
    format!(r#"{{"asset":{{"version":"1.1"}},"geometricError":9,"root":{root}}}"#)
}

fn config() -> PagerConfig {
    let long = Duration::from_secs(100);
    PagerConfig {
        http: HttpConfig { first_byte_timeout: long, read_timeout: long, max_retries: 0, ..HttpConfig::default() },
        retry_after: long,
        max_tries: Some(2),
        decode_threads: 1,
        merge_time: Duration::ZERO,
        ..PagerConfig::default()
    }
}

/// Serves a set. `answer` decides about requests for its contents.
fn start(config: PagerConfig, answer: impl Fn(&Request) -> Reply + Send + Sync + 'static) -> Run {
    let server = Server::start(move |request| match request.path() {
        "/set/tileset.json" => Reply::ok(set()),
        _ => answer(request),
    });
    Run::new(&format!("{}/set/", server.url), config)
}

fn in_state(run: &Run, state: RequestState) -> usize {
    let states = run.pager.request_states();
    let count = states.filter(|(slot, s)| *s == state && run.pager.request_state(*slot) == Some(state)).count();
    let stats = run.pager.stats();
    assert_eq!(stats.waiting + stats.in_flight + failed(run), run.pager.request_states().count() as u64, "{stats:?}");
    count
}

fn failed(run: &Run) -> u64 {
    let has_failed = |state| matches!(state, RequestState::Failed | RequestState::Retrying);
    run.pager.request_states().filter(|(_, state)| has_failed(*state)).count() as u64
}

const NEAR: f64 = 10.0;

#[test]
fn waiting_requested_and_failed_tiles_have_distinct_states() {
    let config = PagerConfig { http_in_flight: 3, http_in_flight_max: 3, ..config() };
    let is_mute = Arc::new(AtomicBool::new(true));
    let mute = is_mute.clone();
    let mut run = start(config, move |request| match request.path() {
        _ if mute.load(Ordering::Relaxed) => Reply::ok("").how(How::Silent),
        "/set/child0.glb" => Reply::new(404, ""),
        "/set/child1.glb" => Reply::new(500, ""),
        "/set/child2.glb" => Reply::ok("no glTF"),
        _ => Reply::ok(glb(2)),
    });
    run.pager.set_paused(true);
    run.frame(above(NEAR));
    run.frame(above(NEAR));
    assert_eq!(in_state(&run, RequestState::Waiting), CHILDREN + 1);
    run.pager.set_paused(false);
    // Three unanswered requests occupy all slots of the server.
    run.until(above(NEAR), "three are requested", |run| in_state(run, RequestState::ReadingHttp) == 3);
    run.frame(above(NEAR));
    assert_eq!((in_state(&run, RequestState::ReadingHttp), in_state(&run, RequestState::Waiting)), (3, CHILDREN - 2));
    let stats = *run.pager.stats();
    assert_eq!((stats.in_flight, stats.decoding, stats.compiling, failed(&run)), (3, 0, 0, 0), "{stats:?}");
    is_mute.store(false, Ordering::Relaxed);
    run.pager.clear(&mut run.scene, &mut [&mut run.context]);
    run.until(above(NEAR), "the rest is merged", |run| run.pager.stats().resident == CHILDREN as u64 - 2);
    run.until(above(NEAR), "three have failed", |run| failed(run) == 3);
    // A body that is not a valid content may have been corrupted in transfer.
    assert_eq!((in_state(&run, RequestState::Failed), in_state(&run, RequestState::Retrying)), (1, 2));
    assert_eq!(run.pager.request_states().count(), 3, "merged tiles are not requests");
}

#[test]
fn loaded_content_is_decoded_then_uploaded_then_merged() {
    // One thread decodes all of them and builds their k-d trees.
    let config = PagerConfig { build_kd_trees: true, ..config() };
    let mut run = start(config, |_| Reply::ok(glb(250)));
    run.context.holds = true;
    run.until(above(NEAR), "decoding is visible", |run| in_state(run, RequestState::Decoding) > 0);
    run.until(above(NEAR), "all are compiled", |run| in_state(run, RequestState::Compiling) == CHILDREN + 1);
    let stats = run.pager.stats();
    assert_eq!((stats.decoding, stats.compiling, stats.in_flight), (0, 9, 9));
    run.context.holds = false;
    // A frame has time to merge one page.
    run.frame(above(NEAR));
    assert_eq!((in_state(&run, RequestState::Merging), run.pager.stats().compiling), (CHILDREN, 8));
    run.settle(above(NEAR));
    assert_eq!(run.pager.request_states().count(), 0);
}
