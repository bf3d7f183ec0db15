//! [`ReaderData`]: what the reader of a tile tree attaches to a tile for the decoder of its content. The scene and the pager
//! pass it on and look only at the methods of [`ReaderValue`]. Immutable; any thread.

use std::any::Any;
use std::fmt::Debug;
use std::sync::Arc;

use crate::math::BoundingVolume;

/// A value that a reader attaches to a tile, known to that reader alone.
pub trait ReaderValue: Any + Debug + Send + Sync {
    /// Returns true if the content is made of this value alone: nothing is fetched for it, and its URI is only a name.
    fn is_whole_content(&self) -> bool {
        false
    }

    /// Returns true if the content continues the tile tree of the tile's own tileset, as a subtree of implicit tiling does.
    /// Such a page does not count as a nested tileset.
    fn continues_tileset(&self) -> bool {
        false
    }

    /// Returns true if the tiles of the content have height tiles.
    fn has_heights(&self) -> bool {
        false
    }

    /// Returns true if an answer without content (status 204) is an error. Otherwise the tile is empty.
    fn needs_content(&self) -> bool {
        false
    }

    /// Returns the URI at which the content is looked for if its own has none.
    fn fallback_uri(&self) -> Option<Arc<str>> {
        None
    }

    /// Returns the region of the content on the ellipsoid of its set, if the reader knows it: west, south, east and north in
    /// radians. East is beyond pi across the antimeridian. Raster overlays cover it.
    fn region(&self) -> Option<[f64; 4]> {
        None
    }

    /// Returns a volume around the content in the frame of the tile's volume, if it is smaller than that one. The content is
    /// neither requested nor drawn while this volume is out of sight.
    fn content_bounds(&self) -> Option<&BoundingVolume> {
        None
    }

    /// Returns true for a tile of a globe's surface, whose volume is a region. Such a tile is replaced by its children as soon
    /// as those in sight are ready: children out of sight are not loaded. One that comes into sight later is drawn as a part
    /// of the tile above until it is loaded.
    fn is_ground_of_globe(&self) -> bool {
        false
    }

    /// Returns the geometric error of the content in metres, if it is not that of the tile. Raster overlays follow it.
    fn geometric_error_m(&self) -> Option<f64> {
        None
    }

    /// Returns the bytes of CPU memory that this value takes, without what it shares with other values.
    fn size_bytes(&self) -> u64;
}

/// Data that is handed back to the reader with the URI of a tile's content. Cheap to clone.
#[derive(Clone, Debug)]
pub enum ReaderData {
    /// Text, such as the JSON of a height tile's parameters.
    Text(Arc<str>),
    /// A value that only the reader knows.
    Value(Arc<dyn ReaderValue>),
}

impl ReaderData {
    /// Wraps a value of a reader.
    pub fn of(value: impl ReaderValue) -> Self {
        Self::Value(Arc::new(value))
    }

    /// Returns the text; `None` for a value.
    pub fn text(&self) -> Option<&str> {
        match self {
            Self::Text(text) => Some(text),
            Self::Value(_) => None,
        }
    }

    /// Returns the value if it is of type `T`.
    pub fn value<T: ReaderValue>(&self) -> Option<&T> {
        match self {
            Self::Text(_) => None,
            Self::Value(value) => (&**value as &dyn Any).downcast_ref(),
        }
    }

    /// Returns true if the content is made of this data alone: nothing is fetched for it.
    pub fn is_whole_content(&self) -> bool {
        matches!(self, Self::Value(value) if value.is_whole_content())
    }

    /// Returns true if the content is a height tile, or its tiles have height tiles.
    pub fn has_heights(&self) -> bool {
        match self {
            Self::Text(_) => true,
            Self::Value(value) => value.has_heights(),
        }
    }

    /// Returns a volume around the content in the frame of the tile's volume, if it is smaller than that one.
    pub fn content_bounds(&self) -> Option<&BoundingVolume> {
        match self {
            Self::Text(_) => None,
            Self::Value(value) => value.content_bounds(),
        }
    }

    /// Returns true if the content continues the tile tree of the tile's own tileset.
    pub fn continues_tileset(&self) -> bool {
        matches!(self, Self::Value(value) if value.continues_tileset())
    }

    /// Returns true if an answer without content (status 204) is an error.
    pub fn needs_content(&self) -> bool {
        matches!(self, Self::Value(value) if value.needs_content())
    }

    /// Returns the URI at which the content is looked for if its own has none.
    pub fn fallback_uri(&self) -> Option<Arc<str>> {
        match self {
            Self::Text(_) => None,
            Self::Value(value) => value.fallback_uri(),
        }
    }

    /// Returns the region of the content; see [`ReaderValue::region`].
    pub fn region(&self) -> Option<[f64; 4]> {
        match self {
            Self::Text(_) => None,
            Self::Value(value) => value.region(),
        }
    }

    /// Returns true for a tile of a globe's surface; see [`ReaderValue::is_ground_of_globe`].
    pub fn is_ground_of_globe(&self) -> bool {
        matches!(self, Self::Value(value) if value.is_ground_of_globe())
    }

    /// Returns the geometric error of the content; see [`ReaderValue::geometric_error_m`].
    pub fn geometric_error_m(&self) -> Option<f64> {
        match self {
            Self::Text(_) => None,
            Self::Value(value) => value.geometric_error_m(),
        }
    }

    /// Returns the bytes of CPU memory of the text or of the value.
    pub fn size_bytes(&self) -> u64 {
        match self {
            Self::Text(text) => text.len() as u64,
            Self::Value(value) => value.size_bytes(),
        }
    }
}

impl From<Arc<str>> for ReaderData {
    fn from(text: Arc<str>) -> Self {
        Self::Text(text)
    }
}

impl From<String> for ReaderData {
    fn from(text: String) -> Self {
        Self::Text(text.into())
    }
}

impl From<&str> for ReaderData {
    fn from(text: &str) -> Self {
        Self::Text(text.into())
    }
}
