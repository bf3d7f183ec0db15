//! The schema of the report is stable: names and kinds of all fields. No GPU.

use serde_json::Value;
use terrane::viewer::{FrameStats, Report, ReportError, Settled};

fn keys(value: &Value) -> Vec<&str> {
    value.as_object().unwrap().keys().map(String::as_str).collect()
}

fn sample() -> Report {
    let frames: Vec<FrameStats> = (1..=100)
        .map(|frame| FrameStats {
            frame,
            frame_ms: f64::from(frame),
            draw_ms: 2.0,
            gpu_ms: Some(1.5),
            triangles: 1000,
            draw_calls: 3,
            drawn: true,
            ..FrameStats::default()
        })
        .collect();
    let mut report = Report::from_frames(frames.iter());
    report.settled = Some(Settled::default());
    report.errors.push(ReportError { uri: "a".into(), reason: "b".into(), count: 2 });
    report
}

#[test]
fn all_fields_of_the_schema_are_present() {
    let json: Value = serde_json::from_str(&sample().to_json()).unwrap();
    let expect = |value: &Value, names: &[&str]| {
        let mut names = names.to_vec();
        names.sort_unstable();
        let mut found = keys(value);
        found.sort_unstable();
        assert_eq!(found, names);
    };
    expect(
        &json,
        &[
            "tool",
            "version",
            "adapter",
            "threading",
            "size",
            "frames",
            "frame_ms",
            "phase_ms",
            "gpu_ms",
            "tiles",
            "bytes",
            "cache",
            "sharing",
            "images",
            "converge_s",
            "draw",
            "hitches",
            "holes",
            "settled",
            "errors",
            "ignored",
        ],
    );
    expect(&json["frame_ms"], &["median", "p95", "p99", "max"]);
    expect(&json["phase_ms"], &["event", "update", "merge", "cull", "draw", "compile"]);
    expect(&json["phase_ms"]["draw"], &["median", "p99", "max"]);
    expect(&json["gpu_ms"], &["median", "p99", "max"]);
    expect(&json["tiles"], &["requested", "loaded", "merged", "expired", "failed", "cancelled", "stale"]);
    let bytes = [
        "read",
        "http",
        "decoded",
        "gpu_peak",
        "cpu_peak",
        "loading_peak",
        "loading_waits",
        "loading_wait_ms",
        "rss_peak",
    ];
    expect(&json["bytes"], &bytes);
    let draw = [
        "leaves",
        "unsampled_leaves",
        "draw_calls",
        "state_changes",
        "triangles",
        "shadow_leaves",
        "shadow_draw_calls",
    ];
    expect(&json["draw"], &draw);
    expect(&json["settled"], &["tiles", "contents", "triangles", "points", "coverage"]);
    expect(&json["errors"][0], &["uri", "reason", "count"]);
    assert_eq!(json["tool"], "terrane");
    assert!(json["size"].as_array().is_some_and(|s| s.len() == 2));
}

#[test]
fn percentiles_and_medians_are_interpolated() {
    let report = sample();
    let f = report.frame_ms;
    assert_eq!((f.median, f.p95, f.p99, f.max), (50.0, 95.0, 99.0, 100.0));
    assert_eq!(report.hitches, 0);
    assert_eq!((report.draw.triangles, report.draw.draw_calls), (1000, 3));
    assert!(cfg!(not(target_os = "linux")) || report.bytes.rss_peak > 1 << 20);
}

#[test]
fn report_can_be_read_back() {
    let report = sample();
    assert_eq!(serde_json::from_str::<Report>(&report.to_json()).unwrap(), report);
    // A report without any measurement is valid.
    let empty = Report::from_frames([].iter());
    assert_eq!(serde_json::from_str::<Report>(&empty.to_json()).unwrap(), empty);
}
