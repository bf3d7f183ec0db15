//! [`DrawableFeatures`]: the features that a drawable shows.

use std::collections::HashSet;
use std::sync::Arc;

use super::data_texture::{DataTexture, SurfacePoint};
use super::property_table::PropertyTable;
use super::property_value::PropertyValue;
use super::surface_property::SurfaceProperty;

/// How the ids of a set are stored.
#[derive(Clone, Debug, PartialEq)]
pub enum FeatureIds {
    /// An id for each vertex of the mesh.
    PerVertex(Arc<[u32]>),
    /// The index of a vertex is its id.
    VertexIndex,
    /// One id for the whole drawable, such as an instance.
    Uniform(u32),
    /// The channels of a texel are the bytes of an id, the lowest first.
    Texture(DataTexture),
}

/// A set of feature ids. A drawable may have several, such as buildings and their rooms.
#[derive(Clone, Debug, PartialEq)]
pub struct FeatureIdSet {
    /// A name for programs; may be empty.
    pub label: String,
    /// The id of parts that belong to no feature.
    pub null_id: Option<u32>,
    /// The ids.
    pub ids: FeatureIds,
    /// The index of the property table whose rows are the features.
    pub table: Option<usize>,
}

/// The features of a drawable.
#[derive(Clone, Debug, Default)]
pub struct DrawableFeatures {
    /// The sets of ids, in the order of the file.
    pub sets: Vec<FeatureIdSet>,
    /// The property tables of the content, which all of its drawables share.
    pub tables: Arc<[Arc<PropertyTable>]>,
    /// The properties of points of the mesh, from property textures and property attributes.
    pub surface: Arc<[SurfaceProperty]>,
}

/// A feature at a point of a drawable.
#[derive(Clone, Copy, Debug)]
pub struct Feature<'a> {
    /// The label of the set.
    pub label: &'a str,
    /// The id, which is the row of the table.
    pub id: u32,
    /// The table with the properties of the feature.
    pub table: Option<&'a PropertyTable>,
}

impl<'a> Feature<'a> {
    /// Returns the names and values of the properties.
    pub fn properties(&self) -> Vec<(&'a str, PropertyValue)> {
        self.table.map_or(Vec::new(), |table| table.row(self.id as usize))
    }
}

impl FeatureIdSet {
    /// Returns the id at a vertex; `None` if the vertex belongs to no feature, or if ids are in an image.
    pub fn id(&self, vertex: u32) -> Option<u32> {
        let id = match &self.ids {
            FeatureIds::PerVertex(ids) => *ids.get(vertex as usize)?,
            FeatureIds::VertexIndex => vertex,
            FeatureIds::Uniform(id) => *id,
            FeatureIds::Texture(_) => return None,
        };
        Some(id).filter(|id| Some(*id) != self.null_id)
    }

    /// Returns the id at a point: that of the texel, or that of the nearest corner of the primitive. Returns `None` if the
    /// point belongs to no feature.
    pub fn id_at(&self, at: &SurfacePoint) -> Option<u32> {
        let FeatureIds::Texture(texture) = &self.ids else { return self.id(at.nearest_vertex()) };
        let id = texture.texel(at)?.iter().rev().fold(0, |id, byte| id << 8 | u32::from(*byte));
        Some(id).filter(|id| Some(*id) != self.null_id)
    }
}

