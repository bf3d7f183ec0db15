//! The bytes of `data:` URIs (RFC 2397). Decode threads.

use base64::Engine as _;

use crate::fetch::IoError;

/// Returns true for a reference that contains its bytes.
pub(super) fn is_data_uri(reference: &str) -> bool {
    reference.get(..5).is_some_and(|scheme| scheme.eq_ignore_ascii_case("data:"))
}

/// Returns the bytes that a `data:` URI contains, as base64 or percent-encoded.
pub(super) fn data_uri(uri: &str, reference: &str) -> Result<Vec<u8>, IoError> {
    let bad = |reason: &str| IoError::invalid(uri, format!("data: URI: {reason}"));
    let (head, data) = reference.split_once(',').ok_or_else(|| bad("there is no comma before the data"))?;
    if !head.to_ascii_lowercase().ends_with(";base64") {
        return percent_decoded(data).ok_or_else(|| bad("bad percent escape"));
    }
    // Some writers omit the padding, others escape it or break lines.
    let unescaped = data.contains('%').then(|| percent_decoded(data).and_then(|bytes| String::from_utf8(bytes).ok()));
    let data = match &unescaped {
        Some(unescaped) => unescaped.as_deref().ok_or_else(|| bad("bad percent escape"))?,
        None => data,
    };
    let engine = base64::engine::GeneralPurpose::new(
        &base64::alphabet::STANDARD,
        base64::engine::general_purpose::PAD.with_decode_padding_mode(base64::engine::DecodePaddingMode::Indifferent),
    );
    let decoded = match data.bytes().any(|byte| byte.is_ascii_whitespace()) {
        true => engine.decode(data.split_ascii_whitespace().collect::<String>()),
        false => engine.decode(data),
    };
    decoded.map_err(|e| bad(&format!("base64: {e}")))
}

fn percent_decoded(text: &str) -> Option<Vec<u8>> {
    let mut bytes = Vec::with_capacity(text.len());
    let mut rest = text.as_bytes();
    while let Some((first, after)) = rest.split_first() {
        if *first != b'%' {
            bytes.push(*first);
            rest = after;
            continue;
        }
        let digits = std::str::from_utf8(after.get(..2)?).ok()?;
        bytes.push(u8::from_str_radix(digits, 16).ok()?);
        rest = &after[2..];
    }
    Some(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_and_percent_escapes_are_decoded() {
        let read = |reference: &str| data_uri("t", reference).map(|bytes| String::from_utf8(bytes).unwrap());
        assert_eq!(read("data:application/octet-stream;base64,Z2xURg==").unwrap(), "glTF");
        assert_eq!(read("data:;BASE64,Z2xURg").unwrap(), "glTF");
        assert_eq!(read("data:;base64,Z2x\n URg==").unwrap(), "glTF");
        assert_eq!(read("data:;base64,Z2xURg%3D%3D").unwrap(), "glTF");
        assert_eq!(read("data:application/json,%7B%22a%22:1}").unwrap(), "{\"a\":1}");
        assert_eq!(read("data:,").unwrap(), "");
        for bad in ["data:", "data:;base64,?", "data:;base64,Z2xURg%3", "data:;base64,%ff", "data:,%7", "data:,%xy"] {
            assert!(read(bad).is_err(), "{bad}");
        }
    }
}
