//! Tiles of osgTerrain, as VirtualPlanetBuilder writes them.

use glam::DVec3;
use kit::osg_files::{Osgb, VERSION, osgt, terrain_tile};
use terrane::math::{Geodetic, WGS84};
use terrane::scene::AlphaMode;

use super::*;

/// 200 m to the east and 100 m to the north.
const PLANE: &str = "Transform { 200 0 0 0 0 100 0 0 0 0 1 0 1000 500 0 1 }";
/// A tenth of a radian in each direction.
const EARTH: &str = "CoordinateSystemType GEOCENTRIC Transform { 0.1 0 0 0 0 0.1 0 0 0 0 1 0 0.5 0.8 0 1 }";
/// A layer with the image a.png, as version 161 writes it.
const IMAGE: &str = "FileName \"a.png\" Image { ClassName osg::Image UniqueID 40 FileName \"a.png\" WriteHint 2 2 }";

fn color_layer(members: &str) -> String {
    format!("ColorLayers 1 {{ Layer 0 osgTerrain::ImageLayer {{ UniqueID 30 {members} }} }}")
}

/// Reads text with a.png in one colour.
fn read_with_image(text: &str, rgba: [u8; 4]) -> (Node, Ignored) {
    let needed = terrane::formats::dependencies(URI, text.as_bytes(), None, &[], &options());
    assert_eq!(needed.iter().map(|uri| &**uri).collect::<Vec<_>>(), ["/set/a.png"]);
    let mut png = std::io::Cursor::new(Vec::new());
    image::RgbaImage::from_pixel(2, 2, image::Rgba(rgba)).write_to(&mut png, image::ImageFormat::Png).unwrap();
    read_with(text.as_bytes(), vec![(needed[0].clone(), Ok(png.into_inner()))], &options()).unwrap()
}

/// Returns the tile's mesh with the centre that its positions are relative to.
fn tile_mesh(node: &Node) -> (&Mesh, DVec3) {
    let mut at = node;
    while !matches!(at.kind, NodeKind::Transform(_)) {
        at = at.children.first().expect("a transform");
    }
    let NodeKind::Transform(map) = at.kind else { unreachable!() };
    (mesh(drawables(at)[0]), map.translation)
}

fn positions(node: &Node) -> Vec<DVec3> {
    let (mesh, center) = tile_mesh(node);
    mesh.vertices.iter().map(|vertex| center + DVec3::from_array(vertex.position.map(f64::from))).collect()
}

#[test]
fn flat_tiles_have_cells_and_a_skirt_that_face_outwards() {
    let text = osgt(VERSION, &terrain_tile(1, PLANE, [3, 2], "SkirtHeight 5", "0 10 20 0 10 20", ""));
    let (node, ignored) = read(&text);
    assert!(ignored.is_empty(), "{ignored:?}");
    let (mesh, center) = tile_mesh(&node);
    assert_eq!((center, mesh.vertices.len(), mesh.indices.len() / 3), (DVec3::new(1100.0, 550.0, 0.0), 12, 4 + 12));
    let points = positions(&node);
    assert_eq!(
        points[..3],
        [[1000.0, 500.0, 0.0], [1100.0, 500.0, 10.0], [1200.0, 500.0, 20.0]].map(DVec3::from_array)
    );
    assert_eq!((points[5], points[6]), (DVec3::new(1200.0, 600.0, 20.0), DVec3::new(1000.0, 500.0, -5.0)));
    // 10 m up in 100 m.
    let [x, y, z, _] = mesh.vertices[1].normal.map(f64::from);
    assert!((x / z + 0.1).abs() < 0.02 && y == 0.0, "{x} {y} {z}");
    for (number, triangle) in mesh.indices.chunks_exact(3).enumerate() {
        let [a, b, c] = [0, 1, 2].map(|corner| points[triangle[corner] as usize]);
        let face = (b - a).cross(c - a);
        let outwards = ((a + b + c) / 3.0 - center).with_z(0.0);
        assert!(if number < 4 { face.z > 0.0 } else { face.dot(outwards) > 0.0 }, "triangle {number}");
    }
    // A locator that is turned over does not turn over the triangles.
    let (node, _) = read(text.replace("0 100 0 0", "0 -100 0 0"));
    let points = positions(&node);
    let (mesh, _) = tile_mesh(&node);
    let up = mesh.indices[..12].chunks_exact(3).all(|triangle| {
        let [a, b, c] = [0, 1, 2].map(|corner| points[triangle[corner] as usize]);
        (b - a).cross(c - a).z > 0.0
    });
    assert!(up, "{:?}", mesh.indices);
}

