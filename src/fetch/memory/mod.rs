//! Limits of the memory that loads take together: of what they hold ([`ByteBudget`]), and of what decoders allocate meanwhile
//! ([`LargeContents`]). All loading threads.

#[cfg_attr(not(feature = "http"), allow(dead_code, reason = "only answers of servers claim bytes"))]
mod byte_budget;
mod large_contents;

pub(crate) use byte_budget::{BudgetUse, ByteBudget, LoadRoom, Permit};
#[cfg(feature = "http")]
pub(crate) use byte_budget::{Claim, NoRoom};
pub(crate) use large_contents::{ContentMemory, LargeContents, about_to_allocate, gated};
