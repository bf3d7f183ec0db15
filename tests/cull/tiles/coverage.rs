//! Tile trees: no hole, no tile drawn twice, every wanted tile is requested, coarse tiles first.

use std::collections::{BTreeSet, HashMap};

use super::model::{Kind, Tile, World, ancestors, assert_covered, camera, error_m, eye, replaces, skip, tile};
use kit::cull_scenes::square_box;
use proptest::prelude::*;
use terrane::cull::{CullCamera, RenderStage};
use terrane::math::Frustum;
use terrane::scene::{NodeId, Refine, SlotState};

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, ..ProptestConfig::default() })]

    /// Tiles are loaded in the order of requests, with failures and expiry in between. Once the root is loaded there is
    /// never a hole.
    #[test]
    fn replace_never_shows_a_hole(
        tree in tile(true, false),
        views in prop::collection::vec((eye(), prop::array::uniform2(-800.0..800.0f64)), 1..6),
        choices in prop::collection::vec((0u32..1000, 0u32..10), 40),
        skip_sse_factor in skip(),
    ) {
        // Without content the root could not be the fallback.
        let tree = Tile { kind: Kind::Content, ..tree };
        let mut world = World::new(&tree);
        world.load(NodeId { page: world.root, index: 0 });
        let mut step = 0;
        for (eye, target) in views {
            let mut camera = camera(eye, target);
            camera.settings.skip_sse_factor = skip_sse_factor;
            for _ in 0..12 {
                camera.frame += 1;
                let stage = world.cull(&camera);
                assert_covered(&world, &stage, &camera);
                let (pick, what) = choices[step % choices.len()];
                step += 1;
                for (i, request) in stage.requests.iter().enumerate() {
                    if what >= 5 || (i as u32 * 7 + pick).is_multiple_of(3) {
                        if what == 3 && pick.is_multiple_of(5) {
                            world.scene.set_failed(request.slot, true);
                        } else {
                            world.load(request.slot);
                        }
                    }
                }
                if what < 3 {
                    // A page is expired, whether it is used or not. Fallbacks must cover it.
                    let slots = world.all_slots();
                    let slot = slots[pick as usize % slots.len()];
                    if let SlotState::Resident(page) = world.scene.slot(slot).unwrap().state
                        && world.scene.is_expirable(page)
                        && slot != (NodeId { page: world.root, index: 0 })
                    {
                        world.scene.detach(page).unwrap();
                    }
                }
            }
        }
    }

    /// With any set of resident tiles that includes the root, each point is covered exactly once.
    #[test]
    fn any_resident_set_is_drawn_without_holes(
        tree in tile(true, false),
        eye in eye(),
        target in prop::array::uniform2(-800.0..800.0f64),
        resident in prop::collection::vec(any::<bool>(), 200),
    ) {
        let tree = Tile { kind: Kind::Content, ..tree };
        let mut world = World::new(&tree);
        world.load(NodeId { page: world.root, index: 0 });
        for _ in 0..4 {
            for (i, slot) in world.all_slots().into_iter().enumerate() {
                if resident[i % resident.len()] && world.scene.slot(slot).unwrap().state == SlotState::Empty {
                    world.load(slot);
                }
            }
        }
        let camera = camera(eye, target);
        assert_covered(&world, &world.cull(&camera), &camera);
    }

    /// Regression: the siblings of a tile that failed were loaded to the finest level and never drawn. Now they are drawn,
    /// and the content above the failed tile is drawn in its place alone.
    #[test]
    fn a_failed_tile_holds_back_no_other(
        tree in tile(true, true),
        fails in any::<prop::sample::Index>(),
        eye in eye(),
        target in prop::array::uniform2(-800.0..800.0f64),
    ) {
        let tree = Tile { kind: Kind::Content, refine: Refine::Replace, ..tree };
        let mut world = World::new(&tree);
        world.load(NodeId { page: world.root, index: 0 });
        let fails = fails.get(&world.tiles.keys().cloned().collect::<Vec<_>>()).clone();
        prop_assume!(fails != "r");
        let camera = camera(eye, target);
        for _ in 0..20 {
            let requests = world.cull(&camera).requests;
            if requests.is_empty() {
                break;
            }
            for request in requests {
                if **world.scene.slot(request.slot).unwrap().uri == *fails {
                    world.scene.set_failed(request.slot, true);
                } else {
                    world.load(request.slot);
                }
            }
        }
        let stage = world.cull(&camera);
        prop_assert!(stage.requests.is_empty());
        let mut wanted = Wanted { world: &world, camera: &camera, tiles: BTreeSet::new(), unsure: false };
        wanted.visit("r");
        prop_assume!(!wanted.unsure);
        let drawn = world.drawn(&stage);
        for name in wanted.tiles.iter().filter(|name| ancestors(name).all(|above| above != fails)) {
            prop_assert!(drawn.contains(name), "{} waits for {}: {:?}", name, fails, drawn);
        }
        // The failed tile is tried again. Nothing changes until it arrives; then exactly the wanted tiles are drawn.
        let slot = world.all_slots().into_iter().find(|slot| **world.scene.slot(*slot).unwrap().uri == *fails);
        if let Some(slot) = slot.filter(|slot| world.scene.slot(*slot).unwrap().state == SlotState::Failed) {
            world.scene.set_failed(slot, false);
            prop_assert_eq!(world.drawn(&world.cull(&camera)), drawn);
            let mut requests = world.cull(&camera).requests;
            while !requests.is_empty() {
                requests.iter().for_each(|request| world.load(request.slot));
                requests = world.cull(&camera).requests;
            }
            let stage = world.cull(&camera);
            prop_assert!(world.stand_ins(&stage).is_empty());
            prop_assert_eq!(&world.drawn(&stage), &wanted_tiles(&world, &camera));
        }
    }

    /// Loading the requested tiles leads to the wanted view without further requests.
    #[test]
    fn requests_lead_to_the_wanted_tiles(
        tree in tile(true, true),
        eye in eye(),
        target in prop::array::uniform2(-800.0..800.0f64),
        lod_scale in 0.5..2.0f64,
        skip_sse_factor in skip(),
    ) {
        let mut world = World::new(&tree);
        let mut camera = camera(eye, target);
        (camera.settings.lod_scale, camera.settings.skip_sse_factor) = (lod_scale, skip_sse_factor);
        let mut rounds = 0;
        let stage = loop {
            camera.frame += 1;
            let stage = world.cull(&camera);
            prop_assert_eq!(stage.counters.wanted_missing as usize, stage.requests.len());
            let requested: BTreeSet<_> = stage.requests.iter().map(|r| r.slot).collect();
            prop_assert_eq!(requested.len(), stage.requests.len(), "a tile was requested twice");
            if stage.requests.is_empty() {
                break stage;
            }
            // Coarse tiles have the higher priority along every path.
            let priority: HashMap<String, f32> = stage
                .requests
                .iter()
                .map(|r| (world.scene.slot(r.slot).unwrap().uri.to_string(), r.priority))
                .collect();
            for (name, own) in &priority {
                prop_assert!(own.is_finite() && *own >= 0.0);
                for above in ancestors(name).filter(|a| a != name) {
                    if let Some(coarser) = priority.get(above) {
                        prop_assert!(coarser > own, "{} {} before {} {}", name, own, above, coarser);
                    }
                }
            }
            stage.requests.iter().for_each(|r| world.load(r.slot));
            rounds += 1;
            prop_assert!(rounds < 20);
        };
        let drawn = world.drawn(&stage);
        let mut wanted = Wanted { world: &world, camera: &camera, tiles: BTreeSet::new(), unsure: false };
        wanted.visit("r");
        prop_assume!(!wanted.unsure);
        prop_assert_eq!(&drawn, &wanted.tiles);
        prop_assert_eq!(stage.counters.tiles_drawn as usize, drawn.len());
        // Every tile that is drawn carries the number of the frame.
        for slot in world.all_slots() {
            let info = world.scene.slot(slot).unwrap();
            if drawn.contains(&**info.uri) {
                prop_assert_eq!(info.last_used_frame, camera.frame);
            }
        }
    }
}

