//! Occluders that glTF files bring along: what a node's mesh surely hides, said by whoever made it.
//!
//! `extras.terrane.occluder` of a node is `{"corners": [[x, y, z], …], "holes": [[[x, y, z], …], …]}`: a convex plane
//! polygon in the node's frame and convex holes in it, metres, y-up as all of glTF. Other readers do not see it.

use glam::DVec3;
use serde::Deserialize;

use super::IoError;
use crate::scene::ConvexPlanarOccluder;

/// Corners of a polygon, and holes in one.
const MOST: usize = 64;
/// How far corners may lie off the plane, as a share of the polygon's size.
const UNEVENNESS: f64 = 1e-3;

#[derive(Deserialize)]
struct Extras {
    terrane: Option<OwnExtras>,
}

#[derive(Deserialize)]
struct OwnExtras {
    occluder: Option<Shape>,
}

#[derive(Deserialize)]
struct Shape {
    corners: Vec<[f64; 3]>,
    #[serde(default)]
    holes: Vec<Vec<[f64; 3]>>,
}

/// The occluder in the extras of a glTF's node.
pub(crate) fn of_node(uri: &str, node: usize, extras: &str) -> Result<Option<ConvexPlanarOccluder>, IoError> {
    // Extras may be anything; most are somebody else's.
    if !extras.contains("\"occluder\"") || !extras.contains("\"terrane\"") || !extras.trim_start().starts_with('{') {
        return Ok(None);
    }
    let bad = |reason: String| IoError::invalid(uri, format!("glTF: extras.terrane.occluder of node {node}: {reason}"));
    let extras: Extras = serde_json::from_str(extras).map_err(|e| bad(e.to_string()))?;
    let Some(Shape { corners, holes }) = extras.terrane.and_then(|own| own.occluder) else { return Ok(None) };
    if holes.len() > MOST {
        return Err(bad(format!("{} holes, {MOST} at most", holes.len())));
    }
    let corners = polygon(&corners).map_err(&bad)?;
    let holes = holes.iter().map(|h| polygon(h).map_err(&bad)).collect::<Result<_, _>>()?;
    Ok(Some(ConvexPlanarOccluder { corners, holes }))
}

/// The corners of a convex plane polygon.
fn polygon(corners: &[[f64; 3]]) -> Result<Vec<DVec3>, String> {
    if !(3..=MOST).contains(&corners.len()) {
        return Err(format!("{} corners, 3 to {MOST} are needed", corners.len()));
    }
    let corners: Vec<DVec3> = corners.iter().map(|c| DVec3::from_array(*c)).collect();
    let count = corners.len() as f64;
    let middle = corners.iter().sum::<DVec3>() / count;
    let size_m = corners.iter().map(|c| c.distance(middle)).fold(0.0, f64::max);
    let after = |i: usize| corners[(i + 1) % corners.len()];
    let normal = (0..corners.len()).map(|i| (corners[i] - middle).cross(after(i) - middle)).sum::<DVec3>();
    let Some(normal) = normal.try_normalize().filter(|_| size_m.is_finite()) else {
        return Err("the corners span no area".to_owned());
    };
    if corners.iter().any(|c| (*c - middle).dot(normal).abs() > UNEVENNESS * size_m) {
        return Err("the corners do not lie in a plane".to_owned());
    }
    let turns_back = |i: usize| {
        let (before, next) = (after(i) - corners[i], after(i + 1) - after(i));
        before.cross(next).dot(normal) < -UNEVENNESS * before.length() * next.length()
    };
    if (0..corners.len()).any(turns_back) {
        return Err("the polygon is not convex".to_owned());
    }
    Ok(corners)
}
