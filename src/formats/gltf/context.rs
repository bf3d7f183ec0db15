//! [`Context`]: everything that the parts of the reader share while they read one glTF.

use super::budget::Budget;
use crate::fetch::IoError;
use crate::formats::external_files::ExternalFiles;
use crate::formats::ignored::Notes;
use crate::formats::options::ReadOptions;

/// The address, options and counters of the glTF that is being read. One thread.
pub(super) struct Context<'a> {
    pub uri: &'a str,
    pub options: &'a ReadOptions,
    pub budget: Budget<'a>,
    pub notes: &'a Notes,
    /// The files that were fetched together with the glTF.
    pub files: ExternalFiles<'a>,
}

impl<'a> Context<'a> {
    pub fn new(uri: &'a str, options: &'a ReadOptions, notes: &'a Notes, files: ExternalFiles<'a>) -> Self {
        Self { uri, options, budget: Budget::new(uri, &options.limits), notes, files }
    }

    /// Returns an error for bytes that violate the format.
    pub fn bad(&self, reason: impl std::fmt::Display) -> IoError {
        IoError::invalid(self.uri, format!("glTF: {reason}"))
    }

    /// Handles the failure of an external file: the glTF is drawn without it unless a retry may succeed, in which case the
    /// whole content fails and is loaded again.
    pub fn missing(&self, what: &'static str, error: &IoError) -> Result<(), IoError> {
        if error.is_transient() && !error.is_doubtful() {
            return Err(error.clone());
        }
        self.notes.add_missing(what, error);
        Ok(())
    }
}
