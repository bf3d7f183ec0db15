//! Manipulators: their poses, independence of the frame rate, and finite results. No GPU.

use crate::world::{Act, SIZE_PX, World, all, home, play};
use glam::{DAffine3, DVec2, DVec3};
use proptest::prelude::*;
use terrane::math::BoundingSphere;
use terrane::scene::{Node, NodeId, Page, Scene};
use terrane::viewer::manipulators::{
    AnimationPathManipulator, CameraManipulator, DriveManipulator, FirstPersonManipulator, FlyManipulator,
    KeySwitchManipulator, NodeTrackerManipulator, OrbitManipulator, TerrainManipulator, TrackerMode, usual,
};
use terrane::viewer::{
    AnimationPath, Camera, ControlPoint, EventKind, EventQueue, FieldOfView, Key, MouseButton, SetBounds,
};

/// A drag that ends in a throw, a turn of the wheel, and keys that are held for a while.
fn a_little_of_everything() -> Vec<(f64, Act)> {
    let mut acts = vec![(0.1, Act::Move(600.0, 400.0)), (0.1, Act::Press(MouseButton::Left))];
    acts.extend((1..=10).map(|i| (0.1, Act::Move(600.0 + 8.0 * f64::from(i), 400.0 - 2.0 * f64::from(i)))));
    acts.push((0.1, Act::Release(MouseButton::Left)));
    acts.push((0.2, Act::Scroll(2.0)));
    acts.push((0.2, Act::Down(Key::Up)));
    acts.push((0.2, Act::Down(Key::Right)));
    acts.push((0.7, Act::Up(Key::Right)));
    acts.push((1.0, Act::Up(Key::Up)));
    acts
}

#[test]
fn motion_does_not_depend_on_the_frame_rate() {
    for world in [World::plane(), World::alps(), World::globe()] {
        for number in 0..all().len() {
            let run = |rate: u32| {
                let (name, mut manipulator) = all().remove(number);
                let start = home(&mut *manipulator, &world);
                (name, start, play(&mut *manipulator, &world, &a_little_of_everything(), 1.5, rate))
            };
            let (name, start, slow) = run(10);
            let (_, _, quick) = run(200);
            let moved = slow.translation.distance(start.translation);
            let off = slow.translation.distance(quick.translation);
            assert!(name == "path" || moved > 1.0, "{name} does nothing");
            assert!(off < 0.02 * moved + 1e-9, "{name}: {off} m of {moved} m");
            let turned = slow.matrix3.z_axis.distance(quick.matrix3.z_axis);
            assert!(turned < 0.02, "{name}: {turned} radians");
        }
    }
}

#[test]
fn home_pose_fills_the_view_with_the_bounds() {
    let narrow = Camera { field_of_view: FieldOfView::Vertical(0.4), ..Camera::default() };
    for camera in [Camera::default(), narrow] {
        for world in [World::plane(), World::alps()] {
            let world = World { camera, ground: None, ..world };
            let b = &world.bounds;
            for (name, mut manipulator) in all().into_iter().filter(|(name, _)| *name != "path") {
                let pose = home(&mut *manipulator, &world);
                let (mut most, size) = (DVec2::ZERO, DVec2::new(f64::from(SIZE_PX[0]), f64::from(SIZE_PX[1])));
                for i in 0..8u32 {
                    let sign = |bit: u32| if i >> bit & 1 == 1 { 1.0 } else { -1.0 };
                    let corner = b.middle_m + b.half_size_m * DVec3::new(sign(0), sign(1), sign(2));
                    let camera = Camera { world_from_eye: pose, ..world.camera };
                    let matrix = terrane::viewer::WindowMatrix::new(&camera, SIZE_PX);
                    let at = matrix.window_from_world(b.frame.world_from_local.transform_point3(corner)).unwrap();
                    most = most.max((at.truncate() / size * 2.0 - 1.0).abs());
                }
                assert!(most.max_element() <= 1.0, "{name}: {most}");
                assert!(most.max_element() > 0.9, "{name}: {most}");
            }
        }
    }
}

