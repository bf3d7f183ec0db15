//! Gaussian splats: ellipsoids of colour that fade from their centres, as plain CPU data. Filled by decode workers on any
//! thread, read once by the draw thread when it uploads a page.

mod harmonics;

use std::sync::Arc;

use glam::{Quat, Vec3};

use crate::math::Aabb;

pub use harmonics::SplatHarmonics;

/// The number of standard deviations at which a splat ends.
pub(crate) const SPLAT_SIGMAS: f32 = 3.0;
/// The bytes of a storage buffer that every device of WebGPU binds.
const MAX_BUFFER_BYTES: usize = 128 << 20;

/// A splat of [`Splats`], as the GPU reads it (36 bytes).
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct Splat {
    /// The centre, metres in the drawable's frame.
    pub position: [f32; 3],
    /// The standard deviation along each axis of the splat, metres.
    pub scale: [f32; 3],
    /// The rotation from the axes of the splat to the drawable's frame: a unit quaternion x, y, z, w as snorm16.
    pub rotation: [i16; 4],
    /// The colour as displayed (sRGB) without harmonics, and the opacity of the centre, as unorm8.
    pub color: [u8; 4],
}

impl Splat {
    /// Returns a splat; `None` if a number is not finite, a scale is negative or the rotation has no length. Colour and opacity
    /// are clamped to 0 to 1.
    pub fn new(position: [f32; 3], scale: [f32; 3], rotation: [f32; 4], color: [f32; 4]) -> Option<Self> {
        let rotation = Quat::from_array(rotation);
        let is_finite = Vec3::from_array(position).is_finite()
            && scale.iter().all(|s| s.is_finite() && *s >= 0.0)
            && rotation.length_squared().is_normal()
            && color.iter().all(|c| c.is_finite());
        is_finite.then(|| Self {
            position,
            scale,
            rotation: rotation.normalize().to_array().map(|q| (q.clamp(-1.0, 1.0) * 32767.0).round() as i16),
            color: color.map(|c| (c.clamp(0.0, 1.0) * 255.0).round() as u8),
        })
    }
}

/// A cloud of splats, which are drawn from back to front.
///
/// They are not lit, cast no shadow and write no depth, and intersections ignore them. The material's base colour is a factor
/// of their colour and opacity; the rest of the material has no effect but [`AlphaMode::Blend`](super::AlphaMode::Blend),
/// which it should have.
#[derive(Clone, Debug, PartialEq)]
pub struct Splats {
    list: Vec<Splat>,
    harmonics: SplatHarmonics,
    /// The centres, by which the draw thread sorts.
    centers: Arc<[[f32; 3]]>,
    bounds: Aabb,
}

impl Splats {
    /// Returns a cloud whose colours do not change with the direction.
    pub fn new(list: Vec<Splat>) -> Self {
        let mut bounds = Aabb::EMPTY;
        for splat in &list {
            let center = Vec3::from_array(splat.position).as_dvec3();
            let reach = f64::from(splat.scale.iter().fold(0.0f32, |most, s| most.max(*s))) * f64::from(SPLAT_SIGMAS);
            bounds = bounds.union(&Aabb { min: center - reach, max: center + reach });
        }
        let centers = list.iter().map(|splat| splat.position).collect();
        Self { list, harmonics: SplatHarmonics::default(), centers, bounds }
    }

    /// Adds the harmonics of the splats. Returns `None` if they are those of another number of splats.
    pub fn with_harmonics(mut self, harmonics: SplatHarmonics) -> Option<Self> {
        let is_whole = harmonics.degree() == 0 || harmonics.count() == self.list.len();
        self.harmonics = harmonics;
        is_whole.then_some(self)
    }

    /// Returns the splats.
    pub fn list(&self) -> &[Splat] {
        &self.list
    }

    /// Returns the harmonics by which the colours change with the direction; of degree 0 if they do not.
    pub fn harmonics(&self) -> &SplatHarmonics {
        &self.harmonics
    }

    /// Returns the centres of the splats.
    pub(crate) fn centers(&self) -> &Arc<[[f32; 3]]> {
        &self.centers
    }

    /// Returns the box around all splats up to three standard deviations.
    pub fn bounds(&self) -> Aabb {
        self.bounds
    }

    /// Returns the bytes of CPU memory that the splats take.
    pub fn size_bytes(&self) -> u64 {
        (size_of_val(&self.list[..]) + size_of_val(&self.centers[..])) as u64 + self.harmonics.size_bytes()
    }

