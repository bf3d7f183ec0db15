//! [`Expression`]: the tree of a parsed expression, and its evaluation. Decode threads.
//!
//! Operations that the specification does not allow for the types of their operands are no error, since the properties of
//! features vary: comparisons are false, everything else is undefined. Conditions use JavaScript's truth values.

use std::fmt::Write as _;
use std::sync::Arc;

use super::functions::Function;
use super::subject::Subject;
use super::value::{Value, componentwise};

/// An operator between two operands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Operator {
    Or,
    And,
    Equal,
    NotEqual,
    Matches,
    MatchesNot,
    Less,
    LessEqual,
    Greater,
    GreaterEqual,
    Add,
    Subtract,
    Multiply,
    Divide,
    Remainder,
}

/// An operation on a value.
#[derive(Debug)]
pub(super) enum Step {
    /// `.name` or `[key]`.
    Member(Expression),
    /// `.test(text)`: whether a regular expression matches.
    Test(Expression),
    /// `.exec(text)`: the first group of a match.
    Exec(Expression),
    /// `.toString()`.
    ToText,
}

/// A part of a string.
#[derive(Debug)]
pub(super) enum Piece {
    Text(String),
    /// An expression whose text is inserted.
    Inserted(Expression),
}

/// An expression. The parser bounds its depth: chains of operators and of members are lists.
#[derive(Debug)]
pub(super) enum Expression {
    Literal(Value),
    /// The property of the feature, or the semantic of the point, with a name.
    Variable(String),
    /// An expression of `defines`.
    Define(Arc<Expression>),
    Template(Vec<Piece>),
    Steps(Box<Expression>, Vec<Step>),
    Not(Box<Expression>),
    Negative(Box<Expression>),
    Positive(Box<Expression>),
    /// Operators of one precedence, from left to right.
    Chain(Box<Expression>, Vec<(Operator, Expression)>),
    /// The value of the first condition that is true, or the last expression.
    Choice(Vec<(Expression, Expression)>, Box<Expression>),
    List(Vec<Expression>),
    Call(Function, Vec<Expression>),
}

impl Expression {
    /// The expression without a value.
    pub const UNDEFINED: Self = Self::Literal(Value::Undefined);

    /// Returns the value for a feature or a point.
    pub fn evaluate(&self, subject: &Subject<'_>) -> Value {
        match self {
            Self::Literal(value) => value.clone(),
            Self::Variable(name) => subject.variable(name),
            Self::Define(expression) => expression.evaluate(subject),
            Self::Template(pieces) => template(pieces, subject),
            Self::Steps(of, steps) => {
                steps.iter().fold(of.evaluate(subject), |value, step| step.apply(&value, subject))
            }
            Self::Not(of) => Value::Bool(!of.evaluate(subject).is_true()),
            Self::Negative(of) => match of.evaluate(subject) {
                Value::Number(number) => Value::Number(-number),
                Value::Vector(vector) => Value::Vector(vector.map(|part| -part)),
                _ => Value::Undefined,
            },
            Self::Positive(of) => match of.evaluate(subject) {
                value @ (Value::Number(_) | Value::Vector(_)) => value,
                _ => Value::Undefined,
            },
            Self::Chain(first, rest) => rest.iter().fold(first.evaluate(subject), |left, (operator, right)| {
                operator.apply(left, || right.evaluate(subject))
            }),
            Self::Choice(cases, otherwise) => {
                let case = cases.iter().find(|(condition, _)| condition.evaluate(subject).is_true());
                case.map_or(&**otherwise, |(_, value)| value).evaluate(subject)
            }
            Self::List(parts) => Value::List(parts.iter().map(|part| part.evaluate(subject)).collect()),
            Self::Call(function, arguments) => {
                let arguments: Vec<Value> = arguments.iter().map(|argument| argument.evaluate(subject)).collect();
                function.call(&arguments)
            }
        }
    }
}

