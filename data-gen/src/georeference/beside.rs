//! Reads the files beside a raster when it is opened: world files, reference systems (`.prj`), and the metadata that GDAL
//! and ArcGIS write (`.aux.xml`).

use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::crs::Crs;
use super::geo_keys::named_unit_m;
use super::transform::GeoTransform;
use crate::GenError;
use crate::store::{BlockCache, is_remote, text_of, with_extension, with_more};

/// The metadata in the file beside a raster with one more extension, `aux.xml`. What it says stands above the raster's own
/// tags, as GDAL reads them.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Metadata {
    path: PathBuf,
    /// The map from pixels to coordinates.
    pub transform: Option<GeoTransform>,
    /// The reference system, WKT.
    system: Option<String>,
    /// The values of elements of the bands, by the number of the band from 1.
    bands: Vec<(usize, Band)>,
}

/// The metadata of a band.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Band {
    pub nodata: Option<f64>,
    pub scale: Option<String>,
    pub offset: Option<String>,
    pub unit: Option<String>,
}

impl Metadata {
    /// Reads the file beside a raster. Without one, nothing is said.
    pub fn beside(raster: &Path, cache: &Arc<BlockCache>) -> Result<Self, GenError> {
        let path = with_more(raster, "aux.xml");
        let is_xml = |bytes: &[u8]| bytes.trim_ascii_start().starts_with(b"<") || bytes.starts_with(b"\xef\xbb\xbf<");
        let Some(text) = text_of(&path, cache, is_xml)? else { return Ok(Self::default()) };
        Self::parse(path.clone(), &text, ["<PAMDataset", "<PAMRasterBand"])
            .map_err(|reason| GenError::invalid(path, reason))
    }

    /// Reads the text of a virtual raster, which has the same elements. The error is the reason.
    pub fn of_virtual(path: &Path, text: &str) -> Result<Self, String> {
        Self::parse(path.to_owned(), text, ["<VRTDataset", "<VRTRasterBand"])
    }

    /// Returns the metadata of a raster whose header has the text of a reference system.
    pub fn of_system(path: &Path, system: &str) -> Self {
        Self { path: path.to_owned(), system: Some(system.to_owned()), ..Self::default() }
    }

    /// Reads the elements of a raster and its bands, which begin as `[raster, band]`. The error is the reason.
    fn parse(path: PathBuf, text: &str, [raster, band]: [&str; 2]) -> Result<Self, String> {
        let Some(start) = text.find(raster) else { return Ok(Self::default()) };
        // Subsets of the raster have metadata of their own.
        let text = text[start..].split("<Subdataset").next().unwrap_or_default();
        let (own, bands) = text.split_at(text.find(band).unwrap_or(text.len()));
        let transform = match element(own, "GeoTransform") {
            None => None,
            Some((_, numbers)) => {
                let numbers: Vec<f64> = numbers.split(',').filter_map(|n| n.trim().parse().ok()).collect();
                let [x, a, b, y, d, e] = numbers[..] else {
                    return Err(format!("GeoTransform has {} numbers, expected 6", numbers.len()));
                };
                Some(GeoTransform { origin: [x, y], dx: [a, d], dy: [b, e] })
            }
        };
        let system = element(own, "SRS").map(|(_, text)| plain(text)).filter(|text| !text.is_empty());
        let bands = bands.split(band).skip(1).enumerate().map(|(k, band)| {
            let (attributes, _) = band.split_once('>').unwrap_or_default();
            let number = attribute(attributes, "band").and_then(|number| number.parse().ok()).unwrap_or(k + 1);
            let value = |name: &str| element(band, name).map(|(_, text)| plain(text)).filter(|text| !text.is_empty());
            let nodata = value("NoDataValue").and_then(|text| text.parse().ok());
            let [scale, offset, unit] = ["Scale", "Offset", "UnitType"].map(value);
            (number, Band { nodata, scale, offset, unit })
        });
        Ok(Self { path, transform, system, bands: bands.collect() })
    }

    /// Returns the nodata value of the first band.
    pub fn nodata(&self) -> Option<f64> {
        self.nodata_of(1)
    }

    /// Returns the nodata value of a band, from 1 on.
    pub fn nodata_of(&self, number: usize) -> Option<f64> {
        self.band(number).and_then(|band| band.nodata)
    }

