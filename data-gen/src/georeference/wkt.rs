//! Reference systems in WKT, of OGC, ISO and ESRI. The crate `proj4wkt` reads the projection; what it leaves out is read here:
//! codes, definitions of PROJ inside of WKT, and the datums that WKT only names.

use super::crs::{Crs, definition};
use super::projection::Projection;

/// Datums whose shift to WGS84 a WKT rarely has: the names of GDAL and ESRI, of which letters and digits count, and EPSG's code of
/// the system in degrees.
const DATUMS: &[(&str, u32)] = &[
    ("osgb1936", 4277),
    ("ordnancesurveyofgreatbritain1936", 4277),
    ("amersfoort", 4289),
    ("ch1903", 4149),
    ("ch1903+", 4150),
    ("deutscheshauptdreiecksnetz", 4314),
    ("militargeographischeinstitut", 4312),
    ("militargeographischesinstitut", 4312),
    ("militargeographischeinstitute", 4312),
    ("mgi", 4312),
    ("reseaunationalbelge1972", 4313),
    ("belge1972", 4313),
    ("reseaunationalbelge1950", 4215),
    ("europeandatum1950", 4230),
    ("european1950", 4230),
    ("systemjednotnetrigonometrickesitekatastralni", 4156),
    ("sjtsk", 4156),
    ("hungariandatum1972", 4237),
    ("hungarian1972", 4237),
    ("greekgeodeticreferencesystem1987", 4121),
    ("ggrs1987", 4121),
    ("kartastokoordinaattijarjestelma1966", 4123),
    ("kkj", 4123),
    ("pulkovo1942", 4284),
    ("pulkovo194258", 4179),
    ("pulkovo1942adj1958", 4179),
    ("pulkovo194283", 4178),
    ("pulkovo1942adj1983", 4178),
    ("pulkovo1995", 4200),
    ("montemario", 4265),
    ("lisbon", 4207),
    ("lisbon1937", 4207),
    ("datum73", 4274),
    ("ireland1965", 4300),
    ("tm65", 4299),
    ("tm75", 4300),
    ("nouvelletriangulationfrancaise", 4275),
    ("ntf", 4275),
    ("northamericandatum1927", 4267),
    ("northamerican1927", 4267),
    ("newzealandgeodeticdatum1949", 4272),
    ("newzealand1949", 4272),
    ("australiangeodeticdatum1966", 4202),
    ("australian1966", 4202),
    ("australiangeodeticdatum1984", 4203),
    ("australian1984", 4203),
    ("tokyo", 4301),
    ("hutzushan1950", 4236),
    ("southamericandatum1969", 4618),
    ("southamerican1969", 4618),
    ("provisionalsouthamericandatum1956", 4248),
    ("provisionalsouthamer1956", 4248),
    ("corregoalegre", 4225),
    ("corregoalegre197072", 4225),
    ("cape", 4222),
    ("arc1950", 4209),
    ("arc1960", 4210),
    ("minna", 4263),
    ("merchich", 4261),
    ("kertau", 4245),
    ("luzon1911", 4253),
    ("israel", 4141),
    ("israel1993", 4141),
    ("dealulpiscului1970", 4317),
    ("systemoftheunifiedtrigonometricalcadastralnetwork", 4156),
    ("mgi1901", 3906),
    ("ainelabd1970", 4204),
    ("hongkong1980", 4611),
    ("vietnam2000", 4756),
    ("carthage", 4223),
    ("nordsahara1959", 4307),
    ("timbalai1948", 4298),
];

/// Datums that are WGS84 or within two metres of it.
const SAME: &[&str] = &[
    "wgs1984",
    "worldgeodeticsystem1984",
    "worldgeodeticsystem1984ensemble",
    "northamericandatum1983",
    "northamerican1983",
    "europeanterrestrialreferencesystem1989",
    "etrs1989",
];

/// The most elements inside of one another. The crate `proj4wkt` calls itself for each; definitions in use have ten.
const MAX_DEPTH: usize = 64;

