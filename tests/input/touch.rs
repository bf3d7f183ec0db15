//! Several fingers on a touch screen: the effect on each manipulator, independence of the frame rate, and fingers that
//! are pressed and lifted in any order. No GPU.

use std::f64::consts::FRAC_PI_2;

use crate::world::{Act, SIZE_PX, World, all, home, play, play_on, queue};
use glam::{DAffine3, DVec2, DVec3};
use proptest::prelude::*;
use terrane::scene::{Node, NodeId, Page};
use terrane::viewer::manipulators::{
    CameraManipulator, DriveManipulator, FirstPersonManipulator, FlyManipulator, KeySwitchManipulator,
    NodeTrackerManipulator, OrbitManipulator, TerrainManipulator, TrackballManipulator, TrackerMode, usual,
};
use terrane::viewer::{Camera, EventQueue, Key, MouseButton, TouchPhase, WindowMatrix, world_from_eye};

use TouchPhase::{Began, Cancelled, Ended, Moved};

/// Two fingers around a middle, with their distance in pixels and their angle, move to another state.
#[derive(Clone, Copy)]
struct Gesture {
    from: DVec2,
    to: DVec2,
    apart: [f64; 2],
    /// The angle in radians, counterclockwise on the screen.
    angle: [f64; 2],
}

const STILL: Gesture =
    Gesture { from: DVec2::new(700.0, 300.0), to: DVec2::new(700.0, 300.0), apart: [200.0, 200.0], angle: [0.3, 0.3] };

impl Gesture {
    fn fingers(&self, share: f64) -> [DVec2; 2] {
        let middle = self.from.lerp(self.to, share);
        let apart = self.apart[0] * (self.apart[1] / self.apart[0]).powf(share);
        let angle = self.angle[0] + (self.angle[1] - self.angle[0]) * share;
        let half = 0.5 * apart * DVec2::new(angle.cos(), -angle.sin());
        [middle - half, middle + half]
    }

    /// Presses the fingers at `at_s` and moves them for `seconds`. They stay pressed.
    fn acts(&self, at_s: f64, seconds: f64, pieces: u32) -> Vec<(f64, Act)> {
        let touch = |phase, share, at_s| {
            let fingers = self.fingers(share);
            [0, 1].map(|id: usize| (at_s, Act::Touch(id as u64, phase, fingers[id].x, fingers[id].y)))
        };
        let mut acts = touch(Began, 0.0, at_s).to_vec();
        for piece in 1..=pieces {
            let share = f64::from(piece) / f64::from(pieces);
            acts.extend(touch(Moved, share, at_s + seconds * share));
        }
        acts
    }

    /// The same, and lifts the fingers at the end.
    fn thrown(&self, at_s: f64, seconds: f64, pieces: u32) -> Vec<(f64, Act)> {
        let mut acts = self.acts(at_s, seconds, pieces);
        let fingers = self.fingers(1.0);
        acts.extend(
            [0, 1].map(|id: usize| (at_s + seconds, Act::Touch(id as u64, Ended, fingers[id].x, fingers[id].y))),
        );
        acts
    }
}

fn seen(pose: &DAffine3, world: &World, point: DVec3) -> DVec2 {
    let camera = Camera { world_from_eye: *pose, ..world.camera };
    WindowMatrix::new(&camera, SIZE_PX).window_from_world(point).unwrap().truncate()
}

/// Returns the point of a plane that is visible at a pixel.
fn point_at(pose: &DAffine3, world: &World, at: DVec2, plane: DVec3, normal: DVec3) -> DVec3 {
    let camera = Camera { world_from_eye: *pose, ..world.camera };
    let ray = WindowMatrix::new(&camera, SIZE_PX).ray(at, camera.eye()).unwrap();
    ray.origin + ray.direction * ((plane - ray.origin).dot(normal) / ray.direction.dot(normal))
}

