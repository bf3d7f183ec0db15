//! The metallic-roughness model: each map and factor, beside the matte model, and how its content is shared.

use std::sync::Arc;

use glam::{Affine2, DAffine3, DVec3, Mat2, Vec2};
use image::RgbaImage;
use kit::frames::{assert_picture, differ, pixel};
use kit::rig::{Rig, camera, plain, rig, unit_camera};
use kit::shadows::small_maps;
use kit::shapes::{quad, with_mips};
use terrane::scene::{
    AlphaMode, AttributeFormat, Clearcoat, Dielectric, DistanceFog, Drawable, Environment, Geometry, MapParts,
    Material, Mesh, MetallicRoughness, Node, OverlayMode, SecondUv, Texture,
};
use terrane::state::{Attribute, Mode, StateSet, StateValue, SurfaceMaterial};

const SIDE: u32 = 32;

/// Returns a square of half a metre around the origin that faces +z. A square of few triangles is pulled by the shader; a
/// fine one has vertex buffers.
fn square(material: &Material, is_fine: bool) -> Drawable {
    let mut drawable = quad([0.0; 3], [0.5, 0.5], [1.0; 4]);
    if is_fine && let Geometry::Mesh(mesh) = &mut drawable.geometry {
        let indices = std::iter::repeat_n(mesh.indices.iter().copied(), 12).flatten().collect::<Vec<_>>();
        *mesh = Arc::new(Mesh { indices: indices.into(), ..Mesh::clone(mesh) });
    }
    drawable.material = material.clone();
    drawable
}

fn surface(change: impl FnOnce(&mut MetallicRoughness)) -> Material {
    let mut surface = MetallicRoughness::default();
    change(&mut surface);
    Material { base_color: [0.5, 0.5, 0.5, 1.0], metallic_roughness: Some(surface), ..Material::default() }
}

fn texels(rgba: [u8; 4]) -> Option<Arc<Texture>> {
    Some(Arc::new(with_mips(8, 8, rgba.repeat(64))))
}

/// Returns light without air: a sun from a direction, and a weak sky.
fn lit_from(sun: DVec3) -> Environment {
    Environment { sun_direction: sun.normalize(), sun_color: [0.8; 3], ambient_color: [0.1; 3], ..plain() }
}

fn draw(rig: &mut Rig, material: &Material, environment: &Environment) -> RgbaImage {
    draw_node(rig, Node::geode(vec![square(material, false)]), environment)
}

fn draw_node(rig: &mut Rig, node: Node, environment: &Environment) -> RgbaImage {
    let scene = rig.scene(node);
    let picture = rig.picture(&scene, &unit_camera(SIDE), environment);
    rig.release(scene);
    picture
}

/// Returns the color of the middle of a square.
fn middle(rig: &mut Rig, material: &Material, environment: &Environment) -> [u8; 3] {
    pixel(&draw(rig, material, environment), SIDE / 2, SIDE / 2)
}

fn sum(color: [u8; 3]) -> i32 {
    color.iter().map(|part| i32::from(*part)).sum()
}

#[test]
fn rough_surface_looks_much_like_a_matte_one() {
    let Some(mut rig) = rig("rough_surface_looks_much_like_a_matte_one") else { return };
    let environment = lit_from(DVec3::new(0.5, 0.0, 1.0));
    let matte = Material { metallic_roughness: None, ..surface(|_| ()) };
    let (matte, rough) = (middle(&mut rig, &matte, &environment), middle(&mut rig, &surface(|_| ()), &environment));
    assert!(sum(matte) > 300 && (sum(matte) - sum(rough)).abs() < 24, "{matte:?} {rough:?}");
}

#[test]
fn emission_is_added_and_multiplied_by_its_map() {
    let Some(mut rig) = rig("emission_is_added_and_multiplied_by_its_map") else { return };
    let dark = Environment { sun_color: [0.0; 3], ambient_color: [0.0; 3], ..plain() };
    let emissive = surface(|s| s.emissive = [0.0, 1.0, 1.0]);
    assert_eq!(middle(&mut rig, &emissive, &dark), [0, 255, 255]);
    let mapped = surface(|s| (s.emissive, s.emissive_map) = ([1.0; 3], texels([255, 0, 128, 255])));
    let [red, green, blue] = middle(&mut rig, &mapped, &dark);
    assert!(red == 255 && green == 0 && blue.abs_diff(128) < 3, "sRGB texels keep their color: {red} {green} {blue}");
    let unlit = Material { unlit: true, ..mapped };
    let gray = middle(&mut rig, &unlit, &dark);
    assert!(gray[0] == gray[1] && gray[0].abs_diff(188) < 3, "an unlit material has its base color: {gray:?}");
}

