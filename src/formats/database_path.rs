//! The counterpart of OSG's database path, for graphs of an application whose files are relative to a folder.

use std::path::Path;
use std::sync::Arc;

use crate::fetch::{IoError, RootScope, is_remote, resolve, root_uri};
use crate::scene::{Node, NodeKind};

/// Makes the URIs of all tiles and proxies in a tree absolute. Relative ones are resolved against `folder`, which is a path or
/// the URL of a folder on a server or in an object store. It is the counterpart of OSG's `PagedLOD::setDatabasePath`. Call it
/// before [`Page::from_node`](crate::scene::Page::from_node).
///
/// # Errors
/// Fails for an invalid folder, and for the first URI that leaves the scope of the folder ([`RootScope`]). Some URIs of the
/// tree are then already absolute.
pub fn set_database_path(node: &mut Node, folder: &str) -> Result<(), IoError> {
    let base = root_uri(&in_folder(folder))?;
    let scope = RootScope::of(&base);
    // An explicit stack, since trees may be arbitrarily deep.
    let mut rest = vec![node];
    while let Some(node) = rest.pop() {
        match &mut node.kind {
            NodeKind::PagedLod(lod) => lod.content.iter_mut().try_for_each(|uri| absolute(uri, &base, &scope))?,
            NodeKind::ProxyNode(proxy) => absolute(&mut proxy.uri, &base, &scope)?,
            _ => {}
        }
        rest.extend(&mut node.children);
    }
    Ok(())
}

/// Returns the input by which [`root_uri`] names the tileset.json of a folder, whether or not it exists.
fn in_folder(folder: &str) -> String {
    if !is_remote(folder) {
        return Path::new(folder).join("tileset.json").to_string_lossy().into_owned();
    }
    let (address, query) = folder.split_at(folder.find(['?', '#']).unwrap_or(folder.len()));
    format!("{address}/{query}")
}

fn absolute(uri: &mut Arc<str>, base: &str, scope: &RootScope) -> Result<(), IoError> {
    if !is_remote(uri) && !Path::new(&**uri).is_absolute() {
        *uri = resolve(base, uri, scope)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use glam::{DAffine3, DVec3};

    use super::*;
    use crate::math::{BoundingSphere, BoundingVolume};
    use crate::scene::{PagedLod, PagingOptions, ProxyLoading, ProxyNode, RangeMode, Refine};

    fn tree(content: &str, proxy: &str) -> Node {
        let lod = PagedLod {
            bounds: BoundingVolume::Sphere(BoundingSphere::EVERYTHING),
            range_mode: RangeMode::Distance { center: DVec3::ZERO, range_m: 1.0 },
            refine: Refine::Replace,
            content: Some(content.into()),
            content_transform: DAffine3::IDENTITY,
            reader_data: None,
            request_volume: None,
            paging: PagingOptions::default(),
        };
        let proxy = ProxyNode {
            uri: proxy.into(),
            bounds: BoundingSphere::EVERYTHING,
            content_transform: DAffine3::IDENTITY,
            loading: ProxyLoading::Never,
        };
        let below = Node::group(vec![Node::new(NodeKind::ProxyNode(Box::new(proxy)))]);
        Node { children: vec![below], ..Node::new(NodeKind::PagedLod(Box::new(lod))) }
    }

    fn uris(node: &Node) -> [String; 2] {
        let NodeKind::PagedLod(lod) = &node.kind else { panic!("a tile") };
        let NodeKind::ProxyNode(proxy) = &node.children[0].children[0].kind else { panic!("a proxy") };
        [lod.content.as_deref().unwrap().to_owned(), proxy.uri.to_string()]
    }

    #[test]
    fn relative_uris_become_absolute_and_absolute_ones_stay() {
        for (folder, expected) in [
            ("/data/set", ["/data/set/t/0.glb", "/data/set/more.json"]),
            ("/data/set/", ["/data/set/t/0.glb", "/data/set/more.json"]),
            ("http://a.org/set", ["http://a.org/set/t/0.glb", "http://a.org/set/more.json"]),
            ("http://a.org", ["http://a.org/t/0.glb", "http://a.org/more.json"]),
            ("http://a.org/set?key=7", ["http://a.org/set/t/0.glb?key=7", "http://a.org/set/more.json?key=7"]),
            ("s3://bucket/set/", ["s3://bucket/set/t/0.glb", "s3://bucket/set/more.json"]),
        ] {
            let mut node = tree("t/0.glb", "./more.json");
            set_database_path(&mut node, folder).unwrap();
            assert_eq!(uris(&node), expected, "{folder}");
            // A second call changes nothing.
            set_database_path(&mut node, "/elsewhere").unwrap();
            assert_eq!(uris(&node), expected, "{folder}");
        }
    }

    #[test]
    fn uris_outside_of_the_folder_are_refused() {
        for folder in ["/data/set", "s3://bucket/set"] {
            assert!(set_database_path(&mut tree("t/0.glb", "file:///etc/passwd"), folder).is_err(), "{folder}");
        }
        assert!(set_database_path(&mut tree("../../other.glb", "a.json"), "/data/set").is_err());
        assert!(set_database_path(&mut tree("a.glb", "a.json"), "http://").is_err());
    }
}
