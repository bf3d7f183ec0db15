//! Compile operations: budgets, splitting, sharing, reuse of released slots, and failed allocations.

use std::sync::Arc;
use std::time::Duration;

use kit::frames::count;
use kit::rig::{Rig, new_rig, noop_traits, plain, unit_camera};
use kit::shapes::{mesh, quad, with_mips};
use kit::skip::skipped;
use kit::terrain::Terrain;
use terrane::gpu::{CompileBudget, CompileOperation, GraphicsContext};
use terrane::scene::{DrawSlot, Drawable, Geometry, Material, MeshVertex, Node, Page, Scene, TexelFormat, Texture};

fn fresh() -> Option<Rig> {
    new_rig([64, 64])
}

fn textured(texture: &Arc<Texture>) -> Drawable {
    let mut drawable = quad([0.0; 3], [1.0, 1.0], [1.0; 4]);
    drawable.material.texture = Some(texture.clone());
    drawable
}

#[test]
fn huge_texture_is_split_over_calls_and_complete_at_the_end() {
    let Some(mut rig) = fresh() else { return };
    // The texture has 64 quadrants in two colors, so that a missing or misplaced slice is visible.
    let side = 2048u32;
    let pixels = (0..side * side)
        .flat_map(
            |i| if (i % side / 256 + i / side / 256).is_multiple_of(2) { [255, 0, 0, 255] } else { [0, 0, 255, 255] },
        )
        .collect();
    let texture = Arc::new(with_mips(side, side, pixels));
    let bytes: u64 = texture.mips.iter().map(|m| m.len() as u64).sum();
    rig.ctx.compile(CompileOperation { ticket: 7, drawables: vec![textured(&texture)] });
    let budget = CompileBudget { time: Duration::from_secs(1), bytes: 1 << 20 };
    let (mut calls, mut sum) = (0, 0);
    while rig.ctx.pending_compiles() > 0 {
        let stats = rig.ctx.run_compiles(&budget);
        assert!(stats.bytes <= budget.bytes, "{} bytes in one call", stats.bytes);
        assert!(stats.bytes > 0);
        calls += 1;
        sum += stats.bytes;
        assert!(calls < 100);
    }
    assert!(calls >= bytes / budget.bytes, "{calls} calls");
    assert!(sum >= bytes && sum < bytes + 1000, "{sum} of {bytes}");
    let compiled = rig.ctx.take_compiled().remove(0);
    assert_eq!((compiled.ticket, compiled.slots.len(), compiled.errors.len()), (7, 1, 0));
    assert!(compiled.bytes >= bytes);

    let mut page = Page::from_node(Node::geode(vec![textured(&texture)])).unwrap();
    page.take_drawables();
    let mut drawable_is_unlit = textured(&texture);
    drawable_is_unlit.material.unlit = true;
    page.set_draw_slots(0, compiled.slots);
    let mut scene = Scene::new();
    scene.add_root(page);
    let picture = rig.picture(&scene, &unit_camera(64), &plain());
    let (red, blue) = (count(&picture, [255, 0, 0]), count(&picture, [0, 0, 255]));
    assert!(red > 1000 && red.abs_diff(blue) < 200, "{red} red, {blue} blue");
}

#[test]
fn images_with_padded_rows_use_staging_memory() {
    let Some(mut rig) = fresh() else { return };
    // Rows of 4 bytes take 256. The first image is larger than a staging buffer, and two do not fit into one.
    for (ticket, [width, height]) in [[1, 4096], [3, 1500], [256, 256], [65, 1000], [1, 1]].into_iter().enumerate() {
        let texture = Arc::new(with_mips(width, height, vec![7; (width * height * 4) as usize]));
        rig.ctx.compile(CompileOperation { ticket: ticket as u64, drawables: vec![textured(&texture)] });
    }
    for _ in 0..1000 {
        rig.ctx.run_compiles(&CompileBudget { time: Duration::from_secs(1), bytes: 100_000 });
    }
    let compiled = rig.ctx.take_compiled();
    assert_eq!(compiled.iter().map(|c| c.ticket).collect::<Vec<_>>(), [0, 1, 2, 3, 4]);
    assert!(compiled.iter().all(|c| c.errors.is_empty() && c.slots.iter().all(|s| *s != DrawSlot::NONE)));
    assert_eq!(rig.ctx.take_device_errors(), Vec::<String>::new());
}

