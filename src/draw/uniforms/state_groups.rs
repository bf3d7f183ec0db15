//! The buffer of a frame's uniforms, and bind group 2: the uniforms and textures of states. Draw thread.

use std::collections::HashMap;
use std::sync::Arc;

use super::fixed::{FixedUniform, taken_by};
use crate::draw::pipelines::Pipelines;
use crate::draw::pipelines::key::Shading;
use crate::gpu::{FallbackTextures, GraphicsContext, StateTextures, view_dimension};
use crate::scene::Texture;
use crate::state::{ResolvedState, Sampler, TEXTURE_UNITS, TextureBinding, TextureDimension, TextureObject};

/// The layout of a bind group.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum GroupLayout {
    /// The fixed function without texture units.
    Fixed,
    /// The fixed function with texture units.
    Textured,
    /// A program, by index.
    Program(u16),
}

/// A texture and its sampler in a unit.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct UnitKey {
    /// Serial number of the texture.
    texture: u32,
    /// Index of the sampler.
    sampler: u32,
}

/// The layout and contents of a bind group.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct GroupKey {
    layout: GroupLayout,
    /// `None` for units whose texture is white.
    units: [Option<UnitKey>; TEXTURE_UNITS],
}

struct Group {
    key: GroupKey,
    /// Created in [`StateGroups::finish`].
    bind_group: Option<wgpu::BindGroup>,
    /// True if it is in the list of groups to be created for this frame.
    is_pending: bool,
}

/// The uniforms and the bind groups 2 of a renderer.
pub(in crate::draw) struct StateGroups {
    pub(in crate::draw) textures: StateTextures,
    fallback_textures: FallbackTextures,
    fallback_sampler: u32,
    /// Created for the first frame.
    buffer: Option<wgpu::Buffer>,
    bytes: Vec<u8>,
    /// The alignment of offsets in bytes.
    align: usize,
    groups: Vec<Group>,
    /// Used for look-ups only, since its order is random.
    group_of: HashMap<GroupKey, u32>,
    /// Serial numbers of the textures that were freed last.
    freed: Vec<u32>,
    /// The groups that this frame needs, each with a state that has its textures.
    pending: Vec<(u32, Arc<ResolvedState>)>,
}

/// The result of [`StateGroups::finish`].
pub(in crate::draw) struct Finished {
    /// True if the buffer of uniforms was replaced.
    pub(in crate::draw) is_new_buffer: bool,
    /// The number of bind groups that were created.
    pub(in crate::draw) groups_created: u32,
}

/// The size of the first uniform buffer in bytes.
const MIN_BYTES: u64 = 64 << 10;

fn buffer(device: &wgpu::Device, size: u64) -> wgpu::Buffer {
    device.create_buffer(&wgpu::BufferDescriptor {
        label: Some("uniforms"),
        size,
        usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
        mapped_at_creation: false,
    })
}

impl StateGroups {
    pub(in crate::draw) fn new(ctx: &GraphicsContext) -> Self {
        let device = ctx.device();
        let mut textures = StateTextures::new(device);
        let fallback_sampler = textures.ensure_sampler(device, &Sampler::default());
        Self {
            textures,
            fallback_textures: FallbackTextures::new(device, ctx.queue()),
            fallback_sampler,
            buffer: None,
            bytes: Vec::new(),
            align: device.limits().min_uniform_buffer_offset_alignment.max(16) as usize,
            groups: Vec::new(),
            group_of: HashMap::new(),
            freed: Vec::new(),
            pending: Vec::new(),
        }
    }

    /// Starts a frame. `programs_freed` means that indices of programs may be reused.
    pub(in crate::draw) fn start_frame(&mut self, programs_freed: bool) {
        self.bytes.clear();
        for (group, _) in self.pending.drain(..) {
            self.groups[group as usize].is_pending = false;
        }
        let Self { textures, freed, groups, group_of, .. } = self;
        freed.clear();
        textures.prune(|serial| freed.push(serial));
        if programs_freed {
            self.forget_groups();
        } else if !freed.is_empty() {
            groups.retain(|group| !group.key.units.iter().flatten().any(|unit| freed.contains(&unit.texture)));
            group_of.clear();
            group_of.extend((0..).zip(groups).map(|(index, group)| (group.key, index)));
        }
    }

    /// Writes an image to a texture, which takes the image's size.
    pub(in crate::draw) fn show(
        &mut self,
        ctx: &GraphicsContext,
        texture: &Arc<TextureObject>,
        image: &Texture,
    ) -> Result<(), String> {
        if self.textures.show(ctx.device(), ctx.queue(), texture, image)? {
            self.forget_groups();
        }
        Ok(())
    }

    /// Gives a texture the size and format of an image that will be copied into it. Called before the frame's groups.
    pub(in crate::draw) fn ensure_copy(
        &mut self,
        ctx: &GraphicsContext,
        texture: &Arc<TextureObject>,
        size_px: [u32; 2],
        format: wgpu::TextureFormat,
    ) -> Result<(), String> {
        if self.textures.ensure_copy(ctx.device(), texture, size_px, format)? {
            self.forget_groups();
        }
        Ok(())
    }