/// Returns the tiles that are wanted by the rules.
fn wanted_tiles(world: &World, camera: &CullCamera) -> BTreeSet<String> {
    let mut wanted = Wanted { world, camera, tiles: BTreeSet::new(), unsure: false };
    wanted.visit("r");
    wanted.tiles
}

/// Selects the wanted tiles directly by the rules, in f64.
struct Wanted<'a> {
    world: &'a World,
    camera: &'a CullCamera,
    tiles: BTreeSet<String>,
    unsure: bool,
}

impl Wanted<'_> {
    fn visit(&mut self, name: &str) {
        let (tile, center, half_m) = &self.world.tiles[name];
        let bounds = square_box(*center, *half_m);
        match self.in_frustum(&bounds) {
            Some(true) => {}
            Some(false) => return,
            None => self.unsure = true,
        }
        let eye = self.camera.eye_from_world.inverse().translation;
        let distance_m = bounds.distance_to(eye).max(1e-7);
        let is_replaced = ancestors(name).any(|above| above != name && replaces(&self.world.tiles[above].0));
        let error_px = error_m(tile, *half_m, is_replaced) * f64::from(self.camera.viewport_px[1])
            / (2.0 * 30f64.to_radians().tan())
            / distance_m
            / self.camera.settings.lod_scale;
        let limit_px = self.camera.settings.max_sse_px;
        let always = !matches!(tile.kind, Kind::Content | Kind::Empty);
        self.unsure |= !always && error_px > 0.0 && (error_px / limit_px - 1.0).abs() < 1e-3;
        let refine = !tile.children.is_empty() && (always || error_px > limit_px);
        if tile.kind == Kind::Content && (!refine || tile.refine == Refine::Add) {
            self.tiles.insert(name.to_owned());
        }
        if refine {
            for i in 0..tile.children.len() {
                self.visit(&format!("{name}/{i}"));
            }
        }
    }

    /// Returns true if a box is in the frustum, `None` if it is too close to a plane to decide.
    fn in_frustum(&self, b: &terrane::math::OrientedBox) -> Option<bool> {
        let in_eye = b.transformed(&self.camera.eye_from_world);
        let mut closest = f64::INFINITY;
        for plane in Frustum::from_clip(&self.camera.clip_from_eye).planes {
            let n = plane.truncate();
            let m = in_eye.half_axes;
            let reach = n.dot(m.x_axis).abs() + n.dot(m.y_axis).abs() + n.dot(m.z_axis).abs();
            closest = closest.min(n.dot(in_eye.center) + plane.w + reach);
        }
        if closest.abs() < 0.01 { None } else { Some(closest > 0.0) }
    }
}

