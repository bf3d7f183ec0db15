//! `terrane info`: what a tile set holds.

use anyhow::Result;
use terrane::io::{Limits, inspect};

use crate::args::InfoArgs;

pub fn run(args: &InfoArgs) -> Result<()> {
    let info = inspect(&args.source, &Limits::default())?;
    if args.json {
        println!("{}", serde_json::to_string_pretty(&info)?);
    } else {
        println!("{info}");
    }
    Ok(())
}