#[test]
fn normal_map_turns_the_surface_along_its_axes() {
    let Some(mut rig) = rig("normal_map_turns_the_surface_along_its_axes") else { return };
    let mut with = |texel: [u8; 4], scale: f32, sun: DVec3| {
        let bent = surface(|s| (s.normal_map, s.normal_scale) = (texels(texel), scale));
        sum(middle(&mut rig, &bent, &lit_from(sun)))
    };
    // u is +x. Rows of the image go down, which is -y.
    let (right, up) = (DVec3::new(1.0, 0.0, 0.5), DVec3::new(0.0, 1.0, 0.5));
    let flat = [with([128, 128, 255, 255], 1.0, right), with([128, 128, 255, 255], 1.0, up)];
    assert!((flat[0] - flat[1]).abs() < 12, "{flat:?}");
    assert!(with([218, 128, 218, 255], 1.0, right) > flat[0] + 60, "red faces along u");
    assert!(with([38, 128, 218, 255], 1.0, right) < flat[0] - 60);
    assert!(with([128, 218, 218, 255], 1.0, up) > flat[0] + 60, "green faces against v");
    assert!(with([128, 38, 218, 255], 1.0, up) < flat[0] - 60);
    assert!((with([218, 128, 218, 255], 0.0, right) - flat[0]).abs() < 6, "a scale of 0 leaves the surface flat");
}

#[test]
fn occlusion_darkens_the_sky_but_not_the_sun() {
    let Some(mut rig) = rig("occlusion_darkens_the_sky_but_not_the_sun") else { return };
    let sky_only = Environment { sun_color: [0.0; 3], ambient_color: [0.8; 3], ..plain() };
    let occluded = |strength| {
        surface(|s| {
            (s.occlusion_roughness_metallic, s.occlusion_strength) = (texels([0, 255, 0, 255]), strength);
        })
    };
    assert_eq!(middle(&mut rig, &occluded(1.0), &sky_only), [0; 3]);
    let open = sum(middle(&mut rig, &occluded(0.0), &sky_only));
    assert!(open > 300, "{open}");
    let sun_only = Environment { ambient_color: [0.0; 3], ..lit_from(DVec3::Z) };
    let under_sun = [occluded(1.0), occluded(0.0)].map(|material| middle(&mut rig, &material, &sun_only));
    assert_eq!(under_sun[0], under_sun[1]);
}

