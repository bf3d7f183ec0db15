//! The objects of a file as plain values, shared as they are in the file. [`build`](super::build) makes nodes of them.

mod arrays;
mod cameras;
mod images;
mod inherited;
mod lights;
mod shapes;
mod terrain;

use std::sync::Arc;

use glam::{DAffine3, DMat4, DQuat, DVec3};

pub(super) use self::arrays::{ArrayObject, Binding, BoundArray};
pub(super) use self::cameras::{CameraObject, CameraOrder};
pub(super) use self::images::{ImageData, ImageObject, RawImage};
pub(super) use self::inherited::{Inherited, ON};
pub(super) use self::lights::{ClipPlaneObject, FogObject, LightModelObject, LightObject};
pub(super) use self::shapes::{HeightFieldObject, Profile, ShapeObject};
pub(super) use self::terrain::{
    BlendingPolicy, LayerContent, LayerObject, LocatorObject, RampObject, TerrainSettings, TerrainTileObject, Validity,
    ellipsoid,
};

use super::input::Values;
use super::motion::{AnimationObject, PathObject, SequenceObject};
use super::text::TextObject;
use crate::math::Ellipsoid;

/// About the bytes that an object of a file takes, with its members.
pub(super) const OBJECT_BYTES: u64 = 512;

/// An object of a file. Objects with the same id are the same value.
#[derive(Clone, Debug)]
pub(super) enum Object {
    /// Nothing that is drawn: a null pointer, a class that is skipped, or one without effect.
    Nothing,
    Node(Arc<NodeObject>),
    Drawable(Arc<DrawableObject>),
    State(Arc<StateObject>),
    Attribute(Arc<AttributeObject>),
    Image(Arc<ImageObject>),
    Array(Arc<ArrayObject>),
    Primitives(Arc<PrimitiveObject>),
    Shape(Arc<ShapeObject>),
    Path(Arc<PathObject>),
    Animation(Arc<AnimationObject>),
    Locator(Arc<LocatorObject>),
    Ramp(Arc<RampObject>),
    Layer(Arc<LayerObject>),
    Ellipsoid(Box<Ellipsoid>),
}

impl Object {
    /// Returns the number of nodes on the longest way down; 0 for what is no node.
    pub fn height(&self) -> usize {
        if let Self::Node(node) = self { node.height } else { 0 }
    }
}

/// A node.
#[derive(Debug)]
pub(super) struct NodeObject {
    pub name: String,
    pub mask: u32,
    pub culling_active: bool,
    pub state: Option<Arc<StateObject>>,
    pub class: NodeClass,
    /// The children in order, those of classes that are skipped included: ranges and switches count them.
    pub children: Vec<Object>,
    /// The number of nodes on the longest way down, this one included.
    pub height: usize,
}

/// The class of a node with its own members.
#[derive(Debug)]
pub(super) enum NodeClass {
    /// Group, Geode and everything that is read like them.
    Group,
    Transform {
        /// `None` if the matrix is not affine.
        parent_from_child: Option<DAffine3>,
        is_absolute: bool,
        /// The animation that moves it.
        animation: Option<Arc<AnimationObject>>,
    },
    Switch(Vec<bool>),
    Sequence(SequenceObject),
    Lod(LodObject),
    PagedLod(LodObject, PagedObject),
    Proxy(ProxyObject),
    Billboard(BillboardObject),
    AutoTransform(AutoObject),
    Light {
        light: Option<LightObject>,
        /// The light moves with the eye.
        is_absolute: bool,
    },
    Clip {
        planes: Vec<ClipPlaneObject>,
        /// The planes move with the eye.
        is_absolute: bool,
    },
    Camera(Box<CameraObject>),
    /// A Projection: a matrix of OpenGL, with depths of -1 to 1.
    Projection(Box<DMat4>),
    /// A CoordinateSystemNode with its system: EPSG or WKT. Empty if the positions are earth-centred.
    CoordinateSystem(String),
    /// An osgTerrain::Terrain: a CoordinateSystemNode whose tiles have its settings.
    Terrain(TerrainSettings, String),
    /// An osgTerrain::TerrainTile, whose children OSG does not draw.
    TerrainTile(TerrainTileObject),
}

impl NodeClass {
    /// Returns a transform. An animation replaces its map.
    pub fn transform(map: Option<DAffine3>, is_absolute: bool, animation: Option<Arc<AnimationObject>>) -> Self {
        let first = animation.as_deref().and_then(AnimationObject::first);
        let parent_from_child = first.or(map.filter(DAffine3::is_finite));
        Self::Transform { parent_from_child, is_absolute, animation }
    }
}

/// The members that all nodes have, while those of a node's class are read.
pub(super) struct NodeMembers {
    pub name: String,
    pub mask: u32,
    pub culling_active: bool,
    pub state: Option<Arc<StateObject>>,
    /// The animation of a transform.
    pub animation: Option<Arc<AnimationObject>>,
}