#[test]
fn pose_is_kept_when_manipulators_change() {
    for (no_ground, world) in
        [(true, World::plane()), (true, World { ground: None, ..World::alps() }), (false, World::alps())]
    {
        let frame = world.bounds.frame;
        let eye = frame.world_from_local.transform_point3(DVec3::new(-300.0, 200.0, 3000.0));
        let up = world.view().frame_at(eye).up();
        let pose = terrane::viewer::world_from_eye(eye, frame.direction(1.2, -0.7), up);
        // A manipulator that stands on the ground moves there.
        let keeps = |name: &str| name != "path" && (no_ground || !matches!(name, "first person" | "drive"));
        for (name, mut manipulator) in all().into_iter().filter(|(name, _)| keeps(name)) {
            manipulator.set_pose(&pose, &world.view());
            let back = manipulator.advance(0.0, &world.view());
            assert!(back.translation.distance(eye) < 1e-6, "{name}: {}", back.translation.distance(eye));
            assert!(back.matrix3.z_axis.distance(pose.matrix3.z_axis) < 1e-9, "{name}");
            // Once at rest, it stays there.
            let later = play(manipulator.as_mut(), &world, &[], 1.0, 30);
            assert!(later.translation.distance(eye) < 1e-6 * 3000.0, "{name}");
        }
    }
}

#[test]
fn orbit_keeps_its_distance_and_the_vertical() {
    for world in [World::plane(), World::globe()] {
        let mut orbit = OrbitManipulator::default();
        home(&mut orbit, &world);
        let (center, distance_m) = (orbit.center(), orbit.distance_m());
        let acts: Vec<_> = [(0.1, Act::Move(600.0, 300.0)), (0.1, Act::Press(MouseButton::Left))]
            .into_iter()
            .chain((0..200).map(|i| (0.1, Act::Move(600.0 + 11.0 * f64::from(i), 300.0 + f64::from(i % 9)))))
            .collect();
        let pose = play(&mut orbit, &world, &acts, 1.0, 60);
        assert_eq!(orbit.center(), center);
        assert!((pose.translation.distance(center) / distance_m - 1.0).abs() < 1e-12);
        let up = world.view().frame_at(center).up();
        assert!(pose.matrix3.x_axis.dot(up).abs() < 1e-12, "the horizon is level");
    }
}

#[test]
fn drag_keeps_the_ground_below_the_pointer() {
    // Pan by a tenth of the image: the point in the middle moves by a tenth.
    let world = World::plane();
    for (name, mut manipulator) in all().into_iter().take(2) {
        home(&mut *manipulator, &world);
        let acts =
            [(0.0, Act::Move(640.0, 360.0)), (0.0, Act::Press(MouseButton::Middle)), (0.0, Act::Move(712.0, 432.0))];
        let center = world.bounds.sphere.center;
        let pose = play(&mut *manipulator, &world, &acts, 0.1, 10);
        let camera = Camera { world_from_eye: pose, ..world.camera };
        let at = terrane::viewer::WindowMatrix::new(&camera, SIZE_PX).window_from_world(center).unwrap();
        assert!(at.truncate().distance(DVec2::new(712.0, 432.0)) < 0.01, "{name}: {at}");
    }
    // Rotate: the near side moves with the pointer.
    for (name, mut manipulator) in all().into_iter().take(3) {
        let start = home(&mut *manipulator, &world);
        let near = start.translation.lerp(world.bounds.sphere.center, 0.7);
        let acts =
            [(0.0, Act::Move(640.0, 360.0)), (0.0, Act::Press(MouseButton::Left)), (0.0, Act::Move(680.0, 350.0))];
        let pose = play(&mut *manipulator, &world, &acts, 0.1, 10);
        let in_eye = pose.inverse().transform_point3(near);
        assert!(in_eye.x > 0.0 && in_eye.y > 0.0, "{name}: {in_eye}");
    }
}

