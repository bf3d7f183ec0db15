//! The uniforms that programs get without declaring a value: those named `osg_...` and `terrane_...`.

/// The values of uniforms that are filled without being given: times in seconds, matrices and the eye.
#[derive(Clone, Copy, Debug, Default)]
pub(in crate::draw) struct Builtins {
    pub(in crate::draw) frame: u32,
    pub(in crate::draw) frame_time_s: f32,
    pub(in crate::draw) delta_frame_time_s: f32,
    pub(in crate::draw) simulation_time_s: f32,
    pub(in crate::draw) view: glam::Mat4,
    pub(in crate::draw) view_inverse: glam::Mat4,
    /// The rotation of the inverse, with columns of four numbers as in a uniform buffer.
    pub(in crate::draw) world_from_eye: [[f32; 4]; 3],
    /// The position of the eye in the world as the sum of two numbers: the nearest `f32`, and what is left.
    pub(in crate::draw) eye: [[f32; 3]; 2],
}

impl Builtins {
    /// Writes the value of a name; other names and types of another size are left as they are.
    pub(super) fn fill(&self, name: &str, bytes: &mut [u8]) {
        let value: &[u8] = match name {
            "osg_FrameNumber" => bytemuck::bytes_of(&self.frame),
            "osg_FrameTime" => bytemuck::bytes_of(&self.frame_time_s),
            "osg_DeltaFrameTime" => bytemuck::bytes_of(&self.delta_frame_time_s),
            "osg_SimulationTime" => bytemuck::bytes_of(&self.simulation_time_s),
            "osg_ViewMatrix" => bytemuck::bytes_of(&self.view),
            "osg_ViewMatrixInverse" => bytemuck::bytes_of(&self.view_inverse),
            "terrane_WorldFromEye" => bytemuck::bytes_of(&self.world_from_eye),
            "terrane_EyeHigh" => bytemuck::bytes_of(&self.eye[0]),
            "terrane_EyeLow" => bytemuck::bytes_of(&self.eye[1]),
            _ => return,
        };
        if bytes.len() == value.len() {
            bytes.copy_from_slice(value);
        }
    }
}
