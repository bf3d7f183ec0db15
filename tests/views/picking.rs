//! A pick hits the ground exactly where the image shows it, at the depth at which it is drawn. Needs a GPU; a software
//! adapter suffices.

use std::sync::Arc;

use glam::{DAffine3, DVec3};
use image::RgbaImage;
use kit::tile_sets::{generate, show_grid};
use kit::viewer::{Settle, offscreen};

use terrane::pager::PagerConfig;
use terrane::scene::{Drawable, Geometry, IntersectionLimit, Material, Mesh, Node, Page, Sky};
use terrane::viewer::{KEY_COLOR, ThreadingModel, ViewFrom, Viewer, ViewerConfig};

const SIZE_PX: [u32; 2] = [320, 180];

fn viewer() -> Option<Viewer> {
    let config = ViewerConfig {
        size_px: SIZE_PX,
        threading: ThreadingModel::SingleThreaded,
        adapter: kit::adapter(),
        max_sse_px: 1.0,
        pager: PagerConfig { blocking: true, build_kd_trees: true, ..PagerConfig::default() },
        ..ViewerConfig::default()
    };
    offscreen(&config)
}

fn is_ground(picture: &RgbaImage, x: u32, y: u32) -> bool {
    picture.get_pixel(x, y).0[..3] != KEY_COLOR
}

/// Returns small balls of about 5 x 5 pixels at given positions.
fn balls(viewer: &Viewer, places: &[DVec3], beyond: f64) -> Page {
    let eye = viewer.view().camera.eye();
    let px_per_m = viewer.view().camera.eye_point(SIZE_PX).px_per_radian;
    let ball = |place: &DVec3| {
        let radius_m = 2.5 * place.distance(eye) / px_per_m;
        let at = *place + (*place - eye).normalize() * radius_m * beyond;
        let mesh = Mesh::sphere(DVec3::ZERO, radius_m, 12);
        let material = Material { base_color: [0.0, 1.0, 1.0, 1.0], unlit: true, ..Material::default() };
        let drawable = Drawable::new(Geometry::Mesh(Arc::new(mesh)), material);
        Node::transform(DAffine3::from_translation(at), vec![Node::geode(vec![drawable])])
    };
    Page::from_node(Node::group(places.iter().map(ball).collect())).unwrap()
}

#[test]
fn picks_hit_the_visible_ground() {
    let folder = tempfile::tempdir().unwrap();
    for content in [terrane_data_gen::ContentKind::Height, terrane_data_gen::ContentKind::Mesh] {
        let set = generate(&folder.path().join(format!("{content:?}")), |args| {
            (args.levels, args.seed, args.size) = (Some(4), 3, 20_000.0);
            show_grid(args, content);
        });
        let Some(mut viewer) = viewer() else { return };
        viewer.load(&set).unwrap();
        // The eye is inside of the set, so that no outer skirt is visible.
        let bounds = *viewer.bounds().unwrap();
        let view = ViewFrom { heading: 0.3, pitch: -0.2, range_m: Some(0.25 * bounds.sphere.radius_m) };
        viewer.view_mut().camera.world_from_eye = bounds.first_camera(&view);
        viewer.view_mut().environment.sky = Sky::Background(KEY_COLOR);
        viewer.view_mut().environment.fog.enabled = false;
        viewer.frame().unwrap();
        let picture = viewer.read_back().unwrap();

        let (mut judged, mut sky) = (0, 0);
        let mut places = Vec::new();
        for y in (3..SIZE_PX[1] - 3).step_by(12) {
            for x in (3..SIZE_PX[0] - 3).step_by(16) {
                let hits =
                    viewer.compute_intersections(f64::from(x) + 0.5, f64::from(y) + 0.5, IntersectionLimit::Nearest);
                let around = [(-1, 0), (1, 0), (0, -1), (0, 1), (-1, -1), (1, 1), (-1, 1), (1, -1)];
                let near = |(i, j): (i32, i32)| is_ground(&picture, (x as i32 + i) as u32, (y as i32 + j) as u32);
                let shown = is_ground(&picture, x, y);
                // At edges of hills either side is accepted.
                if around.into_iter().all(|n| near(n) == shown) {
                    judged += 1;
                    sky += u32::from(!shown);
                    assert_eq!(!hits.is_empty(), shown, "{content:?} {x} {y}");
                }
                if let Some(hit) = hits.first() {
                    // The point lies behind its pixel.
                    let in_eye = viewer.view().camera.world_from_eye.inverse().transform_point3(hit.world_point());
                    let clip = viewer.view().camera.clip_from_eye(SIZE_PX, 0.1) * in_eye.extend(1.0);
                    let at = (160.0 * (1.0 + clip.x / clip.w), 90.0 * (1.0 - clip.y / clip.w));
                    assert!((at.0 - f64::from(x) - 0.5).abs() < 1e-3 && (at.1 - f64::from(y) - 0.5).abs() < 1e-3);
                    assert!((hit.ratio - in_eye.length()).abs() < 1e-6 * hit.ratio);
                    places.push((x, y, hit.world_point()));
                }
            }
        }
        assert!(judged > 180 && sky > 12 && places.len() > 100, "{judged} {sky} {}", places.len());

        // Balls at picked points are half in the ground and visible. Balls behind them are hidden, except where the
        // ground is seen along its slope.
        let points: Vec<DVec3> = places.iter().map(|p| p.2).collect();
        for (beyond, least, most) in [(-0.2, 0.99, 1.0), (3.0, 0.0, 0.15)] {
            let root = viewer.add_root(balls(&viewer, &points, beyond)).unwrap();
            viewer.settle(3);
            let with_balls = viewer.read_back().unwrap();
            let seen = places.iter().filter(|(x, y, _)| {
                let [r, g, b, _] = with_balls.get_pixel(*x, *y).0;
                r < 100 && g > 180 && b > 180
            });
            let share = seen.count() as f64 / places.len() as f64;
            assert!((least..=most).contains(&share), "{content:?} {beyond}: {share}");
            viewer.remove_root(root).unwrap();
        }
    }
}

