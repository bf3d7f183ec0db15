//! [`Ignored`]: counts of the properties of contents that a reader recognizes or lists, but leaves out.
//!
//! A content that asks for something that is not done still draws. Its reader adds one entry per kind, such as
//! `glTF extension KHR_xmp_json_ld`, so that `terrane info --verify` and reports can name it. Any thread.

use std::borrow::Cow;
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use super::tile::Body;
use crate::fetch::{IoError, printable};

/// The maximum number of kinds: names of extensions are outside data. Further kinds count as [`OTHERS`].
const MAX_KINDS: usize = 256;
/// The maximum number of attributions of a content.
const MAX_CREDITS: usize = 64;
/// The kind that replaces all kinds beyond [`MAX_KINDS`].
const OTHERS: &str = "further kinds";
/// The maximum length of a kind in bytes. Longer names are cut.
const MAX_KIND_BYTES: usize = 96;

/// Counts by kind of everything that contents asked for and readers left out.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Ignored {
    counts: BTreeMap<Cow<'static, str>, u64>,
}

impl Ignored {
    /// Returns true if nothing was left out.
    pub fn is_empty(&self) -> bool {
        self.counts.is_empty()
    }

    /// Returns the kinds with their counts, in alphabetical order.
    pub fn iter(&self) -> impl Iterator<Item = (&str, u64)> {
        self.counts.iter().map(|(kind, count)| (&**kind, *count))
    }

    /// Returns the count of a kind; 0 if it did not occur.
    pub fn count(&self, kind: &str) -> u64 {
        self.counts.get(kind).copied().unwrap_or(0)
    }

    /// Adds to the counts of another list.
    pub fn merge(&mut self, other: &Self) {
        for (kind, count) in &other.counts {
            self.add(kind.clone(), *count);
        }
    }

    pub(super) fn add(&mut self, kind: impl Into<Cow<'static, str>>, count: u64) {
        let mut kind = kind.into();
        if let Cow::Owned(text) = printable(&kind) {
            kind = text.into();
        }
        if kind.len() > MAX_KIND_BYTES {
            let end = (0..=MAX_KIND_BYTES).rev().find(|end| kind.is_char_boundary(*end)).unwrap_or(0);
            kind = format!("{}...", &kind[..end]).into();
        }
        // Kinds that readers name are few; only names from files are bounded.
        let is_from_file = matches!(kind, Cow::Owned(_));
        if is_from_file && self.counts.len() >= MAX_KINDS && !self.counts.contains_key(&kind) {
            kind = OTHERS.into();
        }
        let known = self.counts.entry(kind).or_default();
        *known = known.saturating_add(count);
    }
}

/// The list that all reads of a tile set add to. Clones share it. Written by decode threads, read by any thread.
#[derive(Clone, Debug, Default)]
pub struct IgnoredLog(Arc<Mutex<Ignored>>);

impl IgnoredLog {
    /// Returns a copy of the list so far.
    pub fn snapshot(&self) -> Ignored {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Adds the list of one content.
    pub(super) fn add(&self, of_content: &Ignored) {
        if !of_content.is_empty() {
            self.0.lock().unwrap_or_else(PoisonError::into_inner).merge(of_content);
        }
    }
}

/// The list of the content that is being read. All parts of its reader share it; one thread.
#[derive(Debug, Default)]
pub(super) struct Notes {
    ignored: RefCell<Ignored>,
    /// The attributions of the content.
    credits: RefCell<Vec<Arc<str>>>,
    /// The body that the content declares, if it is a root tileset.
    body: RefCell<Option<Body>>,
}

impl Notes {
    /// Adds one occurrence of a kind of file that is missing for a reason. What the user can allow is named with its option.
    pub fn add_missing(&self, kind: &'static str, error: &IoError) {
        self.add(kind);
        match error {
            IoError::HostRefused { host, .. } => self.add(format!("a file on {host}, which --allow-host allows")),
            IoError::LinkRefused { .. } => self.add("a file behind a link, which --follow-links allows"),
            IoError::OutsideRefused { .. } => {
                self.add("a file outside of the set's folder, which --allow-outside allows")
            }
            _ => {}
        }
    }

    /// Stores the body that a root tileset declares.
    pub fn set_body(&self, body: Body) {
        self.body.replace(Some(body));
    }

    /// Returns the body that a root tileset declares, and forgets it.
    pub fn take_body(&self) -> Option<Body> {
        self.body.take()
    }

    /// Adds one occurrence of a kind.
    pub fn add(&self, kind: impl Into<Cow<'static, str>>) {
        self.ignored.borrow_mut().add(kind, 1);
    }

    /// Adds some occurrences of a kind, or none.
    pub fn add_count(&self, kind: &'static str, count: u64) {
        if count > 0 {
            self.ignored.borrow_mut().add(kind, count);
        }
    }

    /// Adds to the counts of a list.
    pub fn merge(&self, other: &Ignored) {
        self.ignored.borrow_mut().merge(other);
    }

    /// Adds an attribution of the content, once.
    pub fn add_credit(&self, credit: &str) {
        let credit = credit.trim();
        let mut credits = self.credits.borrow_mut();
        if !credit.is_empty() && credits.len() < MAX_CREDITS && !credits.iter().any(|known| **known == *credit) {
            credits.push(credit.into());
        }
    }

    /// Returns the attributions, and removes them.
    pub fn take_credits(&self) -> Vec<Arc<str>> {
        self.credits.take()
    }

    /// Returns the list.
    pub fn into_ignored(self) -> Ignored {
        self.ignored.into_inner()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kinds_are_counted_and_bounded() {
        let log = IgnoredLog::default();
        for round in 0..2 {
            let notes = Notes::default();
            notes.add("sampler");
            (0..300).for_each(|i| notes.add(format!("extension {i}")));
            notes.add("x".repeat(1000) + "é");
            log.clone().add(&notes.into_ignored());
            let list = log.snapshot();
            assert_eq!((list.count("sampler"), list.count("nothing")), (round + 1, 0));
        }
        let list = log.snapshot();
        assert_eq!(list.iter().count(), MAX_KINDS + 1);
        assert!(list.count(OTHERS) > 80 && list.iter().all(|(kind, _)| kind.len() < 100));
        assert!(Ignored::default().is_empty() && !list.is_empty());
    }
}