#[test]
fn call_always_uploads_something_and_nothing_from_an_empty_queue() {
    let Some(mut rig) = fresh() else { return };
    let nothing = CompileBudget { time: Duration::ZERO, bytes: 0 };
    assert_eq!(rig.ctx.run_compiles(&nothing).slices, 0);
    for ticket in 0..3 {
        rig.ctx.compile(CompileOperation { ticket, drawables: vec![quad([0.0; 3], [1.0, 1.0], [1.0; 4])] });
    }
    rig.ctx.compile(CompileOperation { ticket: 3, drawables: Vec::new() });
    let mut tickets = Vec::new();
    for _ in 0..20 {
        let stats = rig.ctx.run_compiles(&nothing);
        assert!(stats.slices <= 1);
        tickets.extend(rig.ctx.take_compiled().into_iter().map(|c| c.ticket));
    }
    assert_eq!(tickets, [0, 1, 2, 3], "all finish, in order");
}

#[test]
fn equal_images_meshes_and_indices_are_uploaded_once() {
    let Some(mut rig) = fresh() else { return };
    let texture = Arc::new(with_mips(128, 128, vec![200; 128 * 128 * 4]));
    let first = rig.compile(vec![textured(&texture)]);
    let again = rig.compile(vec![textured(&texture)]);
    assert!(first.bytes > texture.mips[0].len() as u64);
    assert!(again.bytes < 10_000, "the image is shared: {} bytes", again.bytes);

    let drawable = quad([0.0; 3], [1.0, 1.0], [1.0; 4]);
    rig.compile(vec![drawable.clone()]);
    assert_eq!(rig.compile(vec![drawable.clone(), drawable]).bytes, 0, "the mesh is shared");

    let indices: Arc<[u32]> = (0..3000u32).map(|i| i % 100).collect();
    let with_indices = |z: f32| {
        let vertices = (0..100).map(|i| MeshVertex { position: [i as f32, 0.0, z], ..MeshVertex::default() });
        let mut mesh = mesh(vertices.collect(), vec![0]);
        mesh.indices = indices.clone();
        Drawable::new(Geometry::Mesh(Arc::new(mesh)), Material::default())
    };
    let one = rig.compile(vec![with_indices(0.0)]);
    let other = rig.compile(vec![with_indices(1.0)]);
    assert!(other.bytes + 2 * 3000 <= one.bytes, "{} then {}", one.bytes, other.bytes);

    // After all drawables are released one by one, only the white texel is left.
    for compiled in [first, again, one, other] {
        rig.ctx.release(&compiled.slots);
        rig.ctx.flush_released();
    }
    rig.ctx.release(&[DrawSlot::NONE, DrawSlot(99_999)]);
    rig.ctx.flush_released();
}

/// A mesh is drawn only once it is uploaded completely. Regression: half of one showed the earlier content of its slot.
#[test]
fn mesh_in_upload_is_complete_for_another_drawable_that_shares_it() {
    let Some(mut rig) = fresh() else { return };
    // There are enough squares to fill the view.
    let side = 100;
    let corner = |i: usize| MeshVertex {
        position: [i % (side + 1), i / (side + 1), side / 2].map(|x| x as f32 / side as f32 * 2.0 - 1.0),
        normal: [0, 0, 127, 0],
        color: [255; 4],
        ..MeshVertex::default()
    };
    let vertices: Vec<MeshVertex> = (0..(side + 1) * (side + 1)).map(corner).collect();
    let square = |i: usize| {
        let a = (i / side * (side + 1) + i % side) as u32;
        let above = a + side as u32 + 1;
        [a, a + 1, above + 1, a, above + 1, above]
    };
    let large = Arc::new(mesh(vertices, (0..side * side).flat_map(square).collect()));
    let mut shown = quad([0.0; 3], [0.1; 2], [1.0; 4]);
    shown.material.base_color = [0.0, 1.0, 0.0, 1.0];
    let mut page = Page::from_node(Node::geode(vec![shown.clone()])).unwrap();
    let compiled = rig.compile(page.take_drawables());
    let slot = compiled.slots[0];
    page.set_draw_slots(0, compiled.slots);
    let mut scene = Scene::new();
    scene.add_root(page);
    let on_its_way = Drawable::new(Geometry::Mesh(large.clone()), shown.material);
    rig.ctx.compile(CompileOperation { ticket: 1, drawables: vec![on_its_way] });
    rig.ctx.run_compiles(&CompileBudget { time: Duration::from_secs(1), bytes: 16 << 10 });
    assert_eq!(rig.ctx.pending_compiles(), 1);
    rig.ctx.rewrite(slot, &large).unwrap();
    let picture = rig.picture(&scene, &unit_camera(64), &plain());
    assert!(count(&picture, [0, 255, 0]) > 64 * 64 - 64, "{}", count(&picture, [0, 255, 0]));
}