    fn forget_groups(&mut self) {
        self.groups.clear();
        self.group_of.clear();
    }

    /// Appends a uniform and returns its byte offset.
    pub(in crate::draw) fn push<T: bytemuck::Pod>(&mut self, uniform: &T) -> u32 {
        let (offset, bytes) = self.reserve(size_of::<T>());
        bytes.copy_from_slice(bytemuck::bytes_of(uniform));
        offset
    }

    /// Appends a zeroed uniform of a size; returns its byte offset and its bytes.
    pub(in crate::draw) fn reserve(&mut self, size: usize) -> (u32, &mut [u8]) {
        let offset = self.bytes.len().next_multiple_of(self.align);
        self.bytes.resize(offset + size, 0);
        (offset as u32, &mut self.bytes[offset..])
    }

    /// Returns the index of the group that a state needs under a shading. Textures that do not fit are white and passed to
    /// `report`; `is_target` returns true for textures that the stage draws into.
    pub(in crate::draw) fn group(
        &mut self,
        ctx: &GraphicsContext,
        pipelines: &Pipelines,
        shading: Shading,
        state: &Arc<ResolvedState>,
        is_target: impl Fn(&TextureBinding) -> bool,
        mut report: impl FnMut(String),
    ) -> u32 {
        let program = match shading {
            Shading::Program(index) => pipelines.programs.get(index),
            _ => None,
        };
        let mut units = [None; TEXTURE_UNITS];
        for (unit, slot) in units.iter_mut().enumerate() {
            let Some(binding) = state.texture(unit) else { continue };
            let texture = &binding.texture;
            let layout = program.and_then(|program| program.units[unit]);
            let sampler = layout.map_or(Some(binding.sampler), |u| u.sampler(&binding.sampler));
            let fits = match (program, layout) {
                (Some(_), Some(u)) => {
                    u.dimension == view_dimension(texture.dimension)
                        && u.is_depth == texture.format.is_depth()
                        && (u.is_depth || self.textures.is_filterable(texture.format))
                }
                (Some(_), None) => true,
                (None, _) => self.textures.is_filterable(texture.format) && binding.sampler.compare.is_none(),
            };
            if is_target(binding) {
                report(format!("texture {:?} is read while it is drawn into", texture.name));
                continue;
            }
            if let Some(first) = taken_by(state, unit).filter(|_| program.is_none()) {
                let (name, dimension) = (&texture.name, texture.dimension);
                report(format!(
                    "texture {name:?}: unit {first} has the only {dimension:?} texture of a state, unit {unit} is white"
                ));
                continue;
            }
            let Some(sampler) = sampler.filter(|_| fits) else {
                report(format!("texture {:?} ({:?}) does not fit unit {unit}", texture.name, texture.format));
                continue;
            };
            if program.is_some() && self.textures.emulates_border(&sampler) {
                let name = &texture.name;
                report(format!(
                    "texture {name:?}: the adapter has no border of its colour; programs see clamped edges"
                ));
            }
            match self.textures.ensure(ctx.device(), ctx.queue(), texture) {
                Ok(Some(texture)) => {
                    let sampler = self.textures.ensure_sampler(ctx.device(), &sampler);
                    *slot = Some(UnitKey { texture, sampler });
                }
                Ok(None) => {}
                Err(problem) => report(problem),
            }
        }
        for u in program.iter().flat_map(|program| program.units.iter().flatten()) {
            self.textures.ensure_sampler(ctx.device(), &u.own_sampler());
        }
        let layout = match shading {
            Shading::Program(index) => GroupLayout::Program(index),
            Shading::FixedTextured => GroupLayout::Textured,
            _ => GroupLayout::Fixed,
        };
        let key = GroupKey { layout, units };
        let next = self.groups.len() as u32;
        let group = *self.group_of.entry(key).or_insert(next);
        if group == next {
            self.groups.push(Group { key, bind_group: None, is_pending: false });
        }
        // In each frame, since all groups are created again when the buffer grows.
        if !std::mem::replace(&mut self.groups[group as usize].is_pending, true) {
            self.pending.push((group, state.clone()));
        }
        group
    }

