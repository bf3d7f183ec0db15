//! [`QuantizedMesh`]: a tile of the format quantized-mesh-1.0. Decode threads.
//!
//! Layout by Cesium's specification quantized-mesh-1.0: a header, vertices as differences, triangles coded by the highest
//! index so far, the vertices of the four edges, and extensions. Little endian.

use glam::{Vec2, Vec3};

use super::surface::{Normals, Surface, SurfaceVertex};
use super::water::Water;
use crate::fetch::about_to_allocate;

/// The header: centre, lowest and highest height, bounding sphere, horizon occlusion point.
const HEADER_BYTES: usize = 88;
/// The offset of the lowest height in the header.
const HEIGHTS_AT: usize = 24;
/// The largest value of a vertex' coordinates.
const MAX_COORDINATE: i32 = 32767;
/// Tiles with more vertices have indices of 32 bits.
const MAX_SHORT_VERTICES: usize = 1 << 16;
/// The bytes that a vertex takes until it is one of a mesh: its coordinates, its position on the ellipsoid, its normal.
const VERTEX_BYTES: u64 = 256;
/// The same for a triangle: its indices here, without those that are flat, and in the mesh.
const TRIANGLE_BYTES: u64 = 48;
/// Heights beyond this are no heights on the earth, metres.
const MAX_HEIGHT_M: f32 = 1e6;

/// Extensions.
const OCT_VERTEX_NORMALS: u8 = 1;
const WATER_MASK: u8 = 2;
const METADATA: u8 = 4;

/// A tile.
#[derive(Debug)]
pub(super) struct QuantizedMesh<'a> {
    pub surface: Surface,
    /// The JSON of the extension `metadata`.
    pub metadata: Option<&'a [u8]>,
    /// The extension `watermask`.
    pub water: Option<Water>,
    /// The number of extensions that are not known.
    pub unknown_extensions: u32,
}

/// Reads numbers from the front of bytes.
struct Reader<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Reader<'a> {
    fn take(&mut self, count: usize, what: &str) -> Result<&'a [u8], String> {
        let taken = self.at.checked_add(count).and_then(|end| self.bytes.get(self.at..end));
        let left = self.bytes.len() - self.at;
        let taken = taken.ok_or_else(|| format!("{what} of {count} bytes at byte {}, {left} follow", self.at))?;
        self.at += count;
        Ok(taken)
    }

    fn u32(&mut self, what: &str) -> Result<u32, String> {
        let bytes = self.take(4, what)?;
        Ok(u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]))
    }

    /// Returns a count of elements of `size` bytes and their bytes.
    fn elements(&mut self, size: usize, what: &str) -> Result<&'a [u8], String> {
        let count = self.u32(what)? as usize;
        let bytes = count.checked_mul(size).ok_or_else(|| format!("{what}: {count} elements"))?;
        self.take(bytes, what)
    }

    /// Returns the coordinates of `count` vertices, which are stored as differences with the sign in the lowest bit.
    fn coordinates(&mut self, count: usize, what: &str) -> Result<Vec<f64>, String> {
        let codes = self.take(2 * count, what)?.chunks_exact(2).map(|b| i32::from(u16::from_le_bytes([b[0], b[1]])));
        let mut value = 0;
        let decoded = codes.enumerate().map(|(i, code)| {
            value += code >> 1 ^ -(code & 1);
            match (0..=MAX_COORDINATE).contains(&value) {
                true => Ok(f64::from(value) / f64::from(MAX_COORDINATE)),
                false => Err(format!("{what}: vertex {i} has {value}, expected 0 to {MAX_COORDINATE}")),
            }
        });
        decoded.collect()
    }
}

/// Returns the lowest and the highest height that the header of a tile names, metres.
pub(super) fn header_heights_m(bytes: &[u8]) -> Result<[f64; 2], String> {
    let word = |at: usize| bytes.get(at..at + 4).and_then(|b| b.try_into().ok()).map(f32::from_le_bytes);
    let too_short = || format!("{} bytes, a header has {HEADER_BYTES}", bytes.len());
    let heights = word(HEIGHTS_AT).zip(word(HEIGHTS_AT + 4)).filter(|_| bytes.len() >= HEADER_BYTES);
    let (low, high) = heights.ok_or_else(too_short)?;
    if !(low <= high && low.abs() <= MAX_HEIGHT_M && high.abs() <= MAX_HEIGHT_M) {
        return Err(format!("header: heights from {low} to {high} m"));
    }
    Ok([low.into(), high.into()])
}

