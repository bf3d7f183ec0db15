//! Random scene graphs with random states: culled or not, sorted or not, on one thread or many, the frames are equal.
//! Each test has a separate GPU rig, because the pipelines of all random states together fill gigabytes. A bounded
//! sample runs by default; `TERRANE_LONG_TESTS=1` runs all of them, `RANDOM_SCENES=FIRST..END` those seeds.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

mod graphs;
mod hiding;
mod scenes;
mod threads;
