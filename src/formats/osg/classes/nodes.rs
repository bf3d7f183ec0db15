//! The members of nodes.

use std::sync::Arc;

use glam::{DAffine3, DMat4, DVec3, DVec4};

use super::Reader;
use crate::formats::osg::error::Result;
use crate::formats::osg::input::{Names, Number};
use crate::formats::osg::objects::{
    AutoObject, AutoTurn, BillboardObject, BillboardTurn, CameraObject, CameraOrder, NodeClass, NodeMembers, Object,
    StateObject,
};

impl Reader<'_> {
    /// Reads the members of a node; `None` if the class is none. `short` is the class without its namespace.
    pub(super) fn node_of(&mut self, class: &str, short: &str) -> Result<Option<Object>> {
        Ok(Some(match short {
            "Node" => self.node_members()?.with(NodeClass::Group, Vec::new()),
            "Group" => self.group(NodeClass::Group)?,
            "Geode" => self.geode()?,
            "Transform" => {
                let (node, children) = self.group_members()?;
                let is_absolute = self.reference_frame()?;
                node.with(NodeClass::transform(Some(DAffine3::IDENTITY), is_absolute, None), children)
            }
            "MatrixTransform" => self.matrix_transform()?,
            "PositionAttitudeTransform" => self.position_attitude_transform()?,
            "Switch" => self.switch()?,
            "LOD" => self.lod()?,
            "PagedLOD" => self.paged_lod()?,
            "ProxyNode" => self.proxy_node()?,
            "Sequence" => self.sequence()?,
            "Billboard" => self.billboard()?,
            "AutoTransform" => self.auto_transform()?,
            "LightSource" => self.light_source()?,
            "ClipNode" => self.clip_node()?,
            "Camera" if self.input.can_skip() => self.camera()?,
            "Projection" => {
                let (node, children) = self.group_members()?;
                let matrix = if self.member("Matrix")? { self.matrix()? } else { DMat4::IDENTITY };
                node.with(NodeClass::Projection(Box::new(matrix)), children)
            }
            "CoordinateSystemNode" => {
                let (node, children, system) = self.coordinate_system_members()?;
                node.with(NodeClass::CoordinateSystem(system), children)
            }
            _ => return self.of_library(class),
        }))
    }

    pub(super) fn group(&mut self, class: NodeClass) -> Result<Object> {
        let (node, children) = self.group_members()?;
        Ok(node.with(class, children))
    }

    pub(super) fn geode(&mut self) -> Result<Object> {
        let (node, drawables) = self.geode_members()?;
        Ok(node.with(NodeClass::Group, drawables))
    }

    fn geode_members(&mut self) -> Result<(NodeMembers, Vec<Object>)> {
        let node = self.node_members()?;
        let drawables = if self.marked_member("Drawables")? { self.list(Self::object)? } else { Vec::new() };
        Ok((node, drawables))
    }

    fn billboard(&mut self) -> Result<Object> {
        const MODES: Names = &[("POINT_ROT_EYE", 0), ("POINT_ROT_WORLD", 1), ("AXIAL_ROT", 2)];
        let (node, drawables) = self.geode_members()?;
        let mode = match self.named_member("Mode", MODES, 2)? {
            0 => BillboardTurn::Eye,
            1 => BillboardTurn::World,
            _ => BillboardTurn::Axis,
        };
        let point = |point: [f32; 3]| DVec3::from_array(point.map(f64::from));
        let axis = point(self.floats_member("Axis", [0.0, 0.0, 1.0])?);
        let normal = point(self.floats_member("Normal", [0.0, -1.0, 0.0])?);
        let mut positions = Vec::new();
        if self.marked_member("PositionList")? {
            positions = self.list(|reader| reader.doubles().map(DVec3::from_array))?;
        }
        Ok(node.with(NodeClass::Billboard(BillboardObject { mode, axis, normal, positions }), drawables))
    }

    fn auto_transform(&mut self) -> Result<Object> {
        const TURNS: Names = &[("NO_ROTATION", 0), ("ROTATE_TO_SCREEN", 1), ("ROTATE_TO_CAMERA", 2)];
        let (node, children) = self.group_members()?;
        let is_absolute = self.reference_frame()?;
        let scales = [self.double_member("MinimumScale", 0.0)?, self.double_member("MaximumScale", f64::MAX)?];
        let position = self.point_member("Position", DVec3::ZERO)?;
        let scale = self.point_member("Scale", DVec3::ONE)?;
        let pivot = self.point_member("PivotPoint", DVec3::ZERO)?;
        self.float_member("AutoUpdateEyeMovementTolerance", 0.0)?;
        let turn = match self.named_member("AutoRotateMode", TURNS, 0)? {
            0 => AutoTurn::No,
            2 => AutoTurn::Camera,
            _ => AutoTurn::Screen,
        };
        let keeps_size = self.boolean_member("AutoScaleToScreen", false)?;
        let rotation = self.rotation_member("Rotation")?;
        self.float_member("AutoScaleTransitionWidthRatio", 0.25)?;
        let screen_scales = keeps_size.then_some(scales);
        let auto = AutoObject { is_absolute, position, rotation, scale, pivot, turn, screen_scales };
        Ok(node.with(NodeClass::AutoTransform(auto), children))
    }

    /// Reads the members of a Camera up to its targets. The sizes of blocks lead to what follows.
    fn camera(&mut self) -> Result<Object> {
        const ORDERS: Names = &[("PRE_RENDER", 0), ("NESTED_RENDER", 1), ("POST_RENDER", 2)];
        const MULTIPLICATIONS: Names = &[("PRE_MULTIPLY", 0), ("POST_MULTIPLY", 1)];
        const POLICIES: Names = &[("FIXED", 0), ("HORIZONTAL", 1), ("VERTICAL", 2)];
        const TARGETS: Names = &[
            ("FRAME_BUFFER_OBJECT", 0),
            ("PIXEL_BUFFER_RTT", 1),
            ("PIXEL_BUFFER", 2),
            ("FRAME_BUFFER", CameraObject::FRAME_BUFFER),
            ("SEPARATE_WINDOW", 4),
        ];
        let (node, children) = self.group_members()?;
        let is_absolute = self.reference_frame()?;
        self.boolean_member("AllowEventFocus", true)?;
        let clear_mask = self.clear_mask()?;
        let clear_color = self.floats_member("ClearColor", [0.0; 4])?;
        self.floats_member("ClearAccum", [0.0; 4])?;
        self.double_member("ClearDepth", 1.0)?;
        self.integer_member("ClearStencil", 0)?;
        self.object_member("ColorMask")?;
        let has_viewport = self.member("Viewport")? && self.input.boolean()?;
        if has_viewport {
            self.in_braces(Self::object)?;
        }
        self.named_member("TransformOrder", MULTIPLICATIONS, 0)?;
        self.named_member("ProjectionResizePolicy", POLICIES, 1)?;
        let projection = if self.member("ProjectionMatrix")? { self.matrix()? } else { DMat4::IDENTITY };
        let view = if self.member("ViewMatrix")? { self.matrix()? } else { DMat4::IDENTITY };
        let (mut order, mut number) = (CameraOrder::After, 0);
        if self.marked_member("RenderOrder")? {
            order = CameraOrder::of_number(self.input.named(ORDERS)?);
            number = self.input.number(Number::I32)? as i32;
        }
        for buffer in ["DrawBuffer", "ReadBuffer"] {
            self.skipped_constant(buffer)?;
        }
        let target = self.named_member("RenderTargetImplementation", TARGETS, CameraObject::FRAME_BUFFER)?;
        let has_target = target != CameraObject::FRAME_BUFFER || self.marked_member("BufferAttachmentMap")?;
        let camera = CameraObject {
            is_absolute,
            projection,
            view,
            order,
            number,
            clear_mask,
            clear_color,
            has_viewport,
            has_target,
        };
        Ok(node.with(NodeClass::Camera(Box::new(camera)), children))
    }

    /// Reads what a Camera clears, as bits.
    fn clear_mask(&mut self) -> Result<u32> {
        const BOTH: u32 = CameraObject::CLEAR_COLOR | CameraObject::CLEAR_DEPTH;
        // Versions below 123 mark it in binary.
        let follows = if self.version < 123 { self.marked_member("ClearMask")? } else { self.member("ClearMask")? };
        if !follows {
            return Ok(BOTH);
        }
        if !self.input.is_text() {
            return self.unsigned();
        }
        let word = self.input.word()?;
        let bit = |name: &str| match name {
            "COLOR" => CameraObject::CLEAR_COLOR,
            "DEPTH" => CameraObject::CLEAR_DEPTH,
            _ => 0,
        };
        Ok(word.split('|').map(bit).fold(0, |mask, bit| mask | bit))
    }

    /// Reads the members of the classes Object and Node.
    pub(super) fn node_members(&mut self) -> Result<NodeMembers> {
        let name = self.object_members()?;
        self.members_of_node_alone(name)
    }

    /// Reads the members of the class Node, for a name that was read.
    pub(super) fn members_of_node_alone(&mut self, name: String) -> Result<NodeMembers> {
        if self.marked_member("InitialBound")? {
            self.block(|reader| {
                reader.input.keyword("Center")?;
                reader.doubles::<3>()?;
                reader.input.keyword("Radius")?;
                reader.double()
            })?;
        }
        let mut animation = None;
        for callback in ["ComputeBoundingSphereCallback", "UpdateCallback", "EventCallback", "CullCallback"] {
            if let (Object::Animation(moves), "UpdateCallback") = (self.object_member(callback)?, callback) {
                animation = Some(moves);
            }
        }
        let culling_active = self.boolean_member("CullingActive", true)?;
        let mask = self.unsigned_member("NodeMask", u32::MAX)?;
        if self.version < 77 && self.marked_member("Descriptions")? {
            self.list(|reader| reader.input.quoted())?;
        }
        let state = self.state_member("StateSet")?;
        Ok(NodeMembers { name, mask, culling_active, state, animation })
    }

    /// Reads the members of the classes Object, Node and Group.
    pub(super) fn group_members(&mut self) -> Result<(NodeMembers, Vec<Object>)> {
        let node = self.node_members()?;
        let children = if self.marked_member("Children")? { self.list(Self::object)? } else { Vec::new() };
        Ok((node, children))
    }

    /// Reads the members of a CoordinateSystemNode with those of the classes that it is made of, and returns its system at the
    /// end: empty with an ellipsoid, on which the positions lie then.
    pub(super) fn coordinate_system_members(&mut self) -> Result<(NodeMembers, Vec<Object>, String)> {
        let (node, children) = self.group_members()?;
        self.string_member("Format")?;
        let system = self.string_member("CoordinateSystem")?;
        let is_geocentric = matches!(self.object_member("EllipsoidModel")?, Object::Ellipsoid(_));
        Ok((node, children, if is_geocentric { String::new() } else { system }))
    }

    pub(super) fn state_member(&mut self, name: &str) -> Result<Option<Arc<StateObject>>> {
        Ok(match self.object_member(name)? {
            Object::State(state) => Some(state),
            _ => None,
        })
    }

    /// Reads the reference frame of a transform. Returns true if it is not relative to the nodes above.
    pub(super) fn reference_frame(&mut self) -> Result<bool> {
        const FRAMES: Names = &[("RELATIVE_RF", 0), ("ABSOLUTE_RF", 1), ("ABSOLUTE_RF_INHERIT_VIEWPOINT", 2)];
        Ok(self.named_member("ReferenceFrame", FRAMES, 0)? != 0)
    }

    pub(super) fn matrix_transform(&mut self) -> Result<Object> {
        let (node, children) = self.group_members()?;
        let is_absolute = self.reference_frame()?;
        let matrix = if self.member("Matrix")? { self.matrix()? } else { DMat4::IDENTITY };
        let is_affine = matrix.is_finite() && matrix.row(3) == DVec4::W;
        if !is_affine {
            self.notes.add("OpenSceneGraph: a matrix that is not affine".to_owned());
        }
        Ok(node.transform(is_affine.then(|| DAffine3::from_mat4(matrix)), is_absolute, children))
    }

    /// Reads a matrix. OSG multiplies rows, so that its rows are the columns of ours.
    pub(super) fn matrix(&mut self) -> Result<DMat4> {
        self.name_of_matrix()?;
        self.block(|reader| reader.doubles().map(|rows| DMat4::from_cols_array(&rows)))
    }

    /// Reads the type of a matrix, which old text files name.
    pub(super) fn name_of_matrix(&mut self) -> Result<()> {
        if self.input.is_text() && !self.input.matches("Matrixd")? {
            self.input.matches("Matrixf")?;
        }
        Ok(())
    }

    fn position_attitude_transform(&mut self) -> Result<Object> {
        let (node, children) = self.group_members()?;
        let is_absolute = self.reference_frame()?;
        let position = self.point_member("Position", DVec3::ZERO)?;
        let rotation = self.rotation_member("Attitude")?;
        // Text leaves out a scale of zero, which OSG's own default is not.
        let scale = self.point_member("Scale", DVec3::ONE)?;
        let pivot = self.point_member("PivotPoint", DVec3::ZERO)?;
        let map =
            DAffine3::from_scale_rotation_translation(scale, rotation, position) * DAffine3::from_translation(-pivot);
        Ok(node.transform(Some(map), is_absolute, children))
    }

    fn switch(&mut self) -> Result<Object> {
        let (node, children) = self.group_members()?;
        let default = self.boolean_member("NewChildDefaultValue", true)?;
        let mut shown = self.vector_member("ValueList", |reader| reader.input.boolean())?;
        shown.resize(children.len(), default);
        Ok(node.with(NodeClass::Switch(shown), children))
    }

    /// Reads a number of a type as an integer.
    pub(super) fn integer(&mut self, number: Number) -> Result<i64> {
        Ok(self.input.number(number)? as i64)
    }
}
