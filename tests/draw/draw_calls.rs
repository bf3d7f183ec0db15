//! Draw calls, checked by counting pixels: coverage, depth, blending, batching, and no cracks between levels.

use std::sync::Arc;

use glam::dcamera::rh::proj::directx as proj;
use glam::{DAffine3, DVec3};
use kit::frames::{MAGENTA, count, srgb};
use kit::rig::{camera, plain, rig, unit_camera};
use kit::shapes::{mesh, quad, with_mips};
use kit::terrain::Terrain;
use terrane::cull::CullCamera;
use terrane::scene::{
    AlphaMode, Billboard, BillboardMode, Drawable, Geometry, Material, Mesh, MeshVertex, Node, NodeKind, Sampling,
    Texture, Topology,
};
use terrane::state::{Attribute, CullFace, FilterMode, Mode, StateSet, StateValue, WrapMode};

const RED: [f32; 4] = [1.0, 0.0, 0.0, 1.0];
const GREEN: [f32; 4] = [0.0, 1.0, 0.0, 1.0];

#[test]
fn quad_covers_exactly_its_pixels() {
    let Some(mut rig) = rig("quad_covers_exactly_its_pixels") else { return };
    // The quad has a quarter of the image's width and half its height. Its edges lie between pixel centres.
    let scene = rig.scene(Node::geode(vec![quad([0.0, 0.0, 0.0], [0.25, 0.5], RED)]));
    let picture = rig.picture(&scene, &unit_camera(256), &plain());
    assert_eq!(count(&picture, [255, 0, 0]), 64 * 128);
    assert_eq!(count(&picture, MAGENTA), 256 * 256 - 64 * 128);
    rig.release(scene);
}

#[test]
fn nearer_quad_hides_the_farther_in_either_order() {
    let Some(mut rig) = rig("nearer_quad_hides_the_farther_in_either_order") else { return };
    for flip in [false, true] {
        let mut drawables = vec![quad([0.0, 0.0, 0.5], [0.4, 0.4], RED), quad([0.0, 0.0, -0.5], [0.4, 0.4], GREEN)];
        if flip {
            drawables.reverse();
        }
        let scene = rig.scene(Node::geode(drawables));
        let picture = rig.picture(&scene, &unit_camera(256), &plain());
        assert_eq!(picture.get_pixel(128, 128).0[..3], [255, 0, 0]);
        assert_eq!(count(&picture, [0, 255, 0]), 0, "flip {flip}");
        rig.release(scene);
    }
}

#[test]
fn depth_separates_metres_at_ten_thousand_kilometres() {
    let Some(mut rig) = rig("depth_separates_metres_at_ten_thousand_kilometres") else { return };
    // Reversed-Z float depth with the near plane at 0.1 m has relative steps of 6e-8, plus the rounding of the
    // projection.
    let far = -1.0e7f32;
    let half = 1.0e6;
    let drawables = vec![quad([0.0, 0.0, far + 20.0], [half, half], RED), quad([0.0, 0.0, far], [half, half], GREEN)];
    let scene = rig.scene(Node::geode(drawables));
    let picture = rig.picture(&scene, &unit_camera(256), &plain());
    assert_eq!(count(&picture, [0, 255, 0]), 0);
    assert!(count(&picture, [255, 0, 0]) > 10_000);
    rig.release(scene);
}

#[test]
fn blended_quads_are_drawn_far_to_near_over_opaque_ones() {
    let Some(mut rig) = rig("blended_quads_are_drawn_far_to_near_over_opaque_ones") else { return };
    let blended = |z: f32, color: [f32; 4]| {
        let mut drawable = quad([0.0, 0.0, z], [0.5, 0.5], color);
        drawable.material.alpha = AlphaMode::Blend;
        drawable
    };
    // The quads are given near to far, each in a separate node, so that cull sorts them.
    let scene = rig.scene(Node::group(vec![
        Node::geode(vec![blended(0.5, [1.0, 0.0, 0.0, 0.5])]),
        Node::geode(vec![blended(-0.5, [0.0, 0.0, 1.0, 0.5])]),
        Node::geode(vec![quad([0.0, 0.0, -1.0], [0.9, 0.9], GREEN)]),
    ]));
    let picture = rig.picture(&scene, &unit_camera(256), &plain());
    // The blended value is linear, ((green / 2 + blue / 2) / 2 + red / 2), and then encoded.
    let got = picture.get_pixel(128, 128).0.map(i32::from);
    for (channel, expected) in [0.5, 0.25, 0.25].into_iter().enumerate() {
        assert!((got[channel] - i32::from(srgb(expected))).abs() <= 1, "{got:?}");
    }
    assert_eq!(got[3], 255);
    rig.release(scene);
}

