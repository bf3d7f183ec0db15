//! Conversions between numbers and text as JavaScript makes them, and regular expressions.

use std::sync::Arc;

use regex::{Regex, RegexBuilder};

/// The maximum memory of a compiled regular expression in bytes.
const MAX_REGEX_BYTES: usize = 1 << 20;

/// Returns a number as text: `5`, `0.5`, `1e+21`, `NaN`, `Infinity`.
pub(super) fn of_number(number: f64) -> String {
    if number.is_nan() {
        return "NaN".to_owned();
    }
    if number.is_infinite() {
        return if number > 0.0 { "Infinity" } else { "-Infinity" }.to_owned();
    }
    // The sign of -0 is dropped.
    let number = number + 0.0;
    match number.abs() {
        size if size >= 1e21 => format!("{number:e}").replace('e', "e+"),
        size if size > 0.0 && size < 1e-6 => format!("{number:e}"),
        _ => number.to_string(),
    }
}

/// Returns the number that a text means; NaN if it is none.
pub(super) fn number(text: &str) -> f64 {
    let text = text.trim();
    let digits = text.strip_prefix(['+', '-']).unwrap_or(text);
    match digits {
        "" => return if text.is_empty() { 0.0 } else { f64::NAN },
        "Infinity" => return if text.starts_with('-') { f64::NEG_INFINITY } else { f64::INFINITY },
        _ => {}
    }
    if let Some(hex) = text.strip_prefix("0x").or_else(|| text.strip_prefix("0X")) {
        let is_hex = hex.bytes().all(|byte| byte.is_ascii_hexdigit());
        return u64::from_str_radix(hex, 16).ok().filter(|_| is_hex).map_or(f64::NAN, |number| number as f64);
    }
    // Rust also reads words such as `inf`.
    let is_plain = digits.bytes().all(|byte| byte.is_ascii_digit() || b".eE+-".contains(&byte));
    text.parse().ok().filter(|_| is_plain).unwrap_or(f64::NAN)
}

/// Compiles a regular expression with the flags of JavaScript.
pub(super) fn regex(pattern: &str, flags: &str) -> Result<Arc<Regex>, String> {
    if let Some(flag) = flags.chars().find(|flag| !"gimuy".contains(*flag)) {
        return Err(format!("the flag {flag} of a regular expression is unknown, expected g, i, m, u or y"));
    }
    // A sticky expression matches at the start only, since each search is the first.
    let sticky = flags.contains('y').then(|| format!(r"\A(?:{pattern})"));
    let compiled = RegexBuilder::new(sticky.as_deref().unwrap_or(pattern))
        .case_insensitive(flags.contains('i'))
        .multi_line(flags.contains('m'))
        .size_limit(MAX_REGEX_BYTES)
        .build();
    compiled.map(Arc::new).map_err(|error| match error {
        regex::Error::CompiledTooBig(_) => "the regular expression is too large".to_owned(),
        // The last line of a syntax error names the reason.
        error => format!("the regular expression is invalid: {}", error.to_string().lines().last().unwrap_or_default()),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_converted_as_in_javascript() {
        for (value, text) in [
            (5.0, "5"),
            (-0.0, "0"),
            (0.1, "0.1"),
            (-1.5, "-1.5"),
            (1e20, "100000000000000000000"),
            (1e21, "1e+21"),
            (1.5e-7, "1.5e-7"),
            (f64::NEG_INFINITY, "-Infinity"),
        ] {
            assert_eq!((of_number(value).as_str(), number(text)), (text, value));
        }
        assert_eq!(of_number(f64::NAN), "NaN");
        assert_eq!(["", " 12 ", "+1", "0x1F", ".5", "1e3"].map(number), [0.0, 12.0, 1.0, 31.0, 0.5, 1000.0]);
        for text in ["a", "-", "inf", "nan", "1 2", "0x", "0x-1", "--1", "1e", "infinity"] {
            assert!(number(text).is_nan(), "{text}");
        }
    }

    #[test]
    fn regular_expressions_have_flags_and_a_limit() {
        assert!(regex("^b", "gmi").unwrap().is_match("a\nB"));
        assert!(!regex("b", "y").unwrap().is_match("ab") && regex("a|b", "y").unwrap().is_match("ba"));
        assert!(regex("a", "x").unwrap_err().contains("flag x"));
        assert!(regex("(", "").unwrap_err().contains("unclosed group"));
        assert!(regex("(?=a)", "").unwrap_err().contains("look-around"));
        assert!(regex(r"\w{500}{500}", "").unwrap_err().contains("too large"));
    }
}
