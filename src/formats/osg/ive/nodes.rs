//! Nodes.

use glam::{DAffine3, DMat4, DVec3, DVec4};

use super::{Kind, Reader, ids};
use crate::formats::osg::classes::{Freedom, clip_planes};
use crate::formats::osg::error::Result;
use crate::formats::osg::motion::SequenceObject;
use crate::formats::osg::objects::{
    AttributeObject, AutoObject, AutoTurn, BillboardObject, BillboardTurn, CameraObject, CameraOrder, NodeClass,
    NodeMembers, Object, ellipsoid,
};
use crate::math::Ellipsoid;

/// The bytes that a reference to a node or drawable takes.
const REFERENCE_BYTES: usize = 4;

impl Reader<'_> {
    /// Reads a node.
    pub(super) fn node(&mut self) -> Result<Object> {
        self.shared(Kind::Node, Self::new_node)
    }

    fn new_node(&mut self) -> Result<Object> {
        match self.class()? {
            ids::NODE => Ok(self.node_members()?.with(NodeClass::Group, Vec::new())),
            ids::GROUP => self.group_members().map(|(node, children)| node.with(NodeClass::Group, children)),
            ids::GEODE => self.geode_members().map(|(node, drawables)| node.with(NodeClass::Group, drawables)),
            ids::TRANSFORM => {
                let (node, children, is_absolute) = self.transform_members()?;
                Ok(node.transform(Some(DAffine3::IDENTITY), is_absolute, children))
            }
            ids::MATRIX_TRANSFORM => self.matrix_transform(),
            ids::POSITION_ATTITUDE_TRANSFORM => self.position_attitude_transform(),
            ids::AUTO_TRANSFORM => self.auto_transform(),
            ids::DOF_TRANSFORM => self.dof_transform(),
            ids::CAMERA => self.camera(),
            ids::CAMERA_VIEW => self.camera_view(),
            ids::BILLBOARD => self.billboard(),
            ids::SWITCH => self.switch(),
            ids::MULTI_SWITCH => self.multi_switch(),
            ids::SEQUENCE => self.sequence(),
            ids::LOD => self.lod(),
            ids::IMPOSTOR => self.impostor(),
            ids::PAGED_LOD => self.paged_lod(),
            ids::PROXY_NODE => self.proxy_node(),
            ids::COORDINATE_SYSTEM_NODE => {
                let (node, children, system) = self.coordinate_system_members()?;
                Ok(node.with(NodeClass::CoordinateSystem(system), children))
            }
            ids::TERRAIN => self.terrain(),
            ids::TERRAIN_TILE => self.terrain_tile(),
            ids::LIGHT_POINT_NODE => self.light_points(),
            ids::LIGHT_SOURCE => self.light_source(),
            ids::CLIP_NODE => self.clip_node(),
            ids::VOLUME_TILE => self.volume_tile(),
            class => self.like_group(class),
        }
    }

    /// Reads a node whose children are drawn without what its class adds.
    fn like_group(&mut self, class: u32) -> Result<Object> {
        self.unsigned()?;
        if let ids::ANISOTROPIC_LIGHTING | ids::BUMP_MAPPING | ids::CARTOON | ids::SCRIBE | ids::SPECULAR_HIGHLIGHTS =
            class
        {
            let (node, children) = self.effect(class)?;
            return Ok(node.with(NodeClass::Group, children));
        }
        let (node, children) = match class {
            ids::TEX_GEN_NODE
            | ids::OCCLUDER_NODE
            | ids::OCCLUSION_QUERY_NODE
            | ids::VISIBILITY_GROUP
            | ids::VOLUME
            | ids::MULTI_TEXTURE_CONTROL => self.group_members()?,
            _ => return Err(Self::unknown("a node", class)),
        };
        self.note_children(class);
        match class {
            ids::TEX_GEN_NODE => {
                self.unsigned()?;
                self.optional(Self::attribute_in_place)?;
            }
            ids::OCCLUDER_NODE => drop(self.optional(Self::occluder)?),
            ids::OCCLUSION_QUERY_NODE => {
                self.boolean()?;
                self.integers::<2>()?;
                self.boolean()?;
            }
            ids::VISIBILITY_GROUP => {
                self.node()?;
                self.integers::<2>()?;
            }
            ids::MULTI_TEXTURE_CONTROL => drop(self.list(4, Self::float)?),
            _ => {}
        }
        Ok(node.with(NodeClass::Group, children))
    }

    fn light_source(&mut self) -> Result<Object> {
        self.expect(ids::LIGHT_SOURCE)?;
        let (node, children) = self.group_members()?;
        let light = match self.optional(Self::attribute_in_place)? {
            Some(Object::Attribute(attribute)) => match &*attribute {
                AttributeObject::Light(light) => Some(*light),
                _ => None,
            },
            _ => None,
        };
        let is_absolute = self.integer()? != 0;
        Ok(node.with(NodeClass::Light { light, is_absolute }, children))
    }

    fn clip_node(&mut self) -> Result<Object> {
        self.expect(ids::CLIP_NODE)?;
        let (node, children) = self.group_members()?;
        let is_absolute = self.version >= 37 && self.integer()? != 0;
        let planes = clip_planes(self.list(4, Self::attribute_in_place)?);
        Ok(node.with(NodeClass::Clip { planes, is_absolute }, children))
    }

    /// Reads over a ConvexPlanarOccluder.
    fn occluder(&mut self) -> Result<()> {
        self.expect(ids::CONVEX_PLANAR_OCCLUDER)?;
        self.object_members()?;
        self.planar_polygon()?;
        for _ in 0..self.count(8)? {
            self.planar_polygon()?;
        }
        Ok(())
    }

    fn planar_polygon(&mut self) -> Result<()> {
        self.expect(ids::CONVEX_PLANAR_POLYGON)?;
        let points = self.count(12)?;
        self.skip(points * 12)
    }

    /// Reads the members of the classes Object and Node.
    pub(super) fn node_members(&mut self) -> Result<NodeMembers> {
        self.expect(ids::NODE)?;
        let mut name = self.object_members()?;
        if self.version < 12 {
            name = self.string()?;
        }
        let culling_active = self.boolean()?;
        // The descriptions.
        for _ in 0..self.count(4)? {
            self.string()?;
        }
        let state = self.optional_state_set()?;
        let animation = self.optional(Self::animation)?.flatten();
        if self.version >= 6 {
            self.optional(Self::cluster_culling)?;
        }
        if self.version >= 39 {
            self.optional(Self::property_adjustment)?;
        }
        if self.version >= 10 {
            // The initial bound.
            self.optional(Self::floats::<4>)?;
        }
        Ok(NodeMembers { name, mask: self.unsigned()?, culling_active, state, animation })
    }

    /// Reads the members of the classes Object, Node and Group.
    pub(super) fn group_members(&mut self) -> Result<(NodeMembers, Vec<Object>)> {
        self.expect(ids::GROUP)?;
        let node = self.node_members()?;
        Ok((node, self.list(REFERENCE_BYTES, Self::node)?))
    }

    fn geode_members(&mut self) -> Result<(NodeMembers, Vec<Object>)> {
        self.expect(ids::GEODE)?;
        let node = self.node_members()?;
        Ok((node, self.list(REFERENCE_BYTES, Self::drawable)?))
    }

    /// Reads the members of a Group and of the class Transform, with true if it is not relative to the nodes above.
    fn transform_members(&mut self) -> Result<(NodeMembers, Vec<Object>, bool)> {
        self.expect(ids::TRANSFORM)?;
        let (node, children) = self.group_members()?;
        Ok((node, children, self.integer()? != 0))
    }

    /// Reads the members of a Group and of the class CoordinateSystemNode, and returns its system at the end: empty if the
    /// positions are earth-centred.
    pub(super) fn coordinate_system_members(&mut self) -> Result<(NodeMembers, Vec<Object>, String)> {
        self.expect(ids::COORDINATE_SYSTEM_NODE)?;
        let (node, children) = self.group_members()?;
        // The format of the system.
        self.string()?;
        let system = self.string()?;
        let is_geocentric = self.optional(Self::ellipsoid)?.is_some();
        Ok((node, children, if is_geocentric { String::new() } else { system }))
    }

    /// Reads an EllipsoidModel.
    pub(super) fn ellipsoid(&mut self) -> Result<Ellipsoid> {
        self.expect(ids::ELLIPSOID_MODEL)?;
        self.object_members()?;
        let [equator_m, polar_m] = self.doubles()?;
        Ok(ellipsoid(equator_m, polar_m))
    }

    /// Returns the map of a matrix; `None`, noted, if it is not affine.
    fn affine(&self, matrix: DMat4) -> Option<DAffine3> {
        let is_affine = matrix.is_finite() && matrix.row(3) == DVec4::W;
        if !is_affine {
            self.notes.add("OpenSceneGraph: a matrix that is not affine");
        }
        is_affine.then(|| DAffine3::from_mat4(matrix))
    }

    fn matrix_transform(&mut self) -> Result<Object> {
        self.expect(ids::MATRIX_TRANSFORM)?;
        // It is written as a Group with a matrix, without the reference frame of a Transform.
        let (node, children) = self.group_members()?;
        let matrix = self.matrix()?;
        let map = self.affine(matrix);
        Ok(node.transform(map, false, children))
    }

    fn position_attitude_transform(&mut self) -> Result<Object> {
        self.expect(ids::POSITION_ATTITUDE_TRANSFORM)?;
        let (node, children, is_absolute) = self.transform_members()?;
        let (position, rotation) = (self.point()?, self.rotation()?);
        let (scale, pivot) = (self.point()?, self.point()?);
        let map =
            DAffine3::from_scale_rotation_translation(scale, rotation, position) * DAffine3::from_translation(-pivot);
        Ok(node.transform(Some(map), is_absolute, children))
    }

    fn auto_transform(&mut self) -> Result<Object> {
        self.expect(ids::AUTO_TRANSFORM)?;
        let (node, children, is_absolute) = self.transform_members()?;
        let (position, pivot) = (self.point()?, self.point()?);
        // The tolerance of the eye's movement.
        self.float()?;
        let turn = match self.integer()? {
            0 => AutoTurn::No,
            2 => AutoTurn::Camera,
            _ => AutoTurn::Screen,
        };
        let keeps_size = self.boolean()?;
        let mut scales = [0.0, f64::MAX];
        if self.version >= 25 {
            let [min, max, _transition] = self.floats()?;
            // The largest double is written as an infinite float.
            scales = [f64::from(min), if max < f32::MAX { f64::from(max) } else { f64::MAX }];
        }
        let (rotation, scale) = (self.rotation()?, self.point()?);
        let screen_scales = keeps_size.then_some(scales);
        let auto = AutoObject { is_absolute, position, rotation, scale, pivot, turn, screen_scales };
        Ok(node.with(NodeClass::AutoTransform(auto), children))
    }

    /// Reads a DOFTransform in its current position.
    fn dof_transform(&mut self) -> Result<Object> {
        self.expect(ids::DOF_TRANSFORM)?;
        let (node, children, is_absolute) = self.transform_members()?;
        let put = self.matrix()?;
        // Minimum, maximum and increment before the current value.
        let mut current = || -> Result<DVec3> {
            self.floats::<9>()?;
            self.point()
        };
        let (turns, position, scale) = (current()?, current()?, current()?);
        let order = if self.version >= 11 { self.byte()?.into() } else { 0 };
        // The limits, and whether it is animated.
        self.unsigned()?;
        self.boolean()?;
        let map = Freedom { put, turns, position, scale, order }.parent_from_child();
        Ok(node.with(NodeClass::transform(map, is_absolute, None), children))
    }

    fn camera(&mut self) -> Result<Object> {
        self.expect(ids::CAMERA)?;
        let (node, children, is_absolute) = self.transform_members()?;
        let (clear_color, clear_mask) = (self.floats()?, self.unsigned()?);
        // The colour mask.
        self.optional(Self::attribute_of_camera)?;
        let has_viewport = self.optional(Self::attribute_of_camera)?.is_some();
        // The order of the transform.
        self.integer()?;
        let (projection, view) = (self.matrix()?, self.matrix()?);
        // The last three are the target if the first one fails, the draw and the read buffer.
        let [order, target, ..] = self.integers::<5>()?;
        let targets = self.count(4)?;
        for _ in 0..targets {
            // Buffer and internal format.
            self.integers::<2>()?;
            self.optional(Self::raw_image)?;
            self.optional(Self::attribute_of_camera)?;
            // Level, face, and whether mip levels are generated.
            self.integers::<2>()?;
            self.boolean()?;
        }
        let camera = CameraObject {
            is_absolute,
            projection,
            view,
            order: CameraOrder::of_number(order),
            number: 0,
            clear_mask,
            clear_color,
            has_viewport,
            has_target: targets > 0 || target != CameraObject::FRAME_BUFFER,
        };
        Ok(node.with(NodeClass::Camera(Box::new(camera)), children))
    }

    /// Reads an attribute of a Camera.
    fn attribute_of_camera(&mut self) -> Result<Object> {
        self.shared(Kind::Attribute, Self::attribute_in_place)
    }

    /// Reads a CameraView: a transform that marks a place to look from.
    fn camera_view(&mut self) -> Result<Object> {
        self.expect(ids::CAMERA_VIEW)?;
        let (node, children, is_absolute) = self.transform_members()?;
        let (position, rotation) = (self.point()?, self.rotation()?);
        // The field of view with its mode, and the focal length.
        self.double()?;
        self.integer()?;
        self.double()?;
        let map = DAffine3::from_rotation_translation(rotation, position);
        Ok(node.transform(Some(map), is_absolute, children))
    }

    fn billboard(&mut self) -> Result<Object> {
        self.expect(ids::BILLBOARD)?;
        let (node, drawables) = self.geode_members()?;
        let mode = match self.integer()? {
            0 => BillboardTurn::Eye,
            1 => BillboardTurn::World,
            _ => BillboardTurn::Axis,
        };
        let (axis, normal) = (self.point()?, self.point()?);
        let positions = self.list(12, Self::point)?;
        Ok(node.with(NodeClass::Billboard(BillboardObject { mode, axis, normal, positions }), drawables))
    }

    fn switch(&mut self) -> Result<Object> {
        self.expect(ids::SWITCH)?;
        let (node, children) = self.group_members()?;
        let shown = self.shown(children.len())?;
        Ok(node.with(NodeClass::Switch(shown), children))
    }

    /// Reads for each child whether it is shown.
    fn shown(&mut self, count: usize) -> Result<Vec<bool>> {
        (0..count).map(|_| self.boolean()).collect()
    }

    /// Reads a MultiSwitch as a Switch with its active set.
    fn multi_switch(&mut self) -> Result<Object> {
        self.expect(ids::MULTI_SWITCH)?;
        let (node, children) = self.group_members()?;
        // The value of new children.
        self.boolean()?;
        let active = self.unsigned()?;
        // OSG draws nothing for a set that is missing.
        let mut shown = vec![false; children.len()];
        // Sets take no bytes where there are no children.
        let sets = if children.is_empty() { self.integer().map(|_| 0) } else { self.count(children.len()) }?;
        for set in 0..sets {
            let of_set = self.shown(children.len())?;
            if set == active as usize {
                shown = of_set;
            }
        }
        Ok(node.with(NodeClass::Switch(shown), children))
    }

    fn sequence(&mut self) -> Result<Object> {
        self.expect(ids::SEQUENCE)?;
        let has_defaults = self.version >= 22;
        let (node, children) = self.group_members()?;
        let mut sequence = SequenceObject::default();
        if has_defaults {
            self.float()?;
        }
        sequence.times_s = self.list(4, |reader| reader.float().map(f64::from))?;
        sequence.times_s.resize(children.len().max(sequence.times_s.len()), 1.0);
        if has_defaults {
            sequence.last_time_s = self.float()?.into();
        }
        sequence.swings = self.integer()? == 1;
        sequence.interval = [self.integer()?, self.integer()?];
        sequence.speed = self.float()?.into();
        sequence.repeats = self.integer()?;
        sequence.plays = self.integer()? == 0;
        if has_defaults {
            // Whether it skips children if frames are late.
            self.integer()?;
            sequence.clears = self.integer()? != 0;
        }
        Ok(node.with(NodeClass::Sequence(sequence), children))
    }
}
