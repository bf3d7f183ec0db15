//! Wind around the hills, and the bands that show it.

use glam::{DVec2, DVec3};
use terrane::scene::{AttributeFormat, Mesh, MeshError, PrimitiveMode};

use super::land::{HALF_M, HILLS, height, vertex};

/// Returns the wind, metres per second: from the west, flowing around the hills as around pillars, and partly over them.
fn wind(at: DVec2) -> DVec2 {
    let from_west = DVec2::X * 10.0;
    HILLS.iter().fold(from_west, |wind, (center, _, width_m)| {
        let (away, radius_m) = (at - center, 0.9 * width_m);
        let square = away.length_squared().max(radius_m * radius_m);
        let turned = DVec2::new(away.x * away.x - away.y * away.y, 2.0 * away.x * away.y) / (square * square);
        wind - 6.0 * radius_m * radius_m * turned
    })
}

/// Returns a band along the path of the wind from a point, as one quad strip with speed and time on each vertex.
pub fn band(start: DVec2) -> Result<Mesh, MeshError> {
    const STEP_S: f64 = 4.0;
    const HALF_WIDTH_M: f64 = 9.0;
    let (mut vertices, mut m_per_s, mut blown_s) = (Vec::new(), Vec::new(), Vec::new());
    // Bands start at different times, so that their dashes are offset.
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
