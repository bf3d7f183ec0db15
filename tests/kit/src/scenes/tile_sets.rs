//! Tile sets on disk: a small generated terrain, and flat quadtrees of triangles with explicit and implicit tiling.

use std::path::Path;

use terrane::formats::writers::{GlbMesh, write_glb};
use terrane_data_gen::{ContentKind, GenArgs, Triangles};

use crate::subtrees::{Availability, Scheme, Subtree};

/// Generates a set in the folder `set` with the options that `change` sets; returns the folder's path.
pub fn generate(set: &Path, change: impl FnOnce(&mut GenArgs)) -> String {
    let mut args = GenArgs::new(set);
    change(&mut args);
    terrane_data_gen::run(&args).unwrap();
    set.display().to_string()
}

/// Generates `levels` levels of mountains, 20 km wide, in `folder/set`; returns that path.
pub fn mountains(folder: &Path, levels: u32) -> String {
    generate(&folder.join("set"), |args| (args.levels, args.seed, args.size) = (Some(levels), 3, 20_000.0))
}

/// Generates three levels of height tiles, 20 km wide, in `folder/set`; returns that path.
pub fn small_set(folder: &Path) -> String {
    generate(&folder.join("set"), |args| (args.levels, args.seed, args.size) = (Some(3), 5, 20_000.0))
}

/// Sets the kind of content; meshes have the triangles of height tiles, so that both show the same ground.
pub fn show_grid(args: &mut GenArgs, content: ContentKind) {
    args.content = content;
    if content == ContentKind::Mesh {
        args.tiles.triangles = Triangles::Grid;
    }
}

/// Side of the world of [`write_quadtree`] and [`write_implicit`], metres.
pub const WORLD_M: f64 = 4096.0;

/// Levels of [`write_quadtree`] below the root.
const LEVELS: u32 = 4;

/// Writes a flat quadtree with a triangle per tile; returns the size of a content in bytes.
pub fn write_quadtree(folder: &Path) -> u64 {
    let glb = write_glb(&GlbMesh {
        positions: vec![[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]],
        indices: vec![0, 1, 2],
        base_color: [1.0; 4],
        ..GlbMesh::default()
    });
    fn tile(folder: &Path, glb: &[u8], level: u32, x: u32, y: u32) -> String {
        let side = WORLD_M / f64::from(1u32 << level);
        let [cx, cy] = [x, y].map(|k| (f64::from(k) + 0.5) * side);
        let name = format!("{level}_{x}_{y}.glb");
        std::fs::write(folder.join(&name), glb).unwrap();
        let (error, children): (f64, Vec<String>) = if level == LEVELS {
            (0.0, Vec::new())
        } else {
            let child = |i: u32| tile(folder, glb, level + 1, 2 * x + i % 2, 2 * y + i / 2);
            (side / 16.0, (0..4).map(child).collect())
        };
        format!(
            r#"{{"boundingVolume":{{"box":[{cx},{cy},0,{h},0,0,0,{h},0,0,0,1]}},"geometricError":{error},"content":{{"uri":"{name}"}},"children":[{}]}}"#,
            children.join(","),
            h = 0.5 * side,
        )
    }
    let root = tile(folder, &glb, 0, 0, 0);
    let json = format!(
        r#"{{"asset":{{"version":"1.1"}},"geometricError":1000,"root":{}}}"#,
        root.replacen('{', r#"{"refine":"REPLACE","#, 1)
    );
    std::fs::write(folder.join("tileset.json"), json).unwrap();
    glb.len() as u64
}

/// Writes a full quadtree with a triangle per tile: `subtrees` levels of subtrees with `levels` levels each.
pub fn write_implicit(folder: &Path, levels: u32, subtrees: u32) {
    let glb = write_glb(&GlbMesh {
        positions: vec![[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]],
        indices: vec![0, 1, 2],
        base_color: [1.0; 4],
        ..GlbMesh::default()
    });
    let half = WORLD_M / 2.0;
    let all = levels * subtrees;
    let json = format!(
        r#"{{"asset":{{"version":"1.1"}},"geometricError":1000,"root":{{
        "boundingVolume":{{"box":[{half},{half},0,{half},0,0,0,{half},0,0,0,1]}},"geometricError":256,"refine":"REPLACE",
        "content":{{"uri":"{{level}}_{{x}}_{{y}}.glb"}},"implicitTiling":{{"subdivisionScheme":"QUADTREE",
        "subtreeLevels":{levels},"availableLevels":{all},"subtrees":{{"uri":"{{level}}.{{x}}.{{y}}.subtree"}}}}}}}}"#
    );
    std::fs::write(folder.join("tileset.json"), json).unwrap();
    for level in 0..all {
        for (x, y) in (0..1 << level).flat_map(|x| (0..1 << level).map(move |y| (x, y))) {
            std::fs::write(folder.join(format!("{level}_{x}_{y}.glb")), &glb).unwrap();
            if level % levels == 0 {
                let mut subtree = Subtree::new(Scheme::Quadtree, levels, 1);
                subtree.fill();
                subtree.set_children(Availability::Constant(level + levels < all));
                std::fs::write(folder.join(format!("{level}.{x}.{y}.subtree")), subtree.binary()).unwrap();
            }
        }
    }
}
