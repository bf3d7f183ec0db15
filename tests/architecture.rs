//! The layout of the source: the direction of imports between the folders of `src`, and circles of imports inside folders. In all
//! code of the workspace: the number of Rust files per folder, the length of files, and large types. And the form of the documents.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};

/// The folders of `src` from the ground floor up. A folder may use folders on lower levels only.
const LEVELS: [&[&str]; 6] = [
    &["math", "sync", "trace"],
    &["fetch", "state"],
    &["scene"],
    &["formats", "cull", "gpu"],
    &["pager", "draw"],
    &["viewer"],
];

/// Circles of imports between the files and sub-folders of one folder, in all of [`CRATES`]. Those that are left are between
/// sub-folders that would need traits, or large moves, to be parted.
const MAX_CIRCLES: usize = 6;
/// Circles between files alone. Each is two halves of one object, or a type that is in the wrong file.
const MAX_CIRCLES_OF_FILES: usize = 0;
/// The sources in which circles are counted.
const CRATES: [&str; 3] = ["src", "data-gen/src", "tools/src"];
/// Rust files only: the shaders are one list of programs in one folder.
const MAX_FILES_PER_FOLDER: usize = 14;
const MAX_LINES_PER_FILE: usize = 600;
/// A type with more fields says why in its documentation.
const MAX_FIELDS: usize = 16;
/// The documents that are read first, and their limits in bytes.
const MAX_BYTES_PER_DOCUMENT: [(&str, usize); 3] =
    [("README.md", 9 << 10), ("ARCHITECTURE.md", 12 << 10), ("CHANGELOG.md", 12 << 10)];
/// The longest cell of a table in the README.
const MAX_CELL: usize = 120;
/// The sections of a decision.
const SECTIONS: [&str; 5] = ["Context", "Decision", "Measurement", "Consequences", "When to look at it again"];
/// The folders whose files and sub-folders have these limits.
const LIMITED: [&str; 7] = ["src", "tools/src", "tools/tests", "data-gen", "tests", "examples", "benches"];

#[test]
fn folders_use_only_lower_levels() {
    let mut violations = String::new();
    let folders = folders_of(&src());
    for folder in &folders {
        let name = file_name(folder);
        let level = level_of(&name).unwrap_or_else(|| panic!("src/{name} has no level: add it to LEVELS"));
        for file in rust_files(folder) {
            let text = fs::read_to_string(&file).unwrap();
            for (line, used) in uses(&production_code(&text)) {
                if used != name && level_of(&used).is_some_and(|used_level| used_level >= level) {
                    writeln!(violations, "{}:{line}: {name} must not use {used}", file.display()).unwrap();
                }
            }
        }
    }
    assert!(violations.is_empty(), "imports against the order of folders:\n{violations}");
}

#[test]
fn folders_and_files_are_small() {
    let mut violations = String::new();
    let mut folders: Vec<PathBuf> = LIMITED.map(|folder| root().join(folder)).into();
    while let Some(folder) = folders.pop() {
        let files: Vec<PathBuf> = files_in(&folder).into_iter().filter(|path| is_rust(path)).collect();
        if files.len() > MAX_FILES_PER_FOLDER {
            let (folder, count) = (folder.display(), files.len());
            writeln!(violations, "{folder}: {count} files, at most {MAX_FILES_PER_FOLDER} are allowed").unwrap();
        }
        for file in &files {
            let lines = fs::read_to_string(file).unwrap().lines().count();
            if lines > MAX_LINES_PER_FILE {
                let file = file.display();
                writeln!(violations, "{file}: {lines} lines, at most {MAX_LINES_PER_FILE} are allowed").unwrap();
            }
        }
        // A package in the workspace may have a build folder.
        folders.extend(folders_of(&folder).into_iter().filter(|path| file_name(path) != "target"));
    }
    assert!(violations.is_empty(), "too large:\n{violations}");
}

