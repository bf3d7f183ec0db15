//! Reading a span of a file.

use std::fs::File;
use std::io::{self, Read as _, Seek as _, SeekFrom};

use crate::fetch::archive::span::Span;

/// Clips a span to a file of `length` bytes.
pub(super) fn clipped(span: Span, length: u64) -> Span {
    let offset = span.offset.min(length);
    Span { offset, size: span.size.min(length - offset) }
}

/// Reads a span. The result is shorter if the file ends before it.
pub(super) fn read_span(file: &mut File, span: Span) -> io::Result<Vec<u8>> {
    file.seek(SeekFrom::Start(span.offset))?;
    let mut bytes = Vec::with_capacity(span.size as usize);
    file.take(span.size).read_to_end(&mut bytes)?;
    Ok(bytes)
}