#[test]
fn geocentric_tiles_lie_on_their_ellipsoid() {
    let ellipsoid =
        "EllipsoidModel TRUE { osg::EllipsoidModel { UniqueID 50 RadiusEquator 6378137 RadiusPolar 6356752.3142 } }";
    let locator = EARTH.replace("Transform", &format!("{ellipsoid} Transform"));
    let (node, ignored) = read(osgt(VERSION, &terrain_tile(1, &locator, [2, 2], "SkirtHeight 100", "0 50 0 2000", "")));
    assert!(ignored.is_empty(), "{ignored:?}");
    let points = positions(&node);
    for (number, longitude, latitude, height_m) in
        [(0, 0.5, 0.8, 0.0), (1, 0.6, 0.8, 50.0), (3, 0.6, 0.9, 2000.0), (4, 0.5, 0.8, -100.0)]
    {
        let exact = WGS84.ecef(&Geodetic { longitude, latitude, height_m });
        assert!(points[number].distance(exact) < 0.1, "{number}: {}", points[number].distance(exact));
    }
    // Other planets.
    let small = locator.replace("6378137", "1000").replace("6356752.3142", "1000");
    let (node, _) = read(osgt(VERSION, &terrain_tile(1, &small, [2, 2], "", "0 0 0 0", "")));
    assert!(positions(&node).iter().all(|point| (point.length() - 1000.0).abs() < 1e-3));
}

#[test]
fn invalid_samples_are_left_out() {
    // Nine samples, of which the one in the corner and the one in the middle of an edge count in turn.
    let cells = |validity: &str, heights: &str| {
        let text = terrain_tile(1, PLANE, [3, 3], "", heights, "");
        let text = text.replacen("HeightField TRUE", &format!("{validity} HeightField TRUE"), 1);
        let (node, _) = read(osgt(VERSION, &text));
        let (mesh, _) = tile_mesh(&node);
        (mesh.vertices.len(), mesh.indices.len() / 3)
    };
    assert_eq!(cells("", "0 0 0 0 0 0 0 0 -9999"), (9, 8));
    // Three corners of a cell are a triangle.
    assert_eq!(cells("ValidDataOperator 1 -9999", "0 0 0 0 0 0 0 0 -9999"), (8, 7));
    assert_eq!(cells("ValidDataOperator 2 -1 100", "0 -2 0 0 0 0 0 0 101"), (7, 5));
    assert_eq!(cells("", "0 nan 0 0 0 0 0 0 inf"), (7, 5));
    // Without a triangle there is nothing to draw.
    let text = terrain_tile(1, PLANE, [2, 2], "", "1 1 1 1", "")
        .replace("HeightField TRUE", "ValidDataOperator 1 1 HeightField TRUE");
    let (node, ignored) = read(osgt(VERSION, &text));
    assert!(drawables(&node).is_empty() && !ignored.is_empty());
}

