//! Parses and validates the sources of programs.

/// Parses and validates a source.
pub(super) fn checked(source: &str) -> Result<naga::Module, String> {
    let module = naga::front::wgsl::parse_str(source).map_err(|e| lines_of(&e.emit_to_string(source)))?;
    naga::valid::Validator::new(naga::valid::ValidationFlags::all(), naga::valid::Capabilities::empty())
        .validate(&module)
        .map_err(|e| lines_of(&e.emit_to_string(source)))?;
    Ok(module)
}

/// Returns the first lines of an error of naga, which points into the source over several lines, as one line.
fn lines_of(text: &str) -> String {
    text.trim().lines().map(str::trim).filter(|l| !l.is_empty()).take(4).collect::<Vec<_>>().join(" ")
}
