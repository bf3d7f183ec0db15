//! [`DataVariance`]: how update may change data that draw may still read.

/// Whether data that draw reads outside of its stage may change while the next frame is updated.
///
/// A stage is a copy: its transforms, state sets and slots of geometry belong to its frame, whatever update does in the
/// meantime. The variance concerns data that the application itself shares with draw: the data of callbacks, and meshes
/// that are rewritten.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum DataVariance {
    /// The data does not change, or is copied before a change (`Arc::make_mut`) while draw holds it. No thread waits.
    #[default]
    Static,
    /// The data is changed without a copy: the next update waits until draw has read it.
    Dynamic,
}
