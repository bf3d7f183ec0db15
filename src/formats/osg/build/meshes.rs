//! Geometries as meshes: arrays of any type, bindings and primitive sets become indexed triangles, lines and points.

use std::sync::Arc;

use glam::DVec3;

use super::coordinates::UvMap;
use super::textures::BuiltTexture;
use super::units::Unit;
use super::{Builder, Meshes};
use crate::formats::osg::error::{OsgError, Result};
use crate::formats::osg::input::Values;
use crate::formats::osg::objects::{Binding, BoundArray, GeometryObject, Indices, PrimitiveObject};
use crate::math::Aabb;
use crate::math::color::linear_rgba;
use crate::scene::{AttributeFormat, Mesh, MeshVertex, PrimitiveMode, SecondUv, Topology, VertexAttributes};

const TOPOLOGIES: [Topology; 3] = [Topology::Triangles, Topology::Lines, Topology::Points];

/// The numbers by which arrays of each binding are read for a vertex.
#[derive(Clone, Copy)]
struct Corner {
    vertex: usize,
    set: usize,
    primitive: usize,
}

/// The texture coordinates of a texture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub(super) struct UvSet {
    /// The texture unit.
    unit: usize,
    /// True if t = 0 is at the first row of the image.
    pub starts_at_bottom: bool,
    /// The map to the coordinates; `None` for those of the geometry as they are.
    map: Option<UvMap>,
}

impl UvSet {
    /// Returns the coordinates of a unit, which meshes can make, for its texture.
    pub fn of(unit: &Unit, texture: Option<&BuiltTexture>) -> Self {
        let starts_at_bottom = texture.is_some_and(|texture| texture.starts_at_bottom);
        let coordinates = match texture.filter(|_| unit.is_in_texels) {
            Some(texture) => unit.coordinates.of_rectangle([texture.shared.0.width, texture.shared.0.height]),
            None => unit.coordinates,
        };
        Self { unit: unit.number, starts_at_bottom, map: coordinates.of_meshes().flatten() }
    }

    /// Returns true if positions decide and not the geometry's own coordinates.
    pub fn is_of_positions(&self) -> bool {
        self.map.is_some_and(|map| map.is_of_positions)
    }

    /// Returns the coordinates from the first row of the image, for a position or for the geometry's own s and t.
    pub fn mapped(&self, of: DVec3) -> [f32; 2] {
        let [s, t] = self.map.map_or([of.x, of.y], |map| map.point(of)).map(|part| part as f32);
        // OSG's t goes up, Terrane's v down from the first row of an image.
        [s, if self.starts_at_bottom { t } else { 1.0 - t }]
    }
}

/// The texture coordinates of a mesh.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub(super) struct UvSets {
    /// Those of the vertices.
    pub first: UvSet,
    /// The second ones, if they differ.
    pub second: Option<UvSet>,
    /// The third ones, for the fixed function.
    pub third: Option<UvSet>,
}

impl GeometryObject {
    /// Returns true if there are coordinates of a unit.
    pub(super) fn has_uvs(&self, unit: usize) -> bool {
        self.uvs(unit).is_some()
    }

    /// Returns true if two sets are the same coordinates.
    pub(super) fn has_equal_uvs(&self, a: UvSet, b: UvSet) -> bool {
        (a.starts_at_bottom, a.map) == (b.starts_at_bottom, b.map) && self.has_equal_arrays(a.unit, b.unit)
    }

    /// Returns the index of a unit's own coordinates among the sets of a mesh, to which they are added if they are new;
    /// `None` if a mesh has no more.
    pub(super) fn place_of_uvs(&self, unit: usize, sets: &mut Vec<UvSet>) -> Option<usize> {
        /// The number of sets of a mesh.
        const MAX_SETS: usize = 3;
        let known = sets.iter().position(|set| set.map.is_none() && self.has_equal_arrays(set.unit, unit));
        if known.is_some() || sets.len() >= MAX_SETS {
            return known;
        }
        sets.push(UvSet { unit, starts_at_bottom: true, map: None });
        Some(sets.len() - 1)
    }