#[test]
fn throw_continues_and_stops() {
    let world = World::plane();
    for (name, mut manipulator) in all().into_iter().take(3) {
        home(&mut *manipulator, &world);
        let mut acts = vec![(0.0, Act::Move(600.0, 400.0)), (0.0, Act::Press(MouseButton::Left))];
        acts.extend((1..=6).map(|i| (0.02 * f64::from(i), Act::Move(600.0 + 20.0 * f64::from(i), 400.0))));
        acts.push((0.13, Act::Release(MouseButton::Left)));
        let thrown = play(&mut *manipulator, &world, &acts, 0.2, 60);
        let on = play(&mut *manipulator, &world, &[], 0.2, 60);
        assert!(on.translation.distance(thrown.translation) > 10.0, "{name} stops immediately");
        let rest = play(&mut *manipulator, &world, &[], 6.0, 60);
        let later = play(&mut *manipulator, &world, &[], 1.0, 60);
        assert_eq!(rest, later, "{name} never stops");
        assert!(!manipulator.is_moving(), "{name}");
    }
}

#[test]
fn manipulators_work_from_a_metre_to_forty_thousand_kilometres() {
    let mut world = World::globe();
    world.bounds = SetBounds::from_sphere(BoundingSphere::new(DVec3::new(4.2e6, 1.0e6, 4.6e6), 100.0));
    for name in ["orbit", "terrain", "trackball"] {
        let (_, mut manipulator) = all().into_iter().find(|(n, _)| *n == name).unwrap();
        let target = world.bounds.sphere.center;
        for distance_m in [1.0, 40.0e6, 1.0, 1234.5] {
            let direction = world.bounds.frame.direction(0.3, -0.9);
            let up = world.bounds.frame.up();
            world.bounds.sphere.radius_m = 100.0;
            let pose = terrane::viewer::world_from_eye(target - direction * distance_m, direction, up);
            manipulator.set_pose(&pose, &world.view());
            // A small rotation moves the eye by its angle times the distance, with enough precision at both ends.
            let acts =
                [(0.0, Act::Move(640.0, 360.0)), (0.0, Act::Press(MouseButton::Left)), (0.0, Act::Move(641.0, 360.0))];
            let turned = play(manipulator.as_mut(), &world, &acts, 0.1, 10);
            let off = (turned.translation.distance(target) / distance_m - 1.0).abs();
            assert!(off < 1e-8, "{name} at {distance_m} m: {off}");
            let moved = turned.translation.distance(pose.translation) / distance_m;
            assert!((1e-4..0.02).contains(&moved), "{name} at {distance_m} m: {moved}");
            play(manipulator.as_mut(), &world, &[(0.0, Act::Release(MouseButton::Left))], 0.1, 10);
        }
        // The wheel zooms over the whole range, and stops at its limits.
        manipulator
            .set_pose(&terrane::viewer::world_from_eye(target + DVec3::X, DVec3::NEG_X, DVec3::Z), &world.view());
        let acts: Vec<_> = (0..500).map(|i| (0.01 * f64::from(i), Act::Scroll(-1.0))).collect();
        let far = play(manipulator.as_mut(), &world, &acts, 8.0, 60);
        assert!(far.is_finite() && far.translation.distance(target) > 40.0e6, "{name}: {}", far.translation);
        let acts: Vec<_> = (0..500).map(|i| (0.01 * f64::from(i), Act::Scroll(1.0))).collect();
        let near = play(manipulator.as_mut(), &world, &acts, 8.0, 60);
        assert!(near.is_finite() && near.translation.distance(far.translation) > 40.0e6, "{name}");
    }
}

