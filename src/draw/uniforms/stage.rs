//! The lights and clip planes of a stage as uniforms: mirrors of the structs `Stage` and `StageLight` of shaders/frame.wgsl. A
//! test compares them with naga's layout. Draw thread.

use glam::{DAffine3, DVec3, DVec4};

use crate::cull::{CutVolume, PositionedLight, RenderStage, move_light, move_plane};
use crate::scene::LocalLights;
use crate::state::{CLIP_PLANES, LIGHTS, Light, Mode, ResolvedState};

/// A light; mirrors `StageLight` in frame.wgsl.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, bytemuck::Pod, bytemuck::Zeroable)]
pub(in crate::draw) struct StageLight {
    /// In eye space; w is 1 for a position and 0 for a direction.
    pub(in crate::draw) position: [f32; 4],
    /// The axis of a spot light in eye space; w is the cosine of its half angle, -1 without a spot.
    pub(in crate::draw) direction: [f32; 4],
    /// Linear colour; w is the exponent of the spot.
    pub(in crate::draw) ambient: [f32; 4],
    /// Linear colour; w is 1 if the light exists.
    pub(in crate::draw) diffuse: [f32; 4],
    /// Linear colour; w is the cosine of the half angle inside of which a spot has its full strength.
    pub(in crate::draw) specular: [f32; 4],
    /// Constant, linear and quadratic; w is 1 / range in metres, 0 without a range.
    pub(in crate::draw) attenuation: [f32; 4],
}

impl StageLight {
    /// Returns a light in eye space; an error if a number of it is invalid, so that it does not shine.
    fn new(light: &Light) -> Result<Self, DarkLight> {
        let position = position_of(light)?;
        let direction = DVec3::from_array(light.direction).normalize_or(DVec3::NEG_Z).as_vec3();
        let is_spot = light.spot_cutoff <= std::f32::consts::FRAC_PI_2;
        let inner_cutoff = light.spot_inner_cutoff.clamp(0.0, std::f32::consts::PI);
        Ok(Self {
            position,
            direction: direction.extend(if is_spot { light.spot_cutoff.cos() } else { -1.0 }).to_array(),
            ambient: rgb(light.ambient, light.spot_exponent),
            diffuse: rgb(light.diffuse, 1.0),
            specular: rgb(light.specular, inner_cutoff.cos()),
            attenuation: rgb(light.attenuation, light.range_m.recip()),
        })
    }
}

/// The lights and clip planes of a stage as a view sees them; mirrors `Stage` in frame.wgsl.
#[repr(C)]
#[derive(Clone, Copy, Debug, bytemuck::Pod, bytemuck::Zeroable)]
pub(in crate::draw) struct StageUniform {
    /// The lights of state sets by their number, then local lights.
    pub(in crate::draw) lights: [StageLight; LIGHTS + LocalLights::MAX],
    /// In eye space: a point is clipped if its product with a plane is negative.
    pub(in crate::draw) clip_planes: [[f32; 4]; CLIP_PLANES],
    /// x is the end of the local lights in `lights`; y is 1 if the volume is a sphere.
    pub(in crate::draw) light_count: [u32; 4],
    /// The volume that leaves are cut to, as [`CutVolume::rows`].
    pub(in crate::draw) volume: [[f32; 4]; 3],
}

impl StageUniform {
    /// Returns the uniform of a view of a stage. `light_from` returns the transform to the view's lit eye from the view that
    /// a light was met in; clip planes are relative to the view's own eye.
    pub(in crate::draw) fn new(stage: &RenderStage, view: u32, light_from: impl Fn(u32) -> DAffine3) -> Self {
        let mut uniform = Self {
            lights: [StageLight::default(); LIGHTS + LocalLights::MAX],
            // These planes clip nothing.
            clip_planes: [[0.0, 0.0, 0.0, 1.0]; CLIP_PLANES],
            light_count: [LIGHTS as u32, 0, 0, 0],
            volume: [[0.0; 4]; 3],
        };
        for positioned in &stage.lights {
            let light = &move_light(&light_from(positioned.view), &positioned.light);
            let slot = uniform.lights[..LIGHTS].get_mut(usize::from(light.number));
            if let (Some(slot), Ok(light)) = (slot, StageLight::new(light)) {
                *slot = light;
            }
        }
        for clip in &stage.clip_planes {
            if let Some(plane) = uniform.clip_planes.get_mut(usize::from(clip.number)) {
                *plane = move_plane(&eye_from(stage, view, clip.view), clip.plane).as_vec4().to_array();
            }
        }
        uniform
    }

