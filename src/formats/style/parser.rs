//! A recursive-descent parser of expressions. Depth is bounded; errors name the column. Any thread.
//!
//! Strings have no escapes: a backslash is a character, as regular expressions need it and as CesiumJS reads it.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use super::expression::{Expression, Operator, Piece, Step};
use super::functions::Function;
use super::text;
use super::value::Value;

/// The maximum depth of an expression: parentheses, arguments, signs and conditional parts inside each other.
const MAX_DEPTH: u32 = 64;
/// The maximum number of characters of a name in an error.
const MAX_SHOWN: usize = 40;

/// Operators from the weakest to the strongest; within a level, longer ones before those that they start with.
const LEVELS: [&[(&str, Operator)]; 6] = [
    &[("||", Operator::Or)],
    &[("&&", Operator::And)],
    &[("===", Operator::Equal), ("!==", Operator::NotEqual), ("=~", Operator::Matches), ("!~", Operator::MatchesNot)],
    &[("<=", Operator::LessEqual), (">=", Operator::GreaterEqual), ("<", Operator::Less), (">", Operator::Greater)],
    &[("+", Operator::Add), ("-", Operator::Subtract)],
    &[("*", Operator::Multiply), ("/", Operator::Divide), ("%", Operator::Remainder)],
];
/// Operators of JavaScript that the language lacks.
const FOREIGN: [&str; 11] = ["==", "!=", "<<", ">>", "**", "??", "=", "&", "|", "^", "~"];

/// The column and reason of a syntax error.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct SyntaxError {
    /// The character at which the expression is invalid; the first is 1.
    pub column: usize,
    pub reason: String,
}

/// The names that the expressions of a style use.
#[derive(Debug, Default)]
pub(super) struct Names {
    /// Variables.
    pub variables: BTreeSet<String>,
    /// Functions that the language lacks. They have no value.
    pub unknown_functions: BTreeSet<String>,
}

/// Parses a whole expression. Variables with the name of a define are replaced by it. Adds the names that are used.
pub(super) fn parse(
    text: &str,
    defines: &BTreeMap<String, Arc<Expression>>,
    names: &mut Names,
) -> Result<Expression, SyntaxError> {
    let mut parser = Parser { text, at: 0, depth: 0, defines, names };
    let expression = parser.expression()?;
    parser.skip_space();
    if parser.at < text.len() {
        return Err(parser.unexpected("an operator or the end"));
    }
    Ok(expression)
}

struct Parser<'a> {
    text: &'a str,
    /// The offset of the next byte.
    at: usize,
    depth: u32,
    defines: &'a BTreeMap<String, Arc<Expression>>,
    names: &'a mut Names,
}

type Parsed<T = Expression> = Result<T, SyntaxError>;

