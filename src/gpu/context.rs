//! A device with its queue, its target and its pools: OpenSceneGraph's graphics context.
//!
//! Made in realize, then owned by the draw thread; nothing else calls its queue.

use std::collections::VecDeque;
use std::path::Path;
use std::sync::{Arc, Mutex};

use super::budget::CompileBudget;
use super::compile::{self, CompileOperation, CompileQueue, CompileStats, Compiled};
use super::drawable::{DrawableTable, Pools};
use super::faces::{Face, surface_maker};
use super::host_device::HostDevice;
use super::layouts::Layouts;
use super::memory::Memory;
use super::pipeline_cache::PipelineCache;
use super::target::{Acquired, Target};
use super::{BindClass, DrawableEntry, GpuError, TargetFormats};
use crate::scene::{AttributeLayout, DrawSlot, Mesh};

/// Which adapter to draw with.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum AdapterChoice {
    /// The fastest one; a software adapter when there is nothing else.
    #[default]
    Any,
    /// A CPU adapter (lavapipe, WARP): pictures do not depend on the machine.
    Software,
    /// wgpu's backend that does nothing: the cost of recording alone, and tests without a GPU.
    Noop,
}

/// What a context shall be; OpenSceneGraph's `Traits`.
#[derive(Clone, Copy, Debug)]
pub struct ContextTraits {
    /// Width and height of the target in pixels.
    pub size_px: [u32; 2],
    /// Adapter.
    pub adapter: AdapterChoice,
    /// Samples a pixel of the target, 1 or 4.
    pub samples: u32,
    /// A window's images wait for the screen; without it (where the platform can) they do not, and may tear.
    pub vsync: bool,
    /// A thread of the device's own copies what is uploaded and records how it gets to its place, while the thread that
    /// draws only gives places and submits: OpenSceneGraph's compile contexts. Worth it where cores are idle and much
    /// is uploaded at once; otherwise the same within [`CompileBudget`].
    pub compile_thread: bool,
    /// Have the driver's validation layers check every call; ten times slower, never time with it.
    pub validation: bool,
}

impl Default for ContextTraits {
    fn default() -> Self {
        Self {
            size_px: [1280, 720],
            adapter: AdapterChoice::Any,
            samples: 1,
            vsync: true,
            compile_thread: false,
            validation: false,
        }
    }
}

/// A device, its queue, its target and what was uploaded to it. `Send`: made on one thread, then moved to the
/// draw thread, the only one to use it.
///
/// Contexts of a viewer that share a device are targets of one of these, drawn one after the other by its thread: what
/// is uploaded is there for all of them.
pub struct GraphicsContext {
    /// Dropped first: its thread ends then, and begins no commands where the queue is gone.
    compiles: CompileQueue,
    pub(super) instance: wgpu::Instance,
    pub(super) adapter: wgpu::Adapter,
    pub(super) device: wgpu::Device,
    queue: wgpu::Queue,
    adapter_info: wgpu::AdapterInfo,
    /// Never empty; in the order opened.
    pub(super) faces: Vec<Face>,
    /// The one that is drawn into.
    pub(super) face: usize,
    pools: Pools,
    drawables: DrawableTable,
    /// Released, and not yet retired.
    retiring: VecDeque<DrawSlot>,
    /// How many more this frame retires.
    retires: usize,
    /// Written by wgpu's device-lost callback on any thread, read by the draw thread; first reason wins.
    lost: Arc<Mutex<Option<String>>>,
    /// Written by wgpu's error callback on the draw thread, emptied by [`Self::take_device_errors`].
    errors: Arc<Mutex<Vec<String>>>,
    /// Of targets, staging buffers and what else frames need.
    memory: Memory,
    bytes_peak: u64,
    /// Written when it is dropped.
    pipeline_cache: Option<PipelineCache>,
    /// True if the device is the application's, which alone can replace it.
    is_host_device: bool,
}

pub(super) type MakeSurface = Arc<dyn Fn(&wgpu::Instance) -> Result<wgpu::Surface<'static>, GpuError> + Send + Sync>;

