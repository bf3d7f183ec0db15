//! Light of the fixed function in pixels: lights, materials, the light model.

use std::sync::Arc;

use crate::lighting::*;
use glam::dcamera::rh::proj::directx as proj;
use glam::{DAffine3, DVec3};
use kit::frames::{count, pixel};
use kit::rig::{Rig, camera, plain, rig, unit_camera};
use kit::shapes::quad;
use kit::terrain::Terrain;
use terrane::cull::CullCamera;
use terrane::scene::{
    Drawable, Geometry, LightSource, Material, Mesh, MeshVertex, Node, NodeKind, ReferenceFrame, Topology,
};
use terrane::state::{
    Attribute, ColorControl, Light, LightModel, Mode, StateSet, StateValue, SurfaceMaterial, TexGen, TextureObject,
};

/// Returns an orthographic camera, 1 m in front of the drawables, with the same image as the camera of other tests.
fn parallel_camera() -> CullCamera {
    CullCamera {
        eye_from_world: DAffine3::from_translation(DVec3::new(0.0, 0.0, -1.0)),
        clip_from_eye: proj::orthographic(-1.0, 1.0, -1.0, 1.0, 100.0, 0.0),
        ..unit_camera(SIDE)
    }
}

#[test]
fn lights_shine_from_their_position() {
    let Some(mut rig) = rig("lights_shine_from_their_position") else { return };
    let rig = &mut *rig;
    let mut lit = |l: Light| middle(rig, vec![light(l), node(square(WHITE), only_light_1())]);
    let toward = |x: f64, z: f64| Light { position: [x, 0.0, z, 0.0], ..Light::default() };
    assert_near(lit(toward(0.0, 1.0)), [1.0; 3], "straight");
    assert_near(lit(toward(3f64.sqrt(), 1.0)), [0.5; 3], "60 degrees aside");
    assert_near(lit(toward(0.0, -1.0)), [0.0; 3], "from behind");
    assert_near(lit(Light { ambient: [0.25; 3], ..toward(0.0, -1.0) }), [0.25; 3], "ambient");
    let lamp = Light { position: [0.0, 0.0, 2.0, 1.0], attenuation: [0.0, 1.0, 0.0], ..Light::default() };
    assert_near(lit(lamp), [0.5; 3], "2 m away, falling off linearly");
    let quadratic = Light { attenuation: [0.0, 0.0, 1.0], ..lamp };
    assert_near(lit(quadratic), [0.25; 3], "and with the square of the distance");
    let spot = |direction, exponent| Light {
        position: [0.0, 0.0, 2.0, 1.0],
        direction,
        spot_cutoff: 0.3,
        spot_exponent: exponent,
        ..Light::default()
    };
    assert_near(lit(spot([0.0, 0.0, -1.0], 0.0)), [1.0; 3], "in the cone");
    assert_near(lit(spot([0.5, 0.0, -1.0], 0.0)), [0.0; 3], "beside the cone");
    let cosine = 1.0 / (1.0f32 + 0.04).sqrt();
    assert_near(lit(spot([0.2, 0.0, -1.0], 8.0)), [cosine.powi(8); 3], "falling off towards the rim");
}

#[test]
fn lights_move_with_their_parent_and_can_be_switched() {
    let Some(mut rig) = rig("lights_move_with_their_parent_and_can_be_switched") else { return };
    let rig = &mut *rig;
    let from_x = Light { position: [1.0, 0.0, 0.0, 0.0], ..Light::default() };
    let turned = Node::transform(DAffine3::from_rotation_y(-std::f64::consts::FRAC_PI_2), vec![light(from_x)]);
    assert_near(middle(rig, vec![turned, node(square(WHITE), only_light_1())]), [1.0; 3], "rotated to z");
    // Without lighting a surface has its plain colour. Unlit materials follow only an override.
    let unlit = quad([0.0; 3], [0.5; 2], WHITE);
    let off = only_light_1().with_mode(Mode::Lighting, StateValue::OFF);
    assert_eq!(middle(rig, vec![node(square([0.0, 1.0, 0.0, 1.0]), off)]), GREEN);
    assert_eq!(middle(rig, vec![node(unlit.clone(), only_light_1())]), [255; 3]);
    let forced = only_light_1().with_mode(Mode::Lighting, StateValue::ON | StateValue::OVERRIDE);
    assert_eq!(middle(rig, vec![node(unlit, forced)]), [0; 3]);
    // A light with the number 0 in the graph replaces the sun for all leaves.
    let blue = Light { number: 0, position: [0.0, 0.0, 1.0, 0.0], diffuse: [0.0, 0.0, 1.0], ..Light::default() };
    let source = LightSource { light: blue, frame: ReferenceFrame::Relative };
    let nodes = vec![Node::new(NodeKind::LightSource(Box::new(source))), Node::geode(vec![square(WHITE)])];
    assert_eq!(middle(rig, nodes), BLUE);
}

