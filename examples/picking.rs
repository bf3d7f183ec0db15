//! What lies behind the pixels: rays through the window, and heights that another thread asks for.
//!
//! ```text
//! cargo run --release --example picking -- [SOURCE] [--offscreen] [--frames N] [--screenshot FILE]
//! ```
//! Without SOURCE a small set is made in the system's temporary folder. Expected: hills with a grid of red pins, each on
//! the ground behind its place in the window and upright on the slope; where there is sky there is none. A ring of blue
//! balls keeps the same height above hills and valleys.

use anyhow::{Context, Result};
use glam::{DAffine3, DQuat, DVec3};
use terrane::math::{Aabb, WGS84};
use terrane::pager::PagerConfig;
use terrane::scene::{Drawable, HeightQuery, IntersectionLimit, Material, Mesh, Node, NodeId, Page, PageId, Vertical};
use terrane::viewer::{ViewFrom, Viewer, ViewerConfig, ViewerError, WindowOptions, has_display, run_window};

const PINS: [u32; 2] = [9, 6];
const BALLS: u32 = 32;

fn main() -> Result<()> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let value = |name: &str| args.iter().position(|a| a == name).and_then(|i| args.get(i + 1));
    let frames: u32 = value("--frames").map_or(Ok(60), |n| n.parse())?;
    let source = match args.first().filter(|a| !a.starts_with("--")) {
        Some(source) => source.clone(),
        None => terrane_data_gen::default_set(&std::env::temp_dir().join("terrane-hello"))?.display().to_string(),
    };
    // The decode workers build what is intersected.
    let pager = PagerConfig { build_kd_trees: true, ..PagerConfig::default() };
    let config = ViewerConfig { pager, max_sse_px: 3.0, samples: 4, ..ViewerConfig::default() };
    if has_display() && !args.iter().any(|a| a == "--offscreen") {
        let on_open = Box::new(move |viewer: &mut Viewer| open(viewer, &source).map(drop));
        let before_frame = Box::new(|viewer: &mut Viewer| mark(viewer).map(|()| true));
        run_window(config, WindowOptions { on_open, before_frame, ..WindowOptions::default() })?;
        return Ok(());
    }
    let mut viewer = Viewer::new_offscreen(&config)?;
    open(&mut viewer, &source)?;
    while viewer.frame_stamp().frame < frames || !viewer.is_settled() {
        viewer.frame()?;
    }
    mark(&mut viewer)?;
    viewer.frame()?;
    let middle = viewer.compute_intersections(640.0, 360.0, IntersectionLimit::Nearest);
    let middle = middle.first().context("sky in the middle of the picture")?;
    println!("{:.1} m to triangle {} of {:?}", middle.ratio, middle.primitive, middle.node());
    value("--screenshot").map_or(Ok(()), |file| Ok(viewer.read_back()?.save(file)?))
}

fn open(viewer: &mut Viewer, source: &str) -> Result<(), ViewerError> {
    viewer.load(source)?;
    let bounds = *viewer.bounds().expect("a set was loaded");
    let view = ViewFrom { heading: 0.4, pitch: -0.25, range_m: Some(0.5 * bounds.sphere.radius_m) };
    viewer.camera.world_from_eye = bounds.first_camera(&view);
    let colored = |mesh: Mesh, base_color| Drawable::new(mesh.into(), Material { base_color, ..Material::default() });
    let cuboid = Mesh::cuboid(&Aabb { min: DVec3::new(-0.12, -0.12, -1.0), max: DVec3::new(0.12, 0.12, 4.0) });
    let pin = vec![
        colored(cuboid, [0.9, 0.1, 0.1, 1.0]),
        colored(Mesh::sphere(DVec3::Z * 4.0, 0.7, 16), [1.0, 0.3, 0.2, 1.0]),
    ];
    let ball = vec![colored(Mesh::sphere(DVec3::ZERO, 1.0, 24), [0.1, 0.3, 0.9, 1.0])];
    let hidden = |shapes: &Vec<Drawable>| Node {
        mask: 2, // not what is picked
        ..Node::transform(DAffine3::from_scale(DVec3::ZERO), vec![Node::geode(shapes.clone())])
    };
    let pins = (0..PINS[0] * PINS[1]).map(|_| hidden(&pin));
    let marks = pins.chain((0..BALLS).map(|_| hidden(&ball))).collect();
    viewer
        .add_root(Page::from_node(Node { mask: 3, ..Node::group(marks) }.named("marks")).expect("a shallow graph"))?;
    Ok(())
}

/// Moves the marks to what is loaded and seen now.
fn mark(viewer: &mut Viewer) -> Result<(), ViewerError> {
    let bounds = *viewer.bounds().expect("a set was loaded");
    let [width, height] = viewer.size_px().map(f64::from);
    let mut visitor = viewer.camera.intersection_visitor(viewer.size_px());
    visitor.traversal_mask = 1;
    let mut maps = Vec::new();
    for (i, j) in (0..PINS[1]).flat_map(|j| (0..PINS[0]).map(move |i| (i, j))) {
        let (x, y) = ((f64::from(i) + 0.5) * width / 9.0, (f64::from(j) + 0.5) * height / 6.0);
        let mut ray = viewer.camera.ray_at(viewer.size_px(), x, y).with_limit(IntersectionLimit::Nearest);
        visitor.traverse(viewer.scene(), &mut ray);
        maps.push(ray.first_intersection().map_or(DAffine3::from_scale(DVec3::ZERO), |hit| {
            let upright = DQuat::from_rotation_arc(DVec3::Z, hit.world_normal());
            DAffine3::from_scale_rotation_translation(DVec3::splat(0.008 * hit.ratio), upright, hit.world_point())
        }));
    }
    // Any thread may ask what was published.
    let vertical = if bounds.frame.georeferenced { Vertical::Ellipsoid(WGS84) } else { Vertical::Flat };
    let query = HeightQuery::new(vertical).with_traversal_mask(1);
    query.publish(viewer.scene());
    let radius_m = 0.2 * bounds.sphere.radius_m;
    let ring = std::thread::spawn(move || {
        let at = |i: u32| {
            let (sin, cos) = (std::f64::consts::TAU * f64::from(i) / f64::from(BALLS)).sin_cos();
            let above = bounds.frame.world_from_local.transform_point3(DVec3::new(sin, cos, 0.0) * radius_m);
            let ground = query.highest_ground_at(above)?;
            Some(ground.point + bounds.frame.up() * 0.06 * radius_m)
        };
        (0..BALLS).map(at).collect::<Vec<_>>()
    });
    let balls = ring.join().expect("the thread only asks").into_iter().map(|place| {
        let scale = if place.is_some() { 0.02 * radius_m } else { 0.0 };
        DAffine3::from_scale_rotation_translation(DVec3::splat(scale), DQuat::IDENTITY, place.unwrap_or_default())
    });
    maps.extend(balls);
    let root: Option<PageId> = viewer.scene().roots().last().copied();
    let Some(page) = root else { return Ok(()) };
    for (map, index) in maps.into_iter().zip((1..).step_by(2)) {
        // A mark is a transform and a geode.
        viewer.scene_mut().set_transform(NodeId { page, index }, map).expect("marks are transforms");
    }
    Ok(())
}
