//! [`Function`]: the built-in functions of the language. Decode threads.

use std::ops::RangeInclusive;

use super::colors::{named, rgb_from_hsl};
use super::text;
use super::value::{Value, Vector, componentwise};

/// A function of numbers is applied to each component of vectors.
#[derive(Clone, Copy, Debug)]
pub(super) enum Function {
    /// A function of one number.
    Unary(fn(f64) -> f64),
    /// A function of two numbers.
    Binary(fn(f64, f64) -> f64),
    /// A function of two numbers; the second may be a number for all components of the first.
    BinaryScalar(fn(f64, f64) -> f64),
    Clamp,
    Mix,
    Length,
    Normalize,
    Distance,
    Dot,
    Cross,
    IsNan,
    IsFinite,
    Boolean,
    Number,
    Text,
    /// The constructor of vectors with this number of components.
    Vector(usize),
    Color,
    Rgb,
    Hsl,
    Regex,
}

impl Function {
    /// Returns the function with a name and the numbers of arguments that it accepts; `None` if there is none.
    pub fn named(name: &str) -> Option<(Self, RangeInclusive<usize>)> {
        let unary = |f: fn(f64) -> f64| (Self::Unary(f), 1..=1);
        let binary = |f: fn(f64, f64) -> f64| (Self::Binary(f), 2..=2);
        let binary_scalar = |f: fn(f64, f64) -> f64| (Self::BinaryScalar(f), 2..=2);
        Some(match name {
            "abs" => unary(f64::abs),
            "sqrt" => unary(f64::sqrt),
            "cos" => unary(f64::cos),
            "sin" => unary(f64::sin),
            "tan" => unary(f64::tan),
            "acos" => unary(f64::acos),
            "asin" => unary(f64::asin),
            "atan" => unary(f64::atan),
            "radians" => unary(f64::to_radians),
            "degrees" => unary(f64::to_degrees),
            "sign" => unary(|x| if x == 0.0 { x } else { x.signum() }),
            "floor" => unary(f64::floor),
            "ceil" => unary(f64::ceil),
            "round" => unary(|x| (x + 0.5).floor()),
            "exp" => unary(f64::exp),
            "log" => unary(f64::ln),
            "exp2" => unary(f64::exp2),
            "log2" => unary(f64::log2),
            "fract" => unary(|x| x - x.floor()),
            "atan2" => binary(f64::atan2),
            "pow" => binary(f64::powf),
            // Unlike Rust's, JavaScript's functions return NaN if one argument is NaN.
            "min" => binary_scalar(|a, b| if a < b || a.is_nan() { a } else { b }),
            "max" => binary_scalar(|a, b| if a > b || a.is_nan() { a } else { b }),
            "clamp" => (Self::Clamp, 3..=3),
            "mix" => (Self::Mix, 3..=3),
            "length" => (Self::Length, 1..=1),
            "normalize" => (Self::Normalize, 1..=1),
            "distance" => (Self::Distance, 2..=2),
            "dot" => (Self::Dot, 2..=2),
            "cross" => (Self::Cross, 2..=2),
            "isNaN" => (Self::IsNan, 0..=1),
            "isFinite" => (Self::IsFinite, 0..=1),
            "Boolean" => (Self::Boolean, 0..=1),
            "Number" => (Self::Number, 0..=1),
            "String" => (Self::Text, 0..=1),
            "vec2" => (Self::Vector(2), 1..=2),
            "vec3" => (Self::Vector(3), 1..=3),
            "vec4" => (Self::Vector(4), 1..=4),
            "color" => (Self::Color, 0..=2),
            "rgb" => (Self::Rgb, 3..=3),
            "rgba" => (Self::Rgb, 4..=4),
            "hsl" => (Self::Hsl, 3..=3),
            "hsla" => (Self::Hsl, 4..=4),
            "regExp" => (Self::Regex, 0..=2),
            _ => return None,
        })
    }