#[test]
fn materials_reflect_light() {
    let Some(mut rig) = rig("materials_reflect_light") else { return };
    let rig = &mut *rig;
    let front = Light { position: [0.0, 0.0, 1.0, 0.0], ambient: [0.5; 3], ..Light::default() };
    let mut with = |material: SurfaceMaterial, model: [f32; 3]| {
        let set = only_light_1()
            .with(Attribute::SurfaceMaterial(material))
            .with(Attribute::LightModel(LightModel { ambient: model, ..LightModel::default() }));
        middle(rig, vec![light(Light { diffuse: [0.5; 3], ..front }), node(square(WHITE), set)])
    };
    let dark = SurfaceMaterial { ambient: [0.0; 3], diffuse: [0.0, 0.0, 0.0, 1.0], ..SurfaceMaterial::default() };
    assert_near(with(SurfaceMaterial { ambient: [0.0, 0.5, 0.0], ..dark }, [0.0; 3]), [0.0, 0.25, 0.0], "ambient");
    assert_near(with(SurfaceMaterial { ambient: [0.5; 3], ..dark }, [1.0; 3]), [0.75; 3], "light from everywhere");
    assert_near(with(SurfaceMaterial { diffuse: [1.0, 0.0, 0.0, 1.0], ..dark }, [0.0; 3]), [0.5, 0.0, 0.0], "diffuse");
    assert_near(with(SurfaceMaterial { emission: [0.1, 0.0, 0.3], ..dark }, [0.0; 3]), [0.1, 0.0, 0.3], "emission");
    let shiny = SurfaceMaterial { specular: [0.5, 0.25, 0.0], shininess: 20.0, ..dark };
    // Along the normal the highlight has its full value. The ray of the middle pixel is off by a fraction of a degree.
    assert_near(with(shiny, [0.0; 3]), [0.5, 0.25, 0.0], "specular");
}

/// Regression: glossy materials of old files were dull, since lights of state sets alone made highlights.
#[test]
fn sun_makes_highlights() {
    let Some(mut rig) = rig("sun_makes_highlights") else { return };
    let mut shown = |sun_direction: DVec3, shininess: f32| {
        let shiny = SurfaceMaterial {
            ambient: [0.0; 3],
            diffuse: [0.0, 0.0, 0.0, 1.0],
            specular: [0.5, 0.25, 0.0],
            shininess,
            ..SurfaceMaterial::default()
        };
        let scene = rig.scene(node(square(WHITE), StateSet::default().with(Attribute::SurfaceMaterial(shiny))));
        let environment = terrane::scene::Environment { sun_direction, sun_color: [0.5, 1.0, 1.0], ..plain() };
        let picture = rig.picture(&scene, &unit_camera(SIDE), &environment);
        rig.release(scene);
        pixel(&picture, SIDE / 2, SIDE / 2)
    };
    assert_near(shown(DVec3::Z, 20.0), [0.25, 0.25, 0.0], "towards the eye");
    // Half way between 60 degrees and the eye, the cosine is 0.866.
    let slanted = DVec3::new(0.75f64.sqrt(), 0.0, 0.5);
    assert_near(shown(slanted, 2.0), [0.1875, 0.1875, 0.0], "0.75 of it");
    assert_eq!(shown(DVec3::NEG_Z, 20.0), [0; 3], "from behind");
}

/// Regression: lines had the normal of level ground.
#[test]
fn lines_are_lit_by_their_normals() {
    let Some(mut rig) = rig("lines_are_lit_by_their_normals") else { return };
    let rig = &mut *rig;
    let lines = |normal: [i8; 4]| {
        let end = |i: i16| MeshVertex {
            position: [if i % 2 == 0 { -0.5 } else { 0.5 }, f32::from(i / 2) / 16.0 - 0.5, 0.0],
            uv: [0.0; 2],
            normal,
            color: [255; 4],
        };
        let lines = kit::shapes::mesh((0..32).map(end).collect(), (0..32).collect());
        let mesh = Mesh { topology: Topology::Lines, ..lines };
        Drawable::new(Geometry::Mesh(Arc::new(mesh)), Material::default())
    };
    let mut white = |normal, from: [f64; 3]| {
        let sun = light(Light { position: [from[0], from[1], from[2], 0.0], ..Light::default() });
        let picture = draw(rig, vec![sun, node(lines(normal), only_light_1())]);
        [count(&picture, [255; 3]), count(&picture, [0; 3])].map(|pixels| pixels > 300)
    };
    assert_eq!(white([127, 0, 0, 0], [1.0, 0.0, 0.0]), [true, false], "towards the light");
    assert_eq!(white([-127, 0, 0, 0], [1.0, 0.0, 0.0]), [false, true], "away from it");
    assert_eq!(white([0; 4], [0.0, 0.0, 1.0]), [true, false], "without a normal they face up");
}

