//! Limits of the memory that loads take: of what all hold together ([`ByteBudget`]), of what decoders allocate meanwhile
//! ([`LargeContents`]), and of what one content may take at all ([`limited`]). All loading threads.

#[cfg_attr(not(feature = "http"), allow(dead_code, reason = "only answers of servers claim bytes"))]
mod byte_budget;
mod content_budget;
mod large_contents;

pub(crate) use byte_budget::{BudgetUse, ByteBudget, LoadRoom, Permit};
#[cfg(feature = "http")]
pub(crate) use byte_budget::{Claim, NoRoom};
pub(crate) use content_budget::{ContentTooLarge, content_bytes_left, limited};
pub(crate) use large_contents::{ContentMemory, LargeContents, about_to_allocate, gated};
