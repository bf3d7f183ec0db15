//! [`Buffers`]: the bytes of a glTF's buffers and buffer views, and checked access to them.

use std::borrow::Cow;
use std::cell::OnceCell;

use gltf::accessor::{DataType, Dimensions};

use super::elements::{Elements, element_bytes};
use super::meshopt::CompressedView;
use crate::fetch::IoError;
use crate::formats::gltf::context::Context;
use crate::formats::gltf::external::data_uri;

/// The note about a primitive that cannot be drawn without a file that is missing.
pub(in super::super) const BUFFER_MISSING: &str = "glTF: primitive that is not drawn because its buffer is missing";

/// The bytes of all buffers.
pub(in super::super) struct Buffers<'a> {
    context: &'a Context<'a>,
    data: Vec<Buffer<'a>>,
    /// By buffer view: its bytes once they were decompressed. Empty if no view is compressed.
    decompressed: Vec<OnceCell<Vec<u8>>>,
}

enum Buffer<'a> {
    Bytes(Cow<'a, [u8]>),
    /// The file of the buffer is missing, for this reason.
    Missing(IoError),
    /// The document names no bytes: only compressed views refer to the buffer.
    Fallback,
}

/// The part of a buffer view that an accessor reads.
pub(super) struct Slice {
    pub offset: usize,
    pub count: usize,
    pub data_type: DataType,
    pub dimensions: Dimensions,
    /// False if the elements lie without gaps, whatever the stride of the view.
    pub is_strided: bool,
    pub normalized: bool,
}

impl<'a> Buffers<'a> {
    /// Reads the buffers of a document from the binary chunk, from `data:` URIs and from external files.
    pub fn read(
        context: &'a Context<'a>,
        document: &gltf::Document,
        binary: Option<&'a [u8]>,
    ) -> Result<Self, IoError> {
        let mut buffers = Vec::new();
        for buffer in document.buffers() {
            let data = match buffer.source() {
                gltf::buffer::Source::Bin => match binary.filter(|_| buffer.index() == 0) {
                    Some(binary) => Buffer::Bytes(Cow::Borrowed(binary)),
                    None => Buffer::Fallback,
                },
                gltf::buffer::Source::Uri(reference) => match data_uri(context.uri, reference) {
                    Some(data) => Buffer::Bytes(Cow::Owned(data?)),
                    None => context.files.get(reference).map(|(_, bytes)| Buffer::Bytes(bytes)).or_else(|error| {
                        context.missing("glTF: external buffer that is missing", &error)?;
                        Ok(Buffer::Missing(error))
                    })?,
                },
            };
            if let Buffer::Bytes(data) = &data
                && data.len() < buffer.length()
            {
                // A file may have been cut on its way. In one of a piece it is the number that is wrong.
                if let gltf::buffer::Source::Uri(reference) = buffer.source()
                    && data_uri(context.uri, reference).is_none()
                {
                    let (got, declared) = (data.len(), buffer.length());
                    return Err(context.bad(format_args!("buffer of {got} bytes, {declared} declared")));
                }
                context.notes.add("glTF: buffer that is shorter than its byteLength");
            }
            buffers.push(data);
        }
        let is_compressed = document.views().any(|view| CompressedView::is_compressed(&view));
        let decompressed = if is_compressed { document.views().map(|_| OnceCell::new()).collect() } else { Vec::new() };
        Ok(Self { context, data: buffers, decompressed })
    }

    /// Returns the error of the first file that is missing.
    pub fn first_missing(&self) -> Option<&IoError> {
        self.data.iter().find_map(|buffer| if let Buffer::Missing(error) = buffer { Some(error) } else { None })
    }

    /// Returns the bytes of a view, decompressed on first use; `None` if they are missing.
    pub fn view(&self, view: &gltf::buffer::View<'_>) -> Result<Option<&[u8]>, IoError> {
        let plain = || self.bytes(view.buffer().index(), view.offset(), view.length());
        let Some(decompressed) = self.decompressed.get(view.index()) else { return plain() };
        if let Some(known) = decompressed.get() {
            return Ok(Some(known));
        }
        let Some(compressed) = CompressedView::new(view).map_err(|reason| self.context.bad(reason))? else {
            return plain();
        };
        let Some(bytes) = self.bytes(compressed.buffer, compressed.offset, compressed.length)? else { return Ok(None) };
        self.context.budget.add_decoded(compressed.decoded_bytes() as u64)?;
        // The decoder and the filter have a copy each.
        self.context.budget.ask(2 * compressed.decoded_bytes() as u64)?;
        let bytes = compressed.decode(bytes).map_err(|reason| self.context.bad(reason))?;
        Ok(Some(decompressed.get_or_init(|| bytes)))
    }

