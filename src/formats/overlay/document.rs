//! [`ServerTiles`]: what a document of a map server says about its tiles: TMS's tilemapresource.xml and WMTS's capabilities.
//! Any thread.

use std::sync::Arc;

use super::grid::{GeoRectangle, GridLevel, TileGrid, Tiling};
use super::template::Template;
use super::xml::{Element, finite, numbers};
use crate::fetch::markup::text_and_first_byte;

/// Metres of a pixel at scale 1 (OGC 07-057r7, 6.1).
const PIXEL_M: f64 = 0.00028;
/// Metres of a degree at the equator, as WMTS counts them.
const METRES_PER_DEGREE: f64 = 6_378_137.0 * std::f64::consts::PI / 180.0;
/// The maximum number of columns or rows of a level.
const MAX_SIDE: f64 = (1u32 << 31) as f64;

/// The tiles of a server.
#[derive(Clone, Debug, PartialEq)]
pub(in crate::formats) struct ServerTiles {
    pub(super) grid: TileGrid,
    /// The reference to a tile, relative to the document.
    pub(super) template: Template,
    /// The text that the service asks to show.
    pub credit: Option<Arc<str>>,
}

/// The description of an overlay in a document.
pub(in crate::formats) struct DocumentInfo {
    /// The name of the format.
    pub format: &'static str,
    /// True for the capabilities of a WMTS.
    pub is_wmts: bool,
    /// The tiles, of the first layer with its usual choices.
    pub tiles: ServerTiles,
    /// The layers that there are to choose from.
    pub layers: Vec<String>,
}

/// Describes the document of a map server; `None` for other bytes.
pub(in crate::formats) fn describe(bytes: &[u8]) -> Option<Result<DocumentInfo, String>> {
    let start = &bytes[..bytes.len().min(4096)];
    let has = |name: &str| start.windows(name.len()).any(|window| window == name.as_bytes());
    if text_and_first_byte(bytes).1 != Some(b'<') || !(has("<TileMap") || has("Capabilities")) {
        return None;
    }
    let root = match Element::parse(bytes) {
        Ok(root) => root,
        Err(reason) => return Some(Err(reason)),
    };
    let layers = root.child("Contents").into_iter().flat_map(|contents| contents.all("Layer"));
    let layers = layers.filter_map(identifier).map(str::to_owned).collect();
    let is_wmts = root.name == "Capabilities";
    let info = |format| move |tiles| DocumentInfo { format, is_wmts, tiles, layers };
    match root.name.as_str() {
        "TileMap" => Some(read_tms(bytes).map(info("raster overlay (Tile Map Service)"))),
        "Capabilities" => Some(read_wmts(bytes, WmtsChoice::default()).map(info("raster overlay (WMTS)"))),
        _ => None,
    }
}

impl ServerTiles {
    /// Returns the number of tiles of each level, the coarsest first: those in the rectangle if one is known.
    pub fn level_counts(&self) -> Vec<u64> {
        let count = |level: usize| match &self.grid.rectangle {
            Some(rectangle) => self.grid.cover(level, rectangle).map_or(0, |cover| cover.tiles()),
            None => u64::from(self.grid.levels[level].columns) * u64::from(self.grid.levels[level].rows),
        };
        (0..self.grid.levels.len()).map(count).collect()
    }

    /// Returns west, south, east and north of the rectangle with images, radians.
    pub fn region(&self) -> Option<[f64; 4]> {
        self.grid.rectangle.map(|GeoRectangle { west, south, east, north }| [west, south, east, north])
    }

    /// Returns the name of the projection.
    pub fn projection(&self) -> &'static str {
        match self.grid.tiling {
            Tiling::WebMercator => "EPSG:3857 (Web Mercator)",
            Tiling::Geographic => "EPSG:4326 (geographic)",
        }
    }

    /// Returns width and height of a tile of the finest level, pixels.
    pub fn finest_tile_px(&self) -> Option<[u32; 2]> {
        self.grid.levels.last()?.tile_px
    }
}

/// The parts of a WMTS that an application chooses.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct WmtsChoice<'a> {
    pub layer: Option<&'a str>,
    pub style: Option<&'a str>,
    pub matrix_set: Option<&'a str>,
}

