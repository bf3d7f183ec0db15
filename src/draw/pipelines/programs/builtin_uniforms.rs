//! The uniforms that programs get without declaring a value: those named `osg_...`.

/// The values of uniforms named `osg_...`: times in seconds and matrices.
#[derive(Clone, Copy, Debug, Default)]
pub(in crate::draw) struct Builtins {
    pub(in crate::draw) frame: u32,
    pub(in crate::draw) frame_time_s: f32,
    pub(in crate::draw) delta_frame_time_s: f32,
    pub(in crate::draw) simulation_time_s: f32,
    pub(in crate::draw) view: glam::Mat4,
    pub(in crate::draw) view_inverse: glam::Mat4,
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
            _ => return,
        };
        if bytes.len() == value.len() {
            bytes.copy_from_slice(value);
        }
    }
}
