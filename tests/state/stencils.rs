//! The effect of stencils on values and pixels, compared with OpenGL's rules: all operations in all cases, all
//! comparisons, masks and sides. Needs a GPU; a software adapter suffices.

use std::sync::Arc;

use glam::{DAffine3, DVec3};
use kit::frames::pixel;
use kit::rig::{Rig, plain, rig, unit_camera};
use kit::shapes::quad;
use kit::skip::skipped;

use terrane::scene::{Environment, Node, Sky};
use terrane::state::{
    Attribute, BinDetails, ColorMask, CompareFunction, CullFace, Depth, Mode, SortMode, StateSet, StateValue, Stencil,
    StencilFace, StencilOperation,
};

const OPERATIONS: [StencilOperation; 8] = [
    StencilOperation::Keep,
    StencilOperation::Zero,
    StencilOperation::Replace,
    StencilOperation::Invert,
    StencilOperation::Increment,
    StencilOperation::Decrement,
    StencilOperation::IncrementWrap,
    StencilOperation::DecrementWrap,
];
const FUNCTIONS: [CompareFunction; 8] = [
    CompareFunction::Never,
    CompareFunction::Less,
    CompareFunction::Equal,
    CompareFunction::LessOrEqual,
    CompareFunction::Greater,
    CompareFunction::NotEqual,
    CompareFunction::GreaterOrEqual,
    CompareFunction::Always,
];

/// The number of cases along a side of the image, and the pixels of each.
const ACROSS: usize = 16;
const CELL_PX: u32 = 8;
const SIDE: u32 = ACROSS as u32 * CELL_PX;

/// An existing value, and the leaf that is drawn over it.
#[derive(Clone, Copy, Debug)]
struct Case {
    before: u8,
    stencil: Stencil,
    /// True if its back faces the eye.
    is_turned: bool,
    /// True if it is behind the existing surface.
    is_behind: bool,
    culls_both: bool,
}

fn compares(function: CompareFunction, reference: u8, value: u8) -> bool {
    match function {
        CompareFunction::Never => false,
        CompareFunction::Less => reference < value,
        CompareFunction::Equal => reference == value,
        CompareFunction::LessOrEqual => reference <= value,
        CompareFunction::Greater => reference > value,
        CompareFunction::NotEqual => reference != value,
        CompareFunction::GreaterOrEqual => reference >= value,
        CompareFunction::Always => true,
    }
}

impl Case {
    /// Returns the resulting value, and whether the leaf is visible.
    fn outcome(&self) -> (u8, bool) {
        if self.culls_both {
            return (self.before, false);
        }
        let Stencil { front, back, reference, read_mask, write_mask } = self.stencil;
        let face = if self.is_turned { back } else { front };
        let passes = compares(face.function, reference & read_mask, self.before & read_mask);
        let operation = match (passes, self.is_behind) {
            (false, _) => face.fail,
            (true, true) => face.depth_fail,
            (true, false) => face.pass,
        };
        let value = match operation {
            StencilOperation::Keep => self.before,
            StencilOperation::Zero => 0,
            StencilOperation::Replace => reference,
            StencilOperation::Invert => !self.before,
            StencilOperation::Increment => self.before.saturating_add(1),
            StencilOperation::Decrement => self.before.saturating_sub(1),
            StencilOperation::IncrementWrap => self.before.wrapping_add(1),
            StencilOperation::DecrementWrap => self.before.wrapping_sub(1),
        };
        (self.before & !write_mask | value & write_mask, passes && !self.is_behind)
    }
}

/// Draws each case in a separate cell and compares with the rules: red where the leaf is visible, green where the value
/// is the expected one.
fn check(rig: &mut Rig, cases: &[Case]) {
    assert!(cases.len() <= ACROSS * ACROSS);
    let center = |place: usize| f64::from(2 * place as u32 + 1) / ACROSS as f64 - 1.0;
    let half = 0.6 / ACROSS as f32;
    let square = |at: usize, z: f64, is_turned: bool, number: i32, set: StateSet| {
        let set = StateSet { bin: Some(BinDetails::new(number, SortMode::ByState)), ..set };
        let turn = DAffine3::from_rotation_y(if is_turned { std::f64::consts::PI } else { 0.0 });
        let place = DAffine3::from_translation(DVec3::new(center(at % ACROSS), -center(at / ACROSS), z)) * turn;
        let white = Node::geode(vec![quad([0.0; 3], [half; 2], [1.0; 4])]).with_state_set(Arc::new(set));
        Node::transform(place, vec![white])
    };
    let seen = |mask| StateSet::default().with(Attribute::ColorMask(ColorMask(mask)));
    let writes_no_depth = |function| Attribute::Depth(Depth { function, write: false, ..Depth::default() });
    let keeps = |function| StencilFace { function, ..StencilFace::default() };
    let marks = StencilFace { pass: StencilOperation::Replace, ..keeps(CompareFunction::Always) };
    let mut nodes = vec![Node::geode(vec![quad([0.0; 3], [1.2; 2], [0.0, 0.0, 0.0, 1.0])])];
    for (at, case) in cases.iter().enumerate() {
        let before = seen([false; 4])
            .with(Attribute::Stencil(Stencil::both(marks, case.before)))
            .with(writes_no_depth(CompareFunction::Always));
        nodes.push(square(at, 0.01, false, 1, before));
        let faces = if case.culls_both { StateValue::ON } else { StateValue::OFF };
        let tested = seen([true, false, false, false])
            .with(Attribute::Stencil(case.stencil))
            .with(writes_no_depth(CompareFunction::Less))
            .with(Attribute::CullFace(CullFace::FrontAndBack))
            .with_mode(Mode::CullFace, faces);
        nodes.push(square(at, if case.is_behind { -0.05 } else { 0.05 }, case.is_turned, 2, tested));
        let after = seen([false, true, false, false])
            .with(Attribute::Stencil(Stencil::both(keeps(CompareFunction::Equal), case.outcome().0)))
            .with(writes_no_depth(CompareFunction::Always));
        nodes.push(square(at, 0.01, false, 3, after));
    }
    let scene = rig.scene(Node::group(nodes));
    let black = Environment { sky: Sky::Background([0; 3]), ..plain() };
    let picture = rig.picture(&scene, &unit_camera(SIDE), &black);
    rig.release(scene);
    let errors = rig.renderer.take_errors();
    assert!(errors.is_empty(), "{errors:?}");
    for (at, case) in cases.iter().enumerate() {
        let px = |place: usize| place as u32 * CELL_PX + CELL_PX / 2;
        let [red, green, _] = pixel(&picture, px(at % ACROSS), px(at / ACROSS));
        let (value, is_seen) = case.outcome();
        assert_eq!(green, 255, "not {value} after {case:?}");
        assert_eq!(red == 255, is_seen, "{case:?}");
    }
}

