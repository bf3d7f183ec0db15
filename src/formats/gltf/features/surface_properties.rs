//! Property textures and property attributes of EXT_structural_metadata, and the images that hold ids and values.
//!
//! Only read with [`ReadOptions::keep_features`](crate::formats::ReadOptions::keep_features).

use std::sync::Arc;

use gltf::accessor::DataType;
use serde::Deserialize;
use serde_json::{Map, Value};

use crate::fetch::IoError;
use crate::formats::gltf::accessors::{Buffers, Elements};
use crate::formats::gltf::context::Context;
use crate::formats::gltf::materials::{Surfaces, TextureRef};
use crate::formats::properties::{PropertyType, Schema, ValueChanges};
use crate::scene::{DataTexture, PropertyInfo, SurfaceProperty, SurfaceValues};

/// The number of bytes that a property of a primitive counts in the budget of decoded bytes. It is counted for each
/// primitive, since a primitive may refer to all properties many times.
const PROPERTY_BYTES: u64 = 256;

/// A property of a property texture or property attribute, as the document describes it.
struct Described {
    class: Arc<str>,
    info: PropertyInfo,
    kind: Arc<PropertyType>,
    json: Value,
}

/// The property textures and property attributes of a document, which primitives refer to.
#[derive(Default)]
pub(in crate::formats::gltf) struct SurfaceProperties {
    textures: Vec<Vec<Described>>,
    attributes: Vec<Vec<Described>>,
}

impl SurfaceProperties {
    /// Reads EXT_structural_metadata of a document. Properties that are invalid are left out and noted.
    pub fn new(context: &Context<'_>, metadata: &Value, schema: &Schema) -> Self {
        let list = |name: &str| -> Vec<Vec<Described>> {
            let all = metadata.get(name).and_then(Value::as_array);
            all.into_iter().flatten().map(|one| describe(context, one, schema)).collect()
        };
        Self { textures: list("propertyTextures"), attributes: list("propertyAttributes") }
    }

    /// Reads the properties that a primitive refers to.
    pub fn of_primitive(
        &self,
        primitive: &gltf::Primitive<'_>,
        data: &mut PrimitiveImages<'_, '_, '_>,
        attribute: &Attribute<'_, '_>,
    ) -> Result<Arc<[SurfaceProperty]>, IoError> {
        let Some(extension) = primitive.extension_value("EXT_structural_metadata") else { return Ok(Arc::default()) };
        let context = data.context;
        let used = |name: &str| -> Vec<usize> {
            let indices = extension.get(name).and_then(Value::as_array);
            let index = |index: &Value| usize::try_from(index.as_u64()?).ok();
            indices.into_iter().flatten().map(|of| index(of).unwrap_or(usize::MAX)).collect()
        };
        let mut properties = Vec::new();
        let mut add = |of: &Described, values: Option<SurfaceValues>, without: &'static str| match values {
            Some(values) => {
                let Described { class, info, kind, .. } = of;
                properties.push(SurfaceProperty::new(class.clone(), info.clone(), values, kind.clone()));
            }
            None => context.notes.add(without),
        };
        for index in used("propertyTextures") {
            let Some(texture) = self.textures.get(index) else {
                context.notes.add("metadata: a property texture that the file lacks");
                continue;
            };
            for of in texture {
                context.budget.add_decoded(PROPERTY_BYTES)?;
                let channels = channels(&of.json).filter(|channels| of.kind.size_bytes() == Some(channels.len()));
                let texture = channels.zip(TextureRef::from_json(&of.json));
                let values = match texture {
                    Some((channels, texture)) => data.texture(&texture, channels, attribute)?,
                    None => None,
                };
                let without =
                    "metadata: a property texture whose image, coordinates or channels are missing or invalid";
                add(of, values.map(SurfaceValues::Texture), without);
            }
        }
        for index in used("propertyAttributes") {
            let Some(attributes) = self.attributes.get(index) else {
                context.notes.add("metadata: a property attribute that the file lacks");
                continue;
            };
            for of in attributes {
                context.budget.add_decoded(PROPERTY_BYTES)?;
                let name = of.json.get("attribute").and_then(Value::as_str);
                let elements = name.map(attribute).transpose()?.flatten();
                let elements = elements.filter(|elements| stores(&of.kind, elements));
                let values = elements.map(|elements| -> Result<_, IoError> {
                    let size = elements.components * elements.data_type.size();
                    context.budget.add_decoded((elements.count * size) as u64)?;
                    Ok(SurfaceValues::PerVertex { bytes: elements.padded(size), size })
                });
                let without = "metadata: a property attribute that is missing or of another type";
                add(of, values.transpose()?, without);
            }
        }
        Ok(properties.into())
    }
}

