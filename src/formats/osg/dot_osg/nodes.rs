//! Nodes of an .osg file.

use std::sync::Arc;

use glam::{DAffine3, DMat4, DVec3, DVec4};

use super::Reader;
use super::fields::{Block, Field, number_of, rotation, rotation_of};
use super::terrain;
use crate::formats::osg::classes::{
    Freedom, LIKE_GEODES, LIKE_GROUPS, LIKE_TRANSFORMS, ORDERS, clip_planes, light_points,
};
use crate::formats::osg::error::{OsgError, Result};
use crate::formats::osg::input::value_of;
use crate::formats::osg::motion::{AnimationObject, Looping, PathObject, PathPoint, SequenceObject};
use crate::formats::osg::objects::{
    AttributeObject, AutoObject, AutoTurn, BillboardObject, BillboardTurn, CameraObject, CameraOrder, CenterMode,
    LightObject, LodObject, NodeClass, NodeObject, Object, PagedObject, ProxyMode, ProxyObject,
};

/// The classes of nodes that are read.
const CLASSES: [&str; 25] = [
    "Node",
    "Group",
    "Geode",
    "Transform",
    "MatrixTransform",
    "PositionAttitudeTransform",
    "Switch",
    "LOD",
    "PagedLOD",
    "ProxyNode",
    "Billboard",
    "AutoTransform",
    "Sequence",
    "LightSource",
    "ClipNode",
    "CoordinateSystemNode",
    "Terrain",
    "TerrainTile",
    "Camera",
    "CameraNode",
    "Projection",
    "osgSim::MultiSwitch",
    "osgSim::DOFTransform",
    "osgSim::LightPointNode",
    "osgSim::Impostor",
];
/// Fields of nodes with a block that is no object.
const LISTS: [&str; 15] = [
    "Matrix",
    "PutMatrix",
    "Ranges",
    "RangeList",
    "FileNameList",
    "Positions",
    "ValueList",
    "frameTime",
    "lightPoint",
    "ElevationLayer",
    "ColorLayer",
    "ProjectionMatrix",
    "ViewMatrix",
    "bufferComponent",
    "Viewport",
];

/// Returns true for a class of nodes.
pub(super) fn is_node(class: &str) -> bool {
    CLASSES.contains(&class) || LIKE_GEODES.contains(&class) || is_like_group(class)
}

/// Returns true for a class whose children are drawn, without what the class adds.
fn is_like_group(class: &str) -> bool {
    LIKE_GROUPS.iter().any(|like| like.strip_prefix("osg::").unwrap_or(like) == class)
}

/// Returns true for a field of a node that is no object.
pub(super) fn is_list(name: &str) -> bool {
    LISTS.contains(&name)
}

/// Returns a group of objects.
pub(super) fn group_of(children: Vec<Object>) -> Object {
    let height = 1 + children.iter().map(Object::height).max().unwrap_or(0);
    let (name, class) = (String::new(), NodeClass::Group);
    Object::Node(Arc::new(NodeObject {
        name,
        mask: u32::MAX,
        culling_active: true,
        state: None,
        class,
        children,
        height,
    }))
}

