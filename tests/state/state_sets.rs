//! The effect of each mode and attribute of a state set on pixels.

use std::sync::Arc;

use glam::{DAffine3, DVec3};
use kit::frames::{MAGENTA, count};
use kit::rig::{Rig, camera, plain, rig, unit_camera};
use kit::shapes::quad;
use kit::skip::skipped;
use kit::terrain::Terrain;
use terrane::scene::{AlphaMode, Drawable, Geometry, Node, NodeKind};
use terrane::state::{
    Attribute, BinDetails, BlendEquation, BlendFactor, BlendFunc, ColorMask, CompareFunction, CullFace, Depth,
    FrontFace, Mode, PolygonMode, PolygonOffset, Scissor, SortMode, StateSet, StateValue, Stencil, StencilFace,
    StencilOperation, Viewport,
};

const SIDE: u32 = 64;
const BLACK: [u8; 3] = [0, 0, 0];
const RED: [u8; 3] = [255, 0, 0];
const GREEN: [u8; 3] = [0, 255, 0];
const BLUE: [u8; 3] = [0, 0, 255];
const YELLOW: [u8; 3] = [255, 255, 0];
const CYAN: [u8; 3] = [0, 255, 255];
const WHITE: [u8; 3] = [255, 255, 255];

/// Returns a quad over the middle of the image, at a height above z = 0.
fn square(z: f32, color: [u8; 3]) -> Drawable {
    let [r, g, b] = color.map(|c| f32::from(c) / 255.0);
    quad([0.0, 0.0, z], [0.5, 0.5], [r, g, b, 1.0])
}

fn node(drawable: Drawable, set: StateSet) -> Node {
    Node::geode(vec![drawable]).with_state_set(Arc::new(set))
}

/// Returns a state set whose leaves are drawn after those of bin 0.
fn later() -> StateSet {
    StateSet { bin: Some(BinDetails::new(1, SortMode::ByState)), ..StateSet::default() }
}

/// Returns the color in the middle.
fn middle(rig: &mut Rig, nodes: Vec<Node>) -> [u8; 3] {
    let picture = draw(rig, nodes);
    let [r, g, b, alpha] = picture.get_pixel(SIDE / 2, SIDE / 2).0;
    assert_eq!(alpha, 255, "images stay opaque");
    [r, g, b]
}

fn draw(rig: &mut Rig, nodes: Vec<Node>) -> image::RgbaImage {
    let scene = rig.scene(Node::group(nodes));
    let picture = rig.picture(&scene, &unit_camera(SIDE), &plain());
    rig.release(scene);
    picture
}

/// Returns the color of one quad with another one with a state over it.
fn over(rig: &mut Rig, below: [u8; 3], above: [u8; 3], set: StateSet) -> [u8; 3] {
    middle(rig, vec![node(square(0.0, below), StateSet::default()), node(square(0.1, above), set)])
}

fn func(source: BlendFactor, destination: BlendFactor) -> Attribute {
    Attribute::BlendFunc(BlendFunc::new(source, destination))
}

#[test]
fn blending_weights_and_adds() {
    use BlendFactor::{DstColor, One, OneMinusSrcColor, SrcColor, Zero};
    let Some(mut rig) = rig("blending_weights_and_adds") else { return };
    let rig = &mut *rig;
    assert_eq!(over(rig, RED, GREEN, later()), GREEN, "opaque by default");
    assert_eq!(over(rig, RED, GREEN, later().with(Attribute::BlendFunc(BlendFunc::ADD))), YELLOW);
    assert_eq!(over(rig, MAGENTA, YELLOW, later().with(func(DstColor, Zero))), RED, "multiplied");
    assert_eq!(over(rig, MAGENTA, YELLOW, later().with(func(Zero, SrcColor))), RED, "in the reverse order");
    assert_eq!(over(rig, WHITE, RED, later().with(func(Zero, OneMinusSrcColor))), CYAN);
    let equation = |e| later().with(func(One, One)).with(Attribute::BlendEquation(e));
    assert_eq!(over(rig, RED, WHITE, equation(BlendEquation::Subtract)), CYAN);
    assert_eq!(over(rig, WHITE, RED, equation(BlendEquation::ReverseSubtract)), CYAN);
    assert_eq!(over(rig, YELLOW, MAGENTA, equation(BlendEquation::Min)), RED);
    assert_eq!(over(rig, YELLOW, BLUE, equation(BlendEquation::Max)), WHITE);
    // Factors without the mode have no effect, whatever they are.
    assert_eq!(over(rig, YELLOW, BLUE, later().with(Attribute::BlendEquation(BlendEquation::Max))), WHITE);
    assert_eq!(over(rig, YELLOW, MAGENTA, later().with(Attribute::BlendEquation(BlendEquation::Min))), RED);
    // The function without the mode does not blend.
    let mut set = later();
    set.set_attribute(Attribute::BlendFunc(BlendFunc::ADD), StateValue::ON);
    assert_eq!(over(rig, RED, GREEN, set), GREEN);
}