#[test]
fn terrains_scale_heights_and_thin_out_samples() {
    let heights: Vec<String> = (0..33 * 33).map(|i| (i % 33).to_string()).collect();
    let tile = terrain_tile(10, PLANE, [33, 33], "SkirtHeight 4", &heights.join(" "), "");
    let terrain = |members: &str| {
        osgt(VERSION, &format!("osgTerrain::Terrain {{ UniqueID 1 Children 1 {{ {tile} }} Format \"WKT\" {members} }}"))
    };
    let (node, ignored) = read(terrain("SampleRatio 0.25 VerticalScale 2"));
    assert!(ignored.is_empty(), "{ignored:?}");
    let (mesh, _) = tile_mesh(&node);
    assert_eq!(mesh.indices.len() / 3, 15 * 15 * 2 + 15 * 4 * 2);
    let points = positions(&node);
    // Between the samples heights are interpolated: 32 m over 15 cells, twice as high.
    assert!(points[..16].iter().enumerate().all(|(i, point)| (point.z - i as f64 * 64.0 / 15.0).abs() < 1e-4));
    // The skirt is not scaled.
    assert!((points[256].z + 4.0).abs() < 1e-4);
    let (node, _) = read(terrain("SampleRatio 4"));
    assert_eq!(tile_mesh(&node).0.vertices.len(), 66 * 66 + 4 * 65);
    for wrong in ["SampleRatio nan", "SampleRatio -1"] {
        assert_eq!(tile_mesh(&read(terrain(wrong)).0).0.vertices.len(), 33 * 33 + 4 * 32);
    }
    let huge = read_with(terrain("SampleRatio 1e30").as_bytes(), Vec::new(), &options()).unwrap_err();
    assert!(matches!(huge, IoError::TooLarge { .. }), "{huge}");
    // Tiles in the file of a PagedLOD have the scale too, and those in other files, however deep.
    let paged = format!(
        "osg::PagedLOD {{ UniqueID 5 RangeList 2 {{ 50 1e30 0 50 }} RangeDataList 2 {{ \"\" \"a.osgb\" }}
        PriorityList 2 {{ 0 1 0 1 }} Children 1 {{ {tile} }} }}"
    );
    let (node, ignored) = read(terrain("VerticalScale 3").replace(&tile, &paged));
    assert!(ignored.is_empty(), "{ignored:?}");
    let part = read_part(tiles(&node)[0]).unwrap();
    assert_eq!(positions(&part)[32].z, 96.0);
    let read_file = |tile: &PagedLod, text: &str| {
        let (uri, reader_data) = (tile.content.clone().unwrap(), tile.reader_data.clone());
        let content = Content { uri, bytes: osgt(VERSION, text).into(), reader_data, companions: Vec::new() };
        decode_noting(content, &options()).unwrap()
    };
    let (below, _) = read_file(tiles(&node)[1], &paged.replace("a.osgb", "b.osgb"));
    let (ground, _) = read_file(tiles(&below)[1], &tile);
    assert_eq!(positions(&ground)[32].z, 96.0);
    // A Terrain of its own counts, and in other formats the settings have no meaning.
    let own = format!("osgTerrain::Terrain {{ UniqueID 1 Children 1 {{ {tile} }} VerticalScale 2 }}");
    assert_eq!(positions(&read_file(tiles(&below)[1], &own).0)[32].z, 64.0);
    let proxy = "osg::ProxyNode { UniqueID 5 FileNames 1 { \"a.osgb\" } }";
    let (_, ignored) = read(terrain("VerticalScale 3").replace(&tile, proxy));
    assert_eq!(ignored.iter().count(), 1, "{ignored:?}");
}

#[test]
fn images_lie_where_their_locators_say() {
    let text = osgt(VERSION, &terrain_tile(1, PLANE, [2, 2], "", "0 0 0 0", &color_layer(IMAGE)));
    let (node, ignored) = read_with_image(&text, [9, 8, 7, 255]);
    assert!(ignored.is_empty(), "{ignored:?}");
    let drawable = drawables(&node)[0];
    assert_eq!(drawable.material.texture.as_ref().unwrap().mips[0][..4], [9, 8, 7, 255]);
    assert_eq!((drawable.material.alpha, drawable.material.unlit), (AlphaMode::Opaque, false));
    let uvs = |node: &Node| mesh(drawables(node)[0]).vertices.iter().map(|vertex| vertex.uv).collect::<Vec<_>>();
    assert_eq!(uvs(&node), [[0.0, 1.0], [1.0, 1.0], [0.0, 0.0], [1.0, 0.0]]);
    // An image over the western half, and one twice as high.
    let own =
        "Locator TRUE { osgTerrain::Locator { UniqueID 31 Transform { 100 0 0 0 0 200 0 0 0 0 1 0 1000 500 0 1 } } }";
    let (node, _) = read_with_image(&text.replace("FileName \"a.png\" Image", &format!("{own} Image")), [0; 4]);
    assert_eq!(uvs(&node), [[0.0, 1.0], [2.0, 1.0], [0.0, 0.5], [2.0, 0.5]]);
    // On the earth.
    let text = osgt(VERSION, &terrain_tile(1, EARTH, [2, 2], "", "0 0 0 900", &color_layer(IMAGE)));
    let own = EARTH.replace("0.5 0.8 0 1", "0.45 0.8 0 1");
    let own = format!("Locator TRUE {{ osgTerrain::Locator {{ UniqueID 31 {own} }} }}");
    let (node, _) = read_with_image(&text.replace("FileName \"a.png\" Image", &format!("{own} Image")), [0; 4]);
    let expected = [[0.5, 1.0], [1.5, 1.0], [0.5, 0.0], [1.5, 0.0]];
    let is_near = |(a, b): (&[f32; 2], &[f32; 2])| (a[0] - b[0]).abs() < 1e-5 && (a[1] - b[1]).abs() < 1e-5;
    assert!(uvs(&node).iter().zip(&expected).all(is_near), "{:?}", uvs(&node));
}

