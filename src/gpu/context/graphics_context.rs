//! [`GraphicsContext`]: a device with its render targets, its pools and its uploads; OpenSceneGraph's graphics context.
//!
//! Opened when the viewer is realized, then owned by the draw thread. No other thread calls its queue.

use std::path::Path;
use std::sync::Arc;

use super::device_status::DeviceStatus;
use super::host_device::HostDevice;
use super::open_device::{OpenDevice, create_instance};
use super::pipeline_cache::PipelineCache;
use super::read_back::read_back;
use super::render_target::{Acquired, RenderTarget, drawn_format};
use super::targets::{ContextTarget, SurfaceFactory, TargetRequest, Targets, surface_factory};
use super::traits::ContextTraits;
use crate::gpu::GpuError;
use crate::gpu::memory::Memory;
use crate::gpu::pools::{
    BindClass, BindGroupLayouts, DrawableEntry, Pools, RetireQueue, StateTextureBytes, TargetFormats,
};
use crate::gpu::upload::{CompileBudget, CompileOperation, CompileStats, Compiled, UploadQueue, rewrite_mesh};
use crate::scene::{AttributeLayout, BlockFormats, DrawSlot, Mesh};
use crate::state::TextureObject;
use crate::sync::OperationQueue;

/// A device with its queue, its targets and everything uploaded to it. `Send`: opened on one thread, then moved to the draw
/// thread, which alone uses it.
///
/// Contexts of a viewer that share a device are targets of one `GraphicsContext`. Its thread draws them one after the other,
/// and uploads are resident for all of them.
pub struct GraphicsContext {
    /// Dropped first: its thread ends then, and records no commands on a device without a queue.
    uploads: UploadQueue,
    gpu: OpenDevice,
    status: DeviceStatus,
    targets: Targets,
    pools: Pools,
    retired: RetireQueue,
    /// Allocates targets, staging buffers and the buffers of frames.
    memory: Memory,
    bytes_peak: u64,
    /// The sizes of the textures of state sets.
    texture_bytes: StateTextureBytes,
    /// Written to disk when it is dropped.
    pipeline_cache: Option<PipelineCache>,
    /// The application's operations on the compile thread. They outlast a lost device.
    compile_operations: Arc<OperationQueue<wgpu::Device>>,
}

/// Opening, loss and the pipeline cache.
impl GraphicsContext {
    /// Opens a context that draws into its own textures.
    pub fn new_offscreen(traits: &ContextTraits) -> Result<Self, GpuError> {
        Self::open(vec![(*traits, None)])
    }

    /// Opens a context that draws into a window, such as an `Arc<winit::window::Window>`. The context keeps the window, and
    /// draws into it again after a device loss.
    pub fn new_window(
        target: impl Into<wgpu::SurfaceTarget<'static>> + Clone + Send + Sync + 'static,
        traits: &ContextTraits,
    ) -> Result<Self, GpuError> {
        Self::open(vec![(*traits, Some(surface_factory(target)))])
    }

    /// Creates a context on a device of the application, which draws into a texture that the application can sample;
    /// [`HostDevice`] says what that demands. Only size, samples and `compile_thread` of the traits are used. Fails with
    /// [`GpuError::NoDevice`] if the limits of the device are too small.
    pub fn new_on_device(host: HostDevice, traits: &ContextTraits) -> Result<Self, GpuError> {
        Self::on_device(OpenDevice::from_host(host)?, vec![(*traits, None)], vec![None])
    }

    /// Opens a device for some targets. The traits of the first one decide on the adapter.
    fn open(requests: Vec<TargetRequest>) -> Result<Self, GpuError> {
        let traits = requests.first().map_or_else(ContextTraits::default, |(traits, _)| *traits);
        let instance = create_instance(&traits, requests.iter().any(|(_, create)| create.is_some()));
        let surfaces = requests.iter().map(|(_, create)| create.as_ref().map(|create| create(&instance)).transpose());
        let surfaces = surfaces.collect::<Result<Vec<_>, _>>()?;
        let gpu = OpenDevice::request(instance, &traits, &surfaces)?;
        Self::on_device(gpu, requests, surfaces)
    }