impl NodeMembers {
    /// Returns the node with the members of its class.
    pub fn with(self, class: NodeClass, children: Vec<Object>) -> Object {
        let Self { name, mask, culling_active, state, .. } = self;
        let height = 1 + children.iter().map(Object::height).max().unwrap_or(0);
        Object::Node(Arc::new(NodeObject { name, mask, culling_active, state, class, children, height }))
    }

    /// Returns a transform, whose matrix an animation replaces.
    pub fn transform(mut self, map: Option<DAffine3>, is_absolute: bool, children: Vec<Object>) -> Object {
        let class = NodeClass::transform(map, is_absolute, self.animation.take());
        self.with(class, children)
    }
}

/// The members of a Billboard. Its children are drawables.
#[derive(Debug)]
pub(super) struct BillboardObject {
    pub mode: BillboardTurn,
    /// The direction that the drawables keep, if they turn about it.
    pub axis: DVec3,
    /// The direction of the drawables that turns towards the eye.
    pub normal: DVec3,
    /// The position of each drawable.
    pub positions: Vec<DVec3>,
}

/// How a Billboard turns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum BillboardTurn {
    Eye,
    World,
    Axis,
}

/// The members of an AutoTransform.
#[derive(Debug)]
pub(super) struct AutoObject {
    pub is_absolute: bool,
    pub position: DVec3,
    pub rotation: DQuat,
    pub scale: DVec3,
    pub pivot: DVec3,
    pub turn: AutoTurn,
    /// The smallest and the largest scale, if the size on the screen is kept.
    pub screen_scales: Option<[f64; 2]>,
}

impl AutoObject {
    /// Returns the map while nothing turns or scales.
    pub fn parent_from_child(&self) -> DAffine3 {
        let map = DAffine3::from_scale_rotation_translation(self.scale, self.rotation, self.position);
        map * DAffine3::from_translation(-self.pivot)
    }
}

/// How an AutoTransform turns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum AutoTurn {
    No,
    Screen,
    Camera,
}

/// The centre that ranges are measured from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum CenterMode {
    #[default]
    BoundingSphere,
    UserDefined,
    Union,
}

/// The members of an LOD.
#[derive(Debug, Default)]
pub(super) struct LodObject {
    pub center_mode: CenterMode,
    /// Centre and radius, as far as the centre mode needs them.
    pub user_center: Option<(DVec3, f64)>,
    pub is_by_pixel_size: bool,
    /// The range of each child, metres or pixels.
    pub ranges: Vec<[f64; 2]>,
}

/// The members of a PagedLOD beside those of an LOD.
#[derive(Debug, Default)]
pub(super) struct PagedObject {
    pub database_path: String,
    /// The file of each child; empty for children that are in this file.
    pub files: Vec<String>,
    /// Offset and scale of each child's priority.
    pub priorities: Vec<[f32; 2]>,
    pub children_that_cannot_expire: u32,
}

/// The members of a ProxyNode.
#[derive(Debug, Default)]
pub(super) struct ProxyObject {
    pub files: Vec<String>,
    pub database_path: String,
    pub loading: ProxyMode,
    pub center_mode: CenterMode,
    pub user_center: Option<(DVec3, f64)>,
}

/// When a ProxyNode loads its files.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum ProxyMode {
    #[default]
    Immediately,
    DeferToPager,
    Never,
}

/// A drawable.
#[derive(Debug)]
pub(super) struct DrawableObject {
    pub name: String,
    pub mask: u32,
    pub state: Option<Arc<StateObject>>,
    pub class: DrawableClass,
}

#[derive(Debug)]
pub(super) enum DrawableClass {
    Geometry(GeometryObject),
    Shape { shape: Option<Arc<ShapeObject>>, color: [f32; 4] },
    Text(TextObject),
}

/// The members of a Geometry.
#[derive(Clone, Debug, Default)]
pub(super) struct GeometryObject {
    pub primitives: Vec<Arc<PrimitiveObject>>,
    pub vertices: Option<BoundArray>,
    pub normals: Option<BoundArray>,
    pub colors: Option<BoundArray>,
    pub tex_coords: Vec<Option<BoundArray>>,
}

/// A primitive set.
#[derive(Debug)]
pub(super) struct PrimitiveObject {
    /// OpenGL's number of the mode.
    pub mode: u32,
    pub instances: u32,
    pub indices: Indices,
}

/// The vertices of a primitive set.
#[derive(Debug)]
pub(super) enum Indices {
    Arrays { first: i64, count: i64 },
    Lengths { first: i64, lengths: Vec<i32> },
    Elements(Values),
}

