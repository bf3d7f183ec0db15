//! Broken files, unknown classes and endless references: one clear error each, and the rest draws.

use terrane::fetch::Limits;
use terrane::formats::verify;

use super::*;
use kit::osg_files::{Osgb, VERSION, geode, group, osgt, triangle};

fn error(bytes: impl AsRef<[u8]>) -> String {
    let error = read_with(bytes.as_ref(), Vec::new(), &options()).unwrap_err();
    assert_eq!(error.uri(), URI);
    error.to_string()
}

/// A group with a node of an unknown class before a triangle.
fn with_unknown_class(has_sizes: bool) -> Vec<u8> {
    let mut file = Osgb::new(VERSION, has_sizes);
    file.object("osg::Group", 1, |file| {
        file.node_members("").children(2, |file| {
            file.object("osgFoo::Bar", 2, |file| {
                file.raw(&[1, 2, 3, 4, 5]);
            });
            file.triangle_geode(10);
        });
    });
    file.bytes
}

#[test]
fn unknown_classes_are_skipped_if_their_size_is_known() {
    let (node, ignored) = read(with_unknown_class(true));
    assert_eq!((node.children.len(), drawables(&node).len()), (2, 1));
    assert_eq!(ignored.iter().collect::<Vec<_>>(), [("OpenSceneGraph class osgFoo::Bar", 1)]);
    let error = error(with_unknown_class(false));
    assert!(error.contains("class osgFoo::Bar in a file without sizes of blocks is not supported"), "{error}");
}

#[test]
fn files_without_a_node_are_refused() {
    for root in ["osgFoo::Bar { UniqueID 1 }", "osg::CullFace { UniqueID 1 }", "NULL"] {
        assert!(error(osgt(VERSION, root)).contains("a file without a node that is read is not supported"), "{root}");
    }
}

#[test]
fn user_data_is_skipped() {
    let data = "UserDataContainer TRUE { osg::DefaultUserDataContainer { UniqueID 50
        UDC_Descriptions 1 { \"a { b\" } UDC_UserObjects 1 { osg::StringValueObject { UniqueID 51 Value \"x\" } } } }";
    let (node, ignored) = read(osgt(VERSION, &geode(1, data, &[triangle(10, "")])));
    assert_eq!((drawables(&node).len(), ignored.iter().count()), (1, 0));
    // Files without sizes are read member by member.
    let mut file = Osgb::new(91, false);
    file.object("osg::Node", 1, |file| {
        file.text("named").u32(2).raw(&[1]).object("osg::DefaultUserDataContainer", 2, |file| {
            file.object_members("").raw(&[0, 1]).u32(1).text("a description").raw(&[0]);
        });
        file.raw(&[0, 0, 0, 0, 0, 1]).u32(u32::MAX).raw(&[0]);
    });
    let (node, _) = read(file.bytes);
    assert_eq!(node.name, "named");
}

#[test]
fn headers_and_compressors_are_checked() {
    let plain = Osgb::new(VERSION, true).bytes;
    for (bytes, expected) in [
        (plain[..8].to_vec(), "it ends where 4 bytes should follow at byte 8"),
        (plain.clone(), "it ends where 4 bytes should follow"),
        (Osgb::with_compressor(VERSION, true, "lz4x").bytes, "compressor \"lz4x\" is not supported"),
        (Osgb::with_compressor(VERSION, true, "zlib").bytes, "zlib: "),
        (b"#Ascii Scene \n#Version x ".to_vec(), "line 2: x is not a number"),
        (b"#Ascii Image \n#Version 161 ".to_vec(), "an image without a scene is not supported"),
    ] {
        let error = error(bytes);
        assert!(error.contains(expected), "{error}");
    }
}

#[test]
fn broken_lengths_are_errors() {
    let whole = with_unknown_class(true);
    for length in (40..whole.len()).step_by(7) {
        error(&whole[..length]);
    }
    // The size of the root's block, behind its class.
    let at = whole.windows(10).position(|window| window == b"osg::Group").unwrap() + 10;
    for size in [0u64, 7, 13, u64::MAX, 1 << 40] {
        let mut broken = whole.clone();
        broken[at..at + 8].copy_from_slice(&size.to_le_bytes());
        let error = error(&broken);
        assert!(error.contains("block"), "{size}: {error}");
    }
    // Lists and arrays that cannot be in what is left of the file.
    for text in [
        group(1, &[]).replace("Children 0", "Children 4000000000"),
        geode(1, "", &[triangle(10, "")]).replace("vector 3", "vector 1000000000"),
    ] {
        error(osgt(VERSION, &text));
    }
}

#[test]
fn geometry_that_is_invalid_is_left_out() {
    let good = triangle(10, "");
    for bad in [
        triangle(20, "").replace("Count 3", "Count 4"),
        triangle(20, "").replace("Count 3", "First -1 Count 3"),
        triangle(20, "").replace("osg::DrawArrays", "osg::DrawElementsUByte").replace("Count 3", "vector 3 { 0 1 3 }"),
        triangle(20, "").replace("1 0 0", "nan 0 0"),
    ] {
        let (node, ignored) = read(osgt(VERSION, &geode(1, "", &[bad.clone(), good.clone()])));
        assert_eq!(drawables(&node).len(), 1, "{bad}");
        assert_eq!(ignored.count("OpenSceneGraph: invalid geometry that is not drawn"), 1);
        error(osgt(VERSION, &geode(1, "", &[bad])));
    }
}

#[test]
fn nesting_and_references_are_bounded() {
    let nested = (1..200)
        .rev()
        .fold(String::new(), |inner, id| group(id, &if inner.is_empty() { Vec::new() } else { vec![inner] }));
    assert!(error(osgt(VERSION, &nested)).contains("depth of objects"));
    // Each node refers to the one before it, at the same depth of the text.
    let chain: Vec<String> = (2..200u32)
        .map(|id| group(id, &if id == 2 { Vec::new() } else { vec![format!("osg::Group {{ UniqueID {} }}", id - 1)] }))
        .collect();
    assert!(error(osgt(VERSION, &group(1, &chain))).contains("depth of nodes"));
    // Each node refers twice to the one before it.
    let twice: Vec<String> = (2..60u32)
        .map(|id| {
            let reference = format!("osg::Group {{ UniqueID {} }}", id - 1);
            group(id, &if id == 2 { Vec::new() } else { vec![reference.clone(), reference] })
        })
        .collect();
    let limits = Limits { max_elements: 1 << 16, ..Limits::default() };
    let options = ReadOptions::for_root(URI, limits);
    let error = read_with(osgt(VERSION, &group(1, &twice)).as_bytes(), Vec::new(), &options).unwrap_err();
    assert!(error.to_string().contains("nodes of an OpenSceneGraph file"), "{error}");
    // A node that contains itself.
    let (node, ignored) = read(osgt(VERSION, &group(1, &["osg::Group { UniqueID 1 }".to_owned()])));
    assert!(node.children[0].children.is_empty() && ignored.iter().count() == 1, "{ignored:?}");
}

#[test]
fn limits_hold() {
    let with = |limits: Limits, bytes: &[u8]| {
        let options = ReadOptions::for_root(URI, limits);
        read_with(bytes, Vec::new(), &options).unwrap_err().to_string()
    };
    let many: Vec<String> = (0..50).map(|i| triangle(10 + 10 * i, "")).collect();
    let text = osgt(VERSION, &geode(1, "", &many));
    let few = Limits { max_elements: 100, ..Limits::default() };
    assert!(with(few, text.as_bytes()).contains("OpenSceneGraph file is"));
    let mut bomb = Osgb::with_compressor(VERSION, true, "zlib").bytes;
    let mut encoder = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::best());
    std::io::Write::write_all(&mut encoder, &vec![0; 4 << 20]).unwrap();
    bomb.extend(encoder.finish().unwrap());
    let small = Limits { max_file_bytes: 1 << 20, ..Limits::default() };
    assert!(with(small, &bomb).contains("decompressed OpenSceneGraph file"));
}

