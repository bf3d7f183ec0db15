//! OSG's database path: trees of an application's own that name their files relative to a folder.

use std::path::Path;
use std::sync::Arc;

use super::uri::{is_remote, resolve, root_uri};
use super::{IoError, RootScope};
use crate::scene::{Node, NodeKind};

/// Makes the URIs of all tiles and proxies in a tree absolute: what they name is relative to `folder`, a path or an address
/// of a server or object store, as the contents of a tileset.json are to it. What is absolute stays as it is. The
/// counterpart of OSG's `PagedLOD::setDatabasePath`; before [`Page::from_node`](crate::scene::Page::from_node).
///
/// # Errors
/// A folder that is none, and the first name that leads out of what the folder's files may reach
/// ([`RootScope`]); the tree is then half done.
pub fn set_database_path(node: &mut Node, folder: &str) -> Result<(), IoError> {
    let base = root_uri(&in_folder(folder))?;
    let scope = RootScope::of(&base);
    // No call for each level: trees may be as deep as they like.
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

/// What [`root_uri`] takes for the tileset.json of a folder, whether or not there is one.
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
    fn names_are_relative_to_the_folder_and_absolute_ones_stay() {
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
            // Once is enough.
            set_database_path(&mut node, "/elsewhere").unwrap();
            assert_eq!(uris(&node), expected, "{folder}");
        }
    }

    #[test]
    fn nothing_leads_out_of_the_folder() {
        for folder in ["/data/set", "s3://bucket/set"] {
            assert!(set_database_path(&mut tree("t/0.glb", "file:///etc/passwd"), folder).is_err(), "{folder}");
        }
        assert!(set_database_path(&mut tree("../../other.glb", "a.json"), "/data/set").is_err());
        assert!(set_database_path(&mut tree("a.glb", "a.json"), "http://").is_err());
    }
}
