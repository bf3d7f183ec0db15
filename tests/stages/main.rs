//! Render stages: cameras in the graph, near and far planes, stereo. The tests share one GPU rig and run one at a time.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

mod camera_air;
mod camera_lights;
mod camera_parts;
mod camera_shadows;
mod camera_targets;
mod frame_copies;
mod near_far;
mod small_targets;
mod stage_order;
mod stereo;
mod target_attachments;
