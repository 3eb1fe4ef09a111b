// The painting: a bump-mapped plane at d0, boxes with relief mapping, and the full mesh.
//
// First the visible surface is found: each way of drawing writes the place on the grid that a
// pixel sees. Then each pixel is shaded once. Last come the boxes that blend over what is there.
//
// Depth is reversed with the far plane at infinity: near / z, greater is nearer. Rays have z = 1 in
// the camera's frame, so their parameter t is the depth z.

struct Frame {
    clip_from_canvas: mat4x4f,
    ray_column: vec3f,  // ray = pixel.x * ray_column + pixel.y * ray_row + ray_first
    plane: f32,         // d0, mm
    ray_row: vec3f,
    bottom: f32,        // lowest and highest height, mm
    ray_first: vec3f,
    top: f32,
    camera: vec3f,      // canvas, mm
    near: f32,
    to_grid: vec3f,     // (texels per mm, texels per mm, 1)
    shadow_margin: f32, // mm
    last_sample: vec2f, // (columns - 1, rows - 1)
    lamp_count: u32,
    shadows: u32,
}

struct Box {
    low: vec3f,   // canvas, mm
    alpha: f32,
    high: vec3f,
}

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> lamps: array<Lamp>;
@group(0) @binding(2) var<storage, read> boxes: array<Box>;
@group(0) @binding(3) var heights: texture_2d<f32>;
@group(0) @binding(4) var normals: texture_2d<f32>;
@group(0) @binding(5) var diffuse: texture_2d<f32>;
@group(0) @binding(6) var specular: texture_2d<f32>;
@group(0) @binding(7) var lobe: texture_2d<f32>;
@group(0) @binding(8) var opaque_boxes: texture_2d<f32>;  // 1 where a patch lies in one
@group(0) @binding(9) var<storage, read> bounds: array<vec2f>;  // highest, lowest of a cell, mm
@group(0) @binding(10) var<storage, read> levels: array<vec2u>; // first cell, cells per row
@group(1) @binding(0) var visible: texture_2d<f32>;

const NOTHING: f32 = -1.0e6;  // places on the grid left of it: the pixel sees no canvas

struct Seen {
    @location(0) grid: vec2f,
    @builtin(frag_depth) depth: f32,
}

struct Painted {
    @location(0) colour: vec4f,
    @builtin(frag_depth) depth: f32,
}

fn to_grid(place: vec3f) -> vec3f {
    return vec3f(place.x, -place.y, place.z) * frame.to_grid;
}

// The ray through the centre of a pixel, canvas space.
fn ray_through(position: vec4f) -> vec3f {
    let pixel = position.xy - 0.5;
    return pixel.x * frame.ray_column + pixel.y * frame.ray_row + frame.ray_first;
}

fn project(place: vec3f) -> vec4f {
    return frame.clip_from_canvas * vec4f(place, 1.0);
}

fn in_opaque_box(grid: vec2f) -> bool {
    let first_sample = vec2i(clamp(grid, vec2f(0.0), frame.last_sample - 1.0));
    return textureLoad(opaque_boxes, first_sample, 0).r > 0.5;
}

// ---- the plane at d0

@vertex
fn plane_vertex(@builtin(vertex_index) index: u32) -> @builtin(position) vec4f {
    let corner = vec2f(f32(index & 1u), f32(index >> 1u)) * frame.last_sample / frame.to_grid.xy;
    return project(vec3f(corner.x, -corner.y, frame.plane));
}

@fragment
fn plane_fragment(@builtin(position) position: vec4f) -> Seen {
    let ray = ray_through(position);
    let t = (frame.plane - frame.camera.z) / ray.z;
    if (!(t > 0.0)) { discard; }
    let grid = to_grid(frame.camera + t * ray).xy;
    let height = height_at(grid);
    if (height < HOLE_LIMIT) { discard; }
    // Under relief that is drawn itself, the plane could be seen only through the open edge.
    if (height > frame.plane && in_opaque_box(grid)) { discard; }
    return Seen(grid, frame.near / t);
}

// ---- boxes

struct BoxVertex {
    @builtin(position) position: vec4f,
    @location(0) @interpolate(flat) index: u32,
}

// The far faces are drawn, so that a box holding the camera is seen too: one triangle strip of 14
// vertices whose corners are read from three bit patterns.
@vertex
fn box_vertex(
    @builtin(vertex_index) vertex: u32, @builtin(instance_index) index: u32
) -> BoxVertex {
    let corner = (vec3u(0x287au, 0x02afu, 0x31e3u) >> vec3u(vertex)) & vec3u(1u);
    let place = mix(boxes[index].low, boxes[index].high, vec3f(corner));
    return BoxVertex(project(place), index);
}

