//! The options of `terrane stress`.

use std::path::PathBuf;

use clap::Args as ClapArgs;
use terrane::fetch::is_remote;

use super::fault_spec;
use super::plan::Plan;
use crate::values::minutes;

#[derive(Clone, Debug, ClapArgs)]
pub struct StressArgs {
    /// Folder, tileset.json, archive, http(s) URL or s3://, gs://, az:// URI; without it small sets are generated in a
    /// temporary folder
    pub source: Option<String>,
    /// Number of seeds
    #[arg(long, default_value_t = 200, value_parser = clap::value_parser!(u64).range(1..))]
    pub seeds: u64,
    /// First seed
    #[arg(long, default_value_t = 1)]
    pub first_seed: u64,
    /// Run seeds for this many minutes instead of a number of seeds
    #[arg(long, value_parser = minutes)]
    pub minutes: Option<f64>,
    /// Run only this seed, in this process, to repeat a failure
    #[arg(long, conflicts_with_all = ["seeds", "first_seed", "minutes"])]
    pub seed: Option<u64>,
    /// Number of seeds at the same time [default: one per core]
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=256))]
    pub jobs: Option<u16>,
    /// Number of frames of each flight [default: 40 to 120, by seed]
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..1_000_000))]
    pub frames: Option<u32>,
    /// Percentage of seeds that are drawn by an adapter and whose images are checked; the others use wgpu's noop backend
    #[arg(long, value_name = "PERCENT", default_value_t = 20, value_parser = clap::value_parser!(u64).range(..=100))]
    pub drawn: u64,
    /// Faults of the server for all seeds, such as error=0.1,latency-ms=20, or none [default: by seed]; not with a SOURCE
    /// on a server
    #[arg(long, value_name = "SPEC")]
    pub faults: Option<fault_spec::FaultSpec>,
    /// Load within each frame what it wants, one request after the other, so that a seed meets the same faults in the same frames
    /// each time
    #[arg(long)]
    pub blocking: bool,
    /// Count tiles that the server's faults kept from loading as failures
    #[arg(long)]
    pub strict: bool,
    /// Seconds after which a frame counts as hanging
    #[arg(long, value_name = "SECONDS", default_value_t = 60, value_parser = clap::value_parser!(u64).range(1..))]
    pub patience: u64,
    /// Write the results of all seeds as JSON
    #[arg(long, value_name = "FILE")]
    pub report: Option<PathBuf>,
    /// Print one line of JSON instead of text
    #[arg(long, hide = true)]
    pub as_json: bool,
}

impl StressArgs {
    /// Checks combinations of arguments.
    pub fn check(&self) -> Result<(), String> {
        match &self.source {
            Some(source) if self.faults.is_some() && is_remote(source) => {
                Err("--faults apply to the local server only, and SOURCE is on another server".to_owned())
            }
            _ => Ok(()),
        }
    }

    /// Returns the plan of a seed.
    pub fn plan(&self, seed: u64) -> Plan {
        let mut plan = Plan::new(seed, self.frames, self.drawn);
        if let Some(spec) = &self.faults {
            plan.faults = spec.0.clone();
        }
        if self.blocking {
            plan.block();
        }
        plan
    }
}
