//! [`ExternalFiles`]: the files that a content refers to, as loaders fetched them. Decoders do no I/O; any thread.

use std::borrow::Cow;
use std::sync::Arc;

use crate::fetch::{Fetched, IoError, Limits, RootScope, encoding, resolve};

/// The files that were fetched for a content.
#[derive(Clone, Copy)]
pub(super) struct ExternalFiles<'a> {
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

    /// Returns the limits for the files.
    pub fn limits(&self) -> &'a Limits {
        self.limits
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
