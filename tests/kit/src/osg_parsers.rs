//! The parsers of OpenSceneGraph's files and folders, for the fuzz tests.

use terrane::fetch::{DECODER_PANICKED, Limits};
use terrane::formats::{Content, Fetched, ReadOptions, decode, dependencies};

use crate::fuzz::Parser;
use crate::osg_files::{Osgb, VERSION, geode, group, osgt, triangle};

fn options() -> ReadOptions {
    let limits = Limits { max_image_side_px: 256, max_file_bytes: 8 << 20, ..Limits::default() };
    ReadOptions { build_kd_trees: true, ..ReadOptions::for_root("/set/tileset.json", limits) }
}

/// Decodes a content, which must succeed or name the reason.
fn parse(bytes: &[u8], companions: Vec<Fetched>) {
    let content = Content { uri: "/set/tile".into(), bytes: bytes.to_vec(), reader_data: None, companions };
    match decode(content, &options()) {
        Ok(page) => assert!(page.size_bytes() < 1 << 30),
        Err(error) => {
            assert!(!error.uri().is_empty() && !error.reason().is_empty(), "{error:?}");
            assert_ne!(error.reason(), DECODER_PANICKED);
        }
    }
}

/// Returns the parser of OpenSceneGraph's files, with files of all ages in both encodings.
pub fn osg() -> Parser {
    let binary = |mut file: Osgb| {
        file.triangle_geode(1);
        file.bytes
    };
    let text = group(
        1,
        &[
            geode(2, "StateSet TRUE { osg::StateSet { UniqueID 3 ModeList 1 { GL_BLEND ON } } }", &[triangle(10, "")]),
            "osg::PagedLOD { UniqueID 20 CenterMode USER_DEFINED_CENTER UserCenter 0 0 0 9 RangeList 2 { 0 50 50 1e30 }
            RangeDataList 2 { \"\" \"../a.osgb\" } PriorityList 2 { 0 1 0 1 } Children 1 { osg::Group { UniqueID 2 } } }"
                .to_owned(),
            "osg::Geode { UniqueID 30 Drawables 1 { osg::ShapeDrawable { UniqueID 31 Shape TRUE {
            osg::Capsule { UniqueID 32 Radius 1 Height 2 } } Color 1 0 0 1 } } }"
                .to_owned(),
        ],
    );
    let seeds = [
        binary(Osgb::new(VERSION, true)),
        binary(Osgb::new(VERSION, false)),
        binary(Osgb::new(80, false)),
        binary(Osgb::new(100, true)),
        osgt(VERSION, &text).into_bytes(),
    ];
    Parser::new("osg", seeds, move |bytes| {
        dependencies("/set/tile", bytes, None, &[], &options());
        parse(bytes, Vec::new());
    })
}

/// Returns the parser of the metadata of a folder of oblique photogrammetry, with a list of its tiles.
pub fn oblique() -> Parser {
    let of = |srs: &str| {
        format!("<?xml?><ModelMetadata version=\"1\"><SRS>{srs}</SRS><SRSOrigin>1,2,3</SRSOrigin></ModelMetadata>")
    };
    let wkt = r#"PROJCS["a",GEOGCS["b",DATUM["c",SPHEROID["d",6378137,298.257223563]]],PROJECTION["Transverse_Mercator"],
        PARAMETER["central_meridian",9],PARAMETER["scale_factor",0.9996],UNIT["metre",1]]"#;
    let seeds = [of("EPSG:32632"), of("ENU:47,8"), of("EPSG:4547"), of(wkt)];
    Parser::new("oblique", seeds, move |bytes| {
        let listing = ("/set/Data/*".into(), Ok(b"Tile_a/\nTile_b/\n".to_vec()));
        parse(bytes, vec![listing]);
    })
}
