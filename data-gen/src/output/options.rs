//! The options of the form in which a set is written.

use terrane::fetch::{is_store, shown};
use terrane::math::{Ellipsoid, WGS84};

use crate::store::is_remote;
use crate::{BodyArg, Color, ContentKind, GenArgs, TextureFormat, VerticalDatum};

/// The description of the tile tree.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum Tiling {
    /// JSON names each tile. Sets of more than six levels have an external tileset for each block.
    #[default]
    Explicit,
    /// Subtree files have bits and metadata of five levels of tiles.
    Implicit,
}

/// The format of an archive.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum ArchiveFormat {
    /// A 3D Tiles archive: a zip file with an index.
    #[value(name = "3tz")]
    ThreeTz,
    /// A packed set for Terrane: heights in a third of the bytes of EXR, found by an index with errors and checksums.
    Packed,
}

impl ArchiveFormat {
    /// Returns the extension of the name of an archive.
    pub(super) fn extension(self) -> &'static str {
        match self {
            Self::ThreeTz => "3tz",
            Self::Packed => "terrane",
        }
    }
}

/// The form of a set.
#[derive(Clone, Debug, Default, PartialEq, clap::Args)]
pub struct OutputArgs {
    /// Attribution that clients of quantized-mesh terrain show
    #[arg(long, value_name = "TEXT")]
    pub attribution: Option<String>,
    /// Write which tiles exist into tiles of quantized-mesh, each tenth level, instead of into layer.json
    #[arg(long)]
    pub tile_availability: bool,
    /// Body of worlds, and of elevation whose files do not name one: earth, moon, mars, or radii in metres as EQUATORxPOLE or
    /// XxYxZ
    #[arg(long, value_name = "BODY")]
    pub body: Option<BodyArg>,
    /// Description of the tile tree
    #[arg(long, value_enum, default_value_t)]
    pub tiling: Tiling,
    /// Write one file, OUT, instead of a folder: 3tz for any client (its name ends in .3tz), or packed for Terrane (.terrane)
    #[arg(long, value_enum, value_name = "FORMAT")]
    pub archive: Option<ArchiveFormat>,
    /// Compress JSON, glb, subtree and terrain files with gzip under their names; servers must send them with
    /// `Content-Encoding: gzip`
    #[arg(long)]
    pub gzip: bool,
}

impl OutputArgs {
    /// Returns true if the set is packed.
    pub(crate) fn is_packed(&self) -> bool {
        self.archive == Some(ArchiveFormat::Packed)
    }

    /// Returns the extension of the files of heights.
    pub(crate) fn heights(&self) -> &'static str {
        if self.is_packed() { "heights" } else { "exr" }
    }

    /// Returns the ellipsoid of the body that the options name, or that of the earth.
    pub(crate) fn ellipsoid(&self) -> Ellipsoid {
        self.body.map_or(WGS84, |body| body.0)
    }

    /// Checks options that have no effect together with others.
    pub(crate) fn check(&self, args: &GenArgs) -> Result<(), String> {
        if is_remote(&args.out) {
            Self::check_bucket(args)?;
        }
        let is_terrain = args.content == ContentKind::QuantizedMesh;
        let is_elsewhere = self.ellipsoid() != WGS84;
        if is_elsewhere && is_terrain {
            return Err("--body is not supported with --content quantized-mesh: layer.json names no body".to_owned());
        }
        if is_elsewhere && args.world.world.is_none() && args.dem.is_empty() {
            return Err("--body has no effect without --world or --dem".to_owned());
        }
        if is_elsewhere && (args.vertical_datum != VerticalDatum::Ellipsoid || args.datum_grid.is_some()) {
            return Err("--body: --vertical-datum and --datum-grid are about the earth".to_owned());
        }
        if self.attribution.is_some() && !is_terrain {
            return Err("--attribution has no effect without --content quantized-mesh".to_owned());
        }
        for (name, is_given) in [
            ("--imagery", !args.imagery.is_empty()),
            ("--texture", args.tiles.texture != TextureFormat::default()),
            ("--color", args.color != Color::Natural),
            ("--no-meshopt", args.tiles.no_meshopt),
            ("--tiling", self.tiling != Tiling::default()),
        ] {
            if is_terrain && is_given {
                return Err(format!("{name} has no effect with --content quantized-mesh"));
            }
        }
        if self.tile_availability && !is_terrain {
            return Err("--tile-availability has no effect without --content quantized-mesh".to_owned());
        }
        if is_terrain && args.run.aligned {
            return Err(
                "--aligned has no effect with --content quantized-mesh, whose tiles always lie on a grid around \
                        the earth"
                    .to_owned(),
            );
        }
        if self.tiling != Tiling::default() && args.run.aligned {
            return Err("--tiling implicit is not supported with --aligned".to_owned());
        }
        if args.run.update && self.archive.is_some() {
            return Err("--update changes folders, not archives; leave out --archive".to_owned());
        }
        if let Some(archive) = self.archive {
            if is_terrain {
                return Err(
                    "--archive is not supported with --content quantized-mesh: clients of terrain read folders"
                        .to_owned(),
                );
            }
            if self.gzip {
                return Err("--gzip has no effect with --archive, whose files are compressed".to_owned());
            }
            let extension = archive.extension();
            if !args.out.extension().is_some_and(|own| own.eq_ignore_ascii_case(extension)) {
                let name = if archive == ArchiveFormat::Packed { "packed" } else { extension };
                return Err(format!("--archive {name}: the name of {} must end in .{extension}", args.out.display()));
            }
        }
        Ok(())
    }

    /// Checks an OUT that is an address.
    fn check_bucket(args: &GenArgs) -> Result<(), String> {
        let out = shown(&args.out.to_string_lossy()).into_owned();
        if !is_store(&args.out.to_string_lossy()) {
            return Err(format!("{out}: sets are written to folders and to s3://, gs:// and az://"));
        }
        if !cfg!(feature = "object-store") {
            return Err(format!("{out}: this program is built without the feature object-store"));
        }
        Ok(())
    }
}
