//! The forms of sets: terrain for globes, implicit tiling, archives and gzip.

mod archives;
mod implicit;
mod packed;
mod terrain;