/// Reads a WKT. The error is the reason.
pub(super) fn crs(text: &str) -> Result<Crs, String> {
    // ESRI writes a vertical system after the plane's.
    let text = first_element(text)?;
    // The definition of a code has the parameters of its datum, which WKT often lacks.
    if let Some(known) = code(text).and_then(Crs::from_epsg) {
        return Ok(known);
    }
    if ["Popular Visualisation Pseudo", "WGS 84 / Pseudo-Mercator"].iter().any(|n| text.contains(n)) {
        return Ok(Crs::WebMercator);
    }
    // A projection that WKT 1 cannot name.
    if let Some(definition) = quoted_after(text, "EXTENSION[\"PROJ4\",") {
        return match definition.contains("+proj=merc +a=6378137 +b=6378137") {
            true => Ok(Crs::WebMercator),
            false => Projection::new(definition).map(Crs::of),
        };
    }
    // Names of EPSG that the crate does not know yet.
    let text = text.replace("Azimuth at projection centre", "Azimuth of initial line");
    let text = text.replace("Scale factor at projection centre", "Scale factor on initial line");
    let found = proj4wkt::wkt_to_projstring(&text).map_err(|e| format!("WKT: {e}"))?;
    let meridian = text.split_once("PRIMEM[").or_else(|| text.split_once("PRIMEMERIDIAN["));
    let meridian =
        meridian.and_then(|(_, rest)| rest.split_once(',')?.1.split([',', ']']).next()?.trim().parse::<f64>().ok());
    if meridian.is_some_and(|east| east != 0.0) && !found.contains("+pm=") {
        return Err("WKT: a projection from another meridian than Greenwich is not supported".to_owned());
    }
    let found = with_datum(&found, &text).unwrap_or(found);
    let projection = Projection::new(&found)?;
    // Planetocentric latitudes of Mars differ from geodetic ones by up to 20 km. The IAU's systems have them in their names.
    let lower = text.to_lowercase();
    let is_centric =
        ["planetocentric", "cs[spherical", "ocentric\"", "/ ocentric"].iter().any(|part| lower.contains(part));
    if is_centric && projection.ellipsoid().eccentricity_squared() > 0.0 {
        return Err("WKT: planetocentric latitudes on an ellipsoid are not supported".to_owned());
    }
    Ok(Crs::of(projection))
}

/// Returns a definition with the datum of a WKT that has no parameters of its own, if the datum is known.
fn with_datum(definition_of_wkt: &str, text: &str) -> Option<String> {
    let upper = text.to_ascii_uppercase();
    if upper.contains("TOWGS84[") || upper.contains("BOUNDCRS[") {
        return None;
    }
    let at = ["GEODETICDATUM[", "DATUM[", "TRF["].iter().find_map(|key| Some(upper.find(key)? + key.len()))?;
    let name: String = text[at..].trim_start().strip_prefix('"')?.split('"').next()?.to_owned();
    let is_kept = |c: &char| c.is_alphanumeric() || *c == '+';
    let name: String = name.strip_prefix("D_").unwrap_or(&name).chars().filter(is_kept).collect();
    let name = name.to_lowercase();
    if SAME.contains(&name.as_str()) {
        return None;
    }
    let (_, code) = DATUMS.iter().find(|(known, _)| *known == name)?;
    let known = definition(*code)?;
    let is_datum = |part: &&str| {
        let keys = ["+datum=", "+ellps=", "+a=", "+b=", "+rf=", "+towgs84=", "+nadgrids="];
        keys.iter().any(|key| part.starts_with(key))
    };
    let own = definition_of_wkt.split_whitespace().filter(|part| !is_datum(part));
    Some(own.chain(known.split_whitespace().filter(is_datum)).collect::<Vec<_>>().join(" "))
}

/// Returns the first element of a WKT, up to the bracket that closes it. The error is the reason.
fn first_element(text: &str) -> Result<&str, String> {
    let (mut depth, mut is_quoted) = (0usize, false);
    for (at, byte) in text.bytes().enumerate() {
        match byte {
            b'"' => is_quoted = !is_quoted,
            b'[' | b'(' if !is_quoted => {
                depth += 1;
                if depth > MAX_DEPTH {
                    return Err(format!("WKT: more than {MAX_DEPTH} elements inside of one another"));
                }
            }
            b']' | b')' if !is_quoted => {
                depth = depth.saturating_sub(1);
                if depth == 0 {
                    return Ok(&text[..=at]);
                }
            }
            _ => {}
        }
    }
    Ok(text)
}

/// Returns the text in quotes that follows a key.
fn quoted_after<'a>(text: &'a str, key: &str) -> Option<&'a str> {
    let (_, rest) = text.split_once(key)?;
    rest.trim_start().strip_prefix('"')?.split('"').next()
}

