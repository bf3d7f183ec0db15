//! Time steps and exponential decay, independent of the frame rate.

/// The longest time that one frame may advance a motion, seconds. A longer frame (a debugger, a suspended machine) must not
/// fling the camera away.
const MAX_FRAME_S: f64 = 0.5;
/// The longest step of numerical integration, seconds.
const MAX_INTEGRATION_STEP_S: f64 = 1.0 / 240.0;

/// Clamps the duration of a frame to 0 to [`MAX_FRAME_S`]; NaN gives 0.
fn clamped_s(dt_s: f64) -> f64 {
    if dt_s > 0.0 { dt_s.min(MAX_FRAME_S) } else { 0.0 }
}

/// Divides a duration into steps for numerical integration; returns their number and their length in seconds.
pub fn steps(dt_s: f64) -> (u32, f64) {
    let dt_s = clamped_s(dt_s);
    let count = (dt_s / MAX_INTEGRATION_STEP_S).ceil();
    (count as u32, if count > 0.0 { dt_s / count } else { 0.0 })
}

/// Returns the fraction that remains of a difference after `dt_s`, when it decays with a time constant in seconds.
pub fn remaining_after(dt_s: f64, time_constant_s: f64) -> f64 {
    (-clamped_s(dt_s) / time_constant_s).exp()
}
