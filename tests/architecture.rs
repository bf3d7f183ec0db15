//! The layout of the source: the direction of imports between the folders of `src`, and in all code of the workspace
//! the number of Rust files per folder and the length of files.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

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

/// Rust files only: the shaders are one list of programs in one folder.
const MAX_FILES_PER_FOLDER: usize = 14;
const MAX_LINES_PER_FILE: usize = 600;
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