#[test]
fn tiles_are_blended_by_their_policy() {
    let look = |policy: &str, alpha: u8| {
        let layer = format!("{} {policy}", color_layer(IMAGE));
        let text = osgt(VERSION, &terrain_tile(1, PLANE, [2, 2], "", "0 0 0 0", &layer));
        drawables(&read_with_image(&text, [200, 200, 200, alpha]).0)[0].material.alpha
    };
    assert_eq!((look("", 255), look("", 100)), (AlphaMode::Opaque, AlphaMode::Blend));
    assert_eq!(look("BlendingPolicy DO_NOT_SET_BLENDING", 100), AlphaMode::Opaque);
    assert_eq!(look("BlendingPolicy ENABLE_BLENDING", 255), AlphaMode::Blend);
}

#[test]
fn composites_show_one_of_their_layers() {
    let parts =
        format!("Layers 2 {{ File \"set:summer:b.png\" Object osgTerrain::ImageLayer {{ UniqueID 33 {IMAGE} }} }}");
    for (class, members, images) in [
        ("SwitchLayer", "ActiveLayer 1", &["/set/a.png"][..]),
        ("SwitchLayer", "ActiveLayer 0", &["/set/b.png"]),
        ("SwitchLayer", "", &[]),
        ("SwitchLayer", "ActiveLayer 7", &[]),
        ("CompositeLayer", "", &["/set/b.png"]),
    ] {
        let layer = format!("ColorLayers 1 {{ Layer 1 osgTerrain::{class} {{ UniqueID 32 {parts} {members} }} }}");
        let text = osgt(VERSION, &terrain_tile(1, PLANE, [2, 2], "", "0 0 0 0", &layer));
        let needed = terrane::formats::dependencies(URI, text.as_bytes(), None, &[], &options());
        assert_eq!(needed.iter().map(|uri| &**uri).collect::<Vec<_>>(), images, "{class} {members}");
    }
    // Layers that are not drawn, and a unit beyond the last.
    let layers = "ColorLayers 3 { Layer 0 osgTerrain::ContourLayer { UniqueID 35 TransferFunction TRUE {
        osg::TransferFunction1D { UniqueID 36 } } } Layer 1 osgTerrain::ProxyLayer { UniqueID 37 FileName \"a.tif\" }
        Layer 99 osgTerrain::ImageLayer { UniqueID 38 FileName \"a.png\" } }";
    let (node, ignored) = read(osgt(VERSION, &terrain_tile(1, PLANE, [2, 2], "", "0 0 0 0", layers)));
    assert!(drawables(&node)[0].material.texture.is_none());
    for kind in [
        "OpenSceneGraph class osgTerrain::ContourLayer without colours (not drawn)",
        "OpenSceneGraph class osgTerrain::ProxyLayer of a file that is read in place (not drawn)",
        "OpenSceneGraph: colour layer of a ninth texture unit",
    ] {
        assert_eq!(ignored.count(kind), 1, "{ignored:?}");
    }
}

/// The colours of heights, whatever the vertical scale, in every format that has them.
#[test]
fn contour_layers_have_the_colors_of_their_heights() {
    let layer = "ColorLayers 1 { Layer 0 osgTerrain::ContourLayer { UniqueID 35 TransferFunction TRUE {
        osg::TransferFunction1D { UniqueID 36 ColorMap 3 { 50 0 1 0 1 0 1 0 0 1 100 0 0 1 1 } } } } }";
    let tile = terrain_tile(10, PLANE, [2, 2], "SkirtHeight 9", "0 50 100 125", layer);
    let terrain = format!("osgTerrain::Terrain {{ UniqueID 1 Children 1 {{ {tile} }} VerticalScale 4 }}");
    let older = "osgTerrain::TerrainTile {\n osgTerrain::Locator {\n UniqueID l\n CoordinateSystemType PROJECTED\n Transform {
        200 0 0 0 0 100 0 0 0 0 1 0 1000 500 0 1\n }\n }\n ElevationLayer {\n osgTerrain::HeightFieldLayer {\n Use l\n HeightField {
        NumColumnsAndRows 2 2\n SkirtHeight 9\n Heights {\n 0 50\n 100 125\n }\n }\n }\n }\n ColorLayer {
        osgTerrain::ContourLayer {\n TransferFunction1D {\n NumberImageCells 16\n Colours {\n 50 0 1 0 1\n 0 1 0 0 1\n 100 0 0 1 1
        }\n }\n }\n }\n}\n";
    for text in [osgt(VERSION, &tile), osgt(VERSION, &terrain), older.to_owned()] {
        let (node, ignored) = read(&text);
        assert!(ignored.is_empty(), "{ignored:?}");
        let drawable = drawables(&node)[0];
        let texture = drawable.material.texture.as_ref().unwrap();
        assert_eq!(drawable.material.alpha, AlphaMode::Opaque);
        assert_eq!((texture.sampling.mip, texture.height), (None, 1));
        let color = |vertex: usize| {
            let at = (f64::from(mesh(drawable).vertices[vertex].uv[0]) * f64::from(texture.width - 1)).round();
            let at = at.clamp(0.0, f64::from(texture.width - 1)) as usize;
            <[u8; 3]>::try_from(&texture.mips[0][4 * at..4 * at + 3]).unwrap()
        };
        assert_eq!([0, 2, 3].map(color), [[255, 0, 0], [0, 0, 255], [0, 0, 255]]);
        assert!(color(1)[1] >= 254, "{:?}", color(1));
        // The skirt has the colours of the edge.
        assert_eq!(color(4), color(0));
    }
}

