//! Placement: gives drawables their slots in the pools, and queues the uploads to them. Draw thread.

use std::collections::VecDeque;
use std::sync::Arc;

use super::compile_operation::Compiled;
use super::resource_upload::{BufferSource, ImageSource, Upload};
use crate::gpu::pools::{CompileInfo, CustomCompile, DrawableEntry, MeshAllocation, Pools, Shape, VertexFormat};
use crate::scene::{CustomGeometry, DrawSlot, Drawable, Geometry, HeightTile, Mesh, SharedParts};

/// Gives a drawable its slots and queues its uploads. A custom drawable is created at once; its size in bytes is returned.
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
        Geometry::Custom(custom) => compile_custom(info, pools, custom, compiled),
    };
    let is_custom = matches!(drawable.geometry, Geometry::Custom(_));
    let slot = match placed {
        Ok(shape) => pools.insert(DrawableEntry::new(shape, &drawable.material)),
        Err(error) => {
            compiled.errors.push(error);
            DrawSlot::NONE
        }
    };
    compiled.slots.push(slot);
    is_custom.then(|| compiled.bytes - bytes_before)
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
    let image = drawable.material.texture.as_ref();
    let [geometry, indices, texture_content] =
        [&drawable.shared.geometry, &drawable.shared.indices, &drawable.shared.texture]
            .map(|s| s.as_ref().map(|s| &s.key));
    let allocation = pools.allocate_mesh(mesh, &drawable.shared, drawable.vertex_format())?;
    let texture = match image {
        Some(image) => pools.allocate_texture(image, texture_content).map(|texture| (texture.slot, texture.is_new)),
        None => pools.white_texture(queue).map(|white| (white, false)),
    };
    let (texture, is_new_texture) = match texture {
        Ok(texture) => texture,
        Err(error) => {
            pools.release_mesh(&allocation.slot);
            return Err(error);
        }
    };
    compiled.count(geometry, allocation.vertex_bytes, allocation.has_new_vertices);
    compiled.count(indices, allocation.index_bytes, allocation.has_new_indices);
    if image.is_some() {
        compiled.count(texture_content, pools.textures().layer_bytes(texture), is_new_texture);
    }
    queue_mesh(pools, &allocation, mesh, uploads);
    if let Some(image) = image.filter(|_| is_new_texture)
        && let Some(destination) = pools.textures().destination(texture)
    {
        uploads.push_back(Upload::to_layer(ImageSource::Image(image.clone()), destination));
    }
    Ok(Shape::of_mesh(mesh, allocation.slot, texture))
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

/// Replaces the mesh of a drawable and writes its data by the queue at once. Returns true if the drawable now shares
/// vertices or indices with another, whose uploads may be in progress.
pub(in crate::gpu) fn rewrite_mesh(
    queue: &wgpu::Queue,
    pools: &mut Pools,
    slot: DrawSlot,
    mesh: &Arc<Mesh>,
) -> Result<bool, String> {
    let entry = *pools.drawable(slot).ok_or("the drawable of the mesh is not resident")?;
    let Shape::Mesh { slot: old, texture, .. } = entry.shape else {
        return Err("the drawable is a height tile or a custom drawable, not a mesh".into());
    };
    let allocation = pools.allocate_mesh(mesh, &SharedParts::default(), VertexFormat::Full)?;
    let (mut uploads, mut scratch) = (VecDeque::new(), Vec::new());
    queue_mesh(pools, &allocation, mesh, &mut uploads);
    uploads.into_iter().for_each(|upload| upload.write_all(queue, &mut scratch));
    let shape = Shape::of_mesh(mesh, allocation.slot, texture);
    pools.replace(slot, DrawableEntry { shape, ..entry });
    // The old slot is free at once: later uploads run after the draws already submitted.
    pools.release_mesh(&old);
    Ok(!(allocation.has_new_vertices && allocation.has_new_indices))
}