    fn has_equal_arrays(&self, a: usize, b: usize) -> bool {
        let is_same = |a: &BoundArray, b: &BoundArray| match (&a.indices, &b.indices) {
            (None, None) => Arc::ptr_eq(&a.array, &b.array) || a.array.has_equal_values(&b.array),
            (Some(of_a), Some(of_b)) => Arc::ptr_eq(&a.array, &b.array) && Arc::ptr_eq(of_a, of_b),
            _ => false,
        };
        a == b || self.uvs(a).zip(self.uvs(b)).is_some_and(|(a, b)| is_same(a, b))
    }

    fn uvs(&self, unit: usize) -> Option<&BoundArray> {
        self.tex_coords.get(unit)?.as_ref()
    }
}

/// The arrays of a geometry.
struct Arrays<'a> {
    count: usize,
    positions: &'a BoundArray,
    normals: Option<Attribute<'a>>,
    colors: Option<Attribute<'a>>,
    uvs: Uvs<'a>,
    second: Option<Uvs<'a>>,
    third: Option<Uvs<'a>>,
    origin: DVec3,
}

/// A set of texture coordinates with the array that they come from.
#[derive(Clone, Copy)]
struct Uvs<'a> {
    set: UvSet,
    array: Option<Attribute<'a>>,
}

/// An array with the binding that applies.
#[derive(Clone, Copy)]
struct Attribute<'a> {
    array: &'a BoundArray,
    binding: Binding,
}

impl<'a> Attribute<'a> {
    /// Returns `None` for an array that is off, or that is too short for its binding.
    fn new(array: Option<&'a BoundArray>, vertices: usize, sets: usize) -> Option<Self> {
        let array = array?;
        let count = array.count();
        let binding = array.binding.unwrap_or(match count {
            _ if count == vertices => Binding::PerVertex,
            1 => Binding::Overall,
            _ => Binding::Off,
        });
        let needed = match binding {
            Binding::Off => return None,
            Binding::Overall | Binding::PerPrimitive => 1,
            Binding::PerPrimitiveSet => sets,
            Binding::PerVertex => vertices,
        };
        (count >= needed).then_some(Self { array, binding })
    }

    fn element(&self, corner: Corner) -> usize {
        match self.binding {
            Binding::PerVertex => corner.vertex,
            Binding::PerPrimitiveSet => corner.set,
            Binding::PerPrimitive => corner.primitive,
            Binding::Overall | Binding::Off => 0,
        }
    }

    /// Returns the first values; integers are divided by their largest value if `scales`.
    fn first<const N: usize>(&self, corner: Corner, scales: bool) -> [f64; N] {
        self.array.first(self.element(corner), scales)
    }

    fn width(&self) -> usize {
        self.array.array.width
    }
}

impl BoundArray {
    /// Returns the number of elements, by the indices if there are some.
    fn count(&self) -> usize {
        self.indices.as_ref().map_or(self.array.count(), |indices| indices.count())
    }

    fn first<const N: usize>(&self, element: usize, scales: bool) -> [f64; N] {
        let element = match &self.indices {
            Some(indices) => indices.get(element, 0).max(0.0) as usize,
            None => element,
        };
        let values = self.array.first(element);
        if scales { values.map(|value| value / self.array.values.number().one()) } else { values }
    }
}

