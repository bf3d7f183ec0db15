//! Bins with draw callbacks of the application: the order of calls, and the pixels.

use std::sync::{Arc, Mutex};

use image::RgbaImage;
use kit::frames::{MAGENTA, count, pixel};
use kit::rig::{Rig, plain, rig, unit_camera};
use kit::shapes::quad;
use terrane::draw::{BinCallback, BinDrawing, RenderInfo};
use terrane::scene::{Drawable, Geometry, Node};
use terrane::state::{
    Attribute, BinDetails, BinPrototype, BlendFunc, ColorMask, Mode, OpaqueDrawData, SortMode, StateSet, StateValue,
};

const SIZE: u32 = 64;
const ALL: usize = (SIZE * SIZE) as usize;
const RED: [f32; 4] = [1.0, 0.0, 0.0, 1.0];
const GREEN: [f32; 4] = [0.0, 1.0, 0.0, 1.0];
const BLUE: [f32; 4] = [0.0, 0.0, 1.0, 1.0];

type Said = Arc<Mutex<Vec<String>>>;

fn bin(number: i32, callback: Option<OpaqueDrawData>) -> Arc<StateSet> {
    let bin = Some(BinDetails::new(number, SortMode::ByState));
    Arc::new(StateSet { bin, bin_callback: callback, ..StateSet::default() })
}

fn hook(
    said: &Said,
    name: &'static str,
    draw: impl Fn(&RenderInfo<'_>, &mut BinDrawing<'_, '_, '_>) + Send + Sync + 'static,
) -> OpaqueDrawData {
    let said = said.clone();
    let say = move |what: String| said.lock().unwrap().push(format!("{name} {what}"));
    BinCallback::new(move |info, bin| {
        let numbers: Vec<i32> = bin.bins().iter().map(|b| b.number()).collect();
        let leaves: usize = bin.bins().iter().map(|b| b.leaves.len()).sum();
        say(format!("begins {numbers:?} with {leaves}"));
        draw(info, bin);
        say("ends".into());
    })
    .hook()
}

/// Returns a square at a depth that covers the left half, the right half, or the whole view.
fn square(left: bool, right: bool, depth: f32, color: [f32; 4]) -> Node {
    let (center, half) = match (left, right) {
        (true, true) => (0.0, 1.2),
        (true, false) => (-0.6, 0.6),
        _ => (0.6, 0.6),
    };
    Node::geode(vec![quad([center, 0.0, depth], [half, 1.2], color)])
}

fn draw(rig: &mut Rig, nodes: Vec<Node>) -> RgbaImage {
    let scene = rig.scene(Node::group(nodes));
    let picture = rig.picture(&scene, &unit_camera(SIZE), &plain());
    rig.release(scene);
    assert!(rig.renderer.take_errors().is_empty());
    picture
}

#[test]
fn callback_decides_whether_and_how_often_a_bin_is_drawn() {
    let Some(mut rig) = rig("callback_decides_whether_and_how_often_a_bin_is_drawn") else { return };
    let rig = &mut *rig;
    let said = Said::default();
    let scissored = |x: u32| {
        move |_: &RenderInfo<'_>, bin: &mut BinDrawing<'_, '_, '_>| {
            // `draw` restores the state that the callback sets.
            bin.pass().set_scissor_rect(x, 0, 1, 1);
            bin.pass().set_viewport(0.0, 0.0, 3.0, 3.0, 0.0, 0.1);
            bin.draw();
        }
    };
    let nodes = |callback: Option<OpaqueDrawData>| {
        vec![
            square(true, true, -0.5, RED),
            square(true, false, 0.0, GREEN).with_state_set(bin(5, callback)),
            square(false, true, 0.0, BLUE).with_state_set(bin(7, None)),
        ]
    };
    let usual = draw(rig, nodes(None));
    assert_eq!([[0, 255, 0], [0, 0, 255]].map(|c| count(&usual, c)), [ALL / 2; 2]);
    assert_eq!(draw(rig, nodes(Some(hook(&said, "around", scissored(3))))), usual);
    assert_eq!(draw(rig, nodes(Some(hook(&said, "twice", |_, bin| (bin.draw(), bin.draw()).0)))), usual);
    let without = draw(rig, nodes(Some(hook(&said, "instead", |_, _| {}))));
    assert_eq!([[255, 0, 0], [0, 0, 255]].map(|c| count(&without, c)), [ALL / 2; 2]);
    let expected = ["around", "twice", "instead"].map(|n| [format!("{n} begins [5] with 1"), format!("{n} ends")]);
    assert_eq!(*said.lock().unwrap(), expected.concat());
}

