// Where a ray meets the height field. Rays live in grid space: x = column, y = row (texels),
// z = height in mm; a ray's parameter t is the same in canvas space.
//
// Heights are bilinear between four samples. A sample outside the canvas holds HOLE, far below
// everything, so a patch with such a corner is never met.

const HOLE_LIMIT: f32 = -1.0e6;  // heights below it belong to a hole
const TEXELS_PER_STEP: f32 = 0.5;
const CEILING_TILE: f32 = 8.0;
const MOST_STEPS: f32 = 8192.0;
const HALVINGS: i32 = 12;
const MISS: f32 = -1.0;

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

// The least height above which a ray is free for CEILING_TILE texels around a place, or more.
fn ceiling_at(grid: vec2f) -> f32 {
    let tile = vec2i(clamp(grid, vec2f(0.0), frame.last_sample) / CEILING_TILE);
    return textureLoad(ceilings, tile, 0).r;
}

// Linear search with steps of at most TEXELS_PER_STEP, stopped at the first sample on the other
// side of the surface, then bisection. `from_side` is the side on which the ray starts. Both
// faces of the surface are met; going into or out of a hole meets nothing. Runs of steps that
// the ceiling shows to be free are leapt over, which changes no result.
fn first_hit(origin: vec3f, direction: vec3f, t_start: f32, t_end: f32, from_side: i32) -> f32 {
    let texels = length(direction.xy) * (t_end - t_start);
    let steps = i32(clamp(ceil(texels / TEXELS_PER_STEP), 2.0, MOST_STEPS));
    let stride = (t_end - t_start) / f32(steps);
    let run = i32(clamp(CEILING_TILE * f32(steps) / max(texels, 1.0e-6), 1.0, f32(steps)));
    var before = from_side;
    var i = 0;
    while (i < steps) {
        let last = min(i + run, steps);
        let here = origin + (t_start + stride * f32(i)) * direction;
        let there = origin + (t_start + stride * f32(last)) * direction;
        if (before != BELOW && min(here.z, there.z) > ceiling_at(here.xy)) {
            i = last;
            before = side_of(there);
            continue;
        }
        while (i < last) {
            i++;
            let t = t_start + stride * f32(i);
            let side = side_of(origin + t * direction);
            if (side * before < 0) {
                return bisect(origin, direction, t - stride, t, side);
            }
            before = side;
        }
    }
    return MISS;
}

fn bisect(origin: vec3f, direction: vec3f, t_first: f32, t_last: f32, last_side: i32) -> f32 {
    var a = t_first;
    var b = t_last;
    for (var i = 0; i < HALVINGS; i++) {
        let middle = 0.5 * (a + b);
        if (side_of(origin + middle * direction) == last_side) { b = middle; } else { a = middle; }
    }
    return b;
}