/// Each half of the square shows a half of the maps; which one follows from the texture coordinates of each map.
#[test]
fn maps_use_second_texture_coordinates() {
    let Some(mut rig) = rig("maps_use_second_texture_coordinates") else { return };
    let halves: Vec<u8> = (0..64).flat_map(|i| if i % 8 < 4 { [255; 4] } else { [0, 0, 0, 255] }).collect();
    let map = Some(Arc::new(with_mips(8, 8, halves)));
    let lit = Environment { sun_color: [0.0; 3], ambient_color: [0.8; 3], ..plain() };
    let mirror = Affine2 { matrix2: Mat2::from_diagonal(Vec2::new(-1.0, 1.0)), translation: Vec2::X };
    let mut sides = |second: SecondUv, mirrored_attribute: Option<bool>, is_fine: bool| {
        let mut material = surface(|s| {
            (s.emissive, s.emissive_map, s.occlusion_map) = ([0.5; 3], map.clone(), map.clone());
            s.second_uv = second;
        });
        material.base_color = [0.0, 0.5, 0.0, 1.0];
        let mut square = square(&material, is_fine);
        if let (Some(is_mirrored), Geometry::Mesh(mesh)) = (mirrored_attribute, &mut square.geometry) {
            let uvs: Vec<[f32; 2]> = mesh
                .vertices
                .iter()
                .map(|vertex| [if is_mirrored { 1.0 - vertex.uv[0] } else { vertex.uv[0] }, vertex.uv[1]])
                .collect();
            let with = Mesh::clone(mesh).with_attribute(SecondUv::ATTRIBUTE, AttributeFormat::Float32x2, &uvs);
            *mesh = Arc::new(with.unwrap());
        }
        let picture = draw_node(&mut rig, Node::geode(vec![square]), &lit);
        // Red is emission alone; green that is more than red is the light of the sky, which occlusion takes away.
        [3 * SIDE / 8, 5 * SIDE / 8].map(|x| {
            let [red, green, _] = pixel(&picture, x, SIDE / 2);
            (red > 100, green > red.saturating_add(20))
        })
    };
    for is_fine in [false, true] {
        let first = sides(SecondUv::default(), None, is_fine);
        assert_eq!(first, [(true, true), (false, false)], "{is_fine}");
        // Mirrored coordinates of the mesh, for one map.
        let second = SecondUv { occlusion: Some(Affine2::IDENTITY), ..SecondUv::default() };
        assert_eq!(sides(second, Some(true), is_fine), [(true, false), (false, true)], "{is_fine}");
        let second = SecondUv { emissive: Some(Affine2::IDENTITY), ..SecondUv::default() };
        assert_eq!(sides(second, Some(true), is_fine), [(false, true), (true, false)], "{is_fine}");
        // A mirroring transform of the map, with and without the attribute.
        let mirrored = SecondUv { emissive: Some(mirror), ..SecondUv::default() };
        for attribute in [None, Some(false)] {
            assert_eq!(sides(mirrored, attribute, is_fine), [(false, true), (true, false)], "{is_fine}");
        }
    }
}

/// Light maps are multiplied, decals lie over the surface, and glows are added as they are displayed.
#[test]
fn overlays_are_laid_over_multiplied_or_added() {
    let Some(mut rig) = rig("overlays_are_laid_over_multiplied_or_added") else { return };
    let shown = |rig: &mut Rig, overlay_mode: OverlayMode| {
        let surface = MetallicRoughness { overlay: texels([128, 64, 255, 128]), overlay_mode, ..Default::default() };
        let material = Material {
            base_color: [1.0; 4],
            texture: texels([100, 200, 40, 255]),
            unlit: true,
            metallic_roughness: Some(surface),
            ..Material::default()
        };
        middle(rig, &material, &plain())
    };
    let near = |got: [u8; 3], expected: [u8; 3]| {
        assert!(got.iter().zip(expected).all(|(a, b)| a.abs_diff(b) <= 4), "{got:?}, expected {expected:?}");
    };
    near(shown(&mut rig, OverlayMode::Multiply), [50, 50, 40]);
    near(shown(&mut rig, OverlayMode::Add), [228, 255, 255]);
    // Half of each in linear light.
    near(shown(&mut rig, OverlayMode::Over), [115, 151, 188]);
}

#[test]
fn smooth_surface_mirrors_the_sun_and_a_rough_one_spreads_it() {
    let Some(mut rig) = rig("smooth_surface_mirrors_the_sun_and_a_rough_one_spreads_it") else { return };
    let environment = Environment { ambient_color: [0.0; 3], ..lit_from(DVec3::Z) };
    let metal = |roughness: f32| {
        let mut metal = surface(|s| (s.metallic, s.roughness) = (1.0, roughness));
        metal.base_color = [0.2, 0.1, 0.05, 1.0];
        let mesh = Mesh::sphere(DVec3::ZERO, 0.9, 48);
        Node::geode(vec![Drawable::new(mesh.into(), metal)])
    };
    let [smooth, rough] = [0.25, 0.8].map(|r| draw_node(&mut rig, metal(r), &environment));
    let [peak, edge] = [SIDE / 2, SIDE / 2 + 9].map(|x| [&smooth, &rough].map(|p| sum(pixel(p, x, SIDE / 2))));
    assert!(peak[0] > peak[1] + 60 && edge[0] < edge[1], "middle {peak:?}, beside it {edge:?}");
    let [red, green, blue] = pixel(&rough, SIDE / 2, SIDE / 2);
    assert!(red > green && green > blue, "a metal tints what it reflects");
}

