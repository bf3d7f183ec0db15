//! [`Limits`] on everything that is read from outside.

use std::time::Duration;

use super::error::IoError;
use super::memory::about_to_allocate;

/// Upper limits for data from outside. The defaults are above what real tile sets hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Limits {
    /// Bytes of one file, after decompression.
    pub max_file_bytes: u64,
    /// Width and height of an image in pixels.
    pub max_image_side_px: u32,
    /// Bytes of one decoded image. All images of one glTF together may have four times as many.
    pub max_image_bytes: u64,
    /// Tiles of one tileset.json, nodes or vertices of one glTF. Its index lists together may have eight times as many
    /// indices.
    pub max_elements: usize,
    /// Depth of nested tiles and of nested glTF nodes.
    pub max_depth: u32,
    /// Depth of external tilesets inside tilesets.
    pub max_external_depth: usize,
    /// Bytes of memory that one JSON document may take when it is parsed, by a careful estimate: two gibibytes, the default,
    /// are a tileset.json of about 230,000 tiles. Raise it for larger ones.
    pub max_json_bytes: u64,
    /// Bytes of memory that one content may take from its bytes to its page: decompressed bytes, texels, vertices, indices,
    /// nodes and parsed JSON (half of its estimate), as their decoders ask for them before they allocate. What is freed on the way
    /// counts too. One and a half gibibytes, the default, hold the largest file with the largest JSON; usual tiles take a
    /// hundredth of it. Raise it for a single model with many large textures. The files of a content together have a second limit
    /// of the same size.
    pub max_content_bytes: u64,
    /// Time limit for reading or finding one local file, such as one on a network drive whose server is gone; the error is
    /// [`IoError::Timeout`]. A read that hangs cannot be stopped: its thread is left alone. 30 s by default, longer than a disk
    /// that was stopped takes to start.
    pub file_timeout: Duration,
    /// Reads files of a set on disk also if symbolic links lead to them out of the folder of its root. Off by default, since
    /// a set from a stranger could so name any file of this machine.
    pub follow_links: bool,
    /// Lets a set on disk refer to files outside of the folder of its root (`../`, and over links) and to servers with public
    /// addresses. Off by default, since a set from a stranger could so read any file of this machine, and tell a server who
    /// opens it.
    pub allow_outside: bool,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            max_file_bytes: 512 << 20,
            max_image_side_px: 8192,
            max_image_bytes: 256 << 20,
            max_elements: 16 << 20,
            max_depth: 100,
            max_external_depth: 32,
            max_json_bytes: 2 << 30,
            max_content_bytes: 3 << 29,
            file_timeout: Duration::from_secs(30),
            follow_links: false,
            allow_outside: false,
        }
    }
}

impl Limits {
    /// Fails with [`IoError::TooLarge`] if a file of this size is larger than [`Self::max_file_bytes`].
    pub(crate) fn check_file_bytes(&self, uri: &str, got: u64) -> Result<(), IoError> {
        if got > self.max_file_bytes {
            return Err(IoError::TooLarge { uri: uri.to_owned(), what: "file", got, limit: self.max_file_bytes });
        }
        Ok(())
    }

    /// Fails with [`IoError::TooLarge`] if the files of a content have more than [`Self::max_content_bytes`] together. `uri` is
    /// that of the content.
    pub(crate) fn check_files_of_content(&self, uri: &str, got: u64) -> Result<(), IoError> {
        let (what, limit) = (FILES_OF_CONTENT, self.max_content_bytes);
        if got > limit {
            return Err(IoError::TooLarge { uri: uri.to_owned(), what, got, limit });
        }
        Ok(())
    }

    /// Fails with [`IoError::TooLarge`] if a JSON document would take more memory than [`Self::max_json_bytes`]. Reads the text
    /// without allocating, so that it comes before any parser: three bytes of text can become hundreds in memory. Text that is
    /// no JSON passes; its parser stops at the first error.
    pub(crate) fn check_json(&self, uri: &str, text: &[u8]) -> Result<(), IoError> {
        let (mut bytes, mut in_text, mut is_escaped) = (0u64, false, false);
        for byte in text {
            if in_text {
                (in_text, is_escaped) = (is_escaped || *byte != b'"', !is_escaped && *byte == b'\\');
                continue;
            }
            bytes += match byte {
                b'{' => JSON_OBJECT_BYTES,
                b'[' | b',' | b':' => JSON_VALUE_BYTES,
                b'"' => {
                    in_text = true;
                    continue;
                }
                _ => continue,
            };
            if bytes > self.max_json_bytes {
                let limit = self.max_json_bytes;
                return Err(IoError::TooLarge {
                    uri: uri.to_owned(),
                    what: "memory of parsed JSON",
                    got: bytes,
                    limit,
                });
            }
        }
        // A list that has grown keeps half of what the estimate has for its growth.
        about_to_allocate(bytes / 2).map_err(|error| error.at(uri))
    }
}

/// Names the limit of the files of a content in errors.
const FILES_OF_CONTENT: &str = "the files of one content together in bytes (--max-content raises the limit)";
/// An upper limit of the bytes that a parsed object takes without its members. It is twice the size of the largest structure
/// that a reader parses an object into: a growing list has room for as many again.
pub(crate) const JSON_OBJECT_BYTES: u64 = 2048;
/// The same for an element of a list or a member of an object.
const JSON_VALUE_BYTES: u64 = 64;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn json_is_bounded_by_the_memory_that_it_takes() {
        let limits = Limits { max_json_bytes: 100 * JSON_OBJECT_BYTES, ..Limits::default() };
        let check = |text: String| limits.check_json("a", text.as_bytes());
        let list = |element: &str, count: usize| format!("[{}]", vec![element; count].join(","));
        for (element, fits) in [("{}", 96), ("[]", 1599), ("1", 3199), ("\"\"", 3199)] {
            assert!(check(list(element, fits)).is_ok(), "{element}");
            let error = check(list(element, fits + 2)).unwrap_err();
            assert!(matches!(error, IoError::TooLarge { limit: 204_800, .. }), "{element}: {error}");
        }
        // Brackets inside of texts are no objects.
        for text in [r#""{{{{""#, r#""\"{{{{""#, r#""\\\"{""#] {
            assert!(check(list(text, 3199)).is_ok(), "{text}");
        }
        assert!(check(list(r#""\\",{}"#, 100)).is_err(), "the text ends before the object");
        assert!(check(r#"{"a":"#.repeat(98)).is_err(), "an incomplete document");
    }
}
