//! Decides what shades a state, and prepares the uniforms and textures that its shader reads. Draw thread.

use std::sync::Arc;

use super::stage_input::StageInput;
use crate::cull::CullCamera;
use crate::draw::callbacks::info::FrameClock;
use crate::draw::pipelines::key::Shading;
use crate::draw::pipelines::programs::{Builtins, Programs};
use crate::draw::resources::Resources;
use crate::draw::uniforms::fixed::FixedUniform;
use crate::gpu::{CompileInfo, GraphicsContext};
use crate::state::{ResolvedState, TEXTURE_UNITS, TextureBinding};

/// The shader of a state, and the bind groups that it reads.
#[derive(Clone, Copy, Debug)]
pub(in crate::draw) struct Shaded {
    pub(in crate::draw) shading: Shading,
    /// Index of bind group 2, and the byte offset of its uniforms where it has some.
    pub(in crate::draw) group: Option<(u32, Option<u32>)>,
    /// Index of bind group 3 of a program that declares one.
    pub(in crate::draw) attribute: Option<u32>,
}

impl Shaded {
    pub(in crate::draw) const PLAIN: Self = Self { shading: Shading::Plain, group: None, attribute: None };
}

/// Chooses what shades a state. Compiles its program if it has one that was not met before; a program's error is
/// returned by the first call only, and later ones return the fallback.
pub(in crate::draw) fn choose_shading(
    programs: &mut Programs,
    device: &wgpu::Device,
    state: &ResolvedState,
    replaces_sun: bool,
) -> Result<Shading, String> {
    Ok(match state.program() {
        Some(program) => match programs.ensure(device, program)? {
            Some(index) => Shading::Program(index),
            None => Shading::Fallback,
        },
        None if (0..TEXTURE_UNITS).any(|unit| state.texture(unit).is_some()) => Shading::FixedTextured,
        None if replaces_sun || state.is_fixed_function() => Shading::FixedFunction,
        None => Shading::Plain,
    })
}

/// Chooses what shades a state in a view, and prepares its bind group. Reports what is wrong with the state, its program
/// and its textures.
pub(in crate::draw) fn shade(
    resources: &mut Resources,
    input: &StageInput<'_>,
    view: u32,
    state: &Arc<ResolvedState>,
    replaces_sun: bool,
) -> Shaded {
    let StageInput { ctx, stage, target, .. } = *input;
    for (name, error) in state.wrong_numbers() {
        let name = if name.is_empty() { "a state set" } else { name };
        resources.errors.report_once(format!("{name}: {error}"));
    }
    let mut problems: Vec<String> = Vec::new();
    let shading = choose_shading(&mut resources.pipelines.programs, ctx.device(), state, replaces_sun).unwrap_or_else(
        |problem| {
            problems.push(problem);
            Shading::Fallback
        },
    );
    let (shading, attribute) = match shading {
        Shading::Program(index) => match bind_attribute(resources, ctx, state, index) {
            Ok(attribute) => (shading, attribute),
            Err(problem) => {
                problems.extend(problem);
                (Shading::Fallback, None)
            }
        },
        _ => (shading, None),
    };
    let uniforms = match shading {
        Shading::Plain | Shading::Fallback => None,
        Shading::FixedFunction | Shading::FixedTextured => {
            let textures = &resources.state_groups.textures;
            let uniform = FixedUniform::new(state, stage, view, |sampler| textures.emulates_border(sampler));
            Some(resources.state_groups.push(&uniform))
        }
        Shading::Program(index) => push_program_uniforms(resources, input, view, state, index, &mut problems),
    };
    let group = match shading {
        Shading::Plain | Shading::Fallback => None,
        _ => {
            let is_target = |binding: &TextureBinding| target.has_attachment(stage, &binding.texture);
            let found = resources
                .state_groups
                .group(ctx, &resources.pipelines, shading, state, is_target, |problem| problems.push(problem));
            Some((found, uniforms))
        }
    };
    for problem in problems {
        resources.errors.report_once(format!("{}: {problem}", name_of(state)));
    }
    Shaded { shading, group, attribute }
}

/// Returns the index of bind group 3 of a program that declares one, for the state's attribute. An error without a text was
/// reported before.
fn bind_attribute(
    resources: &mut Resources,
    ctx: &GraphicsContext,
    state: &ResolvedState,
    index: u16,
) -> Result<Option<u32>, Option<String>> {
    let Resources { pipelines, attribute_groups, .. } = resources;
    let layout = pipelines.programs.get(index).and_then(|program| program.attribute_layout.as_ref());
    let Some(layout) = layout else { return Ok(None) };
    let Some(hook) = state.custom() else {
        let program = pipelines.programs.name(index).unwrap_or_default();
        return Err(Some(format!("program {program:?} declares bind group 3, and the state has no custom attribute")));
    };
    let info = CompileInfo {
        device: ctx.device(),
        queue: ctx.queue(),
        frame_layout: pipelines.frame_layout(),
        pipeline_cache: ctx.pipeline_cache(),
    };
    match attribute_groups.ensure(&info, layout, index, hook) {
        Ok(Some(group)) => Ok(Some(group)),
        Ok(None) => Err(None),
        Err(problem) => Err(Some(problem)),
    }
}

/// Appends the uniforms of a program and returns their byte offset; `None` if it has none.
fn push_program_uniforms(
    resources: &mut Resources,
    input: &StageInput<'_>,
    view: u32,
    state: &ResolvedState,
    index: u16,
    problems: &mut Vec<String>,
) -> Option<u32> {
    let program = resources.pipelines.programs.get(index)?;
    if program.uniform_bytes == 0 {
        return None;
    }
    let builtins = builtins(input.stage.camera_of(view), &input.clock);
    let (offset, bytes) = resources.state_groups.reserve(program.uniform_bytes);
    problems.extend(program.fill(state, &builtins, bytes).err());
    Some(offset)
}

fn builtins(camera: &CullCamera, clock: &FrameClock) -> Builtins {
    let view = glam::DMat4::from(camera.eye_from_world);
    let world_from_eye = camera.eye_from_world.inverse();
    let axes = world_from_eye.matrix3.to_cols_array_2d();
    let eye = world_from_eye.translation;
    let high = eye.as_vec3();
    Builtins {
        frame: camera.frame,
        frame_time_s: clock.reference_time_s as f32,
        delta_frame_time_s: clock.delta_s as f32,
        simulation_time_s: clock.simulation_time_s as f32,
        view: view.as_mat4(),
        view_inverse: view.inverse().as_mat4(),
        world_from_eye: axes.map(|[x, y, z]| [x as f32, y as f32, z as f32, 0.0]),
        eye: [high.to_array(), (eye - high.as_dvec3()).as_vec3().to_array()],
    }
}

/// Returns the name of a state for error texts.
pub(in crate::draw) fn name_of(state: &ResolvedState) -> &str {
    if state.name.is_empty() { "a state set" } else { &state.name }
}
