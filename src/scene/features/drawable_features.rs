//! [`DrawableFeatures`]: the features that a drawable shows.

use std::sync::Arc;

use super::property_table::PropertyTable;
use super::property_value::PropertyValue;

/// How the ids of a set are stored.
#[derive(Clone, Debug, PartialEq)]
pub enum FeatureIds {
    /// An id for each vertex of the mesh.
    PerVertex(Arc<[u32]>),
    /// The index of a vertex is its id.
    VertexIndex,
    /// One id for the whole drawable, such as an instance.
    Uniform(u32),
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
#[derive(Clone, Debug)]
pub struct DrawableFeatures {
    /// The sets of ids, in the order of the file.
    pub sets: Vec<FeatureIdSet>,
    /// The property tables of the content, which all of its drawables share.
    pub tables: Arc<[Arc<PropertyTable>]>,
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
    /// Returns the id at a vertex; `None` if the vertex belongs to no feature.
    pub fn id(&self, vertex: u32) -> Option<u32> {
        let id = match &self.ids {
            FeatureIds::PerVertex(ids) => *ids.get(vertex as usize)?,
            FeatureIds::VertexIndex => vertex,
            FeatureIds::Uniform(id) => *id,
        };
        Some(id).filter(|id| Some(*id) != self.null_id)
    }
}

impl DrawableFeatures {
    /// Returns the features at a vertex, one of each set at most. An
    /// [`Intersection`](crate::scene::Intersection) names the vertices of the primitive that it meets.
    pub fn at_vertex(&self, vertex: u32) -> impl Iterator<Item = Feature<'_>> {
        self.sets.iter().filter_map(move |set| {
            let table = set.table.and_then(|table| self.tables.get(table)).map(|table| &**table);
            Some(Feature { label: &set.label, id: set.id(vertex)?, table })
        })
    }

    /// Returns the features of one instance of a drawable: those of the drawable, and the instance itself.
    pub(crate) fn with_instance(&self, sets: impl IntoIterator<Item = FeatureIdSet>) -> Self {
        Self { sets: sets.into_iter().chain(self.sets.iter().cloned()).collect(), tables: self.tables.clone() }
    }

    /// Returns the bytes of memory of the ids, without the tables, which other drawables share.
    pub fn size_bytes(&self) -> u64 {
        let ids = |set: &FeatureIdSet| match &set.ids {
            FeatureIds::PerVertex(ids) => size_of_val::<[u32]>(ids),
            FeatureIds::VertexIndex | FeatureIds::Uniform(_) => 0,
        };
        self.sets.iter().map(|set| (size_of::<FeatureIdSet>() + ids(set)) as u64).sum()
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
