//! Tiles of osgTerrain as drawables: a [`Grid`] with a texture of each colour layer.

mod grid;
mod skirts;

use std::sync::Arc;

use glam::{DAffine3, DVec3};

use self::grid::{Grid, GridVertex};
pub(super) use self::skirts::is_ground_with_skirt;
use super::Builder;
use super::looks::{GL_BLEND, GL_CULL_FACE};
use crate::fetch::{IoError, about_to_allocate};
use crate::formats::osg::input::{Number, Values};
use crate::formats::osg::objects::{
    ArrayObject, AttributeObject, Binding, BlendingPolicy, BoundArray, DrawableClass, DrawableObject, GeometryObject,
    ImageObject, Indices, LayerContent, LayerObject, LocatorObject, NodeObject, ON, PrimitiveObject, StateObject,
    TerrainSettings, TerrainTileObject, TextureObject, TextureTarget,
};
use crate::math::BoundingSphere;
use crate::scene::{Node, TexelFormat, Texture};

const GL_CLAMP_TO_EDGE: u32 = 0x812f;
/// The bytes that a vertex of the grid takes: its position and number, six indices, its attributes, and twice as much in a geometry.
const GRID_VERTEX_BYTES: u64 = 256;
const GL_TRIANGLES: u32 = 4;
const GL_LINEAR: u32 = 0x2601;
/// OSG's hint that a state set's drawables are transparent.
const HINT_TRANSPARENT: i32 = 2;

/// A tile as a drawable in a frame whose origin is near it. The objects stay as long as their file is read, since caches know
/// them by their address.
pub(super) struct BuiltTile {
    center: DVec3,
    drawable: Arc<DrawableObject>,
}

/// Returns a sphere around a tile; empty if it has nothing to draw.
pub(super) fn sphere(tile: &TerrainTileObject, settings: &TerrainSettings) -> BoundingSphere {
    // The samples of the file itself: their number is limited by its size.
    let settings = TerrainSettings { sample_ratio: 1.0, ..*settings };
    Grid::new(tile, &settings).map_or(BoundingSphere::EMPTY, |grid| grid.sphere())
}