#[test]
fn large_types_say_why() {
    let mut violations = String::new();
    for file in CRATES.iter().flat_map(|folder| rust_files(&root().join(folder))) {
        let text = fs::read_to_string(&file).unwrap();
        for (name, fields) in undocumented_large_types(&text) {
            writeln!(violations, "{}: {name} has {fields} fields and does not say why", file.display()).unwrap();
        }
    }
    assert!(violations.is_empty(), "types with more than {MAX_FIELDS} fields:\n{violations}");
    let fields: String = (0..=MAX_FIELDS).map(|i| format!("    pub(crate) f{i}: u8,\n")).collect();
    let found =
        |above: &str| undocumented_large_types(&format!("{above}\npub struct Large<'a> {{\n{fields}}}\n")).len();
    assert_eq!([found("/// Everything."), found("/// It has many fields.\n#[derive(Debug)]")], [1, 0]);
}

#[test]
fn documents_are_short_and_decisions_complete() {
    for (name, limit) in MAX_BYTES_PER_DOCUMENT {
        let bytes = fs::read(root().join(name)).unwrap().len();
        assert!(bytes <= limit, "{name}: {bytes} bytes, at most {limit} are allowed");
    }
    let readme = fs::read_to_string(root().join("README.md")).unwrap();
    let cells = readme.lines().filter(|line| line.starts_with('|')).flat_map(|row| row.split('|'));
    let long: Vec<&str> = cells.filter(|cell| cell.trim().chars().count() > MAX_CELL).collect();
    assert!(long.is_empty(), "cells of more than {MAX_CELL} characters: {long:?}");
    let is_decision = |path: &PathBuf| file_name(path).starts_with(|c: char| c.is_ascii_digit());
    let decisions: Vec<PathBuf> = files_in(&root().join("docs/decisions")).into_iter().filter(is_decision).collect();
    assert!(decisions.len() > 50, "{decisions:?}");
    for file in decisions {
        let text = fs::read_to_string(&file).unwrap();
        let lacks = |section: &&&str| !text.lines().any(|line| line.strip_prefix("## ") == Some(**section));
        let missing: Vec<_> = SECTIONS.iter().filter(lacks).collect();
        assert!(missing.is_empty(), "{} has no section {missing:?}", file.display());
    }
}

#[test]
fn imports_are_found_outside_of_comments_and_tests() {
    let text = r#"
// use crate::viewer::A;
use crate::math::B; // crate::draw
#[cfg(test)]
use crate::pager::C;
use crate::{
    scene::{D, draw},
    state,
};
fn f() { let url = "http://h"; crate::sync::g(); }
#[cfg(test)]
mod tests {
    use crate::gpu::E;
    fn brace() -> char { '}' }
}
use crate::trace::F;
"#;
    let found: Vec<(usize, String)> = uses(&production_code(text));
    let expected = [(3, "math"), (6, "scene"), (6, "state"), (10, "sync"), (16, "trace")];
    assert_eq!(found, expected.map(|(line, name)| (line, name.to_owned())));
}

#[test]
fn imports_run_in_few_circles() {
    for (of_files, allowed) in [(true, MAX_CIRCLES_OF_FILES), (false, MAX_CIRCLES)] {
        let found: Vec<String> = CRATES
            .iter()
            .flat_map(|folder| {
                circles(&modules_of(&root().join(folder)), of_files).into_iter().map(move |c| format!("{folder}/{c}"))
            })
            .collect();
        assert!(
            found.len() <= allowed,
            "{} circles, at most {allowed} are allowed:\n{}",
            found.len(),
            found.join("\n")
        );
    }
}

#[test]
fn known_circles_are_found() {
    let circles_of = |files: &[(&str, &str)], of_files: bool| {
        let path = |file: &str| file.split('/').filter(|part| !part.is_empty()).map(str::to_owned).collect();
        circles(&files.iter().map(|(file, text)| (path(file), production_code(text))).collect(), of_files)
    };
    let files = [
        ("", "mod a; mod b; pub use b::B;"),
        ("a", "use crate::B;"),
        ("b", "use super::c;\nfn f() { super::a::g() }"),
        ("c", "#[cfg(test)]\nuse crate::a::A;"),
    ];
    assert_eq!(circles_of(&files, true), [":\n  a -> b (crate::B)\n  b -> a (super::a::g)"]);
    let folders = [
        ("f", ""),
        ("f/a", "mod inner;\npub use inner::{A, other::{self, O as P}};"),
        ("f/a/inner", "use crate::f::b;"),
        ("f/b", "use crate::f::{x::X, a::{P, A}};"),
        ("f/x", ""),
    ];
    assert!(circles_of(&folders, true).is_empty());
    assert_eq!(circles_of(&folders, false), ["f:\n  a -> b (crate::f::b)\n  b -> a (crate::f::a::A, crate::f::a::P)"]);
}

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn src() -> PathBuf {
    root().join("src")
}