/// Parses a tile without compression. Nothing is allocated before the bytes for it are known to be there.
pub(super) fn parse(bytes: &[u8], max_vertices: usize) -> Result<QuantizedMesh<'_>, String> {
    let [low, high] = header_heights_m(bytes)?;
    let mut reader = Reader { bytes, at: 0 };
    reader.take(HEADER_BYTES, "header")?;
    let count = reader.u32("vertex count")? as usize;
    if count > max_vertices {
        return Err(format!("{count} vertices, at most {max_vertices} are read"));
    }
    about_to_allocate(VERTEX_BYTES * count as u64).map_err(|error| error.to_string())?;
    let u = reader.coordinates(count, "u")?;
    let v = reader.coordinates(count, "v")?;
    let heights = reader.coordinates(count, "heights")?;
    let index_bytes = if count > MAX_SHORT_VERTICES { 4 } else { 2 };
    reader.at = reader.at.next_multiple_of(index_bytes).min(bytes.len());
    let triangles = reader.elements(3 * index_bytes, "triangles")?;
    about_to_allocate(TRIANGLE_BYTES * (triangles.len() / index_bytes / 3) as u64)
        .map_err(|error| error.to_string())?;
    let triangles = decode_triangles(triangles, index_bytes, count)?;
    let mut edges: [Vec<u32>; 4] = Default::default();
    for (edge, what) in edges.iter_mut().zip(["western edge", "southern edge", "eastern edge", "northern edge"]) {
        *edge = indices(reader.elements(index_bytes, what)?, index_bytes).collect();
        if let Some(index) = edge.iter().find(|index| **index as usize >= count) {
            return Err(format!("{what}: index {index} of {count} vertices"));
        }
    }
    let places = u.into_iter().zip(v).zip(heights);
    let vertex = |((u, v), share): ((f64, f64), f64)| SurfaceVertex {
        u,
        v,
        height_m: low + (high - low) * share,
        normal: Vec3::ZERO,
    };
    let vertices = places.map(vertex).collect();
    let surface = Surface { vertices, triangles, edges, normals: Normals::Computed };
    let mut mesh = QuantizedMesh { surface, metadata: None, water: None, unknown_extensions: 0 };
    while reader.at < bytes.len() {
        let id = reader.take(1, "extension")?[0];
        let data = reader.elements(1, "extension")?;
        mesh.add_extension(id, data)?;
    }
    if mesh.surface.triangles.is_empty() {
        return Err("no triangles".to_owned());
    }
    Ok(mesh)
}

impl<'a> QuantizedMesh<'a> {
    fn add_extension(&mut self, id: u8, data: &'a [u8]) -> Result<(), String> {
        match id {
            OCT_VERTEX_NORMALS => {
                let vertices = &mut self.surface.vertices;
                if data.len() != 2 * vertices.len() {
                    let (got, count) = (data.len(), vertices.len());
                    return Err(format!("extension octvertexnormals: {got} bytes for {count} vertices"));
                }
                for (vertex, code) in vertices.iter_mut().zip(data.chunks_exact(2)) {
                    vertex.normal = oct_normal([code[0], code[1]]);
                }
                self.surface.normals = Normals::Given;
            }
            WATER_MASK => {
                let invalid = || format!("extension watermask: {} bytes, expected 1 or 65536", data.len());
                self.water = Some(Water::of_mask(data).ok_or_else(invalid)?);
            }
            METADATA => {
                let mut reader = Reader { bytes: data, at: 0 };
                self.metadata = Some(reader.elements(1, "extension metadata")?);
            }
            _ => self.unknown_extensions += 1,
        }
        Ok(())
    }
}

/// Returns indices of 2 or 4 bytes.
fn indices(bytes: &[u8], size: usize) -> impl Iterator<Item = u32> {
    bytes.chunks_exact(size).map(|b| b.iter().rev().fold(0, |value, byte| value << 8 | u32::from(*byte)))
}

/// Returns triangles whose indices are stored as distances from the highest index so far.
fn decode_triangles(bytes: &[u8], size: usize, vertices: usize) -> Result<Vec<[u32; 3]>, String> {
    let mut next = 0u32;
    let mut decoded = Vec::with_capacity(bytes.len() / size / 3);
    let mut triangle = [0; 3];
    for (i, code) in indices(bytes, size).enumerate() {
        let index = next.checked_sub(code).filter(|index| (*index as usize) < vertices);
        let index = index.ok_or_else(|| format!("triangles: index {i} has the code {code} after {next} vertices"))?;
        next += u32::from(code == 0);
        triangle[i % 3] = index;
        if i % 3 == 2 {
            decoded.push(triangle);
        }
    }
    Ok(decoded)
}

/// Returns the unit vector of two bytes on an octahedron (Cigolle et al. 2014, A Survey of Efficient Representations for
/// Independent Unit Vectors).
fn oct_normal(code: [u8; 2]) -> Vec3 {
    let [x, y] = code.map(|byte| f32::from(byte) / 255.0 * 2.0 - 1.0);
    let z = 1.0 - x.abs() - y.abs();
    let flat = Vec2::new(x, y);
    let folded = if z < 0.0 { (Vec2::ONE - Vec2::new(y.abs(), x.abs())) * flat.map(not_zero_sign) } else { flat };
    folded.extend(z).normalize_or(Vec3::Z)
}

