//! Writes Gaussian splats: SPZ files, and glTFs with one or with accessors.

use std::io::Write as _;

/// A splat that is written.
#[derive(Clone, Copy, Debug)]
pub struct WrittenSplat {
    /// The centre.
    pub position: [f32; 3],
    /// The standard deviations.
    pub scale: [f32; 3],
    /// A unit quaternion x, y, z, w.
    pub rotation: [f32; 4],
    /// The colour as displayed, and the opacity.
    pub color: [f32; 4],
}

impl WrittenSplat {
    /// Returns the coefficients of the first harmonic.
    pub fn harmonic(&self) -> [f32; 3] {
        [0, 1, 2].map(|k| (self.color[k] - 0.5) / 0.282_094_8)
    }
}

/// A file of version 4 with harmonics of degree 1, as the format's own library writes it (@adobe/spz 0.2.3).
pub const SPZ_4_DEGREE_1: &str = "\
    4e4753500400000003000000010c00062000000000000000000000000000000024000000000000001b000000000000000c000000000000\
    000300000000000000120000000000000009000000000000001200000000000000090000000000000015000000000000000c0000000000\
    000024000000000000001b0000000000000028b52ffd201bd9000000180000dcff00320000c0f900000000080000000000700000000028\
    b52ffd200319000080ff1a28b52ffd20094900005e80a1c33c3c3cc38028b52ffd2009490000958a7f56ab56a0a0b228b52ffd200c6100\
    00000000c0e458ba528dbe68dd28b52ffd201bd90000000e1c22303e4452606674828896a4aab8c6ccdae8eefc080e1c2a\
";

/// The same splats with harmonics of degree 4.
pub const SPZ_4_DEGREE_4: &str = "\
    4e4753500400000003000000040c00062000000000000000000000000000000024000000000000001b000000000000000c000000000000\
    000300000000000000120000000000000009000000000000001200000000000000090000000000000015000000000000000c0000000000\
    00006e00000000000000d80000000000000028b52ffd201bd9000000180000dcff00320000c0f900000000080000000000700000000028\
    b52ffd200319000080ff1a28b52ffd20094900005e80a1c33c3c3cc38028b52ffd2009490000958a7f56ab56a0a0b228b52ffd200c6100\
    00000000c0e458ba528dbe68dd28b52ffd20d82d0300a405000e1c22303e4452606674828896a4aab8c6ccdae8eefc080e1c2a303e4c52\
    606e74829096a4b2b8c6d4dae8f6fc08161c2a383e4c5a606e7c82909ea4b2c0c6d4e2e8f6020816242a38464c5a686e7c8a909eacb2c0\
    ced4e2f0020004e9100a523003\
";

/// The same splats with harmonics of degree 4 in version 3.
pub const SPZ_3_DEGREE_4: &str = "\
    1f8b0800000000000003f3730f0e606660600061161e2021c1c070e73f831103c3819f401e030788602800110dffa5e21a161eb6b1b139\
    dc30b5ab3e6c75d882059b80e2079e44ec0aeadd977197814f46c9c0ce252821ada4a963da92553b8e9db9f5e2dd1f0e3e192d033b9fa0\
    84bc92a609d3966cda71eccaad17dffe7088c96859d8f94425e4d5344d98b764d38163571ebdf8c6c421a642a1762d0b379fa88cbc9a2e\
    0ab54f98b766d38173571e7d000040df369224010000\
";

/// Returns the 16 bytes with which an SPZ file begins before it is compressed.
pub fn spz_header(version: u32, count: u32, degree: u8, fractional_bits: u8, flags: u8) -> Vec<u8> {
    let words = [version, count].map(u32::to_le_bytes).concat();
    [b"NGSP".to_vec(), words, vec![degree, fractional_bits, flags, 0]].concat()
}