/// Returns the elements of an attribute with a name.
pub(in crate::formats::gltf) type Attribute<'f, 'e> = dyn Fn(&str) -> Result<Option<Elements<'e>>, IoError> + 'f;

/// Texture coordinates by vertex.
type Coordinates = Arc<[[f32; 2]]>;

/// The images that hold data of one primitive.
pub(in crate::formats::gltf) struct PrimitiveImages<'c, 's, 'd> {
    pub context: &'c Context<'c>,
    pub surfaces: &'s mut Surfaces<'d>,
    pub buffers: &'s Buffers<'d>,
    /// Coordinates that were read, which several textures may share; `None` if the attribute is missing.
    uvs: Vec<(TextureRef, Option<Coordinates>)>,
}

impl<'c, 's, 'd> PrimitiveImages<'c, 's, 'd> {
    pub fn new(context: &'c Context<'c>, surfaces: &'s mut Surfaces<'d>, buffers: &'s Buffers<'d>) -> Self {
        Self { context, surfaces, buffers, uvs: Vec::new() }
    }

    /// Returns a texture with the coordinates of the primitive; `None` if its image or coordinates are missing or invalid.
    pub fn texture(
        &mut self,
        texture: &TextureRef,
        channels: Arc<[u8]>,
        attribute: &Attribute<'_, '_>,
    ) -> Result<Option<DataTexture>, IoError> {
        let Some(image) = self.surfaces.data_image(texture.texture, self.buffers)? else { return Ok(None) };
        let uvs = self.coordinates(texture, attribute)?;
        Ok(uvs.and_then(|uvs| DataTexture::new(image, channels, uvs)))
    }

    fn coordinates(
        &mut self,
        texture: &TextureRef,
        attribute: &Attribute<'_, '_>,
    ) -> Result<Option<Coordinates>, IoError> {
        if let Some((_, uvs)) = self.uvs.iter().find(|(known, _)| known.has_coordinates_of(texture)) {
            return Ok(uvs.clone());
        }
        let elements = attribute(&format!("TEXCOORD_{}", texture.uv_set))?.filter(|elements| elements.components == 2);
        let mut uvs = None;
        if let Some(elements) = elements {
            self.context.budget.add_decoded(8 * elements.count as u64)?;
            let map = texture.affine();
            let uv = |i: usize| map.transform_point2(elements.vector(i).into()).into();
            uvs = Some((0..elements.count).map(uv).collect());
        }
        self.uvs.push((*texture, uvs.clone()));
        Ok(uvs)
    }
}

/// Returns the channels of a texture reference, the first by default; `None` if they are invalid.
pub(in crate::formats::gltf) fn channels(json: &Value) -> Option<Arc<[u8]>> {
    match json.get("channels") {
        None => Some([0].into()),
        Some(channels) => Vec::deserialize(channels).ok().map(Vec::into),
    }
}

fn describe(context: &Context<'_>, json: &Value, schema: &Schema) -> Vec<Described> {
    let class_name = json.get("class").and_then(Value::as_str).unwrap_or_default();
    let class = schema.classes.get(class_name);
    if class.is_none() {
        context.notes.add("metadata: a property texture or attribute of an unknown class");
        return Vec::new();
    }
    let no_properties = Map::new();
    let properties = json.get("properties").and_then(Value::as_object).unwrap_or(&no_properties);
    let name: Arc<str> = class_name.into();
    let mut described = Vec::new();
    for (id, property) in properties {
        let changes = ValueChanges::deserialize(property).unwrap_or_default();
        let of = class.and_then(|class| class.properties.get(id));
        let Some((of, kind)) = of.and_then(|of| Some((of, PropertyType::new(of, schema, &changes)?))) else {
            context.notes.add("metadata: a property that is invalid");
            continue;
        };
        let info = kind.info(id, of, &changes);
        described.push(Described { class: name.clone(), info, kind: Arc::new(kind), json: property.clone() });
    }
    described
}

/// Returns true if the elements of an attribute are stored values of a property.
fn stores(kind: &PropertyType, elements: &Elements<'_>) -> bool {
    let component = match elements.data_type {
        DataType::I8 => "INT8",
        DataType::U8 => "UINT8",
        DataType::I16 => "INT16",
        DataType::U16 => "UINT16",
        DataType::U32 => "UINT32",
        DataType::F32 => "FLOAT32",
    };
    kind.has_component(component) && kind.size_bytes() == Some(elements.components * elements.data_type.size())
}