/// Returns true if the adapter has stencils. Otherwise the test is skipped with a message.
fn has_stencils(rig: &Rig, test: &str) -> bool {
    let has = rig.ctx.device().features().contains(wgpu::Features::DEPTH32FLOAT_STENCIL8);
    if !has {
        skipped(format!("{test}: the adapter has no stencil beside float depth"));
    }
    has
}

/// Three operations; those of the back face differ from those of the front.
fn turned_through(function: CompareFunction, first: usize) -> Stencil {
    let face = |first: usize| {
        let [fail, depth_fail, pass] = [0, 1, 2].map(|place| OPERATIONS[(first + place) % OPERATIONS.len()]);
        StencilFace { function, fail, depth_fail, pass }
    };
    Stencil { front: face(first), back: face(first + 3), ..Stencil::both(StencilFace::default(), 0x3c) }
}

#[test]
fn operations_change_values_where_tests_fail_and_pass() {
    let Some(mut rig) = rig("operations_change_values_where_tests_fail_and_pass") else { return };
    if !has_stencils(&rig, "operations_change_values_where_tests_fail_and_pass") {
        return;
    }
    let mut cases = Vec::new();
    for first in 0..OPERATIONS.len() {
        // The stencil test fails, the depth test fails, or both pass.
        for (function, is_behind) in
            [(CompareFunction::Never, false), (CompareFunction::Always, true), (CompareFunction::Always, false)]
        {
            for (before, is_turned) in [0, 0x5a, 255].into_iter().flat_map(|v| [(v, false), (v, true)]) {
                let stencil = turned_through(function, first);
                cases.push(Case { before, stencil, is_turned, is_behind, culls_both: false });
            }
        }
    }
    check(&mut rig, &cases);
}

#[test]
fn comparisons_use_the_reference_and_the_value_below_the_mask() {
    let Some(mut rig) = rig("comparisons_use_the_reference_and_the_value_below_the_mask") else { return };
    if !has_stencils(&rig, "comparisons_use_the_reference_and_the_value_below_the_mask") {
        return;
    }
    let mut cases = Vec::new();
    for (place, function) in FUNCTIONS.into_iter().enumerate() {
        for read_mask in [0xff, 0x0f] {
            // Less, equal and greater than the reference; in the lower half in another order.
            for (before, is_turned) in [0x19, 0x55, 0xf0, 0x05].into_iter().flat_map(|v| [(v, false), (v, true)]) {
                let face = |function| StencilFace {
                    function,
                    fail: StencilOperation::Invert,
                    depth_fail: StencilOperation::Zero,
                    pass: StencilOperation::Replace,
                };
                let other = FUNCTIONS[(place + 3) % FUNCTIONS.len()];
                let stencil =
                    Stencil { front: face(function), back: face(other), reference: 0x55, read_mask, write_mask: 0xff };
                cases.push(Case { before, stencil, is_turned, is_behind: false, culls_both: false });
            }
        }
    }
    check(&mut rig, &cases);
}

#[test]
fn only_bits_of_the_write_mask_change() {
    let Some(mut rig) = rig("only_bits_of_the_write_mask_change") else { return };
    if !has_stencils(&rig, "only_bits_of_the_write_mask_change") {
        return;
    }
    let mut cases = Vec::new();
    for first in 0..OPERATIONS.len() {
        for write_mask in [0x0f, 0xaa, 0] {
            for (before, is_turned) in [0x0f, 0xa5, 255].into_iter().flat_map(|v| [(v, false), (v, true)]) {
                let stencil = Stencil { write_mask, ..turned_through(CompareFunction::Always, first) };
                cases.push(Case { before, stencil, is_turned, is_behind: false, culls_both: false });
            }
        }
    }
    check(&mut rig, &cases);
}

/// Regression: such faces failed the depth test instead, and marked.
#[test]
fn faces_culled_on_both_sides_leave_stencil_values() {
    let Some(mut rig) = rig("faces_culled_on_both_sides_leave_stencil_values") else { return };
    if !has_stencils(&rig, "faces_culled_on_both_sides_leave_stencil_values") {
        return;
    }
    let places = [CompareFunction::Never, CompareFunction::Always].into_iter().flat_map(|f| [(f, false), (f, true)]);
    let cases: Vec<_> = places
        .map(|(function, is_turned)| {
            let operation = StencilOperation::Replace;
            let face = StencilFace { function, fail: operation, depth_fail: operation, pass: operation };
            Case { before: 1, stencil: Stencil::both(face, 9), is_turned, is_behind: false, culls_both: true }
        })
        .collect();
    check(&mut rig, &cases);
}