    /// Returns the uniform with the lights and clip planes of a state's own, which are in the eye space of the view.
    pub(in crate::draw) fn with_own(mut self, state: &ResolvedState) -> Self {
        for light in state.lights() {
            let slot = self.lights[..LIGHTS].get_mut(usize::from(light.number));
            if let (Some(slot), Ok(light)) = (slot, StageLight::new(light)) {
                *slot = light;
            }
        }
        for (number, plane) in state.clip_planes() {
            if let Some(slot) = self.clip_planes.get_mut(usize::from(number)) {
                *slot = DVec4::from_array(plane).as_vec4().to_array();
            }
        }
        self
    }

    /// Returns the uniform with local lights. `light_from` is that of [`Self::new`].
    pub(in crate::draw) fn with_local_lights(
        mut self,
        lights: &[PositionedLight],
        light_from: impl Fn(u32) -> DAffine3,
    ) -> Self {
        let moved = lights.iter().map(|light| move_light(&light_from(light.view), &light.light));
        let slots = self.lights[LIGHTS..].iter_mut();
        for (light, slot) in moved.filter_map(|light| StageLight::new(&light).ok()).zip(slots) {
            *slot = light;
            self.light_count[0] += 1;
        }
        self
    }

    /// Returns the uniform for leaves that are cut to a volume.
    pub(in crate::draw) fn with_volume(mut self, volume: &CutVolume) -> Self {
        (self.volume, self.light_count[1]) = (volume.rows, u32::from(volume.is_sphere));
        self
    }
}

/// Returns the transform between the eyes of two views of a stage; the identity if it is not finite.
pub(super) fn eye_from(stage: &RenderStage, to: u32, from: u32) -> DAffine3 {
    if to == from {
        return DAffine3::IDENTITY;
    }
    let to_from = stage.camera_of(to).eye_from_world * stage.camera_of(from).eye_from_world.inverse();
    if to_from.is_finite() { to_from } else { DAffine3::IDENTITY }
}

/// The reason why a light does not shine.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("light {number} does not shine: its {what}")]
pub(in crate::draw) struct DarkLight {
    number: u8,
    what: &'static str,
}

/// Returns the position or direction of a light; an error if a number of it is invalid, so that it does not shine.
pub(in crate::draw) fn position_of(light: &Light) -> Result<[f32; 4], DarkLight> {
    let dark = |what| Err(DarkLight { number: light.number, what });
    let position = light.position.map(|p| p as f32);
    let is_somewhere = position.iter().all(|p| p.is_finite()) && position.iter().any(|p| *p != 0.0);
    let is_finite = |values: &[f32]| values.iter().all(|v| v.is_finite());
    if !is_somewhere {
        dark("position is nowhere")
    } else if ![light.ambient, light.diffuse, light.specular].iter().all(|color| is_finite(color)) {
        dark("color is not finite")
    } else if !is_finite(&light.attenuation) {
        dark("attenuation is not finite")
    } else if light.range_m.is_nan() || light.range_m <= 0.0 {
        dark("range is not positive")
    } else if !is_finite(&[light.spot_cutoff, light.spot_inner_cutoff, light.spot_exponent])
        || light.direction.iter().any(|d| !d.is_finite())
    {
        dark("spot is not finite")
    } else {
        Ok(position)
    }
}

/// Returns true if a LightSource replaces the environment's sun.
pub(in crate::draw) fn replaces_sun(stage: &RenderStage) -> bool {
    stage.lights.iter().any(|l| l.light.number == 0 && position_of(&l.light).is_ok())
}

/// Returns true if a light of a state replaces the environment's sun.
pub(in crate::draw) fn has_own_sun(state: &ResolvedState) -> bool {
    state.mode(Mode::Light(0)) && state.lights().any(|light| light.number == 0 && position_of(light).is_ok())
}

/// Returns true if a state sets lights or clip planes, so that it has a separate stage uniform.
pub(in crate::draw) fn has_own_uniform(state: &ResolvedState) -> bool {
    state.lights().next().is_some() || state.clip_planes().next().is_some()
}

fn rgb(color: [f32; 3], w: f32) -> [f32; 4] {
    [color[0], color[1], color[2], w]
}