/// An invalid light keeps the sun on, and colours that are not finite do not affect the surface.
#[test]
fn invalid_light_leaves_the_sun_on() {
    let Some(mut rig) = rig("invalid_light_leaves_the_sun_on") else { return };
    let rig = &mut *rig;
    let source =
        |light| Node::new(NodeKind::LightSource(Box::new(LightSource { light, frame: ReferenceFrame::Relative })));
    let seen = |rig: &mut Rig, nodes| {
        let scene = rig.scene(Node::group(nodes));
        let pictures = [(); 2].map(|()| rig.picture(&scene, &unit_camera(SIDE), &plain()));
        rig.release(scene);
        (pictures.map(|picture| pixel(&picture, 32, 32)), rig.renderer.take_errors())
    };
    let material =
        SurfaceMaterial { diffuse: [0.6, 0.5, 0.4, 1.0], specular: [0.1; 3], shininess: 2.0, ..Default::default() };
    let nan = [0.0, f32::NAN, 0.0];
    let light = Light { position: [0.0, 0.0, 1.0, 0.0], ..Light::default() };
    let dark = [
        ("position is nowhere", Light { position: [f64::NAN, 0.0, 1.0, 0.0], ..light }),
        ("position is nowhere", Light { position: [0.0, 0.0, 1e300, 1.0], ..light }),
        ("position is nowhere", Light { position: [0.0; 4], ..light }),
        ("color is not finite", Light { ambient: nan, ..light }),
        ("color is not finite", Light { diffuse: nan, ..light }),
        ("color is not finite", Light { specular: nan, ..light }),
        ("attenuation is not finite", Light { attenuation: nan, ..light }),
        ("spot is not finite", Light { spot_cutoff: f32::NAN, ..light }),
        ("spot is not finite", Light { spot_exponent: f32::INFINITY, ..light }),
        ("spot is not finite", Light { direction: [f64::NAN; 3], ..light }),
    ];
    for set in [StateSet::default(), StateSet::default().with(Attribute::SurfaceMaterial(material))] {
        let set = set.with_mode(Mode::Light(1), StateValue::ON);
        let sunlit = middle(rig, vec![node(square(WHITE), set.clone())]);
        assert!(sunlit.iter().any(|c| *c > 20), "{sunlit:?}");
        for (what, light) in dark {
            for number in [0, 1] {
                let nodes = vec![source(Light { number, ..light }), node(square(WHITE), set.clone())];
                let (pixels, errors) = seen(rig, nodes);
                assert_eq!(pixels, [sunlit; 2], "{light:?}");
                // Each is reported once for all its leaves.
                let error = format!("a LightSource: light {number} does not shine: its {what}");
                assert!(errors.is_empty() || errors == [error], "{errors:?}");
            }
        }
    }
    let lit = vec![source(light), node(square(WHITE), StateSet::default())];
    assert_eq!(seen(rig, lit), ([[255; 3]; 2], vec![]), "as a light that shines");
}

