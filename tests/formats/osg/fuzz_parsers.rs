//! Fuzzed parsers of OpenSceneGraph's files and of the folders that are made of them. They are run like those of
//! `tests/formats/fuzz_parsers.rs`, by tests and by `tools/fuzz`.

use kit::fuzz::Parser;
use kit::ive_files::Ive;
use kit::ive_files::scenes::{paged, terrain_tile as ive_tile, textured, unusual_nodes, volumes};
use kit::osg_files::{Osgb, VERSION, geode, group, osgt, terrain_tile, triangle};
use terrane::fetch::{DECODER_PANICKED, Limits};
use terrane::formats::{Content, Fetched, ReadOptions, decode, dependencies};

fn options() -> ReadOptions {
    let limits = Limits { max_image_side_px: 256, max_file_bytes: 8 << 20, ..Limits::default() };
    ReadOptions::for_root("/set/a", limits)
}

fn content(bytes: &[u8], companions: Vec<Fetched>) {
    let mut options = options();
    options.vertex_attributes = std::sync::Arc::new(["TEXCOORD_1".into()]);
    dependencies("/set/tile", bytes, None, &companions, &options);
    match decode(Content { uri: "/set/tile".into(), bytes: bytes.to_vec(), reader_data: None, companions }, &options) {
        Ok(page) => assert!(page.size_bytes() < 1 << 30),
        Err(error) => assert!(
            !error.uri().is_empty() && !error.reason().is_empty() && error.reason() != DECODER_PANICKED,
            "{error:?}"
        ),
    }
}

