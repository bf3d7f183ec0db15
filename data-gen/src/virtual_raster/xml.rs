//! The elements, numbers and paths in the XML of a virtual raster. Any thread.

use std::path::{Path, PathBuf};

use roxmltree::Node;

/// Returns the path or the address of a source. GDAL's names of remote files have a prefix.
pub(super) fn path_of(name: &str, is_relative: bool, raster: &Path) -> PathBuf {
    for (prefix, scheme) in [("/vsicurl/", ""), ("/vsis3/", "s3://"), ("/vsigs/", "gs://"), ("/vsiaz/", "az://")] {
        if let Some(rest) = name.strip_prefix(prefix) {
            return PathBuf::from(format!("{scheme}{rest}"));
        }
    }
    match raster.parent() {
        Some(folder) if is_relative => folder.join(name),
        _ => PathBuf::from(name),
    }
}

/// Returns the reason for what is not read.
pub(super) fn unsupported(name: &str) -> String {
    format!("`{}` is not supported; gdal_translate writes the raster as GeoTIFF", name.escape_debug())
}

/// Returns the elements of a name in another.
pub(super) fn children<'a, 'b>(
    node: &Node<'a, 'b>,
    name: &'static str,
) -> impl Iterator<Item = Node<'a, 'b>> + use<'a, 'b> {
    node.children().filter(move |child| child.is_element() && child.tag_name().name() == name)
}

/// Returns the first element of a name in another.
pub(super) fn child<'a, 'b>(node: &Node<'a, 'b>, name: &str) -> Option<Node<'a, 'b>> {
    node.children().find(|child| child.is_element() && child.tag_name().name() == name)
}

/// Reads a finite number. The error is the reason.
pub(super) fn number(text: Option<&str>, name: &str) -> Result<f64, String> {
    let text = text.ok_or_else(|| format!("no {name}"))?.trim();
    text.parse().ok().filter(|n: &f64| n.is_finite()).ok_or_else(|| format!("{name} is `{}`", text.escape_debug()))
}
