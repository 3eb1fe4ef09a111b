// The light that leaves a texel of the painting: one function for every way of drawing it.
//
// Attributes are bilinear with float32 weights (a sampler's weights have 8 bits). The Lafortune
// lobe is McAllister et al. 2002; v and l are taken at the texel's own height.

struct Lamp {
    position: vec3f,          // canvas, mm
    radiant_intensity: vec3f, // intensity * colour, mm^2 (E = this * cos / r^2 with r in mm)
}

struct Texel {
    normal: vec3f,
    diffuse: vec3f,
    specular: vec3f,
    lobe: vec3f,  // C_xy, C_z, k
}

fn bilinear(image: texture_2d<f32>, grid: vec2f) -> vec4f {
    let inside = clamp(grid, vec2f(0.0), frame.last_sample);
    let base = min(floor(inside), frame.last_sample - 1.0);
    let f = inside - base;
    let i = vec2i(base);
    let top = mix(textureLoad(image, i, 0), textureLoad(image, i + vec2i(1, 0), 0), f.x);
    let bottom =
        mix(textureLoad(image, i + vec2i(0, 1), 0), textureLoad(image, i + vec2i(1, 1), 0), f.x);
    return mix(top, bottom, f.y);
}

fn texel_at(grid: vec2f) -> Texel {
    let n = bilinear(normals, grid).xy;
    let n_z = sqrt(max(1.0 - dot(n, n), 1.0e-6));
    return Texel(
        normalize(vec3f(n, n_z)),
        bilinear(diffuse, grid).rgb,
        bilinear(specular, grid).rgb,
        bilinear(lobe, grid).rgb,
    );
}

// f_r = rho_d + rho_s max(0, C_xy (v_x l_x + v_y l_y) + C_z v_z l_z)^k in the texel's frame. The
// isotropic lobe needs no tangents: v_x l_x + v_y l_y = v.l - v_z l_z.
fn reflectance(texel: Texel, v: vec3f, l: vec3f) -> vec3f {
    let v_z = dot(v, texel.normal);
    let l_z = dot(l, texel.normal);
    let base = texel.lobe.x * (dot(v, l) - v_z * l_z) + texel.lobe.y * v_z * l_z;
    var peak = 0.0;
    if (base > 0.0) { peak = pow(base, texel.lobe.z); }
    return texel.diffuse + texel.specular * peak;
}

// Whether the relief stands between a point of the surface (grid space) and a lamp.
fn in_shadow(point: vec3f, lamp: vec3f) -> bool {
    let direction = vec3f(lamp.x, -lamp.y, lamp.z) * frame.to_grid - point;
    let margin = frame.shadow_margin / length(direction / frame.to_grid);
    let low = vec3f(0.0, 0.0, frame.bottom);
    let span = clip_to_box(point, direction, low, vec3f(frame.last_sample, frame.top));
    let t_end = min(span.y, 1.0);
    if (t_end <= margin) { return false; }
    return first_hit(point, direction, margin, t_end) != MISS;
}

// Radiance of the surface at a place of the grid, seen from the camera.
fn shade(grid: vec2f, height: f32) -> vec3f {
    let texel = texel_at(grid);
    let point = vec3f(grid.x, grid.y, height);
    let place = vec3f(grid.x, -grid.y, height) / frame.to_grid;
    let v = normalize(frame.camera - place);
    var radiance = vec3f(0.0);
    for (var i = 0u; i < frame.lamp_count; i++) {
        let towards = lamps[i].position - place;
        let r2 = max(dot(towards, towards), 1.0e-6);
        let l = towards * inverseSqrt(r2);
        let cosine = dot(l, texel.normal);
        if (cosine <= 0.0) { continue; }
        if (frame.shadows != 0u && in_shadow(point, lamps[i].position)) { continue; }
        radiance += reflectance(texel, v, l) * lamps[i].radiant_intensity * (cosine / r2);
    }
    return radiance;
}
