//! Writes terrain tiles of the format quantized-mesh-1.0 with the extensions octvertexnormals, watermask and metadata (Cesium's
//! specification). Little endian. Any thread.

use glam::DVec3;

use super::order::cache_order;
use crate::math::{Geodetic, WGS84};

/// The largest value of a vertex' coordinates.
const MAX_COORDINATE: f64 = 32767.0;
/// The cells of a water mask.
const WATER_CELLS: usize = 256 * 256;
/// Tiles with more vertices have indices of 32 bits.
const MAX_SHORT_VERTICES: usize = 1 << 16;
/// The extension octvertexnormals.
const OCT_VERTEX_NORMALS: u8 = 1;
/// The extension watermask.
const WATER_MASK: u8 = 2;
const METADATA: u8 = 4;
/// The parts along a side of the points that the header's sphere and occlusion point contain.
const PARTS: u32 = 16;
/// The largest distance of the occlusion point from the earth's centre, in radii.
const MAX_OCCLUSION_RADII: f64 = 1000.0;

/// A terrain tile: triangles over a rectangle of longitude and latitude.
#[derive(Clone, Debug, Default)]
pub struct TerrainMesh {
    /// West, south, east and north in radians.
    pub rectangle: [f64; 4],
    /// Lowest and highest height of the tile and of the finer tiles inside, metres above the ellipsoid. Heights have steps of
    /// 1/32,767 of the difference.
    pub heights_m: [f32; 2],
    /// The shares of the sides, from west and from south, and the height in metres of each vertex.
    pub vertices: Vec<[f64; 3]>,
    /// The normal of each vertex in the earth-centred frame; empty for none.
    pub normals: Vec<DVec3>,
    /// Three vertices for each triangle, counter-clockwise seen from above.
    pub triangles: Vec<u32>,
    /// The water: 0 is land, 255 is water. One byte for the whole tile, or one for each of 256 x 256 cells, from the north-west
    /// corner along the northern edge; empty for none.
    pub water: Vec<u8>,
    /// The JSON of the extension `metadata`, such as the tiles that exist below; empty for none.
    pub metadata: String,
}

/// Returns the bytes of a quantized-mesh tile. Vertices that no triangle uses are left out. Returns `None` for incomplete
/// triangles, invalid indices, normals of another number than the vertices, and water of another number of bytes than 1 or
/// 65,536.
pub fn write_quantized_mesh(mesh: &TerrainMesh) -> Option<Vec<u8>> {
    let count = mesh.vertices.len();
    let has_normals = !mesh.normals.is_empty();
    if has_normals && mesh.normals.len() != count || ![0, 1, WATER_CELLS].contains(&mesh.water.len()) {
        return None;
    }
    let (indices, old_of_new) = cache_order(&mesh.triangles, count)?;
    let mut out = Vec::new();
    write_header(mesh, &mut out);
    out.extend((old_of_new.len() as u32).to_le_bytes());
    let [low_m, high_m] = mesh.heights_m.map(f64::from);
    let steps = |share: f64| (share.clamp(0.0, 1.0) * MAX_COORDINATE).round() as u16;
    let rise_m = if high_m > low_m { high_m - low_m } else { 1.0 };
    let places: Vec<[u16; 3]> = old_of_new
        .iter()
        .map(|old| mesh.vertices[*old])
        .map(|[u, v, h]| [u, v, (h - low_m) / rise_m].map(steps))
        .collect();
    for k in 0..3 {
        let mut before = 0;
        for place in &places {
            let difference = i32::from(place[k]) - before;
            // The sign is the lowest bit.
            out.extend(((difference << 1 ^ difference >> 31) as u16).to_le_bytes());
            before = i32::from(place[k]);
        }
    }
    let is_long = places.len() > MAX_SHORT_VERTICES;
    out.resize(out.len().next_multiple_of(if is_long { 4 } else { 2 }), 0);
    let index = |index: u32, out: &mut Vec<u8>| match is_long {
        true => out.extend(index.to_le_bytes()),
        false => out.extend((index as u16).to_le_bytes()),
    };
    out.extend((indices.len() as u32 / 3).to_le_bytes());
    let mut next = 0;
    for vertex in &indices {
        // Vertices are numbered by first use.
        index(next - vertex, &mut out);
        next += u32::from(*vertex == next);
    }
    let edges: [(usize, u16, usize); 4] = [(0, 0, 1), (1, 0, 0), (0, 32767, 1), (1, 32767, 0)];
    for (across, value, along) in edges {
        let mut edge: Vec<u32> = (0..places.len() as u32).filter(|k| places[*k as usize][across] == value).collect();
        edge.sort_by_key(|k| places[*k as usize][along]);
        out.extend((edge.len() as u32).to_le_bytes());
        edge.into_iter().for_each(|k| index(k, &mut out));
    }
    if has_normals {
        out.push(OCT_VERTEX_NORMALS);
        out.extend((2 * places.len() as u32).to_le_bytes());
        out.extend(old_of_new.iter().flat_map(|old| oct_code(mesh.normals[*old])));
    }
    if !mesh.water.is_empty() {
        out.push(WATER_MASK);
        out.extend((mesh.water.len() as u32).to_le_bytes());
        out.extend(&mesh.water);
    }
    if !mesh.metadata.is_empty() {
        let length = u32::try_from(mesh.metadata.len()).ok()?;
        out.push(METADATA);
        out.extend(length.checked_add(4)?.to_le_bytes());
        out.extend(length.to_le_bytes());
        out.extend(mesh.metadata.as_bytes());
    }
    Some(out)
}

