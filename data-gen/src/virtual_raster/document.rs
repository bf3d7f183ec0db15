//! The XML of a virtual raster (VRT): its size, georeference, bands and sources, parsed and checked.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use roxmltree::{Document, Node, ParsingOptions};

use super::warp::Warp;
use super::xml::{child, children, number, path_of, unsupported};
use crate::GenError;
use crate::georeference::Metadata;
use crate::store::{BlockCache, text_of};

/// The largest number of nodes in a document: a source has about 30.
const MAX_NODES: u32 = 8 << 20;
/// The largest side in pixels.
const MAX_SIDE: f64 = (1u64 << 32) as f64;

/// A virtual raster.
#[derive(Debug)]
pub(crate) struct VirtualRaster {
    pub size: [usize; 2],
    /// The georeference, and the nodata values and units of the bands.
    pub metadata: Metadata,
    pub bands: Vec<VirtualBand>,
    /// The file that is resampled; the bands have no sources then.
    pub warp: Option<Warp>,
}

/// A band, from 1 on.
#[derive(Debug)]
pub(crate) struct VirtualBand {
    /// From the first to the last, which lies on top.
    pub sources: Vec<VirtualSource>,
    /// Is the band that says how opaque the others are.
    pub is_alpha: bool,
}

/// A part of a file that fills a part of a band.
#[derive(Debug)]
pub(crate) struct VirtualSource {
    pub path: PathBuf,
    /// The band of the file, from 1 on.
    pub band: usize,
    /// Column, row, width and height in the file and in the virtual raster; `None` for all of it.
    pub from: Option<[f64; 4]>,
    pub to: Option<[f64; 4]>,
    /// The value of pixels that do not cover what lies below.
    pub nodata: Option<f64>,
    /// The number by which values are multiplied, and the one that is added then.
    pub factor_and_offset: [f64; 2],
}

impl VirtualRaster {
    /// Reads a file. Virtual rasters that compute values are refused.
    pub fn open(path: &Path, cache: &Arc<BlockCache>) -> Result<Self, GenError> {
        let text = text_of(path, cache, |_| true)?;
        let text = text.ok_or_else(|| GenError::invalid(path, "VRT: too large, or not a file"))?;
        Self::parse(path, &text).map_err(|reason| GenError::invalid(path, format!("VRT: {reason}")))
    }

    /// The error is the reason.
    fn parse(path: &Path, text: &str) -> Result<Self, String> {
        let options = ParsingOptions { allow_dtd: false, nodes_limit: MAX_NODES, ..ParsingOptions::default() };
        let document = Document::parse_with_options(text, options).map_err(|e| e.to_string())?;
        let root = document.root_element();
        if root.tag_name().name() != "VRTDataset" {
            return Err(format!("its root is `{}`, not `VRTDataset`", root.tag_name().name().escape_debug()));
        }
        let is_warped = root.attribute("subClass") == Some("VRTWarpedDataset");
        if !is_warped {
            is_plain(&root)?;
        }
        let side = |name: &str| {
            let found = number(root.attribute(name), name)?;
            let is_side = found.fract() == 0.0 && (1.0..=MAX_SIDE).contains(&found);
            if is_side { Ok(found as usize) } else { Err(format!("{name} is {found}")) }
        };
        let bands: Result<Vec<_>, _> =
            children(&root, "VRTRasterBand").map(|band| VirtualBand::read(&band, path)).collect();
        let bands = bands?;
        if bands.is_empty() {
            return Err("no bands".to_owned());
        }
        Ok(Self {
            size: [side("rasterXSize")?, side("rasterYSize")?],
            metadata: Metadata::of_virtual(path, text)?,
            bands,
            warp: if is_warped { Some(Warp::read(&root, path)?) } else { None },
        })
    }

