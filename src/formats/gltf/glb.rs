//! The binary containers of glTF 2.0 and of glTF 1.0 (KHR_binary_glTF).

use std::borrow::Cow;

use crate::fetch::IoError;

/// The chunks of a binary glTF.
pub(super) struct Chunks<'a> {
    /// UTF-8; characters of other encodings, as in names, are replaced.
    pub json: Cow<'a, [u8]>,
    pub binary: Option<&'a [u8]>,
}

/// The size of a header of version 1.
const HEADER_1_BYTES: usize = 20;

/// Returns the first JSON chunk and the first binary chunk.
pub(super) fn chunks<'a>(uri: &str, bytes: &'a [u8]) -> Result<Chunks<'a>, IoError> {
    let bad = |reason: &str| IoError::invalid(uri, format!("glb: {reason}"));
    let u32_at = |at: usize| -> Option<u32> { Some(u32::from_le_bytes(bytes.get(at..at + 4)?.try_into().ok()?)) };
    if !bytes.starts_with(b"glTF") {
        return Err(bad("wrong magic"));
    }
    let version = u32_at(4).ok_or_else(|| bad("truncated header"))?;
    if version != 1 && version != 2 {
        return Err(IoError::unsupported(uri, format!("glb version {version}")));
    }
    let length = u32_at(8).ok_or_else(|| bad("truncated header"))? as usize;
    if length > bytes.len() {
        return Err(bad(&format!("truncated: {} of {length} bytes", bytes.len())));
    }
    if version == 1 {
        // Length and format of the JSON, the JSON, then the body.
        let size = u32_at(12).ok_or_else(|| bad("truncated header"))? as usize;
        return match u32_at(16) {
            Some(0) => {
                let end = HEADER_1_BYTES.checked_add(size).filter(|end| *end <= length);
                let end = end.ok_or_else(|| bad("JSON beyond the end"))?;
                Ok(Chunks { json: text(&bytes[HEADER_1_BYTES..end]), binary: Some(&bytes[end..length]) })
            }
            format => Err(IoError::unsupported(uri, format!("glb version 1 with content format {format:?}"))),
        };
    }
    let (mut json, mut binary) = (None, None);
    let mut at = 12usize;
    while at + 8 <= length {
        let size = u32_at(at).ok_or_else(|| bad("truncated chunk"))? as usize;
        let kind = bytes.get(at + 4..at + 8).ok_or_else(|| bad("truncated chunk"))?;
        let end = (at + 8).checked_add(size).filter(|e| *e <= length).ok_or_else(|| bad("chunk beyond the end"))?;
        let data = &bytes[at + 8..end];
        match kind {
            b"JSON" if json.is_none() => json = Some(text(data)),
            b"BIN\0" if binary.is_none() => binary = Some(data),
            _ => {}
        }
        at = end.next_multiple_of(4);
    }
    Ok(Chunks { json: json.ok_or_else(|| bad("no JSON chunk"))?, binary })
}

/// Returns JSON as UTF-8, without a byte order mark and without zeros at its end, which some writers pad it with instead of
/// spaces.
pub(super) fn text(json: &[u8]) -> Cow<'_, [u8]> {
    let json = json.strip_prefix(b"\xef\xbb\xbf").unwrap_or(json);
    let json = &json[..json.iter().rposition(|byte| *byte != 0).map_or(0, |last| last + 1)];
    match String::from_utf8_lossy(json) {
        Cow::Borrowed(text) => Cow::Borrowed(text.as_bytes()),
        Cow::Owned(text) => Cow::Owned(text.into_bytes()),
    }
}
