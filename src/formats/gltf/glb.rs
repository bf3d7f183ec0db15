//! The binary container of glTF 2.0.

use glam::DVec3;

use super::reader::read_document;
use crate::fetch::IoError;
use crate::formats::options::ReadOptions;
use crate::scene::Node;

/// Reads a binary glTF. `rtc_center` is the z-up RTC_CENTER of a b3dm, added after the rotation.
pub(in crate::formats) fn read_glb(
    uri: &str,
    bytes: &[u8],
    rtc_center: Option<DVec3>,
    options: &ReadOptions,
) -> Result<Node, IoError> {
    let bad = |reason: &str| IoError::invalid(uri, format!("glb: {reason}"));
    let u32_at = |at: usize| -> Option<u32> { Some(u32::from_le_bytes(bytes.get(at..at + 4)?.try_into().ok()?)) };
    if !bytes.starts_with(b"glTF") {
        return Err(bad("wrong magic"));
    }
    let version = u32_at(4).ok_or_else(|| bad("truncated header"))?;
    if version != 2 {
        return Err(IoError::unsupported(uri, format!("glb version {version}")));
    }
    let length = u32_at(8).ok_or_else(|| bad("truncated header"))? as usize;
    if length > bytes.len() {
        return Err(bad(&format!("truncated: {} of {length} bytes", bytes.len())));
    }
    let (mut json, mut binary) = (None, None);
    let mut at = 12usize;
    while at + 8 <= length {
        let size = u32_at(at).ok_or_else(|| bad("truncated chunk"))? as usize;
        let kind = bytes.get(at + 4..at + 8).ok_or_else(|| bad("truncated chunk"))?;
        let end = (at + 8).checked_add(size).filter(|e| *e <= length).ok_or_else(|| bad("chunk beyond the end"))?;
        let data = &bytes[at + 8..end];
        match kind {
            b"JSON" if json.is_none() => json = Some(data),
            b"BIN\0" if binary.is_none() => binary = Some(data),
            _ => {}
        }
        at = end.next_multiple_of(4);
    }
    read_document(uri, json.ok_or_else(|| bad("no JSON chunk"))?, binary, rtc_center, options)
}
