//! Equal contents of tiles are shared in the decode threads, on the GPU and in the budgets, until they change. Runs
//! without a GPU, except for images.

use std::path::Path;
use std::sync::{Arc, Barrier};
use std::time::{Duration, Instant};
use terrane::state::DataVariance;

use glam::{DAffine3, DVec3};
use kit::frames::count;
use kit::rig::{Rig, new_rig, plain, unit_camera};
use kit::shapes::{quad, with_mips};
use kit::viewer::offscreen;
use proptest::prelude::*;
use terrane::cull::{CullCamera, CullVisitor, RenderStage};
use terrane::fetch::{Limits, root_uri};
use terrane::formats::writers::{GlbMesh, write_glb};
use terrane::formats::{Content, ReadOptions, decode};
use terrane::gpu::{AdapterChoice, CompileBudget, CompileOperation, Compiled, ContextTraits, GraphicsContext};
use terrane::pager::{CompileContext, DatabasePager, PagerConfig, PagerStats};
use terrane::scene::{DrawSlot, Drawable, Geometry, Mesh, Node, Page, Scene, ShareModes, SharedStateManager, Texture};

const WORLD_M: f64 = 4096.0;

/// Returns a square of some cells, higher in the middle by `rise_m`, with an image of one colour.
fn glb(rise_m: u8, shade: u8) -> Vec<u8> {
    let side = 9usize;
    let mut mesh = GlbMesh { base_color: [1.0; 4], ..GlbMesh::default() };
    for j in 0..side {
        for i in 0..side {
            let [x, y] = [i, j].map(|k| 2.0 * k as f32 / (side - 1) as f32 - 1.0);
            mesh.positions.push([x, f32::from(rise_m) * (1.0 - x * x) * (1.0 - y * y), -y]);
            mesh.normals.push([0.0, 1.0, 0.0]);
            mesh.uvs.push([x, y]);
        }
    }
    for j in 0..side - 1 {
        for i in 0..side - 1 {
            let a = (j * side + i) as u16;
            let (b, c, d) = (a + 1, a + side as u16, a + side as u16 + 1);
            mesh.indices.extend([a, b, d, a, d, c]);
        }
    }
    let picture = image::RgbImage::from_pixel(32, 32, image::Rgb([shade, 255 - shade, 40]));
    let mut bytes = std::io::Cursor::new(Vec::new());
    picture.write_to(&mut bytes, image::ImageFormat::Png).unwrap();
    mesh.image = Some(bytes.into_inner());
    write_glb(&mesh)
}

fn options(modes: ShareModes) -> (ReadOptions, Option<Arc<SharedStateManager>>) {
    let sharing = modes.any().then(|| Arc::new(SharedStateManager::new(modes)));
    let options = ReadOptions::for_root("/set/tileset.json", Limits::default());
    (ReadOptions { sharing: sharing.clone(), ..options }, sharing)
}

fn read(bytes: &[u8], options: &ReadOptions) -> Page {
    let uri = "/set/tile.glb".into();
    decode(Content { uri, bytes: bytes.to_vec(), reader_data: None, companions: Vec::new() }, options).unwrap()
}