/// Returns the tiling of a coordinate reference system, by its name.
fn tiling_of(crs: &str) -> Result<Tiling, String> {
    let code = crs.rsplit([':', '/']).next().unwrap_or_default();
    match code {
        "3857" | "900913" | "3785" | "102100" | "102113" | "41001" => Ok(Tiling::WebMercator),
        "4326" | "CRS84" | "84" => Ok(Tiling::Geographic),
        _ => {
            Err(format!("projection {crs} is not supported, only Web Mercator (EPSG:3857) and geographic (EPSG:4326)"))
        }
    }
}

/// Returns a count of tiles.
fn count(number: f64) -> Option<u32> {
    (1.0..=MAX_SIDE).contains(&number).then_some(number as u32)
}

/// Returns a side of a tile in pixels.
fn side_px(number: Option<f64>) -> Result<u32, String> {
    let side = number.filter(|side| (1.0..=8192.0).contains(side)).map(|side| side as u32);
    side.ok_or_else(|| "a tile's width or height is missing, or not from 1 to 8192 pixels".to_owned())
}

/// Reads a tilemapresource.xml (Tile Map Service 1.0.0). Rows count from the south there.
///
/// # Errors
/// The reason if it is not well-formed, incomplete or in another projection.
pub(super) fn read_tms(bytes: &[u8]) -> Result<ServerTiles, String> {
    let root = Element::parse(bytes)?;
    if root.name != "TileMap" {
        return Err(format!("a TMS document begins with TileMap, not with {}", root.name));
    }
    let sets = root.child("TileSets").ok_or("TileMap has no TileSets")?;
    let profile = sets.attribute("profile").unwrap_or_default();
    let tiling = match root.text_of("SRS").filter(|srs| !srs.is_empty()) {
        Some(srs) => tiling_of(srs)?,
        None if profile.ends_with("mercator") => Tiling::WebMercator,
        None if profile.ends_with("geodetic") => Tiling::Geographic,
        None => return Err("TileMap has no SRS".to_owned()),
    };
    let format = root.child("TileFormat").ok_or("TileMap has no TileFormat")?;
    let tile_px = [side_px(format.number("width"))?, side_px(format.number("height"))?];
    let extension = format.attribute("extension").unwrap_or("png");
    let [west, north] = tiling.world_corner();
    let origin = root.child("Origin").and_then(|origin| Some([origin.number("x")?, origin.number("y")?]));
    // Old versions of gdal2tiles write latitude first.
    let origin = match origin {
        Some([x, y]) if tiling == Tiling::Geographic && y < -90.0 && x >= -90.0 => [y, x],
        Some(origin) => origin,
        None => [west, -north],
    };
    let bounds = root.child("BoundingBox").and_then(|bounds| {
        Some([bounds.number("minx")?, bounds.number("miny")?, bounds.number("maxx")?, bounds.number("maxy")?])
    });
    let rectangle = bounds.and_then(|bounds| rectangle_of_tms(tiling, bounds));
    let mut levels: Vec<(f64, GridLevel)> = Vec::new();
    for set in sets.all("TileSet") {
        let per_px = set.number("units-per-pixel").filter(|units| *units > 0.0);
        let per_px = per_px.ok_or("TileSet has no units-per-pixel above 0")?;
        let href = set.attribute("href").or(set.attribute("order")).ok_or("TileSet has neither href nor order")?;
        let tile = tile_px.map(|px| f64::from(px) * per_px);
        let span = |from: f64, to: f64, side: f64| count(((to - from) / side - 1e-6).ceil().max(1.0));
        let (columns, rows) = (span(origin[0], -west, tile[0]), span(origin[1], north, tile[1]));
        let (columns, rows) = columns.zip(rows).ok_or_else(|| format!("TileSet {href} has too many tiles"))?;
        let corner = [origin[0], origin[1] + f64::from(rows) * tile[1]];
        let name = Arc::from(href.trim_end_matches('/'));
        levels.push((per_px, GridLevel { name, corner, tile, tile_px: Some(tile_px), columns, rows }));
    }
    let template = Template::new(&format!("{{z}}/{{x}}/{{-y}}.{extension}"), &[])?;
    let credit = root.at(&["Attribution", "Title"]).map(Element::text).filter(|text| !text.is_empty());
    let grid = TileGrid { tiling, levels: coarse_first(levels)?, rectangle };
    Ok(ServerTiles { grid, template, credit: credit.map(Arc::from) })
}

