// Where a ray meets the height field. Rays live in grid space: x = column, y = row (texels),
// z = height in mm; a ray's parameter t is the same in canvas space.
//
// A patch is the bilinear surface between four samples; a ray is intersected with it exactly, from
// either side. A sample outside the canvas holds HOLE, far below everything, and a patch with such
// a corner is never met. On the way, cells of 2, 4, 8... patches a side are leapt over where the
// ray stays above or below all they hold (maximum mipmap; Tevs, Ihrke and Seidel 2008), so that
// the work grows with the logarithm of the way, not with its length.

const HOLE_LIMIT: f32 = -1.0e6;  // heights below it belong to a hole
const MISS: f32 = -1.0;
const SLACK_TEXELS: f32 = 1.0e-3;  // rounding of a place on the grid: no ray slips between patches
const ROUNDING: f32 = 1.0e-6;      // of a height, relative
const FIRST_LEVEL: u32 = 3u;

const ABOVE: i32 = 1;
const OPEN: i32 = 0;  // over a hole or off the grid
const BELOW: i32 = -1;

fn height_at(grid: vec2f) -> f32 {
    let inside = clamp(grid, vec2f(0.0), frame.last_sample);
    let base = min(floor(inside), frame.last_sample - 1.0);
    let f = inside - base;
    let i = vec2i(base);
    let h00 = textureLoad(heights, i, 0).r;
    let h10 = textureLoad(heights, i + vec2i(1, 0), 0).r;
    let h01 = textureLoad(heights, i + vec2i(0, 1), 0).r;
    let h11 = textureLoad(heights, i + vec2i(1, 1), 0).r;
    return mix(mix(h00, h10, f.x), mix(h01, h11, f.x), f.y);
}

// On which side of the surface a point lies.
fn side_of(point: vec3f) -> i32 {
    let h = height_at(point.xy);
    if (h < HOLE_LIMIT) { return OPEN; }
    return select(BELOW, ABOVE, point.z >= h);
}

// The interval of t in which origin + t * direction lies in a box; empty if y < x.
fn clip_to_box(origin: vec3f, direction: vec3f, low: vec3f, high: vec3f) -> vec2f {
    // A zero component would make 0 * inf = NaN on the box's own faces.
    let safe = select(direction, vec3f(1.0e-20), abs(direction) < vec3f(1.0e-20));
    let a = (low - origin) / safe;
    let b = (high - origin) / safe;
    let enter = min(a, b);
    let leave = max(a, b);
    return vec2f(max(max(enter.x, enter.y), enter.z), min(min(leave.x, leave.y), leave.z));
}

// The stretch of t that is one texel long, or infinity for a ray along z.
fn texel_of(direction: vec3f) -> f32 {
    return 1.0 / max(max(abs(direction.x), abs(direction.y)), 1.0e-20);
}

// The first t in [low, high] at which the ray meets a patch. `here` is where the ray is at t = 0.
fn hit_patch(corner: vec2i, here: vec3f, direction: vec3f, low: f32, high: f32) -> f32 {
    let h00 = textureLoad(heights, corner, 0).r;
    let h10 = textureLoad(heights, corner + vec2i(1, 0), 0).r;
    let h01 = textureLoad(heights, corner + vec2i(0, 1), 0).r;
    let h11 = textureLoad(heights, corner + vec2i(1, 1), 0).r;
    if (min(min(h00, h10), min(h01, h11)) < HOLE_LIMIT) { return MISS; }
    // From t = low on, where u and v are small, the height above the patch is a t^2 + b t + c.
    let at = here + low * direction;
    let u = at.x - f32(corner.x);
    let v = at.y - f32(corner.y);
    let along_u = h10 - h00;
    let along_v = h01 - h00;
    let twist = h11 - h10 - along_v;
    let a = -twist * direction.x * direction.y;
    let b = direction.z - along_u * direction.x - along_v * direction.y
        - twist * (u * direction.y + v * direction.x);
    let c = at.z - h00 - along_u * u - along_v * v - twist * u * v;
    let length = high - low;
    let inside = b * b - 4.0 * a * c;
    if (inside < 0.0) { return MISS; }
    // Neither root is a difference of near numbers; a flat patch has one, the other is infinite.
    let q = -0.5 * (b + select(-1.0, 1.0, b >= 0.0) * sqrt(inside));
    if (q == 0.0) { return select(MISS, low, c == 0.0); }
    let first = c / q;
    var t = select(MISS, first, first >= 0.0 && first <= length);
    if (abs(q) <= abs(a) * length) {
        let second = q / a;
        if (second >= 0.0 && (t == MISS || second < t)) { t = second; }
    }
    return select(low + t, MISS, t == MISS);
}

// The first t in [t_start, t_end] at which the ray meets the surface, MISS if there is none.
fn first_hit(origin: vec3f, direction: vec3f, t_start: f32, t_end: f32) -> f32 {
    let here = origin + t_start * direction;  // t = 0 from here on: near the surface, so precise
    let length = t_end - t_start;
    let straight = abs(direction.xy) < vec2f(1.0e-20);  // crosses no edge in that axis
    let per_texel = 1.0 / select(direction.xy, vec2f(1.0), straight);
    let forward = per_texel > vec2f(0.0);
    let ahead = select(vec2i(0), vec2i(1), forward);
    let slack = SLACK_TEXELS * texel_of(direction);
    let margin = ROUNDING * (abs(here.z) + abs(length * direction.z));
    let last_patch = vec2i(frame.last_sample) - 1;
    let top_level = arrayLength(&levels) - 1u;
    var at = clamp(vec2i(floor(here.xy)), vec2i(0), last_patch);
    var level = min(FIRST_LEVEL, top_level);
    var t = 0.0;
    // Each turn goes a level down, or to a patch farther along the ray: the loop ends.
    loop {
        let cell = at >> vec2u(level);
        let far_edges = (vec2f((cell + ahead) << vec2u(level)) - here.xy) * per_texel;
        let edges = select(far_edges, vec2f(1.0e30), straight);
        let leave = clamp(min(edges.x, edges.y), t, length);
        if (level > 0u) {
            let row = levels[level];
            let bound = bounds[row.x + u32(cell.y) * row.y + u32(cell.x)];
            let a = here.z + max(t - slack, 0.0) * direction.z;
            let b = here.z + min(leave + slack, length) * direction.z;
            if (min(a, b) <= bound.x + margin && max(a, b) >= bound.y - margin) {
                level -= 1u;
                continue;
            }
        } else {
            let low = max(t - slack, 0.0);
            let hit = hit_patch(at, here, direction, low, min(leave + slack, length));
            if (hit != MISS) { return t_start + hit; }
        }
        if (leave >= length) { return MISS; }
        // On to the next cell: across the edge in one axis, as far as the ray is in the other.
        let first = cell << vec2u(level);
        let last = ((cell + 1) << vec2u(level)) - 1;
        let across = vec2<bool>(edges.x <= edges.y, edges.x > edges.y);
        let come = clamp(vec2i(floor(here.xy + leave * direction.xy)), first, min(last, last_patch));
        let onward = select(min(come, at), max(come, at), forward);  // never back, by no rounding
        at = select(onward, select(first - 1, last + 1, forward), across);
        if (any(at < vec2i(0)) || any(at > last_patch)) { return MISS; }
        t = leave;
        level = min(level + 1u, top_level);
    }
    return MISS;
}