fn parts(drawable: &Drawable) -> (&Arc<Mesh>, &Arc<Texture>) {
    let Geometry::Mesh(mesh) = &drawable.geometry else { panic!("a mesh") };
    (mesh, drawable.material.texture.as_ref().unwrap())
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, ..ProptestConfig::default() })]

    /// Equal and unequal contents arrive in any order, and some are dropped meanwhile.
    #[test]
    fn sharing_changes_no_content(tiles in prop::collection::vec((0u8..4, 0u8..4, any::<bool>()), 1..24)) {
        let (naive, _) = options(ShareModes::NONE);
        let (shared, manager) = options(ShareModes::default());
        let manager = manager.unwrap();
        let mut kept: Vec<(u8, u8, Page, Drawable)> = Vec::new();
        for (rise_m, shade, drops) in tiles {
            let bytes = glb(rise_m, shade);
            let expected = read(&bytes, &naive).take_drawables().remove(0);
            let mut page = read(&bytes, &shared);
            let drawable = page.take_drawables().remove(0);
            prop_assert_eq!(parts(&drawable), parts(&expected));
            prop_assert_eq!(&drawable.material, &expected.material);
            for (r, s, _, other) in &kept {
                let (mine, others) = (parts(&drawable), parts(other));
                prop_assert_eq!(Arc::ptr_eq(mine.0, others.0), *r == rise_m, "meshes");
                prop_assert_eq!(Arc::ptr_eq(mine.1, others.1), *s == shade, "images");
            }
            if drops && !kept.is_empty() {
                kept.remove(0);
            }
            kept.push((rise_m, shade, page, drawable));
        }
        manager.prune_all();
        let distinct = |key: fn(&(u8, u8, Page, Drawable)) -> u8| {
            kept.iter().map(key).collect::<std::collections::BTreeSet<_>>().len() as u64
        };
        // The number of meshes, images, and the one index list.
        prop_assert_eq!(manager.stats().entries, distinct(|k| k.0) + distinct(|k| k.1) + 1);
        drop(kept);
        manager.prune_all();
        prop_assert_eq!(manager.stats().entries, 0);
    }
}

#[test]
fn workers_that_decode_the_same_concurrently_share_it() {
    let (options, manager) = options(ShareModes::default());
    let bytes = glb(3, 99);
    for round in 0..20u64 {
        let barrier = Barrier::new(8);
        let pages: Vec<(Page, Drawable)> = std::thread::scope(|scope| {
            let read_one = || {
                barrier.wait();
                let mut page = read(&bytes, &options);
                let drawable = page.take_drawables().remove(0);
                (page, drawable)
            };
            let handles: Vec<_> = (0..8).map(|_| scope.spawn(read_one)).collect();
            handles.into_iter().map(|h| h.join().unwrap()).collect()
        });
        let first = parts(&pages[0].1);
        for (_, drawable) in &pages {
            assert!(Arc::ptr_eq(parts(drawable).0, first.0) && Arc::ptr_eq(parts(drawable).1, first.1));
        }
        let stats = manager.as_ref().unwrap().stats();
        assert_eq!(stats.geometry_hits, 7 * (round + 1), "all except the first of a round");
        assert_eq!((stats.texture_hits, stats.entries), (7 * (round + 1), 3));
    }
}

#[test]
fn equal_geometry_has_one_kd_tree() {
    let (options, _) = options(ShareModes::default());
    let options = ReadOptions { build_kd_trees: true, ..options };
    let [a, b, other] = [glb(3, 1), glb(3, 2), glb(4, 1)].map(|bytes| read(&bytes, &options));
    assert!(Arc::ptr_eq(a.kd_tree(0).unwrap(), b.kd_tree(0).unwrap()));
    assert!(!Arc::ptr_eq(a.kd_tree(0).unwrap(), other.kd_tree(0).unwrap()));
}

/// A context of wgpu's noop adapter. Its memory is counted as with any other.
struct Noop {
    id: u32,
    gpu: GraphicsContext,
}

impl Noop {
    fn new(id: u32) -> Self {
        let traits = ContextTraits { adapter: AdapterChoice::Noop, validation: false, ..ContextTraits::default() };
        Self { id, gpu: GraphicsContext::new_offscreen(&traits).unwrap() }
    }
}

impl CompileContext for Noop {
    fn id(&self) -> u32 {
        self.id
    }

    fn compile(&mut self, operation: CompileOperation) {
        self.gpu.compile(operation);
    }

    fn run_compiles(&mut self, budget: &CompileBudget) {
        self.gpu.run_compiles(budget);
    }

    fn take_compiled(&mut self) -> Vec<Compiled> {
        self.gpu.run_compiles(&CompileBudget::UNLIMITED);
        self.gpu.take_compiled()
    }

    fn release(&mut self, slots: Vec<DrawSlot>) {
        self.gpu.release(&slots);
    }
}

