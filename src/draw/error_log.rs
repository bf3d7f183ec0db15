//! Errors of drawing, each reported once. Draw thread.

use std::collections::HashSet;

/// Errors kept until the application takes them; further ones are only logged.
const MAX_PENDING: usize = 64;
/// Error texts remembered as reported. Beyond that all are forgotten, so that new errors are reported at the price of
/// repeating some.
const MAX_REPORTED: usize = 16 * MAX_PENDING;

/// Collects errors that would otherwise be repeated in every frame.
#[derive(Debug, Default)]
pub(in crate::draw) struct ErrorLog {
    pending: Vec<String>,
    reported: HashSet<String>,
}

impl ErrorLog {
    /// Logs an error and keeps it for [`Self::take`], unless the same text was reported before.
    pub(in crate::draw) fn report_once(&mut self, error: impl ToString) {
        let error = error.to_string();
        if self.reported.len() >= MAX_REPORTED {
            self.reported.clear();
        }
        if self.reported.insert(error.clone()) {
            log::error!("{error}");
            if self.pending.len() < MAX_PENDING {
                self.pending.push(error);
            }
        }
    }

    /// Returns the errors reported since the last call.
    pub(in crate::draw) fn take(&mut self) -> Vec<String> {
        std::mem::take(&mut self.pending)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn repeated_errors_are_reported_once_and_new_ones_always() {
        let mut errors = ErrorLog::default();
        (0..3).for_each(|_| errors.report_once("same"));
        assert_eq!(errors.take(), ["same"]);
        (0..2000).for_each(|i| errors.report_once(format!("another {i}")));
        assert_eq!(errors.take().len(), MAX_PENDING);
        errors.report_once("last");
        assert_eq!(errors.take(), ["last"]);
    }
}