#[test]
fn masked_textures_are_cut_at_their_cutoff() {
    let Some(mut rig) = rig("masked_textures_are_cut_at_their_cutoff") else { return };
    // The left half is opaque red, the right half nearly transparent.
    let pixels = (0..64 * 64).flat_map(|i| [255, 0, 0, if i % 64 < 32 { 255 } else { 20 }]).collect();
    let texture = Texture::rgba8(64, 64, vec![pixels]);
    let mut drawable = quad([0.0, 0.0, 0.0], [0.5, 0.5], [1.0; 4]);
    drawable.material.texture = Some(Arc::new(texture));
    drawable.material.alpha = AlphaMode::Mask(0.5);
    let scene = rig.scene(Node::geode(vec![drawable]));
    let picture = rig.picture(&scene, &unit_camera(256), &plain());
    assert_eq!(count(&picture, [255, 0, 0]) + count(&picture, MAGENTA), 256 * 256);
    let red = count(&picture, [255, 0, 0]) as i64;
    assert!((red - 64 * 128).abs() <= 128, "{red}");
    rig.release(scene);
}

#[test]
fn textures_wrap_by_the_mode_of_each_axis() {
    let Some(mut rig) = rig("textures_wrap_by_the_mode_of_each_axis") else { return };
    let (clamped, red, blue) = (WrapMode::ClampToEdge, [255, 0, 0, 255], [0, 0, 255, 255]);
    // The first half along one axis is red, and the image is repeated twice along each axis.
    for along in [0, 1] {
        let is_red = |i: usize| [i % 64, i / 64][along] < 32;
        let pixels: Vec<u8> = (0..64 * 64).flat_map(|i| if is_red(i) { red } else { blue }).collect();
        for (mode, expected) in
            [(clamped, [blue, blue]), (WrapMode::Repeat, [red, blue]), (WrapMode::Mirror, [blue, red])]
        {
            let wrap = if along == 0 { [mode, clamped] } else { [clamped, mode] };
            let sampling = Sampling { wrap, ..Sampling::default() };
            let texture = Texture { sampling, ..Texture::rgba8(64, 64, vec![pixels.clone()]) };
            let mut drawable = quad([0.0, 0.0, 0.0], [0.5, 0.5], [1.0; 4]);
            let Geometry::Mesh(mesh) = &mut drawable.geometry else { panic!("a mesh") };
            Arc::get_mut(mesh).unwrap().vertices.iter_mut().for_each(|v| v.uv = v.uv.map(|uv| 2.0 * uv));
            drawable.material.texture = Some(Arc::new(texture));
            let scene = rig.scene(Node::geode(vec![drawable]));
            let picture = rig.picture(&scene, &unit_camera(256), &plain());
            // The samples are at 1.25 and 1.75 along the tested axis, and at 0.75 along the other.
            let at = |place: u32| picture.get_pixel([place, 112][along], [112, place][along]).0;
            assert_eq!([at(144), at(176)], expected, "{wrap:?}");
            rig.release(scene);
        }
    }
}