/// Returns a ball of a material.
fn ball(material: Material) -> Node {
    Node::geode(vec![Drawable::new(Mesh::sphere(DVec3::ZERO, 0.9, 32).into(), material)])
}

/// The default values are those of the plain shader: another shader that is given nearly the same draws the same.
#[test]
fn layers_that_change_nothing_are_not_seen() {
    let Some(mut rig) = rig("layers_that_change_nothing_are_not_seen") else { return };
    let mut with = |change: fn(&mut MetallicRoughness)| {
        let material = surface(|s| {
            (s.roughness, s.metallic) = (0.4, 0.3);
            s.normal_map = texels([150, 110, 230, 255]);
            change(s);
        });
        draw_node(&mut rig, ball(material), &lit_from(DVec3::new(0.4, 0.2, 1.0)))
    };
    let plain = with(|_| ());
    let near = with(|s| s.dielectric.ior = 1.5001);
    assert!(differ(&plain, &near, 1) == 0 && differ(&plain, &with(|s| s.dielectric.ior = 2.2), 1) > 50);
    let uncoated = with(|s| (s.clearcoat.strength, s.clearcoat.map) = (1.0, texels([0, 255, 0, 255])));
    assert_eq!(differ(&plain, &uncoated, 1), 0, "a map takes the coat away");
}

#[test]
fn refraction_and_specular_factors_change_the_highlight() {
    let Some(mut rig) = rig("refraction_and_specular_factors_change_the_highlight") else { return };
    let environment = Environment { ambient_color: [0.0; 3], ..lit_from(DVec3::Z) };
    let mut highlight = |metallic: f32, change: fn(&mut MetallicRoughness)| {
        let mut material = surface(|s| {
            (s.roughness, s.metallic) = (0.6, metallic);
            change(s);
        });
        // Without diffuse light.
        material.base_color = [metallic, metallic, metallic, 1.0];
        pixel(&draw_node(&mut rig, ball(material), &environment), SIDE / 2, SIDE / 2)
    };
    let glass = sum(highlight(0.0, |_| ()));
    assert!(glass > 60, "{glass}");
    assert_eq!(highlight(0.0, |s| s.dielectric.ior = 1.0), [0; 3], "air reflects nothing");
    let diamond = sum(highlight(0.0, |s| s.dielectric.ior = 2.4));
    assert!(diamond > glass + 60, "{diamond} {glass}");
    assert_eq!(highlight(0.0, |s| s.dielectric.specular = 0.0), [0; 3]);
    let half = sum(highlight(0.0, |s| s.dielectric.specular = 0.5));
    assert!(half > 20 && half < glass - 20, "{half} {glass}");
    let [red, green, blue] = highlight(0.0, |s| s.dielectric.specular_color = [1.0, 0.25, 0.0]);
    assert!(red > green && green > 5 && blue < 2, "the colour tints it: {red} {green} {blue}");
    let metal = highlight(0.5, |_| ());
    assert_ne!(metal, highlight(0.5, |s| s.dielectric.specular_color = [1.0, 0.0, 0.0]));
    assert_eq!(highlight(1.0, |_| ()), highlight(1.0, |s| s.dielectric.ior = 1.0), "metals have their own");
    let nothing = highlight(0.0, |s| {
        s.dielectric = Dielectric { ior: f32::NAN, specular: f32::INFINITY, ..Dielectric::default() };
        s.clearcoat = Clearcoat { strength: f32::NAN, ..Clearcoat::default() };
    });
    assert_eq!(sum(nothing), glass, "values that are no numbers are those of the default");
}

