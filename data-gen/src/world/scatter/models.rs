//! The meshes of trees and rocks, and the glb of their instances.

use serde_json::{Value, json};

use super::{Scatter, glb_container};

/// The kind of model on a site.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Conifer,
    Broadleaf,
    Rock,
    Shrub,
    Stone,
}

/// Triangles of one colour.
struct Part {
    color: [f32; 3],
    triangles: Vec<[[f32; 3]; 3]>,
}

impl Kind {
    pub const ALL: [Self; 5] = [Self::Conifer, Self::Broadleaf, Self::Rock, Self::Shrub, Self::Stone];

    /// Returns the size of an instance by a share of 0..1: the height of trees, half the length of rocks, in metres.
    pub fn scale(self, share: f32) -> f32 {
        match self {
            Self::Conifer => 11.0 + 20.0 * share * share,
            Self::Broadleaf => 8.0 + 14.0 * share * share,
            // Many small ones, few large ones.
            Self::Rock => 0.5 + 5.0 * share * share * share * share,
            Self::Shrub => 0.4 + 1.4 * share * share,
            Self::Stone => 0.08 + 0.4 * share * share,
        }
    }

    /// Returns the mesh of size 1, y up.
    fn parts(self) -> Vec<Part> {
        match self {
            Self::Conifer => {
                let crowns = [(0.14, 0.24, 0.62), (0.36, 0.19, 0.82), (0.60, 0.12, 1.0)];
                let cones = crowns.iter().flat_map(|&(low, radius, top)| cone(low, radius, top, 7));
                vec![trunk(0.2), Part { color: [0.035, 0.075, 0.03], triangles: cones.collect() }]
            }
            Self::Broadleaf => {
                let crown = ball(|[x, y, z]| [0.34 * x, 0.64 + 0.36 * y, 0.34 * z], 0.22);
                vec![trunk(0.4), Part { color: [0.06, 0.115, 0.03], triangles: crown }]
            }
            Self::Shrub => {
                let crown = ball(|[x, y, z]| [0.6 * x, 0.35 + 0.5 * y, 0.6 * z], 0.4);
                vec![Part { color: [0.075, 0.11, 0.04], triangles: crown }]
            }
            Self::Rock | Self::Stone => {
                let stone = ball(|[x, y, z]| [x, 0.25 + 0.6 * y, 0.8 * z], 0.45);
                vec![Part { color: [0.16, 0.145, 0.13], triangles: stone }]
            }
        }
    }
}

/// Returns the points of a circle. Their bits are the same on every machine.
fn circle(sides: u32, radius: f32, y: f32) -> Vec<[f32; 3]> {
    let point = |side: u32| {
        let angle = std::f64::consts::TAU * f64::from(side) / f64::from(sides);
        let (sin, cos) = super::super::points::sin_cos(angle);
        [radius * cos as f32, y, -radius * sin as f32]
    };
    (0..=sides).map(point).collect()
}

fn cone(low: f32, radius: f32, top: f32, sides: u32) -> Vec<[[f32; 3]; 3]> {
    circle(sides, radius, low).windows(2).map(|ends| [ends[0], ends[1], [0.0, top, 0.0]]).collect()
}

fn trunk(height: f32) -> Part {
    let (low, high) = (circle(5, 0.032, -0.08), circle(5, 0.02, height));
    let sides = low.windows(2).zip(high.windows(2));
    let triangles = sides.flat_map(|(low, high)| [[low[0], low[1], high[1]], [low[0], high[1], high[0]]]);
    Part { color: [0.075, 0.05, 0.03], triangles: triangles.collect() }
}

/// Returns an octahedron whose triangles are split once, on a sphere with dents, mapped by a function.
fn ball(map: impl Fn([f32; 3]) -> [f32; 3], dents: f32) -> Vec<[[f32; 3]; 3]> {
    let sign = [1.0f32, -1.0];
    let mut triangles = Vec::new();
    for octant in 0..8usize {
        let [x, y, z] = [0, 1, 2].map(|axis| sign[(octant >> axis) & 1]);
        let corner = [[x, 0.0, 0.0], [0.0, y, 0.0], [0.0, 0.0, z]];
        let middle = |a: usize, b: usize| {
            let sum = [0, 1, 2].map(|k| corner[a][k] + corner[b][k]);
            sum.map(|c: f32| c * std::f32::consts::FRAC_1_SQRT_2)
        };
        let (ab, bc, ca) = (middle(0, 1), middle(1, 2), middle(2, 0));
        let faces = [[corner[0], ab, ca], [ab, corner[1], bc], [ca, bc, corner[2]], [ab, bc, ca]];
        let is_turned = x * y * z < 0.0;
        triangles.extend(faces.map(|[a, b, c]| if is_turned { [a, c, b] } else { [a, b, c] }));
    }
    let dent = |p: [f32; 3]| {
        let bits = p.iter().fold(7u64, |bits, c| terrane::math::random::mix64(bits ^ u64::from((c + 4.0).to_bits())));
        let radius = 1.0 - dents * ((bits & 0xffff) as f32 / 65_536.0);
        map(p.map(|c| c * radius))
    };
    triangles.into_iter().map(|triangle| triangle.map(dent)).collect()
}

