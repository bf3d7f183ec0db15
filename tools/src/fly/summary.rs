//! The summary of a flight: five lines for standard output, and a line for each kind of error for standard error.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use terrane::viewer::Report;

/// Facts about a flight that are not in its report.
pub struct Notes<'a> {
    /// "offscreen" or "in a window", with the reason if it is not the expected one.
    pub where_drawn: &'a str,
    /// True if the user ended the flight before its last frame.
    pub stopped: bool,
    /// Files that were written, each as "KIND in PATH".
    pub written: Vec<String>,
    /// True for `terrane view`, which writes nothing.
    pub is_interactive: bool,
}

/// Returns five lines: frames and adapter, frame times, times of the stages, tiles, results.
pub fn lines(report: &Report, notes: &Notes) -> String {
    let Report { size: [width, height], frame_ms, phase_ms, tiles, bytes, .. } = report;
    let mebibytes = |bytes: u64| bytes as f64 / f64::from(1 << 20);
    let mut text = String::new();
    // Writing to a String cannot fail.
    let _ = writeln!(
        text,
        "flew    {} frames of {width}x{height} {} on {}, {}{}",
        report.frames,
        notes.where_drawn,
        report.adapter,
        report.threading,
        if notes.stopped { ", stopped early" } else { "" }
    );
    let _ = writeln!(
        text,
        "frame   {:.2} ms median, {:.2} p95, {:.2} p99, {:.2} max, {} hitches; {} draw calls, {} triangles",
        frame_ms.median,
        frame_ms.p95,
        frame_ms.p99,
        frame_ms.max,
        report.hitches,
        report.draw.draw_calls,
        report.draw.triangles
    );
    let _ = writeln!(
        text,
        "phases  update {:.2} ms (merge {:.2}), cull {:.2}, draw {:.2}, compile {:.2}{}",
        phase_ms.update.median,
        phase_ms.merge.median,
        phase_ms.cull.median,
        phase_ms.draw.median,
        phase_ms.compile.median,
        report.gpu_ms.map_or(String::new(), |gpu| format!(", gpu {:.2}", gpu.median))
    );
    let _ = writeln!(
        text,
        "tiles   {} loaded, {} merged, {} expired, {} failed; {:.1} MiB read, {:.1} MiB on the GPU",
        tiles.loaded,
        tiles.merged,
        tiles.expired,
        tiles.failed,
        mebibytes(bytes.read),
        mebibytes(bytes.gpu_peak)
    );
    let mut results = Vec::new();
    if let Some(seconds) = report.converge_s {
        results.push(format!("converged in {seconds:.2} s"));
    }
    if let Some(settled) = &report.settled {
        results.push(format!(
            "settled on {} tiles with {} triangles, {:.1} % covered",
            settled.tiles,
            settled.triangles,
            100.0 * settled.coverage
        ));
    }
    if let Some(holes) = report.holes {
        results.push(format!("{holes} hole pixels"));
    }
    if let Some(cache) = &report.cache {
        let kept = cache.hits + cache.revalidated;
        results.push(format!("{kept} of {} answers from the cache", kept + cache.misses));
    }
    if let Some(sharing) = report.sharing.filter(|s| s.gpu_bytes_saved_peak > 0) {
        let saved = mebibytes(sharing.gpu_bytes_saved_peak);
        results.push(format!("sharing saved {saved:.1} MiB of the GPU"));
    }
    if notes.written.is_empty() && !notes.is_interactive {
        results.push(
            "no files written (--screenshot FILE writes the last frame, --report FILE the statistics)".to_owned(),
        );
    }
    results.extend(notes.written.iter().cloned());
    // Names of files may contain line ends.
    let _ = writeln!(text, "result  {}", results.join("; ").replace(['\n', '\r'], " "));
    text
}

/// Returns a line for each reason for which URIs failed, with the first of them and the number of the others.
pub fn error_lines(report: &Report) -> String {
    let mut by_reason: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
    for error in &report.errors {
        by_reason.entry(&error.reason).or_default().push(&error.uri);
    }
    let mut text = String::new();
    for (reason, uris) in by_reason {
        let more = match uris.len() - 1 {
            0 => String::new(),
            more => format!(" (and {more} more)"),
        };
        let line = format!("error: {}: {reason}{more}", uris[0]);
        // A reason may contain line ends.
        let _ = writeln!(text, "{}", line.split_whitespace().collect::<Vec<_>>().join(" "));
    }
    text
}

#[cfg(test)]
mod tests {
    use terrane::viewer::ReportError;

    use super::*;

    #[test]
    fn a_summary_has_five_lines_and_names_written_files() {
        let mut notes = Notes { where_drawn: "offscreen", stopped: false, written: Vec::new(), is_interactive: false };
        let report = Report::from_frames([].iter());
        let text = lines(&report, &notes);
        assert!(text.lines().count() == 5 && text.contains("no files written"), "{text}");
        notes.written = vec!["trace in t.json".to_owned(), "report in r\n.json".to_owned()];
        let text = lines(&report, &notes);
        assert!(text.lines().count() == 5 && text.contains("trace in t.json; report in r .json"), "{text}");
    }

    #[test]
    fn errors_are_one_line_for_each_reason() {
        let mut report = Report::from_frames([].iter());
        let error = |uri: &str, reason: &str| ReportError { uri: uri.into(), reason: reason.into(), count: 2 };
        report.errors = vec![error("a", "not found"), error("b", "bad\nlength"), error("c", "not found")];
        assert_eq!(error_lines(&report), "error: b: bad length\nerror: a: not found (and 1 more)\n");
    }
}
