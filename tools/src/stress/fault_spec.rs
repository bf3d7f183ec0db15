//! The option `--faults`: the faults of the server.

use std::str::FromStr;

use super::plan::Faults;
use crate::values::{amount, share};

/// The names of faults, for errors.
const NAMES: &str =
    "names are latency-ms, jitter-ms, bandwidth, error, truncate, corrupt, stall, reset, silent and page";

/// Faults that are written such as `error=0.1,latency-ms=20`, or `none`.
#[derive(Clone, Debug, PartialEq)]
pub struct FaultSpec(pub Faults);

impl FromStr for FaultSpec {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let mut faults = Faults::default();
        for part in text.split(',').filter(|part| !part.is_empty() && *part != "none") {
            let (name, value) = part.split_once('=').ok_or_else(|| format!("expected NAME=VALUE; {NAMES}"))?;
            let is_share = !matches!(name, "latency-ms" | "jitter-ms" | "bandwidth");
            let value = if is_share { share(value) } else { amount(value) };
            let value = value.map_err(|what| format!("{name}: {what}"))?;
            let field = match name {
                "latency-ms" => &mut faults.latency_ms,
                "jitter-ms" => &mut faults.jitter_ms,
                "bandwidth" => &mut faults.bandwidth,
                "error" => &mut faults.error,
                "truncate" => &mut faults.truncate,
                "corrupt" => &mut faults.corrupt,
                "stall" => &mut faults.stall,
                "reset" => &mut faults.reset,
                "silent" => &mut faults.silent,
                "page" => &mut faults.page,
                _ => return Err(format!("unknown fault {name}; {NAMES}")),
            };
            *field = value;
        }
        let all = faults.shares();
        if all <= 1.0 { Ok(Self(faults)) } else { Err(format!("the sum of the shares is {all}, more than 1")) }
    }
}

impl std::fmt::Display for FaultSpec {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Faults { latency_ms, jitter_ms, bandwidth, error, truncate, corrupt, stall, reset, silent, page } = self.0;
        write!(f, "latency-ms={latency_ms},jitter-ms={jitter_ms},bandwidth={bandwidth},error={error},")?;
        write!(f, "truncate={truncate},corrupt={corrupt},stall={stall},reset={reset},silent={silent},page={page}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fault_specs_are_parsed() {
        let spec: FaultSpec = "error=0.25,latency-ms=20".parse().unwrap();
        assert_eq!((spec.0.error, spec.0.latency_ms, spec.0.shares()), (0.25, 20.0, 0.25));
        assert_eq!(spec.to_string().parse(), Ok(spec));
        assert_eq!("none".parse(), Ok(FaultSpec(Faults::default())));
        for bad in [
            "error",
            "error=x",
            "error=2",
            "error=-1",
            "rain=0.1",
            "latency-ms=nan",
            "latency-ms=1e-4",
            "error=0.9,reset=0.9",
        ] {
            assert!(bad.parse::<FaultSpec>().is_err(), "{bad}");
        }
    }
}
