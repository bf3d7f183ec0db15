//! Feeds the parser that `FUZZ_PARSER` names with inputs from libFuzzer. Without a name it lists the parsers. With
//! `FUZZ_SEEDS` set to a folder it first writes the parser's seeds there.
#![no_main]

use std::cell::RefCell;

#[allow(dead_code, reason = "the parsers of elevation files use a part of these files")]
#[path = "../../data-gen/tests/generate/files.rs"]
mod files;
#[path = "../../data-gen/tests/generate/grid_files.rs"]
mod grid_files;
#[path = "../http/fuzz_parsers.rs"]
mod http;
#[path = "../formats/osg/fuzz_parsers.rs"]
mod osg;
#[path = "../overlays/fuzz_parsers.rs"]
mod overlays;
#[path = "../formats/fuzz_parsers.rs"]
mod parsers;
#[allow(unused_imports, reason = "the tests of this file use some of them alone")]
#[path = "../../data-gen/tests/generate/fuzz/places.rs"]
mod places;
#[path = "../../data-gen/tests/generate/fuzz/rasters.rs"]
mod rasters;
#[path = "../formats/terrain/fuzz_parsers.rs"]
mod terrain;
#[allow(dead_code, reason = "the parsers use a part of this file")]
#[path = "../../data-gen/tests/generate/tiffs.rs"]
mod tiffs;
#[path = "../../data-gen/tests/generate/sources/tile_archives.rs"]
mod tile_archives;
/// The name under which data-gen's tests have the module.
mod sources {
    pub(crate) use super::tile_archives;
}

type Parse = Box<dyn FnMut(&[u8])>;

thread_local! {
    static PARSE: RefCell<Parse> = RefCell::new(chosen());
}

fn chosen() -> Parse {
    let wanted = std::env::var("FUZZ_PARSER").unwrap_or_default();
    let known = parsers::all().into_iter().map(|p| (p.name, p.seeds, p.parse));
    let known = known.chain(places::all().into_iter().map(|p| (p.name, p.seeds, p.parse)));
    let known = known.chain(rasters::all().into_iter().map(|p| (p.name, p.seeds, p.parse)));
    let known = known.chain(http::all().into_iter().map(|p| (p.name, p.seeds, p.parse)));
    let known = known.chain(overlays::all().into_iter().map(|p| (p.name, p.seeds, p.parse)));
    let known = known.chain(osg::all().into_iter().map(|p| (p.name, p.seeds, p.parse)));
    let known = known.chain(terrain::all().into_iter().map(|p| (p.name, p.seeds, p.parse)));
    let mut names = Vec::new();
    for (name, seeds, parse) in known {
        if name == wanted {
            if let Some(folder) = std::env::var_os("FUZZ_SEEDS") {
                for (number, seed) in seeds.iter().enumerate() {
                    let file = std::path::Path::new(&folder).join(format!("seed-{number}"));
                    std::fs::write(&file, seed).expect("the folder of seeds can be written");
                }
            }
            return parse;
        }
        names.push(name);
    }
    println!("{}", names.join("\n"));
    std::process::exit(if wanted.is_empty() { 0 } else { 2 });
}

libfuzzer_sys::fuzz_target!(|data: &[u8]| PARSE.with(|parse| (parse.borrow_mut())(data)));
