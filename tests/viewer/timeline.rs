//! A recorded flight: the file can be parsed, spans of a thread are nested, all threads have names, and all requests
//! end. Needs a GPU; a software adapter suffices. It runs in a separate process, because a process has one recording.

use std::collections::{BTreeMap, BTreeSet};

use kit::process::runs_alone;
use kit::skip::or_skip;
use kit::tile_sets::mountains;
use kit::viewer::Settle;
use serde_json::Value;
use terrane::trace::{Recording, TraceError, span};
use terrane::viewer::{Slave, ThreadingModel, Viewer, ViewerConfig};

/// The number of frames of the flight.
const FRAMES: u32 = 20;

fn text<'a>(event: &'a Value, key: &str) -> &'a str {
    event[key].as_str().unwrap_or_else(|| panic!("{key} of {event}"))
}

fn number(event: &Value, key: &str) -> f64 {
    event[key].as_f64().unwrap_or_else(|| panic!("{key} of {event}"))
}

/// Checks that each span that starts inside another one ends inside it. The file's microseconds keep nanoseconds.
fn assert_nested(spans: &mut [(f64, f64, String)]) {
    const ROUNDING_US: f64 = 0.002;
    spans.sort_by(|a, b| a.0.total_cmp(&b.0).then(b.1.total_cmp(&a.1)));
    let mut open: Vec<&(f64, f64, String)> = Vec::new();
    for span in spans.iter() {
        while open.last().is_some_and(|above| above.1 <= span.0 + ROUNDING_US) {
            open.pop();
        }
        if let Some(above) = open.last() {
            assert!(span.1 <= above.1 + ROUNDING_US, "{span:?} ends after {above:?}");
        }
        open.push(span);
    }
}