impl Reader {
    /// Reads a node; `None` if the class is none.
    pub(super) fn node(&mut self, class: &str, block: &Block<'_>) -> Result<Option<Object>> {
        let is_bone = LIKE_TRANSFORMS.contains(&class);
        if !is_bone && !is_node(class) {
            return Ok(None);
        }
        if is_bone || is_like_group(class) {
            self.notes.add(format!("OpenSceneGraph class {class} (its children are drawn)"));
        }
        let mut children = self.objects(block)?;
        let state = Self::take_state(&mut children);
        // Lights, clip planes and ellipsoids are fields of their nodes.
        let attributes: Vec<Object> =
            children.iter().filter(|child| matches!(child, Object::Attribute(_))).cloned().collect();
        children.retain(|child| !matches!(child, Object::Attribute(_) | Object::Ellipsoid(_)));
        let class = match class {
            "Transform" => transform(block, Some(DAffine3::IDENTITY), None),
            "MatrixTransform" => {
                let animation = self.animation_of_node(block)?;
                transform(block, self.matrix(block), animation)
            }
            _ if is_bone => transform(block, self.matrix(block), None),
            "PositionAttitudeTransform" => transform(block, Some(placement(block)), self.animation_of_node(block)?),
            "AutoTransform" => NodeClass::AutoTransform(auto(block)),
            "Camera" | "CameraNode" => NodeClass::Camera(Box::new(camera(block))),
            "Projection" => NodeClass::Projection(Box::new(matrix_of(block, "Matrix"))),
            "Switch" => NodeClass::Switch(switch(block, children.len())),
            "Sequence" => NodeClass::Sequence(sequence(block, children.len())),
            "LOD" | "osgSim::Impostor" => NodeClass::Lod(lod(block)),
            "Terrain" => terrain::terrain(block),
            "CoordinateSystemNode" => NodeClass::CoordinateSystem(terrain::coordinate_system(block)),
            "TerrainTile" => self.terrain_tile(block, &mut children)?,
            "osgSim::MultiSwitch" => NodeClass::Switch(multi_switch(block, children.len())),
            "osgSim::DOFTransform" => transform(block, freedom(block).parent_from_child(), None),
            "osgSim::LightPointNode" => {
                let points: Vec<_> = block.fields.iter().filter_map(light_point).collect();
                if !points.is_empty() {
                    children.push(light_points(points));
                }
                NodeClass::Group
            }
            "PagedLOD" => NodeClass::PagedLod(lod(block), paged(block)),
            "ProxyNode" => NodeClass::Proxy(proxy(block)),
            "Billboard" => NodeClass::Billboard(billboard(block)),
            "LightSource" => NodeClass::Light { light: light_among(&attributes), is_absolute: is_absolute(block) },
            "ClipNode" => NodeClass::Clip { planes: clip_planes(attributes), is_absolute: is_absolute(block) },
            _ => NodeClass::Group,
        };
        let height = 1 + children.iter().map(Object::height).max().unwrap_or(0);
        if height > self.max_depth {
            // References to nodes that were read before can be deeper than the nesting of the file.
            let (got, limit) = (height as u64, self.max_depth as u64);
            return Err(OsgError::TooLarge { what: "depth of nodes", got, limit });
        }
        let (name, culling_active) = (block.word("name").to_owned(), block.is_true("cullingActive"));
        let mask = block.value("nodeMask").map_or(u32::MAX, |mask| mask as i64 as u32);
        Ok(Some(Object::Node(Arc::new(NodeObject { name, mask, culling_active, state, class, children, height }))))
    }

    /// Returns the map of a matrix; `None`, noted, if it is not affine.
    fn matrix(&self, block: &Block<'_>) -> Option<DAffine3> {
        let matrix = matrix_of(block, "Matrix");
        let is_affine = matrix.is_finite() && matrix.row(3) == DVec4::W;
        if !is_affine {
            self.notes.add("OpenSceneGraph: a matrix that is not affine");
        }
        is_affine.then(|| DAffine3::from_mat4(matrix))
    }

    /// Returns what moves a transform: the AnimationPathCallback among its callbacks.
    fn animation_of_node(&mut self, block: &Block<'_>) -> Result<Option<Arc<AnimationObject>>> {
        let callbacks = block.field("UpdateCallbacks").or(block.field("UpdateCallback"));
        let Some(callbacks) = callbacks.and_then(|field| field.block.as_ref()) else { return Ok(None) };
        Ok(self.objects(callbacks)?.into_iter().find_map(|object| match object {
            Object::Animation(animation) => Some(animation),
            _ => None,
        }))
    }

    /// Reads an AnimationPathCallback or an AnimationPath; `None` for other classes.
    pub(super) fn animation(&mut self, class: &str, block: &Block<'_>) -> Result<Option<Object>> {
        match class {
            "AnimationPathCallback" => {
                let path = self.objects(block)?.into_iter().find_map(|object| match object {
                    Object::Path(path) => Some(path),
                    _ => None,
                });
                let Some(path) = path else { return Ok(Some(Object::Nothing)) };
                let pivot = point(block, "pivotPoint", DVec3::ZERO);
                let offset_s = block.value("timeOffset").unwrap_or(0.0);
                let multiplier = block.value("timeMultiplier").unwrap_or(1.0);
                let (is_inverse, is_paused) = (false, false);
                let animation = AnimationObject { path, pivot, is_inverse, offset_s, multiplier, is_paused };
                Ok(Some(Object::Animation(Arc::new(animation))))
            }
            "AnimationPath" => {
                let points = block.list("ControlPoints").as_chunks::<11>().0.iter().map(|numbers| {
                    let [time_s, px, py, pz, rx, ry, rz, rw, sx, sy, sz] = *numbers;
                    let position = DVec3::new(px, py, pz);
                    PathPoint {
                        time_s,
                        position,
                        rotation: rotation_of([rx, ry, rz, rw]),
                        scale: DVec3::new(sx, sy, sz),
                    }
                });
                let path = PathObject::new(points, Looping::of_name(block.word("LoopMode")));
                Ok(Some(path.map_or(Object::Nothing, |path| Object::Path(Arc::new(path)))))
            }
            _ => Ok(None),
        }
    }
}

fn light_among(attributes: &[Object]) -> Option<LightObject> {
    attributes.iter().find_map(|object| match object {
        Object::Attribute(attribute) => match &**attribute {
            AttributeObject::Light(light) => Some(*light),
            _ => None,
        },
        _ => None,
    })
}

