//! The options of `terrane gen` about how a run goes.

use terrane::fetch::AllowedHost;

/// Selects what a run does, and what it may use.
#[derive(Clone, Debug, Default, PartialEq, clap::Args)]
pub struct RunArgs {
    /// Predict tiles, bytes and time from a few tiles, and write nothing; --dry-run=json prints JSON
    #[arg(long, value_enum, value_name = "FORMAT", num_args = 0..=1, require_equals = true, default_missing_value = "table")]
    pub dry_run: Option<PredictionFormat>,
    /// Memory for the blocks of sources and for the tiles in work, such as 512M or 2G; by default 256M for the blocks
    #[arg(long, value_name = "SIZE", value_parser = size_bytes)]
    pub memory: Option<u64>,
    /// Make again only what changed or added sources touch in the set in OUT
    #[arg(long, conflicts_with_all = ["plan", "shard", "merge", "world", "overwrite"])]
    pub update: bool,
    /// Place tiles on a grid around the whole earth, so that --update can add sources beyond the bounds of the set
    #[arg(long, requires = "dem", conflicts_with = "world")]
    pub aligned: bool,
    /// Host that a source's server may redirect to although its address is private, loopback or link-local; may be repeated
    #[arg(long, value_name = "HOST[:PORT]")]
    pub allow_host: Vec<AllowedHost>,
}

/// The form of a prediction.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum PredictionFormat {
    /// A table for people.
    Table,
    /// JSON.
    Json,
}

/// Reads a number of bytes, such as `512M`, `1.5G` or `2GiB`. The units are powers of 1024.
fn size_bytes(text: &str) -> Result<u64, String> {
    let bad = || format!("expected a size such as 512M or 2G, not {text}");
    let digits = text.find(|c: char| !c.is_ascii_digit() && c != '.').unwrap_or(text.len());
    let (number, unit) = text.split_at(digits);
    let unit = unit.trim().trim_end_matches(['B', 'b']).trim_end_matches('i');
    let shift = match unit.to_ascii_uppercase().as_str() {
        "" => 0,
        "K" => 10,
        "M" => 20,
        "G" => 30,
        "T" => 40,
        _ => return Err(bad()),
    };
    let bytes = number.parse::<f64>().map_err(|_| bad())? * f64::from(shift).exp2();
    if (1.0..1e18).contains(&bytes) { Ok(bytes as u64) } else { Err(bad()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_have_units() {
        for (text, bytes) in
            [("100", 100), ("512M", 512 << 20), ("1.5g", 3 << 29), ("2GiB", 2 << 30), ("64 KB", 64 << 10)]
        {
            assert_eq!(size_bytes(text), Ok(bytes), "{text}");
        }
        for text in ["", "M", "0", "-1M", "5 apples", "1e30", "nan"] {
            assert!(size_bytes(text).is_err(), "{text}");
        }
    }
}