    /// Cuts a cloud into some whose buffers every adapter binds.
    pub(crate) fn cut_to_buffers(self) -> Vec<Self> {
        let splat_bytes = size_of::<Splat>().max(4 * SplatHarmonics::words_of(self.harmonics.degree()));
        self.cut(MAX_BUFFER_BYTES / splat_bytes)
    }

    /// Cuts a cloud into some of at most `max_splats`: again and again at the median along the longest side, so that clouds can
    /// be sorted by their middles. Splats keep their order within each.
    fn cut(self, max_splats: usize) -> Vec<Self> {
        if self.list.len() <= max_splats.max(1) {
            return vec![self];
        }
        let mut numbers: Vec<u32> = (0..self.list.len() as u32).collect();
        let mut clouds = Vec::new();
        let mut parts = vec![&mut numbers[..]];
        while let Some(part) = parts.pop() {
            if part.len() <= max_splats.max(1) {
                part.sort_unstable();
                clouds.push(self.part(part));
                continue;
            }
            let center = |number: u32| Vec3::from_array(self.centers[number as usize]);
            let (min, max) = part.iter().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(min, max), number| {
                (min.min(center(*number)), max.max(center(*number)))
            });
            let axis = (max - min).max_position();
            let middle = part.len() / 2;
            part.select_nth_unstable_by(middle, |a, b| center(*a)[axis].total_cmp(&center(*b)[axis]).then(a.cmp(b)));
            let (low, high) = part.split_at_mut(middle);
            parts.extend([high, low]);
        }
        clouds
    }

    /// Returns the cloud of some splats.
    fn part(&self, numbers: &[u32]) -> Self {
        let mut harmonics = SplatHarmonics::new(self.harmonics.degree(), self.harmonics.is_linear());
        harmonics.reserve(numbers.len());
        numbers.iter().for_each(|number| harmonics.push_copy(&self.harmonics, *number as usize));
        let list = numbers.iter().map(|number| self.list[*number as usize]).collect();
        Self { harmonics, ..Self::new(list) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn large_cloud_is_cut_along_its_longest_side() {
        // A row along y whose numbers are shuffled, with a harmonic that names each splat.
        let mut harmonics = SplatHarmonics::new(1, true);
        let list: Vec<Splat> = (0..100u16)
            .map(|i| {
                let y = f32::from(i * 37 % 100);
                harmonics.push([0.5; 3], &[[y; 3]]);
                Splat::new([f32::from(i % 3), y, 0.0], [0.1; 3], [0.0, 0.0, 0.0, 1.0], [0.5; 4]).unwrap()
            })
            .collect();
        let cloud = Splats::new(list).with_harmonics(harmonics).unwrap();
        assert_eq!(cloud.clone().cut(100), std::slice::from_ref(&cloud));
        let parts = cloud.clone().cut(30);
        assert_eq!(parts.iter().map(|part| part.list().len()).collect::<Vec<_>>(), [25; 4]);
        for (part, first) in parts.iter().zip([0.0, 25.0, 50.0, 75.0]) {
            assert!(
                (part.bounds().min.y - (first - 0.3)).abs() < 1e-5
                    && (part.bounds().max.y - (first + 24.3)).abs() < 1e-5
            );
            assert!(part.harmonics().is_linear());
            for (number, splat) in part.list().iter().enumerate() {
                let named = part.harmonics().values(number).nth(1).unwrap();
                assert!((named[0] - splat.position[1]).abs() < 1e-4, "{splat:?}, {named:?}");
                assert_eq!(part.centers()[number], splat.position);
            }
            // In the order of the whole.
            let places = part.list().iter().map(|splat| cloud.list().iter().position(|other| other == splat));
            assert!(places.collect::<Vec<_>>().is_sorted());
        }
        // Splats at one position are cut too, and those of another number have no such harmonics.
        let same = Splats::new(vec![parts[0].list()[0]; 10]);
        assert_eq!(same.clone().cut(0).len(), 10);
        assert!(same.with_harmonics(SplatHarmonics::new(2, false)).is_none());
    }

    #[test]
    fn clouds_fit_the_buffers_of_every_adapter() {
        let limits = wgpu::Limits::default();
        assert!(MAX_BUFFER_BYTES as u64 <= limits.max_storage_buffer_binding_size.min(limits.max_buffer_size));
    }
}