fn level_of(folder: &str) -> Option<usize> {
    LEVELS.iter().position(|level| level.contains(&folder))
}

fn file_name(path: &Path) -> String {
    path.file_name().unwrap().to_str().unwrap().to_owned()
}

fn is_rust(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension == "rs")
}

fn entries(folder: &Path) -> Vec<PathBuf> {
    let mut paths: Vec<PathBuf> = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    paths.sort();
    paths
}

fn files_in(folder: &Path) -> Vec<PathBuf> {
    entries(folder).into_iter().filter(|path| path.is_file()).collect()
}

fn folders_of(folder: &Path) -> Vec<PathBuf> {
    entries(folder).into_iter().filter(|path| path.is_dir()).collect()
}

/// Returns the Rust files in a folder and its sub-folders.
fn rust_files(folder: &Path) -> Vec<PathBuf> {
    let mut files: Vec<PathBuf> = files_in(folder).into_iter().filter(|path| is_rust(path)).collect();
    files.extend(folders_of(folder).iter().flat_map(|folder| rust_files(folder)));
    files
}

/// Returns the structs of a file with more than [`MAX_FIELDS`] fields whose comment says nothing of fields, and how many they have.
fn undocumented_large_types(text: &str) -> Vec<(String, usize)> {
    let lines: Vec<&str> = text.lines().collect();
    let mut found = Vec::new();
    for (at, line) in lines.iter().enumerate() {
        let indentation = line.len() - line.trim_start().len();
        let Some((visibility, rest)) = line.split_once("struct ").filter(|_| line.ends_with('{')) else { continue };
        if !(visibility.trim().is_empty() || visibility.trim_start().starts_with("pub")) {
            continue;
        }
        let body = lines[at + 1..].iter().take_while(|line| **line != format!("{:indentation$}}}", ""));
        let is_field = |line: &&&str| {
            let own = line.len() - line.trim_start().len() == indentation + 4;
            own && line.contains(": ") && !line.trim_start().starts_with(['/', '#'])
        };
        let fields = body.filter(is_field).count();
        let above = lines[..at].iter().rev().take_while(|line| line.trim_start().starts_with(['/', '#']));
        if fields > MAX_FIELDS && !above.into_iter().any(|line| line.contains("field")) {
            found.push((rest.split(|c: char| !c.is_alphanumeric()).next().unwrap().to_owned(), fields));
        }
    }
    found
}

/// Replaces comments, and items under `#[cfg(test)]`, by empty text. Line numbers stay the same.
fn production_code(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    let mut lines = text.lines();
    while let Some(line) = lines.next() {
        if !line.trim_start().starts_with("#[cfg(test)]") && !line.trim_start().starts_with("#[cfg(all(test") {
            out.push_str(without_comment(line));
            out.push('\n');
            continue;
        }
        out.push('\n');
        // An item at this indentation ends with `;` on its first line, or with `}` at the same indentation.
        let indentation = line.len() - line.trim_start().len();
        let end = format!("{:indentation$}}}", "");
        let mut is_first = true;
        for line in lines.by_ref() {
            out.push('\n');
            let code = without_comment(line).trim_end();
            let is_attribute = code.trim_start().starts_with("#[");
            if line.starts_with(&end) || is_first && !is_attribute && code.ends_with([';', '}', ',']) {
                break;
            }
            is_first &= is_attribute;
        }
    }
    out
}