/// An empty tile whose error is below the limit is not refined, so nothing is loaded for it.
#[test]
fn empty_tiles_are_refined_by_their_error() {
    let leaf = Tile { refine: Refine::Replace, kind: Kind::Content, children: vec![] };
    let tree = Tile { refine: Refine::Replace, kind: Kind::Empty, children: vec![leaf] };
    let world = World::new(&tree);
    // With 512 pixels for 60 degrees, an error of 51.2 m projects to 16 pixels at 1,419 m.
    let asked = |height_m: f64| world.cull(&camera([0.0, 0.0, height_m], [0.0, 0.1])).requests.len();
    assert_eq!([1_000.0, 1_400.0, 1_440.0, 1e6].map(asked), [1, 1, 0, 0]);
}

/// Regression: all ancestors of each visible tile were loaded.
#[test]
fn intermediate_levels_are_skipped() {
    let leaf = Tile { refine: Refine::Replace, kind: Kind::Content, children: vec![] };
    let tree = (0..5).fold(leaf, |below, _| Tile { children: vec![below.clone(); 4], ..below });
    let mut camera = camera([10.0, 10.0, 3.0], [12.0, 10.0]);
    let load = |camera: &CullCamera, fails: &str| {
        let mut world = World::new(&tree);
        let mut loaded = Vec::new();
        loop {
            let stage = world.cull(camera);
            if stage.requests.is_empty() {
                let stand_ins: BTreeSet<String> =
                    world.stand_ins(&stage).into_iter().map(|(name, _)| name.to_owned()).collect();
                return (world.drawn(&stage), stand_ins, loaded);
            }
            assert_covered_once_anything_is_drawn(&world, &stage, camera);
            for request in &stage.requests {
                let uri = world.scene.slot(request.slot).unwrap().uri.to_string();
                if uri == fails {
                    world.scene.set_failed(request.slot, true);
                    continue;
                }
                loaded.push(uri);
                world.load(request.slot);
            }
        }
    };
    let depths =
        |loaded: &[String]| -> BTreeSet<usize> { loaded.iter().map(|name| name.matches('/').count()).collect() };
    let (all, _, every) = load(&camera, "");
    camera.settings.skip_sse_factor = 16.0;
    let (drawn, _, some) = load(&camera, "");
    assert_eq!(drawn, all, "the same tiles are drawn");
    let above = |name: &str| all.iter().any(|drawn| drawn != name && ancestors(drawn).any(|above| above == name));
    let replaced = |loaded: &[String]| loaded.iter().filter(|name| above(name)).count();
    assert!(all.iter().any(|name| name.matches('/').count() == 5), "the finest level is drawn");
    assert!(depths(&every).len() == 6 && replaced(&every) > 5, "{every:?}");
    // Below the root, loading jumps over up to four levels.
    assert!(replaced(&some) <= replaced(&every) / 2 && some.len() < every.len(), "{some:?}");
    assert!(some.contains(&"r".to_owned()), "the root is loaded first");

    // The parent of a failed tile is loaded instead, and the other tiles stay fine.
    let fails = all.iter().find(|name| name.matches('/').count() == 5).unwrap();
    let above = fails.rsplit_once('/').unwrap().0;
    assert!(!some.contains(&above.to_owned()), "the parent was skipped before");
    let (drawn, stand_ins, loaded) = load(&camera, fails);
    assert!(loaded.contains(&above.to_owned()), "{loaded:?}");
    assert_eq!(stand_ins, BTreeSet::from([above.to_owned()]));
    assert_eq!(drawn, &all - &BTreeSet::from([fails.clone()]));
}