/// A file with PagedLODs that have a triangle, and files for what is near.
fn pages(files: &[&str]) -> String {
    let page = |(id, file): (u32, &&str)| {
        format!(
            "osg::PagedLOD {{ UniqueID {id} CenterMode USER_DEFINED_CENTER UserCenter 0 0 0 9
            RangeList 2 {{ 50 1e+30 0 50 }} RangeDataList 2 {{ \"\" \"{file}\" }} PriorityList 2 {{ 0 1 0 1 }}
            Children 1 {{ {} }} }}",
            geode(id + 10, "", &[triangle(id + 20, "")])
        )
    };
    osgt(VERSION, &group(1, &(100..).step_by(100).zip(files).map(page).collect::<Vec<_>>()))
}

#[test]
fn whole_sets_are_verified_and_endless_references_end() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, files: &[&str]| std::fs::write(folder.path().join(name), pages(files)).unwrap();
    // A refers to b twice and to c; b and c to d, which does not exist at first.
    write("a.osgt", &["b.osgt", "b.osgt", "c.osgt"]);
    write("b.osgt", &["d.osgt"]);
    write("c.osgt", &["d.osgt"]);
    let root = folder.path().join("a.osgt");
    let verified = || verify(root.to_str().unwrap(), &Limits::default(), &mut |_| {}).unwrap();
    let first = verified();
    assert_eq!((first.contents, first.failed), (4, 1), "{first:?}");
    assert!(first.errors[0].uri.ends_with("d.osgt") && first.errors[0].reason == "not found");
    std::fs::write(folder.path().join("d.osgt"), osgt(VERSION, &geode(1, "", &[triangle(2, "")]))).unwrap();
    let whole = verified();
    assert_eq!((whole.contents, whole.failed), (4, 0), "{whole:?}");
    // Now d refers to a.
    write("d.osgt", &["a.osgt"]);
    let cycle = verified();
    assert_eq!((cycle.contents, cycle.failed), (5, 1), "{cycle:?}");
    assert!(cycle.errors[0].reason.contains("the file contains itself"), "{cycle:?}");
    // Files that do not end are refused at a depth.
    let below = ReadOptions { chain: (0..200).map(|i| format!("/set/{i}").into()).collect(), ..options() };
    let error = read_with(pages(&[]).as_bytes(), Vec::new(), &below).unwrap_err();
    assert!(error.to_string().contains("depth of files"), "{error}");
}