/// Cuts off a comment. `//` inside a string is not a comment.
fn without_comment(line: &str) -> &str {
    let is_comment = |at: &usize| line[..*at].matches('"').count().is_multiple_of(2);
    let at = line.match_indices("//").map(|(at, _)| at).find(is_comment);
    at.map_or(line, |at| &line[..at])
}

/// Returns the top-level modules after `crate::` with their line numbers, single or in braces.
fn uses(code: &str) -> Vec<(usize, String)> {
    let identifier = |text: &str| -> String {
        text.trim_start().chars().take_while(|c| c.is_ascii_alphanumeric() || *c == '_').collect()
    };
    let mut found = Vec::new();
    for (at, prefix) in code.match_indices("crate::") {
        let line = code[..at].matches('\n').count() + 1;
        let rest = &code[at + prefix.len()..];
        let Some(group) = rest.strip_prefix('{') else {
            found.push((line, identifier(rest)));
            continue;
        };
        let (mut depth, mut begin) = (1, 0);
        for (i, c) in group.char_indices() {
            match c {
                '{' => depth += 1,
                '}' => depth -= 1,
                _ => {}
            }
            if depth == 0 || depth == 1 && c == ',' {
                found.push((line, identifier(&group[begin..i])));
                begin = i + 1;
            }
            if depth == 0 {
                break;
            }
        }
    }
    found.retain(|(_, name)| !name.is_empty());
    found
}

/// The path of a module in its crate.
type Module = Vec<String>;
/// The names that a module imports with their paths; other paths in its code have no name.
type Imports = Vec<(String, Vec<String>)>;
/// The edges between the modules of a folder, and the paths that make them.
type Edges<'a> = BTreeMap<[&'a str; 2], BTreeSet<String>>;

/// Returns the production code of each module of a crate.
fn modules_of(root: &Path) -> BTreeMap<Module, String> {
    let module_of = |file: &Path| -> Module {
        let path = file.strip_prefix(root).unwrap().with_extension("");
        let names = path.iter().map(|name| name.to_str().unwrap().to_owned());
        names.filter(|name| name != "mod" && name != "lib").collect()
    };
    rust_files(root).iter().map(|file| (module_of(file), production_code(&fs::read_to_string(file).unwrap()))).collect()
}

/// Returns the circles of imports, each as its folder and its edges: between the files of a folder, or between its files and
/// sub-folders. An import leads to the file that declares the name, through the modules that re-export it.
fn circles(modules: &BTreeMap<Module, String>, of_files: bool) -> Vec<String> {
    let imports: BTreeMap<&[String], Imports> =
        modules.iter().map(|(module, code)| (&module[..], imports(code))).collect();
    let folders: BTreeSet<&[String]> =
        modules.keys().filter_map(|module| module.split_last()).map(|(_, up)| up).collect();
    let mut edges: BTreeMap<&[String], Edges<'_>> = BTreeMap::new();
    for (from, paths) in &imports {
        for (_, path) in paths {
            let Some(to) = declared_in(&imports, from, path, 0) else { continue };
            let depth = from.iter().zip(to).take_while(|(a, b)| a == b).count();
            let is_file = |module: &[String]| module.len() == depth + 1 && !folders.contains(module);
            if depth < from.len().min(to.len()) && (!of_files || is_file(from) && is_file(to)) {
                let edges = edges.entry(&from[..depth]).or_default();
                edges.entry([&from[depth], &to[depth]]).or_default().insert(path.join("::"));
            }
        }
    }
    let mut found = Vec::new();
    for (folder, edges) in &edges {
        let mut left: BTreeSet<&str> = edges.keys().flatten().copied().collect();
        while let Some(first) = left.pop_first() {
            let there = reached_from(edges, first);
            let circle: BTreeSet<&str> =
                there.into_iter().filter(|other| reached_from(edges, other).contains(first)).collect();
            left.retain(|module| !circle.contains(module));
            let inside = edges.iter().filter(|(edge, _)| edge.iter().all(|module| circle.contains(module)));
            let list = |paths: &BTreeSet<String>| paths.iter().map(String::as_str).collect::<Vec<_>>().join(", ");
            let inside: Vec<String> = inside.map(|([a, b], paths)| format!("{a} -> {b} ({})", list(paths))).collect();
            found.extend((circle.len() > 1).then(|| format!("{}:\n  {}", folder.join("/"), inside.join("\n  "))));
        }
    }
    found
}