/// The content above a failed tile is loaded although it is skipped otherwise, and not any more once the tile has arrived.
#[test]
fn content_above_a_tile_that_has_recovered_is_skipped_again() {
    let leaf = Tile { refine: Refine::Replace, kind: Kind::Content, children: vec![] };
    let middle = Tile { children: vec![leaf.clone(); 4], ..leaf.clone() };
    let mut world = World::new(&Tile { children: vec![middle; 4], ..leaf });
    let mut camera = camera([10.0, 10.0, 3.0], [12.0, 10.0]);
    camera.settings.skip_sse_factor = 1e30;
    let slot = |world: &World, name: &str| {
        world.all_slots().into_iter().find(|slot| **world.scene.slot(*slot).unwrap().uri == *name).unwrap()
    };
    let load_all = |world: &mut World, fails: &str| {
        for _ in 0..10 {
            let requests = world.cull(&camera).requests;
            for request in &requests {
                match **world.scene.slot(request.slot).unwrap().uri == *fails {
                    true => world.scene.set_failed(request.slot, true),
                    false => world.load(request.slot),
                }
            }
        }
    };
    let (failed, above) = ("r/3/0", "r/3");
    load_all(&mut world, failed);
    let SlotState::Resident(page) = world.scene.slot(slot(&world, above)).unwrap().state else {
        panic!("{above} stands in for {failed}");
    };
    assert_eq!(world.stand_ins(&world.cull(&camera)).iter().map(|(name, _)| *name).collect::<Vec<_>>(), [above]);
    world.load(slot(&world, failed));
    world.scene.detach(page).unwrap();
    assert_eq!(world.cull(&camera).requests.len(), 0, "nothing would show {above}");
    // A tile that fails next to one that has recovered still needs it.
    for fails in ["r/3/0", "r/3/1"] {
        let SlotState::Resident(page) = world.scene.slot(slot(&world, fails)).unwrap().state else { panic!("{fails}") };
        world.scene.detach(page).unwrap();
        world.scene.set_failed(slot(&world, fails), true);
    }
    world.load(slot(&world, "r/3/0"));
    let requested: Vec<_> = world.cull(&camera).requests.iter().map(|request| request.slot).collect();
    assert_eq!(requested, [slot(&world, above)]);
}

