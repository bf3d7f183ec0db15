//! What each mode and attribute of a state set does to pixels.
#![allow(clippy::unwrap_used, reason = "test code")]

mod gpu_support;

use std::sync::Arc;

use glam::{DAffine3, DVec3};
use gpu_support::{MAGENTA, Rig, count, plain, quad, rig, unit_camera};
use terrane::scene::{Drawable, Node};
use terrane::state::{
    Attribute, BinDetails, BlendEquation, BlendFactor, BlendFunc, ColorMask, CompareFunction, CullFace, Depth,
    FrontFace, Mode, PolygonMode, PolygonOffset, SortMode, StateSet, StateValue,
};

const SIDE: u32 = 64;
const BLACK: [u8; 3] = [0, 0, 0];
const RED: [u8; 3] = [255, 0, 0];
const GREEN: [u8; 3] = [0, 255, 0];
const BLUE: [u8; 3] = [0, 0, 255];
const YELLOW: [u8; 3] = [255, 255, 0];
const CYAN: [u8; 3] = [0, 255, 255];
const WHITE: [u8; 3] = [255, 255, 255];

/// A quad over the middle of the picture at a height above z = 0, towards the eye.
fn square(z: f32, color: [u8; 3]) -> Drawable {
    let [r, g, b] = color.map(|c| f32::from(c) / 255.0);
    quad([0.0, 0.0, z], [0.5, 0.5], [r, g, b, 1.0])
}

fn node(drawable: Drawable, set: StateSet) -> Node {
    Node::geode(vec![drawable]).with_state_set(Arc::new(set))
}

/// A state set whose leaves are drawn after those of bin 0.
fn later() -> StateSet {
    StateSet { bin: Some(BinDetails { number: 1, sort: SortMode::ByState }), ..StateSet::default() }
}

/// The color in the middle.
fn middle(rig: &mut Rig, nodes: Vec<Node>) -> [u8; 3] {
    let picture = draw(rig, nodes);
    let [r, g, b, alpha] = picture.get_pixel(SIDE / 2, SIDE / 2).0;
    assert_eq!(alpha, 255, "pictures stay opaque");
    [r, g, b]
}

fn draw(rig: &mut Rig, nodes: Vec<Node>) -> image::RgbaImage {
    let scene = rig.scene(Node::group(nodes));
    let picture = rig.picture(&scene, &unit_camera(SIDE), &plain());
    rig.release(scene);
    picture
}

/// One color, and over it another with a state.
fn over(rig: &mut Rig, below: [u8; 3], above: [u8; 3], set: StateSet) -> [u8; 3] {
    middle(rig, vec![node(square(0.0, below), StateSet::default()), node(square(0.1, above), set)])
}

fn func(source: BlendFactor, destination: BlendFactor) -> Attribute {
    Attribute::BlendFunc(BlendFunc { source, destination })
}

#[test]
fn blending_weighs_and_adds() {
    use BlendFactor::{DstColor, One, OneMinusSrcColor, SrcColor, Zero};
    let Some(mut rig) = rig("blending_weighs_and_adds") else { return };
    let rig = &mut *rig;
    assert_eq!(over(rig, RED, GREEN, later()), GREEN, "opaque without a word");
    assert_eq!(over(rig, RED, GREEN, later().with(Attribute::BlendFunc(BlendFunc::ADD))), YELLOW);
    assert_eq!(over(rig, MAGENTA, YELLOW, later().with(func(DstColor, Zero))), RED, "multiplied");
    assert_eq!(over(rig, MAGENTA, YELLOW, later().with(func(Zero, SrcColor))), RED, "the other way round");
    assert_eq!(over(rig, WHITE, RED, later().with(func(Zero, OneMinusSrcColor))), CYAN);
    let equation = |e| later().with(func(One, One)).with(Attribute::BlendEquation(e));
    assert_eq!(over(rig, RED, WHITE, equation(BlendEquation::Subtract)), CYAN);
    assert_eq!(over(rig, WHITE, RED, equation(BlendEquation::ReverseSubtract)), CYAN);
    assert_eq!(over(rig, YELLOW, MAGENTA, equation(BlendEquation::Min)), RED);
    assert_eq!(over(rig, YELLOW, BLUE, equation(BlendEquation::Max)), WHITE);
    // The function without the mode is no blending.
    let mut set = later();
    set.set_attribute(Attribute::BlendFunc(BlendFunc::ADD), StateValue::ON);
    assert_eq!(over(rig, RED, GREEN, set), GREEN);
}

#[test]
fn depth_compares_and_writes() {
    let Some(mut rig) = rig("depth_compares_and_writes") else { return };
    let rig = &mut *rig;
    let depth = |function, write| Attribute::Depth(Depth { function, write, ..Depth::default() });
    // Red at 0, then green behind it with the function.
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
    // What writes no depth hides nothing that comes later.
    let near = StateSet::default().with(depth(CompareFunction::Less, false));
    assert_eq!(middle(rig, vec![node(square(0.5, RED), near), node(square(0.0, GREEN), later())]), GREEN);
}

