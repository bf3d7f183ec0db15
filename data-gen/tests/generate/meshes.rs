//! Mesh tiles: triangles, compression and textures, read back by the library.

use std::path::Path;

use glam::{DAffine3, DVec3, Vec3};
use terrane::fetch::Limits;
use terrane::formats::{Content, ReadOptions, decode_node, verify};
use terrane::scene::{Geometry, Mesh, MeshVertex, Node, NodeKind};
use terrane_data_gen::{Color, ContentKind, GenArgs, TextureFormat, TileArgs, Triangles, run};

use crate::files::files_below;

fn args(folder: &Path, name: &str, tiles: TileArgs) -> GenArgs {
    GenArgs { content: ContentKind::Mesh, tiles, levels: Some(2), size: 10_000.0, ..GenArgs::new(folder.join(name)) }
}

/// Reads a glb of one mesh. Returns the transform of the mesh, the mesh, and true if it has a texture.
fn read(set: &Path, name: &str) -> (DAffine3, Mesh, bool) {
    let path = set.join(name);
    let uri = path.to_str().unwrap();
    let bytes = std::fs::read(&path).unwrap();
    let content = Content { uri: uri.into(), bytes, reader_data: None, companions: Vec::new() };
    let node = decode_node(content, &ReadOptions::for_root(uri, Limits::default())).unwrap();
    find(&node, DAffine3::IDENTITY).unwrap()
}

fn find(node: &Node, parent: DAffine3) -> Option<(DAffine3, Mesh, bool)> {
    let own = match &node.kind {
        NodeKind::Transform(transform) => parent * *transform,
        NodeKind::Geode(drawables) => {
            let Geometry::Mesh(mesh) = &drawables[0].geometry else { return None };
            return Some((parent, (**mesh).clone(), drawables[0].material.texture.is_some()));
        }
        _ => parent,
    };
    node.children.iter().find_map(|child| find(child, own))
}

/// The positions of a mesh in metres and its normals.
fn vertices((transform, mesh, _): &(DAffine3, Mesh, bool)) -> Vec<(DVec3, Vec3)> {
    let of = |v: &MeshVertex| {
        let position = transform.transform_point3(Vec3::from_array(v.position).as_dvec3());
        (position, Vec3::from_array([0, 1, 2].map(|k| f32::from(v.normal[k]) / 127.0)))
    };
    mesh.vertices.iter().map(of).collect()
}

#[test]
fn compressed_meshes_have_the_vertices_of_others() {
    let folder = tempfile::tempdir().unwrap();
    let set = |name: &str, no_meshopt: bool, float_vertices: bool| {
        let tiles = TileArgs { no_meshopt, ..TileArgs::default() };
        let args = GenArgs { float_vertices, color: Color::None, ..args(folder.path(), name, tiles) };
        (run(&args).unwrap().bytes, args.out)
    };
    let (compressed, plain, floats) = (set("a", false, false), set("b", true, false), set("c", false, true));
    assert!(2 * compressed.0 < plain.0 && 3 * plain.0 < 2 * floats.0 + 10_000, "{compressed:?} {plain:?} {floats:?}");
    for name in ["0/0/0.glb", "1/1/0.glb"] {
        let meshes = [&compressed, &plain, &floats].map(|(_, set)| read(set, name));
        let count = meshes[2].1.indices.len();
        assert!(meshes.iter().all(|(_, mesh, _)| mesh.indices.len() == count), "{name}");
        let [exact, others @ ..] = [2, 0, 1].map(|k| vertices(&meshes[k]));
        for other in others {
            assert_eq!(other.len(), exact.len());
            for ((p, n), (q, m)) in other.iter().zip(&exact) {
                assert!(p.distance(*q) < 0.3, "{p} {q}");
                assert!(n.angle_between(*m) < 0.03, "{n} {m}");
            }
        }
    }
}