/// Regression: materials with a mask were drawn whole, and height tiles opaque.
#[test]
fn blended_leaves_keep_their_mask_and_alpha() {
    let Some(mut rig) = rig("blended_leaves_keep_their_mask_and_alpha") else { return };
    let rig = &mut *rig;
    let mut masked = |alpha: f32| {
        let mut drawable = quad([0.0, 0.0, 0.1], [0.5, 0.5], [0.0, 1.0, 0.0, alpha]);
        drawable.material.alpha = AlphaMode::Mask(0.5);
        let set = later().with(Attribute::BlendFunc(BlendFunc::ADD));
        middle(rig, vec![node(square(0.0, RED), StateSet::default()), node(drawable, set)])
    };
    assert_eq!(masked(0.4), RED, "cut out");
    assert_eq!(masked(0.6), YELLOW, "added");

    let terrain =
        Terrain { west: 0.13, south: 0.8, width: 0.006, relief_m: 2600.0, root_error_m: 250.0, textured: true };
    let eye = terrain.world(0.5, 0.1, 9_000.0);
    let view = camera([SIDE; 2], eye, terrain.world(0.5, 0.6, 0.0), terrain.up(0.5, 0.5));
    let mut ground = |alpha: u8, set: StateSet| {
        let mut tile = terrain.tile(0, 0, 0);
        let NodeKind::Geode(drawables) = &mut tile.children[0].kind else { panic!("a geode") };
        let Geometry::Height(height) = &mut drawables[0].geometry else { panic!("heights") };
        let texture = Arc::get_mut(Arc::get_mut(height).unwrap().texture.as_mut().unwrap()).unwrap();
        texture.mips.iter_mut().for_each(|mip| mip.chunks_mut(4).for_each(|texel| texel[3] = alpha));
        let scene = rig.scene(Node::group(vec![tile]).with_state_set(Arc::new(set)));
        let picture = rig.picture(&scene, &view, &plain());
        rig.release(scene);
        picture.pixels().filter(|p| p.0[..3] != MAGENTA).count()
    };
    let blending = || later().with(func(BlendFactor::SrcAlpha, BlendFactor::OneMinusSrcAlpha));
    let all = ground(255, StateSet::default());
    assert!(all > 1000, "{all}");
    assert_eq!([ground(0, StateSet::default()), ground(255, blending()), ground(0, blending())], [all, all, 0]);
}

#[test]
fn depth_is_compared_and_written() {
    let Some(mut rig) = rig("depth_is_compared_and_written") else { return };
    let rig = &mut *rig;
    let depth = |function, write| Attribute::Depth(Depth { function, write, ..Depth::default() });
    // Red is at depth 0; green is drawn behind it with the function.
    let mut behind =
        |set: StateSet| middle(rig, vec![node(square(0.0, RED), StateSet::default()), node(square(-0.5, GREEN), set)]);
    assert_eq!(behind(later()), RED);
    assert_eq!(behind(later().with(depth(CompareFunction::Always, true))), GREEN);
    assert_eq!(behind(later().with(depth(CompareFunction::Greater, true))), GREEN);
    assert_eq!(behind(later().with(depth(CompareFunction::GreaterOrEqual, true))), GREEN);
    assert_eq!(behind(later().with(depth(CompareFunction::NotEqual, true))), GREEN);
    assert_eq!(behind(later().with(depth(CompareFunction::Equal, true))), RED);
    assert_eq!(behind(later().with_mode(Mode::DepthTest, StateValue::OFF)), GREEN);
    for (function, wins) in [
        (CompareFunction::Less, RED),
        (CompareFunction::LessOrEqual, GREEN),
        (CompareFunction::Equal, GREEN),
        (CompareFunction::Never, RED),
    ] {
        let second = node(square(0.0, GREEN), later().with(depth(function, true)));
        let same = vec![node(square(0.0, RED), StateSet::default()), second];
        assert_eq!(middle(rig, same), wins, "{function:?} at the same depth");
    }
    // Leaves that write no depth hide no later ones.
    let near = StateSet::default().with(depth(CompareFunction::Less, false));
    assert_eq!(middle(rig, vec![node(square(0.5, RED), near), node(square(0.0, GREEN), later())]), GREEN);
}

