//! [`Looks`]: the looks of the vertices of a mesh.

use std::collections::HashMap;

use glam::{DAffine3, DVec3};

use super::look::Look;
use super::style::Style;
use super::subject::{Point, Subject};
use crate::math::color::srgb_from_linear;
use crate::scene::{DrawableFeatures, FeatureIdSet, FeatureIds, Mesh, MeshVertex, PropertyTable};

/// The ids of the features that a style looks at, with their properties.
#[derive(Clone, Copy)]
pub(super) struct FeatureColumn<'a> {
    pub set: &'a FeatureIdSet,
    pub table: Option<&'a PropertyTable>,
}

impl<'a> FeatureColumn<'a> {
    /// Returns the first ids that have properties, or else the first ids; those of instances are before those of meshes. Ids
    /// in images are left out.
    pub fn of(features: &'a DrawableFeatures) -> Option<Self> {
        let table = |set: &FeatureIdSet| set.table.and_then(|table| features.tables.get(table)).map(|table| &**table);
        let sets = || features.sets.iter().filter(|set| !matches!(set.ids, FeatureIds::Texture(_)));
        let set = sets().find(|set| table(set).is_some()).or_else(|| sets().next())?;
        Some(Self { set, table: table(set) })
    }

    /// Returns true if all vertices look alike: they have one id, or the style is the same for all features.
    pub fn is_one_feature(&self, style: &Style) -> bool {
        matches!(self.set.ids, FeatureIds::Uniform(_)) || !style.has_variables() && self.set.null_id.is_none()
    }

    /// Returns the look of the feature with an id; the default for vertices without a feature.
    pub fn look(&self, style: &Style, id: Option<u32>) -> Look {
        id.map_or(Look::DEFAULT, |id| style.look(&self.subject(id)))
    }

    fn subject(&self, id: u32) -> Subject<'a> {
        Subject { row: self.table.map(|table| (table, id as usize)), point: None }
    }
}

/// The looks of all vertices of a mesh.
pub(super) struct Looks {
    /// Looks that occur.
    palette: Vec<Look>,
    /// Indices into `palette` by vertex.
    of_vertices: Vec<u32>,
}

impl Looks {
    /// Returns the same look for all vertices.
    pub fn uniform(look: Look, vertices: usize) -> Self {
        Self { palette: vec![look], of_vertices: vec![0; vertices] }
    }

    /// Evaluates the style once for each feature.
    pub fn of_features(style: &Style, features: FeatureColumn<'_>, vertices: usize) -> Self {
        let (mut palette, mut known) = (Vec::new(), HashMap::new());
        let mut of_vertex = |vertex: usize| {
            let id = features.set.id(vertex as u32);
            *known.entry(id).or_insert_with(|| {
                palette.push(features.look(style, id));
                palette.len() as u32 - 1
            })
        };
        let of_vertices = (0..vertices).map(&mut of_vertex).collect();
        Self { palette, of_vertices }
    }

    /// Evaluates the style for each point.
    pub fn of_points(
        style: &Style,
        features: Option<FeatureColumn<'_>>,
        mesh: &Mesh,
        set_from_mesh: &DAffine3,
    ) -> Self {
        let look = |(i, vertex): (usize, &MeshVertex)| {
            let feature = features.and_then(|features| Some(features.subject(features.set.id(i as u32)?)));
            let point = point(vertex, set_from_mesh);
            style.look(&Subject { point: Some(&point), ..feature.unwrap_or_default() })
        };
        let palette: Vec<Look> = mesh.vertices.iter().enumerate().map(look).collect();
        Self { of_vertices: (0..palette.len() as u32).collect(), palette }
    }

    /// Returns the look of a vertex.
    pub fn of_vertex(&self, vertex: u32) -> &Look {
        let at = self.of_vertices.get(vertex as usize).copied().unwrap_or_default();
        self.palette.get(at as usize).unwrap_or(&Look::DEFAULT)
    }

    /// Returns all looks that occur.
    pub fn all(&self) -> &[Look] {
        &self.palette
    }
}

fn point(vertex: &MeshVertex, set_from_mesh: &DAffine3) -> Point {
    let position = glam::Vec3::from_array(vertex.position).as_dvec3();
    let [x, y, z, _] = vertex.normal.map(f64::from);
    let [r, g, b, a] = vertex.color;
    // Vertices have linear colours in 8 bits.
    let srgb = |linear: u8| srgb_from_linear(f64::from(linear) / 255.0);
    Point {
        position,
        absolute: set_from_mesh.transform_point3(position),
        color: [srgb(r), srgb(g), srgb(b), f64::from(a) / 255.0],
        normal: DVec3::new(x, y, z).try_normalize(),
    }
}
