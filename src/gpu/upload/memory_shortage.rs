//! [`MemoryShortage`]: whether uploads wait because a staging buffer could not be allocated. Draw thread.

/// The result of the last allocation of a staging buffer.
#[derive(Default)]
pub(super) struct MemoryShortage {
    is_short: bool,
    /// The first error of a shortage, until it is reported.
    unreported: Option<String>,
}

impl MemoryShortage {
    /// Notes the result of an allocation. Of a series of errors only the first is reported.
    pub(super) fn note(&mut self, error: Option<String>) {
        let was_short = std::mem::replace(&mut self.is_short, error.is_some());
        if !was_short && error.is_some() {
            self.unreported = error;
        }
    }

    /// Returns true while uploads wait for memory.
    pub(super) fn is_short(&self) -> bool {
        self.is_short
    }

    /// Takes the error of a shortage that has begun.
    pub(super) fn take_unreported(&mut self) -> Option<String> {
        self.unreported.take()
    }
}