/// Files of OpenSceneGraph of all ages, in both encodings.
fn osg() -> Parser {
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
            "osg::Billboard { UniqueID 40 Drawables 1 { osg::ShapeDrawable { UniqueID 41 Shape TRUE {
            osg::HeightField { UniqueID 42 Area 2 2 XInterval 1 YInterval 1 SkirtHeight 1 Heights ArrayID 1 FloatArray 4
            { 0 0 0 7 } } } } } Mode POINT_ROT_EYE Normal 1 0 0 PositionList 1 { 1 2 3 } }"
                .to_owned(),
            "osg::AutoTransform { UniqueID 50 Children 1 { osg::Geode { UniqueID 51 Drawables 1 { osg::ShapeDrawable {
            UniqueID 52 Shape TRUE { osg::TriangleMesh { UniqueID 53 Vertices osg::Vec3Array { UniqueID 54 vector 3
            { 0 0 0 1 0 0 0 1 0 } } Indices osg::UIntArray { UniqueID 55 vector 3 { 0 1 2 } } } } } } } }
            MaximumScale 9 AutoRotateMode ROTATE_TO_SCREEN AutoScaleToScreen TRUE }"
                .to_owned(),
            terrain_tile(
                60,
                "CoordinateSystemType GEOCENTRIC Transform { 0.1 0 0 0 0 0.1 0 0 0 0 1 0 0 0 0 1 }",
                [2, 2],
                "SkirtHeight 3",
                "0 1 2 -9",
                "ColorLayers 2 { Layer 1 osgTerrain::ContourLayer { UniqueID 74 TransferFunction TRUE { osg::TransferFunction1D {
                UniqueID 75 ColorMap 2 { 0 1 0 0 1 9 0 1 0 1 } } } } Layer 0 osgTerrain::SwitchLayer { UniqueID 70 Layers 2 { File \"set:a:b.png\" Object
                osgTerrain::ImageLayer { UniqueID 71 ValidDataOperator 2 0 1 Image { ClassName osg::Image UniqueID 72
                FileName \"c.png\" WriteHint 2 2 } } } ActiveLayer 1 } } BlendingPolicy ENABLE_BLENDING",
            ),
            "osgSim::LightPointNode { UniqueID 80 LightPointList 1 { LightPoint { Position 1 2 3 Color 1 0 0 1 Attributes
            TRUE 0 1 1 Sector FALSE BlinkSequence FALSE } } }"
                .to_owned(),
            "osg::Geode { UniqueID 90 Drawables 1 { osgText::Text { UniqueID 91 Font \"a.ttf\" FontSize 32 32 CharacterSize 3 1
            CharacterSizeMode SCREEN_COORDS MaximumWidth 9 LineSpacing 0.5 Text FALSE osg::UIntArray { UniqueID 92 vector 3 {
            65 10 214 } } Position 1 2 3 Alignment CENTER_TOP AxisAlignment XZ_PLANE Rotation 1 0 0 0
            DrawMode TEXT|BOUND|FILLED|ALIGNMENT BoundingBoxMargin 1 BoundingBoxColor 0 0 1 1 Color 1 0 0 1 BackdropType OUTLINE BackdropOffset 0.1 0.1 BackdropColor 0 0 0 1 } } }"
                .to_owned(),
            "osg::ClipNode { UniqueID 110 StateSet TRUE { osg::StateSet { UniqueID 111 ModeList 1 { GL_FOG ON } AttributeList 2 {
            osg::Fog { UniqueID 112 Color 1 0 0 1 } Value OFF osg::LightModel { UniqueID 113 TwoSided TRUE } Value OFF } } }
            Children 1 { osg::LightSource { UniqueID 114 Light TRUE { osg::Light { UniqueID 115 LightNum 1 Position 0 0 1 0 } } } }
            ClipPlaneList 1 { osg::ClipPlane { UniqueID 116 ClipPlane 1 0 0 1 } } }"
                .to_owned(),
            "osg::Camera { UniqueID 120 Children 1 { osg::Projection { UniqueID 121 Matrix { 0.02 0 0 0 0 0.02 0 0 0 0 -1 0 -1 -1 0 1 } } }
            ReferenceFrame ABSOLUTE_RF ClearMask DEPTH ProjectionMatrix { 0.02 0 0 0 0 0.02 0 0 0 0 -1 0 -1 -1 0 1 }
            RenderOrder POST_RENDER 0 DrawBuffer GL_BACK }"
                .to_owned(),
            "osg::Sequence { UniqueID 95 Children 1 { osg::MatrixTransform { UniqueID 96 UpdateCallback TRUE {
            osg::AnimationPathCallback { UniqueID 97 AnimationPath TRUE { osg::AnimationPath { UniqueID 98 TimeControlPointMap 1 {
            Time 1 { Position 1 0 0 Rotation 0 0 0 1 Scale 1 1 1 } } LoopMode SWING } } TimeMultiplier 2 } } } }
            TimeList 2 { 1 2 } LoopMode SWING Begin 0 End 1 Speed 1 NumRepeats 3 Mode START }"
                .to_owned(),
        ],
    );
    let older = "Group {\n UniqueID g\n description {\n \"a\"\n }\n MatrixTransform {\n Matrix {\n 1 0 0 0 0 1 0 0 0 0 1 0 5 6 7 1\n }
        Geode {\n Geometry {\n StateSet {\n GL_BLEND OVERRIDE|ON\n Material {\n diffuseColor FRONT 1 0 0\n }\n textureUnit 0 {
        GL_TEXTURE_2D ON\n Texture2D {\n file \"a.png\"\n }\n }\n }\n PrimitiveSets 2 {\n DrawArrays QUADS 0 4\n DrawElementsUInt TRIANGLES 3 {
        0 1 2\n }\n }\n VertexArray UniqueID v Vec3Array 4 {\n 0 0 0\n 1 0 0\n 0 1 0\n 1 1 0\n }\n NormalArray Use v\n
        TexCoordArray 1 Vec2Array 1 {\n 0 0\n }\n }\n ShapeDrawable {\n Cone {\n Radius 1\n }\n }\n }\n }\n PagedLOD {\n Center 0 0 0
        Radius 3\n RangeList 1 {\n 0 9\n }\n FileNameList 1 {\n \"b.osg\"\n }\n Use g\n }\n}\n";
    let seeds = [
        older.as_bytes().to_vec(),
        binary(Osgb::new(VERSION, true)),
        binary(Osgb::new(VERSION, false)),
        binary(Osgb::new(80, false)),
        binary(Osgb::new(100, true)),
        osgt(VERSION, &text).into_bytes(),
    ];
    Parser::new("osg", seeds, |bytes| {
        content(bytes, Vec::new());
    })
}

/// Files in .ive of several versions.
fn ive() -> Parser {
    let seeds = [
        textured(Ive::new(45)).bytes,
        textured(Ive::new(45)).compressed(),
        textured(Ive::big_endian(12)).bytes,
        paged(Ive::new(20), true).bytes,
        unusual_nodes(45).bytes,
        unusual_nodes(5).bytes,
        ive_tile(45).bytes,
        volumes(45).bytes,
        ive_tile(22).bytes,
    ];
    Parser::new("ive", seeds, |bytes| {
        content(bytes, Vec::new());
    })
}

/// The metadata of a folder of oblique photogrammetry, with a list of its tiles.
fn oblique() -> Parser {
    let of = |srs: &str| {
        format!("<?xml?><ModelMetadata version=\"1\"><SRS>{srs}</SRS><SRSOrigin>1,2,3</SRSOrigin></ModelMetadata>")
    };
    let wkt = r#"PROJCS["a",GEOGCS["b",DATUM["c",SPHEROID["d",6378137,298.257223563]]],PROJECTION["Transverse_Mercator"],
        PARAMETER["central_meridian",9],PARAMETER["scale_factor",0.9996],UNIT["metre",1]]"#;
    let seeds = [of("EPSG:32632"), of("ENU:47,8"), of("EPSG:4547"), of(wkt)];
    Parser::new("oblique", seeds, |bytes| {
        let listing = ("/set/Data/*".into(), Ok(b"Tile_a/\nTile_b/\n".to_vec()));
        content(bytes, vec![listing]);
    })
}