impl Builder<'_> {
    /// Makes the node of a Terrain, whose settings hold for the tiles below it in its file.
    pub(super) fn terrain(&mut self, object: &NodeObject, settings: &TerrainSettings) -> Result<Node, IoError> {
        let above = std::mem::replace(&mut self.spheres.terrain, *settings);
        let children = self.children(&object.children);
        self.spheres.terrain = above;
        Ok(Node::group(children?))
    }

    /// Makes the node of a TerrainTile.
    pub(super) fn terrain_tile(&mut self, object: &Arc<NodeObject>, tile: &TerrainTileObject) -> Result<Node, IoError> {
        let key = Arc::as_ptr(object).addr();
        if !self.tiles.contains_key(&key) {
            let made = self.new_tile(tile)?;
            self.tiles.insert(key, made);
        }
        let Some(BuiltTile { center, drawable }) = self.tiles.get(&key).and_then(Option::as_ref) else {
            self.note("OpenSceneGraph: a TerrainTile without a place or with less than one cell (not drawn)");
            return Ok(Node::group(Vec::new()));
        };
        let (center, drawable) = (*center, drawable.clone());
        Ok(Node::transform(DAffine3::from_translation(center), vec![self.geode(&drawable)?]))
    }

    fn new_tile(&mut self, tile: &TerrainTileObject) -> Result<Option<BuiltTile>, IoError> {
        let settings = self.spheres.terrain;
        let Some(grid) = Grid::new(tile, &settings) else { return Ok(None) };
        let limit = self.source.options.limits.max_elements;
        self.count(self.vertices, grid.vertex_count(), "vertices of an OpenSceneGraph file", limit)?;
        about_to_allocate(GRID_VERTEX_BYTES * grid.vertex_count() as u64).map_err(|error| error.at(self.source.uri))?;
        let mesh = grid.mesh();
        let center = grid.locator.model(DVec3::new(0.5, 0.5, 0.0));
        if mesh.indices.is_empty() || !center.is_finite() {
            return Ok(None);
        }
        let points = |of: fn(&GridVertex, DVec3) -> DVec3| {
            let values = mesh.vertices.iter().flat_map(|vertex| of(vertex, center).as_vec3().to_array());
            array(3, values.collect())
        };
        let count = mesh.vertices.len();
        let elements = Indices::Elements(Values::Whole(Number::U32, mesh.indices));
        let mut geometry = GeometryObject {
            primitives: vec![Arc::new(PrimitiveObject { mode: GL_TRIANGLES, instances: 0, indices: elements })],
            vertices: points(|vertex, center| vertex.position - center),
            normals: points(|vertex, _| vertex.normal),
            ..GeometryObject::default()
        };
        let mut state = StateObject::default();
        let mut is_first = true;
        let mut is_translucent = false;
        for (unit, layer, image) in tile.images() {
            let texture = Arc::new(texture_of(layer, image));
            if is_first {
                let built = self.texture(&texture)?;
                is_translucent = built.is_some_and(|built| is_translucent_image(&built.shared.0));
                is_first = false;
            }
            state.texture_modes.resize(unit + 1, Vec::new());
            state.texture_attributes.resize(unit + 1, Vec::new());
            state.texture_modes[unit].push((TextureTarget::D2 as u32, ON));
            state.texture_attributes[unit].push((texture, ON));
            geometry.tex_coords.resize(unit + 1, None);
            let mut uvs = Vec::with_capacity(2 * count);
            for vertex in &mesh.vertices {
                uvs.extend(match &layer.content {
                    // The heights of the file, whatever the scale that they are drawn with.
                    LayerContent::Ramp(ramp) => [ramp.place(vertex.local.z / settings.vertical_scale) as f32, 0.5],
                    _ => place_in(layer.locator.as_deref(), grid.locator, vertex.local),
                });
            }
            geometry.tex_coords[unit] = array(2, uvs);
        }
        let policy = if tile.blending == BlendingPolicy::Inherit { settings.blending } else { tile.blending };
        let is_blended = match policy {
            BlendingPolicy::Never => false,
            BlendingPolicy::Always => true,
            BlendingPolicy::Inherit | BlendingPolicy::WhenAlphaIsPresent => is_translucent,
        };
        // A pixel between neighbours can show the skirt of one from behind: it would face away from the light.
        state.modes.push((GL_CULL_FACE, ON));
        if is_blended {
            state.modes.push((GL_BLEND, ON));
            state.hint = HINT_TRANSPARENT;
        }
        let (name, class) = (String::new(), DrawableClass::Geometry(geometry));
        let drawable = DrawableObject { name, mask: u32::MAX, state: Some(Arc::new(state)), class };
        Ok(Some(BuiltTile { center, drawable: Arc::new(drawable) }))
    }
}

fn array(width: usize, values: Vec<f32>) -> Option<BoundArray> {
    let array = ArrayObject { width, values: Values::F32(values), binding: None, is_normalized: false };
    Some(BoundArray { array: Arc::new(array), indices: None, binding: Some(Binding::PerVertex), is_normalized: false })
}

/// Returns the texture of a colour layer.
fn texture_of(layer: &LayerObject, image: &Arc<ImageObject>) -> AttributeObject {
    AttributeObject::Texture(TextureObject {
        target: TextureTarget::D2,
        wrap: [GL_CLAMP_TO_EDGE; 2],
        // Colours of other heights are no smaller image of a height's colour.
        min_filter: if matches!(layer.content, LayerContent::Ramp(_)) { GL_LINEAR } else { layer.min_filter },
        mag_filter: layer.mag_filter,
        border_color: [0.0; 4],
        images: vec![Some(image.clone())],
    })
}

/// Returns the texture coordinates in a layer with a locator for a place in the layer that positions come from.
fn place_in(of_layer: Option<&LocatorObject>, of_positions: &LocatorObject, place: DVec3) -> [f32; 2] {
    let elsewhere = of_layer.filter(|own| !std::ptr::eq(*own, of_positions) && *own != of_positions);
    let place = elsewhere.and_then(|own| own.local(of_positions.model(place))).unwrap_or(place);
    [place.x as f32, place.y as f32]
}

/// Returns true if some texel is not opaque. Compressed images count as opaque.
fn is_translucent_image(texture: &Texture) -> bool {
    let texels = texture.mips.first().filter(|_| texture.format == TexelFormat::Rgba8);
    texels.is_some_and(|texels| texels.chunks_exact(4).any(|texel| texel[3] < u8::MAX))
}