/// Regression: one frame freed all of them.
#[test]
fn thousands_of_released_drawables_are_freed_within_some_frames() {
    let Some(mut rig) = fresh() else { return };
    rig.compile(vec![quad([0.0; 3], [1.0, 1.0], [1.0; 4])]);
    let base = rig.ctx.bytes_in_use();
    let one = |i: u16| quad([f32::from(i), 0.0, 0.0], [1.0, 1.0], [1.0; 4]);
    let compiled = rig.compile((0..3000).map(one).collect());
    let all = rig.ctx.bytes_in_use() - base;
    for part in compiled.slots.chunks(7) {
        rig.ctx.release(part);
    }
    let left = |rig: &Rig| (rig.ctx.bytes_in_use() - base) as f64 / all as f64;
    // How many are freed in a frame depends on the time that it takes; at least 32.
    let mut shares = vec![left(&rig)];
    while shares.last().is_some_and(|share| *share > 0.0) && shares.len() <= 3000 / 32 + 1 {
        rig.picture(&Scene::new(), &unit_camera(4), &plain());
        shares.push(left(&rig));
    }
    assert!(shares.windows(2).all(|two| two[1] < two[0]), "{shares:?}");
    assert_eq!(shares.last(), Some(&0.0));

    // Uploads use released slots before new ones.
    let again = rig.compile((0..3000).map(one).collect());
    let allocated = rig.ctx.bytes_allocated();
    rig.ctx.release(&again.slots);
    rig.compile((0..3000).map(one).collect());
    assert_eq!((left(&rig), rig.ctx.bytes_allocated()), (1.0, allocated));
}

#[test]
fn released_slots_are_reused() {
    let Some(mut rig) = fresh() else { return };
    let terrain = Terrain { west: 0.1, south: 0.7, width: 0.01, relief_m: 1000.0, root_error_m: 100.0, textured: true };
    let drawables = |x: u32| {
        let mut page = Page::from_node(Node::group(vec![
            terrain.tile(3, x, 0),
            Node::geode(vec![quad([0.0; 3], [1.0, 1.0], [1.0; 4])]),
        ]))
        .unwrap();
        page.take_drawables()
    };
    rig.compile(vec![quad([0.0; 3], [1.0, 1.0], [1.0; 4])]);
    let base = (rig.ctx.bytes_in_use(), rig.ctx.bytes_allocated());
    let first = rig.compile(drawables(0));
    // The blocks grow once for the second tile.
    let second = rig.compile(drawables(1));
    rig.ctx.release(&second.slots);
    rig.ctx.flush_released();
    let used = (rig.ctx.bytes_in_use(), rig.ctx.bytes_allocated());
    assert!(used.0 >= base.0 + first.bytes);
    for x in 2..8 {
        let kept = rig.compile(drawables(x));
        rig.ctx.release(&kept.slots);
        rig.ctx.flush_released();
        assert_eq!((rig.ctx.bytes_in_use(), rig.ctx.bytes_allocated()), used, "round {x}");
    }
    let peak = rig.ctx.bytes_peak();
    rig.ctx.release(&first.slots);
    rig.ctx.flush_released();
    // The second release of a slot has no owner.
    rig.ctx.release(&first.slots);
    rig.ctx.flush_released();
    assert_eq!(rig.ctx.bytes_in_use(), base.0);
    assert_eq!(rig.ctx.bytes_allocated(), base.1, "empty blocks are given back");
    assert_eq!(rig.ctx.bytes_peak(), peak);
    let again = rig.compile(drawables(3));
    assert!(again.slots.iter().all(|s| first.slots.contains(s)), "{:?} {:?}", again.slots, first.slots);
}

/// Cancelled operations stop. Regression: they were uploaded to the end.
#[test]
fn operation_cancelled_before_its_start_is_not_uploaded() {
    let Some(mut rig) = fresh() else { return };
    rig.compile(vec![quad([0.0; 3], [1.0, 1.0], [1.0; 4])]);
    let base = rig.ctx.bytes_in_use();
    let operation = |ticket| CompileOperation { ticket, drawables: vec![quad([0.0; 3], [1.0, 1.0], [1.0; 4])] };
    (10..15).for_each(|ticket| rig.ctx.compile(operation(ticket)));
    rig.ctx.cancel_compiles(&[11, 13, 14, 99]);
    let mut done = Vec::new();
    for _ in 0..1000 {
        rig.ctx.run_compiles(&CompileBudget::UNLIMITED);
        done.extend(rig.ctx.take_compiled());
        if done.len() == 5 {
            break;
        }
    }
    done.sort_by_key(|compiled| compiled.ticket);
    let made: Vec<_> = done.iter().map(|compiled| (compiled.ticket, compiled.slots.len())).collect();
    assert_eq!(made, [(10, 1), (11, 0), (12, 1), (13, 0), (14, 0)]);
    assert_eq!(rig.ctx.pending_compiles(), 0);
    done.iter().for_each(|compiled| rig.ctx.release(&compiled.slots));
    rig.ctx.flush_released();
    assert_eq!(rig.ctx.bytes_in_use(), base);
}