#[test]
fn terrain_manipulator_stays_above_the_ground() {
    let world = World::alps();
    let mut manipulator = TerrainManipulator::default();
    home(&mut manipulator, &world);
    // The camera moves down to the ground, looks level, and then moves far over the hills.
    let mut acts: Vec<_> = (0..40).map(|i| (0.02 * f64::from(i), Act::Scroll(1.0))).collect();
    acts.push((1.0, Act::Move(600.0, 100.0)));
    acts.push((1.0, Act::Press(MouseButton::Left)));
    acts.push((1.1, Act::Move(600.0, 700.0)));
    acts.push((1.2, Act::Move(600.0, 20.0)));
    acts.push((1.3, Act::Release(MouseButton::Left)));
    let pose = play(&mut manipulator, &world, &acts, 4.0, 60);
    assert!(world.height_m(pose.translation) >= manipulator.clearance_m - 1e-6);
    for _ in 0..20 {
        manipulator.set_pose(&pose, &world.view());
        let acts = [
            (0.0, Act::Move(600.0, 300.0)),
            (0.0, Act::Press(MouseButton::Middle)),
            (0.05, Act::Move(500.0, 700.0)),
            (0.1, Act::Release(MouseButton::Middle)),
        ];
        for _ in 0..5 {
            let at = play(&mut manipulator, &world, &acts, 0.2, 60);
            assert!(world.height_m(at.translation) >= manipulator.clearance_m - 1e-6);
        }
        let rest = play(&mut manipulator, &world, &[], 3.0, 60);
        assert!(world.height_m(manipulator.center()).abs() < 0.01 * manipulator.distance_m().max(1.0));
        assert!(rest.is_finite());
    }
}

#[test]
fn walking_and_driving_follow_the_ground() {
    let world = World::alps();
    let bounds = world.bounds;
    let start = bounds.frame.world_from_local.transform_point3(DVec3::new(0.0, 0.0, 1000.0));
    let pose = terrane::viewer::world_from_eye(start, bounds.frame.direction(0.4, 0.0), bounds.frame.up());
    let mut walker = FirstPersonManipulator::default();
    walker.set_pose(&pose, &world.view());
    let stood = play(&mut walker, &world, &[], 2.0, 60);
    assert!((world.height_m(stood.translation) - 1.7).abs() < 1e-3, "it falls to the ground");
    let walked = play(&mut walker, &world, &[(0.0, Act::Down(Key::Up))], 5.0, 60);
    assert!((world.height_m(walked.translation) - 1.7).abs() < 1.0, "{}", world.height_m(walked.translation));
    let way_m = walked.translation.distance(stood.translation);
    assert!((15.0..40.0).contains(&way_m), "{way_m}");

    let mut driver = DriveManipulator::default();
    driver.set_pose(&pose, &world.view());
    play(&mut driver, &world, &[], 2.0, 60);
    let acts = [(0.0, Act::Down(Key::Up)), (3.9, Act::Up(Key::Up))];
    let driven = play(&mut driver, &world, &acts, 4.0, 60);
    assert!(driver.speed_m_per_s() > 50.0);
    assert!(world.height_m(driven.translation).abs() < 40.0, "{}", world.height_m(driven.translation));
    let stopped = play(&mut driver, &world, &[], 20.0, 60);
    assert_eq!(driver.speed_m_per_s(), 0.0);
    assert!((world.height_m(stopped.translation) - 2.0).abs() < 1e-3);
}

#[test]
fn key_tapped_within_a_frame_moves_for_that_frame() {
    let world = World::alps();
    let start = world.bounds.frame.world_from_local.transform_point3(DVec3::new(0.0, 0.0, 1000.0));
    let pose = terrane::viewer::world_from_eye(start, world.bounds.frame.direction(0.4, 0.0), world.bounds.frame.up());
    let movers: [(&str, Box<dyn CameraManipulator>); 3] = [
        ("fly", Box::new(FlyManipulator::default())),
        ("first person", Box::new(FirstPersonManipulator::default())),
        ("drive", Box::new(DriveManipulator::default())),
    ];
    for (name, mut mover) in movers {
        mover.set_pose(&pose, &world.view());
        let stood = play(&mut *mover, &world, &[], 4.0, 5);
        let tap = [(0.05, Act::Down(Key::Up)), (0.08, Act::Up(Key::Up))];
        let tapped = play(&mut *mover, &world, &tap, 20.0, 5);
        assert!(tapped.translation.distance(stood.translation) > 0.05, "{name} ignores the tap");
        let rest = play(&mut *mover, &world, &[], 1.0, 5);
        assert!(rest.translation.distance(tapped.translation) < 1e-3, "{name} goes on");
    }
}

