//! State attributes of the application's own: buffers and textures in bind group 3 of programs.

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

use kit::frames::{MAGENTA, pixel};
use kit::rig::{Rig, plain, rig, unit_camera};
use kit::shapes::quad;
use kit::terrain::Terrain;
use terrane::draw::{StateAttribute, state_attribute};
use terrane::gpu::{CompileInfo, CustomError};
use terrane::scene::Node;
use terrane::state::{Attribute, Program, StateSet};
use wgpu::util::DeviceExt as _;

const SIDE: u32 = 64;

/// Colors in a storage buffer; counts how often it is bound and whether it was dropped.
struct Palette {
    colors: Vec<[f32; 4]>,
    bound: Arc<AtomicU32>,
    fails: bool,
}

impl StateAttribute for Palette {
    fn name(&self) -> &str {
        "palette"
    }

    fn bind(&self, info: &CompileInfo<'_>, layout: &wgpu::BindGroupLayout) -> Result<wgpu::BindGroup, CustomError> {
        self.bound.fetch_add(1, Ordering::Relaxed);
        if self.fails {
            return Err("no colors today".into());
        }
        let buffer = info.device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
            label: None,
            contents: bytemuck::cast_slice(&self.colors),
            usage: wgpu::BufferUsages::STORAGE,
        });
        Ok(info.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: None,
            layout,
            entries: &[wgpu::BindGroupEntry { binding: 1, resource: buffer.as_entire_binding() }],
        }))
    }
}

fn program() -> Arc<Program> {
    Program::new(
        "by palette",
        "@group(3) @binding(1) var<storage, read> colors: array<vec4<f32>>;
        @vertex fn vs_main(vertex: MeshVertex, @builtin(instance_index) i: u32) -> @builtin(position) vec4<f32> {
            return frame.clip_from_eye * vec4<f32>(point_in_eye(leaves[i], vertex.position), 1.0);
        }
        @fragment fn fs_main() -> @location(0) vec4<f32> { return colors[arrayLength(&colors) - 1u]; }",
    )
}

fn palette(color: [f32; 3], bound: &Arc<AtomicU32>, fails: bool) -> Attribute {
    let [r, g, b] = color;
    let colors = vec![[0.0; 4], [r, g, b, 1.0]];
    state_attribute(Palette { colors, bound: bound.clone(), fails })
}

/// Returns the middle pixels of squares under state sets, drawn for three frames.
fn pixels(rig: &mut Rig, sets: &[Arc<StateSet>]) -> Vec<[u8; 3]> {
    let at = |i: usize| (2 * i + 1) as f32 / sets.len() as f32 - 1.0;
    let half = 0.4 / sets.len() as f32;
    let squares = sets
        .iter()
        .enumerate()
        .map(|(i, set)| Node::geode(vec![quad([at(i), 0.0, 0.0], [half; 2], [1.0; 4])]).with_state_set(set.clone()));
    let scene = rig.scene(Node::group(squares.collect()));
    (0..2).for_each(|_| _ = rig.draw(&scene, &unit_camera(SIDE), &plain()));
    let picture = rig.picture(&scene, &unit_camera(SIDE), &plain());
    rig.release(scene);
    (0..sets.len()).map(|i| pixel(&picture, (0.5 * (at(i) + 1.0) * SIDE as f32) as u32, SIDE / 2)).collect()
}

