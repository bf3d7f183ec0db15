// Gaussian splats: each is a quad around its ellipse on screen (M. Zwicker et al., EWA Splatting, 2002; B. Kerbl et al., 3D
// Gaussian Splatting, 2023). Colours are displayed as they are, like those of unlit materials.

// A splat has 9 words, as Splat in src/scene/geometry/splats.rs.
@group(1) @binding(0) var<storage, read> splats: array<u32>;
// The numbers of the splats from back to front.
@group(1) @binding(1) var<storage, read> splat_order: array<u32>;
// For each splat a step (f32), and then bytes in threes: what is added to its colour, and the coefficients of its harmonics, as
// SplatHarmonics in src/scene/geometry/splats/harmonics.rs. Not read by splats without harmonics.
@group(1) @binding(2) var<storage, read> splat_harmonics: array<u32>;

// Standard deviations at which a splat ends.
const SPLAT_SIGMAS: f32 = 3.0;
// Fragments with less alpha are not drawn.
const MIN_ALPHA: f32 = 1.0 / 255.0;
// Added to the variances on screen, in pixels: splats that are smaller than a pixel would otherwise lie between pixel centres.
const PIXEL_VARIANCE: f32 = 0.3;
// The linear projection of a splat is that of the nearest point within this range of clip positions; farther outside it
// stretches without limit.
const MAX_CLIP: f32 = 1.3;
const MAX_SIGMA_PX: f32 = 1024.0;
// Bits of the leaf's `side`: the degree of the harmonics, and whether they are added to linear colours.
const DEGREE_MASK: u32 = 3u;
const LINEAR_HARMONICS: u32 = 4u;

struct SplatFragment {
    @builtin(position) position: vec4<f32>,
    @location(0) color: vec4<f32>,
    // The offset from the centre in standard deviations along the axes of the ellipse.
    @location(1) offset: vec2<f32>,
    // The centre in eye space.
    @location(2) @interpolate(flat) in_eye: vec3<f32>,
    @location(3) @interpolate(flat) flags: u32,
}

fn splat_vector(at: u32) -> vec3<f32> {
    return bitcast<vec3<f32>>(vec3<u32>(splats[at], splats[at + 1u], splats[at + 2u]));
}

fn linear_from_srgb(srgb: vec3<f32>) -> vec3<f32> {
    let curve = pow((srgb + 0.055) / 1.055, vec3<f32>(2.4));
    return select(curve, srgb / 12.92, srgb <= vec3<f32>(0.04045));
}

// Returns the matrix of a rotation by a unit quaternion.
fn rotation_matrix(q: vec4<f32>) -> mat3x3<f32> {
    let d = q.xyz + q.xyz;
    let xx = q.x * d.x; let yy = q.y * d.y; let zz = q.z * d.z;
    let xy = q.x * d.y; let xz = q.x * d.z; let yz = q.y * d.z;
    let wx = q.w * d.x; let wy = q.w * d.y; let wz = q.w * d.z;
    return mat3x3<f32>(
        vec3<f32>(1.0 - yy - zz, xy + wz, xz - wy),
        vec3<f32>(xy - wz, 1.0 - xx - zz, yz + wx),
        vec3<f32>(xz + wy, yz - wx, 1.0 - xx - yy),
    );
}

fn harmonic_steps(at: u32) -> vec4<f32> {
    return unpack4x8unorm(splat_harmonics[at]) * 255.0 - 128.0;
}

// Returns four successive coefficients, in steps.
fn four_coefficients(at: u32) -> mat4x3<f32> {
    let a = harmonic_steps(at);
    let b = harmonic_steps(at + 1u);
    let c = harmonic_steps(at + 2u);
    return mat4x3<f32>(a.xyz, vec3<f32>(a.w, b.xy), vec3<f32>(b.zw, c.x), c.yzw);
}

// Returns what is added to the colour of a splat that is seen in a direction of length 1: real spherical harmonics with the
// Condon-Shortley phase (KHR_gaussian_splatting, appendix).
fn added_color(number: u32, degree: u32, d: vec3<f32>) -> vec3<f32> {
    let at = number * select(select(13u, 8u, degree == 2u), 4u, degree == 1u);
    let x = d.x;
    let y = d.y;
    let z = d.z;
    var sum = four_coefficients(at + 1u) * vec4<f32>(1.0, -0.48860251 * y, 0.48860251 * z, -0.48860251 * x);
    if degree > 1u {
        let xx = x * x;
        let yy = y * y;
        let zz = z * z;
        sum += four_coefficients(at + 4u)
            * vec4<f32>(1.09254843 * x * y, -1.09254843 * y * z, 0.31539157 * (2.0 * zz - xx - yy), -1.09254843 * x * z);
        let last = 0.54627421 * (xx - yy);
        if degree == 2u {
            sum += harmonic_steps(at + 7u).xyz * last;
        } else {
            let ring = 0.45704580 * (xx + yy - 4.0 * zz);
            sum += four_coefficients(at + 7u)
                * vec4<f32>(last, 0.59004359 * y * (yy - 3.0 * xx), 2.89061144 * x * y * z, ring * y);
            sum += four_coefficients(at + 10u) * vec4<f32>(
                0.37317633 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy),
                ring * x,
                1.44530572 * z * (xx - yy),
                0.59004359 * x * (3.0 * yy - xx),
            );
        }
    }
    return sum * bitcast<f32>(splat_harmonics[at]);
}

