//! `terrane bench`: one layer at a time, JSON lines on stdout with the peer programs' field names.

pub mod all;
pub mod cull;
pub mod frame;
pub mod page;
pub mod pick;
pub mod resident;
pub mod share;
pub mod submit;
pub mod threading;
pub mod tiles;

use anyhow::Result;
use terrane::gpu::{CompileBudget, CompileOperation, Compiled, GraphicsContext};
use terrane::pager::CompileContext;
use terrane::scene::DrawSlot;

use crate::args::{Bench, BenchArgs};

pub fn run(args: &BenchArgs) -> Result<()> {
    match &args.bench {
        Bench::All { markdown, secs } => all::run(*markdown, *secs),
        Bench::Cull { secs, drawables } => {
            cull::run(*secs, drawables);
            Ok(())
        }
        Bench::Tiles { secs } => {
            tiles::run(*secs);
            Ok(())
        }
        Bench::Pick { secs } => {
            pick::run(*secs);
            Ok(())
        }
        Bench::Submit { secs } => submit::run(*secs),
        Bench::Frame { secs, every_leaf } => frame::run(*secs, *every_leaf),
        Bench::Threading { secs } => threading::run(*secs),
        Bench::Share { secs } => share::run(*secs),
        Bench::Resident { tiles, secs } => resident::run(*tiles as usize, *secs),
        Bench::Page { frames, pace, draw, tiles, content, world, speed, look_ahead, skip_sse, by_motion, url, net } => {
            page::run(page::Options {
                frames: *frames,
                pace_hz: *pace,
                draw: *draw,
                tiles: *tiles as usize,
                content: *content,
                world: *world,
                speed_m_s: speed.map(|speed| speed.0),
                look_ahead_s: *look_ahead,
                skip_sse_factor: skip_sse.0,
                by_motion: *by_motion,
                url: url.clone(),
                net: net.clone(),
            })
        }
    }
}

/// A graphics context that uploads on the thread that updates: a viewer without a draw thread.
struct Uploads(GraphicsContext);

impl CompileContext for Uploads {
    fn id(&self) -> u32 {
        0
    }

    fn compile(&mut self, operation: CompileOperation) {
        self.0.compile(operation);
    }

    fn run_compiles(&mut self, budget: &CompileBudget) {
        self.0.run_compiles(budget);
    }

    fn take_compiled(&mut self) -> Vec<Compiled> {
        self.0.take_compiled()
    }

    fn release(&mut self, slots: Vec<DrawSlot>) {
        self.0.release(&slots);
    }
}

/// Prints a line; whoever reads them may have enough of them, which ends the program.
fn say(line: serde_json::Value) {
    use std::io::Write as _;
    if writeln!(std::io::stdout(), "{line}").is_err() {
        std::process::exit(0);
    }
}

/// The value at a share `p` of the sorted values, between neighbours linearly.
fn percentile(values: &mut [f64], p: f64) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    let place = p * (values.len().max(1) - 1) as f64;
    let (low, high) = (place.floor() as usize, place.ceil() as usize);
    match (values.get(low), values.get(high)) {
        (Some(a), Some(b)) => a + (b - a) * (place - low as f64),
        _ => 0.0,
    }
}