    /// Opens targets on a device. `surfaces` has one entry per request.
    fn on_device(
        gpu: OpenDevice,
        requests: Vec<TargetRequest>,
        surfaces: Vec<Option<wgpu::Surface<'static>>>,
    ) -> Result<Self, GpuError> {
        let compile_thread = requests.first().is_some_and(|(traits, _)| traits.compile_thread);
        let is_software = gpu.adapter_info.device_type == wgpu::DeviceType::Cpu;
        let max_anisotropy = requests.first().and_then(|(traits, _)| traits.max_anisotropy);
        let max_anisotropy = max_anisotropy.unwrap_or(if is_software { 1 } else { 16 }).clamp(1, 16);
        let status = if gpu.is_host_device { DeviceStatus::default() } else { DeviceStatus::watch(&gpu.device) };
        let targets = requests.into_iter().zip(surfaces);
        let targets = targets.map(|(request, surface)| ContextTarget::open(&gpu, request, surface));
        let targets = Targets::new(targets.collect::<Result<_, _>>()?);
        let memory = Memory::new(&gpu.device);
        let mut pools = Pools::new(&gpu.device, max_anisotropy);
        targets.iter().for_each(|target| pools.customs_mut().add_target_formats(&target.formats()));
        let uploads = match compile_thread {
            true => {
                UploadQueue::with_compile_thread(&memory).map_err(|e| GpuError::Thread { reason: e.to_string() })?
            }
            false => UploadQueue::on_draw_thread(),
        };
        Ok(Self {
            uploads,
            gpu,
            status,
            targets,
            pools,
            retired: RetireQueue::default(),
            memory,
            bytes_peak: 0,
            texture_bytes: StateTextureBytes::default(),
            pipeline_cache: None,
            compile_operations: Arc::default(),
        })
    }

    /// Returns true if the device is lost. Nothing is drawn until [`Self::reopen`].
    pub fn is_lost(&self) -> bool {
        self.check_lost().is_err()
    }

    /// Replaces a lost device by a new one of the same traits. All uploads are gone, slots are invalid, and queued uploads are
    /// dropped. May be called again after an error. Fails for a device of the application.
    pub fn reopen(&mut self) -> Result<(), GpuError> {
        if self.gpu.is_host_device {
            let reason = "it is the application's; make a new one, and a new viewer on it".to_owned();
            return Err(GpuError::DeviceLost { reason });
        }
        let selected = self.targets.selected_index();
        let mut opened = Self::open(self.targets.close_all())?;
        opened.targets.select(selected);
        opened.bytes_peak = self.bytes_peak;
        opened.pools.take_budgets(&mut self.pools);
        opened.compile_operations = std::mem::take(&mut self.compile_operations);
        let cache_folder = self.pipeline_cache.take().map(|cache| cache.folder().to_owned());
        *self = opened;
        if let Some(folder) = cache_folder
            && let Err(error) = self.keep_pipelines(&folder)
        {
            log::warn!("{error}");
        }
        Ok(())
    }

    /// Keeps compiled pipelines in a folder, and uses those of earlier runs. Must be called before the first draw. There is one
    /// file per adapter, of at most 64 MiB, written when the context is dropped.
    ///
    /// Returns the number of bytes found. After an error with the file, pipelines are compiled and kept again; after
    /// [`GpuError::NoPipelineCache`] they are not kept.
    pub fn keep_pipelines(&mut self, folder: &Path) -> Result<u64, GpuError> {
        let (cache, found) = PipelineCache::open(&self.gpu.device, &self.gpu.adapter_info, folder)?;
        self.pipeline_cache = Some(cache);
        found
    }

    /// Writes the pipelines compiled so far to their file. Returns its size in bytes; 0 if pipelines are not kept.
    pub fn save_pipelines(&mut self) -> Result<u64, GpuError> {
        self.pipeline_cache.as_mut().map_or(Ok(0), PipelineCache::save)
    }

    /// Returns the cache for the creation of pipelines.
    pub(crate) fn pipeline_cache(&self) -> Option<&wgpu::PipelineCache> {
        self.pipeline_cache.as_ref().map(PipelineCache::cache)
    }