#[test]
fn faces_are_culled_as_told() {
    let Some(mut rig) = rig("faces_are_culled_as_told") else { return };
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
fn double_sided_materials_give_way_to_an_override_only() {
    let Some(mut rig) = rig("double_sided_materials_give_way_to_an_override_only") else { return };
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
fn polygons_are_lines_where_the_adapter_can() {
    let Some(mut rig) = rig("polygons_are_lines_where_the_adapter_can") else { return };
    let lines = StateSet::default().with(Attribute::PolygonMode(PolygonMode::Line));
    let picture = draw(&mut rig, vec![node(square(0.0, RED), lines)]);
    let red = count(&picture, RED);
    if rig.ctx.device().features().contains(wgpu::Features::POLYGON_MODE_LINE) {
        // Four sides of 32 pixels and a diagonal.
        assert!((100..250).contains(&red), "{red} pixels");
    } else {
        assert_eq!(red, 32 * 32, "filled instead");
    }
}

#[test]
fn an_offset_decides_between_equal_depths() {
    let Some(mut rig) = rig("an_offset_decides_between_equal_depths") else { return };
    let rig = &mut *rig;
    let second = |units: f32| {
        let set = later().with(Attribute::PolygonOffset(PolygonOffset { factor: 0.0, units }));
        vec![node(square(0.0, RED), StateSet::default()), node(square(0.0, GREEN), set)]
    };
    assert_eq!(middle(rig, second(-16.0)), GREEN, "nearer");
    assert_eq!(middle(rig, second(16.0)), RED, "farther");
    // Off, the attribute does nothing.
    let mut set = later();
    set.set_attribute(Attribute::PolygonOffset(PolygonOffset { factor: 0.0, units: -16.0 }), StateValue::ON);
    assert_eq!(middle(rig, vec![node(square(0.0, RED), StateSet::default()), node(square(0.0, GREEN), set)]), RED);
}

#[test]
fn masked_components_stay() {
    let Some(mut rig) = rig("masked_components_stay") else { return };
    let rig = &mut *rig;
    let mask = |r, g, b| StateSet::default().with(Attribute::ColorMask(ColorMask([r, g, b])));
    assert_eq!(middle(rig, vec![node(square(0.0, BLACK), mask(true, false, false))]), BLUE, "magenta without red");
    assert_eq!(middle(rig, vec![node(square(0.0, WHITE), mask(false, true, false))]), WHITE);
    assert_eq!(middle(rig, vec![node(square(0.0, GREEN), mask(false, false, false))]), MAGENTA);
}

#[test]
fn overrides_hold_below_and_protection_holds_against_them() {
    let Some(mut rig) = rig("overrides_hold_below_and_protection_holds_against_them") else { return };
    let rig = &mut *rig;
    let with = |mask: [bool; 3], how: StateValue| {
        let mut set = StateSet::default();
        set.set_attribute(Attribute::ColorMask(ColorMask(mask)), how);
        set
    };
    let (no_red, no_blue) = ([false, true, true], [true, true, false]);
    let mut black = |above: StateValue, below: StateValue| {
        let child = node(square(0.0, BLACK), with(no_blue, below));
        middle(rig, vec![Node::group(vec![child]).with_state_set(Arc::new(with(no_red, above)))])
    };
    let (on, over, protect) = (StateValue::ON, StateValue::OVERRIDE, StateValue::PROTECTED);
    assert_eq!(black(on, on), BLUE, "the child's");
    assert_eq!(black(on | over, on), RED, "the parent's");
    assert_eq!(black(on | over, on | over), RED, "an override below an override");
    assert_eq!(black(on | over, on | protect), BLUE, "protected");
    assert_eq!(black(on, on | StateValue::INHERIT), RED, "as if the child said nothing");
}

#[test]
fn states_differ_only_where_they_do() {
    let Some(mut rig) = rig("states_differ_only_where_they_do") else { return };
    // Ten equal sets under ten identities are one pipeline; an eleventh is another.
    let one = square(0.0, RED);
    let nodes = (0..11u32).map(|i| {
        let cull = if i == 10 { CullFace::Front } else { CullFace::Back };
        let place = DAffine3::from_translation(DVec3::new(f64::from(i) * 0.01, 0.0, f64::from(i) * -0.01));
        Node::transform(place, vec![node(one.clone(), StateSet::default().with(Attribute::CullFace(cull)))])
    });
    let scene = rig.scene(Node::group(nodes.collect()));
    let stats = rig.draw(&scene, &unit_camera(SIDE), &plain());
    rig.release(scene);
    // Pipeline twice; textures, vertices and indices once.
    assert_eq!((stats.leaves, stats.draw_calls, stats.state_changes), (11, 2, 5), "{stats:?}");
}
