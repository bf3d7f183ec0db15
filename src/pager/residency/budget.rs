//! [`Budget`]: the memory that merged and arrived pages may take, and what is left of it. Update thread.
//!
//! The budgets hold for merged pages and those that have arrived and wait for their uploads or their merge, together.
//! A page's CPU bytes are known when it arrives, and so are those of the textures of its state sets on the GPU, each counted
//! once; its other GPU bytes only after the upload. Until then the mean of recent pages is reserved, and the page waits for
//! others where that is not free. A page that turns out larger than the free room is
//! declined at once, and loaded again when there is room for it.

use crate::pager::config::PagerConfig;

/// The budgets keep this many tenths free of pages that have not been wanted for long.
pub(in crate::pager) const RESERVED_TENTHS: u64 = 1;

/// Bytes of CPU and GPU memory.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(in crate::pager) struct MemoryUse {
    pub cpu: u64,
    pub gpu: u64,
}

impl std::ops::Add for MemoryUse {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self { cpu: self.cpu + other.cpu, gpu: self.gpu + other.gpu }
    }
}

/// The maximum of memory and of pages.
#[derive(Clone, Copy, Debug)]
pub(in crate::pager) struct Budget {
    pub bytes: MemoryUse,
    pub pages: u64,
}

impl Budget {
    /// Returns the budgets of a configuration.
    pub fn new(config: &PagerConfig) -> Self {
        let bytes = MemoryUse { cpu: config.max_bytes_cpu, gpu: config.max_bytes_gpu };
        Self { bytes, pages: config.max_tiles as u64 }
    }

    /// Returns the budgets without some bytes of CPU memory.
    pub fn without_cpu(self, bytes: u64) -> Self {
        let cpu = self.bytes.cpu.saturating_sub(bytes);
        Self { bytes: MemoryUse { cpu, ..self.bytes }, ..self }
    }

    /// Returns true if a page of this size exceeds a budget alone.
    pub fn is_exceeded_by(&self, bytes: MemoryUse) -> bool {
        bytes.cpu > self.bytes.cpu || bytes.gpu > self.bytes.gpu
    }

    /// Returns true if this many bytes and pages exceed a budget.
    pub fn is_exceeded(&self, bytes: MemoryUse, pages: u64) -> bool {
        self.is_exceeded_by(bytes) || pages > self.pages
    }
}

/// Sums over the pages that have arrived and are not merged.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(in crate::pager) struct ArrivedTotal {
    pub pages: u64,
    /// Pages of them that are being uploaded.
    pub uploading: u64,
    /// Memory in use, without shared contents.
    pub bytes: MemoryUse,
    /// GPU bytes reserved for uploads whose size is not yet known.
    pub reserved_gpu: u64,
}

/// The budgets beside what merged and arrived pages take; a snapshot.
#[derive(Clone, Copy, Debug)]
pub(in crate::pager) struct Room {
    pub budget: Budget,
    /// Memory in use, including what is reserved for uploads.
    pub used: MemoryUse,
    /// Pages merged or arrived.
    pub pages: u64,
    /// Mean size of recent pages; 0 before the first.
    pub mean: MemoryUse,
    /// GPU bytes that contexts have allocated beyond what pages use, after the last upload.
    pub unused_gpu: u64,
}

impl Room {
    /// Returns true if a page of known size has room.
    pub fn fits(&self, page: MemoryUse) -> bool {
        !self.budget.is_exceeded_by(self.used + page) && self.pages < self.budget.pages
    }

    /// Returns true if an upload of this many GPU bytes has room. It takes allocated memory that is unused first; if that is
    /// of another kind, the next update finds the budget exceeded.
    pub fn fits_upload(&self, gpu_bytes: u64) -> bool {
        let added = if self.unused_gpu < gpu_bytes { self.unused_gpu + gpu_bytes } else { self.unused_gpu };
        self.used.gpu.saturating_add(added) <= self.budget.bytes.gpu
    }

    /// Returns how many pages of the mean size have room, with this many tenths of each budget kept free.
    pub fn pages_of_mean_size(&self, reserved_tenths: u64) -> u64 {
        let room =
            |max: u64, used: u64, mean: u64| without_tenths(max, reserved_tenths).saturating_sub(used) / mean.max(1);
        let cpu = room(self.budget.bytes.cpu, self.used.cpu, self.mean.cpu);
        let gpu = room(self.budget.bytes.gpu, self.used.gpu, self.mean.gpu);
        cpu.min(gpu).min(room(self.budget.pages, self.pages, 1))
    }

    /// Returns true while this many tenths of each budget are free.
    pub fn has_free_tenths(&self, tenths: u64) -> bool {
        let is_free = |used: u64, max: u64| used <= without_tenths(max, tenths);
        is_free(self.used.cpu, self.budget.bytes.cpu)
            && is_free(self.used.gpu, self.budget.bytes.gpu)
            && is_free(self.pages, self.budget.pages)
    }
}

/// Returns a budget without this many tenths of it.
fn without_tenths(budget: u64, tenths: u64) -> u64 {
    budget.saturating_sub(budget.div_ceil(10) * tenths)
}

/// Returns the moving mean of the last values, of which about eight count; `mean` is 0 before the first.
pub(in crate::pager) fn moving_mean(mean: u64, value: u64) -> u64 {
    if mean == 0 { value } else { (7 * mean + value) / 8 }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn room(used: u64, mean: u64) -> Room {
        let bytes = |bytes| MemoryUse { cpu: bytes, gpu: bytes };
        Room {
            budget: Budget { bytes: bytes(1000), pages: 10 },
            used: bytes(used),
            pages: 3,
            mean: bytes(mean),
            unused_gpu: 0,
        }
    }

    #[test]
    fn room_is_the_least_of_the_budgets() {
        assert_eq!(room(500, 100).pages_of_mean_size(0), 5);
        assert_eq!(room(500, 100).pages_of_mean_size(1), 4);
        assert_eq!(room(500, 1).pages_of_mean_size(0), 7, "the number of pages");
        assert_eq!(room(2000, 100).pages_of_mean_size(0), 0);
        assert!(
            room(900, 0).fits(MemoryUse { cpu: 100, gpu: 1 }) && !room(900, 0).fits(MemoryUse { cpu: 101, gpu: 0 })
        );
        assert!(room(900, 0).has_free_tenths(1) && !room(901, 0).has_free_tenths(1));
    }

    #[test]
    fn uploads_take_unused_memory_first() {
        let fits = |used, unused_gpu, upload| Room { unused_gpu, ..room(used, 100) }.fits_upload(upload);
        assert!(fits(900, 0, 100) && !fits(901, 0, 100));
        assert!(fits(900, 100, 100) && !fits(901, 100, 100), "what is unused is allocated already");
        assert!(fits(850, 50, 100) && !fits(851, 50, 100), "too little is unused");
    }

    #[test]
    fn mean_starts_with_the_first_value() {
        assert_eq!(moving_mean(0, 80), 80);
        assert_eq!(moving_mean(80, 160), 90);
    }
}
