//! Pipelines are created when content is loaded, by another thread, and not when it is first drawn.

use std::path::Path;
use std::sync::Arc;

use glam::{DAffine3, DVec3};
use kit::shapes::quad;
use kit::viewer::offscreen;

use terrane::formats::writers::{GlbMesh, write_glb};
use terrane::formats::{ContentReader, Fetched, ReadOptions};
use terrane::math::{BoundingSphere, BoundingVolume};
use terrane::pager::PagerConfig;
use terrane::scene::{Node, NodeKind, Page, PagedLod, PagingOptions, RangeMode, Refine, SunShadows};
use terrane::state::{Attribute, ColorMask, CullFace, Depth, Program, StateSet, SurfaceMaterial};
use terrane::viewer::{ThreadingModel, Viewer, ViewerConfig};

fn viewer(threading: ThreadingModel, blocking: bool) -> Option<Viewer> {
    let config = ViewerConfig {
        size_px: [64, 64],
        threading,
        adapter: kit::adapter(),
        validation: false,
        pager: PagerConfig {
            blocking,
            vertex_attributes: ["_HEAT".into()].into(),
            content_readers: Arc::new([Arc::new(States)]),
            ..PagerConfig::default()
        },
        ..ViewerConfig::default()
    };
    offscreen(&config)
}

/// Returns a fan of triangles around the origin that faces +z after the rotation of glTF's axes.
fn fan(triangles: u16, base_color: [f32; 4]) -> GlbMesh {
    let at = |i: u16| {
        let angle = std::f32::consts::TAU * f32::from(i) / f32::from(triangles);
        [2.0 * angle.cos(), 0.0, -2.0 * angle.sin()]
    };
    let positions: Vec<[f32; 3]> = std::iter::once([0.0; 3]).chain((0..=triangles).map(at)).collect();
    let indices = (0..triangles).flat_map(|i| [0, i + 1, i + 2]).collect();
    GlbMesh {
        normals: vec![[0.0, 1.0, 0.0]; positions.len()],
        positions,
        indices,
        base_color,
        quantized: triangles >= 200,
        ..GlbMesh::default()
    }
}

/// Returns the same with an attribute `_HEAT`, 1 at each vertex, as a glTF in JSON.
fn heated(triangles: u16) -> String {
    use base64::Engine as _;
    let fan = fan(triangles, [1.0; 4]);
    let count = fan.positions.len();
    let mut buffer: Vec<u8> = fan.positions.concat().iter().flat_map(|x| x.to_le_bytes()).collect();
    buffer.extend((0..count).flat_map(|_| 1.0f32.to_le_bytes()));
    buffer.extend(fan.indices.iter().flat_map(|i| i.to_le_bytes()));
    let uri = base64::engine::general_purpose::STANDARD.encode(&buffer);
    let (heats, indices) = (12 * count, 16 * count);
    format!(
        r#"{{"asset":{{"version":"2.0"}},
        "meshes":[{{"primitives":[{{"attributes":{{"POSITION":0,"_HEAT":1}},"indices":2}}]}}],
        "buffers":[{{"byteLength":{},"uri":"data:application/octet-stream;base64,{uri}"}}],
        "bufferViews":[{{"buffer":0,"byteLength":{heats}}},{{"buffer":0,"byteOffset":{heats},"byteLength":{}}},
            {{"buffer":0,"byteOffset":{indices},"byteLength":{}}}],
        "accessors":[
            {{"bufferView":0,"componentType":5126,"count":{count},"type":"VEC3","min":[-2,0,-2],"max":[2,0,2]}},
            {{"bufferView":1,"componentType":5126,"count":{count},"type":"SCALAR"}},
            {{"bufferView":2,"componentType":5123,"count":{},"type":"SCALAR"}}]}}"#,
        buffer.len(),
        4 * count,
        2 * fan.indices.len(),
        fan.indices.len(),
    )
}

fn tile(folder: &Path, file: &str, range_m: f64, transform: DAffine3, children: Vec<Node>) -> Node {
    let lod = PagedLod {
        bounds: BoundingVolume::Sphere(BoundingSphere::new(DVec3::ZERO, 3.0)),
        range_mode: RangeMode::Distance { center: DVec3::ZERO, range_m },
        refine: Refine::Replace,
        content: Some(Arc::from(folder.join(file).display().to_string())),
        content_transform: transform,
        reader_data: None,
        paging: PagingOptions::default(),
        request_volume: None,
    };
    Node { children, ..Node::new(NodeKind::PagedLod(Box::new(lod))) }
}