#[test]
fn face_culling_follows_the_state() {
    let Some(mut rig) = rig("face_culling_follows_the_state") else { return };
    let rig = &mut *rig;
    let turned = |set: StateSet| {
        let half_turn = DAffine3::from_rotation_y(std::f64::consts::PI);
        Node::transform(half_turn, vec![node(square(0.0, RED), set)])
    };
    let mirrored = |set: StateSet| {
        Node::transform(DAffine3::from_scale(DVec3::new(-1.0, 1.0, 1.0)), vec![node(square(0.0, RED), set)])
    };
    let plain = StateSet::default;
    let front = || plain().with(Attribute::CullFace(CullFace::Front));
    let clockwise = || plain().with(Attribute::FrontFace(FrontFace::Clockwise));
    let off = || plain().with_mode(Mode::CullFace, StateValue::OFF);
    let both = || plain().with(Attribute::CullFace(CullFace::FrontAndBack));
    let facing = |set| node(square(0.0, RED), set);
    for (what, seen, hidden) in [
        ("back faces by default", facing(plain()), turned(plain())),
        ("front faces", turned(front()), facing(front())),
        ("clockwise fronts", turned(clockwise()), facing(clockwise())),
        ("mirrored back faces", mirrored(plain()), mirrored(front())),
        ("none, and both", turned(off()), facing(both())),
    ] {
        assert_eq!(middle(rig, vec![seen]), RED, "{what}: seen");
        assert_eq!(middle(rig, vec![hidden]), MAGENTA, "{what}: culled");
    }
    assert_eq!(middle(rig, vec![turned(both())]), MAGENTA);
}

#[test]
fn double_sided_materials_follow_only_an_override() {
    let Some(mut rig) = rig("double_sided_materials_follow_only_an_override") else { return };
    let rig = &mut *rig;
    let turned = |value: StateValue| {
        let mut drawable = square(0.0, RED);
        drawable.material.double_sided = true;
        let set = StateSet::default().with_mode(Mode::CullFace, value);
        Node::transform(DAffine3::from_rotation_y(std::f64::consts::PI), vec![node(drawable, set)])
    };
    assert_eq!(middle(rig, vec![turned(StateValue::ON)]), RED);
    assert_eq!(middle(rig, vec![turned(StateValue::ON | StateValue::OVERRIDE)]), MAGENTA);
}

#[test]
fn polygons_are_drawn_as_lines_if_supported() {
    let Some(mut rig) = rig("polygons_are_drawn_as_lines_if_supported") else { return };
    let lines = StateSet::default().with(Attribute::PolygonMode(PolygonMode::Line));
    let picture = draw(&mut rig, vec![node(square(0.0, RED), lines)]);
    let red = count(&picture, RED);
    if rig.ctx.device().features().contains(wgpu::Features::POLYGON_MODE_LINE) {
        // There are four sides of 32 pixels and a diagonal.
        assert!((100..250).contains(&red), "{red} pixels");
    } else {
        assert_eq!(red, 32 * 32, "filled instead");
    }
}

#[test]
fn polygons_are_points_where_the_adapter_can() {
    let Some(mut rig) = rig("polygons_are_points_where_the_adapter_can") else { return };
    let points = StateSet::default().with(Attribute::PolygonMode(PolygonMode::Point));
    // The corners are in the middle of pixels.
    let at_middles = quad([0.0; 3], [31.0 / 64.0; 2], [1.0, 0.0, 0.0, 1.0]);
    let picture = draw(&mut rig, vec![node(at_middles, points)]);
    let red = count(&picture, RED);
    if rig.ctx.device().features().contains(wgpu::Features::POLYGON_MODE_POINT) {
        let corners = [(16, 16), (47, 16), (16, 47), (47, 47)];
        assert!(corners.iter().all(|(x, y)| picture.get_pixel(*x, *y).0[..3] == RED) && red == 4, "{red} pixels");
    } else {
        eprintln!("polygons_are_points_where_the_adapter_can: filled: no points of polygons");
        assert_eq!(red, 31 * 31, "filled instead");
    }
}

