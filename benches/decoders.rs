//! Measures the decoders of compressed contents, beside the C++ references where `tools/peers/decoders/run` has built them.
//!
//! `DECODERS_PEER` names the program of the references, and `KTX2_FILES` files with Basis Universal textures, separated by
//! colons. Prints the shortest time of a
//! decode in microseconds.

use std::error::Error;
use std::hint::black_box;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use basisu::{DecodeFlags, TargetFormat, Transcoder};
use draco_core::{DecoderBuffer, Mesh, MeshDecoder};
use kit::compressed::{Triangles, uastc_mosaic};
use kit::fuzz::Random;
use meshoptimizer_rs::{Workspace, codec};

/// The number of times that both decoders are measured in turns.
const ROUNDS: u32 = 3;
/// The time for which our decoder is measured in a round; the reference takes as long.
const MEASURED: Duration = Duration::from_millis(200);

/// The vertices along a side of the grid: 131,072 triangles.
const SIDE: u32 = 257;

fn main() -> Result<(), Box<dyn Error>> {
    let folder = tempfile::tempdir()?;
    println!("| input | bytes | ours, us | C++, us | ratio |\n|---|---|---|---|---|");
    let written = |name: &str, bytes: &[u8]| {
        let file = folder.path().join(name);
        std::fs::write(&file, bytes).map(|()| file)
    };
    let grid = Triangles::grid(SIDE);
    let (vertices, indices) = (grid.vertex_count(), grid.indices.len());
    for level in [1, 5, 10] {
        let bytes = grid.draco(level);
        let file = written("mesh.drc", &bytes)?;
        compare(&format!("Draco, level {level}"), "draco", &file, &[], || {
            let mut mesh = Mesh::new();
            MeshDecoder::new().decode(&mut DecoderBuffer::new(&bytes), &mut mesh).map(|()| mesh)
        })?;
    }
    let mut workspace = Workspace::default();
    let bytes = grid.meshopt_positions();
    let file = written("vertices", &bytes)?;
    let mut decoded = vec![0; 12 * vertices];
    compare("meshopt vertices", "meshopt-vertices", &file, &[&vertices.to_string(), "12"], || {
        codec::decode_vertex_buffer_into(&mut decoded, vertices, 12, &bytes, &mut workspace)
    })?;
    let bytes = grid.meshopt_indices();
    let file = written("indices", &bytes)?;
    decoded.resize(4 * indices, 0);
    compare("meshopt indices", "meshopt-indices", &file, &[&indices.to_string()], || {
        codec::decode_index_buffer_into(&mut decoded, indices, 4, &bytes, &mut workspace)
    })?;
    let mut files = vec![written("UASTC of all modes", &uastc_of_all_modes())?];
    let named = std::env::var("KTX2_FILES").unwrap_or_default();
    files.extend(named.split(':').filter(|file| !file.is_empty()).map(PathBuf::from));
    for file in &files {
        let bytes = std::fs::read(file)?;
        let name = file.file_name().unwrap_or_default().to_string_lossy();
        let formats = [("bc1", TargetFormat::Bc1Rgb), ("bc3", TargetFormat::Bc3Rgba), ("bc7", TargetFormat::Bc7Rgba)];
        for (format, target) in formats {
            let flags = DecodeFlags::HIGH_QUALITY | DecodeFlags::BC1_FORBID_THREE_COLOR_BLOCKS;
            compare(&format!("{name} to {format}"), "ktx2", file, &[format], || {
                let transcoder = Transcoder::new(&bytes)?;
                let levels = 0..transcoder.level_count();
                levels.map(|level| transcoder.transcode(level, target, flags)).collect::<Result<Vec<_>, _>>()
            })?;
        }
    }
    Ok(())
}

/// Returns a KTX2 file of random blocks of UASTC, which have all modes and partitions. Those that are not valid are left out.
fn uastc_of_all_modes() -> Vec<u8> {
    let mut random = Random(1);
    let [mut one, mut file] = [4, 512].map(|side| uastc_mosaic([side, side], 1, |_| [0; 4]));
    let at = file.len() - 512 * 512;
    for block in file[at..].as_chunks_mut::<16>().0 {
        loop {
            block[..8].copy_from_slice(&random.next_u64().to_le_bytes());
            block[8..].copy_from_slice(&random.next_u64().to_le_bytes());
            let end = one.len() - 16;
            one[end..].copy_from_slice(block);
            let read = Transcoder::new(&one).map(|one| one.transcode(0, TargetFormat::Rgba32, DecodeFlags::NONE));
            if matches!(read, Ok(Ok(_))) {
                break;
            }
        }
    }
    file
}

/// Measures a decoder and the reference in turns, and prints a row.
fn compare<T, E: std::fmt::Debug>(
    input: &str,
    kind: &str,
    file: &Path,
    size: &[&str],
    mut decode: impl FnMut() -> Result<T, E>,
) -> Result<(), Box<dyn Error>> {
    let (mut ours, mut reference) = (f64::INFINITY, None);
    for _ in 0..ROUNDS {
        ours = shortest_us(&mut decode)?.min(ours);
        let measured = reference_us(kind, file, size)?;
        reference = measured.map(|us| us.min(reference.unwrap_or(f64::INFINITY)));
    }
    let bytes = std::fs::metadata(file)?.len();
    match reference {
        Some(reference) => println!("| {input} | {bytes} | {ours:.0} | {reference:.0} | {:.2} |", ours / reference),
        None => println!("| {input} | {bytes} | {ours:.0} | - | - |"),
    }
    Ok(())
}

/// Returns the shortest time of a decode in microseconds.
fn shortest_us<T, E: std::fmt::Debug>(decode: &mut impl FnMut() -> Result<T, E>) -> Result<f64, String> {
    let end = Instant::now() + MEASURED;
    let mut shortest = f64::INFINITY;
    while Instant::now() < end || shortest.is_infinite() {
        let start = Instant::now();
        let decoded = black_box(decode()).map_err(|e| format!("{e:?}"))?;
        shortest = shortest.min(1e6 * start.elapsed().as_secs_f64());
        drop(decoded);
    }
    Ok(shortest)
}

/// Returns the reference's shortest time in microseconds, or `None` without its program.
fn reference_us(kind: &str, file: &Path, size: &[&str]) -> Result<Option<f64>, Box<dyn Error>> {
    let Some(program) = std::env::var_os("DECODERS_PEER") else { return Ok(None) };
    let output = Command::new(program).arg(kind).arg(file).args(size).output()?;
    if !output.status.success() {
        return Err(String::from_utf8_lossy(&output.stderr).into());
    }
    let text = String::from_utf8(output.stdout)?;
    Ok(Some(text.split_whitespace().next().ok_or("the reference printed nothing")?.parse()?))
}
