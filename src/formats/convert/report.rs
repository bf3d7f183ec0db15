//! [`ConvertOptions`], [`Converted`] and [`ConvertError`]: how a set is converted and what came of it. Plain values.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

use serde::Serialize;

use crate::fetch::{IoError, Limits};
use crate::formats::writers::{Leaf, LeafShape};
use crate::math::Region;
use crate::scene::{Texture, Topology};

/// How a set is converted.
#[derive(Clone, Debug)]
pub struct ConvertOptions {
    /// Compresses vertices and indices with EXT_meshopt_compression.
    pub meshopt: bool,
    /// Only tiles over this region of the earth, or of the body of the set, whatever their height. A tile is kept or left out
    /// as a whole. `None` means all tiles.
    pub region: Option<Region>,
    /// Only tiles over this rectangle of a set that is not on the earth: the smallest x and y in its frame, then the largest,
    /// metres. `None` means all tiles.
    pub rectangle_m: Option<[f64; 4]>,
    /// The error in pixels at which a viewer refines; the default of CesiumJS and of Terrane is 16.
    pub max_sse_px: f64,
    /// The number of pixels that one metre covers at a distance of one metre in that viewer:
    /// `0.5 * height_px / tan(0.5 * fov_y)`. By default those of OpenSceneGraph's camera (29.1 degrees) on 1,080 rows.
    pub px_per_radian: f64,
    /// Decodes each written content and counts what it holds. On by default.
    pub check: bool,
    /// The number of threads; by default one for each core.
    pub threads: Option<usize>,
    /// Upper limits on the data.
    pub limits: Limits,
    /// The configuration for sources on servers.
    #[cfg(feature = "http")]
    pub http: crate::fetch::HttpConfig,
}

impl Default for ConvertOptions {
    fn default() -> Self {
        Self {
            meshopt: false,
            region: None,
            rectangle_m: None,
            max_sse_px: 16.0,
            px_per_radian: 0.5 * 1080.0 / 0.26,
            check: true,
            threads: None,
            limits: Limits::default(),
            #[cfg(feature = "http")]
            http: crate::fetch::HttpConfig::default(),
        }
    }
}

/// Sums over contents.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Counts {
    /// The number of contents on each level. The level of a content is the number of contents above it.
    pub levels: Vec<u64>,
    /// The number of triangles.
    pub triangles: u64,
    /// The number of segments of lines.
    pub segments: u64,
    /// The number of points.
    pub points: u64,
    /// The number of Gaussian splats.
    pub splats: u64,
    /// The number of textures. Equal ones count once in each content.
    pub textures: u64,
    /// The number of texels of the first levels of textures.
    pub texture_pixels: u64,
}

/// Returns true for equal first levels and sampling. Further levels are computed from the first.
fn is_same_image(a: &Texture, b: &Texture) -> bool {
    (a.width, a.height, a.format, a.sampling) == (b.width, b.height, b.format, b.sampling)
        && a.mips.first() == b.mips.first()
}

impl Counts {
    /// Adds what a content draws.
    pub(super) fn add(&mut self, leaves: &[Leaf]) {
        // A source may have one image several times, of which the writer writes one.
        let mut known: Vec<Arc<Texture>> = Vec::new();
        let mut add_texture = |texture: &Arc<Texture>| {
            if !known.iter().any(|other| Arc::ptr_eq(other, texture) || is_same_image(other, texture)) {
                known.push(Arc::clone(texture));
                self.textures += 1;
                self.texture_pixels += u64::from(texture.width) * u64::from(texture.height);
            }
        };
        for leaf in leaves {
            match &leaf.shape {
                LeafShape::Splats(splats) => self.splats += splats.list().len() as u64,
                LeafShape::Mesh(mesh) => {
                    let indices = mesh.indices.len() as u64;
                    match mesh.topology {
                        Topology::Triangles => self.triangles += indices / 3,
                        Topology::Lines => self.segments += indices / 2,
                        Topology::Points => self.points += indices,
                        Topology::Squares => self.points += indices / 6,
                    }
                }
            }
            leaf.material.texture.iter().for_each(&mut add_texture);
            let maps = leaf.material.metallic_roughness.iter().flat_map(|surface| surface.maps());
            maps.flatten().for_each(&mut add_texture);
        }
    }

    /// Adds what another content holds, without its levels.
    pub(super) fn merge(&mut self, other: &Self) {
        let Self { levels: _, triangles, segments, points, splats, textures, texture_pixels } = other;
        self.triangles += triangles;
        self.segments += segments;
        self.points += points;
        self.splats += splats;
        self.textures += textures;
        self.texture_pixels += texture_pixels;
    }

    /// Adds a content on a level.
    pub(super) fn add_content(&mut self, level: usize) {
        if self.levels.len() <= level {
            self.levels.resize(level + 1, 0);
        }
        self.levels[level] += 1;
    }

    /// Returns the number of contents.
    pub fn contents(&self) -> u64 {
        self.levels.iter().sum()
    }
}

/// Progress of [`convert`](super::convert), and its result at the end.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Converted {
    /// The sums over what was read.
    pub source: Counts,
    /// The sums over what was written, as a reader of the written files finds it. Without [`ConvertOptions::check`] only its
    /// levels.
    pub written: Counts,
    /// The number of files written.
    pub files: u64,
    /// Their bytes.
    pub bytes: u64,
    /// The number of files that are copied as they are, by [`crop`](super::crop). Only the levels of their contents are counted.
    pub copied: u64,
    /// The number of contents that could not be read. They are left out.
    pub failed: u64,
    /// The first failures: URI, as [`shown`](crate::fetch::shown) returns it, and reason.
    pub errors: Vec<(String, String)>,
    /// Counts by kind: features of contents that their readers leave out, and those that glTF or this writer cannot hold.
    pub left_out: BTreeMap<String, u64>,
}

/// The maximum number of failures that are listed.
const MAX_LISTED: usize = 100;

impl Converted {
    pub(super) fn fail(&mut self, error: &IoError) {
        self.failed += 1;
        if self.errors.len() < MAX_LISTED {
            self.errors.push((crate::fetch::shown(error.uri()).into_owned(), error.reason()));
        }
    }
}

/// The reason why a set was not converted.
#[derive(Debug, thiserror::Error)]
pub enum ConvertError {
    /// The root of the source cannot be read.
    #[error(transparent)]
    Source(#[from] IoError),
    /// The source has no tile that could be written.
    #[error("{uri}: no tile could be converted; the first reason: {reason}")]
    Nothing {
        /// The root of the source.
        uri: String,
        /// The first failure.
        reason: String,
    },
    /// A file of the output cannot be written.
    #[error("{path}: {reason}", path = path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// The error of the system.
        reason: std::io::Error,
    },
    /// A thread cannot be started.
    #[error("a thread to convert tiles: {0}")]
    Thread(std::io::Error),
}