#[test]
fn offset_decides_between_equal_depths() {
    let Some(mut rig) = rig("offset_decides_between_equal_depths") else { return };
    let rig = &mut *rig;
    let second = |units: f32| {
        let set = later().with(Attribute::PolygonOffset(PolygonOffset { factor: 0.0, units }));
        vec![node(square(0.0, RED), StateSet::default()), node(square(0.0, GREEN), set)]
    };
    assert_eq!(middle(rig, second(-16.0)), GREEN, "nearer");
    assert_eq!(middle(rig, second(16.0)), RED, "farther");
    // Without the mode the attribute has no effect.
    let mut set = later();
    set.set_attribute(Attribute::PolygonOffset(PolygonOffset { factor: 0.0, units: -16.0 }), StateValue::ON);
    assert_eq!(middle(rig, vec![node(square(0.0, RED), StateSet::default()), node(square(0.0, GREEN), set)]), RED);
}

#[test]
fn slope_offset_moves_oblique_surfaces() {
    let Some(mut rig) = rig("slope_offset_moves_oblique_surfaces") else { return };
    let rig = &mut *rig;
    let second = |factor: f32, turn: DAffine3| {
        let set = later().with(Attribute::PolygonOffset(PolygonOffset { factor, units: 0.0 }));
        let nodes = vec![node(square(0.0, RED), StateSet::default()), node(square(0.0, GREEN), set)];
        vec![Node::transform(turn, nodes)]
    };
    let aslant = || DAffine3::from_rotation_y(1.0);
    assert_eq!(middle(rig, second(-4.0, aslant())), GREEN, "nearer");
    assert_eq!(middle(rig, second(4.0, aslant())), RED, "farther");
    assert_eq!(middle(rig, second(-4.0, DAffine3::IDENTITY)), RED, "no slope, no offset");
}

#[test]
fn masked_components_are_not_written() {
    let Some(mut rig) = rig("masked_components_are_not_written") else { return };
    let rig = &mut *rig;
    let mask = |r, g, b| StateSet::default().with(Attribute::ColorMask(ColorMask([r, g, b, true])));
    assert_eq!(middle(rig, vec![node(square(0.0, BLACK), mask(true, false, false))]), BLUE, "magenta without red");
    assert_eq!(middle(rig, vec![node(square(0.0, WHITE), mask(false, true, false))]), WHITE);
    assert_eq!(middle(rig, vec![node(square(0.0, GREEN), mask(false, false, false))]), MAGENTA);
}

#[test]
fn overrides_apply_below_and_protection_resists_them() {
    let Some(mut rig) = rig("overrides_apply_below_and_protection_resists_them") else { return };
    let rig = &mut *rig;
    let with = |mask: [bool; 4], how: StateValue| {
        let mut set = StateSet::default();
        set.set_attribute(Attribute::ColorMask(ColorMask(mask)), how);
        set
    };
    let (no_red, no_blue) = ([false, true, true, true], [true, true, false, true]);
    let mut black = |above: StateValue, below: StateValue| {
        let child = node(square(0.0, BLACK), with(no_blue, below));
        middle(rig, vec![Node::group(vec![child]).with_state_set(Arc::new(with(no_red, above)))])
    };
    let (on, over, protect) = (StateValue::ON, StateValue::OVERRIDE, StateValue::PROTECTED);
    assert_eq!(black(on, on), BLUE, "the child's");
    assert_eq!(black(on | over, on), RED, "the parent's");
    assert_eq!(black(on | over, on | over), RED, "an override below an override");
    assert_eq!(black(on | over, on | protect), BLUE, "protected");
    assert_eq!(black(on, on | StateValue::INHERIT), RED, "as if the child had no state");
}

#[test]
fn equal_states_share_pipelines() {
    let Some(mut rig) = rig("equal_states_share_pipelines") else { return };
    // Ten equal sets with ten identities have one pipeline; an eleventh has another one.
    let one = square(0.0, RED);
    let nodes = (0..11u32).map(|i| {
        let cull = if i == 10 { CullFace::Front } else { CullFace::Back };
        let place = DAffine3::from_translation(DVec3::new(f64::from(i) * 0.01, 0.0, f64::from(i) * -0.01));
        Node::transform(place, vec![node(one.clone(), StateSet::default().with(Attribute::CullFace(cull)))])
    });
    let scene = rig.scene(Node::group(nodes.collect()));
    let stats = rig.draw(&scene, &unit_camera(SIDE), &plain());
    rig.release(scene);
    // The pipeline is set twice; frame, textures and meshes once.
    assert_eq!((stats.leaves, stats.draw_calls, stats.state_changes), (11, 2, 5), "{stats:?}");
}

