//! [`UploadOwner`]: marks the uploads of each scene and pager in the ticket that the GPU layer passes through.
//!
//! All scenes and pagers of a viewer share the upload queue of a device. A ticket has 64 bits: 1 for the kind of the owner, 15
//! for its number, and 48 that the owner chooses itself.

const NUMBER_SHIFT: u32 = 48;
const OWN_TICKET_MASK: u64 = (1 << NUMBER_SHIFT) - 1;
const MAX_NUMBER: u16 = 0x7fff;
const PAGES_BIT: u64 = 1 << 63;

/// The owner of an upload.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::viewer) enum UploadOwner {
    /// The application's pages of the scene with this number.
    Pages(u16),
    /// The pager with this number.
    Pager(u16),
}

impl UploadOwner {
    fn bits(self) -> u64 {
        let (number, kind) = match self {
            Self::Pages(number) => (number, PAGES_BIT),
            Self::Pager(number) => (number, 0),
        };
        debug_assert!(number <= MAX_NUMBER, "a viewer has at most 32,768 scenes");
        u64::from(number & MAX_NUMBER) << NUMBER_SHIFT | kind
    }

    /// Adds the owner to one of its tickets, of which 48 bits count.
    pub(super) fn mark(self, ticket: u64) -> u64 {
        self.bits() | (ticket & OWN_TICKET_MASK)
    }

    /// Returns true when the owner has marked a ticket.
    pub(super) fn owns(self, marked: u64) -> bool {
        marked & !OWN_TICKET_MASK == self.bits()
    }

    /// Returns the owner's part of a marked ticket.
    pub(super) fn ticket(marked: u64) -> u64 {
        marked & OWN_TICKET_MASK
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn owners_recognise_their_tickets_only() {
        let owners = [0, 1, MAX_NUMBER].map(|n| [UploadOwner::Pages(n), UploadOwner::Pager(n)]).concat();
        for owner in &owners {
            for ticket in [0, 7, OWN_TICKET_MASK] {
                let marked = owner.mark(ticket);
                assert_eq!(UploadOwner::ticket(marked), ticket);
                assert_eq!(owners.iter().filter(|other| other.owns(marked)).collect::<Vec<_>>(), [owner]);
            }
        }
    }
}