#[test]
fn letters_move_only_while_a_button_is_held() {
    let world = World::plane();
    let mut fly = FlyManipulator::default();
    let start = home(&mut fly, &world);
    let w = Key::Char('w');
    let still = play(&mut fly, &world, &[(0.0, Act::Down(w)), (0.4, Act::Up(w))], 0.5, 60);
    assert_eq!(start, still);
    let acts = [(0.0, Act::Press(MouseButton::Right)), (0.0, Act::Down(w)), (0.4, Act::Up(w))];
    let flown = play(&mut fly, &world, &acts, 0.5, 60);
    let along = (flown.translation - start.translation).dot(-start.matrix3.z_axis);
    assert!(along > 50.0, "{along}");
}

#[test]
fn node_tracker_follows_its_node() {
    let mut world = World::plane();
    let child = Node::geode(vec![terrane::scene::Drawable::new(
        terrane::scene::Mesh::rectangle(DVec3::ZERO, DVec3::X, DVec3::Y).into(),
        terrane::scene::Material::default(),
    )]);
    let root = Page::from_node(Node::transform(DAffine3::IDENTITY, vec![child])).unwrap();
    let node = NodeId { page: world.scene.add_root(root), index: 0 };
    for mode in [TrackerMode::NodeCenter, TrackerMode::NodeCenterAndAzimuth, TrackerMode::NodeCenterAndRotation] {
        world.scene.set_transform(node, DAffine3::IDENTITY).unwrap();
        let mut tracker = NodeTrackerManipulator::new(node, mode);
        let start = home(&mut tracker, &world);
        let turn = DAffine3::from_rotation_x(0.3) * DAffine3::from_rotation_z(1.0);
        let moved = DAffine3::from_translation(DVec3::new(5e5, -3e5, 100.0)) * turn;
        world.scene.set_transform(node, moved).unwrap();
        let followed = tracker.advance(0.016, &world.view());
        let center = world.scene.node_sphere(node).unwrap().center;
        assert!((followed.translation.distance(center) - tracker.distance_m()).abs() < 1e-6);
        let aside = (center - followed.translation).normalize().dot(-followed.matrix3.z_axis);
        assert!(aside > 1.0 - 1e-12, "{mode:?} looks elsewhere");
        let same_direction = followed.matrix3.z_axis.distance(start.matrix3.z_axis) < 1e-9;
        assert_eq!(same_direction, mode == TrackerMode::NodeCenter, "{mode:?}");
        if mode == TrackerMode::NodeCenterAndRotation {
            assert!(followed.matrix3.abs_diff_eq(turn.matrix3 * start.matrix3, 1e-9));
        } else {
            assert!(followed.matrix3.x_axis.z.abs() < 1e-12, "{mode:?}: the horizon is level");
        }
    }
    // A removed node keeps its last position.
    let mut tracker = NodeTrackerManipulator::new(node, TrackerMode::NodeCenter);
    let before = home(&mut tracker, &world);
    world.scene.remove_root(node.page).unwrap();
    assert_eq!(tracker.advance(0.1, &world.view()), before);
}

#[test]
fn path_is_played_paused_and_sped_up() {
    let world = World::plane();
    let point = |t: f64| ControlPoint::from_pose(t, &DAffine3::from_translation(DVec3::X * 10.0 * t));
    let path = AnimationPath::new(vec![point(2.0), point(6.0)]).unwrap();
    let mut player = AnimationPathManipulator::new(path);
    let x =
        |player: &mut AnimationPathManipulator, acts: &[(f64, Act)]| play(player, &world, acts, 1.0, 50).translation.x;
    assert!((x(&mut player, &[]) - 30.0).abs() < 1e-9);
    let p = Key::Char('p');
    assert!((x(&mut player, &[(0.5, Act::Down(p)), (0.5, Act::Up(p))]) - 35.0).abs() < 1e-9);
    assert!(!player.is_moving() && (x(&mut player, &[(0.9, Act::Down(p)), (0.9, Act::Up(p))]) - 36.0).abs() < 1e-9);
    let double = Key::Char(')');
    assert!((x(&mut player, &[(0.0, Act::Down(double))]) - 56.0).abs() < 1e-9);
    assert!((x(&mut player, &[]) - 60.0).abs() < 1e-9 && player.is_finished());
    player.home(&world.view());
    assert_eq!(player.advance(0.0, &world.view()).translation.x, 20.0);
}