#[test]
fn attributes_bind_buffers_by_identity() {
    let Some(mut rig) = rig("attributes_bind_buffers_by_identity") else { return };
    let (program, bound) = (program(), Arc::new(AtomicU32::new(0)));
    let [red, green] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]].map(|color| palette(color, &bound, false));
    let set = |attribute: &Attribute| {
        Arc::new(StateSet::default().with(Attribute::Program(program.clone())).with(attribute.clone()))
    };
    let first = [set(&red), set(&green), set(&red)];
    let (red_rgb, green_rgb) = ([255, 0, 0], [0, 255, 0]);
    assert_eq!(pixels(&mut rig, &first), [red_rgb, green_rgb, red_rgb]);
    assert_eq!(bound.load(Ordering::Relaxed), 2, "once for each attribute");
    // Another program has another layout.
    let other = Arc::new(Program { name: "another".into(), ..(*program).clone() });
    let second = [Arc::new(StateSet::default().with(Attribute::Program(other)).with(green.clone())), set(&green)];
    assert_eq!(pixels(&mut rig, &second), [green_rgb; 2]);
    assert_eq!(bound.load(Ordering::Relaxed), 3);
    assert!(rig.renderer.take_errors().is_empty());
    drop((red, green, first, second));
    let plain_set = Arc::new(StateSet::default());
    (0..10).for_each(|_| _ = pixels(&mut rig, std::slice::from_ref(&plain_set)));
    assert_eq!(Arc::strong_count(&bound), 1, "no renderer keeps an attribute");
}

#[test]
fn missing_or_failing_attributes_are_visible_and_reported_once() {
    let Some(mut rig) = rig("missing_or_failing_attributes_are_visible_and_reported_once") else { return };
    let bound = Arc::new(AtomicU32::new(0));
    let program = Attribute::Program(program());
    let without = Arc::new(StateSet::default().with(program.clone()));
    assert_eq!(pixels(&mut rig, &[without]), [MAGENTA]);
    let errors = rig.renderer.take_errors();
    assert!(matches!(&errors[..], [e] if e.contains("declares bind group 3")), "{errors:?}");
    let failing = Arc::new(StateSet::default().with(program).with(palette([1.0; 3], &bound, true)));
    assert_eq!(pixels(&mut rig, &[failing]), [MAGENTA]);
    let errors = rig.renderer.take_errors();
    assert!(matches!(&errors[..], [e] if e.contains("\"palette\" cannot be bound: no colors today")), "{errors:?}");
    // It is tried again only if indices of programs are reused, as after other tests.
    assert!((1..=2).contains(&bound.load(Ordering::Relaxed)));
    let writes = Program::new(
        "writes",
        "@group(3) @binding(0) var<storage, read_write> out: array<u32>;
        @vertex fn vs_main(vertex: MeshVertex) -> @builtin(position) vec4<f32> { return vec4<f32>(1.0); }
        @fragment fn fs_main() -> @location(0) vec4<f32> { out[0] = 1u; return vec4<f32>(1.0); }",
    );
    pixels(&mut rig, &[Arc::new(StateSet::default().with(Attribute::Program(writes)))]);
    let errors = rig.renderer.take_errors();
    assert!(matches!(&errors[..], [e] if e.contains("group 3 binding 0 is neither")), "{errors:?}");
}

#[test]
fn height_tiles_have_attributes_too() {
    let Some(mut rig) = rig("height_tiles_have_attributes_too") else { return };
    let rig = &mut *rig;
    let bound = Arc::new(AtomicU32::new(0));
    let set = StateSet::default().with(Attribute::Program(program())).with(palette([0.0, 0.0, 1.0], &bound, false));
    let terrain =
        Terrain { west: 0.13, south: 0.8, width: 0.006, relief_m: 900.0, root_error_m: 250.0, textured: true };
    let eye = terrain.world(0.5, 0.2, 9_000.0);
    let view = kit::rig::camera([SIDE; 2], eye, terrain.world(0.5, 0.5, 0.0), terrain.up(0.5, 0.5));
    let scene = rig.scene(terrain.tile(0, 0, 0).with_state_set(Arc::new(set)));
    let picture = rig.picture(&scene, &view, &plain());
    rig.release(scene);
    assert_eq!(pixel(&picture, SIDE / 2, SIDE / 2), [0, 0, 255]);
    assert!(rig.renderer.take_errors().is_empty());
}
