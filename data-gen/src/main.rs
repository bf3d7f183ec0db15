//! The program `terrane-gen`: the tile generator alone, the same as `terrane gen`.

use std::io::Write as _;
use std::process::ExitCode;

use clap::Parser as _;

/// Makes tile sets from elevation data or from noise.
#[derive(clap::Parser)]
#[command(version)]
struct Args {
    #[command(flatten)]
    gen_args: terrane_data_gen::GenArgs,
}

fn main() -> ExitCode {
    // Invalid arguments end the program here, with clap's message and exit code 2.
    let args = Args::parse();
    let ready = terrane_data_gen::exit_on_interrupt("terrane-gen").map_err(|e| format!("signals: {e}"));
    let done = ready.and_then(|()| terrane_data_gen::execute(&args.gen_args).map_err(|e| e.to_string()));
    match done.and_then(|made| made.print().map_err(|e| format!("standard output: {e}"))) {
        Ok(()) => ExitCode::SUCCESS,
        Err(e) => {
            // If standard error cannot be written either, only the exit code reports the failure.
            let _ = writeln!(std::io::stderr(), "terrane-gen: {e}");
            ExitCode::from(1)
        }
    }
}
