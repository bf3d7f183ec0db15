//! The members of LOD, PagedLOD and ProxyNode.

use glam::DVec3;

use super::Reader;
use crate::formats::osg::error::Result;
use crate::formats::osg::input::Names;
use crate::formats::osg::objects::{CenterMode, LodObject, NodeClass, Object, PagedObject, ProxyMode, ProxyObject};

impl Reader<'_> {
    pub(super) fn lod(&mut self) -> Result<Object> {
        let (node, children) = self.group_members()?;
        let lod = self.lod_members()?;
        Ok(node.with(NodeClass::Lod(lod), children))
    }

    /// Reads the members of the class LOD alone.
    fn lod_members(&mut self) -> Result<LodObject> {
        const RANGE_MODES: Names = &[("DISTANCE_FROM_EYE_POINT", 0), ("PIXEL_SIZE_ON_SCREEN", 1)];
        let (center_mode, user_center) = self.center()?;
        let is_by_pixel_size = self.named_member("RangeMode", RANGE_MODES, 0)? == 1;
        let ranges = match self.marked_member("RangeList")? {
            true => self.list(|reader| reader.floats::<2>().map(|range| range.map(f64::from)))?,
            false => Vec::new(),
        };
        Ok(LodObject { center_mode, user_center, is_by_pixel_size, ranges })
    }

    /// Reads the centre mode, and centre and radius.
    fn center(&mut self) -> Result<(CenterMode, Option<(DVec3, f64)>)> {
        const MODES: Names = &[
            ("USE_BOUNDING_SPHERE_CENTER", 0),
            ("USER_DEFINED_CENTER", 1),
            ("UNION_OF_BOUNDING_SPHERE_AND_USER_DEFINED", 2),
        ];
        let mode = match self.named_member("CenterMode", MODES, 0)? {
            1 => CenterMode::UserDefined,
            2 => CenterMode::Union,
            _ => CenterMode::BoundingSphere,
        };
        let mut user_center = None;
        if self.marked_member("UserCenter")? {
            let (center, radius) = (DVec3::from_array(self.doubles()?), self.double()?);
            user_center = Some((center, radius)).filter(|_| center.is_finite() && radius.is_finite());
        }
        Ok((mode, user_center))
    }

    pub(super) fn paged_lod(&mut self) -> Result<Object> {
        // A PagedLOD is no Group in the file, so that the children that are loaded are not written.
        let node = self.node_members()?;
        let lod = self.lod_members()?;
        let mut paged = PagedObject::default();
        if self.marked_member("DatabasePath")? && self.input.boolean()? {
            paged.database_path = self.input.quoted()?;
        }
        if self.version < 70 {
            self.unsigned_member("FrameNumberOfLastTraversal", 0)?;
        }
        paged.children_that_cannot_expire = self.unsigned_member("NumChildrenThatCannotBeExpired", 0)?;
        self.boolean_member("DisableExternalChildrenPaging", false)?;
        if self.marked_member("RangeDataList")? {
            paged.files = self.list(|reader| reader.input.quoted())?;
            self.input.keyword("PriorityList")?;
            paged.priorities = self.list(|reader| reader.floats())?;
        }
        let children = self.children_in_file()?;
        Ok(node.with(NodeClass::PagedLod(lod, paged), children))
    }

    /// Reads the children of a PagedLOD or ProxyNode that are in the file itself.
    fn children_in_file(&mut self) -> Result<Vec<Object>> {
        if self.marked_member("Children")? { self.list_unless_empty(Self::object) } else { Ok(Vec::new()) }
    }

    pub(super) fn proxy_node(&mut self) -> Result<Object> {
        const LOADING: Names =
            &[("LOAD_IMMEDIATELY", 0), ("DEFER_LOADING_TO_DATABASE_PAGER", 1), ("NO_AUTOMATIC_LOADING", 2)];
        let node = self.node_members()?;
        let mut proxy = ProxyObject::default();
        if self.marked_member("FileNames")? {
            proxy.files = self.list(|reader| reader.input.quoted())?;
        }
        let children = self.children_in_file()?;
        proxy.database_path = self.string_member("DatabasePath")?;
        proxy.loading = match self.named_member("LoadingExternalReferenceMode", LOADING, 0)? {
            1 => ProxyMode::DeferToPager,
            2 => ProxyMode::Never,
            _ => ProxyMode::Immediately,
        };
        (proxy.center_mode, proxy.user_center) = self.center()?;
        Ok(node.with(NodeClass::Proxy(proxy), children))
    }
}
