//! Frames compared with reference images: terrain on the globe with sky and haze, and meshes.

use std::sync::Arc;

use glam::{DAffine3, DVec3};
use kit::frames::assert_picture;
use kit::rig::{camera, rig};
use kit::shapes::{quad, with_mips};
use kit::terrain::Terrain;

use terrane::scene::{AlphaMode, Drawable, Environment, Geometry, Material, MeshVertex, Node};

fn alps() -> Terrain {
    Terrain { west: 0.13, south: 0.8, width: 0.006, relief_m: 2600.0, root_error_m: 250.0, textured: true }
}

fn environment(up: DVec3, north: DVec3) -> Environment {
    let east = north.cross(up);
    Environment {
        up_in_world: up,
        sun_direction: (0.5 * up - 0.6 * east - 0.35 * north).normalize(),
        ..Environment::default()
    }
}

#[test]
fn terrain_with_sky_and_haze() {
    let Some(mut rig) = rig("terrain_with_sky_and_haze") else { return };
    let terrain = alps();
    let eye = terrain.world(0.5, 0.1, 1500.0);
    let up = terrain.up(0.5, 0.1);
    let camera = camera([256, 256], eye, terrain.world(0.5, 0.6, 0.0), up);
    let tiles = terrain.tiles_for(&camera, eye, 4);
    let scene = rig.scene(tiles);
    let picture = rig.picture(&scene, &camera, &environment(up, DVec3::Z));
    rig.release(scene);
    assert_picture("terrain", &picture);
}

#[test]
fn meshes_lit_textured_masked_and_blended() {
    let Some(mut rig) = rig("meshes_lit_textured_masked_and_blended") else { return };
    let checker = |alpha: u8| {
        let pixels = (0..64 * 64)
            .flat_map(|i| if (i / 8 + i / 512) % 2 == 0 { [230, 120, 40, 255] } else { [60, 90, 160, alpha] })
            .collect();
        Some(Arc::new(with_mips(64, 64, pixels)))
    };
    let place = |x: f64, y: f64, drawable: Drawable| {
        Node::transform(DAffine3::from_translation(DVec3::new(x, y, 0.0)), vec![Node::geode(vec![drawable])])
    };
    let lit = |normals: bool, texture, alpha| {
        let material = Material { texture, alpha, double_sided: alpha != AlphaMode::Opaque, ..Material::default() };
        Drawable::new(Geometry::Mesh(Arc::new(sphere(normals))), material)
    };
    let mut glass = lit(true, None, AlphaMode::Blend);
    glass.material.base_color = [0.2, 0.9, 0.4, 0.4];
    let mut ground = quad([0.0, 0.0, -1.0], [40.0, 40.0], [0.5, 0.45, 0.4, 1.0]);
    ground.material.unlit = false;
    let scene = rig.scene(Node::group(vec![
        Node::geode(vec![ground]),
        place(-1.3, 1.3, lit(true, checker(255), AlphaMode::Opaque)),
        place(1.3, 1.3, lit(false, None, AlphaMode::Opaque)),
        place(-1.3, -1.3, lit(true, checker(0), AlphaMode::Mask(0.5))),
        place(1.3, -1.3, glass),
    ]));
    let camera = camera([256, 256], DVec3::new(2.0, -7.0, 4.5), DVec3::ZERO, DVec3::Z);
    let picture = rig.picture(&scene, &camera, &Environment::default());
    rig.release(scene);
    assert_picture("meshes", &picture);
}