#[test]
fn picks_below_other_projections_hit_visible_drawables() {
    use glam::dcamera::rh::proj::directx as proj;
    use terrane::scene::{CameraNode, NodeKind, ReferenceFrame, RenderOrder};
    let Some(mut viewer) = viewer() else { return };
    // Each has another colour, in the order of the page's drawables.
    let colors = [[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0], [0, 1, 1], [1, 0, 1], [1, 1, 1]];
    let mut next = colors.iter();
    let mut square = |center: DVec3, half: f64| {
        let color = next.next().unwrap().map(|c| c as f32);
        let corner = center - DVec3::new(half, half, 0.0);
        let mesh = Mesh::rectangle(corner, DVec3::X * 2.0 * half, DVec3::Y * 2.0 * half);
        let base_color = [color[0], color[1], color[2], 1.0];
        let material = Material { base_color, unlit: true, double_sided: true, ..Material::default() };
        Node::geode(vec![Drawable::new(Geometry::Mesh(Arc::new(mesh)), material)])
    };
    let below = |kind: NodeKind, children: Vec<Node>| Node { children, ..Node::new(kind) };
    let overlay = |order, viewport_px| CameraNode {
        frame: ReferenceFrame::Absolute,
        projection: Some(proj::orthographic(-1.0, 1.0, -1.0, 1.0, 10.0, 0.0)),
        viewport_px,
        clear_color: None,
        ..CameraNode::new(order)
    };
    // The square is in the eye's frame, ten units in front of it, so that the eye may stay at the origin.
    let root = Node::group(vec![
        square(DVec3::new(0.0, 0.0, -10.0), 2.5),
        // Seen through a longer lens, behind and in front of the first square.
        below(
            NodeKind::Projection(proj::perspective_infinite_reverse(0.4, 320.0 / 180.0, 0.1)),
            vec![square(DVec3::new(1.5, 0.5, -12.0), 1.0), square(DVec3::new(-1.0, -0.5, -8.0), 0.6)],
        ),
        Node::camera(
            overlay(RenderOrder::Nested, Some([10, 100, 100, 70])),
            vec![square(DVec3::new(0.0, 0.0, -1.0), 0.8)],
        ),
        // Two cameras draw over everything, the one with the higher number over the other.
        Node::camera(overlay(RenderOrder::PostRender(2), None), vec![square(DVec3::new(0.7, 0.7, -9.0), 0.2)]),
        Node::camera(overlay(RenderOrder::PostRender(1), None), vec![square(DVec3::new(0.6, 0.6, -0.5), 0.25)]),
        Node::camera(
            overlay(RenderOrder::PostRender(0), Some([200, 100, 80, 60])),
            vec![square(DVec3::new(0.5, 0.0, -5.0), 1.0)],
        ),
    ]);
    viewer.view_mut().camera.world_from_eye = DAffine3::IDENTITY;
    viewer.view_mut().environment.sky = Sky::Background([0, 0, 0]);
    viewer.view_mut().environment.fog.enabled = false;
    let page = Page::from_node(root).unwrap();
    viewer.add_root(page).unwrap();
    viewer.view_mut().camera.world_from_eye = DAffine3::IDENTITY;
    viewer.settle(3);
    let picture = viewer.read_back().unwrap();
    if let Some(folder) = std::env::var_os("KEEP_IMAGES") {
        picture.save(std::path::Path::new(&folder).join("window-picks.png")).unwrap();
    }
    let color = |x: u32, y: u32| picture.get_pixel(x, y).0[..3].iter().map(|c| i32::from(*c > 128)).collect::<Vec<_>>();
    let mut seen = [0; 7];
    for y in (2..SIZE_PX[1] - 2).step_by(2) {
        for x in (2..SIZE_PX[0] - 2).step_by(2) {
            let shown = color(x, y);
            if [(1, 0), (0, 1)].iter().any(|(i, j)| color(x + i, y + j) != shown || color(x - i, y - j) != shown) {
                continue; // an edge
            }
            let hits = viewer.compute_intersections(f64::from(x) + 0.5, f64::from(y) + 0.5, IntersectionLimit::Nearest);
            let met = hits.first().map_or([0; 3], |hit| colors[hit.drawable as usize]);
            assert_eq!(shown, met, "{x} {y}");
            if let Some(hit) = hits.first() {
                seen[hit.drawable as usize] += 1;
            }
            let [from, to] = [0.4, 0.6].map(|share| [f64::from(x) + share, f64::from(y) + share]);
            let in_pixel = viewer.compute_intersections_in(from, to, IntersectionLimit::Nearest);
            assert_eq!(in_pixel.first().map(|hit| hit.drawable), hits.first().map(|hit| hit.drawable), "{x} {y}");
        }
    }
    assert!(seen.iter().all(|count| *count > 50), "{seen:?}");
}