/// A node with a texture.
const TEXTURED: &str = "Geode {\n StateSet {\n textureUnit 0 {\n GL_TEXTURE_2D ON\n Texture2D {\n file \"a.tga\"\n }\n }\n }\n
    Geometry {\n PrimitiveSets 1 {\n DrawArrays TRIANGLES 0 3\n }\n VertexArray Vec3Array 3 {\n 0 0 0\n 1 0 0\n 0 1 0\n }\n
    TexCoordArray 0 Vec2Array 3 {\n 0 0\n 1 0\n 0 1\n }\n }\n}\n";

/// Images that old databases name: Targa and SGI, plain and in runs.
fn old_images() -> Parser {
    let targa = |kind: u8, map: &[u8], bits: u8, pixels: &[u8]| {
        let entries = (map.len() / 3) as u8;
        let has_map = u8::from(entries > 0);
        let header = [0, has_map, kind, 0, 0, entries, 0, 24 * has_map, 0, 0, 0, 0, 4, 0, 2, 0, bits, 0x20];
        [&header, map, pixels].concat()
    };
    let sgi = |packed: u8, channels: u8, data: &[u8]| {
        let mut file = vec![1, 0xda, packed, 1, 0, 3, 0, 4, 0, 2, 0, channels];
        file.resize(512, 0);
        [&file, data].concat()
    };
    // The places of the rows, their lengths, and a run and a copy for each.
    let rows: Vec<u8> = (0..6u32).flat_map(|row| (560 + row * 6).to_be_bytes()).collect();
    let runs = [rows, [0, 0, 0, 5].repeat(6), [2, 7, 0x82, 8, 9, 0].repeat(6)].concat();
    let seeds = [
        targa(2, &[], 24, &[9; 24]),
        targa(10, &[], 32, &[0x83, 1, 2, 3, 4, 3, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3, 4, 4, 4, 4]),
        targa(1, &[1, 2, 3, 4, 5, 6], 8, &[0, 1, 0, 1, 0, 1, 0, 1]),
        targa(11, &[], 16, &[0x87, 5, 200]),
        sgi(0, 4, &[200; 32]),
        sgi(1, 3, &runs),
    ];
    Parser::new("old-images", seeds, |bytes| {
        content(TEXTURED.as_bytes(), vec![("/set/a.tga".into(), Ok(bytes.to_vec()))])
    })
}

/// Otherwise the images are not decoded.
#[test]
fn seeds_of_images_are_decoded() {
    let named = dependencies("/set/tile", TEXTURED.as_bytes(), None, &[], &options());
    assert_eq!(named.iter().map(|uri| &**uri).collect::<Vec<_>>(), ["/set/a.tga"]);
    for seed in old_images().seeds {
        let companions = vec![("/set/a.tga".into(), Ok(seed))];
        let content = Content { uri: "/set/tile".into(), bytes: TEXTURED.into(), reader_data: None, companions };
        let (_, ignored) = terrane::formats::decode_noting(content, &options()).unwrap();
        assert!(ignored.is_empty(), "{ignored:?}");
    }
}

kit::parsers! {
    osg,
    ive,
    oblique,
    old_images,
}