    /// Returns a range of a buffer, or `None` if the buffer is missing.
    fn bytes(&self, buffer: usize, offset: usize, length: usize) -> Result<Option<&[u8]>, IoError> {
        let outside = || self.context.bad("a bufferView reaches beyond its buffer");
        let bytes = match self.data.get(buffer).ok_or_else(outside)? {
            Buffer::Bytes(bytes) => bytes,
            Buffer::Missing(_) => return Ok(None),
            Buffer::Fallback => return Err(self.context.bad(format_args!("buffer {buffer} has no data"))),
        };
        let end = offset.checked_add(length).ok_or_else(outside)?;
        bytes.get(offset..end).map(Some).ok_or_else(outside)
    }

    /// Returns the elements of an accessor, with every offset, stride and count checked; `None` if their buffer is missing.
    /// The caller has counted the accessor's elements in the budget.
    pub fn elements(
        &self,
        accessor: &gltf::Accessor<'_>,
        dimensions: Dimensions,
    ) -> Result<Option<Elements<'_>>, IoError> {
        if accessor.dimensions() != dimensions {
            return Err(self.context.bad("accessor of the wrong type"));
        }
        let slice = Slice {
            offset: accessor.offset(),
            count: accessor.count(),
            data_type: accessor.data_type(),
            dimensions,
            is_strided: true,
            normalized: accessor.normalized(),
        };
        let elements = match (accessor.view(), accessor.sparse()) {
            (Some(view), None) => self.slice(&view, &slice)?,
            (view, Some(sparse)) => self.sparse(view.as_ref(), &slice, &sparse)?,
            (None, None) => Some(self.zeros(&slice)?),
        };
        elements.map(|elements| self.dequantized(accessor, elements)).transpose()
    }

    /// Returns the elements of a part of a view.
    pub(super) fn slice(&self, view: &gltf::buffer::View<'_>, slice: &Slice) -> Result<Option<Elements<'_>>, IoError> {
        let (size, tight) = element_bytes(slice.data_type, slice.dimensions);
        let stride = view.stride().filter(|_| slice.is_strided).unwrap_or(tight);
        let outside = || self.context.bad("accessor reaches beyond its buffer");
        if stride < size {
            return Err(self.context.bad("byteStride below the element's size"));
        }
        let needed = match slice.count {
            0 => 0,
            n => (n - 1).checked_mul(stride).and_then(|b| b.checked_add(size)).ok_or_else(outside)?,
        };
        let end = slice.offset.checked_add(needed).ok_or_else(outside)?;
        let Some(bytes) = self.view(view)? else { return Ok(None) };
        let bytes = bytes.get(slice.offset..end).ok_or_else(outside)?;
        Ok(Some(slice.elements(Cow::Borrowed(bytes), stride)))
    }

    /// Returns elements that are all zero, as of an accessor without a view.
    pub(super) fn zeros(&self, slice: &Slice) -> Result<Elements<'static>, IoError> {
        let (_, tight) = element_bytes(slice.data_type, slice.dimensions);
        let size = slice.count.saturating_mul(tight);
        self.count_decoded(size as u64)?;
        Ok(slice.elements(Cow::Owned(vec![0; size]), tight))
    }

    /// Counts bytes that are about to be written in the budget.
    pub(super) fn count_decoded(&self, bytes: u64) -> Result<(), IoError> {
        self.context.budget.add_decoded(bytes)
    }

    pub(super) fn bad(&self, reason: impl std::fmt::Display) -> IoError {
        self.context.bad(reason)
    }
}

impl Slice {
    fn elements<'e>(&self, bytes: Cow<'e, [u8]>, stride: usize) -> Elements<'e> {
        Elements {
            bytes,
            stride,
            count: self.count,
            components: self.dimensions.multiplicity(),
            data_type: self.data_type,
            normalized: self.normalized,
        }
    }
}