struct Opened {
    host: HostDevice,
    lost: Arc<Mutex<Option<String>>>,
    errors: Arc<Mutex<Vec<String>>>,
}

/// Drawables whose places one frame frees: some tenths of a millisecond. What a tile set leaves that is taken out at once
/// goes over several frames.
const MOST_RETIRED: usize = 1024;

/// Errors of the device that are kept until somebody asks.
const MOST_ERRORS: usize = 16;

/// The features that are used where an adapter has them.
pub(super) const OPTIONAL_FEATURES: wgpu::Features = wgpu::Features::TIMESTAMP_QUERY
    .union(wgpu::Features::POLYGON_MODE_LINE)
    .union(wgpu::Features::POLYGON_MODE_POINT)
    .union(wgpu::Features::DEPTH32FLOAT_STENCIL8)
    .union(wgpu::Features::FLOAT32_FILTERABLE)
    .union(wgpu::Features::DEPTH_CLIP_CONTROL)
    .union(wgpu::Features::PIPELINE_CACHE)
    .union(wgpu::Features::INDIRECT_FIRST_INSTANCE);

fn instance(traits: &ContextTraits) -> wgpu::Instance {
    let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
    descriptor.backends = match traits.adapter {
        AdapterChoice::Noop => wgpu::Backends::NOOP,
        AdapterChoice::Any | AdapterChoice::Software => wgpu::Backends::all() & !wgpu::Backends::NOOP,
    };
    descriptor.backend_options.noop.enable = traits.adapter == AdapterChoice::Noop;
    descriptor.flags = if traits.validation { wgpu::InstanceFlags::debugging() } else { wgpu::InstanceFlags::empty() };
    wgpu::Instance::new(descriptor)
}

/// Smaller is better: real GPUs first, and the native interfaces before OpenGL.
fn rank(info: &wgpu::AdapterInfo) -> (u32, u32) {
    let device = match info.device_type {
        wgpu::DeviceType::DiscreteGpu => 0,
        wgpu::DeviceType::IntegratedGpu => 1,
        wgpu::DeviceType::VirtualGpu => 2,
        wgpu::DeviceType::Other => 3,
        wgpu::DeviceType::Cpu => 4,
    };
    (device, u32::from(info.backend == wgpu::Backend::Gl))
}

fn open(
    instance: &wgpu::Instance,
    traits: &ContextTraits,
    surfaces: &[Option<wgpu::Surface<'static>>],
) -> Result<Opened, GpuError> {
    let mut adapters = pollster::block_on(instance.enumerate_adapters(wgpu::Backends::all()));
    let found = adapters.len();
    adapters.retain(|a| {
        let is_cpu = a.get_info().device_type == wgpu::DeviceType::Cpu;
        surfaces.iter().flatten().all(|s| a.is_surface_supported(s))
            && (traits.adapter != AdapterChoice::Software || is_cpu)
    });
    adapters.sort_by_key(|a| rank(&a.get_info()));
    let Some(adapter) = adapters.into_iter().next() else {
        let reason = format!("none of {found} found fits {:?}", traits.adapter);
        return Err(GpuError::NoAdapter { reason });
    };
    let info = adapter.get_info();
    let (device, queue) = pollster::block_on(adapter.request_device(&wgpu::DeviceDescriptor {
        label: Some("terrane"),
        required_features: HostDevice::features(&adapter),
        required_limits: adapter.limits(),
        memory_hints: wgpu::MemoryHints::Performance,
        ..Default::default()
    }))
    .map_err(|e| GpuError::NoDevice { adapter: info.name.clone(), reason: e.to_string() })?;
    let lost = Arc::new(Mutex::new(None));
    let on_lost = lost.clone();
    device.set_device_lost_callback(move |reason, message| {
        if reason != wgpu::DeviceLostReason::Destroyed
            && let Ok(mut lost) = on_lost.lock()
        {
            lost.get_or_insert(message);
        }
    });
    // Without a handler wgpu panics, on running out of memory too.
    let errors = Arc::new(Mutex::new(Vec::new()));
    let on_error = errors.clone();
    device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| {
        log::error!("graphics device: {error}");
        if let Ok(mut errors) = on_error.lock()
            && errors.len() < MOST_ERRORS
        {
            errors.push(error.to_string());
        }
    }));
    let host = HostDevice { instance: instance.clone(), adapter, device, queue };
    Ok(Opened { host, lost, errors })
}

