//! The warp of a virtual raster (`gdalwarp -of VRT`): the file that it resamples, and the placement of that file's pixels. Any
//! thread.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use roxmltree::Node;

use super::xml::{child, children, number, path_of, unsupported};
use crate::GenError;
use crate::georeference::{Crs, GeoTransform, Metadata, Placement};
use crate::store::BlockCache;

/// The way in which pixels of another grid are made of those of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Resampling {
    Nearest,
    Bilinear,
    Cubic,
}

/// A file in another reference system, and how its pixels become those of a virtual raster.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Warp {
    pub path: PathBuf,
    /// The bands of the virtual raster in their order, each with the band of the file, and the value without data there.
    pub bands: Vec<(usize, usize, Option<f64>)>,
    /// The placement of the file's pixels.
    pub transform: GeoTransform,
    /// The file's reference system; that of the virtual raster if it names none.
    pub system: Option<String>,
    pub resampling: Resampling,
}

impl Warp {
    /// Reads the elements of a raster's root. The error is the reason.
    pub fn read(root: &Node<'_, '_>, raster: &Path) -> Result<Self, String> {
        let options = child(root, "GDALWarpOptions").ok_or("a warped raster without GDALWarpOptions")?;
        if child(&options, "Cutline").is_some() {
            return Err(unsupported("Cutline"));
        }
        let file = child(&options, "SourceDataset").ok_or("a warped raster without SourceDataset")?;
        let name = file.text().unwrap_or_default().trim();
        if name.is_empty() {
            return Err("a source without a name".to_owned());
        }
        let resampling = match child(&options, "ResampleAlg").and_then(|node| node.text()).map(str::trim) {
            None | Some("NearestNeighbour") => Resampling::Nearest,
            Some("Bilinear") => Resampling::Bilinear,
            Some("Cubic") => Resampling::Cubic,
            Some(other) => return Err(unsupported(&format!("ResampleAlg {other}"))),
        };
        // The approximation around it saves GDAL's time.
        let find = |from: &Node<'_, '_>, name: &str| {
            from.descendants().find(|node| node.tag_name().name() == name).map(|n| n.id())
        };
        let transformer = find(&options, "GenImgProjTransformer").and_then(|id| options.document().get_node(id));
        let transformer = transformer.ok_or_else(|| unsupported("a warp without GenImgProjTransformer"))?;
        let numbers = child(&transformer, "SrcGeoTransform").and_then(|node| node.text());
        let numbers = numbers.ok_or_else(|| unsupported("a warp without SrcGeoTransform"))?;
        let numbers: Result<Vec<f64>, String> =
            numbers.split(',').map(|text| number(Some(text), "SrcGeoTransform")).collect();
        let [x, a, b, y, d, e] = numbers?[..] else {
            return Err("SrcGeoTransform has not 6 numbers".to_owned());
        };
        let system = find(&transformer, "SourceSRS").and_then(|id| options.document().get_node(id));
        let system = system.and_then(|node| node.text()).map(|text| text.trim().to_owned());
        let mappings = child(&options, "BandList").into_iter().flat_map(|list| children(&list, "BandMapping"));
        let band = |mapping: Node<'_, '_>| {
            let count = |name: &str| {
                let found = number(mapping.attribute(name), name)?;
                let is_band = found.fract() == 0.0 && (1.0..=65_536.0).contains(&found);
                if is_band { Ok(found as usize) } else { Err(format!("{name} of BandMapping is {found}")) }
            };
            let nodata = child(&mapping, "SrcNoDataReal").and_then(|node| node.text()?.trim().parse().ok());
            Ok((count("dst")?, count("src")?, nodata))
        };
        let bands: Result<Vec<_>, String> = mappings.map(band).collect();
        Ok(Self {
            path: path_of(name, file.attribute("relativeToVRT") == Some("1"), raster),
            bands: bands?,
            transform: GeoTransform { origin: [x, y], dx: [a, d], dy: [b, e] },
            system: system.filter(|text| !text.is_empty()),
            resampling,
        })
    }

    /// Returns the placement of the pixels of the file, which has a size. `to` is that of the virtual raster at `path`, `given` the
    /// reference system of files that do not name one.
    pub fn placement(
        &self,
        path: &Path,
        to: &Placement,
        size: [usize; 2],
        given: Option<Crs>,
        cache: &Arc<BlockCache>,
    ) -> Result<Placement, GenError> {
        match &self.system {
            Some(system) => {
                let metadata = Metadata::of_system(path, system);
                Placement::of_header(path, self.transform, size, given, &metadata, cache)
            }
            None => Ok(to.with_transform(self.transform)),
        }
    }
}
