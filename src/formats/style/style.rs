//! [`Style`]: a style that was read from JSON. Immutable; shared by the decode threads.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use serde_json::{Map, Value as Json};

use super::error::StyleError;
use super::expression::Expression;
use super::look::Look;
use super::parser::{self, Names};
use super::subject::{Point, Subject};
use super::value::{Value, Vector};
use crate::fetch::Limits;
use crate::formats::ignored::Notes;
use crate::scene::{Feature, PropertyValue};

/// The maximum size of a style in bytes. Styles that list features by their ids are long.
const MAX_STYLE_BYTES: usize = 8 << 20;
/// The maximum memory of a style's JSON in bytes. Eight megabytes of conditions take a quarter of it.
const MAX_JSON_BYTES: u64 = 256 << 20;
/// The variable of CesiumJS that changes with time. Contents are styled once, when they are decoded.
const TIME: &str = "tiles3d_tileset_time";
/// The types of a member with an expression.
const EXPRESSION: &str = "an expression or conditions";

/// A style in the 3D Tiles Styling language, for [`ReadOptions::style`](crate::formats::ReadOptions::style).
///
/// `show`, `color` and `pointSize` apply to contents while they are decoded; the expressions of `meta` are evaluated by
/// [`Self::meta`]. A feature whose expression has no value is shown, in its own colour. Immutable; any thread.
#[derive(Debug)]
pub struct Style {
    show: Option<Expression>,
    color: Option<Expression>,
    point_size: Option<Expression>,
    meta: Vec<(String, Expression)>,
    /// The variables of the first three.
    variables: BTreeSet<String>,
    /// The kinds of what the style asks for and is not done.
    ignored: Vec<String>,
}

impl Style {
    /// Reads a style. `uri` is its address, for errors. Members that are unknown, functions that are unknown and members
    /// that are `null` have no effect.
    ///
    /// Fails if the JSON or an expression is invalid, or if the style is larger than 8 MiB, or 256 MiB when its JSON is parsed.
    pub fn from_json(uri: &str, bytes: &[u8]) -> Result<Self, StyleError> {
        if bytes.len() > MAX_STYLE_BYTES {
            return Err(StyleError::TooLong { uri: uri.to_owned(), bytes: bytes.len(), max: MAX_STYLE_BYTES });
        }
        let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
        let limits = Limits { max_json_bytes: MAX_JSON_BYTES, ..Limits::default() };
        limits
            .check_json(uri, bytes)
            .map_err(|error| StyleError::TooLarge { uri: uri.to_owned(), reason: error.reason() })?;
        let json: Map<String, Json> = serde_json::from_slice(bytes)
            .map_err(|error| StyleError::Json { uri: uri.to_owned(), reason: error.to_string() })?;
        let mut reader = Reader { uri, json: &json, defines: BTreeMap::new(), names: Names::default() };
        reader.defines = reader.named("defines")?.into_iter().map(|(name, define)| (name, Arc::new(define))).collect();
        let [show, color, point_size] = ["show", "color", "pointSize"];
        let (show, color, point_size) = (reader.rule(show)?, reader.rule(color)?, reader.rule(point_size)?);
        let variables = std::mem::take(&mut reader.names.variables);
        let meta = reader.named("meta")?;
        let Names { unknown_functions, .. } = reader.names;
        let known = ["show", "color", "pointSize", "defines", "meta"];
        let unknown = json.keys().filter(|name| !known.contains(&name.as_str()));
        let time = variables.contains(TIME).then(|| format!("style: variable {TIME}"));
        let ignored = unknown
            .map(|name| format!("style: member {name}"))
            .chain(unknown_functions.iter().map(|name| format!("style: function {name}")))
            .chain(time)
            .collect();
        Ok(Self { show, color, point_size, meta, variables, ignored })
    }

    /// Returns the names and values of `meta` for a feature, in the order of their names. A value that is undefined is
    /// [`PropertyValue::Null`]; vectors and colours are lists, colours in sRGB from 0 to 1.
    pub fn meta(&self, feature: &Feature<'_>) -> Vec<(&str, PropertyValue)> {
        let subject = Subject { row: feature.table.map(|table| (table, feature.id as usize)), point: None };
        let value = |expression: &Expression| PropertyValue::from(expression.evaluate(&subject));
        self.meta.iter().map(|(name, expression)| (name.as_str(), value(expression))).collect()
    }

    /// Adds what the style asks for and is not done.
    pub(super) fn note_ignored(&self, notes: &Notes) {
        self.ignored.iter().for_each(|kind| notes.add(kind.clone()));
    }

    /// Returns true if features or points may look different from each other.
    pub(super) fn has_variables(&self) -> bool {
        !self.variables.is_empty()
    }