/// Joins the pieces of a string. Variables without a value leave no text, as in CesiumJS.
fn template(pieces: &[Piece], subject: &Subject<'_>) -> Value {
    let mut joined = String::new();
    for piece in pieces {
        match piece {
            Piece::Text(text) => joined.push_str(text),
            Piece::Inserted(expression) => match expression.evaluate(subject) {
                Value::Undefined => {}
                // Writing to a String cannot fail.
                value => {
                    let _ = write!(joined, "{}", value.to_text());
                }
            },
        }
    }
    Value::Text(joined.into())
}

impl Step {
    fn apply(&self, value: &Value, subject: &Subject<'_>) -> Value {
        match (self, value) {
            (Self::Member(key), value) => value.member(&key.evaluate(subject)),
            (Self::ToText, value) => Value::Text(value.to_text()),
            (Self::Test(searched), Value::Regex(regex)) => {
                Value::Bool(regex.is_match(&searched.evaluate(subject).to_text()))
            }
            (Self::Exec(searched), Value::Regex(regex)) => {
                let text = searched.evaluate(subject).to_text();
                let Some(captures) = regex.captures(&text) else { return Value::Null };
                // Without a group the whole match is returned.
                let group = if captures.len() > 1 { captures.get(1) } else { captures.get(0) };
                group.map_or(Value::Undefined, |group| Value::text(group.as_str()))
            }
            (Self::Test(_) | Self::Exec(_), _) => Value::Undefined,
        }
    }
}

impl Operator {
    /// Applies the operator. The right operand is evaluated only if it is needed.
    fn apply(self, left: Value, right: impl FnOnce() -> Value) -> Value {
        match self {
            Self::Or => Value::Bool(left.is_true() || right().is_true()),
            Self::And => Value::Bool(left.is_true() && right().is_true()),
            Self::Equal => Value::Bool(left.equals(&right())),
            Self::NotEqual => Value::Bool(!left.equals(&right())),
            Self::Matches => matches(&left, &right()).map_or(Value::Undefined, Value::Bool),
            Self::MatchesNot => matches(&left, &right()).map_or(Value::Undefined, |found| Value::Bool(!found)),
            Self::Less => compare(&left, &right(), |a, b| a < b),
            Self::LessEqual => compare(&left, &right(), |a, b| a <= b),
            Self::Greater => compare(&left, &right(), |a, b| a > b),
            Self::GreaterEqual => compare(&left, &right(), |a, b| a >= b),
            Self::Add => {
                let right = right();
                match (&left, &right) {
                    (Value::Text(_), _) | (_, Value::Text(_)) => {
                        Value::Text([left.to_text(), right.to_text()].concat().into())
                    }
                    _ => componentwise(&left, &right, |a, b| a + b),
                }
            }
            Self::Subtract => componentwise(&left, &right(), |a, b| a - b),
            Self::Multiply => match (left, right()) {
                (Value::Number(factor), Value::Vector(vector)) | (Value::Vector(vector), Value::Number(factor)) => {
                    Value::Vector(vector.map(|part| part * factor))
                }
                (left, right) => componentwise(&left, &right, |a, b| a * b),
            },
            Self::Divide => match (left, right()) {
                (Value::Vector(vector), Value::Number(divisor)) => Value::Vector(vector.map(|part| part / divisor)),
                (left, right) => componentwise(&left, &right, |a, b| a / b),
            },
            Self::Remainder => componentwise(&left, &right(), |a, b| a % b),
        }
    }
}

/// Returns whether a regular expression on either side matches the text on the other; `None` for other operands.
fn matches(left: &Value, right: &Value) -> Option<bool> {
    match (left, right) {
        (Value::Regex(regex), Value::Text(text)) | (Value::Text(text), Value::Regex(regex)) => {
            Some(regex.is_match(text))
        }
        _ => None,
    }
}

fn compare(left: &Value, right: &Value, is_in_order: impl Fn(f64, f64) -> bool) -> Value {
    Value::Bool(matches!((left, right), (Value::Number(a), Value::Number(b)) if is_in_order(*a, *b)))
}
