//! Parts that the benches share: a context for uploads, percentiles, and the output of a line.

use terrane::gpu::{CompileBudget, CompileOperation, Compiled, GraphicsContext};
use terrane::pager::CompileContext;
use terrane::scene::{BlockFormats, DrawSlot};

/// A graphics context that uploads on the thread that updates the pager, as in a viewer without a draw thread.
pub struct UploadContext(pub GraphicsContext);

impl CompileContext for UploadContext {
    fn id(&self) -> u32 {
        0
    }

    fn block_formats(&self) -> BlockFormats {
        self.0.block_formats()
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

/// Returns the processor time of this thread in seconds, which does not run while other threads have its core; 0 where the
/// system does not tell.
pub fn thread_s() -> f64 {
    #[cfg(unix)]
    {
        let time = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
        time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
    }
    #[cfg(not(unix))]
    0.0
}

/// Prints a line. If standard output is closed, the program ends.
pub fn print_line(line: serde_json::Value) {
    use std::io::Write as _;
    if writeln!(std::io::stdout(), "{line}").is_err() {
        std::process::exit(0);
    }
}

/// Returns the value at a share `p`, 0..1, of the sorted values, interpolated between neighbours. Sorts the values.
pub fn percentile(values: &mut [f64], p: f64) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    let position = p * (values.len().max(1) - 1) as f64;
    let (low, high) = (position.floor() as usize, position.ceil() as usize);
    match (values.get(low), values.get(high)) {
        (Some(a), Some(b)) => a + (b - a) * (position - low as f64),
        _ => 0.0,
    }
}
