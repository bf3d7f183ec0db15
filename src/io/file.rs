//! Bytes from local files, gzip undone by magic. Blocking; called on the pager's file threads.

use std::io::Read;

use super::{IoError, Limits};

/// Reads a file whole, refusing more than the limit, before and after decompression.
pub fn read_file(uri: &str, limits: &Limits) -> Result<Vec<u8>, IoError> {
    let failed = |e: std::io::Error| match e.kind() {
        std::io::ErrorKind::NotFound => IoError::NotFound { uri: uri.to_owned() },
        _ => IoError::File { uri: uri.to_owned(), reason: e.to_string() },
    };
    let metadata = std::fs::metadata(uri).map_err(failed)?;
    if metadata.is_dir() {
        return Err(IoError::File { uri: uri.to_owned(), reason: "is a folder".to_owned() });
    }
    // A pipe or a device may never end, or never begin.
    if !metadata.is_file() {
        return Err(IoError::File { uri: uri.to_owned(), reason: "is not a regular file".to_owned() });
    }
    check(uri, metadata.len(), limits)?;
    let file = std::fs::File::open(uri).map_err(failed)?;
    let mut bytes = Vec::with_capacity(metadata.len() as usize);
    file.take(limits.max_file_bytes + 1).read_to_end(&mut bytes).map_err(failed)?;
    check(uri, bytes.len() as u64, limits)?;
    gunzip(uri, bytes, limits)
}

/// Undoes gzip where the magic says so (servers and disks hold tiles compressed without saying it).
pub(crate) fn gunzip(uri: &str, bytes: Vec<u8>, limits: &Limits) -> Result<Vec<u8>, IoError> {
    if !bytes.starts_with(&[0x1f, 0x8b]) {
        return Ok(bytes);
    }
    let mut plain = Vec::with_capacity(bytes.len() * 3);
    flate2::read::MultiGzDecoder::new(bytes.as_slice())
        .take(limits.max_file_bytes + 1)
        .read_to_end(&mut plain)
        .map_err(|e| IoError::invalid(uri, format!("gzip: {e}")))?;
    check(uri, plain.len() as u64, limits)?;
    Ok(plain)
}

fn check(uri: &str, got: u64, limits: &Limits) -> Result<(), IoError> {
    if got > limits.max_file_bytes {
        return Err(IoError::TooLarge { uri: uri.to_owned(), what: "file", got, limit: limits.max_file_bytes });
    }
    Ok(())
}
