//! Services that are described by documents: TMS and WMTS, from servers and from disk.

use std::fmt::Write as _;

use kit::server::{Reply, Server};
use terrane::fetch::Limits;
use terrane::formats::{OverlaySource, RasterOverlay, inspect, verify};

use crate::earth::{
    Look, Looking, Patch, color_of, error_for, expected, geographic, mercator, mercator_pixel_m, png, requests,
};

const PATCH: Patch = Patch([8.0, 47.0, 8.6, 47.4]);
const Z: u32 = 10;

fn tms() -> String {
    let levels: String = (0..=12u32).fold(String::new(), |mut text, z| {
        let units = 2.0 * 20_037_508.342_789_244 / f64::from(256u32 << z);
        writeln!(text, r#"<TileSet href="{z}" units-per-pixel="{units}" order="{z}"/>"#).unwrap();
        text
    });
    format!(
        r#"<?xml version="1.0"?><TileMap version="1.0.0"><SRS>EPSG:900913</SRS>
        <Origin x="-20037508.342789244" y="-20037508.342789244"/>
        <TileFormat width="256" height="256" mime-type="image/png" extension="png"/>
        <TileSets profile="mercator">{levels}</TileSets></TileMap>"#
    )
}

/// Rows of TMS count from the south.
fn of_tms([z, x, y]: [u32; 3]) -> [u32; 3] {
    [z, x, (1 << z) - 1 - y]
}

#[test]
fn tms_counts_rows_from_the_south() {
    let server = Server::start(|request| match request.path().strip_prefix("/map/") {
        Some("tilemapresource.xml") => Reply::ok(tms()),
        Some(tile) => match crate::earth::numbers(&format!("/{tile}")) {
            Some(tile) => Reply::ok(png(color_of(tile), 256)),
            None => Reply::new(404, ""),
        },
        None => Reply::new(404, ""),
    });
    let folder = tempfile::tempdir().unwrap();
    let set = PATCH.set(folder.path(), error_for(mercator_pixel_m(Z, 47.0)), Look::White);
    let source = OverlaySource::Tms { document: format!("{}/map/tilemapresource.xml", server.url) };
    let Some(looking) = Looking::at("overlay-tms", &set, vec![RasterOverlay::new(source)], &PATCH) else { return };
    looking.check(&PATCH, |place| expected(|at| of_tms(mercator(Z, at)), place, 0.006));
    assert_eq!(requests(&server)["/map/tilemapresource.xml"], 1);
}

#[test]
fn documents_are_described() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("tilemapresource.xml");
    let bounds = r#"<BoundingBox minx="0" miny="0" maxx="1000000" maxy="1000000"/><Origin"#;
    std::fs::write(&file, tms().replace("<Origin", bounds)).unwrap();
    let info = inspect(file.to_str().unwrap(), &Limits::default()).unwrap();
    assert_eq!(info.format, "raster overlay (Tile Map Service)");
    assert_eq!(info.details["tiling"], "EPSG:3857 (Web Mercator)");
    assert_eq!(info.details["images"], "256 x 256 pixels");
    assert_eq!(info.levels.len(), 13);
    // A tile of level 6 is 626 km wide.
    assert_eq!((info.levels[0].tiles, info.levels[6].tiles), (1, 4));
    let region = info.bounds.region.unwrap();
    assert!((region[2] - 1e6 / 6_378_137.0).abs() < 1e-9, "{region:?}");

    // Two levels are there, one image of them is missing and one is broken.
    let few = tms()
        .lines()
        .filter(|line| !line.contains("<TileSet href") || line.contains("order=\"0\"") || line.contains("order=\"1\""))
        .collect::<String>();
    std::fs::write(&file, few).unwrap();
    for path in ["0/0/0", "1/0/0", "1/0/1", "1/1/0"] {
        let image = folder.path().join(format!("{path}.png"));
        std::fs::create_dir_all(image.parent().unwrap()).unwrap();
        std::fs::write(image, if path == "1/1/0" { b"broken".to_vec() } else { png([1, 2, 3], 256) }).unwrap();
    }
    let verified = verify(file.to_str().unwrap(), &Limits::default(), &mut |_| {}).unwrap();
    assert_eq!((verified.contents, verified.failed), (4, 1), "{verified:?}");
    assert!(verified.errors[0].uri.ends_with("1/1/0.png"), "{verified:?}");
    assert_eq!(verified.ignored["overlay: image that is missing"], 1);

    std::fs::write(&file, tms().replace("EPSG:900913", "EPSG:2056")).unwrap();
    let error = inspect(file.to_str().unwrap(), &Limits::default()).unwrap_err().to_string();
    assert!(error.contains("EPSG:2056"), "{error}");
}

