// Vertex pulling: the shader fetches the vertices of small meshes. A vertex has 7 words, as MeshVertex in src/scene.

@group(3) @binding(0) var<storage, read> pulled_vertices: array<u32>;
@group(3) @binding(1) var<storage, read> pulled_indices: array<u32>;

// Returns the k-th vertex of a mesh. Beyond the last index it repeats that vertex, which gives triangles without area.
fn pulled_vertex(leaf: Leaf, k: u32) -> MeshVertex {
    let count = leaf.flags >> INDEX_COUNT_SHIFT & 255u;
    let at = 7u * (leaf.alpha_cutoff + pulled_indices[leaf.side + min(k, count - 1u)]);
    var vertex: MeshVertex;
    vertex.position =
        bitcast<vec3<f32>>(vec3<u32>(pulled_vertices[at], pulled_vertices[at + 1u], pulled_vertices[at + 2u]));
    set_uv(&vertex, bitcast<vec2<f32>>(vec2<u32>(pulled_vertices[at + 3u], pulled_vertices[at + 4u])));
    vertex.normal = unpack4x8snorm(pulled_vertices[at + 5u]);
    vertex.color = unpack4x8unorm(pulled_vertices[at + 6u]);
    return vertex;
}