// Where the ray meets the relief inside the box.
fn hit_in_box(origin: vec3f, direction: vec3f, low: vec3f, high: vec3f) -> f32 {
    let span = clip_to_box(origin, direction, low, high);
    let enter = max(span.x, 0.0);
    if (span.y <= enter) { return MISS; }
    let side = side_of(origin + enter * direction);
    if (side == BELOW) {
        let field = clip_to_box(
            origin, direction, vec3f(0.0, 0.0, frame.bottom), vec3f(frame.last_sample, frame.top)
        );
        let first = clamp(field.x, 0.0, enter);
        if (side_of(origin + first * direction) == ABOVE) {
            // The ray has met the surface on its way, or gone under it through a hole. A wall
            // stands here if it came through a box that is not drawn, which has left a step.
            let back = 0.5 / max(length(direction.xy), 1.0e-20);
            let came_from = (origin + (enter - back) * direction).xy;
            return select(enter, MISS, in_opaque_box(came_from));
        }
        // Else it came in at the canvas's open edge, and may meet the surface from below.
    }
    // Next boxes overlap by the rounding, so that nothing is seen between them.
    let slack = SLACK_TEXELS * texel_of(direction);
    return first_hit(origin, direction, max(enter - slack, 0.0), span.y + slack);
}

// What a pixel sees of a box: the place on the grid and t; t = MISS where it sees none.
fn see_box(vertex: BoxVertex) -> vec3f {
    let box = boxes[vertex.index];
    let ray = ray_through(vertex.position);
    let origin = to_grid(frame.camera);
    let direction = vec3f(ray.x, -ray.y, ray.z) * frame.to_grid;
    let a = to_grid(box.low);
    let b = to_grid(box.high);
    let t = hit_in_box(origin, direction, min(a, b), max(a, b));
    return vec3f((origin + t * direction).xy, t);
}

@fragment
fn box_fragment(vertex: BoxVertex) -> Seen {
    let seen = see_box(vertex);
    if (seen.z == MISS) { discard; }
    return Seen(seen.xy, frame.near / seen.z);
}

@fragment
fn blended_box_fragment(vertex: BoxVertex) -> Painted {
    let seen = see_box(vertex);
    var colour = vec4f(0.0);
    if (seen.z == MISS) {
        discard;  // the invocation may go on, and must not shade
    } else {
        colour = vec4f(shade(seen.xy, height_at(seen.xy)), boxes[vertex.index].alpha);
    }
    return Painted(colour, frame.near / seen.z);
}

// ---- every sample as a vertex, two triangles per patch

struct MeshVertex {
    @builtin(position) position: vec4f,
    @location(0) grid: vec2f,
}

@vertex
fn mesh_vertex(@builtin(vertex_index) index: u32) -> MeshVertex {
    let columns = u32(frame.last_sample.x);
    let patch_index = index / 6u;
    let base = vec2u(patch_index % columns, patch_index / columns);
    // Corners 0 1 2 and 2 1 3 of the patch, as bits (column, row).
    let corner = (0xda4u >> (2u * (index % 6u))) & 3u;
    let at = base + vec2u(corner & 1u, corner >> 1u);
    let grid = vec2f(at);
    let whole = height_at(vec2f(base) + 0.5) > HOLE_LIMIT;
    let place = vec3f(grid.x, -grid.y, textureLoad(heights, at, 0).r) / frame.to_grid;
    // A patch with a hole at a corner collapses outside the picture.
    return MeshVertex(select(vec4f(2.0, 2.0, 2.0, 1.0), project(place), whole), grid);
}

@fragment
fn mesh_fragment(vertex: MeshVertex) -> @location(0) vec2f {
    return vertex.grid;
}

// ---- the light of what is visible, once per pixel

@vertex
fn shade_vertex(@builtin(vertex_index) index: u32) -> @builtin(position) vec4f {
    let corner = vec2f(f32(index & 1u), f32(index >> 1u)) * 4.0 - 1.0;
    return vec4f(corner, 0.0, 1.0);
}

@fragment
fn shade_fragment(@builtin(position) position: vec4f) -> @location(0) vec4f {
    let grid = textureLoad(visible, vec2i(position.xy), 0).xy;
    if (grid.x < NOTHING) { return vec4f(0.0); }
    return vec4f(shade(grid, height_at(grid)), 1.0);
}
