//! Fuzzed parsers of the documents of map services: TMS and WMTS. They are run like those of `tests/formats/fuzz_parsers.rs`, by
//! tests and by `tools/fuzz`.

use std::sync::Arc;

use glam::{DMat3, DVec3};
use kit::fuzz::Parser;
use terrane::fetch::Limits;
use terrane::formats::{OverlaySet, OverlaySource, RasterOverlay, ReadOptions, TileVolume, dependencies};
use terrane::math::OrientedBox;

const DOCUMENT: &str = "http://h/map/document.xml";

const TMS: &str = r#"<?xml version="1.0"?><TileMap version="1.0.0"><SRS>EPSG:900913</SRS>
    <BoundingBox minx="-20037508.34" miny="-20037508.34" maxx="20037508.34" maxy="20037508.34"/>
    <Origin x="-20037508.34" y="-20037508.34"/><Attribution><Title>A</Title></Attribution>
    <TileFormat width="256" height="256" mime-type="image/png" extension="png"/>
    <TileSets profile="mercator"><TileSet href="0" units-per-pixel="156543.03" order="0"/>
    <TileSet href="1" units-per-pixel="78271.52" order="1"/></TileSets></TileMap>"#;

const WMTS: &str = r#"<Capabilities xmlns:ows="o"><Contents><Layer><ows:Identifier>a</ows:Identifier>
    <Style isDefault="true"><ows:Identifier>s</ows:Identifier></Style><Format>image/png</Format>
    <TileMatrixSetLink><TileMatrixSet>m</TileMatrixSet><TileMatrixSetLimits><TileMatrixLimits><TileMatrix>0</TileMatrix>
    <MinTileRow>0</MinTileRow><MaxTileRow>0</MaxTileRow><MinTileCol>0</MinTileCol><MaxTileCol>1</MaxTileCol>
    </TileMatrixLimits></TileMatrixSetLimits></TileMatrixSetLink>
    <ResourceURL format="image/png" resourceType="tile" template="http://h/{TileMatrix}/{TileCol}/{TileRow}.png"/></Layer>
    <TileMatrixSet><ows:Identifier>m</ows:Identifier><ows:SupportedCRS>urn:ogc:def:crs:OGC:1.3:CRS84</ows:SupportedCRS>
    <TileMatrix><ows:Identifier>0</ows:Identifier><ScaleDenominator>279541132.01</ScaleDenominator>
    <TopLeftCorner>-180 90</TopLeftCorner><TileWidth>256</TileWidth><TileHeight>256</TileHeight>
    <MatrixWidth>2</MatrixWidth><MatrixHeight>1</MatrixHeight></TileMatrix></TileMatrixSet></Contents></Capabilities>"#;

/// Returns the number of images that a tile needs by a document.
fn images_by(source: OverlaySource, bytes: &[u8]) -> usize {
    let set = OverlaySet::new(vec![RasterOverlay::new(source)]).unwrap();
    let half_axes = DMat3::from_diagonal(DVec3::splat(10_000.0));
    let bounds = OrientedBox { center: DVec3::new(6_378_137.0, 0.0, 0.0), half_axes };
    let limits = Limits { max_file_bytes: 8 << 20, ..Limits::default() };
    let options = ReadOptions {
        overlays: Some(Arc::new(set)),
        tile: Some(TileVolume { bounds, geometric_error_m: 1000.0 }),
        ..ReadOptions::for_root("http://h/tileset.json", limits)
    };
    let known = [(DOCUMENT.into(), Ok(bytes.to_vec()))];
    dependencies("http://h/a.glb", b"glTF", None, &known, &options).len()
}

fn source_of_wmts() -> OverlaySource {
    OverlaySource::Wmts { document: DOCUMENT.to_owned(), layer: None, style: None, matrix_set: None }
}

fn source_of_tms() -> OverlaySource {
    OverlaySource::Tms { document: DOCUMENT.to_owned() }
}

fn tms() -> Parser {
    Parser::new("tms", [TMS], |bytes| assert!(images_by(source_of_tms(), bytes) < 1_000))
}

fn wmts() -> Parser {
    Parser::new("wmts", [WMTS, TMS], |bytes| assert!(images_by(source_of_wmts(), bytes) < 1_000))
}

/// Otherwise little of the parsers is reached.
#[test]
fn seeds_name_images() {
    assert!(images_by(source_of_tms(), TMS.as_bytes()) > 0);
    assert!(images_by(source_of_wmts(), WMTS.as_bytes()) > 0);
}

kit::parsers! {
    tms,
    wmts,
}