/// A set on a server is covered by files of this machine.
#[test]
fn tms_may_be_a_folder() {
    let (set_folder, map) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    std::fs::write(map.path().join("tilemapresource.xml"), tms()).unwrap();
    let [west, south, east, north] = PATCH.0;
    let [[_, x0, y0], [_, x1, y1]] = [[west, north], [east, south]].map(|corner| mercator(Z, corner));
    for (x, y) in (x0..=x1).flat_map(|x| (y0..=y1).map(move |y| (x, y))) {
        let tile = of_tms([Z, x, y]);
        let folder = map.path().join(format!("{}/{}", tile[0], tile[1]));
        std::fs::create_dir_all(&folder).unwrap();
        std::fs::write(folder.join(format!("{}.png", tile[2])), png(color_of(tile), 256)).unwrap();
    }
    PATCH.set(set_folder.path(), error_for(mercator_pixel_m(Z, 47.0)), Look::White);
    let files = set_folder.path().to_owned();
    let server = Server::start(move |request| match std::fs::read(files.join(&request.path()[1..])) {
        Ok(bytes) => Reply::ok(bytes),
        Err(_) => Reply::new(404, ""),
    });
    let source = OverlaySource::Tms { document: map.path().join("tilemapresource.xml").to_str().unwrap().to_owned() };
    let overlays = || vec![RasterOverlay::new(source.clone())];
    let set = format!("{}/tileset.json", server.url);
    let Some(looking) = Looking::at("", &set, overlays(), &PATCH) else { return };
    looking.check(&PATCH, |place| expected(|at| of_tms(mercator(Z, at)), place, 0.006));
    // Neither of the two needs a server.
    let set = set_folder.path().join("tileset.json");
    let Some(looking) = Looking::at("", set.to_str().unwrap(), overlays(), &PATCH) else { return };
    looking.check(&PATCH, |place| expected(|at| of_tms(mercator(Z, at)), place, 0.006));
}

#[test]
fn wmts_names_its_levels_and_its_tiles() {
    let matrices: String = (0..=12u32).fold(String::new(), |mut text, z| {
        let scale = 180.0 / f64::from(256u32 << z) * 6_378_137.0f64.to_radians() / 0.00028;
        let (columns, rows) = (2u32 << z, 1u32 << z);
        writeln!(
            text,
            "<TileMatrix><Identifier>level {z}</Identifier><ScaleDenominator>{scale}</ScaleDenominator>\
             <TopLeftCorner>90 -180</TopLeftCorner><TileWidth>256</TileWidth><TileHeight>256</TileHeight>\
             <MatrixWidth>{columns}</MatrixWidth><MatrixHeight>{rows}</MatrixHeight></TileMatrix>"
        )
        .unwrap();
        text
    });
    let server = Server::start(move |request| {
        if request.path() == "/capabilities.xml" {
            let host = format!("http://{}", request.header("host").unwrap());
            return Reply::ok(format!(
                r#"<Capabilities><ServiceProvider><ProviderName>The Office</ProviderName></ServiceProvider><Contents>
                <Layer><Identifier>other</Identifier></Layer>
                <Layer><Identifier>photo</Identifier><Style><Identifier>plain</Identifier></Style>
                <TileMatrixSetLink><TileMatrixSet>world</TileMatrixSet></TileMatrixSetLink>
                <ResourceURL format="image/png" resourceType="tile"
                  template="{host}/{{Style}}/{{TileMatrixSet}}/{{TileMatrix}}/{{TileRow}}/{{TileCol}}"/></Layer>
                <TileMatrixSet><Identifier>world</Identifier><SupportedCRS>urn:ogc:def:crs:EPSG::4326</SupportedCRS>
                {matrices}</TileMatrixSet></Contents></Capabilities>"#
            ));
        }
        let tile = request.path().strip_prefix("/plain/world/level%20").map(|rest| {
            let parts: Vec<u32> = rest.split('/').map(|part| part.parse().unwrap()).collect();
            [parts[0], parts[2], parts[1]]
        });
        tile.map_or(Reply::new(404, ""), |tile| Reply::ok(png(color_of(tile), 512)))
    });
    let folder = tempfile::tempdir().unwrap();
    let pixel_m = 180.0 / f64::from(256u32 << 9) * 6_378_137.0f64.to_radians();
    let set = PATCH.set(folder.path(), error_for(pixel_m), Look::White);
    let document = format!("{}/capabilities.xml", server.url);
    let source = OverlaySource::Wmts { document, layer: Some("photo".to_owned()), style: None, matrix_set: None };
    let Some(looking) = Looking::at("overlay-wmts", &set, vec![RasterOverlay::new(source)], &PATCH) else { return };
    looking.check(&PATCH, |place| expected(|at| geographic(9, at), place, 0.006));
    assert_eq!(looking.overlays.credits(), ["The Office".into()]);
}