/// In binary the map of colours depends on the version.
#[test]
fn binary_ramps_are_read() {
    for version in [100, VERSION] {
        let mut file = Osgb::new(version, false);
        let locator = |file: &mut Osgb| {
            file.object_members("").u32(2).text("").text("").raw(&[0]).block(|file| {
                file.f64s(&glam::DMat4::IDENTITY.to_cols_array());
            });
            file.raw(&[0, 0]);
        };
        file.object("osgTerrain::TerrainTile", 2, |file| {
            file.node_members("").raw(&[0, 0, 0, 1]).object("osgTerrain::Locator", 4, locator);
            file.raw(&[0, 1]).u32(1).block(|file| {
                file.u32(0).object("osgTerrain::ContourLayer", 8, |file| {
                    file.object_members("").text("").raw(&[0]).u32(0).u32(30).raw(&[0]).f32s(&[0.0; 4]);
                    file.u32(0x2601).u32(0x2601).raw(&[1]).object("osg::TransferFunction1D", 9, |file| {
                        file.object_members("");
                        let colors = [(0.0f32, [1.0f32, 0.0, 0.0, 1.0]), (9.0, [0.0, 1.0, 0.0, 1.0])];
                        if version < 112 {
                            file.raw(&[1]).u32(2).block(|file| {
                                for (at, color) in colors {
                                    file.f32s(&[at]).f64s(&color.map(f64::from));
                                }
                            });
                            return;
                        }
                        file.u32(2);
                        for (at, color) in colors {
                            file.f32s(&[at]).f32s(&color);
                        }
                    });
                });
            });
            file.raw(&[1, 0]).u32(0);
        });
        let (node, ignored) = read(&file.bytes);
        assert!(ignored.is_empty(), "{ignored:?}");
        assert_eq!(drawables(&node)[0].material.texture.as_ref().unwrap().mips[0][..4], [255, 0, 0, 255]);
    }
}

