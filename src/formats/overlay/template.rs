//! [`Template`]: the URL of an image as a text with placeholders. Any thread.

use super::grid::{TileGrid, TileIndex};

/// The names of placeholders.
const NAMES: [&str; 9] = ["z", "x", "y", "-y", "reverseY", "s", "TileMatrix", "TileCol", "TileRow"];

/// A URL with placeholders, checked.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Template {
    text: String,
    subdomains: Vec<String>,
}

impl Template {
    /// Checks a template. `subdomains` replace `{s}` in turn.
    ///
    /// # Errors
    /// The reason if a placeholder is unknown, or one for the tile is missing.
    pub fn new(text: &str, subdomains: &[String]) -> Result<Self, String> {
        let mut rest = text;
        let mut found = Vec::new();
        while let Some((_, after)) = rest.split_once('{') {
            let Some((name, next)) = after.split_once('}') else {
                return Err(format!("{text}: a placeholder has no closing brace"));
            };
            if !NAMES.contains(&name) {
                return Err(format!("{text}: unknown placeholder {{{name}}}, expected one of {}", listed()));
            }
            found.push(name);
            rest = next;
        }
        let has = |names: &[&str]| names.iter().any(|name| found.contains(name));
        for (what, names) in [
            ("level", &["z", "TileMatrix"][..]),
            ("column", &["x", "TileCol"]),
            ("row", &["y", "-y", "reverseY", "TileRow"]),
        ] {
            if !has(names) {
                let names: Vec<String> = names.iter().map(|name| format!("{{{name}}}")).collect();
                return Err(format!("{text}: no placeholder for the {what} ({})", names.join(" or ")));
            }
        }
        if has(&["s"]) && subdomains.is_empty() {
            return Err(format!("{text}: {{s}} without subdomains"));
        }
        Ok(Self { text: text.to_owned(), subdomains: subdomains.to_vec() })
    }

    /// Returns the address of a single image.
    pub fn one(address: &str) -> Self {
        Self { text: address.to_owned(), subdomains: Vec::new() }
    }

    /// Returns the URL of a tile.
    pub fn url(&self, grid: &TileGrid, tile: TileIndex) -> String {
        let level = grid.levels.get(tile.level);
        let rows = level.map_or(1, |level| level.rows);
        let mut url = String::with_capacity(self.text.len() + 16);
        let mut rest = &self.text[..];
        while let Some((before, (name, after))) = rest.split_once('{').and_then(|(b, a)| Some((b, a.split_once('}')?)))
        {
            url.push_str(before);
            match name {
                "z" | "TileMatrix" => url.push_str(level.map_or("0", |level| &level.name)),
                "x" | "TileCol" => url.push_str(&tile.column.to_string()),
                "y" | "TileRow" => url.push_str(&tile.row.to_string()),
                "-y" | "reverseY" => url.push_str(&rows.saturating_sub(1).saturating_sub(tile.row).to_string()),
                "s" => {
                    let turn = tile.column as usize + tile.row as usize + tile.level;
                    url.push_str(self.subdomains.get(turn % self.subdomains.len().max(1)).map_or("", String::as_str));
                }
                // `new` has refused others; the address of a single image may have braces.
                other => {
                    url.push('{');
                    url.push_str(other);
                    url.push('}');
                }
            }
            rest = after;
        }
        url + rest
    }
}

fn listed() -> String {
    NAMES.map(|name| format!("{{{name}}}")).join(" ")
}

#[cfg(test)]
mod tests {
    use super::super::grid::Tiling;
    use super::*;

    #[test]
    fn placeholders_are_replaced() {
        let grid = TileGrid::world(Tiling::WebMercator, 2..=9, 256);
        let tile = TileIndex { level: 3, column: 7, row: 4 };
        let subdomains = ["a".to_owned(), "b".to_owned()];
        let url = |text: &str| Template::new(text, &subdomains).unwrap().url(&grid, tile);
        assert_eq!(url("http://{s}.h/{z}/{x}/{y}.png?k=1"), "http://a.h/5/7/4.png?k=1");
        assert_eq!(url("http://h/{z}/{x}/{-y}.png"), "http://h/5/7/27.png");
        assert_eq!(url("http://h/{z}/{x}/{reverseY}"), "http://h/5/7/27");
        assert_eq!(url("http://h/{TileMatrix}/{TileRow}/{TileCol}.jpg"), "http://h/5/4/7.jpg");
        assert_eq!(Template::one("/a/{b}.png").url(&grid, tile), "/a/{b}.png");
    }

    #[test]
    fn templates_that_name_no_tile_are_refused() {
        for (text, part) in [
            ("http://h/{z}/{x}/{q}.png", "unknown placeholder {q}"),
            ("http://h/{z}/{x}.png", "for the row"),
            ("http://h/{x}/{y}.png", "for the level"),
            ("http://h/{z}/{y}.png", "for the column"),
            ("http://h/{z}/{x}/{y", "no closing brace"),
            ("http://{s}.h/{z}/{x}/{y}", "without subdomains"),
        ] {
            let error = Template::new(text, &[]).unwrap_err();
            assert!(error.contains(part), "{error}");
        }
    }
}
