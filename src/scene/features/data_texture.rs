//! [`DataTexture`]: an image whose texels hold ids or property values instead of colours. Plain CPU data, any thread.

use std::collections::HashSet;
use std::sync::Arc;

use crate::scene::geometry::{TexelFormat, Texture};
use crate::state::WrapMode;

/// A point of a mesh: the corners of a primitive with their weights.
/// [`Intersection::surface_point`](crate::scene::Intersection::surface_point) returns it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfacePoint {
    /// Indices into the vertices of the mesh.
    pub vertices: [u32; 3],
    /// The weights of the vertices, 1 in sum.
    pub weights: [f64; 3],
}

impl SurfacePoint {
    /// Returns the vertex with the largest weight.
    pub fn nearest_vertex(&self) -> u32 {
        let [a, b, c] = self.weights;
        let at = if a >= b && a >= c { 0 } else { 1 + usize::from(c > b) };
        self.vertices[at]
    }
}

/// An image on a mesh that is read by the CPU, texel by texel. It stays in memory with the page.
#[derive(Clone, Debug, PartialEq)]
pub struct DataTexture {
    image: Arc<Texture>,
    channels: Arc<[u8]>,
    /// Texture coordinates by vertex.
    uvs: Arc<[[f32; 2]]>,
}

impl DataTexture {
    /// Creates a texture from the first level of an image in RGBA8. `channels` are the numbers of the channels that hold a
    /// value, its lowest byte first, and `uvs` the texture coordinates of each vertex. Returns `None` for another format, an
    /// image without texels, and for other than one to four channels of four.
    pub fn new(image: Arc<Texture>, channels: Arc<[u8]>, uvs: Arc<[[f32; 2]]>) -> Option<Self> {
        let texels = u64::from(image.width) * u64::from(image.height);
        let has_texels = image.mips.first().is_some_and(|level| level.len() as u64 == 4 * texels && texels > 0);
        let has_channels = (1..=4).contains(&channels.len()) && channels.iter().all(|channel| *channel < 4);
        (image.format == TexelFormat::Rgba8 && has_texels && has_channels).then_some(Self { image, channels, uvs })
    }

    /// Returns the bytes of the texel at a point, one for each channel, without filtering. Returns `None` if the mesh lacks
    /// one of the vertices.
    pub fn texel(&self, at: &SurfacePoint) -> Option<Vec<u8>> {
        let mut uv = [0.0; 2];
        for (vertex, weight) in at.vertices.iter().zip(at.weights) {
            let corner = self.uvs.get(*vertex as usize)?;
            uv[0] += weight * f64::from(corner[0]);
            uv[1] += weight * f64::from(corner[1]);
        }
        let Texture { width, height, sampling, .. } = &*self.image;
        let [x, y] = [(uv[0], *width, sampling.wrap[0]), (uv[1], *height, sampling.wrap[1])]
            .map(|(at, size, wrap)| texel_index(at, size, wrap));
        let texel = self.image.mips.first()?.get(4 * (y * *width as usize + x)..)?;
        self.channels.iter().map(|channel| texel.get(usize::from(*channel)).copied()).collect()
    }

    /// Returns the texture for a mesh of some of the vertices.
    pub(super) fn with_vertices(&self, vertices: &[u32]) -> Self {
        let uv = |vertex: &u32| self.uvs.get(*vertex as usize).copied().unwrap_or_default();
        Self { uvs: vertices.iter().map(uv).collect(), ..self.clone() }
    }

    /// Returns the bytes of memory beside images and coordinates whose addresses are in `counted`, and adds those.
    pub(super) fn size_bytes_beside(&self, counted: &mut HashSet<usize>) -> u64 {
        let is_new = counted.insert(Arc::as_ptr(&self.image).addr());
        let image = if is_new { self.image.size_bytes() } else { 0 };
        let is_new = counted.insert(self.uvs.as_ptr().addr());
        image + if is_new { size_of_val::<[[f32; 2]]>(&self.uvs) as u64 } else { 0 }
    }
}

/// Returns the texel along an axis of `size` texels at a texture coordinate.
fn texel_index(at: f64, size: u32, wrap: WrapMode) -> usize {
    let at = match wrap {
        // Images of features have no border.
        WrapMode::ClampToEdge | WrapMode::ClampToBorder => at,

        WrapMode::Repeat => at - at.floor(),
        WrapMode::Mirror => 1.0 - (at.rem_euclid(2.0) - 1.0).abs(),
    };
    // A cast of NaN or of a negative number is 0.
    ((at * f64::from(size)) as usize).min(size.saturating_sub(1) as usize)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::geometry::Sampling;

    #[test]
    fn the_nearest_texel_is_read_with_the_wrap_modes() {
        let texels: Vec<u8> = (0..6).flat_map(|i| [i, 10 + i, 20 + i, 30 + i]).collect();
        let image = |wrap| {
            let sampling = Sampling { wrap: [wrap; 2], ..Sampling::default() };
            Arc::new(Texture { sampling, ..Texture::rgba8(3, 2, vec![texels.clone()]) })
        };
        let corner = |u: f32, v: f32| -> Arc<[[f32; 2]]> { [[u, v], [0.0; 2], [0.0; 2]].into() };
        let at = SurfacePoint { vertices: [0, 1, 2], weights: [1.0, 0.0, 0.0] };
        let read = |wrap, u, v| DataTexture::new(image(wrap), [0].into(), corner(u, v)).unwrap().texel(&at).unwrap()[0];
        for (u, v, clamped, repeated, mirrored) in [
            (0.1, 0.1, 0, 0, 0),
            (0.5, 0.9, 4, 4, 4),
            (1.2, 0.4, 2, 0, 2),
            (-0.2, 1.2, 3, 2, 3),
            (2.4, -0.8, 2, 1, 4),
            (f32::NAN, f32::INFINITY, 3, 0, 0),
        ] {
            let found = [WrapMode::ClampToEdge, WrapMode::Repeat, WrapMode::Mirror].map(|wrap| read(wrap, u, v));
            assert_eq!(found, [clamped, repeated, mirrored], "{u} {v}");
        }
        // Several channels, and a point between the corners.
        let uvs: Arc<[[f32; 2]]> = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]].into();
        let two = DataTexture::new(image(WrapMode::ClampToEdge), [2, 0].into(), uvs.clone()).unwrap();
        let at = |weights| SurfacePoint { vertices: [0, 1, 2], weights };
        assert_eq!(two.texel(&at([0.1, 0.4, 0.5])), Some(vec![24, 4]));
        assert_eq!(two.texel(&SurfacePoint { vertices: [0, 1, 3], weights: [1.0, 0.0, 0.0] }), None);
        assert_eq!(
            two.with_vertices(&[2, 1]).texel(&SurfacePoint { vertices: [0; 3], weights: [1.0, 0.0, 0.0] }).unwrap(),
            [23, 3]
        );
        let nearest = [[0.5, 0.3, 0.2], [0.2, 0.5, 0.3], [0.3, 0.2, 0.5]].map(|weights| at(weights).nearest_vertex());
        assert_eq!(nearest, [0, 1, 2]);
        for channels in [&[][..], &[4], &[0, 1, 2, 3, 0]] {
            assert!(DataTexture::new(image(WrapMode::Repeat), channels.into(), uvs.clone()).is_none());
        }
        let short = Arc::new(Texture::rgba8(2, 2, vec![vec![0; 15]]));
        assert!(DataTexture::new(short, [0].into(), uvs).is_none());
    }
}