#[test]
fn bins_are_called_in_order_with_nested_ones() {
    let Some(mut rig) = rig("bins_are_called_in_order_with_nested_ones") else { return };
    let rig = &mut *rig;
    let said = Said::default();
    let usual = |name| hook(&said, name, |_, bin| bin.draw());
    let outer = |child: Node| Node::group(vec![child]).with_state_set(bin(2, Some(usual("outer"))));
    let picture = draw(
        rig,
        vec![
            square(true, true, 0.3, BLUE).with_state_set(bin(9, Some(usual("last")))),
            outer(Node::group(vec![
                square(true, true, 0.0, RED),
                square(false, true, 0.1, GREEN).with_state_set(bin(4, Some(usual("nested")))),
                square(true, false, 0.1, GREEN).with_state_set(bin(-4, None)),
            ])),
            square(true, true, -0.6, RED).with_state_set(bin(-1, Some(usual("first")))),
            square(true, true, -0.7, RED),
        ],
    );
    assert_eq!(count(&picture, [0, 0, 255]), ALL);
    let expected = [
        "first begins [-1] with 1",
        "first ends",
        "outer begins [-4, 2, 4] with 3",
        "nested begins [4] with 1",
        "nested ends",
        "outer ends",
        "last begins [9] with 1",
        "last ends",
    ];
    assert_eq!(*said.lock().unwrap(), expected);

    // Leaving out the outer bin leaves out the nested ones as well, even the one in front of them.
    said.lock().unwrap().clear();
    let nothing = |name| hook(&said, name, |_, _| {});
    let picture = draw(
        rig,
        vec![
            Node::group(vec![
                square(true, true, 0.0, RED),
                square(true, true, 0.1, BLUE).with_state_set(bin(4, Some(usual("nested")))),
            ])
            .with_state_set(bin(2, Some(nothing("outer")))),
            square(true, true, -0.7, GREEN),
        ],
    );
    assert_eq!(count(&picture, [0, 255, 0]), ALL);
    assert_eq!(*said.lock().unwrap(), ["outer begins [2, 4] with 2", "outer ends"]);
}

#[test]
fn blended_bins_are_drawn_after_opaque_leaves() {
    let Some(mut rig) = rig("blended_bins_are_drawn_after_opaque_leaves") else { return };
    let rig = &mut *rig;
    let said = Said::default();
    let glass = |callback| {
        let mut drawable = quad([0.0, 0.0, 0.5], [1.2, 1.2], [0.0, 1.0, 0.0, 0.5]);
        drawable.material.alpha = terrane::scene::AlphaMode::Blend;
        let set = StateSet { bin: Some(BinDetails::TRANSPARENT), bin_callback: callback, ..StateSet::default() };
        Node::geode(vec![drawable]).with_state_set(Arc::new(set))
    };
    let nodes = |callback| vec![glass(callback), square(true, false, 0.0, RED)];
    let usual = draw(rig, nodes(None));
    assert_eq!(count(&usual, [255, 0, 0]) + count(&usual, MAGENTA), 0, "everything is behind the glass");
    assert_eq!(draw(rig, nodes(Some(hook(&said, "glass", |_, bin| bin.draw())))), usual);
    let without = draw(rig, nodes(Some(hook(&said, "none", |_, _| {}))));
    assert_eq!((count(&without, [255, 0, 0]), count(&without, MAGENTA)), (ALL / 2, ALL / 2));
    assert_eq!(said.lock().unwrap().len(), 4);
}