fn frames(viewer: &mut Viewer, time_s: &mut f64, lod_scale: f64) {
    viewer.view_mut().camera.settings.lod_scale = lod_scale;
    let before = viewer.frame_stamp().frame;
    loop {
        *time_s += 0.05;
        viewer.frame_at(*time_s).unwrap();
        let done = viewer.frame_stamp().frame - before;
        assert!(done < 5_000, "does not settle");
        if done > 8 && viewer.is_settled() {
            break;
        }
        std::thread::sleep(std::time::Duration::from_millis(1));
    }
    viewer.finish().unwrap();
}

#[test]
fn first_draw_of_a_merged_tile_creates_no_pipeline() {
    let folder = std::env::temp_dir().join(format!("terrane-pipelines-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    for (file, triangles) in [("coarse.glb", 6), ("medium.glb", 8), ("mirrored.glb", 9), ("fine.glb", 200)] {
        std::fs::write(folder.join(file), write_glb(&fan(triangles, [0.5, 0.5, 0.5, 1.0]))).unwrap();
    }
    std::fs::write(folder.join("heated.gltf"), heated(7)).unwrap();
    let wgsl = "
        struct V { @builtin(position) position: vec4<f32>, @location(0) heat: f32 }
        @vertex fn vs_main(vertex: MeshVertex, @builtin(instance_index) i: u32, @location(4) _HEAT: f32) -> V {
            return V(frame.clip_from_eye * vec4<f32>(point_in_eye(leaves[i], vertex.position), 1.0), _HEAT);
        }
        @fragment fn fs_main(in: V) -> @location(0) vec4<f32> { return vec4<f32>(0.0, in.heat, 0.0, 1.0); }";
    let program = Program::new("heat", wgsl);
    for (model, blocking, shadows) in [
        (ThreadingModel::SingleThreaded, true, false),
        (ThreadingModel::SingleThreaded, false, true),
        (ThreadingModel::CullThreadPerCameraDrawThreadPerContext, false, false),
        (ThreadingModel::CullThreadPerCameraDrawThreadPerContext, false, true),
    ] {
        let Some(mut viewer) = viewer(model, blocking) else { return };
        viewer.page_files_in(&folder).unwrap();
        let under = |set: StateSet, node: Node| node.with_state_set(Arc::new(set));
        let material = StateSet::default().with(Attribute::SurfaceMaterial(SurfaceMaterial::default()));
        let front = StateSet::default().with(Attribute::CullFace(CullFace::Front));
        let mirror = DAffine3::from_scale(DVec3::new(1.0, -1.0, 1.0));
        let whole = DAffine3::IDENTITY;
        let back = Attribute::CullFace(CullFace::Back);
        let heat = StateSet::default().with(Attribute::Program(program.clone())).with(back);
        // Each has another pipeline: small, small with the fixed function, mirrored, large and quantized with both, and
        // that of a program with an attribute.
        let heated = under(heat, tile(&folder, "heated.gltf", 0.0, whole, vec![]));
        let fine = under(material.clone(), tile(&folder, "fine.glb", 1.5, whole, vec![heated]));
        let mirrored = under(front, tile(&folder, "mirrored.glb", 3.0, mirror, vec![fine]));
        let medium = under(material, tile(&folder, "medium.glb", 5.0, whole, vec![mirrored]));
        let root = tile(&folder, "coarse.glb", 8.0, whole, vec![medium]);
        viewer.add_root(Page::from_node(Node::group(vec![root])).unwrap()).unwrap();
        viewer.view_mut().camera.look_at(DVec3::new(0.0, 0.0, 10.0), DVec3::ZERO, DVec3::Y);
        viewer.view_mut().environment.shadows = shadows.then(SunShadows::default);
        let mut time_s = 0.0;
        frames(&mut viewer, &mut time_s, 1.0);
        let created = |viewer: &Viewer, from: u32| -> u32 {
            viewer.stats().iter().filter(|s| s.frame > from).map(|s| s.pipelines_created).sum()
        };
        assert!(created(&viewer, 0) > 0, "that of the sky is created with the first frame");
        let mut triangles = viewer.stats().last().unwrap().triangles;
        assert!(triangles > 0);
        assert_eq!(viewer.stats().last().unwrap().shadow_leaves > 0, shadows);
        for (lod_scale, expected) in [(0.6, 8), (0.4, 9), (0.2, 200), (0.1, 7)] {
            let before = viewer.frame_stamp().frame;
            frames(&mut viewer, &mut time_s, lod_scale);
            let now = viewer.stats().last().unwrap().triangles;
            assert!(now != triangles, "{model}: {lod_scale}");
            triangles = now;
            assert_eq!(triangles % expected, 0, "{model}: once, and once for each cascade");
            assert_eq!(created(&viewer, before), 0, "{model}, blocking {blocking}, shadows {shadows}: {lod_scale}");
        }
        assert_eq!(viewer.pager().unwrap().stats().merged, 5);
        assert_eq!(viewer.read_back().unwrap().get_pixel(32, 32).0[..3], [0, 255, 0]);
    }
    std::fs::remove_dir_all(&folder).unwrap();
}

/// Reads any content that begins with `STATES` as squares under 32 states, each with pipelines of its own, for fades too.
#[derive(Debug)]
struct States;

impl ContentReader for States {
    fn accepts(&self, _uri: &str, bytes: &[u8]) -> bool {
        bytes.starts_with(b"STATES")
    }

    fn read(&self, _uri: &str, _bytes: &[u8], _files: &[Fetched], _options: &ReadOptions) -> Result<Node, String> {
        let states = (0..32u8).map(|n| {
            let bit = |index: u8| n >> index & 1 == 1;
            let set = StateSet::default()
                .with(Attribute::ColorMask(ColorMask([bit(0), bit(1), bit(2), true])))
                .with(Attribute::CullFace(if bit(3) { CullFace::Back } else { CullFace::Front }))
                .with(Attribute::Depth(Depth { write: bit(4), ..Depth::default() }));
            Node::geode(vec![quad([0.0; 3], [1.0; 2], [1.0; 4])]).with_state_set(Arc::new(set))
        });
        Ok(Node::group(states.collect()))
    }
}

/// Regression: all pipelines of a page were created before the next frame, which took as long as they did.
#[test]
fn pipelines_of_many_states_are_created_beside_the_frames() {
    let Some(mut viewer) = viewer(ThreadingModel::SingleThreaded, false) else { return };
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("coarse.glb"), write_glb(&fan(6, [0.5, 0.5, 0.5, 1.0]))).unwrap();
    std::fs::write(folder.path().join("many.states"), "STATES").unwrap();
    viewer.page_files_in(folder.path()).unwrap();
    viewer.view_mut().camera.look_at(DVec3::new(0.0, 0.0, 10.0), DVec3::ZERO, DVec3::Y);
    let root = |file: &str| {
        let tile = tile(folder.path(), file, 8.0, DAffine3::IDENTITY, vec![]);
        Page::from_node(Node::group(vec![tile])).unwrap()
    };
    viewer.add_root(root("coarse.glb")).unwrap();
    let mut time_s = 0.0;
    frames(&mut viewer, &mut time_s, 1.0);
    let before = viewer.stats().last().unwrap().triangles;
    assert!(before > 0);
    viewer.add_root(root("many.states")).unwrap();
    let (mut frame, mut compiling, mut seen) = (0, 0, Vec::new());
    while viewer.pager().unwrap().stats().merged < 2 {
        time_s += 0.05;
        viewer.frame_at(time_s).unwrap();
        viewer.finish().unwrap();
        let stats = viewer.pager().unwrap().stats();
        compiling += u32::from(stats.compiling > 0);
        seen.push((stats.waiting, stats.in_flight, stats.decoding, stats.compiling, stats.merged, stats.failed));
        seen.dedup();
        assert_eq!(viewer.stats().last().unwrap().pipelines_created, 0, "none while it is drawn");
        frame += 1;
        assert!(frame < 5_000, "the tile does not arrive");
        std::thread::sleep(std::time::Duration::from_millis(1));
    }
    assert!(compiling >= 2, "its pipelines were created in {compiling} frames: {seen:?}");
    frames(&mut viewer, &mut time_s, 1.0);
    assert!(viewer.stats().last().unwrap().triangles > before, "{:?}", viewer.stats().last());
    assert_eq!(viewer.stats().iter().skip(2).map(|s| s.pipelines_created).sum::<u32>(), 0);
    let created: u32 = viewer.stats().iter().map(|s| s.pipelines_created_by_thread).sum();
    assert!(created >= 64, "another thread has created {created}, with those of fades");
}