#[test]
fn triangulated_sets_are_small_and_textures_are_read_back() {
    let folder = tempfile::tempdir().unwrap();
    for (texture, max_bytes) in
        [(TextureFormat::Jpeg, 35_000), (TextureFormat::Png, 200_000), (TextureFormat::Webp, 160_000)]
    {
        let tiles = TileArgs { texture, ..TileArgs::default() };
        let args = args(folder.path(), &format!("{texture:?}"), tiles);
        let summary = run(&args).unwrap();
        assert!(
            summary.bytes / summary.tiles < max_bytes,
            "{texture:?}: {} bytes a tile",
            summary.bytes / summary.tiles
        );
        let verified = verify(&args.out.to_string_lossy(), &Limits::default(), &mut |_| ()).unwrap();
        assert_eq!((verified.contents, verified.failed, verified.ignored.len()), (5, 0, 0), "{verified:?}");
        assert!(read(&args.out, "1/0/1.glb").2, "{texture:?}");
    }
    let images = GenArgs {
        content: ContentKind::Height,
        ..args(folder.path(), "h", TileArgs { texture: TextureFormat::Webp, ..TileArgs::default() })
    };
    run(&images).unwrap();
    assert_eq!(files_below(&images.out).keys().filter(|name| name.ends_with(".webp")).count(), 5);
    assert_eq!(verify(&images.out.to_string_lossy(), &Limits::default(), &mut |_| ()).unwrap().failed, 0);
}

/// The heights of the vertices on an edge are compared after they were read.
#[test]
fn triangulated_tiles_have_few_triangles_and_common_edges() {
    let folder = tempfile::tempdir().unwrap();
    let set = |name: &str, triangles: Triangles| {
        let tiles = TileArgs { triangles, ..TileArgs::default() };
        let args = GenArgs { float_vertices: true, ..args(folder.path(), name, tiles) };
        run(&args).unwrap();
        args.out
    };
    let (tin, grid) = (set("tin", Triangles::Tin), set("grid", Triangles::Grid));
    let [few, many] = [&tin, &grid].map(|set| read(set, "1/0/0.glb").1.indices.len() / 3);
    assert_eq!(many, 64 * 64 * 2 + 4 * 64 * 2);
    assert!(few < many / 3, "{few} triangles of {many}");
    // Rows of vertices on the edge, without those of skirts.
    let rows = |name: &str, u: f32| {
        let mut rows: Vec<i32> = read(&tin, name)
            .1
            .vertices
            .iter()
            .filter(|v| v.uv[0] == u)
            .map(|v| (v.uv[1] * 64.0).round() as i32)
            .collect();
        rows.sort_unstable();
        rows.dedup();
        rows
    };
    let (west, east) = (rows("1/0/0.glb", 1.0), rows("1/1/0.glb", 0.0));
    assert!(west == east && (3..60).contains(&west.len()), "{west:?} {east:?}");
}

/// The colours of the normal map of a tile, northern row first.
fn normal_texels(set: &Path, name: &str) -> Vec<[u8; 3]> {
    let bytes = std::fs::read(set.join(name)).unwrap();
    let png = bytes.windows(8).position(|window| window == b"\x89PNG\r\n\x1a\n").unwrap();
    let image = image::load_from_memory(&bytes[png..]).unwrap().to_rgb8();
    assert_eq!(image.dimensions(), (65, 65), "{name}");
    image.pixels().map(|texel| texel.0).collect()
}

