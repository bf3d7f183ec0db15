//! `terrane-gen`: the tile generator alone; `terrane gen` is the same.

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
    // Wrong arguments end here, with exit code 2 and clap's own words.
    let args = Args::parse();
    let done = terrane_data_gen::run(&args.gen_args).map_err(|e| e.to_string());
    match done.and_then(|summary| summary.print().map_err(|e| format!("standard output: {e}"))) {
        Ok(()) => ExitCode::SUCCESS,
        Err(e) => {
            // Where even this cannot be written the exit code says it.
            let _ = writeln!(std::io::stderr(), "terrane-gen: {e}");
            ExitCode::from(1)
        }
    }
}