/// A bin has the settings of the prototype of its name. Two bins with one number are separate.
#[test]
fn bins_are_drawn_by_the_prototype_of_their_name() {
    let Some(mut rig) = rig("bins_are_drawn_by_the_prototype_of_their_name") else { return };
    let rig = &mut *rig;
    let said = Said::default();
    for name in ["gpu_bins: first", "gpu_bins: second"] {
        let draw = Some(hook(&said, name, |_, bin| bin.draw()));
        BinPrototype::register(name, BinPrototype { sort: SortMode::BackToFront, draw });
    }
    let named = |name: &str| {
        let mut set = StateSet::default().with_mode(Mode::DepthTest, StateValue::OFF);
        set.set_render_bin_details(5, name).unwrap();
        Arc::new(set)
    };
    let picture = draw(
        rig,
        vec![
            square(true, true, 0.2, GREEN).with_state_set(named("gpu_bins: second")),
            square(false, true, 0.1, BLUE).with_state_set(named("gpu_bins: first")),
            Node::group(vec![
                square(true, true, 0.0, BLUE),
                square(true, false, 0.1, RED).with_state_set(bin(-1, None)),
            ])
            .with_state_set(named("gpu_bins: first")),
            square(true, true, 0.3, RED).with_state_set(bin(5, None)),
        ],
    );
    assert_eq!(count(&picture, [0, 255, 0]), ALL, "the second is drawn last in any order of traversal");
    let expected = [
        "gpu_bins: first begins [-1, 5] with 3",
        "gpu_bins: first ends",
        "gpu_bins: second begins [5] with 1",
        "gpu_bins: second ends",
    ];
    assert_eq!(*said.lock().unwrap(), expected);
}

/// Returns a mesh with many or few indices. Different draw calls draw them.
fn sized(mut drawable: Drawable, is_large: bool) -> Drawable {
    if let (Geometry::Mesh(mesh), true) = (&mut drawable.geometry, is_large) {
        let mesh = Arc::make_mut(mesh);
        mesh.indices = mesh.indices.iter().copied().chain(std::iter::repeat_n(0, 60)).collect();
    }
    drawable
}

/// Leaves whose state depends on the order are drawn in the order of traversal, in one batch or one by one.
#[test]
fn order_dependent_states_keep_the_order() {
    let Some(mut rig) = rig("order_dependent_states_keep_the_order") else { return };
    let rig = &mut *rig;
    let picture_of = |rig: &mut Rig, enlarged: [bool; 3]| {
        let colors = [[1.0, 0.0, 0.0, 0.5], [0.0, 1.0, 0.0, 0.5], [0.0, 0.0, 1.0, 0.5]];
        let nodes = colors.iter().zip(enlarged).enumerate().map(|(i, (color, is_enlarged))| {
            Node::geode(vec![sized(quad([0.0, 0.0, 0.1 * i as f32], [1.2; 2], *color), is_enlarged)])
        });
        let blended = StateSet::default().with(Attribute::BlendFunc(BlendFunc::ALPHA));
        draw(rig, vec![Node::group(nodes.collect()).with_state_set(Arc::new(blended))])
    };
    let small = picture_of(rig, [false; 3]);
    // Blue over green over red over magenta has shares of a quarter, a quarter and five eighths, in sRGB.
    // Adapters blend 8-bit sRGB with different precision.
    let color = pixel(&small, 32, 32);
    assert!(color.iter().zip([136, 136, 207]).all(|(a, b)| a.abs_diff(b) <= 3), "{color:?}");
    for enlarged in [[true, false, true], [false, true, false], [true; 3]] {
        assert!(picture_of(rig, enlarged) == small, "{enlarged:?}");
    }
}

/// Channels that a near leaf does not write keep the colours that were drawn before, however near those leaves are.
#[test]
fn leaves_with_a_color_mask_follow_earlier_leaves() {
    let Some(mut rig) = rig("leaves_with_a_color_mask_follow_earlier_leaves") else { return };
    let rig = &mut *rig;
    for [far, near] in [[false, false], [true, false], [false, true], [true, true]] {
        let quad = |z: f32, color: [f32; 4], is_large: bool| {
            Node::geode(vec![sized(quad([0.0, 0.0, z], [1.2; 2], color), is_large)])
        };
        let mask = StateSet::default().with(Attribute::ColorMask(ColorMask([true, true, false, true])));
        let [black, yellow] = [quad(0.0, [0.0, 0.0, 0.0, 1.0], far), quad(0.1, [1.0, 1.0, 0.0, 1.0], near)];
        let masked = yellow.with_state_set(Arc::new(mask));
        assert_eq!(pixel(&draw(rig, vec![black.clone(), masked.clone()]), 32, 32), [255, 255, 0], "{far} {near}");
        // In the reverse order, blue is that of the background.
        assert_eq!(pixel(&draw(rig, vec![masked, black]), 32, 32), [255; 3], "{far} {near}");
    }
}
