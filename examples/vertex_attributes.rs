//! Attributes of vertices beside those that every mesh has, read by programs under their names, and other primitives
//! than triangles: rain on hills, and the wind that goes over and around them.
//!
//! ```text
//! cargo run --release --example vertex_attributes -- [--offscreen] [--frames N] [--screenshot FILE]
//! ```
//! Expected: three hills from sand to deep green with the rain that falls there, a line every 100 mm, in a white frame.
//! Bands of wind come from the left, in dashes that move with it: blue where it is slow, in front of the hills and behind
//! them, red where it is fast, between them and over them.

use std::sync::Arc;

use anyhow::Result;
use glam::{DVec2, DVec3};
use terrane::scene::{AttributeFormat, Drawable, Material, Mesh, MeshError, MeshVertex, Node, Page, PrimitiveMode};
use terrane::state::{Attribute, Program, StateSet};
use terrane::viewer::{Viewer, ViewerConfig, WindowOptions, has_display, run_window};

/// Half a side of the land.
const HALF_M: f64 = 2000.0;
/// Vertices along a side.
const SIDE: u16 = 161;
/// Middles of the hills, their heights and widths, metres.
const HILLS: [(DVec2, f64, f64); 3] = [
    (DVec2::new(-500.0, -650.0), 420.0, 430.0),
    (DVec2::new(-250.0, 750.0), 560.0, 520.0),
    (DVec2::new(950.0, 80.0), 350.0, 380.0),
];

/// Behind the engine's own declarations, as those of any program: `MeshVertex`, `leaves`, `frame`, `light_of_sun`, ...
/// What a vertex has beside a `MeshVertex` has locations from 4 on, in any order: names decide.
const RAIN_WGSL: &str = "
struct Varying {
    @builtin(position) clip: vec4<f32>,
    @location(0) in_eye: vec3<f32>,
    @location(1) normal: vec3<f32>,
    @location(2) rain_mm: f32,
}

@vertex
fn vs_main(vertex: MeshVertex, @builtin(instance_index) i: u32, @location(4) rain_mm: f32) -> Varying {
    let in_eye = point_in_eye(leaves[i], vertex.position);
    let normal = normal_in_eye(leaves[i], vertex.normal.xyz);
    return Varying(frame.clip_from_eye * vec4<f32>(in_eye, 1.0), in_eye, normal, rain_mm);
}

@fragment
fn fs_main(in: Varying) -> @location(0) vec4<f32> {
    let dry = mix(vec3<f32>(0.55, 0.42, 0.22), vec3<f32>(0.28, 0.36, 0.10), smoothstep(250.0, 600.0, in.rain_mm));
    let color = mix(dry, vec3<f32>(0.03, 0.16, 0.06), smoothstep(600.0, 1100.0, in.rain_mm));
    let hundreds = in.rain_mm / 100.0;
    let from_line = abs(fract(hundreds + 0.5) - 0.5) / fwidth(hundreds);
    let ground = above_ground(in.in_eye);
    let light = light_of_sun(normalize(in.normal), ground.xyz, ground.w) + light_of_sky(normalize(in.normal), ground.xyz);
    let lit = color * mix(0.55, 1.0, smoothstep(0.4, 1.2, from_line)) * light;
    return vec4<f32>(through_air(lit, aerial(in.in_eye)), 1.0);
}
";

const WIND_WGSL: &str = "
struct Uniforms { osg_SimulationTime: f32 }
@group(2) @binding(0) var<uniform> uniforms: Uniforms;

struct Varying {
    @builtin(position) clip: vec4<f32>,
    @location(0) m_per_s: f32,
    @location(1) blown_s: f32,
}

@vertex
fn vs_main(
    vertex: MeshVertex,
    @builtin(instance_index) i: u32,
    @location(4) m_per_s: f32,
    @location(5) blown_s: f32,
) -> Varying {
    let in_eye = point_in_eye(leaves[i], vertex.position);
    return Varying(frame.clip_from_eye * vec4<f32>(in_eye, 1.0), m_per_s, blown_s);
}

@fragment
fn fs_main(in: Varying) -> @location(0) vec4<f32> {
    // A dash is what the wind goes in 20 of 30 seconds, shown 10 times as fast.
    if fract((in.blown_s - 10.0 * uniforms.osg_SimulationTime) / 30.0) > 0.67 {
        discard;
    }
    let slow = mix(vec3<f32>(0.02, 0.10, 0.60), vec3<f32>(0.75, 0.80, 0.85), smoothstep(5.0, 10.0, in.m_per_s));
    return vec4<f32>(mix(slow, vec3<f32>(0.80, 0.05, 0.02), smoothstep(10.0, 14.0, in.m_per_s)), 1.0);
}
";

/// Of the ground, and how it rises to the east and to the north.
fn height(at: DVec2) -> (f64, DVec2) {
    HILLS.iter().fold((0.0, DVec2::ZERO), |(height_m, rise), (middle, top_m, width_m)| {
        let away = at - middle;
        let own = top_m * (-away.length_squared() / (2.0 * width_m * width_m)).exp();
        (height_m + own, rise - own / (width_m * width_m) * away)
    })
}

/// Metres a second: from the west, as around pillars where the hills are, a part of it over them.
fn wind(at: DVec2) -> DVec2 {
    let from_west = DVec2::X * 10.0;
    HILLS.iter().fold(from_west, |wind, (middle, _, width_m)| {
        let (away, radius_m) = (at - middle, 0.9 * width_m);
        let square = away.length_squared().max(radius_m * radius_m);
        let turned = DVec2::new(away.x * away.x - away.y * away.y, 2.0 * away.x * away.y) / (square * square);
        wind - 6.0 * radius_m * radius_m * turned
    })
}