/// Returns the modules that edges lead to from one, which is one of them.
fn reached_from<'a>(edges: &Edges<'a>, first: &'a str) -> BTreeSet<&'a str> {
    let (mut reached, mut next) = (BTreeSet::from([first]), vec![first]);
    while let Some(module) = next.pop() {
        next.extend(edges.keys().filter(|[a, b]| *a == module && reached.insert(b)).map(|[_, b]| *b));
    }
    reached
}

/// Returns the module that declares what a path in a module leads to; `None` outside of the crate.
fn declared_in<'a>(
    imports: &BTreeMap<&'a [String], Imports>,
    at: &[String],
    path: &[String],
    depth: usize,
) -> Option<&'a [String]> {
    const MAX_DEPTH: usize = 8;
    let supers = path.iter().take_while(|part| *part == "super").count();
    let (base, rest) = match path.first()?.as_str() {
        "crate" => (&at[..0], &path[1..]),
        "self" => (at, &path[1..]),
        _ => (&at[..at.len().checked_sub(supers)?], &path[supers..]),
    };
    let full = [base, rest].concat();
    let length = (0..=full.len()).rev().find(|length| imports.contains_key(&full[..*length]))?;
    // A path without such a beginning leads to a child or to another crate.
    let is_in_crate = length > at.len() || ["crate", "self", "super"].contains(&path[0].as_str());
    let (module, own) = imports.get_key_value(&full[..length]).filter(|_| is_in_crate && depth < MAX_DEPTH)?;
    let imported = own.iter().find(|(name, _)| Some(name) == full.get(length));
    imported.and_then(|(_, path)| declared_in(imports, module, path, depth + 1)).or(Some(module))
}

/// Returns the imports of a file, and without a name its other paths that begin with `crate`, `self` or `super`.
fn imports(code: &str) -> Imports {
    let is_word = |c: char| c.is_ascii_alphanumeric() || c == '_';
    let (mut found, mut others, mut rest) = (Vec::new(), String::new(), code);
    while let Some((before, after)) = rest.split_once("use ") {
        others.push_str(before);
        rest = after;
        if !before.ends_with(is_word) {
            let (tree, after) = after.split_once(';').unwrap_or((after, ""));
            expand(&[], tree, &mut found);
            rest = after;
        }
    }
    others.push_str(rest);
    for start in ["crate::", "self::", "super::"] {
        for (at, _) in
            others.match_indices(start).filter(|(at, _)| !others[..*at].ends_with(|c| is_word(c) || c == ':'))
        {
            let path = others[at..].split(|c| !is_word(c) && c != ':').next().unwrap();
            found.push((String::new(), names_of(path)));
        }
    }
    found
}

fn names_of(path: &str) -> Vec<String> {
    path.split("::").map(|name| name.trim().to_owned()).filter(|name| !name.is_empty()).collect()
}

/// Adds the paths of a tree such as `a::{b, c::{self, D as E}}`.
fn expand(prefix: &[String], tree: &str, found: &mut Imports) {
    let Some((head, group)) = tree.split_once('{') else {
        let (path, alias) = tree.split_once(" as ").unwrap_or((tree, ""));
        let path = [prefix, &names_of(path)].concat();
        let path = path.strip_suffix(&["self".to_owned()]).filter(|path| !path.is_empty()).unwrap_or(&path).to_vec();
        let name = if alias.is_empty() { path.last().cloned().unwrap_or_default() } else { alias.trim().to_owned() };
        return found.extend((!path.is_empty()).then_some((name, path)));
    };
    let prefix = [prefix, &names_of(head)].concat();
    let (mut depth, mut begin) = (0, 0);
    for (at, c) in group.char_indices() {
        if depth == 0 && (c == ',' || c == '}') {
            expand(&prefix, &group[begin..at], found);
            begin = at + 1;
        }
        depth += i32::from(c == '{') - i32::from(c == '}');
        if depth < 0 {
            return;
        }
    }
}