    /// Returns the paths of all sources, each once.
    pub fn files(&self) -> Vec<PathBuf> {
        let mut files: Vec<PathBuf> =
            self.bands.iter().flat_map(|band| &band.sources).map(|source| source.path.clone()).collect();
        files.extend(self.warp.iter().map(|warp| warp.path.clone()));
        files.sort();
        files.dedup();
        files
    }
}

impl VirtualBand {
    fn read(band: &Node<'_, '_>, raster: &Path) -> Result<Self, String> {
        is_plain(band)?;
        let mut sources = Vec::new();
        for element in band.children().filter(Node::is_element) {
            let name = element.tag_name().name();
            match name {
                "SimpleSource" | "ComplexSource" | "AveragedSource" => {
                    sources.push(VirtualSource::read(&element, raster)?);
                }
                _ if name.ends_with("Source") => return Err(unsupported(name)),
                _ => {}
            }
        }
        let interpretation = child(band, "ColorInterp").and_then(|node| node.text()).unwrap_or_default();
        Ok(Self { sources, is_alpha: interpretation == "Alpha" })
    }
}

impl VirtualSource {
    fn read(source: &Node<'_, '_>, raster: &Path) -> Result<Self, String> {
        // The masks of files are used in any case (`UseMaskBand`).
        let own = ["LUT", "ColorTableComponent", "Exponent"];
        if let Some(name) = own.into_iter().find(|name| child(source, name).is_some()) {
            return Err(unsupported(name));
        }
        let file = child(source, "SourceFilename").ok_or("a source without SourceFilename")?;
        let name = file.text().unwrap_or_default().trim();
        if name.is_empty() {
            return Err("a source without a name".to_owned());
        }
        let is_relative = file.attribute("relativeToVRT") == Some("1");
        let band = child(source, "SourceBand").map_or(Ok(1.0), |node| number(node.text(), "SourceBand"))?;
        let is_band = band.fract() == 0.0 && (1.0..=65_536.0).contains(&band);
        let band = if is_band { Ok(band as usize) } else { Err(format!("SourceBand is {band}")) }?;
        let value = |name: &str| child(source, name).map(|node| number(node.text(), name)).transpose();
        let nodata = child(source, "NODATA").and_then(|node| node.text()?.trim().parse().ok());
        Ok(Self {
            path: path_of(name, is_relative, raster),
            band,
            from: rectangle(source, "SrcRect")?,
            to: rectangle(source, "DstRect")?,
            nodata,
            factor_and_offset: [value("ScaleRatio")?.unwrap_or(1.0), value("ScaleOffset")?.unwrap_or(0.0)],
        })
    }

    /// Returns the rectangles in the file and in the virtual raster, which have these sizes.
    pub fn rectangles(&self, file: [usize; 2], raster: [usize; 2]) -> [[f64; 4]; 2] {
        let whole = |size: [usize; 2]| [0.0, 0.0, size[0] as f64, size[1] as f64];
        [self.from.unwrap_or_else(|| whole(file)), self.to.unwrap_or_else(|| whole(raster))]
    }
}

/// Returns an error for a document or a band that computes its pixels.
fn is_plain(node: &Node<'_, '_>) -> Result<(), String> {
    match node.attribute("subClass") {
        None | Some("VRTSourcedRasterBand" | "VRTWarpedRasterBand") => Ok(()),
        Some(other) => Err(unsupported(other)),
    }
}

/// Reads the rectangle in an element; `None` without the element.
fn rectangle(source: &Node<'_, '_>, name: &str) -> Result<Option<[f64; 4]>, String> {
    let Some(node) = child(source, name) else { return Ok(None) };
    let side = |side: &'static str| number(node.attribute(side), side).map_err(|reason| format!("{name}: {reason}"));
    let found = [side("xOff")?, side("yOff")?, side("xSize")?, side("ySize")?];
    let is_valid = found[2] > 0.0 && found[3] > 0.0 && found.iter().all(|n| n.abs() <= MAX_SIDE);
    if is_valid { Ok(Some(found)) } else { Err(format!("{name} is {found:?}")) }
}
