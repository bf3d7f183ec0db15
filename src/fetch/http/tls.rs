//! Reads the additional certificate authorities of a client, once when the client is created.

use std::path::{Path, PathBuf};

use reqwest::Certificate;
use rustls::pki_types::CertificateDer;
use rustls::pki_types::pem::{Error, PemObject as _};

use crate::fetch::IoError;

/// Reads all certificates of PEM files.
pub(super) fn root_certificates(files: &[PathBuf]) -> Result<Vec<Certificate>, IoError> {
    let mut found = Vec::new();
    for file in files {
        found.extend(certificates(file)?);
    }
    Ok(found)
}

fn certificates(file: &Path) -> Result<Vec<Certificate>, IoError> {
    let uri = file.display().to_string();
    let bytes = std::fs::read(file).map_err(|e| IoError::of_file(&uri, &e))?;
    let bad = |e: &dyn std::fmt::Display| IoError::invalid(&uri, format!("not a valid certificate: {e}"));
    let ders = CertificateDer::pem_slice_iter(&bytes).collect::<Result<Vec<_>, Error>>().map_err(|e| bad(&e))?;
    if ders.is_empty() {
        return Err(IoError::invalid(&uri, "contains no certificate"));
    }
    // Parsed here already, so that an error names the file.
    let mut store = rustls::RootCertStore::empty();
    let read = |der: CertificateDer<'static>| {
        store.add(der.clone()).map_err(|e| bad(&e))?;
        Certificate::from_der(&der).map_err(|e| bad(&e))
    };
    ders.into_iter().map(read).collect()
}
