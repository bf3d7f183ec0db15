//! `terrane`: flies, shows, makes and inspects tile sets from the command line.

mod args;
mod bench;
mod cache;
mod default_set;
mod fly;
mod info;
mod net;
mod pictures;
mod serve;
mod stress;
mod summary;

use std::process::ExitCode;

use clap::Parser as _;

fn main() -> ExitCode {
    // Wrong arguments end here, with exit code 2 and clap's own words.
    let args = args::Args::parse();
    let (name, result) = match args.command {
        args::Command::Fly(args) => ("fly", fly::run(args)),
        args::Command::View(args) => ("view", fly::run(args.into())),
        args::Command::Gen(args) => {
            ("gen", terrane_data_gen::run(&args).map(|summary| println!("{summary}")).map_err(Into::into))
        }
        args::Command::Info(args) => ("info", info::run(&args)),
        args::Command::Serve(args) => ("serve", serve::run(args)),
        args::Command::Stress(args) => ("stress", stress::run(args)),
        args::Command::Cache(args) => ("cache", cache::run(&args)),
        args::Command::Bench(args) => ("bench", bench::run(&args)),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            // One line, whatever the causes look like.
            let line = format!("{error:#}").split_whitespace().collect::<Vec<_>>().join(" ");
            eprintln!("terrane {name}: {line}");
            ExitCode::from(1)
        }
    }
}