impl GraphicsContext {
    /// A context that draws into textures of its own.
    pub fn new_offscreen(traits: &ContextTraits) -> Result<Self, GpuError> {
        Self::open(vec![(*traits, None)])
    }

    /// A context that draws into a window (an `Arc<winit::window::Window>`, say). The window is kept, to be drawn into
    /// again should the device be lost.
    pub fn new_window(
        target: impl Into<wgpu::SurfaceTarget<'static>> + Clone + Send + Sync + 'static,
        traits: &ContextTraits,
    ) -> Result<Self, GpuError> {
        Self::open(vec![(*traits, Some(surface_maker(target)))])
    }

    /// Creates a context on a device of the application, which draws into a texture that it can sample; see
    /// [`HostDevice`] for what that demands. Of the traits only size, samples and `compile_thread` are used. Fails with
    /// [`GpuError::NoDevice`] if the limits of the device are too small.
    pub fn new_on_device(host: HostDevice, traits: &ContextTraits) -> Result<Self, GpuError> {
        host.check()?;
        let opened = Opened { host, lost: Arc::default(), errors: Arc::default() };
        let context = Self::with_device(opened, vec![(*traits, None)], vec![None])?;
        Ok(Self { is_host_device: true, ..context })
    }

    /// The first of the targets decides on the adapter.
    fn open(wanted: Vec<(ContextTraits, Option<MakeSurface>)>) -> Result<Self, GpuError> {
        let traits = wanted.first().map_or_else(ContextTraits::default, |(traits, _)| *traits);
        let instance = instance(&traits);
        let surfaces = wanted.iter().map(|(_, make)| make.as_ref().map(|make| make(&instance)).transpose());
        let surfaces = surfaces.collect::<Result<Vec<_>, _>>()?;
        let opened = open(&instance, &traits, &surfaces)?;
        Self::with_device(opened, wanted, surfaces)
    }

    fn with_device(
        opened: Opened,
        wanted: Vec<(ContextTraits, Option<MakeSurface>)>,
        surfaces: Vec<Option<wgpu::Surface<'static>>>,
    ) -> Result<Self, GpuError> {
        let Opened { host: HostDevice { instance, adapter, device, queue }, lost, errors } = opened;
        let uses_thread = wanted.first().is_some_and(|(traits, _)| traits.compile_thread);
        let mut faces = Vec::with_capacity(wanted.len());
        for ((traits, make_surface), surface) in wanted.into_iter().zip(surfaces) {
            faces.push(Face { target: Target::new(&adapter, &device, surface, &traits)?, traits, make_surface });
        }
        let memory = Memory::new(&device);
        let mut pools = Pools::new(&device, Layouts::new(&device));
        for face in &faces {
            let target = face.formats();
            if !pools.customs.targets.contains(&target) {
                pools.customs.targets.push(target);
            }
        }
        let compiles = match uses_thread {
            true => CompileQueue::threaded(&memory).map_err(|e| GpuError::Thread { reason: e.to_string() })?,
            false => CompileQueue::default(),
        };
        Ok(Self {
            adapter_info: adapter.get_info(),
            instance,
            adapter,
            faces,
            face: 0,
            pools,
            drawables: DrawableTable::default(),
            compiles,
            retiring: VecDeque::new(),
            retires: MOST_RETIRED,
            lost,
            errors,
            memory,
            bytes_peak: 0,
            pipeline_cache: None,
            is_host_device: false,
            device,
            queue,
        })
    }

    /// True once the device was lost: nothing is drawn any more before [`Self::reopen`].
    pub fn is_lost(&self) -> bool {
        self.check_lost().is_err()
    }