#[test]
fn textures_are_filtered_by_their_sampler() {
    let Some(mut rig) = rig("textures_are_filtered_by_their_sampler") else { return };
    let (red, blue, green) = ([255, 0, 0, 255], [0, 0, 255, 255], [0, 255, 0, 255]);
    // Level 0 is red and blue in halves, the other levels are green.
    let mut mips = vec![(0..32 * 32).flat_map(|i| if i % 32 < 16 { red } else { blue }).collect::<Vec<u8>>()];
    mips.extend((1..6).map(|level| green.repeat((32 >> level) * (32 >> level))));
    let mut colors = |sampling: Sampling, half: f32| {
        let mut drawable = quad([0.0; 3], [half, half], [1.0; 4]);
        let texture = Texture { sampling, ..Texture::rgba8(32, 32, mips.clone()) };
        drawable.material.texture = Some(Arc::new(texture));
        let scene = rig.scene(Node::geode(vec![drawable]));
        let picture = rig.picture(&scene, &unit_camera(256), &plain());
        rig.release(scene);
        let all = picture.pixels().filter(|pixel| pixel.0[..3] != MAGENTA).count() as u64;
        let [red, blue, green] = [red, blue, green].map(|c| count(&picture, [c[0], c[1], c[2]]) as u64);
        [all, red, blue, green]
    };
    let linear = Sampling::default();
    let nearest = Sampling { mag: FilterMode::Nearest, ..linear };
    // Magnified: 256 x 256 pixels for 32 x 32 texels.
    let [all, red, blue, _] = colors(nearest, 1.0);
    assert_eq!([all, red, blue], [1 << 16, 1 << 15, 1 << 15], "no mixture");
    let [all, red, blue, _] = colors(linear, 1.0);
    assert!(red + blue < all, "a mixture of {all} pixels: {red}, {blue}");
    // Minified: 8 x 8 pixels.
    for min in [FilterMode::Nearest, FilterMode::Linear] {
        let [all, _, _, green] = colors(Sampling { min, mip: None, ..linear }, 1.0 / 32.0);
        assert_eq!([all, green], [64, 0], "level 0 alone: {min:?}");
        let [all, _, _, green] = colors(Sampling { min, mip: Some(FilterMode::Nearest), ..linear }, 1.0 / 32.0);
        assert_eq!(all, green, "another level: {min:?}");
    }
}

#[test]
fn back_faces_are_culled_unless_double_sided() {
    let Some(mut rig) = rig("back_faces_are_culled_unless_double_sided") else { return };
    let turned = DAffine3::from_rotation_y(std::f64::consts::PI);
    let mirrored = DAffine3::from_scale(DVec3::new(-1.0, 1.0, 1.0));
    for (transform, double_sided, pixels) in
        [(turned, false, 0), (turned, true, 128 * 128), (mirrored, false, 128 * 128)]
    {
        let mut drawable = quad([0.0, 0.0, 0.0], [0.5, 0.5], RED);
        drawable.material.double_sided = double_sided;
        let scene = rig.scene(Node::transform(transform, vec![Node::geode(vec![drawable])]));
        let picture = rig.picture(&scene, &unit_camera(256), &plain());
        assert_eq!(count(&picture, [255, 0, 0]), pixels, "{transform:?}");
        rig.release(scene);
    }
}

#[test]
fn lines_and_points_are_drawn() {
    let Some(mut rig) = rig("lines_and_points_are_drawn") else { return };
    let vertex = |x: f32, y: f32| MeshVertex { position: [x, y, 0.0], color: [255; 4], ..MeshVertex::default() };
    let material = Material { base_color: RED, unlit: true, ..Material::default() };
    let mut line = mesh(vec![vertex(-0.5, 0.002), vertex(0.5, 0.002)], vec![0, 1]);
    line.topology = Topology::Lines;
    let mut points = mesh(vec![vertex(-0.498, 0.502), vertex(0.502, 0.502), vertex(0.502, -0.498)], vec![0, 1, 2]);
    points.topology = Topology::Points;
    let drawables = [line, points].map(|m| Drawable::new(Geometry::Mesh(Arc::new(m)), material.clone())).to_vec();
    let scene = rig.scene(Node::geode(drawables));
    let camera = unit_camera(256);
    let stats = rig.draw(&scene, &camera, &plain());
    assert_eq!((stats.points, stats.triangles, stats.draw_calls), (3, 0, 2));
    let picture = rig.read_back();
    let red = count(&picture, [255, 0, 0]);
    assert!((127..=131).contains(&(red - 3)), "{red}");
    rig.release(scene);
}