/// Returns the same as [`spz_plain`] with coefficients of harmonics for each splat, -1 to 1.
pub fn spz_with_harmonics(splats: &[WrittenSplat], version: u32, harmonics: &[Vec<[f32; 3]>]) -> Vec<u8> {
    let mut out = spz_plain(splats, version, degree_of(harmonics));
    let values = harmonics.iter().flatten().flatten();
    let bytes: Vec<u8> = values.map(|c| (c * 128.0 + 128.0).round().clamp(0.0, 255.0) as u8).collect();
    out.truncate(out.len() - bytes.len());
    out.extend(bytes);
    out
}

/// Returns the degree of harmonics by the number of coefficients of a splat.
fn degree_of(harmonics: &[Vec<[f32; 3]>]) -> u8 {
    match harmonics.first().map_or(0, Vec::len) {
        0 => 0,
        3 => 1,
        8 => 2,
        15 => 3,
        other => panic!("{other} coefficients"),
    }
}

/// Returns an SPZ file of version 2 or 3 before it is compressed, with harmonics of 128 up to a degree.
pub fn spz_plain(splats: &[WrittenSplat], version: u32, degree: u8) -> Vec<u8> {
    let byte = |x: f32| x.round().clamp(0.0, 255.0) as u8;
    let mut out = spz_header(version, splats.len() as u32, degree, 12, 0);
    for p in splats.iter().flat_map(|splat| splat.position) {
        out.extend(&((p * 4096.0).round() as i32).to_le_bytes()[..3]);
    }
    out.extend(splats.iter().map(|splat| byte(splat.color[3] * 255.0)));
    out.extend(splats.iter().flat_map(WrittenSplat::harmonic).map(|c| byte((c * 0.15 + 0.5) * 255.0)));
    out.extend(splats.iter().flat_map(|splat| splat.scale).map(|s| byte((s.ln() + 10.0) * 16.0)));
    for splat in splats {
        out.extend(if version < 3 { first_three(splat.rotation) } else { smallest_three(splat.rotation) });
    }
    let harmonics = usize::from(degree) * (usize::from(degree) + 2) * 3;
    out.resize(out.len() + splats.len() * harmonics, 128);
    out
}

fn first_three(q: [f32; 4]) -> Vec<u8> {
    let sign = if q[3] < 0.0 { -1.0 } else { 1.0 };
    [0, 1, 2].map(|k| (sign * q[k] * 127.5 + 127.5).round() as u8).to_vec()
}

fn smallest_three(q: [f32; 4]) -> Vec<u8> {
    let largest = (0..4).max_by(|a, b| q[*a].abs().total_cmp(&q[*b].abs())).unwrap();
    let mut bits = largest as u32;
    for k in (0..4).filter(|k| *k != largest) {
        let size = (511.0 * q[k].abs() * std::f32::consts::SQRT_2 + 0.5) as u32;
        bits = bits << 10 | u32::from((q[k] < 0.0) != (q[largest] < 0.0)) << 9 | size;
    }
    bits.to_le_bytes().to_vec()
}

/// Returns the bytes of hexadecimal digits.
pub fn from_hex(digits: &str) -> Vec<u8> {
    let byte = |pair: &[u8]| u8::from_str_radix(std::str::from_utf8(pair).unwrap(), 16).unwrap();
    digits.as_bytes().chunks(2).map(byte).collect()
}

/// Returns bytes compressed by gzip.
pub fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

/// Returns a glb whose only primitive is an SPZ file.
pub fn spz_glb(file: &[u8]) -> Vec<u8> {
    let length = file.len();
    let json = format!(
        r#"{{"asset":{{"version":"2.0"}},"extensionsUsed":["KHR_gaussian_splatting","KHR_gaussian_splatting_compression_spz_2"],"extensionsRequired":["KHR_gaussian_splatting","KHR_gaussian_splatting_compression_spz_2"],"scene":0,"scenes":[{{"nodes":[0]}}],"nodes":[{{"mesh":0}}],"meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}},"mode":0,"extensions":{{"KHR_gaussian_splatting":{{"extensions":{{"KHR_gaussian_splatting_compression_spz_2":{{"bufferView":0}}}}}}}}}}]}}],"accessors":[{{"componentType":5126,"count":1,"type":"VEC3"}}],"bufferViews":[{{"buffer":0,"byteLength":{length}}}],"buffers":[{{"byteLength":{length}}}]}}"#
    );
    glb(&json, file)
}

