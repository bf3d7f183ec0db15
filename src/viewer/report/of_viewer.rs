//! [`Viewer::report`]: adds the counters of pager, cache and errors to the report on the frames.

use super::schema::{Bytes, Images, Report, ReportError, Sharing, Tiles};
use crate::pager::{ErrorRecord, ImagePagerStats, PagerStats};
use crate::viewer::{Viewer, ViewerError};

impl Sharing {
    fn from_pager(pager: &PagerStats) -> Self {
        let s = &pager.sharing;
        Self {
            texture_hits: s.texture_hits,
            geometry_hits: s.geometry_hits,
            state_set_hits: s.state_set_hits,
            decodes_spared: s.decodes_spared,
            payload_bytes_spared: s.payload_bytes_spared,
            cpu_bytes_saved: pager.shared_cpu_bytes_saved,
            gpu_bytes_saved: pager.shared_gpu_bytes_saved,
            gpu_bytes_saved_peak: pager.shared_gpu_bytes_saved_peak,
            entries: s.entries,
            pruned: s.pruned,
        }
    }
}

impl Images {
    fn from_pager(s: &ImagePagerStats) -> Self {
        Self {
            loaded: s.loaded,
            failed: s.failed,
            cancelled: s.cancelled,
            paged_out: s.paged_out,
            shown: s.shown,
            late: s.late,
            read: s.bytes_read,
            images_peak: s.images_peak,
            bytes_peak: s.bytes_peak,
        }
    }
}

impl Viewer {
    /// Returns the report on all frames so far; waits for the frames in flight.
    pub fn report(&mut self) -> Result<Report, ViewerError> {
        self.finish()?;
        let mut report = Report::from_frames(self.stats().iter());
        report.frames = self.stats().count();
        report.adapter = self.composite().adapter_name().to_owned();
        report.threading = self.composite().threading_model().to_string();
        report.size = self.view().size_px();
        report.converge_s = self.converge_s();
        report.bytes.gpu_peak = self.composite().gpu_bytes_peak();
        if let Some(pager) = self.pager() {
            let s = pager.stats();
            report.tiles = Tiles {
                requested: s.requested,
                loaded: s.loaded,
                merged: s.merged,
                expired: s.expired,
                failed: s.failed,
                cancelled: s.cancelled,
                stale: s.stale,
            };
            report.bytes = Bytes {
                read: s.bytes_read,
                http: s.bytes_http,
                decoded: s.bytes_decoded,
                cpu_peak: s.cpu_bytes_peak,
                loading_peak: s.loading_bytes_peak,
                loading_waits: s.loading_waits,
                loading_wait_ms: (1000.0 * s.loading_wait_s) as u64,
                ..report.bytes
            };
            report.ignored = pager.ignored().iter().map(|(kind, count)| (kind.to_owned(), count)).collect();
            report.cache = pager.cache_stats();
            report.sharing = pager.sharing().map(|_| Sharing::from_pager(s));
            report.errors = pager
                .errors()
                .into_iter()
                .map(|e| ReportError { uri: e.uri.to_string(), reason: e.reason.to_string(), count: e.count })
                .collect();
        }
        if let Some(images) = self.image_pager() {
            report.images = Some(Images::from_pager(images.stats()));
            let record =
                |e: ErrorRecord| ReportError { uri: e.uri.to_string(), reason: e.reason.to_string(), count: e.count };
            report.errors.extend(images.errors().into_iter().map(record));
        }
        let draw_error = |reason: &String| ReportError { uri: "draw".into(), reason: reason.clone(), count: 1 };
        report.errors.extend(self.composite().draw_errors().iter().map(draw_error));
        Ok(report)
    }
}
