//! The bridge to the crate `tracing` (feature `tracing`): spans and requests for the application's own subscriber.
//!
//! Spans have the target `terrane` and the level DEBUG. A span of a thread is entered on that thread. A request is a span
//! `request` with the fields `uri` and `outcome`, and its own spans are its children. `tracing` requires a static callsite per
//! span name, so one is created for each name on first use. There are some dozens of names, and callsites live forever.

use std::collections::HashMap;
use std::sync::atomic::{AtomicU8, Ordering};
use std::sync::{Mutex, MutexGuard, OnceLock, PoisonError, RwLock};

use tracing::callsite::{Callsite, Identifier, register};
use tracing::field::{FieldSet, Value};
use tracing::level_filters::LevelFilter;
use tracing::metadata::Kind;
use tracing::subscriber::Interest;
use tracing::{Level, Metadata, dispatcher};

use super::redact::without_secrets;

const TARGET: &str = "terrane";
const LEVEL: Level = Level::DEBUG;
const FIELDS: &[&str] = &["of", "uri", "outcome"];

/// A span as a subscriber sees it. Ends when it is dropped.
#[derive(Debug, Default)]
pub(super) struct ObservedSpan {
    span: Option<tracing::Span>,
    /// True if the span was entered on its thread.
    is_entered: bool,
}

impl Drop for ObservedSpan {
    fn drop(&mut self) {
        if let Some(span) = self.span.as_ref().filter(|_| self.is_entered) {
            span.with_subscriber(|(id, dispatch)| dispatch.exit(id));
        }
    }
}

/// Returns false if no subscriber of the process is interested in spans of our level.
#[inline]
pub(super) fn is_enabled() -> bool {
    LEVEL <= LevelFilter::current()
}

/// Opens a span and enters it on this thread.
pub(super) fn enter(name: &'static str, detail: Option<&str>) -> ObservedSpan {
    let detail = detail.map(without_secrets);
    let span = open(name, None, "of", detail.as_deref());
    if let Some(span) = &span {
        span.with_subscriber(|(id, dispatch)| dispatch.enter(id));
    }
    ObservedSpan { span, is_entered: true }
}

/// Opens a span inside the span of a request. It is not entered, since spans of several requests may overlap on a thread.
pub(super) fn open_in_request(name: &'static str, ticket: u64) -> ObservedSpan {
    let parent = requests().get(&ticket).cloned();
    ObservedSpan { span: open(name, parent.as_ref(), "of", None), is_entered: false }
}

/// Opens the span of a request.
pub(super) fn request_begins(ticket: u64, uri: &str) {
    if let Some(span) = open("request", None, "uri", Some(&*without_secrets(uri))) {
        requests().insert(ticket, span);
    }
}

/// Records the outcome of a request and closes its span.
pub(super) fn request_ends(ticket: u64, outcome: &'static str) {
    let span = requests().remove(&ticket);
    if let Some(span) = span {
        span.record("outcome", outcome);
    }
}

/// The open spans of requests by ticket. Locked briefly by the threads that begin and end requests.
fn requests() -> MutexGuard<'static, HashMap<u64, tracing::Span>> {
    static REQUESTS: OnceLock<Mutex<HashMap<u64, tracing::Span>>> = OnceLock::new();
    REQUESTS.get_or_init(Mutex::default).lock().unwrap_or_else(PoisonError::into_inner)
}

/// Opens a span if the subscriber of this thread wants it. `text` is the value of the field `field`.
fn open(name: &'static str, parent: Option<&tracing::Span>, field: &str, text: Option<&str>) -> Option<tracing::Span> {
    let callsite = callsite(name);
    if !callsite.is_wanted() {
        return None;
    }
    let metadata = callsite.metadata.get()?;
    let field = metadata.fields().field(field)?;
    let value = text.as_ref().map(|text| text as &dyn Value);
    let values = [(&field, value)];
    let values = metadata.fields().value_set(&values);
    Some(match parent {
        Some(parent) => tracing::Span::child_of(parent, metadata, &values),
        None => tracing::Span::new(metadata, &values),
    })
}

/// A callsite of `tracing` for one span name.
struct NamedCallsite {
    metadata: OnceLock<Metadata<'static>>,
    /// The interest of all subscribers together: [`NEVER`], [`SOMETIMES`] or [`ALWAYS`].
    interest: AtomicU8,
}

const NEVER: u8 = 0;
const SOMETIMES: u8 = 1;
const ALWAYS: u8 = 2;

impl NamedCallsite {
    fn is_wanted(&self) -> bool {
        match self.interest.load(Ordering::Relaxed) {
            NEVER => false,
            ALWAYS => true,
            _ => self.metadata.get().is_some_and(|metadata| dispatcher::get_default(|of| of.enabled(metadata))),
        }
    }
}

impl Callsite for NamedCallsite {
    fn set_interest(&self, interest: Interest) {
        let interest = match interest {
            interest if interest.is_never() => NEVER,
            interest if interest.is_always() => ALWAYS,
            _ => SOMETIMES,
        };
        self.interest.store(interest, Ordering::Relaxed);
    }