/// A state set.
#[derive(Debug, Default)]
pub(super) struct StateObject {
    pub name: String,
    /// Modes as OpenGL's numbers with OSG's flags.
    pub modes: Vec<(u32, u32)>,
    pub attributes: Vec<(Arc<AttributeObject>, u32)>,
    /// By texture unit.
    pub texture_modes: Vec<Vec<(u32, u32)>>,
    pub texture_attributes: Vec<Vec<(Arc<AttributeObject>, u32)>>,
    pub hint: i32,
    pub bin_mode: u32,
    pub bin_number: i32,
    pub bin_name: String,
    pub nest_bins: bool,
}

/// An attribute of a state set.
#[derive(Debug)]
pub(super) enum AttributeObject {
    Material(MaterialObject),
    Texture(TextureObject),
    /// Source and destination of colour, then of alpha: OpenGL's numbers.
    BlendFunc([u32; 4]),
    AlphaFunc {
        function: u32,
        reference: f32,
    },
    CullFace(u32),
    Depth {
        function: u32,
        range: [f64; 2],
        write: bool,
    },
    FrontFace(u32),
    PolygonOffset {
        factor: f32,
        units: f32,
    },
    ColorMask([bool; 4]),
    Light(LightObject),
    LightModel(LightModelObject),
    Fog(FogObject),
    ClipPlane(ClipPlaneObject),
    /// OpenGL's number of the mode of front faces.
    PolygonMode(u32),
    /// The displayed colour, sRGB.
    BlendColor([f32; 4]),
    /// OpenGL's numbers for colour and alpha.
    BlendEquation([u32; 2]),
    /// OpenGL's number of the mode, and the colour of BLEND.
    TexEnv {
        mode: u32,
        color: [f32; 4],
    },
    Combine(CombineObject),
    /// OpenGL's number of the mode, and the planes of s, t, r and q.
    TexGen {
        mode: u32,
        planes: [[f64; 4]; 4],
    },
    TexMat(TexMatObject),
    /// The side of points in pixels.
    PointSize(f32),
    /// Attributes without effect here.
    Other(&'static str),
}

impl AttributeObject {
    /// Returns a Point of a size in pixels with OpenGL's coefficients of its change with distance, which is not drawn.
    pub fn of_point(size_px: f32, attenuation: [f32; 3]) -> Self {
        if attenuation[1..] == [0.0; 2] { Self::PointSize(size_px) } else { Self::Other("Point") }
    }
}

/// A TexEnvCombine: one combination for colour and one for alpha.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct CombineObject {
    pub color: CombinePart,
    pub alpha: CombinePart,
    pub constant: [f32; 4],
}

impl Default for CombineObject {
    /// Returns OSG's defaults: the product of the texture and the colour below.
    fn default() -> Self {
        let part = |operands| CombinePart { function: 0x2100, sources: [0x1702, 0x8578, 0x8576], operands, scale: 1.0 };
        Self { color: part([0x300, 0x300, 0x302]), alpha: part([0x302; 3]), constant: [0.0; 4] }
    }
}

/// The combination of three arguments: OpenGL's numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct CombinePart {
    pub function: u32,
    pub sources: [u32; 3],
    pub operands: [u32; 3],
    pub scale: f32,
}

/// A TexMat.
#[derive(Clone, Copy, Debug)]
pub(super) struct TexMatObject {
    pub matrix: DMat4,
    /// The matrix of a TextureRectangle is for coordinates of 0 to 1.
    pub scales_by_size: bool,
}

/// Front and back of each colour, as far as they differ.
#[derive(Clone, Copy, Debug)]
pub(super) struct MaterialObject {
    pub color_mode: u32,
    pub ambient: [[f32; 4]; 2],
    pub diffuse: [[f32; 4]; 2],
    pub specular: [[f32; 4]; 2],
    pub emission: [[f32; 4]; 2],
    pub shininess: [f32; 2],
}

/// A texture.
#[derive(Debug)]
pub(super) struct TextureObject {
    pub target: TextureTarget,
    /// Along s and t: OpenGL's numbers.
    pub wrap: [u32; 2],
    pub min_filter: u32,
    pub mag_filter: u32,
    pub border_color: [f32; 4],
    /// One image, or the faces of a cube: +x, -x, +y, -y, +z, -z.
    pub images: Vec<Option<Arc<ImageObject>>>,
}

impl TextureObject {
    /// Returns the images that there are.
    pub fn all_images(&self) -> impl Iterator<Item = &Arc<ImageObject>> {
        self.images.iter().flatten()
    }
}

/// The kind of a texture, as OpenGL's mode that switches it on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub(super) enum TextureTarget {
    D1 = 0xde0,
    D2 = 0xde1,
    /// Its coordinates are texels.
    Rectangle = 0x84f5,
    Cube = 0x8513,
    /// A volume.
    D3 = 0x806f,
}
