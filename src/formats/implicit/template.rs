//! [`UriTemplate`]: the URI of a content or subtree with placeholders for the coordinates of the tile. Plain values.

use std::fmt::Write as _;
use std::sync::Arc;

use super::coordinates::TileCoordinates;
use crate::fetch::IoError;
use crate::formats::options::ReadOptions;

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
pub(in crate::formats) struct UriTemplate {
    uri: Template,
    /// The URI without the redirects that led to the file, if it differs.
    fallback: Option<Template>,
}

/// Text with placeholders.
#[derive(Clone, Debug)]
struct Template {
    /// Text, each part followed by a coordinate.
    parts: Vec<(Box<str>, Variable)>,
    /// The text after the last placeholder.
    end: Box<str>,
}

impl UriTemplate {
    /// Resolves a template that stands in the file `uri`.
    pub fn resolve(uri: &str, template: &str, options: &ReadOptions) -> Result<Self, IoError> {
        let (uri, fallback) = options.resolve(uri, template)?;
        Ok(Self { uri: Template::of(&uri), fallback: fallback.map(|fallback| Template::of(&fallback)) })
    }

    /// Returns the URI of a tile.
    pub fn fill(&self, tile: TileCoordinates) -> Arc<str> {
        self.uri.fill(tile)
    }

    /// Returns the URI at which the file of a tile is looked for if its own has none.
    pub fn fill_fallback(&self, tile: TileCoordinates) -> Option<Arc<str>> {
        Some(self.fallback.as_ref()?.fill(tile))
    }

    /// Returns the bytes of the text.
    pub fn size_bytes(&self) -> u64 {
        [Some(&self.uri), self.fallback.as_ref()].into_iter().flatten().map(Template::size_bytes).sum()
    }
}

impl Template {
    fn of(resolved: &str) -> Self {
        let (mut parts, mut rest) = (Vec::new(), resolved);
        while let Some((at, length, variable)) = first_placeholder(rest) {
            parts.push((rest[..at].into(), variable));
            rest = &rest[at + length..];
        }
        Self { parts, end: rest.into() }
    }

    fn fill(&self, tile: TileCoordinates) -> Arc<str> {
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

    fn size_bytes(&self) -> u64 {
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
    use crate::fetch::Limits;

    #[test]
    fn placeholders_are_filled_in_paths_and_queries() {
        let tile = TileCoordinates { level: 3, x: 10, y: 2, z: 7 };
        let fill = |base: &str, template: &str| {
            let options = ReadOptions::for_root(base, Limits::default());
            UriTemplate::resolve(base, template, &options).map(|template| template.fill(tile).to_string())
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
