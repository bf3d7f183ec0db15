//! LOD, PagedLOD and ProxyNode.

use glam::DVec3;

use super::{Reader, ids};
use crate::formats::osg::error::Result;
use crate::formats::osg::objects::{CenterMode, LodObject, NodeClass, Object, PagedObject, ProxyMode, ProxyObject};

/// The radius of nodes that take the one of their bounding sphere.
const NO_RADIUS: f32 = -1.0;

impl Reader<'_> {
    pub(super) fn lod(&mut self) -> Result<Object> {
        self.expect(ids::LOD)?;
        let (node, children) = self.group_members()?;
        let has_radius = self.version > 2;
        let radius = if has_radius { self.float()? } else { NO_RADIUS };
        let lod = self.lod_members(radius, has_radius)?;
        Ok(node.with(NodeClass::Lod(lod), children))
    }

    /// Reads an Impostor as the LOD that it is when it is near.
    pub(super) fn impostor(&mut self) -> Result<Object> {
        self.expect(ids::IMPOSTOR)?;
        let lod = self.lod()?;
        // The distance from which an image replaces the children.
        self.float()?;
        Ok(lod)
    }

    /// Reads the centre mode, the centre, the range mode and the ranges.
    fn lod_members(&mut self, radius: f32, has_range_mode: bool) -> Result<LodObject> {
        let (center_mode, user_center) = self.center(radius)?;
        let is_by_pixel_size = has_range_mode && self.integer()? == 1;
        let ranges = self.list(8, |reader| reader.floats::<2>().map(|range| range.map(f64::from)))?;
        Ok(LodObject { center_mode, user_center, is_by_pixel_size, ranges })
    }

    /// Reads the centre mode and the centre, which a bounding sphere replaces in one of the modes.
    fn center(&mut self, radius: f32) -> Result<(CenterMode, Option<(DVec3, f64)>)> {
        let mode = match self.integer()? {
            1 => CenterMode::UserDefined,
            2 => CenterMode::Union,
            _ => CenterMode::BoundingSphere,
        };
        let (center, radius) = (self.point()?, f64::from(radius));
        let is_used = mode != CenterMode::BoundingSphere && center.is_finite() && radius.is_finite();
        Ok((mode, is_used.then_some((center, radius))))
    }

    pub(super) fn paged_lod(&mut self) -> Result<Object> {
        self.expect(ids::PAGED_LOD)?;
        // A PagedLOD is no Group in the file, so that the children that are loaded are not written.
        let node = self.node_members()?;
        let database_path = if self.version >= 6 { self.string()? } else { String::new() };
        let radius = self.float()?;
        let children_that_cannot_expire = self.unsigned()?;
        if self.version >= 41 {
            // Whether the external children are paged.
            self.boolean()?;
        }
        let children = self.list(4, Self::node)?;
        let lod = self.lod_members(radius, true)?;
        let files = self.list(4, Self::string)?;
        let mut priorities = Vec::new();
        if self.version >= 15 {
            let (offsets, scales) = (self.list(4, Self::float)?, self.list(4, Self::float)?);
            priorities = (0..offsets.len().max(scales.len()))
                .map(|child| [offsets.get(child).copied().unwrap_or(0.0), scales.get(child).copied().unwrap_or(1.0)])
                .collect();
        }
        let paged = PagedObject { database_path, files, priorities, children_that_cannot_expire };
        Ok(node.with(NodeClass::PagedLod(lod, paged), children))
    }

    pub(super) fn proxy_node(&mut self) -> Result<Object> {
        self.expect(ids::PROXY_NODE)?;
        let node = self.node_members()?;
        let radius = self.float()?;
        let (center_mode, user_center) = self.center(radius)?;
        let mut loading = ProxyMode::Immediately;
        if self.version >= 45 {
            loading = match self.integer()? {
                1 => ProxyMode::DeferToPager,
                2 => ProxyMode::Never,
                _ => ProxyMode::Immediately,
            };
        }
        let mut files = self.list(4, Self::string)?;
        let children = self.list(4, Self::node)?;
        // Children beyond those without a name are the first files, which were written into this one.
        if children.len() > files.iter().filter(|name| name.is_empty()).count() {
            files.drain(..children.len().min(files.len()));
        }
        let database_path = String::new();
        let proxy = ProxyObject { files, database_path, loading, center_mode, user_center };
        Ok(node.with(NodeClass::Proxy(proxy), children))
    }
}