/// On a plane seen obliquely from nearby, the highlight differs in each pixel for a local viewer, and is the same
/// everywhere for a distant one.
#[test]
fn highlights_use_a_local_or_a_distant_viewer() {
    let Some(mut rig) = rig("highlights_use_a_local_or_a_distant_viewer") else { return };
    let rig = &mut *rig;
    let dark = SurfaceMaterial { ambient: [0.0; 3], diffuse: [0.0, 0.0, 0.0, 1.0], ..SurfaceMaterial::default() };
    let shiny = SurfaceMaterial { specular: [1.0; 3], shininess: 200.0, ..dark };
    let mut with = |model: Option<LightModel>| {
        let mut set = only_light_1().with(Attribute::SurfaceMaterial(shiny));
        if let Some(model) = model {
            set = set.with(Attribute::LightModel(model));
        }
        let front = light(Light { position: [0.0, 0.0, 1.0, 0.0], ..Light::default() });
        let picture = draw(rig, vec![front, node(square(WHITE), set)]);
        [(32, 32), (17, 17)].map(|(x, y)| pixel(&picture, x, y))
    };
    let far = [[255; 3]; 2];
    assert_eq!(with(None), far);
    assert_eq!(with(Some(LightModel::default())), far);
    let [middle, corner] = with(Some(LightModel { local_viewer: true, ..LightModel::default() }));
    // The ray of the corner is tilted by the offset of the pixel's centre at 10 m; the half angle is half of that.
    let aside = 2f32.sqrt() * (32.0 - 17.5) / 32.0;
    let cosine = ((aside / 10.0).atan() / 2.0).cos();
    assert_eq!(middle, [255; 3]);
    assert_near(corner, [cosine.powi(200); 3], "aside");
}

/// Seen from behind, a surface is lit like its front, or on its own side with a separate material.
#[test]
fn back_faces_are_lit_by_the_light_model() {
    let Some(mut rig) = rig("back_faces_are_lit_by_the_light_model") else { return };
    let rig = &mut *rig;
    let color = |diffuse: [f32; 3]| SurfaceMaterial {
        diffuse: [diffuse[0], diffuse[1], diffuse[2], 1.0],
        ..SurfaceMaterial::default()
    };
    let sides = Attribute::SurfaceMaterials { front: color([1.0, 0.0, 0.0]), back: color([0.0, 1.0, 0.0]) };
    let bare = |mut drawable: Drawable| {
        if let Geometry::Mesh(mesh) = &mut drawable.geometry {
            Arc::make_mut(mesh).vertices.iter_mut().for_each(|v| v.normal = [0; 4]);
        }
        drawable
    };
    let behind = DAffine3::from_rotation_y(std::f64::consts::PI);
    for is_bare in [false, true] {
        let square = || if is_bare { bare(square(WHITE)) } else { square(WHITE) };
        let mut seen = |model: Option<bool>, turned: DAffine3, z: f64| {
            let mut set = only_light_1().with(sides.clone()).with_mode(Mode::CullFace, StateValue::OFF);
            if let Some(two_sided) = model {
                set = set.with(Attribute::LightModel(LightModel { two_sided, ..LightModel::default() }));
            }
            let lamp = light(Light { position: [0.0, 0.0, z, 0.0], ..Light::default() });
            middle(rig, vec![lamp, Node::transform(turned, vec![node(square(), set)])])
        };
        for model in [None, Some(false), Some(true)] {
            assert_eq!(seen(model, DAffine3::IDENTITY, 1.0), RED, "{model:?} {is_bare}");
            assert_eq!(seen(model, DAffine3::IDENTITY, -1.0), [0; 3], "{model:?} {is_bare}");
        }
        // From behind: light from the eye, and light from the far side, towards which the front faces.
        let got = [None, Some(false), Some(true)].map(|model| [1.0, -1.0].map(|z| seen(model, behind, z)));
        assert_eq!(got, [[RED, [0; 3]], [[0; 3], RED], [GREEN, [0; 3]]], "{is_bare}");
    }
}

/// Textures darken highlights unless these are added after them.
#[test]
fn highlights_are_textured_or_added() {
    let Some(mut rig) = rig("highlights_are_textured_or_added") else { return };
    let rig = &mut *rig;
    let dark = SurfaceMaterial { ambient: [0.0; 3], diffuse: [0.0, 0.0, 0.0, 1.0], ..SurfaceMaterial::default() };
    let shiny = SurfaceMaterial { specular: [0.5; 3], emission: [0.25; 3], shininess: 20.0, ..dark };
    let red = TextureObject::image("red", [1, 1], vec![255, 0, 0, 255]);
    let mut with = |color_control, vertex_color| {
        let set = only_light_1()
            .with(Attribute::SurfaceMaterial(shiny))
            .with(Attribute::Texture(0, nearest(red.clone())))
            .with(Attribute::LightModel(LightModel { color_control, ..LightModel::default() }));
        let front = light(Light { position: [0.0, 0.0, 1.0, 0.0], ..Light::default() });
        middle(rig, vec![front, node(square(vertex_color), set)])
    };
    for color in [WHITE, [0.0, 0.0, 0.0, 1.0]] {
        assert_near(with(ColorControl::SingleColor, color), [0.75, 0.0, 0.0], "single colour");
        assert_near(with(ColorControl::SeparateSpecularColor, color), [0.75, 0.5, 0.5], "separate");
    }
}