    /// Returns the factor and the offset that convert the values of a band to heights in metres. The error is the reason.
    pub fn factor_and_offset_m(&self, number: usize) -> Result<[f64; 2], String> {
        let band = self.band(number).cloned().unwrap_or_default();
        let unit = unit_m(band.unit.as_deref())?;
        let number = |role: &str, text: &Option<String>, usual: f64| number_of_band(role, text.as_deref(), usual);
        Ok([number("scale", &band.scale, 1.0)? * unit, number("offset", &band.offset, 0.0)? * unit])
    }

    /// Returns the metadata of a band, from 1 on.
    pub(super) fn band(&self, number: usize) -> Option<&Band> {
        self.bands.iter().find(|(own, _)| *own == number).map(|(_, band)| band)
    }

    /// Returns the reference system; `given` if it is not understood.
    pub(super) fn crs(&self, given: Option<&Crs>) -> Result<Option<Crs>, GenError> {
        match &self.system {
            Some(text) => understood(&self.path, text, given),
            None => Ok(None),
        }
    }
}

/// Returns a unit of GDAL's metadata in metres. The error is the reason.
pub(super) fn unit_m(name: Option<&str>) -> Result<f64, String> {
    let name = name.unwrap_or_default();
    let unknown = || format!("GDAL's metadata: heights in units of `{name}`, which is not supported");
    named_unit_m(name).ok_or_else(unknown)
}

/// Returns the number of a band in GDAL's metadata. The error is the reason.
pub(super) fn number_of_band(role: &str, text: Option<&str>, usual: f64) -> Result<f64, String> {
    let Some(text) = text else { return Ok(usual) };
    let number = text.trim().parse().ok().filter(|n: &f64| n.is_finite());
    number.ok_or_else(|| format!("GDAL's metadata: {role} `{text}`, which is not supported"))
}

/// Returns the reference system in the file beside a raster with the extension `prj`; `given` if it is not understood.
pub(super) fn system_file(
    raster: &Path,
    given: Option<&Crs>,
    cache: &Arc<BlockCache>,
) -> Result<Option<Crs>, GenError> {
    let path = with_extension(raster, "prj");
    let is_text = |bytes: &[u8]| !bytes.trim_ascii_start().starts_with(b"<") && !bytes.contains(&0);
    match text_of(&path, cache, is_text)? {
        Some(text) => understood(&path, &text, given),
        None => Ok(None),
    }
}

/// Returns the reference system of a text in a file; `None` for a local system, which has no place on the earth.
fn understood(path: &Path, text: &str, given: Option<&Crs>) -> Result<Option<Crs>, GenError> {
    let local = ["LOCAL_CS", "ENGCRS", "ENGINEERINGCRS", "LOCALCS"];
    if local.iter().any(|name| text.trim_start().starts_with(name)) {
        return Ok(None);
    }
    match (Crs::parse(text), given) {
        (Ok(crs), _) => Ok(Some(crs)),
        (Err(_), Some(given)) => Ok(Some(given.clone())),
        (Err(reason), None) => Err(GenError::invalid(path, format!("{reason}; --epsg names another system"))),
    }
}

