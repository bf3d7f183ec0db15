//! External files of a glTF: buffers and images that it refers to by URI.
//!
//! Loaders ask [`references`] before they decode, fetch the files and hand them to the decoder, which does no I/O.

use std::borrow::Cow;
use std::sync::Arc;

use serde::Deserialize;

use crate::fetch::{IoError, Limits, RootScope, encoding, resolve};
use crate::formats::embedded;
use crate::formats::options::Fetched;

/// The files that were fetched for a content.
#[derive(Clone, Copy)]
pub(in crate::formats) struct ExternalFiles<'a> {
    base: &'a str,
    scope: &'a RootScope,
    limits: &'a Limits,
    fetched: &'a [Fetched],
}

impl<'a> ExternalFiles<'a> {
    /// Returns the files that references in the file `base` lead to.
    pub fn new(base: &'a str, scope: &'a RootScope, limits: &'a Limits, fetched: &'a [Fetched]) -> Self {
        Self { base, scope, limits, fetched }
    }

    /// Returns the address that a reference leads to with its bytes, or the reason why they are missing.
    pub fn get(&self, reference: &str) -> Result<(Arc<str>, Cow<'a, [u8]>), IoError> {
        let uri = resolve(self.base, reference, self.scope)?;
        let known = self.fetched.iter().find(|(fetched, _)| *fetched == uri);
        let (_, bytes) = known.ok_or_else(|| IoError::NotFound { uri: uri.to_string() })?;
        let bytes = bytes.as_ref().map_err(IoError::clone)?;
        // Plain servers and disks hold gzip files without declaring it.
        let bytes = match bytes.starts_with(&[0x1f, 0x8b]) {
            true => encoding::gunzip(&uri, bytes.clone(), self.limits).map(Cow::Owned)?,
            false => Cow::Borrowed(bytes.as_slice()),
        };
        Ok((uri, bytes))
    }
}

/// Returns the bytes of a `data:` URI; `None` for other references.
pub(super) fn data_uri(uri: &str, reference: &str) -> Option<Result<Vec<u8>, IoError>> {
    is_data_uri(reference).then(|| embedded::data_uri(uri, reference))
}

fn is_data_uri(reference: &str) -> bool {
    reference.get(..5).is_some_and(|scheme| scheme.eq_ignore_ascii_case("data:"))
}

#[derive(Deserialize)]
struct Document<'a> {
    #[serde(borrow)]
    buffers: Option<Vec<Source<'a>>>,
    #[serde(borrow)]
    images: Option<Vec<Source<'a>>>,
}

#[derive(Deserialize)]
struct Source<'a> {
    #[serde(borrow)]
    uri: Option<Cow<'a, str>>,
}

/// Returns the references to external files in the JSON of a glTF; none if it is invalid.
pub(super) fn references(json: &[u8]) -> Vec<String> {
    let Ok(document) = serde_json::from_slice::<Document<'_>>(json) else { return Vec::new() };
    let sources = [document.buffers, document.images].into_iter().flatten().flatten();
    sources.filter_map(|source| source.uri).filter(|reference| !is_data_uri(reference)).map(Cow::into_owned).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn references_are_found_in_any_document() {
        let json =
            br#"{"buffers":[{"uri":"a%20b.bin"},{"uri":"data:,x"},{"byteLength":1}],"images":[{"uri":"c.png"}]}"#;
        assert_eq!(references(json), ["a%20b.bin", "c.png"]);
        assert!(references(b"{}").is_empty() && references(b"{").is_empty());
        assert!(references(br#"{"buffers":null,"images":[{"uri":"d"}]}"#) == ["d"]);
    }
}
