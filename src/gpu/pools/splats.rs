//! [`SplatPool`]: Gaussian splats in GPU memory, and the orders in which they are drawn. Draw thread.
//!
//! The splats themselves stay as they are. They are drawn in an order from back to front, which is a list of numbers. It is
//! sorted again when the eye has moved far enough, and written before the frame that needs it is submitted. Each view has an
//! order of its own, also within a frame.

use std::cell::{Cell, RefCell};
use std::sync::Arc;

use glam::{Mat3, Vec3};

use super::allocation::BufferDestination;
use super::bind_group_layouts::BindGroupLayouts;
use super::slot_table::SlotTable;
use crate::gpu::memory::Memory;
use crate::scene::Splats;

/// An order stays while the eye moves by less than this share of its distance from the middle of the splats, or of their radius
/// if that is more.
const MAX_MOVE: f32 = 0.005;
/// Draws after which an order that no view uses is freed. One order is kept.
const MAX_UNUSED_DRAWS: u64 = 60;
/// The maximum number of distances that an order tells apart.
const MAX_STEPS: usize = 1 << 16;

/// The place that splats are seen from, in their frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Viewpoint {
    /// An eye, from which distances are measured.
    Eye(Vec3),
    /// The direction towards the eye, if rays are parallel; of length 1.
    Direction(Vec3),
}

impl Viewpoint {
    /// Returns the viewpoint of a view by the rows of the transform from the splats to the eye.
    pub(crate) fn new(eye_from_splats: &[[f32; 4]; 3], has_parallel_rays: bool) -> Self {
        let [x, y, z] = eye_from_splats.map(|row| Vec3::new(row[0], row[1], row[2]));
        if has_parallel_rays {
            return Self::Direction(z.normalize_or_zero());
        }
        let inverse = Mat3::from_cols(x, y, z).transpose().inverse();
        Self::Eye(inverse * -Vec3::from_array(eye_from_splats.map(|row| row[3])))
    }

    /// Returns how far a point is away; only differences count.
    fn distance(&self, point: Vec3) -> f32 {
        match self {
            Self::Eye(eye) => point.distance(*eye),
            Self::Direction(towards_eye) => -point.dot(*towards_eye),
        }
    }

    /// Returns true if an order for another viewpoint is good enough for this one.
    fn is_near(&self, other: &Self, middle: Vec3, radius: f32) -> bool {
        match (self, other) {
            (Self::Eye(a), Self::Eye(b)) => a.distance(*b) <= MAX_MOVE * b.distance(middle).max(radius),
            (Self::Direction(a), Self::Direction(b)) => a.distance(*b) <= MAX_MOVE,
            _ => false,
        }
    }
}

/// An order of splats for a view.
struct Order {
    /// The viewpoint that it was sorted for; `None` if the buffer has no contents yet.
    viewpoint: Option<Viewpoint>,
    /// The number of the last draw that used it.
    used: u64,
    numbers: wgpu::Buffer,
    /// Splats, numbers and harmonics.
    bind_group: wgpu::BindGroup,
}

struct ResidentSplats {
    splats: wgpu::Buffer,
    /// `None` for splats whose colours do not change with the direction.
    harmonics: Option<wgpu::Buffer>,
    /// The centres, which the orders are sorted by.
    centers: Arc<[[f32; 3]]>,
    middle: Vec3,
    radius: f32,
    orders: Vec<Order>,
}

impl ResidentSplats {
    fn order_bytes(&self) -> u64 {
        4 * self.centers.len() as u64
    }

    /// Returns the bytes of GPU memory, and of the centres.
    fn bytes(&self) -> u64 {
        let harmonics = self.harmonics.as_ref().map_or(0, wgpu::Buffer::size);
        let orders = self.orders.len() as u64 * self.order_bytes();
        self.splats.size() + harmonics + size_of_val(&self.centers[..]) as u64 + orders
    }

