//! This module decides where requests may go: a tile set from a stranger must not reach the servers of a private network
//! through the machine that draws it. HTTP thread.
//!
//! Each request, also after a redirect, is sent over one of three pools of connections, by the host of its URL:
//!
//! | host | addresses that its pool connects to |
//! |---|---|
//! | allowed by the configuration, or asked through a proxy | any |
//! | that of the set's root, if its first addresses were all local | local |
//! | any other | public |
//!
//! The resolver of a pool leaves out the addresses that the pool may not connect to, so that no time passes between check
//! and connection. A pool never reuses the connections of another one. Addresses that are written in a URL do not pass the
//! resolver; they are checked before the request.

mod address;
mod connections;
mod dns;

pub(in crate::fetch) use connections::Connections;
pub(super) use connections::refused;
pub(super) use dns::{DnsResolver, RefusedAddress};
