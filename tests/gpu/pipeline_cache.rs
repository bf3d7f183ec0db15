//! The driver's compiled pipelines are stored on disk, and only valid files are used again. Needs a GPU whose driver
//! provides them (Vulkan).

use std::path::{Path, PathBuf};

use kit::frames::count;
use kit::rig::{Rig, plain, traits, unit_camera};
use kit::shapes::quad;
use kit::skip::{or_skip, skipped};
use terrane::gpu::{GpuError, GraphicsContext};
use terrane::scene::Node;
use terrane::viewer::{Viewer, ViewerConfig};

const SIDE: u32 = 32;

/// Returns a context with a pipeline cache in a folder, and the state of its cache. Skips the test if that is not
/// possible.
fn keeping(test: &str, folder: &Path) -> Option<(GraphicsContext, Result<u64, GpuError>)> {
    let mut ctx = or_skip(GraphicsContext::new_offscreen(&traits([SIDE, SIDE])))?;
    match ctx.keep_pipelines(folder) {
        Err(error @ GpuError::NoPipelineCache { .. }) => {
            skipped(format!("{test}: {error}"));
            None
        }
        told => Some((ctx, told)),
    }
}

/// Draws a red square; the context is closed afterwards.
fn draw(ctx: GraphicsContext) {
    let mut rig = Rig::new(ctx);
    let scene = rig.scene(Node::geode(vec![quad([0.0; 3], [0.5, 0.5], [1.0, 0.0, 0.0, 1.0])]));
    let picture = rig.picture(&scene, &unit_camera(SIDE), &plain());
    assert_eq!(count(&picture, [255, 0, 0]), (SIDE * SIDE / 4) as usize);
    assert!(rig.renderer.take_errors().is_empty());
}

fn files(folder: &Path) -> Vec<PathBuf> {
    std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()).collect()
}

#[test]
fn compiled_pipelines_are_reused_unless_the_file_changed() {
    let test = "compiled_pipelines_are_reused_unless_the_file_changed";
    let folder = tempfile::tempdir().unwrap();
    let kept = folder.path().join("pipelines");
    let Some((mut ctx, told)) = keeping(test, &kept) else { return };
    assert!(matches!(told, Ok(0)), "{told:?}");
    assert!(ctx.save_pipelines().unwrap() > 0, "a valid file is used");
    draw(ctx);
    let [file] = &files(&kept)[..] else { panic!("one file") };
    let name = file.file_name().unwrap().to_str().unwrap();
    assert!(name.starts_with("wgpu_pipeline_cache_vulkan_"), "{name}");
    let bytes = std::fs::read(file).unwrap();

    let (ctx, told) = keeping(test, &kept).unwrap();
    assert_eq!(told.unwrap(), bytes.len() as u64 - 40, "all but signature and hash");
    draw(ctx);

    // One wrong bit suffices. The error names the file, and the next context replaces it.
    for (at, reason) in [(bytes.len() - 1, "hash"), (9, "hash"), (0, "no file of pipelines")] {
        let mut changed = std::fs::read(file).unwrap();
        changed[at] ^= 1;
        std::fs::write(file, changed).unwrap();
        let (ctx, told) = keeping(test, &kept).unwrap();
        let said = told.unwrap_err().to_string();
        assert!(said.contains(name) && said.contains(reason), "{said}");
        draw(ctx);
        let (_, told) = keeping(test, &kept).unwrap();
        assert!(told.unwrap() > 0);
    }
    assert_eq!(files(&kept).len(), 1, "nothing beside it");

    // If the folder cannot be created, only the cache is missing.
    let (ctx, told) = keeping(test, &file.join("below")).unwrap();
    assert!(told.is_err() || told.is_ok_and(|bytes| bytes == 0));
    draw(ctx);
}

#[test]
fn viewer_stores_pipelines_in_the_configured_folder() {
    let test = "viewer_stores_pipelines_in_the_configured_folder";
    let folder = tempfile::tempdir().unwrap();
    if keeping(test, &folder.path().join("asked")).is_none() {
        return;
    }
    for (keeps, name) in [(false, "off"), (true, "on")] {
        let kept = folder.path().join(name);
        let config = ViewerConfig {
            size_px: [SIDE, SIDE],
            adapter: kit::adapter(),
            pipeline_cache: keeps.then(|| kept.clone()),
            ..ViewerConfig::default()
        };
        let mut viewer = Viewer::new_offscreen(&config).unwrap();
        viewer.frame().unwrap();
        drop(viewer);
        assert_eq!(kept.is_dir(), keeps);
    }
}