#[test]
fn compressed_texture_is_split_by_rows_of_blocks() {
    let Some(mut rig) = fresh() else { return };
    if !rig.ctx.block_formats().bc {
        return skipped("BC1 textures: the adapter lacks them");
    }
    // 64 squares of red and blue blocks: two equal colours of 5, 6 and 5 bits, and indices.
    let blocks_a_side = 512;
    let is_red = |i: u32| (i % blocks_a_side / 64 + i / blocks_a_side / 64).is_multiple_of(2);
    let block = |i: u32| if is_red(i) { [0, 0xf8, 0, 0xf8, 0, 0, 0, 0] } else { [0x1f, 0, 0x1f, 0, 0, 0, 0, 0] };
    let blocks: Vec<u8> = (0..blocks_a_side * blocks_a_side).flat_map(block).collect();
    let bytes = blocks.len() as u64;
    let texture = Texture { format: TexelFormat::Bc1, ..Texture::rgba8(2048, 2048, vec![blocks]) };
    assert_eq!(bytes, 2048 * 2048 / 2);
    let texture = Arc::new(texture);
    rig.ctx.compile(CompileOperation { ticket: 7, drawables: vec![textured(&texture)] });
    let budget = CompileBudget { time: Duration::from_secs(1), bytes: 100_000 };
    let (mut calls, mut sum) = (0, 0);
    while rig.ctx.pending_compiles() > 0 {
        let stats = rig.ctx.run_compiles(&budget);
        assert!(stats.bytes > 0 && stats.bytes <= budget.bytes, "{} bytes in one call", stats.bytes);
        (calls, sum) = (calls + 1, sum + stats.bytes);
    }
    assert!(calls >= bytes / budget.bytes && (bytes..bytes + 1000).contains(&sum), "{calls} calls, {sum} of {bytes}");
    let mut page = Page::from_node(Node::geode(vec![textured(&texture)])).unwrap();
    page.take_drawables();
    page.set_draw_slots(0, rig.ctx.take_compiled().remove(0).slots);
    let mut scene = Scene::new();
    scene.add_root(page);
    let picture = rig.picture(&scene, &unit_camera(64), &plain());
    assert_eq!([count(&picture, [255, 0, 0]), count(&picture, [0, 0, 255])], [64 * 64 / 2; 2]);
}

#[test]
fn drawable_that_cannot_be_uploaded_is_one_error() {
    let Some(mut rig) = fresh() else { return };
    let good = quad([0.0; 3], [1.0, 1.0], [1.0; 4]);
    let bad_texture =
        |width: u32, height: u32, mips: Vec<Vec<u8>>| textured(&Arc::new(Texture::rgba8(width, height, mips)));
    let with_index = |index: u32| {
        let mesh = mesh(vec![MeshVertex::default(); 3], vec![0, 1, index]);
        Drawable::new(Geometry::Mesh(Arc::new(mesh)), Material::default())
    };
    let mut tile =
        Terrain { west: 0.1, south: 0.7, width: 0.01, relief_m: 1.0, root_error_m: 1.0, textured: false }.tile(0, 0, 0);
    let terrane::scene::NodeKind::Geode(tile) = &mut tile.children[0].kind else { panic!("a geode") };
    let mut tile = tile.remove(0);
    if let Geometry::Height(tile) = &mut tile.geometry {
        Arc::make_mut(tile).heights.pop();
    }
    let drawables = vec![
        good.clone(),
        bad_texture(0, 4, vec![vec![]]),
        bad_texture(1 << 20, 1, vec![vec![0; 4 << 20]]),
        bad_texture(4, 4, vec![vec![0; 63]]),
        bad_texture(4, 4, Vec::new()),
        bad_texture(1, 1, vec![vec![0; 4], vec![0; 4]]),
        with_index(3),
        with_index(u32::MAX),
        tile,
        good,
    ];
    let before = rig.ctx.bytes_in_use();
    let compiled = rig.compile(drawables);
    let made: Vec<_> = compiled.slots.iter().map(|s| *s != DrawSlot::NONE).collect();
    assert_eq!(made, [true, false, false, false, false, false, false, false, false, true]);
    assert_eq!(compiled.errors.len(), 8, "{:?}", compiled.errors);
    rig.ctx.release(&compiled.slots);
    rig.ctx.flush_released();
    let white_texel = 4;
    assert_eq!(rig.ctx.bytes_in_use(), before + white_texel, "partial allocations are released");
    assert!(rig.ctx.take_device_errors().is_empty());
}