#[test]
fn clearcoat_adds_a_sharp_highlight_over_a_rough_base() {
    let Some(mut rig) = rig("clearcoat_adds_a_sharp_highlight_over_a_rough_base") else { return };
    let environment = lit_from(DVec3::Z);
    let mut coated = |strength: f32, roughness: f32, emissive: f32| {
        let mut material = surface(|s| {
            s.clearcoat = Clearcoat { strength, roughness, ..Clearcoat::default() };
            s.emissive = [emissive; 3];
        });
        material.base_color = [0.3, 0.0, 0.0, 1.0];
        let picture = draw_node(&mut rig, ball(material), &environment);
        [0, SIDE / 4].map(|beside| pixel(&picture, SIDE / 2 + beside, SIDE / 2))
    };
    let ([bare, bare_side], [sharp, sharp_side], [soft, _]) =
        (coated(0.0, 0.0, 0.0), coated(1.0, 0.2, 0.0), coated(1.0, 0.7, 0.0));
    assert!(bare[1] < 40 && sharp[1] > bare[1] + 60, "a white highlight: {bare:?} {sharp:?}");
    assert!(sharp_side[1].abs_diff(bare_side[1]) < 30, "none beside it: {bare_side:?} {sharp_side:?}");
    assert!(soft[1] > bare[1] && sharp[1] > soft[1] + 30, "a rough coat spreads it: {soft:?} {sharp:?}");
    let [_, half_side] = coated(0.5, 0.2, 0.0);
    assert!(
        half_side[0] <= bare_side[0] && half_side[0] >= sharp_side[0],
        "{bare_side:?} {half_side:?} {sharp_side:?}"
    );
    let [glowing, coated_glow] = [coated(0.0, 0.2, 0.5), coated(1.0, 0.2, 0.5)].map(|[_, side]| side[0]);
    assert!(coated_glow < glowing, "the coat takes some of what the base emits");
}

/// Each map lies on one half of the square. Their coordinates may be the second ones.
#[test]
fn layers_have_maps() {
    let Some(mut rig) = rig("layers_have_maps") else { return };
    let environment = Environment { ambient_color: [0.0; 3], ..lit_from(DVec3::Z) };
    let halves = |left: [u8; 4], right: [u8; 4]| {
        let texels = (0..64).flat_map(|i| if i % 8 < 4 { left } else { right }).collect();
        Some(Arc::new(with_mips(8, 8, texels)))
    };
    let mirror = Affine2 { matrix2: Mat2::from_diagonal(Vec2::new(-1.0, 1.0)), translation: Vec2::X };
    let mut sides = |change: &dyn Fn(&mut MetallicRoughness)| {
        let mut material = surface(|s| {
            s.roughness = 0.5;
            change(s);
        });
        material.base_color = [0.0, 0.0, 0.0, 1.0];
        let pictures = [false, true].map(|is_fine| {
            let square = square(&material, is_fine);
            draw_node(&mut rig, Node::geode(vec![square]), &environment)
        });
        assert_eq!(differ(&pictures[0], &pictures[1], 0), 0, "pulled vertices and vertex buffers");
        [3 * SIDE / 8, 5 * SIDE / 8].map(|x| pixel(&pictures[0], x, SIDE / 2).map(|part| part > 10))
    };
    let (none, all, red) = ([false; 3], [true; 3], [true, false, false]);
    let map = halves([255, 0, 0, 255], [255, 255, 255, 0]);
    let mut specular = |map_parts: MapParts, dielectric: Option<Affine2>| {
        sides(&|s| {
            s.dielectric = Dielectric { map: map.clone(), map_parts, ..Dielectric::default() };
            s.second_uv = SecondUv { dielectric, ..SecondUv::default() };
        })
    };
    assert_eq!(specular(MapParts::Both, None), [red, none]);
    assert_eq!(specular(MapParts::First, None), [red, all]);
    assert_eq!(specular(MapParts::Second, None), [all, none]);
    assert_eq!(specular(MapParts::Both, Some(mirror)), [none, red]);
    // The base reflects nothing. A coat of full roughness has a weak highlight.
    let map = halves([255, 255, 0, 255], [0, 0, 0, 255]);
    let mut coat = |map_parts: MapParts, clearcoat: Option<Affine2>| {
        sides(&|s| {
            s.dielectric.ior = 1.0;
            s.clearcoat =
                Clearcoat { strength: 1.0, roughness: 1.0, map: map.clone(), map_parts, ..Clearcoat::default() };
            s.second_uv = SecondUv { clearcoat, ..SecondUv::default() };
        })
    };
    assert_eq!(coat(MapParts::First, None), [all, none]);
    assert_eq!(coat(MapParts::Second, None), [all, all]);
    assert_eq!(coat(MapParts::First, Some(mirror)), [none, all]);
}

