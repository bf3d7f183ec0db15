//! Residency: which merged pages are in memory, how much they take, and which leave first. Update thread.

pub(super) mod budget;
mod content_users;
mod expiry;
mod pages;
mod residents;

pub(super) use expiry::Unused;
pub(super) use pages::Residency;
pub(super) use residents::Resident;
