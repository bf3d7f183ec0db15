//! `terrane`: the command line to fly over, view, generate, convert, inspect and serve tile sets.

mod args;
mod bench;
mod cache;
mod convert;
mod default_set;
mod fly;
mod info;
mod net;
mod overlays;
mod serve;
mod stress;
mod values;

use std::ffi::OsString;
use std::io::{ErrorKind as IoErrorKind, Write as _};
use std::process::ExitCode;

use anyhow::Context as _;
use clap::error::ErrorKind;
use clap::{CommandFactory as _, FromArgMatches as _};
use terrane::fetch::printable;
use terrane::viewer::DisplaySettings;
use terrane_data_gen::GenError;

fn main() -> ExitCode {
    let mut line: Vec<OsString> = std::env::args_os().collect();
    let mut display = DisplaySettings::from_environment();
    if line.get(1).is_some_and(|command| command == "fly" || command == "view") {
        // The library reads the options of the display. They are all UTF-8, so other arguments are left alone.
        let words: Result<Vec<String>, _> = line.iter().cloned().map(OsString::into_string).collect();
        if let Ok(mut words) = words {
            let mut unused = DisplaySettings::default();
            if let Err(error) = display.as_mut().unwrap_or(&mut unused).read_command_line(&mut words) {
                eprintln!("error: {error}");
                return ExitCode::from(2);
            }
            line = words.into_iter().map(OsString::from).collect();
        }
    }
    let args = parse(line);
    let (name, result) = match args.command {
        args::Command::Fly(args) => ("fly", fly::run(args, display)),
        args::Command::View(args) => ("view", fly::run((*args).into(), display)),
        args::Command::Gen(args) => ("gen", exit_on_interrupt("terrane gen").and_then(|()| generate(&args))),
        args::Command::Convert(args) => {
            ("convert", exit_on_interrupt("terrane convert").and_then(|()| convert::run(&args)))
        }
        args::Command::Merge(args) => {
            ("merge", exit_on_interrupt("terrane merge").and_then(|()| convert::merge(&args)))
        }
        args::Command::Crop(args) => ("crop", exit_on_interrupt("terrane crop").and_then(|()| convert::crop(&args))),
        args::Command::Info(args) => ("info", info::run(&args)),
        args::Command::Serve(args) => ("serve", serve::run(args)),
        args::Command::Stress(args) => ("stress", stress::run(args)),
        args::Command::Cache(args) => ("cache", cache::run(&args)),
        args::Command::Bench(args) => ("bench", bench::run(&args)),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        // `head` and pagers close the pipe when they have read enough.
        Err(error) if is_closed_output(&error) => ExitCode::SUCCESS,
        Err(error) => {
            // The error is printed on one line, although its causes may have several.
            let line = format!("{error:#}").split_whitespace().collect::<Vec<_>>().join(" ");
            // Without a reader of standard error there is no one to tell.
            let _ = writeln!(std::io::stderr(), "terrane {name}: {}", printable(&line));
            ExitCode::from(if is_about_arguments(&error) { 2 } else { 1 })
        }
    }
}

/// Parses the command line. Invalid arguments end the program with clap's message and exit code 2.
fn parse(line: Vec<OsString>) -> args::Args {
    let mut command = args::Args::command().mut_subcommands(terrane_data_gen::with_negative_numbers);
    let matches = command.try_get_matches_from_mut(line).unwrap_or_else(|error| error.exit());
    let args = args::Args::from_arg_matches(&matches).unwrap_or_else(|error| error.format(&mut command).exit());
    if let Err(reason) = args.check() {
        let name = matches.subcommand_name().unwrap_or_default();
        let used = command.find_subcommand_mut(name);
        used.unwrap_or(&mut args::Args::command()).error(ErrorKind::ValueValidation, reason).exit();
    }
    args
}

/// Returns true for options of `gen` that are found to be wrong after clap has parsed them.
fn is_about_arguments(error: &anyhow::Error) -> bool {
    matches!(error.downcast_ref(), Some(GenError::Argument(_)))
}

/// Makes Ctrl-C and SIGTERM say what the command `program` leaves unfinished.
fn exit_on_interrupt(program: &'static str) -> anyhow::Result<()> {
    terrane_data_gen::exit_on_interrupt(program).context("signals")
}

fn generate(args: &terrane_data_gen::GenArgs) -> anyhow::Result<()> {
    terrane_data_gen::execute(args)?.print().context("standard output")
}

/// Returns true if the reader of standard output has closed it.
fn is_closed_output(error: &anyhow::Error) -> bool {
    let is_output = ["stdout", "standard output"].contains(&error.to_string().as_str());
    let cause = error.root_cause().downcast_ref::<std::io::Error>();
    is_output && cause.is_some_and(|cause| cause.kind() == IoErrorKind::BrokenPipe)
}
