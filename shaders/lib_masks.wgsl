// Where alpha cuts holes into a triangle: masks.rs. Reads the globals `masks`, `planes` and `alpha`.

struct TexelMap {
    texel: array<i32, 2>,
    step1: array<i32, 2>,
    step2: array<i32, 2>,
    shift: u32,
}

struct TriangleMask {
    plane: u32,
    threshold: u32,
    map: TexelMap,
    reserved: u32,
}

struct PackedPlane {
    first_texel: u32,
    width: u32,
    height: u32,
    wrap_u: u32,
    wrap_v: u32,
}

fn wrap_texel(texel: i32, size: u32, wrap: u32) -> u32 {
    let n = i32(size);
    if wrap == WRAP_CLAMP {
        return u32(clamp(texel, 0i, n - 1i));
    }
    let period = select(n, 2i * n, wrap == WRAP_MIRROR);
    let t = (texel % period + period) % period;
    return u32(min(t, select(t, period - 1i - t, wrap == WRAP_MIRROR)));
}

fn mask_passes(mask: u32, weights: vec2<u32>) -> bool {
    let plane = planes[masks[mask].plane];
    let w = vec2<i32>(weights);
    let map = masks[mask].map;
    let s = (map.texel[0] + ((w.x * map.step1[0] + w.y * map.step2[0]) >> 15u)) >> map.shift;
    let t = (map.texel[1] + ((w.x * map.step1[1] + w.y * map.step2[1]) >> 15u)) >> map.shift;
    let texel = plane.first_texel + wrap_texel(t, plane.height, plane.wrap_v) * plane.width
        + wrap_texel(s, plane.width, plane.wrap_u);
    let value = (alpha[texel >> 2u] >> ((texel & 3u) * 8u)) & 255u;
    return value >= masks[mask].threshold;
}
