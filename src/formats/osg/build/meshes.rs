//! Geometries as meshes: arrays of any type, bindings and primitive sets become indexed triangles, lines and points.

use std::sync::Arc;

use glam::DVec3;

use super::coordinates::UvMap;
use super::textures::BuiltTexture;
use super::units::Unit;
use super::{Builder, Meshes};
use crate::fetch::about_to_allocate;
use crate::formats::osg::error::{OsgError, Result};
use crate::formats::osg::input::{Number, Values};
use crate::formats::osg::objects::{Binding, BoundArray, GeometryObject, Indices, PrimitiveObject};
use crate::math::Aabb;
use crate::math::color::linear_rgba;
use crate::scene::{AttributeFormat, Mesh, MeshVertex, PrimitiveMode, SecondUv, Topology, VertexAttributes};

/// The bytes that a vertex takes until it is one of a mesh.
const VERTEX_BYTES: u64 = 64;
/// The bytes that an index takes: in its primitive set, assembled, and in the list of a mesh.
const INDEX_BYTES: u64 = 12;

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
        let [s, t] = self.map.map_or([of.x, of.y], |map| map.point(of));
        let (s, t) = (s as f32, t as f32);
        // OSG's t goes up, Terrane's v down from the first row of an image.
        [s, if self.starts_at_bottom { t } else { 1.0 - t }]
    }
}

/// The texture coordinates of a mesh.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub(super) struct UvSets {
    /// The coordinates of the vertices.
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

    /// Returns the third coordinate r of a unit if all vertices have the same one, and otherwise `None`.
    pub(super) fn depth_of_uvs(&self, unit: usize) -> Option<f64> {
        let array = &self.uvs(unit)?.array;
        let depth = |element: usize| if array.width > 2 { array.get(element, 2) } else { 0.0 };
        let first = depth(0);
        (first.is_finite() && (1..array.count()).all(|element| depth(element) == first)).then_some(first)
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

    /// Passes the first values for each corner to `put`; integers are divided by their largest value if `scales`.
    fn for_each<const N: usize>(&self, corners: impl Iterator<Item = Corner>, scales: bool, put: impl FnMut([f64; N])) {
        self.array.for_each(corners.map(|corner| self.element(corner)), scales, put);
    }

    fn width(&self) -> usize {
        self.array.array.width
    }
}

impl Arrays<'_> {
    /// Passes the position of each vertex to `put`.
    fn for_each_position(&self, vertices: impl Iterator<Item = usize>, mut put: impl FnMut(DVec3)) {
        self.positions.for_each(vertices, self.positions.is_normalized, |position| put(DVec3::from_array(position)));
    }

    /// Passes the texture coordinates of each corner to `put`; nothing if the geometry has none.
    fn for_each_uv(&self, uvs: &Uvs<'_>, corners: impl Iterator<Item = Corner>, mut put: impl FnMut([f32; 2])) {
        match &uvs.array {
            _ if uvs.set.is_of_positions() => {
                self.for_each_position(corners.map(|corner| corner.vertex), |position| put(uvs.set.mapped(position)));
            }
            Some(array) => {
                let is_normalized = array.array.is_normalized;
                array.for_each(corners, is_normalized, |[s, t]| put(uvs.set.mapped(DVec3::new(s, t, 0.0))));
            }
            None => {}
        }
    }

    /// Makes the vertices of corners, one array after the other.
    fn vertices(&self, corners: &(impl Iterator<Item = Corner> + Clone)) -> Vec<MeshVertex> {
        let mut vertices: Vec<MeshVertex> = Vec::with_capacity(corners.size_hint().0);
        self.for_each_position(corners.clone().map(|corner| corner.vertex), |position| {
            let position = (position - self.origin).as_vec3().to_array();
            vertices.push(MeshVertex { position, uv: [0.0; 2], normal: [0; 4], color: [255; 4] });
        });
        let mut each = vertices.iter_mut();
        self.for_each_uv(&self.uvs, corners.clone(), |uv| each.next().into_iter().for_each(|vertex| vertex.uv = uv));
        if let Some(normals) = self.normals {
            let mut each = vertices.iter_mut();
            normals.for_each(corners.clone(), true, |normal| {
                let normal = packed_normal(DVec3::from_array(normal));
                each.next().into_iter().for_each(|vertex| vertex.normal = normal);
            });
        }
        if let Some(colors) = self.colors {
            let mut each = vertices.iter_mut();
            colors.for_each(corners.clone(), true, |mut color: [f64; 4]| {
                color.iter_mut().skip(colors.width()).for_each(|part| *part = 1.0);
                let color = linear_rgba(color.map(|part| part as f32)).map(|part| (part * 255.0).round() as u8);
                each.next().into_iter().for_each(|vertex| vertex.color = color);
            });
        }
        vertices
    }

    /// Returns true if some array has an element for each primitive set or primitive: vertices differ between them.
    fn binds(&self, binding: Binding) -> bool {
        [self.normals, self.colors, self.uvs.array].into_iter().flatten().any(|attribute| attribute.binding == binding)
    }
}

