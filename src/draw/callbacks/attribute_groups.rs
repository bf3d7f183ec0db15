//! Bind groups 3 of programs: the application's own state attributes. Draw thread.

use std::any::Any;
use std::sync::{Arc, Weak};

use super::attributes::bind;
use crate::gpu::CompileInfo;
use crate::state::OpaqueDrawData;

struct Entry {
    /// Weak, so that the application decides when it is dropped; it also keeps the address from being reused.
    attribute: Weak<dyn Any + Send + Sync>,
    /// Index of the program.
    program: u16,
    /// `None` if it could not be created.
    group: Option<wgpu::BindGroup>,
}

/// The bind groups of the attributes in use, by attribute and program. There are few.
#[derive(Default)]
pub(in crate::draw) struct AttributeGroups(Vec<Entry>);

impl AttributeGroups {
    /// Starts a frame: drops the groups of attributes that were dropped, and all groups if indices of programs may be reused.
    pub(in crate::draw) fn start_frame(&mut self, programs_freed: bool) {
        self.0.retain(|entry| !programs_freed && entry.attribute.strong_count() > 0);
    }

    /// Returns the index of the group of an attribute for a program, and creates it at the first call. A group that cannot
    /// be created is an error then, and `None` later.
    pub(in crate::draw) fn ensure(
        &mut self,
        info: &CompileInfo<'_>,
        layout: &wgpu::BindGroupLayout,
        program: u16,
        hook: &OpaqueDrawData,
    ) -> Result<Option<u32>, String> {
        let is_same = |entry: &Entry| {
            entry.program == program && std::ptr::addr_eq(entry.attribute.as_ptr(), Arc::as_ptr(&hook.0))
        };
        if let Some(index) = self.0.iter().position(is_same) {
            return Ok(self.0[index].group.is_some().then_some(index as u32));
        }
        let (group, result) = match bind(hook, info, layout) {
            Ok(group) => (Some(group), Ok(Some(self.0.len() as u32))),
            Err(problem) => (None, Err(problem)),
        };
        self.0.push(Entry { attribute: Arc::downgrade(&hook.0), program, group });
        result
    }

    /// Returns a group by the index that [`Self::ensure`] returned in this frame.
    pub(in crate::draw) fn get(&self, index: u32) -> Option<&wgpu::BindGroup> {
        self.0.get(index as usize)?.group.as_ref()
    }
}
