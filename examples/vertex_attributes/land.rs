//! Three hills and the rain on them.

use glam::{DVec2, DVec3};
use terrane::scene::{AttributeFormat, Mesh, MeshError, MeshVertex, PrimitiveMode};

/// Half the side of the land, metres.
pub const HALF_M: f64 = 2000.0;
/// The number of vertices along a side.
const SIDE: u16 = 161;
/// The centres of the hills, their heights and widths, metres.
pub const HILLS: [(DVec2, f64, f64); 3] = [
    (DVec2::new(-500.0, -650.0), 420.0, 430.0),
    (DVec2::new(-250.0, 750.0), 560.0, 520.0),
    (DVec2::new(950.0, 80.0), 350.0, 380.0),
];

/// Returns the height of the ground, metres, and its slope to the east and to the north.
pub fn height(at: DVec2) -> (f64, DVec2) {
    HILLS.iter().fold((0.0, DVec2::ZERO), |(height_m, rise), (center, top_m, width_m)| {
        let away = at - center;
        let hill_m = top_m * (-away.length_squared() / (2.0 * width_m * width_m)).exp();
        (height_m + hill_m, rise - hill_m / (width_m * width_m) * away)
    })
}

/// Returns a vertex at a position with a normal.
pub fn vertex(at: DVec3, normal: DVec3) -> MeshVertex {
    let [x, y, z] = (normal.normalize() * 127.0).to_array().map(|n| n.round() as i8);
    MeshVertex { position: at.as_vec3().to_array(), normal: [x, y, z, 0], color: [255; 4], ..MeshVertex::default() }
}

/// Returns the ground as one triangle strip, with the rain on each vertex.
pub fn land() -> Result<Mesh, MeshError> {
    let coordinate = |i: u16| (2.0 * f64::from(i) / f64::from(SIDE - 1) - 1.0) * HALF_M;
    let points: Vec<DVec2> =
        (0..SIDE).flat_map(|y| (0..SIDE).map(move |x| DVec2::new(coordinate(x), coordinate(y)))).collect();
    let vertices = points.iter().map(|at| {
        let (height_m, rise) = height(*at);
        vertex(at.extend(height_m), DVec3::new(-rise.x, -rise.y, 1.0))
    });
    // Rain falls where air rises, and not behind the hills.
    let rain_mm: Vec<f32> = points
        .iter()
        .map(|at| {
            let (height_m, rise) = height(*at);
            (350.0 + 1.3 * height_m + 350.0 * rise.x.clamp(-0.8, 0.8)) as f32
        })
        .collect();
    // Degenerate triangles join the rows.
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