    /// Returns an error if the device is lost or its compile thread has stopped.
    pub(crate) fn check_lost(&self) -> Result<(), GpuError> {
        if !self.uploads.is_alive() {
            return Err(GpuError::DeviceLost { reason: "its compile thread has stopped".to_owned() });
        }
        self.status.check_lost()
    }

    /// Takes the device errors since the last call, such as lack of memory or a bug of the engine. They were logged too.
    pub fn take_device_errors(&mut self) -> Vec<String> {
        self.status.take_errors()
    }
}

/// The device.
impl GraphicsContext {
    /// Returns the name of the adapter and of the interface it is driven through.
    pub fn adapter_name(&self) -> String {
        self.gpu.adapter_name()
    }

    /// Returns true if the adapter is a software driver.
    pub(crate) fn is_software(&self) -> bool {
        self.gpu.adapter_info.device_type == wgpu::DeviceType::Cpu
    }

    /// Returns true if occlusion queries count samples. Only software drivers of Vulkan do: wgpu asks the others for queries that
    /// may answer 1 for any number, and with OpenGL, Direct3D and Metal a software driver too.
    pub(crate) fn counts_samples(&self) -> bool {
        counts_samples(self.gpu.adapter_info.device_type, self.gpu.adapter_info.backend)
    }

    /// Returns the families of compressed texture formats that the device samples; for
    /// [`ReadOptions::block_formats`](crate::formats::ReadOptions::block_formats).
    pub fn block_formats(&self) -> BlockFormats {
        self.memory.block_formats()
    }

    /// Returns true if the device is the application's; see [`Self::new_on_device`].
    pub fn is_host_device(&self) -> bool {
        self.gpu.is_host_device
    }

    /// Returns the device, for overlays that are drawn on top.
    pub fn device(&self) -> &wgpu::Device {
        &self.gpu.device
    }

    /// Returns the queue. Only the thread that owns the context may use it.
    pub fn queue(&self) -> &wgpu::Queue {
        &self.gpu.queue
    }

    /// Returns the allocator for everything but the pools.
    pub(crate) fn memory(&self) -> &Memory {
        &self.memory
    }
}

/// The targets.
impl GraphicsContext {
    /// Opens another offscreen target behind the existing ones. The adapter and the compile thread of the traits are ignored.
    pub(crate) fn add_offscreen_target(&mut self, traits: &ContextTraits) -> Result<(), GpuError> {
        self.add_target(traits, None)
    }

    /// Opens another target in a window, which the adapter must support. See [`Self::add_offscreen_target`].
    pub(crate) fn add_window_target(
        &mut self,
        window: impl Into<wgpu::SurfaceTarget<'static>> + Clone + Send + Sync + 'static,
        traits: &ContextTraits,
    ) -> Result<(), GpuError> {
        self.add_target(traits, Some(surface_factory(window)))
    }

    fn add_target(&mut self, traits: &ContextTraits, create_surface: Option<SurfaceFactory>) -> Result<(), GpuError> {
        self.check_lost()?;
        let surface = create_surface.as_ref().map(|create| create(&self.gpu.instance)).transpose()?;
        if surface.as_ref().is_some_and(|surface| !self.gpu.adapter.is_surface_supported(surface)) {
            let reason = format!("{}, whose device is to be shared, cannot show anything in it", self.adapter_name());
            return Err(GpuError::Surface { reason });
        }
        self.targets.push(ContextTarget::open(&self.gpu, (*traits, create_surface), surface)?);
        Ok(())
    }

    /// Closes a target unless it is the last one. Those after it move up, and the first one is selected.
    pub(crate) fn remove_target(&mut self, index: usize) {
        self.targets.remove(index);
    }

    /// Selects the target to draw into.
    pub(crate) fn select_target(&mut self, index: usize) {
        self.targets.select(index);
    }

    /// Returns the number of targets.
    pub(crate) fn target_count(&self) -> usize {
        self.targets.count()
    }

    /// Returns true while the first target is selected.
    pub(crate) fn is_first_target_selected(&self) -> bool {
        self.targets.selected_index() == 0
    }

