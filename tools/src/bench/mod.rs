//! `terrane bench`: measures one layer at a time. Prints JSON lines with the field names of the peer programs.

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

/// Runs one bench.
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

/// A graphics context that uploads on the thread that updates the pager, as in a viewer without a draw thread.
struct UploadContext(GraphicsContext);

impl CompileContext for UploadContext {
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

/// Prints a line. If standard output is closed, the program ends.
fn print_line(line: serde_json::Value) {
    use std::io::Write as _;
    if writeln!(std::io::stdout(), "{line}").is_err() {
        std::process::exit(0);
    }
}

/// Returns the value at a share `p`, 0..1, of the sorted values, interpolated between neighbours. Sorts the values.
fn percentile(values: &mut [f64], p: f64) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    let position = p * (values.len().max(1) - 1) as f64;
    let (low, high) = (position.floor() as usize, position.ceil() as usize);
    match (values.get(low), values.get(high)) {
        (Some(a), Some(b)) => a + (b - a) * (position - low as f64),
        _ => 0.0,
    }
}