    /// Takes a new device in the place of a lost one, of the same traits. What was uploaded is gone, and no slot is
    /// valid any more; uploads that waited are dropped. After an error it can be tried again.
    pub fn reopen(&mut self) -> Result<(), GpuError> {
        if self.is_host_device {
            let reason = "it is the application's; make a new one, and a new viewer on it".to_owned();
            return Err(GpuError::DeviceLost { reason });
        }
        let wanted = self.faces.iter().map(|face| {
            let traits = ContextTraits { size_px: face.target.size_px(), ..face.traits };
            (traits, face.make_surface.clone())
        });
        let wanted = wanted.collect();
        // A window has one surface at a time.
        self.faces.iter_mut().for_each(|face| face.target.close());
        let opened = Self::open(wanted)?;
        let (bytes_peak, face) = (self.bytes_peak, self.face);
        let kept = self.pipeline_cache.take();
        *self = Self { bytes_peak, face, ..opened };
        if let Some(folder) = kept.map(|kept| kept.folder().to_owned())
            && let Err(error) = self.keep_pipelines(&folder)
        {
            log::warn!("{error}");
        }
        Ok(())
    }

    /// Keeps what the driver compiles in a folder, for the next start, and uses what is kept there; called before the
    /// first draw. One file an adapter, of at most 64 MiB; written when the context is dropped. How many bytes were
    /// there. Where they could not be used the pipelines are made anew, and kept; only where the adapter
    /// [cannot](GpuError::NoPipelineCache) they are not.
    pub fn keep_pipelines(&mut self, folder: &Path) -> Result<u64, GpuError> {
        let (cache, found) = PipelineCache::open(&self.device, &self.adapter_info, folder)?;
        self.pipeline_cache = Some(cache);
        found
    }

    /// Writes what the driver has compiled so far to where it is kept; the bytes, 0 where nothing is.
    pub fn save_pipelines(&mut self) -> Result<u64, GpuError> {
        self.pipeline_cache.as_mut().map_or(Ok(0), PipelineCache::save)
    }

    /// For all pipelines that are made.
    pub(crate) fn pipeline_cache(&self) -> Option<&wgpu::PipelineCache> {
        self.pipeline_cache.as_ref().map(PipelineCache::cache)
    }

    /// Loses the device as if the driver had lost it.
    #[cfg(feature = "testing")]
    pub fn lose_device(&self) {
        if let Ok(mut lost) = self.lost.lock() {
            lost.get_or_insert_with(|| "destroyed".to_owned());
        }
        self.device.destroy();
    }

    /// Limits the further growth of the pools to a number of bytes; `None` removes the limit.
    #[cfg(feature = "testing")]
    pub fn pretend_memory(&mut self, left_bytes: Option<u64>) {
        self.pools.memory.pretend(left_bytes);
    }

    /// Limits the memory for what frames need besides the pools: targets, staging buffers, tables of the air.
    #[cfg(feature = "testing")]
    pub fn pretend_frame_memory(&self, left_bytes: Option<u64>) {
        self.memory.pretend(left_bytes);
    }

    /// Where frames get memory for what they need besides the pools.
    pub(crate) fn memory(&self) -> &Memory {
        &self.memory
    }

    /// Sets the next answers of the window's surface.
    #[cfg(feature = "testing")]
    pub fn pretend_surface(&mut self, answers: &[super::SurfaceAnswer]) {
        self.faces[self.face].target.pretend(answers);
    }

    /// Makes a window's images wait for the screen, or not.
    pub fn set_vsync(&mut self, vsync: bool) {
        let face = &mut self.faces[self.face];
        face.traits.vsync = vsync;
        face.target.set_vsync(&self.device, vsync);
    }

    /// Name of the adapter and the interface it is driven through.
    pub fn adapter_name(&self) -> String {
        format!("{} ({:?})", self.adapter_info.name, self.adapter_info.backend)
    }

    /// It draws with the processor.
    pub(crate) fn is_software(&self) -> bool {
        self.adapter_info.device_type == wgpu::DeviceType::Cpu
    }

    /// Returns true if the device is the application's; see [`Self::new_on_device`].
    pub fn is_host_device(&self) -> bool {
        self.is_host_device
    }

    /// The device, for overlays that draw on top.
    pub fn device(&self) -> &wgpu::Device {
        &self.device
    }

