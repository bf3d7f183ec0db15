//! `terrane-gen`: the tile generator alone; `terrane gen` is the same.

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
    let args = Args::parse();
    match terrane_data_gen::run(&args.gen_args) {
        Ok(summary) => {
            println!("{summary}");
            ExitCode::SUCCESS
        }
        Err(e) => {
            eprintln!("terrane-gen: {e}");
            ExitCode::from(1)
        }
    }
}
