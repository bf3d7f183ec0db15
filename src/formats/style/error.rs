//! [`StyleError`].

/// A reason why a style cannot be read.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum StyleError {
    /// The file is too large.
    #[error("{uri}: the style has {bytes} bytes, at most {max} are read")]
    TooLong {
        /// The address of the style.
        uri: String,
        /// The size of the file.
        bytes: usize,
        /// The maximum size.
        max: usize,
    },
    /// The JSON would take too much memory.
    #[error("{uri}: the style is too large: {reason}")]
    TooLarge {
        /// The address of the style.
        uri: String,
        /// The memory that it would take, and the limit.
        reason: String,
    },
    /// The file is not a JSON object.
    #[error("{uri}: the style is not a JSON object: {reason}")]
    Json {
        /// The address of the style.
        uri: String,
        /// The error of the JSON parser.
        reason: String,
    },
    /// A member has the wrong type.
    #[error("{uri}: {member} is {found}, expected {expected}")]
    Member {
        /// The address of the style.
        uri: String,
        /// The path of the member, such as `color.conditions[2]`.
        member: String,
        /// The type of the member.
        found: &'static str,
        /// The types that are allowed.
        expected: &'static str,
    },
    /// An expression is invalid.
    #[error("{uri}: {member}, column {column}: {reason}")]
    Expression {
        /// The address of the style.
        uri: String,
        /// The path of the member that has the expression.
        member: String,
        /// The character at which the expression is invalid; the first is 1.
        column: usize,
        /// The reason: the invalid part, and what was expected.
        reason: String,
    },
}