/// Returns the rectangle of a BoundingBox, smallest x and y, largest x and y; `None` if its meaning is not clear.
fn rectangle_of_tms(tiling: Tiling, [min_x, min_y, max_x, max_y]: [f64; 4]) -> Option<GeoRectangle> {
    match tiling {
        // Latitude first, as in the origin.
        Tiling::Geographic if min_y < -90.0 || max_y > 90.0 => GeoRectangle::from_degrees([min_y, min_x, max_y, max_x]),
        Tiling::Geographic => GeoRectangle::from_degrees([min_x, min_y, max_x, max_y]),
        // Some writers give degrees in an order that depends on their version.
        Tiling::WebMercator if [min_x, min_y, max_x, max_y].iter().all(|edge| edge.abs() <= 180.0) => None,
        Tiling::WebMercator => GeoRectangle::from_degrees(
            [longitude_of(min_x), latitude_of(min_y), longitude_of(max_x), latitude_of(max_y)].map(f64::to_degrees),
        ),
    }
}

fn longitude_of(x: f64) -> f64 {
    x / 6_378_137.0
}

fn latitude_of(y: f64) -> f64 {
    2.0 * (y / 6_378_137.0).exp().atan() - std::f64::consts::FRAC_PI_2
}

/// Returns levels with the largest pixels first.
fn coarse_first(mut levels: Vec<(f64, GridLevel)>) -> Result<Vec<GridLevel>, String> {
    if levels.is_empty() {
        return Err("the document has no levels".to_owned());
    }
    levels.sort_by(|a, b| b.0.total_cmp(&a.0));
    Ok(levels.into_iter().map(|(_, level)| level).collect())
}

/// Reads the capabilities of a Web Map Tile Service 1.0.0.
///
/// # Errors
/// The reason if it is not well-formed, incomplete, in another projection, or has not what the application chose.
pub(super) fn read_wmts(bytes: &[u8], choice: WmtsChoice<'_>) -> Result<ServerTiles, String> {
    let root = Element::parse(bytes)?;
    if root.name != "Capabilities" {
        return Err(format!("a WMTS document begins with Capabilities, not with {}", root.name));
    }
    let contents = root.child("Contents").ok_or("Capabilities has no Contents")?;
    let layer = named(contents, "Layer", choice.layer)?;
    let layer_name = identifier(layer).unwrap_or_default();
    let style = match choice.style {
        Some(style) => style,
        None => {
            let default = layer.all("Style").find(|style| style.attribute("isDefault") == Some("true"));
            default.or(layer.child("Style")).and_then(identifier).unwrap_or("default")
        }
    };
    let links: Vec<&Element> = layer.all("TileMatrixSetLink").collect();
    let linked = |name: &str| links.iter().find(|link| link.text_of("TileMatrixSet") == Some(name)).copied();
    let sets: Vec<&Element> = contents.all("TileMatrixSet").collect();
    let (set, tiling) = match choice.matrix_set {
        Some(name) => {
            let set = sets.iter().find(|set| identifier(set) == Some(name) && linked(name).is_some());
            let set = set.ok_or_else(|| format!("layer {layer_name} has no TileMatrixSet {name}"))?;
            (*set, tiling_of(set.text_of("SupportedCRS").unwrap_or_default())?)
        }
        None => {
            // The first that can be drawn.
            let of_layer = sets.iter().filter(|set| identifier(set).is_some_and(|name| linked(name).is_some()));
            let known = of_layer.map(|set| Ok((*set, tiling_of(set.text_of("SupportedCRS").unwrap_or_default())?)));
            let mut error = format!("layer {layer_name} has no TileMatrixSet");
            let mut found = None;
            for known in known {
                match known {
                    Ok(known) => {
                        found = Some(known);
                        break;
                    }
                    Err(reason) => error = reason,
                }
            }
            found.ok_or(error)?
        }
    };
    let set_name = identifier(set).unwrap_or_default();
    let limits = linked(set_name).and_then(|link| link.child("TileMatrixSetLimits"));
    let has_level = |name: &str| {
        limits.is_none_or(|limits| limits.all("TileMatrixLimits").any(|of| of.text_of("TileMatrix") == Some(name)))
    };
    let crs = set.text_of("SupportedCRS").unwrap_or_default();
    let mut levels = Vec::new();
    for matrix in set.all("TileMatrix") {
        let name = identifier(matrix).ok_or("a TileMatrix has no Identifier")?;
        if has_level(name) {
            levels.push(matrix_level(matrix, name, tiling, crs)?);
        }
    }
    let grid = TileGrid { tiling, levels: coarse_first(levels)?, rectangle: bounds_of_layer(layer) };
    let template = wmts_template(&root, layer, layer_name, style, set_name)?;
    let provider = root.at(&["ServiceProvider", "ProviderName"]).map(Element::text).filter(|name| !name.is_empty());
    Ok(ServerTiles { grid, template, credit: provider.map(Arc::from) })
}