#[test]
fn switch_passes_the_pose_on() {
    let world = World::plane();
    let mut switch: KeySwitchManipulator = usual(None);
    assert_eq!(switch.current_name(), "terrain");
    switch.home(&world.view());
    let before = switch.advance(0.0, &world.view());
    for (key, name) in [('1', "trackball"), ('2', "fly"), ('5', "orbit"), ('9', "orbit"), ('4', "terrain")] {
        let key = Key::Char(key);
        let after = play(&mut switch, &world, &[(0.0, Act::Down(key)), (0.0, Act::Up(key))], 0.02, 50);
        assert_eq!(switch.current_name(), name);
        assert!(after.translation.distance(before.translation) < 1e-6, "{name}");
        assert!(after.matrix3.z_axis.distance(before.matrix3.z_axis) < 1e-9, "{name}");
    }
}

fn act() -> impl Strategy<Value = Act> {
    let button = || prop::sample::select(vec![MouseButton::Left, MouseButton::Middle, MouseButton::Right]);
    let keys = [
        Key::Up,
        Key::Down,
        Key::Left,
        Key::Right,
        Key::PageUp,
        Key::PageDown,
        Key::Char('w'),
        Key::Char('d'),
        Key::Char('1'),
        Key::Char('2'),
        Key::Char('3'),
        Key::Char('4'),
        Key::Char('5'),
        Key::Char('6'),
    ];
    let number = prop_oneof![3 => -3000.0..3000.0, 1 => prop::num::f64::ANY];
    let key = || prop::sample::select(keys.to_vec());
    prop_oneof![
        1 => button().prop_map(Act::Press),
        1 => button().prop_map(Act::Release),
        4 => (number.clone(), number.clone()).prop_map(|(x, y)| Act::Move(x, y)),
        1 => number.prop_map(Act::Scroll),
        1 => key().prop_map(Act::Down),
        1 => key().prop_map(Act::Up),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]

    #[test]
    fn poses_stay_finite(
        acts in prop::collection::vec((0.0..2.0f64, act()), 0..60),
        times in prop::collection::vec(prop_oneof![0.0..0.1f64, prop::num::f64::ANY], 1..20),
        which in 0usize..8,
        world in 0usize..3,
        senseless_ground: bool,
    ) {
        let mut world = [World::plane(), World::alps(), World::globe()].into_iter().nth(world).unwrap();
        if senseless_ground {
            world.ground = Some(Box::new(|_: &Scene, p: DVec3, _: DVec3| Some(p * f64::NAN)));
        }
        let (name, mut manipulator) = all().remove(which);
        home(&mut *manipulator, &world);
        let mut acts = acts;
        acts.sort_by(|a, b| a.0.total_cmp(&b.0));
        let pose = play(&mut *manipulator, &world, &acts, 2.0, 30);
        prop_assert!(pose.is_finite(), "{name} {pose}");
        manipulator.set_pose(&DAffine3::NAN, &world.view());
        for dt_s in times {
            let pose = manipulator.advance(dt_s, &world.view());
            prop_assert!(pose.is_finite(), "{name} {pose} after {dt_s}");
            let unit = (pose.matrix3.transpose() * pose.matrix3 - glam::DMat3::IDENTITY).to_cols_array();
            prop_assert!(unit.iter().all(|v| v.abs() < 1e-9), "{name}: not a rotation {unit:?} {pose}");
        }
        manipulator.home(&world.view());
        prop_assert!(manipulator.advance(0.1, &world.view()).is_finite());
    }
}

#[test]
fn unused_events_are_not_handled() {
    let world = World::plane();
    for (name, mut manipulator) in all() {
        let mut queue = EventQueue::default();
        queue.key_press(Key::Char('x'), Key::Char('x'), 0.0);
        queue.focus(true, 0.0);
        let mut events = Vec::new();
        queue.take_frame(&mut events, 0.0);
        for event in &events {
            assert!(!manipulator.handle(event, &world.view()), "{name} takes {:?}", event.kind);
        }
        assert!(matches!(events.last().unwrap().kind, EventKind::Frame));
    }
}