impl Arrays<'_> {
    fn position(&self, vertex: usize) -> DVec3 {
        DVec3::from_array(self.positions.first(vertex, self.positions.is_normalized))
    }

    /// Returns texture coordinates; zeros if the geometry has none.
    fn uv(&self, uvs: &Uvs<'_>, corner: Corner) -> [f32; 2] {
        match &uvs.array {
            _ if uvs.set.is_of_positions() => uvs.set.mapped(self.position(corner.vertex)),
            Some(array) => {
                let [s, t] = array.first(corner, array.array.is_normalized);
                uvs.set.mapped(DVec3::new(s, t, 0.0))
            }
            None => [0.0; 2],
        }
    }

    fn vertex(&self, corner: Corner) -> MeshVertex {
        let position = (self.position(corner.vertex) - self.origin).as_vec3().to_array();
        let uv = self.uv(&self.uvs, corner);
        let normal = self.normals.map_or([0; 4], |normals| {
            let normal = DVec3::from_array(normals.first(corner, true)).normalize_or_zero();
            // The cast cuts, as rounding is a call on processors without an instruction for it.
            let [x, y, z] = normal.to_array().map(|part| (part * 127.0 + 0.5_f64.copysign(part)) as i8);
            [x, y, z, 0]
        });
        let color = self.colors.map_or([255; 4], |colors| {
            let mut color: [f64; 4] = colors.first(corner, true);
            color.iter_mut().skip(colors.width()).for_each(|part| *part = 1.0);
            linear_rgba(color.map(|part| part as f32)).map(|part| (part * 255.0).round() as u8)
        });
        MeshVertex { position, uv, normal, color }
    }

    /// Returns true if some array has an element for each primitive set or primitive: vertices differ between them.
    fn binds(&self, binding: Binding) -> bool {
        [self.normals, self.colors, self.uvs.array].into_iter().flatten().any(|attribute| attribute.binding == binding)
    }
}