// Returns the direction from the eye to a point, in the frame of its leaf. The inverse of the leaf's matrix is that of its
// cofactors, but for a factor.
fn direction_in_leaf(leaf: Leaf, in_eye: vec3<f32>) -> vec3<f32> {
    let x = leaf.eye_from_drawable_x.xyz;
    let y = leaf.eye_from_drawable_y.xyz;
    let z = leaf.eye_from_drawable_z.xyz;
    let ray = way_to(in_eye).xyz;
    let yz = cross(y, z);
    let along = (ray.x * yz + ray.y * cross(z, x) + ray.z * cross(x, y)) * sign(dot(x, yz));
    return along / max(length(along), 1e-30);
}

// Returns the linear colour of a splat.
fn seen_color(leaf: Leaf, number: u32, srgb: vec3<f32>, in_eye: vec3<f32>) -> vec3<f32> {
    let degree = leaf.side & DEGREE_MASK;
    if degree == 0u {
        return linear_from_srgb(srgb);
    }
    let added = added_color(number, degree, direction_in_leaf(leaf, in_eye));
    if (leaf.side & LINEAR_HARMONICS) != 0u {
        return max(linear_from_srgb(srgb) + added, vec3<f32>(0.0));
    }
    return linear_from_srgb(max(srgb + added, vec3<f32>(0.0)));
}

// A splat that is not drawn: its corners are one point.
fn no_splat() -> SplatFragment {
    return SplatFragment(vec4<f32>(0.0, 0.0, 0.0, 1.0), vec4<f32>(0.0), vec2<f32>(0.0), vec3<f32>(0.0), 0u);
}

@vertex
fn vs_splat(@builtin(vertex_index) index: u32, @builtin(instance_index) instance: u32) -> SplatFragment {
    let leaf = leaves[instance];
    let number = splat_order[index / 6u];
    let at = 9u * number;
    let color = unpack4x8unorm(splats[at + 8u]);
    let opacity = color.a * leaf.color.a;
    let in_eye = point_in_eye(leaf, splat_vector(at));
    let clip = clip_of(leaf, in_eye);
    // Centres behind the near plane have no projection.
    if opacity < MIN_ALPHA || clip.w <= 0.0 || clip.z > clip.w {
        return no_splat();
    }

    // The axes of the splat in eye space, each as long as its standard deviation.
    let q = vec4<f32>(unpack2x16snorm(splats[at + 6u]), unpack2x16snorm(splats[at + 7u]));
    let rotation = rotation_matrix(normalize(q));
    let scale = splat_vector(at + 3u);
    // The change of the position on screen, in pixels, along each axis of the eye.
    let clip_at = clamp(clip.xy / clip.w, vec2<f32>(-MAX_CLIP), vec2<f32>(MAX_CLIP));
    let rows = transpose(frame.clip_from_eye);
    let pixels = 1.0 / (frame.middle_ray.zw * clip.w);
    let across = (rows[0].xyz - clip_at.x * rows[3].xyz) * pixels.x;
    let upwards = (rows[1].xyz - clip_at.y * rows[3].xyz) * pixels.y;
    var x = vec3<f32>(0.0);
    var y = vec3<f32>(0.0);
    for (var k = 0; k < 3; k++) {
        let axis = direction_in_eye(leaf, rotation[k] * scale[k]);
        x[k] = dot(across, axis);
        y[k] = dot(upwards, axis);
    }

    // The covariance on screen, and its axes.
    let xx = dot(x, x) + PIXEL_VARIANCE;
    let yy = dot(y, y) + PIXEL_VARIANCE;
    let xy = dot(x, y);
    let middle = 0.5 * (xx + yy);
    let half_difference = 0.5 * (xx - yy);
    let spread = sqrt(half_difference * half_difference + xy * xy);
    let sigmas = min(sqrt(vec2<f32>(middle + spread, max(middle - spread, PIXEL_VARIANCE))), vec2<f32>(MAX_SIGMA_PX));
    // Half of the angle of (half_difference, xy), without a division by zero for circles.
    let angle = 0.5 * select(atan2(xy, half_difference), 0.0, spread <= 1e-6 * middle);
    let long_axis = vec2<f32>(cos(angle), sin(angle));
    let short_axis = vec2<f32>(-long_axis.y, long_axis.x);

    // The quad ends where alpha does.
    let reach = min(sqrt(2.0 * log(opacity / MIN_ALPHA)), SPLAT_SIGMAS);
    let k = index % 6u;
    let corner = vec2<f32>(select(-1.0, 1.0, k == 1u || k == 2u || k == 4u), select(-1.0, 1.0, k == 2u || k == 4u || k == 5u));
    let offset = corner * reach;
    let offset_px = offset.x * sigmas.x * long_axis + offset.y * sigmas.y * short_axis;
    var fragment: SplatFragment;
    fragment.position = clip + vec4<f32>(offset_px * frame.middle_ray.zw * clip.w, 0.0, 0.0);
    let displayed_color = unlit_through_air(seen_color(leaf, number, color.rgb, in_eye) * leaf.color.rgb, aerial(in_eye));
    fragment.color = vec4<f32>(displayed_color, opacity);
    fragment.offset = offset;
    fragment.in_eye = in_eye;
    fragment.flags = leaf.flags;
    return fragment;
}

fn splat_color(in: SplatFragment) -> vec4<f32> {
    let square = dot(in.offset, in.offset);
    let alpha = in.color.a * exp(-0.5 * square);
    if square > SPLAT_SIGMAS * SPLAT_SIGMAS || alpha < MIN_ALPHA {
        discard;
    }
    return vec4<f32>(in.color.rgb, alpha);
}

@fragment
fn fs_splat(in: SplatFragment) -> @location(0) vec4<f32> {
    return splat_color(in);
}

@fragment
fn fs_splat_fading(in: SplatFragment) -> @location(0) vec4<f32> {
    if is_left_out(in.position.xy, in.in_eye, in.flags) {
        discard;
    }
    return splat_color(in);
}
