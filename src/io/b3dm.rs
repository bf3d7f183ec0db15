//! Batched 3D Model (3D Tiles 1.0): a header, tables, and a glb. The tables matter only for RTC_CENTER.

use glam::DVec3;

use super::IoError;

/// The glb inside, and the centre its positions are relative to.
pub(crate) fn unwrap<'a>(uri: &str, bytes: &'a [u8]) -> Result<(&'a [u8], Option<DVec3>), IoError> {
    let u32_at =
        |at: usize| -> Option<usize> { bytes.get(at..at + 4)?.try_into().ok().map(|b| u32::from_le_bytes(b) as usize) };
    let truncated = || IoError::invalid(uri, "b3dm: truncated header");
    let version = u32_at(4).ok_or_else(truncated)?;
    if version != 1 {
        return Err(IoError::unsupported(uri, format!("b3dm version {version}")));
    }
    let lengths: Vec<usize> = (0..4).map(|i| u32_at(12 + 4 * i)).collect::<Option<_>>().ok_or_else(truncated)?;
    let (&[feature_json, feature_binary, batch_json, batch_binary], mut at) =
        (<&[usize; 4]>::try_from(lengths.as_slice()).map_err(|_| truncated())?, 28usize);
    let mut feature = (at, feature_json);
    let sum = [feature_json, feature_binary, batch_json, batch_binary]
        .iter()
        .try_fold(at, |a, &b| a.checked_add(b))
        .ok_or_else(truncated)?;
    let is_glb = |at: usize| bytes.get(at..).is_some_and(|b| b.starts_with(b"glTF"));
    if is_glb(sum) {
        at = sum;
    } else if let Some(found) = [20usize, 24].into_iter().find_map(|header| {
        // Headers from before 1.0, without or with half a batch table.
        let start = header.checked_add(if header == 20 { feature_binary } else { batch_json })?;
        is_glb(start).then_some(start)
    }) {
        at = found;
        feature = (0, 0);
    } else {
        return Err(IoError::invalid(uri, "b3dm: no glb where the header says"));
    }
    let table = bytes.get(feature.0..feature.0 + feature.1).unwrap_or(&[]);
    let rtc = match serde_json::from_slice::<serde_json::Value>(table) {
        Ok(json) => json.get("RTC_CENTER").and_then(|c| {
            let c: Vec<f64> = c.as_array()?.iter().filter_map(serde_json::Value::as_f64).collect();
            <[f64; 3]>::try_from(c).ok().map(DVec3::from_array)
        }),
        Err(_) => None,
    };
    Ok((bytes.get(at..).unwrap_or(&[]), rtc.filter(|c| c.is_finite())))
}