#[test]
fn flight_is_recorded_completely() {
    if runs_alone(module_path!(), "flight_is_recorded_completely") {
        return;
    }
    let this_thread = std::thread::current().name().unwrap().to_owned();
    let folder = tempfile::tempdir().unwrap();
    let set = mountains(folder.path(), 4);
    let file = folder.path().join("trace.json");
    for threading in ThreadingModel::ALL {
        let config = ViewerConfig {
            size_px: [160, 90],
            threading,
            adapter: kit::adapter(),
            max_sse_px: 3.0,
            max_contexts: 2,
            ..ViewerConfig::default()
        };
        let recording = Recording::start().unwrap();
        assert!(matches!(Recording::start(), Err(TraceError::AlreadyRecording)));
        let Some(mut viewer) = or_skip(Viewer::new_offscreen(&config)) else { return };
        viewer.load(&set).unwrap();
        let first = viewer.contexts().next().unwrap();
        let second = viewer.composite_mut().open_offscreen_on(first, &config.traits()).unwrap();
        viewer.add_slave(Slave::new(second)).unwrap();
        let path = viewer.bounds().unwrap().default_path(&viewer.view().camera.world_from_eye);
        for frame in 0..FRAMES {
            viewer.view_mut().camera.world_from_eye = path.world_from_eye(f64::from(frame));
            viewer.frame().unwrap();
        }
        viewer.settle(1);
        viewer.finish().unwrap();
        let stats = *viewer.pager().unwrap().stats();
        let has_timestamps = viewer.stats().iter().any(|frame| frame.gpu_ms.is_some());
        drop(viewer);
        let never_ends = span("still open when the recording ends");
        let summary = recording.write(&file).unwrap();
        drop(never_ends);

        let json: Value = serde_json::from_slice(&std::fs::read(&file).unwrap()).unwrap();
        let events = json["traceEvents"].as_array().unwrap();
        assert_eq!(summary.lost, 0);

        // The names of threads.
        let mut names = BTreeMap::new();
        for event in events.iter().filter(|e| text(e, "name") == "thread_name") {
            let before = names.insert(number(event, "tid") as u64, text(&event["args"], "name").to_owned());
            assert!(before.is_none());
        }
        assert_eq!(names.len(), summary.threads);
        let all: BTreeSet<&str> = names.values().map(String::as_str).collect();
        let draws = if threading == ThreadingModel::SingleThreaded { None } else { Some("draw 0") };
        let culls = match threading {
            ThreadingModel::CullDrawThreadPerContext => Some("draw 0"),
            ThreadingModel::CullThreadPerCameraDrawThreadPerContext => Some("cull 0"),
            _ => None,
        };
        for name in [this_thread.as_str(), "pager-file-", "pager-decode-"].into_iter().chain(draws).chain(culls) {
            assert!(all.iter().any(|n| n.starts_with(name)), "{name} is not among {all:?}");
        }
        assert!(!all.iter().any(|n| n.starts_with("thread ")), "without a name: {all:?}");

        // The spans.
        let mut spans: BTreeMap<u64, Vec<(f64, f64, String)>> = BTreeMap::new();
        let mut stages: BTreeMap<(&str, &str), u32> = BTreeMap::new();
        for event in events.iter().filter(|e| text(e, "ph") == "X") {
            let thread = number(event, "tid") as u64;
            let name = names.get(&thread).expect("every thread has a name");
            let (at, us) = (number(event, "ts"), number(event, "dur"));
            assert!(at >= 0.0 && us >= 0.0);
            spans.entry(thread).or_default().push((at, at + us, text(event, "name").to_owned()));
            *stages.entry((name, text(event, "name"))).or_default() += 1;
        }
        assert_eq!(spans.values().map(|s| s.len() as u64).sum::<u64>(), summary.spans);
        spans.values_mut().for_each(|spans| assert_nested(spans));
        let main = this_thread.as_str();
        let (draw, cull) = (draws.unwrap_or(main), culls.unwrap_or(main));
        // The barriers of the threading model.
        let meetings: &[(&str, &str, u32)] = match threading {
            ThreadingModel::CullDrawThreadPerContext => &[
                (main, "start barrier", FRAMES),
                (main, "end barrier", FRAMES),
                ("draw 0", "start barrier", FRAMES),
                ("draw 0", "end barrier", FRAMES),
            ],
            ThreadingModel::DrawThreadPerContext => &[
                (main, "end of dynamic draws", FRAMES),
                ("draw 0", "await frame", FRAMES),
                ("draw 0", "swap ready", FRAMES),
            ],
            ThreadingModel::CullThreadPerCameraDrawThreadPerContext => &[
                (main, "start barrier", FRAMES),
                (main, "end of dynamic draws", FRAMES),
                (main, "wait for culls", FRAMES),
                ("cull 0", "start barrier", FRAMES),
                ("draw 0", "wait for cull", FRAMES),
            ],
            _ => &[],
        };
        for &(thread, stage, least) in meetings.iter().chain(&[
            (main, "frame", FRAMES),
            (main, "event", FRAMES),
            (main, "update", FRAMES),
            (main, "merge", FRAMES),
            (main, "wait for stage", FRAMES),
            (cull, "cull", FRAMES),
            (cull, "traverse", FRAMES),
            (cull, "sort", FRAMES),
            (draw, "compile", FRAMES),
            (draw, "draw", FRAMES),
            (draw, "present", FRAMES),
        ]) {
            let count = stages.get(&(thread, stage)).copied().unwrap_or(0);
            assert!(count >= least, "{threading}: {count} of {stage} on {thread}");
        }
        let of = |stage: &str| stages.iter().filter(|((_, s), _)| *s == stage).map(|(_, n)| u64::from(*n)).sum::<u64>();
        assert!(of("fetch") >= stats.loaded && of("decode") >= stats.loaded && stats.loaded > 5, "{stages:?}");
        assert_eq!(of("still open when the recording ends"), 0);

        // The adapter's work has a track for each context. It starts after its frame began, and ends before the frame
        // that waited for it.
        let frames_of = |line: &str| -> BTreeMap<u32, (f64, f64)> {
            let is_frame = |e: &&Value| text(e, "ph") == "X" && text(e, "name") == "frame";
            let on_line = |e: &&Value| names[&(number(e, "tid") as u64)] == line;
            let of = |e: &Value| {
                (text(&e["args"], "of").parse().unwrap(), (number(e, "ts"), number(e, "ts") + number(e, "dur")))
            };
            events.iter().filter(is_frame).filter(on_line).map(of).collect()
        };
        let begun = frames_of(main);
        for line in ["gpu 0", "gpu 1"].into_iter().filter(|_| has_timestamps) {
            let drawn = frames_of(line);
            let pictures = stages.get(&(line, "picture")).copied().unwrap_or(0);
            assert!(drawn.len() > 10 && drawn.len() as u32 == pictures, "{threading}: {} of {pictures}", drawn.len());
            for (frame, (from, to)) in &drawn {
                assert!(*from >= begun[frame].0 && to > from, "{threading}: frame {frame} on {line} before it began");
                let later = begun.get(&(frame + 6)).map_or(f64::INFINITY, |(at, _)| *at);
                assert!(*to <= later, "{threading}: frame {frame} on {line} ends {} us too late", to - later);
            }
        }

        // The requests.
        let mut requests: BTreeMap<&str, Vec<(&str, f64, &Value)>> = BTreeMap::new();
        for event in events.iter().filter(|e| ["b", "e"].contains(&text(e, "ph"))) {
            assert!(names.contains_key(&(number(event, "tid") as u64)));
            let request = requests.entry(text(event, "id")).or_default();
            request.push((text(event, "ph"), number(event, "ts"), &event["args"]));
        }
        assert_eq!(requests.len() as u64, summary.requests);
        assert_eq!(summary.requests, stats.requested, "all requests are recorded from their start");
        let mut outcomes: BTreeMap<&str, u64> = BTreeMap::new();
        for (id, events) in &requests {
            let [(begin, from, args), .., (end, to, ended)] = events[..] else { panic!("{id}: {events:?}") };
            assert_eq!((begin, end), ("b", "e"), "{id}");
            assert!(from <= to && text(args, "uri").ends_with(".exr"), "{id}: {args}");
            *outcomes.entry(text(ended, "outcome")).or_default() += 1;
        }
        let outcome = |name: &str| outcomes.get(name).copied().unwrap_or(0);
        assert_eq!(outcome("merged"), stats.merged, "{outcomes:?} {stats:?}");
        assert_eq!(outcome("stale"), stats.stale);
        assert_eq!(outcome("cancelled"), stats.cancelled, "{outcomes:?} {stats:?}");
        assert_eq!(outcome("declined"), stats.declined);
        assert_eq!((outcome("failed"), stats.failed), (0, 0));
        assert_eq!(outcome("unfinished"), stats.waiting + stats.in_flight);
    }
}