/// Calls [`assert_covered`] once any tile is drawn.
fn assert_covered_once_anything_is_drawn(world: &World, stage: &RenderStage, camera: &CullCamera) {
    if !world.drawn(stage).is_empty() {
        assert_covered(world, stage, camera);
    }
}

/// Regression: the tile was skipped, and its ancestors waited for it forever.
#[test]
fn tile_above_empty_tiles_is_not_skipped() {
    let empty = |children| Tile { refine: Refine::Replace, kind: Kind::Empty, children };
    let middle = Tile { refine: Refine::Replace, kind: Kind::Content, children: vec![empty(vec![]); 4] };
    let tree = Tile { refine: Refine::Replace, kind: Kind::Content, children: vec![middle; 4] };
    let mut world = World::new(&tree);
    let mut camera = camera([10.0, 10.0, 3.0], [12.0, 10.0]);
    camera.settings.skip_sse_factor = 1e30;
    for _ in 0..3 {
        world.cull(&camera).requests.iter().for_each(|request| world.load(request.slot));
    }
    let stage = world.cull(&camera);
    assert!(stage.requests.is_empty());
    // The refinement of the tile is empty.
    assert!(world.drawn(&stage).is_empty());
    assert_eq!(
        world.all_slots().iter().filter(|s| world.scene.slot(**s).unwrap().state != SlotState::Empty).count(),
        5
    );
}

/// The parent of an external tileset waits for it, so it is loaded even if all its tiles lie outside of the frustum.
#[test]
fn external_tileset_is_loaded_even_if_its_tiles_are_culled() {
    let leaf = |refine| Tile { refine, kind: Kind::Content, children: vec![] };
    let external = Tile { refine: Refine::Replace, kind: Kind::External, children: vec![leaf(Refine::Replace)] };
    let tree = Tile { refine: Refine::Replace, kind: Kind::Content, children: vec![external] };
    let mut world = World::new(&tree);
    // The camera is above a corner of the external tile (-1024 to 0), which is visible; its child (to -512) is not.
    let mut camera = camera([-60.0, -60.0, 60.0], [-60.0, -60.5]);
    for round in 0.. {
        let stage = world.cull(&camera);
        assert!(round < 5);
        if stage.requests.is_empty() {
            assert_eq!(round, 2, "first the root and the external tileset, then its tile");
            assert!(world.drawn(&stage).is_empty(), "the root is replaced");
            break;
        }
        stage.requests.iter().for_each(|r| world.load(r.slot));
        camera.frame += 1;
    }
    for slot in world.all_slots() {
        assert_eq!(world.scene.slot(slot).unwrap().last_used_frame, camera.frame);
    }
}