/// Returns a ball of radius 1, with smooth normals or without normals.
fn sphere(normals: bool) -> terrane::scene::Mesh {
    let (columns, rows) = (24u32, 12u32);
    let mut vertices = Vec::new();
    for j in 0..=rows {
        for i in 0..=columns {
            let (u, v) = (i as f32 / columns as f32, j as f32 / rows as f32);
            let (longitude, latitude) = (u * std::f32::consts::TAU, (0.5 - v) * std::f32::consts::PI);
            let p = [latitude.cos() * longitude.cos(), latitude.cos() * longitude.sin(), latitude.sin()];
            let normal = p.map(|c| (c * 127.0).round() as i8);
            let normal = if normals { [normal[0], normal[1], normal[2], 0] } else { [0; 4] };
            vertices.push(MeshVertex { position: p, uv: [u, v], normal, color: [255; 4] });
        }
    }
    let mut indices = Vec::new();
    for j in 0..rows {
        for i in 0..columns {
            let (nw, sw) = (j * (columns + 1) + i, (j + 1) * (columns + 1) + i);
            indices.extend([nw, sw, sw + 1, nw, sw + 1, nw + 1]);
        }
    }
    kit::shapes::mesh(vertices, indices)
}

/// Draws a label in the scene, and a line of text over the image by a post-render camera.
#[cfg(feature = "text")]
#[test]
fn text_in_the_scene_and_over_the_image() {
    use terrane::scene::{CameraNode, Font, Mesh, NodeKind, ReferenceFrame, RenderOrder};
    let Some(mut rig) = rig("text_in_the_scene_and_over_the_image") else { return };
    let font = Font::default();
    let label = Drawable::text(&font, "Mount Terrane\n2,917 m", 0.16, [1.0, 0.9, 0.3, 1.0]);
    let label = Node::transform(
        DAffine3::from_rotation_translation(glam::DQuat::from_rotation_y(0.5), DVec3::new(-0.4, 0.1, 0.0)),
        vec![Node::geode(vec![label])],
    );
    let hud = CameraNode {
        frame: ReferenceFrame::Absolute,
        projection: Some(glam::dcamera::rh::proj::directx::orthographic(0.0, 256.0, 0.0, 256.0, 1.0, -1.0)),
        clear_color: None,
        ..CameraNode::new(RenderOrder::PostRender(0))
    };
    let line = Drawable::text(&font, "60 frames a second", 24.0, [1.0; 4]);
    let line = Node::transform(DAffine3::from_translation(DVec3::new(8.0, 8.0, 0.0)), vec![Node::geode(vec![line])]);
    let back = Drawable::new(
        Mesh::rectangle(DVec3::new(-0.9, -0.9, -0.9), 1.8 * DVec3::X, 1.8 * DVec3::Y).into(),
        Material { base_color: [0.02, 0.05, 0.2, 1.0], unlit: true, ..Material::default() },
    );
    let scene = rig.scene(Node::group(vec![
        Node::geode(vec![back]),
        label,
        Node { children: vec![line], ..Node::new(NodeKind::Camera(Box::new(hud))) },
    ]));
    let picture = rig.picture(&scene, &kit::rig::unit_camera(256), &kit::rig::plain());
    rig.release(scene);
    assert_picture("text", &picture);
}

#[test]
fn sea_fills_the_valleys_up_to_the_horizon() {
    use terrane::scene::Water;
    let Some(mut rig) = rig("sea_fills_the_valleys_up_to_the_horizon") else { return };
    let terrain = alps();
    let (eye, up) = (terrain.world(0.5, 0.05, 2_500.0), terrain.up(0.5, 0.05));
    let target = terrain.world(0.5, 0.55, 0.0);
    let view = camera([320, 180], eye, target, up);
    let scene = {
        let nodes = terrain.tiles_for(&view, eye, 2);
        rig.scene(nodes)
    };
    let north = (target - eye).normalize();
    let mut picture = |water| {
        let environment = Environment { water, ..environment(up, north) };
        rig.picture(&scene, &view, &environment)
    };
    let dry = picture(None);
    let wet = picture(Some(Water::at(1_500.0)));
    let deep = picture(Some(Water::at(90_000.0)));
    assert_picture("water", &wet);
    let changed =
        |a: &image::RgbaImage, b: &image::RgbaImage| a.pixels().zip(b.pixels()).filter(|(a, b)| a != b).count();
    assert!((2_000..50_000).contains(&changed(&dry, &wet)), "{}", changed(&dry, &wet));
    assert_eq!(changed(&dry, &deep), 0, "the sea is invisible from below");
    rig.release(scene);
}