    fn target(&self) -> &RenderTarget {
        self.targets.selected().target()
    }

    /// Returns true if the target that was added last is a window.
    pub(crate) fn has_window_last(&self) -> bool {
        self.targets.last().target().is_window()
    }

    /// Returns width and height of the target in pixels.
    pub fn size_px(&self) -> [u32; 2] {
        self.target().size_px()
    }

    /// Returns the screen of the target's window and its position there; see [`ContextTraits::screen`].
    pub(crate) fn place(&self) -> (u32, [i32; 2]) {
        self.targets.selected().place()
    }

    /// Returns the samples per pixel of the target: 1, 2, 4, 8 or 16.
    pub fn samples(&self) -> u32 {
        self.targets.selected().samples()
    }

    /// Returns the samples per pixel for attachments of some formats, for a wanted number.
    pub(crate) fn samples_of(&self, wanted: u32, formats: impl Iterator<Item = wgpu::TextureFormat> + Clone) -> u32 {
        self.gpu.samples(wanted, formats)
    }

    /// Returns the format of the target's colour.
    pub fn color_format(&self) -> wgpu::TextureFormat {
        self.target().format()
    }

    /// Returns the format that frames are drawn in: that of the target, unless their image is encoded by a pass afterwards.
    pub(crate) fn drawn_format(&self) -> wgpu::TextureFormat {
        drawn_format(self.color_format())
    }

    /// Changes the size of the target. A window's image that is not presented yet is dropped.
    pub fn resize(&mut self, size_px: [u32; 2]) -> Result<(), GpuError> {
        self.targets.selected_mut().target_mut().resize(&self.gpu.device, size_px)
    }

    /// Sets whether a window's images wait for the vertical blank.
    pub fn set_vsync(&mut self, vsync: bool) {
        self.targets.selected_mut().set_vsync(&self.gpu.device, vsync);
    }

    /// Gets the image that the next frame is drawn into. [`crate::draw::Renderer::draw`] calls it; a second call before
    /// [`Self::present`] does nothing. Blocks until the window has an image.
    pub fn acquire(&mut self) -> Result<Acquired, GpuError> {
        self.check_lost()?;
        self.targets.selected_mut().acquire(&self.gpu)
    }

    /// Returns the image that is drawn into, for overlays between draw and [`Self::present`]; `None` while a window has none.
    pub fn color_view(&self) -> Option<&wgpu::TextureView> {
        self.target().color_view()
    }

    /// Returns the texture of [`Self::color_view`].
    pub(crate) fn color_texture(&self) -> Option<&wgpu::Texture> {
        self.target().color_texture()
    }

    /// Presents the window's image. Does nothing offscreen.
    pub fn present(&mut self) {
        let _span = crate::trace::span("present");
        let Self { targets, gpu, .. } = self;
        targets.selected_mut().target_mut().present(&gpu.queue);
    }

    /// Reads the target's image back, top row first. Waits for the adapter.
    pub(crate) fn read_back(&mut self) -> Result<image::RgbaImage, GpuError> {
        self.check_lost()?;
        read_back(&self.gpu.device, &self.gpu.queue, self.target().color_texture())
    }
}

/// Uploads and releases.
impl GraphicsContext {
    /// Queues drawables to be uploaded by [`Self::run_compiles`].
    pub fn compile(&mut self, operation: CompileOperation) {
        self.uploads.push(operation);
    }

    /// Queues the upload of a texture of state sets, before the operations that are queued later.
    pub(crate) fn compile_texture(&mut self, object: Arc<TextureObject>, texture: wgpu::Texture) {
        self.uploads.push_texture(object, texture);
    }

    /// Takes the textures of state sets that are complete in the next frame.
    pub(crate) fn take_compiled_textures(&mut self) -> Vec<Arc<TextureObject>> {
        self.uploads.take_textures()
    }

    /// Notes the size of the textures of state sets, which the renderer owns.
    pub(crate) fn set_texture_bytes(&mut self, bytes: StateTextureBytes) {
        self.texture_bytes = bytes;
        self.note_peak();
    }

    /// Finishes operations that have not begun, without slots.
    pub fn cancel_compiles(&mut self, tickets: &[u64]) {
        self.uploads.cancel(tickets);
    }

