//! [`DataVariance`]: what happens to data that update changes while draw may still read it.

/// Whether what draw reads outside its stage may change while the next frame is already being updated.
///
/// A stage is a copy: transforms, state sets and places of geometry in it are those of its frame, whatever update does
/// meanwhile. What remains is data that the application shares with draw itself: what callbacks read, and meshes that
/// are written anew.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum DataVariance {
    /// It does not change, or who changes it makes a copy (`Arc::make_mut`) while draw still has it: nobody waits.
    #[default]
    Static,
    /// It is changed in place: the next update waits until draw has read it.
    Dynamic,
}