#[test]
fn blending_uses_the_constant_color() {
    let Some(mut rig) = rig("blending_uses_the_constant_color") else { return };
    let rig = &mut *rig;
    let set = later()
        .with(func(BlendFactor::ConstantColor, BlendFactor::OneMinusConstantColor))
        .with(Attribute::BlendColor([1.0, 0.0, 0.0, 1.0]));
    // Red is that of the drawn leaf, green and blue are those of the background.
    assert_eq!(over(rig, CYAN, YELLOW, set), WHITE);
    let none = later().with(func(BlendFactor::ConstantColor, BlendFactor::OneMinusConstantColor));
    assert_eq!(over(rig, CYAN, YELLOW, none), CYAN, "zero by default");
}

#[test]
fn depth_ranges_act_as_layers() {
    let Some(mut rig) = rig("depth_ranges_act_as_layers") else { return };
    let rig = &mut *rig;
    let ranged = |range| Attribute::Depth(Depth { range, ..Depth::default() });
    // Green is behind, in a nearer range.
    let nodes = |near, far| {
        vec![
            node(square(0.0, RED), StateSet::default().with(ranged(far))),
            node(square(-0.5, GREEN), later().with(ranged(near))),
        ]
    };
    assert_eq!(middle(rig, nodes([0.0, 0.1], [0.1, 1.0])), GREEN);
    assert_eq!(middle(rig, nodes([0.0, 1.0], [0.0, 1.0])), RED);
    assert_eq!(middle(rig, nodes([0.0, 1.0], [1.0, 1.0])), GREEN, "everything at the far end");
    assert_eq!(middle(rig, nodes([0.0, 0.0], [0.0, 1.0])), GREEN, "all of it at the near end");
    assert_eq!(middle(rig, nodes([f32::NAN, 2.0], [0.0, 1.0])), RED, "an invalid range is the whole range");
}

#[test]
fn scissors_and_viewports_limit_the_drawn_pixels() {
    let Some(mut rig) = rig("scissors_and_viewports_limit_the_drawn_pixels") else { return };
    let rig = &mut *rig;
    let red = |picture: &image::RgbaImage| {
        let mut box_px = [u32::MAX, u32::MAX, 0, 0];
        for (x, y, _) in picture.enumerate_pixels().filter(|(.., p)| p.0[..3] == RED) {
            box_px = [box_px[0].min(x), box_px[1].min(y), box_px[2].max(x + 1), box_px[3].max(y + 1)];
        }
        (box_px, count(picture, RED))
    };
    let scissor = |x, y, width, height| StateSet::default().with(Attribute::Scissor(Scissor { x, y, width, height }));
    let picture = draw(rig, vec![node(square(0.0, RED), scissor(20, 18, 9, 5))]);
    assert_eq!(red(&picture), ([20, 18, 29, 23], 45));
    // A rectangle beyond the target is cut, an empty one draws nothing, and without the mode it has no effect.
    assert_eq!(red(&draw(rig, vec![node(square(0.0, RED), scissor(40, 40, 999, 999))])), ([40, 40, 48, 48], 64));
    assert_eq!(red(&draw(rig, vec![node(square(0.0, RED), scissor(999, 0, 5, 5))])).1, 0);
    let mut off = scissor(20, 18, 9, 5);
    off.set_mode(Mode::ScissorTest, StateValue::OFF);
    assert_eq!(red(&draw(rig, vec![node(square(0.0, RED), off)])).1, 32 * 32);
    // With the whole image in the upper left quarter, the square is half as large there.
    let quarter = Viewport { x: 0.0, y: 0.0, width: 32.0, height: 32.0 };
    let picture = draw(rig, vec![node(square(0.0, RED), StateSet::default().with(Attribute::Viewport(quarter)))]);
    assert_eq!(red(&picture), ([8, 8, 24, 24], 256));
    // A viewport beyond the target is cut, not scaled: a quarter of an image of twice the size, from each corner.
    for (x, y, expected) in
        [(0.0, 0.0, [32, 32, 64, 64]), (-64.0, 0.0, [0, 32, 32, 64]), (-64.0, -64.0, [0, 0, 32, 32])]
    {
        let larger = Viewport { x, y, width: 128.0, height: 128.0 };
        let picture = draw(rig, vec![node(square(0.0, RED), StateSet::default().with(Attribute::Viewport(larger)))]);
        assert_eq!(red(&picture), (expected, 32 * 32));
    }
    for x in [-9999.0, -64.0, 64.0, 1e6] {
        let outside = Viewport { x, y: 0.0, width: 64.0, height: 64.0 };
        let picture = draw(rig, vec![node(square(0.0, RED), StateSet::default().with(Attribute::Viewport(outside)))]);
        assert_eq!(red(&picture).1, 0);
    }
    let nonsense = Viewport { x: f32::NAN, y: -9.0, width: 1e9, height: f32::INFINITY };
    let set = StateSet::default().with(Attribute::Viewport(nonsense));
    draw(rig, vec![node(square(0.0, RED), set)]);
}