impl<'a> Parser<'a> {
    fn rest(&self) -> &'a str {
        &self.text[self.at..]
    }

    fn skip_space(&mut self) {
        self.at = self.text.len() - self.rest().trim_start().len();
    }

    fn error_at(&self, at: usize, reason: impl Into<String>) -> SyntaxError {
        SyntaxError { column: self.text[..at].chars().count() + 1, reason: reason.into() }
    }

    fn unexpected(&self, expected: &str) -> SyntaxError {
        let rest = self.rest();
        let found = match rest.chars().next() {
            None => "the end".to_owned(),
            Some(first) => match FOREIGN.iter().find(|operator| rest.starts_with(**operator)) {
                Some(operator) => format!("the operator {operator}, which the language lacks"),
                None => format!("{first:?}"),
            },
        };
        self.error_at(self.at, format!("found {found}, expected {expected}"))
    }

    /// Consumes a symbol after spaces; returns false if something else follows.
    fn accept(&mut self, symbol: &str) -> bool {
        self.skip_space();
        let is_next = self.rest().starts_with(symbol);
        if is_next {
            self.at += symbol.len();
        }
        is_next
    }

    fn expect(&mut self, symbol: &str) -> Parsed<()> {
        if self.accept(symbol) { Ok(()) } else { Err(self.unexpected(symbol)) }
    }

    /// Parses a part one level deeper.
    fn nested<T>(&mut self, parse: impl FnOnce(&mut Self) -> Parsed<T>) -> Parsed<T> {
        if self.depth >= MAX_DEPTH {
            return Err(self.error_at(self.at, format!("the expression is deeper than {MAX_DEPTH} levels")));
        }
        self.depth += 1;
        let parsed = parse(self);
        self.depth -= 1;
        parsed
    }

    fn expression(&mut self) -> Parsed {
        let mut cases = Vec::new();
        loop {
            let expression = self.chain(0)?;
            if !self.accept("?") {
                return Ok(match cases.is_empty() {
                    true => expression,
                    false => Expression::Choice(cases, Box::new(expression)),
                });
            }
            let value = self.nested(Self::expression)?;
            self.expect(":")?;
            cases.push((expression, value));
        }
    }

    /// Parses operators of a level with operands of stronger ones.
    fn chain(&mut self, level: usize) -> Parsed {
        let Some(operators) = LEVELS.get(level) else { return self.signed() };
        let first = self.chain(level + 1)?;
        let mut rest = Vec::new();
        while let Some(operator) = self.operator(operators) {
            rest.push((operator, self.chain(level + 1)?));
        }
        Ok(if rest.is_empty() { first } else { Expression::Chain(Box::new(first), rest) })
    }

    fn operator(&mut self, operators: &[(&str, Operator)]) -> Option<Operator> {
        self.skip_space();
        let rest = self.rest();
        // Such as `<<`, which starts like `<`.
        let is_foreign = ["<<", ">>", "**"].iter().any(|operator| rest.starts_with(operator));
        let (symbol, operator) = operators.iter().find(|(symbol, _)| rest.starts_with(symbol) && !is_foreign)?;
        self.at += symbol.len();
        Some(*operator)
    }

    fn signed(&mut self) -> Parsed {
        type Sign = fn(Box<Expression>) -> Expression;
        let signs: [(&str, Sign); 3] =
            [("!", Expression::Not), ("-", Expression::Negative), ("+", Expression::Positive)];
        for (symbol, sign) in signs {
            if self.accept(symbol) {
                return self.nested(Self::signed).map(|of| sign(Box::new(of)));
            }
        }
        let value = self.primary()?;
        let steps = self.steps()?;
        Ok(with_steps(value, steps))
    }

    /// Parses members and methods after a value.
    fn steps(&mut self) -> Parsed<Vec<Step>> {
        let mut steps = Vec::new();
        loop {
            if self.accept("[") {
                let key = self.nested(Self::expression)?;
                self.expect("]")?;
                steps.push(Step::Member(key));
            } else if self.accept(".") {
                let at = self.at;
                let name = self.identifier().ok_or_else(|| self.unexpected("the name of a member"))?;
                let step = match self.accept("(") {
                    true => self.method(name, at)?,
                    false => Step::Member(Expression::Literal(Value::text(name))),
                };
                steps.push(step);
            } else {
                return Ok(steps);
            }
        }
    }

    /// Parses the arguments of a method. Unknown methods have no value.
    fn method(&mut self, name: &str, at: usize) -> Parsed<Step> {
        let mut arguments = self.list(")")?.into_iter();
        match (name, arguments.next()) {
            ("test" | "exec", None) => Err(self.error_at(at, format!("{name} needs an argument"))),
            ("test", Some(searched)) => Ok(Step::Test(searched)),
            ("exec", Some(searched)) => Ok(Step::Exec(searched)),
            ("toString", None) => Ok(Step::ToText),
            _ => {
                self.names.unknown_functions.insert(shown(name));
                // No value has a member without a name.
                Ok(Step::Member(Expression::UNDEFINED))
            }
        }
    }

    /// Parses expressions between commas until a closing symbol.
    fn list(&mut self, end: &str) -> Parsed<Vec<Expression>> {
        let mut parts = Vec::new();
        if self.accept(end) {
            return Ok(parts);
        }
        loop {
            parts.push(self.nested(Self::expression)?);
            if self.accept(end) {
                return Ok(parts);
            }
            if !self.accept(",") {
                return Err(self.unexpected(&format!(", or {end}")));
            }
        }
    }

    fn primary(&mut self) -> Parsed {
        self.skip_space();
        let start = self.at;
        match self.rest().chars().next() {
            Some('(') => {
                self.at += 1;
                let inner = self.nested(Self::expression)?;
                self.expect(")")?;
                Ok(inner)
            }
            Some('[') => {
                self.at += 1;
                self.list("]").map(Expression::List)
            }
            Some('$') if self.rest().starts_with("${") => {
                self.at += 2;
                let variable = self.variable()?;
                self.expect("}")?;
                Ok(variable)
            }
            Some(quote @ ('\'' | '"' | '`')) => self.string(quote).map(|text| self.template(text)),
            Some('0'..='9' | '.') => self.number().map(|number| Expression::Literal(Value::Number(number))),
            _ => match self.identifier() {
                Some(name) => self.named(name, start),
                None => Err(self.unexpected("a value")),
            },
        }
    }

    /// Parses what a name starts: a constant or a call.
    fn named(&mut self, name: &str, start: usize) -> Parsed {
        if self.accept("(") {
            let arguments = self.list(")")?;
            return self.call(name, arguments, start);
        }
        let value = match name {
            "true" => Value::Bool(true),
            "false" => Value::Bool(false),
            "null" => Value::Null,
            "undefined" => Value::Undefined,
            "NaN" => Value::Number(f64::NAN),
            "Infinity" => Value::Number(f64::INFINITY),
            "Math" | "Number" if self.accept(".") => match (name, self.identifier()) {
                ("Math", Some("PI")) => Value::Number(std::f64::consts::PI),
                ("Math", Some("E")) => Value::Number(std::f64::consts::E),
                ("Number", Some("POSITIVE_INFINITY")) => Value::Number(f64::INFINITY),
                _ => return Err(self.error_at(start, format!("a constant of {name} that is unknown"))),
            },
            _ => {
                let reason = format!("{} is unknown; properties are written ${{{0}}}", shown(name));
                return Err(self.error_at(start, reason));
            }
        };
        Ok(Expression::Literal(value))
    }

    fn call(&mut self, name: &str, arguments: Vec<Expression>, start: usize) -> Parsed {
        let Some((function, counts)) = Function::named(name) else {
            self.names.unknown_functions.insert(shown(name));
            return Ok(Expression::UNDEFINED);
        };
        if !counts.contains(&arguments.len()) {
            let (least, most) = (counts.start(), counts.end());
            let expected = if least == most { least.to_string() } else { format!("{least} to {most}") };
            let reason = format!("{name} has {} arguments, expected {expected}", arguments.len());
            return Err(self.error_at(start, reason));
        }
        // Regular expressions are compiled once if they are constant.
        if let Function::Regex = function
            && let Some(texts) = constant_texts(&arguments)
        {
            let text_of = |at: usize| texts.get(at).map(|text| &**text);
            let compiled = text::regex(text_of(0).unwrap_or("(?:)"), text_of(1).unwrap_or_default());
            let regex = compiled.map_err(|reason| self.error_at(start, reason))?;
            return Ok(Expression::Literal(Value::Regex(regex)));
        }
        Ok(Expression::Call(function, arguments))
    }

    /// Parses the inside of `${}`: a name with members. `feature` before a member is implicit.
    fn variable(&mut self) -> Parsed {
        self.skip_space();
        let first = self.identifier().ok_or_else(|| self.unexpected("the name of a property"))?;
        let mut keys = Vec::new();
        loop {
            if self.accept(".") {
                keys.push(Value::text(self.identifier().ok_or_else(|| self.unexpected("the name of a member"))?));
            } else if self.accept("[") {
                self.skip_space();
                keys.push(match self.rest().chars().next() {
                    Some(quote @ ('\'' | '"' | '`')) => Value::text(self.string(quote)?),
                    Some('0'..='9') => Value::Number(self.number()?),
                    _ => return Err(self.unexpected("a name in quotes or an index")),
                });
                self.expect("]")?;
            } else {
                break;
            }
        }
        let mut keys = keys.into_iter();
        let is_explicit = first == "feature" && matches!(keys.as_slice().first(), Some(Value::Text(_)));
        let name = match is_explicit.then(|| keys.next()).flatten() {
            Some(Value::Text(name)) => name,
            _ => first.into(),
        };
        let variable = match self.defines.get(&*name).filter(|_| !is_explicit) {
            Some(define) => Expression::Define(define.clone()),
            None => {
                self.names.variables.insert(name.as_ref().to_owned());
                Expression::Variable(name.as_ref().to_owned())
            }
        };
        Ok(with_steps(variable, keys.map(|key| Step::Member(Expression::Literal(key))).collect()))
    }

    /// Returns the text between quotes.
    fn string(&mut self, quote: char) -> Parsed<&'a str> {
        let start = self.at;
        let rest = &self.rest()[quote.len_utf8()..];
        let Some(length) = rest.find(quote) else { return Err(self.error_at(start, "a string without an end")) };
        self.at = start + length + 2 * quote.len_utf8();
        Ok(&rest[..length])
    }

    /// Returns the expression of a string, which may have variables inside.
    fn template(&mut self, text: &'a str) -> Expression {
        let mut pieces = Vec::new();
        let mut rest = text;
        while let Some((before, after)) = rest.split_once("${")
            && let Some((name, after)) = after.split_once('}')
        {
            pieces.push(Piece::Text(before.to_owned()));
            pieces.push(Piece::Inserted(self.inserted(name)));
            rest = after;
        }
        if pieces.is_empty() {
            return Expression::Literal(Value::text(text));
        }
        pieces.push(Piece::Text(rest.to_owned()));
        Expression::Template(pieces)
    }

    /// Returns a variable in a string. A name that is no identifier is a property as it is.
    fn inserted(&mut self, name: &'a str) -> Expression {
        let mut inner = Parser { text: name, at: 0, depth: self.depth, defines: self.defines, names: self.names };
        let parsed = inner.variable();
        inner.skip_space();
        let is_whole = inner.at == name.len();
        parsed.ok().filter(|_| is_whole).unwrap_or_else(|| {
            self.names.variables.insert(name.to_owned());
            Expression::Variable(name.to_owned())
        })
    }

    fn number(&mut self) -> Parsed<f64> {
        let (start, bytes) = (self.at, self.text.as_bytes());
        let digits = |mut at: usize| {
            while bytes.get(at).is_some_and(u8::is_ascii_digit) {
                at += 1;
            }
            at
        };
        let mut end = digits(start);
        if bytes.get(end) == Some(&b'.') {
            end = digits(end + 1);
        }
        if matches!(bytes.get(end), Some(b'e' | b'E')) {
            let sign = usize::from(matches!(bytes.get(end + 1), Some(b'+' | b'-')));
            end = digits(end + 1 + sign);
        }
        self.at = end;
        if self.rest().starts_with(is_name_part) {
            return Err(self.unexpected("the end of the number"));
        }
        self.text[start..end].parse().map_err(|_| self.error_at(start, "an invalid number"))
    }

    /// Consumes a name; `None` if none follows.
    fn identifier(&mut self) -> Option<&'a str> {
        self.skip_space();
        let rest = self.rest();
        let length = rest.find(|c| !is_name_part(c)).unwrap_or(rest.len());
        let name = &rest[..length];
        if name.is_empty() || name.starts_with(|c: char| c.is_ascii_digit()) {
            return None;
        }
        self.at += length;
        Some(name)
    }
}

fn is_name_part(c: char) -> bool {
    c.is_alphanumeric() || c == '_' || c == '$'
}

fn with_steps(value: Expression, steps: Vec<Step>) -> Expression {
    if steps.is_empty() { value } else { Expression::Steps(Box::new(value), steps) }
}

/// Returns the texts of arguments that are all literal texts.
fn constant_texts(arguments: &[Expression]) -> Option<Vec<Arc<str>>> {
    let text = |argument: &Expression| match argument {
        Expression::Literal(Value::Text(text)) => Some(text.clone()),
        _ => None,
    };
    arguments.iter().map(text).collect()
}

/// Returns a name, cut for an error or a list.
fn shown(name: &str) -> String {
    name.chars().take(MAX_SHOWN).collect()
}