#[test]
fn tiles_without_heights_or_place_are_drawn_flat_or_noted() {
    let flat = format!(
        "osgTerrain::TerrainTile {{ UniqueID 1 Locator TRUE {{ osgTerrain::Locator {{ UniqueID 2 {PLANE} }} }} {} }}",
        color_layer(IMAGE)
    );
    let (node, _) = read_with_image(&osgt(VERSION, &flat), [1, 2, 3, 255]);
    assert_eq!(tile_mesh(&node).0.indices.len() / 3, 19 * 19 * 2);
    for nowhere in [
        "osgTerrain::TerrainTile { UniqueID 1 RequiresNormals FALSE }".to_owned(),
        terrain_tile(1, "Transform { 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 }", [2, 2], "", "0 0 0 0", ""),
        terrain_tile(1, PLANE, [1, 1], "", "0", ""),
    ] {
        let (node, ignored) = read(osgt(VERSION, &nowhere));
        assert!(drawables(&node).is_empty());
        let note = "OpenSceneGraph: a TerrainTile without a place or with less than one cell (not drawn)";
        assert_eq!(ignored.count(note), 1, "{ignored:?}");
    }
    let short = osgt(
        VERSION,
        &terrain_tile(1, PLANE, [2, 2], "", "0 0 0 0", "").replace("Area 2 2", "Area 2000000000 2000000000"),
    );
    let error = read_with(short.as_bytes(), Vec::new(), &options()).unwrap_err();
    assert!(error.to_string().contains("HeightField of 2000000000 x 2000000000 with 4 heights"), "{error}");
    // OSG does not draw the children of a tile either.
    let child = terrain_tile(1, PLANE, [2, 2], "", "0 0 0 0", "").replacen(
        "TileID",
        "Children 1 { osg::Geode { UniqueID 60 } } TileID",
        1,
    );
    let (node, ignored) = read(osgt(VERSION, &child));
    assert_eq!(
        (drawables(&node).len(), ignored.count("OpenSceneGraph: children of a TerrainTile, which OSG does not draw")),
        (1, 1)
    );
}

/// OSG writes all levels of a compressed image as one text, and counts them nevertheless.
#[test]
fn compressed_images_in_text_are_one_text() {
    // Four texels of black, and of the levels below.
    let image = "Image { ClassName osg::Image UniqueID 40 FileName \"a.dds\" WriteHint 0 0 Origin 0 Size 4 4 1
        InternalTextureFormat 33776 PixelFormat 33776 DataType 5121 Packing 1 AllocationMode 1
        Data 3 { \"AAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAA\" } DataVariance STATIC }";
    let (node, ignored) = read(osgt(VERSION, &terrain_tile(1, PLANE, [2, 2], "", "0 0 0 0", &color_layer(image))));
    assert!(ignored.is_empty(), "{ignored:?}");
    let texture = drawables(&node)[0].material.texture.as_ref().unwrap();
    assert_eq!((texture.width, texture.mips[0][..4].to_vec()), (4, vec![0, 0, 0, 255]));
}

/// A file that is a whole set in a projection lies on the earth; one in an unknown projection around the origin.
#[test]
fn projected_sets_are_placed_by_their_system() {
    let far = "Transform { 2000 0 0 0 0 1000 0 0 0 0 1 0 460000 5248000 0 1 }";
    let tile = terrain_tile(10, far, [2, 2], "", "400 400 400 400", "");
    let utm = r#"CoordinateSystem "PROJCS[\"UTM 32N\",GEOGCS[\"WGS 84\",DATUM[\"WGS_1984\",SPHEROID[\"WGS 84\",6378137,
        298.257223563]],UNIT[\"degree\",0.0174532925199433]],PROJECTION[\"Transverse_Mercator\"],
        PARAMETER[\"latitude_of_origin\",0],PARAMETER[\"central_meridian\",9],PARAMETER[\"scale_factor\",0.9996],
        PARAMETER[\"false_easting\",500000],PARAMETER[\"false_northing\",0],UNIT[\"metre\",1]]""#;
    for class in ["osgTerrain::Terrain", "osg::CoordinateSystemNode"] {
        let text = |system: &str| osgt(VERSION, &format!("{class} {{ UniqueID 1 Children 1 {{ {tile} }} {system} }}"));
        let (node, ignored) = read(text(utm));
        assert!(ignored.is_empty(), "{ignored:?}");
        let NodeKind::Transform(map) = node.kind else { panic!("a transform: {node:?}") };
        let geodetic = WGS84.geodetic(map.transform_point3(DVec3::new(461_000.0, 5_248_500.0, 400.0)));
        assert!((geodetic.height_m - 400.0).abs() < 0.1, "{geodetic:?}");
        let [easting, northing] = terrane::math::TransverseMercator::utm(32, false).project(&geodetic);
        assert!((easting - 461_000.0).abs() < 0.01 && (northing - 5_248_500.0).abs() < 0.01, "{easting} {northing}");
        // With an ellipsoid the positions are earth-centred, whatever the name of the system.
        let ellipsoid = "EllipsoidModel TRUE { osg::EllipsoidModel { UniqueID 50 } }";
        assert!(matches!(read(text(&format!("{utm} {ellipsoid}"))).0.kind, NodeKind::Group));
        let (node, ignored) = read(text("CoordinateSystem \"PROJCS[Lambert]\""));
        let note = "OpenSceneGraph: an unknown coordinate system (what it has is drawn around the origin)";
        assert_eq!(ignored.count(note), 1, "{ignored:?}");
        assert!(matches!(node.kind, NodeKind::Transform(map) if map.translation.y == -5_248_500.0));
        // Nodes below another file have the frame of that file.
        let below = options().below(&"/set/tileset.json".into());
        let (node, _) = read_with(text(utm).as_bytes(), Vec::new(), &below).unwrap();
        assert!(matches!(node.kind, NodeKind::Group));
    }
}

/// The volume of a tile of a PagedLOD holds its skirt, and its heights as they are drawn.
#[test]
fn tiles_of_paged_levels_hold_their_terrain() {
    let paged = format!(
        "osg::PagedLOD {{ UniqueID 5 RangeList 2 {{ 50 1e30 0 50 }} RangeDataList 2 {{ \"\" \"a.osgb\" }}
        PriorityList 2 {{ 0 1 0 1 }} Children 1 {{ {} }} }}",
        terrain_tile(10, PLANE, [2, 2], "SkirtHeight 40", "0 0 0 100", "")
    );
    let text = format!("osgTerrain::Terrain {{ UniqueID 1 Children 1 {{ {paged} }} VerticalScale 5 }}");
    let (node, _) = read(osgt(VERSION, &text));
    let terrane::math::BoundingVolume::Sphere(sphere) = tiles(&node)[0].bounds else { panic!("a sphere") };
    for point in [[1000.0, 500.0, -40.0], [1200.0, 600.0, 500.0], [1200.0, 500.0, -40.0]].map(DVec3::from_array) {
        assert!(sphere.center.distance(point) <= sphere.radius_m, "{point} in {sphere:?}");
    }
}

