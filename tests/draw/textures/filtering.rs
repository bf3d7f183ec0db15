//! Images at a flat angle: anisotropic filtering keeps their detail across the view.

use std::sync::Arc;

use glam::{DAffine3, DVec3};
use image::RgbaImage;
use kit::frames::pixel;
use kit::rig::{camera, plain, rig_with, traits};
use kit::shapes::with_mips;
use terrane::gpu::ContextTraits;
use terrane::math::Aabb;
use terrane::scene::{Drawable, Geometry, HeightTile, Material, Mesh, Node, Texture};

const SIDE: u32 = 256;
/// Width and length of the ground in metres.
const GROUND: [f64; 2] = [40.0, 400.0];

/// Returns an image of stripes along v, 8 texels wide.
fn stripes() -> Option<Arc<Texture>> {
    let texels = (0..256 * 256u32).flat_map(|i| if i % 16 < 8 { [255, 255, 255, 255] } else { [0, 0, 0, 255] });
    Some(Arc::new(with_mips(256, 256, texels.collect())))
}

fn unlit(texture: Option<Arc<Texture>>) -> Material {
    Material { texture, unlit: true, double_sided: true, ..Material::default() }
}

/// Returns a flat height tile around the origin. A plane is a tile at the pole of a vast earth.
fn flat_tile() -> Node {
    let (side, p0) = (17u32, 1e9f64);
    let part = |i: u32| f64::from(i) / f64::from(side - 1) - 0.5;
    let [width, length] = GROUND;
    let half = DVec3::new(0.5 * width, 0.5 * length, 1.0);
    let tile = HeightTile {
        side,
        heights: vec![0.0; ((side + 2) * (side + 2)) as usize],
        rows: (0..side).map(|j| [(-part(j) * length) as f32, 0.0, 0.0, 1.0]).collect(),
        columns: (0..side).map(|i| [(part(i) * width / p0) as f32, 0.0]).collect(),
        p0_m: p0 as f32,
        level: 0,
        coarser_errors_m: Vec::new(),
        skirt_m: 0.0,
        cell_m: GROUND.map(|size| (size / f64::from(side - 1)) as f32),
        texture: stripes(),
        bounds: Aabb { min: -half, max: half },
    };
    let drawable = Drawable::new(Geometry::Height(Arc::new(tile)), unlit(None));
    Node::transform(DAffine3::from_scale(DVec3::new(1.0, -1.0, 1.0)), vec![Node::geode(vec![drawable])])
}

/// Returns the difference of the brightest and the darkest pixel of a row of the ground, 100 m from the eye.
fn contrast(picture: &RgbaImage) -> u8 {
    let row: Vec<u8> = (100..156).map(|x| pixel(picture, x, 133)[1]).collect();
    row.iter().max().unwrap() - row.iter().min().unwrap()
}

#[test]
fn images_keep_detail_at_flat_angles() {
    let traits = ContextTraits { max_anisotropy: Some(16), ..traits([SIDE, SIDE]) };
    let Some(mut rig) = rig_with(&traits) else { return };
    let [width, length] = GROUND;
    let corner = DVec3::new(-0.5 * width, -0.5 * length, 0.0);
    let mesh = Mesh::rectangle(corner, width * DVec3::X, length * DVec3::Y);
    let mesh = Node::geode(vec![Drawable::new(mesh.into(), unlit(stripes()))]);
    let eye = DVec3::new(0.0, -0.5 * length, 2.0);
    let camera = camera([SIDE, SIDE], eye, eye + DVec3::Y, DVec3::Z);
    for (name, ground) in [("mesh", mesh), ("height tile", flat_tile())] {
        let scene = rig.scene(ground);
        let picture = rig.picture(&scene, &camera, &plain());
        rig.release(scene);
        kit::frames::keep(&format!("filtering_{}", name.replace(' ', "_")), &picture);
        assert!(contrast(&picture) > 90, "{name}: the stripes differ by {}", contrast(&picture));
    }
}
