//! The values of OpenSceneGraph's binary files, for the writers of .osgb and .ive.

/// Defines the methods that write values, for a type with the members `bytes` and `is_big_endian`.
macro_rules! binary_values {
    () => {
        fn put<const N: usize>(&mut self, mut bytes: [u8; N]) -> &mut Self {
            if self.is_big_endian {
                bytes.reverse();
            }
            self.bytes.extend(bytes);
            self
        }

        /// Writes a number, which may be a class, a mode or a count.
        pub fn u32(&mut self, value: u32) -> &mut Self {
            self.put(value.to_le_bytes())
        }

        /// Writes floats.
        pub fn f32s(&mut self, values: &[f32]) -> &mut Self {
            values.iter().for_each(|value| _ = self.put(value.to_le_bytes()));
            self
        }

        /// Writes doubles.
        pub fn f64s(&mut self, values: &[f64]) -> &mut Self {
            values.iter().for_each(|value| _ = self.put(value.to_le_bytes()));
            self
        }

        /// Writes bytes, such as booleans.
        pub fn raw(&mut self, bytes: &[u8]) -> &mut Self {
            self.bytes.extend(bytes);
            self
        }

        /// Writes a string with its length.
        pub fn text(&mut self, text: &str) -> &mut Self {
            self.u32(text.len() as u32).raw(text.as_bytes())
        }
    };
}

pub(crate) use binary_values;
