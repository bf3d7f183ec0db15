//! [`Track`]: a line for work outside of our threads.

use std::sync::Arc;
use std::time::Instant;

use super::buffers::{Event, EventKind, since};
use super::recording::{Joined, current, join};

/// A line of the recording for the work of an adapter, whose times are known only later.
#[derive(Debug)]
pub(crate) struct Track {
    name: String,
    joined: Option<Joined>,
    /// End of the last span in nanoseconds. Spans do not overlap.
    last_end_ns: u64,
}

impl Track {
    pub(crate) fn new(name: String) -> Self {
        Self { name, joined: None, last_end_ns: 0 }
    }

    /// Adds a span from `whole[0]` to `whole[1]` that contains the spans `inside`, one after the other. Does nothing without a
    /// recording. Times before the recording or before the end of the previous span are clipped.
    pub(crate) fn spans(
        &mut self,
        name: &'static str,
        detail: impl FnOnce() -> Arc<str>,
        whole: [Instant; 2],
        inside: impl Iterator<Item = (&'static str, [Instant; 2])>,
    ) {
        let Some(recording) = current() else {
            self.joined = None;
            return;
        };
        if self.joined.as_ref().is_none_or(|joined| joined.recording != recording) {
            self.joined = join(recording, Some(&self.name));
            self.last_end_ns = 0;
        }
        let Some(joined) = &self.joined else { return };
        let mut from_ns = since(joined.start, whole[0]).max(self.last_end_ns);
        let end_ns = since(joined.start, whole[1]);
        if end_ns <= from_ns {
            return;
        }
        self.last_end_ns = end_ns;
        let mut events = joined.buffer.lock();
        let span = |name, at_ns, ns, detail| Event { name, at_ns, detail, kind: EventKind::Span { ns } };
        events.push(span(name, from_ns, end_ns - from_ns, Some(detail())));
        for (name, [begin, end]) in inside {
            let begin_ns = since(joined.start, begin).clamp(from_ns, end_ns);
            let until_ns = since(joined.start, end).clamp(begin_ns, end_ns);
            events.push(span(name, begin_ns, until_ns - begin_ns, None));
            from_ns = until_ns;
        }
    }
}
