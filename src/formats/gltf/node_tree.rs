//! [`NodeTree`]: the transforms of nodes to the frame of the glTF, for the joints of skins. Nodes with several parents. Decode
//! threads.

use glam::DAffine3;
use gltf::json;

use super::double_precision::DoublePrecision;

/// The parents of all nodes, found on first use.
pub(super) struct NodeTree<'a> {
    double: &'a DoublePrecision,
    parents: Vec<Option<usize>>,
}

impl<'a> NodeTree<'a> {
    pub fn new(document: &gltf::Document, double: &'a DoublePrecision) -> Self {
        let mut parents = vec![None; document.nodes().len()];
        for node in document.nodes() {
            for child in node.children() {
                parents[child.index()] = Some(node.index());
            }
        }
        Self { double, parents }
    }

    /// Returns the transform from a node to the frame of the glTF. Returns `None` if a transform is not affine and finite,
    /// or if the nodes form a circle.
    pub fn root_from_node(&self, node: usize) -> Option<DAffine3> {
        let mut root_from_node = self.double.transform(node)?;
        let mut at = node;
        for _ in 0..self.parents.len() {
            match *self.parents.get(at)? {
                Some(parent) => {
                    root_from_node = self.double.transform(parent)? * root_from_node;
                    at = parent;
                }
                None => return Some(root_from_node).filter(DAffine3::is_finite),
            }
        }
        None
    }
}

/// Removes references to nodes so that each has one parent, or is the root of a scene. Returns the number of references
/// that were removed. The first parent in the file counts; the roots of the drawn scene count after it. Indices are valid.
pub(super) fn keep_one_parent(root: &mut json::Root) -> u64 {
    let mut removed = 0;
    let mut parents = vec![None; root.nodes.len()];
    for (parent, node) in root.nodes.iter_mut().enumerate() {
        let Some(children) = &mut node.children else { continue };
        children.retain(|child| match parents.get_mut(child.value()) {
            Some(known) if known.is_none() => {
                *known = Some(parent);
                true
            }
            _ => {
                removed += 1;
                false
            }
        });
    }
    let drawn = root.scene.map_or(0, |scene| scene.value());
    let Some(scene) = root.scenes.get_mut(drawn) else { return removed };
    // A root that lies below another one is drawn there. One of a circle that has no other root begins it.
    let mut is_reached = vec![false; parents.len()];
    let mut is_kept = vec![false; scene.nodes.len()];
    for has_parent in [false, true] {
        for (is_kept, node) in is_kept.iter_mut().zip(&scene.nodes) {
            let node = node.value();
            if is_reached[node] || parents[node].is_some() != has_parent {
                continue;
            }
            *is_kept = true;
            let mut open = vec![node];
            while let Some(node) = open.pop() {
                if !std::mem::replace(&mut is_reached[node], true) {
                    open.extend(root.nodes[node].children.iter().flatten().map(json::Index::value));
                }
            }
        }
    }
    removed += is_kept.iter().filter(|is_kept| !**is_kept).count() as u64;
    let mut is_kept = is_kept.into_iter();
    scene.nodes.retain(|_| is_kept.next().unwrap_or(false));
    removed
}