#[test]
fn equal_meshes_are_one_draw_call_and_states_are_set_once() {
    let Some(mut rig) = rig("equal_meshes_are_one_draw_call_and_states_are_set_once") else { return };
    let one = quad([0.0; 3], [0.01, 0.01], RED);
    let other = quad([0.0; 3], [0.02, 0.01], GREEN);
    let place = |i: u32, drawable: &Drawable| {
        let offset = DVec3::new(f64::from(i % 10) * 0.1 - 0.5, f64::from(i / 10) * 0.1 - 0.5, 0.0);
        Node::transform(DAffine3::from_translation(offset), vec![Node::geode(vec![drawable.clone()])])
    };
    // The drawables are interleaved, and below two state sets that differ only in color.
    let tinted = |i: u32, node: Node| {
        let color = if i.is_multiple_of(3) { [1.0; 4] } else { [0.5, 0.5, 0.5, 1.0] };
        node.with_state_set(Arc::new(StateSet { color: Some(color), ..StateSet::default() }))
    };
    let nodes = (0..100).map(|i| tinted(i, place(i, if i % 2 == 0 { &one } else { &other }))).collect();
    let scene = rig.scene(Node::group(nodes));
    let stats = rig.draw(&scene, &unit_camera(256), &plain());
    assert_eq!(stats.leaves, 100);
    assert_eq!(stats.triangles, 200);
    assert_eq!(stats.draw_calls, 1, "small meshes use vertex pulling");
    assert_eq!(stats.state_changes, 4, "frame, pipeline, textures and meshes are bound once");
    assert_eq!(stats.state_changes_skipped, 0, "both meshes have the same bindings");
    rig.release(scene);
}

#[test]
fn large_meshes_are_instanced_or_drawn_by_one_indirect_call() {
    let Some(mut rig) = rig("large_meshes_are_instanced_or_drawn_by_one_indirect_call") else { return };
    let ball = |i: u32| {
        let material = Material { base_color: [1.0, 0.0, 0.0, 1.0], unlit: true, ..Material::default() };
        let center = DVec3::new(f64::from(i % 4) * 0.5 - 0.75, f64::from(i / 4) * 0.5 - 0.75, 0.0);
        Drawable::new(Mesh::sphere(center, 0.2, 12).into(), material)
    };
    // One mesh is drawn a hundred times at one position.
    let one = ball(5);
    let scene = rig.scene(Node::group((0..100).map(|_| Node::geode(vec![one.clone()])).collect()));
    let stats = rig.draw(&scene, &unit_camera(256), &plain());
    assert_eq!((stats.leaves, stats.draw_calls, stats.state_changes), (100, 1, 6));
    rig.release(scene);
    // Sixteen meshes are drawn, each at its own position.
    let scene = rig.scene(Node::group((0..16).map(|i| Node::geode(vec![ball(i)])).collect()));
    let picture = rig.picture(&scene, &unit_camera(256), &plain());
    for i in 0..16 {
        let at = |k: u32| 32 + 64 * k;
        assert_eq!(picture.get_pixel(at(i % 4), at(i / 4)).0[..3], [255, 0, 0], "ball {i}");
    }
    let stats = rig.draw(&scene, &unit_camera(256), &plain());
    let is_one_call = rig.ctx.device().features().contains(wgpu::Features::INDIRECT_FIRST_INSTANCE);
    assert_eq!((stats.leaves, stats.draw_calls), (16, if is_one_call { 1 } else { 16 }));
    rig.release(scene);
}

