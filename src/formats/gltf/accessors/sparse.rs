//! Sparse accessors: elements of a view, or zeros, of which some are replaced (glTF 2.0, 3.6.2.3).

use gltf::accessor::sparse::{IndexType, Sparse};
use gltf::accessor::{DataType, Dimensions};

use super::buffers::{Buffers, Slice};
use super::elements::{Elements, element_bytes};
use crate::fetch::IoError;

impl Buffers<'_> {
    /// Returns the elements of a sparse accessor; `None` if a buffer of them is missing.
    pub(super) fn sparse(
        &self,
        view: Option<&gltf::buffer::View<'_>>,
        slice: &Slice,
        sparse: &Sparse<'_>,
    ) -> Result<Option<Elements<'_>>, IoError> {
        let mut elements = self.zeros(slice)?;
        let (size, tight) = element_bytes(slice.data_type, slice.dimensions);
        let all = elements.bytes.to_mut();
        if let Some(view) = view {
            let Some(base) = self.slice(view, slice)? else { return Ok(None) };
            for (to, from) in all.chunks_exact_mut(tight).zip(base.bytes.chunks(base.stride)) {
                to[..size].copy_from_slice(&from[..size]);
            }
        }
        if sparse.count() > slice.count {
            return Err(self.bad("a sparse accessor replaces more elements than it has"));
        }
        let part = |offset, data_type, dimensions| Slice {
            offset,
            count: sparse.count(),
            data_type,
            dimensions,
            is_strided: false,
            normalized: false,
        };
        let index_type = match sparse.indices().index_type() {
            IndexType::U8 => DataType::U8,
            IndexType::U16 => DataType::U16,
            IndexType::U32 => DataType::U32,
        };
        let indices = part(sparse.indices().offset(), index_type, Dimensions::Scalar);
        let values = part(sparse.values().offset(), slice.data_type, slice.dimensions);
        let indices = self.slice(&sparse.indices().view(), &indices)?;
        let (Some(indices), Some(values)) = (indices, self.slice(&sparse.values().view(), &values)?) else {
            return Ok(None);
        };
        for (i, from) in values.bytes.chunks(values.stride).enumerate() {
            let index = indices.unsigned(i, 0) as usize;
            let to = all.chunks_exact_mut(tight).nth(index);
            let to = to.ok_or_else(|| self.bad(format_args!("sparse index {index} of {} elements", slice.count)))?;
            to[..size].copy_from_slice(&from[..size]);
        }
        Ok(Some(elements))
    }
}
