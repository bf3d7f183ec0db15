//! [`Buffers`]: the bytes of a glTF's buffers, and checked access to them.

use std::borrow::Cow;

use base64::Engine as _;
use gltf::accessor::Dimensions;

use super::elements::{Elements, element_bytes};
use crate::fetch::IoError;

/// The bytes of all buffers.
pub(super) struct Buffers<'a> {
    uri: &'a str,
    data: Vec<Cow<'a, [u8]>>,
}

impl<'a> Buffers<'a> {
    /// Reads the buffers of a document from the binary chunk and from `data:` URIs.
    pub fn read(uri: &'a str, document: &gltf::Document, binary: Option<&'a [u8]>) -> Result<Self, IoError> {
        let mut buffers = Vec::new();
        for buffer in document.buffers() {
            let data = match buffer.source() {
                gltf::buffer::Source::Bin if buffer.index() > 0 => {
                    return Err(IoError::invalid(uri, format!("glTF: buffer {} has no data", buffer.index())));
                }
                gltf::buffer::Source::Bin => {
                    Cow::Borrowed(binary.ok_or_else(|| IoError::invalid(uri, "glTF: no binary chunk"))?)
                }
                gltf::buffer::Source::Uri(reference) => Cow::Owned(data_uri(uri, reference)?),
            };
            if data.len() < buffer.length() {
                let reason = format!("glTF: buffer of {} bytes, {} declared", data.len(), buffer.length());
                return Err(IoError::invalid(uri, reason));
            }
            buffers.push(data);
        }
        Ok(Self { uri, data: buffers })
    }

    /// Returns the bytes of a view.
    pub fn view(&self, view: &gltf::buffer::View<'_>) -> Result<&[u8], IoError> {
        let outside = || self.bad("image reaches beyond its buffer");
        let buffer = self.data.get(view.buffer().index()).ok_or_else(outside)?;
        let end = view.offset().checked_add(view.length()).ok_or_else(outside)?;
        buffer.get(view.offset()..end).ok_or_else(outside)
    }

    fn bad(&self, reason: &str) -> IoError {
        IoError::invalid(self.uri, format!("glTF: {reason}"))
    }

    /// Returns the elements of an accessor, with every offset, stride and count checked.
    pub fn elements(&self, accessor: &gltf::Accessor<'_>, dimensions: Dimensions) -> Result<Elements<'_>, IoError> {
        if accessor.dimensions() != dimensions {
            return Err(self.bad("accessor of the wrong type"));
        }
        if accessor.sparse().is_some() {
            return Err(IoError::unsupported(self.uri, "sparse accessor"));
        }
        let view = accessor.view().ok_or_else(|| IoError::unsupported(self.uri, "accessor without a bufferView"))?;
        let (count, (size, tight)) = (accessor.count(), element_bytes(accessor.data_type(), dimensions));
        let stride = view.stride().unwrap_or(tight);
        let outside = || self.bad("accessor reaches beyond its buffer");
        if stride < size {
            return Err(self.bad("byteStride below the element's size"));
        }
        let needed = match count {
            0 => 0,
            n => (n - 1).checked_mul(stride).and_then(|b| b.checked_add(size)).ok_or_else(outside)?,
        };
        let end = accessor.offset().checked_add(needed).ok_or_else(outside)?;
        if end > view.length() {
            return Err(outside());
        }
        let begin = view.offset().checked_add(accessor.offset()).ok_or_else(outside)?;
        let buffer = self.data.get(view.buffer().index()).ok_or_else(outside)?;
        let bytes = begin.checked_add(needed).and_then(|end| buffer.get(begin..end)).ok_or_else(outside)?;
        Ok(Elements {
            bytes,
            stride,
            count,
            components: dimensions.multiplicity(),
            data_type: accessor.data_type(),
            normalized: accessor.normalized(),
        })
    }
}

/// Returns the bytes of a base64 `data:` URI. Fails for any other reference.
pub(super) fn data_uri(uri: &str, reference: &str) -> Result<Vec<u8>, IoError> {
    let data = reference.strip_prefix("data:").and_then(|d| d.split_once(";base64,"));
    let Some((_, text)) = data else {
        return Err(IoError::unsupported(uri, format!("glTF with an external file {:.60}", reference)));
    };
    // Some writers omit the padding.
    let engine = base64::engine::GeneralPurpose::new(
        &base64::alphabet::STANDARD,
        base64::engine::general_purpose::PAD.with_decode_padding_mode(base64::engine::DecodePaddingMode::Indifferent),
    );
    engine.decode(text).map_err(|e| IoError::invalid(uri, format!("glTF: base64 of a data: URI: {e}")))
}