    /// Returns the value of a call; undefined for arguments of other types than the function accepts.
    pub fn call(self, arguments: &[Value]) -> Value {
        match (self, arguments) {
            (Self::Unary(f), [Value::Number(x)]) => Value::Number(f(*x)),
            (Self::Unary(f), [Value::Vector(x)]) => Value::Vector(x.map(f)),
            (Self::BinaryScalar(f), [Value::Vector(x), Value::Number(y)]) => Value::Vector(x.map(|part| f(part, *y))),
            (Self::Binary(f) | Self::BinaryScalar(f), [x, y]) => componentwise(x, y, f),
            (Self::Clamp, [x, low, high]) => clamp(x, low, high),
            (Self::Mix, [x, y, share]) => mix(x, y, share),
            (Self::Length, [x]) => Value::number(length(x)),
            (Self::Normalize, [Value::Number(_)]) => Value::Number(1.0),
            (Self::Normalize, [Value::Vector(x)]) => {
                let length = length(&Value::Vector(*x)).unwrap_or(f64::NAN);
                Value::Vector(x.map(|part| part / length))
            }
            (Self::Distance, [x, y]) => Value::number(length(&componentwise(x, y, |a, b| a - b))),
            (Self::Dot, [Value::Number(x), Value::Number(y)]) => Value::Number(x * y),
            (Self::Dot, [Value::Vector(x), Value::Vector(y)]) => Value::number(x.dot(*y)),
            (Self::Cross, [Value::Vector(x), Value::Vector(y)]) => cross(x.components(), y.components()),
            // A missing argument is undefined.
            (Self::IsNan, _) => Value::Bool(arguments.first().is_none_or(|x| x.to_number().is_nan())),
            (Self::IsFinite, _) => Value::Bool(arguments.first().is_some_and(|x| x.to_number().is_finite())),
            (Self::Boolean, _) => Value::Bool(arguments.first().is_some_and(Value::is_true)),
            (Self::Number, _) => Value::Number(arguments.first().map_or(0.0, Value::to_number)),
            (Self::Text, _) => Value::Text(arguments.first().map_or_else(|| "".into(), Value::to_text)),
            (Self::Vector(components), _) => vector(components, arguments),
            (Self::Color, _) => color(arguments),
            (Self::Rgb, _) => colored(arguments, |parts| parts.map(|part| (part / 255.0).clamp(0.0, 1.0))),
            (Self::Hsl, _) => colored(arguments, |[h, s, l]| rgb_from_hsl(h, s, l)),
            (Self::Regex, _) => regex_of(arguments),
            _ => Value::Undefined,
        }
    }
}

fn clamp(x: &Value, low: &Value, high: &Value) -> Value {
    let max = |a: f64, b: f64| if a < b { b } else { a };
    let min = |a: f64, b: f64| if a > b { b } else { a };
    match (x, low, high) {
        (Value::Vector(x), Value::Number(low), Value::Number(high)) => {
            Value::Vector(x.map(|part| min(max(part, *low), *high)))
        }
        _ => componentwise(&componentwise(x, low, max), high, min),
    }
}

fn mix(x: &Value, y: &Value, share: &Value) -> Value {
    let difference = componentwise(y, x, |y, x| y - x);
    let step = match (difference, share) {
        (Value::Vector(difference), Value::Number(share)) => Value::Vector(difference.map(|part| part * share)),
        (difference, share) => componentwise(&difference, share, |part, share| part * share),
    };
    componentwise(x, &step, |x, step| x + step)
}

fn length(x: &Value) -> Option<f64> {
    match x {
        Value::Number(x) => Some(x.abs()),
        Value::Vector(x) => x.dot(*x).map(f64::sqrt),
        _ => None,
    }
}

fn cross(x: &[f64], y: &[f64]) -> Value {
    let (&[a, b, c], &[d, e, f]) = (x, y) else { return Value::Undefined };
    Value::vector(Vector::new(&[b * f - c * e, c * d - a * f, a * e - b * d]))
}

/// Constructs a vector by the rules of GLSL: one number for all components, a longer vector whose last components are
/// dropped, or arguments with the right number of components together.
fn vector(length: usize, arguments: &[Value]) -> Value {
    let mut components = Vec::with_capacity(4);
    for argument in arguments {
        match argument {
            Value::Number(part) => components.push(*part),
            Value::Vector(parts) => components.extend(parts.components()),
            _ => return Value::Undefined,
        }
    }
    match (components.len(), arguments.len()) {
        (1, _) => components.resize(length, components[0]),
        (count, 1) if count >= length => components.truncate(length),
        (count, _) if count == length => {}
        _ => return Value::Undefined,
    }
    Value::vector(Vector::new(&components))
}

fn color(arguments: &[Value]) -> Value {
    let Some(text) = arguments.first() else { return Value::vector(Vector::new(&[1.0; 4])) };
    let Value::Text(text) = text else { return Value::Undefined };
    let (Some([r, g, b, a]), alpha) = (named(text), arguments.get(1)) else { return Value::Undefined };
    match alpha {
        None => Value::vector(Vector::new(&[r, g, b, a])),
        Some(Value::Number(alpha)) => Value::vector(Vector::new(&[r, g, b, *alpha])),
        Some(_) => Value::Undefined,
    }
}

/// Returns the colour of three numbers, with a fourth as alpha.
fn colored(arguments: &[Value], rgb: impl Fn([f64; 3]) -> [f64; 3]) -> Value {
    let number = |at: usize| match arguments.get(at) {
        Some(Value::Number(part)) => Some(*part),
        None => Some(1.0),
        Some(_) => None,
    };
    let (Some(x), Some(y), Some(z), Some(alpha)) = (number(0), number(1), number(2), number(3)) else {
        return Value::Undefined;
    };
    let [r, g, b] = rgb([x, y, z]);
    Value::vector(Vector::new(&[r, g, b, alpha]))
}

/// Compiles a regular expression from values; undefined if it is invalid.
fn regex_of(arguments: &[Value]) -> Value {
    let text_of = |at: usize| arguments.get(at).map(Value::to_text);
    let pattern = text_of(0).unwrap_or_else(|| "(?:)".into());
    let compiled = text::regex(&pattern, &text_of(1).unwrap_or_default());
    compiled.map_or(Value::Undefined, Value::Regex)
}
