//! The option `--overlay`: an address with sub-options, as a [`RasterOverlay`].

use std::str::FromStr;

use terrane::formats::{GeoRectangle, OverlaySet, OverlaySource, RasterOverlay, Tiling};

/// The help of `--overlay`.
pub const OVERLAY_HELP: &str = "Drape images over the terrain; again for further ones above. ADDRESS is a template with {z} {x} {y} \
    (or {-y}, {s}), a tilemapresource.xml (TMS), WMTS capabilities, one image, or ion:ASSET_ID. Sub-options follow after commas: opacity=0.5, \
    levels=2-18, tiling=mercator|geographic, tile=512 (pixels), subdomains=a/b/c, rectangle=WEST/SOUTH/EAST/NORTH (degrees; \
    needed for an image), credit=TEXT; of WMTS layer=, style=, matrix-set=";

/// The names of the sub-options.
const KEYS: [&str; 11] = [
    "opacity",
    "levels",
    "tiling",
    "tile",
    "subdomains",
    "rectangle",
    "credit",
    "layer",
    "style",
    "matrix-set",
    "kind",
];

/// The value of an `--overlay`.
#[derive(Clone, Debug, PartialEq)]
pub struct OverlayArg(pub RasterOverlay);

impl FromStr for OverlayArg {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (address, options) = split(text);
        let value = |key: &str| options.iter().rev().find(|(name, _)| *name == key).map(|(_, value)| *value);
        let own = |key: &str| value(key).map(str::to_owned);
        let rectangle = value("rectangle").map(rectangle).transpose()?;
        let source = match kind(address, value("kind"))? {
            Kind::Template => {
                let subdomains = value("subdomains").unwrap_or_default();
                let subdomains = subdomains.split('/').filter(|part| !part.is_empty()).map(str::to_owned).collect();
                OverlaySource::Template { url: address.to_owned(), subdomains }
            }
            Kind::Tms => OverlaySource::Tms { document: address.to_owned() },
            Kind::Wmts => OverlaySource::Wmts {
                document: address.to_owned(),
                layer: own("layer"),
                style: own("style"),
                matrix_set: own("matrix-set"),
            },
            Kind::Image => {
                let rectangle = rectangle.ok_or("an image needs rectangle=WEST/SOUTH/EAST/NORTH in degrees")?;
                OverlaySource::Image { address: address.to_owned(), rectangle }
            }
        };
        let is_image = matches!(source, OverlaySource::Image { .. });
        let mut overlay = RasterOverlay::new(source);
        overlay.rectangle = rectangle;
        overlay.credit = value("credit").map(Into::into);
        overlay.tiling = match value("tiling") {
            Some("geographic") => Tiling::Geographic,
            Some("mercator") => Tiling::WebMercator,
            None if is_image => Tiling::Geographic,
            None => Tiling::WebMercator,
            Some(other) => return Err(format!("tiling={other}, expected mercator or geographic")),
        };
        if let Some(opacity) = value("opacity") {
            overlay.opacity = opacity.parse().map_err(|_| format!("opacity={opacity} is not a number"))?;
        }
        if let Some(tile) = value("tile") {
            overlay.tile_px = tile.parse().map_err(|_| format!("tile={tile} is not a number of pixels"))?;
        }
        if let Some(levels) = value("levels") {
            let both = levels.split_once('-').and_then(|(min, max)| Some((min.parse().ok()?, max.parse().ok()?)));
            (overlay.min_level, overlay.max_level) = both.ok_or(format!("levels={levels}, expected MIN-MAX"))?;
        }
        // The library checks the rest.
        OverlaySet::new(vec![overlay.clone()]).map_err(|error| error.reason)?;
        Ok(Self(overlay))
    }
}

enum Kind {
    Template,
    Tms,
    Wmts,
    Image,
}

