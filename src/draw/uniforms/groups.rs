//! The frame's uniforms in one buffer, and group 2 of the pipelines: uniforms and textures of states. Draw thread.

use std::collections::HashMap;
use std::sync::Arc;

use super::fixed::{FixedUniform, taken_by};
use crate::draw::pipelines::Pipelines;
use crate::draw::pipelines::key::Shading;
use crate::gpu::{GraphicsContext, StateTextures, White, view_dimension};
use crate::scene::Texture;
use crate::state::{ResolvedState, Sampler, TEXTURE_UNITS, TextureBinding, TextureDimension, TextureObject};

/// Of the fixed function without textures.
const BARE: u16 = u16::MAX;

/// Which bind group a state needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct GroupKey {
    /// 0 is the fixed function with textures, [`BARE`] without; others are a program's place plus 1.
    shading: u16,
    /// Serial number of the texture and place of the sampler; 0, 0 without.
    units: [(u32, u32); TEXTURE_UNITS],
}

struct Group {
    key: GroupKey,
    /// Made in [`Groups::finish`].
    bind_group: Option<wgpu::BindGroup>,
    is_pending: bool,
}

/// Uniforms and bind groups of a renderer.
pub(in crate::draw) struct Groups {
    pub(in crate::draw) textures: StateTextures,
    white: White,
    white_sampler: u32,
    /// Made for the first frame.
    buffer: Option<wgpu::Buffer>,
    pub(in crate::draw) bytes: Vec<u8>,
    align: usize,
    groups: Vec<Group>,
    /// Only looked up.
    group_of: HashMap<GroupKey, u32>,
    /// Groups of this frame that have to be made, with a state that says how.
    pending: Vec<(u32, Arc<ResolvedState>)>,
}

/// Bytes of uniforms that there is room for at first.
const LEAST_BYTES: u64 = 64 << 10;

fn buffer(device: &wgpu::Device, size: u64) -> wgpu::Buffer {
    device.create_buffer(&wgpu::BufferDescriptor {
        label: Some("uniforms"),
        size,
        usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
        mapped_at_creation: false,
    })
}

impl Groups {
    pub(in crate::draw) fn new(ctx: &GraphicsContext) -> Self {
        let device = ctx.device();
        let mut textures = StateTextures::new(device);
        let white_sampler = textures.ensure_sampler(device, &Sampler::default());
        Self {
            textures,
            white: White::new(device, ctx.queue()),
            white_sampler,
            buffer: None,
            bytes: Vec::new(),
            align: device.limits().min_uniform_buffer_offset_alignment.max(16) as usize,
            groups: Vec::new(),
            group_of: HashMap::new(),
            pending: Vec::new(),
        }
    }

    /// `programs_left` is whether places of programs will be others' from now on.
    pub(in crate::draw) fn start_frame(&mut self, programs_left: bool) {
        self.bytes.clear();
        for (group, _) in self.pending.drain(..) {
            self.groups[group as usize].is_pending = false;
        }
        if self.textures.prune() | programs_left {
            self.forget_groups();
        }
    }

    /// Writes an image to a texture.
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

    fn forget_groups(&mut self) {
        self.groups.clear();
        self.group_of.clear();
    }

    /// Appends a uniform and returns where.
    pub(in crate::draw) fn push<T: bytemuck::Pod>(&mut self, uniform: &T) -> u32 {
        let at = self.reserve(size_of::<T>());
        self.bytes[at as usize..][..size_of::<T>()].copy_from_slice(bytemuck::bytes_of(uniform));
        at
    }

    /// Room for a uniform, zeroed.
    pub(in crate::draw) fn reserve(&mut self, size: usize) -> u32 {
        let at = self.bytes.len().next_multiple_of(self.align);
        self.bytes.resize(at + size, 0);
        at as u32
    }

