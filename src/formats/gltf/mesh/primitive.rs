//! [`PrimitiveData`]: access to the attributes and indices of one primitive.

use std::sync::Arc;

use gltf::accessor::Dimensions;
use gltf::mesh::Semantic;

use super::draco::{Compressed, DracoMesh};
use crate::fetch::IoError;
use crate::formats::gltf::accessors::{BUFFER_MISSING, Buffers, Elements};
use crate::formats::gltf::context::Context;

/// The attributes and indices of a primitive.
pub(super) struct PrimitiveData<'a> {
    context: &'a Context<'a>,
    buffers: &'a Buffers<'a>,
    primitive: &'a gltf::Primitive<'a>,
    /// The decompressed mesh; attributes that it lacks are read from their accessors.
    draco: Option<Box<DracoMesh<'a>>>,
    /// The number of vertices.
    pub count: usize,
}

impl<'a> PrimitiveData<'a> {
    /// Counts the vertices of a primitive in the budget, and decompresses it. Returns `None` if it has no positions, or if the
    /// buffer of its compressed mesh is missing.
    pub fn new(
        context: &'a Context<'a>,
        buffers: &'a Buffers<'a>,
        document: &gltf::Document,
        primitive: &'a gltf::Primitive<'a>,
    ) -> Result<Option<Self>, IoError> {
        let Some(positions) = primitive.get(&Semantic::Positions) else {
            context.notes.add("glTF: primitive without positions");
            return Ok(None);
        };
        let count = positions.count();
        context.budget.add_vertices(count)?;
        let draco = match Compressed::new(context, buffers, document, primitive, count)? {
            Compressed::No => None,
            Compressed::Mesh(mesh) => Some(mesh),
            Compressed::Missing => {
                context.notes.add(BUFFER_MISSING);
                return Ok(None);
            }
        };
        let count = draco.as_ref().map_or(count, |draco| draco.count());
        Ok(Some(Self { context, buffers, primitive, draco, count }))
    }

    /// Returns the elements of an attribute; `None` if the primitive lacks it or if its buffer is missing.
    pub fn attribute(&self, semantic: &Semantic, dimensions: &[Dimensions]) -> Result<Option<Elements<'_>>, IoError> {
        let Some(accessor) = self.primitive.get(semantic) else { return Ok(None) };
        let wrong = || self.context.bad(format_args!("{} has the wrong type or count", semantic.to_string()));
        if !dimensions.contains(&accessor.dimensions()) {
            return Err(wrong());
        }
        let elements = match &self.draco {
            Some(_) => self.elements(&semantic.to_string(), &accessor)?,
            None if accessor.count() != self.count => return Err(wrong()),
            None => self.buffers.elements(&accessor, accessor.dimensions())?,
        };
        match elements {
            Some(elements) if elements.count != self.count => Err(wrong()),
            elements => Ok(elements),
        }
    }

    /// Returns the elements of an attribute without which the primitive is drawn; `None`, and a note, if it is invalid.
    pub fn optional(&self, semantic: &Semantic, dimensions: &[Dimensions]) -> Result<Option<Elements<'_>>, IoError> {
        match self.attribute(semantic, dimensions) {
            Err(IoError::Invalid { .. }) => {
                let name = semantic.to_string();
                self.context.notes.add(format!("glTF: {name} of the wrong type or length (drawn without it)"));
                Ok(None)
            }
            elements => elements,
        }
    }

    /// Returns true if the primitive has normals that are no vectors of three components.
    pub fn has_odd_normals(&self) -> bool {
        self.primitive.get(&Semantic::Normals).is_some_and(|accessor| accessor.dimensions() != Dimensions::Vec3)
    }

    /// Returns the elements of a displacement of a morph target.
    pub fn displacement(&self, accessor: &gltf::Accessor<'_>) -> Result<Option<Elements<'_>>, IoError> {
        if accessor.dimensions() != Dimensions::Vec3 || accessor.count() != self.count {
            return Err(self.context.bad("a morph target has the wrong type or count"));
        }
        self.context.budget.add_vertices(self.count)?;
        self.buffers.elements(accessor, Dimensions::Vec3)
    }

    /// Returns the accessor of the attribute with a name as in the file.
    pub fn accessor(&self, name: &str) -> Option<gltf::Accessor<'a>> {
        let named = |(semantic, _): &(Semantic, gltf::Accessor<'_>)| semantic.to_string() == name;
        self.primitive.attributes().find(named).map(|(_, accessor)| accessor)
    }

    /// Returns the elements of an attribute with a name as in the file.
    pub fn elements(&self, name: &str, accessor: &gltf::Accessor<'_>) -> Result<Option<Elements<'_>>, IoError> {
        if let Some(draco) = &self.draco
            && let Some(elements) = draco.elements(name, accessor)?
        {
            return Ok(Some(elements));
        }
        self.buffers.elements(accessor, accessor.dimensions())
    }

    /// Returns the elements of an index accessor.
    pub fn index_elements(&self, accessor: &gltf::Accessor<'_>) -> Result<Option<Elements<'_>>, IoError> {
        self.buffers.elements(accessor, Dimensions::Scalar)
    }

    /// Returns the triangles of a decompressed mesh; `None` if the primitive was not compressed.
    pub fn triangles(&self) -> Result<Option<Arc<[u32]>>, IoError> {
        self.draco.as_ref().filter(|draco| draco.has_triangles()).map(|draco| draco.indices()).transpose()
    }

    pub fn morph_targets(&self) -> impl Iterator<Item = gltf::mesh::MorphTarget<'a>> {
        self.primitive.morph_targets()
    }
}