fn identifier(element: &Element) -> Option<&str> {
    element.text_of("Identifier").filter(|name| !name.is_empty())
}

/// Returns the child of a kind that an application chose, or the first.
fn named<'a>(parent: &'a Element, kind: &'a str, chosen: Option<&str>) -> Result<&'a Element, String> {
    let mut all = parent.all(kind);
    match chosen {
        None => all.next().ok_or_else(|| format!("{} has no {kind}", parent.name)),
        Some(name) => all.find(|element| identifier(element) == Some(name)).ok_or_else(|| {
            let names: Vec<&str> = parent.all(kind).filter_map(identifier).take(20).collect();
            format!("{kind} {name} does not exist; there are {}", names.join(", "))
        }),
    }
}

/// Returns a level with the size of its pixels.
fn matrix_level(matrix: &Element, name: &str, tiling: Tiling, crs: &str) -> Result<(f64, GridLevel), String> {
    let number = |of: &str| matrix.text_of(of).and_then(finite);
    let missing = |of: &str| format!("TileMatrix {name}: {of} is missing or invalid");
    let scale = number("ScaleDenominator").filter(|scale| *scale > 0.0).ok_or_else(|| missing("ScaleDenominator"))?;
    let metres = if tiling == Tiling::WebMercator { 1.0 } else { METRES_PER_DEGREE };
    let per_px = scale * PIXEL_M / metres;
    let corner = matrix.text_of("TopLeftCorner").and_then(numbers::<2>).ok_or_else(|| missing("TopLeftCorner"))?;
    // EPSG:4326 has latitude first, CRS84 longitude. Some servers mix them up, which -180 gives away.
    let is_latitude_first = tiling == Tiling::Geographic && !crs.contains("84") && corner[0] >= -90.0;
    let corner = if is_latitude_first { [corner[1], corner[0]] } else { corner };
    let tile_px = [side_px(number("TileWidth"))?, side_px(number("TileHeight"))?];
    let columns = number("MatrixWidth").and_then(count).ok_or_else(|| missing("MatrixWidth"))?;
    let rows = number("MatrixHeight").and_then(count).ok_or_else(|| missing("MatrixHeight"))?;
    let mut tile = tile_px.map(|px| f64::from(px) * per_px);
    // The scales of many servers have few digits; their tiles go around the earth all the same.
    let world = tiling.world_width();
    if (f64::from(columns) * tile[0] / world - 1.0).abs() < 1e-3 {
        tile = tile.map(|side| side * world / (f64::from(columns) * tile[0]));
    }
    Ok((per_px, GridLevel { name: name.into(), corner, tile, tile_px: Some(tile_px), columns, rows }))
}

fn bounds_of_layer(layer: &Element) -> Option<GeoRectangle> {
    let bounds = layer.child("WGS84BoundingBox")?;
    let [west, south] = numbers(bounds.text_of("LowerCorner")?)?;
    let [east, north] = numbers(bounds.text_of("UpperCorner")?)?;
    GeoRectangle::from_degrees([west, south.max(-90.0), east, north.min(90.0)])
}