fn transform(block: &Block<'_>, map: Option<DAffine3>, animation: Option<Arc<AnimationObject>>) -> NodeClass {
    NodeClass::transform(map, is_absolute(block), animation)
}

fn sequence(block: &Block<'_>, children: usize) -> SequenceObject {
    let mut sequence = SequenceObject { times_s: block.list("frameTime").to_vec(), ..SequenceObject::default() };
    let default_s = block.value("defaultTime").unwrap_or(1.0);
    sequence.times_s.resize(children.max(sequence.times_s.len()), default_s);
    if let Some(interval) = block.field("interval") {
        sequence.swings = interval.word(1) == "SWING";
        sequence.interval = interval.numbers(2).unwrap_or([0.0, -1.0]).map(|at| at as i32);
    }
    if let Some([speed, repeats]) = block.values("duration") {
        (sequence.speed, sequence.repeats) = (speed, repeats as i32);
    }
    sequence.last_time_s = block.value("lastFrameTime").unwrap_or(0.0);
    sequence.plays = block.word("mode") == "START";
    sequence.clears = !matches!(block.word("clearOnStop"), "" | "0" | "FALSE");
    sequence
}

/// Returns the matrix of a field; the identity without one. OSG multiplies rows, so that its rows are the columns of ours.
fn matrix_of(block: &Block<'_>, name: &str) -> DMat4 {
    let numbers = block.list(name).try_into().unwrap_or(DMat4::IDENTITY.to_cols_array());
    DMat4::from_cols_array(&numbers)
}

fn camera(block: &Block<'_>) -> CameraObject {
    const BOTH: u32 = CameraObject::CLEAR_COLOR | CameraObject::CLEAR_DEPTH;
    CameraObject {
        is_absolute: is_absolute(block),
        projection: matrix_of(block, "ProjectionMatrix"),
        view: matrix_of(block, "ViewMatrix"),
        order: match block.word("renderOrder") {
            "PRE_RENDER" => CameraOrder::Before,
            "NESTED_RENDER" => CameraOrder::Nested,
            _ => CameraOrder::After,
        },
        number: 0,
        clear_mask: block.value("clearMask").map_or(BOTH, |mask| mask as u32),
        clear_color: block.values("clearColor").map_or([0.0; 4], |color| color.map(|part| part as f32)),
        has_viewport: block.field("Viewport").is_some(),
        has_target: !matches!(block.word("renderTargetImplementation"), "" | "FRAME_BUFFER")
            || block.field("bufferComponent").is_some(),
    }
}

fn is_absolute(block: &Block<'_>) -> bool {
    let frame = block.word("referenceFrame");
    frame == "RELATIVE_TO_ABSOLUTE" || frame.starts_with("ABSOLUTE")
}

fn point(block: &Block<'_>, name: &str, default: DVec3) -> DVec3 {
    block.values(name).map_or(default, DVec3::from_array)
}

fn placement(block: &Block<'_>) -> DAffine3 {
    let [position, scale, pivot] = [("position", DVec3::ZERO), ("scale", DVec3::ONE), ("pivotPoint", DVec3::ZERO)]
        .map(|(name, default)| point(block, name, default));
    let map = DAffine3::from_scale_rotation_translation(scale, rotation(block, "attitude"), position);
    map * DAffine3::from_translation(-pivot)
}

fn auto(block: &Block<'_>) -> AutoObject {
    let limit = |name, default| block.value(name).unwrap_or(default);
    let scales = [limit("minimumScale", 0.0), limit("maximumScale", f64::MAX)];
    AutoObject {
        is_absolute: is_absolute(block),
        position: point(block, "position", DVec3::ZERO),
        rotation: rotation(block, "rotation"),
        scale: point(block, "scale", DVec3::ONE),
        pivot: point(block, "pivotPoint", DVec3::ZERO),
        turn: match block.word("autoRotateMode") {
            "ROTATE_TO_SCREEN" => AutoTurn::Screen,
            "ROTATE_TO_CAMERA" => AutoTurn::Camera,
            _ => AutoTurn::No,
        },
        screen_scales: (block.word("autoScaleToScreen") == "TRUE").then_some(scales),
    }
}

/// Returns which children are shown.
fn switch(block: &Block<'_>, count: usize) -> Vec<bool> {
    let mut shown: Vec<bool> = block.list("ValueList").iter().map(|value| *value != 0.0).collect();
    shown.resize(count, block.is_true("NewChildDefaultValue"));
    match block.word("value") {
        "ALL_CHILDREN_ON" => shown.fill(true),
        "ALL_CHILDREN_OFF" => shown.fill(false),
        // A child alone, in files of the first versions.
        word => {
            if let Some(only) = number_of(word) {
                shown.iter_mut().enumerate().for_each(|(i, is_shown)| *is_shown = i as f64 == only);
            }
        }
    }
    shown
}