/// Every member is present in binary, and blocks need no sizes.
#[test]
fn binary_tiles_are_read() {
    let mut file = Osgb::new(VERSION, false);
    file.object("osgTerrain::Terrain", 1, |file| {
        file.node_members("").children(1, |file| {
            file.object("osgTerrain::TerrainTile", 2, |file| {
                file.node_members("").raw(&[0]).raw(&[1]).u32(0).u32(1).u32(2).raw(&[1]);
                file.object("osgTerrain::GeometryTechnique", 3, |file| {
                    file.object_members("").f32s(&[0.0, 0.1]).raw(&[1]).block(|file| {
                        file.f32s(&[0.0; 9]);
                    });
                });
                let locator = |file: &mut Osgb| {
                    file.object_members("").u32(2).text("WKT").text("PROJCS[]").raw(&[0]).block(|file| {
                        let rows = [10.0, 0.0, 0.0, 0.0, 0.0, 10.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0];
                        file.f64s(&rows);
                    });
                    file.raw(&[0, 0]);
                };
                file.raw(&[1]).object("osgTerrain::Locator", 4, locator).raw(&[1]);
                file.object("osgTerrain::HeightFieldLayer", 5, |file| {
                    file.object_members("").text("").raw(&[1]).object("osgTerrain::Locator", 6, locator);
                    file.u32(0).u32(30).raw(&[1]).u32(1).f32s(&[-1.0]).f32s(&[0.0; 4]).u32(0x2703).u32(0x2601);
                    file.raw(&[1]).object("osg::HeightField", 7, |file| {
                        file.object_members("").raw(&[1]).u32(2).u32(2).f32s(&[0.0; 5]).f32s(&[0.0]).u32(0);
                        file.f64s(&[0.0, 0.0, 0.0, 1.0]).raw(&[1]).u32(1).u32(6).u32(4).block(|file| {
                            file.f32s(&[1.0, 2.0, 3.0, -1.0]);
                        });
                    });
                });
                file.raw(&[1]).u32(1).block(|file| {
                    file.u32(0).object("osgTerrain::ImageLayer", 8, |file| {
                        file.object_members("").text("").raw(&[0]).u32(0).u32(30).raw(&[0]).f32s(&[0.0; 4]);
                        file.u32(0x2601).u32(0x2600).raw(&[1]).text("osg::Image").u32(9).text("x").u32(0).u32(0);
                        // A pixel of RGB: origin, size, formats, type, packing, allocation; bytes; no further levels.
                        for word in [0, 1, 1, 1, 0x1907, 0x1907, 0x1401, 1, 0, 3] {
                            file.u32(word);
                        }
                        file.raw(&[10, 20, 30]).u32(0).object_members("");
                    });
                });
                file.raw(&[1, 0]).u32(0);
            });
        });
        file.text("").text("").raw(&[0]).f32s(&[1.0, 2.0]).u32(0);
    });
    let (node, ignored) = read(&file.bytes);
    assert!(ignored.is_empty(), "{ignored:?}");
    assert_eq!(positions(&node), [[0.0, 0.0, 2.0], [10.0, 0.0, 4.0], [0.0, 10.0, 6.0]].map(DVec3::from_array));
    let texture = drawables(&node)[0].material.texture.as_ref().unwrap();
    assert_eq!((texture.mips[0][..3].to_vec(), texture.sampling.mip), (vec![10, 20, 30], None));
}