fn gestures() -> [(&'static str, Gesture); 5] {
    [
        ("drag", Gesture { to: DVec2::new(560.0, 390.0), ..STILL }),
        ("pinch", Gesture { apart: [200.0, 320.0], ..STILL }),
        ("together", Gesture { apart: [200.0, 90.0], ..STILL }),
        ("twist", Gesture { angle: [0.3, 1.0], ..STILL }),
        ("all", Gesture { from: STILL.from, to: DVec2::new(600.0, 350.0), apart: [150.0, 300.0], angle: [-0.4, 0.5] }),
    ]
}

#[test]
fn ground_stays_below_the_fingers() {
    // The trackball keeps the points of both fingers in the plane before the eye. Upright manipulators keep that of the
    // middle, the terrain manipulator on level ground. Splitting the motion into pieces does not change the result.
    for (gesture_name, gesture) in gestures() {
        for (world_name, world) in [("plane", World::plane()), ("alps", World { ground: None, ..World::alps() })] {
            for pieces in [1, 7] {
                let acts = gesture.acts(0.0, 0.05, pieces);
                let context = format!("{gesture_name} over the {world_name} in {pieces} pieces");
                let fingers = [gesture.fingers(0.0), gesture.fingers(1.0)];

                let mut trackball = TrackballManipulator::default();
                let start = home(&mut trackball, &world);
                let held = fingers[0].map(|at| point_at(&start, &world, at, trackball.center(), start.matrix3.z_axis));
                let pose = play(&mut trackball, &world, &acts, 0.1, 60);
                for (point, at) in held.into_iter().zip(fingers[1]) {
                    let off = seen(&pose, &world, point).distance(at);
                    assert!(off < 0.01, "trackball, {context}: {off} px");
                }

                let mut orbit = OrbitManipulator::default();
                let start = home(&mut orbit, &world);
                let held = point_at(&start, &world, gesture.from, orbit.center(), start.matrix3.z_axis);
                let pose = play(&mut orbit, &world, &acts, 0.1, 60);
                let off = seen(&pose, &world, held).distance(gesture.to);
                assert!(off < 0.01, "orbit, {context}: {off} px");

                let mut terrain = TerrainManipulator::default();
                let start = home(&mut terrain, &world);
                let center = terrain.center();
                let held = point_at(&start, &world, gesture.from, center, world.view().frame_at(center).up());
                let pose = play(&mut terrain, &world, &acts, 0.1, 60);
                let off = seen(&pose, &world, held).distance(gesture.to);
                // The plane through the point differs a little from the ellipsoid.
                let most = if world_name == "plane" { 0.01 } else { 4.0 };
                assert!(off < most, "terrain, {context}: {off} px");
            }
        }
    }
}

/// The node that a tracker follows.
fn tracker(world: &mut World) -> NodeTrackerManipulator {
    let child = Node::geode(vec![terrane::scene::Drawable::new(
        terrane::scene::Mesh::rectangle(DVec3::ZERO, DVec3::X * 50.0, DVec3::Y * 50.0).into(),
        terrane::scene::Material::default(),
    )]);
    let page = world.scene.add_root(Page::from_node(Node::transform(DAffine3::IDENTITY, vec![child])).unwrap());
    NodeTrackerManipulator::new(NodeId { page, index: 0 }, TrackerMode::NodeCenter)
}

#[test]
fn pinch_zooms_by_the_ratio_of_distances() {
    for (name, gesture) in gestures() {
        let ratio = gesture.apart[1] / gesture.apart[0];
        let mut world = World::plane();
        let mut trackball = TrackballManipulator::default();
        let mut orbit = OrbitManipulator::default();
        let mut terrain = TerrainManipulator::default();
        let mut tracker = tracker(&mut world);
        let acts = gesture.acts(0.0, 0.05, 5);
        let zoomed = |manipulator: &mut dyn CameraManipulator| {
            home(manipulator, &world);
            play(manipulator, &world, &[], 0.1, 60);
        };
        zoomed(&mut trackball);
        zoomed(&mut orbit);
        zoomed(&mut terrain);
        zoomed(&mut tracker);
        let before = [trackball.distance_m(), orbit.distance_m(), terrain.distance_m(), tracker.distance_m()];
        for manipulator in [&mut trackball as &mut dyn CameraManipulator, &mut orbit, &mut terrain, &mut tracker] {
            play(manipulator, &world, &acts, 0.1, 60);
        }
        let after = [trackball.distance_m(), orbit.distance_m(), terrain.distance_m(), tracker.distance_m()];
        for (before, after) in before.into_iter().zip(after) {
            assert!((before / after / ratio - 1.0).abs() < 1e-9, "{name}: {before} m, then {after} m");
        }
    }
}

#[test]
fn twist_rotates_the_view_with_the_fingers() {
    // A camera that looks straight down sees the ground rotate like the fingers.
    let turn = 0.7;
    let gesture =
        Gesture { from: DVec2::new(640.0, 360.0), to: DVec2::new(640.0, 360.0), angle: [0.2, 0.2 + turn], ..STILL };
    let mut world = World::plane();
    let tracker = tracker(&mut world);
    let eye = DVec3::new(0.0, 0.0, 900.0);
    let down = world_from_eye(eye, DVec3::new(0.0, 0.02, -1.0), DVec3::Z);
    let mut manipulators = all();
    manipulators.push(("tracker", Box::new(tracker)));
    for (name, mut manipulator) in manipulators.into_iter().filter(|(name, _)| !matches!(*name, "path" | "drive")) {
        manipulator.set_pose(&down, &world.view());
        let before = manipulator.advance(0.0, &world.view());
        let after = play(&mut *manipulator, &world, &gesture.acts(0.0, 0.05, 6), 0.1, 60);
        // Points on the right of the middle move up in a counterclockwise rotation.
        let point = point_at(&before, &world, DVec2::new(740.0, 360.0), DVec3::ZERO, DVec3::Z);
        let middle = point_at(&before, &world, DVec2::new(640.0, 360.0), DVec3::ZERO, DVec3::Z);
        let at = seen(&after, &world, point) - seen(&after, &world, middle);
        let angle = (-at.y).atan2(at.x);
        assert!((angle - turn).abs() < 0.06, "{name}: {angle}");
    }
    // Seen from below, the sky rotates with the fingers as well.
    let up = world_from_eye(eye, DVec3::new(0.0, 0.02, 1.0), DVec3::Z);
    let mut fly = FlyManipulator::default();
    fly.set_pose(&up, &world.view());
    let before = fly.advance(0.0, &world.view());
    let after = play(&mut fly, &world, &gesture.acts(0.0, 0.05, 6), 0.1, 60);
    let sky = DVec3::new(0.0, 0.0, 5e6);
    let point = point_at(&before, &world, DVec2::new(740.0, 360.0), sky, DVec3::Z);
    let at = seen(&after, &world, point) - DVec2::new(640.0, 360.0);
    let angle = (-at.y).atan2(at.x);
    assert!((angle - turn).abs() < 0.06, "sky: {angle}");
}

#[test]
fn flying_walking_and_driving_follow_the_fingers() {
    let world = World::plane();
    let level = World {
        ground: Some(Box::new(|_: &terrane::scene::Scene, p: DVec3, _: DVec3| Some(p.with_z(0.0)))),
        ..World::plane()
    };
    let apart = Gesture { apart: [100.0, 200.0], ..STILL };
    let right = Gesture { to: STILL.from + DVec2::X * 150.0, ..STILL };
    let down = Gesture { to: STILL.from + DVec2::Y * 150.0, ..STILL };
    let eye = DVec3::new(0.0, 0.0, 1.7);
    let north = world_from_eye(eye, DVec3::new(0.0, 1.0, -0.2), DVec3::Z);
    let go = |manipulator: &mut dyn CameraManipulator, world: &World, gesture: &Gesture| {
        manipulator.set_pose(&north, &world.view());
        let before = manipulator.advance(0.0, &world.view());
        let after = play(manipulator, world, &gesture.acts(0.0, 0.05, 6), 0.1, 60);
        after.translation - before.translation
    };
    let mut fly = FlyManipulator::default();
    let (ahead, aside, up) = (go(&mut fly, &world, &apart), go(&mut fly, &world, &right), go(&mut fly, &world, &down));
    assert!(ahead.y > 1.0 && ahead.x > 0.0, "towards the point between the fingers: {ahead}");
    assert!(aside.x < -1.0 && aside.y.abs() < 0.1, "the image follows: {aside}");
    assert!(up.z > 1.0, "{up}");

    let mut walk = FirstPersonManipulator::default();
    let (ahead, aside, back) =
        (go(&mut walk, &level, &apart), go(&mut walk, &level, &right), go(&mut walk, &level, &down));
    assert!(ahead.y > 0.5 && ahead.z.abs() < 1e-6, "on the ground: {ahead}");
    assert!(aside.x < -0.5 && aside.z.abs() < 1e-6, "{aside}");
    assert!(back.y > 0.5 && back.z.abs() < 1e-6, "the ground comes nearer: {back}");

    let mut drive = DriveManipulator::default();
    drive.set_pose(&north, &level.view());
    let up = Gesture { to: STILL.from - DVec2::Y * 150.0, ..STILL };
    let mut input = queue();
    play_on(&mut input, &mut drive, &level, &up.acts(0.0, 0.05, 6), 3.0, 60);
    let speed = drive.speed_m_per_s();
    assert!(speed > 10.0, "held like a lever, it keeps its speed: {speed}");
    let lift = [0, 1].map(|id| (0.0, Act::Touch(id, Ended, f64::NAN, f64::NAN)));
    play_on(&mut input, &mut drive, &level, &lift, 14.0, 60);
    assert_eq!(drive.speed_m_per_s(), 0.0, "released, it slows down");
    let steer = Gesture { to: STILL.from + DVec2::new(150.0, -150.0), ..STILL };
    let wheel = Gesture { to: up.to, angle: [0.3, -0.7], ..STILL };
    for gesture in [steer, wheel] {
        drive.set_pose(&north, &level.view());
        let pose = play(&mut drive, &level, &gesture.acts(0.0, 0.05, 6), 1.0, 60);
        assert!(-pose.matrix3.z_axis.x > 0.1, "to the right: {}", -pose.matrix3.z_axis);
    }
}

#[test]
fn one_finger_acts_as_the_left_button() {
    for world in [World::plane(), World::alps()] {
        for number in 0..all().len() {
            let run = |touched: bool| {
                let (name, mut manipulator) = all().remove(number);
                home(&mut *manipulator, &world);
                let place = |i: u32| (600.0 + 9.0 * f64::from(i), 400.0 - 3.0 * f64::from(i));
                let mut acts = Vec::new();
                for i in 0..=8 {
                    let (at_s, (x, y)) = (0.01 * f64::from(i), place(i));
                    let phase = if i == 0 { Began } else { Moved };
                    acts.push((at_s, if touched { Act::Touch(5, phase, x, y) } else { Act::Move(x, y) }));
                    if i == 0 && !touched {
                        acts.push((at_s, Act::Press(MouseButton::Left)));
                    }
                }
                let (x, y) = place(8);
                acts.push((0.08, if touched { Act::Touch(5, Ended, x, y) } else { Act::Release(MouseButton::Left) }));
                (name, play(&mut *manipulator, &world, &acts, 0.5, 60))
            };
            let ((name, mouse), (_, finger)) = (run(false), run(true));
            assert_eq!(mouse, finger, "{name}");
        }
    }
}

#[test]
fn gestures_do_not_depend_on_the_frame_rate() {
    for (gesture_name, gesture) in gestures() {
        for world in [World::plane(), World::alps()] {
            for number in 0..all().len() {
                let run = |rate: u32| {
                    let (name, mut manipulator) = all().remove(number);
                    let start = home(&mut *manipulator, &world);
                    // A lever stays held from frame to frame, like a key.
                    let (seconds, pieces) = if name == "drive" { (1.0, 10) } else { (0.2, 6) };
                    let acts = gesture.thrown(0.1, seconds, pieces);
                    (name, start, play(&mut *manipulator, &world, &acts, 2.5, rate))
                };
                let (name, start, slow) = run(10);
                let (_, _, quick) = run(200);
                let moved = slow.translation.distance(start.translation);
                let off = slow.translation.distance(quick.translation);
                assert!(off < 0.02 * moved + 1e-6, "{name}, {gesture_name}: {off} m of {moved} m");
                let turned = slow.matrix3.z_axis.distance(quick.matrix3.z_axis);
                assert!(turned < 0.02, "{name}, {gesture_name}: {turned} radians");
            }
        }
    }
}

#[test]
fn throw_of_fingers_continues_and_stops() {
    for (gesture_name, gesture) in gestures() {
        let world = World::plane();
        for (name, mut manipulator) in all() {
            if matches!(name, "path" | "drive") {
                continue;
            }
            home(&mut *manipulator, &world);
            let mut input = queue();
            let mut run =
                |acts: &[(f64, Act)], seconds: f64| play_on(&mut input, &mut *manipulator, &world, acts, seconds, 60);
            let thrown = run(&gesture.thrown(0.0, 0.1, 10), 0.15);
            let on = run(&[], 0.3);
            assert!(!thrown.abs_diff_eq(on, 1e-6), "{name}, {gesture_name}: stops immediately");
            run(&[], 6.0);
            let rest = run(&[], 1.0);
            assert_eq!(rest, run(&[], 1.0), "{name}, {gesture_name}: never stops");
            assert!(!manipulator.is_moving(), "{name}, {gesture_name}");
        }
    }
}

#[test]
fn resting_or_cancelled_fingers_throw_nothing() {
    let gesture = gestures()[4].1;
    let world = World::plane();
    let cancelled = || [0, 1].map(|id| (0.11, Act::Touch(id, Cancelled, 0.0, 0.0))).to_vec();
    let rested = || {
        let fingers = gesture.fingers(1.0);
        [0, 1].map(|id: usize| (1.0, Act::Touch(id as u64, Ended, fingers[id].x, fingers[id].y))).to_vec()
    };
    for (what, end) in [("cancelled", cancelled()), ("rested", rested())] {
        for (name, mut manipulator) in all() {
            home(&mut *manipulator, &world);
            let mut acts = gesture.acts(0.0, 0.1, 8);
            acts.extend(end.clone());
            if name == "drive" {
                continue;
            }
            let mut input = queue();
            let at = play_on(&mut input, &mut *manipulator, &world, &acts, 1.1, 60);
            let later = play_on(&mut input, &mut *manipulator, &world, &[], 1.0, 60);
            assert!(at.abs_diff_eq(later, 1e-9 * at.translation.length().max(1.0)), "{name}, {what}");
            assert_eq!(input.finger_count(), 0);
        }
    }
}

#[test]
fn pressing_and_lifting_fingers_causes_no_jump() {
    let world = World::plane();
    let gesture = gestures()[4].1;
    let [a, b] = gesture.fingers(1.0);
    for (name, mut manipulator) in all() {
        home(&mut *manipulator, &world);
        let mut input = queue();
        let mut run =
            |acts: &[(f64, Act)], seconds: f64| play_on(&mut input, &mut *manipulator, &world, acts, seconds, 60);
        // The fingers rest first, so that nothing is thrown.
        let held = run(&gesture.acts(0.0, 0.1, 8), 1.0);
        if name == "drive" {
            continue;
        }
        let same = |pose: DAffine3| pose.abs_diff_eq(held, 1e-7);
        let third = [(0.5, Act::Touch(2, Began, 100.0, 100.0)), (0.6, Act::Touch(2, Ended, 100.0, 100.0))];
        assert!(same(run(&third, 1.0)), "{name}: a third finger taps");
        assert!(same(run(&[(0.5, Act::Touch(0, Ended, a.x, a.y))], 1.0)), "{name}: the first finger is lifted");
        assert!(same(run(&[(0.5, Act::Touch(1, Moved, b.x + 3.0, b.y))], 1.0)), "{name}: the last finger trembles");
        assert!(same(run(&[(0.5, Act::Touch(1, Moved, b.x + 40.0, b.y))], 1.0)), "{name}: it becomes the pointer");
        let dragged = run(&[(0.5, Act::Touch(1, Moved, b.x + 90.0, b.y))], 1.0);
        assert!(name == "path" || !same(dragged), "{name}: and drags");
        let again = run(&[(0.5, Act::Touch(3, Began, 100.0, 100.0)), (0.5, Act::Touch(3, Moved, 150.0, 100.0))], 0.6);
        assert!(name == "path" || !again.abs_diff_eq(dragged, 1e-7), "{name}: a second pinch");
    }
}

/// Regression: the old manipulator was not notified that its fingers were lifted.
#[test]
fn manipulator_selected_again_forgets_earlier_fingers() {
    let world = World::plane();
    let mut poses = Vec::new();
    for was_left in [false, true] {
        let mut switch: KeySwitchManipulator = usual(None);
        let mut input = queue();
        assert!(switch.choose("trackball", &world.view()));
        home(&mut switch, &world);
        let mut run = |acts: &[(f64, Act)]| play_on(&mut input, &mut switch, &world, acts, 1.0, 60);
        let key = |key| [(0.1, Act::Down(Key::Char(key))), (0.1, Act::Up(Key::Char(key)))];
        if was_left {
            run(&STILL.acts(0.1, 0.1, 1));
            run(&key('2'));
            run(&[(0.1, Act::Touch(0, Ended, 600.0, 300.0)), (0.2, Act::Touch(1, Ended, 800.0, 300.0))]);
            run(&key('1'));
        }
        let began = run(&[(0.1, Act::Touch(7, Began, 300.0, 300.0))]);
        poses.push((began, run(&[(0.1, Act::Touch(7, Moved, 420.0, 330.0))])));
    }
    let [(before, alone), (again, after)] = poses[..] else { panic!() };
    assert!(before.abs_diff_eq(again, 1e-6), "nothing has moved so far");
    assert!(!before.abs_diff_eq(alone, 1e-2), "a finger turns the ball");
    assert!(alone.abs_diff_eq(after, 1e-6), "{alone} and {after}");
}

fn touch() -> impl Strategy<Value = Act> {
    let number = prop_oneof![5 => -200.0..1500.0, 1 => prop::num::f64::ANY];
    let phase = prop::sample::select(vec![Began, Began, Moved, Moved, Moved, Moved, Ended, Cancelled]);
    let id = prop_oneof![8 => 0u64..3, 1 => 0u64..60];
    (id, phase, number.clone(), number).prop_map(|(id, phase, x, y)| Act::Touch(id, phase, x, y))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn empty_gestures_have_no_effect(
        acts in prop::collection::vec((0.0..2.0f64, touch()), 0..120),
        which in 0usize..9,
        world in 0usize..3,
    ) {
        let mut world = [World::plane(), World::alps(), World::globe()].into_iter().nth(world).unwrap();
        let tracker = tracker(&mut world);
        let mut manipulators = all();
        manipulators.push(("tracker", Box::new(tracker)));
        let (name, mut manipulator) = manipulators.remove(which);
        home(&mut *manipulator, &world);
        let mut acts = acts;
        acts.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut input: EventQueue = queue();
        let pose = play_on(&mut input, &mut *manipulator, &world, &acts, 2.0, 30);
        prop_assert!(pose.is_finite(), "{name} {pose}");
        let unit = (pose.matrix3.transpose() * pose.matrix3 - glam::DMat3::IDENTITY).to_cols_array();
        prop_assert!(unit.iter().all(|v| v.abs() < 1e-9), "{name}: not a rotation {unit:?} {pose}");
        // After all fingers are lifted, one finger is the pointer again.
        input.focus(false, 2.0);
        prop_assert_eq!(input.finger_count(), 0);
        play_on(&mut input, &mut *manipulator, &world, &[], 12.0, 30);
        let tap = [(0.0, Act::Touch(99, Began, 640.0, 360.0)), (0.05, Act::Touch(99, Ended, 640.0, 360.0))];
        let before = manipulator.advance(0.0, &world.view());
        let after = play_on(&mut input, &mut *manipulator, &world, &tap, 0.2, 30);
        let off = before.translation.distance(after.translation);
        prop_assert!(off <= 1e-6 * before.translation.length() + 1e-3, "{name}: a tap moves by {off} m");
    }
}

#[test]
fn quarter_turn_of_many_fingers_is_a_quarter_turn() {
    let world = World::plane();
    let mut trackball = TrackballManipulator::default();
    let start = home(&mut trackball, &world);
    let count = 5u64;
    let place = |id: u64, turn: f64| {
        let angle = std::f64::consts::TAU * id as f64 / count as f64 + turn;
        DVec2::new(640.0, 360.0) + 200.0 * DVec2::new(angle.cos(), -angle.sin())
    };
    let touch = |id: u64, phase, turn: f64, at_s: f64| {
        let at = place(id, turn);
        (at_s, Act::Touch(id, phase, at.x, at.y))
    };
    let mut acts: Vec<_> = (0..count).map(|id| touch(id, Began, 0.0, 0.0)).collect();
    for step in 1..=50u32 {
        let share = f64::from(step) / 50.0;
        acts.extend((0..count).map(|id| touch(id, Moved, FRAC_PI_2 * share, 0.5 * share)));
    }
    let pose = play(&mut trackball, &world, &acts, 0.6, 60);
    // The eye rotates clockwise, so that the image rotates counterclockwise.
    assert!(pose.matrix3.x_axis.dot(-start.matrix3.y_axis) > 0.999, "{}", pose.matrix3);
    assert!(pose.translation.distance(start.translation) < 0.01 * trackball.distance_m());
}
