//! `terrane bench`: one layer at a time, JSON lines on stdout with the peer programs' field names.

pub mod cull;
pub mod page;

use anyhow::Result;

use crate::args::{Bench, BenchArgs};

pub fn run(args: &BenchArgs) -> Result<()> {
    match &args.bench {
        Bench::Cull { secs } => {
            cull::run(*secs);
            Ok(())
        }
        Bench::Page(args) => page::run(args),
    }
}
