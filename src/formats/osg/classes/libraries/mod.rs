//! The members of the nodes and drawables of OSG's other libraries: osgSim, osgFX, osgShadow, osgAnimation and osgText.

mod texts;

use std::sync::Arc;

use glam::{DAffine3, DMat4, DQuat, DVec3, DVec4};

use super::Reader;
use crate::formats::osg::error::Result;
use crate::formats::osg::input::{Names, Number, Values};
use crate::formats::osg::objects::{
    ArrayObject, Binding, BoundArray, DrawableClass, DrawableObject, GeometryObject, Indices, NodeClass, Object,
    PrimitiveObject,
};

/// Classes whose members begin like those of a Group. Their own members are left out.
pub(in crate::formats::osg) const LIKE_GROUPS: [&str; 14] = [
    "osg::TexGenNode",
    "osg::ClearNode",
    "osg::OccluderNode",
    "osg::OcclusionQueryNode",
    "osgFX::AnisotropicLighting",
    "osgFX::BumpMapping",
    "osgFX::Cartoon",
    "osgFX::MultiTextureControl",
    "osgFX::Outline",
    "osgFX::Scribe",
    "osgFX::SpecularHighlights",
    "osgShadow::ShadowedScene",
    "osgSim::OverlayNode",
    "osgSim::VisibilityGroup",
];
/// Classes whose members begin like those of a MatrixTransform: bones, in their rest pose.
pub(in crate::formats::osg) const LIKE_TRANSFORMS: [&str; 2] = ["osgAnimation::Skeleton", "osgAnimation::Bone"];
/// Classes whose members begin like those of a Geode.
pub(in crate::formats::osg) const LIKE_GEODES: [&str; 2] = ["osgSim::ScalarBar", "osgSim::SphereSegment"];
/// Classes whose members begin like those of a Geometry: surfaces that are animated.
const LIKE_GEOMETRIES: [&str; 2] = ["osgAnimation::MorphGeometry", "osgAnimation::RigGeometry"];

/// The orders of heading, pitch and roll of a DOFTransform, the outermost first. Their places are the numbers in binary files.
pub(in crate::formats::osg) const ORDERS: Names =
    &[("PRH", 0), ("PHR", 1), ("HPR", 2), ("HRP", 3), ("RPH", 4), ("RHP", 5)];

/// The members of a DOFTransform that place its children.
pub(in crate::formats::osg) struct Freedom {
    /// The matrix that leads to the frame in which the parts move.
    pub put: DMat4,
    /// Heading, pitch and roll, radians.
    pub turns: DVec3,
    pub position: DVec3,
    pub scale: DVec3,
    /// The order of the angles, one of [`ORDERS`].
    pub order: u32,
}

impl Freedom {
    /// Returns the map; `None` if it is not affine or not finite.
    pub fn parent_from_child(&self) -> Option<DAffine3> {
        let axes = [('H', DVec3::Z, self.turns.x), ('P', DVec3::X, self.turns.y), ('R', DVec3::Y, self.turns.z)];
        let order = ORDERS.get(self.order as usize).map_or("PRH", |(name, _)| *name);
        let turn = order.chars().filter_map(|letter| axes.iter().find(|(axis, ..)| *axis == letter));
        let turn = turn.fold(DQuat::IDENTITY, |all, (_, axis, angle)| all * DQuat::from_axis_angle(*axis, *angle));
        let moved = DMat4::from_scale_rotation_translation(self.scale, turn, self.position);
        let map = self.put.inverse() * moved * self.put;
        (self.put.row(3) == DVec4::W && map.is_finite()).then(|| DAffine3::from_mat4(map))
    }
}