#[test]
fn one_frame_spans_a_decimetre_to_forty_thousand_kilometres() {
    let Some(mut rig) = rig("one_frame_spans_a_decimetre_to_forty_thousand_kilometres") else { return };
    // Squares lie behind each other, each a strip lower than the one before, drawn from near to far and from far to
    // near.
    let at = |distance: f64, row: f64, color| {
        let half = [0.4 * distance as f32, 0.04 * distance as f32];
        let square = quad([0.0, (distance * (0.3 - 0.1 * row)) as f32, 0.0], half, color);
        Node::transform(DAffine3::from_translation(DVec3::new(0.0, 0.0, -distance)), vec![Node::geode(vec![square])])
    };
    let distances = [0.12, 1.0, 50.0, 4.0e4, 4.0e7];
    let rows: Vec<Node> = distances.iter().enumerate().map(|(i, d)| at(*d, i as f64, RED)).collect();
    // Squares that are farther by a thousandth, over all rows, must be hidden by the red ones at each distance.
    let behind = distances.iter().enumerate().map(|(i, d)| at(d * 1.001, i as f64, GREEN));
    for nodes in [rows.iter().cloned().chain(behind.clone()).collect::<Vec<_>>(), behind.chain(rows.clone()).collect()]
    {
        let scene = rig.scene(Node::group(nodes));
        let view = camera([256, 256], DVec3::ZERO, DVec3::NEG_Z, DVec3::Y);
        let picture = rig.picture(&scene, &view, &plain());
        rig.release(scene);
        for row in 0..5 {
            // With 1 radian over 256 pixels, tan(0.5) corresponds to 128 pixels.
            let y = 128.0 - (0.3 - 0.1 * f64::from(row)) / 0.5f64.tan() * 128.0;
            assert_eq!(picture.get_pixel(128, y as u32).0[..3], [255, 0, 0], "row {row}");
        }
        assert!(count(&picture, [0, 255, 0]) < 250, "{}", count(&picture, [0, 255, 0]));
    }
}

#[test]
fn height_tiles_of_a_block_are_one_draw_call() {
    let Some(mut rig) = rig("height_tiles_of_a_block_are_one_draw_call") else { return };
    let terrain = terrain(false);
    let tiles = (0..16).map(|i| terrain.tile(2, i % 4, i / 4)).collect();
    let scene = rig.scene(Node::group(tiles));
    let camera = camera([256, 256], terrain.world(0.5, 0.4, 30_000.0), terrain.world(0.5, 0.5, 0.0), DVec3::Z);
    let stats = rig.draw(&scene, &camera, &plain());
    assert_eq!((stats.leaves, stats.draw_calls, stats.state_changes), (16, 1, 4));
    assert_eq!(stats.triangles, 16 * (64 * 64 * 2 + 64 * 4 * 2));
    rig.release(scene);
}

fn terrain(textured: bool) -> Terrain {
    Terrain { west: 0.13, south: 0.8, width: 0.006, relief_m: 2600.0, root_error_m: 250.0, textured }
}

/// A tile of level 1 is beside tiles of level 2, at many distances from the eye and over three lines of ground. The finer level
/// is drawn only within the range of the coarser one, as cull does. The morph then closes the edges: no background is visible
/// between the tiles, also without skirts, and also where no back of a far slope could hide a crack.
#[test]
fn no_background_is_visible_between_levels() {
    background_between_tiles("no_background_is_visible_between_levels", &Terrain::tiles_for);
}

/// The same where each tile has its own error, so that tiles of several levels lie beside each other at any distance.
#[test]
fn no_background_is_visible_between_tiles_with_their_own_errors() {
    background_between_tiles(
        "no_background_is_visible_between_tiles_with_their_own_errors",
        &Terrain::uneven_tiles_for,
    );
}

fn background_between_tiles(test: &'static str, tiles: &dyn Fn(&Terrain, &CullCamera, DVec3, u32) -> Node) {
    let Some(mut rig) = rig(test) else { return };
    let terrain = terrain(false);
    let front_only =
        StateSet::default().with(Attribute::CullFace(CullFace::Back)).with_mode(Mode::CullFace, StateValue::ON);
    let front_only = Arc::new(front_only);
    let mut leaks_with = |skirts: bool, morph: bool| {
        let mut leaks = 0;
        for (line, step) in
            [0.3, 0.5, 0.7].into_iter().flat_map(|line| (0..24).step_by(3).map(move |step| (line, step)))
        {
            // The eye is low over the western edge and looks east across the terrain, from farther and farther away.
            // The finer tiles pass through all stages of their morph.
            let eye_u = 0.3 - 0.02 * f64::from(step);
            let eye = terrain.world(eye_u, line, 4_500.0 + 700.0 * f64::from(step));
            let up = terrain.up(eye_u, line);
            let mut camera = camera([256, 256], eye, terrain.world(0.5, line, 0.0), up);
            camera.settings.max_sse_px = 4.0;
            let mut root = tiles(&terrain, &camera, eye, 4);
            if !skirts {
                without_skirts(&mut root);
                root = root.with_state_set(front_only.clone());
            }
            if !morph {
                without_morph(&mut root);
            }
            let scene = rig.scene(root);
            let picture = rig.picture(&scene, &camera, &plain());
            rig.release(scene);
            // Counted background has terrain on both sides of it along the row or the column.
            leaks += enclosed(&picture);
        }
        leaks
    };
    // Without skirts, a pixel may fall between two edges that differ by rounding.
    let (skirts, none, no_morph) = (leaks_with(true, true), leaks_with(false, true), leaks_with(false, false));
    assert!(skirts == 0 && none <= 2, "{skirts} pixels of background with skirts, {none} without");
    assert!(no_morph > 40, "{no_morph} pixels of background without skirts and morph: cracks are not seen");
}