/// Regression: highlights and reflections were placed as if rays came from one point.
#[test]
fn orthographic_views_have_uniform_highlights_on_a_plane() {
    let Some(mut rig) = rig("orthographic_views_have_uniform_highlights_on_a_plane") else { return };
    let rig = &mut *rig;
    let dark = SurfaceMaterial { ambient: [0.0; 3], diffuse: [0.0, 0.0, 0.0, 1.0], ..SurfaceMaterial::default() };
    let shiny = SurfaceMaterial { specular: [0.5, 0.25, 0.0], shininess: 20.0, ..dark };
    let local = Attribute::LightModel(LightModel { local_viewer: true, ..LightModel::default() });
    let shines = || node(square(WHITE), only_light_1().with(Attribute::SurfaceMaterial(shiny)).with(local.clone()));
    let front = light(Light { position: [0.0, 0.0, 1.0, 0.0], ..Light::default() });
    let mut seen = |nodes: Vec<Node>| {
        let scene = rig.scene(Node::group(nodes));
        let picture = rig.picture(&scene, &parallel_camera(), &plain());
        rig.release(scene);
        [(32, 32), (18, 18), (46, 20)].map(|(x, y)| pixel(&picture, x, y))
    };
    for got in seen(vec![front.clone(), shines()]) {
        assert_near(got, [0.5, 0.25, 0.0], "a highlight");
    }
    // The same at the position of the eye.
    let near = Node::transform(DAffine3::from_translation(DVec3::Z), vec![shines()]);
    for got in seen(vec![front, near]) {
        assert_near(got, [0.5, 0.25, 0.0], "in the plane of the eye");
    }
    // Red is where the area behind the eye is reflected, the middle of a sphere map.
    let mut texels = [0u8, 0, 255, 255].repeat(81);
    texels[40 * 4..41 * 4].copy_from_slice(&[255, 0, 0, 255]);
    let map = unlit()
        .with(Attribute::Texture(0, nearest(TextureObject::image("dot", [9, 9], texels))))
        .with(Attribute::TexGen(0, TexGen::SphereMap));
    assert_eq!(seen(vec![node(square(WHITE), map)]), [RED; 3]);
}

#[test]
fn height_tiles_have_two_sides() {
    let Some(mut rig) = rig("height_tiles_have_two_sides") else { return };
    let rig = &mut *rig;
    let terrain = Terrain { west: 0.13, south: 0.8, width: 0.006, relief_m: 10.0, root_error_m: 1.0, textured: false };
    let up = terrain.up(0.5, 0.5);
    let [target, sideways] =
        [terrain.world(0.5, 0.5, 0.0), terrain.world(0.5, 0.6, 0.0) - terrain.world(0.5, 0.5, 0.0)];
    let green = SurfaceMaterial { diffuse: [0.0, 1.0, 0.0, 1.0], ..SurfaceMaterial::default() };
    let sides = Attribute::SurfaceMaterials { front: SurfaceMaterial::default(), back: green };
    let mut seen = |eye_m: f64, light_from: DVec3, two_sided: bool| {
        let set = only_light_1()
            .with(sides.clone())
            .with(Attribute::LightModel(LightModel { two_sided, ..LightModel::default() }))
            .with_mode(Mode::CullFace, StateValue::OFF);
        let lamp = light(Light { position: light_from.extend(0.0).to_array(), ..Light::default() });
        let tile = Node::group(vec![terrain.tile(0, 0, 0)]).with_state_set(Arc::new(set));
        let scene = rig.scene(Node::group(vec![lamp, tile]));
        let view = camera([SIDE; 2], target + eye_m * up, target, sideways);
        let picture = rig.picture(&scene, &view, &plain());
        rig.release(scene);
        assert!(rig.renderer.take_errors().is_empty());
        // The ground is nearly level and the light nearly perpendicular; the tolerance covers the hills.
        pixel(&picture, 32, 32).map(|channel| channel > 230)
    };
    let (dark, white, green) = ([false; 3], [true; 3], [false, true, false]);
    for two_sided in [false, true] {
        assert_eq!(seen(9_000.0, up, two_sided), white, "{two_sided}");
        assert_eq!(seen(9_000.0, -up, two_sided), dark, "{two_sided}");
    }
    assert_eq!([false, true].map(|two_sided| seen(-9_000.0, up, two_sided)), [white, dark]);
    assert_eq!([false, true].map(|two_sided| seen(-9_000.0, -up, two_sided)), [dark, green]);
}