/// A coat fills the bumps of its base, and may have its own.
#[test]
fn coat_has_its_own_normals() {
    let Some(mut rig) = rig("coat_has_its_own_normals") else { return };
    let environment = Environment { ambient_color: [0.0; 3], ..lit_from(DVec3::Z) };
    let bump = || texels([218, 128, 218, 255]);
    let mut highlight = |base: Option<Arc<Texture>>, normal_map: Option<Arc<Texture>>, normal_scale: f32| {
        let mut material = surface(|s| {
            s.dielectric.ior = 1.0;
            s.clearcoat = Clearcoat { strength: 1.0, roughness: 0.3, normal_map, normal_scale, ..Clearcoat::default() };
            s.normal_map = base;
        });
        material.base_color = [0.0, 0.0, 0.0, 1.0];
        sum(middle(&mut rig, &material, &environment))
    };
    let smooth = [highlight(bump(), None, 1.0), highlight(None, bump(), 0.0)];
    let bent = [highlight(bump(), bump(), 1.0), highlight(None, bump(), 1.0)];
    assert!(smooth.iter().all(|of| *of > 300) && bent.iter().all(|of| *of < 60), "{smooth:?} {bent:?}");
}

#[test]
fn back_faces_are_lit_as_seen() {
    let Some(mut rig) = rig("back_faces_are_lit_as_seen") else { return };
    let material = Material { double_sided: true, ..surface(|_| ()) };
    let half_turn = DAffine3::from_rotation_y(std::f64::consts::PI);
    let back = Node::transform(half_turn, vec![Node::geode(vec![square(&material, false)])]);
    let environment = lit_from(DVec3::new(0.3, 0.2, 1.0));
    let (front, back) = (draw(&mut rig, &material, &environment), draw_node(&mut rig, back, &environment));
    assert_eq!(differ(&front, &back, 1), 0);
}

#[test]
fn small_meshes_shadows_masks_and_other_states_draw() {
    let Some(mut rig) = rig("small_meshes_shadows_masks_and_other_states_draw") else { return };
    let full = surface(|s| {
        s.normal_map = texels([170, 100, 220, 255]);
        s.occlusion_roughness_metallic = texels([200, 90, 128, 255]);
        (s.emissive, s.emissive_map) = ([0.2; 3], texels([80, 20, 10, 255]));
    });
    let environment = lit_from(DVec3::new(0.3, 0.2, 1.0));
    let geode = |material: &Material, is_fine| Node::geode(vec![square(material, is_fine)]);
    let pulled = draw_node(&mut rig, geode(&full, false), &environment);
    assert_eq!(differ(&pulled, &draw_node(&mut rig, geode(&full, true), &environment), 0), 0);
    let shadowed = Environment { shadows: small_maps(), ..environment };
    assert!(differ(&pulled, &draw_node(&mut rig, geode(&full, true), &shadowed), 2) < 40, "nothing casts on it");
    let mut coated = full.clone();
    coated.metallic_roughness.as_mut().unwrap().clearcoat.strength = 1.0;
    let [lit, in_shadow_maps] = [&environment, &shadowed].map(|of| draw_node(&mut rig, geode(&coated, true), of));
    assert!(differ(&lit, &in_shadow_maps, 2) < 40 && differ(&lit, &pulled, 2) > 100);

    let holes = Material { texture: texels([255, 255, 255, 40]), alpha: AlphaMode::Mask(0.5), ..full.clone() };
    let empty = draw_node(&mut rig, Node::group(Vec::new()), &environment);
    assert_eq!(differ(&empty, &draw_node(&mut rig, geode(&holes, false), &shadowed), 0), 0);

    // The fixed function draws the same as without a surface.
    let fixed = StateSet::default().with(Attribute::SurfaceMaterial(SurfaceMaterial::default()));
    let fixed = Arc::new(fixed);
    let matte = Material { metallic_roughness: None, ..full.clone() };
    let [a, b] = [&full, &matte]
        .map(|material| draw_node(&mut rig, geode(material, false).with_state_set(fixed.clone()), &environment));
    assert_eq!(differ(&a, &b, 0), 0);

    let dark = StateSet::default().with_mode(Mode::Lighting, StateValue::OFF);
    let unlit = draw_node(&mut rig, geode(&full, false).with_state_set(Arc::new(dark)), &environment);
    assert!(pixel(&unlit, SIDE / 2, SIDE / 2)[0].abs_diff(188) < 3, "without lighting, the base color");
}

