//! State sets on the GPU: each attribute and mode shows in the frame. The tests share one GPU rig and run one at a time.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

mod attributes;
mod blending;
mod custom_attributes;
mod eye_space;
mod fixed_function;
mod lighting;
mod lights;
mod outputs;
mod programs;
mod samplers;
mod state_sets;
mod stencils;
mod texture_units;
