//! Tickets: the identity of one load attempt.

use std::sync::Arc;

use crate::trace;

/// Identifies one attempt to load a content. A retry has a new ticket, so that an answer to an earlier attempt is
/// recognised as late.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub(in crate::pager) struct Ticket {
    /// The issuing pager's bits in a trace; zero in the low 40 bits.
    source: u64,
    /// Unique within its pager.
    number: u64,
}

impl Ticket {
    /// Returns the number that compile operations carry; unique within a pager.
    pub fn number(self) -> u64 {
        self.number
    }

    /// Returns the id of the attempt on the timeline; unique within the process.
    pub fn trace_id(self) -> u64 {
        self.source | self.number
    }

    /// Records on the timeline that the attempt begins.
    pub fn trace_begin(self, uri: &Arc<str>) {
        trace::request_begins(self.trace_id(), uri);
    }

    /// Records on the timeline how the attempt ended.
    pub fn trace_end(self, end: RequestEnd) {
        trace::request_ends(self.trace_id(), end.name());
    }
}

/// How an attempt to load a content ended; [`PagerStats`](crate::pager::PagerStats) counts each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::pager) enum RequestEnd {
    /// The page is part of its scene.
    Merged,
    /// The load failed.
    Failed,
    /// The HTTP request was aborted because the content was no longer wanted.
    Cancelled,
    /// The request was not renewed and no thread had taken it.
    Stale,
    /// The page had no room.
    Declined,
    /// The slot is gone, or its contexts changed.
    Dropped,
}

impl RequestEnd {
    fn name(self) -> &'static str {
        match self {
            Self::Merged => "merged",
            Self::Failed => "failed",
            Self::Cancelled => "cancelled",
            Self::Stale => "stale",
            Self::Declined => "declined",
            Self::Dropped => "dropped",
        }
    }
}

/// Issues the tickets of one pager, in ascending order. Update thread.
#[derive(Debug)]
pub(in crate::pager) struct TicketIssuer {
    source: u64,
    next: u64,
}

impl TicketIssuer {
    /// Creates an issuer whose tickets differ on the timeline from those of all other issuers.
    pub fn new() -> Self {
        Self { source: trace::ticket_source(), next: 1 }
    }

    /// Returns a ticket that was not issued before.
    pub fn issue(&mut self) -> Ticket {
        let number = self.next;
        self.next += 1;
        Ticket { source: self.source, number }
    }

    /// Skips all numbers that `before` has issued, so that late answers to its tickets match none of this issuer's.
    pub fn continue_from(&mut self, before: &Self) {
        self.next = self.next.max(before.next);
    }
}

#[cfg(test)]
impl Ticket {
    /// Creates a ticket with a given number, for tests.
    pub fn for_test(number: u64) -> Self {
        Self { source: 0, number }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn successor_issues_no_number_of_its_predecessor() {
        let (mut first, mut second) = (TicketIssuer::new(), TicketIssuer::new());
        let last = (0..5).map(|_| first.issue()).last().unwrap();
        second.continue_from(&first);
        let next = second.issue();
        assert!(next.number() > last.number() && next.trace_id() != last.trace_id());
    }
}