    fn add_order(&mut self, memory: &Memory, layouts: &BindGroupLayouts) -> Result<(), String> {
        let descriptor = wgpu::BufferDescriptor {
            label: Some("order of splats"),
            size: self.order_bytes(),
            usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        };
        let numbers =
            memory.allocate("order of splats", descriptor.size, |device| device.create_buffer(&descriptor))?;
        // The shader does not read harmonics of degree 0.
        let harmonics = self.harmonics.as_ref().unwrap_or(&self.splats);
        let bind_group = memory.device().create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("splats"),
            layout: &layouts.splats,
            entries: &[
                wgpu::BindGroupEntry { binding: 0, resource: self.splats.as_entire_binding() },
                wgpu::BindGroupEntry { binding: 1, resource: numbers.as_entire_binding() },
                wgpu::BindGroupEntry { binding: 2, resource: harmonics.as_entire_binding() },
            ],
        });
        self.orders.push(Order { viewpoint: None, used: 0, numbers, bind_group });
        Ok(())
    }
}

/// The buffers of splats, to be filled.
pub(in crate::gpu) struct SplatAllocation {
    /// The number of the splats in the pool.
    pub(in crate::gpu) number: u32,
    /// The bytes of GPU memory, and of the centres.
    pub(in crate::gpu) bytes: u64,
    pub(in crate::gpu) splats: BufferDestination,
    /// `None` without harmonics.
    pub(in crate::gpu) harmonics: Option<BufferDestination>,
}

/// The lists that sorting writes to, kept for the next sort.
#[derive(Default)]
struct Scratch {
    distances: Vec<f32>,
    starts: Vec<u32>,
    order: Vec<u32>,
}

impl Scratch {
    /// Sorts numbers of points by their distances, the farthest first. Points of equal steps keep their order.
    fn sort(&mut self, points: &[[f32; 3]], viewpoint: &Viewpoint) {
        let Self { distances, starts, order } = self;
        distances.clear();
        distances.extend(points.iter().map(|point| viewpoint.distance(Vec3::from_array(*point))));
        let (nearest, farthest) =
            distances.iter().fold((f32::INFINITY, f32::NEG_INFINITY), |(least, most), d| (least.min(*d), most.max(*d)));
        let steps = (4 * points.len()).next_power_of_two().clamp(256, MAX_STEPS);
        let per_metre = (steps - 1) as f32 / (farthest - nearest).max(f32::MIN_POSITIVE);
        // A conversion of what is no number is 0, and that of infinity the largest number.
        let step = |distance: f32| (((farthest - distance) * per_metre) as usize).min(steps - 1);
        starts.clear();
        starts.resize(steps, 0);
        distances.iter().for_each(|distance| starts[step(*distance)] += 1);
        let mut next = 0;
        for start in starts.iter_mut() {
            next += std::mem::replace(start, next);
        }
        order.clear();
        order.resize(points.len(), 0);
        for (number, distance) in (0..).zip(distances.iter()) {
            let place = &mut starts[step(*distance)];
            order[*place as usize] = number;
            *place += 1;
        }
    }
}

/// Gaussian splats of a device.
#[derive(Default)]
pub(crate) struct SplatPool {
    clouds: RefCell<SlotTable<ResidentSplats>>,
    bytes: Cell<u64>,
    scratch: RefCell<Scratch>,
    /// The number of the current draw.
    draw: Cell<u64>,
}