/// Returns the heights of a tile and those below it, without morphing into coarser levels.
fn without_morph(node: &mut Node) {
    if let terrane::scene::NodeKind::Geode(drawables) = &mut node.kind {
        for drawable in drawables {
            if let Geometry::Height(tile) = &mut drawable.geometry {
                Arc::make_mut(tile).coarser_errors_m.clear();
            }
        }
    }
    node.children.iter_mut().for_each(without_morph);
}

#[test]
fn orthographic_views_morph_heights_by_their_error() {
    let Some(mut rig) = rig("orthographic_views_morph_heights_by_their_error") else { return };
    let terrain = terrain(true);
    let mut seen = |above_m: f64, max_sse_px: f64, morphs: bool| {
        let mut camera = camera([256, 256], terrain.world(0.5, 0.5, above_m), terrain.world(0.5, 0.5, 0.0), DVec3::Z);
        // A pixel is 60 m wide, so the root's error of 250 m projects to 4.2 pixels.
        camera.clip_from_eye = proj::orthographic(-7_680.0, 7_680.0, -7_680.0, 7_680.0, 1e6, 1.0);
        camera.settings.max_sse_px = max_sse_px;
        let mut root = terrain.tile(1, 0, 0);
        if !morphs {
            without_morph(&mut root);
        }
        let scene = rig.scene(root);
        let picture = rig.picture(&scene, &camera, &plain());
        rig.release(scene);
        picture
    };
    let own = seen(20_000.0, 2.0, false);
    for above_m in [20_000.0, 200_000.0] {
        let (near, far) = (differing(&own, &seen(above_m, 2.0, true)), differing(&own, &seen(above_m, 6.0, true)));
        assert!(near < 300 && far > 5_000, "{above_m} m: {near} and {far} pixels");
    }
}

fn without_skirts(node: &mut Node) {
    if let terrane::scene::NodeKind::Geode(drawables) = &mut node.kind {
        for drawable in drawables {
            if let Geometry::Height(tile) = &mut drawable.geometry {
                Arc::make_mut(tile).skirt_m = 0.0;
            }
        }
    }
    node.children.iter_mut().for_each(without_skirts);
}

/// Counts background pixels that are not connected with the border of the image.
fn enclosed(picture: &image::RgbaImage) -> usize {
    let (w, h) = picture.dimensions();
    let is_background = |x: u32, y: u32| picture.get_pixel(x, y).0[..3] == MAGENTA;
    let mut outside = vec![false; (w * h) as usize];
    let mut stack: Vec<(u32, u32)> = (0..w).map(|x| (x, 0)).filter(|&(x, y)| is_background(x, y)).collect();
    while let Some((x, y)) = stack.pop() {
        let seen = &mut outside[(y * w + x) as usize];
        if *seen {
            continue;
        }
        *seen = true;
        for (nx, ny) in [(x.wrapping_sub(1), y), (x + 1, y), (x, y.wrapping_sub(1)), (x, y + 1)] {
            if nx < w && ny < h && is_background(nx, ny) {
                stack.push((nx, ny));
            }
        }
    }
    let mut enclosed = 0;
    for y in 0..h {
        for x in 0..w {
            // The bottom rows may show the near end of the ground.
            if is_background(x, y) && !outside[(y * w + x) as usize] {
                enclosed += 1;
            }
        }
    }
    enclosed
}