    /// The group that a state needs under a shading; what is wrong with its textures, which are then white.
    pub(in crate::draw) fn group(
        &mut self,
        ctx: &GraphicsContext,
        pipelines: &Pipelines,
        shading: Shading,
        state: &Arc<ResolvedState>,
        attached: impl Fn(&TextureBinding) -> bool,
        mut wrong: impl FnMut(String),
    ) -> u32 {
        let program = match shading {
            Shading::Program(place) => pipelines.programs.get(place),
            _ => None,
        };
        let mut units = [(0, 0); TEXTURE_UNITS];
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
            if attached(binding) {
                wrong(format!("texture {:?} is read while it is drawn into", texture.name));
                continue;
            }
            if let Some(first) = taken_by(state, unit).filter(|_| program.is_none()) {
                let (name, dimension) = (&texture.name, texture.dimension);
                wrong(format!(
                    "texture {name:?}: unit {first} has the one {dimension:?} there can be, unit {unit} is white"
                ));
                continue;
            }
            let Some(sampler) = sampler.filter(|_| fits) else {
                wrong(format!("texture {:?} ({:?}) does not fit unit {unit}", texture.name, texture.format));
                continue;
            };
            match self.textures.ensure(ctx.device(), ctx.queue(), texture) {
                Ok(Some(serial)) => {
                    *slot = (serial, self.textures.ensure_sampler(ctx.device(), &sampler) + 1);
                }
                Ok(None) => {}
                Err(problem) => wrong(problem),
            }
        }
        for u in program.iter().flat_map(|program| program.units.iter().flatten()) {
            self.textures.ensure_sampler(ctx.device(), &u.own_sampler());
        }
        let shading = match shading {
            Shading::Program(place) => place + 1,
            Shading::FixedTextured => 0,
            _ => BARE,
        };
        let key = GroupKey { shading, units };
        let next = self.groups.len() as u32;
        let group = *self.group_of.entry(key).or_insert(next);
        if group == next {
            self.groups.push(Group { key, bind_group: None, is_pending: false });
        }
        // Again each frame: all groups are made anew when the buffer grows.
        if !std::mem::replace(&mut self.groups[group as usize].is_pending, true) {
            self.pending.push((group, state.clone()));
        }
        group
    }

    /// Uploads the uniforms and makes the groups that are not there; true when the buffer is another one. Where there is
    /// no memory for it, nothing can be drawn.
    pub(in crate::draw) fn finish(&mut self, ctx: &GraphicsContext, pipelines: &Pipelines) -> Result<bool, String> {
        // Bindings are of fixed sizes: the last one must lie inside too.
        let needed = self.bytes.len().next_multiple_of(4);
        self.bytes.resize(needed, 0);
        let grows = self.buffer.as_ref().is_none_or(|buffer| buffer.size() < needed as u64);
        if grows {
            let size = (needed as u64).next_power_of_two().max(LEAST_BYTES);
            self.buffer = Some(ctx.memory().make("uniforms", size, |device| buffer(device, size))?);
            self.groups.iter_mut().for_each(|group| group.bind_group = None);
        }
        if let Some(buffer) = &self.buffer {
            ctx.queue().write_buffer(buffer, 0, &self.bytes);
        }
        let pending = std::mem::take(&mut self.pending);
        for (group, state) in &pending {
            self.groups[*group as usize].is_pending = false;
            if self.groups[*group as usize].bind_group.is_none() {
                let made = self.make(ctx, pipelines, &self.groups[*group as usize].key, state);
                self.groups[*group as usize].bind_group = made;
            }
        }
        self.pending = pending;
        self.pending.clear();
        Ok(grows)
    }

    fn make(
        &self,
        ctx: &GraphicsContext,
        pipelines: &Pipelines,
        key: &GroupKey,
        state: &ResolvedState,
    ) -> Option<wgpu::BindGroup> {
        let view = |unit: usize| {
            let (serial, sampler) = key.units[unit];
            let binding = state.texture(unit).filter(|_| serial != 0)?;
            Some((self.textures.view(&binding.texture)?, self.textures.sampler(sampler - 1)?, binding))
        };
        let white_sampler = self.textures.sampler(self.white_sampler)?;
        let mut entries = Vec::new();
        let fixed_bytes = size_of::<FixedUniform>();
        let (layout, uniform_bytes) = match key.shading.checked_sub(1) {
            _ if key.shading == BARE => (&pipelines.fixed_layout, fixed_bytes),
            None => {
                for unit in 0..TEXTURE_UNITS {
                    let is_plane =
                        |b: &TextureBinding| matches!(b.texture.dimension, TextureDimension::D1 | TextureDimension::D2);
                    let found = view(unit).filter(|(.., b)| is_plane(b));
                    let (view, sampler) = found.map_or((&self.white.plane, white_sampler), |(v, s, _)| (v, s));
                    push(&mut entries, unit, view, Some(sampler));
                }
                let others = [
                    (TextureDimension::Cube, &self.white.cube),
                    (TextureDimension::D3, &self.white.volume),
                    (TextureDimension::D2Array, &self.white.layers),
                ];
                for (place, (dimension, white)) in (TEXTURE_UNITS..).zip(others) {
                    let found = (0..TEXTURE_UNITS).filter_map(view).find(|(.., b)| b.texture.dimension == dimension);
                    let (view, sampler) = found.map_or((white, white_sampler), |(v, s, _)| (v, s));
                    push(&mut entries, place, view, Some(sampler));
                }
                (&pipelines.textured_layout, fixed_bytes)
            }
            Some(place) => {
                let program = pipelines.programs.get(place)?;
                for (unit, layout) in program.units.iter().enumerate() {
                    let Some(layout) = layout else { continue };
                    let white = self.white.of(layout.dimension, layout.is_depth);
                    let own_sampler = self.textures.known_sampler(&layout.own_sampler())?;
                    let (view, sampler) = view(unit).map_or((white, own_sampler), |(v, s, _)| (v, s));
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

    pub(in crate::draw) fn bind_group(&self, group: u32) -> Option<&wgpu::BindGroup> {
        self.groups.get(group as usize)?.bind_group.as_ref()
    }

    pub(in crate::draw) fn buffer(&self) -> Option<&wgpu::Buffer> {
        self.buffer.as_ref()
    }
}

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
