//! [`NodeTree`]: the transforms of nodes to the frame of the glTF, for the joints of skins.

use glam::DAffine3;

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