    /// The queue; only the thread that owns the context may use it.
    pub fn queue(&self) -> &wgpu::Queue {
        &self.queue
    }

    /// Width and height of the target in pixels.
    pub fn size_px(&self) -> [u32; 2] {
        self.target().size_px()
    }

    /// Samples a pixel of the target.
    pub fn samples(&self) -> u32 {
        // WebGPU promises 1 and 4.
        if self.faces[self.face].traits.samples > 1 { 4 } else { 1 }
    }

    /// Format of the colour target.
    pub fn color_format(&self) -> wgpu::TextureFormat {
        self.target().format()
    }

    /// Changes the size of the target; a held window image is dropped.
    pub fn resize(&mut self, size_px: [u32; 2]) -> Result<(), GpuError> {
        self.faces[self.face].target.resize(&self.device, size_px)
    }

    /// Gets the image the next draw goes to. [`crate::draw::Renderer::draw`] calls it; a second call before
    /// [`Self::present`] is free. Blocks until the window has an image (Fifo).
    pub fn acquire(&mut self) -> Result<Acquired, GpuError> {
        self.check_lost()?;
        let Face { target, make_surface, .. } = &mut self.faces[self.face];
        let remake = || match &*make_surface {
            Some(make) => make(&self.instance).and_then(|surface| match self.adapter.is_surface_supported(&surface) {
                true => Ok(surface),
                false => Err(GpuError::Surface { reason: "the adapter cannot show anything in it".to_owned() }),
            }),
            None => Err(GpuError::Surface { reason: "there is no window".to_owned() }),
        };
        target.acquire(&self.device, remake)
    }

    /// The image drawn into, for overlays between draw and [`Self::present`]; `None` while a window holds none.
    pub fn color_view(&self) -> Option<&wgpu::TextureView> {
        self.target().color_view()
    }

    /// Shows the window's image. Nothing to do offscreen.
    pub fn present(&mut self) {
        let _span = crate::trace::span("present");
        self.faces[self.face].target.present(&self.queue);
    }

    /// Queues drawables to be uploaded by [`Self::run_compiles`].
    pub fn compile(&mut self, operation: CompileOperation) {
        self.compiles.push(operation);
    }

    /// Ends operations that have not begun, with no slot.
    pub fn cancel_compiles(&mut self, tickets: &[u64]) {
        self.compiles.cancel(tickets);
    }

    /// Uploads within a budget, at least one slice; what is too big is split over calls.
    pub fn run_compiles(&mut self, budget: &CompileBudget) -> CompileStats {
        let _span = crate::trace::span("compile");
        if self.compiles.pending() > 0 {
            self.retire(usize::MAX);
        }
        let cache = self.pipeline_cache.as_ref().map(PipelineCache::cache);
        let compiles = &mut self.compiles;
        let stats = compiles.run(&self.memory, &self.queue, &mut self.pools, &mut self.drawables, cache, budget);
        if let Some(error) = compiles.take_refusal() {
            log::error!("uploads wait: {error}");
            if let Ok(mut errors) = self.errors.lock()
                && errors.len() < MOST_ERRORS
            {
                errors.push(error);
            }
        }
        self.bytes_peak = self.bytes_peak.max(self.pools.bytes_allocated());
        stats
    }

    /// There was no memory for what was to be uploaded last.
    pub(crate) fn lacks_memory(&self) -> bool {
        self.compiles.is_refused()
    }

    /// Operations that are waiting or under way.
    pub fn pending_compiles(&self) -> usize {
        self.compiles.pending()
    }

    /// What was finished since the last call, in the order of [`Self::compile`].
    pub fn take_compiled(&mut self) -> Vec<Compiled> {
        self.compiles.take_finished()
    }