    /// Uploads the uniforms and creates missing groups. Returns an error if there is no memory for the buffer, so that nothing
    /// can be drawn.
    pub(in crate::draw) fn finish(&mut self, ctx: &GraphicsContext, pipelines: &Pipelines) -> Result<Finished, String> {
        // The size of a write must be a multiple of 4 bytes.
        let needed = self.bytes.len().next_multiple_of(4);
        self.bytes.resize(needed, 0);
        let is_new_buffer = self.buffer.as_ref().is_none_or(|buffer| buffer.size() < needed as u64);
        if is_new_buffer {
            let size = (needed as u64).next_power_of_two().max(MIN_BYTES);
            self.buffer = Some(ctx.memory().allocate("uniforms", size, |device| buffer(device, size))?);
            self.groups.iter_mut().for_each(|group| group.bind_group = None);
        }
        if let Some(buffer) = &self.buffer {
            ctx.queue().write_buffer(buffer, 0, &self.bytes);
        }
        let mut groups_created = 0;
        let pending = std::mem::take(&mut self.pending);
        for (group, state) in &pending {
            self.groups[*group as usize].is_pending = false;
            if self.groups[*group as usize].bind_group.is_none() {
                let created = self.create(ctx, pipelines, &self.groups[*group as usize].key, state);
                groups_created += u32::from(created.is_some());
                self.groups[*group as usize].bind_group = created;
            }
        }
        self.pending = pending;
        self.pending.clear();
        Ok(Finished { is_new_buffer, groups_created })
    }

    fn create(
        &self,
        ctx: &GraphicsContext,
        pipelines: &Pipelines,
        key: &GroupKey,
        state: &ResolvedState,
    ) -> Option<wgpu::BindGroup> {
        let view = |unit: usize| {
            let (key, binding) = (key.units[unit]?, state.texture(unit)?);
            Some((self.textures.view(&binding.texture)?, self.textures.sampler(key.sampler)?, binding))
        };
        let fallback_sampler = self.textures.sampler(self.fallback_sampler)?;
        let mut entries = Vec::new();
        let fixed_bytes = size_of::<FixedUniform>();
        let (layout, uniform_bytes) = match key.layout {
            GroupLayout::Fixed => (pipelines.fixed_layout(), fixed_bytes),
            GroupLayout::Textured => {
                for unit in 0..TEXTURE_UNITS {
                    let is_plane =
                        |b: &TextureBinding| matches!(b.texture.dimension, TextureDimension::D1 | TextureDimension::D2);
                    let found = view(unit).filter(|(.., b)| is_plane(b));
                    let (view, sampler) =
                        found.map_or((&self.fallback_textures.plane, fallback_sampler), |(v, s, _)| (v, s));
                    push(&mut entries, unit, view, Some(sampler));
                }
                let others = [
                    (TextureDimension::Cube, &self.fallback_textures.cube),
                    (TextureDimension::D3, &self.fallback_textures.volume),
                    (TextureDimension::D2Array, &self.fallback_textures.layers),
                ];
                for (binding, (dimension, fallback)) in (TEXTURE_UNITS..).zip(others) {
                    let found = (0..TEXTURE_UNITS).filter_map(view).find(|(.., b)| b.texture.dimension == dimension);
                    let (view, sampler) = found.map_or((fallback, fallback_sampler), |(v, s, _)| (v, s));
                    push(&mut entries, binding, view, Some(sampler));
                }
                (pipelines.textured_layout(), fixed_bytes)
            }
            GroupLayout::Program(index) => {
                let program = pipelines.programs.get(index)?;
                for (unit, layout) in program.units.iter().enumerate() {
                    let Some(layout) = layout else { continue };
                    let fallback = self.fallback_textures.of(layout.dimension, layout.is_depth);
                    let own_sampler = self.textures.existing_sampler(&layout.own_sampler())?;
                    let (view, sampler) = view(unit).map_or((fallback, own_sampler), |(v, s, _)| (v, s));
                    push(&mut entries, unit, view, layout.has_sampler().then_some(sampler));
                }
                (&program.layout, program.uniform_bytes)
            }
        };
        if uniform_bytes > 0 {
            let (buffer, size) = (self.buffer.as_ref()?, wgpu::BufferSize::new(uniform_bytes as u64));
            entries.push(wgpu::BindGroupEntry {
                binding: 0,
                resource: wgpu::BindingResource::Buffer(wgpu::BufferBinding { buffer, offset: 0, size }),
            });
        }
        Some(ctx.device().create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("state"),
            layout,
            entries: &entries,
        }))
    }

    /// Returns a group by the index that [`Self::group`] returned in this frame.
    pub(in crate::draw) fn bind_group(&self, group: u32) -> Option<&wgpu::BindGroup> {
        self.groups.get(group as usize)?.bind_group.as_ref()
    }

    /// Returns the uniform buffer; `None` before the first frame.
    pub(in crate::draw) fn buffer(&self) -> Option<&wgpu::Buffer> {
        self.buffer.as_ref()
    }
}

/// Adds the bindings of a texture unit: a texture and its sampler.
fn push<'a>(
    entries: &mut Vec<wgpu::BindGroupEntry<'a>>,
    unit: usize,
    view: &'a wgpu::TextureView,
    sampler: Option<&'a wgpu::Sampler>,
) {
    let binding = 1 + 2 * unit as u32;
    entries.push(wgpu::BindGroupEntry { binding, resource: wgpu::BindingResource::TextureView(view) });
    if let Some(sampler) = sampler {
        let resource = wgpu::BindingResource::Sampler(sampler);
        entries.push(wgpu::BindGroupEntry { binding: binding + 1, resource });
    }
}