/// Returns the extensions of world files: the first and the last letter of the raster's own and `w` (`tfw`, `pgw`, `jgw`), all
/// letters and `w`, and `wld`.
fn world_extensions(raster: &Path) -> Vec<String> {
    let name = raster.to_string_lossy();
    let name = if is_remote(raster) { name.split(['?', '#']).next().unwrap_or_default() } else { &*name };
    let own = Path::new(name).extension().map(|e| e.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
    let ends = [own.chars().next(), own.chars().last()].into_iter().flatten();
    let short = if own == "exr" { "exw".to_owned() } else { ends.chain(['w']).collect() };
    vec![short, format!("{own}w"), "wld".to_owned()]
}

/// Reads the world file beside a raster. `None` if there is no valid one.
pub(super) fn world_file(raster: &Path, cache: &Arc<BlockCache>) -> Result<Option<GeoTransform>, GenError> {
    for extension in world_extensions(raster) {
        let is_numbers = |bytes: &[u8]| bytes.trim_ascii_start().first().is_some_and(|b| b"+-.0123456789".contains(b));
        let Some(text) = text_of(&with_extension(raster, &extension), cache, is_numbers)? else { continue };
        let n: Vec<f64> = text.split_whitespace().filter_map(|t| t.parse().ok()).collect();
        if let [a, d, b, e, x, y] = n[..] {
            let origin = [x - 0.5 * (a + b), y - 0.5 * (d + e)];
            return Ok(Some(GeoTransform { origin, dx: [a, d], dy: [b, e] }));
        }
    }
    Ok(None)
}

/// Returns the files that lie beside a raster and change what it shows; of those on servers all that may be there.
pub(crate) fn files_beside(raster: &Path) -> Vec<PathBuf> {
    let replaced = world_extensions(raster).into_iter().chain(["prj".to_owned()]);
    let replaced = replaced.map(|extension| with_extension(raster, &extension));
    let more = ["aux.xml", "msk", "ovr", "msk.ovr"].map(|extension| with_more(raster, extension));
    // Plain samples with a header are read from disks only.
    let headers = ["hdr", "sgrd", "lbl", "ige"].map(|extension| with_extension(raster, extension));
    let headers = headers.into_iter().chain([with_more(raster, "hdr")]);
    let headers = headers.filter(|_| !is_remote(raster));
    replaced.chain(more).chain(headers).filter(|path| is_remote(path) || path.is_file()).collect()
}

/// Returns the attributes and the content of the first element of a name.
fn element<'a>(xml: &'a str, name: &str) -> Option<(&'a str, &'a str)> {
    let open = format!("<{name}");
    let starts = xml.match_indices(&open).map(|(at, _)| &xml[at + open.len()..]);
    let rest = starts.into_iter().find(|rest| rest.starts_with(|c: char| c == '>' || c.is_whitespace()))?;
    let (attributes, rest) = rest.split_once('>')?;
    Some((attributes, rest.split_once(&format!("</{name}>"))?.0))
}

/// Returns the value of an attribute.
fn attribute<'a>(attributes: &'a str, name: &str) -> Option<&'a str> {
    let (_, rest) = attributes.split_once(&format!("{name}=\""))?;
    rest.split('"').next()
}

/// Returns the text of an element without XML's escapes.
fn plain(text: &str) -> String {
    let mut text = text.trim().to_owned();
    for (escape, character) in [("&quot;", "\""), ("&apos;", "'"), ("&lt;", "<"), ("&gt;", ">"), ("&amp;", "&")] {
        text = text.replace(escape, character);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    const GDAL: &str = r#"<PAMDataset>
  <SRS dataAxisToSRSAxisMapping="1,2">PROJCS[&quot;a &amp; b&quot;]</SRS>
  <GeoTransform>  5.0e+05,  3.0e+01,  0.0e+00,  5.2e+06,  0.0e+00, -3.0e+01</GeoTransform>
  <PAMRasterBand band="2"><NoDataValue>7</NoDataValue></PAMRasterBand>
  <PAMRasterBand band="1"><NoDataValue le_hex_equiv="00">-9.999E+03</NoDataValue><UnitType>ft</UnitType>
    <Offset>2</Offset><Scale>0.5</Scale><Metadata><MDI key="STATISTICS_MEAN">3</MDI></Metadata></PAMRasterBand>
</PAMDataset>"#;

    fn parse(path: &str, text: &str) -> Result<Metadata, String> {
        Metadata::parse(PathBuf::from(path), text, ["<PAMDataset", "<PAMRasterBand"])
    }

    #[test]
    fn metadata_of_gdal_is_read() {
        let read = parse("a.png.aux.xml", GDAL).unwrap();
        let transform = GeoTransform { origin: [5e5, 5.2e6], dx: [30.0, 0.0], dy: [0.0, -30.0] };
        assert_eq!((read.transform, read.system.as_deref()), (Some(transform), Some("PROJCS[\"a & b\"]")));
        let first = read.band(1).unwrap();
        assert_eq!((first.nodata, first.unit.as_deref()), (Some(-9999.0), Some("ft")));
        assert_eq!([first.scale.as_deref(), first.offset.as_deref()], [Some("0.5"), Some("2")]);
        assert_eq!((read.band(2).unwrap().nodata, read.band(3)), (Some(7.0), None));
        let few = GDAL.replace("5.2e+06,", "");
        assert!(parse("", &few).unwrap_err().contains("has 5 numbers, expected 6"));
        for cut in 0..GDAL.len() {
            let _ = parse("", &GDAL[..cut]);
        }
        assert_eq!(parse("", "<html></html>"), Ok(Metadata::default()));
    }
}