#[test]
fn north_of_textures_is_at_the_top() {
    let Some(mut rig) = rig("north_of_textures_is_at_the_top") else { return };
    // The northern half is red, the southern half green.
    let pixels: Vec<u8> =
        (0..64 * 64).flat_map(|i| if i < 32 * 64 { [255, 0, 0, 255] } else { [0, 255, 0, 255] }).collect();
    let terrain = terrain(false);
    let mut root = terrain.tile(0, 0, 0);
    let mut paint = |node: &mut Node| {
        if let terrane::scene::NodeKind::Geode(drawables) = &mut node.kind
            && let Geometry::Height(tile) = &mut drawables[0].geometry
        {
            Arc::make_mut(tile).texture = Some(Arc::new(with_mips(64, 64, pixels.clone())));
            drawables[0].material.unlit = true;
        }
    };
    root.children.iter_mut().for_each(&mut paint);
    let scene = rig.scene(root);
    // The camera looks down from above, with north up.
    let eye = terrain.world(0.5, 0.5, 60_000.0);
    let camera = camera([256, 256], eye, terrain.world(0.5, 0.5, 0.0), DVec3::Z);
    let picture = rig.picture(&scene, &camera, &plain());
    assert_eq!(picture.get_pixel(128, 90).0[..3], [255, 0, 0]);
    assert_eq!(picture.get_pixel(128, 166).0[..3], [0, 255, 0]);
    rig.release(scene);
}

#[test]
fn billboards_show_their_full_face() {
    let Some(mut rig) = rig("billboards_show_their_full_face") else { return };
    let rig = &mut *rig;
    let flat = || {
        let mesh = Mesh::rectangle(DVec3::new(-0.5, 0.0, -0.5), DVec3::X, DVec3::Z);
        let mut drawable = quad([0.0; 3], [0.5; 2], RED);
        drawable.geometry = mesh.into();
        drawable
    };
    // The eye is above and to the side, 8 m away, where a metre covers 256 / (2 * 8 * tan(0.5)) pixels.
    let eye = DVec3::new(1.0, -1.0, 0.9).normalize() * 8.0;
    let view = camera([256, 256], eye, DVec3::ZERO, DVec3::Z);
    let metre_px = 128.0 / (8.0 * 0.5f64.tan());
    let mut covered = |node: Node| {
        let scene = rig.scene(node);
        let picture = rig.picture(&scene, &view, &plain());
        rig.release(scene);
        count(&picture, [255, 0, 0]) as f64 / (metre_px * metre_px)
    };
    let turned = |mode| {
        let billboard = Billboard { mode, drawables: vec![(DVec3::ZERO, flat())], ..Billboard::default() };
        Node::new(NodeKind::Billboard(Box::new(billboard)))
    };
    let still = covered(Node::geode(vec![flat()]));
    assert!(still < 0.65, "{still}");
    for mode in [BillboardMode::PointRotEye, BillboardMode::PointRotWorld] {
        let whole = covered(turned(mode));
        assert!((0.95..1.05).contains(&whole), "{mode:?}: {whole}");
    }
    // Rotation about the upright axis only leaves a foreshortening by the height of the eye.
    let upright = covered(turned(BillboardMode::AxialRot { axis: DVec3::Z }));
    let expected = (1.0f64 - (0.9 * 0.9) / (2.0 + 0.9 * 0.9)).sqrt();
    assert!((upright - expected).abs() < 0.06, "{upright} instead of {expected}");
}

/// Returns the number of pixels whose colors differ by more than a few steps.
fn differing(a: &image::RgbaImage, b: &image::RgbaImage) -> usize {
    a.pixels().zip(b.pixels()).filter(|(a, b)| (0..3).any(|c| a.0[c].abs_diff(b.0[c]) > 4)).count()
}