    /// Uploads within a budget, at least one slice. Large uploads are split over several calls.
    pub fn run_compiles(&mut self, budget: &CompileBudget) -> CompileStats {
        let _span = crate::trace::span("compile");
        let Self { uploads, pools, retired, .. } = self;
        if uploads.pending() > 0 {
            retired.free_all(pools);
        }
        let cache = self.pipeline_cache.as_ref().map(PipelineCache::cache);
        let stats = uploads.run(&self.memory, &self.gpu.queue, pools, cache, budget);
        if let Some(error) = uploads.take_memory_error() {
            log::error!("uploads wait: {error}");
            self.status.add_error(error);
        }
        self.note_peak();
        if !self.compile_operations.is_empty() {
            self.uploads.run_operations(&self.compile_operations, &self.memory);
        }
        stats
    }

    /// Returns the application's operations on the device, which any thread may add. [`Self::run_compiles`] has them run once:
    /// on the compile thread, or at once if there is none.
    pub fn compile_operations(&self) -> &Arc<OperationQueue<wgpu::Device>> {
        &self.compile_operations
    }

    /// Returns true if the last upload failed for lack of memory. It is tried again.
    pub(crate) fn lacks_memory(&self) -> bool {
        self.uploads.lacks_memory()
    }

    /// Returns the number of operations that are waiting or in progress.
    pub fn pending_compiles(&self) -> usize {
        self.uploads.pending()
    }

    /// Takes the operations that finished since the last call, in the order of [`Self::compile`].
    pub fn take_compiled(&mut self) -> Vec<Compiled> {
        let of_pages = self.bytes_in_use() + self.texture_bytes.of_pages;
        let unused_bytes = self.bytes_allocated().saturating_sub(of_pages);
        let finished = self.uploads.take_finished().into_iter();
        finished.map(|compiled| Compiled { unused_bytes, ..compiled }).collect()
    }

    /// Sets the budget of one of the context's owners, such as a pager, in bytes. Blocks of the pools do not grow ahead of
    /// need beyond the sum of all budgets; a slot that is needed is allocated all the same. Until the first call there is no
    /// limit.
    pub fn set_max_bytes(&mut self, owner: u16, max_bytes: u64) {
        self.pools.set_max_bytes(owner, max_bytes);
    }

    /// Replaces the mesh of a drawable and uploads it at once. Draws from now on show the new mesh, draws already submitted
    /// the old one. Slot, material and texture stay.
    pub fn rewrite(&mut self, slot: DrawSlot, mesh: &Arc<Mesh>) -> Result<(), GpuError> {
        let Self { uploads, gpu, pools, status, .. } = self;
        // Recorded uploads to a slot that is taken over here must be executed first.
        uploads.flush_recorded(&gpu.device, &gpu.queue);
        if pools.is_copying_meshes() {
            uploads.finish_uploads(&gpu.device, &gpu.queue, || status.check_lost().is_err());
            pools.meshes_copied();
        }
        let shares_mesh = rewrite_mesh((&gpu.device, &gpu.queue), pools, slot, mesh);
        if matches!(shares_mesh, Ok(true)) {
            // The upload of the shared mesh may be in progress.
            uploads.finish_uploads(&gpu.device, &gpu.queue, || status.check_lost().is_err());
        }
        self.note_peak();
        shares_mesh.map(|_| ()).map_err(|reason| GpuError::Rewrite { reason })
    }

    /// Releases drawables. Their slots in the pools are free at once, except for what takes longer than 0.3 ms, which is freed
    /// in the next frames or when an upload needs slots. Uploads to them run after the draws already submitted. Stages that are
    /// drawn after this call must not name the drawables.
    pub fn release(&mut self, slots: &[DrawSlot]) {
        self.retired.release(slots, &mut self.pools);
    }

    /// Frees the memory of all released drawables at once, however long that takes. Otherwise a frame frees as many as it has
    /// time for.
    pub fn flush_released(&mut self) {
        self.retired.free_all(&mut self.pools);
    }