/// Returns the EPSG code of the system that a WKT defines: that of the authority (or id, in WKT 2) at its end.
fn code(text: &str) -> Option<u32> {
    let text: String = text.chars().filter(|c| !c.is_whitespace()).collect::<String>().to_ascii_uppercase();
    let (_, last) = text.rsplit_once("[\"EPSG\",")?;
    let digits = last.strip_suffix("]]")?.trim_matches('"');
    digits.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a WKT of ESRI, as in the file beside a raster.
    fn esri(datum: &str, spheroid: &str, projection: &str, parameters: [f64; 5]) -> String {
        let names = ["False_Easting", "False_Northing", "Central_Meridian", "Scale_Factor", "Latitude_Of_Origin"];
        let parameters: String =
            names.iter().zip(parameters).map(|(name, value)| format!("PARAMETER[\"{name}\",{value:?}],")).collect();
        format!(
            "PROJCS[\"a\",GEOGCS[\"b\",DATUM[\"{datum}\",SPHEROID[{spheroid}]],PRIMEM[\"Greenwich\",0.0],UNIT[\"Degree\",\
             0.0174532925199433]],PROJECTION[\"{projection}\"],{parameters}UNIT[\"Meter\",1.0]]"
        )
    }

    /// Regression: without parameters of their own, datums were read as WGS84, 70 to 370 m away.
    #[test]
    fn datums_that_wkt_only_names_are_shifted() {
        let bessel = "\"Bessel_1841\",6377397.155,299.1528128";
        let transverse = "Transverse_Mercator";
        let british = [400_000.0, -100_000.0, -2.0, 0.9996012717, 49.0];
        let airy = "\"Airy_1830\",6377563.396,299.3249646";
        let dutch = [155_000.0, 463_000.0, 5.38763888888889, 0.9999079, 52.15616055555555];
        for (wkt, code, place) in [
            (esri("D_OSGB_1936", airy, transverse, british), 27700, [-1.5f64, 52.0f64]),
            (esri("OSGB_1936", airy, transverse, british), 27700, [-1.5, 52.0]),
            (esri("D_Amersfoort", bessel, "Double_Stereographic", dutch), 28992, [5.0, 52.0]),
            (
                esri("D_Deutsches_Hauptdreiecksnetz", bessel, transverse, [3_500_000.0, 0.0, 9.0, 1.0, 0.0]),
                31467,
                [9.5, 50.0],
            ),
            (
                esri(
                    "D_European_1950",
                    "\"International_1924\",6378388.0,297.0",
                    transverse,
                    [500_000.0, 0.0, 9.0, 0.9996, 0.0],
                ),
                23032,
                [8.0, 46.0],
            ),
        ] {
            let [found, expected] = [Crs::parse(&wkt).unwrap(), Crs::from_epsg(code).unwrap()]
                .map(|crs| crs.project(place[0].to_radians(), place[1].to_radians()));
            let apart_m = (found[0] - expected[0]).hypot(found[1] - expected[1]);
            assert!(apart_m < 0.01, "EPSG:{code}: {apart_m} m");
        }
    }

    #[test]
    fn vertical_systems_after_the_plane_are_left_out() {
        let plane = esri(
            "D_WGS_1984",
            "\"WGS_1984\",6378137.0,298.257223563",
            "Transverse_Mercator",
            [5e5, 0.0, 9.0, 0.9996, 0.0],
        );
        let both = format!("{plane},VERTCS[\"EGM96_Geoid\",VDATUM[\"EGM96_Geoid\"],UNIT[\"Meter\",1.0]]");
        assert_eq!(Crs::parse(&both), Crs::parse(&plane));
        assert!(Crs::parse(&plane).is_ok());
    }

    /// Regression: Web Mercator without EPSG's code was a Mercator of the ellipsoid, up to 20 km away.
    #[test]
    fn web_mercator_is_recognised_without_a_code() {
        let mercator = "PROJCS[\"WGS 84 / Pseudo-Mercator\",GEOGCS[\"WGS 84\",DATUM[\"WGS_1984\",SPHEROID[\"WGS 84\",6378137,\
            298.257223563]],PRIMEM[\"Greenwich\",0],UNIT[\"degree\",0.0174532925199433]],PROJECTION[\"Mercator_1SP\"],PARAMETER[\
            \"central_meridian\",0],PARAMETER[\"scale_factor\",1],PARAMETER[\"false_easting\",0],PARAMETER[\"false_northing\",0],\
            UNIT[\"metre\",1],EXTENSION[\"PROJ4\",\"+proj=merc +a=6378137 +b=6378137 +lat_ts=0 +lon_0=0 +x_0=0 +y_0=0 +k=1 \
            +units=m +nadgrids=@null +wktext +no_defs\"]]";
        assert_eq!(Crs::parse(mercator), Ok(Crs::WebMercator));
        assert_eq!(Crs::parse(&mercator.replace("WGS 84 / Pseudo-Mercator", "other")), Ok(Crs::WebMercator));
    }

    #[test]
    fn nad27_needs_no_grid() {
        // The parameters for the contiguous United States (EPSG:1173), by cs2cs.
        for text in ["EPSG:26711", "+proj=utm +zone=11 +datum=NAD27", "+init=epsg:26711"] {
            let [x, y] = Crs::parse(text).unwrap().project(-117f64.to_radians(), 34f64.to_radians());
            assert!((x - 500_079.734).abs() < 0.01 && (y - 3_761_958.24).abs() < 0.01, "{text}: {x} {y}");
        }
    }
}