#[test]
fn normal_maps_continue_in_neighbours_and_do_not_depend_on_threads() {
    let folder = tempfile::tempdir().unwrap();
    let tiles = || TileArgs { normal_maps: true, ..TileArgs::default() };
    let args = |name: &str| GenArgs { color: Color::None, ..args(folder.path(), name, tiles()) };
    let (one, three) = (GenArgs { jobs: Some(1), ..args("a") }, GenArgs { jobs: Some(3), ..args("b") });
    for args in [&one, &three] {
        run(args).unwrap();
    }
    assert!(files_below(&one.out) == files_below(&three.out));
    let verified = verify(&one.out.to_string_lossy(), &Limits::default(), &mut |_| ()).unwrap();
    assert_eq!((verified.contents, verified.failed, verified.ignored.len()), (5, 0, 0), "{verified:?}");
    let [south_west, south_east, north_west] =
        ["1/0/0.glb", "1/1/0.glb", "1/0/1.glb"].map(|name| normal_texels(&one.out, name));
    let edges =
        (0..65).flat_map(|k| [(south_west[65 * k + 64], south_east[65 * k]), (south_west[k], north_west[65 * 64 + k])]);
    let mut slopes = 0;
    for (own, other) in edges {
        assert!((0..3).all(|c| own[c].abs_diff(other[c]) <= 1), "{own:?} {other:?}");
        slopes += u32::from(own[0].abs_diff(128) > 8);
    }
    assert!(slopes > 20, "{slopes} texels are not level");
    // A normal that leans east is red, one that leans north green: the map has the slopes of the heights.
    let all = GenArgs { tiles: TileArgs { triangles: Triangles::Grid, ..TileArgs::default() }, ..args("c") };
    run(&GenArgs { float_vertices: true, ..all.clone() }).unwrap();
    let (transform, mesh, _) = read(&all.out, "1/0/0.glb");
    // Vertices of meshes without a texture have no texture coordinates: those at the top are found by their places.
    let texels = mesh.vertices.iter().filter_map(|v| {
        let place = transform.transform_point3(Vec3::from_array(v.position).as_dvec3()) / 5_000.0 * 64.0 + 32.0;
        let [i, j] = [place.x, place.y].map(f64::round);
        let is_near = (place.x - i).abs() < 0.1 && (place.y - j).abs() < 0.1 && (0.0..=64.0).contains(&i);
        let normal = transform.transform_vector3(DVec3::from_array([0, 1, 2].map(|k| f64::from(v.normal[k]) / 127.0)));
        (is_near && (0.0..=64.0).contains(&j)).then(|| (normal, south_west[65 * (64 - j as usize) + i as usize]))
    });
    let off = |(normal, texel): (DVec3, [u8; 3])| {
        (normal - DVec3::from_array(texel.map(|c| f64::from(c) / 127.5 - 1.0))).abs().max_element()
    };
    let far: Vec<f64> = texels.map(off).collect();
    assert!(far.len() > 1_000 && far.iter().all(|far| *far < 0.02), "{} {far:?}", far.len());
}

#[test]
fn options_without_effect_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let grid = || TileArgs { triangles: Triangles::Grid, ..TileArgs::default() };
    let no_meshopt = TileArgs { no_meshopt: true, ..TileArgs::default() };
    let webp = TileArgs { texture: TextureFormat::Webp, ..TileArgs::default() };
    let mapped = |triangles| TileArgs { normal_maps: true, triangles, ..TileArgs::default() };
    for (args, names) in [
        (GenArgs { content: ContentKind::Height, ..args(folder.path(), "a", grid()) }, ["--mesh", "--content mesh"]),
        (
            GenArgs { float_vertices: true, ..args(folder.path(), "b", no_meshopt) },
            ["--no-meshopt", "--float-vertices"],
        ),
        (GenArgs { color: Color::None, ..args(folder.path(), "c", webp) }, ["--texture", "--color none"]),
        (
            GenArgs { content: ContentKind::Height, ..args(folder.path(), "d", mapped(Triangles::Tin)) },
            ["--normal-maps", "--content mesh"],
        ),
        (args(folder.path(), "e", mapped(Triangles::Grid)), ["--normal-maps", "--mesh grid"]),
    ] {
        let error = run(&args).unwrap_err().to_string();
        assert!(names.iter().all(|name| error.contains(name)), "{error}");
    }
}
