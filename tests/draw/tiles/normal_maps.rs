//! Generated meshes of few triangles with normal maps, beside those of all samples.

use std::path::Path;

use glam::{DAffine3, DVec3, Vec3};
use image::RgbaImage;
use kit::frames::{MAGENTA, keep};
use kit::rig::{Rig, camera, plain, rig};
use kit::tile_sets::generate;
use terrane::fetch::Limits;
use terrane::formats::{Content, ReadOptions, decode_node};
use terrane::scene::{Drawable, Environment, Geometry, Node, NodeKind};
use terrane_data_gen::{Color, ContentKind, Triangles};

/// The side of the tile in metres.
const SIDE_M: f64 = 10_000.0;

/// Generates a set of one tile. Returns the transform of its mesh and the mesh.
fn tile(set: &Path, triangles: Triangles, normal_maps: bool) -> (DAffine3, Drawable) {
    generate(set, |args| {
        (args.levels, args.seed, args.size) = (Some(1), 3, SIDE_M);
        (args.content, args.color) = (ContentKind::Mesh, Color::None);
        (args.tiles.triangles, args.tiles.normal_maps) = (triangles, normal_maps);
    });
    let path = set.join("0/0/0.glb");
    let uri = path.to_str().unwrap();
    let bytes = std::fs::read(&path).unwrap();
    let content = Content { uri: uri.into(), bytes, reader_data: None, companions: Vec::new() };
    let node = decode_node(content, &ReadOptions::for_root(uri, Limits::default())).unwrap();
    find(&node, DAffine3::IDENTITY).unwrap()
}

fn find(node: &Node, parent: DAffine3) -> Option<(DAffine3, Drawable)> {
    match &node.kind {
        NodeKind::Transform(transform) => node.children.iter().find_map(|child| find(child, parent * *transform)),
        NodeKind::Geode(drawables) => Some((parent, drawables[0].clone())),
        _ => node.children.iter().find_map(|child| find(child, parent)),
    }
}

/// Draws the mesh under a low sun from an eye.
fn draw(rig: &mut Rig, (transform, drawable): &(DAffine3, Drawable), eye: DVec3, target: DVec3) -> RgbaImage {
    let mut drawable = drawable.clone();
    // All are drawn by the same model of reflection.
    drawable.material.metallic_roughness.get_or_insert_default();
    let scene = rig.scene(Node::transform(*transform, vec![Node::geode(vec![drawable])]));
    let sun_direction = DVec3::new(0.8, 0.3, 0.5).normalize();
    let environment = Environment { sun_direction, sun_color: [0.8; 3], ambient_color: [0.05; 3], ..plain() };
    let picture = rig.picture(&scene, &camera([192, 192], eye, target, DVec3::new(0.0, 0.5, 1.0)), &environment);
    rig.release(scene);
    picture
}

/// Returns the mean difference of the pixels that both pictures cover, and the share of those that differ by more than 12.
fn difference(a: &RgbaImage, b: &RgbaImage) -> (f64, f64) {
    let both = a.pixels().zip(b.pixels()).filter(|(a, b)| a.0[..3] != MAGENTA && b.0[..3] != MAGENTA);
    let far: Vec<f64> = both.map(|(a, b)| f64::from(a.0[1].abs_diff(b.0[1]))).collect();
    assert!(far.len() > 8_000, "{} pixels", far.len());
    let count = far.len() as f64;
    (far.iter().sum::<f64>() / count, far.iter().filter(|far| **far > 12.0).count() as f64 / count)
}

#[test]
fn few_triangles_with_a_normal_map_are_shaded_like_all() {
    let Some(mut rig) = rig("few_triangles_with_a_normal_map_are_shaded_like_all") else { return };
    let folder = tempfile::tempdir().unwrap();
    let [all, few, mapped] =
        [("all", Triangles::Grid, false), ("few", Triangles::Tin, false), ("mapped", Triangles::Tin, true)]
            .map(|(name, triangles, normal_maps)| tile(&folder.path().join(name), triangles, normal_maps));
    let material = mapped.1.material.metallic_roughness.as_ref().unwrap();
    assert!(material.normal_map.is_some() && few.1.material.metallic_roughness.is_none());
    let eye = DVec3::new(0.0, 0.0, 1.1 * SIDE_M);
    let pictures = [&all, &few, &mapped].map(|tile| draw(&mut rig, tile, eye, DVec3::ZERO));
    let [all, few, mapped] = &pictures;
    for (kind, picture) in ["all", "few", "mapped"].iter().zip(&pictures) {
        keep(&format!("normal_maps_{kind}"), picture);
    }
    let (with, without) = (difference(mapped, all), difference(few, all));
    assert!(with.0 < 1.0 && with.1 < 0.002, "{with:?}, without the map {without:?}");
    assert!(without.0 > 2.0 * with.0, "{with:?}, without the map {without:?}");
}

/// Texture coordinates of a skirt change along its edge only.
#[test]
fn skirts_have_the_shades_of_their_edge() {
    let Some(mut rig) = rig("skirts_have_the_shades_of_their_edge") else { return };
    let folder = tempfile::tempdir().unwrap();
    let [all, mapped] = [("all", Triangles::Grid, false), ("mapped", Triangles::Tin, true)]
        .map(|(name, triangles, normal_maps)| tile(&folder.path().join(name), triangles, normal_maps));
    // The skirt of the northern edge, with mountains, from the north.
    let Geometry::Mesh(mesh) = &all.1.geometry else { panic!("no mesh") };
    let places = mesh.vertices.iter().map(|v| all.0.transform_point3(Vec3::from_array(v.position).as_dvec3()));
    let mut edge: Vec<DVec3> = places.filter(|p| p.x.abs() < 50.0 && p.y > 0.49 * SIDE_M).collect();
    edge.sort_by(|a, b| a.z.total_cmp(&b.z));
    let (low, high) = (edge[0], edge[edge.len() - 1]);
    let depth_m = high.z - low.z;
    let upper = high - 0.35 * depth_m * DVec3::Z;
    let pictures = [&all, &mapped].map(|tile| draw(&mut rig, tile, upper + depth_m * DVec3::Y, upper));
    for (kind, picture) in ["all", "mapped"].iter().zip(&pictures) {
        keep(&format!("skirt_{kind}"), picture);
    }
    let far = difference(&pictures[0], &pictures[1]);
    assert!(far.0 < 2.0 && far.1 < 0.01, "{far:?}");
}
