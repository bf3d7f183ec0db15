//! External files of a glTF: buffers, images and the schema of its metadata.
//!
//! Loaders ask [`references`] before they decode, fetch the files and hand them to the decoder, which does no I/O.

use std::borrow::Cow;

use serde::Deserialize;
use serde_json::Value;

use crate::fetch::IoError;
use crate::formats::embedded::{self, is_data_uri};
use crate::formats::lenient::{Text, valid_or_default};

/// Returns the bytes of a `data:` URI; `None` for other references.
pub(super) fn data_uri(uri: &str, reference: &str) -> Option<Result<Vec<u8>, IoError>> {
    is_data_uri(reference).then(|| embedded::data_uri(uri, reference))
}

#[derive(Deserialize)]
struct Document<'a> {
    #[serde(borrow)]
    buffers: Option<Vec<Source<'a>>>,
    #[serde(borrow)]
    images: Option<Vec<Source<'a>>>,
    #[serde(default, deserialize_with = "valid_or_default")]
    extensions: Extensions,
}

#[derive(Default, Deserialize)]
struct Extensions {
    #[serde(rename = "EXT_structural_metadata")]
    metadata: Option<Metadata>,
}

#[derive(Deserialize)]
struct Metadata {
    #[serde(rename = "schemaUri", default)]
    schema_uri: Text,
}

#[derive(Deserialize)]
struct Source<'a> {
    #[serde(borrow)]
    uri: Option<Cow<'a, str>>,
}

/// Returns the references to external files in the JSON of a glTF 2.0; `None` if it is invalid. The schema of its metadata is
/// among them only `with_schema`.
pub(super) fn references(json: &[u8], with_schema: bool) -> Option<Vec<String>> {
    let Ok(document) = serde_json::from_slice::<Document<'_>>(json) else { return of_valid_parts(json) };
    let sources = [document.buffers, document.images].into_iter().flatten().flatten();
    let schema = document.extensions.metadata.filter(|_| with_schema).and_then(|metadata| metadata.schema_uri.0);
    let references = sources.filter_map(|source| source.uri).map(Cow::into_owned).chain(schema);
    Some(references.filter(|reference| !is_data_uri(reference)).collect())
}

/// Returns the references of a document with invalid parts, whose metadata is left out.
fn of_valid_parts(json: &[u8]) -> Option<Vec<String>> {
    let document: Value = serde_json::from_slice(json).ok()?;
    let lists = ["buffers", "images"].map(|list| document.get(list));
    // The lists of older versions are objects.
    if !document.is_object() || lists.iter().flatten().any(|list| list.is_object()) {
        return None;
    }
    let objects = lists.into_iter().flatten().filter_map(Value::as_array).flatten();
    let references = objects.filter_map(|object| object.get("uri")?.as_str());
    Some(references.filter(|reference| !is_data_uri(reference)).map(str::to_owned).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn references_are_found_in_any_document() {
        let json =
            br#"{"buffers":[{"uri":"a%20b.bin"},{"uri":"data:,x"},{"byteLength":1}],"images":[{"uri":"c.png"}]}"#;
        let all = |json: &[u8]| references(json, true).unwrap();
        assert_eq!(all(json), ["a%20b.bin", "c.png"]);
        assert!(all(b"{}").is_empty() && references(b"{", true).is_none());
        assert!(references(br#"{"buffers":{"a":{"uri":"b"}}}"#, true).is_none());
        assert!(all(br#"{"buffers":null,"images":[{"uri":"d"}],"extensions":7}"#) == ["d"]);
        assert_eq!(all(br#"{"buffers":[{"uri":"e"},7],"images":[{"uri":8},{"uri":"f"}]}"#), ["e", "f"]);
        let json = br#"{"buffers":[{"uri":"a"}],"extensions":{"EXT_structural_metadata":{"schemaUri":"s.json"}}}"#;
        assert_eq!(
            (all(json), references(json, false).map(|list| list.len())),
            (vec!["a".to_owned(), "s.json".to_owned()], Some(1))
        );
    }
}