#[test]
fn stencils_mark_and_test() {
    let Some(mut rig) = rig("stencils_mark_and_test") else { return };
    let rig = &mut *rig;
    if !rig.ctx.device().features().contains(wgpu::Features::DEPTH32FLOAT_STENCIL8) {
        skipped("the adapter has no stencil beside float depth");
        return;
    }
    let face = |function, pass| StencilFace { function, pass, ..StencilFace::default() };
    let stencil = |set: StateSet, s: Stencil| set.with(Attribute::Stencil(s));
    let mark = Stencil::both(face(CompareFunction::Always, StencilOperation::Replace), 3);
    let bin = |number| StateSet { bin: Some(BinDetails::new(number, SortMode::ByState)), ..StateSet::default() };
    // A small mark without color, then a square that is drawn where the mark is, or where it is not.
    let mut drawn = |test: Stencil, mark: Stencil| {
        let mut invisible = stencil(bin(1), mark).with(Attribute::ColorMask(ColorMask([false; 4])));
        invisible.set_attribute(Attribute::Depth(Depth { write: false, ..Depth::default() }), StateValue::ON);
        let small = quad([0.0, 0.0, 0.1], [0.25, 0.25], [1.0; 4]);
        let picture = draw(rig, vec![node(small, invisible), node(square(0.0, RED), stencil(bin(2), test))]);
        count(&picture, RED)
    };
    let test = |function, reference| Stencil::both(face(function, StencilOperation::Keep), reference);
    assert_eq!(drawn(test(CompareFunction::Equal, 3), mark), 16 * 16);
    assert_eq!(drawn(test(CompareFunction::NotEqual, 3), mark), 32 * 32 - 16 * 16);
    assert_eq!(drawn(test(CompareFunction::Equal, 4), mark), 0);
    assert_eq!(drawn(test(CompareFunction::Less, 2), mark), 16 * 16, "2 < 3 where it is marked");
    // Masks select bit 0 for comparing, or for writing.
    let masked = Stencil { read_mask: 1, ..test(CompareFunction::Equal, 1) };
    assert_eq!(drawn(masked, mark), 16 * 16);
    assert_eq!(drawn(test(CompareFunction::Equal, 2), Stencil { write_mask: 2, ..mark }), 16 * 16);
    // Incremented from 0, inverted, and marked by back faces only, of which there are none.
    let does = |pass| Stencil::both(face(CompareFunction::Always, pass), 0);
    assert_eq!(drawn(test(CompareFunction::Equal, 1), does(StencilOperation::Increment)), 16 * 16);
    assert_eq!(drawn(test(CompareFunction::Equal, 255), does(StencilOperation::Invert)), 16 * 16);
    assert_eq!(drawn(test(CompareFunction::Equal, 255), does(StencilOperation::DecrementWrap)), 16 * 16);
    assert_eq!(drawn(test(CompareFunction::Equal, 0), does(StencilOperation::Decrement)), 32 * 32, "stays at 0");
    let back_only = Stencil { front: StencilFace::default(), ..mark };
    assert_eq!(drawn(test(CompareFunction::Equal, 3), back_only), 0);
    // The depth test fails behind the existing surface.
    let depth_fail =
        StencilFace { depth_fail: StencilOperation::Replace, ..face(CompareFunction::Always, StencilOperation::Keep) };
    let behind = stencil(bin(1), Stencil::both(depth_fail, 3));
    let nodes = vec![
        node(square(0.0, RED), StateSet::default()),
        node(quad([0.0, 0.0, -0.5], [0.25, 0.25], [1.0; 4]), behind),
        node(square(0.2, GREEN), stencil(bin(2), test(CompareFunction::Equal, 3))),
    ];
    let green = count(&draw(rig, nodes), GREEN);
    assert!((200..260).contains(&green), "{green}");
    // Images without stencils are drawn as before.
    assert_eq!(middle(rig, vec![node(square(0.0, RED), StateSet::default())]), RED);
}