fn not_zero_sign(x: f32) -> f32 {
    if x >= 0.0 { 1.0 } else { -1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A tile of two triangles, with extensions.
    fn tile(extensions: &[(u8, Vec<u8>)]) -> Vec<u8> {
        let mut bytes = vec![0; 24];
        [-10.0f32, 90.0].iter().for_each(|height| bytes.extend(height.to_le_bytes()));
        bytes.resize(HEADER_BYTES, 0);
        bytes.extend(4u32.to_le_bytes());
        let zigzag = |difference: i32| (difference << 1 ^ difference >> 31) as u16;
        for values in [[0, 32767, 0, 32767], [0, 0, 32767, 32767], [0, 16384, 32767, 0]] {
            let mut before = 0;
            for value in values {
                bytes.extend(zigzag(value - before).to_le_bytes());
                before = value;
            }
        }
        bytes.extend(2u32.to_le_bytes());
        for code in [0u16, 0, 0, 1, 2, 0] {
            bytes.extend(code.to_le_bytes());
        }
        for edge in [[0u16, 2], [0, 1], [1, 3], [2, 3]] {
            bytes.extend(2u32.to_le_bytes());
            edge.iter().for_each(|index| bytes.extend(index.to_le_bytes()));
        }
        for (id, data) in extensions {
            bytes.push(*id);
            bytes.extend((data.len() as u32).to_le_bytes());
            bytes.extend(data);
        }
        bytes
    }

    #[test]
    fn vertices_triangles_and_edges_are_decoded() {
        let bytes = tile(&[]);
        let mesh = parse(&bytes, 100).unwrap();
        let places: Vec<_> = mesh.surface.vertices.iter().map(|p| (p.u, p.v, p.height_m.round())).collect();
        assert_eq!(places, [(0.0, 0.0, -10.0), (1.0, 0.0, 40.0), (0.0, 1.0, 90.0), (1.0, 1.0, -10.0)]);
        assert_eq!(mesh.surface.triangles, [[0, 1, 2], [2, 1, 3]]);
        assert_eq!(mesh.surface.edges, [vec![0, 2], vec![0, 1], vec![1, 3], vec![2, 3]]);
        assert_eq!((mesh.surface.normals, mesh.metadata, mesh.water), (Normals::Computed, None, None));
    }

    #[test]
    fn extensions_are_read() {
        let metadata = [vec![2, 0, 0, 0], b"{}".to_vec()].concat();
        let normals = vec![128, 128, 255, 128, 128, 0, 0, 0];
        let bytes = tile(&[(1, normals), (2, vec![255]), (9, vec![1, 2, 3]), (4, metadata)]);
        let mesh = parse(&bytes, 100).unwrap();
        assert_eq!((mesh.metadata, mesh.unknown_extensions), (Some(&b"{}"[..]), 1));
        assert_eq!(mesh.water, Some(Water::Uniform(255)));
        let expected = [Vec3::Z, Vec3::X, Vec3::NEG_Y, Vec3::NEG_Z];
        for (vertex, expected) in mesh.surface.vertices.iter().zip(expected) {
            assert!(vertex.normal.distance(expected) < 0.02, "{} {expected}", vertex.normal);
        }
    }

    #[test]
    fn damaged_tiles_are_refused() {
        let whole = tile(&[(2, vec![0])]);
        for length in 0..whole.len() {
            // Without its extensions the tile is whole.
            let is_whole = length == tile(&[]).len();
            assert_eq!(parse(&whole[..length], 100).is_ok(), is_whole, "{length} bytes");
        }
        let changed = |at: usize, byte: u8| {
            let mut bytes = tile(&[]);
            bytes[at] = byte;
            parse(&bytes, 100).unwrap_err()
        };
        assert!(changed(91, 255).contains("vertices, at most 100"), "the vertex count");
        assert!(changed(31, 255).contains("heights from"));
        assert!(changed(93, 255).contains("u: vertex 1"));
        assert!(changed(120, 9).contains("triangles: index 0"));
        assert!(changed(136, 77).contains("western edge: index 77 of 4"));
        assert!(parse(&tile(&[(1, vec![0; 7])]), 100).unwrap_err().contains("octvertexnormals"));
        assert!(parse(&tile(&[(2, vec![0; 7])]), 100).unwrap_err().contains("watermask"));
        assert!(parse(&tile(&[(4, vec![9, 0, 0, 0])]), 100).unwrap_err().contains("metadata"));
    }

    #[test]
    fn many_vertices_have_long_indices_at_even_places() {
        let count = MAX_SHORT_VERTICES + 1;
        let mut bytes = vec![0; HEADER_BYTES];
        bytes.extend((count as u32).to_le_bytes());
        bytes.resize(bytes.len() + 6 * count, 0);
        bytes.resize(bytes.len().next_multiple_of(4), 0);
        bytes.extend(1u32.to_le_bytes());
        bytes.resize(bytes.len() + 12, 0);
        bytes.resize(bytes.len() + 16, 0);
        assert_eq!(parse(&bytes, count).unwrap().surface.triangles, [[0, 1, 2]]);
    }
}
