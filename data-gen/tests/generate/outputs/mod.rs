//! The forms of sets: terrain for globes, implicit tiling, archives, gzip and buckets.

mod archives;
#[cfg(unix)]
mod buckets;
mod corner_errors;
mod implicit;
mod packed;
mod terrain;
