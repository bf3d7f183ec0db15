//! The five lines that a flight ends with.

use std::fmt::Write as _;
use std::path::Path;

use terrane::viewer::Report;

/// What the report does not hold.
pub struct Notes<'a> {
    pub where_drawn: &'a str,
    pub stopped: bool,
    pub pictures: Option<(usize, Option<&'a Path>)>,
    pub report_file: Option<&'a Path>,
}

/// Always five lines: what was drawn, frames, phases, tiles, results.
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
        results.push(format!("settled on {} tiles, {:.1} % covered", settled.tiles, 100.0 * settled.coverage));
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
        let hits = sharing.geometry_hits + sharing.texture_hits + sharing.state_set_hits;
        results.push(format!("{hits} shared contents saved {saved:.1} MiB of the GPU"));
    }
    if let Some(error) = report.errors.first() {
        let more = report.errors.len() - 1;
        let rest = if more > 0 { format!(" and {more} more") } else { String::new() };
        results.push(format!("error: {}: {}{rest}", error.uri, error.reason));
    }
    if let Some((count, Some(folder))) = notes.pictures {
        results.push(format!("{count} pictures in {}", folder.display()));
    }
    if let Some(file) = notes.report_file {
        results.push(format!("report in {}", file.display()));
    }
    if results.is_empty() {
        results.push("nothing asked for".to_owned());
    }
    // An error's text may hold line ends.
    let _ = writeln!(text, "result  {}", results.join("; ").replace(['\n', '\r'], " "));
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn five_lines() {
        let notes = Notes { where_drawn: "offscreen", stopped: false, pictures: None, report_file: None };
        assert_eq!(lines(&Report::from_frames([].iter()), &notes).lines().count(), 5);
    }
}