    fn metadata(&self) -> &Metadata<'_> {
        self.metadata.get().expect("set before the callsite is registered")
    }
}

/// Returns the callsite of a name; creates and registers it on first use.
fn callsite(name: &'static str) -> &'static NamedCallsite {
    static CALLSITES: OnceLock<RwLock<HashMap<&'static str, &'static NamedCallsite>>> = OnceLock::new();
    let callsites = CALLSITES.get_or_init(RwLock::default);
    if let Some(known) = callsites.read().unwrap_or_else(PoisonError::into_inner).get(name) {
        return known;
    }
    let mut callsites = callsites.write().unwrap_or_else(PoisonError::into_inner);
    if let Some(known) = callsites.get(name) {
        return known;
    }
    let new: &'static NamedCallsite =
        Box::leak(Box::new(NamedCallsite { metadata: OnceLock::new(), interest: AtomicU8::new(SOMETIMES) }));
    let fields = FieldSet::new(FIELDS, Identifier(new));
    let module = Some(module_path!());
    let _ = new.metadata.set(Metadata::new(name, TARGET, LEVEL, None, None, module, fields, Kind::SPAN));
    register(new);
    callsites.insert(name, new);
    new
}

#[cfg(test)]
mod tests {
    use std::fmt::{Debug, Write as _};
    use std::sync::Arc;
    use std::sync::atomic::AtomicU64;

    use tracing::field::{Field, Visit};
    use tracing::span::{Attributes, Id, Record};
    use tracing::{Event, Subscriber, subscriber};

    use super::super::{request_begins, request_ends, request_span, span, span_of};
    use super::*;

    /// Writes one line for everything that happens to a span.
    #[derive(Clone, Default)]
    struct Log {
        lines: Arc<Mutex<Vec<String>>>,
        last_id: Arc<AtomicU64>,
    }

    impl Log {
        fn push(&self, line: String) {
            self.lines.lock().unwrap().push(line);
        }
    }

    #[derive(Default)]
    struct Fields(String);

    impl Visit for Fields {
        fn record_debug(&mut self, field: &Field, value: &dyn Debug) {
            write!(self.0, " {field}={value:?}").unwrap();
        }
    }

    impl Subscriber for Log {
        fn enabled(&self, metadata: &Metadata<'_>) -> bool {
            metadata.target() == TARGET && metadata.name() != "unwanted"
        }

        fn new_span(&self, attributes: &Attributes<'_>) -> Id {
            let id = self.last_id.fetch_add(1, Ordering::Relaxed) + 1;
            let mut fields = Fields::default();
            attributes.record(&mut fields);
            let parent = attributes.parent().map_or(String::new(), |parent| format!(" in {}", parent.into_u64()));
            self.push(format!("new {id} {}{parent}{}", attributes.metadata().name(), fields.0));
            Id::from_u64(id)
        }

        fn record(&self, id: &Id, values: &Record<'_>) {
            let mut fields = Fields::default();
            values.record(&mut fields);
            self.push(format!("record {}{}", id.into_u64(), fields.0));
        }

        fn record_follows_from(&self, _: &Id, _: &Id) {}

        fn event(&self, _: &Event<'_>) {}

        fn enter(&self, id: &Id) {
            self.push(format!("enter {}", id.into_u64()));
        }

        fn exit(&self, id: &Id) {
            self.push(format!("exit {}", id.into_u64()));
        }

        fn try_close(&self, id: Id) -> bool {
            self.push(format!("close {}", id.into_u64()));
            true
        }

        fn clone_span(&self, id: &Id) -> Id {
            id.clone()
        }
    }

    #[test]
    fn a_subscriber_sees_spans_and_requests_without_secrets() {
        let log = Log::default();
        subscriber::with_default(log.clone(), || {
            let frame = span_of("frame", || "7".into());
            drop(span("cull"));
            drop(span("unwanted"));
            drop(frame);
            request_begins(5, &"https://me:secret@h/a.glb?key=secret".into());
            let fetch = request_span("fetch", 5);
            drop(fetch);
            request_ends(5, "merged");
        });
        // Closing depends on the number of handles, which is not of interest here.
        let lines: Vec<String> =
            log.lines.lock().unwrap().iter().filter(|l| !l.starts_with("close")).cloned().collect();
        let expected = [
            "new 1 frame of=\"7\"",
            "enter 1",
            "new 2 cull",
            "enter 2",
            "exit 2",
            "exit 1",
            "new 3 request uri=\"https://h/a.glb\"",
            "new 4 fetch in 3",
            "record 3 outcome=\"merged\"",
        ];
        assert_eq!(lines, expected);
        assert!(log.lines.lock().unwrap().iter().any(|line| line == "close 4"));
        // Without a subscriber nothing is observed.
        drop(span("frame"));
        assert_eq!(log.lines.lock().unwrap().iter().filter(|line| line.starts_with("new")).count(), 4);
    }
}