    /// Returns true if the looks of points depend on positions, colours or normals.
    pub(super) fn has_semantics(&self) -> bool {
        let names = [Point::POSITION, Point::ABSOLUTE, Point::COLOR, Point::NORMAL];
        names.iter().any(|name| self.variables.contains(*name))
    }

    /// Returns true if the looks of points depend on positions in the frame of the set.
    pub(super) fn has_absolute_positions(&self) -> bool {
        self.variables.contains(Point::ABSOLUTE)
    }

    /// Returns the look of a feature or a point.
    pub(super) fn look(&self, subject: &Subject<'_>) -> Look {
        let value = |expression: &Option<Expression>| {
            expression.as_ref().map_or(Value::Undefined, |expression| expression.evaluate(subject))
        };
        let is_shown = match value(&self.show) {
            Value::Undefined | Value::Null => true,
            value => value.is_true(),
        };
        let color = match value(&self.color) {
            Value::Vector(color) => srgb(&color),
            _ => None,
        };
        let point_size = match value(&self.point_size) {
            Value::Number(size) if size.is_finite() => Some(size),
            _ => None,
        };
        Look::new(is_shown, color, point_size)
    }
}

/// Returns the components of a colour, 0 to 1; `None` if the vector is too short or not a number.
fn srgb(vector: &Vector) -> Option<[f64; 4]> {
    let [r, g, b, ..] = *vector.components() else { return None };
    let alpha = vector.components().get(3).copied().unwrap_or(1.0);
    let color = [r, g, b, alpha];
    color.iter().all(|part| !part.is_nan()).then(|| color.map(|part| part.clamp(0.0, 1.0)))
}

/// Reads the members of a style.
struct Reader<'a> {
    uri: &'a str,
    json: &'a Map<String, Json>,
    defines: BTreeMap<String, Arc<Expression>>,
    names: Names,
}

impl Reader<'_> {
    /// Reads a member with an expression or conditions; `None` if it is missing or null.
    fn rule(&mut self, member: &str) -> Result<Option<Expression>, StyleError> {
        let json = self.json;
        match json.get(member) {
            None | Some(Json::Null) => Ok(None),
            Some(Json::Object(object)) => match object.get("conditions") {
                Some(Json::Array(conditions)) => self.conditions(member, conditions).map(Some),
                None | Some(Json::Null) => Ok(None),
                Some(other) => Err(self.wrong_type(&format!("{member}.conditions"), other, "a list")),
            },
            Some(value) => self.expression(member, value, EXPRESSION).map(Some),
        }
    }

    fn conditions(&mut self, member: &str, list: &[Json]) -> Result<Expression, StyleError> {
        let mut cases = Vec::with_capacity(list.len());
        for (i, case) in list.iter().enumerate() {
            let path = format!("{member}.conditions[{i}]");
            let Some([condition, value]) = case.as_array().map(Vec::as_slice) else {
                return Err(self.wrong_type(&path, case, "a list of a condition and an expression"));
            };
            let condition = self.expression(&format!("{path}[0]"), condition, "an expression")?;
            cases.push((condition, self.expression(&format!("{path}[1]"), value, "an expression")?));
        }
        Ok(Expression::Choice(cases, Box::new(Expression::UNDEFINED)))
    }

    /// Reads a member with expressions by name.
    fn named(&mut self, member: &str) -> Result<Vec<(String, Expression)>, StyleError> {
        let json = self.json;
        let object = match json.get(member) {
            None | Some(Json::Null) => return Ok(Vec::new()),
            Some(Json::Object(object)) => object,
            Some(other) => return Err(self.wrong_type(member, other, "an object")),
        };
        let read = |(name, value): (&String, &Json)| {
            Ok((name.clone(), self.expression(&format!("{member}.{name}"), value, "an expression")?))
        };
        object.iter().map(read).collect()
    }

    /// Parses an expression. Numbers and truth values stand for themselves.
    fn expression(&mut self, path: &str, value: &Json, expected: &'static str) -> Result<Expression, StyleError> {
        let text = match value {
            Json::String(text) => text.clone(),
            Json::Bool(_) | Json::Number(_) => value.to_string(),
            other => return Err(self.wrong_type(path, other, expected)),
        };
        parser::parse(&text, &self.defines, &mut self.names).map_err(|error| StyleError::Expression {
            uri: self.uri.to_owned(),
            member: path.to_owned(),
            column: error.column,
            reason: error.reason,
        })
    }

    fn wrong_type(&self, member: &str, value: &Json, expected: &'static str) -> StyleError {
        let found = match value {
            Json::Null => "null",
            Json::Bool(_) => "a truth value",
            Json::Number(_) => "a number",
            Json::String(_) => "a string",
            Json::Array(_) => "a list of another length or type",
            Json::Object(_) => "an object",
        };
        StyleError::Member { uri: self.uri.to_owned(), member: member.to_owned(), found, expected }
    }
}