#[test]
fn noop_backend_compiles_and_draws() {
    let Rig { mut ctx, mut renderer, .. } = Rig::new(GraphicsContext::new_offscreen(&noop_traits([64, 64])).unwrap());
    ctx.compile(CompileOperation { ticket: 1, drawables: vec![quad([0.0; 3], [1.0, 1.0], [1.0; 4])] });
    ctx.run_compiles(&CompileBudget::UNLIMITED);
    assert_eq!(ctx.take_compiled().len(), 1);
    let stage = terrane::cull::RenderStage::new();
    let stats = renderer.draw(&mut ctx, &stage, &plain()).unwrap();
    assert_eq!(stats.leaves, 0);
    assert!(ctx.resize([0, 10]).is_err());
    assert!(ctx.resize([128, 32]).is_ok());
    assert_eq!(renderer.read_back(&mut ctx).unwrap().dimensions(), (128, 32));
}

/// Regression: it was a device error that invalidated other uploads of the frame; a height grid without an index buffer
/// panicked.
#[test]
fn out_of_memory_fails_one_drawable_only() {
    let Some(mut rig) = fresh() else { return };
    let image = |side: u32, shade: u8| Arc::new(with_mips(side, side, vec![shade; (side * side * 4) as usize]));
    let tile = || {
        let terrain = Terrain { west: 0.1, south: 0.7, width: 0.01, relief_m: 1.0, root_error_m: 1.0, textured: false };
        let terrane::scene::NodeKind::Geode(mut tile) = terrain.tile(0, 0, 0).children.remove(0).kind else {
            panic!("a geode")
        };
        tile.remove(0)
    };
    let good = quad([0.0; 3], [1.0, 1.0], [1.0; 4]);
    let first = rig.compile(vec![good.clone(), textured(&image(4, 1))]);
    assert!(first.errors.is_empty());
    let (in_use, allocated) = (rig.ctx.bytes_in_use(), rig.ctx.bytes_allocated());
    // Existing pools have free slots, but no new pool can be allocated.
    rig.ctx.pretend_memory(Some(0));
    let large = mesh(vec![MeshVertex::default(); 5000], (0..5000).map(|i| i % 3).collect());
    let large = Drawable::new(Geometry::Mesh(Arc::new(large)), Material::default());
    let drawables = vec![good.clone(), textured(&image(64, 2)), large.clone(), tile(), textured(&image(4, 3)), good];
    let compiled = rig.compile(drawables.clone());
    let made: Vec<_> = compiled.slots.iter().map(|s| *s != DrawSlot::NONE).collect();
    assert_eq!(made, [true, false, false, false, true, true]);
    let errors = &compiled.errors;
    assert_eq!(errors.len(), 3, "{errors:?}");
    for (error, what) in errors.iter().zip(["texture block", "indices", "grid"]) {
        assert!(error.starts_with(&format!("out of graphics memory: {what} of ")), "{error}");
    }
    rig.ctx.release(&compiled.slots);
    rig.ctx.flush_released();
    assert_eq!(
        (rig.ctx.bytes_in_use(), rig.ctx.bytes_allocated()),
        (in_use, allocated),
        "no partial allocation is left"
    );
    // Any part of a height block may be the one whose allocation fails.
    let mut seen = Vec::new();
    for left_bytes in (0..).map(|step| step * 2048) {
        rig.ctx.pretend_memory(Some(left_bytes));
        let compiled = rig.compile(vec![tile()]);
        rig.ctx.release(&compiled.slots);
        rig.ctx.flush_released();
        let Some(error) = compiled.errors.first() else { break };
        let what = error.split(" of ").nth(1).unwrap().rsplit(": ").next().unwrap().to_owned();
        if seen.last() != Some(&what) {
            seen.push(what);
        }
        assert_eq!(rig.ctx.bytes_in_use(), in_use);
    }
    assert!(seen.len() >= 2, "{seen:?}");
    // With memory everything is uploaded.
    rig.ctx.pretend_memory(None);
    let compiled = rig.compile(drawables);
    assert!(compiled.errors.is_empty() && !compiled.slots.contains(&DrawSlot::NONE), "{:?}", compiled.errors);
    rig.ctx.release(&compiled.slots);
    rig.ctx.flush_released();
    assert!(rig.ctx.take_device_errors().is_empty());
}
