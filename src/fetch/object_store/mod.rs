//! Objects of S3, Google Cloud Storage and Azure Blob Storage, fetched through the HTTP client. HTTP thread.

mod config;
mod stores;

pub(in crate::fetch) use config::askers;
pub(in crate::fetch) use stores::Stores;
