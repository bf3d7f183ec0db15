//! The tables of a page: draw counters, pager counters and image pager counters, and what readers left out. Main thread, event
//! phase.

use crate::viewer::{FrameStats, GuiActionAdapter};

/// A name and a value.
pub(super) type Cell = (&'static str, String);

/// Returns the draw counters of the last frame; `None` before the first.
pub(super) fn drawing(recent: &[&FrameStats]) -> Option<Vec<Cell>> {
    let last = recent.first()?;
    Some(vec![
        ("leaves", last.leaves.to_string()),
        ("draw calls", last.draw_calls.to_string()),
        ("triangles", thousands(last.triangles)),
        ("shadow leaves", last.shadow_leaves.to_string()),
        ("state changes", last.state_changes.to_string()),
        ("tiles drawn", last.tiles_drawn.to_string()),
        ("tiles visited", last.tiles_visited.to_string()),
        ("occluded", last.occluded.to_string()),
        ("gpu", last.gpu_ms.map_or("-".to_owned(), |ms| format!("{ms:.2} ms"))),
    ])
}

/// Returns the pager's counters; `None` without a pager.
pub(super) fn pager(viewer: &GuiActionAdapter<'_>) -> Option<Vec<Cell>> {
    let pager = viewer.pager().map(|p| p.stats())?;
    let wanted = viewer.stats().last().map_or(0, |s| s.wanted_missing);
    let mean_ms = 1e3 * pager.latency_sum_s / pager.merged.max(1) as f64;
    Some(vec![
        ("wanted", wanted.to_string()),
        ("waiting", pager.waiting.to_string()),
        ("in flight", pager.in_flight.to_string()),
        ("of them decoding", pager.decoding.to_string()),
        ("uploading", pager.compiling.to_string()),
        ("requested", pager.requested.to_string()),
        ("merged", pager.merged.to_string()),
        ("merged ahead", pager.merged_ahead.to_string()),
        ("expired", pager.expired.to_string()),
        ("cancelled", pager.cancelled.to_string()),
        ("failed", pager.failed.to_string()),
        ("pages", viewer.scene().page_count().to_string()),
        ("to merge, mean", format!("{mean_ms:.0} ms")),
        ("to merge, most", format!("{:.0} ms", 1e3 * pager.latency_max_s)),
        ("tiles on CPU", mebibytes(pager.cpu_bytes)),
        ("tiles on GPU", mebibytes(pager.gpu_bytes)),
        ("on the way", mebibytes(pager.loading_bytes)),
        ("at most", mebibytes(pager.loading_bytes_peak)),
        ("waited for it", format!("{:.1} s", pager.loading_wait_s)),
        ("read", mebibytes(pager.bytes_read)),
        ("shared images", pager.sharing.texture_hits.to_string()),
        ("saved on CPU", mebibytes(pager.shared_cpu_bytes_saved)),
        ("saved on GPU", mebibytes(pager.shared_gpu_bytes_saved)),
        ("shared shapes", pager.sharing.geometry_hits.to_string()),
    ])
}

/// Returns the image pager's counters; `None` without an image pager.
pub(super) fn images(viewer: &GuiActionAdapter<'_>) -> Option<Vec<Cell>> {
    let images = viewer.image_pager().map(|p| p.stats())?;
    Some(vec![
        ("images loaded", images.loaded.to_string()),
        ("kept", images.images.to_string()),
        ("late", images.late.to_string()),
        ("failed", images.failed.to_string()),
        ("paged out", images.paged_out.to_string()),
        ("bytes", mebibytes(images.bytes)),
    ])
}

/// The maximum number of kinds that are named.
const MAX_KINDS: usize = 4;

/// Returns a line for each of the most frequent kinds that readers left out, and one about the other kinds.
pub(super) fn left_out<'a>(ignored: impl Iterator<Item = (&'a str, u64)>) -> Vec<String> {
    let mut kinds: Vec<(&str, u64)> = ignored.collect();
    // Kinds of equal counts stay in the order of their names.
    kinds.sort_by_key(|(_, count)| std::cmp::Reverse(*count));
    let named = kinds.iter().take(MAX_KINDS).map(|(kind, count)| format!("left out {count} x {kind}"));
    let more = kinds.len().saturating_sub(MAX_KINDS);
    named.chain((more > 0).then(|| format!("left out {more} more kinds, which terrane info names"))).collect()
}

fn mebibytes(bytes: u64) -> String {
    format!("{:.1} MiB", bytes as f64 / f64::from(1 << 20))
}

fn thousands(count: u64) -> String {
    if count < 10_000 { count.to_string() } else { format!("{} k", count / 1000) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn most_frequent_kinds_that_are_left_out_are_named() {
        let counts = [("a", 1), ("b", 9), ("c", 3), ("d", 9), ("e", 2), ("f", 1)];
        let lines = left_out(counts.into_iter());
        let more = "left out 2 more kinds, which terrane info names";
        assert_eq!(lines, ["left out 9 x b", "left out 9 x d", "left out 3 x c", "left out 2 x e", more]);
        assert!(left_out(std::iter::empty()).is_empty());
    }
}
