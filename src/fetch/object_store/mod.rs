//! Objects of S3, Google Cloud Storage and Azure Blob Storage, fetched through the HTTP client. HTTP thread. Programs that make
//! sets write them too.

mod config;
mod folder;
mod stores;

pub(in crate::fetch) use config::askers;
pub use folder::{ObjectFolder, ObjectHeaders, ObjectList};
pub(in crate::fetch) use stores::Stores;