fn vertex(at: DVec3, normal: DVec3) -> MeshVertex {
    let [x, y, z] = (normal.normalize() * 127.0).to_array().map(|n| n.round() as i8);
    MeshVertex { position: at.as_vec3().to_array(), normal: [x, y, z, 0], color: [255; 4], ..MeshVertex::default() }
}

/// The ground in one strip of triangles, with the rain that falls on it.
fn land() -> Result<Mesh, MeshError> {
    let place = |i: u16| (2.0 * f64::from(i) / f64::from(SIDE - 1) - 1.0) * HALF_M;
    let places: Vec<DVec2> = (0..SIDE).flat_map(|y| (0..SIDE).map(move |x| DVec2::new(place(x), place(y)))).collect();
    let vertices = places.iter().map(|at| {
        let (height_m, rise) = height(*at);
        vertex(at.extend(height_m), DVec3::new(-rise.x, -rise.y, 1.0))
    });
    // Where air rises it rains, and behind the hills it does not.
    let rain_mm: Vec<f32> = places
        .iter()
        .map(|at| {
            let (height_m, rise) = height(*at);
            (350.0 + 1.3 * height_m + 350.0 * rise.x.clamp(-0.8, 0.8)) as f32
        })
        .collect();
    // Rows end and begin with a corner twice: triangles without area join them.
    let row = |y: u16| {
        let pairs = (0..SIDE).flat_map(move |x| [(y + 1) * SIDE + x, y * SIDE + x]);
        std::iter::once((y + 1) * SIDE).chain(pairs).chain([(y + 1) * SIDE - 1])
    };
    let strip: Vec<u16> = (0..SIDE - 1).flat_map(row).collect();
    Mesh::from_elements(PrimitiveMode::TriangleStrip, vertices.collect(), &strip)?.with_attribute(
        "rain_mm",
        AttributeFormat::Float32,
        &rain_mm,
    )
}

/// A band along the way of what is blown from a place, in one strip of quads.
fn band(start: DVec2) -> Result<Mesh, MeshError> {
    const STEP_S: f64 = 4.0;
    const HALF_WIDTH_M: f64 = 9.0;
    let (mut vertices, mut m_per_s, mut blown_s) = (Vec::new(), Vec::new(), Vec::new());
    // Dashes begin at different times.
    let (mut at, mut time_s) = (start, start.y * 0.37);
    while at.x < HALF_M {
        let velocity = wind(at);
        let across = velocity.perp().normalize() * HALF_WIDTH_M;
        for side in [at + across, at - across] {
            vertices.push(vertex(side.extend(height(at).0 + 40.0), DVec3::Z));
            m_per_s.push(velocity.length() as f32);
            blown_s.push(time_s as f32);
        }
        at += STEP_S * wind(at + 0.5 * STEP_S * velocity);
        time_s += STEP_S;
    }
    Mesh::from_arrays(PrimitiveMode::QuadStrip, vertices)
        .with_attribute("m_per_s", AttributeFormat::Float32, &m_per_s)?
        .with_attribute("blown_s", AttributeFormat::Float32, &blown_s)
}

fn main() -> Result<()> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let value = |name: &str| args.iter().position(|a| a == name).and_then(|i| args.get(i + 1));
    let frames: u32 = value("--frames").map_or(Ok(30), |n| n.parse())?;
    if has_display() && !args.iter().any(|a| a == "--offscreen") {
        let options = WindowOptions { on_open: Box::new(build), ..WindowOptions::default() };
        return Ok(run_window(ViewerConfig::default(), options).map(drop)?);
    }
    let mut viewer = Viewer::new_offscreen(&ViewerConfig { samples: 4, ..ViewerConfig::default() })?;
    build(&mut viewer)?;
    for _ in 0..frames {
        viewer.frame()?;
    }
    value("--screenshot").map_or(Ok(()), |file| Ok(viewer.read_back()?.save(file)?))
}

fn build(viewer: &mut Viewer) -> Result<(), terrane::viewer::ViewerError> {
    let shown_by = |program: &str, wgsl: &str, meshes: Vec<Mesh>| {
        let both_sides = Material { double_sided: true, ..Material::default() };
        let drawables = meshes.into_iter().map(|mesh| Drawable::new(mesh.into(), both_sides.clone())).collect();
        let set = StateSet::default().with(Attribute::Program(Program::new(program, wgsl)));
        Node::geode(drawables).with_state_set(Arc::new(set))
    };
    let land = shown_by("rain", RAIN_WGSL, vec![land().expect("a value for each vertex")]);
    let starts = (0..33).map(|i| DVec2::new(-HALF_M, (f64::from(i) / 16.0 - 1.0) * (HALF_M - 60.0)));
    let bands = starts.map(|start| band(start).expect("a value for each vertex")).collect();
    // Without attributes and program: the engine's own shading.
    let corners = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)];
    let corners = corners.map(|(x, y)| vertex(DVec3::new(x, y, 0.0) * HALF_M + DVec3::Z, DVec3::Z)).to_vec();
    let white = Material { unlit: true, ..Material::default() };
    let frame = Drawable::new(Mesh::from_arrays(PrimitiveMode::LineLoop, corners).into(), white);
    let all = vec![land, shown_by("wind", WIND_WGSL, bands), Node::geode(vec![frame])];
    viewer.add_root(Page::from_node(Node::group(all)).expect("a shallow graph"))?;
    viewer.view_mut().environment.sun_direction = DVec3::new(-0.6, -0.5, 0.6).normalize();
    viewer.view_mut().camera.look_at(DVec3::new(-700.0, -3600.0, 2300.0), DVec3::new(50.0, -250.0, 0.0), DVec3::Z);
    Ok(())
}
