//! The state of a buffer that is mapped for reading. The draw thread starts and resets it; wgpu's callback, which runs on
//! the thread that polls the device, completes it.

use std::sync::Arc;
use std::sync::atomic::{AtomicU8, Ordering};

/// The steps of reading a buffer back.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::draw) enum MappingState {
    Idle,
    InFlight,
    Ready,
    Failed,
}

/// A [`MappingState`] shared with wgpu's callback.
#[derive(Debug)]
pub(in crate::draw) struct Mapping(Arc<AtomicU8>);

impl Default for Mapping {
    fn default() -> Self {
        Self(Arc::new(AtomicU8::new(MappingState::Idle as u8)))
    }
}

impl Mapping {
    pub(in crate::draw) fn state(&self) -> MappingState {
        use MappingState::{Failed, Idle, InFlight, Ready};
        let state = self.0.load(Ordering::Acquire);
        [Idle, InFlight, Ready].into_iter().find(|s| *s as u8 == state).unwrap_or(Failed)
    }

    /// Maps a buffer for reading once its submission has finished.
    pub(in crate::draw) fn start(&self, buffer: &wgpu::Buffer) {
        self.0.store(MappingState::InFlight as u8, Ordering::Release);
        let state = self.0.clone();
        buffer.map_async(wgpu::MapMode::Read, .., move |result| {
            let done = if result.is_ok() { MappingState::Ready } else { MappingState::Failed };
            state.store(done as u8, Ordering::Release);
        });
    }

    /// Marks the buffer as unmapped and free to be used again.
    pub(in crate::draw) fn reset(&self) {
        self.0.store(MappingState::Idle as u8, Ordering::Release);
    }
}