/// Returns points of positions and colours as a drawable.
pub(in crate::formats::osg) fn light_points(points: Vec<([f32; 3], [f32; 4])>) -> Object {
    let count = points.len();
    let bound = |width: usize, values: Vec<f32>| {
        let array = ArrayObject { width, values: Values::F32(values), binding: None, is_normalized: false };
        Some(BoundArray {
            array: Arc::new(array),
            indices: None,
            binding: Some(Binding::PerVertex),
            is_normalized: false,
        })
    };
    let (positions, colors): (Vec<[f32; 3]>, Vec<[f32; 4]>) = points.into_iter().unzip();
    let set = PrimitiveObject { mode: 0, instances: 0, indices: Indices::Arrays { first: 0, count: count as i64 } };
    let geometry = GeometryObject {
        primitives: vec![Arc::new(set)],
        vertices: bound(3, positions.concat()),
        colors: bound(4, colors.concat()),
        ..GeometryObject::default()
    };
    let class = DrawableClass::Geometry(geometry);
    Object::Drawable(Arc::new(DrawableObject { name: String::new(), mask: u32::MAX, state: None, class }))
}

impl Reader<'_> {
    /// Reads the members of a class of another library; `None` if the class is none of them.
    pub(super) fn of_library(&mut self, class: &str) -> Result<Option<Object>> {
        let note = |reader: &Self, what: &str| reader.notes.add(format!("OpenSceneGraph class {class} ({what})"));
        Ok(Some(match class {
            "osgSim::MultiSwitch" if self.version < 160 || self.input.can_skip() => self.multi_switch()?,
            "osgSim::DOFTransform" => self.freedom_transform()?,
            "osgSim::LightPointNode" => self.light_point_node()?,
            "osgText::Text" | "osgText::FadeText" | "osgText::Text3D" => self.text(class)?,
            "osgSim::Impostor" => {
                let lod = self.lod()?;
                self.float_member("ImpostorThreshold", -1.0)?;
                lod
            }
            _ if !self.input.can_skip() => return Ok(None),
            _ if LIKE_GROUPS.contains(&class) => {
                note(self, "its children are drawn");
                self.group(NodeClass::Group)?
            }
            _ if LIKE_TRANSFORMS.contains(&class) => {
                note(self, "its children are drawn");
                self.matrix_transform()?
            }
            _ if LIKE_GEODES.contains(&class) => self.geode()?,
            _ if LIKE_GEOMETRIES.contains(&class) => {
                note(self, "its rest pose is drawn");
                let own = self.geometry()?;
                if class == "osgAnimation::RigGeometry" { self.rig_source(own)? } else { own }
            }
            _ => return Ok(None),
        }))
    }

    /// Reads the members of a RigGeometry, and returns the surface that bones move: its source if the geometry itself has no
    /// vertices yet.
    fn rig_source(&mut self, own: Object) -> Result<Object> {
        if self.marked_member("InfluenceMap")? {
            self.list(|reader| {
                reader.input.keyword("VertexInfluence")?;
                reader.input.quoted()?;
                reader.list(|reader| {
                    reader.integer(Number::I32)?;
                    reader.float()
                })
            })?;
        }
        let source = self.object_member("SourceGeometry")?;
        let (Object::Drawable(rig), Object::Drawable(drawable)) = (&own, source) else { return Ok(own) };
        match (&rig.class, &drawable.class) {
            (DrawableClass::Geometry(GeometryObject { vertices: None, .. }), DrawableClass::Geometry(surface)) => {
                let state = rig.state.clone().or(drawable.state.clone());
                let class = DrawableClass::Geometry(surface.clone());
                Ok(Object::Drawable(Arc::new(DrawableObject { name: rig.name.clone(), mask: rig.mask, state, class })))
            }
            _ => Ok(own),
        }
    }

    fn multi_switch(&mut self) -> Result<Object> {
        let (node, children) = self.group_members()?;
        let default = self.boolean_member("NewChildDefaultValue", true)?;
        let active = self.unsigned_member("ActiveSwitchSet", 0)? as usize;
        let mut sets = Vec::new();
        if self.marked_member("Values")? {
            sets = self.list(|reader| {
                reader.input.keyword("SwitchSet")?;
                reader.list(|reader| reader.input.boolean())
            })?;
        }
        // The names of the sets follow, in files of some versions from 160 on.
        // OSG draws nothing for a set that is missing.
        let mut shown = if active < sets.len() { sets.swap_remove(active) } else { vec![false; children.len()] };
        shown.resize(children.len(), default);
        Ok(node.with(NodeClass::Switch(shown), children))
    }

    fn freedom_transform(&mut self) -> Result<Object> {
        let (node, children) = self.group_members()?;
        let is_absolute = self.reference_frame()?;
        let mut current = [DVec3::ZERO, DVec3::ZERO, DVec3::ONE];
        for (value, names) in current.iter_mut().zip([
            ["MinHPR", "MaxHPR", "CurrentHPR", "IncrementHPR"],
            ["MinTranslate", "MaxTranslate", "CurrentTranslate", "IncrementTranslate"],
            ["MinScale", "MaxScale", "CurrentScale", "IncrementScale"],
        ]) {
            for (at, name) in names.into_iter().enumerate() {
                let default = value.to_array().map(|part| part as f32);
                let read = DVec3::from_array(self.floats_member(name, default)?.map(f64::from));
                if at == 2 {
                    *value = read;
                }
            }
        }
        let mut put = DMat4::IDENTITY;
        if self.marked_member("PutMatrix")? {
            self.name_of_matrix()?;
            put = self.block(|reader| reader.floats().map(|rows| DMat4::from_cols_array(&rows.map(f64::from))))?;
        }
        if self.marked_member("LimitationFlags")? {
            self.unsigned()?;
        }
        self.boolean_member("AnimationOn", false)?;
        let order = self.named_member("HPRMultOrder", ORDERS, 0)?;
        let [turns, position, scale] = current;
        let map = Freedom { put, turns, position, scale, order }.parent_from_child();
        Ok(node.with(NodeClass::transform(map, is_absolute, None), children))
    }

    fn light_point_node(&mut self) -> Result<Object> {
        let node = self.node_members()?;
        let mut points = Vec::new();
        if self.marked_member("LightPointList")? {
            points = self.list(Self::light_point)?;
        }
        for (name, default) in [("MinPixelSize", 0.0), ("MaxPixelSize", 30.0), ("MaxVisibleDistance2", f32::MAX)] {
            self.float_member(name, default)?;
        }
        self.object_member("LightPointSystem")?;
        self.boolean_member("PointSprite", false)?;
        let points: Vec<_> = points.into_iter().flatten().collect();
        let children = if points.is_empty() { Vec::new() } else { vec![light_points(points)] };
        Ok(node.with(NodeClass::Group, children))
    }

    /// Reads a light point; `None` for one that is off.
    fn light_point(&mut self) -> Result<Option<([f32; 3], [f32; 4])>> {
        self.input.keyword("LightPoint")?;
        self.block(|reader| {
            reader.input.keyword("Position")?;
            let position = reader.floats()?;
            reader.input.keyword("Color")?;
            let color = reader.floats()?;
            reader.input.keyword("Attributes")?;
            let is_on = reader.input.boolean()?;
            reader.integer(Number::I32)?;
            reader.floats::<2>()?;
            for name in ["Sector", "BlinkSequence"] {
                reader.input.keyword(name)?;
                if reader.input.boolean()? {
                    reader.block(Self::object)?;
                }
            }
            Ok(is_on.then_some((position, color)))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_turn_in_the_order_of_their_axes() {
        let freedom = |order| Freedom {
            put: DMat4::from_translation(DVec3::new(-1.0, 0.0, 0.0)),
            turns: DVec3::new(std::f64::consts::FRAC_PI_2, std::f64::consts::FRAC_PI_2, 0.0),
            position: DVec3::new(0.0, 0.0, 5.0),
            scale: DVec3::new(2.0, 1.0, 1.0),
            order,
        };
        let at = |order| freedom(order).parent_from_child().unwrap().transform_point3(DVec3::new(2.0, 0.0, 0.0));
        // (2, 0, 0) is (1, 0, 0) about the pivot and (2, 0, 0) scaled. PRH turns it by the heading to y, then by the pitch to z.
        assert!(at(0).abs_diff_eq(DVec3::new(1.0, 0.0, 7.0), 1e-9), "{}", at(0));
        // HPR pitches first, which x does not feel.
        assert!(at(2).abs_diff_eq(DVec3::new(1.0, 2.0, 5.0), 1e-9), "{}", at(2));
        let flat = Freedom { put: DMat4::ZERO, ..freedom(0) };
        assert_eq!(flat.parent_from_child(), None);
    }
}
