//! Placement: gives drawables their slots in the pools, and queues the uploads to them. Draw thread.

use std::collections::VecDeque;
use std::sync::Arc;

use super::compile_operation::Compiled;
use super::resource_upload::{BufferSource, ImageSource, QueueSink, Upload};
use crate::gpu::pools::{
    CompileInfo, CustomCompile, DrawableEntry, MapLayers, MeshAllocation, Pools, Shape, SurfaceSlot, TexelEncoding,
    TextureLayer, VertexFormat,
};
use crate::scene::{
    ContentKey, CustomGeometry, DrawSlot, Drawable, Geometry, HeightTile, Mesh, MetallicRoughness, SharedParts, Splats,
    Texture, Topology,
};

/// Gives a drawable its slots and queues its uploads. Custom drawables are created at once; their size in bytes is returned.
pub(super) fn place_drawable(
    info: &CompileInfo<'_>,
    pools: &mut Pools,
    drawable: Drawable,
    compiled: &mut Compiled,
    uploads: &mut VecDeque<Upload>,
) -> Option<u64> {
    let bytes_before = compiled.bytes;
    let placed = match &drawable.geometry {
        Geometry::Height(tile) => place_height_tile(pools, tile, &drawable, compiled, uploads),
        Geometry::Mesh(mesh) => place_mesh(info.queue, pools, mesh, &drawable, compiled, uploads),
        Geometry::Splats(splats) => place_splats(pools, splats, compiled, uploads),
        Geometry::Custom(custom) => compile_custom(info, pools, custom, compiled),
    };
    let is_complete = matches!(drawable.geometry, Geometry::Custom(_));
    let slot = match placed {
        Ok(shape) => pools.insert(DrawableEntry::new(shape, &drawable.material)),
        Err(error) => {
            compiled.errors.push(error);
            DrawSlot::NONE
        }
    };
    compiled.slots.push(slot);
    is_complete.then(|| compiled.bytes - bytes_before)
}

fn place_splats(
    pools: &mut Pools,
    splats: &Arc<Splats>,
    compiled: &mut Compiled,
    uploads: &mut VecDeque<Upload>,
) -> Result<Shape, String> {
    let allocation = pools.allocate_splats(splats)?;
    compiled.bytes += allocation.bytes;
    uploads.push_back(Upload::to_buffer(BufferSource::Splats(splats.clone()), allocation.splats));
    if let Some(destination) = allocation.harmonics {
        uploads.push_back(Upload::to_buffer(BufferSource::SplatHarmonics(splats.clone()), destination));
    }
    Ok(Shape::of_splats(splats, allocation.number))
}

fn compile_custom(
    info: &CompileInfo<'_>,
    pools: &mut Pools,
    custom: &CustomGeometry,
    compiled: &mut Compiled,
) -> Result<Shape, String> {
    let compile = custom.hook.0.downcast_ref::<CustomCompile>();
    let compile = compile.ok_or("a custom geometry that was not made by `draw::custom_geometry`")?;
    let (index, bytes) = pools.customs_mut().compile(compile, info)?;
    compiled.bytes += bytes;
    Ok(Shape::Custom(index))
}

fn place_height_tile(
    pools: &mut Pools,
    tile: &Arc<HeightTile>,
    drawable: &Drawable,
    compiled: &mut Compiled,
    uploads: &mut VecDeque<Upload>,
) -> Result<Shape, String> {
    let content = drawable.shared.geometry.as_ref().map(|s| &s.key);
    let allocation = pools.allocate_height_tile(tile, content)?;
    let slot = allocation.slot;
    compiled.count(content, pools.heights().slot_bytes(slot), allocation.is_new);
    if allocation.is_new
        && let Some(destinations) = pools.heights().destinations(slot)
    {
        let color = tile.texture.clone().map_or(ImageSource::White, ImageSource::Image);
        uploads.push_back(Upload::to_buffer(BufferSource::HeightTable(tile.clone()), destinations.table));
        uploads.push_back(Upload::to_layer(ImageSource::Heights(tile.clone()), destinations.heights));
        uploads.push_back(Upload::to_layer(color, destinations.color));
    }
    Ok(Shape::Height(slot))
}

fn place_mesh(
    queue: &wgpu::Queue,
    pools: &mut Pools,
    mesh: &Arc<Mesh>,
    drawable: &Drawable,
    compiled: &mut Compiled,
    uploads: &mut VecDeque<Upload>,
) -> Result<Shape, String> {
    let [geometry, indices] = [&drawable.shared.geometry, &drawable.shared.indices].map(|s| s.as_ref().map(|s| &s.key));
    let allocation = pools.allocate_mesh(mesh, &drawable.shared, drawable.vertex_format())?;
    let mut images = NewImages::default();
    let placed = place_color(queue, pools, drawable, &mut images).and_then(|color| {
        let surface = drawable.material.surface().filter(|_| mesh.topology == Topology::Triangles);
        let surface = surface.map(|surface| place_surface(queue, pools, surface, drawable, color, &mut images));
        Ok((color, surface.transpose()?))
    });
    let (color, surface) = match placed {
        Ok(placed) => placed,
        Err(error) => {
            images.release(pools);
            pools.release_mesh(&allocation.slot);
            return Err(error);
        }
    };
    compiled.count(geometry, allocation.vertex_bytes, allocation.has_new_vertices);
    compiled.count(indices, allocation.index_bytes, allocation.has_new_indices);
    if let Some(surface) = surface {
        compiled.count(None, surface.size_bytes(), true);
    }
    queue_mesh(pools, &allocation, mesh, uploads);
    images.queue(pools, compiled, uploads);
    Ok(Shape::of_mesh(mesh, allocation.slot, color, surface))
}