/// Returns which children of a MultiSwitch are shown: those of its active set.
fn multi_switch(block: &Block<'_>, count: usize) -> Vec<bool> {
    let active = block.value("ActiveSwitchSet").unwrap_or(0.0);
    let is_active = |field: &&Field<'_>| field.word(0) == "ValueList" && number_of(field.word(1)) == Some(active);
    let set = block.fields.iter().find(is_active).and_then(|field| field.block.as_ref());
    let default = !matches!(block.word("NewChildDefaultValue"), "FALSE" | "0");
    let mut shown = set.map_or(vec![false; count], |set| set.numbers.iter().map(|value| *value != 0.0).collect());
    shown.resize(count, default);
    shown
}

fn freedom(block: &Block<'_>) -> Freedom {
    let numbers: Option<[f64; 16]> = block.list("PutMatrix").try_into().ok();
    Freedom {
        put: numbers.map_or(DMat4::IDENTITY, |rows| DMat4::from_cols_array(&rows)),
        turns: point(block, "currentHPR", DVec3::ZERO),
        position: point(block, "currentTranslate", DVec3::ZERO),
        scale: point(block, "currentScale", DVec3::ONE),
        order: value_of(ORDERS, block.word("multOrder")).unwrap_or(0),
    }
}

/// Returns position and colour of a light point; `None` for one that is off.
fn light_point(field: &Field<'_>) -> Option<([f32; 3], [f32; 4])> {
    let block = field.block.as_ref().filter(|_| field.word(0) == "lightPoint")?;
    let position = block.values("position")?.map(|part: f64| part as f32);
    let color = block.values("color").unwrap_or([1.0; 4]).map(|part| part as f32);
    block.is_true("isOn").then_some((position, color))
}

/// Returns the centre mode with centre and radius.
fn center(block: &Block<'_>) -> (CenterMode, Option<(DVec3, f64)>) {
    let radius = block.value("Radius").unwrap_or(-1.0);
    match block.values("Center").map(DVec3::from_array).filter(|center| center.is_finite()) {
        Some(center) => (CenterMode::UserDefined, Some((center, radius))),
        None => (CenterMode::BoundingSphere, None),
    }
}

fn lod(block: &Block<'_>) -> LodObject {
    let (center_mode, user_center) = center(block);
    // Files before 2002 have the ends of the ranges.
    let ends = block.list("Ranges");
    let mut ranges: Vec<[f64; 2]> = ends.windows(2).map(|range| [range[0], range[1]]).collect();
    if ranges.is_empty() {
        ranges = block.list("RangeList").chunks_exact(2).map(|range| [range[0], range[1]]).collect();
    }
    let is_by_pixel_size = block.word("RangeMode") == "PIXEL_SIZE_ON_SCREEN";
    LodObject { center_mode, user_center, is_by_pixel_size, ranges }
}

/// Returns the files of a PagedLOD or ProxyNode; empty for children in this file.
fn files(block: &Block<'_>) -> Vec<String> {
    let list = block.field("FileNameList").and_then(|field| field.block.as_ref());
    let words = list.iter().flat_map(|list| &list.fields).flat_map(|field| &field.words);
    words.map(|word| word.to_string()).collect()
}

fn paged(block: &Block<'_>) -> PagedObject {
    PagedObject {
        database_path: block.word("DatabasePath").to_owned(),
        files: files(block),
        priorities: Vec::new(),
        children_that_cannot_expire: block.value("NumChildrenThatCannotBeExpired").unwrap_or(0.0) as u32,
    }
}

fn proxy(block: &Block<'_>) -> ProxyObject {
    let (center_mode, user_center) = center(block);
    let loading = match block.word("ExtRefMode") {
        "DEFER_LOADING_TO_DATABASE_PAGER" => ProxyMode::DeferToPager,
        "NO_AUTOMATIC_LOADING" => ProxyMode::Never,
        _ => ProxyMode::Immediately,
    };
    ProxyObject { files: files(block), database_path: String::new(), loading, center_mode, user_center }
}

fn billboard(block: &Block<'_>) -> BillboardObject {
    let mode = match block.word("Mode") {
        "POINT_ROT_EYE" => BillboardTurn::Eye,
        "POINT_ROT_WORLD" => BillboardTurn::World,
        _ => BillboardTurn::Axis,
    };
    let positions = block.list("Positions").chunks_exact(3).map(DVec3::from_slice).collect();
    let (axis, normal) = (point(block, "Axis", DVec3::Z), point(block, "Normal", -DVec3::Y));
    BillboardObject { mode, axis, normal, positions }
}