/// Returns a quadtree of `levels` levels with repeating contents, as many different ones as `content` gives. The frame
/// of a tile is a square from -1 to 1.
fn write_quadtree(folder: &Path, levels: u32, content: impl Fn(u32) -> Vec<u8>) {
    fn tile(folder: &Path, content: &dyn Fn(u32) -> Vec<u8>, n: &mut u32, levels: u32, transform: String) -> String {
        let name = format!("{n}.glb");
        std::fs::write(folder.join(&name), content(*n)).unwrap();
        *n += 1;
        let child = |i: u32| {
            let [x, y] = [i % 2, i / 2].map(|k| f64::from(k) - 0.5);
            tile(folder, content, n, levels - 1, format!("[0.5,0,0,0,0,0.5,0,0,0,0,1,0,{x},{y},0,1]"))
        };
        let children: Vec<String> = if levels == 1 { Vec::new() } else { (0..4).map(child).collect() };
        let error = if levels == 1 { 0.0 } else { 0.125 };
        format!(
            r#"{{"boundingVolume":{{"box":[0,0,0,1,0,0,0,1,0,0,0,300]}},"refine":"REPLACE","geometricError":{error},"transform":{transform},"content":{{"uri":"{name}"}},"children":[{}]}}"#,
            children.join(",")
        )
    }
    let h = 0.5 * WORLD_M;
    let root = tile(folder, &content, &mut 0, levels, format!("[{h},0,0,0,0,{h},0,0,0,0,1,0,{h},{h},0,1]"));
    let json = format!(r#"{{"asset":{{"version":"1.1"}},"geometricError":1000,"root":{root}}}"#);
    std::fs::write(folder.join("tileset.json"), json).unwrap();
}

struct Run {
    scene: Scene,
    pager: DatabasePager,
    contexts: Vec<Noop>,
    stage: RenderStage,
    visitor: CullVisitor,
    frame: u32,
}

impl Run {
    fn new(folder: &Path, config: PagerConfig, contexts: u32) -> Self {
        let uri = root_uri(folder.to_str().unwrap()).unwrap();
        let mut pager = DatabasePager::new(config, ReadOptions::for_root(&uri, Limits::default())).unwrap();
        let mut scene = Scene::new();
        scene.add_root(pager.read_root(&uri).unwrap());
        let contexts = (0..contexts).map(Noop::new).collect();
        Self { scene, pager, contexts, stage: RenderStage::new(), visitor: CullVisitor::new(), frame: 0 }
    }

    fn frame(&mut self, eye: DVec3) -> PagerStats {
        self.frame += 1;
        let eye_from_world = DAffine3::from_translation(-eye);
        let mut camera = CullCamera { eye_from_world, frame: self.frame, ..CullCamera::default() };
        camera.settings.max_sse_px = 1.0;
        self.visitor.cull(&self.scene, &camera, &mut self.stage);
        let mut contexts: Vec<_> = self.contexts.iter_mut().map(|c| c as &mut dyn CompileContext).collect();
        self.pager.update_scene_graph(
            &mut self.scene,
            self.frame,
            f64::from(self.frame) / 60.0,
            &self.stage.requests,
            &mut contexts,
        );
        *self.pager.stats()
    }

    fn settle(&mut self, eye: DVec3) -> PagerStats {
        let end = Instant::now() + Duration::from_secs(60);
        self.frame(eye);
        while !self.pager.is_idle() || !self.stage.requests.is_empty() {
            assert!(Instant::now() < end, "does not settle: {:?} {:?}", self.pager.stats(), self.pager.errors());
            self.frame(eye);
            std::thread::sleep(Duration::from_micros(200));
        }
        let stats = self.frame(eye);
        let held: u64 = self.contexts.iter().map(|c| c.gpu.bytes_in_use()).sum();
        assert_eq!(stats.gpu_bytes, held, "the pager's counts equal those of the contexts: {stats:?}");
        stats
    }
}

fn over(x: f64, height_m: f64) -> DVec3 {
    DVec3::new(WORLD_M * x, 0.5 * WORLD_M, height_m)
}

#[test]
fn memory_of_a_closed_context_is_not_counted() {
    let folder = tempfile::tempdir().unwrap();
    write_quadtree(folder.path(), 4, |n| glb((n % 3) as u8, (n % 2) as u8));
    for sharing in [ShareModes::STATIC, ShareModes::NONE] {
        let mut run = Run::new(folder.path(), PagerConfig { sharing, ..PagerConfig::default() }, 3);
        let all = run.settle(over(0.5, 600_000.0));
        // The second context is closed while tiles load, the first one when nothing is in flight.
        run.frame(over(0.3, 200.0));
        for (left, goes) in [(2, 1), (1, 0)] {
            let gone = run.contexts.remove(goes);
            let mut contexts: Vec<_> = run.contexts.iter_mut().map(|c| c as &mut dyn CompileContext).collect();
            run.pager.forget_context(gone.id, &mut contexts);
            let held: u64 = run.contexts.iter().map(|c| c.gpu.bytes_in_use()).sum();
            assert!(held > 0 && run.pager.stats().gpu_bytes <= held, "pages that are not merged do not count");
            let stats = run.settle(over(0.3, 200.0));
            assert!(stats.resident > all.resident && stats.expired == 0, "{left} left: {stats:?}");
        }
        let mut contexts: Vec<_> = run.contexts.iter_mut().map(|c| c as &mut dyn CompileContext).collect();
        run.pager.clear(&mut run.scene, &mut contexts);
        let stats = run.pager.stats();
        assert_eq!((stats.gpu_bytes, stats.shared_gpu_bytes_saved, stats.cpu_bytes), (0, 0, 0));
    }
}

#[test]
fn each_content_is_uploaded_and_counted_once_per_context() {
    let folder = tempfile::tempdir().unwrap();
    // There are three meshes and two images.
    write_quadtree(folder.path(), 4, |n| glb((n % 3) as u8, (n % 2) as u8));
    let near = over(0.5, 1500.0);
    let settled = |modes: ShareModes, contexts: u32| {
        let config = PagerConfig { sharing: modes, ..PagerConfig::default() };
        let mut run = Run::new(folder.path(), config, contexts);
        let stats = run.settle(near);
        let bytes = run.contexts[0].gpu.bytes_in_use();
        (stats, bytes, run)
    };
    let (naive, naive_bytes, _) = settled(ShareModes::NONE, 1);
    let (shared, shared_bytes, _) = settled(ShareModes::default(), 1);
    assert!(naive.resident == shared.resident && naive.resident >= 40, "{naive:?} {shared:?}");
    // Five objects are stored instead of one for each tile. The grid's index list was shared before.
    assert!(shared_bytes * 10 < naive_bytes, "{shared_bytes} instead of {naive_bytes}");
    // With an index list for each tile; the naive tiles share them by address.
    assert!(shared.shared_gpu_bytes_saved >= naive_bytes - shared_bytes, "{shared:?} {naive_bytes}");
    assert_eq!(shared.sharing.geometry_hits, shared.loaded - 3);
    assert_eq!(shared.sharing.texture_hits, shared.loaded - 2);
    assert!(shared.sharing.decodes_spared > 0);
    assert_eq!(naive.shared_gpu_bytes_saved, 0);

    let (two, each, run) = settled(ShareModes::default(), 2);
    assert_eq!((two.gpu_bytes, each), (2 * shared_bytes, shared_bytes), "once in each of two contexts");
    assert_eq!(run.contexts[1].gpu.bytes_in_use(), shared_bytes);
}

/// Each tile has a separate mesh. Two external images are shared by half of the tiles each.
#[test]
fn hundred_tiles_with_two_images_hold_one_copy_of_each() {
    const SIDE_PX: u32 = 256;
    let bytes_of = |tiles: usize| {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: String, bytes: &[u8]| std::fs::write(folder.path().join(name), bytes).unwrap();
        for image in 0..2u8 {
            let texels = image::RgbImage::from_fn(SIDE_PX, SIDE_PX, |x, y| image::Rgb([x as u8, y as u8, image]));
            texels.save(folder.path().join(format!("{image}.png"))).unwrap();
        }
        for tile in 0..tiles {
            let corners = [[0.0, 0.0], [1.0 + tile as f32, 0.0], [0.0, 1.0]];
            let positions = corners.iter().flat_map(|[x, y]| [*x, *y, 0.0]);
            let mesh: Vec<u8> = positions.chain(corners.into_iter().flatten()).flat_map(f32::to_le_bytes).collect();
            write(format!("{tile}.bin"), &mesh);
            let gltf = format!(
                r#"{{"asset":{{"version":"2.0"}},"scenes":[{{"nodes":[0]}}],"nodes":[{{"mesh":0}}],
                "meshes":[{{"primitives":[{{"attributes":{{"POSITION":0,"TEXCOORD_0":1}},"material":0}}]}}],
                "materials":[{{"pbrMetallicRoughness":{{"metallicFactor":0,"baseColorTexture":{{"index":0}}}}}}],
                "textures":[{{"source":0}}],"images":[{{"uri":"{}.png"}}],
                "accessors":[{{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3","min":[0,0,0],"max":[200,1,0]}},
                {{"bufferView":1,"componentType":5126,"count":3,"type":"VEC2"}}],
                "bufferViews":[{{"buffer":0,"byteLength":36}},{{"buffer":0,"byteOffset":36,"byteLength":24}}],
                "buffers":[{{"byteLength":60,"uri":"{tile}.bin"}}]}}"#,
                tile % 2
            );
            write(format!("{tile}.gltf"), gltf.as_bytes());
        }
        let bounds = r#""geometricError":9,"boundingVolume":{"sphere":[0,0,0,300]}"#;
        let children: Vec<_> = (0..tiles).map(|i| format!(r#"{{{bounds},"content":{{"uri":"{i}.gltf"}}}}"#)).collect();
        let root = format!(r#"{{{bounds},"refine":"ADD","children":[{}]}}"#, children.join(","));
        let tileset = format!(r#"{{"asset":{{"version":"1.1"}},"geometricError":9,"root":{root}}}"#);
        write("tileset.json".to_owned(), tileset.as_bytes());
        let mut run = Run::new(folder.path(), PagerConfig::default(), 1);
        let stats = run.settle(DVec3::new(0.0, 0.0, 300.0));
        assert_eq!((stats.resident, stats.sharing.texture_hits), (tiles as u64, tiles as u64 - 2), "{stats:?}");
        stats.gpu_bytes
    };
    let (two, hundred) = (bytes_of(2), bytes_of(100));
    let images = 2 * (0..=SIDE_PX.ilog2()).map(|level| u64::from(SIDE_PX >> level).pow(2) * 4).sum::<u64>();
    assert!(two >= images, "{two} bytes for images of {images}");
    assert!(hundred * 10 <= 11 * images, "{hundred} bytes for images of {images}");
}

#[test]
fn budgets_hold_and_shared_slots_live_as_long_as_their_last_page() {
    let folder = tempfile::tempdir().unwrap();
    write_quadtree(folder.path(), 5, |n| glb((n % 200) as u8, (n % 7) as u8));
    // The budget is about a third of the size of 200 meshes and 7 images.
    let mut all = Run::new(folder.path(), PagerConfig::default(), 1);
    let everything = all.settle(over(0.5, 1500.0));
    let max_bytes_gpu = everything.gpu_bytes / 3;
    let config = PagerConfig { max_bytes_gpu, expiry_time: Duration::ZERO, ..PagerConfig::default() };
    let mut run = Run::new(folder.path(), config, 1);
    for i in 0..600u32 {
        let stats = run.frame(over(f64::from(i % 200) / 199.0, 250.0));
        assert!(stats.gpu_bytes <= max_bytes_gpu, "frame {i}: {stats:?}");
        std::thread::sleep(Duration::from_micros(300));
    }
    let stats = *run.pager.stats();
    assert!(stats.expired > 20 && stats.sharing.geometry_hits > 0, "{stats:?}");
    // After everything expires, only the white texel of the roots is left on the GPU.
    let mut contexts: Vec<_> = run.contexts.iter_mut().map(|c| c as &mut dyn CompileContext).collect();
    run.pager.page_anew(&mut run.scene, &mut contexts);
    run.pager.drop_uploads(&mut contexts);
    run.contexts[0].gpu.flush_released();
    assert!(run.contexts[0].gpu.bytes_in_use() <= 4, "{} bytes", run.contexts[0].gpu.bytes_in_use());
    let end = Instant::now() + Duration::from_secs(20);
    let sharing = run.pager.sharing().unwrap().clone();
    loop {
        // Pages that were being read are still merged, and expire too.
        let far = DVec3::new(0.0, 0.0, -1e9);
        let stats = run.frame(far);
        let mut contexts: Vec<_> = run.contexts.iter_mut().map(|c| c as &mut dyn CompileContext).collect();
        run.pager.page_anew(&mut run.scene, &mut contexts);
        sharing.prune_all();
        if stats.in_flight == 0 && sharing.stats().entries == 0 {
            break;
        }
        assert!(Instant::now() < end, "{stats:?} {sharing:?}");
        std::thread::sleep(Duration::from_millis(1));
    }
    run.frame(DVec3::new(0.0, 0.0, -1e9));
    assert_eq!((run.pager.stats().gpu_bytes, run.pager.stats().shared_gpu_bytes_saved), (0, 0));
}

#[test]
fn pages_shared_by_the_application_have_one_tree_and_keep_shared_objects() {
    let manager = SharedStateManager::new(ShareModes::default());
    let [mut a, mut b] = [0, 1].map(|_| read(&glb(3, 1), &options(ShareModes::NONE).0));
    // Both k-d trees were built before the pages were shared.
    for page in [&mut a, &mut b] {
        page.build_kd_trees();
        manager.share(page);
    }
    assert!(Arc::ptr_eq(a.kd_tree(0).unwrap(), b.kd_tree(0).unwrap()));
    assert!(Arc::ptr_eq(parts(&a.take_drawables()[0]).0, parts(&b.take_drawables()[0]).0));
    // The same without payloads: the page keeps its objects.
    let before = manager.stats();
    manager.share(&mut a);
    manager.prune_all();
    assert_eq!(manager.stats(), before);
    drop(b);
    manager.prune_all();
    assert_eq!(manager.stats().entries, before.entries, "the first page still has everything");
}

/// Returns a page of one square at `x` with an image of one colour, shared like a paged one by its worker.
fn square_page(manager: &SharedStateManager, x: f64, shade: u8) -> Page {
    let mut drawable = quad([0.0; 3], [0.3, 0.3], [1.0; 4]);
    drawable.material.texture = Some(Arc::new(with_mips(4, 4, [shade, 0, 0, 255].repeat(16))));
    let place = DAffine3::from_translation(DVec3::new(x, 0.0, 0.0));
    let mut page = Page::from_node(Node::transform(place, vec![Node::geode(vec![drawable])])).unwrap();
    manager.share(&mut page);
    page
}

fn add(rig: &mut Rig, scene: &mut Scene, mut page: Page) -> (terrane::scene::PageId, Compiled) {
    let compiled = rig.compile(page.take_drawables());
    assert!(compiled.errors.is_empty());
    page.set_draw_slots(0, compiled.slots.clone());
    (scene.add_root(page), compiled)
}

#[test]
fn removing_or_changing_a_page_keeps_shared_objects_of_others() {
    let Some(mut rig) = new_rig([128, 128]) else { return };
    let manager = SharedStateManager::new(ShareModes::default());
    let mut scene = Scene::new();
    let before = rig.ctx.bytes_in_use();
    let (a, first) = add(&mut rig, &mut scene, square_page(&manager, -0.5, 200));
    let held = rig.ctx.bytes_in_use();
    let (b, second) = add(&mut rig, &mut scene, square_page(&manager, 0.5, 200));
    assert_eq!(rig.ctx.bytes_in_use(), held, "the second of equal pages takes no memory");
    assert_eq!((first.bytes, second.bytes, first.shared.len()), (0, 0, 3));
    assert_eq!(first.shared, second.shared);
    let halves = |rig: &mut Rig, scene: &Scene| {
        let picture = rig.picture(scene, &unit_camera(128), &plain());
        let half = |x| image::imageops::crop_imm(&picture, x, 0, 64, 128).to_image();
        [half(0), half(64)].map(|h| count(&h, [200, 0, 0]))
    };
    let [left, right] = halves(&mut rig, &scene);
    assert!(left > 1200 && left == right, "{left} {right}");

    // One page gets a smaller mesh; that of the other stays.
    let node = terrane::scene::NodeId { page: a, index: 1 };
    let Geometry::Mesh(small) = quad([0.0; 3], [0.1, 0.1], [1.0; 4]).geometry else { panic!("a mesh") };
    scene.set_mesh(node, 0, small.clone(), DataVariance::Static).unwrap();
    rig.ctx.rewrite(first.slots[0], &small).unwrap();
    let [changed, kept] = halves(&mut rig, &scene);
    assert!(changed > 50 && changed < left / 4 && kept == right, "{changed} {kept}");

    // One page is removed. Shared slots stay as long as the other needs them.
    scene.remove_root(a).unwrap();
    rig.ctx.release(&first.slots);
    rig.ctx.flush_released();
    assert_eq!(halves(&mut rig, &scene), [0, right]);
    scene.remove_root(b).unwrap();
    rig.ctx.release(&second.slots);
    rig.ctx.flush_released();
    assert_eq!(rig.ctx.bytes_in_use(), before);

    // Later pages are uploaded again, although their key is known.
    let (_, third) = add(&mut rig, &mut scene, square_page(&manager, 0.5, 200));
    assert_eq!(halves(&mut rig, &scene), [0, right]);
    assert_eq!(third.shared, first.shared);
}

#[test]
fn images_are_the_same_with_and_without_sharing() {
    use terrane::viewer::{ThreadingModel, ViewerConfig};
    let folder = tempfile::tempdir().unwrap();
    write_quadtree(folder.path(), 4, |n| glb((40 * (n % 3)) as u8, (60 * (n % 4)) as u8));
    let fly = |sharing: ShareModes| {
        let config = ViewerConfig {
            size_px: [160, 120],
            threading: ThreadingModel::SingleThreaded,
            adapter: kit::adapter(),
            max_sse_px: 2.0,
            pager: PagerConfig {
                blocking: true,
                sharing,
                max_tiles: 40,
                expiry_time: Duration::ZERO,
                ..PagerConfig::default()
            },
            ..ViewerConfig::default()
        };
        let mut viewer = offscreen(&config)?;
        viewer.load(folder.path().to_str().unwrap()).unwrap();
        for frame in 0..24u32 {
            let eye = over(0.1 + 0.8 * f64::from(frame) / 23.0, 900.0) - DVec3::Y * 1500.0;
            let view = glam::dcamera::rh::view::look_at_mat4(eye, over(0.5, 0.0), DVec3::Z);
            viewer.view_mut().camera.world_from_eye = DAffine3::from_mat4(view).inverse();
            if frame % 4 == 0 {
                viewer.want_picture();
            }
            viewer.frame_at(f64::from(frame)).unwrap();
        }
        viewer.finish().unwrap();
        let report = viewer.report().unwrap();
        Some((viewer.take_pictures(), report.sharing))
    };
    let Some((naive, none)) = fly(ShareModes::NONE) else { return };
    let (shared, some) = fly(ShareModes::default()).unwrap();
    assert_eq!((naive.len(), none), (6, None));
    assert!(some.is_some_and(|s| s.geometry_hits > 0 && s.texture_hits > 0 && s.gpu_bytes_saved_peak > 0), "{some:?}");
    for ((_, a), (_, b)) in naive.iter().zip(&shared) {
        let colours: std::collections::BTreeSet<_> = a.pixels().map(|p| p.0).collect();
        assert!(colours.len() > 20, "an empty image");
        let differing = a.pixels().zip(b.pixels()).filter(|(a, b)| a != b).count();
        assert_eq!(differing, 0, "pixels of an image");
    }
}