/// The images of a drawable, while it is placed.
#[derive(Default)]
struct NewImages<'a> {
    images: Vec<NewImage<'a>>,
}

/// An image whose layer is allocated.
struct NewImage<'a> {
    image: &'a Arc<Texture>,
    content: Option<&'a ContentKey>,
    layer: TextureLayer,
    /// True if the image must be uploaded.
    is_new: bool,
}

impl<'a> NewImages<'a> {
    /// Allocates the layer of an image.
    fn place(
        &mut self,
        pools: &mut Pools,
        image: &'a Arc<Texture>,
        encoding: TexelEncoding,
        content: Option<&'a ContentKey>,
    ) -> Result<TextureLayer, String> {
        let allocation = pools.allocate_texture(image, encoding, content)?;
        self.images.push(NewImage { image, content, layer: allocation.slot, is_new: allocation.is_new });
        Ok(allocation.slot)
    }

    /// Counts the images and queues the uploads of new ones.
    fn queue(self, pools: &Pools, compiled: &mut Compiled, uploads: &mut VecDeque<Upload>) {
        for NewImage { image, content, layer, is_new } in self.images {
            compiled.count(content, pools.textures().layer_bytes(layer), is_new);
            if is_new && let Some(destination) = pools.textures().destination(layer) {
                uploads.push_back(Upload::to_layer(ImageSource::Image(image.clone()), destination));
            }
        }
    }

    /// Releases the layers after another part of the drawable could not be placed.
    fn release(self, pools: &mut Pools) {
        self.images.into_iter().for_each(|image| pools.release_texture(image.layer));
    }
}

fn place_color<'a>(
    queue: &wgpu::Queue,
    pools: &mut Pools,
    drawable: &'a Drawable,
    images: &mut NewImages<'a>,
) -> Result<TextureLayer, String> {
    match &drawable.material.texture {
        Some(image) => {
            let content = drawable.shared.texture.as_ref().map(|s| &s.key);
            images.place(pools, image, TexelEncoding::Srgb, content)
        }
        None => pools.white_texture(queue),
    }
}

fn place_surface<'a>(
    queue: &wgpu::Queue,
    pools: &mut Pools,
    surface: &'a MetallicRoughness,
    drawable: &'a Drawable,
    color: TextureLayer,
    images: &mut NewImages<'a>,
) -> Result<SurfaceSlot, String> {
    let mut layers = MapLayers::default();
    let (srgb, linear) = (TexelEncoding::Srgb, TexelEncoding::Linear);
    let encodings = [linear, linear, srgb, linear, srgb, srgb, linear, linear];
    let count = if surface.is_layered() { MetallicRoughness::MAPS } else { MetallicRoughness::PLAIN_MAPS };
    let maps = surface.maps().into_iter().take(count).zip(encodings).zip(&drawable.shared.maps);
    for (layer, ((image, encoding), shared)) in layers.iter_mut().zip(maps) {
        let content = shared.as_ref().map(|s| &s.key);
        *layer = image.map(|image| images.place(pools, image, encoding, content)).transpose()?;
    }
    pools.allocate_surface(queue, surface, color, &layers)
}

/// Queues the uploads of a mesh's new parts.
fn queue_mesh(pools: &Pools, allocation: &MeshAllocation, mesh: &Arc<Mesh>, uploads: &mut VecDeque<Upload>) {
    let (meshes, slot) = (pools.meshes(), &allocation.slot);
    if allocation.has_new_vertices
        && let Some(destination) = meshes.vertex_destination(slot)
    {
        let format = meshes.format_of(slot.vertex_chunk);
        uploads.push_back(Upload::to_buffer(BufferSource::Vertices(mesh.clone(), format), destination));
    }
    if allocation.has_new_indices
        && let Some(destination) = meshes.index_destination(slot)
    {
        let source = match meshes.has_short_indices(slot.index_chunk) {
            true => BufferSource::ShortIndices(mesh.clone()),
            false => BufferSource::Indices(mesh.clone()),
        };
        uploads.push_back(Upload::to_buffer(source, destination));
    }
}

/// Replaces the mesh of a drawable and writes its data by the queue at once. No copy of meshes may be pending. Returns true if
/// the drawable now shares vertices or indices with another, whose uploads may be in progress.
pub(in crate::gpu) fn rewrite_mesh(
    (device, queue): (&wgpu::Device, &wgpu::Queue),
    pools: &mut Pools,
    slot: DrawSlot,
    mesh: &Arc<Mesh>,
) -> Result<bool, String> {
    let entry = *pools.drawable(slot).ok_or("the drawable of the mesh is not resident")?;
    let Shape::Mesh { slot: old, texture, surface, .. } = entry.shape else {
        return Err("the drawable is a height tile or a custom drawable, not a mesh".into());
    };
    let allocation = pools.allocate_mesh(mesh, &SharedParts::default(), VertexFormat::Full)?;
    let mut uploads: VecDeque<_> = pools.take_copies().map(Upload::copy).collect();
    queue_mesh(pools, &allocation, mesh, &mut uploads);
    let (mut sink, mut scratch) = (QueueSink { device, queue }, Vec::new());
    uploads.into_iter().for_each(|upload| upload.write_all(&mut sink, &mut scratch));
    pools.meshes_copied();
    let shape = Shape::of_mesh(mesh, allocation.slot, texture, surface);
    pools.replace(slot, DrawableEntry { shape, ..entry });
    // The old slot is free at once: later uploads run after the draws already submitted.
    pools.release_mesh(&old);
    Ok(!(allocation.has_new_vertices && allocation.has_new_indices))
}
