//! The program `terrane-gen`: the tile generator alone, the same as `terrane gen`.

use std::io::Write as _;
use std::process::ExitCode;

use clap::{CommandFactory as _, FromArgMatches as _};
use terrane_data_gen::GenError;

/// Makes tile sets from elevation data or from noise.
#[derive(clap::Parser)]
#[command(version)]
struct Args {
    #[command(flatten)]
    gen_args: terrane_data_gen::GenArgs,
}

fn main() -> ExitCode {
    // Invalid arguments end the program here, with clap's message and exit code 2.
    let mut command = terrane_data_gen::with_negative_numbers(Args::command());
    let matches = command.get_matches_mut();
    let args = Args::from_arg_matches(&matches).unwrap_or_else(|error| error.format(&mut command).exit());
    let ready = terrane_data_gen::exit_on_interrupt("terrane-gen").map_err(|e| (format!("signals: {e}"), 1));
    let done = ready.and_then(|()| terrane_data_gen::execute(&args.gen_args).map_err(|e| (e.to_string(), code_of(&e))));
    match done.and_then(|made| made.print().map_err(|e| (format!("standard output: {e}"), 1))) {
        Ok(()) => ExitCode::SUCCESS,
        Err((reason, code)) => {
            // If standard error cannot be written either, only the exit code reports the failure.
            let _ = writeln!(std::io::stderr(), "terrane-gen: {reason}");
            ExitCode::from(code)
        }
    }
}

/// Returns the exit code for an error: 2 if the arguments are wrong, otherwise 1.
fn code_of(error: &GenError) -> u8 {
    if matches!(error, GenError::Argument(_)) { 2 } else { 1 }
}