    /// Puts another mesh in the place of a drawable's, uploaded at once: draws from now on show it, those submitted
    /// before do not. Slot, material and texture stay.
    pub fn rewrite(&mut self, slot: DrawSlot, mesh: &Arc<Mesh>) -> Result<(), GpuError> {
        let Self { device, queue, pools, drawables, .. } = self;
        // What the thread recorded for a place that is another's now must not come after this.
        self.compiles.flush_recorded(device, queue);
        let is_shared = compile::rewrite(queue, pools, drawables, slot, mesh);
        self.bytes_peak = self.bytes_peak.max(self.pools.bytes_allocated());
        if is_shared.map_err(|reason| GpuError::Rewrite { reason })? {
            // The mesh may be on its way.
            let is_lost = || self.lost.lock().is_ok_and(|lost| lost.is_some());
            self.compiles.end_uploads(&self.device, &self.queue, is_lost);
        }
        Ok(())
    }

    /// Gives drawables back. Their places are free at once, but for more than a frame retires: those when the next
    /// frames are submitted, or when an upload needs places. Later uploads run after the draws already submitted. Stages
    /// drawn after this call must not name the slots.
    pub fn release(&mut self, slots: &[DrawSlot]) {
        self.retiring.extend(slots);
        self.retire(self.retires);
    }

    /// Frees the places of so many that were released, or of all.
    fn retire(&mut self, most: usize) {
        let count = most.min(self.retiring.len());
        for slot in self.retiring.drain(..count) {
            if let Some(entry) = self.drawables.remove(slot) {
                self.pools.release(&entry);
            }
        }
        self.retires = self.retires.saturating_sub(count);
    }

    /// Bytes of the places that are taken in the pools.
    pub fn bytes_in_use(&self) -> u64 {
        self.pools.bytes_in_use()
    }

    /// Bytes of all blocks of the pools, free places included.
    pub fn bytes_allocated(&self) -> u64 {
        self.pools.bytes_allocated()
    }

    /// Largest [`Self::bytes_allocated`] so far.
    pub fn bytes_peak(&self) -> u64 {
        self.bytes_peak
    }

    /// What the device complained about since the last call (also logged): out of memory, or a bug of ours.
    pub fn take_device_errors(&mut self) -> Vec<String> {
        self.errors.lock().map(|mut e| std::mem::take(&mut *e)).unwrap_or_default()
    }

    /// Called by the renderer, whose submit takes along what was written before; gives it what it must submit before
    /// its own.
    pub(crate) fn submitted(&mut self, uploads: &mut Vec<wgpu::CommandBuffer>) {
        self.compiles.flushed();
        self.compiles.take_commands(uploads);
        self.retires = MOST_RETIRED;
        self.retire(MOST_RETIRED);
    }

    /// What is drawn into: told to what the application compiles.
    pub(crate) fn draws_into(&mut self, target: &TargetFormats) {
        let targets = &mut self.pools.customs.targets;
        if !targets.contains(target) {
            targets.push(*target);
        }
    }

    pub(crate) fn drawable(&self, slot: DrawSlot) -> Option<&DrawableEntry> {
        self.drawables.entry(slot)
    }

    /// By [`DrawableEntry::class`].
    pub(crate) fn bind_classes(&self) -> &[BindClass] {
        self.drawables.classes()
    }

    fn target(&self) -> &Target {
        &self.faces[self.face].target
    }

    /// The place of a layout of further attributes, see [`MeshPool`](super::mesh_pool::MeshPool).
    pub(crate) fn layout_place(&mut self, layout: &Arc<AttributeLayout>) -> Option<u32> {
        self.pools.meshes.layout_place(layout)
    }

    pub(crate) fn pools(&self) -> &Pools {
        &self.pools
    }

    pub(crate) fn layouts(&self) -> &Layouts {
        self.pools.layouts()
    }

    pub(crate) fn color_texture(&self) -> Option<&wgpu::Texture> {
        self.target().color_texture()
    }

    pub(crate) fn check_lost(&self) -> Result<(), GpuError> {
        if !self.compiles.is_alive() {
            return Err(GpuError::DeviceLost { reason: "its compile thread has stopped".to_owned() });
        }
        match self.lost.lock() {
            Ok(lost) => match lost.as_ref() {
                Some(reason) => Err(GpuError::DeviceLost { reason: reason.clone() }),
                None => Ok(()),
            },
            Err(_) => Ok(()),
        }
    }
}
