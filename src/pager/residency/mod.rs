//! Residency: which merged pages are in memory, how much they take, and which leave first. Update thread.

pub(super) mod budget;
mod expiry;
mod pages;
mod residents;
mod shared_content;

pub(super) use expiry::Unused;
pub(super) use pages::Residency;
pub(super) use residents::Resident;
