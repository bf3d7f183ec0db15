//! [`UriTemplate`]: the URI of a content or subtree with placeholders for the coordinates of the tile. Plain values.

use std::fmt::Write as _;
use std::sync::Arc;

use super::coordinates::TileCoordinates;
use crate::fetch::{IoError, RootScope, resolve};

/// A coordinate that stands in a URI.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Variable {
    Level,
    X,
    Y,
    Z,
}

/// A placeholder in braces, plain or as URLs escape it.
const PLACEHOLDERS: [(&str, Variable); 8] = [
    ("{level}", Variable::Level),
    ("{x}", Variable::X),
    ("{y}", Variable::Y),
    ("{z}", Variable::Z),
    ("%7Blevel%7D", Variable::Level),
    ("%7Bx%7D", Variable::X),
    ("%7By%7D", Variable::Y),
    ("%7Bz%7D", Variable::Z),
];

/// An absolute URI with placeholders. It is resolved once, so that the URI of a tile costs only the text.
#[derive(Clone, Debug)]
pub(super) struct UriTemplate {
    /// Text, each part followed by a coordinate.
    parts: Vec<(Box<str>, Variable)>,
    /// The text after the last placeholder.
    end: Box<str>,
}

impl UriTemplate {
    /// Resolves a template that stands in the file `base`.
    pub fn resolve(base: &str, template: &str, scope: &RootScope) -> Result<Self, IoError> {
        let resolved = resolve(base, template, scope)?;
        let (mut parts, mut rest) = (Vec::new(), &*resolved);
        while let Some((at, length, variable)) = first_placeholder(rest) {
            parts.push((rest[..at].into(), variable));
            rest = &rest[at + length..];
        }
        Ok(Self { parts, end: rest.into() })
    }

    /// Returns the URI of a tile.
    pub fn fill(&self, tile: TileCoordinates) -> Arc<str> {
        let mut uri = String::with_capacity(self.size_bytes() as usize + 8 * self.parts.len());
        for (text, variable) in &self.parts {
            uri.push_str(text);
            let number = match variable {
                Variable::Level => tile.level,
                Variable::X => tile.x,
                Variable::Y => tile.y,
                Variable::Z => tile.z,
            };
            // Writing to a string never fails.
            let _ = write!(uri, "{number}");
        }
        uri.push_str(&self.end);
        uri.into()
    }

    /// Returns the bytes of the text.
    pub fn size_bytes(&self) -> u64 {
        (self.parts.iter().map(|(text, _)| text.len()).sum::<usize>() + self.end.len()) as u64
    }
}

/// Returns position, length and meaning of the first placeholder of a text.
fn first_placeholder(text: &str) -> Option<(usize, usize, Variable)> {
    let found = PLACEHOLDERS.iter().filter_map(|(name, variable)| Some((text.find(name)?, name.len(), *variable)));
    found.min_by_key(|(at, _, _)| *at)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn placeholders_are_filled_in_paths_and_queries() {
        let tile = TileCoordinates { level: 3, x: 10, y: 2, z: 7 };
        let fill = |base: &str, template: &str| {
            UriTemplate::resolve(base, template, &RootScope::of(base)).map(|template| template.fill(tile).to_string())
        };
        let file = "/set/tileset.json";
        assert_eq!(fill(file, "c/{level}/{x}_{y}.glb").unwrap(), "/set/c/3/10_2.glb");
        assert_eq!(fill(file, "{z}{level}{z}").unwrap(), "/set/737");
        assert_eq!(fill(file, "all.glb").unwrap(), "/set/all.glb");
        let url = "https://h/set/tileset.json?key=1";
        assert_eq!(fill(url, "../c/{level}/{x}.glb?y={y}&z={z}").unwrap(), "https://h/c/3/10.glb?y=2&z=7&key=1");
        assert_eq!(fill(url, "%7Bx%7D/{w}").unwrap(), "https://h/set/10/%7Bw%7D?key=1");
        assert!(fill(file, "../../{x}").is_err());
        assert!(fill(url, "ftp://h/{x}").is_err());
    }
}
