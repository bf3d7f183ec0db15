//! Nodes and scenes.

use glam::{DQuat, DVec3};
use serde_json::{Value, json};

use super::Upgrade;
use super::document::Node;
use crate::fetch::{IoError, JSON_OBJECT_BYTES};
use crate::formats::lenient::Text;

impl Upgrade<'_> {
    /// Returns the nodes. The second and all further meshes of a node become its children, which follow all other nodes.
    pub(super) fn nodes(&self) -> Result<Vec<Value>, IoError> {
        let old = &self.document.nodes.list;
        // A reference takes less memory than the node that it becomes.
        let added: u64 = old.iter().map(|node| (meshes(node).len() as u64).saturating_sub(1)).sum();
        let (got, limit) = (added.saturating_mul(JSON_OBJECT_BYTES), self.limits.max_json_bytes);
        if got > limit {
            return Err(IoError::TooLarge { uri: self.uri.to_owned(), what: "memory of parsed JSON", got, limit });
        }
        let mut nodes = Vec::with_capacity(old.len());
        let mut added = Vec::new();
        for node in old {
            let mut children = self.node_indices(&node.children, "a node")?;
            let mut upgraded = json!({});
            for (i, mesh) in meshes(node).iter().enumerate() {
                let mesh = self.index(&self.document.meshes.ids, mesh, "mesh", "a node")?;
                match i {
                    0 => upgraded["mesh"] = mesh.into(),
                    _ => {
                        children.push(old.len() + added.len());
                        added.push(json!({ "mesh": mesh }));
                    }
                }
            }
            let rotation = self.rotation(&node.rotation);
            for (name, value) in [
                ("matrix", &node.matrix),
                ("translation", &node.translation),
                ("rotation", &rotation),
                ("scale", &node.scale),
                ("extras", &node.extras),
            ] {
                if !value.is_null() {
                    upgraded[name] = value.clone();
                }
            }
            if !children.is_empty() {
                upgraded["children"] = children.into();
            }
            nodes.push(upgraded);
        }
        nodes.append(&mut added);
        Ok(nodes)
    }

    pub(super) fn scenes(&self) -> Result<Vec<Value>, IoError> {
        let scenes = self.document.scenes.list.iter();
        scenes.map(|scene| Ok(json!({ "nodes": self.node_indices(&scene.nodes, "a scene")? }))).collect()
    }

    fn node_indices(&self, ids: &[Text], user: &str) -> Result<Vec<usize>, IoError> {
        ids.iter().map(|id| self.index(&self.document.nodes.ids, id, "node", user)).collect()
    }

    /// Returns a rotation as a quaternion. glTF 0.8 has an axis and an angle.
    fn rotation(&self, rotation: &Value) -> Value {
        if !self.version.starts_with('0') {
            return rotation.clone();
        }
        let part = |i: usize| rotation.get(i).and_then(Value::as_f64);
        let (Some(x), Some(y), Some(z), Some(angle)) = (part(0), part(1), part(2), part(3)) else { return Value::Null };
        let quaternion = DVec3::new(x, y, z).try_normalize().map(|axis| DQuat::from_axis_angle(axis, angle));
        json!(quaternion.unwrap_or(DQuat::IDENTITY).to_array())
    }
}

fn meshes(node: &Node) -> &[Text] {
    match &node.instance_skin {
        Some(instance) if node.meshes.is_empty() => &instance.meshes,
        _ => &node.meshes,
    }
}
