//! Rewrites the programs of meshes for height tiles. Draw thread.

use super::check::checked;
use crate::draw::pipelines::sources::{HEIGHT_PROGRAM_PRELUDE, PROGRAM_PRELUDE};

/// The vertex entry point of programs on height tiles.
pub(in crate::draw) const HEIGHT_ENTRY: &str = "vs_height_main";

/// Returns the source of a program for height tiles: its vertex entry point becomes a function that is called with a
/// displaced vertex instead of a mesh's.
pub(super) fn heights_source(wgsl: &str) -> Result<String, String> {
    let module = naga::front::wgsl::parse_str(&format!("{PROGRAM_PRELUDE}\n{wgsl}")).map_err(|e| e.to_string())?;
    let entry = module.entry_points.iter().find(|e| e.name == "vs_main").ok_or("no vertex entry point vs_main")?;
    let arguments =
        entry.function.arguments.iter().map(|argument| match (&argument.binding, &module.types[argument.ty].name) {
            (Some(naga::Binding::BuiltIn(naga::BuiltIn::InstanceIndex)), _) => Ok("instance"),
            (Some(naga::Binding::BuiltIn(naga::BuiltIn::VertexIndex)), _) => Ok("index"),
            (None, Some(name)) if name == "MeshVertex" => Ok("height_vertex(index, instance)"),
            _ => Err("vs_main takes other than MeshVertex, vertex_index and instance_index"),
        });
    let arguments = arguments.collect::<Result<Vec<_>, _>>()?.join(", ");
    let result = entry.function.result.as_ref().ok_or("vs_main returns nothing")?;
    let result = match (&result.binding, &module.types[result.ty].name) {
        (Some(naga::Binding::BuiltIn(naga::BuiltIn::Position { .. })), _) => "@builtin(position) vec4<f32>",
        (None, Some(name)) => name,
        _ => return Err("vs_main returns neither a struct nor a position".into()),
    };
    // Only spaces and line breaks may stand between the attribute and the function.
    let name = find_function(wgsl, "vs_main").ok_or("`fn vs_main` is not found")?;
    let before = wgsl[..name].trim_end();
    let before = before.strip_suffix("@vertex").ok_or("`@vertex` does not stand right before `fn vs_main`")?;
    let (header, body) = wgsl[name..].split_at(wgsl[name..].find('{').unwrap_or(0));
    let header = without_attributes(header);
    let source = format!(
        "{HEIGHT_PROGRAM_PRELUDE}\n{before}{header}{body}\n@vertex\nfn {HEIGHT_ENTRY}(@builtin(vertex_index) index: u32, \
         @builtin(instance_index) instance: u32) -> {result} {{\n    return vs_main({arguments});\n}}\n"
    );
    checked(&source)?;
    Ok(source)
}

/// Removes the attributes from a function header, since only entry points may have them.
fn without_attributes(header: &str) -> String {
    let mut parts = header.split('@');
    let mut kept = parts.next().unwrap_or_default().to_owned();
    for attribute in parts {
        let name = attribute.find(|c: char| !c.is_alphanumeric() && c != '_').unwrap_or(attribute.len());
        let rest = &attribute[name..];
        let values = rest.trim_start();
        let end = values.find(')').filter(|_| values.starts_with('(')).map(|end| &values[end + 1..]);
        kept.push_str(end.unwrap_or(rest));
    }
    kept
}

/// Returns the position at which `fn NAME` begins.
fn find_function(wgsl: &str, name: &str) -> Option<usize> {
    let is_name = |c: char| c.is_alphanumeric() || c == '_';
    wgsl.match_indices("fn").map(|(at, _)| at).find(|at| {
        let rest = &wgsl[at + 2..];
        let after = rest.trim_start();
        let is_word = !wgsl[..*at].ends_with(is_name) && after.len() < rest.len();
        is_word && after.strip_prefix(name).is_some_and(|end| !end.starts_with(is_name))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const FRAGMENT: &str = "@fragment fn fs_main() -> @location(0) vec4<f32> { return vec4<f32>(1.0); }";

    #[test]
    fn mesh_programs_are_rewritten_for_height_tiles() {
        let simple = format!(
            "// fn vs_main is below\n@vertex\n  fn vs_main(vertex: MeshVertex, @builtin(instance_index) instance: u32) -> \
             @builtin(position) vec4<f32> {{\n return frame.clip_from_eye * vec4<f32>(point_in_eye(leaves[instance], \
             vertex.position), 1.0);\n}}\n{FRAGMENT}"
        );
        assert_eq!(heights_source(&simple).unwrap_err(), "`@vertex` does not stand right before `fn vs_main`");
        let simple = simple.replace("// fn vs_main is below", "fn vs_main_helper() {}");
        let source = heights_source(&simple).unwrap();
        assert!(source.contains("return vs_main(height_vertex(index, instance), instance);"));
        let varying = "struct Out { @builtin(position) p: vec4<f32>, @location(0) n: vec3<f32> }
            @vertex fn vs_main(@builtin(instance_index) i: u32, @builtin(vertex_index) v: u32, m: MeshVertex) -> Out {
                return Out(vec4<f32>(f32(i), f32(v), 0.0, 1.0), m.normal.xyz);
            }";
        heights_source(&format!("{varying}{FRAGMENT}")).unwrap();
        let own_inputs = "@vertex fn vs_main(@location(0) p: vec3<f32>) -> @builtin(position) vec4<f32> {
            return vec4<f32>(p, 1.0); }";
        let error = heights_source(&format!("{own_inputs}{FRAGMENT}")).unwrap_err();
        assert!(error.contains("other than MeshVertex"), "{error}");
        // The tiles' own shader has a function of this name.
        let error = heights_source(&format!("fn height_at() {{}} {varying}{FRAGMENT}")).unwrap_err();
        assert!(error.contains("height_at"), "{error}");
    }
}