#[test]
fn maps_are_shared_counted_and_freed() {
    let Some(mut rig) = rig("maps_are_shared_counted_and_freed") else { return };
    // The white texel stays for good.
    let scene = rig.scene(Node::geode(vec![square(&Material::default(), false)]));
    rig.release(scene);
    let base = rig.ctx.bytes_in_use();
    let map = Some(Arc::new(with_mips(256, 256, vec![200; 256 * 256 * 4])));
    let map_bytes = map.iter().flat_map(|map| &map.mips).map(|mip| mip.len() as u64).sum::<u64>();
    let both = surface(|s| (s.normal_map, s.occlusion_roughness_metallic) = (map.clone(), map.clone()));
    let squares = (0..3).map(|i| square(&both, i == 2)).collect();
    let scene = rig.scene(Node::geode(squares));
    let used = rig.ctx.bytes_in_use() - base;
    assert!((map_bytes..map_bytes + 10_000).contains(&used), "one copy of {map_bytes} bytes: {used}");
    // The same image as colors is another texture.
    let colors = Material { texture: map.clone(), ..both };
    let other = rig.scene(Node::geode(vec![square(&colors, false)]));
    let used = rig.ctx.bytes_in_use() - base;
    assert!((2 * map_bytes..2 * map_bytes + 10_000).contains(&used), "two copies of {map_bytes} bytes: {used}");
    rig.release(scene);
    rig.release(other);
    assert_eq!(rig.ctx.bytes_in_use(), base);
}

/// Draws balls of rising roughness, of plastic above and of gold below, and a wall with a normal map, under the sky.
#[test]
fn balls_by_roughness_and_a_bumpy_wall() {
    let Some(mut rig) = rig("balls_by_roughness_and_a_bumpy_wall") else { return };
    let mut nodes = Vec::new();
    for (row, metallic, base_color) in [(0, 0.0, [0.5, 0.05, 0.04, 1.0]), (1, 1.0, [1.0, 0.71, 0.29, 1.0])] {
        for column in 0..5u8 {
            let mut material = surface(|s| (s.metallic, s.roughness) = (metallic, f32::from(column) / 4.0));
            material.base_color = base_color;
            let at = DVec3::new(2.2 * (f64::from(column) - 2.0), 0.0, 1.1 - 2.2 * f64::from(row));
            let ball = Drawable::new(Mesh::sphere(at, 1.0, 48).into(), material);
            nodes.push(Node::geode(vec![ball]));
        }
    }
    let bumps = (0..64u32 * 64).flat_map(|i| {
        let slope = |k: u32| (f64::from(k % 16) / 8.0 - 1.0) * 100.0 + 127.5;
        [slope(i % 64) as u8, (255.0 - slope(i / 64)) as u8, 200, 255]
    });
    let bumps = Some(Arc::new(with_mips(64, 64, bumps.collect())));
    let mut wall = surface(|s| (s.normal_map, s.roughness) = (bumps, 0.4));
    wall.base_color = [0.35, 0.4, 0.45, 1.0];
    let wall_mesh = Mesh::rectangle(DVec3::new(-6.0, 1.5, -2.3), 12.0 * DVec3::X, 5.0 * DVec3::Z);
    nodes.push(Node::geode(vec![Drawable::new(wall_mesh.into(), wall)]));
    let scene = rig.scene(Node::group(nodes));
    let camera = camera([480, 240], DVec3::new(0.0, -5.5, 0.5), DVec3::ZERO, DVec3::Z);
    let fog = DistanceFog { enabled: true, density_per_m: 3e-6 };
    let environment = Environment { exposure: Some(1.2), fog, ..Environment::default() };
    let picture = rig.picture(&scene, &camera, &environment);
    rig.release(scene);
    assert_picture("surfaces", &picture);
}
