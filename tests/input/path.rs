//! Camera paths: the text format survives a round trip, and errors name the line. No GPU.

use glam::{DQuat, DVec3};
use proptest::prelude::*;
use terrane::viewer::{AnimationPath, ControlPoint, LoopMode, PathError};

#[test]
fn osg_example_lines_are_read() {
    let text = "0 0 -100 20 0.7071067811865476 0 0 0.7071067811865476\r\n\n# a remark\n2.5 1e3 5 6 0 0 0 1";
    let path = AnimationPath::parse(text).unwrap();
    assert_eq!(path.points().len(), 2);
    assert_eq!(path.duration_s(), 2.5);
    // The rotation maps eye axes to world axes: a camera turned 90 degrees about x looks along +y.
    let direction = -path.world_from_eye(0.0).matrix3.z_axis;
    assert!(direction.distance(DVec3::Y) < 1e-12);
}

#[test]
fn invalid_lines_are_named() {
    let good = "0 0 0 0 0 0 0 1\n";
    for (bad, says) in [
        ("1 2 3", "3 numbers instead of 8"),
        ("1 2 3 4 5 6 7 8 9", "9 numbers instead of 8"),
        ("1 2 three 4 5 6 7 8", "`three` is not a number"),
        ("1 2 nan 4 0 0 0 1", "not finite"),
        ("1 2 inf 4 0 0 0 1", "not finite"),
        ("1 2 3 4 0 0 0 0", "quaternion"),
        ("1;2;3", "not a number"),
    ] {
        let error = AnimationPath::parse(&format!("{good}\n{bad}\n{good}")).unwrap_err();
        let text = error.to_string();
        assert!(text.starts_with("line 3: ") && text.contains(says), "{bad}: {text}");
    }
    assert!(matches!(AnimationPath::parse("\n# nothing\n"), Err(PathError::Empty)));
    let missing = AnimationPath::read(std::path::Path::new("no/such.path")).unwrap_err();
    assert!(missing.to_string().contains("no/such.path"));
}

/// Regression: such times sorted to the ends, and the first use of the path panicked.
#[test]
fn times_that_are_not_finite_are_an_error() {
    let point = |time_s| ControlPoint { time_s, position: DVec3::ZERO, rotation: DQuat::IDENTITY };
    for time_s in [f64::NAN, -f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let error = AnimationPath::new(vec![point(0.0), point(time_s), point(1.0)]).unwrap_err();
        assert!(error.to_string().contains("not finite"), "{error}");
    }
    // The time between two points must be finite as well.
    let mut path = AnimationPath::new(vec![point(-f64::MAX), point(f64::MAX)]).unwrap();
    for mode in [LoopMode::NoLooping, LoopMode::Loop, LoopMode::Swing] {
        path.loop_mode = mode;
        assert!([-f64::MAX, 0.0, f64::MAX].iter().all(|time_s| path.world_from_eye(*time_s).is_finite()), "{mode:?}");
    }
}

proptest! {
    #[test]
    fn written_paths_read_back_to_the_same_bits(
        raw in prop::collection::vec((-1e3..1e3f64, prop::array::uniform3(-7e6..7e6f64), prop::array::uniform3(-3.0..3.0f64)), 1..20)
    ) {
        let points = raw.iter().map(|(time_s, p, r)| ControlPoint {
            time_s: *time_s,
            position: DVec3::from_array(*p),
            rotation: DQuat::from_euler(glam::EulerRot::ZYX, r[0], r[1], r[2]).normalize(),
        }).collect();
        let path = AnimationPath::new(points).unwrap();
        let back = AnimationPath::parse(&path.to_text()).unwrap();
        prop_assert_eq!(path, back);
    }

    #[test]
    fn no_text_panics(text in "\\PC*") {
        let _ = AnimationPath::parse(&text);
    }

    #[test]
    fn any_time_gives_a_pose(time_s in prop::num::f64::ANY) {
        let path = AnimationPath::parse("0 0 0 0 0 0 0 1\n1 5 0 0 0 0 1 0\n1 6 0 0 1 0 0 0").unwrap();
        prop_assert!(path.world_from_eye(time_s).is_finite());
    }
}
