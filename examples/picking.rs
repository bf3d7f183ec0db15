//! What lies behind the pixels: rays through the window, and heights that another thread asks for.
//!
//! ```text
//! cargo run --release --example picking -- [SOURCE] [--offscreen] [--frames N] [--screenshot FILE]
//! ```
//! Without SOURCE a small set is made in the system's temporary folder. Expected, once all is loaded: hills with a grid of
//! red pins, each on the ground behind its place in the picture and upright on the slope; in the sky there are none. A ring
//! of blue balls keeps the same height above hills and valleys.

use anyhow::Result;
use glam::{DAffine3, DQuat, DVec3};
use terrane::math::{Aabb, WGS84};
use terrane::pager::PagerConfig;
use terrane::scene::{Drawable, HeightQuery, IntersectionLimit, Material, Mesh, Node, Page, Vertical};
use terrane::viewer::{ViewFrom, Viewer, ViewerConfig, ViewerError, WindowOptions, has_display, run_window};

fn main() -> Result<()> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let value = |name: &str| args.iter().position(|a| a == name).and_then(|i| args.get(i + 1));
    let frames: u32 = value("--frames").map_or(Ok(60), |n| n.parse())?;
    let source = match args.first().filter(|a| !a.starts_with("--")) {
        Some(source) => source.clone(),
        None => terrane_data_gen::default_set(&std::env::temp_dir().join("terrane-hello"))?.display().to_string(),
    };
    let open = move |viewer: &mut Viewer| {
        viewer.load(&source)?;
        let bounds = *viewer.bounds().expect("a set was loaded");
        let view = ViewFrom { heading: 0.4, pitch: -0.25, range_m: Some(0.5 * bounds.sphere.radius_m) };
        viewer.view_mut().camera.world_from_eye = bounds.first_camera(&view);
        Ok(())
    };
    // The decode workers build what is intersected.
    let pager = PagerConfig { build_kd_trees: true, ..PagerConfig::default() };
    let config = ViewerConfig { pager, max_sse_px: 3.0, samples: 4, ..ViewerConfig::default() };
    if has_display() && !args.iter().any(|a| a == "--offscreen") {
        let mut is_marked = false;
        let before_frame = Box::new(move |viewer: &mut Viewer| {
            if !is_marked && viewer.is_settled() {
                mark(viewer)?;
                is_marked = true;
            }
            Ok(true)
        });
        run_window(config, WindowOptions { on_open: Box::new(open), before_frame, ..WindowOptions::default() })?;
        return Ok(());
    }
    let mut viewer = Viewer::new_offscreen(&config)?;
    open(&mut viewer)?;
    while viewer.frame_stamp().frame < frames || !viewer.is_settled() {
        viewer.frame()?;
    }
    mark(&mut viewer)?;
    (0..10).try_for_each(|_| viewer.frame())?;
    value("--screenshot").map_or(Ok(()), |file| Ok(viewer.read_back()?.save(file)?))
}

/// Puts marks on what is loaded and seen now.
fn mark(viewer: &mut Viewer) -> Result<(), ViewerError> {
    let colored = |mesh: Mesh, base_color| Drawable::new(mesh.into(), Material { base_color, ..Material::default() });
    let needle = Mesh::cuboid(&Aabb { min: DVec3::new(-0.12, -0.12, -1.0), max: DVec3::new(0.12, 0.12, 4.0) });
    let head = colored(Mesh::sphere(DVec3::Z * 4.0, 0.7, 16), [1.0, 0.3, 0.2, 1.0]);
    let pin = Node::geode(vec![colored(needle, [0.9, 0.1, 0.1, 1.0]), head]);
    let ball = Node::geode(vec![colored(Mesh::sphere(DVec3::ZERO, 1.0, 24), [0.1, 0.3, 0.9, 1.0])]);

    let mut marks = Vec::new();
    let [width, height] = viewer.view().size_px().map(f64::from);
    for (i, j) in (0..9).flat_map(|i| (0..6).map(move |j| (f64::from(i) + 0.5, f64::from(j) + 0.5))) {
        let hits = viewer.compute_intersections(i * width / 9.0, j * height / 6.0, IntersectionLimit::Nearest);
        let Some(hit) = hits.first() else { continue };
        let upright = DQuat::from_rotation_arc(DVec3::Z, hit.world_normal());
        let scale = DVec3::splat(0.008 * hit.ratio);
        let map = DAffine3::from_scale_rotation_translation(scale, upright, hit.world_point());
        marks.push(Node::transform(map, vec![pin.clone()]));
    }

    // Any thread may ask what was published.
    let bounds = *viewer.bounds().expect("a set was loaded");
    let vertical = if bounds.frame.georeferenced { Vertical::Ellipsoid(WGS84) } else { Vertical::Flat };
    let query = HeightQuery::new(vertical);
    query.publish(viewer.scene());
    let radius_m = 0.2 * bounds.sphere.radius_m;
    let ring = move || {
        let places = (0..32).filter_map(|i| {
            let (sin, cos) = (std::f64::consts::TAU * f64::from(i) / 32.0).sin_cos();
            let around = bounds.frame.world_from_local.transform_point3(DVec3::new(sin, cos, 0.0) * radius_m);
            Some(query.highest_ground_at(around)?.point + bounds.frame.up() * 0.06 * radius_m)
        });
        places.collect::<Vec<_>>()
    };
    for place in std::thread::spawn(ring).join().expect("it only asks") {
        let scale = DVec3::splat(0.02 * radius_m);
        let map = DAffine3::from_scale_rotation_translation(scale, DQuat::IDENTITY, place);
        marks.push(Node::transform(map, vec![ball.clone()]));
    }
    viewer.add_root(Page::from_node(Node::group(marks)).expect("a shallow graph")).map(drop)
}