/// Returns the URL of tiles: that of the layer's resources, or a query of the service.
fn wmts_template(
    root: &Element,
    layer: &Element,
    layer_name: &str,
    style: &str,
    set_name: &str,
) -> Result<Template, String> {
    let is_read = |format: &str| ["png", "jpeg", "jpg", "webp"].iter().any(|known| format.contains(known));
    let resources = layer.all("ResourceURL").filter(|of| of.attribute("resourceType") == Some("tile"));
    let mut readable = resources.filter(|of| of.attribute("format").is_none_or(is_read));
    if let Some(text) = readable.find_map(|of| of.attribute("template")) {
        let mut text = text.to_owned();
        let mut replace = |name: &str, by: &str| {
            for name in [name.to_owned(), name.to_lowercase()] {
                text = text.replace(&format!("{{{name}}}"), by);
            }
        };
        replace("TileMatrixSet", set_name);
        replace("Style", style);
        replace("Layer", layer_name);
        for dimension in layer.all("Dimension") {
            if let (Some(name), Some(default)) = (identifier(dimension), dimension.text_of("Default")) {
                replace(name, default);
            }
        }
        return Template::new(&text, &[]);
    }
    let operations: Vec<_> =
        root.child("OperationsMetadata").map(|of| of.all("Operation").collect()).unwrap_or_default();
    let get_tile = operations.iter().find(|of| of.attribute("name") == Some("GetTile"));
    let address = get_tile.and_then(|of| of.at(&["DCP", "HTTP", "Get"])?.attribute("href"));
    let address =
        address.ok_or_else(|| format!("layer {layer_name} has neither a ResourceURL nor a GetTile address"))?;
    let format = layer.all("Format").map(Element::text).find(|format| is_read(format)).unwrap_or("image/png");
    let separator = match address {
        _ if address.ends_with(['?', '&']) => "",
        _ if address.contains('?') => "&",
        _ => "?",
    };
    let escape = |text: &str| -> String { url::form_urlencoded::byte_serialize(text.as_bytes()).collect() };
    let (layer, style, set, format) = (escape(layer_name), escape(style), escape(set_name), escape(format));
    Template::new(
        &format!(
            "{address}{separator}SERVICE=WMTS&REQUEST=GetTile&VERSION=1.0.0&LAYER={layer}&STYLE={style}&FORMAT={format}&\
             TILEMATRIXSET={set}&TILEMATRIX={{TileMatrix}}&TILEROW={{TileRow}}&TILECOL={{TileCol}}"
        ),
        &[],
    )
}

#[cfg(test)]
mod tests {
    use super::super::grid::TileIndex;
    use super::*;

    /// A document as gdal2tiles writes it.
    const TMS: &str = r#"<?xml version="1.0" encoding="utf-8"?>
    <TileMap version="1.0.0" tilemapservice="http://tms.osgeo.org/1.0.0">
      <Title>a.tif</Title><Abstract></Abstract><SRS>EPSG:3857</SRS>
      <BoundingBox minx="0.0" miny="0.0" maxx="2000000.0" maxy="3000000.0"/>
      <Origin x="-20037508.342789244" y="-20037508.342789244"/>
      <TileFormat width="256" height="256" mime-type="image/png" extension="png"/>
      <TileSets profile="mercator">
        <TileSet href="1" units-per-pixel="78271.516964020480767" order="1"/>
        <TileSet href="0" units-per-pixel="156543.03392804096153" order="0"/>
        <TileSet href="2" units-per-pixel="39135.758482010240383" order="2"/>
      </TileSets>
    </TileMap>"#;

    #[test]
    fn rows_of_tms_count_from_the_south() {
        let tiles = read_tms(TMS.as_bytes()).unwrap();
        let usual = TileGrid::world(Tiling::WebMercator, 0..=2, 256);
        for (read, usual) in tiles.grid.levels.iter().zip(&usual.levels) {
            assert_eq!((read.columns, read.rows, &read.name), (usual.columns, usual.rows, &usual.name));
            assert!((read.corner[0] - usual.corner[0]).abs() < 1.0 && (read.corner[1] - usual.corner[1]).abs() < 1.0);
        }
        let url = tiles.template.url(&tiles.grid, TileIndex { level: 2, column: 3, row: 0 });
        assert_eq!(url, "2/3/3.png");
        let rectangle = tiles.grid.rectangle.unwrap();
        assert!((rectangle.east.to_degrees() - 17.966).abs() < 1e-3, "{rectangle:?}");
        assert!((rectangle.north.to_degrees() - 26.01).abs() < 1e-2, "{rectangle:?}");
    }