/// Returns a normal in the format of vertices.
fn packed_normal(normal: DVec3) -> [i8; 4] {
    /// Squares of lengths that are nearer to 1 count as 1: less than a hundredth of the format's step.
    const MAX_DEVIATION: f64 = 1e-4;
    let is_unit = (normal.length_squared() - 1.0).abs() < MAX_DEVIATION;
    let normal = if is_unit { normal } else { normal.normalize_or_zero() };
    // The cast cuts, as rounding is a call on processors without an instruction for it.
    let packed = |part: f64| (part * 127.0 + 0.5_f64.copysign(part)) as i8;
    [packed(normal.x), packed(normal.y), packed(normal.z), 0]
}

impl Builder<'_> {
    /// Makes the meshes of a geometry: at most one for each topology.
    pub(super) fn geometry(&mut self, geometry: &GeometryObject, uv_sets: UvSets, has_colors: bool) -> Result<Meshes> {
        let empty = Meshes { origin: DVec3::ZERO, meshes: Vec::new() };
        let Some(positions) = geometry.vertices.as_ref().filter(|array| array.count() > 0) else { return Ok(empty) };
        let (count, sets) = (positions.count(), geometry.primitives.len());
        self.vertices = self.counted(self.vertices, count, "vertices of an OpenSceneGraph file", 1)?;
        about_to_allocate(VERTEX_BYTES * count as u64)?;
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
        let mut is_finite = true;
        arrays.for_each_position(0..count, |position| is_finite &= position.is_finite());
        if !is_finite {
            return Err(OsgError::invalid("a vertex whose position is not finite"));
        }
        if matches!(positions.array.values, Values::F64(_)) {
            // Positions on the GPU have 24 bits, so that they must be near their origin.
            let mut bounds = Aabb::EMPTY;
            arrays.for_each_position(0..count, |position| bounds = bounds.with(position));
            arrays.origin = bounds.center();
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
        let mut lists: [Vec<Arc<[u32]>>; 3] = Default::default();
        for set in &geometry.primitives {
            for indices in self.runs(set, arrays.count)? {
                let (topology, indices) = self.assembled(set, indices)?;
                let at = TOPOLOGIES.iter().position(|known| *known == topology);
                if let Some(at) = at.filter(|_| !indices.is_empty()) {
                    lists[at].push(indices);
                }
            }
        }
        let is_single = lists.iter().filter(|list| !list.is_empty()).count() == 1;
        let mut meshes = Vec::new();
        for (topology, sets) in TOPOLOGIES.into_iter().zip(lists).filter(|(_, sets)| !sets.is_empty()) {
            let corner = |vertex: usize| Corner { vertex, set: 0, primitive: 0 };
            meshes.push(if is_single {
                // Most geometries have one set, whose list is not copied.
                let list = <[_; 1]>::try_from(sets).map_or_else(|sets| sets.concat().into(), |[list]| list);
                self.mesh(geometry, arrays, &(0..arrays.count).map(corner), list, topology)?
            } else {
                let mut list = sets.concat();
                let used = compacted(&mut list, arrays.count);
                let corners = used.iter().map(|vertex| corner(*vertex as usize));
                self.mesh(geometry, arrays, &corners, list.into(), topology)?
            });
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
                about_to_allocate(VERTEX_BYTES * list.len() as u64)?;
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
            meshes.push(self.mesh(geometry, arrays, &corners.iter().copied(), indices.into(), topology)?);
        }
        Ok(meshes)
    }

    /// Makes a mesh of corners.
    fn mesh(
        &self,
        geometry: &GeometryObject,
        arrays: &Arrays<'_>,
        corners: &(impl Iterator<Item = Corner> + Clone),
        indices: Arc<[u32]>,
        topology: Topology,
    ) -> Result<Mesh> {
        let attributes = self.attributes(geometry, corners, arrays)?;
        Ok(Mesh { attributes, indices, ..Mesh::new(arrays.vertices(corners), Vec::new(), topology) })
    }

    /// Returns the vertices of a primitive set: one list, or one for each length. Fails if one is outside of the arrays.
    fn runs(&mut self, set: &PrimitiveObject, vertices: usize) -> Result<Vec<Arc<[u32]>>> {
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
                let indices: Arc<[u32]> = match values {
                    Values::Whole(Number::U8 | Number::U16 | Number::U32, values) => {
                        values.iter().map(|index| *index as u32).collect()
                    }
                    _ => (0..values.len()).map(|i| values.get(i) as u32).collect(),
                };
                match indices.iter().max().filter(|index| **index as usize >= vertices) {
                    Some(index) => Err(OsgError::invalid(format!("index {index} of {vertices} vertices"))),
                    None => Ok(vec![indices]),
                }
            }
        }
    }

    /// Converts the vertices of a primitive set to a list of triangles, lines or points.
    fn assembled(&mut self, set: &PrimitiveObject, indices: Arc<[u32]>) -> Result<(Topology, Arc<[u32]>)> {
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
        Ok(mode.assemble(indices))
    }

    /// Returns the second and third texture coordinates, and the further ones that the options ask for.
    fn attributes(
        &self,
        geometry: &GeometryObject,
        corners: &(impl Iterator<Item = Corner> + Clone),
        arrays: &Arrays<'_>,
    ) -> Result<VertexAttributes> {
        let mut attributes = VertexAttributes::default();
        let mut add = |name: &str, uvs: &Uvs<'_>| {
            if uvs.array.is_none() && !uvs.set.is_of_positions() {
                return Ok(());
            }
            let mut values: Vec<[f32; 2]> = Vec::with_capacity(corners.size_hint().0);
            arrays.for_each_uv(uvs, corners.clone(), |uv| values.push(uv));
            let bytes = bytemuck::cast_slice(&values).into();
            let pushed = attributes.push(values.len(), name, AttributeFormat::Float32x2, bytes);
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
        about_to_allocate(INDEX_BYTES * more as u64)?;
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
    fn normals_are_packed_at_unit_length() {
        let near = |a: [i8; 4], b: [i8; 4]| a.iter().zip(b).all(|(a, b)| a.abs_diff(b) <= 1);
        for direction in [DVec3::X, -DVec3::Z, DVec3::new(1.0, -2.0, 3.0), DVec3::ONE] {
            let unit = packed_normal(direction.normalize());
            for length in [0.99996, 1.00004, 0.9, 1e-30, 1e30] {
                let packed = packed_normal(direction.normalize() * length);
                assert!(near(packed, unit), "{packed:?} and {unit:?} of length {length}");
            }
        }
        assert_eq!(packed_normal(DVec3::ZERO), [0; 4]);
        assert_eq!(packed_normal(DVec3::NAN), [0; 4]);
        assert_eq!(packed_normal(DVec3::X), [127, 0, 0, 0]);
    }

    #[test]
    fn numbers_are_scaled_by_the_largest_of_their_type() {
        assert_eq!(Number::U8.one(), 255.0);
        assert_eq!(Number::I16.one(), 32767.0);
    }
}
