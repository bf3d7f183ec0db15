//! Pictures compared with references: terrain on the globe with sky and haze, and meshes.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on shall panic")]

mod gpu_support;

use std::sync::Arc;

use glam::{DAffine3, DVec3};
use gpu_support::{Terrain, assert_picture, camera, new_rig, quad, rig, with_mips};
use terrane::draw::Environment;
use terrane::scene::{AlphaMode, Drawable, Geometry, Material, MeshVertex, Node, NodeKind, Page, Scene};

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
        Drawable { geometry: Geometry::Mesh(Arc::new(sphere(normals))), material }
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

/// A ball of radius 1, with smooth normals or none.
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
    gpu_support::mesh(vertices, indices)
}

/// Not a test: large pictures to look at, in $LOOK_DIR.
#[test]
#[ignore = "writes large pictures for people"]
fn look() {
    let Some(mut rig) = new_rig([1280, 720]) else { return };
    let folder = std::path::PathBuf::from(std::env::var("LOOK_DIR").unwrap_or_else(|_| "/tmp".into()));
    let globe =
        Terrain { west: -0.75, south: -0.75, width: 1.5, relief_m: 60_000.0, root_error_m: 2e5, textured: true };
    for (name, from, above_m, to) in [
        ("globe", (0.3, 0.3), 9_000_000.0, (0.5, 0.5)),
        ("limb", (0.3, 0.3), 700_000.0, (0.5, 0.5)),
        ("valley", (0.5, 0.05), 700.0, (0.6, 0.5)),
        ("high", (0.5, -0.2), 20_000.0, (0.5, 0.5)),
        ("space", (0.5, -6.0), 300_000.0, (0.5, 0.5)),
        ("down", (0.52, 0.52), 6_000.0, (0.521, 0.5305)),
    ] {
        let terrain = if above_m > 500_000.0 { &globe } else { &alps() };
        let eye = terrain.world(from.0, from.1, above_m);
        let up = terrain.up(from.0, from.1);
        let camera = camera([1280, 720], eye, terrain.world(to.0, to.1, 0.0), up);
        let tiles = terrain.tiles_for(&camera, eye, 6);
        let count = tiles.children.len();
        let scene = rig.scene(tiles);
        let environment = environment(up, DVec3::Z);
        for _ in 0..4 {
            rig.draw(&scene, &camera, &environment);
        }
        let start = std::time::Instant::now();
        let stats = rig.draw(&scene, &camera, &environment);
        let picture = rig.renderer.read_back(&mut rig.ctx).unwrap();
        println!("{name}: {count} tiles, {:?}, draw and read back {:?}", stats, start.elapsed());
        picture.save(folder.join(format!("look-{name}.png"))).unwrap();
        rig.release(scene);
    }
}

/// Not a test: what tiles cost, printed.
#[test]
#[ignore = "measures"]
fn measure() {
    let Some(mut rig) = new_rig([1280, 720]) else { return };
    let terrain = alps();
    let (mut run_max, mut draw_max) = (0.0f64, 0.0f64);
    let mut scene = Scene::new();
    let eye = terrain.world(0.5, 0.5, 60_000.0);
    let camera = camera([1280, 720], eye, terrain.world(0.5, 0.5, 0.0), DVec3::Z);
    let environment = environment(terrain.up(0.5, 0.5), DVec3::Z);
    let texture = Arc::new(with_mips(256, 256, vec![128; 256 * 256 * 4]));
    let mut times = Vec::new();
    for i in 0..64u32 {
        let mut root = terrain.tile(3, i % 8, i / 8);
        if let NodeKind::Geode(drawables) = &mut root.children[0].kind
            && let Geometry::Height(tile) = &mut drawables[0].geometry
        {
            Arc::make_mut(tile).texture = Some(texture.clone());
        }
        let mut page = Page::from_node(root).unwrap();
        let start = std::time::Instant::now();
        let compiled = rig.compile(page.take_drawables());
        let run = start.elapsed().as_secs_f64() * 1e3;
        run_max = run_max.max(run);
        page.set_draw_slots(0, compiled.slots);
        scene.add_root(page);
        let start = std::time::Instant::now();
        rig.draw(&scene, &camera, &environment);
        let draw = start.elapsed().as_secs_f64() * 1e3;
        draw_max = draw_max.max(if i > 2 { draw } else { 0.0 });
        times.push((run, draw));
    }
    for (i, (run, draw)) in times.iter().enumerate() {
        if i < 4 || i % 16 < 2 {
            println!("tile {i}: compile {run:.2} ms, draw {draw:.2} ms");
        }
    }
    println!("slowest compile {run_max:.1} ms, draw {draw_max:.1} ms");
    rig.release(scene);
    // A view from the ground, then one from above where every vertex has morphed as far as it goes.
    let eye = terrain.world(0.5, 0.05, 700.0);
    let low = gpu_support::camera([1280, 720], eye, terrain.world(0.6, 0.5, 0.0), terrain.up(0.5, 0.05));
    let nodes = (0..64).map(|i| terrain.tile(3, i % 8, i / 8)).collect();
    let scenes = [("low", low, terrain.tiles_for(&low, eye, 6)), ("high", camera, Node::group(nodes))];
    for (name, camera, nodes) in scenes {
        let scene = rig.scene(nodes);
        for _ in 0..4 {
            rig.draw(&scene, &camera, &environment);
        }
        let mut stats = terrane::draw::DrawStats::default();
        let mut gpu_ms = f64::INFINITY;
        let cpu_before = cpu_seconds();
        for _ in 0..30 {
            stats = rig.draw(&scene, &camera, &environment);
            gpu_ms = gpu_ms.min(stats.gpu_ms.unwrap_or(f64::INFINITY));
        }
        // A software adapter's work is processor time, which other programs do not blur as they do the clock.
        let cpu_ms = (cpu_seconds() - cpu_before) * 1e3 / 30.0;
        println!("{name}: {} leaves, {cpu_ms:.1} ms of processor, best {gpu_ms:.1} ms on the adapter", stats.leaves);
        rig.release(scene);
    }
}

/// Processor time of this process, where /proc tells (100 ticks a second).
fn cpu_seconds() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let fields: Vec<f64> = stat.rsplit(')').next().unwrap_or("").split(' ').filter_map(|f| f.parse().ok()).collect();
    // After the name and the state letter: utime and stime are the 11th and 12th.
    fields.get(10).zip(fields.get(11)).map_or(0.0, |(user, system)| (user + system) / 100.0)
}