#[test]
fn uneven_scales_and_mirrors_are_lit_correctly() {
    let Some(mut rig) = rig("uneven_scales_and_mirrors_are_lit_correctly") else { return };
    let ball = Mesh::sphere(DVec3::ZERO, 0.6, 48);
    let mut picture = |stretch: DVec3, transform: DAffine3| {
        let mut mesh = ball.clone();
        for vertex in &mut mesh.vertices {
            let position = glam::Vec3::from(vertex.position).as_dvec3();
            vertex.position = (stretch * position).as_vec3().to_array();
            let normal = (position / stretch).normalize().as_vec3() * 127.0;
            vertex.normal = [normal.x.round() as i8, normal.y.round() as i8, normal.z.round() as i8, 0];
        }
        let drawable = Drawable::new(
            Mesh::new(mesh.vertices, mesh.indices.to_vec(), Topology::Triangles).into(),
            Material::default(),
        );
        let scene = rig.scene(Node::transform(transform, vec![Node::geode(vec![drawable])]));
        let seen = camera([256, 256], DVec3::new(0.9, -1.3, 0.7), DVec3::ZERO, DVec3::Z);
        let picture = rig.picture(&scene, &seen, &plain());
        rig.release(scene);
        picture
    };
    let flat = DVec3::new(1.0, 1.0, 0.3);
    let itself = picture(flat, DAffine3::IDENTITY);
    let covered = itself.pixels().filter(|p| p.0[..3] != MAGENTA).count();
    assert!(covered > 5_000, "{covered}");
    for scale in [flat, flat * DVec3::new(-1.0, 1.0, 1.0)] {
        let scaled = picture(DVec3::ONE, DAffine3::from_scale(scale));
        // Normals of 8 bits are rounded before and after the rotation.
        assert!(differing(&itself, &scaled) < covered / 50, "{scale}: {} of {covered}", differing(&itself, &scaled));
    }
    // The same with scales far from 1 and the same shape.
    for size in [1e-4, 1e4] {
        let scaled = picture(flat / size, DAffine3::from_scale(DVec3::splat(size)));
        assert!(differing(&itself, &scaled) < covered / 50, "{size}: {} of {covered}", differing(&itself, &scaled));
    }
}

#[test]
fn quantized_meshes_take_16_bytes_per_vertex_and_look_the_same() {
    let Some(mut rig) = rig("quantized_meshes_take_16_bytes_per_vertex_and_look_the_same") else { return };
    let ball = Mesh::sphere(DVec3::ZERO, 0.8, 96);
    let count = ball.vertices.len();
    let drawn = [true, false].map(|quantized| {
        let floats = |of: [i8; 4]| [0, 1, 2].map(|k| f32::from(of[k]) / 127.0);
        let glb = terrane::formats::writers::GlbMesh {
            positions: ball.vertices.iter().map(|v| v.position).collect(),
            normals: ball.vertices.iter().map(|v| floats(v.normal)).collect(),
            uvs: vec![[0.25, 0.75]; count],
            indices: ball.indices.iter().map(|i| *i as u16).collect(),
            base_color: [0.8, 0.6, 0.4, 1.0],
            quantized,
            ..Default::default()
        };
        let content = terrane::formats::Content {
            uri: "/ball.glb".into(),
            bytes: terrane::formats::writers::write_glb(&glb),
            reader_data: None,
            companions: Vec::new(),
        };
        let options = terrane::formats::ReadOptions::for_root("/t.json", terrane::fetch::Limits::default());
        let node = terrane::formats::decode_node(content, &options).unwrap();
        let before = rig.ctx.bytes_in_use();
        let scene = rig.scene(node);
        let bytes = rig.ctx.bytes_in_use() - before;
        let seen = camera([256, 256], DVec3::new(2.0, -1.0, 1.5), DVec3::ZERO, DVec3::Z);
        let stats = rig.draw(&scene, &seen, &plain());
        assert_eq!((stats.leaves, stats.triangles), (1, ball.indices.len() as u64 / 3));
        let picture = rig.read_back();
        rig.release(scene);
        (bytes, picture)
    });
    let [(few, quantized), (more, plain)] = &drawn;
    // Slots of vertices are up to an eighth larger than their content.
    assert!(*more - *few >= 4 * count as u64, "{more} {few} bytes of {count} vertices");
    let covered = plain.pixels().filter(|p| p.0[..3] != MAGENTA).count();
    assert!(
        covered > 10_000 && differing(plain, quantized) < covered / 100,
        "{} of {covered}",
        differing(plain, quantized)
    );
}