/// Buffer views and accessors while a document is written.
#[derive(Default)]
struct Buffer {
    bytes: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
}

impl Buffer {
    /// Adds vectors of floats and returns the number of their accessor.
    fn add<const N: usize>(&mut self, vectors: &[[f32; N]]) -> usize {
        let start = self.bytes.len();
        self.bytes.extend(vectors.as_flattened().iter().flat_map(|c| c.to_le_bytes()));
        self.views.push(json!({ "buffer": 0, "byteOffset": start, "byteLength": self.bytes.len() - start }));
        let bound = |pick: fn(f32, f32) -> f32| {
            vectors
                .iter()
                .copied()
                .reduce(|a, b| std::array::from_fn(|k| pick(a[k], b[k])))
                .unwrap_or([0.0; N])
                .to_vec()
        };
        self.accessors.push(json!({
            "bufferView": self.views.len() - 1, "componentType": 5126, "count": vectors.len(),
            "type": if N == 3 { "VEC3" } else { "VEC4" }, "min": bound(f32::min), "max": bound(f32::max),
        }));
        self.accessors.len() - 1
    }
}

/// Returns the glb of instances. One without any is a glb without meshes.
pub(super) fn glb(scatter: &Scatter) -> Vec<u8> {
    let mut buffer = Buffer::default();
    let (mut nodes, mut meshes, mut materials) = (vec![Value::Null], Vec::new(), Vec::new());
    for (kind, instances) in Kind::ALL.into_iter().zip(&scatter.instances) {
        if instances.is_empty() {
            continue;
        }
        let primitives: Vec<Value> = kind
            .parts()
            .iter()
            .map(|part| {
                let positions = buffer.add(part.triangles.as_flattened());
                let normals: Vec<[f32; 3]> = part.triangles.iter().flat_map(|triangle| [normal(triangle); 3]).collect();
                let normals = buffer.add(&normals);
                let [red, green, blue] = part.color;
                materials.push(json!({ "pbrMetallicRoughness": {
                    "metallicFactor": 0.0, "roughnessFactor": 1.0, "baseColorFactor": [red, green, blue, 1.0],
                } }));
                json!({ "attributes": { "POSITION": positions, "NORMAL": normals }, "material": materials.len() - 1 })
            })
            .collect();
        meshes.push(json!({ "primitives": primitives }));
        let translations: Vec<[f32; 3]> = instances.iter().map(|instance| instance.at_m).collect();
        let rotations: Vec<[f32; 4]> = instances
            .iter()
            .map(|instance| {
                let (sin, cos) = super::super::points::sin_cos(f64::from(instance.half_turn));
                [0.0, sin as f32, 0.0, cos as f32]
            })
            .collect();
        let scales: Vec<[f32; 3]> = instances.iter().map(|instance| [instance.scale; 3]).collect();
        let attributes = json!({
            "TRANSLATION": buffer.add(&translations), "ROTATION": buffer.add(&rotations), "SCALE": buffer.add(&scales),
        });
        nodes.push(json!({
            "mesh": meshes.len() - 1, "extensions": { "EXT_mesh_gpu_instancing": { "attributes": attributes } },
        }));
    }
    let asset = json!({ "version": "2.0", "generator": "terrane" });
    if meshes.is_empty() {
        return glb_container(&json!({ "asset": asset, "scene": 0, "scenes": [{}] }), &[]);
    }
    // From east, up and south to the earth's axes, which glTF turns so that y is up.
    let frame = scatter.ellipsoid.ecef_from_enu(&scatter.origin);
    let axes = [frame.matrix3.x_axis, frame.matrix3.z_axis, -frame.matrix3.y_axis, frame.translation];
    let matrix: Vec<f64> =
        axes.iter().zip([0.0, 0.0, 0.0, 1.0]).flat_map(|(axis, w)| [axis.x, axis.z, -axis.y, w]).collect();
    nodes[0] = json!({ "matrix": matrix, "children": (1..nodes.len()).collect::<Vec<_>>() });
    let extensions = json!(["EXT_mesh_gpu_instancing"]);
    let document = json!({
        "asset": asset, "scene": 0, "scenes": [{ "nodes": [0] }], "nodes": nodes, "meshes": meshes, "materials": materials,
        "accessors": buffer.accessors, "bufferViews": buffer.views, "buffers": [{ "byteLength": buffer.bytes.len() }],
        "extensionsUsed": extensions, "extensionsRequired": extensions,
    });
    glb_container(&document, &buffer.bytes)
}

fn normal([a, b, c]: &[[f32; 3]; 3]) -> [f32; 3] {
    let (u, v) = ([0, 1, 2].map(|k| b[k] - a[k]), [0, 1, 2].map(|k| c[k] - a[k]));
    let n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
    let length = (n[0] * n[0] + n[1] * n[1] + n[2] * n[2]).sqrt().max(1e-12);
    n.map(|c| c / length)
}