    /// Ends the uploads of a frame. The renderer calls it before it submits the frame, and submits the commands that `uploads`
    /// receives before its own.
    pub(crate) fn before_submit(&mut self, uploads: &mut Vec<wgpu::CommandBuffer>) {
        self.uploads.take_commands(uploads);
        self.retired.start_frame(&mut self.pools);
    }

    /// Makes custom drawables that are compiled from now on ready for a target.
    pub(crate) fn add_target_formats(&mut self, formats: &TargetFormats) {
        self.pools.customs_mut().add_target_formats(formats);
    }
}

/// The pools.
impl GraphicsContext {
    /// Returns an uploaded drawable.
    pub(crate) fn drawable(&self, slot: DrawSlot) -> Option<&DrawableEntry> {
        self.pools.drawable(slot)
    }

    /// Returns the bind classes by [`DrawableEntry::class`].
    pub(crate) fn bind_classes(&self) -> &[BindClass] {
        self.pools.bind_classes()
    }

    /// Returns the index of an attribute layout, see
    /// [`MeshPool::attribute_layout_index`](crate::gpu::MeshPool::attribute_layout_index).
    pub(crate) fn attribute_layout_index(&mut self, layout: &Arc<AttributeLayout>) -> Option<u32> {
        self.pools.attribute_layout_index(layout)
    }

    pub(crate) fn pools(&self) -> &Pools {
        &self.pools
    }

    pub(crate) fn layouts(&self) -> &BindGroupLayouts {
        self.pools.layouts()
    }

    /// Returns the size of all slots in use in the pools.
    pub fn bytes_in_use(&self) -> u64 {
        self.pools.bytes_in_use()
    }

    /// Returns the size of the pools, free slots included, and blocks that are being replaced by larger ones; and of the
    /// textures of state sets, without those that cameras draw into.
    pub fn bytes_allocated(&self) -> u64 {
        self.pools.bytes_allocated() + self.texture_bytes.all
    }

    /// Returns the largest [`Self::bytes_allocated`] so far.
    pub fn bytes_peak(&self) -> u64 {
        self.bytes_peak
    }

    fn note_peak(&mut self) {
        self.bytes_peak = self.bytes_peak.max(self.bytes_allocated());
    }
}

/// Hooks of tests.
#[cfg(feature = "testing")]
impl GraphicsContext {
    /// Loses the device as if the driver had lost it.
    pub fn lose_device(&self) {
        self.status.lose();
        self.gpu.device.destroy();
    }

    /// Limits the further growth of the pools to a number of bytes; `None` removes the limit.
    pub fn pretend_memory(&mut self, left_bytes: Option<u64>) {
        self.pools.pretend_memory(left_bytes);
    }

    /// Limits the memory for everything but the pools: targets, staging buffers, tables of the air.
    pub fn pretend_frame_memory(&self, left_bytes: Option<u64>) {
        self.memory.pretend(left_bytes);
    }

    /// Gives the selected offscreen target another format, such as those of windows without sRGB.
    pub fn pretend_format(&mut self, format: wgpu::TextureFormat) {
        self.targets.selected_mut().target_mut().pretend_format(&self.gpu.device, format);
    }

    /// Sets the next answers of the window's surface.
    pub fn pretend_surface(&mut self, answers: &[super::SurfaceAnswer]) {
        self.targets.selected_mut().target_mut().pretend(answers);
    }
}

fn counts_samples(kind: wgpu::DeviceType, backend: wgpu::Backend) -> bool {
    kind == wgpu::DeviceType::Cpu && backend == wgpu::Backend::Vulkan
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Regression: software drivers of OpenGL and Direct3D, whose queries answer 0 or 1, counted as ones that count.
    #[test]
    fn only_software_drivers_of_vulkan_count_samples() {
        use wgpu::{Backend, DeviceType};
        assert!(counts_samples(DeviceType::Cpu, Backend::Vulkan));
        for backend in [Backend::Gl, Backend::Dx12, Backend::Metal] {
            assert!(!counts_samples(DeviceType::Cpu, backend), "{backend:?}");
        }
        assert!(!counts_samples(DeviceType::DiscreteGpu, Backend::Vulkan));
    }
}
