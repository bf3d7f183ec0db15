//! Benchmarks the noise, the generation of a tile set from noise on one thread and on all, and from a GeoTIFF in all
//! forms. `tools/peers/generate` compares with other programs.
#![allow(missing_docs, reason = "criterion's macros make undocumented items")]

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use terrane_data_gen::{
    ArchiveFormat, Color, ContentKind, ElevationSource as _, GenArgs, OutputArgs, Procedural, TileArgs, Triangles, run,
};

fn noise(criterion: &mut Criterion) {
    let source = Procedural { seed: 1, cos_latitude: 0.7 };
    let mut group = criterion.benchmark_group("noise");
    group.throughput(Throughput::Elements(1));
    let mut k = 0u32;
    group.bench_function("one height", |b| {
        b.iter(|| {
            k = k.wrapping_add(1);
            source.height_m(0.14 + 1e-6 * f64::from(k % 1000), 0.82 + 1e-6 * f64::from(k / 1000 % 1000))
        });
    });
    group.finish();
}

fn generate(criterion: &mut Criterion) {
    let Ok(folder) = tempfile::tempdir() else { return };
    let mut group = criterion.benchmark_group("generate");
    group.sample_size(10);
    for (content, name) in [(ContentKind::Height, "height"), (ContentKind::Mesh, "mesh")] {
        for jobs in [Some(1), None] {
            let out = folder.path().join(format!("{name}-{}", jobs.unwrap_or(0)));
            let args = GenArgs { content, jobs, levels: Some(4), size: 20_000.0, overwrite: true, ..GenArgs::new(out) };
            // Four levels have 1 + 4 + 16 + 64 tiles.
            group.throughput(Throughput::Elements(85));
            let threads = if jobs.is_some() { "one thread" } else { "all threads" };
            group.bench_function(BenchmarkId::new(name, threads), |b| {
                b.iter(|| {
                    let summary = run(&args);
                    assert!(summary.as_ref().is_ok_and(|s| s.tiles == 85), "generation failed");
                    summary
                });
            });
        }
    }
    group.finish();
}

/// Meshes without colour on one thread: the difference of both is the triangulation and the smaller files.
fn triangles(criterion: &mut Criterion) {
    let Ok(folder) = tempfile::tempdir() else { return };
    let mut group = criterion.benchmark_group("triangles");
    group.sample_size(10).throughput(Throughput::Elements(341));
    for triangles in [Triangles::Tin, Triangles::Grid] {
        let args = GenArgs {
            content: ContentKind::Mesh,
            color: Color::None,
            tiles: TileArgs { triangles, ..TileArgs::default() },
            jobs: Some(1),
            levels: Some(5),
            size: 40_000.0,
            overwrite: true,
            ..GenArgs::new(folder.path().join(format!("{triangles:?}")))
        };
        group.bench_function(format!("{triangles:?}"), |b| b.iter(|| run(&args)));
    }
    group.finish();
}

/// Sets of a GeoTIFF of floats on one thread, without colour: EXR heights, packed heights, and meshes.
fn forms(criterion: &mut Criterion) {
    let Ok(folder) = tempfile::tempdir() else { return };
    let side = 1025u32;
    let source = Procedural { seed: 3, cos_latitude: 0.7 };
    let mut heights = vec![0.0f32; (side * side) as usize];
    for (row, heights) in heights.chunks_exact_mut(side as usize).enumerate() {
        let latitude = 0.8 - 5e-6 * row as f64;
        assert!(source.heights_of_row(0.1, 5e-6, latitude, heights).is_ok(), "noise has heights everywhere");
    }
    let dem = folder.path().join("dem.tif");
    let written = std::fs::File::create(&dem).map_err(tiff::TiffError::from).and_then(|file| {
        tiff::encoder::TiffEncoder::new(file)?
            .write_image::<tiff::encoder::colortype::Gray32Float>(side, side, &heights)
    });
    let placed = std::fs::write(dem.with_extension("tfw"), "0.0003\n0\n0\n-0.0003\n7\n47\n");
    assert!(written.is_ok() && placed.is_ok(), "the folder can be written");
    let mut group = criterion.benchmark_group("forms");
    group.sample_size(10).throughput(Throughput::Elements(341));
    let packed = OutputArgs { archive: Some(ArchiveFormat::Packed), ..OutputArgs::default() };
    for (name, content, output) in [
        ("exr", ContentKind::Height, OutputArgs::default()),
        ("packed.terrane", ContentKind::Height, packed),
        ("tin", ContentKind::Mesh, OutputArgs::default()),
    ] {
        let args = GenArgs {
            dem: vec![dem.clone()],
            content,
            output,
            color: Color::None,
            jobs: Some(1),
            overwrite: true,
            ..GenArgs::new(folder.path().join(name))
        };
        group.bench_function(name, |b| {
            b.iter(|| assert!(run(&args).is_ok_and(|s| s.tiles == 341), "generation failed"))
        });
    }
    group.finish();
}

criterion_group!(benches, noise, generate, triangles, forms);
criterion_main!(benches);