/// The text format before 3.0, as osgdem writes it.
#[test]
fn dot_osg_tiles_are_read() {
    let text = r#"osgTerrain::Terrain {
  nodeMask 0xffffffff
  SampleRatio 1
  VerticalScale 2
  BlendingPolicy INHERIT
  Format ""
  EllipsoidModel {
    UniqueID EllipsoidModel_0
    RadiusEquator 6378137
    RadiusPolar 6356752.3142
  }
  num_children 1
  osgTerrain::TerrainTile {
    UniqueID TerrainTile_2
    BlendingPolicy ENABLE_BLENDING
    osgTerrain::Locator {
      UniqueID Locator_3
      CoordinateSystemType PROJECTED
      TransformScaledByResolution FALSE
      Transform {
        200 0 0 0
        0 100 0 0
        0 0 1 0
        1000 500 0 1
      }
    }
    ElevationLayer {
      osgTerrain::HeightFieldLayer {
        Use Locator_3
        HeightField {
          UniqueID HeightField_4
          Origin 1 2 0
          XInterval 0.1
          SkirtHeight 7
          Rotation 0 0 0 1
          NumColumnsAndRows 2 2
          Heights
          {
            1 2
            3 4
          }
        }
      }
    }
    ColorLayer {
      osgTerrain::ImageLayer {
        Use Locator_3
        MinFilter LINEAR
        MagFilter NEAREST
        file "a.png"
      }
    }
    ColorLayer 1 {
      osgTerrain::SwitchLayer {
        ActiveLayer 0
        ProxyLayer b.tif
      }
    }
    osgTerrain::GeometryTechnique {
    }
  }
}
"#;
    let (node, ignored) = read_with_image(text, [5, 6, 7, 255]);
    let note = "OpenSceneGraph class osgTerrain::ProxyLayer of a file that is read in place (not drawn)";
    assert_eq!((ignored.count(note), ignored.iter().count()), (1, 1), "{ignored:?}");
    let points = positions(&node);
    assert_eq!(
        (points.len(), points[3], points[4]),
        (8, DVec3::new(1200.0, 600.0, 8.0), DVec3::new(1000.0, 500.0, -5.0))
    );
    let drawable = drawables(&node)[0];
    assert_eq!(drawable.material.alpha, AlphaMode::Blend);
    assert_eq!(drawable.material.texture.as_ref().unwrap().mips[0][..3], [5, 6, 7]);
    assert_eq!(mesh(drawable).vertices[0].uv, [0.0, 1.0]);
    // The same HeightField as a shape.
    let start = text.find("HeightField {").unwrap();
    let end = start + text[start..].find("3 4").unwrap();
    let shape = format!("Geode {{\n ShapeDrawable {{\n {}3 4\n }}\n }}\n }}\n}}\n", &text[start..end]);
    let (node, ignored) = read(&shape);
    assert!(ignored.is_empty(), "{ignored:?}");
    assert_eq!(mesh(drawables(&node)[0]).bounds.max.z, 4.0);
    let error = read_with(shape.replace("3 4", "3").as_bytes(), Vec::new(), &options()).unwrap_err();
    assert!(error.to_string().contains("HeightField of 2 x 2 with 3 heights"), "{error}");
}
