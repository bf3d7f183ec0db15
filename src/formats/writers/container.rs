//! The container of a glb (glTF 2.0, section "GLB File Format"). Threads of `convert` and `gen`.

use serde_json::Value;

/// Returns a glb file of a document and its binary chunk, which is left out if it is empty. The length of the chunk is a multiple
/// of 4.
pub fn container(document: &Value, binary: &[u8]) -> Vec<u8> {
    let mut text = document.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let binary_length = if binary.is_empty() { 0 } else { 8 + binary.len() };
    let length = 12 + 8 + text.len() + binary_length;
    let mut out = Vec::with_capacity(length);
    out.extend_from_slice(b"glTF");
    out.extend_from_slice(&2u32.to_le_bytes());
    out.extend_from_slice(&(length as u32).to_le_bytes());
    out.extend_from_slice(&(text.len() as u32).to_le_bytes());
    out.extend_from_slice(b"JSON");
    out.extend_from_slice(&text);
    if !binary.is_empty() {
        out.extend_from_slice(&(binary.len() as u32).to_le_bytes());
        out.extend_from_slice(b"BIN\0");
        out.extend_from_slice(binary);
    }
    out
}