impl Builder<'_> {
    /// Makes the meshes of a geometry: at most one for each topology.
    pub(super) fn geometry(&mut self, geometry: &GeometryObject, uv_sets: UvSets, has_colors: bool) -> Result<Meshes> {
        let empty = Meshes { origin: DVec3::ZERO, meshes: Vec::new() };
        let Some(positions) = geometry.vertices.as_ref().filter(|array| array.count() > 0) else { return Ok(empty) };
        let (count, sets) = (positions.count(), geometry.primitives.len());
        self.vertices = self.counted(self.vertices, count, "vertices of an OpenSceneGraph file", 1)?;
        let uvs = |set: UvSet| Uvs { set, array: Attribute::new(geometry.uvs(set.unit), count, sets) };
        let mut arrays = Arrays {
            count,
            positions,
            normals: Attribute::new(geometry.normals.as_ref(), count, sets),
            colors: Attribute::new(geometry.colors.as_ref(), count, sets).filter(|_| has_colors),
            uvs: uvs(uv_sets.first),
            second: uv_sets.second.map(uvs),
            third: uv_sets.third.map(uvs),
            origin: DVec3::ZERO,
        };
        let points = || (0..count).map(|vertex| arrays.position(vertex));
        if !points().all(|point| point.is_finite()) {
            return Err(OsgError::invalid("a vertex whose position is not finite"));
        }
        if matches!(positions.array.values, Values::F64(_)) {
            // Positions on the GPU have 24 bits, so that they must be near their origin.
            arrays.origin = Aabb::from_points(points()).center();
        }
        let has_normals = arrays.normals.is_some();
        let meshes = if arrays.binds(Binding::PerPrimitiveSet) || arrays.binds(Binding::PerPrimitive) {
            self.separate_meshes(geometry, &arrays)?
        } else {
            self.joined_meshes(geometry, &arrays)?
        };
        let meshes = meshes.into_iter().filter(|mesh| !mesh.indices.is_empty());
        Ok(Meshes { origin: arrays.origin, meshes: meshes.map(|mesh| (Arc::new(mesh), has_normals)).collect() })
    }

    /// Makes meshes whose primitive sets share all vertices.
    fn joined_meshes(&mut self, geometry: &GeometryObject, arrays: &Arrays<'_>) -> Result<Vec<Mesh>> {
        let mut lists: [Vec<u32>; 3] = Default::default();
        for set in &geometry.primitives {
            for indices in self.runs(set, arrays.count)? {
                let (topology, indices) = self.assembled(set, indices)?;
                if let Some(at) = TOPOLOGIES.iter().position(|known| *known == topology) {
                    lists[at].extend_from_slice(&indices);
                }
            }
        }
        let is_single = lists.iter().filter(|list| !list.is_empty()).count() == 1;
        let mut meshes = Vec::new();
        for (topology, mut list) in TOPOLOGIES.into_iter().zip(lists).filter(|(_, list)| !list.is_empty()) {
            let used = if is_single { (0..arrays.count as u32).collect() } else { compacted(&mut list, arrays.count) };
            let corner = |vertex: &u32| Corner { vertex: *vertex as usize, set: 0, primitive: 0 };
            let corners: Vec<Corner> = used.iter().map(corner).collect();
            let vertices = corners.iter().map(|corner| arrays.vertex(*corner)).collect();
            let attributes = self.attributes(geometry, &corners, arrays)?;
            meshes.push(Mesh { attributes, ..Mesh::new(vertices, list, topology) });
        }
        Ok(meshes)
    }

    /// Makes meshes in which each primitive set, or each primitive, has separate vertices.
    fn separate_meshes(&mut self, geometry: &GeometryObject, arrays: &Arrays<'_>) -> Result<Vec<Mesh>> {
        let mut parts: [(Vec<Corner>, Vec<u32>); 3] = Default::default();
        let mut primitive = 0;
        let is_per_primitive = arrays.binds(Binding::PerPrimitive);
        for (set_index, set) in geometry.primitives.iter().enumerate() {
            for indices in self.runs(set, arrays.count)? {
                // A primitive of a strip is a triangle of it; a polygon is one primitive.
                let corners = corners_of_primitive(set.mode, indices.len());
                let (topology, list) = self.assembled(set, indices)?;
                let Some(at) = TOPOLOGIES.iter().position(|known| *known == topology) else { continue };
                self.vertices = self.counted(self.vertices, list.len(), "vertices of an OpenSceneGraph file", 1)?;
                let (corners_of_part, indices) = &mut parts[at];
                for (i, vertex) in list.iter().enumerate() {
                    let within = if is_per_primitive { i / corners.max(1) } else { 0 };
                    let corner = Corner { vertex: *vertex as usize, set: set_index, primitive: primitive + within };
                    indices.push(corners_of_part.len() as u32);
                    corners_of_part.push(corner);
                }
                primitive += list.len().div_ceil(corners.max(1));
            }
        }
        let mut meshes = Vec::new();
        for (topology, (corners, indices)) in TOPOLOGIES.into_iter().zip(parts) {
            let vertices = corners.iter().map(|corner| arrays.vertex(*corner)).collect();
            let attributes = self.attributes(geometry, &corners, arrays)?;
            meshes.push(Mesh { attributes, ..Mesh::new(vertices, indices, topology) });
        }
        Ok(meshes)
    }

    /// Returns the vertices of a primitive set: one list, or one for each length. Fails if one is outside of the arrays.
    fn runs(&mut self, set: &PrimitiveObject, vertices: usize) -> Result<Vec<Vec<u32>>> {
        if set.instances > 1 {
            self.note("OpenSceneGraph: instances of a primitive set, which is drawn once");
        }
        let span = |first: i64, count: i64| -> Result<std::ops::Range<u32>> {
            let end = first.checked_add(count).filter(|end| first >= 0 && count >= 0 && *end <= vertices as i64);
            match end {
                Some(end) => Ok(first as u32..end as u32),
                None => {
                    let reason =
                        format!("a primitive set of {count} vertices from {first}, where there are {vertices}");
                    Err(OsgError::Invalid(reason))
                }
            }
        };
        match &set.indices {
            Indices::Arrays { first, count } => {
                let span = span(*first, *count)?;
                self.count_indices(span.len())?;
                Ok(vec![span.collect()])
            }
            Indices::Lengths { first, lengths } => {
                let mut first = *first;
                let mut runs = Vec::with_capacity(lengths.len());
                for length in lengths {
                    let span = span(first, i64::from(*length))?;
                    self.count_indices(span.len())?;
                    first += i64::from(*length);
                    runs.push(span.collect());
                }
                Ok(runs)
            }
            Indices::Elements(values) => {
                self.count_indices(values.len())?;
                let indices: Vec<u32> = (0..values.len()).map(|i| values.get(i) as u32).collect();
                match indices.iter().find(|index| **index as usize >= vertices) {
                    Some(index) => Err(OsgError::invalid(format!("index {index} of {vertices} vertices"))),
                    None => Ok(vec![indices]),
                }
            }
        }
    }

    /// Converts the vertices of a primitive set to a list of triangles, lines or points.
    fn assembled(&mut self, set: &PrimitiveObject, indices: Vec<u32>) -> Result<(Topology, Arc<[u32]>)> {
        use PrimitiveMode::{
            LineLoop, LineStrip, Lines, Points, Polygon, QuadStrip, Quads, TriangleFan, TriangleStrip, Triangles,
        };
        let modes =
            [Points, Lines, LineLoop, LineStrip, Triangles, TriangleStrip, TriangleFan, Quads, QuadStrip, Polygon];
        let Some(mode) = modes.get(set.mode as usize) else {
            self.note("OpenSceneGraph: primitives with adjacency, and patches");
            return Ok((Topology::Points, Arc::default()));
        };
        self.count_indices(mode.assembled(indices.len()))?;
        Ok(mode.assemble(indices.into()))
    }

    /// Returns the second and third texture coordinates, and the further ones that the options ask for.
    fn attributes(&self, geometry: &GeometryObject, used: &[Corner], arrays: &Arrays<'_>) -> Result<VertexAttributes> {
        let mut attributes = VertexAttributes::default();
        let mut add = |name: &str, uvs: &Uvs<'_>| {
            if uvs.array.is_none() && !uvs.set.is_of_positions() {
                return Ok(());
            }
            let values: Vec<[f32; 2]> = used.iter().map(|corner| arrays.uv(uvs, *corner)).collect();
            let bytes = bytemuck::cast_slice(&values).into();
            let pushed = attributes.push(used.len(), name, AttributeFormat::Float32x2, bytes);
            pushed.map_err(|error| OsgError::invalid(error.to_string()))
        };
        let further = [(SecondUv::ATTRIBUTE, &arrays.second), (SecondUv::THIRD_ATTRIBUTE, &arrays.third)];
        for (name, uvs) in further {
            uvs.iter().try_for_each(|uvs| add(name, uvs))?;
        }
        for unit in 1..geometry.tex_coords.len() {
            let name = format!("TEXCOORD_{unit}");
            let is_wanted = self.source.options.vertex_attributes.iter().any(|wanted| **wanted == *name);
            if !is_wanted {
                continue;
            }
            let set = UvSet { unit, starts_at_bottom: true, map: None };
            let array = Attribute::new(geometry.uvs(unit), arrays.count, geometry.primitives.len());
            add(&name, &Uvs { set, array })?;
        }
        Ok(attributes)
    }

    fn count_indices(&mut self, more: usize) -> Result<()> {
        self.indices = self.counted(self.indices, more, "indices of an OpenSceneGraph file", 8)?;
        Ok(())
    }

    /// Adds to a counter, and fails beyond `factor` times the limit of elements.
    fn counted(&self, counter: usize, more: usize, what: &'static str, factor: usize) -> Result<usize> {
        let (got, limit) =
            (counter.saturating_add(more), self.source.options.limits.max_elements.saturating_mul(factor));
        match got <= limit {
            true => Ok(got),
            false => Err(OsgError::TooLarge { what, got: got as u64, limit: limit as u64 }),
        }
    }
}

/// Renumbers the indices of a list by the vertices that it uses, and returns those.
fn compacted(list: &mut [u32], count: usize) -> Vec<u32> {
    let mut numbers = vec![u32::MAX; count];
    let mut used = Vec::new();
    for index in list {
        let number = &mut numbers[*index as usize];
        if *number == u32::MAX {
            *number = used.len() as u32;
            used.push(*index);
        }
        *index = *number;
    }
    used
}

/// Returns the number of corners that a primitive has once its set is a list, for a set of `count` vertices.
fn corners_of_primitive(mode: u32, count: usize) -> usize {
    match mode {
        0 => 1,
        1..=3 => 2,
        7 | 8 => 6,
        9 => 3 * count.saturating_sub(2),
        _ => 3,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::osg::input::Number;

    #[test]
    fn lists_are_renumbered_in_their_order() {
        let mut list = [7, 3, 7, 9, 3];
        assert_eq!(compacted(&mut list, 10), [7, 3, 9]);
        assert_eq!(list, [0, 1, 0, 2, 1]);
    }

    #[test]
    fn numbers_are_scaled_by_the_largest_of_their_type() {
        assert_eq!(Number::U8.one(), 255.0);
        assert_eq!(Number::I16.one(), 32767.0);
    }
}
