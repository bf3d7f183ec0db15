// Height tiles: one grid mesh, displaced and morphed by the vertex shader.
//
// Vertex v of level L is drawn at p_L(v) = (1 - k) P(v) + k p_{L-1}(snap(v)). P is the tile's own surface, and snap(v) is
// the coarser level's vertex south-west of v. The weight k depends on the coarser level's error at v and the distance from the
// eye to P(v) alone; if rays are parallel, on the error alone. So two tiles that share an edge compute the same points on it.
// Where a finer tile meets a coarser one, its edge has k = 1, which is the coarser one's edge.

// A vertex with height h in the row (dp, dz, cos, sin) and the column (sin', 1 - cos') has the position
//     east   = (p0 + dp + h cos) * sin'
//     radial = dp + h cos - (p0 + dp + h cos) * (1 - cos')
//     polar  = dz + h sin
// This is the ellipsoid in small differences (see HeightTile).

@group(1) @binding(0) var heights: texture_2d_array<f32>;
@group(1) @binding(1) var<storage, read> tables: array<vec4<f32>>;
@group(1) @binding(2) var color_layers: texture_2d_array<f32>;
@group(1) @binding(3) var color_sampler: sampler;

const HEADER: u32 = 8u;

// Returns the row j of a tile's table.
fn row_of(table: u32, j: i32) -> vec4<f32> {
    return tables[table + HEADER + u32(j)];
}

// Returns sin and 1 - cos of a column's longitude from the tile's centre.
fn column_of(table: u32, side: u32, i: i32) -> vec2<f32> {
    let pair = tables[table + HEADER + side + u32(i >> 1u)];
    return select(pair.xy, pair.zw, (i & 1) == 1);
}

// Returns the height of a vertex; coordinates -1 and `side` are the border.
fn height_at(layer: u32, vertex: vec2<i32>) -> f32 {
    return textureLoad(heights, vertex + 1, layer, 0).r;
}

// Returns the slopes east and north from the differences over `step` cells to both sides. Towards the edges there are fewer,
// but as many on both sides, so that the neighbouring tile computes the same slopes on the edge.
fn slope_at(side: u32, layer: u32, vertex: vec2<i32>, step: i32, cell: vec2<f32>) -> vec2<f32> {
    let inside = min(vertex, i32(side) - 1 - vertex);
    let reach = min(vec2<i32>(step), inside + 1);
    let low = vertex - reach;
    let high = vertex + reach;
    let rise = vec2<f32>(
        height_at(layer, vec2<i32>(high.x, vertex.y)) - height_at(layer, vec2<i32>(low.x, vertex.y)),
        height_at(layer, vec2<i32>(vertex.x, high.y)) - height_at(layer, vec2<i32>(vertex.x, low.y)),
    );
    return rise / (vec2<f32>(2 * reach) * cell);
}

// Returns the geometric error of the n-th coarser level at a vertex in metres, interpolated between the corners of the tile.
fn error_at(table: u32, n: u32, vertex: vec2<i32>, cells: i32) -> f32 {
    let corners = tables[table + 2u + n];  // south-west, south-east, north-west, north-east
    let place = vec2<f32>(vertex) / f32(cells);
    let south_north = mix(corners.xz, corners.yw, place.x);
    return mix(south_north.x, south_north.y, place.y);
}

// A vertex of a tile in eye space.
struct HeightPoint {
    in_eye: vec3<f32>,
    normal: vec3<f32>,
    up: vec3<f32>,
    uv: vec2<f32>,
    in_tile: vec3<f32>,
    facing: vec3<f32>,  // the normal in the tile's frame, not of unit length
}

// Returns a vertex of a tile, displaced and morphed.
fn height_point(index: u32, instance: u32) -> HeightPoint {
    let leaf = leaves[instance];
    let side = leaf.side;
    let layer = leaf.layer;
    let table = layer * (HEADER + side + (side + 1u) / 2u);
    let cells = i32(side) - 1;

    // The indices after the grid are the ring of the skirt, counter-clockwise from the south-west.
    var vertex = vec2<i32>(i32(index % side), i32(index / side));
    var drop = 0.0;
    if index >= side * side {
        let k = i32(index - side * side);
        let along = k % cells;
        switch k / cells {
            case 0: { vertex = vec2<i32>(along, 0); }
            case 1: { vertex = vec2<i32>(cells, along); }
            case 2: { vertex = vec2<i32>(cells - along, cells); }
            default: { vertex = vec2<i32>(0, cells - along); }
        }
        drop = tables[table].y;
    }

    let header = tables[table];  // p0, skirt, cell size east and north
    let levels = u32(tables[table + 1u].x);
    let morph_start = frame.sun_color.w;
    let range_per_error = frame.sun_direction.w;
    let row = row_of(table, vertex.y);
    let column = column_of(table, side, vertex.x);
    // Cells narrow towards the poles.
    let cell = header.zw * vec2<f32>(max(1.0 + row.x / header.x, 1e-3), 1.0);

    var weight = 1.0;
    var step = 1;
    var v = vertex;
    var v_row = row;
    var v_column = column;
    var position = vec3<f32>(0.0);
    var slope = vec2<f32>(0.0);
    var grid = vec2<f32>(0.0);
    for (var n = 0u; n <= 6u; n++) {
        let height = height_at(layer, v);
        let out = v_row.x + height * v_row.z;
        let across = header.x + out;
        let point = vec3<f32>(across * v_column.x, out - across * v_column.y, v_row.y + height * v_row.w);
        var k = 0.0;
        if n < levels {
            let distance = select(length(point_in_eye(leaf, point)), 1.0, frame.air.w > 0.0);
            let range = max(error_at(table, n, v, cells) * range_per_error, 1e-6);
            k = clamp((distance / range - morph_start) / (1.0 - morph_start), 0.0, 1.0);
        }
        let share = weight * (1.0 - k);
        if share > 0.0 {
            position += share * point;
            slope += share * slope_at(side, layer, v, step, cell);
            grid += share * vec2<f32>(v);
        }
        weight *= k;
        if weight <= 0.0 {
            break;
        }
        step *= 2;
        v = vec2<i32>(v.x & -step, v.y & -step);
        v_row = row_of(table, v.y);
        v_column = column_of(table, side, v.x);
    }

    // East, north and up at the vertex, in the tile's (left-handed) frame.
    let cos_lon = 1.0 - column.y;
    let east = vec3<f32>(cos_lon, -column.x, 0.0);
    let north = vec3<f32>(-row.w * column.x, -row.w * cos_lon, row.z);
    let up = vec3<f32>(row.z * column.x, row.z * cos_lon, row.w);
    let normal = up - slope.x * east - slope.y * north;
    position -= drop * up;

    return HeightPoint(
        point_in_eye(leaf, position),
        normal_in_eye(leaf, normal),
        normalize(direction_in_eye(leaf, up)),
        vec2<f32>(grid.x, f32(cells) - grid.y) / f32(cells),
        position,
        normal,
    );
}
