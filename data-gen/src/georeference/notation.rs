//! Reads reference systems in any notation.

use super::crs::Crs;
use super::projection::Projection;
use super::wkt;

impl Crs {
    /// Reads a code (`2056`, `EPSG:2056`), a definition in PROJ's notation (`+proj=...`) or WKT. The error is the reason.
    pub fn parse(text: &str) -> Result<Self, String> {
        let text = text.trim();
        if text.contains('[') {
            return wkt::crs(text);
        }
        if let Some(code) = text.strip_prefix("+init=epsg:") {
            return Self::parse(code.split_whitespace().next().unwrap_or_default());
        }
        if text.starts_with('+') {
            return Projection::new(text).map(Self::of);
        }
        let code = text.strip_prefix("EPSG:").or_else(|| text.strip_prefix("epsg:")).unwrap_or(text);
        let code =
            code.parse().map_err(|_| format!("`{text}` is neither an EPSG code nor a definition like +proj=..."))?;
        Self::from_epsg(code)
            .ok_or_else(|| format!("EPSG:{code} is not supported; give it in PROJ's notation, +proj=..."))
    }
}