impl DrawableFeatures {
    /// Returns the features at a vertex, one of each set at most. Sets whose ids are in an image have none; see
    /// [`Self::at_point`].
    pub fn at_vertex(&self, vertex: u32) -> impl Iterator<Item = Feature<'_>> {
        self.sets.iter().filter_map(move |set| Some(self.feature(set, set.id(vertex)?)))
    }

    /// Returns the features at a point, one of each set at most.
    /// [`Intersection::surface_point`](crate::scene::Intersection::surface_point) returns the point that an intersector meets.
    pub fn at_point(&self, at: SurfacePoint) -> impl Iterator<Item = Feature<'_>> {
        self.sets.iter().filter_map(move |set| Some(self.feature(set, set.id_at(&at)?)))
    }

    /// Returns the properties from property textures and property attributes with their values at a point.
    pub fn properties_at(&self, at: SurfacePoint) -> impl Iterator<Item = (&SurfaceProperty, PropertyValue)> {
        self.surface.iter().map(move |property| (property, property.value(&at)))
    }

    fn feature<'a>(&'a self, set: &'a FeatureIdSet, id: u32) -> Feature<'a> {
        let table = set.table.and_then(|table| self.tables.get(table)).map(|table| &**table);
        Feature { label: &set.label, id, table }
    }

    /// Returns the features of one instance of a drawable: those of the drawable, and the instance itself.
    pub(crate) fn with_instance(&self, sets: impl IntoIterator<Item = FeatureIdSet>) -> Self {
        Self { sets: sets.into_iter().chain(self.sets.iter().cloned()).collect(), ..self.clone() }
    }

    /// Returns the features for a mesh of some of the vertices.
    pub(crate) fn with_vertices(&self, vertices: &[u32]) -> Self {
        let set = |set: &FeatureIdSet| {
            let ids = match &set.ids {
                FeatureIds::PerVertex(ids) => {
                    let id = |vertex: &u32| ids.get(*vertex as usize).copied().unwrap_or(u32::MAX);
                    FeatureIds::PerVertex(vertices.iter().map(id).collect())
                }
                FeatureIds::VertexIndex => FeatureIds::PerVertex(vertices.into()),
                FeatureIds::Uniform(id) => FeatureIds::Uniform(*id),
                FeatureIds::Texture(texture) => FeatureIds::Texture(texture.with_vertices(vertices)),
            };
            FeatureIdSet { ids, ..set.clone() }
        };
        let surface = self.surface.iter().map(|property| property.with_vertices(vertices)).collect();
        Self { sets: self.sets.iter().map(set).collect(), tables: self.tables.clone(), surface }
    }

    /// Returns the bytes of memory beside ids, images and tables whose addresses are in `counted`, and adds those, which other
    /// drawables may share.
    pub(crate) fn size_bytes_beside(&self, counted: &mut HashSet<usize>) -> u64 {
        let mut bytes = 0;
        for set in &self.sets {
            bytes += size_of::<FeatureIdSet>() as u64;
            bytes += match &set.ids {
                FeatureIds::PerVertex(ids) if counted.insert(ids.as_ptr().addr()) => size_of_val::<[u32]>(ids) as u64,
                FeatureIds::Texture(texture) => texture.size_bytes_beside(counted),
                FeatureIds::PerVertex(_) | FeatureIds::VertexIndex | FeatureIds::Uniform(_) => 0,
            };
        }
        if !self.surface.is_empty() && counted.insert(self.surface.as_ptr().addr()) {
            bytes += self.surface.iter().map(|property| property.size_bytes_beside(counted)).sum::<u64>();
        }
        let mut is_new = |table: &&Arc<PropertyTable>| counted.insert(Arc::as_ptr(table).addr());
        bytes + self.tables.iter().filter(&mut is_new).map(|table| table.size_bytes() as u64).sum::<u64>()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::PropertyColumn;

    struct Squares;

    impl PropertyColumn for Squares {
        fn value(&self, row: usize) -> PropertyValue {
            PropertyValue::UInt((row * row) as u64)
        }

        fn size_bytes(&self) -> usize {
            0
        }
    }

    #[test]
    fn vertices_lead_to_their_features() {
        let table =
            PropertyTable::new("t".into(), "c".into(), 4, vec![("square".to_owned().into(), Box::new(Squares))]);
        let set = |label: &str, null_id, ids, table| FeatureIdSet { label: label.into(), null_id, ids, table };
        let features = DrawableFeatures {
            sets: vec![
                set("a", Some(9), FeatureIds::PerVertex([3, 9, 7].into()), Some(0)),
                set("b", None, FeatureIds::VertexIndex, None),
                set("c", None, FeatureIds::Uniform(2), Some(5)),
            ],
            tables: [Arc::new(table)].into(),
            surface: Arc::default(),
        };
        let at = |vertex| features.at_vertex(vertex).map(|f| (f.label, f.id, f.properties())).collect::<Vec<_>>();
        assert_eq!(at(0), [("a", 3, vec![("square", PropertyValue::UInt(9))]), ("b", 0, vec![]), ("c", 2, vec![])]);
        assert_eq!(at(1).len(), 2, "the null id is no feature");
        assert_eq!(at(2)[0], ("a", 7, vec![]), "a row that the table lacks");
        assert_eq!(at(3).len(), 2, "a vertex that the mesh lacks");
        assert_eq!(features.tables[0].value("square", 3).unwrap().as_f64(), Some(9.0));
        assert!(features.tables[0].value("square", 4).is_none() && features.tables[0].value("x", 0).is_none());
        let list = PropertyValue::List(vec![PropertyValue::Int(-1), PropertyValue::Text("x".into())]);
        assert_eq!(list.to_string(), "[-1, x]");
    }
}
