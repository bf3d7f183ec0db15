//! `terrane bench`: measures one layer at a time. Prints JSON lines with the field names of the peer programs.

mod measurement;

pub mod all;
pub mod cull;
pub mod frame;
pub mod overlays;
pub mod page;
pub mod pick;
pub mod resident;
pub mod share;
pub mod submit;
pub mod threading;
pub mod tiles;

use anyhow::Result;

use crate::args::{Bench, BenchArgs};

/// Runs one bench.
pub fn run(args: &BenchArgs) -> Result<()> {
    match &args.bench {
        Bench::All { markdown, secs } => all::run(*markdown, *secs),
        Bench::Cull { secs, drawables } => {
            cull::run(*secs, drawables);
            Ok(())
        }
        Bench::Tiles { secs } => {
            tiles::run(*secs);
            Ok(())
        }
        Bench::Pick { secs } => {
            pick::run(*secs);
            Ok(())
        }
        Bench::Submit { secs } => submit::run(*secs),
        Bench::Frame { secs, every_leaf } => frame::run(*secs, *every_leaf),
        Bench::Overlays { secs } => overlays::run(*secs),
        Bench::Threading { secs } => threading::run(*secs),
        Bench::Share { secs } => share::run(*secs),
        Bench::Resident { tiles, requests, secs } => resident::run(*tiles as usize, *requests as usize, *secs),
        Bench::Page {
            frames,
            pace,
            draw,
            tiles,
            content,
            osgb,
            world,
            speed,
            look_ahead,
            skip_sse,
            by_motion,
            url,
            net,
        } => page::run(page::Options {
            frames: *frames,
            pace_hz: *pace,
            draw: *draw,
            tiles: *tiles as usize,
            content: *content,
            osgb: osgb.clone(),
            world: *world,
            speed_m_s: speed.map(|speed| speed.0),
            look_ahead_s: *look_ahead,
            skip_sse_factor: skip_sse.0,
            by_motion: *by_motion,
            url: url.clone(),
            net: (**net).clone(),
        }),
    }
}