/// Writes the centre, the heights, the bounding sphere and the horizon occlusion point. They hold for all heights of the tile,
/// also those of finer tiles.
fn write_header(mesh: &TerrainMesh, out: &mut Vec<u8>) {
    let ([west, south, east, north], [low_m, high_m]) = (mesh.rectangle, mesh.heights_m.map(f64::from));
    let at = |u: f64, v: f64, height_m: f64| {
        WGS84.ecef(&Geodetic { longitude: west + (east - west) * u, latitude: south + (north - south) * v, height_m })
    };
    let center = at(0.5, 0.5, 0.5 * (low_m + high_m));
    let share = |k: u32| f64::from(k) / f64::from(PARTS);
    let places = (0..=PARTS).flat_map(|i| (0..=PARTS).map(move |j| [share(i), share(j)]));
    let radii = DVec3::new(WGS84.semi_major_m, WGS84.semi_major_m, WGS84.semi_minor_m);
    // Points on the ellipsoid of radius 1, seen from its centre.
    let direction = (center / radii).normalize_or(DVec3::X);
    let (mut radius_m, mut occlusion_radii) = (0.0f64, 1.0f64);
    for [u, v] in places {
        let high = at(u, v, high_m);
        radius_m = radius_m.max(center.distance(high)).max(center.distance(at(u, v, low_m)));
        occlusion_radii = occlusion_radii.max(occlusion(high / radii, direction));
    }
    let point = direction * occlusion_radii;
    center.to_array().iter().for_each(|c| out.extend(c.to_le_bytes()));
    mesh.heights_m.iter().for_each(|height_m| out.extend(height_m.to_le_bytes()));
    // Between the points the sides bulge a little.
    let sphere = [center.x, center.y, center.z, 1.001 * radius_m];
    sphere.iter().chain(&point.to_array()).for_each(|c| out.extend(c.to_le_bytes()));
}

/// Returns the distance from the centre of a unit sphere, along a direction, of the point that is hidden only if `point` is
/// hidden too (Ring 2013, Horizon Culling 2). Points below the sphere count as on it.
fn occlusion(point: DVec3, direction: DVec3) -> f64 {
    let distance = point.length().max(1.0);
    let own = point.normalize_or(direction);
    let (cos_beta, sin_beta) = (1.0 / distance, (distance * distance - 1.0).sqrt() / distance);
    let reciprocal = own.dot(direction) * cos_beta - own.cross(direction).length() * sin_beta;
    // From a quarter of the earth on there is no such point.
    1.0 / reciprocal.max(1.0 / MAX_OCCLUSION_RADII)
}

/// Returns the bytes of a unit vector as a point of an octahedron (Cigolle et al. 2014, A Survey of Efficient Representations for
/// Independent Unit Vectors).
fn oct_code(normal: DVec3) -> [u8; 2] {
    let normal = normal / (normal.x.abs() + normal.y.abs() + normal.z.abs()).max(f64::MIN_POSITIVE);
    let sign = |x: f64| if x >= 0.0 { 1.0 } else { -1.0 };
    let [x, y] = match normal.z < 0.0 {
        true => [(1.0 - normal.y.abs()) * sign(normal.x), (1.0 - normal.x.abs()) * sign(normal.y)],
        false => [normal.x, normal.y],
    };
    [x, y].map(|c| ((c.clamp(-1.0, 1.0) * 0.5 + 0.5) * 255.0).round() as u8)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn occlusion_points_hide_with_their_tile() {
        let mesh = TerrainMesh {
            rectangle: [0.1, 0.5, 0.2, 0.6],
            heights_m: [-100.0, 5000.0],
            vertices: vec![[0.0, 0.0, -100.0], [1.0, 0.0, 5000.0], [0.0, 1.0, 10.0]],
            triangles: vec![0, 1, 2],
            ..TerrainMesh::default()
        };
        let bytes = write_quantized_mesh(&mesh).unwrap();
        let double = |at: usize| f64::from_le_bytes(bytes[at..at + 8].try_into().unwrap());
        let point = DVec3::new(double(64), double(72), double(80));
        // The tangent plane at the horizon: the highest corner is as far beyond it.
        assert!(point.length() > 1.001 && point.length() < 1.1, "{point}");
        let (center, radius_m) = (DVec3::new(double(0), double(8), double(16)), double(56));
        for (u, v, height_m) in [(0.0, 0.0, 5000.0), (1.0, 1.0, -100.0), (0.37, 1.0, 5000.0)] {
            let g = Geodetic { longitude: 0.1 + 0.1 * u, latitude: 0.5 + 0.1 * v, height_m };
            assert!(center.distance(WGS84.ecef(&g)) <= radius_m);
        }
        // A hemisphere is never hidden.
        let half = TerrainMesh { rectangle: [-3.1, -1.5, 0.0, 1.5], ..mesh };
        let bytes = write_quantized_mesh(&half).unwrap();
        let far = f64::from_le_bytes(bytes[72..80].try_into().unwrap()).abs();
        assert!(far > 100.0, "{far}");
    }

    #[test]
    fn invalid_meshes_are_refused() {
        let mesh = TerrainMesh { vertices: vec![[0.0; 3]; 3], triangles: vec![0, 1, 3], ..TerrainMesh::default() };
        assert!(write_quantized_mesh(&mesh).is_none());
        assert!(write_quantized_mesh(&TerrainMesh { triangles: vec![0, 1], ..mesh.clone() }).is_none());
        let water = vec![0; 7];
        assert!(write_quantized_mesh(&TerrainMesh { triangles: vec![0, 1, 2], water, ..mesh.clone() }).is_none());
        let normals = vec![DVec3::Z];
        assert!(write_quantized_mesh(&TerrainMesh { triangles: vec![0, 1, 2], normals, ..mesh }).is_none());
    }
}