/// Returns a glb whose only primitive has splats as accessors, by the names of the extension.
pub fn accessor_glb(splats: &[WrittenSplat]) -> Vec<u8> {
    glb_with_harmonics(splats, &[], "srgb_rec709_display")
}

/// Returns the same with coefficients of harmonics for each splat, and a colour space.
pub fn glb_with_harmonics(splats: &[WrittenSplat], harmonics: &[Vec<[f32; 3]>], color_space: &str) -> Vec<u8> {
    type Values = fn(&WrittenSplat) -> Vec<f32>;
    const ATTRIBUTES: [(&str, &str, Values); 5] = [
        ("POSITION", "VEC3", |splat| splat.position.to_vec()),
        ("KHR_gaussian_splatting:SCALE", "VEC3", |splat| splat.scale.to_vec()),
        ("KHR_gaussian_splatting:ROTATION", "VEC4", |splat| splat.rotation.to_vec()),
        ("KHR_gaussian_splatting:OPACITY", "SCALAR", |splat| vec![splat.color[3]]),
        ("KHR_gaussian_splatting:SH_DEGREE_0_COEF_0", "VEC3", |splat| splat.harmonic().to_vec()),
    ];
    let (mut body, mut views, mut accessors, mut attributes) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let own = ATTRIBUTES
        .iter()
        .map(|(name, kind, values)| ((*name).to_owned(), *kind, splats.iter().flat_map(values).collect::<Vec<f32>>()));
    let names = (1..=degree_of(harmonics)).flat_map(|l| (0..=2 * l).map(move |n| format!("SH_DEGREE_{l}_COEF_{n}")));
    let above = names.enumerate().map(|(index, name)| {
        let values = harmonics.iter().flat_map(|of_splat| of_splat[index]).collect();
        (format!("KHR_gaussian_splatting:{name}"), "VEC3", values)
    });
    for (index, (name, kind, values)) in own.chain(above).enumerate() {
        let start = body.len();
        body.extend(values.into_iter().flat_map(f32::to_le_bytes));
        let (length, count) = (body.len() - start, splats.len());
        views.push(format!(r#"{{"buffer":0,"byteOffset":{start},"byteLength":{length}}}"#));
        accessors.push(format!(r#"{{"bufferView":{index},"componentType":5126,"count":{count},"type":"{kind}"}}"#));
        attributes.push(format!(r#""{name}":{index}"#));
    }
    let [views, accessors, attributes] = [views, accessors, attributes].map(|list| list.join(","));
    let length = body.len();
    let json = format!(
        r#"{{"asset":{{"version":"2.0"}},"extensionsUsed":["KHR_gaussian_splatting"],"scene":0,"scenes":[{{"nodes":[0]}}],"nodes":[{{"mesh":0}}],"meshes":[{{"primitives":[{{"attributes":{{{attributes}}},"mode":0,"extensions":{{"KHR_gaussian_splatting":{{"kernel":"ellipse","colorSpace":"{color_space}"}}}}}}]}}],"accessors":[{accessors}],"bufferViews":[{views}],"buffers":[{{"byteLength":{length}}}]}}"#
    );
    glb(&json, &body)
}

fn glb(json: &str, body: &[u8]) -> Vec<u8> {
    let mut json = json.as_bytes().to_vec();
    json.resize(json.len().next_multiple_of(4), b' ');
    let mut body = body.to_vec();
    body.resize(body.len().next_multiple_of(4), 0);
    let word = |x: usize| (x as u32).to_le_bytes().to_vec();
    let header = [b"glTF".to_vec(), word(2), word(28 + json.len() + body.len())];
    let chunks = [word(json.len()), b"JSON".to_vec(), json, word(body.len()), b"BIN\0".to_vec(), body];
    [header.concat(), chunks.concat()].concat()
}
