//! Simple drawables and textures: a rectangle, a mesh of given vertices, a ball, a texture with mips.

use std::sync::Arc;

use glam::{DAffine3, DVec3};
use terrane::math::Aabb;
use terrane::scene::{Drawable, Geometry, Material, Mesh, MeshVertex, Node, Texture, Topology};

/// Returns a rectangle that faces +z, in one unlit color.
pub fn quad(center: [f32; 3], half: [f32; 2], color: [f32; 4]) -> Drawable {
    let corner = |sx: f32, sy: f32| MeshVertex {
        position: [center[0] + sx * half[0], center[1] + sy * half[1], center[2]],
        uv: [0.5 + 0.5 * sx, 0.5 - 0.5 * sy],
        normal: [0, 0, 127, 0],
        color: [255; 4],
    };
    let vertices = vec![corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)];
    let material = Material { base_color: color, unlit: true, ..Material::default() };
    Drawable::new(Geometry::Mesh(Arc::new(mesh(vertices, vec![0, 1, 2, 0, 2, 3]))), material)
}

/// Returns a mesh of triangles with the bounds of its vertices.
pub fn mesh(vertices: Vec<MeshVertex>, indices: Vec<u32>) -> Mesh {
    let bounds = Aabb::from_points(vertices.iter().map(|v| DVec3::from_array(v.position.map(f64::from))));
    Mesh { vertices, indices: indices.into(), topology: Topology::Triangles, bounds, ..Mesh::default() }
}

/// Returns a texture with box-filtered mip levels.
pub fn with_mips(width: u32, height: u32, pixels: Vec<u8>) -> Texture {
    let mut mips = vec![pixels];
    let (mut w, mut h) = (width as usize, height as usize);
    while w > 1 || h > 1 {
        let (nw, nh) = ((w / 2).max(1), (h / 2).max(1));
        let above = mips.last().unwrap();
        let mut level = Vec::with_capacity(nw * nh * 4);
        for y in 0..nh {
            for x in 0..nw {
                for c in 0..4 {
                    let texel = |dx: usize, dy: usize| {
                        u32::from(above[((2 * y + dy).min(h - 1) * w + (2 * x + dx).min(w - 1)) * 4 + c])
                    };
                    level.push(((texel(0, 0) + texel(1, 0) + texel(0, 1) + texel(1, 1)) / 4) as u8);
                }
            }
        }
        mips.push(level);
        (w, h) = (nw, nh);
    }
    Texture::rgba8(width, height, mips)
}

/// Returns a ball in one unlit color.
pub fn ball(at: DVec3, radius: f64, color: [f32; 4]) -> Node {
    let mesh = Mesh::sphere(DVec3::ZERO, radius, 24);
    let material = Material { base_color: color, unlit: true, ..Material::default() };
    let geode = Node::geode(vec![Drawable::new(Geometry::Mesh(Arc::new(mesh)), material)]);
    Node::transform(DAffine3::from_translation(at), vec![geode])
}