impl SplatPool {
    /// Allocates the buffers of splats.
    pub(in crate::gpu) fn allocate(
        &mut self,
        memory: &Memory,
        layouts: &BindGroupLayouts,
        splats: &Splats,
    ) -> Result<SplatAllocation, String> {
        if splats.list().is_empty() {
            return Err("a cloud of no splats".into());
        }
        let limits = memory.limits();
        let limit = limits.max_storage_buffer_binding_size.min(limits.max_buffer_size);
        let buffer = |label: &'static str, size: u64| {
            if size > limit {
                return Err(format!("{size} bytes of {label}; the adapter binds at most {limit}"));
            }
            let usage = wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST;
            let descriptor = wgpu::BufferDescriptor { label: Some(label), size, usage, mapped_at_creation: false };
            memory.allocate(label, size, |device| device.create_buffer(&descriptor))
        };
        let harmonics_bytes = splats.harmonics().size_bytes();
        let harmonics = (harmonics_bytes > 0).then(|| buffer("harmonics of splats", harmonics_bytes)).transpose()?;
        let bounds = splats.bounds();
        let mut cloud = ResidentSplats {
            splats: buffer("splats", size_of_val(splats.list()) as u64)?,
            harmonics,
            centers: splats.centers().clone(),
            middle: bounds.center().as_vec3(),
            radius: bounds.half_size().length() as f32,
            orders: Vec::new(),
        };
        cloud.add_order(memory, layouts)?;
        let bytes = cloud.bytes();
        self.bytes.set(self.bytes.get() + bytes);
        let destination = |buffer: &wgpu::Buffer| BufferDestination { buffer: buffer.clone(), offset: 0 };
        let (splats, harmonics) = (destination(&cloud.splats), cloud.harmonics.as_ref().map(destination));
        Ok(SplatAllocation { number: self.clouds.get_mut().insert(cloud), bytes, splats, harmonics })
    }

    pub(super) fn release(&mut self, number: u32) {
        if let Some(cloud) = self.clouds.get_mut().remove(number) {
            self.bytes.set(self.bytes.get() - cloud.bytes());
        }
    }

    /// Starts a draw, whose commands are submitted before the next one starts.
    pub(crate) fn start_draw(&self) {
        self.draw.set(self.draw.get() + 1);
    }

    /// Returns the bind group that draws splats from back to front, sorted for a viewpoint. Returns `None` if they were
    /// released or if there is no memory for another view.
    pub(super) fn sorted(
        &self,
        memory: &Memory,
        layouts: &BindGroupLayouts,
        queue: &wgpu::Queue,
        number: u32,
        viewpoint: Viewpoint,
    ) -> Option<wgpu::BindGroup> {
        let mut clouds = self.clouds.borrow_mut();
        let cloud = clouds.get_mut(number)?;
        let (draw, before) = (self.draw.get(), cloud.bytes());
        let (middle, radius) = (cloud.middle, cloud.radius);
        let is_good = |order: &Order| order.viewpoint.is_some_and(|known| viewpoint.is_near(&known, middle, radius));
        let index = match cloud.orders.iter().position(is_good) {
            Some(index) => index,
            None => {
                // An order that a view of this draw uses must not change.
                let index = match cloud.orders.iter().position(|order| order.used != draw) {
                    Some(index) => index,
                    None => {
                        cloud.add_order(memory, layouts).ok()?;
                        cloud.orders.len() - 1
                    }
                };
                let mut scratch = self.scratch.borrow_mut();
                scratch.sort(&cloud.centers, &viewpoint);
                let order = &mut cloud.orders[index];
                order.viewpoint = Some(viewpoint);
                queue.write_buffer(&order.numbers, 0, bytemuck::cast_slice(&scratch.order));
                index
            }
        };
        let order = &mut cloud.orders[index];
        order.used = draw;
        let bind_group = order.bind_group.clone();
        if cloud.orders.len() > 1 {
            cloud.orders.retain(|order| draw - order.used <= MAX_UNUSED_DRAWS);
        }
        self.bytes.set(self.bytes.get() + cloud.bytes() - before);
        Some(bind_group)
    }

    pub(super) fn bytes(&self) -> u64 {
        self.bytes.get()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::{AdapterChoice, ContextTraits, GraphicsContext};
    use crate::scene::Splat;

    #[test]
    fn splats_are_sorted_from_back_to_front() {
        let mut scratch = Scratch::default();
        let points: Vec<[f32; 3]> = (0..1000u32).map(|i| [(i * 7919 % 1000) as f32, 0.0, 0.0]).collect();
        for (viewpoint, ascends) in [
            (Viewpoint::Eye(Vec3::X * -5.0), false),
            (Viewpoint::Eye(Vec3::X * 2000.0), true),
            (Viewpoint::Direction(Vec3::X), true),
            (Viewpoint::Direction(-Vec3::X), false),
        ] {
            scratch.sort(&points, &viewpoint);
            let sorted: Vec<f32> = scratch.order.iter().map(|i| points[*i as usize][0]).collect();
            assert_eq!(sorted.len(), 1000);
            assert!(sorted.windows(2).all(|w| (w[0] < w[1]) == ascends && w[0] != w[1]), "{viewpoint:?}");
        }
        // Points at one place, and a distance that overflows, keep the list whole.
        for points in [vec![[1.0; 3]; 5], vec![[f32::MAX; 3], [0.0; 3], [-f32::MAX; 3]]] {
            scratch.sort(&points, &Viewpoint::Eye(Vec3::ZERO));
            let mut order = scratch.order.clone();
            order.sort_unstable();
            assert!(order.iter().copied().eq(0..points.len() as u32));
        }
    }

    #[test]
    fn views_of_one_draw_have_orders_of_their_own() {
        let traits = ContextTraits { size_px: [4, 4], adapter: AdapterChoice::Noop, ..ContextTraits::default() };
        let ctx = GraphicsContext::new_offscreen(&traits).unwrap();
        let (memory, layouts) = (Memory::new(ctx.device()), BindGroupLayouts::new(ctx.device(), 1));
        let splat = Splat::new([0.0; 3], [1.0; 3], [0.0, 0.0, 0.0, 1.0], [1.0; 4]).unwrap();
        let mut pool = SplatPool::default();
        let allocation = pool.allocate(&memory, &layouts, &Splats::new(vec![splat; 10])).unwrap();
        let number = allocation.number;
        assert!(allocation.harmonics.is_none());
        assert_eq!((pool.bytes(), allocation.bytes), (10 * 52, 10 * 52));
        let [front, back, side] = [Vec3::Z, -Vec3::Z, Vec3::X].map(|eye| Viewpoint::Eye(9.0 * eye));
        let sorted = |view| pool.sorted(&memory, &layouts, ctx.queue(), number, view).unwrap();
        pool.start_draw();
        let (of_front, of_back) = (sorted(front), sorted(back));
        assert!(of_front != of_back && sorted(front) == of_front && sorted(back) == of_back);
        assert_eq!(pool.bytes(), 10 * 56);
        // An order that no view of the next draw uses is sorted anew.
        pool.start_draw();
        assert!(sorted(back) == of_back && sorted(side) == of_front);
        // An order that no view uses is freed.
        for _ in 0..=MAX_UNUSED_DRAWS {
            pool.start_draw();
            assert!(sorted(back) == of_back);
        }
        assert_eq!(pool.bytes(), 10 * 52);
        pool.release(number);
        assert_eq!(pool.bytes(), 0);
    }

    #[test]
    fn viewpoint_is_the_eye_in_the_frame_of_the_splats() {
        // Turned by a quarter, doubled, and moved 10 m away from the eye.
        let rows = [[0.0, -2.0, 0.0, 0.0], [2.0, 0.0, 0.0, 0.0], [0.0, 0.0, 2.0, -10.0]];
        let Viewpoint::Eye(eye) = Viewpoint::new(&rows, false) else { panic!("an eye") };
        assert!(eye.distance(Vec3::Z * 5.0) < 1e-5, "{eye}");
        assert_eq!(Viewpoint::new(&rows, true), Viewpoint::Direction(Vec3::Z));
        let near = Viewpoint::Eye(Vec3::new(0.0, 0.02, 5.0));
        let far = Viewpoint::Eye(Vec3::new(0.0, 0.03, 5.0));
        assert!(Viewpoint::Eye(eye).is_near(&near, Vec3::ZERO, 1.0));
        assert!(!Viewpoint::Eye(eye).is_near(&far, Vec3::ZERO, 1.0));
    }
}