    #[test]
    fn geodetic_tms_of_old_writers_is_understood() {
        let text = TMS
            .replace("EPSG:3857", "EPSG:4326")
            .replace(r#"<Origin x="-20037508.342789244" y="-20037508.342789244"/>"#, r#"<Origin x="-90" y="-180"/>"#)
            .replace("156543.03392804096153", "0.703125")
            .replace("78271.516964020480767", "0.3515625")
            .replace("39135.758482010240383", "0.17578125")
            .replace(
                r#"minx="0.0" miny="0.0" maxx="2000000.0" maxy="3000000.0""#,
                r#"minx="-10" miny="-170" maxx="20" maxy="100""#,
            );
        let tiles = read_tms(text.as_bytes()).unwrap();
        let usual = TileGrid::world(Tiling::Geographic, 0..=2, 256);
        assert_eq!(tiles.grid.levels, usual.levels);
        assert_eq!(tiles.grid.rectangle, GeoRectangle::from_degrees([-170.0, -10.0, 100.0, 20.0]));
    }

    #[test]
    fn broken_tms_is_refused_with_a_reason() {
        for (from, to, part) in [
            ("EPSG:3857", "EPSG:2056", "EPSG:2056 is not supported"),
            ("units-per-pixel", "units", "units-per-pixel"),
            (r#"width="256""#, r#"width="0""#, "1 to 8192"),
            ("TileSets", "Sets", "no TileSets"),
            ("TileMap", "Html", "not with Html"),
            (r#""156543.03392804096153""#, r#""1e-9""#, "too many tiles"),
            ("</TileMap>", "", "not closed"),
        ] {
            let error = read_tms(TMS.replace(from, to).as_bytes()).unwrap_err();
            assert!(error.contains(part), "{error}");
        }
    }

    fn wmts() -> String {
        let matrix = |name: &str, scale: f64, corner: &str, columns: u32, rows: u32| {
            format!(
                "<TileMatrix><ows:Identifier>{name}</ows:Identifier><ScaleDenominator>{scale}</ScaleDenominator>\
                 <TopLeftCorner>{corner}</TopLeftCorner><TileWidth>256</TileWidth><TileHeight>256</TileHeight>\
                 <MatrixWidth>{columns}</MatrixWidth><MatrixHeight>{rows}</MatrixHeight></TileMatrix>"
            )
        };
        let mercator: String = (0..4)
            .map(|level| {
                let scale = 559_082_264.028_717_8 / f64::from(1 << level);
                matrix(&format!("m{level}"), scale, "-20037508.3427892 20037508.3427892", 1 << level, 1 << level)
            })
            .collect();
        let geographic: String = (0..4)
            .map(|level| {
                let scale = 279_541_132.014_358_76 / f64::from(1 << level);
                matrix(&format!("{level}"), scale, "90.0 -180.0", 2 << level, 1 << level)
            })
            .collect();
        format!(
            r#"<Capabilities xmlns="http://www.opengis.net/wmts/1.0" xmlns:ows="http://www.opengis.net/ows/1.1"
              xmlns:xlink="http://www.w3.org/1999/xlink" version="1.0.0">
            <ows:ServiceProvider><ows:ProviderName>Office of Maps</ows:ProviderName></ows:ServiceProvider>
            <ows:OperationsMetadata><ows:Operation name="GetTile"><ows:DCP><ows:HTTP>
              <ows:Get xlink:href="http://h/wmts?key=1"/></ows:HTTP></ows:DCP></ows:Operation></ows:OperationsMetadata>
            <Contents>
            <Layer><ows:Identifier>photo</ows:Identifier>
              <ows:WGS84BoundingBox><ows:LowerCorner>5 45</ows:LowerCorner><ows:UpperCorner>11 48</ows:UpperCorner>
              </ows:WGS84BoundingBox>
              <Style><ows:Identifier>grey</ows:Identifier></Style>
              <Style isDefault="true"><ows:Identifier>colour</ows:Identifier></Style>
              <Format>image/svg+xml</Format><Format>image/jpeg</Format>
              <Dimension><ows:Identifier>Time</ows:Identifier><Default>2026</Default></Dimension>
              <TileMatrixSetLink><TileMatrixSet>Local</TileMatrixSet></TileMatrixSetLink>
              <TileMatrixSetLink><TileMatrixSet>Mercator</TileMatrixSet></TileMatrixSetLink>
              <ResourceURL format="image/jpeg" resourceType="tile"
                template="http://h/photo/{{Style}}/{{Time}}/{{TileMatrixSet}}/{{TileMatrix}}/{{TileRow}}/{{TileCol}}.jpg"/></Layer>
            <Layer><ows:Identifier>plan &amp; more</ows:Identifier><Style><ows:Identifier>s</ows:Identifier></Style>
              <Format>image/png</Format>
              <TileMatrixSetLink><TileMatrixSet>World</TileMatrixSet><TileMatrixSetLimits>
                <TileMatrixLimits><TileMatrix>1</TileMatrix></TileMatrixLimits>
                <TileMatrixLimits><TileMatrix>2</TileMatrix></TileMatrixLimits></TileMatrixSetLimits></TileMatrixSetLink></Layer>
            <TileMatrixSet><ows:Identifier>Local</ows:Identifier>
              <ows:SupportedCRS>urn:ogc:def:crs:EPSG::2056</ows:SupportedCRS></TileMatrixSet>
            <TileMatrixSet><ows:Identifier>Mercator</ows:Identifier>
              <ows:SupportedCRS>urn:ogc:def:crs:EPSG:6.18:3:3857</ows:SupportedCRS>{mercator}</TileMatrixSet>
            <TileMatrixSet><ows:Identifier>World</ows:Identifier>
              <ows:SupportedCRS>urn:ogc:def:crs:EPSG::4326</ows:SupportedCRS>{geographic}</TileMatrixSet>
            </Contents></Capabilities>"#
        )
    }

    #[test]
    fn first_layer_of_wmts_has_the_usual_tiles() {
        let tiles = read_wmts(wmts().as_bytes(), WmtsChoice::default()).unwrap();
        let usual = TileGrid::world(Tiling::WebMercator, 0..=3, 256);
        for (read, usual) in tiles.grid.levels.iter().zip(&usual.levels) {
            assert_eq!((read.columns, read.rows), (usual.columns, usual.rows));
            assert!((read.tile[0] / usual.tile[0] - 1.0).abs() < 1e-9, "{read:?}");
            assert!((read.corner[1] - usual.corner[1]).abs() < 1.0, "{read:?}");
        }
        let url = tiles.template.url(&tiles.grid, TileIndex { level: 3, column: 5, row: 2 });
        assert_eq!(url, "http://h/photo/colour/2026/Mercator/m3/2/5.jpg");
        assert_eq!(tiles.grid.rectangle, GeoRectangle::from_degrees([5.0, 45.0, 11.0, 48.0]));
        assert_eq!(tiles.credit.as_deref(), Some("Office of Maps"));
    }

    #[test]
    fn layer_without_resources_is_asked_for_by_a_query() {
        let choice = WmtsChoice { layer: Some("plan & more"), ..WmtsChoice::default() };
        let tiles = read_wmts(wmts().as_bytes(), choice).unwrap();
        let names: Vec<&str> = tiles.grid.levels.iter().map(|level| &*level.name).collect();
        assert_eq!(names, ["1", "2"], "only what the limits name");
        let usual = TileGrid::world(Tiling::Geographic, 1..=2, 256);
        assert!((tiles.grid.levels[0].corner[0] + 180.0).abs() < 1e-9, "latitude is first");
        assert!((tiles.grid.levels[0].tile[1] / usual.levels[0].tile[1] - 1.0).abs() < 1e-9);
        assert_eq!(
            tiles.template.url(&tiles.grid, TileIndex { level: 1, column: 3, row: 1 }),
            "http://h/wmts?key=1&SERVICE=WMTS&REQUEST=GetTile&VERSION=1.0.0&LAYER=plan+%26+more&STYLE=s&\
             FORMAT=image%2Fpng&TILEMATRIXSET=World&TILEMATRIX=2&TILEROW=1&TILECOL=3"
        );
    }

    #[test]
    fn what_a_wmts_has_not_is_named() {
        let text = wmts();
        let error = |choice| read_wmts(text.as_bytes(), choice).unwrap_err();
        let layer = error(WmtsChoice { layer: Some("x"), ..WmtsChoice::default() });
        assert_eq!(layer, "Layer x does not exist; there are photo, plan & more");
        let set = error(WmtsChoice { matrix_set: Some("World"), ..WmtsChoice::default() });
        assert_eq!(set, "layer photo has no TileMatrixSet World");
        let local = error(WmtsChoice { matrix_set: Some("Local"), ..WmtsChoice::default() });
        assert!(local.contains("2056 is not supported"), "{local}");
        let broken = text.replace("ScaleDenominator", "Scale");
        let broken = read_wmts(broken.as_bytes(), WmtsChoice::default()).unwrap_err();
        assert!(broken.contains("m0: ScaleDenominator is missing"), "{broken}");
    }
}