/// Returns what an address means, unless the sub-option `kind` says it.
fn kind(address: &str, said: Option<&str>) -> Result<Kind, String> {
    let lower = address.to_ascii_lowercase();
    let path = lower.split('?').next().unwrap_or_default();
    let is_image = [".png", ".jpg", ".jpeg", ".webp"].iter().any(|end| path.ends_with(end));
    match said {
        Some("template") => Ok(Kind::Template),
        Some("tms") => Ok(Kind::Tms),
        Some("wmts") => Ok(Kind::Wmts),
        Some("image") => Ok(Kind::Image),
        Some(other) => Err(format!("kind={other}, expected template, tms, wmts or image")),
        None if address.contains('{') => Ok(Kind::Template),
        // The service says where the document is.
        None if address.starts_with("ion:") => Ok(Kind::Tms),
        None if lower.contains("wmts") => Ok(Kind::Wmts),
        None if path.ends_with(".xml") => Ok(Kind::Tms),
        None if is_image => Ok(Kind::Image),
        None => Err("expected a template with {z} {x} {y}, a tilemapresource.xml, WMTS capabilities or an image; \
                     kind=template, tms, wmts or image says which"
            .to_owned()),
    }
}

/// Splits an address from its sub-options. A comma before another word belongs to the address, or to the option before it.
fn split(text: &str) -> (&str, Vec<(&str, &str)>) {
    let starts = text.match_indices(',').filter_map(|(at, _)| {
        let (key, _) = text[at + 1..].split_once('=')?;
        KEYS.contains(&key).then_some((at, key))
    });
    let starts: Vec<(usize, &str)> = starts.collect();
    let end_of = |i: usize| starts.get(i).map_or(text.len(), |(at, _)| *at);
    let options = starts.iter().enumerate().map(|(i, (at, key))| (*key, &text[at + key.len() + 2..end_of(i + 1)]));
    (&text[..end_of(0)], options.collect())
}

fn rectangle(text: &str) -> Result<GeoRectangle, String> {
    let edges: Option<Vec<f64>> = text.split('/').map(|edge| edge.parse().ok()).collect();
    let edges: Option<[f64; 4]> = edges.and_then(|edges| edges.try_into().ok());
    let rectangle = edges.and_then(GeoRectangle::from_degrees);
    rectangle.ok_or_else(|| format!("rectangle={text}, expected WEST/SOUTH/EAST/NORTH in degrees"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn overlay(text: &str) -> RasterOverlay {
        text.parse::<OverlayArg>().unwrap().0
    }

    #[test]
    fn sub_options_follow_the_address() {
        let read = overlay("http://{s}.h/{z}/{x}/{y}.png?a=1,2,opacity=0.5,levels=2-9,subdomains=a/b,credit=A, B");
        let (url, subdomains) = ("http://{s}.h/{z}/{x}/{y}.png?a=1,2".to_owned(), vec!["a".to_owned(), "b".to_owned()]);
        assert_eq!(read.source, OverlaySource::Template { url, subdomains });
        assert_eq!((read.opacity, read.min_level, read.max_level, read.credit.as_deref()), (0.5, 2, 9, Some("A, B")));
        let read = overlay("http://h/wmts?request=GetCapabilities,layer=photo,matrix-set=m");
        let [layer, matrix_set] = ["photo", "m"].map(|name| Some(name.to_owned()));
        let document = "http://h/wmts?request=GetCapabilities".to_owned();
        assert_eq!(read.source, OverlaySource::Wmts { document, layer, style: None, matrix_set });
        let read = overlay("map.png,rectangle=170/-50/-170/-30");
        assert_eq!((read.tiling, read.rectangle.unwrap().width().to_degrees().round()), (Tiling::Geographic, 20.0));
        assert!(matches!(overlay("http://h/a/tilemapresource.xml").source, OverlaySource::Tms { .. }));
    }

    #[test]
    fn invalid_overlays_are_named() {
        for (text, part) in [
            ("http://h/{z}/{x}/{q}.png", "unknown placeholder {q}"),
            ("http://h/{z}/{x}/{y}.png,opacity=2", "opacity 2"),
            ("http://h/{z}/{x}/{y}.png,levels=9", "expected MIN-MAX"),
            ("http://h/{z}/{x}/{y}.png,tiling=flat", "mercator or geographic"),
            ("map.png", "needs rectangle"),
            ("map.png,rectangle=1/2/3", "WEST/SOUTH/EAST/NORTH"),
            ("http://h/", "expected a template"),
            ("http://h/,kind=x", "kind=x"),
        ] {
            let error = text.parse::<OverlayArg>().unwrap_err();
            assert!(error.contains(part), "{error}");
        }
    }
}
