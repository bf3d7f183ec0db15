//! WEB3D_quantized_attributes: integers that a matrix of their accessor maps to numbers.

use std::borrow::Cow;

use gltf::accessor::DataType;
use serde_json::Value;

use super::buffers::Buffers;
use super::elements::Elements;
use crate::fetch::IoError;

const EXTENSION: &str = "WEB3D_quantized_attributes";

impl Buffers<'_> {
    /// Applies the matrix of an accessor to its elements. Returns them as they are if it has none.
    pub(super) fn dequantized<'e>(
        &self,
        accessor: &gltf::Accessor<'_>,
        elements: Elements<'e>,
    ) -> Result<Elements<'e>, IoError> {
        let Some(extension) = accessor.extension_value(EXTENSION) else { return Ok(elements) };
        let (count, n) = (elements.count, elements.components);
        // One row and one column more than components, column by column. The last column is the offset.
        let numbers = extension.get("decodeMatrix").and_then(Value::as_array);
        let matrix: Option<Vec<f64>> = numbers.and_then(|numbers| numbers.iter().map(Value::as_f64).collect());
        let matrix = matrix.filter(|matrix| matrix.len() == (n + 1) * (n + 1));
        let matrix = matrix.ok_or_else(|| {
            self.bad(format_args!("{EXTENSION}: decodeMatrix has not {} numbers for {n} components", (n + 1) * (n + 1)))
        })?;
        let stride = n * DataType::F32.size();
        self.count_decoded(count.saturating_mul(stride) as u64)?;
        let raw = Elements { normalized: false, ..elements };
        let mut bytes = Vec::with_capacity(count * stride);
        for i in 0..count {
            for row in 0..n {
                let parts = (0..n).map(|c| matrix[c * (n + 1) + row] * f64::from(raw.value(i, c)));
                let sum = parts.sum::<f64>() + matrix[n * (n + 1) + row];
                bytes.extend((sum as f32).to_le_bytes());
            }
        }
        Ok(Elements { bytes: Cow::Owned(bytes), stride, data_type: DataType::F32, ..raw })
    }
}
